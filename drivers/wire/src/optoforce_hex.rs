//! OptoForce / OnRobot HEX sensors, 3 and 6 axes: one packet format on USB, UART and CAN.
//!
//! All fields are **big endian**; every packet ends with a u16, the sum of all its other bytes (header too) modulo 65536.
//!
//! | packet | bytes | header | content |
//! |---|---|---|---|
//! | sample, 6 axes | 22 | AA 07 08 10 | u16 counter, u16 status, i16 Fx Fy Fz Tx Ty Tz |
//! | sample, 3 axes | 16 | AA 07 08 0A | u16 counter, u16 status, i16 Fx Fy Fz |
//! | configured | 7 | AA 00 50 01 | u8 error |
//! | serial number | 14 | AA 00 12 08 | 8 ASCII |
//! | configure (to the sensor) | 9 | AA 00 32 03 | u8 speed (ms per sample, 0 = stop), u8 filter, u8 zero |
//! | ask serial number (to the sensor) | 6 | AB 00 12 08 | - |
//!
//! On CAN (1 Mbit/s) a packet is cut into payloads of 8 bytes, the last one shorter: 22 = 8 + 8 + 6.
//! Counts become N and N m by the sensitivity report of the very sensor.
//!
//! **What the sum cannot promise**: any one flipped bit is refused, flips that cancel and bytes that change places are not seen.
//!
//! # Source
//! hardware.md 2.3: the 3-axis packet and a configuration are captured bytes of `alknemeyer/optoforce` [A]; 6 axes and
//! CAN agree in two drivers [B]. Answers on CAN are unconfirmed [X].

use core::fmt;

use crate::bytes::field;
use crate::error::DecodeError;
use crate::stream::{Chunk, Parsed};

/// Length of a sample of a 6-axis sensor, bytes.
pub const SAMPLE_LEN: usize = 22;
/// Length of the longest packet, bytes.
pub const MAX_LEN: usize = SAMPLE_LEN;

const SAMPLE_6: [u8; 4] = [0xAA, 0x07, 0x08, 0x10];
const SAMPLE_3: [u8; 4] = [0xAA, 0x07, 0x08, 0x0A];
const CONFIGURED: [u8; 4] = [0xAA, 0x00, 0x50, 0x01];
const SERIAL_NUMBER: [u8; 4] = [0xAA, 0x00, 0x12, 0x08];
const CONFIGURE: [u8; 4] = [0xAA, 0x00, 0x32, 0x03];
const ASK_SERIAL_NUMBER: [u8; 4] = [0xAB, 0x00, 0x12, 0x08];

/// Headers of packets to the host, and their whole lengths.
const TO_HOST: [([u8; 4], usize); 4] = [
    (SAMPLE_6, SAMPLE_LEN),
    (SAMPLE_3, 16),
    (CONFIGURED, 7),
    (SERIAL_NUMBER, 14),
];
const TO_SENSOR: [([u8; 4], usize); 2] = [(CONFIGURE, 9), (ASK_SERIAL_NUMBER, 6)];

/// The status word.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Status(pub u16);

impl Status {
    /// Trouble of the converter box: 0 none, 1 converter, 2 communication with the sensor.
    #[must_use]
    pub const fn converter(self) -> u16 {
        self.0 >> 13
    }

    /// Trouble of the sensor: 0 none, 1 not detected, 2 failure, 4 temperature.
    #[must_use]
    pub const fn sensor(self) -> u16 {
        (self.0 >> 10) & 7
    }

    /// Overloaded axes: 0x20 Fx, 0x10 Fy, 0x08 Fz, 0x04 Tx, 0x02 Ty, 0x01 Tz.
    #[must_use]
    pub const fn overload(self) -> u16 {
        (self.0 >> 4) & 0x3F
    }
}

impl fmt::Debug for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Status({:#06x})", self.0)
    }
}

/// One sample in raw counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Counts samples; wraps at 65536.
    pub counter: u16,
    /// Status.
    pub status: Status,
    /// Raw Fx Fy Fz.
    pub force: [i16; 3],
    /// Raw Tx Ty Tz; `None` from a 3-axis sensor.
    pub torque: Option<[i16; 3]>,
}

