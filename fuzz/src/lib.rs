//! What the fuzz targets share.
#![forbid(unsafe_code)]
#![warn(missing_docs)]

use ft_wire::{CanFrame, DecodeError, Parsed};

/// Asserts that a decoder used at least one byte and no more than there were.
///
/// # Panics
/// It did not.
pub fn whole<T>(parsed: Result<Parsed<T>, DecodeError>, data: &[u8]) {
    if let Ok(Parsed::Complete { used, .. }) = parsed {
        assert!((1..=data.len()).contains(&used), "{used} of {}", data.len());
    }
}

/// A base and a frame from bytes: base, two bytes of id, up to eight of payload.
#[must_use]
pub fn can(data: &[u8]) -> Option<(u8, CanFrame)> {
    let (&[base, high, low], payload) = data.split_first_chunk()?;
    let id = u16::from_be_bytes([high, low]) & 0x7FF;
    Some((
        base,
        CanFrame::standard(id, payload.get(..8).unwrap_or(payload))?,
    ))
}
