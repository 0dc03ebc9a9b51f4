//! Slips that the effort shows: pulses of it that nothing explains, and how far the tool slid along the path.
//!
//! Along the path a tool that slides on the handle cannot be told from an object that moves by its pose. But the object's inertia asks for a
//! pulse of effort that nobody gave, to one side and back; and ever after the coordinate is off by the way that the tool slid, so that springs
//! and catches seem to have moved.

use nalgebra::{DMatrix, DVector};

use super::diagnosis::{Diagnosis, fit_found};
use super::model::{Found, slopes_of};
use super::start::diagnose_while;
use super::steps::Steps;
use crate::analysis::SURELY_BELOW;
use crate::dynamics::{DynamicsError, EffortModel, fit_with_mechanism};
use crate::effect::{Effect, RigidBody, slip};
use crate::least_squares::{FitError, least_squares, rms};
use crate::motion::{Motion, MotionError, MotionSettings};
use crate::samples::{JointSamples, Slid, extrema, quantile};

/// A pulse is so many times the floor and what is usual, and so many times what is left about it.
const PULSE: f64 = 7.0;
const ALONE: f64 = 4.0;
/// So many samples must tell what is left about it.
const SOME: usize = 8;
/// So many samples at the same place and to the same side tell that it is not of the place, and what they leave is mostly less than this share of it.
const FEW: usize = 3;
const ELSEWHERE: f64 = 0.5;
const MOSTLY: f64 = 0.8;
/// So near in place, as a share of the range.
const SAME_PLACE: f64 = 0.03;
/// It lasts so long to either side, and so long is what is about it, s.
const LASTS_S: f64 = 0.2;
const ABOUT_S: f64 = 1.0;
/// One pulse at least comes back, unless slips are known: its sum is less than this share of the sum of what it has on either side.
const COMES_BACK: f64 = 0.4;
/// Standard deviation of the way along the path beforehand, as a share of the range.
const USUAL_WAY: f64 = 0.01;
/// The ways must take away this share of the square that is left.
const LEAST_GAIN: f64 = 0.05;
/// More pulses than these are no slips.
const MOST: usize = 8;
/// More than these that are all within this share of the range are of the place.
const PAIR: usize = 2;
const ONE_PLACE: f64 = 0.1;
/// Ratio of singular values that still counts.
const RANK: f64 = 1e-9;

/// What rids a recording of slips is made anew so often with what was found then, and stays where so much of the error does.
const ROUNDS: usize = 2;
const STAYS_BELOW: f64 = 0.95;
/// Instants that nothing but the effort shows count where so many floors are left without them at most: anything that is missing makes pulses, too.
const MOST_LEFT: f64 = 1.3;
/// With more left after a round than so many floors, another one does not come to [`MOST_LEFT`] of them.
const MOST_LEFT_AGAIN: f64 = 5.0;

/// As [`super::diagnose_without`], of `samples` rid of the slips that the effort shows where that leaves less.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn diagnose_rid_of_slips(
    samples: &JointSamples,
    settings: &MotionSettings,
    barred: &[&'static str],
    steps: &Steps,
) -> Result<Diagnosis, DynamicsError> {
    let first = diagnose_while(samples, settings, barred, steps)?;
    let most = MOST_LEFT * first.floor.rms;
    let mut rounds: Vec<(Diagnosis, JointSamples)> = Vec::new();
    // Slips may be why the first search went far.
    while rounds.is_empty() || rounds.len() < ROUNDS && !steps.are_enough() {
        let (last, seen) = rounds
            .last()
            .map_or((&first, samples), |(last, seen)| (last, seen));
        if !rounds.is_empty() && last.model.held_out_rms > MOST_LEFT_AGAIN * last.floor.rms {
            break;
        }
        let noise = SURELY_BELOW * last.floor.rms;
        let left = Left {
            motion: &last.motion,
            found: &last.found(),
            model: &last.model,
            elsewhere: false,
        };
        let rid = rid_of_slips(seen, &left, noise)?;
        let rid = match rid {
            None if last.model.held_out_rms > noise => {
                rid_beside_any_load(seen, &last.motion, noise)?
            }
            rid => rid,
        };
        let Some(rid) = rid else {
            break;
        };
        let Some(next) = if_enough(diagnose_while(&rid, settings, barred, steps))? else {
            break;
        };
        if next.model.held_out_rms > STAYS_BELOW * last.model.held_out_rms {
            break;
        }
        rounds.push((next, rid));
    }
    let known = first.motion.slips.len();
    let mut last = rounds.into_iter().map(|(last, _)| last).rev();
    Ok(last
        .find(|last| counts(&last.motion, &last.model, known, most))
        .unwrap_or(first))
}

