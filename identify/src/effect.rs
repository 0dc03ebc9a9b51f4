//! Candidates for the effort model: each gives regressors on a prepared motion, with the sign physics allows.

pub mod axis;
pub mod damping;
pub mod friction;
pub mod library;
pub mod load;
pub mod measurement;
pub mod memory;
pub mod slip;

use crate::least_squares::Bound;
use crate::motion::{Motion, MotionError};

/// One regressor of a model that is linear in its parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Name of the parameter, as in reports.
    pub name: &'static str,
    /// Unit of the parameter.
    pub unit: String,
    /// What the parameter may be.
    pub bound: Bound,
    /// Effort per unit of the parameter, filtered like the measured effort, at the samples that fits use.
    pub values: Vec<f64>,
}

/// A physical effect that adds to the effort.
pub trait Effect: core::fmt::Debug + Sync {
    /// Name from the project's one vocabulary of effects.
    fn name(&self) -> &'static str;

    /// Its regressors on this motion.
    ///
    /// # Errors
    /// When a series does not fit the motion.
    fn columns(&self, motion: &Motion) -> Result<Vec<Column>, MotionError>;

    /// The same before the filter: effort per unit of each parameter at every sample of the motion.
    ///
    /// # Errors
    /// As [`Effect::columns`].
    fn series(&self, motion: &Motion) -> Result<Vec<Vec<f64>>, MotionError>;

    /// How far each free number of its shape may be moved either way, in steps of its own; `motion` = the one that it was found on. Nothing where it
    /// is no function of the state, or has no shape.
    fn shape_limits(&self, _motion: &Motion) -> Vec<[f64; 2]> {
        Vec::new()
    }

    /// It with these numbers moved by so many steps; nothing where there are none.
    fn moved(&self, _motion: &Motion, _steps: &[f64]) -> Option<Box<dyn Effect>> {
        None
    }
}

/// The parametric model of the paper: `I ddq + mu sgn(dq) + b dq`, all three non-negative.
#[derive(Clone, Copy, Debug, Default)]
pub struct RigidBody;

impl RigidBody {
    /// Its series as they were measured, not smoothed.
    pub(crate) fn measured(motion: &Motion) -> [Vec<f64>; 3] {
        let q = &motion.q_measured;
        [
            motion.second_derivative(q),
            motion.sign.clone(),
            motion.derivative(q),
        ]
    }
}

impl Effect for RigidBody {
    fn name(&self) -> &'static str {
        "rigid_body"
    }

    fn columns(&self, motion: &Motion) -> Result<Vec<Column>, MotionError> {
        let column = |name, unit: &str, values| Column {
            name,
            unit: unit.to_owned(),
            bound: Bound::NonNegative,
            values,
        };
        let kind = motion.kind;
        let [inertia, coulomb, viscous] = Self::measured(motion);
        let filtered = |series: Vec<f64>| motion.regressor(&series);
        Ok(vec![
            column("inertia", kind.inertia_unit(), filtered(inertia)?),
            column("coulomb", kind.effort_unit(), filtered(coulomb)?),
            column("viscous", kind.viscous_unit(), filtered(viscous)?),
        ])
    }

    fn series(&self, motion: &Motion) -> Result<Vec<Vec<f64>>, MotionError> {
        Ok(vec![
            motion.ddq.clone(),
            motion.sign.clone(),
            motion.dq.clone(),
        ])
    }
}

/// The bias of the force sensor that drifts while it measures: straight pieces, each of as many kept samples, of two minutes or an eighth of
/// the recording; they start from nothing. Wherever the joint is, the sensor lies in the same way to its path, so that this is a load over time.
///
/// No effect of the library: it is there to be fitted beside others, so that what a sensor usually drifts is not taken for friction
/// where few strokes are slow.
#[derive(Clone, Copy, Debug, Default)]
pub struct BiasDrift;

impl BiasDrift {
    const PIECE_S: f64 = 120.0;
    const MOST: f64 = 8.0;

    /// How far the bias goes in all, of the coefficients of its pieces: N m or N.
    pub(crate) fn range(pieces: &[f64]) -> f64 {
        let mut at = 0.0;
        let (mut low, mut high) = (0.0_f64, 0.0_f64);
        for piece in pieces {
            at += piece;
            (low, high) = (low.min(at), high.max(at));
        }
        high - low
    }
}

impl Effect for BiasDrift {
    fn name(&self) -> &'static str {
        "bias_drift"
    }

    fn columns(&self, motion: &Motion) -> Result<Vec<Column>, MotionError> {
        let column = |series: Vec<f64>| {
            Ok(Column {
                name: "bias_drift",
                unit: motion.kind.effort_unit().to_owned(),
                bound: Bound::Free,
                values: motion.regressor(&series)?,
            })
        };
        self.series(motion)?.into_iter().map(column).collect()
    }

    fn series(&self, motion: &Motion) -> Result<Vec<Vec<f64>>, MotionError> {
        let kept = motion.at_kept(&motion.time);
        let [Some(start), Some(end)] = [kept.first(), kept.last()] else {
            return Ok(Vec::new());
        };
        let pieces = ((end - start) / Self::PIECE_S)
            .ceil()
            .clamp(1.0, Self::MOST) as usize;
        // A long rest is no piece of its own, of which no sample would tell.
        let knot = |k: usize| kept[k * (kept.len() - 1) / pieces];
        let piece = |k: usize| {
            let (from, to) = (knot(k), knot(k + 1));
            let long = (to - from).max(f64::MIN_POSITIVE);
            let time = motion.time.iter();
            time.map(|t| ((t - from) / long).clamp(0.0, 1.0)).collect()
        };
        Ok((0..pieces).map(piece).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bias_that_comes_back_has_gone_its_whole_way() {
        assert_eq!(BiasDrift::range(&[]), 0.0);
        assert_eq!(BiasDrift::range(&[0.5, -0.2]), 0.5);
        assert_eq!(BiasDrift::range(&[0.5, -0.75]), 0.75);
    }
}
