//! `/diagnostics`: the ledger, the clocks and the state of every device, once a second and on change.

use std::sync::Arc;
use std::time::Duration;

use ft_drivers::reading::{DeviceEvent, Identity};
use ft_drivers::translate::ClockStatus;
use ft_recording::message::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Time};
use ft_wire::HostTime;
use serde::Serialize;

use crate::item::{Body, Item};
use crate::ledger::{StreamCounters, StreamLedger};

/// How often everything is said again.
const PERIOD: Duration = Duration::from_secs(1);

/// Warnings kept of one device; a device that finds new words for ever is not listened to for ever.
const MOST_WARNINGS: usize = 16;

/// `diagnostic_msgs/msg/DiagnosticStatus` levels.
const OK: u8 = 0;
const WARN: u8 = 1;
const ERROR: u8 = 2;

/// What is known of the devices.
#[derive(Debug)]
pub struct Health {
    devices: Vec<DeviceHealth>,
    due: HostTime,
    changed: bool,
}

/// A device, before anything is known of it.
#[derive(Clone, Debug)]
pub struct Named {
    /// As in the configuration.
    pub name: String,
    /// Its driver.
    pub driver: &'static str,
    /// Its settings in effect, defaults included: keys of `[device.settings]` and what they are set to.
    pub settings: Vec<(String, String)>,
    /// Its account.
    pub counters: Arc<StreamCounters>,
}

/// What is known of one device.
#[derive(Debug)]
pub struct DeviceHealth {
    name: String,
    driver: &'static str,
    settings: Vec<(String, String)>,
    counters: Arc<StreamCounters>,
    state: State,
    identity: Option<Identity>,
    /// What the device says that its numbers mean.
    scale: Vec<(&'static str, String)>,
    warnings: Vec<String>,
    clock: Option<ClockStatus>,
    rate: RateMeter,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    /// Not opened yet; why, where that was tried.
    Closed(Option<String>),
    Starting,
    Streaming,
    Lost(String),
}

/// Samples per second between two reports.
#[derive(Debug, Default)]
struct RateMeter {
    since: Option<(HostTime, u64)>,
    rate_hz: f64,
}

/// One device's part of the summary.
#[derive(Clone, Debug, Serialize)]
pub struct StreamSummary {
    /// The device's name.
    pub name: String,
    /// Its driver.
    pub driver: &'static str,
    /// `closed`, `starting`, `streaming` or `lost`.
    pub state: &'static str,
    /// Model, serial number and firmware, where the device says them.
    pub identity: Option<DeviceIdentity>,
    /// The account.
    #[serde(flatten)]
    pub ledger: StreamLedger,
    /// Samples per second over the last second.
    pub rate_hz: f64,
    /// The device's clock against the host's; `None` for devices without a clock.
    pub clock: Option<ClockSummary>,
    /// What the operator must know.
    pub warnings: Vec<String>,
}

/// Who a device says it is.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceIdentity {
    /// Maker's model name.
    pub model: String,
    /// Serial number.
    pub serial_number: String,
    /// Firmware version.
    pub firmware: String,
}

/// A device clock: `t_host = offset + (1 + skew) t_device`.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ClockSummary {
    /// Parts per million.
    pub skew_ppm: f64,
    /// One standard deviation of the translation, us.
    pub spread_us: f64,
}

impl Health {
    /// Nothing is known yet of `devices`.
    #[must_use]
    pub fn new(devices: Vec<Named>) -> Self {
        let devices = devices
            .into_iter()
            .map(|device| DeviceHealth {
                name: device.name,
                driver: device.driver,
                settings: device.settings,
                counters: device.counters,
                state: State::Closed(None),
                identity: None,
                scale: Vec::new(),
                warnings: Vec::new(),
                clock: None,
                rate: RateMeter::default(),
            })
            .collect();
        Self {
            devices,
            due: HostTime::EPOCH,
            changed: false,
        }
    }

