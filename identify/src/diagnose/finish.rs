//! The end of the search: the order of the effects, what looks alike, and the last fit.

use std::sync::Arc;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::confirm::shown;
use super::gates::{LEAST_SIZE, gives};
use super::model::{Found, Ground, RIGID, is_known, is_smooth_load, object_of};
use super::score::{Problem, factor, gram};
use super::search::{
    Ambiguity, Diagnosis, NamedEffect, RIVAL_BELOW, Refused, State, fit_found, floor_of,
};
use super::shapes::ENOUGH_AT_LAST;
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::{DynamicsError, EffortModel};
use crate::effect::friction::ASYMMETRIC;
use crate::effect::library::{Kind, kind};
use crate::effect::load::{CONSTANT_LOAD, STRUT};
use crate::effect::slip::{self, SLIP};
use crate::least_squares::rms;
use crate::motion::Motion;
use crate::products::dot;

/// Kinds that only a tare tells apart: on moving samples their regressors agree.
const ALIAS: (&str, &str) = ("constant_load", "asymmetric_coulomb");
/// Friction of one way is at most so many times that of the other, or it is a load.
const MOST_BY_WAY: f64 = 2.0;
/// Play and a grasp that gives: how pads hit the handle behind their play is in no model, so that either may do for the other.
const CRUDE: (&str, &str) = ("grasp_compliance", "backlash");
/// The share of the gain that makes one of these a look-alike of the other: their forms are cruder than that.
const ALIAS_GAIN: f64 = 0.5;
/// Kinds that hold another one as a special case: no alternatives to it.
const CONTAIN: [(&str, &str); 8] = [
    ("spring", "constant_load"),
    ("spring", "asymmetric_coulomb"),
    ("sensor_drift", "constant_load"),
    ("sensor_drift", "asymmetric_coulomb"),
    ("gravity", "constant_load"),
    ("gravity", "asymmetric_coulomb"),
    (ZONE, "asymmetric_viscous"),
    ("backlash", "grasp_compliance"),
];
const ZONE: &str = "damping_zone";

fn are(pair: (&str, &str), a: &str, b: &str) -> bool {
    pair == (a, b) || pair == (b, a)
}

/// Whether they are play and a grasp that gives.
pub(super) fn are_crude(a: &str, b: &str) -> bool {
    are(CRUDE, a, b)
}

/// Whether no motion tells them apart, or one of them holds the other as a special case and is no cruder for it.
pub(super) fn are_of_one_class(a: &str, b: &str) -> bool {
    let contains = CONTAIN.iter().any(|pair| are(*pair, a, b));
    !are_crude(a, b) && (contains || are(ALIAS, a, b))
}

