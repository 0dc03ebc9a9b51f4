//! How device clocks stood to the host's, and who the devices are, by `/diagnostics`.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::message::{DiagnosticArray, Message};
use crate::reader::RawMessage;

/// How a device's clock stood to the host's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ClockReport {
    /// How much faster the host's clock runs, parts per million, at the end.
    pub skew_ppm: f64,
    /// Uncertainty of the translated stamps at the end, one standard deviation, us.
    pub spread_us: f64,
    /// The largest uncertainty after the first 10 s of the recording, us; 0 in a shorter one.
    pub largest_spread_us: f64,
}

/// What `/diagnostics` says of devices and their clocks.
#[derive(Default)]
pub(super) struct Clocks {
    pub(super) clocks: BTreeMap<String, ClockReport>,
    /// What devices warned of, as last said.
    pub(super) warnings: BTreeMap<String, String>,
    /// Who devices are and how they were set, as last said.
    pub(super) devices: BTreeMap<String, BTreeMap<String, String>>,
    first_ns: Option<u64>,
}

/// Keys that say who a device is, and what the others begin with that say how it is set.
const IDENTITY: [&str; 3] = ["model", "serial_number", "firmware"];
const SET: [&str; 2] = ["settings.", "scale."];

/// Until then a clock's skew is not yet known, ns.
const CLOCKS_SETTLE_NS: u64 = 10_000_000_000;

impl Clocks {
    pub(super) fn take(&mut self, message: &RawMessage<'_>) {
        let Ok(array) = DiagnosticArray::decode(message.data) else {
            return;
        };
        let first_ns = *self.first_ns.get_or_insert(message.log_time);
        for status in array.status {
            if let Some(pair) = status.values.iter().find(|pair| pair.key == "warnings") {
                let text = pair.value.clone();
                self.warnings.insert(status.name.clone(), text);
            }
            let about = status.values.iter().filter(|pair| {
                IDENTITY.contains(&pair.key.as_str())
                    || SET.iter().any(|begin| pair.key.starts_with(begin))
            });
            for pair in about {
                let device = self.devices.entry(status.name.clone()).or_default();
                device.insert(pair.key.clone(), pair.value.clone());
            }
            let value = |key: &str| {
                let pair = status.values.iter().find(|pair| pair.key == key)?;
                pair.value.parse::<f64>().ok().filter(|v| v.is_finite())
            };
            let Some((skew_ppm, spread_ns)) = value("clock_skew_ppm").zip(value("clock_spread_ns"))
            else {
                continue;
            };
            let clock = self.clocks.entry(status.name.clone()).or_default();
            (clock.skew_ppm, clock.spread_us) = (skew_ppm, 1e-3 * spread_ns);
            if message.log_time.saturating_sub(first_ns) >= CLOCKS_SETTLE_NS {
                clock.largest_spread_us = clock.largest_spread_us.max(clock.spread_us);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{DiagnosticStatus, KeyValue};

    #[test]
    fn the_last_warning_of_each_device_is_kept_and_who_it_is() {
        let mut clocks = Clocks::default();
        for text in ["first", "first; second"] {
            let pair = |key: &str, value: &str| KeyValue {
                key: key.to_owned(),
                value: value.to_owned(),
            };
            let warned = DiagnosticStatus {
                name: "ft: kunwei".to_owned(),
                values: vec![
                    pair("gaps", "0"),
                    pair("warnings", text),
                    pair("firmware", "1.0"),
                    pair("settings.rate_hz", "800"),
                ],
                ..DiagnosticStatus::default()
            };
            let silent = DiagnosticStatus {
                name: "aria: pose_stream".to_owned(),
                ..DiagnosticStatus::default()
            };
            let array = DiagnosticArray {
                status: vec![silent, warned],
                ..DiagnosticArray::default()
            };
            let mut data = Vec::new();
            array.encode(&mut data);
            clocks.take(&RawMessage {
                channel_id: 1,
                sequence: 0,
                log_time: 5,
                publish_time: 5,
                data: &data,
            });
        }
        let expected = BTreeMap::from([("ft: kunwei".to_owned(), "first; second".to_owned())]);
        assert_eq!(clocks.warnings, expected);
        let about = [("firmware", "1.0"), ("settings.rate_hz", "800")];
        let about = about.map(|(key, value)| (key.to_owned(), value.to_owned()));
        let expected = BTreeMap::from([("ft: kunwei".to_owned(), BTreeMap::from(about))]);
        assert_eq!(clocks.devices, expected);
        assert!(clocks.clocks.is_empty());
    }
}
