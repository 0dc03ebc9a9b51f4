//! Our own line format for an encoder behind a microcontroller (AS5600, AS5048, quadrature ...).
//!
//! ```text
//! $ENC,<time>,<counts>*<check>\r\n        $ENC,1000000,2048*77
//! ```
//!
//! Plain ASCII, at most [`MAX_LEN`] bytes, sent at a steady rate without being asked. `time`: the firmware's microseconds when the
//! encoder was read, u32 decimal, wraps (Arduino's `micros()`). `counts`: i32 decimal, what the encoder showed. `check`: two
//! upper-case hexadecimal digits, exclusive or of all bytes between `$` and `*`. The `\r` may be missing. No other sign of plus,
//! space or leading zero is allowed, so that every sample has one spelling.
//!
//! In C: `int n = snprintf(s, sizeof s, "ENC,%lu,%ld", micros(), counts); uint8_t x = 0; for (int i = 0; i < n; i++) x ^= s[i];
//! printf("$%s*%02X\r\n", s, x);`
//!
//! **What the check cannot promise**: any one flipped bit and any one byte left out are refused (but for the `\r`); two flips of the
//! same bit in two bytes, and two equal characters left out, are not seen.
//!
//! # Source
//! This page is the definition; the check is that of NMEA 0183 sentences.

use crate::error::DecodeError;
use crate::stream::{Chunk, Parsed};

/// Length of the longest line, bytes.
pub const MAX_LEN: usize = 32;

const HEAD: &[u8] = b"$ENC,";

/// One reading of the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The firmware's clock, us; wraps at 2^32.
    pub time_us: u32,
    /// What the encoder showed.
    pub counts: i32,
}

/// Reads the line at the start of `bytes`.
///
/// # Errors
/// It is no such line, or its check is wrong.
pub fn decode(bytes: &[u8]) -> Result<Parsed<Sample>, DecodeError> {
    let begun = bytes.len().min(HEAD.len());
    if bytes.get(..begun) != HEAD.get(..begun) {
        return Err(DecodeError::Field {
            name: "start of line",
            value: bytes.first().copied().unwrap_or_default().into(),
        });
    }
    let Some(end) = bytes.iter().take(MAX_LEN).position(|byte| *byte == b'\n') else {
        return if bytes.len() < MAX_LEN {
            Ok(Parsed::Incomplete)
        } else {
            Err(DecodeError::Length {
                expected: MAX_LEN,
                got: bytes.len(),
            })
        };
    };
    let line = bytes.get(..end).unwrap_or_default();
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    Ok(Parsed::Complete {
        value: sample(line)?,
        used: end + 1,
    })
}

const fn wrong(name: &'static str) -> DecodeError {
    DecodeError::Field { name, value: 0 }
}

fn sample(line: &[u8]) -> Result<Sample, DecodeError> {
    let content = line.get(1..).unwrap_or_default();
    let star = content.iter().position(|byte| *byte == b'*');
    let Some((content, [_, high, low])) =
        star.and_then(|at| Some((content.get(..at)?, content.get(at..)?)))
    else {
        return Err(wrong("check"));
    };
    let (Some(high), Some(low)) = (hex_digit(*high), hex_digit(*low)) else {
        return Err(wrong("check"));
    };
    let computed = check(content);
    let carried = high << 4 | low;
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    let mut fields = content.split(|byte| *byte == b',').skip(1);
    let (Some(time), Some(counts), None) = (fields.next(), fields.next(), fields.next()) else {
        return Err(wrong("number of fields"));
    };
    let time_us = number(time, 0).ok_or(wrong("time"))?;
    let counts = number(counts, i32::MIN.into()).ok_or(wrong("counts"))?;
    Ok(Sample {
        time_us: u32::try_from(time_us).map_err(|_| wrong("time"))?,
        counts: i32::try_from(counts).map_err(|_| wrong("counts"))?,
    })
}

/// A decimal number in its one spelling, not below `least`.
fn number(text: &[u8], least: i64) -> Option<i64> {
    let (negative, digits) = match text {
        [b'-', digits @ ..] => (true, digits),
        digits => (false, digits),
    };
    let plain = match digits {
        [] => false,
        [b'0'] => !negative,
        [first, ..] => *first != b'0' && digits.len() <= 10,
    };
    if !plain {
        return None;
    }
    let mut value = 0_i64;
    for digit in digits {
        if !digit.is_ascii_digit() {
            return None;
        }
        value = value * 10 + i64::from(digit - b'0');
    }
    let value = if negative { -value } else { value };
    (value >= least).then_some(value)
}

