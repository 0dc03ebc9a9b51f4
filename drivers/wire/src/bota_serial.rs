//! Bota Systems Rokubi, SensONE, MiniONE on a serial line (USB or RS-422), "gen0" protocol.
//!
//! 8N1, little endian; a frame has 37 bytes:
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | u8 | header 0xAA |
//! | 1 | u16 | status bits, [`Status`] |
//! | 3 | 3 x f32 | force x y z, N |
//! | 15 | 3 x f32 | torque x y z, N m |
//! | 27 | u32 | sensor's clock, us, wraps after 71 min 34.97 s |
//! | 31 | f32 | temperature, deg C |
//! | 35 | u16 | CRC-16/X-25 over bytes 1..35 (without the header) |
//!
//! Commands are ASCII without terminator, at most 64 bytes; the maker's driver sends one character every
//! [`COMMAND_PACE_US`]. The sensor acknowledges with `r,<digit>,<command's letter>,<return code>`, 0 = accepted.
//!
//! # Source
//! hardware.md 2.1: the maker's MATLAB code and ROS drivers agree [A]. The exact form of the boot text is unconfirmed.

use core::fmt::{self, Write as _};

use crate::bytes::{Layout, field};
use crate::crc::X25;
use crate::error::DecodeError;
use crate::stream::Parsed;

/// Length of a frame, bytes.
pub const FRAME_LEN: usize = 37;
/// First byte of a frame.
pub const HEADER: u8 = 0xAA;
/// Pause between two characters of a command, as the maker's driver keeps it, us.
pub const COMMAND_PACE_US: u64 = 5_000;

/// One sample as the sensor sent it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Status bits.
    pub status: Status,
    /// Force x y z, N (gauge values when [`Status::RAW_MEASUREMENTS`] is set).
    pub force: [f32; 3],
    /// Torque x y z, N m (gauge values when [`Status::RAW_MEASUREMENTS`] is set).
    pub torque: [f32; 3],
    /// Sensor's clock, us, wraps at 2^32.
    pub timestamp_us: u32,
    /// Temperature, deg C. Not checked: it may be NaN.
    pub temperature_celsius: f32,
}

/// Status bits of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status(pub u16);

impl Status {
    /// The sensor's program took too long: samples were skipped; raise the sinc length.
    pub const APP_TOOK_TOO_LONG: u16 = 1 << 0;
    /// A component is beyond its range.
    pub const OVERRANGE: u16 = 1 << 1;
    /// Saturated, short or open gauge; the maker warns of permanent damage.
    pub const INVALID_MEASUREMENTS: u16 = 1 << 2;
    /// Gauge values, not N and N m.
    pub const RAW_MEASUREMENTS: u16 = 1 << 3;

    /// Whether any bit of `mask` is set.
    #[must_use]
    pub const fn has(self, mask: u16) -> bool {
        self.0 & mask != 0
    }
}

/// Reads the frame at the start of `bytes`.
///
/// # Errors
/// The first byte is not the header, the CRC is wrong, or a force or torque is not finite.
pub fn decode(bytes: &[u8]) -> Result<Parsed<Sample>, DecodeError> {
    match bytes.first() {
        None => return Ok(Parsed::Incomplete),
        Some(&HEADER) => {}
        Some(&other) => {
            return Err(DecodeError::Field {
                name: "header",
                value: other.into(),
            });
        }
    }
    let Some(frame) = bytes.first_chunk::<FRAME_LEN>() else {
        return Ok(Parsed::Incomplete);
    };
    let carried = u16::from_le_bytes(field(frame, 35).unwrap_or_default());
    let computed = X25.checksum(frame.get(1..35).unwrap_or_default());
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    let f32_at = |at| f32::from_le_bytes(field(frame, at).unwrap_or_default());
    let sample = Sample {
        status: Status(u16::from_le_bytes(field(frame, 1).unwrap_or_default())),
        force: [3, 7, 11].map(f32_at),
        torque: [15, 19, 23].map(f32_at),
        timestamp_us: u32::from_le_bytes(field(frame, 27).unwrap_or_default()),
        temperature_celsius: f32_at(31),
    };
    for (name, axes) in [("force", sample.force), ("torque", sample.torque)] {
        if !axes.iter().all(|axis| axis.is_finite()) {
            return Err(DecodeError::NotFinite { name });
        }
    }
    Ok(Parsed::Complete {
        value: sample,
        used: FRAME_LEN,
    })
}

