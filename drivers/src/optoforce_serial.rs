//! OptoForce / OnRobot HEX sensors on USB (CDC) or UART, 1 Mbit/s 8N1.
//!
//! Set-up, scale, sign, gaps: [`crate::optoforce`]. Every sample that a chunk completes gets the chunk's arrival; the sensor's
//! counter in `device_ns` tells them apart.

use ft_wire::optoforce_hex as wire;
use ft_wire::{Chunk, DecodeError, HostTime};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::optoforce::{Config, Protocol};
use crate::reading::{Counts, Reading};

/// Bit rate of the line, bit/s; a USB CDC port ignores it.
pub const BAUD_BPS: u32 = 1_000_000;

/// The driver.
#[derive(Debug)]
pub struct OptoforceSerial {
    protocol: Protocol,
    framer: Framer,
}

impl OptoforceSerial {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            protocol: Protocol::new(config, "check bit rate (1000000), cable and power"),
            framer: Framer::new(),
        }
    }
}

impl Device for OptoforceSerial {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        self.protocol.on_traffic(stamps.arrival);
        self.framer.push(chunk);
        loop {
            match self.framer.next(wire::decode, |_| ()) {
                Found::Frame(packet) => {
                    self.protocol.on_packet(packet, stamps.arrival);
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
        Some(wire::encode_command(self.protocol.poll_transmit()?))
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.protocol.poll_reading()
    }
}

impl Counted for OptoforceSerial {
    fn counts(&self) -> Counts {
        Counts {
            refused: self.framer.refused,
            skipped: self.framer.skipped,
            ..self.protocol.counts()
        }
    }
}

#[cfg(test)]
mod tests;