/// A fit, or nothing where what was left out for slips was too much.
fn if_enough<T>(fit: Result<T, DynamicsError>) -> Result<Option<T>, DynamicsError> {
    match fit {
        Err(
            DynamicsError::Motion(MotionError::AllGated { .. })
            | DynamicsError::Fit(FitError::RankDeficient { .. } | FitError::TooFewSamples { .. }),
        ) => Ok(None),
        other => other.map(Some),
    }
}

/// Whether what a motion is rid of may be slips, of which `known` were there before and with which `most` may be left.
fn counts(motion: &Motion, model: &EffortModel, known: usize, most: f64) -> bool {
    motion.slips.len() <= known || model.held_out_rms <= most
}

/// Confirming recordings without the slips that their effort shows beside what is named.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn others_rid_of_slips(
    diagnosis: &Diagnosis,
    others: &[(String, JointSamples)],
    settings: &MotionSettings,
) -> Result<Vec<(String, JointSamples)>, DynamicsError> {
    let (found, floor) = (diagnosis.found(), diagnosis.floor.rms);
    let lag_s = diagnosis.lag_s.unwrap_or(0.0);
    let mut out = others.to_vec();
    for (_, samples) in &mut out {
        if let Some(rid) = rid_beside(samples, &found, floor, lag_s, settings)? {
            *samples = rid;
        }
    }
    Ok(out)
}

/// `samples`, whose effort comes `lag_s` late, without the slips that it shows beside `found`; nothing where there are none.
fn rid_beside(
    samples: &JointSamples,
    found: &[Found],
    floor: f64,
    lag_s: f64,
    settings: &MotionSettings,
) -> Result<Option<JointSamples>, DynamicsError> {
    let fit = |samples: &JointSamples| {
        let fitted = Motion::prepare(&samples.with_effort_earlier(lag_s), settings)
            .map_err(DynamicsError::from)
            .and_then(|motion| Ok((fit_found(&motion, found)?, motion)));
        if_enough(fitted)
    };
    let Some(first) = fit(samples)? else {
        return Ok(None);
    };
    let mut rounds: Vec<(JointSamples, (EffortModel, Motion))> = Vec::new();
    while rounds.len() < ROUNDS {
        let (seen, (model, motion)) = rounds
            .last()
            .map_or((samples, &first), |(seen, last)| (seen, last));
        let noise = SURELY_BELOW * floor;
        let left = Left {
            motion,
            found,
            model,
            elsewhere: true,
        };
        let Some(rid) = rid_of_slips(seen, &left, noise)? else {
            break;
        };
        let Some(next) = fit(&rid)? else {
            break;
        };
        if next.0.held_out_rms > STAYS_BELOW * model.held_out_rms {
            break;
        }
        rounds.push((rid, next));
    }
    let known = first.1.slips.len();
    while let Some((rid, (model, motion))) = rounds.pop() {
        if counts(&motion, &model, known, MOST_LEFT * floor) {
            return Ok(Some(rid));
        }
    }
    Ok(None)
}

/// A model on a motion, and what it leaves of the effort.
struct Left<'a> {
    motion: &'a Motion,
    found: &'a [Found],
    model: &'a EffortModel,
    /// Its shapes were found on another recording, which may count the coordinate from another place.
    elsewhere: bool,
}

