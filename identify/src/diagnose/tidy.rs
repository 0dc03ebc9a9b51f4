//! After each effect: shapes of all anew, replacements, and what has become superfluous.

use std::sync::Arc;

use super::confirm::shown;
use super::diagnosis::Refused;
use super::gates::{gives, most_of};
use super::model::{Found, grid_points, is_load, object_of, signs_hold};
use super::scan::{Look, look};
use super::score::{Outcome, Problem};
use super::search::State;
use super::shapes::{ENOUGH, ENOUGH_AT_LAST, moments, polished};
use super::start::UNASKED;
use crate::dynamics::DynamicsError;
use crate::effect::library::{Kind, Search};
use crate::effect::load::{CATCH, DETENT, FARTHEST_REACH};
use crate::effect::measurement::GRASP_COMPLIANCE;
use crate::effect::memory::BACKLASH;
use crate::least_squares::rms;

/// What an effect must take away of the squared error that is there without it.
const LEAST_GAIN: f64 = 0.1;
/// What leaves so many times the square of what is there is not made to leave less than that by a better shape.
const HOPELESS: f64 = 4.0;
/// Another form must err so much less.
const REFORMED_BELOW: f64 = 0.995;
/// What acts through the object is made anew so often.
const REMADE: usize = 3;
/// Play must leave so many times less of the squared error than a grasp that gives, which has one number less, and of neither the form is exact.
const WORTH_PLAY: f64 = 1.08;
/// Play that may look like a grasp that gives: the gap in what that gives at the usual effort, and what still gives as a share of it.
const PLAYS: [[f64; 2]; 3] = [[0.7, 0.7], [1.5, 0.4], [2.0, 0.15]];

impl State {
    /// Shapes of all effects once more, together, and of what acts through the object with what they say of that.
    pub(super) fn refine_all(&mut self) -> Result<(), DynamicsError> {
        self.unless_worse(Self::relieve)?;
        self.polish()?;
        self.part()?;
        let shapes = |state: &Self| -> Vec<Vec<f64>> {
            let effects = state.effects.iter();
            effects.map(|(found, _)| found.shape.clone()).collect()
        };
        let before = shapes(self);
        self.unless_worse(Self::relieve)?;
        // A valve that was tried anew opens at one of some speeds.
        if shapes(self) != before {
            self.unless_worse(Self::polish)?;
        }
        self.remake()
    }

    /// Makes what acts through the object anew, with what the whole model says of that.
    fn remake(&mut self) -> Result<(), DynamicsError> {
        // Beside a curve of no name the model does not say all.
        if !self.effects.iter().any(|(found, _)| gives(found.kind)) || !self.ground.curve.is_empty()
        {
            return Ok(());
        }
        self.unless_worse(|state| {
            for _ in 0..REMADE {
                let Some(model) = shown(state.fit())? else {
                    break;
                };
                let object = Arc::new(object_of(&state.found(), model.theta.as_slice()));
                for (found, _) in &mut state.effects {
                    if gives(found.kind) {
                        found.object = Arc::clone(&object);
                    }
                }
                state.polish()?;
            }
            Ok(())
        })
    }

    /// Makes what the library offers to act through the object anew: through the one that those of the model have, or with what the model, which has
    /// `theta`, says of it. Beside a curve of no name it does not say all.
    pub(super) fn offer_anew(&mut self, theta: &[f64]) -> Result<(), DynamicsError> {
        if !self.ground.curve.is_empty() {
            return Ok(());
        }
        let object = match self.effects.iter().find(|(found, _)| gives(found.kind)) {
            Some((found, _)) => Arc::clone(&found.object),
            None if self.effects.is_empty() && self.ground.object.effects.is_empty() => {
                return Ok(());
            }
            None => {
                let mut object = object_of(&self.found(), theta);
                // No part is without inertia: a bound is no estimate.
                if object.rigid[0] == 0.0 {
                    object.rigid[0] = self.ground.object.rigid[0];
                }
                Arc::new(object)
            }
        };
        if Arc::ptr_eq(&object, &self.ground.object) {
            return Ok(());
        }
        self.ground.object = object;
        let offered = |kind: &Kind| gives(kind) && self.bank.iter().any(|c| c.kind.is(kind));
        let anew = grid_points(&self.ground, offered)?;
        self.bank
            .retain(|old| !anew.iter().any(|new| new.kind.is(old.kind)));
        self.bank.extend(anew);
        Ok(())
    }

