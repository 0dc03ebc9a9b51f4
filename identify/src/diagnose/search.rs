//! The loop.

use super::model::{Candidate, Found, Ground, bank};
use super::null::replicates;
use super::scan::{Look, Ranked, look, minimize};
use super::score::{Problem, solve};
use crate::dynamics::{DynamicsError, EffortModel, fit_parametric};
use crate::effect::library::Kind;
use crate::effect::{Effect, RigidBody};
use crate::least_squares::rms;
use crate::motion::{Motion, MotionSettings};
use crate::noise::{self, NoiseFloor};
use crate::samples::JointSamples;

/// An effect that fits nearly as well.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Ambiguity {
    /// Its name.
    pub name: &'static str,
    /// The motion or measurement that would tell the two apart.
    pub told_apart_by: &'static str,
}

/// An effect that was added.
#[derive(Clone, Debug)]
pub struct NamedEffect {
    /// The effect with its shape.
    pub found: Found,
    /// Error on held-out strokes before and after it was added, in the order of the effects.
    pub held_out_rms: [f64; 2],
    /// Share of simulated recordings without any effect in which the search found as much.
    pub p_value: f64,
    /// What fits nearly as well.
    pub ambiguous_with: Vec<Ambiguity>,
}

/// A candidate that improved the fit and was turned down.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Refused {
    /// Its name.
    pub name: &'static str,
    /// Why.
    pub reason: String,
    /// Error on held-out strokes without and with it.
    pub held_out_rms: [f64; 2],
}

/// What the search found.
#[derive(Clone, Debug)]
pub struct Diagnosis {
    /// Effects in the order in which they lower the error most.
    pub effects: Vec<NamedEffect>,
    /// Candidates turned down.
    pub refused: Vec<Refused>,
    /// Lag of the effort that was named as an effect, s.
    pub lag_s: Option<f64>,
    /// I, mu, b and the effects, fitted with their bounds.
    pub model: EffortModel,
    /// What a complete model would leave.
    pub floor: NoiseFloor,
    /// The motion that the model is fitted to.
    pub motion: Motion,
    /// The samples it comes from.
    pub samples: JointSamples,
    /// What simulated recordings of the model leave, with the sensors' noise, rms: the floor with the errors of processing.
    pub simulated_rms: f64,
    /// Whether the coordinate's zero is that of the file, as in tables, and not that of the grasp.
    pub is_table: bool,
}

const REPLICATES: usize = 40;
const MOST_EFFECTS: usize = 6;
/// An effect must move the effort (held-out) by so many noise floors.
const LEAST_SIZE: f64 = 0.5;
/// The floor is taken as at least this share of the effort: numbers in files have so many digits.
const LEAST_FLOOR: f64 = 1.5e-3;
/// What simulated recordings leave may be so much above the sensors' noise alone: signs near reversals, double smoothing.
const MOST_ABOVE: f64 = 1.25;
/// Held-out errors within this factor of the floor have nothing to explain.
const AT_FLOOR: f64 = 1.03;
/// Of the squared error before, an effect must take away three tenths: a small change that several shapes of a residual can
/// explain names nothing while much is left.
const MOST_LEFT: f64 = 0.7;
/// When it brings the error near the floor, a seventh is enough.
const MOST_LEFT_NEAR: f64 = 0.85;
const NEAR_FLOOR: f64 = 1.5;
/// Share of the blocks that must get better.
const LEAST_HELPED: f64 = 0.6;
/// Kinds of which a joint may have two.
const TWICE: [&str; 2] = ["damping_zone", "detent"];
/// Kinds that only a tare, or rest under no force, tells apart: on moving samples their regressors agree.
const ALIAS: [(&str, &str); 2] = [
    ("constant_load", "asymmetric_coulomb"),
    ("grasp_compliance", "backlash"),
];
/// Kinds that hold another one as a special case: no alternatives to it.
const CONTAIN: [(&str, &str); 7] = [
    ("spring", "constant_load"),
    ("spring", "asymmetric_coulomb"),
    ("sensor_drift", "constant_load"),
    ("sensor_drift", "asymmetric_coulomb"),
    ("gravity", "constant_load"),
    ("gravity", "asymmetric_coulomb"),
    ("damping_zone", "asymmetric_viscous"),
];

