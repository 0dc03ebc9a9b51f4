//! Leptrino CFS and PFS sensors on USB (CDC), protocol 1.13.
//!
//! Frame: `10 02` body `10 03` check. A 10 in the body is sent twice. Check = XOR of the body (before doubling) and 03. A sensor
//! that got a frame with a wrong check answers `10 15` alone. Numbers are **little endian**.
//!
//! | body | layout |
//! |---|---|
//! | command | length (of all of the body), FF, number, 00, data |
//! | response | length, FF, number, result, data; no data when the result is not 0 |
//!
//! | number | function | data of the response |
//! |---|---|---|
//! | 2A | product | 16 ASCII model, 8 ASCII serial number, 4 ASCII firmware |
//! | 2B | rated limits | 6 x f32: N, N m |
//! | 30 | one sample | 6 x i16 (10 000 = rated), 2 bytes undefined, status, 00 |
//! | 32 | start | none; then samples with the same number. **This answer is the very bytes of the command** |
//! | 33 | stop | none; samples may still come before it |
//!
//! **What the check cannot promise**: an XOR does not see two flips of the same bit in two bytes, nor bytes that change places.
//!
//! # Source
//! hardware.md 2.6: maker's protocol 1.13 in `hiveground-ros-package/leptrino_force_torque: doc/protocal.pdf` [A].

use core::fmt;

use crate::bytes::field;
use crate::error::DecodeError;
use crate::stream::{Chunk, Parsed};

const ESCAPE: u8 = 0x10;
const START: u8 = 0x02;
const END: u8 = 0x03;
const REFUSED: u8 = 0x15;
const FIXED: u8 = 0xFF;
/// Longest body read here, bytes: that of the product.
const MAX_BODY: usize = 0x20;
/// Length of the longest frame with every byte doubled, bytes.
pub const MAX_LEN: usize = 2 * MAX_BODY + 5;
/// Raw counts at the rated limit.
pub const COUNTS_AT_LIMIT: f64 = 10_000.0;

/// What the host can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// 2A.
    ReadProduct,
    /// 2B.
    ReadLimits,
    /// 30.
    ReadOnce,
    /// 32.
    Start,
    /// 33.
    Stop,
}

impl Command {
    const fn number(self) -> u8 {
        match self {
            Self::ReadProduct => 0x2A,
            Self::ReadLimits => 0x2B,
            Self::ReadOnce => 0x30,
            Self::Start => 0x32,
            Self::Stop => 0x33,
        }
    }
}

/// Status of a sample.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u8);

impl Status {
    /// The correction data in the sensor's ROM is bad.
    pub const BAD_CORRECTION: u8 = 1;
    /// The sensor is in trouble.
    pub const SENSOR_ERROR: u8 = 1 << 1;
    /// Beyond the rated load.
    pub const OVER_RATING: u8 = 1 << 2;

    /// Whether any of `bits` is set.
    #[must_use]
    pub const fn has(self, bits: u8) -> bool {
        self.0 & bits != 0
    }
}

impl fmt::Debug for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Status({:#04x})", self.0)
    }
}

/// One sample in raw counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Whether it is one of a stream.
    pub streamed: bool,
    /// Fx Fy Fz Mx My Mz; 10 000 = rated limit, clipped at 32 000.
    pub raw: [i16; 6],
    /// Status.
    pub status: Status,
}

/// What a sensor says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// The check of our frame was wrong: say it again.
    Refused,
    /// Who it is.
    Product {
        /// Model, ASCII.
        model: [u8; 16],
        /// Serial number, ASCII.
        serial_number: [u8; 8],
        /// Firmware, ASCII.
        firmware: [u8; 4],
    },
    /// Rated limits: Fx Fy Fz (N), Mx My Mz (N m); finite and positive.
    Limits([f32; 6]),
    /// A sample.
    Sample(Sample),
    /// A command was carried out (result 0) or not: 1 length, 2 undefined, 3 value, 4 state.
    Done {
        /// Number of the command.
        number: u8,
        /// Result.
        result: u8,
    },
}

