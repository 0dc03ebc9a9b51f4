//! Robotous RFT sensors on CAN, 1 Mbit/s.
//!
//! A response is two frames; they carry nothing that says they belong together. The second half must be the next frame
//! of the sensor and be stamped within [`Config::pairing_timeout`]. Two different first halves in a row may be a lost second half,
//! or one that was overtaken on a crowded bus, where the lower id goes first: nobody can tell whose the next second half is, so
//! both samples are refused. The same first half twice is skipped once. A first half without its second is one refused frame,
//! counted when the stream is lost. A second half without a first is skipped; unless its sample was refused already, or it is the half before
//! once more, its first half was lost, which is a gap. A host that reads late loses nothing, because only
//! stamps are compared.
//!
//! **Two frames lost in a row** can leave a first half and the second half of the next sample, a period behind it. A second half that
//! was merely stamped late looks the same until the next first halves come: behind a late one the n-th comes n periods after the first half,
//! or the first right behind it; behind a wrong one the n-th is due n + 1 periods after the first half, and none comes early. So
//! halves further apart than four fifths of a period (by the configured rate) wait, and the samples after them, until one of the next
//! [`FIRSTS`] first halves comes a quarter of a period before it is due behind a wrong one, or the first within half a period. What is not
//! borne out, or still waits when the stream is lost, is refused, as two samples; what waits when nobody reads any more is neither
//! received nor refused. What this cannot see: two frames lost in a row while one of the halves that are left is late, too, by a quarter
//! of a period or more.
//!
//! Set-up, scale, sign, gaps: [`crate::robotous`]. The stamp of a sample is the second frame's arrival.

use std::time::Duration;

pub use ft_wire::robotous_rft::CanIds;
use ft_wire::robotous_rft::{self as wire, Half, Response};
use ft_wire::{CanFrame, DecodeError, HostTime};

use crate::device::{Counted, Device};
use crate::link::RxStamps;
use crate::reading::{Counts, Reading};
use crate::robotous::{self, Protocol};

/// Bit rate of the bus, bit/s; the sensor has no other.
pub const BITRATE_BPS: u32 = 1_000_000;

const CHECKS: &str = "check bit rate (1 Mbit/s), termination, power and the ids";

/// How to find and set up the sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// What both buses share: rate, filter, scale, sign, timeouts.
    pub sensor: robotous::Config,
    /// CAN ids. Default 0x64 to the sensor, 0x01 and 0x02 from it.
    pub ids: CanIds,
    /// Longest time between the stamps of the halves of a response. Default 5 ms; on the wire it is 0.13 ms.
    pub pairing_timeout: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            sensor: robotous::Config::default(),
            ids: CanIds::default(),
            pairing_timeout: Duration::from_millis(5),
        }
    }
}

/// The driver.
#[derive(Debug)]
pub struct RobotousCan {
    config: Config,
    protocol: Protocol,
    first: Option<([u8; 8], HostTime)>,
    doubted: Option<Doubted>,
    /// The second half before.
    second: Option<([u8; 8], HostTime)>,
    /// Second halves that may still come of samples that were refused.
    orphans: Orphans,
    gaps: u64,
    refused: u64,
    skipped: u64,
}

/// What halves of two samples cost.
const OF_TWO: u64 = 2;

/// Second halves that wait for nobody.
#[derive(Clone, Copy, Debug, Default)]
struct Orphans {
    left: u64,
    until: HostTime,
}

impl Orphans {
    /// Whether a half that comes alone is one of them.
    fn take(&mut self, at: HostTime) -> bool {
        let is_one = self.left > 0 && at < self.until;
        self.left = if is_one { self.left - 1 } else { 0 };
        is_one
    }
}

/// Halves that may be of two samples, until the next first halves tell.
#[derive(Clone, Copy, Debug)]
struct Doubted {
    response: Response,
    first_at: HostTime,
    second_at: HostTime,
    /// First halves that came since.
    firsts: u32,
    /// Responses that came since and wait for their turn.
    behind: [Option<(Response, HostTime)>; FIRSTS as usize],
}

/// So many first halves may bear out halves that are in doubt.
const FIRSTS: u32 = 4;

