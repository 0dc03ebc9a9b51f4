//! Stretches in which nothing but its own weight and inertia acts on the tool.

use ft_recording::Recording;

use crate::calibrate::{CalibrateError, CalibrateOptions, Calibrated, calibrate};

/// Why a stretch is no free air, as far as that says something of the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum NoFreeAir {
    /// The wrench follows the motion, with its sign turned round.
    Turned,
    /// It follows the motion of a tool of this mass, kg.
    Mass(f64),
    /// The tool moved, and this share of the wrench follows, 0 to 1.
    Unrelated(f64),
    /// Nothing moved, or something touched the tool.
    Nothing,
}

/// Clocks that were aligned before are not farther apart, s.
const SEARCH_S: f64 = 0.5;
/// A tool of another mass is held by nobody, kg.
const MASSES_KG: core::ops::Range<f64> = 0.1..3.0;

impl NoFreeAir {
    /// The reason that says more.
    pub(super) fn or(self, other: Self) -> Self {
        match (self, other) {
            (Self::Unrelated(a), Self::Unrelated(b)) => Self::Unrelated(a.max(b)),
            (Self::Nothing, other) => other,
            (Self::Unrelated(_), Self::Turned | Self::Mass(_)) => other,
            _ => self,
        }
    }

    /// What it says of the data, if anything.
    pub(super) fn told(self) -> Option<String> {
        match self {
            Self::Turned => Some(
                "free air is there, and the wrench follows the poses with its sign turned: is it what acts on the tool?".to_owned(),
            ),
            Self::Mass(mass) => Some(format!(
                "free air is there, and by it the tool weighs {mass:.3} kg (expected {} to {} kg): are forces in N?",
                MASSES_KG.start, MASSES_KG.end
            )),
            Self::Unrelated(share) => Some(format!(
                "the tool moves, and the wrench follows the poses to only {:.0} % (in free air 90 % or more): where the tool was free, signs, \
                 units or times of one of them are wrong (times are put right where they are less than {SEARCH_S} s apart)",
                100.0 * share
            )),
            Self::Nothing => None,
        }
    }
}

/// Calibrates from `from_s` to `until_s`; refused when something touched the tool or the motion shows too little.
pub(super) fn free_air(
    recording: &Recording,
    from_s: f64,
    until_s: f64,
) -> Result<Calibrated, NoFreeAir> {
    let options = CalibrateOptions {
        free_air: Some((from_s, until_s)),
        search_s: SEARCH_S,
        find_rotation: false,
    };
    let found = calibrate(recording, &options).map_err(|error| match error {
        CalibrateError::Reversed { .. } => NoFreeAir::Turned,
        CalibrateError::Unrelated { explained } => NoFreeAir::Unrelated(explained),
        _ => NoFreeAir::Nothing,
    })?;
    let mass = found.calibration.payload_mass_kg.value;
    if found.alignment.is_some() && !MASSES_KG.contains(&mass) {
        return Err(NoFreeAir::Mass(mass));
    }
    // A hand that rests on the tool, or a handle, leaves newtons.
    let quiet = found.residual_rms[0] < 0.3 && found.residual_rms[1] < 0.03;
    let largest = found
        .series
        .iter()
        .flat_map(|sample| &sample.left[..3])
        .fold(0.0_f64, |most, left| most.max(left.abs()));
    if quiet && largest < 1.5 && MASSES_KG.contains(&mass) {
        return Ok(found);
    }
    Err(NoFreeAir::Nothing)
}

#[cfg(test)]
mod tests {
    use super::NoFreeAir::{Mass, Nothing, Turned, Unrelated};

    #[test]
    fn the_reason_that_says_more_is_told() {
        let all = [Nothing, Unrelated(0.3), Unrelated(0.6), Nothing];
        let told = all.into_iter().reduce(super::NoFreeAir::or).unwrap();
        assert_eq!(told, Unrelated(0.6));
        assert!(told.told().unwrap().contains("to only 60 %"));
        assert_eq!(told.or(Mass(490.0)).or(Unrelated(0.8)), Mass(490.0));
        assert_eq!(Turned.or(Nothing), Turned);
        assert_eq!(Nothing.told(), None);
    }
}
