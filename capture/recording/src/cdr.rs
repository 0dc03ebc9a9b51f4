//! XCDR1 in and out, as ROS 2 writes it.
//!
//! ```text
//! 00 01 00 00   representation CDR_LE, options (00 00 00 00 is CDR_BE, which is read too)
//! body          little endian, every primitive aligned to its size, counted from byte 4
//!               string: u32 length with the NUL, bytes, NUL; sequence: u32 count, elements
//! ```
//!
//! # Source
//! OMG DDS-XTYPES 1.3, 7.4.1 (PLAIN_CDR) and 10.5 of RTPS 2.3 (encapsulation); confirmed with rosbags 0.11.9.

use thiserror::Error;

/// Bytes that are no message of the asked type. The message is left out and counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum CdrError {
    /// The first two bytes name a representation that is not plain CDR.
    #[error("representation {got:#06x} is not plain CDR (0x0000 or 0x0001)")]
    Representation {
        /// The two bytes, big endian.
        got: u16,
    },
    /// The message ends before a field does.
    #[error("{field} needs {needed} bytes at offset {offset}, the message has {length}")]
    Truncated {
        /// What was being read.
        field: &'static str,
        /// Where, counted from the first byte of the message.
        offset: usize,
        /// Bytes needed there.
        needed: usize,
        /// Bytes of the whole message.
        length: usize,
    },
    /// A string is not UTF-8, or does not end in its only NUL.
    #[error("string at offset {offset} is not NUL-terminated UTF-8")]
    Text {
        /// Where the string's bytes begin.
        offset: usize,
    },
    /// More than alignment padding follows the last field, so this is another type.
    #[error("{extra} bytes follow the last field, which ends at {offset}")]
    Trailing {
        /// Where the last field ends.
        offset: usize,
        /// Bytes after it.
        extra: usize,
    },
}

/// The most padding that may follow the last field.
const MAX_PADDING: usize = 7;
const HEADER_LENGTH: usize = 4;

/// Writes fields in order into a buffer.
#[derive(Debug)]
pub(crate) struct Encoder<'a> {
    out: &'a mut Vec<u8>,
}

impl<'a> Encoder<'a> {
    /// Clears `out` and writes the encapsulation header.
    pub(crate) fn new(out: &'a mut Vec<u8>) -> Self {
        out.clear();
        out.extend_from_slice(&[0, 1, 0, 0]);
        Self { out }
    }

    fn align(&mut self, alignment: usize) {
        let body = self.out.len() - HEADER_LENGTH;
        self.out
            .resize(HEADER_LENGTH + body.next_multiple_of(alignment), 0);
    }

    pub(crate) fn u8(&mut self, value: u8) {
        self.out.push(value);
    }

