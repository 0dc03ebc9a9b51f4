//! Settings of the gripper's encoders: `dynamixel`, `amt21`, `encoder_line`, and the linkage that all of them share.

use std::f64::consts::TAU;
use std::time::Duration;

use ft_drivers::amt21::Echo;
use ft_drivers::linkage::Linkage;
use ft_drivers::options::Startup;
use ft_drivers::{amt21, dynamixel, encoder_line, hid_axis};
use ft_wire::hid::Usage;
use serde::{Deserialize, Serialize};

/// `[device.settings.linkage]`: from the encoder's angle to the jaw opening.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum LinkageSetting {
    /// The Hoi! gripper.
    #[default]
    Hoi,
    /// Two crank-and-rod halves.
    CrankAndRod {
        zero_angle_deg: f64,
        crank_m: f64,
        rod_m: f64,
    },
    /// Rack and pinion, spindle, belt, slider.
    Linear {
        zero_angle_deg: f64,
        width_at_zero_m: f64,
        width_per_turn_m: f64,
    },
}

fn linkage(setting: LinkageSetting) -> Result<Linkage, String> {
    let linkage = match setting {
        LinkageSetting::Hoi => Linkage::HOI,
        LinkageSetting::CrankAndRod {
            zero_angle_deg,
            crank_m,
            rod_m,
        } => {
            if !(crank_m > 0.0 && rod_m > crank_m && rod_m < 1.0) {
                return Err(format!(
                    "linkage: crank_m = {crank_m}, rod_m = {rod_m}: the rod is longer than the crank, and below 1 m"
                ));
            }
            Linkage::CrankAndRod {
                zero_angle_rad: zero_angle_deg.to_radians(),
                crank_m,
                rod_m,
            }
        }
        LinkageSetting::Linear {
            zero_angle_deg,
            width_at_zero_m,
            width_per_turn_m,
        } => {
            if !(1e-5..=1.0).contains(&width_per_turn_m.abs()) {
                return Err(format!(
                    "linkage: width_per_turn_m = {width_per_turn_m}: 0.00001 to 1, negative when the jaws close"
                ));
            }
            Linkage::Linear {
                zero_angle_rad: zero_angle_deg.to_radians(),
                width_at_zero_m,
                slope_m_per_rad: width_per_turn_m / TAU,
            }
        }
    };
    let (zero_angle_rad, width_at_zero_m) = match linkage {
        Linkage::CrankAndRod { zero_angle_rad, .. } => (zero_angle_rad, 0.0),
        Linkage::Linear {
            zero_angle_rad,
            width_at_zero_m,
            ..
        } => (zero_angle_rad, width_at_zero_m),
    };
    if zero_angle_rad.abs() <= MOST_TURNS * TAU && width_at_zero_m.abs() <= 1.0 {
        Ok(linkage)
    } else {
        Err("linkage: zero_angle_deg within 100 turns, width_at_zero_m within 1 m".to_owned())
    }
}

/// Of a spindle's encoder between its zero and the angle at which the opening is known.
const MOST_TURNS: f64 = 100.0;

fn period(rate_hz: f64) -> Result<Duration, String> {
    if (1.0..=1000.0).contains(&rate_hz) {
        Ok(Duration::from_secs_f64(1.0 / rate_hz))
    } else {
        Err(format!("rate_hz = {rate_hz}: 1 to 1000"))
    }
}

/// A busy host may take longer than a busy line; an answer that is late is no sample lost.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(100);

/// Settings of `dynamixel`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Dynamixel {
    id: u8,
    pub(super) baud_bps: u32,
    rate_hz: f64,
    linkage: LinkageSetting,
}

impl Default for Dynamixel {
    fn default() -> Self {
        Self {
            id: 1,
            baud_bps: 57_600,
            rate_hz: 50.0,
            linkage: LinkageSetting::Hoi,
        }
    }
}

impl Dynamixel {
    pub(super) fn config(&self, startup: Startup) -> Result<dynamixel::Config, String> {
        if self.id > 252 {
            return Err(format!("id = {}: 0 to 252", self.id));
        }
        Ok(dynamixel::Config {
            id: self.id,
            period: period(self.rate_hz)?,
            linkage: linkage(self.linkage)?,
            startup,
            answer_timeout: ANSWER_TIMEOUT,
            ..dynamixel::Config::default()
        })
    }
}

/// Settings of `amt21`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct Amt21 {
    address: u8,
    pub(super) baud_bps: u32,
    rate_hz: f64,
    /// Position that is angle 0.
    zero_counts: u16,
    /// The adapter hands back what was sent.
    echo: bool,
    linkage: LinkageSetting,
}

impl Default for Amt21 {
    fn default() -> Self {
        Self {
            address: ft_wire::amt21::FACTORY_ADDRESS,
            baud_bps: 2_000_000,
            rate_hz: 100.0,
            zero_counts: 0,
            echo: false,
            linkage: LinkageSetting::Hoi,
        }
    }
}

