//! OptoForce / OnRobot HEX sensors: what the drivers for a serial line and for CAN share.
//!
//! ```text
//! configure to stop -> Drain (quiet) -> serial number -> configure -> Streaming
//! ```
//!
//! An answer to the serial number may be missing; a refused configuration is a loss. The zero of the sensor is
//! given back to the factory's at each start; taring is done on the host.
//!
//! **Scale**: counts per N and per N m of each axis stand in the sensitivity report of the very sensor and have no default.
//!
//! **Sign**: unconfirmed on hardware; taken as environment on tool, [`Config::sign`] changes that.
//!
//! **Gaps and stamps**: samples carry a counter. Gaps, duplicates and late samples are told by it, and with the configured rate
//! it is the device's clock in `device_ns`. A sensor with three axes gives no wrench and is refused.
//!
//! # Source
//! hardware.md 2.3, see [`ft_wire::optoforce_hex`].

use std::time::Duration;

use ft_wire::optoforce_hex::{self as wire, Command, Packet, Sample, Settings};
use ft_wire::{HostTime, Unwrapper, Wrench};

use crate::options::{Sign, Startup};
use crate::reading::{Counts, DeviceEvent, Identity, Reading, SampleInstant, WrenchReading};
use crate::sequence::{Seen, Sequence};
use crate::stages::{Due, Stages, Timing, quality};

/// Raw counts per SI unit, by axis, of one sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Counts per N, x y z.
    pub counts_per_newton: [f64; 3],
    /// Counts per N m, x y z.
    pub counts_per_newton_metre: [f64; 3],
}

/// How to set the sensor up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Output rate: 1000, 333, 100, 30 or 10 Hz.
    pub rate_hz: u16,
    /// Low pass in the sensor: 500, 150, 50, 15, 5 or 2 (1.5) Hz; 0 is off, which is the default.
    pub low_pass_hz: u16,
    /// Scale of this sensor.
    pub scale: Scale,
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

impl Config {
    /// A sensor of this scale at 333 Hz, unfiltered.
    #[must_use]
    pub fn new(scale: Scale) -> Self {
        Self {
            rate_hz: 333,
            low_pass_hz: 0,
            scale,
            sign: Sign::default(),
            startup: Startup::default(),
            answer_timeout: Duration::from_millis(300),
            silence_timeout: Duration::from_millis(500),
            retry_after: Duration::from_secs(1),
        }
    }

    fn settings(&self) -> Option<Settings> {
        Some(Settings {
            period_ms: wire::period_ms(self.rate_hz)?,
            filter: wire::filter_code(self.low_pass_hz)?,
            zero: 0,
        })
    }
}

/// The protocol, whatever carries it: commands out, packets in.
#[derive(Debug)]
pub(crate) struct Protocol {
    config: Config,
    stages: Stages<Command>,
    period_ns: i64,
    ticks: Unwrapper,
    sequence: Sequence,
    duplicated: u64,
}

/// Marks, beside the bits of the status, that a sensor without torque was told of.
const NO_TORQUE: u32 = 1 << 6;

const STOP: Command = Command::Configure(Settings {
    period_ms: 0,
    filter: 0,
    zero: 0,
});

impl Protocol {
    pub(crate) fn new(config: Config, checks: &'static str) -> Self {
        let timing = Timing {
            startup: config.startup,
            // Longer than a sample takes at 10 Hz.
            quiet: Duration::from_millis(120),
            drain_limit: Duration::from_millis(1000),
            answer_timeout: config.answer_timeout,
            silence_timeout: config.silence_timeout,
            retry_after: config.retry_after,
        };
        let period_ms = config.settings().map_or(1, |settings| settings.period_ms);
        Self {
            stages: Stages::new(timing, Some(STOP), checks)
                .with_optional(Command::ReadSerialNumber),
            config,
            period_ns: i64::from(period_ms) * 1_000_000,
            ticks: Unwrapper::new(16),
            sequence: Sequence::new(),
            duplicated: 0,
        }
    }

    pub(crate) const fn is_streaming(&self) -> bool {
        self.stages.is_streaming()
    }

    pub(crate) fn on_traffic(&mut self, at: HostTime) {
        self.stages.on_traffic(at);
    }

    pub(crate) fn on_packet(&mut self, packet: Packet, at: HostTime) {
        match packet {
            Packet::Sample(sample) => self.on_sample(&sample, at),
            Packet::SerialNumber(text) if self.stages.awaits(Command::ReadSerialNumber) => {
                let serial_number = String::from_utf8_lossy(&text)
                    .trim_matches(['\0', ' '])
                    .to_owned();
                let identity = Identity {
                    model: "HEX".to_owned(),
                    serial_number,
                    firmware: String::new(),
                };
                self.stages.tell(DeviceEvent::Identified(identity), at);
                self.configure(at);
            }
            Packet::Configured { error } => self.on_configured(error, at),
            Packet::SerialNumber(_) => {}
        }
    }

