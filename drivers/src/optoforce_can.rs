//! OptoForce / OnRobot HEX sensors on CAN, 1 Mbit/s.
//!
//! A packet comes in payloads of 8 bytes and a shorter last one, all with the data id and nothing that numbers them. A payload
//! that begins a packet begins it anew; the next ones must have the length that their place asks for and be stamped within
//! [`Config::joining_timeout`] of the first, and the packet's sum must be right. What does not join is one refused frame; a
//! payload without a beginning is skipped.
//!
//! Set-up, scale, sign, gaps: [`crate::optoforce`]. The stamp of a sample is its last payload's arrival.

use std::time::Duration;

use ft_wire::optoforce_hex::{self as wire, Packet};
use ft_wire::{CanFrame, Chunk, DecodeError, HostTime, Parsed};

use crate::device::{Counted, Device};
use crate::link::RxStamps;
use crate::optoforce::{self, Protocol};
use crate::reading::{Counts, Reading};

/// Bit rate of the bus, bit/s.
pub const BITRATE_BPS: u32 = 1_000_000;

/// How to find and set up the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// What both buses share: rate, filter, scale, sign, timeouts.
    pub sensor: optoforce::Config,
    /// Id of the sensor's payloads. Factory 0x100.
    pub data_id: u16,
    /// Id of payloads to the sensor. Factory 0x101; another driver uses 0x111.
    pub command_id: u16,
    /// Longest time between the stamps of a packet's first and last payload. Default 5 ms; on the wire it is 0.3 ms.
    pub joining_timeout: Duration,
}

impl Config {
    /// The factory's ids.
    #[must_use]
    pub const fn new(sensor: optoforce::Config) -> Self {
        Self {
            sensor,
            data_id: 0x100,
            command_id: 0x101,
            joining_timeout: Duration::from_millis(5),
        }
    }
}

/// The driver.
#[derive(Debug)]
pub struct OptoforceCan {
    config: Config,
    protocol: Protocol,
    joined: Joined,
    /// The rest of a command that takes more than one frame.
    outgoing: Chunk,
    refused: u64,
    skipped: u64,
}

/// The payloads of a packet so far.
#[derive(Debug, Default)]
struct Joined {
    bytes: [u8; wire::MAX_LEN],
    len: usize,
    first_at: HostTime,
}

impl Joined {
    fn add(&mut self, payload: &[u8]) -> bool {
        let Some(room) = self.bytes.get_mut(self.len..self.len + payload.len()) else {
            return false;
        };
        room.copy_from_slice(payload);
        self.len += payload.len();
        true
    }

    fn decode(&self) -> Result<Parsed<Packet>, DecodeError> {
        wire::decode(self.bytes.get(..self.len).unwrap_or_default())
    }
}

impl OptoforceCan {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let checks = "check bit rate (1 Mbit/s), termination, power and the ids";
        Self {
            protocol: Protocol::new(config.sensor, checks),
            config,
            joined: Joined::default(),
            outgoing: Chunk::default(),
            refused: 0,
            skipped: 0,
        }
    }

    /// Counts a packet that is lost to us, once samples flow.
    fn refuse(&mut self) {
        self.joined.len = 0;
        self.refused += u64::from(self.protocol.is_streaming());
    }

    fn skip(&mut self) {
        self.skipped += u64::from(self.protocol.is_streaming());
    }

    fn on_payload(&mut self, payload: &[u8], at: HostTime) -> Result<(), DecodeError> {
        let begins = wire::decode(payload).is_ok() && payload.len() >= 4;
        if self.joined.len > 0 {
            let late = at.saturating_since(self.joined.first_at) > self.config.joining_timeout;
            if begins || late {
                self.refuse();
            }
        }
        if self.joined.len == 0 {
            if !begins {
                self.skip();
                return Ok(());
            }
            self.joined.first_at = at;
        }
        if !self.joined.add(payload) {
            let got = self.joined.len + payload.len();
            self.refuse();
            return Err(DecodeError::Length {
                expected: wire::MAX_LEN,
                got,
            });
        }
        match self.joined.decode() {
            Ok(Parsed::Complete { value, used }) if self.ends_at(used, payload.len()) => {
                self.joined.len = 0;
                self.protocol.on_packet(value, at);
                Ok(())
            }
            Ok(Parsed::Incomplete) if payload.len() == 8 => Ok(()),
            Ok(_) => {
                self.refuse();
                Err(DecodeError::Length {
                    expected: 8,
                    got: payload.len(),
                })
            }
            Err(error) => {
                self.refuse();
                Err(error)
            }
        }
    }

    /// Whether a packet of `used` bytes ends with the payload that came last: nothing behind it but padding to 8 bytes.
    fn ends_at(&self, used: usize, last: usize) -> bool {
        let before = self.joined.len - last;
        used > before && (self.joined.len == used || last == 8)
    }
}

impl Device for OptoforceCan {
    type Frame = CanFrame;
    type Reading = Reading;

    fn handle_frame(&mut self, frame: &CanFrame, stamps: RxStamps) -> Result<(), DecodeError> {
        let ours = !frame.is_extended() && frame.arbitration_id() == u32::from(self.config.data_id);
        if !ours {
            self.skip();
            return Ok(());
        }
        self.protocol.on_traffic(stamps.arrival);
        self.on_payload(frame.payload(), stamps.arrival)
    }

    fn handle_timeout(&mut self, now: HostTime) {
        let was_streaming = self.protocol.is_streaming();
        self.protocol.handle_timeout(now);
        if !self.protocol.is_streaming() {
            let left = core::mem::take(&mut self.joined.len) > 0;
            self.refused += u64::from(was_streaming && left);
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.protocol.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<CanFrame> {
        if self.outgoing.as_slice().is_empty() {
            self.outgoing = wire::encode_command(self.protocol.poll_transmit()?);
        }
        let bytes = self.outgoing.as_slice();
        let mut payload = [0; 8];
        payload
            .iter_mut()
            .zip(bytes)
            .for_each(|(slot, byte)| *slot = *byte);
        self.outgoing = Chunk::take_from(bytes.get(8..).unwrap_or_default()).0;
        CanFrame::standard(self.config.command_id, &payload)
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.protocol.poll_reading()
    }
}

impl Counted for OptoforceCan {
    fn counts(&self) -> Counts {
        Counts {
            refused: self.refused,
            skipped: self.skipped,
            ..self.protocol.counts()
        }
    }
}

#[cfg(test)]
mod tests;