impl Amt21 {
    pub(super) fn config(&self, startup: Startup) -> Result<amt21::Config, String> {
        if !self.address.is_multiple_of(4) {
            return Err(format!("address = {}: a multiple of 4", self.address));
        }
        if self.zero_counts >= ft_wire::amt21::COUNTS_PER_TURN {
            return Err(format!("zero_counts = {}: 0 to 16383", self.zero_counts));
        }
        Ok(amt21::Config {
            address: self.address,
            period: period(self.rate_hz)?,
            zero_counts: self.zero_counts,
            linkage: linkage(self.linkage)?,
            echo: if self.echo { Echo::Present } else { Echo::None },
            startup,
            poll_timeout: ANSWER_TIMEOUT,
            ..amt21::Config::default()
        })
    }
}

/// Settings of `encoder_line`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EncoderLine {
    /// Negative when it counts down as the angle grows.
    counts_per_turn: f64,
    /// Counts at angle 0.
    #[serde(default)]
    zero_counts: f64,
    #[serde(default = "line_baud_bps")]
    pub(super) baud_bps: u32,
    #[serde(default)]
    linkage: LinkageSetting,
}

const fn line_baud_bps() -> u32 {
    115_200
}

impl EncoderLine {
    pub(super) fn config(&self) -> Result<encoder_line::Config, String> {
        let (counts, zero) = (self.counts_per_turn, self.zero_counts);
        if !(1.0..=1e9).contains(&counts.abs()) {
            return Err(format!(
                "counts_per_turn = {counts}: 1 to 1e9, negative when it counts down"
            ));
        }
        if zero.abs() > 2_147_483_648.0 || zero.is_nan() {
            return Err(format!("zero_counts = {zero}: within 32 bits"));
        }
        Ok(encoder_line::Config {
            zero_counts: zero,
            linkage: linkage(self.linkage)?,
            ..encoder_line::Config::new(counts)
        })
    }
}

/// Settings of `hid_axis`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct HidAxis {
    /// x, y, z, rx, ry, rz, slider, dial or wheel.
    axis: String,
    /// Negative when it counts down as the angle grows; without it the unit of the device's descriptor is taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    counts_per_turn: Option<f64>,
    /// Counts at angle 0.
    zero_counts: f64,
    linkage: LinkageSetting,
}

impl Default for HidAxis {
    fn default() -> Self {
        Self {
            axis: Usage::X.name().to_owned(),
            counts_per_turn: None,
            zero_counts: 0.0,
            linkage: LinkageSetting::Hoi,
        }
    }
}

impl HidAxis {
    pub(super) fn config(&self) -> Result<hid_axis::Config, String> {
        let Some(usage) = Usage::named(&self.axis) else {
            let names = Usage::ALL.map(Usage::name).join(", ");
            return Err(format!("axis = {:?}: one of {names}", self.axis));
        };
        if let Some(counts) = self.counts_per_turn
            && !(1.0..=1e9).contains(&counts.abs())
        {
            return Err(format!(
                "counts_per_turn = {counts}: 1 to 1e9, negative when it counts down"
            ));
        }
        if !self.zero_counts.is_finite() {
            return Err(format!("zero_counts = {}: a number", self.zero_counts));
        }
        Ok(hid_axis::Config {
            usage,
            counts_per_turn: self.counts_per_turn,
            zero_counts: self.zero_counts,
            linkage: linkage(self.linkage)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn amt21(text: &str) -> Result<amt21::Config, String> {
        let settings: Amt21 = toml::from_str(text).map_err(|error| error.to_string())?;
        settings.config(Startup::Configure)
    }

    #[test]
    fn a_linkage_is_chosen_by_its_kind() {
        let config = amt21("").unwrap();
        assert_eq!(config.linkage, Linkage::HOI);
        let rack = "linkage = { kind = \"linear\", zero_angle_deg = 0, width_at_zero_m = 0.01, width_per_turn_m = 0.1 }";
        let config = amt21(rack).unwrap();
        assert!((config.linkage.width_m(std::f64::consts::PI) - 0.06).abs() < 1e-12);
    }

    #[test]
    fn a_linkage_that_cannot_be_is_named() {
        let short = "linkage = { kind = \"crank_and_rod\", zero_angle_deg = 0, crank_m = 0.05, rod_m = 0.04 }";
        assert!(amt21(short).unwrap_err().contains("longer than the crank"));
        let far = "linkage = { kind = \"linear\", zero_angle_deg = 1e9, width_at_zero_m = 0, width_per_turn_m = 0.1 }";
        assert!(amt21(far).unwrap_err().contains("within 100 turns"));
        let unknown = amt21("linkage = { kind = \"cable\" }").unwrap_err();
        assert!(unknown.contains("crank_and_rod"), "{unknown}");
        assert!(amt21("address = 3").unwrap_err().contains("multiple of 4"));
    }

    #[test]
    fn an_encoder_of_lines_needs_its_counts() {
        let missing: Result<EncoderLine, _> = toml::from_str("");
        assert!(missing.unwrap_err().to_string().contains("counts_per_turn"));
    }
}
