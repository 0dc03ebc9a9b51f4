//! Settings of `kunwei_kwr75`, `leptrino` and `ati_netcanoem`.

use std::time::Duration;

use ft_drivers::options::Startup;
use ft_drivers::{ati_netcanoem, kunwei_kwr75, leptrino};
use ft_wire::ati_netcanoem::FACTORY_BASE;
use serde::{Deserialize, Serialize};

use super::SignSetting;

/// Settings of `kunwei_kwr75`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Kunwei {
    pub(super) baud_bps: u32,
    /// Largest step between samples that is believed; frames have no check sum.
    max_step_n: f64,
    max_step_nm: f64,
    sign: SignSetting,
}

impl Default for Kunwei {
    fn default() -> Self {
        let config = kunwei_kwr75::Config::default();
        Self {
            baud_bps: kunwei_kwr75::BAUD_BPS,
            max_step_n: config.max_step_n,
            max_step_nm: config.max_step_nm,
            sign: SignSetting::default(),
        }
    }
}

impl Kunwei {
    pub(super) fn config(&self, startup: Startup) -> Result<kunwei_kwr75::Config, String> {
        for (key, value) in [
            ("max_step_n", self.max_step_n),
            ("max_step_nm", self.max_step_nm),
        ] {
            if !(1e-3..=1e4).contains(&value) {
                return Err(format!("{key} = {value}: 0.001 to 10000"));
            }
        }
        Ok(kunwei_kwr75::Config {
            max_step_n: self.max_step_n,
            max_step_nm: self.max_step_nm,
            sign: self.sign.into(),
            startup,
            ..kunwei_kwr75::Config::default()
        })
    }
}

/// Settings of `leptrino`. Scale and rate are the sensor's.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Leptrino {
    /// A USB CDC port ignores it.
    pub(super) baud_bps: u32,
    sign: SignSetting,
}

impl Default for Leptrino {
    fn default() -> Self {
        Self {
            baud_bps: leptrino::BAUD_BPS,
            sign: SignSetting::default(),
        }
    }
}

impl Leptrino {
    pub(super) fn config(&self, startup: Startup) -> leptrino::Config {
        leptrino::Config {
            sign: self.sign.into(),
            startup,
            ..leptrino::Config::default()
        }
    }
}

/// Settings of `ati_netcanoem`. Scale and units are the board's.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Ati {
    /// Base id, 7 bits.
    base_id: u8,
    calibration: u8,
    rate_hz: f64,
    sign: SignSetting,
}

impl Default for Ati {
    fn default() -> Self {
        Self {
            base_id: FACTORY_BASE,
            calibration: 0,
            rate_hz: 250.0,
            sign: SignSetting::default(),
        }
    }
}

impl Ati {
    pub(super) fn config(&self, startup: Startup) -> Result<ati_netcanoem::Config, String> {
        if self.base_id > 0x7F {
            return Err(format!("base_id = {}: 0 to 127", self.base_id));
        }
        if self.calibration > 15 {
            return Err(format!("calibration = {}: 0 to 15", self.calibration));
        }
        if !(1.0..=2000.0).contains(&self.rate_hz) {
            return Err(format!("rate_hz = {}: 1 to 2000", self.rate_hz));
        }
        Ok(ati_netcanoem::Config {
            base: self.base_id,
            calibration: self.calibration,
            period: Duration::from_secs_f64(1.0 / self.rate_hz),
            sign: self.sign.into(),
            startup,
            ..ati_netcanoem::Config::default()
        })
    }

    /// All that the board may send on.
    pub(super) fn ids(&self) -> Vec<u16> {
        (0..16)
            .map(|operation| ft_wire::ati_netcanoem::id(self.base_id, operation))
            .collect()
    }
}