/// A packet of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packet {
    /// A sample.
    Sample(Sample),
    /// Answer to [`Command::Configure`]; 0 = taken.
    Configured {
        /// The sensor's error number.
        error: u8,
    },
    /// Answer to [`Command::ReadSerialNumber`].
    SerialNumber([u8; 8]),
}

/// A packet to the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Sets speed, filter and zero, all at once.
    Configure(Settings),
    /// Asks for the serial number.
    ReadSerialNumber,
}

/// What [`Command::Configure`] sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Time between two samples, ms; 0 stops.
    pub period_ms: u8,
    /// [`filter_code`].
    pub filter: u8,
    /// 0 gives back the factory's zero, 255 makes the present load zero.
    pub zero: u8,
}

/// Cut-off of filter codes 1 to 6, Hz; 0 is no filter and 1.5 Hz (code 6) is written as 2 here.
const CUT_OFFS_HZ: [u16; 6] = [500, 150, 50, 15, 5, 2];

/// The code of a low-pass filter; 0 Hz is no filter.
#[must_use]
pub fn filter_code(cut_off_hz: u16) -> Option<u8> {
    if cut_off_hz == 0 {
        return Some(0);
    }
    let at = CUT_OFFS_HZ.iter().position(|known| *known == cut_off_hz)?;
    u8::try_from(at + 1).ok()
}

/// Milliseconds per sample for an output rate that the documents name: 1000, 333, 100, 30 or 10 Hz.
#[must_use]
pub const fn period_ms(rate_hz: u16) -> Option<u8> {
    match rate_hz {
        1000 => Some(1),
        333 => Some(3),
        100 => Some(10),
        30 => Some(33),
        10 => Some(100),
        _ => None,
    }
}

/// Reads the packet of a sensor at the start of `bytes`.
///
/// # Errors
/// The header is none of the sensor's, or the sum is wrong.
pub fn decode(bytes: &[u8]) -> Result<Parsed<Packet>, DecodeError> {
    let Some((header, packet)) = deframe(bytes, &TO_HOST)? else {
        return Ok(Parsed::Incomplete);
    };
    let three = |at: usize| [at, at + 2, at + 4].map(|at| i16::from_be_bytes(field_at(packet, at)));
    let value = match header {
        CONFIGURED => Packet::Configured {
            error: packet.get(4).copied().unwrap_or_default(),
        },
        SERIAL_NUMBER => Packet::SerialNumber(field(packet, 4).unwrap_or_default()),
        _ => Packet::Sample(Sample {
            counter: u16::from_be_bytes(field_at(packet, 4)),
            status: Status(u16::from_be_bytes(field_at(packet, 6))),
            force: three(8),
            torque: (header == SAMPLE_6).then(|| three(14)),
        }),
    };
    Ok(Parsed::Complete {
        value,
        used: packet.len(),
    })
}

/// Reads the packet of a host at the start of `bytes`.
///
/// # Errors
/// The header is none of a host's, or the sum is wrong.
pub fn decode_command(bytes: &[u8]) -> Result<Parsed<Command>, DecodeError> {
    let Some((header, packet)) = deframe(bytes, &TO_SENSOR)? else {
        return Ok(Parsed::Incomplete);
    };
    let [period_ms, filter, zero] = field(packet, 4).unwrap_or_default();
    let value = match header {
        CONFIGURE => Command::Configure(Settings {
            period_ms,
            filter,
            zero,
        }),
        _ => Command::ReadSerialNumber,
    };
    Ok(Parsed::Complete {
        value,
        used: packet.len(),
    })
}

