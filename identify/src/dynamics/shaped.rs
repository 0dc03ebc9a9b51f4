//! Effects with their shapes, motion and dynamics fitted together.

use nalgebra::{DMatrix, DVector};

use super::design::Design;
use super::joint::{self, JointFit, Together};
use super::{DynamicsError, EffortModel};
use crate::effect::Effect;
use crate::mechanism::SplineMechanism;
use crate::motion::Motion;

/// Effects with their shapes, fitted together with the motion.
pub(crate) struct Shaped {
    /// Parameters of the effects.
    pub(crate) theta: DVector<f64>,
    /// Steps by which the shapes were moved, effect by effect.
    pub(crate) steps: Vec<f64>,
    /// Of the parameters and these steps.
    pub(crate) covariance: DMatrix<f64>,
    /// Lowest place of each visit of the fitted motion to its low end.
    pub(crate) lowest: Vec<f64>,
    /// What it says of inertia and friction.
    pub(crate) fit: JointFit,
}

/// Fits the parameters of `effects`, which are those of `plain`, and their shapes together with the motion, without a mechanism. Nothing where that does
/// not come to rest, where a shape goes to its limit or inertia or friction to another bound than in `plain`, where it is not known how uncertain it is, or
/// where held-out strokes are foretold no better than along the smoothed motion.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn fit_shapes(
    motion: &Motion,
    effects: &[&dyn Effect],
    plain: &EffortModel,
) -> Result<Option<Shaped>, DynamicsError> {
    let design = Design::new(motion, effects, None)?;
    let smoothing = [0.0; 2];
    let mechanism = SplineMechanism::over(motion);
    let start = joint::Plain {
        theta: plain.theta.as_slice(),
        mechanism: &mechanism,
        design: &design,
        smoothing: &smoothing,
    };
    let held_out_rms = design.held_out(&smoothing);
    let is_better = |one: &Together| {
        let limits = effects
            .iter()
            .flat_map(|effect| effect.shape_limits(motion));
        // One that began at its limit may stay there.
        let inside =
            |([low, high], step): ([f64; 2], &f64)| *step == 0.0 || low < *step && *step < high;
        one.converged
            && limits.zip(&one.steps).all(inside)
            && one.has_bounds_of(&plain.theta)
            && one.covariance.iter().all(|v| v.is_finite())
            && one.fit.held_out_rms <= held_out_rms
    };
    let together = joint::fit(motion, effects, &start)?.filter(is_better);
    Ok(together.map(|mut together| {
        together.doubt(&plain.theta, 0.0, &plain.covariance);
        Shaped {
            theta: together.theta,
            steps: together.steps,
            covariance: together.covariance,
            lowest: together.lowest,
            fit: JointFit {
                stands: true,
                ..together.fit
            },
        }
    }))
}

/// The model of `effects` with these parameters, their covariance, and the error on held-out strokes that the effects have along the smoothed motion.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn model_with(
    motion: &Motion,
    effects: &[&dyn Effect],
    theta: &DVector<f64>,
    covariance: DMatrix<f64>,
) -> Result<EffortModel, DynamicsError> {
    let design = Design::new(motion, effects, None)?;
    let held_out_rms = design.held_out(&[0.0; 2]);
    Ok(design.model(theta.as_slice(), covariance, None, held_out_rms))
}
