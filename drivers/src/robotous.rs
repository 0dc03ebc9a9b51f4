//! Robotous RFT sensors: what the drivers for CAN and for a serial line share.
//!
//! ```text
//! Stop (not answered) -> Drain (quiet) -> model, serial number, firmware -> rate -> filter -> Start -> Streaming
//!      a question unanswered three times, or a stream that falls silent -> Lost -> wait -> Stop
//! ```
//!
//! Rate and filter are read first and written only when they differ: the sensor keeps them in EEPROM. The bias of the
//! sensor is never set; taring is done on the host.
//!
//! **Scale**: raw counts become N and N m by [`Scale`], which belongs to the model. When the model that the sensor names
//! has another scale by the manual than the configured one, a warning says both and the configured one is used.
//!
//! **Sign**: the manual at hand does not say on which side the wrench acts. The drivers take it as environment on tool
//! and flip nothing; [`Config::sign`] changes that. Unconfirmed on hardware.
//!
//! **Gaps**: a sample carries neither counter nor stamp, so a sample lost as a whole leaves no certain trace and is not counted.
//!
//! # Source
//! hardware.md 2.2, see [`ft_wire::robotous_rft`].

mod config;

use std::collections::VecDeque;
use std::time::Duration;

use ft_wire::robotous_rft::{
    self as wire, Command, FilterSetting, Outcome, Record, Response, Text,
};
use ft_wire::{HostTime, Wrench};

pub use config::{Config, Filter, Scale};

use crate::options::Startup;
use crate::reading::{DeviceEvent, Identity, Quality, Reading, SampleInstant, WrenchReading};

/// Silence that ends the draining of a stopped stream.
const QUIET: Duration = Duration::from_millis(50);
/// A stream that goes on after Stop is stopped again after this.
const DRAIN_LIMIT: Duration = Duration::from_millis(500);
/// How often a command is sent before the sensor counts as lost.
const ATTEMPTS: u8 = 3;

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Idle,
    Draining {
        quiet_at: HostTime,
        give_up_at: HostTime,
    },
    Asking {
        command: Command,
        attempt: u8,
        deadline: HostTime,
    },
    Listening(HostTime),
    Streaming(HostTime),
    Waiting(HostTime),
}

/// The protocol, whatever carries it: commands out, responses in.
#[derive(Debug)]
pub(crate) struct Protocol {
    config: Config,
    /// What to look at when nothing answers.
    checks: &'static str,
    warning_at_start: Option<String>,
    state: State,
    outgoing: Option<Command>,
    stops: u8,
    identity: Identity,
    warned: u8,
    frames_unread: u64,
    pub(crate) received: u64,
    readings: VecDeque<Reading>,
}

impl Protocol {
    pub(crate) fn new(config: Config, checks: &'static str) -> Self {
        Self {
            config,
            checks,
            warning_at_start: None,
            state: State::Idle,
            outgoing: None,
            stops: 0,
            identity: Identity::default(),
            warned: 0,
            frames_unread: 0,
            received: 0,
            readings: VecDeque::with_capacity(32),
        }
    }

    /// Something about the configuration that every start is to say.
    pub(crate) fn warn_at_start(&mut self, text: Option<String>) {
        self.warning_at_start = text;
    }

    pub(crate) const fn is_streaming(&self) -> bool {
        matches!(self.state, State::Streaming(_))
    }

    /// Something came that is no response: it shows that the bus lives.
    pub(crate) fn on_traffic(&mut self, at: HostTime) {
        self.frames_unread += 1;
        self.postpone_quiet(at);
    }

    fn postpone_quiet(&mut self, at: HostTime) {
        if let State::Draining { quiet_at, .. } = &mut self.state {
            *quiet_at = at + QUIET;
        }
    }

    pub(crate) fn on_response(&mut self, response: Response, at: HostTime) {
        self.postpone_quiet(at);
        match response {
            Response::Stream(record) => self.on_record(record, at),
            Response::Model(text) => {
                self.identity.model = shown(text);
                self.compare_scale(at);
                self.answered(Command::ReadModel, at);
            }
            Response::SerialNumber(text) => {
                self.identity.serial_number = shown(text);
                self.answered(Command::ReadSerialNumber, at);
            }
            Response::Firmware(text) => {
                self.identity.firmware = shown(text);
                self.tell(DeviceEvent::Identified(self.identity.clone()), at);
                self.answered(Command::ReadFirmware, at);
            }
            Response::Rate(code) => self.on_rate(code, at),
            Response::Filter(setting) => self.on_filter(setting, at),
            Response::RateSet(outcome) => {
                self.on_outcome(outcome, at, |asked| matches!(asked, Command::SetRate(_)));
            }
            Response::FilterSet(outcome) => {
                self.on_outcome(outcome, at, |asked| matches!(asked, Command::SetFilter(_)));
            }
            // Nothing here asks for these.
            Response::Once(_) | Response::OverloadCounters(_) => {}
        }
    }

