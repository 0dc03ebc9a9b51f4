//! Dynamixel protocol 2.0 (XL330, XL430, XM430): packets both ways, and the part of the control table that is used.
//!
//! 8N1, half duplex, little endian:
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | 4 x u8 | FF FF FD 00 |
//! | 4 | u8 | id |
//! | 5 | u16 | length: bytes from offset 7 to the end |
//! | 7 | u8 | instruction; 0x55 in a status packet |
//! | 8 | | status packet only: u8 error |
//! | 8 or 9 | bytes | parameters |
//! | end - 2 | u16 | CRC-16/UMTS over everything before it |
//!
//! Byte stuffing: after FF FF FD in instruction and parameters one FD is inserted; length and CRC count it.
//!
//! # Source
//! hardware.md 3.1: ROBOTIS e-manual, DynamixelSDK [A].

use crate::bytes::{Layout, field};
use crate::crc::DYNAMIXEL;
use crate::error::DecodeError;
use crate::stream::Parsed;

/// The most parameters that this codec carries; the protocol allows more, the devices here need 14.
pub const MAX_PARAMS: usize = 64;
/// Longest packet that this codec reads or writes, bytes, stuffing included.
pub const MAX_LEN: usize = HEAD + MAX_BODY + 2;
/// Instruction byte of a status packet.
pub const STATUS: u8 = 0x55;

/// Instruction codes.
pub mod instruction {
    /// Who is there: answered with model number (u16) and firmware (u8).
    pub const PING: u8 = 0x01;
    /// Read: address (u16), length (u16).
    pub const READ: u8 = 0x02;
    /// Write: address (u16), data.
    pub const WRITE: u8 = 0x03;
}

/// Addresses in the control table of XL330, XL430 and XM430.
pub mod address {
    /// Torque enable, u8; 0 for a passive encoder.
    pub const TORQUE_ENABLE: u16 = 64;
    /// Hardware error status, u8.
    pub const HARDWARE_ERROR: u16 = 70;
    /// Present current (i16), velocity (i32), position (i32) in one block.
    pub const PRESENT_STATE: u16 = 126;
}

/// Bytes of [`address::PRESENT_STATE`].
pub const PRESENT_STATE_LEN: u16 = 10;
/// Position counts per turn.
pub const COUNTS_PER_TURN: f64 = 4096.0;
/// Velocity unit, turns per minute.
pub const VELOCITY_UNIT_RPM: f64 = 0.229;
/// Current unit of XM430 and XL330-M288, A. XL430 reports a load instead.
pub const CURRENT_UNIT_A: f64 = 0.002_69;

const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
const HEAD: usize = 7;
const MAX_PLAIN: usize = MAX_PARAMS + 2;
const MAX_BODY: usize = MAX_PLAIN + MAX_PLAIN / 3;

/// Parameters of a packet, without heap.
#[derive(Clone, Copy)]
pub struct Params {
    bytes: [u8; MAX_PARAMS],
    len: usize,
}

impl Params {
    /// Parameters of `bytes`, or `None` when they are more than [`MAX_PARAMS`].
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let mut params = Self {
            bytes: [0; MAX_PARAMS],
            len: bytes.len(),
        };
        params.bytes.get_mut(..bytes.len())?.copy_from_slice(bytes);
        Some(params)
    }

    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

impl PartialEq for Params {
    fn eq(&self, other: &Self) -> bool {
        self.as_slice() == other.as_slice()
    }
}

impl Eq for Params {}

impl core::fmt::Debug for Params {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("Params").field(&self.as_slice()).finish()
    }
}

/// A packet, either way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packet {
    /// From the host. A half-duplex adapter without direction control hands it back as an echo.
    Instruction {
        /// Addressed device.
        id: u8,
        /// See [`instruction`].
        code: u8,
        /// Parameters.
        params: Params,
    },
    /// From a device.
    Status {
        /// Answering device.
        id: u8,
        /// How it went.
        error: StatusError,
        /// Parameters.
        params: Params,
    },
}

/// The error byte of a status packet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusError(pub u8);

impl StatusError {
    /// The device reports a hardware alert; [`address::HARDWARE_ERROR`] says which.
    #[must_use]
    pub const fn hardware_alert(self) -> bool {
        self.0 & 0x80 != 0
    }

