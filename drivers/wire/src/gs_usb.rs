//! Host frames and control requests of candleLight adapters (gs_usb), classic CAN only.
//!
//! ```text
//! frame    0..4 echo id (0xFFFFFFFF: received) | 4..8 CAN id and flags | 8 DLC | 9 channel | 10 flags | 11 0 |
//!          12..20 data | 20..24 time stamp, us (only where the mode asked for stamps)
//! CAN id   bit 31 extended, bit 30 remote, bit 29 error frame (then bits 0..29 are error classes of linux/can/error.h)
//! flags    bit 0: the adapter lost frames before this one; bit 1: CAN FD
//! request  0 host format | 1 bit timing | 2 mode | 4 limits of bit timing | 5 device
//! ```
//!
//! All fields are little endian, which the host format asks for.
//!
//! # Source
//! `candle-usb/candleLight_fw: include/gs_usb.h, src/usbd_gs_can.c`; Linux `drivers/net/can/usb/gs_usb.c`; hardware.md 4.4. The maker's source and the
//! kernel's driver agree.

use crate::bytes::{Layout, field};
use crate::{CanFrame, DecodeError};

/// Vendor request to an interface, host to adapter.
pub const REQUEST_OUT: u8 = 0x41;
/// Vendor request to an interface, adapter to host.
pub const REQUEST_IN: u8 = 0xC1;

/// Numbers of the control requests.
pub mod request {
    /// The host's byte order.
    pub const HOST_FORMAT: u8 = 0;
    /// Bit timing of a channel.
    pub const BIT_TIMING: u8 = 1;
    /// Starts and stops a channel.
    pub const MODE: u8 = 2;
    /// What bit timings a channel takes, and its features.
    pub const LIMITS: u8 = 4;
    /// How many channels there are.
    pub const DEVICE: u8 = 5;
}

/// The word that tells the adapter the host's byte order, as little endian.
pub const HOST_FORMAT: [u8; 4] = [0xEF, 0xBE, 0x00, 0x00];
/// Feature: received frames carry a time stamp.
pub const FEATURE_TIME_STAMPS: u32 = 1 << 4;

/// Length of a frame without a time stamp; frames to the adapter have none.
pub const FRAME: usize = 20;
/// Length of a frame with a time stamp.
pub const STAMPED_FRAME: usize = 24;

const RECEIVED: u32 = 0xFFFF_FFFF;
const EXTENDED: u32 = 0x8000_0000;
const REMOTE: u32 = 0x4000_0000;
const ERROR: u32 = 0x2000_0000;
const CLASSES: u32 = 0x1FFF_FFFF;
const STANDARD: u32 = 0x7FF;
const LOST: u8 = 0x01;
const FD: u8 = 0x02;

/// Whether received frames carry a time stamp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stamps {
    /// 24 bytes a frame.
    Carried,
    /// 20 bytes a frame.
    Absent,
}

/// What a frame is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// A data frame came from the bus.
    Data(CanFrame),
    /// A frame of ours with this tag was sent and acknowledged.
    Sent(u32),
    /// A remote frame, which no device here uses.
    Remote,
    /// The controller reports errors of these classes (`linux/can/error.h`).
    Errors(u32),
}

/// A frame of the adapter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostFrame {
    /// Which CAN bus of the adapter, from 0.
    pub channel: u8,
    /// What it is about.
    pub content: Content,
    /// Whether the adapter lost frames before this one, for want of room.
    pub lost_before: bool,
    /// The adapter's clock when the frame came, us, wraps at 2^32 (71.6 min).
    pub time_us: Option<u32>,
}

