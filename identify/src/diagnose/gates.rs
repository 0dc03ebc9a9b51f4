//! Which candidate is taken, and why others are not.

use core::f64::consts::TAU;

use super::diagnosis::Refused;
use super::model::{Found, is_load, is_smooth_load, signs_hold};
use super::null::slow_effort;
use super::scan::{Look, Ranked, evidence};
use super::score::Problem;
use super::search::State;
use crate::effect::friction::AT_A_PLACE;
use crate::effect::library::{Belongs, Kind};
use crate::effect::measurement::SENSOR_DRIFT;
use crate::effect::memory::played_quietly;
use crate::least_squares::rms;
use crate::payload::is_another;
use crate::products::combine;

/// An effect must move the effort (held-out) by so many noise floors; one of the object that acts in less than a share `LOCAL` of the
/// samples by the less the fewer they are, down to `LEAST_OF_LOCAL` of that.
pub(super) const LEAST_SIZE: f64 = 0.5;
const LOCAL: f64 = 0.25;
const LEAST_OF_LOCAL: f64 = 0.6;
/// Where the held-out error is within this factor of the floor an effect must be of [`LEAST_SIZE`], local or not.
const AT_FLOOR: f64 = 1.03;
/// A load that a sensor's offset may be must move the effort by so many standard deviations of that.
const OFFSETS: f64 = 2.0;
/// Share of the blocks that must get better.
const LEAST_HELPED: f64 = 0.6;

/// Share of the choice's evidence that makes a rival, and how many are tried.
const RIVAL_SCORE: f64 = 0.4;
const MOST_RIVALS: usize = 3;

/// Grasps that give: by a force, or by a play. One of them is enough to say.
const GIVES: [&str; 2] = ["backlash", "grasp_compliance"];

/// Whether it moves the object away from the tool, and so all that the object has.
pub(crate) fn gives(kind: &Kind) -> bool {
    GIVES.contains(&kind.name)
}

/// The share of their evidence that must be left without the noise of the poses.
const QUIET_SHARE: f64 = 0.5;

/// How many of a kind a joint may have: a closer damps its sweep, its latching and its backcheck.
pub(super) fn most_of(kind: &Kind) -> usize {
    match kind.name {
        "damping_zone" => 3,
        "detent" => 2,
        // It may bind at two places, but grows from the closed end once.
        _ if kind.is(&AT_A_PLACE) => 2,
        _ => 1,
    }
}

/// Whether an effect looks like a sensor's offset, or one that changes slowly.
fn may_be_an_offset(kind: &Kind) -> bool {
    is_smooth_load(kind) || kind.is(&SENSOR_DRIFT)
}

