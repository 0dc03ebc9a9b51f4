//! The error of a model on another recording of the same object than the one that it was fitted to.
//!
//! Inertia, friction and the object's effects keep their numbers; what belongs to a recording (bias, preload, drift, the time of a
//! switch) is fitted anew, and so is the zero of the coordinate, which each recording chooses for itself. Whether something changes in the course of a
//! recording is asked beside the inertia and the friction of that day.

use super::diagnosis::Diagnosis;
use super::model::{Found, Ground, is_of_time};
use super::score::{Problem, rms_beside};
use super::shapes::{ENOUGH_AT_LAST, polished};
use crate::dynamics::DynamicsError;
use crate::effect::library::{Belongs, Kind, Search, Unit};
use crate::effect::memory::BACKLASH;
use crate::least_squares::rms;
use crate::parallel::in_parallel;
use crate::products::residual;

/// The zero is looked for in so many steps either way of this share of the range,
const DATUM_STEPS: i32 = 6;
const DATUM_STEP: f64 = 0.005;
/// then between them, so often in half the step.
const DATUM_HALVINGS: usize = 5;
/// Another zero must err so much less.
const DATUM_BELOW: f64 = 0.995;
/// Pads of another grip are tried at first so many times as soft and as lasting, and as little,
const MOST_REGRIPPED: f64 = 2.0;
/// at last less than this.
const LEAST_REGRIPPED: f64 = 1.04;

/// Error there of the model with the effects `found` and the terms `theta`, and the size of the last effect there.
pub(super) fn error_on(
    found: &[Found],
    theta: &[f64],
    ground: &Ground,
    datum: f64,
) -> Result<(f64, f64), DynamicsError> {
    error_beside(&[], found, theta, ground, datum)
}

/// The same where the question is whether `kind` is there, beside all else: where that changes in the course of a recording, inertia and friction are
/// fitted anew, too, as what makes up for another level of these is no change; its size is what these leave of it.
pub(super) fn error_for(
    kind: &Kind,
    found: &[Found],
    theta: &[f64],
    ground: &Ground,
    datum: f64,
) -> Result<(f64, f64), DynamicsError> {
    let free = if is_of_time(kind) {
        &ground.base[..]
    } else {
        &[]
    };
    error_beside(free, found, theta, ground, datum)
}

/// The same with the columns `free` fitted anew, too.
fn error_beside(
    free: &[Vec<f64>],
    found: &[Found],
    theta: &[f64],
    ground: &Ground,
    datum: f64,
) -> Result<(f64, f64), DynamicsError> {
    let mut left = residual(&ground.y, &ground.base, theta);
    let mut theta = theta.iter().skip(ground.base.len());
    let mut anew = free.to_vec();
    let mut size = 0.0;
    let of_each: Vec<Vec<f64>> = found
        .iter()
        .map(|found| {
            theta
                .by_ref()
                .take(found.terms().count())
                .copied()
                .collect()
        })
        .collect();
    let of_recording = |found: &Found| found.kind.belongs == Belongs::Recording;
    // What belongs to the recording is fitted to what all of the object leaves.
    let mut order: Vec<usize> = (0..found.len()).collect();
    order.sort_by_key(|&i| of_recording(&found[i]));
    for i in order {
        let own = of_recording(&found[i]);
        let mut there = Found {
            datum,
            ..found[i].clone()
        };
        if own {
            there.shape = reshaped(ground, &left, &anew, &there)?;
        }
        let mut sum = vec![0.0; ground.y.len()];
        let terms = found[i].terms().zip(&of_each[i]);
        for (series, (term, theta)) in there.series(&ground.motion).iter().zip(terms) {
            let column = ground.motion.regressor(series)?;
            for (sum, value) in sum.iter_mut().zip(&column) {
                *sum += theta * value;
            }
            if own || term.0 == "preload" {
                anew.push(column);
            } else {
                left = residual(&left, [&column], &[*theta]);
            }
        }
        if i + 1 == found.len() {
            size = rms_beside(free, &sum);
        }
    }
    if anew.is_empty() {
        return Ok((rms(&left), size));
    }
    let ys = [left.clone()];
    let problem = Problem::new(&anew, &ys, &ground.folds);
    let error = problem
        .alone()
        .map_or_else(|| rms(&left), |outcome| outcome[0].mse.sqrt());
    Ok((error, size))
}

