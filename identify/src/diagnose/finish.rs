//! The end of the search: the order of the effects and the last fit.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::alike::is_constant;
use super::confirm::shown;
use super::diagnosis::{Ambiguity, Diagnosis, NamedEffect, Refused, fit_found, floor_of};
use super::doubt::{curve_with, doubt, drop_doubtful, error_beside, explains_little};
use super::gates::{LEAST_SIZE, gives};
use super::model::{Found, Ground, RIGID, is_known, object_of};
use super::search::{RIVAL_BELOW, State};
use super::shapes::ENOUGH_AT_LAST;
use super::start::CameTo;
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::{DynamicsError, EffortModel};
use crate::effect::friction::ASYMMETRIC;
use crate::effect::library::kind;
use crate::effect::load::CONSTANT_LOAD;
use crate::effect::measurement::{PAYLOAD_SWITCH, TIME_LAG};
use crate::effect::slip::{self, SLIP};
use crate::motion::Motion;

/// Friction of one way is at most so many times that of the other, or it is a load.
const MOST_BY_WAY: f64 = 2.0;

impl State {
    pub(super) fn finish(mut self, came_to: CameTo) -> Result<Diagnosis, DynamicsError> {
        self.unless_worse(|state| state.polish_until(ENOUGH_AT_LAST))?;
        let (as_was, before) = (self.effects.clone(), self.fit()?.held_out_rms);
        self.simplify()?;
        if shown(self.fit())?.is_none_or(|fit| fit.held_out_rms > 1.02 * before) {
            self.effects = as_was;
        }
        self.simplify_loads()?;
        self.name_by_friction()?;
        let theta = self.fit()?.theta;
        self.offer_anew(theta.as_slice())?;
        let mut ambiguous = Vec::new();
        for i in 0..self.effects.len() {
            ambiguous.push(self.look_alikes(i, theta.as_slice())?);
        }
        let leans = self.samples.aside.lean.is_some();
        let weight = self.weight()?;
        let mut rest: Vec<(Found, f64, Vec<Ambiguity>)> = self
            .effects
            .drain(..)
            .zip(ambiguous)
            .map(|((found, p), ambiguous)| (found, p, ambiguous))
            .collect();
        rest.extend(weight.map(|weight| (weight, 0.0, Vec::new())));
        let refused = self.superfluous(&mut rest, |found| leans && is_known(found))?;
        self.refused.extend(refused);
        let mut effects = Vec::new();
        while let Some((i, [without, with])) = self.least(&rest, |_| false)? {
            let (found, p_value, ambiguous_with) = rest.remove(i);
            effects.push(NamedEffect {
                found,
                held_out_rms: [without, with],
                p_value,
                ambiguous_with,
                spread: DMatrix::zeros(0, 0),
            });
        }
        effects.reverse();
        let motion = &self.ground.motion;
        let ground = &self.ground;
        let known = |found: &Found| leans && found.kind.name == "gravity";
        let floor = self.floor.rms;
        let corners = drop_doubtful(ground, floor, known, &mut effects, &mut self.refused)?;
        let model = fit_named(motion, &mut effects)?;
        let ordered: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
        let floor = floor_of(&self.samples, motion, &model, &ordered)?;
        self.refused
            .retain(|refused| !ordered.iter().any(|found| found.kind.name == refused.name));
        let mut doubted = doubted_switch(&model, &effects);
        if let Some((lag, p_value)) = self.lag {
            // The others' errors are those with the lag taken out; its own are with all others in.
            let late = self.samples.with_effort_earlier(-lag);
            let mut late = self.shifted(&late)?;
            late.active = self.ground.active;
            let before = fit_found(&late.motion, &ordered)?;
            let held_out_rms = [before.held_out_rms, model.held_out_rms];
            // Of what free air shows there is no doubt, but it may do nothing that a name would be needed for.
            let known = p_value == 0.0;
            let sensors = self.floor.rms;
            if !known && model.held_out_rms > EXPLAINED_BELOW * sensors {
                // Beside a load of no name, as all others are judged.
                let beside = |ground: &Ground| {
                    error_beside(ground, &ordered, &curve_with(ground, &corners)?)
                };
                let errors = [beside(&late)?, beside(&self.ground)?];
                if explains_little(errors, sensors) {
                    doubted = Some(doubt(TIME_LAG.name, errors, sensors));
                }
            }
            let effect = NamedEffect {
                found: self.ground.found(&TIME_LAG, Vec::new(), vec![false]),
                held_out_rms,
                p_value,
                ambiguous_with: Vec::new(),
                spread: DMatrix::zeros(0, 0),
            };
            // A grasp that gives moves tool and object apart in time as well.
            let gives = |effect: &NamedEffect| gives(effect.found.kind);
            let needed = !known || held_out_rms[1] < held_out_rms[0];
            if needed && (lag.abs() > LEAST_BESIDE || !effects.iter().any(gives)) {
                self.refused.retain(|refused| refused.name != TIME_LAG.name);
                effects.push(effect);
            }
        }
        if let Some(change) = &self.samples.aside.change
            && effects
                .iter()
                .all(|effect| effect.found.kind.name != change.name)
        {
            let left_in = self.samples.with_change_left_in();
            let before = fit_found(&Motion::prepare(&left_in, &self.settings)?, &ordered)?;
            let Some(kind) = kind(change.name) else {
                unreachable!("the library has the changes of a tool")
            };
            effects.push(NamedEffect {
                found: self.ground.found(
                    kind,
                    // A drift's time is not known, and its regressor is not used.
                    vec![change.size; usize::from(kind.terms.is_empty())],
                    vec![false; kind.terms.len()],
                ),
                held_out_rms: [before.held_out_rms, model.held_out_rms],
                p_value: 0.0,
                ambiguous_with: Vec::new(),
                spread: DMatrix::zeros(0, 0),
            });
        }
        if let Some(slip) = self.slip(&ordered, model.held_out_rms)? {
            effects.push(slip);
        }
        Ok(Diagnosis {
            effects,
            refused: self.refused,
            lag_s: self.lag.map(|lag| lag.0),
            doubted,
            came_to,
            together: None,
            model,
            floor,
            simulated_rms: self.level,
            is_table: self.samples.noise_of_q.is_empty(),
            motion: self.ground.motion,
            samples: self.samples,
        })
    }