    /// 0 none, 1 result fail, 2 instruction, 3 CRC, 4 data range, 5 length, 6 limit, 7 access.
    #[must_use]
    pub const fn code(self) -> u8 {
        self.0 & 0x7F
    }
}

impl Packet {
    /// A ping of device `id`.
    #[must_use]
    pub const fn ping(id: u8) -> Self {
        Self::Instruction {
            id,
            code: instruction::PING,
            params: Params {
                bytes: [0; MAX_PARAMS],
                len: 0,
            },
        }
    }

    /// A read of `len` bytes at `address`.
    #[must_use]
    pub fn read(id: u8, address: u16, len: u16) -> Self {
        let ([a0, a1], [l0, l1]) = (address.to_le_bytes(), len.to_le_bytes());
        let params = Params::new(&[a0, a1, l0, l1]);
        params.map_or(Self::ping(id), |params| Self::Instruction {
            id,
            code: instruction::READ,
            params,
        })
    }

    /// A write of `data` at `address`, or `None` when it is longer than fits.
    #[must_use]
    pub fn write(id: u8, address: u16, data: &[u8]) -> Option<Self> {
        let mut all = Layout::<MAX_PARAMS>::new();
        if data.len() + 2 > MAX_PARAMS {
            return None;
        }
        let params = Params::new(all.put(&address.to_le_bytes()).put(data).so_far())?;
        Some(Self::Instruction {
            id,
            code: instruction::WRITE,
            params,
        })
    }
}

/// A packet's bytes, without heap.
#[derive(Debug)]
pub struct PacketBytes(Layout<MAX_LEN>);

impl PacketBytes {
    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        self.0.so_far()
    }
}

/// Writes a packet, stuffed and with its CRC.
#[must_use]
pub fn encode(packet: &Packet) -> PacketBytes {
    let mut plain = Layout::<MAX_PLAIN>::new();
    let id = match packet {
        Packet::Instruction { id, code, params } => {
            plain.put(&[*code]).put(params.as_slice());
            *id
        }
        Packet::Status { id, error, params } => {
            plain.put(&[STATUS, error.0]).put(params.as_slice());
            *id
        }
    };
    let mut body = Layout::<MAX_BODY>::new();
    let mut last = [0; 3];
    for &byte in plain.so_far() {
        last = [last[1], last[2], byte];
        body.put(&[byte]);
        if last == [0xFF, 0xFF, 0xFD] {
            body.put(&[0xFD]);
        }
    }
    let length = u16::try_from(body.so_far().len() + 2).unwrap_or(u16::MAX);
    let mut out = Layout::<MAX_LEN>::new();
    out.put(&HEADER)
        .put(&[id])
        .put(&length.to_le_bytes())
        .put(body.so_far());
    let crc = DYNAMIXEL.checksum(out.so_far());
    out.put(&crc.to_le_bytes());
    PacketBytes(out)
}

/// Reads the packet at the start of `bytes`.
///
/// # Errors
/// The header is wrong, the length impossible or beyond [`MAX_LEN`], the CRC wrong, or the stuffing broken.
pub fn decode(bytes: &[u8]) -> Result<Parsed<Packet>, DecodeError> {
    for (byte, expected) in bytes.iter().zip(HEADER) {
        if *byte != expected {
            return Err(DecodeError::Field {
                name: "header",
                value: u32::from(*byte),
            });
        }
    }
    let (Some(&id), Some(length)) = (bytes.get(4), field(bytes, 5)) else {
        return Ok(Parsed::Incomplete);
    };
    let length = usize::from(u16::from_le_bytes(length));
    if !(3..=MAX_BODY + 2).contains(&length) {
        return Err(DecodeError::Length {
            expected: MAX_BODY + 2,
            got: length,
        });
    }
    let used = HEAD + length;
    let Some(frame) = bytes.get(..used) else {
        return Ok(Parsed::Incomplete);
    };
    let Some((checked, crc)) = frame.split_last_chunk::<2>() else {
        return Ok(Parsed::Incomplete);
    };
    let (computed, carried) = (DYNAMIXEL.checksum(checked), u16::from_le_bytes(*crc));
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    let plain = unstuff(checked.get(HEAD..).unwrap_or_default())?;
    Ok(Parsed::Complete {
        value: interpret(id, plain.so_far())?,
        used,
    })
}

