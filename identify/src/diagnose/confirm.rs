//! Whether an effect found in one recording is there in another one of the same object.
//!
//! Inertia, friction and the object's effects keep the numbers of the first recording; what belongs to a recording (bias,
//! preload, lag, drift, the time of a switch) is fitted anew on the second and judged on its held-out strokes.

use super::apart::tell_apart;
use super::model::{Found, Ground, is_known};
use super::score::Problem;
use super::search::{Diagnosis, NamedEffect, Refused, fit_found};
use super::shapes::polished;
use crate::dynamics::DynamicsError;
use crate::effect::library::{Belongs, Search, Unit, kind};
use crate::effect::slip::SLIP;
use crate::least_squares::rms;
use crate::motion::{Motion, MotionSettings};
use crate::parallel::in_parallel;
use crate::samples::{JointSamples, extrema};

/// Errors on a confirming recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Confirmation {
    /// Its file.
    pub file: String,
    /// Before and after each effect, in their order.
    pub rms: Vec<[f64; 2]>,
    /// Residual over effort of the model with all effects.
    pub relative_error: f64,
    /// Share of its samples at places and speeds that the first recording has probed, too: the errors are over these, and over all
    /// where they are too few to stand for it.
    pub share: f64,
}

impl Confirmation {
    /// Whether the errors are over all samples.
    #[must_use]
    pub fn is_over_all(&self) -> bool {
        over_all(self.share)
    }
}

fn over_all(share: f64) -> bool {
    share < LEAST_PROBED || share == 1.0
}

/// An effect must bring this share of what its own size promises,
const LEAST_SHARE: f64 = 0.25;
/// or take away this share of the squared error there: then other effects, fitted without it, hide a part of what it brings.
const SURE: f64 = 0.5;
const DATUM_STEPS: i32 = 6;
const DATUM_STEP: f64 = 0.005;
const DATUM_HALVINGS: usize = 5;
/// Another zero must err so much less.
const DATUM_BELOW: f64 = 0.995;