    /// A load and a friction that differs between the ways are the same effort while the joint moves: which of them the search took is chance. It is
    /// named a load where the friction of one way would have to be much larger than that of the other: rubbing parts hardly do that, and weights and
    /// springs do; and a friction elsewhere.
    fn name_by_friction(&mut self) -> Result<(), DynamicsError> {
        let either = |(found, _): &(Found, f64)| is_constant(found.kind);
        let Some(i) = self.effects.iter().position(either) else {
            return Ok(());
        };
        let (theta, own) = (self.fit()?.theta, self.first_term_of(i));
        let (coulomb, size) = (theta[1], theta[own]);
        let found = &self.effects[i].0;
        let is_load = found.kind.is(&CONSTANT_LOAD);
        // Of the way of less friction, and what the other has more.
        let (least, more) = if is_load {
            (coulomb - size.abs(), 2.0 * size.abs())
        } else {
            (coulomb, size)
        };
        let is_friction = least + more <= MOST_BY_WAY * least;
        if is_friction != is_load {
            return Ok(());
        }
        let (other, shape) = if is_friction {
            (&ASYMMETRIC, vec![size.signum()])
        } else {
            (&CONSTANT_LOAD, Vec::new())
        };
        let in_bank = self.bank.iter().any(|c| c.kind.is(other));
        if !in_bank || !self.ground.curve.is_empty() {
            return Ok(());
        }
        let (as_was, before) = (self.effects.clone(), self.error()?);
        self.effects[i].0 = self.ground.found(other, shape, vec![true]);
        // They differ where the joint turns alone, which says little.
        if RIVAL_BELOW * self.error()? > before {
            self.effects = as_was;
        }
        Ok(())
    }

    /// Takes out of `rest` what does not lower the error on held-out strokes beside all others once signs are kept: from the whole model and not
    /// on the way to it, where a load may be of no use before the dampers that it presses against are there.
    fn superfluous(
        &self,
        rest: &mut Vec<(Found, f64, Vec<Ambiguity>)>,
        known: impl Fn(&Found) -> bool,
    ) -> Result<Vec<Refused>, DynamicsError> {
        let mut refused = Vec::new();
        if !self.ground.curve.is_empty() {
            return Ok(refused);
        }
        while let Some((i, [without, with])) = self.least(rest, &known)? {
            if without > with {
                break;
            }
            let (found, ..) = rest.remove(i);
            refused.push(Refused {
                name: found.kind.name,
                reason: "it does not lower the error on held-out strokes once signs are kept"
                    .to_owned(),
                held_out_rms: [without, with],
            });
        }
        Ok(refused)
    }

    /// The effect without which the others err least, of those that are not `known`, and the errors without and with it.
    fn least(
        &self,
        effects: &[(Found, f64, Vec<Ambiguity>)],
        known: impl Fn(&Found) -> bool,
    ) -> Result<Option<(usize, [f64; 2])>, DynamicsError> {
        let error = |left_out: Option<usize>| {
            let kept = effects
                .iter()
                .enumerate()
                .filter(|(i, _)| Some(*i) != left_out);
            let found: Vec<Found> = kept.map(|(_, (found, ..))| found.clone()).collect();
            Ok::<_, DynamicsError>(fit_found(&self.ground.motion, &found)?.held_out_rms)
        };
        let mut least: Option<(usize, f64)> = None;
        for i in (0..effects.len()).filter(|&i| !known(&effects[i].0)) {
            let without = error(Some(i))?;
            if least.is_none_or(|(_, least)| without < least) {
                least = Some((i, without));
            }
        }
        least
            .map(|(i, without)| Ok((i, [without, error(None)?])))
            .transpose()
    }