/// The bytes of a frame's body.
struct Body {
    bytes: [u8; MAX_BODY],
    len: usize,
}

impl Body {
    fn push(&mut self, byte: u8) -> Result<(), DecodeError> {
        let Some(slot) = self.bytes.get_mut(self.len) else {
            return Err(DecodeError::Length {
                expected: MAX_BODY,
                got: self.len + 1,
            });
        };
        *slot = byte;
        self.len += 1;
        Ok(())
    }

    fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

/// Reads the message of a sensor at the start of `bytes`.
///
/// # Errors
/// Framing, check, length or content are wrong.
pub fn decode(bytes: &[u8]) -> Result<Parsed<Message>, DecodeError> {
    let mut body = Body {
        bytes: [0; MAX_BODY],
        len: 0,
    };
    let mut rest = bytes.iter().copied().enumerate();
    let mut next = || rest.next();
    match next() {
        None => return Ok(Parsed::Incomplete),
        Some((_, ESCAPE)) => {}
        Some((_, other)) => return Err(wrong("start of frame", other)),
    }
    match next() {
        None => return Ok(Parsed::Incomplete),
        Some((_, REFUSED)) => {
            return Ok(Parsed::Complete {
                value: Message::Refused,
                used: 2,
            });
        }
        Some((_, START)) => {}
        Some((_, other)) => return Err(wrong("start of frame", other)),
    }
    loop {
        let Some((_, byte)) = next() else {
            return Ok(Parsed::Incomplete);
        };
        if byte != ESCAPE {
            body.push(byte)?;
            continue;
        }
        match next() {
            None => return Ok(Parsed::Incomplete),
            Some((_, ESCAPE)) => body.push(ESCAPE)?,
            Some((_, END)) => break,
            Some((_, other)) => return Err(wrong("byte after 0x10", other)),
        }
    }
    let Some((at, carried)) = next() else {
        return Ok(Parsed::Incomplete);
    };
    let computed = check(body.as_slice());
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    Ok(Parsed::Complete {
        value: message(body.as_slice())?,
        used: at + 1,
    })
}

const fn wrong(name: &'static str, value: u8) -> DecodeError {
    DecodeError::Field {
        name,
        value: value as u32,
    }
}

fn check(body: &[u8]) -> u8 {
    body.iter().fold(END, |check, byte| check ^ byte)
}

fn message(body: &[u8]) -> Result<Message, DecodeError> {
    let Some([length, fixed, number, result]) = field(body, 0) else {
        return Err(DecodeError::Length {
            expected: 4,
            got: body.len(),
        });
    };
    if usize::from(length) != body.len() {
        return Err(DecodeError::Length {
            expected: length.into(),
            got: body.len(),
        });
    }
    if fixed != FIXED {
        return Err(wrong("second byte of the body", fixed));
    }
    let data = body.get(4..).unwrap_or_default();
    if data.is_empty() {
        return Ok(Message::Done { number, result });
    }
    let expected = match number {
        0x2A => 28,
        0x2B => 24,
        0x30 | 0x32 => 16,
        other => return Err(wrong("number", other)),
    };
    if data.len() != expected {
        return Err(DecodeError::Length {
            expected,
            got: data.len(),
        });
    }
    Ok(match number {
        0x2A => Message::Product {
            model: field(data, 0).unwrap_or_default(),
            serial_number: field(data, 16).unwrap_or_default(),
            firmware: field(data, 24).unwrap_or_default(),
        },
        0x2B => Message::Limits(limits(data)?),
        _ => Message::Sample(Sample {
            streamed: number == 0x32,
            raw: [0, 2, 4, 6, 8, 10]
                .map(|at| i16::from_le_bytes(field(data, at).unwrap_or_default())),
            status: Status(data.get(14).copied().unwrap_or_default()),
        }),
    })
}

fn limits(data: &[u8]) -> Result<[f32; 6], DecodeError> {
    let limits =
        [0, 4, 8, 12, 16, 20].map(|at| f32::from_le_bytes(field(data, at).unwrap_or_default()));
    for limit in limits {
        if !limit.is_finite() {
            return Err(DecodeError::NotFinite { name: "limit" });
        }
        if limit <= 0.0 {
            return Err(DecodeError::Field {
                name: "limit",
                value: limit.to_bits(),
            });
        }
    }
    Ok(limits)
}

/// Writes a command.
#[must_use]
pub fn encode_command(command: Command) -> Chunk {
    frame(command.number(), 0, &[])
}

/// Writes a message of a sensor.
#[must_use]
pub fn encode(message: &Message) -> Chunk {
    let mut data = Body {
        bytes: [0; MAX_BODY],
        len: 0,
    };
    let mut put = |field: &[u8]| {
        for byte in field {
            // Sixteen to 28 bytes fit.
            let _ = data.push(*byte);
        }
    };
    let (number, result) = match message {
        Message::Refused => return Chunk::take_from(&[ESCAPE, REFUSED]).0,
        Message::Product {
            model,
            serial_number,
            firmware,
        } => {
            put(model);
            put(serial_number);
            put(firmware);
            (0x2A, 0)
        }
        Message::Limits(limits) => {
            limits.iter().for_each(|limit| put(&limit.to_le_bytes()));
            (0x2B, 0)
        }
        Message::Sample(sample) => {
            sample.raw.iter().for_each(|raw| put(&raw.to_le_bytes()));
            put(&[0, 0, sample.status.0, 0]);
            (if sample.streamed { 0x32 } else { 0x30 }, 0)
        }
        Message::Done { number, result } => (*number, *result),
    };
    frame(number, result, data.as_slice())
}

fn frame(number: u8, result: u8, data: &[u8]) -> Chunk {
    let length = u8::try_from(data.len() + 4).unwrap_or(u8::MAX);
    let head = [length, FIXED, number, result];
    let mut out = [0; MAX_LEN];
    let mut slots = out.iter_mut();
    let mut len = 0;
    let mut put = |byte: u8| {
        if let Some(slot) = slots.next() {
            *slot = byte;
            len += 1;
        }
    };
    put(ESCAPE);
    put(START);
    for byte in head.iter().chain(data) {
        put(*byte);
        if *byte == ESCAPE {
            put(ESCAPE);
        }
    }
    put(ESCAPE);
    put(END);
    put(check(&head) ^ check(data) ^ END);
    Chunk::take_from(out.get(..len).unwrap_or_default()).0
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::{assert_flipped_bits_refused, assert_prefixes_incomplete, hex};

    // hardware.md 2.6, computed from the maker's protocol 1.13. The sample exercises the doubling of 10.
    const SAMPLE: &str =
        "10 02 14 FF 32 00 10 10 00 18 FC 10 10 10 10 00 00 88 13 F0 D8 00 00 00 00 10 03 9D";
    const LIMITS: &str = "10 02 1C FF 2B 00 00 00 FA 43 00 00 FA 43 00 00 7A 44 00 00 20 41 00 00 20 41 00 00 20 41 \
                          10 03 94";

    fn sample() -> Message {
        Message::Sample(Sample {
            streamed: true,
            raw: [16, -1000, 4112, 0, 5000, -10_000],
            status: Status(0),
        })
    }

    #[test]
    fn golden_commands_are_written() {
        for (bytes, command) in [
            ("10 02 04 FF 2A 00 10 03 D2", Command::ReadProduct),
            ("10 02 04 FF 2B 00 10 03 D3", Command::ReadLimits),
            ("10 02 04 FF 30 00 10 03 C8", Command::ReadOnce),
            ("10 02 04 FF 32 00 10 03 CA", Command::Start),
            ("10 02 04 FF 33 00 10 03 CB", Command::Stop),
        ] {
            assert_eq!(encode_command(command).as_slice(), hex(bytes));
        }
    }

    #[test]
    fn golden_messages_decode_and_encode() {
        for (bytes, message) in [
            (SAMPLE, sample()),
            (
                LIMITS,
                Message::Limits([500.0, 500.0, 1000.0, 10.0, 10.0, 10.0]),
            ),
            (
                "10 02 04 FF 32 00 10 03 CA",
                Message::Done {
                    number: 0x32,
                    result: 0,
                },
            ),
            ("10 15", Message::Refused),
        ] {
            let bytes = hex(bytes);
            let used = bytes.len();
            assert_eq!(
                decode(&bytes),
                Ok(Parsed::Complete {
                    value: message,
                    used
                })
            );
            assert_eq!(encode(&message).as_slice(), bytes);
        }
    }

    #[test]
    fn every_prefix_is_incomplete() {
        assert_prefixes_incomplete(&hex(SAMPLE), decode);
        assert_prefixes_incomplete(&hex(LIMITS), decode);
    }

    #[test]
    fn no_flipped_bit_gives_another_sample() {
        assert_flipped_bits_refused(&hex(LIMITS), decode);
        let bytes = hex(SAMPLE);
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            let decoded = decode(&flipped);
            assert!(
                !matches!(
                    decoded,
                    Ok(Parsed::Complete {
                        value: Message::Sample(_),
                        ..
                    })
                ),
                "bit {bit}: {decoded:?}"
            );
        }
    }