impl State {
    /// The first that passes every gate, or a simpler one that is as good. A damper's edges and valve may show later only: whether
    /// it needs them is asked at the end.
    pub(super) fn choose(&mut self, seen: &Look) -> Option<(Ranked, f64)> {
        // Why something was given up says more than that it was.
        let is_told = |name: &'static str| {
            let told = self.refused.iter().any(|old| old.name == name);
            told && self.given_up.contains(&name)
        };
        let mut turned_down = Vec::new();
        let mut choice: Option<Ranked> = None;
        for entry in &seen.ranked {
            let as_good = choice.as_ref().is_none_or(|best| {
                entry.score > best.score - (0.03 * best.score).max(4.0)
                    && entry.kind.freedom() < best.kind.freedom()
                    && best.kind.name != "damping_zone"
            });
            if !as_good {
                continue;
            }
            match self.why_not(entry, seen) {
                None => choice = Some(entry.clone()),
                Some(reason) if entry.mse < 0.98 * seen.mse && !is_told(entry.kind.name) => {
                    turned_down.push(refusal(entry, seen, reason));
                }
                Some(_) => {}
            }
        }
        if choice.is_none() {
            // What is left at the end is what was turned down for good.
            self.refused
                .retain(|old| !turned_down.iter().any(|new| new.name == old.name));
            self.refused.extend(turned_down);
        }
        let choice = choice.map(|entry| self.before_places(&entry, seen).unwrap_or(entry));
        choice.map(|entry| {
            let p_value = p_value(&entry, seen);
            (entry, p_value)
        })
    }

    /// The weight about an axis that lies: it is there whatever else is, and a strut alone would do for both at first.
    pub(super) fn weight_of_what_lies(&self, seen: &Look) -> Option<(Ranked, f64)> {
        let gravity = |entry: &&Ranked| self.is_sure(entry.kind);
        self.passing(seen.ranked.iter().find(gravity)?.kind, seen)
    }

    /// The best of a kind, when it passes every gate.
    pub(super) fn passing(&self, kind: &Kind, seen: &Look) -> Option<(Ranked, f64)> {
        let own = |entry: &&Ranked| entry.kind.is(kind);
        let entry = seen.ranked.iter().find(own)?;
        let passes = self.why_not(entry, seen).is_none();
        passes.then(|| (entry.clone(), p_value(entry, seen)))
    }

    /// The best load, when there is one that passes every gate.
    pub(super) fn passing_load(&self, seen: &Look) -> Option<(Ranked, f64)> {
        let passes = |entry: &&Ranked| is_load(entry.kind) && self.why_not(entry, seen).is_none();
        let entry = seen.ranked.iter().find(passes)?;
        let first = self.before_places(entry, seen);
        let load = first.unwrap_or_else(|| entry.clone());
        let p_value = p_value(&load, seen);
        Some((load, p_value))
    }

    /// A load over the whole range that a joint which lies shows before one that sits at a place: beside a weight that no strut
    /// holds yet, a far-reaching magnet or a wide notch would do for a strut.
    fn before_places(&self, choice: &Ranked, seen: &Look) -> Option<Ranked> {
        let smooth = |entry: &&Ranked| {
            self.comes_first(entry.kind, choice.kind)
                && entry.score > RIVAL_SCORE * choice.score
                && self.why_not(entry, seen).is_none()
        };
        seen.ranked.iter().find(smooth).cloned()
    }

    /// Whether `first` comes before `second`, whichever explains more.
    fn comes_first(&self, first: &Kind, second: &Kind) -> bool {
        self.samples.aside.lies
            && is_smooth_load(first)
            && is_load(second)
            && !is_smooth_load(second)
    }

    /// Whether the axis says that an effect is there.
    pub(super) fn is_sure(&self, kind: &Kind) -> bool {
        self.samples.aside.lies && kind.name == "gravity"
    }

    /// Other candidates that pass every gate and have a good part of the choice's evidence, the best first, with what chance
    /// says of each.
    pub(super) fn rivals(&self, choice: &Ranked, seen: &Look) -> Vec<(Ranked, f64)> {
        let other = |entry: &&Ranked| {
            entry.kind.name != choice.kind.name
                && entry.kind.name != "time_lag"
                && !self.comes_first(choice.kind, entry.kind)
                && entry.score > RIVAL_SCORE * choice.score
                && self.why_not(entry, seen).is_none()
        };
        let rivals = seen.ranked.iter().filter(other).take(MOST_RIVALS);
        rivals
            .map(|entry| (entry.clone(), p_value(entry, seen)))
            .collect()
    }

    /// Whether a load of one shape passes every gate; a notch or a magnet has to be the best of all.
    pub(super) fn a_load_is_left(&self, seen: &Look) -> bool {
        seen.ranked
            .iter()
            .filter(|entry| is_smooth_load(entry.kind))
            .any(|entry| self.why_not(entry, seen).is_none())
    }

    fn why_not(&self, entry: &Ranked, seen: &Look) -> Option<String> {
        let size = (seen.mse - entry.mse).max(0.0).sqrt();
        let floor = self.floor.rms;
        let again = self
            .effects
            .iter()
            .filter(|(found, _)| found.kind.name == entry.kind.name);
        if again.count() >= most_of(entry.kind) {
            return Some(
                "it is in the model already, and once more makes no physical sense".to_owned(),
            );
        }
        let there = self.effects.iter().find(|(found, _)| gives(found.kind));
        if gives(entry.kind) && there.is_some() {
            return Some("its look-alike is in the model already".to_owned());
        }
        if entry.kind.name == "presliding"
            && let Some((found, _)) = there
        {
            let (length, way) = (entry.shape[0], self.given_way(found));
            if length < way {
                return Some(format!(
                    "its length of {length:.2e} is less than the {way:.2e} that {} gives",
                    found.kind.name
                ));
            }
        }
        let damps = |found: &Found| found.kind.name == "damping_zone";
        if entry.kind.is(&AT_A_PLACE) && self.effects.iter().any(|(found, _)| damps(found)) {
            return Some(
                "a damper's edge that is not yet as it should be looks like it".to_owned(),
            );
        }
        if let Some(reason) = self.unresolved(entry.kind, &entry.shape) {
            return Some(reason);
        }
        if let Some(reason) = self.too_heavy(entry) {
            return Some(reason);
        }
        if self.given_up.contains(&entry.kind.name) {
            return Some("removed before as superfluous".to_owned());
        }
        if entry.kind.name == "time_lag" {
            let lag = entry.theta[0];
            if self.lag.is_some() {
                return Some("it is in the model already".to_owned());
            }
            if let Some((late, std)) = self.samples.aside.late
                && is_another(lag, (late, std))
            {
                return Some(format!(
                    "in free air the wrench comes {:.1} ± {:.1} ms after the pose, not {:.1} ms",
                    1e3 * late,
                    1e3 * std,
                    1e3 * lag
                ));
            }
            if lag.abs() < 1e-3 {
                return Some(format!(
                    "a lag of {:.2} ms is too small to be named",
                    1e3 * lag
                ));
            }
        }
        if size < LEAST_SIZE * floor {
            let left = seen.mse.sqrt();
            if left < AT_FLOOR * floor {
                return Some(format!(
                    "the residual {left:.3} is what noise and processing leave ({floor:.3}), and it moves the effort by {size:.3} only"
                ));
            }
            let least = self.least_size(&entry.found(&self.ground), &entry.theta);
            if size < least * floor {
                return Some(format!(
                    "it moves the effort by {size:.3}, less than {least:.2} of the noise floor {floor:.3}"
                ));
            }
        }
        let least = OFFSETS * self.samples.aside.offset_std;
        if may_be_an_offset(entry.kind) && size < least {
            return Some(format!(
                "it moves the effort by {size:.3}: the sensor's bias, or the tool's weight where the tracker turns the tool wrongly, may do as much ({least:.3})"
            ));
        }
        if entry.helps < LEAST_HELPED {
            return Some(format!(
                "it helps in {:.0} % of the held-out blocks only",
                100.0 * entry.helps
            ));
        }
        let most = limit(&seen.chance);
        if entry.score <= most {
            return Some(format!(
                "by chance the search finds as much (score {:.1}, limit {most:.1})",
                entry.score
            ));
        }
        if gives(entry.kind) && self.score_of_quiet(entry) <= most.max(QUIET_SHARE * entry.score) {
            return Some(
                "it helps by the noise of the poses, which is in the effort too where the tool's inertia was taken off"
                    .to_owned(),
            );
        }
        None
    }

    /// What a grasp that gives scores with columns of an effort without the noise of the poses.
    fn score_of_quiet(&self, entry: &Ranked) -> f64 {
        let score = || {
            let found = self.found();
            let theta = self.fit().ok()?.theta;
            let slow = slow_effort(&self.ground.motion, &found, theta.as_slice());
            let column = played_quietly(&self.ground.scope(), &slow, entry.kind, &entry.shape);
            let column = self.ground.motion.regressor(&column).ok()?;
            let x = self.ground.columns(&found).ok()?;
            let efforts = [self.ground.y.clone()];
            let problem = Problem::new(&x, &efforts, &self.ground.folds);
            let before = problem.alone()?[0].mse;
            let with = problem.with(&[&column], 1)?;
            let with = &with[0];
            let used = [true];
            signs_hold(entry.kind, &used, &with.theta)
                .then(|| evidence(&problem, entry.kind, &used, before, with.mse))
        };
        score().unwrap_or(0.0)
    }
}

