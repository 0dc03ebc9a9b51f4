//! Effects with their shapes, motion and dynamics fitted together.

use nalgebra::DMatrix;

use super::design::Design;
use super::joint::{self, JointFit, Together};
use super::{DynamicsError, EffortModel};
use crate::effect::Effect;
use crate::mechanism::SplineMechanism;
use crate::motion::Motion;

/// Effects with their shapes, fitted together with the motion.
pub(crate) struct Shaped {
    /// With the parameters, its residual that along the smoothed motion, as its error on held-out strokes.
    pub(crate) model: EffortModel,
    /// Steps by which the shapes were moved, effect by effect.
    pub(crate) steps: Vec<f64>,
    /// Of the parameters and these steps.
    pub(crate) covariance: DMatrix<f64>,
    /// Lowest place of each visit of the fitted motion to its low end.
    pub(crate) lowest: Vec<f64>,
    /// What it says of inertia and friction.
    pub(crate) fit: JointFit,
}

/// Fits the parameters of `effects` and their shapes together with the motion, without a mechanism; nothing where that does not come to rest, where a
/// shape goes to its limit, or where held-out strokes are foretold no better than along the smoothed motion.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn fit_shapes(
    motion: &Motion,
    effects: &[&dyn Effect],
) -> Result<Option<Shaped>, DynamicsError> {
    let design = Design::new(motion, effects, None)?;
    let smoothing = [0.0; 2];
    let (theta, mechanism) = (design.solve(&smoothing), SplineMechanism::over(motion));
    let plain = joint::Plain {
        theta: theta.as_slice(),
        mechanism: &mechanism,
        design: &design,
        smoothing: &smoothing,
    };
    let held_out_rms = design.held_out(&smoothing);
    let is_better = |one: &Together| {
        let limits = effects.iter().flat_map(|effect| effect.freedom(motion));
        let mut within = limits.zip(&one.steps);
        let at_rest =
            one.converged && within.all(|([low, high], step)| low < *step && *step < high);
        at_rest && one.fit.held_out_rms <= held_out_rms
    };
    let Some(together) = joint::fit(motion, effects, &plain)?.filter(is_better) else {
        return Ok(None);
    };
    let moved = joint::moved(motion, effects, &together.steps);
    let moved: Vec<&dyn Effect> = moved.effects(effects).collect();
    let (theta, params) = (&together.theta, together.theta.len());
    let own = together.covariance.view((0, 0), (params, params));
    let design = Design::new(motion, &moved, None)?;
    Ok(Some(Shaped {
        model: design.model(theta.as_slice(), own.into_owned(), None, held_out_rms),
        steps: together.steps,
        covariance: together.covariance,
        lowest: together.lowest,
        fit: JointFit {
            stands: true,
            ..together.fit
        },
    }))
}
