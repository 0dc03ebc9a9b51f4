//! Leptrino CFS and PFS sensors on USB (CDC).
//!
//! ```text
//! stop -> Drain (quiet) -> product -> limits -> start -> Streaming
//! ```
//!
//! The answer to Start is the very bytes of Start: an echoing line looks like a sensor, so only what comes after the drain is an
//! answer, and only samples make the stream. Scale comes from the sensor: raw counts are ten-thousandths of its rated limits. The
//! sensor's own filter is not touched, because it wants power off and on after a change.
//!
//! **Sign**: unconfirmed on hardware; taken as environment on tool, [`Config::sign`] changes that.
//!
//! **Gaps**: samples have neither counter nor clock; one lost as a whole leaves no trace and is not counted.
//!
//! # Source
//! hardware.md 2.6, see [`ft_wire::leptrino`].

use std::time::Duration;

use ft_wire::leptrino::{self as wire, COUNTS_AT_LIMIT, Command, Message, Sample, Status};
use ft_wire::{Chunk, DecodeError, HostTime, Wrench};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::options::{Sign, Startup};
use crate::reading::{Counts, DeviceEvent, Identity, Reading, SampleInstant, WrenchReading};
use crate::stages::{Due, Stages, Timing, quality};

/// Bit rate of the line, bit/s; a USB CDC port ignores it.
pub const BAUD_BPS: u32 = 460_800;

/// How to set the sensor up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Rated limits, N and N m, for a sensor that is only listened to; one that is set up says them itself. Default none.
    pub limits: Option<[f64; 6]>,
    /// Which side's wrench the sensor reports. Default environment on tool; unconfirmed on hardware.
    pub sign: Sign,
    /// Set the sensor up, or only listen. Default set up.
    pub startup: Startup,
    /// Longest wait for an answer, of three attempts. Default 300 ms.
    pub answer_timeout: Duration,
    /// Silence after which the stream counts as lost. Default 500 ms.
    pub silence_timeout: Duration,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            limits: None,
            sign: Sign::default(),
            startup: Startup::default(),
            answer_timeout: Duration::from_millis(300),
            silence_timeout: Duration::from_millis(500),
            retry_after: Duration::from_secs(1),
        }
    }
}

/// The driver.
#[derive(Debug)]
pub struct Leptrino {
    config: Config,
    stages: Stages<Command>,
    framer: Framer,
    limits: Option<[f64; 6]>,
}

