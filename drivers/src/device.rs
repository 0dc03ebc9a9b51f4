//! The contract of a device: a protocol without input and output.

use ft_wire::{DecodeError, HostTime};

use crate::link::RxStamps;
use crate::reading::Counts;

/// A device's protocol without I/O: frames and instants go in, frames and readings come out.
pub trait Device {
    /// What the link carries: [`ft_wire::Chunk`], [`ft_wire::CanFrame`] or [`crate::hid_axis::HidFrame`].
    type Frame;
    /// What comes out.
    type Reading;

    /// Takes one frame; the caller drains `poll_reading` before the next.
    ///
    /// # Errors
    /// The frame is malformed. A byte stream may hold several frames in one chunk: the good ones are still read, the
    /// count of the refused is in [`crate::reading::Counts`].
    fn handle_frame(&mut self, frame: &Self::Frame, stamps: RxStamps) -> Result<(), DecodeError>;

    /// Time went by: `now` is at or past what `poll_timeout` asked for.
    fn handle_timeout(&mut self, now: HostTime);

    /// When `handle_timeout` is wanted next.
    fn poll_timeout(&self) -> Option<HostTime>;

    /// The next frame to send, until `None`.
    fn poll_transmit(&mut self, now: HostTime) -> Option<Self::Frame>;

    /// The next reading, until `None`.
    fn poll_reading(&mut self) -> Option<Self::Reading>;
}

/// Keeps count of what was delivered and what was not.
pub trait Counted {
    /// What was counted since the driver was made. A restart of the device does not reset it.
    fn counts(&self) -> Counts;
}
