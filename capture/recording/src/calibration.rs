//! What is known about the tool in front of the force-torque sensor: the metadata record `ft.calibration`.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::error::CalibrationError;

/// Key of the metadata record that holds the JSON.
const KEY: &str = "json";

/// A value with its standard deviation, in the same unit and shape.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Estimate<T> {
    /// Best estimate.
    pub value: T,
    /// One standard deviation.
    pub std: T,
}

/// Parameters of a [`Calibration`]: mass, centre of mass x y z, inertia xx xy yy xz yz zz, bias of force x y z and of torque x y z.
pub const PARAMETERS: usize = 16;

/// The part of the gripper in front of the sensor, and the sensor's bias, in the axes of `ft_sensor`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Mass, kg.
    pub payload_mass_kg: Estimate<f64>,
    /// Centre of mass from the origin of `ft_sensor`, m.
    pub payload_com_m: Estimate<[f64; 3]>,
    /// Inertia about the centre of mass, kg m^2: xx xy yy xz yz zz.
    pub payload_inertia_kgm2: Estimate<[f64; 6]>,
    /// What the sensor reads when nothing acts on it: N, N m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wrench_bias: Option<Estimate<[f64; 6]>>,
    /// Covariance of all [`PARAMETERS`] in their order and units, (16, 16); its diagonal is the squares of the standard deviations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Box<[[f64; PARAMETERS]; PARAMETERS]>>,
}

impl Calibration {
    /// Reads the JSON of design 3, strictly.
    ///
    /// # Errors
    /// When it is not JSON, a key is missing or unknown, a number is not finite, or the mass is not positive, a moment of
    /// inertia or a standard deviation is negative.
    pub fn from_json(text: &str) -> Result<Self, CalibrationError> {
        let calibration: Self = serde_json::from_str(text)?;
        calibration.check()?;
        Ok(calibration)
    }

    /// Writes what [`Self::from_json`] reads.
    ///
    /// # Errors
    /// When [`Self::from_json`] would refuse it.
    pub fn to_json(&self) -> Result<String, CalibrationError> {
        self.check()?;
        Ok(serde_json::to_string(self)?)
    }

    /// Reads the entries of the metadata record `ft.calibration`.
    ///
    /// # Errors
    /// When the key `json` is missing, and as [`Self::from_json`].
    pub fn from_metadata(entries: &BTreeMap<String, String>) -> Result<Self, CalibrationError> {
        Self::from_json(entries.get(KEY).ok_or(CalibrationError::NoJson)?)
    }

    /// The entries of the metadata record `ft.calibration`.
    ///
    /// # Errors
    /// As [`Self::to_json`].
    pub fn to_metadata(&self) -> Result<BTreeMap<String, String>, CalibrationError> {
        Ok(BTreeMap::from([(KEY.to_owned(), self.to_json()?)]))
    }

    fn check(&self) -> Result<(), CalibrationError> {
        let mass = self.payload_mass_kg;
        check_estimate("payload_mass_kg", &[mass.value], &[mass.std])?;
        if mass.value <= 0.0 {
            return impossible("payload_mass_kg", mass.value, "positive");
        }
        let com = self.payload_com_m;
        check_estimate("payload_com_m", &com.value, &com.std)?;
        let inertia = self.payload_inertia_kgm2;
        check_estimate("payload_inertia_kgm2", &inertia.value, &inertia.std)?;
        let [xx, _, yy, _, _, zz] = inertia.value;
        if let Some(moment) = [xx, yy, zz].into_iter().find(|moment| *moment < 0.0) {
            return impossible("payload_inertia_kgm2", moment, "at least 0 on the diagonal");
        }
        if let Some(bias) = self.wrench_bias {
            check_estimate("wrench_bias", &bias.value, &bias.std)?;
        }
        self.covariance
            .as_ref()
            .map_or(Ok(()), |covariance| self.check_covariance(covariance))
    }

