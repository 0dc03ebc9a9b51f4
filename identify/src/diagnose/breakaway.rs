//! How much more it takes to leave rest than to slide: read off the effort while the joint rests, which no fit of the motion sees.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::confirm::{Confirmation, shown};
use super::gates::gives;
use super::model::Found;
use super::search::{Diagnosis, NamedEffect, Refused, fit_found};
use crate::dynamics::DynamicsError;
use crate::effect::library::kind;
use crate::effect::slip;
use crate::motion::{Motion, MotionError, MotionSettings};
use crate::samples::{JointSamples, extrema, quantile};

/// What the joint took to break away beyond what it took to slide from there on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Breakaway {
    /// Beyond sliding, the median over all times that it left rest: N m or N.
    pub(crate) excess: f64,
    /// Standard deviation of that median.
    pub(crate) std: f64,
    /// Sliding friction there, the median: N m or N.
    pub(crate) sliding: f64,
    /// How often it left rest.
    pub(crate) count: usize,
}

/// A rest lasts at least so long, s.
const RESTS_S: f64 = 0.1;
/// The effort is looked at for so long before the joint leaves and after it, s.
const AROUND_S: [f64; 2] = [0.1, 0.02];
/// It has left when it is this share of the range away after so long, s.
const LEFT: f64 = 0.01;
const AFTER_S: f64 = 0.15;
/// Rests this near to an end are at a stop or on a catch, as a share of the range.
const END: f64 = 0.06;

impl Breakaway {
    /// Of a motion whose effort while it slides is inertia, friction and `found` with the estimates `theta`; nothing when it never
    /// left a rest away from the ends. Effort and motion go through the same smoothing: a joint that just breaks away accelerates,
    /// and its inertia is not taken for friction.
    ///
    /// # Errors
    /// When the effort cannot be filtered.
    pub(crate) fn of(
        motion: &Motion,
        found: &[Found],
        theta: &[f64],
    ) -> Result<Option<Self>, MotionError> {
        let samples = |s: f64| (s / motion.period).round() as usize;
        let (low, high) = extrema(&motion.q);
        let (from, to) = (low + END * (high - low), high - END * (high - low));
        let sliding = Sliding::of(motion, found, theta);
        let effort = motion.smoothed_effort()?;
        let friction = |j: usize| {
            effort[j] - theta[0] * motion.ddq[j] - theta[2] * motion.dq[j] - sliding.load(j)
        };
        let mut excesses = Vec::new();
        let mut levels = Vec::new();
        for run in &motion.runs {
            let mut rests = 0;
            for i in run.start..run.end.saturating_sub(samples(AFTER_S)) {
                if motion.dq[i].abs() < motion.slow_speed {
                    rests += 1;
                    continue;
                }
                let rested = core::mem::take(&mut rests);
                let way = motion.q[i + samples(AFTER_S)] - motion.q[i];
                let slips = slip::slides(&motion.slips, motion.time[i]);
                let inside = (from..to).contains(&motion.q[i]) && !slips;
                if rested < samples(RESTS_S) || !inside || way.abs() < LEFT * (high - low) {
                    continue;
                }
                let direction = way.signum();
                let [before, after] = AROUND_S.map(samples);
                let looked = i - rested.min(before)..i + after;
                let most = looked
                    .map(|j| direction * friction(j))
                    .fold(f64::NEG_INFINITY, f64::max);
                let level = direction * (sliding.at(i, direction) - sliding.load(i));
                excesses.push(most - level);
                levels.push(level);
            }
        }
        let excess = quantile(&excesses, 0.5) - sliding.noise(friction, from..to);
        let middle = quantile(&excesses, 0.5);
        let apart: Vec<f64> = excesses.iter().map(|e| (e - middle).abs()).collect();
        // Of a median, from the median deviation, for normal scatter.
        let std = 1.2533 * 1.4826 * quantile(&apart, 0.5) / (excesses.len() as f64).sqrt();
        Ok((!excesses.is_empty()).then_some(Self {
            excess,
            std,
            sliding: quantile(&levels, 0.5),
            count: excesses.len(),
        }))
    }

    /// Whether that is more than dry contacts have as a rule.
    pub(crate) fn is_stiction(&self) -> bool {
        self.count >= LEAST_COUNT && self.excess - 2.0 * self.std > UNUSUAL * self.sliding
    }