/// Takes out of `diagnosis` what does not hold on every one of `others` (file name, samples), and the look-alikes that they tell apart
/// from what does.
///
/// # Errors
/// [`DynamicsError`].
pub fn confirm(
    diagnosis: &mut Diagnosis,
    others: &[(String, JointSamples)],
    settings: &MotionSettings,
) -> Result<Vec<Confirmation>, DynamicsError> {
    let mut grounds = Vec::new();
    for (file, samples) in others {
        let ground = Ground::of(Motion::prepare(samples, settings)?)?;
        grounds.push((file, samples, ground));
    }
    let mut shifts = vec![0.0; others.len()];
    let lags = confirm_lag(diagnosis, &mut grounds, &mut shifts, settings)?;
    let mut shares = Vec::new();
    for (_, _, ground) in &mut grounds {
        shares.push(leave_probed(ground, &diagnosis.motion)?);
    }
    let mut at = 0;
    let mut datums: Vec<f64> = Vec::new();
    for (_, _, ground) in &grounds {
        datums.push(datum(diagnosis, &objects(diagnosis), ground)?);
    }
    while at < diagnosis.effects.len() {
        let slid = diagnosis.effects[at].found.kind.name == SLIP.name;
        let held = |motion: &Motion| motion.slips.is_empty();
        if let Some((file, ..)) = grounds.iter().find(|(.., g)| slid && held(&g.motion)) {
            let gone = diagnosis.effects.remove(at);
            diagnosis.refused.push(Refused {
                name: gone.found.kind.name,
                reason: format!(
                    "not confirmed: the tool is not seen to slide in {file}; the instants at which it did here are left out of the fits all the same"
                ),
                held_out_rms: gone.held_out_rms,
            });
            continue;
        }
        if diagnosis.effects[at].found.taken_out() {
            at += 1;
            continue;
        }
        let known = is_known(&diagnosis.effects[at].found);
        let failed = grounds
            .iter()
            .zip(&datums)
            .find_map(|((file, samples, ground), datum)| {
                if known && samples.aside.lean.is_some() {
                    return None;
                }
                match holds(diagnosis, at, ground, *datum) {
                    Ok(None) => None,
                    Ok(Some(pair)) => Some(Ok((file, pair))),
                    Err(error) => Some(Err(error)),
                }
            });
        if let Some(failed) = failed {
            let (file, pair) = failed?;
            let gone = diagnosis.effects.remove(at);
            diagnosis.refused.push(Refused {
                name: gone.found.kind.name,
                reason: format!(
                    "not confirmed on {file}: the error there goes from {:.3} to {:.3}",
                    pair[0], pair[1]
                ),
                held_out_rms: gone.held_out_rms,
            });
        } else {
            at += 1;
        }
    }
    tell_apart(diagnosis, grounds.iter().map(|(.., ground)| ground))?;
    diagnosis.refit()?;
    let mut out = Vec::new();
    let all = objects(diagnosis);
    // By number of effects.
    let theta: Vec<Vec<f64>> = (0..=all.len())
        .map(|count| theta_of(diagnosis, &all[..count]))
        .collect::<Result<_, _>>()?;
    let with = |count: usize, ground: &Ground, datum: f64| {
        error_on(&all[..count], &theta[count], ground, datum).map(|(error, _)| error)
    };
    for (number, ((file, samples, ground), datum)) in grounds.iter().zip(datums).enumerate() {
        let mut pairs = Vec::new();
        for count in 0..diagnosis.effects.len() {
            if let (Some(pair), "time_lag") =
                (lags.get(number), diagnosis.effects[count].found.kind.name)
            {
                pairs.push(*pair);
                continue;
            }
            if diagnosis.effects[count].found.taken_out() {
                let mut left_in = left_in(
                    &diagnosis.effects[count].found,
                    samples,
                    shifts[number],
                    settings,
                )?;
                leave_probed(&mut left_in, &diagnosis.motion)?;
                pairs.push([
                    with(all.len(), &left_in, datum)?,
                    with(all.len(), ground, datum)?,
                ]);
                continue;
            }
            let columns = with_columns(diagnosis, count).unwrap_or_default();
            pairs.push([
                with(columns, ground, datum)?,
                with(columns + 1, ground, datum)?,
            ]);
        }
        let last = with(all.len(), ground, datum)?;
        out.push(Confirmation {
            file: (*file).clone(),
            rms: pairs,
            relative_error: last / rms(&ground.y).max(f64::MIN_POSITIVE),
            share: shares.get(number).copied().unwrap_or(1.0),
        });
    }
    Ok(out)
}

/// Leaves those samples of a confirming recording at whose place and speed the first one has been, and returns their share: what a
/// valve does at speeds that were never probed no fit can know. Leaves all of them where these are too few.
fn leave_probed(ground: &mut Ground, probed: &Motion) -> Result<f64, DynamicsError> {
    let [q, dq] = [&probed.q, &probed.dq].map(|series| {
        let (low, high) = extrema(&probed.at_kept(series));
        let beyond = BEYOND * (high - low);
        low - beyond..=high + beyond
    });
    let there = &ground.motion;
    let inside = |i: &usize| q.contains(&there.q[*i]) && dq.contains(&there.dq[*i]);
    let kept: Vec<usize> = there.kept.iter().copied().filter(inside).collect();
    let share = kept.len() as f64 / there.kept.len().max(1) as f64;
    if over_all(share) {
        return Ok(share);
    }
    let mut motion = there.clone();
    motion.kept = kept;
    *ground = Ground::of(motion)?;
    Ok(share)
}

/// Beyond what was probed by so much of its range counts as probed; either recording has a zero of its own, too.
const BEYOND: f64 = 0.05;
/// Less than this share of a recording cannot stand for it.
const LEAST_PROBED: f64 = 0.5;

