//! The named effects as motion and effort together have them: where a magnet's pull ends is blurred along the smoothed motion by as much as the position
//! sensor wanders, and its size with it; along a motion that the wrench informs it is not.

use nalgebra::DMatrix;

use super::model::Found;
use super::search::Diagnosis;
use super::spread::{SHOWN_BELOW, by_closed_end, wander};
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::{DynamicsError, EffortModel, fit_shapes};
use crate::effect::load::{CATCH, restated};
use crate::effect::{Effect, RigidBody};
use crate::samples::quantile;

/// Inertia, Coulomb and viscous friction come first.
const RIGID: usize = 3;
/// Along the smoothed motion what both have may leave so much more than what that has itself. Where it leaves more, an effect was taken for wander.
const LEAVES_BELOW: f64 = 1.05;

/// Takes parameters and shapes of the named effects, and how well they are known, from a fit of motion and effort together, where that foretells
/// better. It takes from the wrench how the joint moved, so it presumes that nothing is lacking: only where no more than the floor is left.
///
/// # Errors
/// When an effect has no regressor on the motion.
pub(crate) fn take_from_both(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let found = diagnosis.found();
    let motion = &diagnosis.motion;
    let floor = diagnosis.floor.rms.max(diagnosis.simulated_rms);
    let is_lacking = diagnosis.model.held_out_rms > EXPLAINED_BELOW * floor;
    if is_lacking || found.iter().all(|found| found.freedom(motion).is_empty()) {
        return Ok(());
    }
    let mut effects: Vec<&dyn Effect> = vec![&RigidBody];
    effects.extend(found.iter().map(|found| found as &dyn Effect));
    let most = LEAVES_BELOW * diagnosis.model.rms;
    let shaped = fit_shapes(motion, &effects)?.filter(|shaped| shaped.model.rms < most);
    let Some(mut shaped) = shaped else {
        return Ok(());
    };
    shaped.model.held_out_rms = diagnosis.model.held_out_rms;
    let first_step = shaped.model.theta.len();
    let (mut term, mut step) = (RIGID, 0);
    let (closed, visits) = closed_end(&shaped.lowest);
    let closed_known_to = wander(&diagnosis.samples) / visits.sqrt();
    for effect in &mut diagnosis.effects {
        if effect.found.taken_out() {
            continue;
        }
        let found = &effect.found;
        let (terms, free) = (found.terms().count(), found.freedom(motion));
        let of_own = step..step + free.len();
        let mut moved = found.with_steps(motion, &shaped.steps[of_own.clone()]);
        // A row per number of the effect, a column per number of the fit.
        let count = terms + moved.shape.len();
        let mut by = DMatrix::zeros(count, shaped.covariance.nrows());
        for k in 0..terms {
            by[(k, term + k)] = 1.0;
        }
        let per_step = moved.steps_on(motion).into_iter();
        for ((k, [low, high]), (shape, per_step)) in of_own.clone().zip(free).zip(per_step) {
            let k = first_step + k;
            // Of one that the data do not show only its limits are known.
            let known = (0.5 * (high - low)).powi(2);
            if shaped.covariance[(k, k)] < SHOWN_BELOW * known {
                by[(terms + shape, k)] = per_step;
            }
        }
        if moved.kind.is(&CATCH) && terms == 1 {
            restate(&mut moved, &mut shaped.model, (term, closed), &mut by);
        }
        effect.spread = &by * &shaped.covariance * by.transpose();
        let own = &shaped.model.theta.as_slice()[term..term + terms];
        let restated = by_closed_end(&moved, own) * closed_known_to;
        effect.spread += &restated * restated.transpose();
        for k in 0..terms {
            let number = &mut shaped.model.terms[term + k];
            let std = effect.spread[(k, k)].max(0.0).sqrt();
            number.std = number.std.map(|_| std);
        }
        effect.found = moved;
        term += terms;
        step = of_own.end;
    }
    diagnosis.model = shaped.model;
    diagnosis.together = Some(shaped.fit);
    Ok(())
}

/// Where the joint is closed, of the lowest places of its visits there, and of how many visits that is: above the lowest tenth of them, whose places
/// are what the position sensor errs.
fn closed_end(lowest: &[f64]) -> (f64, f64) {
    const OUTLYING: f64 = 0.1;
    let visits = OUTLYING * lowest.len() as f64;
    (quantile(lowest, OUTLYING), visits.max(1.0))
}

/// States a magnet's pull, which is parameter `term`, at the closed end.
fn restate(
    found: &mut Found,
    model: &mut EffortModel,
    (term, closed): (usize, f64),
    by: &mut DMatrix<f64>,
) {
    let closed = closed + found.datum;
    let (pull, slopes) = restated(model.theta[term], &mut found.shape, closed);
    model.theta[term] = pull;
    model.terms[term].value = model.terms[term].value.map(|_| pull);
    let (of_pull, of_reach) = (by.row(0).into_owned(), by.row(2).into_owned());
    for (row, [by_pull, by_reach]) in [0, 2].into_iter().zip(slopes) {
        by.set_row(row, &(by_pull * &of_pull + by_reach * &of_reach));
    }
}
