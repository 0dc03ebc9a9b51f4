//! What every codec's tests assert alike.

use core::fmt::Debug;

use crate::{DecodeError, Parsed};

/// Bytes of a string of hexadecimal pairs.
pub(crate) fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace()
        .map(|pair| u8::from_str_radix(pair, 16).unwrap())
        .collect()
}

pub(crate) fn assert_prefixes_incomplete<T: Debug + PartialEq>(
    frame: &[u8],
    decode: impl Fn(&[u8]) -> Result<Parsed<T>, DecodeError>,
) {
    for len in 0..frame.len() {
        assert_eq!(
            decode(&frame[..len]),
            Ok(Parsed::Incomplete),
            "prefix of {len}"
        );
    }
}

pub(crate) fn assert_flipped_bits_refused<T: Debug>(
    frame: &[u8],
    decode: impl Fn(&[u8]) -> Result<Parsed<T>, DecodeError>,
) {
    for bit in 0..frame.len() * 8 {
        let mut flipped = frame.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        // A flipped length may also ask for more bytes; what must never come is a value.
        assert!(
            !matches!(decode(&flipped), Ok(Parsed::Complete { .. })),
            "bit {bit}"
        );
    }
}
