//! Whether an effect found in one recording is there in another one of the same object.
//!
//! The lag is fitted anew there and judged on its held-out strokes; all else by the errors of [`super::elsewhere`].

use super::apart::tell_apart;
use super::diagnosis::{Diagnosis, NamedEffect, Refused, fit_found};
use super::elsewhere::{datum, error_for, error_on};
use super::model::{Found, Ground, is_known, is_of_time};
use super::score::rms_beside;
use crate::dynamics::{DynamicsError, EffortModel};
use crate::effect::library::{Belongs, kind};
use crate::effect::slip::SLIP;
use crate::effect::{Effect, RigidBody};
use crate::least_squares::{FitError, rms};
use crate::motion::{Motion, MotionSettings};
use crate::payload::is_seen;
use crate::samples::{JointSamples, extrema};

/// Errors on a confirming recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Confirmation {
    /// Its file.
    pub file: String,
    /// Lag of its effort that was taken out, s.
    pub lag_s: f64,
    /// Before and after each effect, in their order: with the first recording's numbers, at samples that it has probed, too; what is read off rests
    /// is fitted there, over all samples.
    pub rms: Vec<[f64; 2]>,
    /// Residual over effort of the model with all effects.
    pub relative_error: f64,
    /// Share of its samples at places and speeds that the first recording has probed, too: the errors are over these, and over all
    /// where they are too few to stand for it.
    pub share: f64,
    /// The inertia that it shows by itself, kg m^2 or kg, where that is another one than the first recording's.
    pub other_inertia: Option<f64>,
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
/// What belongs to a recording must take away this share of the squared error there.
const LEAST_GAIN: f64 = 0.05;
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
    let mut datums = datums_of(diagnosis, &grounds)?;
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
            // Those before it may have helped beside it alone.
            at = 0;
            datums = datums_of(diagnosis, &grounds)?;
        } else {
            at += 1;
        }
    }
    tell_apart(diagnosis, grounds.iter().map(|(.., ground)| ground))?;
    diagnosis.refit()?;
    // Another effect may stand where one was.
    let datums = datums_of(diagnosis, &grounds)?;
    let mut out = Vec::new();
    let all = objects(diagnosis);
    // By number of effects.
    let theta: Vec<Vec<f64>> = (0..=all.len())
        .map(|count| terms_of(diagnosis, &all[..count]))
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
            let mut pair = [0.0; 2];
            for (error, count) in pair.iter_mut().zip([columns, columns + 1]) {
                let (kind, found) = (all[columns].kind, &all[..count]);
                (*error, _) = error_for(kind, found, &theta[count], ground, datum)?;
            }
            pairs.push(pair);
        }
        let last = with(all.len(), ground, datum)?;
        // A recording that does not show all effects apart by itself says nothing of the inertia.
        let there = shown(fit_found(&ground.motion, &all))?;
        out.push(Confirmation {
            file: (*file).clone(),
            lag_s: shifts[number],
            rms: pairs,
            relative_error: last / rms(&ground.y).max(f64::MIN_POSITIVE),
            share: shares.get(number).copied().unwrap_or(1.0),
            other_inertia: there.and_then(|there| other_inertia(&diagnosis.model, &there)),
        });
    }
    Ok(out)
}

/// Where the zero of the coordinate lies on each.
fn datums_of(diagnosis: &Diagnosis, grounds: &Others<'_>) -> Result<Vec<f64>, DynamicsError> {
    let found = objects(diagnosis);
    let theta = terms_of(diagnosis, &found)?;
    let each = grounds.iter();
    each.map(|(.., ground)| datum(diagnosis, &found, &theta, ground))
        .collect()
}

/// What of `found`, term by term and in order, a motion shows apart from what is kept before.
fn shown_apart(motion: &Motion, found: Vec<Found>) -> Result<Vec<Found>, DynamicsError> {
    if shown(fit_found(motion, &found))?.is_some() {
        return Ok(found);
    }
    let mut out: Vec<Found> = Vec::new();
    for one in found {
        let last = out.len();
        out.push(Found {
            used: vec![false; one.used.len()],
            ..one.clone()
        });
        for term in (0..one.used.len()).filter(|&term| one.used[term]) {
            out[last].used[term] = true;
            out[last].used[term] = shown(fit_found(motion, &out))?.is_some();
        }
        if !out[last].used.contains(&true) {
            out.pop();
        }
    }
    Ok(out)
}

