//! The full model: the named effects and the mechanism that takes up what they leave, fitted at once, and what each of them keeps of a load
//! that both can be.

use nalgebra::DVector;

use super::EXPLAINED_BELOW;
use crate::diagnose::{Diagnosis, Found, beside_rigid, is_smooth_load, shown};
use crate::dynamics::{DynamicsError, EffortModel, JointFit, fit_jointly, fit_parametric};
use crate::effect::BiasDrift;
use crate::effect::friction::ASYMMETRIC;
use crate::effect::measurement::SENSOR_DRIFT;
use crate::motion::Motion;
use crate::parallel::in_parallel_on;

/// Where Coulomb friction is among the parameters.
const COULOMB: usize = 1;

/// Named effects are left to the mechanism when it does so much better on held-out strokes.
const LEFT_BELOW: f64 = 0.97;

/// Samples at the work rate, 20 min of them, from which on memory counts for more than time.
const MANY: usize = 120_000;

/// A mechanism that foretells held-out strokes so many times worse than the named effects by themselves is none.
const ALONE_ABOVE: f64 = 1.5;
/// The same where motion and effort together have the effects' parameters.
const KNOWN_ALONE_ABOVE: f64 = 1.02;

/// I, mu, b, the named effects and the mechanism at once; the terms are I, mu, b, and what is left of an effect beside the
/// mechanism stands in `theta` only. Where the named effects leave more than the floor, their shapes may be wrong: then those
/// that a mechanism can be by itself are left to it, if that foretells held-out strokes better; then the last value is true.
pub(super) fn with_mechanism(
    motion: &Motion,
    diagnosis: &Diagnosis,
) -> Result<(EffortModel, Option<JointFit>, bool), DynamicsError> {
    let mut left = false;
    let found = diagnosis.found();
    let by_state = |found: &Found| found.kind.at.is_some();
    // Beside a load that may be any constant a friction of one way is one of both.
    let tells = |found: &Found| !found.kind.is(&ASYMMETRIC);
    let floor = diagnosis.floor_of_all();
    let mut used = vec![found.iter().map(tells).collect::<Vec<_>>()];
    let may_leave = found.iter().any(|found| by_state(found) && tells(found));
    if diagnosis.model.held_out_rms > EXPLAINED_BELOW * floor && may_leave {
        used.push(found.iter().map(|found| !by_state(found)).collect());
    }
    // Side by side only while that is no question of memory: of an hour each takes some hundred megabytes.
    let at_once = if motion.q.len() < MANY { usize::MAX } else { 1 };
    let fits = in_parallel_on(at_once, &used, |used| {
        beside_mechanism(
            motion,
            diagnosis.is_table,
            &found,
            used,
            EXPLAINED_BELOW * floor,
        )
    });
    let mut fits = fits.into_iter();
    let Some(all) = fits.next() else {
        unreachable!("one item has one result")
    };
    let (mut model, mut jointly) = all?;
    if let Some(without) = fits.next() {
        let without = without?;
        if without.0.held_out_rms < LEFT_BELOW * model.held_out_rms {
            (model, jointly) = without;
            left = true;
        }
    }
    let alone = shown(fit_parametric(motion, &beside_rigid(&found)))?;
    let above = if diagnosis.together.is_some() {
        KNOWN_ALONE_ABOVE
    } else {
        ALONE_ABOVE
    };
    if let Some(mut alone) = alone.filter(|alone| above * alone.held_out_rms < model.held_out_rms) {
        // A mechanism that takes up what a named effect is: the effects alone foretell. What the full model does not know stays unknown.
        jointly.clone_from(&diagnosis.together);
        if jointly.is_some() {
            alone = EffortModel {
                held_out_rms: alone.held_out_rms,
                ..diagnosis.model.clone()
            };
        }
        model = known_to_all(alone, [&model, &diagnosis.model]);
        for (term, stated) in jointly
            .iter_mut()
            .flat_map(|fit| &mut fit.terms)
            .zip(&model.terms)
        {
            term.std = stated.std;
        }
        left = false;
    } else {
        keep_loads_named(&mut model, jointly.as_mut(), diagnosis, left);
    }
    model.withdraw_friction_of_one_way(motion);
    model.terms.truncate(3);
    model.covariance = model.covariance.view((0, 0), (3, 3)).into_owned();
    let terms = &model.terms;
    model
        .not_identified
        .retain(|name, _| terms.iter().any(|term| term.name == *name));
    // What the data do not show they do not show here either.
    for (term, plain) in jointly.iter_mut().flat_map(|fit| &mut fit.terms).zip(terms) {
        if plain.value.is_none() {
            (term.value, term.std) = (None, None);
        }
    }
    Ok((model, jointly, left))
}