fn unstuff(body: &[u8]) -> Result<Layout<MAX_BODY>, DecodeError> {
    let mut plain = Layout::new();
    let mut last = [0; 3];
    let mut bytes = body.iter();
    while let Some(&byte) = bytes.next() {
        last = [last[1], last[2], byte];
        plain.put(&[byte]);
        if last == [0xFF, 0xFF, 0xFD] {
            match bytes.next() {
                Some(0xFD) => {}
                other => {
                    let value = other.map_or(u32::MAX, |byte| u32::from(*byte));
                    return Err(DecodeError::Field {
                        name: "stuffing",
                        value,
                    });
                }
            }
        }
    }
    Ok(plain)
}

fn interpret(id: u8, plain: &[u8]) -> Result<Packet, DecodeError> {
    let too_many = |params: &[u8]| DecodeError::Length {
        expected: MAX_PARAMS,
        got: params.len(),
    };
    match plain {
        [STATUS, error, params @ ..] => {
            let params = Params::new(params).ok_or_else(|| too_many(params))?;
            Ok(Packet::Status {
                id,
                error: StatusError(*error),
                params,
            })
        }
        [code, params @ ..] if *code != STATUS => {
            let params = Params::new(params).ok_or_else(|| too_many(params))?;
            Ok(Packet::Instruction {
                id,
                code: *code,
                params,
            })
        }
        _ => Err(DecodeError::Length {
            expected: 2,
            got: plain.len(),
        }),
    }
}

/// What [`address::PRESENT_STATE`] holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PresentState {
    /// Present current, units of [`CURRENT_UNIT_A`] (a load on XL430).
    pub current: i16,
    /// Present velocity, units of [`VELOCITY_UNIT_RPM`].
    pub velocity: i32,
    /// Present position, [`COUNTS_PER_TURN`] per turn; counts on over several turns.
    pub position: i32,
}

impl PresentState {
    /// Reads the block.
    ///
    /// # Errors
    /// It has not 10 bytes.
    pub fn decode(params: &[u8]) -> Result<Self, DecodeError> {
        let Ok([c0, c1, v0, v1, v2, v3, p0, p1, p2, p3]) = <[u8; 10]>::try_from(params) else {
            return Err(DecodeError::Length {
                expected: 10,
                got: params.len(),
            });
        };
        Ok(Self {
            current: i16::from_le_bytes([c0, c1]),
            velocity: i32::from_le_bytes([v0, v1, v2, v3]),
            position: i32::from_le_bytes([p0, p1, p2, p3]),
        })
    }