/// A fit, or nothing where the samples do not show all effects apart: one may act where the joint turns and nowhere else.
pub(crate) fn shown<T>(fit: Result<T, DynamicsError>) -> Result<Option<T>, DynamicsError> {
    match fit {
        Err(DynamicsError::Fit(FitError::RankDeficient { .. })) => Ok(None),
        other => other.map(Some),
    }
}

/// Inertias that differ by more than this share of the larger one and by so many standard deviations are of two objects, or loads.
const OTHER: f64 = 0.25;
const SURELY: f64 = 5.0;

/// The inertia of the model `there` where it is another one than that of `here`.
fn other_inertia(here: &EffortModel, there: &EffortModel) -> Option<f64> {
    let of = |model: &EffortModel| Some((model.value("inertia")?, model.std("inertia")?));
    let ((own, std), (other, its)) = (of(here)?, of(there)?);
    let apart = (own - other).abs();
    (apart > OTHER * own.max(other) && apart > SURELY * std.hypot(its)).then_some(other)
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
        let found = shown_apart(&ground.motion, objects(diagnosis))?;
        let mut there = 0.0;
        let error = |ground: &Ground| {
            let fit = shown(fit_found(&ground.motion, &found))?;
            Ok::<_, DynamicsError>(fit.map(|fit| fit.held_out_rms))
        };
        let Some(before) = error(ground)? else {
            pairs.push([f64::NAN; 2]);
            failed = Some((
                format!("not confirmed on {file}: it does not show inertia and friction apart"),
                [f64::NAN; 2],
            ));
            continue;
        };
        let mut after = before;
        let seen = samples.aside.late.filter(is_seen);
        if let Some((late, _)) = seen {
            there = late;
            let earlier = samples.with_effort_earlier(late);
            *ground = Ground::of(Motion::prepare(&earlier, settings)?)?;
            after = error(ground)?.unwrap_or(f64::INFINITY);
        }
        let rounds = if seen.is_some() { 0 } else { 4 };
        for _ in 0..rounds {
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
            after = error(ground)?.unwrap_or(f64::INFINITY);
            if rest.abs() < 1e-4 {
                break;
            }
        }
        pairs.push([before, after]);
        *shift = there;
        // Another recording may have another lag, but not none.
        if after >= before && seen.is_none() || there * lag < 0.0 || there.abs() < 0.3 * lag.abs() {
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

/// Terms of the model with `found` on the first recording.
fn terms_of(diagnosis: &Diagnosis, found: &[Found]) -> Result<Vec<f64>, DynamicsError> {
    Ok(fit_found(&diagnosis.motion, found)?
        .theta
        .as_slice()
        .to_vec())
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
    let error_there =
        |found: &[Found], theta: &[f64]| error_for(tested.kind, found, theta, ground, datum);
    let (mut before, _) = error_there(&others, without.theta.as_slice())?;
    let (after, size) = error_there(&all, model.theta.as_slice())?;
    let (rest, theta) = model
        .theta
        .as_slice()
        .split_at(model.theta.len() - tested.terms().count());
    if tested.kind.belongs == Belongs::Recording {
        // That the object's terms are right with it here is no sign that it is there.
        before = before.min(error_there(&others, rest)?.0);
    }
    let gain = before * before - after * after;
    let here = (without.held_out_rms.powi(2) - model.held_out_rms.powi(2)).max(0.0);
    let size_here = contribution(&diagnosis.motion, &tested, theta)?;
    let expected = here * (size / size_here.max(1e-12)).powi(2).min(1.0);
    // Its size and its moment are free there, and little is expected of a small one: it must show.
    let least = match tested.kind.belongs {
        Belongs::Recording => LEAST_GAIN * before * before,
        Belongs::Object => 0.0,
    };
    let wanted = (LEAST_SHARE * expected).min(SURE * before * before);
    let helps = gain > 0.0 && gain >= wanted.max(least);
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

/// What `found` moves on a motion, rms; where it changes in the course of it, what inertia and friction leave of that.
fn contribution(motion: &Motion, found: &Found, theta: &[f64]) -> Result<f64, DynamicsError> {
    let mut sum = vec![0.0; motion.kept.len()];
    for (series, theta) in found.series(motion).iter().zip(theta) {
        for (sum, value) in sum.iter_mut().zip(motion.regressor(series)?) {
            *sum += theta * value;
        }
    }
    let mut rigid = Vec::new();
    if is_of_time(found.kind) {
        let columns = RigidBody.columns(motion)?.into_iter();
        rigid.extend(columns.map(|column| column.values));
    }
    Ok(rms_beside(&rigid, &sum))
}
