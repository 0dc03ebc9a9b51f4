//! The named effects as motion and effort together have them: where a magnet's pull ends is blurred along the smoothed motion by as much as the position
//! sensor wanders, and its size with it; along a motion that the wrench informs it is not.

use nalgebra::{DMatrix, DVector};

use super::confirm::shown;
use super::diagnosis::Diagnosis;
use super::model::{Found, RIGID, beside_rigid};
use super::spread::{SHOWN_BELOW, by_closed_end, wander};
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::{DynamicsError, Shaped, fit_shapes, model_with};
use crate::effect::Effect;
use crate::effect::load::{CATCH, restated};
use crate::motion::Motion;
use crate::samples::quantile;

/// Along the smoothed motion what both have may leave so much more than what that has itself. Where it leaves more, an effect was taken for wander.
const LEAVES_BELOW: f64 = 1.05;

/// Takes parameters and shapes of the named effects, and how well they are known, from a fit of motion and effort together, where that foretells
/// better. It takes from the wrench how the joint moved, so it presumes that nothing is lacking: only where no more than the floor is left.
///
/// # Errors
/// When an effect has no regressor on the motion.
pub(crate) fn take_from_both(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let mut found = diagnosis.found();
    let (motion, plain) = (&diagnosis.motion, &diagnosis.model);
    let floor = diagnosis.floor_of_all();
    let is_lacking = plain.held_out_rms > EXPLAINED_BELOW * floor;
    if is_lacking || found.iter().all(|one| one.shape_limits(motion).is_empty()) {
        return Ok(());
    }
    let fitted = fit_shapes(motion, &beside_rigid(&found), plain);
    let Some(mut shaped) = shown(fitted)?.flatten() else {
        return Ok(());
    };
    let closed_known_to = move_to(&mut found, motion, &mut shaped, wander(&diagnosis.samples));
    let (theta, params) = (&shaped.theta, shaped.theta.len());
    let own = shaped.covariance.view((0, 0), (params, params));
    let model = model_with(motion, &beside_rigid(&found), theta, own.into_owned());
    let Some(mut model) = shown(model)?.filter(|model| model.rms < LEAVES_BELOW * plain.rms) else {
        return Ok(());
    };
    // What the verdict asks for is the error on the blocks that the search held out.
    model.held_out_rms = plain.held_out_rms;
    let mut numbers = (RIGID, params);
    let regressed = diagnosis.effects.iter_mut();
    let regressed = regressed.filter(|effect| !effect.found.taken_out());
    for (effect, moved) in regressed.zip(found) {
        effect.spread = spread(&moved, motion, &shaped, &mut numbers, closed_known_to);
        effect.found = moved;
    }
    diagnosis.model = model;
    diagnosis.together = Some(shaped.fit);
    Ok(())
}

/// Moves the shapes of `found` by the steps fitted, and states magnets at the closed end of the fitted motion; gives how well that is known, where the
/// position sensor wanders by so much.
fn move_to(found: &mut [Found], motion: &Motion, shaped: &mut Shaped, wander: f64) -> f64 {
    let (closed, known_to) = closed_end(&shaped.lowest, wander);
    let (mut term, first_step) = (RIGID, shaped.theta.len());
    let mut step = first_step;
    for found in found {
        let count = found.shape_limits(motion).len();
        let own = &shaped.steps[step - first_step..][..count];
        *found = found.with_steps(motion, own);
        let (pull, reach) = (shaped.theta[term], found.shape.get(1).copied());
        let is_magnet = found.kind.is(&CATCH);
        let there = closed + found.datum;
        let stated = is_magnet.then(|| restated(pull, &mut found.shape, there));
        if let (Some((pull, slopes)), Some(reach)) = (stated.flatten(), reach) {
            shaped.theta[term] = pull;
            // Steps of the reach are in shares of it, and it grows by as much as it did.
            let mut by = DMatrix::identity(shaped.covariance.nrows(), shaped.covariance.nrows());
            by[(term, term)] = slopes[0];
            by[(term, step)] = slopes[1] * reach;
            by[(step, step)] = reach / found.shape[1];
            shaped.covariance = &by * &shaped.covariance * by.transpose();
        }
        term += found.terms().count();
        step += count;
    }
    known_to
}

/// Where the joint is closed, of the lowest places of its visits there, and how well that is known: above the lowest tenth of them where these are apart
/// by no more than the position sensor wanders; else at the lowest, where it was closed and the other times was not.
fn closed_end(lowest: &[f64], wander: f64) -> (f64, f64) {
    const OUTLYING: f64 = 0.1;
    let [first, usual] = [0.0, OUTLYING].map(|share| quantile(lowest, share));
    if usual - first > wander {
        return (first, wander);
    }
    let visits = (OUTLYING * lowest.len() as f64).max(1.0);
    (usual, (usual - first).hypot(wander / visits.sqrt()))
}

/// Covariance of the terms of an effect, which is where it was fitted, and then of its shape; `numbers` = the places of its first term and its first step in
/// the fit, which become those of the next effect.
fn spread(
    moved: &Found,
    motion: &Motion,
    shaped: &Shaped,
    (term, step): &mut (usize, usize),
    closed_known_to: f64,
) -> DMatrix<f64> {
    let (terms, limits) = (moved.terms().count(), moved.shape_limits(motion));
    let count = terms + moved.shape.len();
    // A row per number of the effect, a column per number of the fit.
    let mut by = DMatrix::zeros(count, shaped.covariance.nrows());
    for k in 0..terms {
        by[(k, *term + k)] = 1.0;
    }
    let mut unshown = Vec::new();
    let steps = moved.steps_on(motion).into_iter();
    for (k, ((shape, per_step), [low, high])) in (*step..).zip(steps.zip(&limits)) {
        by[(terms + shape, k)] = per_step;
        let known = (0.5 * (high - low)).powi(2);
        if shaped.covariance[(k, k)] >= SHOWN_BELOW * known {
            unshown.push(terms + shape);
        }
    }
    let own = &shaped.theta.as_slice()[*term..*term + terms];
    let by_end: DVector<f64> = by_closed_end(moved, own) * closed_known_to;
    let mut out = &by * &shaped.covariance * by.transpose() + &by_end * by_end.transpose();
    // Of one that the data do not show only its limits are known.
    for k in unshown {
        out.row_mut(k).fill(0.0);
        out.column_mut(k).fill(0.0);
    }
    *term += terms;
    *step += limits.len();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_closed_end_is_where_visits_end_alike_and_else_the_lowest() {
        let at_a_stop: Vec<f64> = (0..40).map(|k| 1e-4 * f64::from(k % 20)).collect();
        let (closed, known_to) = closed_end(&at_a_stop, 1e-3);
        assert!((closed - 2e-4).abs() < 1e-12, "{closed}");
        assert!(
            (known_to - 2e-4_f64.hypot(0.5e-3)).abs() < 1e-12,
            "{known_to}"
        );
        let mut short_of_it = vec![8e-3; 39];
        short_of_it.push(0.0);
        assert_eq!(closed_end(&short_of_it, 1e-3), (0.0, 1e-3));
        assert_eq!(closed_end(&[2e-3, 0.0, 1e-3], 1e-3), (0.0, 1e-3));
    }
}
