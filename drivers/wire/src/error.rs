//! Why bytes were refused.

use core::fmt;

/// A frame that is not what the maker's document says. Counted, and the next one is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DecodeError {
    /// The payload has another length than the document gives.
    Length {
        /// Bytes that the document gives.
        expected: usize,
        /// Bytes that came.
        got: usize,
    },
    /// A field holds a value that the document does not allow.
    Field {
        /// The document's name of the field.
        name: &'static str,
        /// What it held.
        value: u32,
    },
    /// The check sum over the frame is wrong.
    Checksum {
        /// Computed from the bytes.
        computed: u32,
        /// Carried by the frame.
        carried: u32,
    },
    /// A number that must be finite is not.
    NotFinite {
        /// The document's name of the field.
        name: &'static str,
    },
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Length { expected, got } => write!(f, "expected {expected} bytes, got {got}"),
            Self::Field { name, value } => write!(f, "{name} is {value:#x}"),
            Self::Checksum { computed, carried } => {
                write!(f, "check sum computed {computed:#x}, carried {carried:#x}")
            }
            Self::NotFinite { name } => write!(f, "{name} is not finite"),
        }
    }
}

impl core::error::Error for DecodeError {}
