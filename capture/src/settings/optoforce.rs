//! Settings of `optoforce_serial` and `optoforce_can`.

use ft_drivers::options::Startup;
use ft_drivers::optoforce::{Config, Scale};
use ft_drivers::{optoforce_can, optoforce_serial};
use ft_wire::optoforce_hex::{filter_code, period_ms};
use serde::{Deserialize, Serialize};

use super::SignSetting;

/// The scale has no default: it stands in the sensitivity report of the very sensor.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Settings {
    force_counts_per_newton: [f64; 3],
    torque_counts_per_newton_metre: [f64; 3],
    #[serde(default = "rate_hz")]
    rate_hz: u16,
    /// 0: the sensor's own filter is off.
    #[serde(default)]
    low_pass_hz: u16,
    #[serde(default)]
    sign: SignSetting,
    /// Serial only; a USB CDC port ignores it.
    #[serde(default = "baud_bps")]
    pub(super) baud_bps: u32,
    /// CAN only.
    #[serde(default = "data_id")]
    pub(super) data_id: u16,
    /// CAN only.
    #[serde(default = "command_id")]
    command_id: u16,
}

const fn rate_hz() -> u16 {
    333
}
const fn baud_bps() -> u32 {
    optoforce_serial::BAUD_BPS
}
const fn data_id() -> u16 {
    0x100
}
const fn command_id() -> u16 {
    0x101
}

impl Settings {
    pub(super) fn config(&self, startup: Startup) -> Result<Config, String> {
        if period_ms(self.rate_hz).is_none() {
            let rate = self.rate_hz;
            return Err(format!("rate_hz = {rate}: 10, 30, 100, 333 or 1000"));
        }
        if filter_code(self.low_pass_hz).is_none() {
            let cut_off = self.low_pass_hz;
            return Err(format!(
                "low_pass_hz = {cut_off}: 0 (off), 2 (1.5 Hz), 5, 15, 50, 150 or 500"
            ));
        }
        for (key, counts) in [
            ("force_counts_per_newton", self.force_counts_per_newton),
            (
                "torque_counts_per_newton_metre",
                self.torque_counts_per_newton_metre,
            ),
        ] {
            if counts.iter().any(|value| !(1e-3..=1e6).contains(value)) {
                return Err(format!("{key} = {counts:?}: each 0.001 to 1000000"));
            }
        }
        Ok(Config {
            rate_hz: self.rate_hz,
            low_pass_hz: self.low_pass_hz,
            sign: self.sign.into(),
            startup,
            ..Config::new(Scale {
                counts_per_newton: self.force_counts_per_newton,
                counts_per_newton_metre: self.torque_counts_per_newton_metre,
            })
        })
    }

    pub(super) fn can_config(&self, startup: Startup) -> Result<optoforce_can::Config, String> {
        let (data_id, command_id) = (self.data_id, self.command_id);
        if data_id > 0x7FF || command_id > 0x7FF || data_id == command_id {
            return Err(format!(
                "data_id, command_id = {data_id:#x}, {command_id:#x}: two different 11-bit ids"
            ));
        }
        Ok(optoforce_can::Config {
            data_id,
            command_id,
            ..optoforce_can::Config::new(self.config(startup)?)
        })
    }
}