/// Looks for what the model lacks on `samples`.
///
/// # Errors
/// [`DynamicsError`].
pub fn diagnose(
    samples: &JointSamples,
    settings: &MotionSettings,
) -> Result<Diagnosis, DynamicsError> {
    let mut state = State::new(samples.clone(), *settings)?;
    for _ in 0..2 * MOST_EFFECTS {
        if !state.step()? {
            break;
        }
    }
    state.finish()
}

impl Diagnosis {
    /// The effects that have regressors: all but a lag, which was taken out of the samples.
    #[must_use]
    pub fn found(&self) -> Vec<Found> {
        let all = self.effects.iter().map(|effect| effect.found.clone());
        all.filter(|found| found.kind.name != "time_lag").collect()
    }

    /// Fits the model anew after effects were taken out or the motion changed.
    ///
    /// # Errors
    /// [`DynamicsError`].
    pub fn refit(&mut self) -> Result<(), DynamicsError> {
        let mut found = Vec::new();
        let mut before = fit_found(&self.motion, &found)?.held_out_rms;
        for effect in &mut self.effects {
            if effect.found.kind.name == "time_lag" {
                continue;
            }
            found.push(effect.found.clone());
            let after = fit_found(&self.motion, &found)?.held_out_rms;
            effect.held_out_rms = [before, after];
            before = after;
        }
        self.model = fit_found(&self.motion, &found)?;
        self.floor = floor_of(&self.samples, &self.motion, &self.model)?;
        Ok(())
    }
}

struct State {
    settings: MotionSettings,
    samples: JointSamples,
    ground: Ground,
    bank: Vec<Candidate>,
    effects: Vec<(Found, f64)>,
    /// The lag taken out, s, and its p-value.
    lag: Option<(f64, f64)>,
    refused: Vec<Refused>,
    given_up: Vec<&'static str>,
    floor: NoiseFloor,
    /// Error that simulated recordings of the model have, rms.
    level: f64,
}

impl State {
    fn new(samples: JointSamples, settings: MotionSettings) -> Result<Self, DynamicsError> {
        let motion = Motion::prepare(&samples, &settings)?;
        let base = fit_parametric(&motion, &[&RigidBody])?;
        let floor = floor_of(&samples, &motion, &base)?;
        let ground = Ground::of(motion)?;
        Ok(Self {
            settings,
            samples,
            bank: bank(&ground)?,
            ground,
            effects: Vec::new(),
            lag: None,
            refused: Vec::new(),
            given_up: Vec::new(),
            floor,
            level: 0.0,
        })
    }

    fn found(&self) -> Vec<Found> {
        self.effects
            .iter()
            .map(|(found, _)| found.clone())
            .collect()
    }

    fn fit(&self) -> Result<EffortModel, DynamicsError> {
        fit_found(&self.ground.motion, &self.found())
    }

    /// Adds one effect; whether there was one to add.
    fn step(&mut self) -> Result<bool, DynamicsError> {
        let found = self.found();
        let model = self.fit()?;
        self.floor = floor_of(&self.samples, &self.ground.motion, &model)?;
        self.ground.active = [model.theta[0] > 0.0, true, model.theta[2] > 0.0];
        let x = self.ground.columns(&found)?;
        let mut efforts = vec![self.ground.y.clone()];
        let (simulated, level) = replicates(
            &self.ground,
            &found,
            &model,
            &self.floor,
            &self.settings,
            REPLICATES,
        )?;
        efforts.extend(simulated);
        self.level = level.min(MOST_ABOVE * self.floor.rms);
        self.floor.rms = self.floor.rms.max(self.level);
        let Some(seen) = look(&self.ground, &self.bank, &x, &efforts)? else {
            return Ok(false);
        };
        let choice = self.choose(&seen);
        let Some((choice, p_value)) = choice else {
            return Ok(false);
        };
        if choice.kind.name == "time_lag" {
            self.take_lag(&choice, p_value)?;
        } else {
            self.effects.push((choice.found(&self.ground), p_value));
            self.refine_all()?;
        }
        self.swap()?;
        self.prune()?;
        Ok(self.effects.len() < MOST_EFFECTS)
    }

