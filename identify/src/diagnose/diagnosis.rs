//! What a search found, and the fit of its model.

use nalgebra::DMatrix;

use super::finish::fit_named;
use super::model::{Found, blocks, slopes_of};
use super::score::Problem;
use super::start::CameTo;
use crate::dynamics::{DynamicsError, EffortModel, JointFit, fit_columns};
use crate::effect::{Effect, RigidBody};
use crate::least_squares::rms;
use crate::motion::Motion;
use crate::noise::{self, NoiseFloor};
use crate::parallel::in_parallel;
use crate::samples::JointSamples;

/// An effect that fits nearly as well.
#[derive(Clone, Debug)]
pub struct Ambiguity {
    /// Its name.
    pub name: &'static str,
    /// The motion or measurement that would tell the two apart.
    pub told_apart_by: &'static str,
    /// It with its shape, in the place of the effect; nothing when only a part of the effect may be it.
    pub rival: Option<Found>,
}

/// An effect that was added.
#[derive(Clone, Debug)]
pub struct NamedEffect {
    /// The effect with its shape.
    pub found: Found,
    /// Error on held-out strokes before and after it was added, in the order of the effects.
    pub held_out_rms: [f64; 2],
    /// Share of simulated recordings without any effect in which the search found as much; 0 of what no search found: free air, the pose or rests show it.
    pub p_value: f64,
    /// What fits nearly as well.
    pub ambiguous_with: Vec<Ambiguity>,
    /// Covariance of its terms and then of its shape parameters, zero for those that are a choice; empty where it is not known.
    pub spread: DMatrix<f64>,
}

/// A candidate that improved the fit and was turned down.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Refused {
    /// Its name.
    pub name: &'static str,
    /// Why.
    pub reason: String,
    /// Error on held-out strokes without and with it.
    pub held_out_rms: [f64; 2],
}

/// What the search found.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// Effects, the last the one without which the others err least, and so on: mostly each lowers the error of those before it, but a load may do
    /// so only beside the dampers that it presses against.
    pub effects: Vec<NamedEffect>,
    /// Candidates turned down.
    pub refused: Vec<Refused>,
    /// Lag of the effort that was named as an effect, s.
    pub lag_s: Option<f64>,
    /// A lag or a switch that is no name for what it takes away, and why.
    pub(super) doubted: Option<Refused>,
    pub(super) came_to: CameTo,
    /// I, mu, b and the effects, fitted with their bounds.
    pub model: EffortModel,
    /// Of motion and dynamics together, where the model has the parameters of such a fit.
    pub together: Option<JointFit>,
    /// What the sensors' noise leaves of a complete model.
    pub floor: NoiseFloor,
    /// The motion that the model is fitted to.
    pub motion: Motion,
    /// The samples it comes from.
    pub samples: JointSamples,
    /// What simulated recordings of the model leave, with the sensors' noise, rms: the floor with the errors of processing.
    pub simulated_rms: f64,
    /// Whether the coordinate's zero is that of the file, as in tables, and not that of the grasp.
    pub is_table: bool,
}

/// That many noise floors are much more than noise.
pub(super) const MUCH: f64 = 2.0;
/// The floor is taken as at least this share of the effort: numbers in files have so many digits.
pub(crate) const LEAST_FLOOR: f64 = 1.5e-3;

impl Diagnosis {
    /// Whether much more than noise is left.
    pub(super) fn is_far(&self) -> bool {
        self.model.held_out_rms > MUCH * self.floor.rms
    }

    /// What noise and processing leave of a complete model, rms.
    pub(crate) fn floor_of_all(&self) -> f64 {
        self.floor.rms.max(self.simulated_rms)
    }

    /// The effects that have regressors: all but those that were taken out of the samples.
    #[must_use]
    pub fn found(&self) -> Vec<Found> {
        let all = self.effects.iter().map(|effect| effect.found.clone());
        all.filter(|found| !found.taken_out()).collect()
    }

    /// Error on held-out strokes of the model without effect `i`.
    ///
    /// # Errors
    /// [`DynamicsError`].
    pub fn error_without(&self, i: usize) -> Result<f64, DynamicsError> {
        let kept = self.effects.iter().enumerate().filter(|(k, _)| *k != i);
        let found = kept.map(|(_, effect)| effect.found.clone());
        let found: Vec<Found> = found.filter(|found| !found.taken_out()).collect();
        Ok(fit_found(&self.motion, &found)?.held_out_rms)
    }

    /// Fits the model anew after effects were taken out or the motion changed.
    ///
    /// # Errors
    /// [`DynamicsError`].
    pub fn refit(&mut self) -> Result<(), DynamicsError> {
        let mut found = Vec::new();
        let mut before = fit_found(&self.motion, &found)?.held_out_rms;
        for effect in &mut self.effects {
            if effect.found.taken_out() {
                continue;
            }
            found.push(effect.found.clone());
            let after = fit_found(&self.motion, &found)?.held_out_rms;
            effect.held_out_rms = [before, after];
            before = after;
        }
        self.model = fit_named(&self.motion, &mut self.effects)?;
        self.floor = floor_of(&self.samples, &self.motion, &self.model, &self.found())?;
        Ok(())
    }
}

pub(super) fn fit_found(motion: &Motion, found: &[Found]) -> Result<EffortModel, DynamicsError> {
    let mut columns = RigidBody.columns(motion)?;
    for own in in_parallel(found, |found| found.columns(motion)) {
        columns.extend(own?);
    }
    let y = motion.regressor(&motion.tau)?;
    let folds = blocks(motion);
    let mut model = fit_columns(columns.clone(), y.clone(), folds.clone())?;
    // By the same blocks and the same rule as the search.
    let free = columns.into_iter().zip(model.theta.iter());
    let x: Vec<Vec<f64>> = free
        .filter(|(_, theta)| **theta != 0.0)
        .map(|(column, _)| column.values)
        .collect();
    if let Some(outcome) = Problem::new(&x, &[y], &folds).complete(&[]) {
        model.held_out_rms = outcome.mse.sqrt();
    }
    Ok(model)
}

pub(crate) fn floor_of(
    samples: &JointSamples,
    motion: &Motion,
    model: &EffortModel,
    found: &[Found],
) -> Result<NoiseFloor, DynamicsError> {
    let slopes = slopes_of(motion, found, model.theta.as_slice());
    let mut floor = noise::floor(samples, motion, model, slopes)?;
    let least = LEAST_FLOOR * rms(&motion.regressor(&motion.tau)?);
    floor.rms = floor.rms.max(least);
    floor.wrench_rms = floor.wrench_rms.max(least);
    Ok(floor)
}
