//! ATI NETCANOEM: the CAN board of ATI's force-torque sensors. Polled; gauges only, the host multiplies with the matrix.
//!
//! An 11-bit id is `base << 4 | operation`; base is 7 bits, 0x20 from the factory. 250 kbit/s from the factory. **Big endian.**
//!
//! | operation | request | reply |
//! |---|---|---|
//! | 0 read gauges | - | id 0: u16 status, i16 sg0 sg2 sg4; then id 1: i16 sg1 sg3 sg5 |
//! | 2 read a row of the matrix | u8 axis, 0..5 = Fx Fy Fz Tx Ty Tz | ids 2, 3, 4: two f32 each (SG0 SG1, SG2 SG3, SG4 SG5) |
//! | 5 serial number | - | 8 ASCII |
//! | 6 set active calibration | u8 0..15 | the same; 0 at power-up |
//! | 7 counts per unit | - | u32 per unit of force, u32 per unit of torque |
//! | 8 units | - | u8 of force, u8 of torque |
//! | C reset | - | none |
//! | F firmware | - | u8 major, u8 minor, u16 build |
//!
//! Force = row · gauges / counts per force, in the unit named; torque alike. Note the order of the gauges: even ones first.
//! Nothing in a reply says to which request it belongs.
//!
//! # Source
//! hardware.md 2.4: ATI 9610-05-1030, section 7, in `griloHBG/ati-netcanoem-cpp`; `KITrobotics/ati_force_torque` [A].

use core::fmt;

use crate::bytes::field;
use crate::can::CanFrame;
use crate::error::DecodeError;

/// The factory's base id.
pub const FACTORY_BASE: u8 = 0x20;

/// What the host can ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Status and gauges.
    ReadGauges,
    /// A row of the matrix: 0..5 = Fx Fy Fz Tx Ty Tz.
    ReadMatrixRow(u8),
    /// Serial number of the transducer.
    ReadSerialNumber,
    /// Makes one of 16 calibrations the active one until power-off.
    SetCalibration(u8),
    /// Counts per unit.
    ReadCountsPerUnit,
    /// Units.
    ReadUnits,
    /// Resets the board. Not answered.
    Reset,
    /// Firmware version.
    ReadFirmware,
}

/// What the board says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reply {
    /// First half of a sample.
    EvenGauges {
        /// Status.
        status: Status,
        /// sg0 sg2 sg4.
        even: [i16; 3],
    },
    /// Second half of a sample: sg1 sg3 sg5.
    OddGauges([i16; 3]),
    /// Part 0, 1 or 2 of a row of the matrix; finite.
    MatrixPart {
        /// Which pair of gauges.
        part: u8,
        /// Two elements.
        pair: [f32; 2],
    },
    /// 8 ASCII.
    SerialNumber([u8; 8]),
    /// The active calibration.
    Calibration(u8),
    /// Counts per unit of force and of torque; not 0.
    CountsPerUnit([u32; 2]),
    /// Units of force and torque as SI per unit.
    Units([f64; 2]),
    /// Firmware version.
    Firmware {
        /// Major.
        major: u8,
        /// Minor.
        minor: u8,
        /// Build.
        build: u16,
    },
}

/// Status of the board.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u16);

impl Status {
    /// A gauge is at the upper end of its converter.
    pub const TOO_HIGH: u16 = 1 << 1;
    /// A gauge is at the lower end of its converter.
    pub const TOO_LOW: u16 = 1 << 2;
    /// Trouble on the bus; stays until a reset.
    pub const BUS_ERROR: u16 = 1 << 14;
    /// Any error.
    pub const ANY: u16 = 1 << 15;

    /// Whether any of `bits` is set.
    #[must_use]
    pub const fn has(self, bits: u16) -> bool {
        self.0 & bits != 0
    }

    /// What bit `bit` means.
    #[must_use]
    pub const fn meaning(bit: u32) -> &'static str {
        match bit {
            0 => "watchdog reset",
            1 => "gauge or converter too high",
            2 => "gauge or converter too low",
            3 => "artificial ground out of range",
            4 => "supply too high",
            5 => "supply too low",
            6 => "bad active calibration",
            7 => "EEPROM failure",
            8 => "configuration invalid",
            11 => "temperature too high",
            12 => "temperature too low",
            14 => "CAN bus error",
            15 => "an error",
            _ => "an undocumented bit",
        }
    }
}

impl fmt::Debug for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Status({:#06x})", self.0)
    }
}

/// Newtons per unit of force code 1 to 6: lbf, N, klbf, kN, kgf, gf.
const NEWTONS: [f64; 6] = [
    4.448_221_615_260_5,
    1.0,
    4_448.221_615_260_5,
    1_000.0,
    9.806_65,
    9.806_65e-3,
];
/// Newton metres per unit of torque code 1 to 6: lbf in, lbf ft, N m, N mm, kgf cm, kN m.
const NEWTON_METRES: [f64; 6] = [
    0.112_984_829_027_616_7,
    1.355_817_948_331_400_4,
    1.0,
    1e-3,
    0.098_066_5,
    1_000.0,
];

