//! Doubt: what is named while more than noise is left is taken back where it explains too little to be sure of its name.

use super::diagnosis::{NamedEffect, Refused, fit_found};
use super::model::{Found, Ground, is_smooth_load};
use super::score::Problem;
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::DynamicsError;
use crate::effect::load::DETENT;

/// While more than the floor is left, something is missing or has the wrong name: takes back, one after the other, what explains
/// too little beside all others to be sure of its name and less than what stays above the floor (curves: whatever stays), and all curves but one,
/// because several could make up any load. Three of them do so to the floor, and are taken back whatever is left.
///
/// Gives the corners that the load of no name has in the place of notches: all are judged beside them.
pub(super) fn drop_doubtful(
    ground: &Ground,
    floor: f64,
    known: impl Fn(&Found) -> bool,
    effects: &mut Vec<NamedEffect>,
    refused: &mut Vec<Refused>,
) -> Result<Vec<f64>, DynamicsError> {
    if effects.iter().filter(|e| is_curve(&e.found)).count() >= ANY_LOAD {
        let curves = effects.extract_if(.., |e| is_curve(&e.found));
        refused.extend(curves.map(|curve| Refused {
            name: curve.found.kind.name,
            reason: format!(
                "{ANY_LOAD} notches and ripples together make up any load: this one has no name"
            ),
            held_out_rms: curve.held_out_rms,
        }));
    }
    let corners = corners_of(ground, floor, effects)?;
    let curve = &curve_with(ground, &corners)?;
    drop_small(ground, curve, floor, &known, effects, refused)?;
    loop {
        let all: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
        if fit_found(&ground.motion, &all)?.held_out_rms <= EXPLAINED_BELOW * floor {
            break;
        }
        let curves = all.iter().filter(|found| is_curve(found)).count();
        let mut least: Option<(usize, f64, [f64; 2])> = None;
        for (i, found) in all.iter().enumerate() {
            let errors = beside_others(ground, curve, &all, i)?;
            let share = share(errors);
            let little = if !is_curve(found) {
                explains_little(errors, floor)
            } else if curve.is_empty() {
                share < SURE_CURVE
            } else {
                share < SURE_BESIDE_CURVE
            };
            let doubtful = little || is_curve(found) && curves > 1;
            if doubtful && !known(found) && least.is_none_or(|(_, old, _)| share < old) {
                least = Some((i, share, errors));
            }
        }
        let Some((i, _, errors)) = least else {
            break;
        };
        let gone = effects.remove(i).found;
        let mut doubt = doubt(gone.kind.name, errors, floor);
        if gone.kind.is(&DETENT) {
            for at in corners.iter().filter(|at| acts_at(&gone, **at)) {
                doubt.reason += &format!("; the load has a corner at {at:.3}");
            }
        }
        refused.push(doubt);
    }
    let mut found: Vec<Found> = Vec::new();
    let mut before = fit_found(&ground.motion, &found)?.held_out_rms;
    for effect in effects.iter_mut() {
        found.push(effect.found.clone());
        let after = fit_found(&ground.motion, &found)?.held_out_rms;
        effect.held_out_rms = [before, after];
        before = after;
    }
    Ok(corners)
}

/// While very much is left: takes back what explains but a small part of what is there without it. All at once, because what goes makes the share
/// of what stays smaller; and no load that a curve would hold, because it is judged without one.
fn drop_small(
    ground: &Ground,
    curve: &[Vec<f64>],
    floor: f64,
    known: impl Fn(&Found) -> bool,
    effects: &mut Vec<NamedEffect>,
    refused: &mut Vec<Refused>,
) -> Result<(), DynamicsError> {
    let all: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
    for i in (0..all.len()).rev() {
        let found = &all[i];
        if !is_beside_curve(found) || is_curve(found) || known(found) {
            continue;
        }
        let errors = beside_others(ground, curve, &all, i)?;
        if errors[1] > VERY_FAR * floor && share(errors) < SURE_VERY_FAR {
            effects.remove(i);
            refused.push(doubt(found.kind.name, errors, floor));
        }
    }
    Ok(())
}

/// Corners of a load of no name, such as a stop's, which the smooth curve of the search rounds off: places where a notch acts and a corner in its place
/// errs less.
fn corners_of(
    ground: &Ground,
    floor: f64,
    effects: &[NamedEffect],
) -> Result<Vec<f64>, DynamicsError> {
    let mut corners = Vec::new();
    if ground.curve.is_empty() {
        return Ok(corners);
    }
    let all: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
    for i in (0..all.len()).filter(|&i| all[i].kind.is(&DETENT)) {
        let curve = curve_with(ground, &corners)?;
        let [without, with] = beside_others(ground, &curve, &all, i)?;
        if with <= EXPLAINED_BELOW * floor || without <= with {
            continue;
        }
        let mut others = all.clone();
        let notch = others.remove(i);
        let mut x = ground.plain_columns(&others)?;
        x.extend(curve);
        let efforts = [ground.y.clone()];
        let problem = Problem::new(&x, &efforts, &ground.folds);
        let (centre, width) = (notch.shape[0], notch.shape[1]);
        let [low, high] = ground.scope().q;
        let error_at = |at: f64| {
            if !acts_at(&notch, at) || !(low..=high).contains(&at) {
                return Ok(f64::INFINITY);
            }
            let outcome = problem.complete(&[&corner(ground, at)?]);
            Ok::<f64, DynamicsError>(outcome.map_or(f64::INFINITY, |outcome| outcome.mse.sqrt()))
        };
        let (mut at, mut error, mut step) = (centre, error_at(centre)?, width);
        while step > width / 50.0 {
            for place in [at - step, at + step] {
                let there = error_at(place)?;
                if there < error {
                    (at, error) = (place, there);
                }
            }
            step /= 1.5;
        }
        if error < with {
            corners.push(at);
        }
    }
    Ok(corners)
}