    /// Takes what a channel reports; a line for the log when the operator should see it.
    pub fn take(&mut self, item: &Item) -> Option<String> {
        let device = item.device.and_then(|index| self.devices.get_mut(index))?;
        match &item.body {
            Body::Clock(status) => {
                device.clock = Some(*status);
                None
            }
            Body::Event(event) => {
                self.changed = true;
                device.take_event(event)
            }
            _ => None,
        }
    }

    /// The message for `/diagnostics`, when it is due.
    pub fn poll(&mut self, now: HostTime) -> Option<DiagnosticArray> {
        if now < self.due && !self.changed {
            return None;
        }
        if now >= self.due {
            for device in &mut self.devices {
                device.rate.update(now, device.counters.snapshot().received);
            }
            self.due = now + PERIOD;
        }
        self.changed = false;
        let header = Header {
            stamp: Time::from(now),
            frame_id: String::new(),
        };
        Some(DiagnosticArray {
            header,
            status: self.devices.iter().map(DeviceHealth::diagnostic).collect(),
        })
    }

    /// Every device's account, in the order of the configuration.
    #[must_use]
    pub fn ledgers(&self) -> Vec<StreamLedger> {
        self.devices
            .iter()
            .map(|device| device.counters.snapshot())
            .collect()
    }

    /// Every device's part of the summary.
    #[must_use]
    pub fn summary(&self) -> Vec<StreamSummary> {
        self.devices.iter().map(DeviceHealth::summary).collect()
    }
}

impl DeviceHealth {
    fn take_event(&mut self, event: &DeviceEvent) -> Option<String> {
        let name = &self.name;
        match event {
            DeviceEvent::Starting => {
                self.state = State::Starting;
                None
            }
            DeviceEvent::Identified(identity) => {
                let told = [
                    ("", &identity.model),
                    ("serial ", &identity.serial_number),
                    ("firmware ", &identity.firmware),
                ];
                let told = told.into_iter().filter(|(_, value)| !value.is_empty());
                let told: Vec<_> = told.map(|(key, value)| format!("{key}{value}")).collect();
                let line = format!("{name}: {}", told.join(" "));
                self.identity = Some(identity.clone());
                Some(line)
            }
            DeviceEvent::Scale(scale) => {
                self.scale.clone_from(scale);
                None
            }
            DeviceEvent::Closed { reason } => {
                self.state = State::Closed(Some(reason.clone()));
                Some(format!(
                    "{name}: not open: {reason}; it is opened as soon as that is mended"
                ))
            }
            DeviceEvent::Streaming => {
                self.state = State::Streaming;
                Some(format!("{name}: streaming"))
            }
            DeviceEvent::Lost { reason } => {
                self.state = State::Lost(reason.clone());
                Some(format!("{name}: lost: {reason}"))
            }
            DeviceEvent::Warning { text } => {
                if self.warnings.len() < MOST_WARNINGS && !self.warnings.contains(text) {
                    self.warnings.push(text.clone());
                }
                Some(format!("{name}: {text}"))
            }
            _ => None,
        }
    }