impl HostFrame {
    /// Reads one transfer. Bytes behind the frame are padding.
    ///
    /// # Errors
    /// Too short, a DLC beyond 15, a CAN FD frame, or an id of more than 11 bits that is not marked extended.
    pub fn decode(bytes: &[u8], stamps: Stamps) -> Result<Self, DecodeError> {
        let expected = match stamps {
            Stamps::Carried => STAMPED_FRAME,
            Stamps::Absent => FRAME,
        };
        let short = DecodeError::Length {
            expected,
            got: bytes.len(),
        };
        let bytes = bytes.get(..expected).ok_or(short)?;
        let word = |at| field(bytes, at).map(u32::from_le_bytes).ok_or(short);
        let (echo_id, id) = (word(0)?, word(4)?);
        let [dlc, channel, flags, _] = field(bytes, 8).ok_or(short)?;
        let data: [u8; 8] = field(bytes, 12).ok_or(short)?;
        if flags & FD != 0 {
            let (name, value) = ("flags", u32::from(flags));
            return Err(DecodeError::Field { name, value });
        }
        // Of the DLCs of four bits, 9 to 15 mean 8 bytes.
        let payload = match dlc {
            0..=8 => data.get(..usize::from(dlc)).unwrap_or_default(),
            9..=15 => &data,
            _ => {
                let (name, value) = ("can_dlc", u32::from(dlc));
                return Err(DecodeError::Field { name, value });
            }
        };
        let content = if id & ERROR != 0 {
            Content::Errors(id & CLASSES)
        } else if echo_id != RECEIVED {
            Content::Sent(echo_id)
        } else if id & REMOTE != 0 {
            Content::Remote
        } else {
            Content::Data(data_frame(id, payload)?)
        };
        Ok(Self {
            channel,
            content,
            lost_before: flags & LOST != 0,
            time_us: match stamps {
                Stamps::Carried => Some(word(20)?),
                Stamps::Absent => None,
            },
        })
    }
}

fn data_frame(id: u32, payload: &[u8]) -> Result<CanFrame, DecodeError> {
    let frame = if id & EXTENDED != 0 {
        CanFrame::extended(id & CLASSES, payload)
    } else {
        let standard = u16::try_from(id).ok();
        standard.and_then(|id| CanFrame::standard(id, payload))
    };
    frame.ok_or(DecodeError::Field {
        name: "can_id",
        value: id,
    })
}

/// A frame to be sent on `channel`; the adapter gives `echo_id` back when it was acknowledged.
#[must_use]
pub fn encode(echo_id: u32, channel: u8, frame: &CanFrame) -> [u8; FRAME] {
    let id = frame.arbitration_id();
    let id = if frame.is_extended() {
        id | EXTENDED
    } else {
        id & STANDARD
    };
    let payload = frame.payload();
    let dlc = u8::try_from(payload.len()).unwrap_or(8);
    Layout::new()
        .put(&echo_id.to_le_bytes())
        .put(&id.to_le_bytes())
        .put(&[dlc, channel, 0, 0])
        .put(payload)
        .finish()
}

/// What starts a channel with these features of [`Limits::features`].
#[must_use]
pub fn start(features: u32) -> [u8; 8] {
    mode(1, features)
}

/// What takes a channel off the bus and forgets its errors.
#[must_use]
pub fn reset() -> [u8; 8] {
    mode(0, 0)
}

fn mode(mode: u32, features: u32) -> [u8; 8] {
    Layout::new()
        .put(&mode.to_le_bytes())
        .put(&features.to_le_bytes())
        .finish()
}

/// How many channels the adapter has, from its answer to [`request::DEVICE`].
///
/// # Errors
/// Not 12 bytes.
pub fn channels(answer: &[u8]) -> Result<u8, DecodeError> {
    match answer {
        [_, _, _, last, _, _, _, _, _, _, _, _] => Ok(last.saturating_add(1)),
        _ => Err(DecodeError::Length {
            expected: 12,
            got: answer.len(),
        }),
    }
}

/// What bit timings a channel takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bits of what it can do besides.
    pub features: u32,
    /// Clock of the CAN controller, Hz.
    pub clock_hz: u32,
    /// Least and most time quanta before the sample point, without the first.
    pub before: (u32, u32),
    /// Least and most time quanta behind the sample point.
    pub behind: (u32, u32),
    /// Most time quanta of a jump.
    pub jump: u32,
    /// Least and most of the clock's divisor, and its step.
    pub divisor: (u32, u32, u32),
}