/// The shape that fits a recording's own effect there.
fn reshaped(
    ground: &Ground,
    left: &[f64],
    anew: &[Vec<f64>],
    found: &Found,
) -> Result<Vec<f64>, DynamicsError> {
    if found.kind.shape.iter().all(|s| s.2 == Search::Fixed) {
        return Ok(found.shape.clone());
    }
    let ys = [left.to_vec()];
    let problem = Problem::new(anew, &ys, &ground.folds);
    // As it was on the first recording, unless that tells an instant of its own, and what the kind begins with.
    let mut shapes = found.kind.shape.iter();
    let has_instant = shapes.any(|s| matches!(s.2, Search::Seconds(_)));
    let mut grid = if has_instant {
        Vec::new()
    } else {
        vec![found.shape.clone()]
    };
    grid.extend((found.kind.grid)(&ground.scope()));
    let costs = in_parallel(&grid, |shape| {
        let trial = Found {
            shape: shape.clone(),
            ..found.clone()
        };
        let columns: Option<Vec<Vec<f64>>> = trial
            .series(&ground.motion)
            .iter()
            .map(|series| ground.motion.regressor(series).ok())
            .collect();
        let columns = columns.unwrap_or_default();
        let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        problem
            .with(&columns, 1)
            .map_or(f64::INFINITY, |outcome| outcome[0].mse)
    });
    let best = (0..grid.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b]));
    let Some(best) = best else {
        return Ok(found.shape.clone());
    };
    let start = Found {
        shape: grid[best].clone(),
        ..found.clone()
    };
    let better = polished(ground, anew, left, vec![start], ENOUGH_AT_LAST);
    Ok(better
        .into_iter()
        .next()
        .map_or_else(Vec::new, |found| found.shape))
}

/// The effects `found` with the pads of a play as the grip there has them: the gap is the object's, and what gives behind it is not.
pub(super) fn regripped(
    found: &[Found],
    theta: &[f64],
    ground: &Ground,
    datum: f64,
) -> Result<Vec<Found>, DynamicsError> {
    let mut best = found.to_vec();
    let Some(play) = found.iter().position(|found| found.kind.is(&BACKLASH)) else {
        return Ok(best);
    };
    let mut least = error_on(&best, theta, ground, datum)?.0;
    let mut factor = MOST_REGRIPPED;
    while factor > LEAST_REGRIPPED {
        for (pad, factor) in [
            (1, factor),
            (1, factor.recip()),
            (2, factor),
            (2, factor.recip()),
        ] {
            let mut trial = best.clone();
            let shape = &mut trial[play].shape;
            shape[pad] *= factor;
            if let Search::Lasting(low, high) = BACKLASH.shape[pad].2 {
                shape[pad] = shape[pad].clamp(low, high);
            }
            let error = error_on(&trial, theta, ground, datum)?.0;
            if error < least {
                (best, least) = (trial, error);
            }
        }
        factor = factor.sqrt();
    }
    Ok(best)
}

/// Where the zero of the coordinate there lies: within 4 % of the range, where the model with the effects `found` and the terms
/// `theta` fits best. Recordings of one table's kind share theirs.
pub(super) fn datum(
    diagnosis: &Diagnosis,
    found: &[Found],
    theta: &[f64],
    ground: &Ground,
) -> Result<f64, DynamicsError> {
    let located = found.iter().any(|found| {
        let mut shape = found.kind.shape.iter();
        found.kind.belongs == Belongs::Object && shape.any(|s| s.1 == Unit::Position)
    });
    if !located || diagnosis.is_table {
        return Ok(0.0);
    }
    let mut best = (0.0, f64::INFINITY);
    let mut width = DATUM_STEP * ground.scope().range();
    for step in -DATUM_STEPS..=DATUM_STEPS {
        let datum = f64::from(step) * width;
        let (error, _) = error_on(found, theta, ground, datum)?;
        if error < DATUM_BELOW * best.1 || (error < best.1 && step == 0) {
            best = (datum, error);
        }
    }
    // Loads that hold each other move the effort far more than what is left of them.
    let mut finer = best;
    for _ in 0..DATUM_HALVINGS {
        width *= 0.5;
        for datum in [finer.0 - width, finer.0 + width] {
            let (error, _) = error_on(found, theta, ground, datum)?;
            if error < finer.1 {
                finer = (datum, error);
            }
        }
    }
    let lower = finer.1 < DATUM_BELOW * best.1;
    Ok(if lower { finer.0 } else { best.0 })
}
