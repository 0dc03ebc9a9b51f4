//! What drivers deliver, the same for every device of a kind.

use ft_wire::HostTime;
use ft_wire::frames::{AriaDevice, FtSensor, Pose, World, Wrench};

/// One thing that a device said.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Reading {
    /// A force-torque sample.
    Wrench(WrenchReading),
    /// A gripper encoder's sample.
    Width(WidthReading),
    /// A tracker's pose.
    Pose(PoseReading),
    /// So many samples were taken between the one before and the next, and will not come: refused, or shown missing by what came.
    /// Only of devices whose number of samples is their clock.
    Missing {
        /// How many.
        samples: u64,
    },
    /// The device's state changed.
    Event {
        /// When.
        at: HostTime,
        /// How.
        event: DeviceEvent,
    },
}

/// When a sample was taken, as far as the device and the host can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleInstant {
    /// Earliest host stamp of the frame's last byte.
    pub arrival: HostTime,
    /// The device's own clock, unwrapped, ns; `None` when the device has no clock or sends no stamp.
    pub device_ns: Option<i64>,
}

/// A force-torque sample in SI, environment on tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WrenchReading {
    /// When.
    pub at: SampleInstant,
    /// The wrench at the origin and in the axes of the sensor; not tared, not compensated.
    pub wrench: Wrench<FtSensor>,
    /// Sensor temperature, deg C.
    pub temperature_celsius: Option<f32>,
    /// How far to trust it.
    pub quality: Quality,
    /// The status word as the device sent it.
    pub status_bits: u32,
}

/// How far to trust a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Quality {
    /// In order.
    Good,
    /// A component is beyond its rated range: the value may be clipped.
    Overrange,
    /// The device itself calls the value wrong (saturated, short or open gauge, uncalibrated).
    Invalid,
}

/// A gripper encoder's sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WidthReading {
    /// When.
    pub at: SampleInstant,
    /// Jaw opening, m.
    pub width_m: f64,
    /// Rate of the jaw opening, m/s.
    pub width_rate_m_s: f64,
    /// Raw counts as the encoder sent them.
    pub counts: i32,
}

/// A tracker's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseReading {
    /// When.
    pub at: SampleInstant,
    /// `world_from_aria_device`.
    pub pose: Pose<World, AriaDevice>,
    /// The tracker's own quality score, 0 to 1.
    pub quality_score: f32,
}

/// A change in what a device does.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DeviceEvent {
    /// Set-up began: stopping what may still stream, draining, asking who is there.
    Starting,
    /// The device said who it is.
    Identified(Identity),
    /// The device said what its numbers mean: each with its unit in the name.
    Scale(Vec<(&'static str, String)>),
    /// The port could not be opened yet; that is tried on.
    Closed {
        /// Why, and what to check.
        reason: String,
    },
    /// Samples flow.
    Streaming,
    /// Samples stopped, or set-up got no answer. The text says what was awaited and what to check.
    Lost {
        /// What was awaited, for how long, and what to check.
        reason: String,
    },
    /// Something that the operator must know, such as a model and a scale that disagree.
    Warning {
        /// What, with both values where two disagree.
        text: String,
    },
}

/// Who a device says it is; empty where it does not say.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Maker's model name.
    pub model: String,
    /// Serial number.
    pub serial_number: String,
    /// Firmware version.
    pub firmware: String,
}

/// What a driver counted since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Samples delivered.
    pub received: u64,
    /// Samples that the device's own counter or clock shows as missing.
    pub gaps: u64,
    /// Frames refused as malformed.
    pub refused: u64,
    /// Samples delivered twice by the device or the bus, and dropped.
    pub duplicated: u64,
    /// Bytes or frames that belong to no known frame, skipped while searching.
    pub skipped: u64,
    /// Frames for which the kernel or the adapter had no room ([`crate::Link::overflows`]); at least so many.
    pub overflows: u64,
}

impl std::ops::Add for Counts {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self {
            received: self.received + other.received,
            gaps: self.gaps + other.gaps,
            refused: self.refused + other.refused,
            duplicated: self.duplicated + other.duplicated,
            skipped: self.skipped + other.skipped,
            overflows: self.overflows + other.overflows,
        }
    }
}
