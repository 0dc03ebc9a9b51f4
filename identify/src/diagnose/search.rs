//! The loop.

use std::sync::Arc;

use super::confirm::shown;
use super::dampers::is_damper;
use super::diagnosis::{Refused, fit_found, floor_of};
use super::gates::{gives, limit, most_of};
use super::model::{Candidate, Found, Ground, bank, is_load, is_smooth_load};
use super::null::replicates;
use super::scan::{Look, Ranked, look};
use super::score::{Problem, solve};
use super::steps::Steps;
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::{DynamicsError, EffortModel, fit_parametric, fit_with_mechanism};
use crate::effect::RigidBody;
use crate::effect::library::Object;
use crate::motion::{Motion, MotionSettings};
use crate::noise::NoiseFloor;
use crate::samples::JointSamples;

/// A rival takes the place of the best candidate when its whole model errs so much less.
pub(super) const RIVAL_BELOW: f64 = 0.95;
/// A named load does as well as a curve when the whole model errs no more than so many times as much.
const AS_WELL: f64 = 1.05;
/// So many loads in the place of dampers are tried before a curve.
const LOADS_FOR_A_CURVE: usize = 2;
/// What is left is all a load when a curve leaves this share of its square above the floor.
const OF_A_LOAD: f64 = 0.05;
/// An addition after which the same effects are there as before was worth it when the error fell below so many times what it was.
const GAINED_BELOW: f64 = 0.995;
/// Recordings that are simulated of a model.
const REPLICATES: usize = 40;
pub(super) const MOST_EFFECTS: usize = 8;
/// A floor that is read off the position's own motion and is this share of what I, mu, b leave is compared with what more leaves.
const DOUBTED: f64 = 0.3;
/// What simulated recordings leave may be so much above the sensors' noise alone: signs near reversals, double smoothing.
const MOST_ABOVE: f64 = 1.25;

pub(super) struct State {
    pub(super) settings: MotionSettings,
    pub(super) samples: JointSamples,
    pub(super) ground: Ground,
    pub(super) bank: Vec<Candidate>,
    pub(super) effects: Vec<(Found, f64)>,
    /// The lag taken out, s, and its p-value.
    pub(super) lag: Option<(f64, f64)>,
    pub(super) refused: Vec<Refused>,
    pub(super) given_up: Vec<&'static str>,
    pub(super) floor: NoiseFloor,
    /// Error that simulated recordings of the model have, rms.
    pub(super) level: f64,
    steps: Steps,
}

/// Regressors of a model at the fit's samples.
type Columns = Vec<Vec<f64>>;

/// See [`State::as_is`].
pub(super) struct AsWas {
    effects: Vec<(Found, f64)>,
    refused: Vec<Refused>,
    given_up: Vec<&'static str>,
    curve: Vec<Vec<f64>>,
    object: Arc<Object>,
    /// What of the bank was made of that object.
    offered: Vec<Candidate>,
    active: [bool; 3],
    floor: NoiseFloor,
    level: f64,
}