    fn diagnostic(&self) -> DiagnosticStatus {
        let ledger = self.counters.snapshot();
        let (level, message) = match &self.state {
            State::Lost(reason) => (ERROR, format!("lost: {reason}")),
            State::Closed(Some(reason)) => (ERROR, format!("closed: {reason}")),
            State::Closed(None) | State::Starting => (WARN, self.state.name().to_owned()),
            State::Streaming if ledger.lost_data() => (WARN, "streaming, data was lost".to_owned()),
            State::Streaming if !self.warnings.is_empty() => (WARN, self.warnings.join("; ")),
            State::Streaming => (OK, "streaming".to_owned()),
        };
        let mut values = vec![
            pair("rate_hz", format!("{:.1}", self.rate.rate_hz)),
            pair("received", ledger.received),
            pair("gaps", ledger.gaps),
            pair("drops", ledger.drops),
            pair("refused", ledger.refused),
            pair("overflows", ledger.overflows),
            pair("duplicated", ledger.duplicated),
            pair("overrange", ledger.overrange),
            pair("invalid", ledger.invalid),
            pair("interruptions", ledger.interruptions),
            pair("view_drops", ledger.view_drops),
        ];
        if !self.warnings.is_empty() {
            values.push(pair("warnings", self.warnings.join("; ")));
        }
        if let Some(clock) = &self.clock {
            values.push(pair("clock_offset_ns", clock.offset_ns));
            values.push(pair("clock_skew_ppm", format!("{:.3}", clock.skew_ppm)));
            values.push(pair("clock_spread_ns", clock.spread_ns));
        }
        if let Some(Identity {
            model,
            serial_number,
            firmware,
        }) = &self.identity
        {
            // Not every device says all of it.
            let about = [
                ("model", model),
                ("serial_number", serial_number),
                ("firmware", firmware),
            ];
            let told = about.into_iter().filter(|(_, value)| !value.is_empty());
            values.extend(told.map(|(name, value)| pair(name, value)));
        }
        let settings = self.settings.iter();
        values.extend(settings.map(|(key, value)| pair(&format!("settings.{key}"), value)));
        let scale = self.scale.iter();
        values.extend(scale.map(|(key, value)| pair(&format!("scale.{key}"), value)));
        let hardware_id = self
            .identity
            .as_ref()
            .map_or_else(String::new, |identity| identity.serial_number.clone());
        DiagnosticStatus {
            level,
            name: format!("{}: {}", self.name, self.driver),
            message,
            hardware_id,
            values,
        }
    }

    fn summary(&self) -> StreamSummary {
        let identity = self.identity.as_ref().map(|identity| DeviceIdentity {
            model: identity.model.clone(),
            serial_number: identity.serial_number.clone(),
            firmware: identity.firmware.clone(),
        });
        StreamSummary {
            name: self.name.clone(),
            driver: self.driver,
            state: self.state.name(),
            identity,
            ledger: self.counters.snapshot(),
            rate_hz: self.rate.rate_hz,
            clock: self.clock.map(|clock| ClockSummary {
                skew_ppm: clock.skew_ppm,
                spread_us: clock.spread_ns as f64 * 1e-3,
            }),
            warnings: self.warnings.clone(),
        }
    }
}

impl State {
    const fn name(&self) -> &'static str {
        match self {
            Self::Closed(_) => "closed",
            Self::Starting => "starting",
            Self::Streaming => "streaming",
            Self::Lost(_) => "lost",
        }
    }
}

impl RateMeter {
    fn update(&mut self, now: HostTime, received: u64) {
        if let Some((then, before)) = self.since {
            let seconds = now.seconds_since(then);
            if seconds > 0.0 {
                self.rate_hz = received.saturating_sub(before) as f64 / seconds;
            }
        }
        self.since = Some((now, received));
    }
}