/// The recording with what effect `taken_out` stands for left in, and its effort read `lag_s` later.
fn left_in(
    taken_out: &Found,
    samples: &JointSamples,
    lag_s: f64,
    settings: &MotionSettings,
) -> Result<Ground, DynamicsError> {
    let samples = if taken_out.kind.name == SLIP.name {
        samples.with_slips_left_in()
    } else {
        samples.with_change_left_in()
    };
    let samples = samples.with_effort_earlier(lag_s);
    Ok(Ground::of(Motion::prepare(&samples, settings)?)?)
}

type Others<'a> = Vec<(&'a String, &'a JointSamples, Ground)>;

/// Fits the lag of each confirming recording, shifts it, and asks whether that helps; `shifts` become the lags.
fn confirm_lag(
    diagnosis: &mut Diagnosis,
    grounds: &mut Others<'_>,
    shifts: &mut [f64],
    settings: &MotionSettings,
) -> Result<Vec<[f64; 2]>, DynamicsError> {
    let (Some(lag), Some(time_lag)) = (diagnosis.lag_s, kind("time_lag")) else {
        return Ok(Vec::new());
    };
    let mut pairs = Vec::new();
    let mut failed = None;
    for ((file, samples, ground), shift) in grounds.iter_mut().zip(&mut *shifts) {
        let found = objects(diagnosis);
        let mut there = 0.0;
        let before = fit_found(&ground.motion, &found)?.held_out_rms;
        let mut after = before;
        for _ in 0..4 {
            let mut x = ground.columns(&found)?;
            x.extend(ground.columns_of(time_lag, &[])?);
            let Some(rest) = super::score::solve(&x, &ground.y).and_then(|t| t.last().copied())
            else {
                break;
            };
            there += rest;
            *ground = Ground::of(Motion::prepare(
                &samples.with_effort_earlier(there),
                settings,
            )?)?;
            after = fit_found(&ground.motion, &found)?.held_out_rms;
            if rest.abs() < 1e-4 {
                break;
            }
        }
        pairs.push([before, after]);
        *shift = there;
        // Another recording may have another lag, but not none.
        if after >= before || there * lag < 0.0 || there.abs() < 0.3 * lag.abs() {
            failed = Some((
                format!(
                    "not confirmed on {file}: the lag there is {:.2} ms",
                    1e3 * there
                ),
                [before, after],
            ));
        }
    }
    if let Some((reason, _)) = failed {
        if let Some(at) = diagnosis
            .effects
            .iter()
            .position(|e| e.found.kind.name == "time_lag")
        {
            let gone = diagnosis.effects.remove(at);
            diagnosis.refused.push(Refused {
                name: "time_lag",
                reason,
                held_out_rms: gone.held_out_rms,
            });
        }
        diagnosis.lag_s = None;
        shifts.fill(0.0);
        diagnosis.samples = diagnosis.samples.with_effort_earlier(-lag);
        diagnosis.motion = Motion::prepare(&diagnosis.samples, settings)?;
        for (_, samples, ground) in grounds.iter_mut() {
            *ground = Ground::of(Motion::prepare(samples, settings)?)?;
        }
    }
    Ok(pairs)
}

/// The effects with columns.
pub(super) fn objects(diagnosis: &Diagnosis) -> Vec<Found> {
    let found = diagnosis.effects.iter().map(|effect| effect.found.clone());
    found.filter(|found| !found.taken_out()).collect()
}

/// The pair of errors when effect `at` does not help there, beside all others.
fn holds(
    diagnosis: &Diagnosis,
    at: usize,
    ground: &Ground,
    datum: f64,
) -> Result<Option<[f64; 2]>, DynamicsError> {
    let mut others = objects(diagnosis);
    let Some(own) = with_columns(diagnosis, at) else {
        return Ok(None);
    };
    let tested = others.remove(own);
    let mut all = others.clone();
    all.push(tested.clone());
    let model = fit_found(&diagnosis.motion, &all)?;
    let without = fit_found(&diagnosis.motion, &others)?;
    let (before, _) = error_on(&others, without.theta.as_slice(), ground, datum)?;
    let (after, size) = error_on(&all, model.theta.as_slice(), ground, datum)?;
    let gain = before * before - after * after;
    let here = (without.held_out_rms.powi(2) - model.held_out_rms.powi(2)).max(0.0);
    let theta = &model.theta.as_slice()[model.theta.len() - tested.terms().count()..];
    let size_here = contribution(&diagnosis.motion, &tested, theta)?;
    let expected = here * (size / size_here.max(1e-12)).powi(2).min(1.0);
    let helps = gain > 0.0 && gain >= (LEAST_SHARE * expected).min(SURE * before * before);
    Ok((!helps).then_some([before, after]))
}