    /// Does it, and takes it back when the whole model then errs more.
    pub(super) fn unless_worse(
        &mut self,
        change: impl FnOnce(&mut Self) -> Result<(), DynamicsError>,
    ) -> Result<(), DynamicsError> {
        if self.effects.is_empty() {
            return Ok(());
        }
        let (as_was, before) = (self.effects.clone(), self.error()?);
        change(self)?;
        if self.error()? > 1.01 * before {
            self.effects = as_was;
        }
        Ok(())
    }

    pub(super) fn polish(&mut self) -> Result<(), DynamicsError> {
        self.polish_until(ENOUGH)
    }

    /// Polishes the shapes of all effects together until an iteration gains less than `enough`.
    pub(super) fn polish_until(&mut self, enough: f64) -> Result<(), DynamicsError> {
        // Beside a curve the loads stay as they were before it.
        let curved = !self.ground.curve.is_empty();
        let (fixed, free): (Vec<Found>, Vec<Found>) = self
            .found()
            .into_iter()
            .partition(|found| curved && is_load(found.kind));
        let x = self.ground.columns(&fixed)?;
        let mut better = polished(&self.ground, &x, &self.ground.y, free, enough).into_iter();
        for (old, _) in &mut self.effects {
            if !(curved && is_load(old.kind))
                && let Some(new) = better.next()
            {
                *old = new;
            }
        }
        Ok(())
    }

    /// Looks for the moments of changes anew: they were chosen while other effects were missing.
    pub(super) fn retime(&mut self) -> Result<(), DynamicsError> {
        for i in 0..self.effects.len() {
            let found = self.effects[i].0.clone();
            let shapes = moments(found.kind, &found.shape);
            if shapes.is_empty() {
                continue;
            }
            let x = self.without(i)?;
            let efforts = [self.ground.y.clone()];
            let problem = Problem::new(&x, &efforts, &self.ground.folds);
            let mut least = self.own_mse(&problem, &found).unwrap_or(f64::INFINITY);
            for shape in shapes {
                let moved = Found {
                    shape,
                    ..found.clone()
                };
                let mse = self.own_mse(&problem, &moved).unwrap_or(f64::INFINITY);
                if mse < least {
                    least = mse;
                    self.effects[i].0 = moved;
                }
            }
            self.unless_worse(Self::polish)?;
        }
        Ok(())
    }

    /// Tries the other form of what has two: the first was chosen while other effects were missing.
    pub(super) fn reform(&mut self) -> Result<(), DynamicsError> {
        for i in 0..self.effects.len() {
            let mut shape = self.effects[i].0.kind.shape.iter();
            let Some(form) = shape.position(|s| s.2 == Search::Form) else {
                continue;
            };
            if !self.ground.curve.is_empty() && is_load(self.effects[i].0.kind) {
                continue;
            }
            let (as_was, before) = (self.effects.clone(), self.error()?);
            let shape = &mut self.effects[i].0.shape;
            shape[form] = 1.0 - shape[form];
            self.polish()?;
            if !self.holds(i)? || self.error()? > REFORMED_BELOW * before {
                self.effects = as_was;
            }
        }
        self.play()
    }

    /// Puts play in the place of a grasp that gives when that errs less by more than their forms are crude, and takes it away when it does not: a
    /// grasp that gives has one number less.
    /// Once it is play, pads that give from where those of the play do are tried, too: they may err as little, and less than before. What took the place
    /// acts through the object as it is then.
    fn play(&mut self) -> Result<(), DynamicsError> {
        let plays = |state: &Self| {
            let mut found = state.effects.iter();
            found.any(|(found, _)| found.kind.name == BACKLASH.name)
        };
        if !self.play_or_pads()? {
            return Ok(());
        }
        if plays(self) {
            self.play_or_pads()?;
        }
        self.remake()
    }

