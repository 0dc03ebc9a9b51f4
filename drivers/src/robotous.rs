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

use std::time::Duration;

use ft_wire::robotous_rft::{
    self as wire, Command, FilterSetting, Outcome, Record, Response, Text,
};
use ft_wire::{HostTime, Wrench};

pub use config::{Config, Filter, Scale};

use crate::reading::{DeviceEvent, Identity, Reading, SampleInstant, WrenchReading};
use crate::stages::{Due, Stages, Timing, quality};

/// The protocol, whatever carries it: commands out, responses in.
#[derive(Debug)]
pub(crate) struct Protocol {
    config: Config,
    stages: Stages<Command>,
    warning_at_start: Option<String>,
    identity: Identity,
}

impl Protocol {
    pub(crate) fn new(config: Config, checks: &'static str) -> Self {
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
            stages: Stages::new(timing, Some(Command::Stop), checks),
            warning_at_start: None,
            identity: Identity::default(),
        }
    }

    /// Something about the configuration that every start is to say.
    pub(crate) fn warn_at_start(&mut self, text: Option<String>) {
        self.warning_at_start = text;
    }

    pub(crate) const fn is_streaming(&self) -> bool {
        self.stages.is_streaming()
    }

    pub(crate) const fn received(&self) -> u64 {
        self.stages.received()
    }

    /// So many samples of the stream will not come.
    pub(crate) fn tell_missing(&mut self, samples: u64) {
        self.stages.tell_missing(samples);
    }

    /// Something came, whatever it is: it shows that the bus lives.
    pub(crate) fn on_traffic(&mut self, at: HostTime) {
        self.stages.on_traffic(at);
    }

    pub(crate) fn on_response(&mut self, response: Response, at: HostTime) {
        match response {
            Response::Stream(record) => self.on_record(record, at),
            Response::Model(text) => {
                self.identity.model = shown(text);
                if self.stages.awaits(Command::ReadModel) {
                    self.compare_scale(at);
                    self.stages.ask(Command::ReadSerialNumber, at);
                }
            }
            Response::SerialNumber(text) => {
                self.identity.serial_number = shown(text);
                if self.stages.awaits(Command::ReadSerialNumber) {
                    self.stages.ask(Command::ReadFirmware, at);
                }
            }
            Response::Firmware(text) => {
                self.identity.firmware = shown(text);
                if self.stages.awaits(Command::ReadFirmware) {
                    let identity = self.identity.clone();
                    self.stages.tell(DeviceEvent::Identified(identity), at);
                    self.stages.ask(Command::ReadRate, at);
                }
            }
            Response::Rate(code) => self.on_rate(code, at),
            Response::Filter(setting) => self.on_filter(setting, at),
            Response::RateSet(outcome) => {
                if let Some(asked @ Command::SetRate(_)) = self.stages.asked() {
                    self.on_outcome(asked, outcome, Command::ReadFilter, at);
                }
            }
            Response::FilterSet(outcome) => {
                if let Some(asked @ Command::SetFilter(_)) = self.stages.asked() {
                    self.on_outcome(asked, outcome, Command::Start, at);
                }
            }
            // Nothing here asks for these.
            Response::Once(_) | Response::OverloadCounters(_) => {}
        }
    }

    fn on_rate(&mut self, code: u8, at: HostTime) {
        if !self.stages.awaits(Command::ReadRate) {
            return;
        }
        if wire::rate_hz(code) == Some(self.config.rate_hz) {
            return self.stages.ask(Command::ReadFilter, at);
        }
        match wire::rate_code(self.config.rate_hz) {
            Some(wanted) => self.stages.ask(Command::SetRate(wanted), at),
            None => self.stages.lose(
                format!(
                    "rate_hz = {} is none of the sensor's rates",
                    self.config.rate_hz
                ),
                at,
            ),
        }
    }

    fn on_filter(&mut self, setting: FilterSetting, at: HostTime) {
        if !self.stages.awaits(Command::ReadFilter) {
            return;
        }
        let wanted = match self.config.filter {
            Filter::Off => Some(FilterSetting::NONE),
            Filter::LowPass { cut_off_hz } => FilterSetting::low_pass(cut_off_hz),
        };
        if let Some(wanted) = wanted
            && let Some(cut_off_hz) = wanted.cut_off_hz()
        {
            // The sources do not agree on what a code means.
            let scale = vec![
                ("filter_code", wanted.code.to_string()),
                ("low_pass_hz_by_the_manual", cut_off_hz.to_string()),
            ];
            self.stages.tell(DeviceEvent::Scale(scale), at);
        }
        match wanted {
            None => self.stages.lose(
                format!("{:?} is none of the sensor's filters", self.config.filter),
                at,
            ),
            // Without filter the code means nothing.
            Some(wanted) if setting == wanted || (wanted.kind == 0 && setting.kind == 0) => {
                self.stages.ask(Command::Start, at);
            }
            Some(wanted) => self.stages.ask(Command::SetFilter(wanted), at),
        }
    }

    /// The answer to the setting that was asked.
    fn on_outcome(&mut self, asked: Command, outcome: Outcome, next: Command, at: HostTime) {
        if outcome.result == 1 {
            return self.stages.ask(next, at);
        }
        let text = outcome.error_text();
        self.stages
            .lose(format!("the sensor refused {asked:?}: {text}"), at);
    }

    fn on_record(&mut self, record: Record, arrival: HostTime) {
        if !self.stages.admits_sample(Some(Command::Start), arrival) {
            return;
        }
        self.stages
            .warn_of_overload(record.overload.into(), arrival);
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
        self.stages.deliver(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: None,
            },
            wrench: self.config.sign.apply(wrench),
            temperature_celsius: None,
            quality: quality(false, record.overload != 0),
            status_bits: record.overload.into(),
        }));
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
        self.stages.warn(text, at);
    }

    pub(crate) fn handle_timeout(&mut self, now: HostTime) {
        match self.stages.handle_timeout(now) {
            Due::Began => {
                self.identity = Identity::default();
                if let Some(text) = self.warning_at_start.clone() {
                    self.stages.warn(text, now);
                }
            }
            Due::Drained => self.stages.ask(Command::ReadModel, now),
            Due::Nothing | Due::Polled | Due::Unanswered(_) | Due::Lost => {}
        }
    }

    pub(crate) fn poll_timeout(&self) -> HostTime {
        self.stages.poll_timeout()
    }

    pub(crate) fn poll_transmit(&mut self) -> Option<Command> {
        self.stages.poll_transmit()
    }

    pub(crate) fn poll_reading(&mut self) -> Option<Reading> {
        self.stages.poll_reading()
    }
}

fn shown(text: Text) -> String {
    text.as_str().unwrap_or("(not ASCII)").to_owned()
}