    pub(crate) fn i32(&mut self, value: i32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn f32(&mut self, value: f32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn bool(&mut self, value: bool) {
        self.out.push(u8::from(value));
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.align(8);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// A length or count; what does not fit in 32 bits is cut off by [`Self::text`] and by nothing else, because no
    /// memory holds such a sequence of these messages.
    pub(crate) fn count(&mut self, value: usize) {
        self.u32(u32::try_from(value).unwrap_or(u32::MAX));
    }

    /// Writes a string up to its first NUL, which CDR cannot carry.
    pub(crate) fn text(&mut self, value: &str) {
        let bytes = value.split('\0').next().unwrap_or_default().as_bytes();
        self.count(bytes.len() + 1);
        self.out.extend_from_slice(bytes);
        self.out.push(0);
    }
}

#[derive(Clone, Copy, Debug)]
enum Endian {
    Little,
    Big,
}

/// Reads fields in order; every read is bounds-checked and nothing is allocated by a length before its bytes are there.
#[derive(Debug)]
pub(crate) struct Decoder<'a> {
    bytes: &'a [u8],
    at: usize,
    endian: Endian,
}

impl<'a> Decoder<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let Some(&[high, low, _, _]) = bytes.first_chunk::<HEADER_LENGTH>() else {
            return Err(CdrError::Truncated {
                field: "encapsulation",
                offset: 0,
                needed: HEADER_LENGTH,
                length: bytes.len(),
            });
        };
        let endian = match [high, low] {
            [0, 1] => Endian::Little,
            [0, 0] => Endian::Big,
            other => {
                return Err(CdrError::Representation {
                    got: u16::from_be_bytes(other),
                });
            }
        };
        Ok(Self {
            bytes,
            at: HEADER_LENGTH,
            endian,
        })
    }

    /// Bytes not yet read.
    pub(crate) fn remaining(&self) -> usize {
        self.bytes.len().saturating_sub(self.at)
    }

    pub(crate) fn finish(self) -> Result<(), CdrError> {
        match self.remaining() {
            extra if extra > MAX_PADDING => Err(CdrError::Trailing {
                offset: self.at,
                extra,
            }),
            _ => Ok(()),
        }
    }

    fn take(&mut self, field: &'static str, needed: usize) -> Result<&'a [u8], CdrError> {
        let taken = self
            .at
            .checked_add(needed)
            .and_then(|end| self.bytes.get(self.at..end));
        let taken = taken.ok_or(CdrError::Truncated {
            field,
            offset: self.at,
            needed,
            length: self.bytes.len(),
        })?;
        self.at += needed;
        Ok(taken)
    }

    fn aligned<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], CdrError> {
        let body = self.at - HEADER_LENGTH;
        self.take(field, body.next_multiple_of(N) - body)?;
        let mut value = [0; N];
        value.copy_from_slice(self.take(field, N)?);
        Ok(value)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, CdrError> {
        self.aligned("u8").map(|[byte]| byte)
    }

    pub(crate) fn i32(&mut self) -> Result<i32, CdrError> {
        let bytes = self.aligned("i32")?;
        Ok(match self.endian {
            Endian::Little => i32::from_le_bytes(bytes),
            Endian::Big => i32::from_be_bytes(bytes),
        })
    }

    pub(crate) fn u32(&mut self) -> Result<u32, CdrError> {
        let bytes = self.aligned("u32")?;
        Ok(match self.endian {
            Endian::Little => u32::from_le_bytes(bytes),
            Endian::Big => u32::from_be_bytes(bytes),
        })
    }

    pub(crate) fn f32(&mut self) -> Result<f32, CdrError> {
        let bytes = self.aligned("f32")?;
        Ok(match self.endian {
            Endian::Little => f32::from_le_bytes(bytes),
            Endian::Big => f32::from_be_bytes(bytes),
        })
    }

    pub(crate) fn bool(&mut self) -> Result<bool, CdrError> {
        self.aligned("bool").map(|[byte]| byte != 0)
    }

    pub(crate) fn f64(&mut self) -> Result<f64, CdrError> {
        let bytes = self.aligned("f64")?;
        Ok(match self.endian {
            Endian::Little => f64::from_le_bytes(bytes),
            Endian::Big => f64::from_be_bytes(bytes),
        })
    }

    pub(crate) fn text(&mut self) -> Result<String, CdrError> {
        let length = usize::try_from(self.u32()?).unwrap_or(usize::MAX);
        let offset = self.at;
        let bytes = self.take("string", length)?;
        // Some writers give an empty string as length 0, without its NUL.
        let text = match bytes.split_last() {
            None => &[],
            Some((0, text)) if !text.contains(&0) => text,
            Some(_) => return Err(CdrError::Text { offset }),
        };
        std::str::from_utf8(text)
            .map(str::to_owned)
            .map_err(|_| CdrError::Text { offset })
    }

    /// A sequence whose elements take at least one byte each.
    pub(crate) fn sequence<T>(
        &mut self,
        mut element: impl FnMut(&mut Self) -> Result<T, CdrError>,
    ) -> Result<Vec<T>, CdrError> {
        let count = usize::try_from(self.u32()?).unwrap_or(usize::MAX);
        if count > self.remaining() {
            return Err(CdrError::Truncated {
                field: "sequence",
                offset: self.at,
                needed: count,
                length: self.bytes.len(),
            });
        }
        let mut elements = Vec::new();
        for _ in 0..count {
            elements.push(element(self)?);
        }
        Ok(elements)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alignment_counts_from_the_fourth_byte() {
        let mut out = vec![9; 3];
        let mut encoder = Encoder::new(&mut out);
        encoder.u8(7);
        encoder.f64(1.0);
        assert_eq!(
            out,
            [
                &[0, 1, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0][..],
                &1.0_f64.to_le_bytes()
            ]
            .concat()
        );
    }

    #[test]
    fn big_endian_is_read() {
        let mut decoder = Decoder::new(&[0, 0, 0, 0, 0, 0, 0, 2, b'a', 0]).unwrap();
        assert_eq!(decoder.text().unwrap(), "a");
        decoder.finish().unwrap();
    }

    #[test]
    fn other_representations_are_named() {
        assert_eq!(
            Decoder::new(&[0, 3, 0, 0]).unwrap_err(),
            CdrError::Representation { got: 3 }
        );
        assert_eq!(
            Decoder::new(&[0, 3, 0, 0]).unwrap_err().to_string(),
            "representation 0x0003 is not plain CDR (0x0000 or 0x0001)"
        );
    }

    #[test]
    fn a_huge_count_is_refused_before_anything_is_allocated() {
        let mut decoder = Decoder::new(&[0, 1, 0, 0, 255, 255, 255, 255, 0]).unwrap();
        assert!(matches!(
            decoder.sequence(Decoder::u8),
            Err(CdrError::Truncated {
                field: "sequence",
                needed: 0xffff_ffff,
                ..
            })
        ));
    }

    #[test]
    fn text_with_a_nul_inside_or_none_at_the_end_is_refused() {
        for body in [*b"a\0\0", *b"abc", [0xff, 0xff, 0]] {
            let bytes = [&[0, 1, 0, 0, 3, 0, 0, 0][..], &body].concat();
            assert_eq!(
                Decoder::new(&bytes).unwrap().text(),
                Err(CdrError::Text { offset: 8 })
            );
        }
    }

    #[test]
    fn text_is_written_up_to_its_first_nul() {
        let mut out = Vec::new();
        Encoder::new(&mut out).text("ab\0cd");
        assert_eq!(out, [0, 1, 0, 0, 3, 0, 0, 0, b'a', b'b', 0]);
    }

    #[test]
    fn padding_may_follow_but_another_field_may_not() {
        let mut decoder = Decoder::new(&[0, 1, 0, 0, 0, 0, 0, 0]).unwrap();
        decoder.u8().unwrap();
        decoder.finish().unwrap();
        assert_eq!(
            Decoder::new(&[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
                .unwrap()
                .finish(),
            Err(CdrError::Trailing {
                offset: 4,
                extra: 8
            })
        );
    }
}