/// The recording without what the tool slid along the path, where more of it is seen in what is left of the effort than `samples` are rid of; the motion was
/// prepared from them, without a lag. New instants are looked for where more than `noise` is left. Of a table nobody knows that a hand held it.
fn rid_of_slips(
    samples: &JointSamples,
    left: &Left<'_>,
    noise: f64,
) -> Result<Option<JointSamples>, DynamicsError> {
    let Left {
        motion,
        found,
        model,
        ..
    } = left;
    if motion.noise_of_q.is_empty() {
        return Ok(None);
    }
    let slopes = slopes_of(motion, found, model.theta.as_slice()).load;
    let new = if model.held_out_rms > noise {
        new_pulses(motion, &model.residual, &slopes, noise)
    } else {
        Vec::new()
    };
    let known = motion.slips.iter().map(|slip| slip.at);
    let mut at: Vec<f64> = known.chain(new.iter().copied()).collect();
    at.sort_unstable_by(f64::total_cmp);
    if at.is_empty() {
        return Ok(None);
    }
    let (ways, gain) = ways(left, &slopes, &at)?;
    if new.is_empty() && gain < LEAST_GAIN {
        return Ok(None);
    }
    let slid: Vec<Slid> = at
        .iter()
        .zip(ways)
        .map(|(&at, along)| Slid { at, along })
        .collect();
    Ok(Some(samples.rid_of(&slid)))
}

/// As [`rid_of_slips`] beside loads and dampers of any shape, where the search has not found those that there are; how far the tool slid is not known then.
fn rid_beside_any_load(
    samples: &JointSamples,
    motion: &Motion,
    noise: f64,
) -> Result<Option<JointSamples>, DynamicsError> {
    if motion.noise_of_q.is_empty() {
        return Ok(None);
    }
    let Some(model) = if_enough(fit_with_mechanism(motion, &[&RigidBody]))? else {
        return Ok(None);
    };
    let none = vec![0.0; motion.q.len()];
    let at = new_pulses(motion, &model.residual, &none, noise);
    let slid: Vec<Slid> = at.into_iter().map(|at| Slid { at, along: 0.0 }).collect();
    Ok((!slid.is_empty()).then(|| samples.rid_of(&slid)))
}

/// The pulses that are none of the slips that are known.
fn new_pulses(motion: &Motion, residual: &[f64], slopes: &[f64], noise: f64) -> Vec<f64> {
    let mut all = pulses(motion, residual, slopes, noise);
    all.retain(|at| !motion.slips.iter().any(|slip| slip::is_one(slip.at, *at)));
    all
}

/// When the effort has a pulse that comes once and stands alone; none where none of them comes back and no slip is known, where there are many, and where all are at one place.
fn pulses(motion: &Motion, residual: &[f64], slopes: &[f64], noise: f64) -> Vec<f64> {
    let [time, q, dq] = [&motion.time, &motion.q, &motion.dq].map(|series| motion.at_kept(series));
    let (low, high) = extrema(&q);
    let sizes: Vec<f64> = residual.iter().map(|r| r.abs()).collect();
    let usual = noise.max(1.4826 * quantile(&sizes, 0.5));
    let mut order: Vec<usize> = (0..sizes.len())
        .filter(|i| sizes[*i] > PULSE * usual)
        .collect();
    order.sort_by(|&a, &b| sizes[b].total_cmp(&sizes[a]));
    let mut peaks: Vec<usize> = Vec::new();
    for i in order {
        if !peaks.iter().any(|j| slip::is_one(time[i], time[*j])) {
            peaks.push(i);
        }
    }
    let of_a_pulse = |t: f64| peaks.iter().any(|p| (time[*p] - t).abs() <= LASTS_S);
    let is_alone = |peak: &&usize| {
        let peak = **peak;
        let about = (0..time.len())
            .filter(|i| (time[*i] - time[peak]).abs() <= ABOUT_S && !of_a_pulse(time[*i]));
        let about: Vec<f64> = about.map(|i| residual[i]).collect();
        let same = |i: &usize| {
            (q[*i] - q[peak]).abs() < SAME_PLACE * (high - low)
                && dq[*i] * dq[peak] > 0.0
                && (time[*i] - time[peak]).abs() > ABOUT_S
        };
        // A notch that is taken for a little deeper than it is makes pulses, too.
        let steep = slopes[motion.kept[peak]].abs() * USUAL_WAY * (high - low);
        let there: Vec<f64> = (0..time.len()).filter(same).map(|i| sizes[i]).collect();
        about.len() >= SOME
            && there.len() >= FEW
            && steep < sizes[peak]
            && ALONE * rms(&about) < sizes[peak]
            && quantile(&there, MOSTLY) < ELSEWHERE * sizes[peak]
    };
    let alone: Vec<usize> = peaks.iter().filter(is_alone).copied().collect();
    let about = |peak: usize| {
        let near = |i: &usize| (time[*i] - time[peak]).abs() <= LASTS_S;
        (0..time.len()).filter(near).collect::<Vec<_>>()
    };
    let comes_back = |&peak: &usize| {
        let [sum, all] = about(peak).into_iter().fold([0.0, 0.0], |[sum, all], i| {
            [sum + residual[i], all + sizes[i]]
        });
        !slip::turns_near(motion, motion.kept[peak]) && sum.abs() < COMES_BACK * all
    };
    let places: Vec<f64> = alone.iter().map(|i| q[*i]).collect();
    let (first, last) = extrema(&places);
    let of_one_place = places.len() > PAIR && last - first < ONE_PLACE * (high - low);
    let slid = !motion.slips.is_empty() || alone.iter().any(comes_back);
    if alone.len() > MOST || of_one_place || !slid {
        return Vec::new();
    }
    let middle = |&peak: &usize| {
        let [weighted, all] = about(peak)
            .into_iter()
            .fold([0.0, 0.0], |[weighted, all], i| {
                [weighted + sizes[i] * time[i], all + sizes[i]]
            });
        weighted / all
    };
    alone.iter().map(middle).collect()
}

