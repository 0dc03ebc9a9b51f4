//! Codecs, units, frames and time: bytes in, values out, no input or output.
//!
//! Nothing here waits, reads a clock, allocates per sample or can panic on bytes from outside.
#![forbid(unsafe_code)]
#![warn(
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
#![cfg_attr(
    test,
    allow(
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

pub mod amt21;
pub mod ati_netcanoem;
pub mod bota_serial;
mod bytes;
pub mod can;
pub mod crc;
pub mod dynamixel2;
pub mod encoder_line;
pub mod error;
pub mod frames;
pub mod gs_usb;
pub mod hid;
pub mod kunwei_kwr75;
pub mod leptrino;
pub mod optoforce_hex;
pub mod pace;
pub mod pose_stream;
pub mod robotous_rft;
pub mod stream;
#[cfg(test)]
mod test_support;
pub mod time;

pub use can::CanFrame;
pub use error::DecodeError;
pub use frames::{Frame, Pose, Wrench};
pub use stream::{Chunk, Parsed};
pub use time::{DeviceTicks, HostTime, Unwrapper};
