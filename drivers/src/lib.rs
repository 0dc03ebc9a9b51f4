//! Device state machines without I/O, and the links that carry their frames.
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
pub mod clock;
pub mod device;
pub mod discover;
pub mod dynamixel;
pub mod encoder_line;
mod framer;
pub mod hid_axis;
pub mod kunwei_kwr75;
pub mod leptrino;
pub mod link;
pub mod linkage;
pub mod options;
pub mod optoforce;
pub mod optoforce_can;
pub mod optoforce_serial;
mod outbox;
pub mod pose_stream;
pub mod priority;
pub mod pump;
pub mod reading;
pub mod robotous;
pub mod robotous_can;
pub mod robotous_uart;
mod sequence;
mod stages;
#[cfg(test)]
mod test_support;
pub mod translate;

pub use clock::{Clock, MonotonicClock, SteppedClock};
pub use device::{Counted, Device};
pub use link::{Link, LinkError, RxStamps};
pub use options::{Sign, Startup};