/// Bit timing of a channel, in time quanta.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Propagation segment.
    pub propagation: u32,
    /// First phase segment, up to the sample point.
    pub phase_1: u32,
    /// Second phase segment.
    pub phase_2: u32,
    /// Most quanta by which a bit is moved to stay in step.
    pub jump: u32,
    /// Clock cycles in a quantum.
    pub divisor: u32,
}

impl BitTiming {
    /// For [`request::BIT_TIMING`].
    #[must_use]
    pub fn encode(&self) -> [u8; 20] {
        let mut layout = Layout::new();
        for part in [
            self.propagation,
            self.phase_1,
            self.phase_2,
            self.jump,
            self.divisor,
        ] {
            layout.put(&part.to_le_bytes());
        }
        layout.finish()
    }
}

/// Most time quanta in a bit that are looked at; the largest controllers take 385.
const MOST_QUANTA: u32 = 512;
/// A rate is refused when it can only be met worse than this, in parts of it.
const TOLERANCE: u64 = 1_000;

impl Limits {
    /// Reads the answer to [`request::LIMITS`].
    ///
    /// # Errors
    /// Not 40 bytes.
    pub fn decode(answer: &[u8]) -> Result<Self, DecodeError> {
        let wrong = DecodeError::Length {
            expected: 40,
            got: answer.len(),
        };
        if answer.len() != 40 {
            return Err(wrong);
        }
        let word = |number: usize| {
            field(answer, number * 4)
                .map(u32::from_le_bytes)
                .ok_or(wrong)
        };
        Ok(Self {
            features: word(0)?,
            clock_hz: word(1)?,
            before: (word(2)?, word(3)?),
            behind: (word(4)?, word(5)?),
            jump: word(6)?,
            divisor: (word(7)?, word(8)?, word(9)?),
        })
    }

    /// The timing for `bitrate_bps` with its sample point next to what CiA recommends: 87.5 % of a bit up to 500 kbit/s, 80 % up to
    /// 800 kbit/s, 75 % above. `None` when the clock cannot be divided so within 0.1 %.
    #[must_use]
    pub fn timing(&self, bitrate_bps: u32) -> Option<BitTiming> {
        let wanted = match bitrate_bps {
            0 => return None,
            1..=500_000 => 875,
            500_001..=800_000 => 800,
            _ => 750,
        };
        let clock = u64::from(self.clock_hz);
        let rate = u64::from(bitrate_bps);
        let mut best = None;
        for quanta in (3..=MOST_QUANTA).rev() {
            let per_divisor = rate * u64::from(quanta);
            let Ok(divisor) = u32::try_from((clock + per_divisor / 2) / per_divisor) else {
                continue;
            };
            let (least, most, step) = self.divisor;
            let in_steps = divisor
                .checked_sub(least)
                .is_some_and(|above| above.is_multiple_of(step.max(1)));
            let off = clock.abs_diff(per_divisor * u64::from(divisor));
            if divisor == 0 || divisor > most || !in_steps || off * TOLERANCE > clock {
                continue;
            }
            let Some((before, behind)) = self.split(quanta, wanted) else {
                continue;
            };
            let sample_point = (1 + before) * 1_000 / quanta;
            let cost = (off, sample_point.abs_diff(wanted));
            if best.is_none_or(|(least, _)| cost < least) {
                let timing = BitTiming {
                    propagation: before / 2,
                    phase_1: before - before / 2,
                    phase_2: behind,
                    jump: (behind / 2).clamp(1, self.jump.max(1)),
                    divisor,
                };
                best = Some((cost, timing));
            }
        }
        best.map(|(_, timing)| timing)
    }

    /// Quanta before and behind the sample point, next to `wanted` thousandths of a bit.
    fn split(&self, quanta: u32, wanted: u32) -> Option<(u32, u32)> {
        let ideal = (quanta * (1_000 - wanted) + 500) / 1_000;
        let most = (quanta - 1).checked_sub(self.before.0)?.min(self.behind.1);
        let least = (quanta - 1)
            .saturating_sub(self.before.1)
            .max(self.behind.0);
        (least <= most).then(|| {
            let behind = ideal.clamp(least, most);
            (quanta - 1 - behind, behind)
        })
    }
}

#[cfg(test)]
mod tests;