    /// It and those of other recordings together, each by how often the joint left rest there.
    fn with(self, others: impl Iterator<Item = Self>) -> Self {
        others.fold(self, |all, one| {
            let count = all.count + one.count;
            let [of_all, of_one] = [all, one].map(|part| part.count as f64 / count as f64);
            Self {
                excess: of_all * all.excess + of_one * one.excess,
                std: (of_all * all.std).hypot(of_one * one.std),
                sliding: of_all * all.sliding + of_one * one.sliding,
                count,
            }
        })
    }

    fn is_unusual(&self) -> bool {
        self.excess > UNUSUAL * self.sliding
    }

    /// Why it is no stiction for sure.
    fn doubt(&self) -> String {
        let Self {
            excess,
            std,
            sliding,
            count,
        } = self;
        format!(
            "it takes {excess:.3} ± {std:.3} more to leave rest than to slide ({count} times away from the ends, {LEAST_COUNT} are needed): not surely more than \
             half of the {sliding:.3} that sliding takes, which dry contacts have; start from rest more often, and slowly"
        )
    }

    /// Whether it may be one of several recordings that show it surely: beyond what dry contacts have and beyond chance, each alone.
    fn confirms(&self) -> bool {
        self.count >= LEAST_COUNT && self.is_unusual() && self.excess > 2.0 * self.std
    }
}

/// Break-aways that it takes to tell.
const LEAST_COUNT: usize = 6;
/// Static friction up to one and a half times the sliding one is what dry contacts have.
const UNUSUAL: f64 = 0.5;

/// The model's effort as the joint just slides, by sample.
struct Sliding<'a> {
    motion: &'a Motion,
    found: &'a [Found],
    theta: &'a [f64],
    /// Effects that are no function of the state, as they are at each sample.
    rest: Vec<f64>,
}

impl<'a> Sliding<'a> {
    fn of(motion: &'a Motion, found: &'a [Found], theta: &'a [f64]) -> Self {
        let mut rest = vec![0.0; motion.q.len()];
        let mut at = 3;
        for found in found {
            let terms = found.terms().count();
            if found.kind.at.is_none() {
                for (series, theta) in found.series(motion).iter().zip(&theta[at..at + terms]) {
                    for (rest, value) in rest.iter_mut().zip(series) {
                        *rest += theta * value;
                    }
                }
            }
            at += terms;
        }
        Self {
            motion,
            found,
            theta,
            rest,
        }
    }

    /// About to slide towards `direction` at sample `i`.
    fn at(&self, i: usize, direction: f64) -> f64 {
        let q = self.motion.q[i];
        let dq = direction * SLOWEST * self.motion.slow_speed;
        let mut sum = self.theta[1] * direction + self.rest[i];
        let mut at = 3;
        for found in self.found {
            let terms = found.terms().count();
            if let Some(state) = found.kind.at {
                let all = state(&found.shape, q + found.datum, dq);
                let used = all.into_iter().zip(&found.used).filter(|(_, used)| **used);
                for ((value, _), theta) in used.zip(&self.theta[at..at + terms]) {
                    sum += theta * value;
                }
            }
            at += terms;
        }
        sum
    }

    /// Scatter of `friction` about the model's while the joint just slides within `inside`, from its median deviation. The largest of
    /// the two or three independent values before a break-away stands about that much above their mean.
    fn noise(&self, friction: impl Fn(usize) -> f64, inside: core::ops::Range<f64>) -> f64 {
        let slow = self.motion.slow_speed;
        let scatter: Vec<f64> = (0..self.motion.q.len())
            .filter(|&i| {
                (slow..SLOWLY * slow).contains(&self.motion.dq[i].abs())
                    && inside.contains(&self.motion.q[i])
            })
            .map(|i| {
                let direction = self.motion.dq[i].signum();
                friction(i) - (self.at(i, direction) - self.load(i))
            })
            .collect();
        let middle = quantile(&scatter, 0.5);
        let apart: Vec<f64> = scatter.iter().map(|value| (value - middle).abs()).collect();
        if apart.is_empty() {
            0.0
        } else {
            1.4826 * quantile(&apart, 0.5)
        }
    }

    /// What it takes at sample `i` without friction: midway between sliding one way and the other.
    fn load(&self, i: usize) -> f64 {
        0.5 * (self.at(i, 1.0) + self.at(i, -1.0))
    }
}

/// The joint just slides up to so many times the speed below which it rests.
const SLOWLY: f64 = 6.0;