/// Writes a packet of a sensor.
#[must_use]
pub fn encode(packet: &Packet) -> Chunk {
    match packet {
        Packet::Sample(sample) => {
            let header = if sample.torque.is_some() {
                SAMPLE_6
            } else {
                SAMPLE_3
            };
            let mut out = Writer::new(header);
            out.put(&sample.counter.to_be_bytes());
            out.put(&sample.status.0.to_be_bytes());
            for raw in sample.force.iter().chain(sample.torque.iter().flatten()) {
                out.put(&raw.to_be_bytes());
            }
            out.finish()
        }
        Packet::Configured { error } => Writer::new(CONFIGURED).put(&[*error]).finish(),
        Packet::SerialNumber(text) => Writer::new(SERIAL_NUMBER).put(text).finish(),
    }
}

/// Writes a packet to a sensor.
#[must_use]
pub fn encode_command(command: Command) -> Chunk {
    match command {
        Command::Configure(settings) => Writer::new(CONFIGURE)
            .put(&[settings.period_ms, settings.filter, settings.zero])
            .finish(),
        Command::ReadSerialNumber => Writer::new(ASK_SERIAL_NUMBER).finish(),
    }
}

fn field_at(bytes: &[u8], at: usize) -> [u8; 2] {
    field(bytes, at).unwrap_or_default()
}

fn sum(bytes: &[u8]) -> u16 {
    bytes
        .iter()
        .fold(0, |sum: u16, byte| sum.wrapping_add((*byte).into()))
}

/// Header and whole packet; `None` while bytes are missing.
type Deframed<'a> = Option<([u8; 4], &'a [u8])>;

fn deframe<'a>(bytes: &'a [u8], known: &[([u8; 4], usize)]) -> Result<Deframed<'a>, DecodeError> {
    let begun = bytes.get(..bytes.len().min(4)).unwrap_or_default();
    let Some((header, len)) = known.iter().find(|(header, _)| header.starts_with(begun)) else {
        let value = begun
            .iter()
            .fold(0, |value: u32, byte| value << 8 | u32::from(*byte));
        return Err(DecodeError::Field {
            name: "header",
            value,
        });
    };
    let Some((content, check)) = bytes.get(..*len).and_then(|packet| {
        let (content, check) = packet.split_last_chunk::<2>()?;
        Some((content, *check))
    }) else {
        return Ok(None);
    };
    let (computed, carried) = (sum(content), u16::from_be_bytes(check));
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    Ok(bytes.get(..*len).map(|packet| (*header, packet)))
}

struct Writer {
    bytes: [u8; MAX_LEN],
    len: usize,
}

impl Writer {
    fn new(header: [u8; 4]) -> Self {
        let mut writer = Self {
            bytes: [0; MAX_LEN],
            len: 0,
        };
        writer.put(&header);
        writer
    }

    fn put(&mut self, field: &[u8]) -> &mut Self {
        for byte in field {
            if let Some(slot) = self.bytes.get_mut(self.len) {
                *slot = *byte;
                self.len += 1;
            }
        }
        self
    }