fn pair(key: &str, value: impl ToString) -> KeyValue {
    KeyValue {
        key: key.to_owned(),
        value: value.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_drivers::reading::Counts;

    fn event(event: DeviceEvent) -> Item {
        let at = HostTime::from_nanos(5);
        Item {
            device: Some(0),
            arrival: at,
            clock_epoch: 0,
            sample_time: at,
            body: Body::Event(event),
        }
    }

    fn health() -> (Health, Arc<StreamCounters>) {
        let counters = Arc::new(StreamCounters::default());
        (
            Health::new(vec![Named {
                name: "ft_sensor".to_owned(),
                driver: "bota_serial",
                settings: vec![("rate_hz".to_owned(), "800".to_owned())],
                counters: Arc::clone(&counters),
            }]),
            counters,
        )
    }

    fn at(seconds: i64) -> HostTime {
        HostTime::from_nanos(seconds * 1_000_000_000)
    }

    #[test]
    fn a_change_is_said_at_once_and_everything_once_a_second() {
        let (mut health, _) = health();
        assert!(health.poll(at(1)).is_some());
        assert!(health.poll(at(1)).is_none());
        health.take(&event(DeviceEvent::Streaming));
        assert!(health.poll(at(1)).is_some());
        assert!(health.poll(at(2)).is_some());
        assert_eq!(health.summary()[0].state, "streaming");
    }

    #[test]
    fn the_rate_is_that_of_the_last_second() {
        let (mut health, counters) = health();
        health.poll(at(1));
        counters.set_driver_counts(
            Counts::default(),
            Counts {
                received: 800,
                ..Counts::default()
            },
        );
        health.poll(at(2));
        assert!((health.summary()[0].rate_hz - 800.0).abs() < 1e-9);
    }

    #[test]
    fn a_lost_device_is_an_error_with_its_reason() {
        let (mut health, _) = health();
        let line = health.take(&event(DeviceEvent::Lost {
            reason: "no bytes for 1 s".to_owned(),
        }));
        assert_eq!(line.as_deref(), Some("ft_sensor: lost: no bytes for 1 s"));
        let status = health.poll(at(1)).unwrap().status.remove(0);
        assert_eq!(
            (status.level, status.message.as_str()),
            (ERROR, "lost: no bytes for 1 s")
        );
    }

    #[test]
    fn a_device_that_is_not_there_yet_is_an_error_until_it_is() {
        let (mut health, _) = health();
        let line = health.take(&event(DeviceEvent::Closed {
            reason: "ttyUSB0 does not exist".to_owned(),
        }));
        let line = line.unwrap();
        assert!(
            line.starts_with("ft_sensor: not open: ttyUSB0 does not exist"),
            "{line}"
        );
        let status = health.poll(at(1)).unwrap().status.remove(0);
        assert_eq!(
            (status.level, status.message.as_str()),
            (ERROR, "closed: ttyUSB0 does not exist")
        );
        health.take(&event(DeviceEvent::Streaming));
        assert_eq!(health.poll(at(2)).unwrap().status[0].level, OK);
    }

    #[test]
    fn who_a_device_is_and_how_it_is_set_stands_in_its_status() {
        let (mut health, _) = health();
        health.take(&event(DeviceEvent::Identified(Identity {
            model: "SensONE".to_owned(),
            serial_number: "A1".to_owned(),
            firmware: "2.1".to_owned(),
        })));
        let scale = vec![("rated_force_n", "500 500 1000".to_owned())];
        health.take(&event(DeviceEvent::Scale(scale)));
        let values = health.poll(at(1)).unwrap().status.remove(0).values;
        for (key, value) in [
            ("model", "SensONE"),
            ("serial_number", "A1"),
            ("firmware", "2.1"),
            ("settings.rate_hz", "800"),
            ("scale.rated_force_n", "500 500 1000"),
        ] {
            assert!(values.contains(&pair(key, value)), "{key}: {values:?}");
        }
    }

    #[test]
    fn lost_samples_do_not_hide_what_was_warned_of() {
        let (mut health, counters) = health();
        health.take(&event(DeviceEvent::Streaming));
        let text = "stamps are arrivals".to_owned();
        health.take(&event(DeviceEvent::Warning { text: text.clone() }));
        counters.add_drop();
        let status = health.poll(at(1)).unwrap().status.remove(0);
        assert_eq!(status.message, "streaming, data was lost");
        assert!(
            status.values.contains(&pair("warnings", text)),
            "{status:?}"
        );
    }

    #[test]
    fn lost_samples_are_a_warning() {
        let (mut health, counters) = health();
        health.take(&event(DeviceEvent::Streaming));
        counters.add_drop();
        assert_eq!(health.poll(at(1)).unwrap().status[0].level, WARN);
    }
}