impl State {
    /// So many noise floors an effect must move the effort by at least. No less for what belongs to a recording: with its terms and its
    /// moment free on another one, that confirms less.
    pub(super) fn least_size(&self, found: &Found, theta: &[f64]) -> f64 {
        if found.kind.belongs == Belongs::Recording {
            return LEAST_SIZE;
        }
        let local = (self.share_touched(found, theta) / LOCAL).sqrt();
        LEAST_SIZE * local.clamp(LEAST_OF_LOCAL, 1.0)
    }

    /// The share of the samples in which an effect acts: 1 for a constant, little for what acts at one place only.
    fn share_touched(&self, found: &Found, theta: &[f64]) -> f64 {
        let Ok(columns) = self.ground.filtered(found) else {
            return 1.0;
        };
        let effort = combine(&columns, theta);
        let moment = |power: i32| effort.iter().map(|v| v.powi(power)).sum::<f64>();
        moment(2).powi(2) / (effort.len() as f64 * moment(4)).max(f64::MIN_POSITIVE)
    }

    /// How far the tool moves before the object does: a play, or a compliance under the usual effort.
    fn given_way(&self, found: &Found) -> f64 {
        let effort = rms(&self.ground.motion.tau);
        match found.shape.as_slice() {
            [gap, compliance, _] => gap + compliance * effort,
            [compliance, _] => compliance * effort,
            _ => 0.0,
        }
    }
}