    fn finish(&mut self) -> Chunk {
        let check = sum(self.bytes.get(..self.len).unwrap_or_default());
        self.put(&check.to_be_bytes());
        Chunk::take_from(self.bytes.get(..self.len).unwrap_or_default()).0
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::{assert_flipped_bits_refused, assert_prefixes_incomplete, hex};

    // hardware.md 2.3. Captured by alknemeyer/optoforce: the 3-axis sample and the configuration of 100 Hz; the others
    // computed from the layout.
    const THREE: &str = "AA 07 08 0A 2D 6A 00 00 FF F7 FF FB 00 07 05 51";
    const SIX: &str = "AA 07 08 10 01 02 00 00 00 64 FF 38 01 2C FF CE 00 3C FF BA 06 56";
    const OVERLOAD: &str = "AA 07 08 10 01 03 02 00 7F FF FF 38 01 2C FF CE 00 3C FF BA 07 73";

    const SAMPLE: Sample = Sample {
        counter: 0x0102,
        status: Status(0),
        force: [100, -200, 300],
        torque: Some([-50, 60, -70]),
    };

    fn configure(period_ms: u8, filter: u8, zero: u8) -> Command {
        Command::Configure(Settings {
            period_ms,
            filter,
            zero,
        })
    }

    #[test]
    fn golden_packets_decode_and_encode() {
        let three = Sample {
            counter: 11_626,
            status: Status(0),
            force: [-9, -5, 7],
            torque: None,
        };
        let overload = Sample {
            counter: 0x0103,
            status: Status(0x0200),
            force: [0x7FFF, -200, 300],
            ..SAMPLE
        };
        for (bytes, packet) in [
            (THREE, Packet::Sample(three)),
            (SIX, Packet::Sample(SAMPLE)),
            (OVERLOAD, Packet::Sample(overload)),
            ("AA 00 50 01 00 00 FB", Packet::Configured { error: 0 }),
        ] {
            let bytes = hex(bytes);
            let used = bytes.len();
            assert_eq!(
                decode(&bytes),
                Ok(Parsed::Complete {
                    value: packet,
                    used
                })
            );
            assert_eq!(encode(&packet).as_slice(), bytes);
        }
    }

    #[test]
    fn golden_commands_decode_and_encode() {
        for (bytes, command) in [
            ("AA 00 32 03 0A 04 00 00 ED", configure(10, 4, 0)),
            ("AA 00 32 03 01 00 FF 01 DF", configure(1, 0, 255)),
            ("AA 00 32 03 03 02 00 00 E4", configure(3, 2, 0)),
            ("AA 00 32 03 00 00 00 00 DF", configure(0, 0, 0)),
            ("AB 00 12 08 00 C5", Command::ReadSerialNumber),
        ] {
            let bytes = hex(bytes);
            let used = bytes.len();
            assert_eq!(
                decode_command(&bytes),
                Ok(Parsed::Complete {
                    value: command,
                    used
                })
            );
            assert_eq!(encode_command(command).as_slice(), bytes);
        }
    }

    #[test]
    fn the_parts_of_a_status_word_are_told_apart() {
        let status = Status(0x5230);
        assert_eq!(
            (status.converter(), status.sensor(), status.overload()),
            (2, 4, 0x23)
        );
    }

    #[test]
    fn codes_follow_the_table() {
        assert_eq!(
            [0, 500, 150, 50, 15, 5, 2, 7].map(filter_code),
            [
                Some(0),
                Some(1),
                Some(2),
                Some(3),
                Some(4),
                Some(5),
                Some(6),
                None
            ]
        );
        assert_eq!(
            [1000, 333, 100, 30, 10, 200].map(period_ms),
            [Some(1), Some(3), Some(10), Some(33), Some(100), None]
        );
    }

    #[test]
    fn every_prefix_is_incomplete() {
        assert_prefixes_incomplete(&hex(SIX), decode);
        assert_prefixes_incomplete(&hex(THREE), decode);
        assert_prefixes_incomplete(&hex("AA 00 32 03 0A 04 00 00 ED"), decode_command);
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        assert_flipped_bits_refused(&hex(SIX), decode);
        assert_flipped_bits_refused(&hex(THREE), decode);
        assert_flipped_bits_refused(&hex("AA 00 32 03 0A 04 00 00 ED"), decode_command);
    }

    #[test]
    fn a_packet_of_four_sensors_is_named_by_its_header() {
        assert_eq!(
            decode(&hex("AA 07 08 1C 00")),
            Err(DecodeError::Field {
                name: "header",
                value: 0xAA07_081C
            })
        );
        let mut broken = hex(SIX);
        broken[21] = 0;
        assert_eq!(
            decode(&broken),
            Err(DecodeError::Checksum {
                computed: 0x0656,
                carried: 0x0600
            })
        );
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let _ = decode(&bytes);
            let _ = decode_command(&bytes);
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(
            counter: u16, status: u16, force: [i16; 3], torque: Option<[i16; 3]>, text: [u8; 8], error: u8
        ) {
            let sample = Sample { counter, status: Status(status), force, torque };
            for packet in [Packet::Sample(sample), Packet::SerialNumber(text), Packet::Configured { error }] {
                let bytes = encode(&packet);
                let used = bytes.as_slice().len();
                prop_assert_eq!(decode(bytes.as_slice()), Ok(Parsed::Complete { value: packet, used }));
            }
        }
    }
}