    #[test]
    fn each_broken_part_of_a_frame_is_named() {
        let field = |name, value| Err(DecodeError::Field { name, value });
        assert_eq!(decode(&[0x11]), field("start of frame", 0x11));
        assert_eq!(decode(&[0x10, 0x04]), field("start of frame", 4));
        assert_eq!(
            decode(&hex("10 02 04 FF 10 02")),
            field("byte after 0x10", 2)
        );
        assert_eq!(
            decode(&hex("10 02 04 FF 32 00 10 03 CB")),
            Err(DecodeError::Checksum {
                computed: 0xCA,
                carried: 0xCB
            })
        );
        assert_eq!(
            decode(&hex("10 02 05 FF 32 00 10 03 CB")),
            Err(DecodeError::Length {
                expected: 5,
                got: 4
            })
        );
        assert_eq!(
            decode(&hex("10 02 04 FE 32 00 10 03 CB")),
            field("second byte of the body", 0xFE)
        );
        let endless = [&[0x10, 0x02][..], &[0; 40]].concat();
        assert_eq!(
            decode(&endless),
            Err(DecodeError::Length {
                expected: MAX_BODY,
                got: MAX_BODY + 1
            })
        );
    }

    #[test]
    fn limits_that_cannot_be_are_refused() {
        let with = |limit| decode(encode(&Message::Limits([limit; 6])).as_slice());
        assert_eq!(
            with(f32::INFINITY),
            Err(DecodeError::NotFinite { name: "limit" })
        );
        assert_eq!(
            with(0.0),
            Err(DecodeError::Field {
                name: "limit",
                value: 0
            })
        );
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..90)) {
            let _ = decode(&bytes);
            let _ = decode(&[&[0x10, 0x02][..], &bytes].concat());
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(
            streamed: bool, raw: [i16; 6], status: u8, model: [u8; 16], serial_number: [u8; 8], firmware: [u8; 4],
            number: u8, result: u8,
        ) {
            let sample = Sample { streamed, raw, status: Status(status) };
            for message in [
                Message::Sample(sample),
                Message::Product { model, serial_number, firmware },
                Message::Done { number, result },
            ] {
                let bytes = encode(&message);
                let used = bytes.as_slice().len();
                prop_assert_eq!(decode(bytes.as_slice()), Ok(Parsed::Complete { value: message, used }));
            }
        }
    }
}
