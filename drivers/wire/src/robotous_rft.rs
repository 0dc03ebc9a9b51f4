//! Robotous RFT series on CAN and on a serial line (RS-232/422/485, USB): one protocol, two framings.
//!
//! Command D1..D8 and response D1..D16, where D1 is the command's number; unused bytes mean nothing (we send 0).
//!
//! | framing | command | response |
//! |---|---|---|
//! | serial | 0x55, D1..D8, sum, 0xAA (11 bytes) | 0x55, D1..D16, sum, 0xAA (19 bytes) |
//! | CAN, 1 Mbit/s | id 0x64: D1..D8 | id 0x01: D1..D8, then id 0x02: D9..D16 |
//!
//! | force-torque record | D1 | D2..D13 | D14 | D15 D16 |
//! |---|---|---|---|---|
//! | type | u8 0x0A or 0x0B | 6 x i16, **big endian** | u8 | - |
//! | field | once or stream | raw Fx Fy Fz Tx Ty Tz | overload bits | nothing |
//!
//! Force = raw / DF (N), torque = raw / DT (N m); both divisors depend on the model, [`Model`].
//!
//! **What the sum cannot promise**: it is the sum of the data bytes modulo 256. Any one flipped bit is refused, but two
//! flips that cancel, and bytes that change places, are not seen. On CAN the bus's own CRC protects each half, and
//! nothing says that two halves belong together but their order.
//!
//! # Source
//! hardware.md 2.2: maker's manual 1.82, maker's source, three independent drivers [A]. The padding of text fields is
//! unconfirmed (NUL and space are both taken off).

mod can;
mod settings;

use core::fmt;

pub use can::{CanIds, Half, command_frame, decode_half, join, response_frames};
pub use settings::{FilterSetting, MODELS, Model, max_rate_hz_at, model_named, rate_code, rate_hz};

use crate::bytes::{Layout, field};
use crate::error::DecodeError;
use crate::stream::Parsed;

/// Length of a command on a serial line, bytes.
pub const COMMAND_LEN: usize = 11;
/// Length of a response on a serial line, bytes.
pub const RESPONSE_LEN: usize = 19;
/// First byte of a packet on a serial line.
pub const START: u8 = 0x55;
/// Last byte of a packet on a serial line.
pub const END: u8 = 0xAA;

/// A command, D1..D8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// 0x01: model name.
    ReadModel,
    /// 0x02: serial number.
    ReadSerialNumber,
    /// 0x03: firmware version.
    ReadFirmware,
    /// 0x08: set the filter; kept over a restart.
    SetFilter(FilterSetting),
    /// 0x09: read the filter.
    ReadFilter,
    /// 0x0A: one force-torque record.
    ReadOnce,
    /// 0x0B: records until [`Command::Stop`].
    Start,
    /// 0x0C: stop. Not answered.
    Stop,
    /// 0x0F: set the output rate by [`rate_code`]; kept over a restart.
    SetRate(u8),
    /// 0x10: read the output rate.
    ReadRate,
    /// 0x11: make the present output zero (true) or go back to the factory's reference. Not answered.
    SetBias(bool),
    /// 0x12: how often each axis was overloaded.
    ReadOverloadCounters,
}

/// 15 characters that the sensor says of itself.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Text(pub [u8; 15]);

impl Text {
    /// The text without padding; `None` when it is not ASCII.
    #[must_use]
    pub fn as_str(&self) -> Option<&str> {
        let text = core::str::from_utf8(&self.0).ok()?;
        text.is_ascii()
            .then(|| text.trim_matches(['\0', ' ', '\r', '\n']))
    }

    /// A text of at most 15 ASCII characters, padded with NUL.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        let fits = text.is_ascii() && text.len() <= 15;
        fits.then(|| Self(Layout::new().put(text.as_bytes()).finish()))
    }
}

impl fmt::Debug for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Text").field(&self.as_str()).finish()
    }
}

/// Answer to a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Outcome {
    /// 1 = taken, 0 = refused.
    pub result: u8,
    /// 0 none, 1 unsupported command, 2 out of range, 3 not stored.
    pub error: u8,
}

impl Outcome {
    /// The setting was taken.
    pub const TAKEN: Self = Self {
        result: 1,
        error: 0,
    };