/// The id of an operation.
#[must_use]
pub fn id(base: u8, operation: u8) -> u16 {
    (u16::from(base & 0x7F) << 4) | u16::from(operation & 0xF)
}

/// Writes a request.
#[must_use]
pub fn request_frame(base: u8, request: Request) -> CanFrame {
    let (operation, argument) = match request {
        Request::ReadGauges => (0x0, None),
        Request::ReadMatrixRow(axis) => (0x2, Some(axis)),
        Request::ReadSerialNumber => (0x5, None),
        Request::SetCalibration(index) => (0x6, Some(index)),
        Request::ReadCountsPerUnit => (0x7, None),
        Request::ReadUnits => (0x8, None),
        Request::Reset => (0xC, None),
        Request::ReadFirmware => (0xF, None),
    };
    let payload = argument.map(|byte| [byte]);
    let payload: &[u8] = payload.as_ref().map_or(&[], |payload| payload);
    CanFrame::standard(id(base, operation), payload).unwrap_or_default()
}

/// Reads a reply.
///
/// # Errors
/// The id is not the board's, the payload has another length than the operation's, or a value cannot be.
pub fn decode(base: u8, frame: &CanFrame) -> Result<Reply, DecodeError> {
    let foreign = Err(DecodeError::Field {
        name: "can_id",
        value: frame.arbitration_id(),
    });
    let first = u32::from(id(base, 0));
    if frame.is_extended() || frame.arbitration_id() & !0xF != first {
        return foreign;
    }
    let payload = frame.payload();
    match frame.arbitration_id() & 0xF {
        0x0 => {
            let [status, even @ ..] = words::<4>(payload)?;
            Ok(Reply::EvenGauges {
                status: Status(status),
                even: even.map(u16::cast_signed),
            })
        }
        0x1 => Ok(Reply::OddGauges(words::<3>(payload)?.map(u16::cast_signed))),
        0x2 => matrix_part(0, payload),
        0x3 => matrix_part(1, payload),
        0x4 => matrix_part(2, payload),
        0x5 => Ok(Reply::SerialNumber(exactly(payload)?)),
        0x6 => exactly(payload).map(|[index]| Reply::Calibration(index)),
        0x7 => {
            let counts = doubles(payload)?.map(u32::from_be_bytes);
            if counts.contains(&0) {
                return Err(DecodeError::Field {
                    name: "counts per unit",
                    value: 0,
                });
            }
            Ok(Reply::CountsPerUnit(counts))
        }
        0x8 => {
            let [force, torque] = exactly(payload)?;
            Ok(Reply::Units([
                unit("unit of force", &NEWTONS, force)?,
                unit("unit of torque", &NEWTON_METRES, torque)?,
            ]))
        }
        0xF => {
            let [major, minor, high, low] = exactly(payload)?;
            Ok(Reply::Firmware {
                major,
                minor,
                build: u16::from_be_bytes([high, low]),
            })
        }
        _ => foreign,
    }
}

fn exactly<const N: usize>(payload: &[u8]) -> Result<[u8; N], DecodeError> {
    payload.try_into().map_err(|_| DecodeError::Length {
        expected: N,
        got: payload.len(),
    })
}

fn words<const N: usize>(payload: &[u8]) -> Result<[u16; N], DecodeError> {
    if payload.len() != 2 * N {
        return Err(DecodeError::Length {
            expected: 2 * N,
            got: payload.len(),
        });
    }
    let mut words = [0; N];
    for (at, word) in words.iter_mut().enumerate() {
        *word = u16::from_be_bytes(field(payload, 2 * at).unwrap_or_default());
    }
    Ok(words)
}

fn doubles(payload: &[u8]) -> Result<[[u8; 4]; 2], DecodeError> {
    let [a, b, c, d, e, f, g, h] = exactly(payload)?;
    Ok([[a, b, c, d], [e, f, g, h]])
}

fn matrix_part(part: u8, payload: &[u8]) -> Result<Reply, DecodeError> {
    let pair = doubles(payload)?.map(f32::from_be_bytes);
    if pair.iter().any(|element| !element.is_finite()) {
        return Err(DecodeError::NotFinite {
            name: "matrix element",
        });
    }
    Ok(Reply::MatrixPart { part, pair })
}

