//! Axes of USB HID devices: joysticks, dials, sliders and wheels as encoders.
//!
//! A device describes its reports in a descriptor of items: one byte of size (bits 0-1: 0, 1, 2 or 4 bytes), type (bits 2-3) and tag
//! (bits 4-7), then the data, little endian. [`axes`] reads it once and finds the axes of the Generic Desktop page; [`Axis::read`] takes
//! an axis out of each report.
//!
//! | item | byte (without size) | item | byte |
//! |---|---|---|---|
//! | Usage Page | 04 | Report Size, bits | 74 |
//! | Logical Minimum, Maximum | 14, 24 | Report ID | 84 |
//! | Physical Minimum, Maximum | 34, 44 | Report Count | 94 |
//! | Unit Exponent, Unit | 54, 64 | Push, Pop | A4, B4 |
//! | Usage, Usage Minimum, Maximum | 08, 18, 28 | Input, Output, Feature | 80, 90, B0 |
//! | Collection, End | A0, C0 | long item | FE |
//!
//! # Source
//! hardware.md 3.6: Device Class Definition for HID 1.11, 6.2.2; descriptors of `NicoHood/HID` and `MHeironimus/ArduinoJoystickLibrary`
//! [A]. Item numbers that these do not use are from memory of the class definition [B].

mod parse;

pub use parse::axes;

use crate::error::DecodeError;

/// Longest report that is read here, bytes: that of a full-speed interrupt endpoint.
pub const MAX_REPORT: usize = 64;
/// Longest descriptor that Linux hands out, bytes.
pub const MAX_DESCRIPTOR: usize = 4096;

/// One report as the device sent it, its id byte first when it has one; no heap.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Report {
    bytes: [u8; MAX_REPORT],
    len: usize,
}

impl Report {
    /// A report of these bytes, or `None` when they are more than [`MAX_REPORT`].
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut report = Self {
            bytes: [0; MAX_REPORT],
            len: bytes.len(),
        };
        report.bytes.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(report)
    }

    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

impl core::fmt::Debug for Report {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("Report").field(&self.as_slice()).finish()
    }
}

/// Usages of the Generic Desktop page that are axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Usage {
    /// 30.
    X = 0x30,
    /// 31.
    Y,
    /// 32.
    Z,
    /// 33.
    Rx,
    /// 34.
    Ry,
    /// 35.
    Rz,
    /// 36.
    Slider,
    /// 37.
    Dial,
    /// 38.
    Wheel,
}

impl Usage {
    /// All, by number.
    pub const ALL: [Self; 9] = [
        Self::X,
        Self::Y,
        Self::Z,
        Self::Rx,
        Self::Ry,
        Self::Rz,
        Self::Slider,
        Self::Dial,
        Self::Wheel,
    ];

    /// Lower-case name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::Rx => "rx",
            Self::Ry => "ry",
            Self::Rz => "rz",
            Self::Slider => "slider",
            Self::Dial => "dial",
            Self::Wheel => "wheel",
        }
    }

    /// The usage of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|usage| usage.name() == name)
    }
}

/// What a number of an axis means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motion {
    /// A position.
    Absolute,
    /// A step since the report before.
    Relative,
}

/// An axis, as the descriptor tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Which axis.
    pub usage: Usage,
    /// First byte of its reports, when the device numbers them.
    pub report_id: Option<u8>,
    /// Length of its reports with the id byte, bytes.
    pub report_len: usize,
    /// First bit, counted from the end of the id byte.
    pub bit: usize,
    /// Size, 1 to 32 bits.
    pub bits: u32,
    /// Smallest and largest number; others mean that there is no value.
    pub logical: (i32, i32),
    /// What these stand for, in the unit; equal to `logical` when the descriptor does not say.
    pub physical: (i32, i32),
    /// Power of ten of the unit.
    pub exponent: i8,
    /// Unit: low nibble the system, then length, mass, time ... by powers. 0x14 is degrees, 0x12 radians, 0x11 centimetres.
    pub unit: u32,
    /// What a number means.
    pub motion: Motion,
}

/// Unit of an angle in degrees.
const DEGREES: u32 = 0x14;
/// Unit of an angle in radians.
const RADIANS: u32 = 0x12;

impl Axis {
    /// The number of this axis in a report, or `None` when the report is another one or the number means that there is no value.
    ///
    /// # Errors
    /// The report has this axis's id and another length than the descriptor says.
    pub fn read(&self, report: &[u8]) -> Result<Option<i32>, DecodeError> {
        let data = match (self.report_id, report) {
            (Some(id), [first, data @ ..]) if *first == id => data,
            (Some(_), _) => return Ok(None),
            (None, data) => data,
        };
        if report.len() != self.report_len {
            return Err(DecodeError::Length {
                expected: self.report_len,
                got: report.len(),
            });
        }
        // At most 32 bits that begin in the middle of a byte: five bytes.
        let first = self.bit / 8;
        let mut raw = 0_u64;
        for (place, byte) in data.iter().skip(first).take(5).enumerate() {
            raw |= u64::from(*byte) << (8 * place);
        }
        let raw = (raw >> (self.bit % 8)) & ((1_u64 << self.bits) - 1);
        let sign = 1_u64 << (self.bits - 1);
        let value = if self.logical.0 < 0 && raw & sign != 0 {
            i64::try_from(raw).unwrap_or(0) - (1_i64 << self.bits)
        } else {
            i64::try_from(raw).unwrap_or(0)
        };
        let (least, most) = (i64::from(self.logical.0), i64::from(self.logical.1));
        Ok((least..=most)
            .contains(&value)
            .then(|| i32::try_from(value).ok())
            .flatten())
    }

    /// The angle of a count, rad, when the descriptor gives the axis a unit of angle.
    #[must_use]
    pub fn radians_per_count(&self) -> Option<f64> {
        let unit = match self.unit {
            DEGREES => 1_f64.to_radians(),
            RADIANS => 1.0,
            _ => return None,
        };
        let span = |(least, most): (i32, i32)| f64::from(most) - f64::from(least);
        let (logical, physical) = (span(self.logical), span(self.physical));
        (logical > 0.0 && physical != 0.0)
            .then(|| physical / logical * 10_f64.powi(self.exponent.into()) * unit)
    }
}

#[cfg(test)]
mod tests;