    /// Whether the one took the place of the other.
    fn play_or_pads(&mut self) -> Result<bool, DynamicsError> {
        let barred = |kind: &Kind| {
            let mut bank = self.bank.iter();
            self.given_up.contains(&kind.name) || bank.all(|c| c.kind.name != kind.name)
        };
        let there = |name: &str| self.effects.iter().position(|(f, _)| f.kind.name == name);
        let effort = rms(&self.ground.motion.tau);
        let (i, others) = match (there(GRASP_COMPLIANCE.name), there(BACKLASH.name)) {
            (Some(i), None) if !barred(&BACKLASH) => {
                let &[compliance, retardation] = self.effects[i].0.shape.as_slice() else {
                    return Ok(false);
                };
                let played = PLAYS.map(|[gap, rest]| {
                    let gap = gap * compliance * effort;
                    (&BACKLASH, vec![gap, rest * compliance, retardation])
                });
                (i, played.to_vec())
            }
            (None, Some(i)) if !barred(&GRASP_COMPLIANCE) => {
                let &[gap, compliance, retardation] = self.effects[i].0.shape.as_slice() else {
                    return Ok(false);
                };
                let given = [0.0, 0.5].map(|share| {
                    let compliance = compliance + share * gap / effort;
                    (&GRASP_COMPLIANCE, vec![compliance, retardation])
                });
                (i, given.to_vec())
            }
            _ => return Ok(false),
        };
        let mut least = self.error()?;
        if self.effects[i].0.kind.name == GRASP_COMPLIANCE.name {
            least /= WORTH_PLAY.sqrt();
        } else {
            least *= WORTH_PLAY.sqrt();
        }
        let mut changed = false;
        for (kind, shape) in others {
            let as_was = self.effects.clone();
            // Through the same object.
            (self.effects[i].0.kind, self.effects[i].0.shape) = (kind, shape);
            self.polish()?;
            let (holds, error) = (self.holds(i)?, self.error()?);
            if holds && error < least {
                least = error;
                changed = true;
            } else {
                self.effects = as_was;
            }
        }
        Ok(changed)
    }

    pub(super) fn own_mse(&self, problem: &Problem<'_>, found: &Found) -> Option<f64> {
        Some(self.beside(problem, found)?.mse)
    }

    /// Whether the terms of effect `i` have the signs of physics beside all others.
    pub(super) fn holds(&self, i: usize) -> Result<bool, DynamicsError> {
        let x = self.without(i)?;
        let efforts = [self.ground.y.clone()];
        let problem = Problem::new(&x, &efforts, &self.ground.folds);
        Ok(self.outcome(&problem, &self.effects[i].0).is_some())
    }

    /// The model of `problem` with `found`, when its terms have the signs of physics.
    pub(super) fn outcome(&self, problem: &Problem<'_>, found: &Found) -> Option<Outcome> {
        let outcome = self.beside(problem, found)?;
        signs_hold(found.kind, &found.used, &outcome.theta).then_some(outcome)
    }

    fn beside(&self, problem: &Problem<'_>, found: &Found) -> Option<Outcome> {
        let columns = self.ground.columns_with(found).ok()?;
        let least = 1e-9 * rms(&self.ground.y);
        if columns.iter().any(|column| rms(column) < least) {
            return None;
        }
        let columns: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        problem.complete(&columns)
    }

    /// Error of the whole model on held-out blocks.
    pub(super) fn error(&self) -> Result<f64, DynamicsError> {
        let x = self.ground.columns(&self.found())?;
        let efforts = [self.ground.y.clone()];
        let problem = Problem::new(&x, &efforts, &self.ground.folds);
        let alone = problem.complete(&[]);
        Ok(alone.map_or(f64::INFINITY, |outcome| outcome.mse.sqrt()))
    }

    /// The same with terms of the signs that physics allows; beside a curve, of which no bounded fit is made, without.
    /// Infinite where the motion does not show the terms apart.
    pub(super) fn error_with_signs(&self) -> Result<f64, DynamicsError> {
        Ok(match shown(self.fit())? {
            None => f64::INFINITY,
            Some(fit) if self.ground.curve.is_empty() => fit.held_out_rms,
            Some(_) => self.error()?,
        })
    }

    /// Columns of the model without effect `i`; a curve is none when the effect is one that it could stand in for.
    pub(super) fn without(&self, i: usize) -> Result<Vec<Vec<f64>>, DynamicsError> {
        let mut rest = self.found();
        let gone = rest.remove(i);
        Ok(if is_load(gone.kind) {
            self.ground.plain_columns(&rest)?
        } else {
            self.ground.columns(&rest)?
        })
    }