    /// What the error number means.
    #[must_use]
    pub const fn error_text(self) -> &'static str {
        match self.error {
            0 => "no error",
            1 => "unsupported command",
            2 => "value out of range",
            3 => "could not be stored",
            _ => "unknown error",
        }
    }
}

/// A force-torque record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// Raw Fx Fy Fz.
    pub force: [i16; 3],
    /// Raw Tx Ty Tz.
    pub torque: [i16; 3],
    /// Axes beyond their rated load by more than 20 %: 0x20 Fx, 0x10 Fy, 0x08 Fz, 0x04 Tx, 0x02 Ty, 0x01 Tz.
    pub overload: u8,
}

/// A response, D1..D16.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// 0x01.
    Model(Text),
    /// 0x02.
    SerialNumber(Text),
    /// 0x03.
    Firmware(Text),
    /// 0x08.
    FilterSet(Outcome),
    /// 0x09.
    Filter(FilterSetting),
    /// 0x0A.
    Once(Record),
    /// 0x0B.
    Stream(Record),
    /// 0x0F.
    RateSet(Outcome),
    /// 0x10: rate code.
    Rate(u8),
    /// 0x12: Fx Fy Fz Tx Ty Tz, each stops at 255.
    OverloadCounters([u8; 6]),
}

impl Command {
    /// D1..D8.
    #[must_use]
    pub fn to_data(self) -> [u8; 8] {
        let (number, arguments): (u8, [u8; 2]) = match self {
            Self::ReadModel => (0x01, [0, 0]),
            Self::ReadSerialNumber => (0x02, [0, 0]),
            Self::ReadFirmware => (0x03, [0, 0]),
            Self::SetFilter(filter) => (0x08, [filter.kind, filter.code]),
            Self::ReadFilter => (0x09, [0, 0]),
            Self::ReadOnce => (0x0A, [0, 0]),
            Self::Start => (0x0B, [0, 0]),
            Self::Stop => (0x0C, [0, 0]),
            Self::SetRate(code) => (0x0F, [code, 0]),
            Self::ReadRate => (0x10, [0, 0]),
            Self::SetBias(on) => (0x11, [u8::from(on), 0]),
            Self::ReadOverloadCounters => (0x12, [0, 0]),
        };
        let [first, second] = arguments;
        [number, first, second, 0, 0, 0, 0, 0]
    }

    /// Reads D1..D8.
    ///
    /// # Errors
    /// The command's number is unknown here (ids and baud rates, 0x04 to 0x07, are left to the maker's tool), or the
    /// bias is neither on nor off.
    pub fn from_data(data: [u8; 8]) -> Result<Self, DecodeError> {
        let [number, first, second, ..] = data;
        Ok(match number {
            0x01 => Self::ReadModel,
            0x02 => Self::ReadSerialNumber,
            0x03 => Self::ReadFirmware,
            0x08 => Self::SetFilter(FilterSetting {
                kind: first,
                code: second,
            }),
            0x09 => Self::ReadFilter,
            0x0A => Self::ReadOnce,
            0x0B => Self::Start,
            0x0C => Self::Stop,
            0x0F => Self::SetRate(first),
            0x10 => Self::ReadRate,
            0x11 if first <= 1 => Self::SetBias(first == 1),
            0x11 => {
                return Err(DecodeError::Field {
                    name: "bias",
                    value: first.into(),
                });
            }
            0x12 => Self::ReadOverloadCounters,
            other => {
                return Err(DecodeError::Field {
                    name: "D1",
                    value: other.into(),
                });
            }
        })
    }
}

impl Response {
    /// D1..D16.
    #[must_use]
    pub fn to_data(self) -> [u8; 16] {
        let mut data = Layout::<16>::new();
        match self {
            Self::Model(text) => data.put(&[0x01]).put(&text.0),
            Self::SerialNumber(text) => data.put(&[0x02]).put(&text.0),
            Self::Firmware(text) => data.put(&[0x03]).put(&text.0),
            Self::FilterSet(outcome) => data.put(&[0x08, outcome.result, outcome.error]),
            Self::Filter(filter) => data.put(&[0x09, filter.kind, filter.code]),
            Self::Once(record) => put_record(data.put(&[0x0A]), record),
            Self::Stream(record) => put_record(data.put(&[0x0B]), record),
            Self::RateSet(outcome) => data.put(&[0x0F, outcome.result, outcome.error]),
            Self::Rate(code) => data.put(&[0x10, code]),
            Self::OverloadCounters(counters) => data.put(&[0x12]).put(&counters),
        };
        data.finish()
    }