    fn on_rate(&mut self, code: u8, at: HostTime) {
        if !self.awaits(Command::ReadRate) {
            return;
        }
        if wire::rate_hz(code) == Some(self.config.rate_hz) {
            return self.ask(Command::ReadFilter, at);
        }
        match wire::rate_code(self.config.rate_hz) {
            Some(wanted) => self.ask(Command::SetRate(wanted), at),
            None => self.lose(
                format!(
                    "rate_hz = {} is none of the sensor's rates",
                    self.config.rate_hz
                ),
                at,
            ),
        }
    }

    fn on_filter(&mut self, setting: FilterSetting, at: HostTime) {
        if !self.awaits(Command::ReadFilter) {
            return;
        }
        let wanted = match self.config.filter {
            Filter::Off => Some(FilterSetting::NONE),
            Filter::LowPass { cut_off_hz } => FilterSetting::low_pass(cut_off_hz),
        };
        match wanted {
            None => self.lose(
                format!("{:?} is none of the sensor's filters", self.config.filter),
                at,
            ),
            // Without filter the code means nothing.
            Some(wanted) if setting == wanted || (wanted.kind == 0 && setting.kind == 0) => {
                self.ask(Command::Start, at);
            }
            Some(wanted) => self.ask(Command::SetFilter(wanted), at),
        }
    }

    /// An answer to a setting; one to another setting than the one asked is left aside.
    fn on_outcome(&mut self, outcome: Outcome, at: HostTime, answers: fn(Command) -> bool) {
        let State::Asking { command, .. } = self.state else {
            return;
        };
        if !answers(command) {
            return;
        }
        if outcome.result == 1 {
            return self.answered(command, at);
        }
        self.lose(
            format!("the sensor refused {command:?}: {}", outcome.error_text()),
            at,
        );
    }