/// Speed at which sliding begins, as a share of that below which the joint rests.
const SLOWEST: f64 = 1e-3;

/// Names stiction, as large as `diagnosis` shows it, when it surely took more than usual to break away there, or there and on all of `others` (file name,
/// samples) together, and more than usual on each of these, and
/// nothing else is missing that could be taken for it: a seal that peels off resists on the way behind its place too.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn add_stiction(
    diagnosis: &mut Diagnosis,
    confirmed: &mut [Confirmation],
    others: &[(String, JointSamples)],
    settings: &MotionSettings,
) -> Result<(), DynamicsError> {
    let Some(kind) = kind("stiction") else {
        return Ok(());
    };
    let found = diagnosis.found();
    let here = Breakaway::of(&diagnosis.motion, &found, diagnosis.model.theta.as_slice())?;
    let Some(here) = here else {
        return Ok(());
    };
    let floor = diagnosis.floor.rms.max(diagnosis.simulated_rms);
    let held_out_rms = errors(&diagnosis.motion, &found)?;
    let mut refuse = |reason| {
        diagnosis.refused.push(Refused {
            name: kind.name,
            reason,
            held_out_rms,
        });
    };
    if !here.confirms() {
        if here.is_unusual() {
            refuse(here.doubt());
        }
        return Ok(());
    }
    let mut elsewhere = Vec::new();
    for (file, samples) in others {
        let motion = Motion::prepare(samples, settings)?;
        let model = shown(fit_found(&motion, &found))?;
        let there = model.map(|model| Breakaway::of(&motion, &found, model.theta.as_slice()));
        elsewhere.push((file, there.transpose()?, shown(errors(&motion, &found))?));
    }
    let all = elsewhere.iter().filter_map(|(_, there, _)| there.flatten());
    if !here.is_stiction() && !here.with(all).is_stiction() {
        refuse(here.doubt());
        return Ok(());
    }
    let left = left_between_turns(&diagnosis.motion, &found)?;
    let left = left.min(diagnosis.model.held_out_rms);
    if left > MOST_LEFT * floor {
        refuse(format!(
            "it takes {:.3} more to leave rest than to slide, but {:.1} noise floors are left while it slides: something else is missing",
            here.excess,
            left / floor
        ));
        return Ok(());
    }
    if let Some(gives) = found.iter().find(|found| gives(found.kind)) {
        refuse(format!(
            "it takes {:.3} more to leave rest than to slide, but with {} the tool moves before the object does",
            here.excess, gives.kind.name
        ));
        return Ok(());
    }
    let mut pairs = Vec::new();
    for (file, there, pair) in elsewhere {
        let (Some(there), Some(pair)) = (there, pair) else {
            refuse(format!(
                "not confirmed on {file}: it does not show the effects apart"
            ));
            return Ok(());
        };
        if !there.is_some_and(|there| there.confirms()) {
            let excess = there.map_or(f64::NAN, |there| there.excess);
            refuse(format!(
                "not confirmed on {file}: there it takes {excess:.3} more to leave rest than to slide, here {:.3}",
                here.excess
            ));
            return Ok(());
        }
        pairs.push(pair);
    }
    for (confirmed, pair) in confirmed.iter_mut().zip(pairs) {
        confirmed.rms.push(pair);
    }
    diagnosis.effects.push(NamedEffect {
        found: Found {
            kind,
            shape: vec![here.excess],
            used: Vec::new(),
            object: Arc::default(),
            datum: 0.0,
        },
        held_out_rms,
        p_value: 0.0,
        ambiguous_with: Vec::new(),
        spread: DMatrix::zeros(0, 0),
    });
    Ok(())
}

/// While more noise floors than this are left, what holds the joint at rest has no sure name.
const MOST_LEFT: f64 = 1.3;

/// Error on held-out strokes away from where the joint turns: there what holds it at rest is felt, too.
fn left_between_turns(motion: &Motion, found: &[Found]) -> Result<f64, DynamicsError> {
    let mut between = motion.clone();
    between.leave_out_turns();
    let model = shown(fit_found(&between, found))?;
    Ok(model.map_or(f64::INFINITY, |model| model.held_out_rms))
}