/// Writes `sample` as a frame.
#[must_use]
pub fn encode(sample: &Sample) -> [u8; FRAME_LEN] {
    let mut layout = Layout::<FRAME_LEN>::new();
    layout.put(&[HEADER]).put(&sample.status.0.to_le_bytes());
    for axis in sample.force.iter().chain(&sample.torque) {
        layout.put(&axis.to_le_bytes());
    }
    layout
        .put(&sample.timestamp_us.to_le_bytes())
        .put(&sample.temperature_celsius.to_le_bytes());
    let crc = X25.checksum(layout.so_far().get(1..).unwrap_or_default());
    layout.put(&crc.to_le_bytes()).finish()
}

/// The bit rates that the sensor knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BaudRate {
    /// 9600 bit/s, code 0.
    Bps9600,
    /// 57600 bit/s, code 1.
    Bps57600,
    /// 115200 bit/s, code 2.
    Bps115200,
    /// 230400 bit/s, code 3, the factory's.
    Bps230400,
    /// 460800 bit/s, code 4, to which the maker's driver switches the sensor.
    Bps460800,
}

impl BaudRate {
    const ALL: [Self; 5] = [
        Self::Bps9600,
        Self::Bps57600,
        Self::Bps115200,
        Self::Bps230400,
        Self::Bps460800,
    ];

    /// The rate of `bps` bit/s, or `None` when the sensor does not know it.
    #[must_use]
    pub fn from_bps(bps: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|rate| rate.bps() == bps)
    }

    /// Bits per second.
    #[must_use]
    pub const fn bps(self) -> u32 {
        match self {
            Self::Bps9600 => 9_600,
            Self::Bps57600 => 57_600,
            Self::Bps115200 => 115_200,
            Self::Bps230400 => 230_400,
            Self::Bps460800 => 460_800,
        }
    }

    /// The code of the `c` command.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

/// The digital filter, command `f`. The sample rate follows the sinc length: about 51 200 Hz / `sinc_length`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    /// 51 to 4096.
    pub sinc_length: u16,
    /// Chop the bridge's supply.
    pub chop: bool,
    /// Fast mode.
    pub fast: bool,
    /// Leave out the FIR filter behind the sinc filter.
    pub fir_disable: bool,
}

/// A command to the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// `C`: stop the frames, take settings.
    Config,
    /// `R`: send frames.
    Run,
    /// `I`: soft reset.
    Init,
    /// `#`: hardware reset; not acknowledged.
    HardwareReset,
    /// `c,T,C,D,B`: temperature compensation, calibration matrix, binary frames, baud code.
    CommSetup {
        /// Compensate the temperature.
        temperature_compensation: bool,
        /// Apply the calibration matrix (else gauge values come).
        calibration: bool,
        /// Rate from the next start on.
        baud: BaudRate,
    },
    /// `f,sinc,chop,fast,firDisable`.
    Filter(Filter),
    /// `s`: keep the settings over a restart.
    Save,
}

impl Command {
    /// The letter that an acknowledgement repeats; `None` when none comes.
    #[must_use]
    pub const fn ack_letter(&self) -> Option<u8> {
        match self {
            Self::Config => Some(b'C'),
            Self::Run => Some(b'R'),
            Self::Init => Some(b'I'),
            Self::HardwareReset => None,
            Self::CommSetup { .. } => Some(b'c'),
            Self::Filter(_) => Some(b'f'),
            Self::Save => Some(b's'),
        }
    }

    /// The command's characters.
    #[must_use]
    pub fn text(&self) -> CommandText {
        let mut text = CommandText(Layout::new());
        // Every command fits: the longest is `c,1,1,0,4` or `f,65535,1,1,1`.
        let _ = match *self {
            Self::Config => text.write_str("C"),
            Self::Run => text.write_str("R"),
            Self::Init => text.write_str("I"),
            Self::HardwareReset => text.write_str("#"),
            Self::CommSetup {
                temperature_compensation,
                calibration,
                baud,
            } => {
                let [t, c] = [temperature_compensation, calibration].map(u8::from);
                write!(text, "c,{t},{c},0,{}", baud.code())
            }
            Self::Filter(Filter {
                sinc_length,
                chop,
                fast,
                fir_disable,
            }) => {
                let [chop, fast, fir_disable] = [chop, fast, fir_disable].map(u8::from);
                write!(text, "f,{sinc_length},{chop},{fast},{fir_disable}")
            }
            Self::Save => text.write_str("s"),
        };
        text
    }
}

/// A command's characters, without heap.
#[derive(Debug)]
pub struct CommandText(Layout<64>);

impl CommandText {
    /// The characters.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        self.0.so_far()
    }
}

impl fmt::Write for CommandText {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.put(text.as_bytes());
        Ok(())
    }
}