/// How far the tool slid along the path at each of `at` beyond what the motion is rid of, by what is left of the effort away from these instants, and the
/// share of its square that they take away.
fn ways(left: &Left<'_>, slopes: &[f64], at: &[f64]) -> Result<(Vec<f64>, f64), DynamicsError> {
    let Left { motion, model, .. } = left;
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for &at in at {
        let after = motion.time.iter().zip(slopes);
        let series: Vec<f64> = after.map(|(t, load)| load * slip::gone(*t - at)).collect();
        columns.push(motion.regressor(&series)?);
    }
    let mut others = RigidBody.columns(motion)?;
    for found in left.found {
        others.extend(found.columns(motion)?);
    }
    if left.elsewhere {
        columns.push(motion.regressor(slopes)?);
    }
    let doubtful = columns.len();
    columns.extend(others.into_iter().map(|column| column.values));
    let counts = |j: &usize| {
        let t = motion.time[motion.kept[*j]];
        at.iter().all(|at| (t - at).abs() > slip::SLIDES_S)
    };
    let rows: Vec<usize> = (0..motion.kept.len()).filter(counts).collect();
    let rest: Vec<f64> = rows.iter().map(|j| model.residual[*j]).collect();
    let (low, high) = extrema(&motion.q);
    let doubt = rms(&rest) / (USUAL_WAY * (high - low));
    let fit = |from: usize| -> Result<_, DynamicsError> {
        let columns = &columns[from..];
        let height = rows.len() + doubtful - from;
        let regressor = DMatrix::from_fn(height, columns.len(), |i, k| match rows.get(i) {
            Some(row) => columns[k][*row],
            None if i - rows.len() == k => doubt,
            None => 0.0,
        });
        let aim = DVector::from_fn(height, |i, _| rest.get(i).copied().unwrap_or(0.0));
        if_enough(least_squares(&regressor, &aim, RANK).map_err(DynamicsError::from))
    };
    let (Some(with), Some(without)) = (fit(0)?, fit(at.len())?) else {
        return Ok((vec![0.0; at.len()], 0.0));
    };
    let [with_it, without_it] = [&with, &without].map(|fit| fit.residual.norm_squared());
    let gain = 1.0 - with_it / without_it.max(f64::MIN_POSITIVE);
    // A coordinate that reads too far by `along` shows the load of a place that the object has not reached.
    let ways = (0..at.len()).map(|i| -with.theta[i]).collect();
    Ok((ways, gain))
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;
    use crate::diagnose::model::Ground;
    use crate::effect::load::SPRING;
    use crate::random::Random;
    use crate::samples::Aside;
    use crate::screw::JointKind;

    const RATE: f64 = 200.0;
    const SECONDS: f64 = 60.0;

    /// A drawer of 8 kg on a spring of 60 N/m, pulled to and fro; `off(t)` is what the pose reads too much, `more(t, q)` what the effort has beside.
    fn pulled(off: impl Fn(f64) -> f64, more: impl Fn(f64, f64) -> f64) -> JointSamples {
        let mut random = Random::new(7);
        let time: Vec<f64> = (0..(SECONDS * RATE) as usize)
            .map(|i| i as f64 / RATE)
            .collect();
        let mut out = JointSamples {
            kind: JointKind::Prismatic,
            period: 1.0 / RATE,
            runs: vec![0..time.len()],
            time: time.clone(),
            q: Vec::new(),
            tau: Vec::new(),
            noise_of_q: vec![Vec::new(), Vec::new()],
            aside: Aside::default(),
        };
        for t in time {
            // Strokes of 2.2 to 4 s.
            let pace = 1.1 + 0.3 * (0.4 * t).sin();
            let phase = 1.1 * t - 0.75 * (0.4 * t).cos();
            let q = 0.2 - 0.2 * phase.cos();
            let dq = 0.2 * pace * phase.sin();
            let ddq = 0.2 * (pace * pace * phase.cos() + 0.12 * (0.4 * t).cos() * phase.sin());
            let effort = 8.0 * ddq + 4.0 * (dq / 0.002).tanh() + 6.0 * dq + 60.0 * q;
            out.q.push(q + off(t) + 3e-5 * random.normal());
            out.tau.push(effort + more(t, q) + 0.05 * random.normal());
            for series in &mut out.noise_of_q {
                series.push(3e-5 * random.normal());
            }
        }
        out
    }

    /// What rids `samples` of slips beside a spring, by the instants and the ways.
    fn seen(samples: &JointSamples) -> Vec<Slid> {
        let settings = MotionSettings::default();
        let ground = Ground::of(Motion::prepare(samples, &settings).unwrap()).unwrap();
        let spring = ground.found(&SPRING, Vec::new(), vec![true, true]);
        let rid = rid_beside(samples, &[spring], 0.1, 0.0, &settings).unwrap();
        rid.map_or(Vec::new(), |rid| rid.aside.slid)
    }

    /// `way` at each of `at`, in 70 ms.
    fn steps(at: &[f64], way: f64) -> impl Fn(f64) -> f64 {
        move |t| {
            let gone = |at: &f64| 0.5 - 0.5 * (PI * ((t - at) / 0.07 + 0.5).clamp(0.0, 1.0)).cos();
            way * at.iter().map(gone).sum::<f64>()
        }
    }

    #[test]
    fn a_tool_that_slides_along_the_path_is_seen_in_the_effort_and_how_far() {
        let at = [12.8, 31.7, 44.4];
        let slid = seen(&pulled(steps(&at, 0.006), |_, _| 0.0));
        assert_eq!(slid.len(), at.len(), "{slid:?}");
        for (slid, at) in slid.iter().zip(at) {
            assert!((slid.at - at).abs() < 0.05, "{slid:?}");
            assert!((slid.along - 0.006).abs() < 0.0015, "{slid:?}");
        }
    }

    #[test]
    fn a_blow_that_does_not_come_back_a_notch_and_nothing_are_no_slips() {
        assert_eq!(seen(&pulled(|_| 0.0, |_, _| 0.0)), []);
        let notch = |_: f64, q: f64| 12.0 * (-((q - 0.2) / 0.006).powi(2)).exp();
        assert_eq!(seen(&pulled(|_| 0.0, notch)), []);
        let blow = |t: f64, _: f64| 25.0 * (-((t - 30.0) / 0.05).powi(2)).exp();
        assert_eq!(seen(&pulled(|_| 0.0, blow)), []);
    }

    #[test]
    fn slips_left_in_are_as_they_were() {
        let samples = pulled(|_| 0.0, |_, _| 0.0);
        let slid = [(10.0, 0.003), (20.0, -0.001), (10.05, 0.002)];
        let rid = samples.rid_of(&slid.map(|(at, along)| Slid { at, along }));
        assert_eq!(rid.aside.slid.len(), 2);
        let after = |q: &[f64]| q[q.len() - 1];
        assert!((after(&samples.q) - after(&rid.q) - 0.004).abs() < 1e-12);
        let back = rid.with_slips_left_in();
        // The second time near one instant is put to the first.
        let same = back.q.iter().zip(&samples.q).zip(&samples.time);
        for ((back, q), t) in same.filter(|(_, t)| (**t - 10.0).abs() > 0.2) {
            assert!((back - q).abs() < 1e-12, "{t}");
        }
    }
}