/// Whether a place is one where a notch acts.
fn acts_at(notch: &Found, at: f64) -> bool {
    (at - notch.shape[0]).abs() <= 2.0 * notch.shape[1]
}

/// The curve of the search with corners, where there is one.
pub(super) fn curve_with(ground: &Ground, corners: &[f64]) -> Result<Vec<Vec<f64>>, DynamicsError> {
    let mut curve = ground.curve.clone();
    for at in corners {
        curve.push(corner(ground, *at)?);
    }
    Ok(curve)
}

/// Column of a load that begins at a place and grows with the way from there.
fn corner(ground: &Ground, at: f64) -> Result<Vec<f64>, DynamicsError> {
    let beyond: Vec<f64> = ground.motion.q.iter().map(|q| (q - at).max(0.0)).collect();
    Ok(ground.motion.regressor(&beyond)?)
}

/// Held-out errors without and with effect `i`, beside the others and, unless it is a load that `curve` would hold, beside that.
fn beside_others(
    ground: &Ground,
    curve: &[Vec<f64>],
    all: &[Found],
    i: usize,
) -> Result<[f64; 2], DynamicsError> {
    let mut others = all.to_vec();
    others.remove(i);
    let curve = if is_beside_curve(&all[i]) { curve } else { &[] };
    Ok([
        error_beside(ground, &others, curve)?,
        error_beside(ground, all, curve)?,
    ])
}

fn is_curve(found: &Found) -> bool {
    CURVES.contains(&found.kind.name)
}

fn is_beside_curve(found: &Found) -> bool {
    !is_smooth_load(found.kind) && found.kind.name != "catch"
}

/// Held-out error of a model, beside the columns of a curve if there are any.
pub(super) fn error_beside(
    ground: &Ground,
    found: &[Found],
    curve: &[Vec<f64>],
) -> Result<f64, DynamicsError> {
    if curve.is_empty() {
        return Ok(fit_found(&ground.motion, found)?.held_out_rms);
    }
    let mut x = ground.plain_columns(found)?;
    x.extend_from_slice(curve);
    let efforts = [ground.y.clone()];
    let outcome = Problem::new(&x, &efforts, &ground.folds).complete(&[]);
    Ok(outcome.map_or(f64::INFINITY, |outcome| outcome.mse.sqrt()))
}

/// Share of the squared error without an effect that it takes away.
fn share([before, after]: [f64; 2]) -> f64 {
    1.0 - (after / before).powi(2)
}

/// Whether an effect with these errors without and with it explains too little to be sure of its name while more than `floor` is left. What explains
/// more than all that stays above the floor is no stand-in for it.
pub(super) fn explains_little(errors: [f64; 2], floor: f64) -> bool {
    let [before, after] = errors.map(|error| error.powi(2));
    let sure = if errors[1] > FAR * floor {
        SURE_FAR
    } else {
        SURE
    };
    share(errors) < sure && before - after < after - floor.powi(2)
}

/// What was named and is taken back, with its errors without and with it.
pub(super) fn doubt(name: &'static str, held_out_rms: [f64; 2], floor: f64) -> Refused {
    Refused {
        name,
        reason: format!(
            "it explains {:.0} % of what is left and {:.1} noise floors stay: too little to be sure of its name",
            100.0 * share(held_out_rms).max(0.0),
            held_out_rms[1] / floor
        ),
        held_out_rms,
    }
}

/// Share of the squared error that an effect must take away to be named while more than the floor is left.
const SURE: f64 = 0.3;
/// The same while many floors are left.
const SURE_FAR: f64 = 0.5;
/// So many floors are many.
const FAR: f64 = 3.0;
/// The same where so many are left that what is named is a small part of what there is.
const SURE_VERY_FAR: f64 = 0.75;
const VERY_FAR: f64 = 5.0;
/// The same for a curve over the coordinate.
const SURE_CURVE: f64 = 0.6;
/// The same beside a load of no name, of which it may be a part.
const SURE_BESIDE_CURVE: f64 = 0.9;
/// Curves over the coordinate that can sit anywhere: two or three of them make up any load.
const CURVES: [&str; 2] = ["detent", "ripple"];
/// So many of them do so to the noise floor.
const ANY_LOAD: usize = 3;