impl RobotousCan {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let protocol = Protocol::new(config.sensor, CHECKS);
        Self {
            config,
            protocol,
            first: None,
            doubted: None,
            second: None,
            orphans: Orphans::default(),
            gaps: 0,
            refused: 0,
            skipped: 0,
        }
    }

    /// Counts samples that are lost to us, once they flow.
    fn refuse(&mut self, samples: u64) {
        if self.protocol.is_streaming() {
            self.refused += samples;
            self.tell_missing(samples);
        }
    }

    /// So many samples are missing behind what came so far, doubted or not.
    fn tell_missing(&mut self, samples: u64) {
        self.end_doubt(false);
        self.protocol.tell_missing(samples);
    }

    /// A second half came alone.
    fn on_orphan(&mut self, second: [u8; 8], at: HostTime) {
        if !self.protocol.is_streaming() {
            return;
        }
        self.skipped += 1;
        let again = self.second.is_some_and(|(before, before_at)| {
            before == second && at.saturating_since(before_at) < self.period() / 2
        });
        if !self.orphans.take(at) && !again {
            self.gaps += 1;
            self.tell_missing(1);
        }
    }

    fn on_first(&mut self, data: [u8; 8], at: HostTime) {
        self.protocol.on_traffic(at);
        if self.first.is_some_and(|(before, _)| before == data) {
            self.skipped += u64::from(self.protocol.is_streaming());
            return;
        }
        self.settle(at);
        match self.first {
            Some((_, before_at))
                if at.saturating_since(before_at) <= self.config.pairing_timeout =>
            {
                self.first = None;
                self.expect_orphans(OF_TWO, at);
                self.refuse(OF_TWO);
            }
            Some(_) => {
                self.refuse(1);
                self.first = Some((data, at));
            }
            None => {
                self.orphans = Orphans::default();
                self.first = Some((data, at));
            }
        }
    }

    fn on_second(&mut self, second: [u8; 8], at: HostTime) -> Result<(), DecodeError> {
        let Some((first, first_at)) = self.first.take() else {
            self.on_orphan(second, at);
            return Ok(());
        };
        let apart = at.saturating_since(first_at);
        if apart > self.config.pairing_timeout {
            self.refuse(1);
            if self.may_be_of_two(apart) {
                self.on_orphan(second, at);
            } else {
                self.skipped += u64::from(self.protocol.is_streaming());
            }
            self.second = Some((second, at));
            return Ok(());
        }
        self.second = Some((second, at));
        match wire::join(first, second) {
            Ok(response) => {
                self.on_response(response, first_at, at);
                Ok(())
            }
            Err(error) => {
                self.refuse(1);
                Err(error)
            }
        }
    }

    /// Takes a response, unless its halves, or those before it, may be of two.
    fn on_response(&mut self, response: Response, first_at: HostTime, second_at: HostTime) {
        let apart = second_at.saturating_since(first_at);
        // Answers of the set-up come alone, and wait for nothing.
        let is_sample = matches!(response, Response::Stream(_));
        if is_sample && self.may_be_of_two(apart) {
            self.end_doubt(false);
            self.doubted = Some(Doubted {
                response,
                first_at,
                second_at,
                firsts: 0,
                behind: [None; FIRSTS as usize],
            });
            return;
        }
        let waits = self.doubted.as_mut().filter(|_| is_sample);
        match waits.and_then(|doubted| doubted.behind.iter_mut().find(|slot| slot.is_none())) {
            Some(slot) => *slot = Some((response, second_at)),
            None => {
                self.end_doubt(false);
                self.protocol.on_response(response, second_at);
            }
        }
    }

    /// The next first half came `at`: it may tell that the halves in doubt were of one sample.
    fn settle(&mut self, at: HostTime) {
        let period = self.period();
        let Some(doubted) = &mut self.doubted else {
            return;
        };
        doubted.firsts += 1;
        let since = at.saturating_since(doubted.first_at);
        let early = since < period * doubted.firsts + period * 3 / 4;
        let right_behind =
            doubted.firsts == 1 && at.saturating_since(doubted.second_at) < period / 2;
        if early || right_behind {
            self.end_doubt(true);
        } else if doubted.firsts == FIRSTS {
            self.end_doubt(false);
        }
    }

    /// Takes the halves in doubt as one sample or refuses them as two, and takes what waits behind them.
    fn end_doubt(&mut self, are_of_one: bool) {
        let Some(doubted) = self.doubted.take() else {
            return;
        };
        if are_of_one {
            self.protocol
                .on_response(doubted.response, doubted.second_at);
        } else {
            self.refuse(OF_TWO);
        }
        for (response, at) in doubted.behind.into_iter().flatten() {
            self.protocol.on_response(response, at);
        }
    }

    /// Whether halves so far apart may be of two samples.
    fn may_be_of_two(&self, apart: Duration) -> bool {
        apart > self.period() * 4 / 5
    }

    fn expect_orphans(&mut self, left: u64, at: HostTime) {
        let until = at + self.period() * 4 / 5;
        self.orphans = Orphans { left, until };
    }

    /// Time between two samples: the set-up has seen to it that the sensor has the configured rate.
    fn period(&self) -> Duration {
        Duration::from_secs(1) / u32::from(self.config.sensor.rate_hz.max(1))
    }
}

impl Device for RobotousCan {
    type Frame = CanFrame;
    type Reading = Reading;

    fn handle_frame(&mut self, frame: &CanFrame, stamps: RxStamps) -> Result<(), DecodeError> {
        let at = stamps.arrival;
        match wire::decode_half(self.config.ids, frame) {
            Ok(Half::First(data)) => {
                self.on_first(data, at);
                Ok(())
            }
            Ok(Half::Second(data)) => self.on_second(data, at),
            // Another device's frame on the same bus.
            Err(DecodeError::Field { .. }) => {
                self.skipped += u64::from(self.protocol.is_streaming());
                Ok(())
            }
            Err(error) => {
                // Ours, but too short: whatever waited for it is lost with it.
                if self.first.take().is_some() {
                    self.orphans = Orphans::default();
                    self.refuse(1);
                } else if !self.orphans.take(at) {
                    self.expect_orphans(1, at);
                    self.refuse(1);
                }
                Err(error)
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        let was_streaming = self.protocol.is_streaming();
        self.protocol.handle_timeout(now);
        if was_streaming && !self.protocol.is_streaming() {
            self.refused += u64::from(self.first.take().is_some());
            self.refused += self.doubted.take().map_or(0, |doubted| {
                OF_TWO + doubted.behind.iter().flatten().count() as u64
            });
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.protocol.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<CanFrame> {
        Some(wire::command_frame(
            self.config.ids,
            self.protocol.poll_transmit()?,
        ))
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.protocol.poll_reading()
    }
}

impl Counted for RobotousCan {
    fn counts(&self) -> Counts {
        Counts {
            received: self.protocol.received(),
            gaps: self.gaps,
            refused: self.refused,
            skipped: self.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