impl State {
    pub(super) fn new(
        mut samples: JointSamples,
        settings: MotionSettings,
        steps: Steps,
    ) -> Result<Self, DynamicsError> {
        let motion = Motion::prepare(&samples, &settings)?;
        let base = fit_parametric(&motion, &[&RigidBody])?;
        let mut floor = floor_of(&samples, &motion, &base, &[])?;
        // A position that stands for its own noise: no model can err less than by the noise, so what one leaves bounds it.
        if samples.noise_of_q.is_empty() && floor.rms > DOUBTED * base.held_out_rms {
            let flexible = fit_with_mechanism(&motion, &[&RigidBody])?;
            let least = flexible.held_out_rms.min(base.held_out_rms);
            if floor.rms > least {
                samples.aside.floor_at_most = Some(least);
                floor = floor_of(&samples, &motion, &base, &[])?;
            }
        }
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
            steps,
        })
    }

    pub(super) fn found(&self) -> Vec<Found> {
        self.effects
            .iter()
            .map(|(found, _)| found.clone())
            .collect()
    }

    pub(super) fn fit(&self) -> Result<EffortModel, DynamicsError> {
        fit_found(&self.ground.motion, &self.found())
    }

    pub(super) fn search(&mut self) -> Result<(), DynamicsError> {
        for _ in 0..2 * MOST_EFFECTS {
            if self.effects.len() >= MOST_EFFECTS || !self.step()? {
                break;
            }
        }
        Ok(())
    }

    /// What a trial that leaves the samples as they are may change.
    pub(super) fn as_is(&self) -> AsWas {
        AsWas {
            effects: self.effects.clone(),
            refused: self.refused.clone(),
            given_up: self.given_up.clone(),
            curve: self.ground.curve.clone(),
            object: Arc::clone(&self.ground.object),
            offered: self
                .bank
                .iter()
                .filter(|c| gives(c.kind))
                .cloned()
                .collect(),
            active: self.ground.active,
            floor: self.floor,
            level: self.level,
        }
    }

    pub(super) fn put_back(&mut self, as_was: AsWas) {
        self.effects = as_was.effects;
        self.refused = as_was.refused;
        self.given_up = as_was.given_up;
        self.ground.curve = as_was.curve;
        if !Arc::ptr_eq(&self.ground.object, &as_was.object) {
            self.bank.retain(|candidate| !gives(candidate.kind));
            self.bank.extend(as_was.offered);
        }
        self.ground.object = as_was.object;
        self.ground.active = as_was.active;
        self.floor = as_was.floor;
        self.level = as_was.level;
    }

    /// Whether a trial that leaves the samples as they are came off; all is as it was otherwise, as where the motion does not show its effects apart.
    pub(super) fn tried(
        &mut self,
        trial: impl FnOnce(&mut Self) -> Result<bool, DynamicsError>,
    ) -> Result<bool, DynamicsError> {
        let as_was = self.as_is();
        let came_off = shown(trial(self))?.unwrap_or(false);
        if !came_off {
            self.put_back(as_was);
        }
        Ok(came_off)
    }

    /// The columns of the model, and what each candidate does beside them and by chance; the floor is estimated anew.
    pub(super) fn survey(&mut self) -> Result<Option<(Columns, Look)>, DynamicsError> {
        self.steps.count();
        let found = self.found();
        let model = self.fit()?;
        self.floor = floor_of(&self.samples, &self.ground.motion, &model, &found)?;
        self.ground.active = [model.theta[0] > 0.0, true, model.theta[2] > 0.0];
        self.offer_anew(model.theta.as_slice())?;
        let x = self.ground.columns(&found)?;
        let mut efforts = vec![self.ground.y.clone()];
        let left = if self.ground.curve.is_empty() {
            model.rms
        } else {
            let problem = Problem::new(&x, &efforts, &self.ground.folds);
            let outcome = problem.complete(&[]);
            outcome.map_or(model.rms, |outcome| outcome.fit.sqrt())
        };
        let (simulated, level) = replicates(
            &self.ground,
            &found,
            (model.theta.as_slice(), left),
            &self.floor,
            &self.settings,
            REPLICATES,
        )?;
        efforts.extend(simulated);
        let sensors = self.floor.rms;
        self.level = level.min(MOST_ABOVE * sensors);
        let seen = look(&self.ground, &self.bank, &x, &efforts, f64::INFINITY)?;
        // No model leaves less than noise: where one does, the simulated recordings have too much.
        let least = seen.as_ref().map(Look::least_beyond_chance);
        self.level = self.level.min(least.unwrap_or(f64::INFINITY).max(sensors));
        self.floor.rms = sensors.max(self.level);
        Ok(seen.map(|seen| (x, seen)))
    }

    /// Adds one effect; whether there was one to add.
    fn step(&mut self) -> Result<bool, DynamicsError> {
        let Some((x, seen)) = self.survey()? else {
            return Ok(false);
        };
        self.add_from(&seen, Some(&x))
    }

    /// As [`State::step`] of what the library has a name for; there is no lag in the bank.
    pub(super) fn add_named(&mut self) -> Result<bool, DynamicsError> {
        let Some((_, seen)) = self.survey()? else {
            return Ok(false);
        };
        self.add_from(&seen, None)
    }

    /// Adds the first of what passes that stays, or a curve where there may be one beside the columns `x`; whether there was one to add.
    fn add_from(&mut self, seen: &Look, x: Option<&Columns>) -> Result<bool, DynamicsError> {
        let mut undone = Vec::new();
        let added = loop {
            let choice = self.next(seen);
            if let Some(x) = x
                && !self.a_load_is_left(seen)
                && self.curved(x, choice.as_ref(), seen)?
            {
                break true;
            }
            let Some((choice, p_value)) = choice else {
                break false;
            };
            if choice.kind.name == "time_lag" {
                self.take_lag(&choice, p_value)?;
                self.tidy()?;
                break true;
            }
            if self.add(&choice, p_value, seen)? {
                break true;
            }
            undone.extend((most_of(choice.kind) > 1).then_some(choice.kind.name));
        };
        // Elsewhere another of these may stay beside other effects.
        self.given_up.retain(|name| !undone.contains(name));
        Ok(added)
    }

    /// What comes next of what passes, and how often chance gives as much.
    fn next(&mut self, seen: &Look) -> Option<(Ranked, f64)> {
        self.weight_of_what_lies(seen).or_else(|| self.choose(seen))
    }

    /// Adds the choice or what does better in its place. Where that goes again at once and takes others with it, which would come back beside the next,
    /// all is as it was and the choice is given up: then nothing has changed.
    fn add(&mut self, choice: &Ranked, p_value: f64, seen: &Look) -> Result<bool, DynamicsError> {
        let (as_was, name) = (self.as_is(), choice.kind.name);
        let (before, numbers) = (self.names(), self.numbers());
        let (error, signed) = (self.error()?, self.error_with_signs()?);
        self.add_best(choice, p_value, seen)?;
        self.or_beyond(&as_was.effects, (choice.kind, p_value))?;
        self.tidy()?;
        let after = self.names();
        let sorted = |names: &[&'static str]| {
            let mut names = names.to_vec();
            names.sort_unstable();
            names
        };
        let often = |names: &[&str], name| names.iter().filter(|one| **one == name).count();
        let stays = after
            .iter()
            .any(|name| often(&after, *name) > often(&before, *name));
        if sorted(&after) == sorted(&before) {
            // What came and was superfluous at once would come again.
            let left = self.error()?;
            if left > error {
                self.put_back(as_was);
                // Why it was turned down before holds no longer.
                self.refused.retain(|old| old.name != name);
                self.given_up.push(name);
                return Ok(false);
            }
            if left > GAINED_BELOW * error {
                self.given_up.push(name);
            }
        } else if !stays {
            let worth = self.price(numbers as f64 - self.numbers() as f64);
            let left = self.error_with_signs()?;
            if left > worth * signed {
                self.put_back(as_was);
                self.given_up.push(name);
                self.refused.retain(|old| old.name != name);
                self.refused.push(Refused {
                    name,
                    reason: "beside it others seem superfluous, and without them it does"
                        .to_owned(),
                    held_out_rms: [signed, left],
                });
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Free numbers of all effects.
    fn numbers(&self) -> usize {
        let each = self.effects.iter();
        each.map(|(found, _)| found.kind.freedom_of(&found.used))
            .sum()
    }

    fn tidy(&mut self) -> Result<(), DynamicsError> {
        self.retime()?;
        self.reform()?;
        self.swap()?;
        self.prune()
    }

    pub(super) fn names(&self) -> Vec<&'static str> {
        self.effects
            .iter()
            .map(|(found, _)| found.kind.name)
            .collect()
    }

    /// Adds the choice, or a rival: the other effects' shapes were found without it and have taken up a part of what it does, so
    /// where the choice leaves more than the floor those that explain nearly as much are tried with all shapes anew.
    fn add_best(
        &mut self,
        choice: &Ranked,
        p_value: f64,
        seen: &Look,
    ) -> Result<(), DynamicsError> {
        let before = self.effects.clone();
        self.effects.push((choice.found(&self.ground), p_value));
        self.refine_all()?;
        let mut least = self.error_with_signs()?;
        let sure = self.is_sure(choice.kind);
        if sure || least < EXPLAINED_BELOW * self.floor.rms || before.is_empty() {
            return Ok(());
        }
        for (rival, p_value) in self.rivals(choice, seen) {
            let chosen = core::mem::replace(&mut self.effects, before.clone());
            self.effects.push((rival.found(&self.ground), p_value));
            self.refine_all()?;
            let error = self.error_with_signs()?;
            if error < RIVAL_BELOW * least {
                least = error;
            } else {
                self.effects = chosen;
            }
        }
        Ok(())
    }

    /// Puts a smooth load beside the model when a load of the library is there or what is left is all one, no further one helps, and it explains
    /// more than the best effect does. The search goes on beside it, and what it takes up has no name. Loads of the library come first, up to two at
    /// once, when they do as well: a curve takes a constant load and a magnet for one, and the shapes of the loads beside it were found without it.
    fn curved(
        &mut self,
        x: &[Vec<f64>],
        choice: Option<&(Ranked, f64)>,
        seen: &Look,
    ) -> Result<bool, DynamicsError> {
        let is_there = |found: &Found| is_smooth_load(found.kind) || found.kind.name == "catch";
        let loaded = self.effects.iter().any(|(found, _)| is_there(found));
        let left = seen.mse.sqrt() > EXPLAINED_BELOW * self.floor.rms;
        if !self.ground.curve.is_empty() || !left {
            return Ok(false);
        }
        let curve = self.ground.smooth_load()?;
        let efforts = [self.ground.y.clone()];
        let problem = Problem::new(x, &efforts, &self.ground.folds);
        let columns: Vec<&[f64]> = curve.iter().map(Vec::as_slice).collect();
        let Some(with) = problem.complete(&columns) else {
            return Ok(false);
        };
        let floor = self.floor.rms.powi(2);
        if !loaded && with.mse - floor > OF_A_LOAD * (seen.mse - floor) {
            return Ok(false);
        }
        let independent = problem.independent();
        let price = 0.5 * curve.len() as f64 * independent.ln();
        let score = 0.5 * independent * (seen.mse / with.mse).ln() - price;
        let best = choice.map_or(0.0, |(choice, _)| choice.score);
        if score <= best.max(limit(&seen.chance)) {
            return Ok(false);
        }
        if !self.by_loads(choice, AS_WELL * with.mse.sqrt(), seen)? {
            self.ground.curve = curve;
            self.given_up.clear();
        }
        self.tidy()?;
        Ok(true)
    }

    /// Whether loads of the library do as well as a curve, which are then in the model: the choice with one more, or a few in the place of the
    /// dampers, which take up what loads they can where no load fits yet.
    fn by_loads(
        &mut self,
        choice: Option<&(Ranked, f64)>,
        as_well: f64,
        seen: &Look,
    ) -> Result<bool, DynamicsError> {
        if let Some((choice, p_value)) = choice.filter(|(choice, _)| is_load(choice.kind))
            && self.tried(|state| {
                state.add_best(choice, *p_value, seen)?;
                Ok(state.error()? <= as_well || state.add_a_load()? && state.error()? <= as_well)
            })?
        {
            return Ok(true);
        }
        self.tried(|state| state.loads_for_dampers(as_well))
    }

    fn loads_for_dampers(&mut self, as_well: f64) -> Result<bool, DynamicsError> {
        let before = self.effects.len();
        self.effects.retain(|(found, _)| !is_damper(found.kind));
        if self.effects.len() == before {
            return Ok(false);
        }
        // Beside those they may have been superfluous.
        self.given_up.clear();
        for _ in 0..LOADS_FOR_A_CURVE {
            if !self.add_a_load()? {
                break;
            }
            if self.error()? <= as_well {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Adds what comes next where that is a load of the library, and else the best load that passes; whether there was one.
    fn add_a_load(&mut self) -> Result<bool, DynamicsError> {
        if self.effects.len() >= MOST_EFFECTS {
            return Ok(false);
        }
        let Some((_, seen)) = self.survey()? else {
            return Ok(false);
        };
        let next = self.next(&seen).filter(|(next, _)| is_load(next.kind));
        let Some((load, p_value)) = next.or_else(|| self.passing_load(&seen)) else {
            return Ok(false);
        };
        self.add_best(&load, p_value, &seen)?;
        Ok(true)
    }

    /// Shifts the effort by the lag, again until it stays.
    fn take_lag(&mut self, entry: &Ranked, p_value: f64) -> Result<(), DynamicsError> {
        let mut lag = entry.theta[0];
        let original = self.samples.clone();
        for _ in 0..5 {
            let ground = self.shifted(&original.with_effort_earlier(lag))?;
            let mut wide = ground.columns(&self.found())?;
            wide.extend(ground.columns_of(entry.kind, &[])?);
            let rest = solve(&wide, &ground.y).and_then(|theta| theta.last().copied());
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

    /// The ground of other samples, with a curve where there is one.
    pub(super) fn shifted(&self, samples: &JointSamples) -> Result<Ground, DynamicsError> {
        let mut ground = Ground::of(Motion::prepare(samples, &self.settings)?)?;
        if !self.ground.curve.is_empty() {
            ground.curve = ground.smooth_load()?;
        }
        Ok(ground)
    }

    pub(super) fn shift(&mut self, samples: JointSamples) -> Result<(), DynamicsError> {
        self.ground = self.shifted(&samples)?;
        let known: Vec<&str> = self
            .bank
            .iter()
            .map(|candidate| candidate.kind.name)
            .collect();
        // The largest of all that is held in memory: the old one goes first.
        self.bank = Vec::new();
        self.bank = bank(&self.ground)?;
        self.bank
            .retain(|candidate| known.contains(&candidate.kind.name));
        self.samples = samples;
        Ok(())
    }
}