/// Errors on held-out strokes of a model that takes rest for sliding, and of one that lets friction take up what the hand gives.
fn errors(motion: &Motion, found: &[Found]) -> Result<[f64; 2], DynamicsError> {
    let mut sliding = motion.clone();
    for (slides, t) in sliding.slides.iter_mut().zip(&motion.time) {
        *slides = !slip::slides(&motion.slips, *t);
    }
    Ok([
        fit_found(&sliding, found)?.held_out_rms,
        fit_found(motion, found)?.held_out_rms,
    ])
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;
    use crate::samples::Aside;
    use crate::screw::JointKind;

    const RATE: f64 = 400.0;
    const PLACES: [f64; 16] = [
        0.0, 0.4, 0.2, 0.3, 0.1, 0.25, 0.15, 0.3, 0.1, 0.2, 0.3, 0.12, 0.28, 0.1, 0.2, 0.0,
    ];

    /// Pulls from place to place: 0.8 s of pulling harder and harder at rest, up to `extra` above the sliding friction of 4 N, then
    /// 0.7 s of 3 kg on the way.
    fn pulled(extra: f64) -> JointSamples {
        let (mut q, mut tau) = (Vec::new(), Vec::new());
        for pair in PLACES.windows(2) {
            let way = pair[1] - pair[0];
            let (rest, moves) = ((0.8 * RATE) as usize, (0.7 * RATE) as usize);
            for i in 0..rest {
                q.push(pair[0]);
                tau.push(way.signum() * (4.0 + extra) * i as f64 / rest as f64);
            }
            for i in 0..moves {
                let (w, u) = (PI / 0.7, PI * i as f64 / moves as f64);
                q.push(pair[0] + 0.5 * way * (1.0 - u.cos()));
                let (dq, ddq) = (0.5 * way * w * u.sin(), 0.5 * way * w * w * u.cos());
                tau.push(3.0 * ddq + 4.0 * way.signum() + 2.0 * dq);
            }
        }
        JointSamples {
            kind: JointKind::Prismatic,
            period: 1.0 / RATE,
            runs: vec![0..q.len()],
            time: (0..q.len()).map(|i| i as f64 / RATE).collect(),
            q,
            tau,
            noise_of_q: Vec::new(),
            aside: Aside::default(),
        }
    }

    fn measured(extra: f64) -> (Breakaway, f64) {
        let motion = Motion::prepare(&pulled(extra), &MotionSettings::default()).unwrap();
        let model = fit_found(&motion, &[]).unwrap();
        let found = Breakaway::of(&motion, &[], model.theta.as_slice()).unwrap();
        (found.unwrap(), model.theta[1])
    }

    #[test]
    fn less_confirms_it_than_it_takes_to_find_it() {
        let like = |excess: f64, sliding: f64| Breakaway {
            excess,
            std: 0.3,
            sliding,
            count: LEAST_COUNT,
        };
        assert!(like(2.7, 4.0).is_stiction() && like(2.7, 4.0).confirms());
        assert!(!like(2.3, 4.0).is_stiction() && like(2.3, 4.0).confirms());
        assert!(!like(1.9, 4.0).confirms());
        assert!(!like(0.5, 0.5).confirms());
    }

    #[test]
    fn recordings_together_are_surer_than_each_and_count_by_how_often_the_joint_left_rest() {
        let like = |excess: f64, count: usize| Breakaway {
            excess,
            std: 0.3,
            sliding: 4.0,
            count,
        };
        let near = like(2.5, 6);
        assert!(!near.is_stiction() && near.with([near].into_iter()).is_stiction());
        let few = near.with([like(2.1, 3)].into_iter());
        let many = near.with([like(2.1, 18)].into_iter());
        assert!((few.excess - 2.3667).abs() < 1e-3 && (few.std - 0.2236).abs() < 1e-3);
        assert!((many.excess - 2.2).abs() < 1e-9 && (many.std - 0.2372).abs() < 1e-3);
        assert_eq!(many.count, 24);
    }

    #[test]
    fn more_effort_to_leave_rest_than_to_slide_is_seen_and_inertia_is_not_taken_for_it() {
        let (none, coulomb) = measured(0.0);
        assert!(
            none.excess.abs() < 0.2 * 4.0 && !none.is_stiction(),
            "{none:?}"
        );
        assert!((coulomb - 4.0).abs() < 0.2, "{coulomb}");
        let (much, coulomb) = measured(5.0);
        assert!(
            (much.excess - 5.0).abs() < 0.25 * 5.0 && much.is_stiction(),
            "{much:?}"
        );
        // Friction at rest is no sliding friction.
        assert!((coulomb - 4.0).abs() < 0.2, "{coulomb}");
    }
}