    /// Replaces effects where others now do better in their places.
    pub(super) fn swap(&mut self) -> Result<(), DynamicsError> {
        for i in 0..self.effects.len().saturating_sub(1) {
            if self.is_sure(self.effects[i].0.kind) {
                continue;
            }
            let (seen, own) = self.in_place_of(i, HOPELESS)?;
            let Some(seen) = seen else { continue };
            let here = self.effects[i].0.kind;
            let better = seen.ranked.iter().find(|entry| {
                let name = entry.kind.name;
                let numbered = self.effects.iter().enumerate();
                let there = numbered.filter(|(j, (f, _))| *j != i && f.kind.name == name);
                name != "time_lag"
                    && !entry.kind.is(here)
                    && there.count() < most_of(entry.kind)
                    && self.unresolved(entry.kind, &entry.shape).is_none()
                    && entry.mse < 0.93 * own
            });
            if let Some(better) = better {
                let (as_was, before) = (self.effects.clone(), self.error()?);
                self.effects[i].0 = better.found(&self.ground);
                self.refine_all()?;
                if self.error()? > 0.97 * before {
                    self.effects = as_was;
                }
            }
        }
        Ok(())
    }

    /// What the library offers in place of effect `i`, refined where it leaves at most so many times as much, and the mean square error with it.
    pub(super) fn in_place_of(
        &self,
        i: usize,
        most_ratio: f64,
    ) -> Result<(Option<Look>, f64), DynamicsError> {
        let x = self.without(i)?;
        let efforts = vec![self.ground.y.clone()];
        let problem = Problem::new(&x, &efforts, &self.ground.folds);
        let own = self
            .own_mse(&problem, &self.effects[i].0)
            .unwrap_or(f64::INFINITY);
        let seen = look(&self.ground, &self.bank, &x, &efforts, most_ratio * own)?;
        Ok((seen, own))
    }

    /// Takes loads that do no better than a simpler one for that: a notch where the magnet does, a drift that does not drift, and a constant and a
    /// weight that a spring does as well as, where nothing but the effort tells of the weight.
    pub(super) fn simplify_loads(&mut self) -> Result<(), DynamicsError> {
        self.magnet_for_notch()?;
        self.unless_needed(&["sensor_drift"], "constant_load")?;
        let aside = &self.samples.aside;
        if !aside.lies && aside.lean.is_none() {
            self.unless_needed(&["constant_load", "gravity"], "spring")?;
        }
        Ok(())
    }

    /// Takes a notch where a magnet may reach for a magnet of another reach, where that does as well: the magnet's was found while other loads were
    /// missing, which it took up with its tail, and from there no polish leads back.
    fn magnet_for_notch(&mut self) -> Result<(), DynamicsError> {
        if !self.ground.curve.is_empty() {
            return Ok(());
        }
        let numbered = || self.effects.iter().map(|(found, _)| found).enumerate();
        let Some((magnet, closed)) = numbered()
            .find(|(_, found)| found.kind.is(&CATCH))
            .map(|(i, found)| (i, found.shape[0]))
        else {
            return Ok(());
        };
        let farthest = closed + FARTHEST_REACH * self.ground.scope().range();
        let near = numbered().filter(|(_, found)| {
            found.kind.is(&DETENT) && found.shape[0] - found.shape[1] < farthest
        });
        let notches: Vec<usize> = near.map(|(i, _)| i).collect();
        for notch in notches {
            if self.took_for_magnet(notch, magnet)? {
                break;
            }
        }
        Ok(())
    }

    /// Whether a magnet of another reach took the places of a notch and a magnet.
    fn took_for_magnet(&mut self, notch: usize, magnet: usize) -> Result<bool, DynamicsError> {
        let with = self.error_with_signs()?;
        if !with.is_finite() {
            return Ok(false);
        }
        let as_was = self.effects.clone();
        let (gone, _) = self.effects.remove(notch);
        let magnet = magnet - usize::from(notch < magnet);
        let without = self.effects.clone();
        let mut least = self.price(gone.kind.freedom_of(&gone.used) as f64) * with;
        let mut best = None;
        let magnets = self.bank.iter().filter(|one| one.kind.is(&CATCH));
        let shapes: Vec<Vec<f64>> = magnets.map(|magnet| magnet.shape.clone()).collect();
        for shape in shapes {
            self.effects.clone_from(&without);
            self.effects[magnet].0.shape = shape;
            self.polish()?;
            let error = self.error_with_signs()?;
            if error < least && self.holds(magnet)? {
                least = error;
                best = Some(self.effects.clone());
            }
        }
        let Some(best) = best else {
            self.effects = as_was;
            return Ok(false);
        };
        self.effects.clone_from(&best);
        self.polish_until(ENOUGH_AT_LAST)?;
        let polished = self.error_with_signs()?;
        if polished < least {
            least = polished;
        } else {
            self.effects = best;
        }
        self.refused.retain(|old| old.name != gone.kind.name);
        self.refused.push(Refused {
            name: gone.kind.name,
            reason: "with a magnet of another reach the model does as well without it".to_owned(),
            held_out_rms: [least, with],
        });
        Ok(true)
    }