    /// Standard deviations of all parameters; `None` without a bias.
    fn std(&self) -> Option<[f64; PARAMETERS]> {
        let all = [self.payload_mass_kg.std]
            .into_iter()
            .chain(self.payload_com_m.std)
            .chain(self.payload_inertia_kgm2.std)
            .chain(self.wrench_bias?.std);
        let mut std = [0.0; PARAMETERS];
        for (place, value) in std.iter_mut().zip(all) {
            *place = value;
        }
        Some(std)
    }

    fn check_covariance(
        &self,
        covariance: &[[f64; PARAMETERS]; PARAMETERS],
    ) -> Result<(), CalibrationError> {
        const NAME: &str = "covariance";
        const ROUNDING: f64 = 1e-6;
        if !covariance
            .as_flattened()
            .iter()
            .all(|number| number.is_finite())
        {
            return Err(CalibrationError::NotFinite { name: NAME });
        }
        let Some(std) = self.std() else {
            return impossible(NAME, PARAMETERS as f64, "left out without a wrench_bias");
        };
        let transposed =
            (0..PARAMETERS).map(|k| covariance.iter().filter_map(move |row| row.get(k)));
        for ((row, column), a) in covariance.iter().zip(transposed).zip(std) {
            for ((value, mirrored), b) in row.iter().zip(column).zip(std) {
                if (value - mirrored).abs() > ROUNDING * a * b {
                    return impossible(NAME, *value, "symmetric");
                }
                if value.abs() > (1.0 + ROUNDING) * a * b {
                    return impossible(
                        NAME,
                        *value,
                        "at most the product of the two standard deviations",
                    );
                }
            }
        }
        let diagonal = covariance
            .iter()
            .enumerate()
            .filter_map(|(k, row)| row.get(k));
        match diagonal
            .zip(std)
            .find(|(value, std)| (**value - std * std).abs() > ROUNDING * std * std)
        {
            Some((value, _)) => impossible(
                NAME,
                *value,
                "the square of the standard deviation on the diagonal",
            ),
            None => Ok(()),
        }
    }
}

fn check_estimate(name: &'static str, value: &[f64], std: &[f64]) -> Result<(), CalibrationError> {
    if !value.iter().chain(std).all(|number| number.is_finite()) {
        return Err(CalibrationError::NotFinite { name });
    }
    match std.iter().find(|std| **std < 0.0) {
        Some(std) => impossible(name, *std, "at least 0 for a std"),
        None => Ok(()),
    }
}