    /// The weight of a part whose axis is seen to lean: no search is needed for it. A spring may hold all of it; what is left to it
    /// then has no sense, and no column.
    fn weight(&self) -> Result<Option<Found>, DynamicsError> {
        let (Some(lean), Some(gravity)) = (self.samples.aside.lean, kind("gravity")) else {
            return Ok(None);
        };
        let mut found = self.found();
        if found.iter().any(|f| f.kind.name == gravity.name) {
            return Ok(None);
        }
        let own = |used| self.ground.found(gravity, vec![lean.lowest], used);
        found.push(own(vec![true, false]));
        let model = fit_found(&self.ground.motion, &found)?;
        let falls = model
            .theta
            .as_slice()
            .last()
            .is_some_and(|sine| *sine > 0.0);
        Ok(Some(own(vec![falls, false])))
    }

    /// That the tool slid on the handle, where the pose shows it plainly or leaving it in would have moved the effort by more than the floor allows to
    /// doubt.
    fn slip(&self, found: &[Found], after: f64) -> Result<Option<NamedEffect>, DynamicsError> {
        let slips = &self.ground.motion.slips;
        if slips.is_empty() || self.samples.aside.slips_left_in {
            return Ok(None);
        }
        let left_in = Motion::prepare(&self.samples.with_slips_left_in(), &self.settings)?;
        let before = fit_found(&left_in, found)?.held_out_rms;
        let moved = (before.powi(2) - after.powi(2)).max(0.0).sqrt();
        let effect = NamedEffect {
            found: self.ground.found(&SLIP, slip::shape(slips), Vec::new()),
            held_out_rms: [before, after],
            p_value: 0.0,
            ambiguous_with: Vec::new(),
            spread: DMatrix::zeros(0, 0),
        };
        let is_seen = slips.iter().any(|slip| slip.is_plain) || moved > LEAST_SIZE * self.floor.rms;
        Ok(is_seen.then_some(effect))
    }

    /// Where the terms of effect `i` begin in those of the model.
    pub(super) fn first_term_of(&self, i: usize) -> usize {
        let before = self.effects[..i].iter();
        RIGID + before.map(|(f, _)| f.terms().count()).sum::<usize>()
    }
}

/// A switch beside which the inertia is not known: where the poses' noise hides the acceleration before or after it, inertia seems to be another one there.
fn doubted_switch(model: &EffortModel, effects: &[NamedEffect]) -> Option<Refused> {
    let is_hidden = model.value("inertia").is_none();
    let mut switches = effects.iter().filter(|e| e.found.kind.is(&PAYLOAD_SWITCH));
    switches.next().filter(|_| is_hidden).map(|switch| Refused {
        name: PAYLOAD_SWITCH.name,
        reason: "beside it the poses' noise hides the inertia that is said to change; move as quickly before it as after".to_owned(),
        held_out_rms: switch.held_out_rms,
    })
}

/// The model of what is named. What acts through the object has been made with all that the search found: it is made anew where some of that has gone.
pub(super) fn fit_named(
    motion: &Motion,
    effects: &mut [NamedEffect],
) -> Result<EffortModel, DynamicsError> {
    let found = |effects: &[NamedEffect]| -> Vec<Found> {
        let found = effects.iter().map(|effect| effect.found.clone());
        found.filter(|found| !found.taken_out()).collect()
    };
    let all = found(effects);
    let model = fit_found(motion, &all)?;
    let of_state = all.iter().filter(|found| found.kind.at.is_some()).count();
    let is_stale = |found: &Found| gives(found.kind) && found.object.effects.len() != of_state;
    if !all.iter().any(is_stale) {
        return Ok(model);
    }
    make_anew(effects, &all, &model);
    fit_found(motion, &found(effects))
}

/// Makes what acts through the object anew, with the object as `all` of the effects have it in `model`.
pub(super) fn make_anew(effects: &mut [NamedEffect], all: &[Found], model: &EffortModel) {
    let object = Arc::new(object_of(all, model.theta.as_slice()));
    for effect in effects.iter_mut().filter(|effect| gives(effect.found.kind)) {
        effect.found.object = Arc::clone(&object);
    }
}

/// Lag that is named beside a grasp that gives, s; a smaller one is taken out without a name.
const LEAST_BESIDE: f64 = 3e-3;