    /// So many times as much may a model err that has so many numbers less.
    pub(super) fn price(&self, spared: f64) -> f64 {
        let independent = 0.5 * self.ground.y.len() as f64;
        (0.5 * spared * independent.ln() / independent).exp()
    }

    /// Puts one effect in the place of several, when the numbers that this spares are worth what it errs more.
    fn unless_needed(&mut self, several: &[&str], one: &str) -> Result<(), DynamicsError> {
        let Some(candidate) = self.bank.iter().find(|c| c.kind.name == one) else {
            return Ok(());
        };
        let there = |name: &str| self.effects.iter().position(|(f, _)| f.kind.name == name);
        let places: Option<Vec<usize>> = several.iter().map(|name| there(name)).collect();
        let (Some(places), None, true) = (places, there(one), self.ground.curve.is_empty()) else {
            return Ok(());
        };
        let freedom = |i: &usize| {
            let found = &self.effects[*i].0;
            found.kind.freedom_of(&found.used)
        };
        let used = vec![true; candidate.kind.terms.len()];
        let spared = places.iter().map(freedom).sum::<usize>() as f64
            - candidate.kind.freedom_of(&used) as f64;
        let simple = self
            .ground
            .found(candidate.kind, candidate.shape.clone(), used);
        let price = self.price(spared);
        let (as_was, before) = (self.effects.clone(), self.error_with_signs()?);
        self.effects[places[0]].0 = simple;
        let mut place = 0..;
        self.effects
            .retain(|_| place.next().is_none_or(|i| !places[1..].contains(&i)));
        self.polish_until(ENOUGH_AT_LAST)?;
        if self.error_with_signs()? > price * before {
            self.effects = as_was;
        }
        Ok(())
    }

    /// Takes out what later effects made superfluous.
    pub(super) fn prune(&mut self) -> Result<(), DynamicsError> {
        while self.effects.len() > 1 {
            let mut least: Option<(usize, f64, f64, f64)> = None;
            for i in 0..self.effects.len() {
                let (found, p_value) = &self.effects[i];
                if self.is_sure(found.kind) || *p_value == UNASKED {
                    continue;
                }
                let x = self.without(i)?;
                let efforts = [self.ground.y.clone()];
                let problem = Problem::new(&x, &efforts, &self.ground.folds);
                let Some(alone) = problem.alone() else {
                    continue;
                };
                let (with, theta) = self
                    .beside(&problem, found)
                    .map_or((f64::INFINITY, vec![]), |with| (with.mse, with.theta));
                let alone = alone[0].mse;
                let size = (alone - with).max(0.0).sqrt();
                let moved = size / (self.least_size(found, &theta) * self.floor.rms);
                // By how much it passes: by its size, and by its share of what is left without it.
                let margin = moved.min(size / (LEAST_GAIN * alone).sqrt());
                if least.as_ref().is_none_or(|old| margin < old.1) {
                    least = Some((i, margin, alone, with));
                }
            }
            let Some((i, margin, alone, with)) = least else {
                break;
            };
            if margin >= 1.0 {
                break;
            }
            let (gone, _) = self.effects.remove(i);
            if most_of(gone.kind) == 1 {
                self.given_up.push(gone.kind.name);
            }
            self.refused.retain(|old| old.name != gone.kind.name);
            self.refused.push(Refused {
                name: gone.kind.name,
                reason: "superfluous beside the effects added later".to_owned(),
                held_out_rms: [alone.sqrt(), with.min(1e300).sqrt()],
            });
            self.refine_all()?;
        }
        Ok(())
    }
}
