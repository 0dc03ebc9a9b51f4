//! Robotous RFT sensors on a serial line (RS-232, RS-422, RS-485, USB), 115 200 bit/s from the factory.
//!
//! Set-up, scale, sign, gaps: [`crate::robotous`]. The bit rate limits the output rate by the manual's table; beyond it
//! a warning names both and the sensor decides. Every frame that a chunk completes gets the chunk's arrival, so the
//! earlier of several frames look late by up to the chunk's length, and there is no sensor clock to tell.
//!
//! A packet is protected by a sum only ([`ft_wire::robotous_rft`] says what it cannot see).

use ft_wire::robotous_rft as wire;
use ft_wire::{Chunk, DecodeError, HostTime};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::reading::{Counts, Reading};
use crate::robotous::{self, Protocol};

const CHECKS: &str = "check bit rate (the factory's is 115200), cable and power";

/// How to set the sensor up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// What both buses share: rate, filter, scale, sign, timeouts.
    pub sensor: robotous::Config,
    /// Bit rate at which the line is open, bit/s. Default 115 200. The sensor's own is changed with the maker's tool.
    pub baud_bps: u32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            sensor: robotous::Config::default(),
            baud_bps: 115_200,
        }
    }
}

/// The driver.
#[derive(Debug)]
pub struct RobotousUart {
    protocol: Protocol,
    framer: Framer,
}

impl RobotousUart {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let mut protocol = Protocol::new(config.sensor, CHECKS);
        protocol.warn_at_start(too_fast(&config));
        Self {
            protocol,
            framer: Framer::new(),
        }
    }
}

fn too_fast(config: &Config) -> Option<String> {
    let (baud, rate) = (config.baud_bps, config.sensor.rate_hz);
    match wire::max_rate_hz_at(baud) {
        None => Some(format!(
            "baud_bps = {baud} is none of the sensor's bit rates"
        )),
        Some(max) if rate > max => Some(format!(
            "rate_hz = {rate} is more than the {max} Hz that the manual allows at {baud} bit/s"
        )),
        Some(_) => None,
    }
}

impl Device for RobotousUart {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        self.protocol.on_traffic(stamps.arrival);
        self.framer.push(chunk);
        loop {
            match self.framer.next(wire::decode_response, |_| ()) {
                Found::Frame(response) => {
                    self.protocol.tell_missing(self.framer.take_missing());
                    self.protocol.on_response(response, stamps.arrival);
                    if self.protocol.is_streaming() {
                        self.framer.begin_counting();
                    }
                }
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => return first_error,
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        self.protocol.handle_timeout(now);
        if !self.protocol.is_streaming() {
            // What stands there is left from before a pause.
            self.framer.clear();
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.protocol.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        Some(Chunk::take_from(&wire::encode_command(self.protocol.poll_transmit()?)).0)
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.protocol.poll_reading()
    }
}

impl Counted for RobotousUart {
    fn counts(&self) -> Counts {
        Counts {
            received: self.protocol.received(),
            refused: self.framer.refused,
            skipped: self.framer.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
