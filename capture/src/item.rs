//! What travels from the link threads to the sinks.

use ft_drivers::reading::{DeviceEvent, PoseReading, WidthReading, WrenchReading};
use ft_drivers::translate::ClockStatus;
use ft_recording::message::DiagnosticArray;
use ft_wire::HostTime;

/// One thing to record and to publish. Everything that comes at the rate of a sensor is held in place, without heap.
#[derive(Clone, Debug)]
pub struct Item {
    /// Position of the device in the configuration; `None` for what the operator or the service itself says.
    pub device: Option<usize>,
    /// Earliest host stamp; the recording's `log_time`.
    pub arrival: HostTime,
    /// How often the device's clock had begun anew, or the period of its counts become another, by then.
    pub clock_epoch: u32,
    /// When it was true, on the host clock, never later than `arrival`; the recording's `publish_time`.
    pub sample_time: HostTime,
    /// What it is.
    pub body: Body,
}

/// The kinds of things.
#[derive(Clone, Debug)]
#[allow(
    clippy::large_enum_variant,
    reason = "held in preallocated queues: a box would allocate per frame"
)]
pub enum Body {
    /// A frame of the link as it came.
    Raw(RawBytes),
    /// A force-torque sample.
    Wrench(WrenchReading),
    /// A gripper width.
    Width(WidthReading),
    /// A tracker's pose.
    Pose(PoseReading),
    /// The device's state changed.
    Event(DeviceEvent),
    /// Where the device's clock stands against the host's.
    Clock(ClockStatus),
    /// An operator's mark.
    Mark(String),
    /// What `/diagnostics` says.
    Diagnostics(Box<DiagnosticArray>),
}

/// At most [`RawBytes::CAPACITY`] bytes in place.
#[derive(Clone, Copy)]
pub struct RawBytes {
    bytes: [u8; Self::CAPACITY],
    len: usize,
}

impl RawBytes {
    /// The longest frame of any link.
    pub const CAPACITY: usize = ft_wire::Chunk::CAPACITY;

    /// The bytes in place, or `None` when they are more than fit.
    #[must_use]
    pub fn new(from: &[u8]) -> Option<Self> {
        let mut bytes = [0; Self::CAPACITY];
        bytes.get_mut(..from.len())?.copy_from_slice(from);
        Some(Self {
            bytes,
            len: from.len(),
        })
    }

    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

impl std::fmt::Debug for RawBytes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("RawBytes").field(&self.as_slice()).finish()
    }
}
