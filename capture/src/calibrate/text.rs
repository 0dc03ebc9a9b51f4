//! A calibration as people and files read it.

use std::collections::BTreeMap;
use std::fmt;

use ft_recording::{Calibration, Recording};
use serde::Serialize;

use crate::config::Frames;

use super::{Alignment, CalibrateError, Calibrated};

impl Calibrated {
    pub(super) fn details(&self, recording: &Recording, shifted: bool) -> BTreeMap<String, String> {
        let mut entries = BTreeMap::from([
            ("source_sha256".to_owned(), recording.sha256.clone()),
            ("poses_shifted".to_owned(), shifted.to_string()),
        ]);
        if let Ok(json) = serde_json::to_string(self) {
            entries.insert("json".to_owned(), json);
        }
        entries
    }

    /// The section `[calibration]` of a `capture.toml`.
    pub(super) fn to_toml(&self, recording: &Recording) -> Result<String, CalibrateError> {
        #[derive(Serialize)]
        struct File<'a> {
            calibration: &'a Calibration,
            #[serde(skip_serializing_if = "Option::is_none")]
            frames: Option<Frames>,
        }
        let name = recording.path.file_name().unwrap_or_default();
        let text = toml::to_string(&File {
            calibration: &self.calibration,
            frames: self.frames(recording),
        })?;
        let hint = self
            .alignment
            .and_then(|alignment| latency_hint(alignment.offset_s));
        Ok(format!(
            "# From {} (sha256 {}).\n# For capture.toml of later recordings with the same tool and sensor.\n{}{}",
            name.to_string_lossy(),
            recording.sha256,
            hint.unwrap_or_default(),
            text.replace(
                "covariance = ",
                "# Of mass, centre x y z, inertia xx xy yy xz yz zz, bias of force x y z and torque x y z, in their units:\ncovariance = "
            )
        ))
    }
}

/// Longer is no link's delay but another clock, s.
const MAX_DELAY_S: f64 = 0.2;

/// A line on how later recordings get rid of an offset of the poses' stamps: a stamp that is too late has a link slower than its
/// `latency_us` says.
fn latency_hint(offset_s: f64) -> Option<String> {
    let (delay_us, device) = match 1e6 * offset_s {
        us if us < 0.0 => (-us, "tracker"),
        us => (us, "force-torque sensor"),
    };
    (delay_us <= 1e6 * MAX_DELAY_S).then(|| {
        format!(
            "# Poses and wrench were {:.3} ms apart; {delay_us:.0} more in the latency_us of the {device} takes that away.\n",
            1e-3 * delay_us
        )
    })
}

impl fmt::Display for Calibrated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let c = &self.calibration;
        let list = |values: &[f64], scale: f64, digits: usize| {
            let texts: Vec<_> = values
                .iter()
                .map(|value| format!("{:.digits$}", value * scale))
                .collect();
            texts.join(" ")
        };
        let (mass, com, inertia) = (
            &c.payload_mass_kg,
            &c.payload_com_m,
            &c.payload_inertia_kgm2,
        );
        if let Some(damage) = &self.damage {
            writeln!(f, "DAMAGED       the recording is not whole: {damage}")?;
        }
        writeln!(f, "free air      {:.1} s", self.free_air_s)?;
        for (count, what) in self.repeats.iter().zip(["wrenches", "poses"]) {
            if *count > 0 {
                writeln!(
                    f,
                    "repeats       {count} {what} only repeat the one before under a new stamp: left out"
                )?;
            }
        }
        writeln!(f, "mass          {:.4} +-{:.4} kg", mass.value, mass.std)?;
        writeln!(
            f,
            "centre        {} +-{} mm",
            list(&com.value, 1e3, 2),
            list(&com.std, 1e3, 2)
        )?;
        writeln!(
            f,
            "inertia       {} +-{} g m^2 (xx xy yy xz yz zz){}",
            list(&inertia.value, 1e3, 3),
            list(&inertia.std, 1e3, 3),
            if self.inertia_made_possible {
                ", moved to one that a body can have: shake harder to see it"
            } else {
                ""
            }
        )?;
        if let Some(bias) = &c.wrench_bias {
            writeln!(
                f,
                "bias          {} N, {} N m (+-{} N, {} N m)",
                list(&bias.value[..3], 1.0, 3),
                list(&bias.value[3..], 1.0, 4),
                list(&bias.std[..3], 1.0, 3),
                list(&bias.std[3..], 1.0, 4)
            )?;
        }
        if let Some(rate) = &self.bias_rate {
            writeln!(
                f,
                "bias drift    {} N/min, {} N m/min",
                list(&rate.value[..3], 60.0, 3),
                list(&rate.value[3..], 60.0, 4)
            )?;
        }
        if let Some(rate) = &self.bias_per_kelvin {
            writeln!(
                f,
                "per kelvin    {} N, {} N m",
                list(&rate.value[..3], 1.0, 4),
                list(&rate.value[3..], 1.0, 5)
            )?;
        }
        if let Some(rotation) = &self.rotation {
            writeln!(
                f,
                "rotation      quaternion x y z w {} from ft_sensor to tcp (+-{} deg about x, y, z)",
                list(&rotation.quaternion_xyzw, 1.0, 5),
                list(&rotation.std_deg, 1.0, 3)
            )?;
        }
        match (&self.alignment, &self.not_aligned) {
            (Some(alignment), _) => writeln!(f, "{alignment}")?,
            (None, Some(reason)) => writeln!(f, "pose offset   not seen: {reason}")?,
            (None, None) => {}
        }
        if let Some(gyroscope) = &self.gyroscope {
            writeln!(f, "{gyroscope}")?;
        }
        write!(
            f,
            "left over     {:.3} N, {:.4} N m rms below 8 Hz (before: {:.2} N, {:.3} N m)",
            self.residual_rms[0], self.residual_rms[1], self.before_rms[0], self.before_rms[1]
        )
    }
}

impl fmt::Display for Alignment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "pose offset   {:+.3} ms to add to the pose's stamps (95 %: {:+.3} to {:+.3} ms)",
            1e3 * self.offset_s,
            1e3 * self.interval_s[0],
            1e3 * self.interval_s[1]
        )?;
        match self.skew_ppm {
            Some([skew, std]) => write!(f, ", skew {skew:+.1} +-{std:.1} ppm"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_device_whose_stamps_are_late_gets_the_hint() {
        let hint = |offset_s| latency_hint(offset_s).unwrap_or_default();
        assert_eq!(
            hint(-0.0032),
            "# Poses and wrench were 3.200 ms apart; 3200 more in the latency_us of the tracker takes that away.\n"
        );
        assert!(hint(0.0011).contains("1100 more in the latency_us of the force-torque sensor"));
        assert_eq!(latency_hint(-3.0), None);
    }
}