fn unit(name: &'static str, known: &[f64; 6], code: u8) -> Result<f64, DecodeError> {
    let value = usize::from(code)
        .checked_sub(1)
        .and_then(|at| known.get(at));
    value.copied().ok_or(DecodeError::Field {
        name,
        value: code.into(),
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::hex;

    fn frame(id: u16, bytes: &str) -> CanFrame {
        CanFrame::standard(id, &hex(bytes)).unwrap()
    }

    // hardware.md 2.4, computed from the maker's document.
    #[test]
    fn golden_replies_decode() {
        for (id, bytes, reply) in [
            (
                0x200,
                "00 00 03 E8 0B B8 13 88",
                Reply::EvenGauges {
                    status: Status(0),
                    even: [1000, 3000, 5000],
                },
            ),
            (
                0x201,
                "F8 30 F0 60 E8 90",
                Reply::OddGauges([-2000, -4000, -6000]),
            ),
            (
                0x200,
                "C0 00 00 00 00 00 00 00",
                Reply::EvenGauges {
                    status: Status(Status::ANY | Status::BUS_ERROR),
                    even: [0; 3],
                },
            ),
            (
                0x203,
                "3F C0 00 00 C0 10 00 00",
                Reply::MatrixPart {
                    part: 1,
                    pair: [1.5, -2.25],
                },
            ),
            (
                0x207,
                "00 0F 42 40 00 0F 42 40",
                Reply::CountsPerUnit([1_000_000; 2]),
            ),
            (0x208, "02 03", Reply::Units([1.0, 1.0])),
            (0x208, "01 04", Reply::Units([4.448_221_615_260_5, 1e-3])),
            (
                0x205,
                "46 54 30 31 32 33 34 35",
                Reply::SerialNumber(*b"FT012345"),
            ),
            (0x206, "05", Reply::Calibration(5)),
            (
                0x20F,
                "03 08 01 02",
                Reply::Firmware {
                    major: 3,
                    minor: 8,
                    build: 0x0102,
                },
            ),
        ] {
            assert_eq!(decode(FACTORY_BASE, &frame(id, bytes)), Ok(reply));
        }
    }

    #[test]
    fn requests_have_the_ids_and_lengths_of_the_document() {
        for (id, bytes, request) in [
            (0x200, "", Request::ReadGauges),
            (0x202, "05", Request::ReadMatrixRow(5)),
            (0x205, "", Request::ReadSerialNumber),
            (0x206, "0F", Request::SetCalibration(15)),
            (0x207, "", Request::ReadCountsPerUnit),
            (0x208, "", Request::ReadUnits),
            (0x20C, "", Request::Reset),
            (0x20F, "", Request::ReadFirmware),
        ] {
            assert_eq!(request_frame(FACTORY_BASE, request), frame(id, bytes));
        }
        assert_eq!(id(0x7F, 0xF), 0x7FF);
    }

    #[test]
    fn a_payload_of_another_length_is_never_a_reply() {
        for operation in [0, 1, 2, 3, 4, 5, 6, 7, 8, 0xF] {
            let right: Vec<usize> = (0..=8)
                .filter(|len| {
                    let payload = vec![1; *len];
                    let frame = CanFrame::standard(0x200 | operation, &payload).unwrap();
                    decode(FACTORY_BASE, &frame).is_ok()
                })
                .collect();
            assert_eq!(right.len(), 1, "operation {operation:x}: {right:?}");
        }
    }

    #[test]
    fn what_cannot_be_is_named() {
        let field = |name, value| Err(DecodeError::Field { name, value });
        let decode = |id, bytes| decode(FACTORY_BASE, &frame(id, bytes));
        assert_eq!(decode(0x210, "00 00"), field("can_id", 0x210));
        assert_eq!(decode(0x20A, "00 00"), field("can_id", 0x20A));
        assert_eq!(decode(0x208, "07 03"), field("unit of force", 7));
        assert_eq!(decode(0x208, "02 00"), field("unit of torque", 0));
        assert_eq!(
            decode(0x207, "00 00 00 01 00 00 00 00"),
            field("counts per unit", 0)
        );
        assert_eq!(
            decode(0x202, "7F C0 00 00 00 00 00 00"),
            Err(DecodeError::NotFinite {
                name: "matrix element"
            })
        );
        let extended = CanFrame::extended(0x206, &[0]).unwrap();
        assert_eq!(
            super::decode(FACTORY_BASE, &extended),
            field("can_id", 0x206)
        );
    }

    proptest! {
        #[test]
        fn arbitrary_frames_never_panic(
            base: u8, id in 0_u16..0x800, payload in proptest::collection::vec(any::<u8>(), 0..9)
        ) {
            let frame = CanFrame::standard(id, &payload).unwrap();
            let _ = decode(base, &frame);
        }

        #[test]
        fn a_request_answered_by_itself_is_no_sample(base in 0_u8..0x80, axis: u8) {
            for request in [Request::ReadGauges, Request::ReadMatrixRow(axis), Request::ReadUnits] {
                prop_assert!(decode(base, &request_frame(base, request)).is_err());
            }
        }
    }
}