    fn configure(&mut self, now: HostTime) {
        match self.config.settings() {
            Some(settings) => self.stages.ask(Command::Configure(settings), now),
            None => {
                let Config {
                    rate_hz,
                    low_pass_hz,
                    ..
                } = self.config;
                self.stages.lose(
                    format!("rate_hz = {rate_hz} with low_pass_hz = {low_pass_hz} is no setting of the sensor"),
                    now,
                );
            }
        }
    }

    fn on_configured(&mut self, error: u8, at: HostTime) {
        let settings = self.config.settings().map(Command::Configure);
        if !settings.is_some_and(|command| self.stages.awaits(command)) {
            // The answer to the stop.
            return;
        }
        if error == 0 {
            self.stages.await_sample(at);
        } else {
            self.stages.lose(
                format!("the sensor refused {settings:?}: error {error}"),
                at,
            );
        }
    }

    fn on_sample(&mut self, sample: &Sample, arrival: HostTime) {
        let Some(torque) = sample.torque else {
            // Once per attempt.
            if self.stages.fresh_bits(NO_TORQUE) != 0 {
                let reason = "a sensor with three axes gives no torque, so no wrench";
                self.stages.lose(reason.to_owned(), arrival);
            }
            return;
        };
        // Samples after the configuration show that it was taken, should its answer be missing.
        let start = self.config.settings().map(Command::Configure);
        if !self.stages.admits_sample(start, arrival) {
            return;
        }
        let Some(device_ns) = self.place(sample.counter, arrival) else {
            return;
        };
        self.warn_of(sample, arrival);
        let Scale {
            counts_per_newton,
            counts_per_newton_metre,
        } = self.config.scale;
        let [fx, fy, fz] = sample.force.map(f64::from);
        let [tx, ty, tz] = torque.map(f64::from);
        let ([nx, ny, nz], [mx, my, mz]) = (counts_per_newton, counts_per_newton_metre);
        let wrench = Wrench::from_array([fx / nx, fy / ny, fz / nz, tx / mx, ty / my, tz / mz]);
        let status = sample.status;
        self.stages.deliver(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: Some(device_ns),
            },
            wrench: self.config.sign.apply(wrench),
            temperature_celsius: None,
            quality: quality(
                status.converter() != 0 || status.sensor() != 0,
                status.overload() != 0,
            ),
            status_bits: status.0.into(),
        }));
    }

    /// The sample's instant on the sensor's counter, ns; `None` for a duplicate.
    fn place(&mut self, counter: u16, arrival: HostTime) -> Option<i64> {
        let device_ns = self.ticks.unwrap(counter.into()) * self.period_ns;
        match self.sequence.observe(device_ns, arrival) {
            Seen::New | Seen::Late => Some(device_ns),
            Seen::Duplicate => {
                self.duplicated += 1;
                None
            }
            Seen::Restarted { .. } => {
                self.ticks.reset();
                let device_ns = self.ticks.unwrap(counter.into()) * self.period_ns;
                self.sequence.forget();
                self.sequence.observe(device_ns, arrival);
                let text = "the sample counter began anew: the sensor restarted, or another program set it up";
                self.stages.warn(text.to_owned(), arrival);
                Some(device_ns)
            }
        }
    }

    fn warn_of(&mut self, sample: &Sample, at: HostTime) {
        let status = sample.status;
        self.stages.warn_of_overload(status.overload().into(), at);
        let trouble = u32::from(status.0 & 0xFC00) << 16;
        if self.stages.fresh_bits(trouble) != 0 {
            let (converter, sensor) = (status.converter(), status.sensor());
            let text = format!(
                "status {:#06x}: converter trouble {converter} (1 converter, 2 communication), sensor trouble {sensor} \
                 (1 not detected, 2 failure, 4 temperature): values are invalid",
                status.0
            );
            self.stages.warn(text, at);
        }
    }

    pub(crate) fn handle_timeout(&mut self, now: HostTime) {
        match self.stages.handle_timeout(now) {
            Due::Began => {
                self.ticks.reset();
                self.sequence.forget();
            }
            Due::Drained => self.stages.ask(Command::ReadSerialNumber, now),
            Due::Unanswered(_) => self.configure(now),
            Due::Nothing | Due::Polled | Due::Lost => {}
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

    /// Everything but what the carrier counts.
    pub(crate) fn counts(&self) -> Counts {
        Counts {
            received: self.stages.received(),
            gaps: self.sequence.gaps(),
            duplicated: self.duplicated,
            ..Counts::default()
        }
    }
}