    /// Writes the block.
    #[must_use]
    pub fn encode(&self) -> [u8; 10] {
        let mut block = Layout::<10>::new();
        block
            .put(&self.current.to_le_bytes())
            .put(&self.velocity.to_le_bytes());
        block.put(&self.position.to_le_bytes()).finish()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::{assert_flipped_bits_refused, assert_prefixes_incomplete, hex};

    // hardware.md 3.1: the first two from the maker's manual, the others computed.
    const READ_POSITION: &str = "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15";
    const REPLY_166: &str = "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0";
    const PING: &str = "FF FF FD 00 01 03 00 01 19 4E";
    const PING_REPLY: &str = "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D";
    const READ_STATE: &str = "FF FF FD 00 01 07 00 02 7E 00 0A 00 36 F9";
    const REPLY_STATE: &str = "FF FF FD 00 01 0E 00 55 00 9C FF 05 00 00 00 00 08 00 00 05 09";
    const TORQUE_OFF: &str = "FF FF FD 00 01 06 00 03 40 00 00 DE E6";
    const STUFFED: &str = "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7";

    fn status(params: &[u8]) -> Packet {
        Packet::Status {
            id: 1,
            error: StatusError(0),
            params: Params::new(params).unwrap(),
        }
    }

    #[test]
    fn golden_bytes_decode_and_encode() {
        let state = PresentState {
            current: -100,
            velocity: 5,
            position: 2048,
        };
        for (bytes, packet) in [
            (READ_POSITION, Packet::read(1, 132, 4)),
            (REPLY_166, status(&166_i32.to_le_bytes())),
            (PING, Packet::ping(1)),
            (PING_REPLY, status(&[0x06, 0x04, 0x26])),
            (
                READ_STATE,
                Packet::read(1, address::PRESENT_STATE, PRESENT_STATE_LEN),
            ),
            (REPLY_STATE, status(&state.encode())),
            (
                TORQUE_OFF,
                Packet::write(1, address::TORQUE_ENABLE, &[0]).unwrap(),
            ),
            (
                STUFFED,
                Packet::write(1, 116, &0x00FD_FFFF_i32.to_le_bytes()).unwrap(),
            ),
        ] {
            let bytes = hex(bytes);
            assert_eq!(
                decode(&bytes),
                Ok(Parsed::Complete {
                    value: packet,
                    used: bytes.len()
                })
            );
            assert_eq!(encode(&packet).as_slice(), bytes);
        }
        assert_eq!(PresentState::decode(&state.encode()), Ok(state));
    }

    #[test]
    fn every_prefix_is_incomplete() {
        assert_prefixes_incomplete(&hex(REPLY_STATE), decode);
        assert_prefixes_incomplete(&hex(STUFFED), decode);
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        assert_flipped_bits_refused(&hex(REPLY_STATE), decode);
        assert_flipped_bits_refused(&hex(STUFFED), decode);
    }

    #[test]
    fn a_length_that_cannot_be_is_refused_at_once() {
        let too_long = [0xFF, 0xFF, 0xFD, 0x00, 1, 0xFF, 0xFF];
        assert_eq!(
            decode(&too_long),
            Err(DecodeError::Length {
                expected: MAX_BODY + 2,
                got: 0xFFFF
            })
        );
        let too_short = [0xFF, 0xFF, 0xFD, 0x00, 1, 2, 0];
        assert_eq!(
            decode(&too_short),
            Err(DecodeError::Length {
                expected: MAX_BODY + 2,
                got: 2
            })
        );
    }

    #[test]
    fn a_stuffed_header_is_no_header() {
        assert_eq!(
            decode(&[0xFF, 0xFF, 0xFD, 0xFD]),
            Err(DecodeError::Field {
                name: "header",
                value: 0xFD
            })
        );
    }

    #[test]
    fn a_missing_stuffing_byte_is_refused_although_the_crc_is_right() {
        let mut frame = vec![
            0xFF, 0xFF, 0xFD, 0x00, 1, 9, 0, 3, 74, 0, 0xFF, 0xFF, 0xFD, 0,
        ];
        frame.extend(DYNAMIXEL.checksum(&frame).to_le_bytes());
        assert_eq!(
            decode(&frame),
            Err(DecodeError::Field {
                name: "stuffing",
                value: 0
            })
        );
    }

    #[test]
    fn a_status_without_an_error_byte_is_refused() {
        let mut frame = vec![0xFF, 0xFF, 0xFD, 0x00, 1, 3, 0, STATUS];
        frame.extend(DYNAMIXEL.checksum(&frame).to_le_bytes());
        assert_eq!(
            decode(&frame),
            Err(DecodeError::Length {
                expected: 2,
                got: 1
            })
        );
        assert_eq!(
            PresentState::decode(&[0; 9]),
            Err(DecodeError::Length {
                expected: 10,
                got: 9
            })
        );
    }

    #[test]
    fn an_alert_is_apart_from_the_error_code() {
        assert!(StatusError(0x84).hardware_alert());
        assert_eq!(StatusError(0x84).code(), 4);
    }

    #[test]
    fn what_does_not_fit_is_not_written() {
        assert!(Params::new(&[0; MAX_PARAMS + 1]).is_none());
        assert!(Packet::write(1, 0, &[0; MAX_PARAMS - 1]).is_none());
        assert!(Packet::write(1, 0, &[0xFF; MAX_PARAMS - 2]).is_some());
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            let _ = decode(&bytes);
            let mut headed = HEADER.to_vec();
            headed.extend(&bytes);
            let _ = decode(&headed);
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(
            id in 0_u8..=252, error: u8,
            params in proptest::collection::vec(prop_oneof![Just(0xFF), Just(0xFD), any::<u8>()], 0..=MAX_PARAMS),
        ) {
            let params = Params::new(&params).unwrap();
            for packet in [
                Packet::Status { id, error: StatusError(error), params },
                Packet::Instruction { id, code: instruction::WRITE, params },
            ] {
                let bytes = encode(&packet);
                let used = bytes.as_slice().len();
                prop_assert_eq!(decode(bytes.as_slice()), Ok(Parsed::Complete { value: packet, used }));
            }
        }
    }
}