    fn on_record(&mut self, record: Record, arrival: HostTime) {
        match self.state {
            State::Streaming(_) => {}
            State::Asking {
                command: Command::Start,
                ..
            }
            | State::Listening(_) => {
                self.outgoing = None;
                self.tell(DeviceEvent::Streaming, arrival);
            }
            // A stream that is being stopped.
            _ => return,
        }
        self.state = State::Streaming(arrival + self.config.silence_timeout);
        self.warn_of(record.overload, arrival);
        let Scale {
            counts_per_newton,
            counts_per_newton_metre,
        } = self.config.scale;
        let wrench = Wrench::new(
            record.force.map(|raw| f64::from(raw) / counts_per_newton),
            record
                .torque
                .map(|raw| f64::from(raw) / counts_per_newton_metre),
        );
        self.received += 1;
        self.readings.push_back(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: None,
            },
            wrench: self.config.sign.apply(wrench),
            temperature_celsius: None,
            quality: if record.overload == 0 {
                Quality::Good
            } else {
                Quality::Overrange
            },
            status_bits: record.overload.into(),
        }));
    }

    /// Each overloaded axis once per stream.
    fn warn_of(&mut self, overload: u8, at: HostTime) {
        let fresh = overload & !self.warned;
        if fresh != 0 {
            self.warned |= fresh;
            let axes = [
                (0x20, "Fx"),
                (0x10, "Fy"),
                (0x08, "Fz"),
                (0x04, "Tx"),
                (0x02, "Ty"),
                (0x01, "Tz"),
            ];
            let names: Vec<_> = axes
                .iter()
                .filter(|(bit, _)| fresh & bit != 0)
                .map(|(_, name)| *name)
                .collect();
            let text = format!(
                "{} beyond 120 % of the rated load: unload the sensor",
                names.join(" ")
            );
            self.tell(DeviceEvent::Warning { text }, at);
        }
    }

    fn compare_scale(&mut self, at: HostTime) {
        let configured = self.config.scale;
        let model = &self.identity.model;
        let text = match Scale::of_model(model) {
            Some(scale) if scale == configured => return,
            Some(scale) => format!(
                "{model} has {} counts/N and {} counts/(N m) by the manual, configured are {} and {}: \
                 the configured ones are used",
                scale.counts_per_newton,
                scale.counts_per_newton_metre,
                configured.counts_per_newton,
                configured.counts_per_newton_metre
            ),
            None => format!(
                "{model:?} is not in the manual's table: the configured {} counts/N and {} counts/(N m) are used",
                configured.counts_per_newton, configured.counts_per_newton_metre
            ),
        };
        self.tell(DeviceEvent::Warning { text }, at);
    }

    fn awaits(&self, wanted: Command) -> bool {
        matches!(self.state, State::Asking { command, .. } if command == wanted)
    }

    /// Goes on to what comes after `command`, when that is what was asked.
    fn answered(&mut self, command: Command, now: HostTime) {
        if !self.awaits(command) {
            return;
        }
        match command {
            Command::ReadModel => self.ask(Command::ReadSerialNumber, now),
            Command::ReadSerialNumber => self.ask(Command::ReadFirmware, now),
            Command::ReadFirmware => self.ask(Command::ReadRate, now),
            Command::SetRate(_) => self.ask(Command::ReadFilter, now),
            Command::SetFilter(_) => self.ask(Command::Start, now),
            _ => {}
        }
    }

    fn ask(&mut self, command: Command, now: HostTime) {
        self.frames_unread = 0;
        self.attempt(command, 1, now);
    }

    fn attempt(&mut self, command: Command, attempt: u8, now: HostTime) {
        self.outgoing = Some(command);
        self.state = State::Asking {
            command,
            attempt,
            deadline: now + self.config.answer_timeout,
        };
    }

    fn start(&mut self, now: HostTime) {
        self.tell(DeviceEvent::Starting, now);
        if let Some(text) = self.warning_at_start.clone() {
            self.tell(DeviceEvent::Warning { text }, now);
        }
        (self.stops, self.warned, self.frames_unread) = (0, 0, 0);
        self.identity = Identity::default();
        match self.config.startup {
            Startup::Configure => self.stop(now),
            Startup::Listen => self.state = State::Listening(now + self.config.silence_timeout),
        }
    }

    fn stop(&mut self, now: HostTime) {
        self.stops += 1;
        self.outgoing = Some(Command::Stop);
        self.state = State::Draining {
            quiet_at: now + QUIET,
            give_up_at: now + DRAIN_LIMIT,
        };
    }

    fn lose(&mut self, reason: String, now: HostTime) {
        self.tell(DeviceEvent::Lost { reason }, now);
        self.outgoing = None;
        self.state = match self.config.startup {
            Startup::Configure => State::Waiting(now + self.config.retry_after),
            Startup::Listen => State::Listening(HostTime::FAR_FUTURE),
        };
    }

    fn tell(&mut self, event: DeviceEvent, at: HostTime) {
        self.readings.push_back(Reading::Event { at, event });
    }

    pub(crate) fn handle_timeout(&mut self, now: HostTime) {
        let Config {
            answer_timeout,
            silence_timeout,
            ..
        } = self.config;
        match self.state {
            State::Idle => self.start(now),
            State::Waiting(until) if now >= until => self.start(now),
            State::Draining { give_up_at, .. } if now >= give_up_at => {
                if self.stops < ATTEMPTS {
                    self.stop(now);
                } else {
                    self.lose(
                        format!(
                            "Stop was sent {ATTEMPTS} times, frames still come: {}",
                            self.checks
                        ),
                        now,
                    );
                }
            }
            State::Draining { quiet_at, .. } if now >= quiet_at => {
                self.ask(Command::ReadModel, now);
            }
            State::Asking {
                command,
                attempt,
                deadline,
            } if now >= deadline => {
                if attempt < ATTEMPTS {
                    self.attempt(command, attempt + 1, now);
                } else {
                    let (unread, checks) = (self.frames_unread, self.checks);
                    self.lose(
                        format!(
                            "{command:?} was not answered within {answer_timeout:?}, {ATTEMPTS} times, while {unread} \
                             pieces came that mean nothing: {checks}"
                        ),
                        now,
                    );
                }
            }
            State::Listening(deadline) | State::Streaming(deadline) if now >= deadline => {
                self.lose(
                    format!("no sample for {silence_timeout:?}: {}", self.checks),
                    now,
                );
            }
            _ => {}
        }
    }

    pub(crate) const fn poll_timeout(&self) -> HostTime {
        match self.state {
            State::Idle => HostTime::EPOCH,
            State::Draining {
                quiet_at,
                give_up_at,
            } => {
                if quiet_at.as_nanos() < give_up_at.as_nanos() {
                    quiet_at
                } else {
                    give_up_at
                }
            }
            State::Asking { deadline, .. } => deadline,
            State::Listening(at) | State::Streaming(at) | State::Waiting(at) => at,
        }
    }

    pub(crate) const fn poll_transmit(&mut self) -> Option<Command> {
        self.outgoing.take()
    }

    pub(crate) fn poll_reading(&mut self) -> Option<Reading> {
        self.readings.pop_front()
    }
}

fn shown(text: Text) -> String {
    text.as_str().unwrap_or("(not ASCII)").to_owned()
}