fn impossible(name: &'static str, got: f64, must: &'static str) -> Result<(), CalibrationError> {
    Err(CalibrationError::Impossible { name, got, must })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn paper() -> Calibration {
        Calibration {
            payload_mass_kg: Estimate {
                value: 0.49,
                std: 0.005,
            },
            payload_com_m: Estimate {
                value: [0.021, 0.020, 0.059],
                std: [0.001; 3],
            },
            payload_inertia_kgm2: Estimate {
                value: [1e-3, 0.0, 1e-3, 0.0, 0.0, 5e-4],
                std: [1e-4; 6],
            },
            wrench_bias: None,
            covariance: None,
        }
    }

    /// A covariance whose every two parameters are correlated by 0.5.
    fn with_covariance() -> Calibration {
        let mut calibration = Calibration {
            wrench_bias: Some(Estimate {
                value: [0.5; 6],
                std: [0.01; 6],
            }),
            ..paper()
        };
        let std = calibration.std().unwrap();
        let row =
            |i: usize| core::array::from_fn(|j| std[i] * std[j] * if i == j { 1.0 } else { 0.5 });
        calibration.covariance = Some(Box::new(core::array::from_fn(row)));
        calibration
    }

    #[test]
    fn a_covariance_comes_back_as_it_was_or_is_refused() {
        let calibration = with_covariance();
        let text = calibration.to_json().unwrap();
        let mut read = Calibration::from_json(&text).unwrap();
        let matrices = [&read, &calibration].map(|c| c.covariance.clone().unwrap());
        let [read_back, written] = matrices.each_ref().map(|m| m.as_flattened());
        for (a, b) in read_back.iter().zip(written) {
            // The reader rounds its last digit otherwise than the writer.
            assert!((a - b).abs() < 1e-15 * b.abs() + 1e-300, "{a} {b}");
        }
        read.covariance.clone_from(&calibration.covariance);
        assert_eq!(read, calibration);
        let refusal = |change: &dyn Fn(&mut Calibration)| {
            let mut changed = calibration.clone();
            change(&mut changed);
            changed.to_json().unwrap_err().to_string()
        };
        let with = |i: usize, j: usize, factor: f64| {
            move |calibration: &mut Calibration| {
                calibration.covariance.as_mut().unwrap()[i][j] *= factor;
            }
        };
        assert!(refusal(&with(2, 5, 1.1)).contains("symmetric"));
        assert!(refusal(&with(3, 3, 0.9)).contains("on the diagonal"));
        assert!(refusal(&with(0, 0, f64::NAN)).contains("covariance"));
        assert!(refusal(&|calibration| calibration.wrench_bias = None).contains("wrench_bias"));
        let text = refusal(&|calibration| {
            with(2, 5, 3.0)(calibration);
            with(5, 2, 3.0)(calibration);
        });
        assert!(text.contains("at most the product"), "{text}");
    }

    #[test]
    fn a_calibration_comes_back_as_it_was() {
        for bias in [
            None,
            Some(Estimate {
                value: [0.5; 6],
                std: [0.01; 6],
            }),
        ] {
            let calibration = Calibration {
                wrench_bias: bias,
                ..paper()
            };
            let metadata = calibration.to_metadata().unwrap();
            assert_eq!(Calibration::from_metadata(&metadata).unwrap(), calibration);
        }
    }

    #[test]
    fn the_json_has_the_names_of_the_design() {
        assert!(paper().to_json().unwrap().starts_with(
            "{\"payload_mass_kg\":{\"value\":0.49,\"std\":0.005},\"payload_com_m\":{\"value\":[0.021,0.02,0.059],"
        ));
    }

    #[test]
    fn an_unknown_key_is_refused_with_the_known_ones() {
        let text = paper()
            .to_json()
            .unwrap()
            .replacen('{', "{\"mass\": 1, ", 1);
        let message = Calibration::from_json(&text).unwrap_err().to_string();
        assert!(message.contains("unknown field `mass`"), "{message}");
        assert!(
            message.contains(
                "`payload_mass_kg`, `payload_com_m`, `payload_inertia_kgm2`, `wrench_bias`, `covariance`"
            )
        );
    }

    #[test]
    fn a_missing_key_and_a_wrong_shape_are_refused() {
        let text = paper().to_json().unwrap();
        let message =
            Calibration::from_json(&text.replace("payload_com_m", "wrench_bias")).unwrap_err();
        assert!(
            message.to_string().contains("invalid length 3"),
            "{message}"
        );
        assert!(matches!(
            Calibration::from_json("{}"),
            Err(CalibrationError::Json(_))
        ));
        assert!(matches!(
            Calibration::from_metadata(&BTreeMap::new()),
            Err(CalibrationError::NoJson)
        ));
    }

    #[test]
    fn a_body_without_mass_is_refused() {
        let mut calibration = paper();
        calibration.payload_mass_kg.value = 0.0;
        assert_eq!(
            calibration.to_json().unwrap_err().to_string(),
            "payload_mass_kg is 0, must be positive"
        );
    }

    #[test]
    fn negative_moments_and_spreads_and_infinities_are_refused() {
        let mut calibration = paper();
        calibration.payload_inertia_kgm2.value[5] = -1e-6;
        assert!(matches!(
            calibration.to_json(),
            Err(CalibrationError::Impossible { .. })
        ));
        let mut calibration = paper();
        calibration.payload_com_m.std[1] = -1.0;
        assert!(matches!(
            calibration.to_json(),
            Err(CalibrationError::Impossible { .. })
        ));
        let mut calibration = paper();
        calibration.payload_com_m.value[1] = f64::NAN;
        assert!(matches!(
            calibration.to_json(),
            Err(CalibrationError::NotFinite {
                name: "payload_com_m"
            })
        ));
    }
}