impl Leptrino {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let timing = Timing {
            startup: config.startup,
            quiet: Duration::from_millis(50),
            drain_limit: Duration::from_millis(500),
            answer_timeout: config.answer_timeout,
            silence_timeout: config.silence_timeout,
            retry_after: config.retry_after,
        };
        Self {
            config,
            stages: Stages::new(timing, Some(Command::Stop), "check cable, power and port"),
            framer: Framer::new(),
            limits: config.limits,
        }
    }

    fn on_message(&mut self, message: &Message, at: HostTime) {
        match *message {
            Message::Product {
                model,
                serial_number,
                firmware,
            } if self.stages.awaits(Command::ReadProduct) => {
                let identity = Identity {
                    model: shown(&model),
                    serial_number: shown(&serial_number),
                    firmware: shown(&firmware),
                };
                self.stages.tell(DeviceEvent::Identified(identity), at);
                self.stages.ask(Command::ReadLimits, at);
            }
            // A recording of a sensor that was set up holds its limits.
            Message::Limits(limits) => {
                self.limits = Some(limits.map(f64::from));
                let [fx, fy, fz, tx, ty, tz] = limits;
                let scale = vec![
                    ("rated_force_n", format!("{fx} {fy} {fz}")),
                    ("rated_torque_nm", format!("{tx} {ty} {tz}")),
                ];
                self.stages.tell(DeviceEvent::Scale(scale), at);
                if self.stages.awaits(Command::ReadLimits) {
                    self.stages.ask(Command::Start, at);
                }
            }
            Message::Sample(sample) if sample.streamed => self.on_sample(&sample, at),
            Message::Done { number, result } if result != 0 => self.on_refusal(number, result, at),
            // An answer to Start says no more than the samples; a refused frame is sent again when its time is over.
            Message::Done { .. }
            | Message::Refused
            | Message::Product { .. }
            | Message::Sample(_) => {}
        }
    }

    fn on_refusal(&mut self, number: u8, result: u8, at: HostTime) {
        let asked = [
            (0x2A, Command::ReadProduct),
            (0x2B, Command::ReadLimits),
            (0x32, Command::Start),
        ];
        let ours = asked
            .into_iter()
            .find(|(known, command)| *known == number && self.stages.awaits(*command));
        if let Some((_, command)) = ours {
            let meaning = match result {
                1 => "wrong length",
                2 => "unknown command",
                3 => "wrong value",
                4 => "not in this state",
                _ => "unknown error",
            };
            self.stages.lose(
                format!("the sensor refused {command:?}: {meaning} ({result})"),
                at,
            );
        }
    }

    fn on_sample(&mut self, sample: &Sample, arrival: HostTime) {
        let Some(limits) = self.limits else {
            // Counts without a scale are no wrench; only listening can bring them.
            return;
        };
        if !self.stages.admits_sample(Some(Command::Start), arrival) {
            return;
        }
        self.framer.begin_counting();
        self.warn_of(sample.status, arrival);
        let mut wrench = [0.0; 6];
        for ((value, raw), limit) in wrench.iter_mut().zip(sample.raw).zip(limits) {
            *value = f64::from(raw) * limit / COUNTS_AT_LIMIT;
        }
        let status = sample.status;
        self.stages.deliver(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: None,
            },
            wrench: self.config.sign.apply(Wrench::from_array(wrench)),
            temperature_celsius: None,
            quality: quality(
                status.has(Status::BAD_CORRECTION | Status::SENSOR_ERROR),
                status.has(Status::OVER_RATING),
            ),
            status_bits: status.0.into(),
        }));
    }

    fn warn_of(&mut self, status: Status, at: HostTime) {
        let fresh = self.stages.fresh_bits(status.0.into());
        for (bit, text) in [
            (
                Status::BAD_CORRECTION,
                "the correction data in the sensor is bad: values are invalid",
            ),
            (
                Status::SENSOR_ERROR,
                "the sensor is in trouble: values are invalid",
            ),
            (
                Status::OVER_RATING,
                "beyond the rated load: unload the sensor",
            ),
        ] {
            if fresh & u32::from(bit) != 0 {
                self.stages
                    .warn(format!("status {:#04x}: {text}", status.0), at);
            }
        }
    }
}

fn shown(text: &[u8]) -> String {
    String::from_utf8_lossy(text)
        .trim_matches(['\0', ' '])
        .to_owned()
}

impl Device for Leptrino {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        self.stages.on_traffic(stamps.arrival);
        self.framer.push(chunk);
        loop {
            match self.framer.next(wire::decode, |_| ()) {
                Found::Frame(message) => {
                    self.stages.tell_missing(self.framer.take_missing());
                    self.on_message(&message, stamps.arrival);
                }
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => return first_error,
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        match self.stages.handle_timeout(now) {
            Due::Began if self.config.startup == Startup::Configure => self.limits = None,
            Due::Drained => {
                self.framer.clear();
                self.stages.ask(Command::ReadProduct, now);
            }
            _ => {}
        }
        if !self.stages.is_streaming() {
            // What stands there is left from before a pause.
            self.framer.clear();
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.stages.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        Some(wire::encode_command(self.stages.poll_transmit()?))
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.stages.poll_reading()
    }
}

impl Counted for Leptrino {
    fn counts(&self) -> Counts {
        Counts {
            received: self.stages.received(),
            refused: self.framer.refused,
            skipped: self.framer.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
