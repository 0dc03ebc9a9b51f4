//! Of what has two forms, as a magnet's pull has, the data may not tell which it is: then its numbers are known no better than the two differ.

use nalgebra::DVector;

use super::diagnosis::{Diagnosis, fit_found};
use super::model::{Found, Ground, RIGID};
use super::shapes::{ENOUGH_AT_LAST, polished};
use super::shown;
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::{DynamicsError, EffortModel};
use crate::effect::library::Search;

/// Adds to the stated uncertainty of each effect that has two forms what its numbers differ by in the other one, by how likely that is. What is
/// left beyond noise would be no measure of that.
///
/// # Errors
/// When the model cannot be fitted as it is.
pub(crate) fn state_forms(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let found = diagnosis.found();
    let floor = diagnosis.floor_of_all();
    let is_lacking = diagnosis.model.held_out_rms > EXPLAINED_BELOW * floor;
    if is_lacking || found.iter().all(|found| form_of(found).is_none()) {
        return Ok(());
    }
    let (motion, theta) = (&diagnosis.motion, &diagnosis.model.theta);
    let mut ground = Ground::of(motion.clone())?;
    ground.active = [theta[0] > 0.0, true, theta[2] > 0.0];
    let x = ground.columns(&[])?;
    let nearest = |found: Vec<Found>| polished(&ground, &x, &ground.y, found, ENOUGH_AT_LAST);
    let found = nearest(found);
    let Some(model) = shown(fit_found(motion, &found))? else {
        return Ok(());
    };
    let regressed = diagnosis.effects.iter_mut();
    let regressed = regressed.filter(|effect| !effect.found.taken_out());
    for (k, effect) in regressed.enumerate() {
        let Some(form) = form_of(&found[k]) else {
            continue;
        };
        let mut other = found.clone();
        other[k].shape[form] = 1.0 - other[k].shape[form];
        let other = nearest(other);
        let Some(its) = shown(fit_found(motion, &other))? else {
            continue;
        };
        let mut moved = numbers(&other, &its, k) - numbers(&found, &model, k);
        // What the data do not show they do not show in another form either; and the form itself is a choice.
        let spread = &mut effect.spread;
        if spread.nrows() != moved.len() {
            continue;
        }
        for i in 0..moved.len() {
            moved[i] *= f64::from(spread[(i, i)] > 0.0);
        }
        *spread += &moved * moved.transpose() * likelihood(&its, &model);
    }
    Ok(())
}

/// Which of its shape parameters is the form.
fn form_of(found: &Found) -> Option<usize> {
    let mut shapes = found.kind.shape.iter();
    shapes.position(|shape| shape.2 == Search::Form)
}

/// Terms and then shape of effect `k`.
fn numbers(found: &[Found], model: &EffortModel, k: usize) -> DVector<f64> {
    let before: usize = found[..k].iter().map(|found| found.terms().count()).sum();
    let terms = model.theta.iter().skip(RIGID + before);
    let terms = terms.take(found[k].terms().count());
    let numbers = terms.chain(&found[k].shape).copied();
    DVector::from_vec(numbers.collect())
}

/// Of the first of two models, one of which is true, by what they leave of strokes that were held out.
fn likelihood(one: &EffortModel, other: &EffortModel) -> f64 {
    let [one_rms, other_rms] = [one, other].map(|m| m.held_out_rms.max(f64::MIN_POSITIVE));
    let worse = (one_rms / other_rms).ln();
    1.0 / (1.0 + (other.effective_samples * worse).exp())
}