impl State {
    /// Why, where an effect that acts over a short way after a turn, or at slow speeds, does so below what positions resolve: there it is
    /// their noise, or an encoder's steps.
    pub(super) fn unresolved(&self, kind: &Kind, shape: &[f64]) -> Option<String> {
        let motion = &self.ground.motion;
        let step = motion.fast_noise_of_q();
        let (what, noise) = match kind.name {
            "presliding" => ("length", step),
            "stribeck" => ("speed", self.noise_of_speed().min(TAU * USUAL_HZ * step)),
            _ => return None,
        };
        let limit = RESOLVED * noise;
        (shape[0] < limit).then(|| {
            format!(
                "its {what} of {:.2e} is less than the {limit:.2e} that the positions' noise lets know",
                shape[0]
            )
        })
    }
}

impl State {
    /// Why, where a weight would have to be more than what the hinge carries can have about an axis that is seen to stand upright.
    pub(super) fn too_heavy(&self, entry: &Ranked) -> Option<String> {
        let most = self.samples.aside.most_weight? * self.ground.object.rigid[0];
        let weight = entry.theta.iter().map(|v| v * v).sum::<f64>().sqrt();
        (entry.kind.name == "gravity" && weight > most && most > 0.0).then(|| {
            format!("{weight:.3} N m is more than weight can do about an axis that is as upright ({most:.3})")
        })
    }
}

impl State {
    /// Of a tracker whose noise is seen, through the filters; without limit for others.
    fn noise_of_speed(&self) -> f64 {
        let motion = &self.ground.motion;
        let speeds = motion.noise_of_q.iter().map(|noise| {
            let speed = motion.regressor(&motion.derivative(noise));
            speed.map_or(f64::INFINITY, |speed| rms(&speed))
        });
        speeds.reduce(f64::max).unwrap_or(f64::INFINITY)
    }
}

/// So many standard deviations of the positions' fast noise are resolved: two or three steps of an encoder.
const RESOLVED: f64 = 10.0;
/// The noise of a speed is that of the positions at this frequency, Hz: the fit's usual cut-off.
const USUAL_HZ: f64 = 6.0;

fn refusal(entry: &Ranked, seen: &Look, reason: String) -> Refused {
    Refused {
        name: entry.kind.name,
        reason,
        held_out_rms: [seen.mse.sqrt(), entry.mse.sqrt()],
    }
}

/// What chance may give: the most of all replicates, or four standard deviations above their mean.
pub(super) fn limit(chance: &[f64]) -> f64 {
    let n = chance.len().max(1) as f64;
    let mean = chance.iter().sum::<f64>() / n;
    let spread = (chance.iter().map(|c| (c - mean).powi(2)).sum::<f64>() / n).sqrt();
    chance
        .iter()
        .copied()
        .fold(mean + 4.0 * spread, f64::max)
        .max(4.0)
}

fn p_value(entry: &Ranked, seen: &Look) -> f64 {
    let as_good = seen.chance.iter().filter(|c| **c >= entry.score).count();
    (1.0 + as_good as f64) / (1.0 + seen.chance.len() as f64)
}