/// Place of effect `at` among those with columns.
pub(super) fn with_columns(diagnosis: &Diagnosis, at: usize) -> Option<usize> {
    let is_column = |effect: &NamedEffect| !effect.found.taken_out();
    is_column(diagnosis.effects.get(at)?).then(|| {
        diagnosis.effects[..at]
            .iter()
            .filter(|e| is_column(e))
            .count()
    })
}

fn contribution(motion: &Motion, found: &Found, theta: &[f64]) -> Result<f64, DynamicsError> {
    let mut sum = vec![0.0; motion.kept.len()];
    for (series, theta) in found.series(motion).iter().zip(theta) {
        for (sum, value) in sum.iter_mut().zip(motion.regressor(series)?) {
            *sum += theta * value;
        }
    }
    Ok(rms(&sum))
}

/// Terms of the model with `found` on the first recording.
pub(super) fn theta_of(diagnosis: &Diagnosis, found: &[Found]) -> Result<Vec<f64>, DynamicsError> {
    Ok(fit_found(&diagnosis.motion, found)?
        .theta
        .as_slice()
        .to_vec())
}

/// Error there of the model with the effects `found` and the terms `theta`, and the size of the last effect there.
pub(super) fn error_on(
    found: &[Found],
    theta: &[f64],
    ground: &Ground,
    datum: f64,
) -> Result<(f64, f64), DynamicsError> {
    let mut theta = theta.iter();
    let mut left = ground.y.clone();
    for (column, theta) in ground.base.iter().zip(theta.by_ref()) {
        for (left, value) in left.iter_mut().zip(column) {
            *left -= theta * value;
        }
    }
    let mut anew: Vec<Vec<f64>> = Vec::new();
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
                for (left, value) in left.iter_mut().zip(&column) {
                    *left -= theta * value;
                }
            }
        }
        if i + 1 == found.len() {
            size = rms(&sum);
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
    let grid = (found.kind.grid)(&ground.scope());
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
    let better = polished(ground, anew, left, vec![start]);
    Ok(better
        .into_iter()
        .next()
        .map_or_else(Vec::new, |found| found.shape))
}

/// Where the zero of the coordinate of another recording lies: within 4 % of the range, where the model with `found` fits best.
pub(super) fn datum(
    diagnosis: &Diagnosis,
    found: &[Found],
    ground: &Ground,
) -> Result<f64, DynamicsError> {
    let located = found.iter().any(|found| {
        let mut shape = found.kind.shape.iter();
        found.kind.belongs == Belongs::Object && shape.any(|s| s.1 == Unit::Position)
    });
    if !located || diagnosis.is_table {
        return Ok(0.0);
    }
    let theta = theta_of(diagnosis, found)?;
    let mut best = (0.0, f64::INFINITY);
    let mut width = DATUM_STEP * ground.scope().range();
    for step in -DATUM_STEPS..=DATUM_STEPS {
        let datum = f64::from(step) * width;
        let (error, _) = error_on(found, &theta, ground, datum)?;
        if error < DATUM_BELOW * best.1 || (error < best.1 && step == 0) {
            best = (datum, error);
        }
    }
    // Loads that hold each other move the effort far more than what is left of them.
    let mut finer = best;
    for _ in 0..DATUM_HALVINGS {
        width *= 0.5;
        for datum in [finer.0 - width, finer.0 + width] {
            let (error, _) = error_on(found, &theta, ground, datum)?;
            if error < finer.1 {
                finer = (datum, error);
            }
        }
    }
    let lower = finer.1 < DATUM_BELOW * best.1;
    Ok(if lower { finer.0 } else { best.0 })
}