const fn hex_digit(byte: u8) -> Option<u8> {
    match byte {
        b'0'..=b'9' => Some(byte - b'0'),
        b'A'..=b'F' => Some(byte - b'A' + 10),
        _ => None,
    }
}

fn check(content: &[u8]) -> u8 {
    content.iter().fold(0, |check, byte| check ^ byte)
}

/// Writes a line. Allocates: for firmware in tests and simulations, not for a stream.
#[must_use]
pub fn encode(sample: &Sample) -> Chunk {
    let content = format!("ENC,{},{}", sample.time_us, sample.counts);
    let line = format!("${content}*{:02X}\r\n", check(content.as_bytes()));
    Chunk::take_from(line.as_bytes()).0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::{assert_flipped_bits_refused, assert_prefixes_incomplete};

    const GOLDEN: [(&[u8], Sample); 3] = [
        (
            b"$ENC,1000000,2048*77\r\n",
            Sample {
                time_us: 1_000_000,
                counts: 2048,
            },
        ),
        (
            b"$ENC,0,0*48\r\n",
            Sample {
                time_us: 0,
                counts: 0,
            },
        ),
        (
            b"$ENC,4294967295,-2147483648*6D\r\n",
            Sample {
                time_us: u32::MAX,
                counts: i32::MIN,
            },
        ),
    ];

    #[test]
    fn golden_lines_decode_and_encode() {
        for (bytes, value) in GOLDEN {
            let used = bytes.len();
            assert_eq!(decode(bytes), Ok(Parsed::Complete { value, used }));
            assert_eq!(encode(&value).as_slice(), bytes);
        }
        assert_eq!(GOLDEN[2].0.len(), MAX_LEN);
    }

    #[test]
    fn the_return_may_be_missing() {
        let line = b"$ENC,0,0*48\n";
        assert!(matches!(
            decode(line),
            Ok(Parsed::Complete { used: 12, .. })
        ));
    }

    #[test]
    fn every_prefix_is_incomplete() {
        for (bytes, _) in GOLDEN {
            assert_prefixes_incomplete(bytes, decode);
        }
    }

    #[test]
    fn every_flipped_bit_of_what_is_checked_is_refused() {
        for (bytes, _) in GOLDEN {
            // The line's end is not checked: a flipped return makes a bad check, a flipped newline a longer line.
            let checked = &bytes[..bytes.len() - 2];
            for bit in 0..checked.len() * 8 {
                let mut flipped = bytes.to_vec();
                flipped[bit / 8] ^= 1 << (bit % 8);
                assert!(
                    !matches!(decode(&flipped), Ok(Parsed::Complete { .. })),
                    "bit {bit}"
                );
            }
        }
        assert_flipped_bits_refused(b"$ENC,0,0*48\n", decode);
    }

    #[test]
    fn a_sample_has_one_spelling() {
        for content in [
            "ENC,+1,2",
            "ENC,01,2",
            "ENC,1,-0",
            "ENC,1,2,3",
            "ENC,1",
            "ENC,,2",
            "ENC, 1,2",
            "ENC,-1,2",
            "ENC,4294967296,2",
            "ENC,1,2147483648",
        ] {
            let line = format!("${content}*{:02X}\n", check(content.as_bytes()));
            assert!(
                matches!(decode(line.as_bytes()), Err(DecodeError::Field { .. })),
                "{line}"
            );
        }
        assert!(
            decode(b"$ENC,4294967295,-2147483648*6d\r\n").is_err(),
            "upper case only"
        );
        assert!(
            decode(&[&b"$ENC,"[..], &[b'1'; 40]].concat()).is_err(),
            "too long"
        );
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..50)) {
            let _ = decode(&bytes);
            let _ = decode(&[HEAD, &bytes].concat());
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(time_us: u32, counts: i32) {
            let value = Sample { time_us, counts };
            let bytes = encode(&value);
            let used = bytes.as_slice().len();
            prop_assert_eq!(decode(bytes.as_slice()), Ok(Parsed::Complete { value, used }));
        }
    }
}