    /// The first that passes every gate, or a simpler one that is as good.
    fn choose(&mut self, seen: &Look) -> Option<(Ranked, f64)> {
        let mut turned_down = Vec::new();
        let mut choice: Option<Ranked> = None;
        for entry in &seen.ranked {
            let as_good = choice.as_ref().is_none_or(|best| {
                entry.score > best.score - (0.03 * best.score).max(4.0)
                    && entry.kind.freedom() < best.kind.freedom()
            });
            if !as_good {
                continue;
            }
            match self.why_not(entry, seen) {
                None => choice = Some(entry.clone()),
                Some(reason) if entry.mse < 0.98 * seen.mse => {
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
        choice.map(|entry| {
            let p_value = p_value(&entry, seen);
            (entry, p_value)
        })
    }

    fn why_not(&self, entry: &Ranked, seen: &Look) -> Option<String> {
        let size = (seen.mse - entry.mse).max(0.0).sqrt();
        let floor = self.floor.rms;
        let again = self
            .effects
            .iter()
            .filter(|(found, _)| found.kind.name == entry.kind.name);
        if again.count() > usize::from(TWICE.contains(&entry.kind.name)) {
            return Some(
                "it is in the model already, and once more makes no physical sense".to_owned(),
            );
        }
        if self.given_up.contains(&entry.kind.name) {
            return Some("removed before as superfluous".to_owned());
        }
        if entry.kind.name == "time_lag" {
            let lag = entry.theta[0];
            if lag.abs() < 1e-3 || self.lag.is_some() {
                return Some(format!(
                    "a lag of {:.2} ms is below what is resolved",
                    1e3 * lag
                ));
            }
        }
        if seen.mse.sqrt() < AT_FLOOR * floor {
            return Some(format!(
                "the residual {:.3} is at the noise floor {floor:.3}",
                seen.mse.sqrt()
            ));
        }
        if size < LEAST_SIZE * floor {
            return Some(format!(
                "it moves the effort by {size:.3}, less than {LEAST_SIZE} of the noise floor {floor:.3}"
            ));
        }
        let near = entry.mse.sqrt() < NEAR_FLOOR * floor;
        let most = if near { MOST_LEFT_NEAR } else { MOST_LEFT };
        if entry.mse > most * seen.mse {
            let share = 100.0 * (1.0 - entry.mse / seen.mse);
            return Some(format!(
                "it explains {share:.0} % of what is left and leaves {:.1} noise floors: too little to be sure of its name",
                entry.mse.sqrt() / floor
            ));
        }
        if entry.helps < LEAST_HELPED {
            return Some(format!(
                "it helps in {:.0} % of the held-out blocks only",
                100.0 * entry.helps
            ));
        }
        let limit = limit(&seen.chance);
        if entry.score <= limit {
            return Some(format!(
                "by chance the search finds as much (score {:.1}, limit {limit:.1})",
                entry.score
            ));
        }
        None
    }

    /// Shifts the effort by the lag, again until it stays.
    fn take_lag(&mut self, entry: &Ranked, p_value: f64) -> Result<(), DynamicsError> {
        let mut lag = entry.theta[0];
        let original = self.samples.clone();
        for _ in 0..5 {
            self.shift(original.with_effort_earlier(lag))?;
            let x = self.ground.columns(&self.found())?;
            let mut wide = x.clone();
            wide.extend(self.ground.columns_of(entry.kind, &[])?);
            let rest = solve(&wide, &self.ground.y).and_then(|theta| theta.last().copied());
            let rest = rest.unwrap_or(0.0);
            if rest.abs() < 1e-4 {
                break;
            }
            lag += rest;
        }
        self.shift(original.with_effort_earlier(lag))?;
        self.refine_all()?;
        self.lag = Some((lag, p_value));
        Ok(())
    }

    fn shift(&mut self, samples: JointSamples) -> Result<(), DynamicsError> {
        self.ground = Ground::of(Motion::prepare(&samples, &self.settings)?)?;
        self.bank = bank(&self.ground)?;
        self.samples = samples;
        Ok(())
    }

    /// Shapes of all effects once more, each beside all others.
    fn refine_all(&mut self) -> Result<(), DynamicsError> {
        if self.effects.len() < 2 {
            return Ok(());
        }
        for i in 0..self.effects.len() {
            let x = self.without(i)?;
            let efforts = [self.ground.y.clone()];
            let problem = Problem::new(&x, &efforts, &self.ground.folds);
            let found = &self.effects[i].0;
            let shape = minimize(
                found.kind,
                &found.shape,
                self.ground.scope().range(),
                |shape| {
                    let trial = Found {
                        shape: shape.to_vec(),
                        ..found.clone()
                    };
                    self.own_mse(&problem, &trial).unwrap_or(f64::INFINITY)
                },
            );
            self.effects[i].0.shape = shape;
        }
        Ok(())
    }

    fn own_mse(&self, problem: &Problem<'_>, found: &Found) -> Option<f64> {
        let columns: Vec<Vec<f64>> = found
            .series(&self.ground.motion)
            .iter()
            .map(|series| self.ground.motion.regressor(series))
            .collect::<Result<_, _>>()
            .ok()?;
        let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let outcome = problem.with(&columns, 1)?.into_iter().next()?;
        super::model::signs_hold(found.kind, &found.used, &outcome.theta).then_some(outcome.mse)
    }

    /// Columns of the model without effect `i`.
    fn without(&self, i: usize) -> Result<Vec<Vec<f64>>, DynamicsError> {
        let mut rest = self.found();
        rest.remove(i);
        Ok(self.ground.columns(&rest)?)
    }

    /// Replaces an early effect where another one now does better in its place.
    fn swap(&mut self) -> Result<(), DynamicsError> {
        for i in 0..self.effects.len().saturating_sub(1) {
            let (seen, own) = self.in_place_of(i)?;
            let Some(seen) = seen else { continue };
            let there: Vec<&str> = self
                .effects
                .iter()
                .map(|(found, _)| found.kind.name)
                .collect();
            let better = seen.ranked.iter().find(|entry| {
                entry.kind.name != "time_lag"
                    && !there.contains(&entry.kind.name)
                    && entry.mse < 0.93 * own
            });
            if let Some(better) = better {
                self.effects[i].0 = better.found(&self.ground);
                self.refine_all()?;
            }
        }
        Ok(())
    }

    /// What the library offers in place of effect `i`, and the mean square error with it.
    fn in_place_of(&self, i: usize) -> Result<(Option<Look>, f64), DynamicsError> {
        let x = self.without(i)?;
        let efforts = vec![self.ground.y.clone()];
        let problem = Problem::new(&x, &efforts, &self.ground.folds);
        let own = self
            .own_mse(&problem, &self.effects[i].0)
            .unwrap_or(f64::INFINITY);
        Ok((look(&self.ground, &self.bank, &x, &efforts)?, own))
    }

    /// Takes out what later effects made superfluous.
    fn prune(&mut self) -> Result<(), DynamicsError> {
        while self.effects.len() > 1 {
            let mut least: Option<(usize, f64, f64, f64)> = None;
            for i in 0..self.effects.len() {
                let x = self.without(i)?;
                let efforts = [self.ground.y.clone()];
                let problem = Problem::new(&x, &efforts, &self.ground.folds);
                let Some(alone) = problem.alone() else {
                    continue;
                };
                let with = self
                    .own_mse(&problem, &self.effects[i].0)
                    .unwrap_or(f64::INFINITY);
                let size = (alone[0].mse - with).max(0.0).sqrt();
                if least.as_ref().is_none_or(|old| size < old.1) {
                    least = Some((i, size, alone[0].mse, with));
                }
            }
            let Some((i, size, alone, with)) = least else {
                break;
            };
            if size >= LEAST_SIZE * self.floor.rms && with < 0.9 * alone {
                break;
            }
            let (gone, _) = self.effects.remove(i);
            self.given_up.push(gone.kind.name);
            self.refused.push(Refused {
                name: gone.kind.name,
                reason: "superfluous beside the effects added later".to_owned(),
                held_out_rms: [alone.sqrt(), with.min(1e300).sqrt()],
            });
            self.refine_all()?;
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Diagnosis, DynamicsError> {
        let mut ambiguous = Vec::new();
        for i in 0..self.effects.len() {
            ambiguous.push(self.look_alikes(i)?);
        }
        let mut rest: Vec<(Found, f64, Vec<Ambiguity>)> = self
            .effects
            .drain(..)
            .zip(ambiguous)
            .map(|((found, p), ambiguous)| (found, p, ambiguous))
            .collect();
        let motion = &self.ground.motion;
        let mut ordered: Vec<Found> = Vec::new();
        let mut effects = Vec::new();
        let mut before = fit_found(motion, &ordered)?.held_out_rms;
        while !rest.is_empty() {
            let mut errors = Vec::new();
            for (found, _, _) in &rest {
                let mut with = ordered.clone();
                with.push(found.clone());
                errors.push(fit_found(motion, &with)?.held_out_rms);
            }
            let Some(best) = (0..rest.len()).min_by(|&a, &b| errors[a].total_cmp(&errors[b]))
            else {
                break;
            };
            let (found, p_value, ambiguous_with) = rest.remove(best);
            if errors[best] >= before {
                self.refused.push(Refused {
                    name: found.kind.name,
                    reason: "it does not lower the error on held-out strokes once signs are kept"
                        .to_owned(),
                    held_out_rms: [before, errors[best]],
                });
                continue;
            }
            ordered.push(found.clone());
            effects.push(NamedEffect {
                found,
                held_out_rms: [before, errors[best]],
                p_value,
                ambiguous_with,
            });
            before = errors[best];
        }
        let model = fit_found(motion, &ordered)?;
        let floor = floor_of(&self.samples, motion, &model)?;
        self.refused
            .retain(|refused| !ordered.iter().any(|found| found.kind.name == refused.name));
        if let Some((lag, p_value)) = self.lag {
            // The others' errors are those with the lag taken out; its own are with all others in.
            let late = self.samples.with_effort_earlier(-lag);
            let before = fit_found(&Motion::prepare(&late, &self.settings)?, &ordered)?;
            let held_out_rms = [before.held_out_rms, model.held_out_rms];
            let Some(kind) = crate::effect::library::kind("time_lag") else {
                unreachable!("the library has a time lag")
            };
            let effect = NamedEffect {
                found: self.ground.found(kind, Vec::new(), vec![true]),
                held_out_rms,
                p_value,
                ambiguous_with: Vec::new(),
            };
            effects.push(effect);
        }
        Ok(Diagnosis {
            effects,
            refused: self.refused,
            lag_s: self.lag.map(|lag| lag.0),
            model,
            floor,
            simulated_rms: self.level,
            is_table: self.samples.noise_of_q.is_empty(),
            motion: self.ground.motion,
            samples: self.samples,
        })
    }

    /// Effects that would do nearly as well in place of effect `i`.
    fn look_alikes(&self, i: usize) -> Result<Vec<Ambiguity>, DynamicsError> {
        let (seen, own) = self.in_place_of(i)?;
        let Some(seen) = seen else {
            return Ok(Vec::new());
        };
        let name = self.effects[i].0.kind.name;
        let gain = (seen.mse - own).max(0.0);
        Ok(seen
            .ranked
            .iter()
            .filter(|entry| entry.kind.name != name)
            .filter(|entry| {
                let alias = ALIAS.contains(&(entry.kind.name, name))
                    || ALIAS.contains(&(name, entry.kind.name));
                seen.mse - entry.mse >= 0.85 * gain && (alias || entry.mse <= 1.15 * own)
            })
            .filter(|entry| !CONTAIN.contains(&(entry.kind.name, name)) || entry.mse < 0.95 * own)
            .map(|entry| ambiguity(entry.kind))
            .collect())
    }
}

fn ambiguity(kind: &Kind) -> Ambiguity {
    Ambiguity {
        name: kind.name,
        told_apart_by: kind.separate,
    }
}

fn refusal(entry: &Ranked, seen: &Look, reason: String) -> Refused {
    Refused {
        name: entry.kind.name,
        reason,
        held_out_rms: [seen.mse.sqrt(), entry.mse.sqrt()],
    }
}

/// What chance may give: the most of all replicates, or four standard deviations above their mean.
fn limit(chance: &[f64]) -> f64 {
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

pub(super) fn fit_found(motion: &Motion, found: &[Found]) -> Result<EffortModel, DynamicsError> {
    let mut effects: Vec<&dyn Effect> = vec![&RigidBody];
    effects.extend(found.iter().map(|found| found as &dyn Effect));
    fit_parametric(motion, &effects)
}

fn floor_of(
    samples: &JointSamples,
    motion: &Motion,
    model: &EffortModel,
) -> Result<NoiseFloor, DynamicsError> {
    let mut floor = noise::floor(samples, motion, model)?;
    let least = LEAST_FLOOR * rms(&motion.regressor(&motion.tau)?);
    floor.rms = floor.rms.max(least);
    floor.wrench_rms = floor.wrench_rms.max(least);
    Ok(floor)
}