/// An acknowledgement, `r,<digit>,<command>,<return code>`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ack {
    /// The digit, whose meaning is unconfirmed.
    pub digit: u8,
    /// Letter of the command.
    pub command: u8,
    /// 0 = accepted. Only one digit is read.
    pub return_code: u8,
}

/// Length of an acknowledgement, without the line end.
pub const ACK_LEN: usize = 7;

/// Reads the acknowledgement at the start of `bytes`; it has 7 bytes and no check sum.
///
/// # Errors
/// The bytes cannot become an acknowledgement.
pub fn decode_ack(bytes: &[u8]) -> Result<Parsed<Ack>, DecodeError> {
    let allowed = |at: usize, byte: u8| match at {
        0 => byte == b'r',
        2 | 6 => byte.is_ascii_digit(),
        4 => byte.is_ascii_alphabetic(),
        _ => byte == b',',
    };
    for (at, byte) in bytes.iter().take(ACK_LEN).enumerate() {
        if !allowed(at, *byte) {
            return Err(DecodeError::Field {
                name: "ack",
                value: u32::from(*byte),
            });
        }
    }
    let Some([_, _, digit, _, command, _, code]) = bytes.first_chunk::<ACK_LEN>().copied() else {
        return Ok(Parsed::Incomplete);
    };
    let ack = Ack {
        digit: digit.wrapping_sub(b'0'),
        command,
        return_code: code.wrapping_sub(b'0'),
    };
    Ok(Parsed::Complete {
        value: ack,
        used: ACK_LEN,
    })
}

/// Writes an acknowledgement; digits above 9 are written as 9.
#[must_use]
pub fn encode_ack(ack: Ack) -> [u8; ACK_LEN] {
    let digit = |value: u8| b'0' + value.min(9);
    [
        b'r',
        b',',
        digit(ack.digit),
        b',',
        ack.command,
        b',',
        digit(ack.return_code),
    ]
}