impl State {
    pub(super) fn finish(mut self) -> Result<Diagnosis, DynamicsError> {
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
        let as_found = self.effects.clone();
        let mut ambiguous = Vec::new();
        for i in 0..self.effects.len() {
            ambiguous.push(self.look_alikes(i)?);
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
        drop_doubtful(ground, floor, known, &mut effects, &mut self.refused)?;
        let model = fit_named(motion, &mut effects)?;
        let ordered: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
        let floor = floor_of(&self.samples, motion, &model, &ordered)?;
        self.refused
            .retain(|refused| !ordered.iter().any(|found| found.kind.name == refused.name));
        if let Some((lag, p_value)) = self.lag {
            // The others' errors are those with the lag taken out; its own are with all others in.
            let late = self.samples.with_effort_earlier(-lag);
            let before = fit_found(&Motion::prepare(&late, &self.settings)?, &ordered)?;
            let held_out_rms = [before.held_out_rms, model.held_out_rms];
            let share = 1.0 - (held_out_rms[1] / held_out_rms[0]).powi(2);
            // Of what free air shows there is no doubt, but it may do nothing that a name would be needed for.
            let known = p_value == 0.0;
            let (left, floor) = (model.held_out_rms, self.floor.rms);
            if !known && share < sure_share(left, floor) && left > EXPLAINED_BELOW * floor {
                self.refused
                    .push(doubt("time_lag", share, held_out_rms, floor));
                self.shift(late)?;
                self.lag = None;
                self.effects = as_found;
                self.refine_all()?;
                return self.finish();
            }
            let Some(time_lag) = kind("time_lag") else {
                unreachable!("the library has a time lag")
            };
            let effect = NamedEffect {
                found: self.ground.found(time_lag, Vec::new(), vec![false]),
                held_out_rms,
                p_value,
                ambiguous_with: Vec::new(),
                spread: DMatrix::zeros(0, 0),
            };
            // A grasp that gives moves tool and object apart in time as well.
            let gives = |effect: &NamedEffect| gives(effect.found.kind);
            let needed = !known || share > 0.0;
            if needed && (lag.abs() > LEAST_BESIDE || !effects.iter().any(gives)) {
                self.refused.retain(|refused| refused.name != time_lag.name);
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
        let is_either = |kind: &Kind| kind.is(&ASYMMETRIC) || kind.is(&CONSTANT_LOAD);
        let either = |(found, _): &(Found, f64)| is_either(found.kind);
        let Some(i) = self.effects.iter().position(either) else {
            return Ok(());
        };
        let before = self.effects[..i].iter();
        let own = RIGID + before.map(|(f, _)| f.terms().count()).sum::<usize>();
        let theta = self.fit()?.theta;
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

    /// That the tool slid on the handle, where leaving it in would have moved the effort by more than the floor allows to doubt.
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
        Ok((moved > LEAST_SIZE * self.floor.rms).then_some(effect))
    }

    /// Effects that would do nearly as well in place of effect `i`.
    fn look_alikes(&self, i: usize) -> Result<Vec<Ambiguity>, DynamicsError> {
        let (seen, own) = self.in_place_of(i, f64::INFINITY)?;
        let Some(seen) = seen else {
            return Ok(Vec::new());
        };
        let found = &self.effects[i].0;
        let name = found.kind.name;
        let gain = (seen.mse - own).max(0.0);
        // Beside other dampers, what slows over the whole range may be one more of them.
        let damps = self.effects.iter().any(|(f, _)| f.kind.name == ZONE);
        let contains =
            |kind: &Kind| CONTAIN.contains(&(kind.name, name)) && !(damps && kind.name == ZONE);
        let mut alike: Vec<Ambiguity> = seen
            .ranked
            .iter()
            .filter(|entry| entry.kind.name != name && self.too_heavy(entry).is_none())
            .filter(|entry| {
                let alias = are(ALIAS, entry.kind.name, name) || are_crude(entry.kind.name, name);
                let least = if alias { ALIAS_GAIN } else { 0.85 };
                seen.mse - entry.mse >= least * gain && (alias || entry.mse <= 1.15 * own)
            })
            .filter(|entry| {
                let crude = CRUDE == (name, entry.kind.name);
                !contains(entry.kind) || crude || entry.mse < 0.95 * own
            })
            .map(|entry| ambiguity(entry.kind, Some(entry.found(&self.ground))))
            .collect();
        // A strut whose rate cannot be seen apart from the weight.
        let rate_is_hidden = |f: &Found| f.kind.is(&STRUT) && !f.used[0];
        if name == "gravity" && self.effects.iter().any(|(f, _)| rate_is_hidden(f)) {
            alike.retain(|a| a.name != STRUT.name);
            alike.push(ambiguity(&STRUT, None));
        }
        for hidden in self.hidden_in(i)? {
            if !contains(hidden) && alike.iter().all(|a| a.name != hidden.name) {
                alike.push(ambiguity(hidden, None));
            }
        }
        Ok(alike)
    }
}

impl State {
    /// Effects of the state that are not in the model, but of which a part of effect `i` may be: what its columns leave of
    /// theirs is too little to be seen.
    fn hidden_in(&self, i: usize) -> Result<Vec<&'static Kind>, DynamicsError> {
        let mut others = self.found();
        let all = self.ground.plain_columns(&others)?;
        others.remove(i);
        let without = self.ground.plain_columns(&others)?;
        let base = self.ground.plain_columns(&[])?;
        let [all, without, base] = [all, without, base].map(|x| (factor(&gram(&x)), x));
        let own = |(factor, x): &(Option<Cholesky<f64, Dyn>>, Vec<Vec<f64>>), column: &[f64]| {
            let right = DVector::from_fn(x.len(), |i, _| dot(&x[i], column));
            let theta = factor.as_ref().map(|factor| factor.solve(&right));
            let mut left = column.to_vec();
            for (x, theta) in x.iter().zip(theta.iter().flat_map(|theta| theta.iter())) {
                for (left, value) in left.iter_mut().zip(x) {
                    *left -= theta * value;
                }
            }
            rms(&left)
        };
        let mut out: Vec<&'static Kind> = Vec::new();
        for candidate in &self.bank {
            let kind = candidate.kind;
            let there = self.effects.iter().any(|(f, _)| f.kind.name == kind.name);
            if kind.at.is_none() || there || out.iter().any(|hidden| hidden.name == kind.name) {
                continue;
            }
            let columns = candidate.columns();
            let Some(column) = columns.first() else {
                continue;
            };
            let beside_all = own(&all, column);
            if beside_all < HIDDEN * own(&base, column) && own(&without, column) > 2.0 * beside_all
            {
                out.push(kind);
            }
        }
        Ok(out)
    }
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
    let object = Arc::new(object_of(&all, model.theta.as_slice()));
    for effect in effects.iter_mut().filter(|effect| gives(effect.found.kind)) {
        effect.found.object = Arc::clone(&object);
    }
    fit_found(motion, &found(effects))
}

/// Lag that is named beside a grasp that gives, s; a smaller one is taken out without a name.
const LEAST_BESIDE: f64 = 3e-3;

/// Share of a column that must stay its own to be seen: of an effect of two floors that is a fifth of a floor, near the least that is found.
const HIDDEN: f64 = 0.1;

/// While more than the floor is left, something is missing or has the wrong name: takes back, one after the other, what explains
/// too little beside all others to be sure of its name and less than what stays above the floor (curves: whatever stays), and all curves but one,
/// because several could make up any load. Three of them do so to the floor, and are taken back whatever is left.
fn drop_doubtful(
    ground: &Ground,
    floor: f64,
    known: impl Fn(&Found) -> bool,
    effects: &mut Vec<NamedEffect>,
    refused: &mut Vec<Refused>,
) -> Result<(), DynamicsError> {
    if effects.iter().filter(|e| is_curve(&e.found)).count() >= ANY_LOAD {
        let curves = effects.extract_if(.., |e| is_curve(&e.found));
        refused.extend(curves.map(|curve| Refused {
            name: curve.found.kind.name,
            reason: format!(
                "{ANY_LOAD} notches and ripples together make up any load: this one has no name"
            ),
            held_out_rms: curve.held_out_rms,
        }));
    }
    drop_small(ground, floor, &known, effects, refused)?;
    loop {
        let all: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
        if fit_found(&ground.motion, &all)?.held_out_rms <= EXPLAINED_BELOW * floor {
            break;
        }
        let curves = all.iter().filter(|found| is_curve(found)).count();
        let mut least: Option<(usize, f64, [f64; 2])> = None;
        for (i, found) in all.iter().enumerate() {
            let [before, after] = beside_others(ground, &all, i)?;
            let share = 1.0 - (after / before).powi(2);
            let curve = is_curve(found);
            let sure = match curve {
                true if !ground.curve.is_empty() => SURE_BESIDE_CURVE,
                true => SURE_CURVE,
                false => sure_share(after, floor),
            };
            // What explains more than all that stays above the floor is no stand-in for it.
            let stays = after.powi(2) - floor.powi(2);
            let outdone = before.powi(2) - after.powi(2) < stays;
            let little = share < sure && (curve || outdone);
            let doubtful = (little || curve && curves > 1) && !known(found);
            if doubtful && least.is_none_or(|(_, old, _)| share < old) {
                least = Some((i, share, [before, after]));
            }
        }
        let Some((i, share, errors)) = least else {
            break;
        };
        let gone = effects.remove(i);
        refused.push(doubt(gone.found.kind.name, share, errors, floor));
    }
    let mut found: Vec<Found> = Vec::new();
    let mut before = fit_found(&ground.motion, &found)?.held_out_rms;
    for effect in effects.iter_mut() {
        found.push(effect.found.clone());
        let after = fit_found(&ground.motion, &found)?.held_out_rms;
        effect.held_out_rms = [before, after];
        before = after;
    }
    Ok(())
}

/// While very much is left: takes back what explains but a small part of what is there without it. All at once, because what goes makes the share
/// of what stays smaller; and no load that a curve would hold, because it is judged without one.
fn drop_small(
    ground: &Ground,
    floor: f64,
    known: impl Fn(&Found) -> bool,
    effects: &mut Vec<NamedEffect>,
    refused: &mut Vec<Refused>,
) -> Result<(), DynamicsError> {
    let all: Vec<Found> = effects.iter().map(|effect| effect.found.clone()).collect();
    for i in (0..all.len()).rev() {
        let found = &all[i];
        let [before, after] = beside_others(ground, &all, i)?;
        let share = 1.0 - (after / before).powi(2);
        let judged = is_beside_curve(found) && !is_curve(found) && !known(found);
        if judged && after > VERY_FAR * floor && share < SURE_VERY_FAR {
            effects.remove(i);
            refused.push(doubt(found.kind.name, share, [before, after], floor));
        }
    }
    Ok(())
}

/// Held-out errors without and with effect `i`, beside the others and, where the search has a curve, a load of any shape: a bent one for notches and
/// ripples, the smooth one for the rest, and none for what that would hold.
fn beside_others(ground: &Ground, all: &[Found], i: usize) -> Result<[f64; 2], DynamicsError> {
    let mut others = all.to_vec();
    others.remove(i);
    if ground.curve.is_empty() || !is_beside_curve(&all[i]) {
        let error = |found: &[Found]| fit_found(&ground.motion, found).map(|fit| fit.held_out_rms);
        return Ok([error(&others)?, error(all)?]);
    }
    let curve = if is_curve(&all[i]) {
        &ground.bent_load()?
    } else {
        &ground.curve
    };
    Ok([
        error_beside(ground, &others, curve)?,
        error_beside(ground, all, curve)?,
    ])
}

fn is_curve(found: &Found) -> bool {
    CURVES.contains(&found.kind.name)
}

fn is_beside_curve(found: &Found) -> bool {
    !is_smooth_load(found.kind) && found.kind.name != "catch"
}

/// Held-out error of a model beside the columns of a curve.
fn error_beside(
    ground: &Ground,
    found: &[Found],
    curve: &[Vec<f64>],
) -> Result<f64, DynamicsError> {
    let mut x = ground.plain_columns(found)?;
    x.extend_from_slice(curve);
    let efforts = [ground.y.clone()];
    let outcome = Problem::new(&x, &efforts, &ground.folds).complete(&[]);
    Ok(outcome.map_or(f64::INFINITY, |outcome| outcome.mse.sqrt()))
}

fn doubt(name: &'static str, share: f64, held_out_rms: [f64; 2], floor: f64) -> Refused {
    Refused {
        name,
        reason: format!(
            "it explains {:.0} % of what is left and {:.1} noise floors stay: too little to be sure of its name",
            100.0 * share,
            held_out_rms[1] / floor
        ),
        held_out_rms,
    }
}

/// Share of the squared error that an effect must take away to be named while more than the floor is left: that much.
fn sure_share(left: f64, floor: f64) -> f64 {
    if left > FAR * floor { SURE_FAR } else { SURE }
}

/// Such a share where the floor is near.
const SURE: f64 = 0.3;
/// The same while many floors are left.
const SURE_FAR: f64 = 0.5;
/// So many floors are many.
const FAR: f64 = 3.0;
/// The same where so many are left that what is named is a small part of what there is.
const SURE_VERY_FAR: f64 = 0.75;
const VERY_FAR: f64 = 5.0;
/// The same for a curve over the coordinate.
const SURE_CURVE: f64 = 0.6;
/// The same beside a load of no name, of which it may be a part.
const SURE_BESIDE_CURVE: f64 = 0.9;
/// Curves over the coordinate that can sit anywhere: two or three of them make up any load.
const CURVES: [&str; 2] = ["detent", "ripple"];
/// So many of them do so to the noise floor.
const ANY_LOAD: usize = 3;

fn ambiguity(kind: &Kind, rival: Option<Found>) -> Ambiguity {
    Ambiguity {
        name: kind.name,
        told_apart_by: kind.separate,
        rival,
    }
}