    /// Reads D1..D16.
    ///
    /// # Errors
    /// D1 is no response known here.
    pub fn from_data(data: [u8; 16]) -> Result<Self, DecodeError> {
        let [number, rest @ ..] = data;
        let [first, second, third, fourth, fifth, sixth, ..] = rest;
        let outcome = Outcome {
            result: first,
            error: second,
        };
        Ok(match number {
            0x01 => Self::Model(Text(rest)),
            0x02 => Self::SerialNumber(Text(rest)),
            0x03 => Self::Firmware(Text(rest)),
            0x08 => Self::FilterSet(outcome),
            0x09 => Self::Filter(FilterSetting {
                kind: first,
                code: second,
            }),
            0x0A => Self::Once(record(rest)),
            0x0B => Self::Stream(record(rest)),
            0x0F => Self::RateSet(outcome),
            0x10 => Self::Rate(first),
            0x12 => Self::OverloadCounters([first, second, third, fourth, fifth, sixth]),
            other => {
                return Err(DecodeError::Field {
                    name: "D1",
                    value: other.into(),
                });
            }
        })
    }
}

fn put_record(data: &mut Layout<16>, record: Record) -> &mut Layout<16> {
    for raw in record.force.iter().chain(&record.torque) {
        data.put(&raw.to_be_bytes());
    }
    data.put(&[record.overload])
}

fn record(rest: [u8; 15]) -> Record {
    let raw_at = |at| i16::from_be_bytes(field(&rest, at).unwrap_or_default());
    let [.., overload, _, _] = rest;
    Record {
        force: [0, 2, 4].map(raw_at),
        torque: [6, 8, 10].map(raw_at),
        overload,
    }
}

fn sum(data: &[u8]) -> u8 {
    data.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte))
}

/// Writes a command for a serial line.
#[must_use]
pub fn encode_command(command: Command) -> [u8; COMMAND_LEN] {
    let data = command.to_data();
    Layout::new()
        .put(&[START])
        .put(&data)
        .put(&[sum(&data), END])
        .finish()
}

/// Writes a response for a serial line.
#[must_use]
pub fn encode_response(response: &Response) -> [u8; RESPONSE_LEN] {
    let data = response.to_data();
    Layout::new()
        .put(&[START])
        .put(&data)
        .put(&[sum(&data), END])
        .finish()
}

/// Reads the command at the start of `bytes`.
///
/// # Errors
/// Start or end byte, sum or D1 are wrong.
pub fn decode_command(bytes: &[u8]) -> Result<Parsed<Command>, DecodeError> {
    match deframe::<8>(bytes)? {
        None => Ok(Parsed::Incomplete),
        Some(data) => Ok(Parsed::Complete {
            value: Command::from_data(data)?,
            used: COMMAND_LEN,
        }),
    }
}

/// Reads the response at the start of `bytes`.
///
/// # Errors
/// Start or end byte, sum or D1 are wrong.
pub fn decode_response(bytes: &[u8]) -> Result<Parsed<Response>, DecodeError> {
    match deframe::<16>(bytes)? {
        None => Ok(Parsed::Incomplete),
        Some(data) => Ok(Parsed::Complete {
            value: Response::from_data(data)?,
            used: RESPONSE_LEN,
        }),
    }
}

/// The `N` data bytes between start byte and sum; `None` while bytes are missing.
fn deframe<const N: usize>(bytes: &[u8]) -> Result<Option<[u8; N]>, DecodeError> {
    match bytes.first() {
        Some(&START) | None => {}
        Some(&other) => {
            return Err(DecodeError::Field {
                name: "start of packet",
                value: other.into(),
            });
        }
    }
    let (Some(data), Some([carried, end])) = (field::<N>(bytes, 1), field::<2>(bytes, 1 + N))
    else {
        return Ok(None);
    };
    if end != END {
        return Err(DecodeError::Field {
            name: "end of packet",
            value: end.into(),
        });
    }
    let computed = sum(&data);
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    Ok(Some(data))
}

#[cfg(test)]
mod tests;