/// A line of the text that the sensor prints when it starts. The form beyond these marks is unconfirmed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BootLine<'a> {
    /// `App Init`: the program began.
    AppInit,
    /// `name: ...`
    Name(&'a str),
    /// `S/N: ...`
    SerialNumber(&'a str),
    /// `FW version: ...`
    Firmware(&'a str),
}

/// What a line of boot text says (without its CR or LF); `None` for any other text.
#[must_use]
pub fn decode_boot_line(line: &[u8]) -> Option<BootLine<'_>> {
    let text = core::str::from_utf8(line).ok()?;
    let after = |mark: &str| text.split_once(mark).map(|(_, rest)| rest.trim());
    if text.contains("App Init") {
        return Some(BootLine::AppInit);
    }
    after("FW version:")
        .map(BootLine::Firmware)
        .or_else(|| after("S/N:").map(BootLine::SerialNumber))
        .or_else(|| after("name:").map(BootLine::Name))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::{assert_flipped_bits_refused, assert_prefixes_incomplete, hex};

    // hardware.md 2.1, golden vectors: computed from the maker's layout.
    const STILL: &str = "AA 00 00 00 00 80 3F 00 00 00 C0 00 00 60 40 CD CC CC 3D CD CC 4C BE 9A 99 99 3E \
                         40 42 0F 00 00 00 C8 41 CB E7";
    const OVERRANGE: &str = "AA 02 00 00 00 20 41 00 00 A0 41 00 00 F0 C1 00 00 00 3F 00 00 80 BE 00 00 00 3E \
                             FF FF FF FF 00 00 FC 41 E9 2B";

    fn still() -> Sample {
        Sample {
            status: Status(0),
            force: [1.0, -2.0, 3.5],
            torque: [0.1, -0.2, 0.3],
            timestamp_us: 1_000_000,
            temperature_celsius: 25.0,
        }
    }

    #[test]
    fn golden_bytes_decode_and_encode() {
        let overrange = Sample {
            status: Status(Status::OVERRANGE),
            force: [10.0, 20.0, -30.0],
            torque: [0.5, -0.25, 0.125],
            timestamp_us: u32::MAX,
            temperature_celsius: 31.5,
        };
        let zero = Sample {
            status: Status(0),
            force: [0.0; 3],
            torque: [0.0; 3],
            timestamp_us: 0,
            temperature_celsius: 0.0,
        };
        let mut all_zero = vec![0; FRAME_LEN];
        all_zero[0] = HEADER;
        all_zero[35..].copy_from_slice(&[0x6A, 0xE2]);
        for (bytes, sample) in [
            (hex(STILL), still()),
            (hex(OVERRANGE), overrange),
            (all_zero, zero),
        ] {
            assert_eq!(
                decode(&bytes),
                Ok(Parsed::Complete {
                    value: sample,
                    used: FRAME_LEN
                })
            );
            assert_eq!(encode(&sample).as_slice(), bytes);
        }
    }

    #[test]
    fn every_prefix_is_incomplete() {
        assert_prefixes_incomplete(&hex(STILL), decode);
        assert_prefixes_incomplete(b"r,0,C,0", decode_ack);
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        assert_flipped_bits_refused(&hex(STILL), decode);
        assert_flipped_bits_refused(&hex(OVERRANGE), decode);
    }

    #[test]
    fn a_force_that_is_not_finite_is_refused_although_the_crc_is_right() {
        let nan_force = Sample {
            force: [0.0, f32::NAN, 0.0],
            ..still()
        };
        assert_eq!(
            decode(&encode(&nan_force)),
            Err(DecodeError::NotFinite { name: "force" })
        );
        let endless_torque = Sample {
            torque: [f32::INFINITY, 0.0, 0.0],
            ..still()
        };
        assert_eq!(
            decode(&encode(&endless_torque)),
            Err(DecodeError::NotFinite { name: "torque" })
        );
    }

    #[test]
    fn another_header_is_named() {
        assert_eq!(
            decode(&[0xAB]),
            Err(DecodeError::Field {
                name: "header",
                value: 0xAB
            })
        );
    }

    #[test]
    fn commands_read_as_the_maker_writes_them() {
        let text =
            |command: Command| String::from_utf8(command.text().as_bytes().to_vec()).unwrap();
        let filter = Filter {
            sinc_length: 256,
            chop: false,
            fast: false,
            fir_disable: true,
        };
        let setup = Command::CommSetup {
            temperature_compensation: false,
            calibration: true,
            baud: BaudRate::Bps460800,
        };
        assert_eq!(text(Command::Config), "C");
        assert_eq!(text(Command::Run), "R");
        assert_eq!(text(Command::Init), "I");
        assert_eq!(text(Command::HardwareReset), "#");
        assert_eq!(text(Command::Save), "s");
        assert_eq!(text(setup), "c,0,1,0,4");
        assert_eq!(text(Command::Filter(filter)), "f,256,0,0,1");
    }

    #[test]
    fn acks_decode_and_a_foreign_letter_is_refused() {
        let ack = Ack {
            digit: 0,
            command: b'f',
            return_code: 3,
        };
        assert_eq!(
            decode_ack(b"r,0,f,3\r\n"),
            Ok(Parsed::Complete {
                value: ack,
                used: 7
            })
        );
        assert_eq!(encode_ack(ack), *b"r,0,f,3");
        assert_eq!(
            decode_ack(b"r;"),
            Err(DecodeError::Field {
                name: "ack",
                value: u32::from(b';')
            })
        );
    }

    #[test]
    fn boot_text_says_who_is_there() {
        assert_eq!(decode_boot_line(b"App Init"), Some(BootLine::AppInit));
        assert_eq!(
            decode_boot_line(b"name: BFT-SENS-SER-M8"),
            Some(BootLine::Name("BFT-SENS-SER-M8"))
        );
        assert_eq!(
            decode_boot_line(b"S/N: 000123"),
            Some(BootLine::SerialNumber("000123"))
        );
        assert_eq!(
            decode_boot_line(b"FW version: 1.2.3"),
            Some(BootLine::Firmware("1.2.3"))
        );
        assert_eq!(decode_boot_line(b"c,0,1,0,4"), None);
        assert_eq!(decode_boot_line(&[0xFF, b'S']), None);
    }

    #[test]
    fn only_known_baud_rates_have_a_code() {
        assert_eq!(BaudRate::from_bps(460_800).map(BaudRate::code), Some(4));
        assert_eq!(BaudRate::from_bps(9_600).map(BaudRate::code), Some(0));
        assert_eq!(BaudRate::from_bps(921_600), None);
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = decode(&bytes);
            let _ = decode_ack(&bytes);
            let _ = decode_boot_line(&bytes);
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(
            status: u16, counts in any::<[i16; 6]>(), timestamp_us: u32, temperature in -40.0..120.0_f32,
        ) {
            let [fx, fy, fz, tx, ty, tz] = counts.map(|count| f32::from(count) * 0.01);
            let sample = Sample {
                status: Status(status),
                force: [fx, fy, fz],
                torque: [tx, ty, tz],
                timestamp_us,
                temperature_celsius: temperature,
            };
            prop_assert_eq!(decode(&encode(&sample)), Ok(Parsed::Complete { value: sample, used: FRAME_LEN }));
        }
    }
}