/// A load over the whole range can be a named effect's or the mechanism's, and nothing tells which; nor does anything tell a friction of one way from
/// a constant load and half of it both ways. They are given back to the effects: of loads what these have in the named model, unless they are `left` to the
/// mechanism; of the friction in the full model, whatever this has, the same part as there. The effort within the probed range stays the same.
fn keep_loads_named(
    full: &mut EffortModel,
    jointly: Option<&mut JointFit>,
    diagnosis: &Diagnosis,
    left: bool,
) {
    let Some(mechanism) = &mut full.mechanism else {
        return;
    };
    let named = &diagnosis.model;
    let (mut both_ways, mut at) = (1.0, 3);
    for found in diagnosis.found() {
        // What the named effect has more of, by its terms, is taken out of g.
        let mut more = [0.0; 2];
        let used = found.used.iter().enumerate().filter(|(_, used)| **used);
        for (k, _) in used {
            let value = named.theta[at];
            let kept = if found.kind.is(&ASYMMETRIC) {
                let [both, one] = split(named.theta[COULOMB], value);
                both_ways = both;
                Some(one * full.theta[COULOMB].max(0.0))
            } else {
                (!left && is_smooth_load(found.kind)).then_some(value)
            };
            if let Some(value) = kept {
                more[k] = value - full.theta[at];
                full.theta[at] = value;
            }
            at += 1;
        }
        if found.kind.is(&ASYMMETRIC) {
            mechanism.take_load(|_| 0.5 * more[0] * found.shape[0]);
        } else if let Some(of_state) = found.kind.at.filter(|_| more != [0.0; 2]) {
            mechanism.take_load(|q| {
                let [first, second] = of_state(&found.shape, q + found.datum, 0.0);
                more[0] * first + more[1] * second
            });
        }
    }
    if both_ways == 1.0 {
        return;
    }
    full.theta[COULOMB] *= both_ways;
    let std = named.covariance[(COULOMB, COULOMB)].max(0.0).sqrt();
    let jointly = jointly.and_then(|fit| fit.terms.get_mut(COULOMB));
    for term in full.terms.get_mut(COULOMB).into_iter().chain(jointly) {
        term.value = term.value.map(|value| both_ways * value);
        term.std = term.std.map(|own| own.max(std));
    }
    // What is left of it may not be known where the sum is.
    widen(full, COULOMB, named);
    forget(full, COULOMB, named);
}

/// The friction of both ways and what one way has `more`, for each of their mean.
fn split(coulomb: f64, more: f64) -> [f64; 2] {
    let (both, more) = (coulomb.max(0.0), more.max(0.0));
    if more == 0.0 {
        return [1.0, 0.0];
    }
    let mean = both + 0.5 * more;
    [both / mean, more / mean]
}

/// `model` as uncertain in inertia and friction as any of the others says, and without what `full` has not.
fn known_to_all(mut model: EffortModel, others: [&EffortModel; 2]) -> EffortModel {
    let [full, _] = others;
    for j in 0..model.terms.len().min(3) {
        for other in others {
            widen(&mut model, j, other);
        }
        forget(&mut model, j, full);
    }
    model
}

/// Term `j` as uncertain as the other model says, at least.
fn widen(model: &mut EffortModel, j: usize, other: &EffortModel) {
    let widest = model.covariance[(j, j)].max(other.covariance[(j, j)]);
    model.covariance[(j, j)] = widest;
    let term = &mut model.terms[j];
    term.std = term.std.map(|_| widest.max(0.0).sqrt());
}

/// Term `j` as unknown as in the other model, for the same reason.
fn forget(model: &mut EffortModel, j: usize, other: &EffortModel) {
    let term = &mut model.terms[j];
    if other.terms[j].value.is_some() {
        return;
    }
    (term.value, term.std) = (None, None);
    if let Some(reason) = other.not_identified.get(&term.name) {
        let known = model.not_identified.entry(term.name.clone());
        known.or_insert_with(|| reason.clone());
    }
}

/// I, mu, b, those of `found` that are `used`, and the mechanism, beside what a force sensor usually drifts; the parameters of the
/// others are zero.
fn beside_mechanism(
    motion: &Motion,
    is_table: bool,
    found: &[Found],
    used: &[bool],
    whole_below: f64,
) -> Result<(EffortModel, Option<JointFit>), DynamicsError> {
    let some = found.iter().zip(used).filter(|(_, used)| **used);
    let mut effects = beside_rigid(some.map(|(found, _)| found));
    let is_named = |found: &Found| found.kind.name == SENSOR_DRIFT.name;
    if !is_table && !found.iter().any(is_named) {
        effects.push(&BiasDrift);
    }
    let (mut model, jointly) = fit_jointly(motion, &effects, whole_below)?;
    let mut fitted = model.theta.iter().copied();
    let mut theta: Vec<f64> = fitted.by_ref().take(3).collect();
    for (found, used) in found.iter().zip(used) {
        for _ in found.terms() {
            theta.push(if *used {
                fitted.next().unwrap_or(0.0)
            } else {
                0.0
            });
        }
    }
    model.bias_drift = BiasDrift::range(&fitted.collect::<Vec<f64>>());
    model.theta = DVector::from_vec(theta);
    Ok((model, jointly))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_of_both_ways_and_of_one_have_their_mean() {
        for ([coulomb, more], each) in [
            ([3.0, 2.0], [0.75, 0.5]),
            ([0.0, 2.0], [0.0, 2.0]),
            ([3.0, 0.0], [1.0, 0.0]),
            ([0.0, 0.0], [1.0, 0.0]),
        ] {
            assert_eq!(split(coulomb, more), each);
        }
    }
}
