//! From joint samples to the effort model with its errors and a verdict: the part that recordings and tables share.

use std::borrow::Cow;
use std::collections::BTreeMap;

use nalgebra::DVector;

use crate::diagnose::{
    Confirmation, Diagnosis, Evidence, Found, LEAST_FLOOR, NamedEffect, Refused, add_stiction,
    beside_rigid, confirm, diagnose_rid_of_slips, evidence, floor_of, gives, is_smooth_load,
    others_rid_of_slips, shown, state_spread, take_from_both,
};
use crate::dynamics::{
    Bursts, DynamicsError, EffortModel, JointFit, Structure, align, bursts, fit_base, fit_jointly,
    fit_parametric, not_white, structure,
};
use crate::effect::BiasDrift;
use crate::effect::friction::ASYMMETRIC;
use crate::effect::library::Belongs;
use crate::effect::measurement::SENSOR_DRIFT;
use crate::effect::slip::SLIP;
use crate::lag::{Lag, USUAL_S};
use crate::least_squares::rms;
use crate::motion::{Motion, MotionSettings};
use crate::noise::NoiseFloor;
use crate::parallel::in_parallel_on;
use crate::payload::is_another;
use crate::samples::JointSamples;
use crate::screw::JointKind;

/// What the final model leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The held-out residual is at the noise floor, and white.
    Explained,
    /// Structure remains.
    Unexplained,
    /// The data cannot tell.
    NotIdentifiable,
}

/// Series for plots, at the fit's samples.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FitSeries {
    /// Time, s.
    pub time: Vec<f64>,
    /// Joint coordinate.
    pub q: Vec<f64>,
    /// Velocity.
    pub dq: Vec<f64>,
    /// Effort as measured, filtered.
    pub tau: Vec<f64>,
}

/// The dynamics of one recording or table.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Smallest and largest coordinate.
    pub q_range: [f64; 2],
    /// The paper's model.
    pub base: EffortModel,
    /// The paper's model and the effects that were named, without a mechanism; the verdict is about it.
    pub named: EffortModel,
    /// The full model: the named one, and the mechanism fitted on what is left.
    pub full: EffortModel,
    /// Whether the full model leaves those named effects to its mechanism that a mechanism can be by itself.
    pub left_to_mechanism: bool,
    /// Motion and dynamics fitted together, from the full model on or with the shapes of the named effects; nothing where that foretells no better.
    pub jointly: Option<JointFit>,
    /// What was named and what was refused; nothing when nobody looked.
    pub diagnosis: Option<Diagnosis>,
    /// Plots of the named effects, in their order.
    pub evidence: Vec<Option<Evidence>>,
    /// Errors on confirming recordings.
    pub confirmed: Vec<Confirmation>,
    /// Lag of the effort behind the motion.
    pub lag: Option<Lag>,
    /// What a complete model would leave.
    pub floor: NoiseFloor,
    /// Against what the named model's residual stands, strongest first.
    pub structure: Vec<Structure>,
    /// How what the named effects leave comes in bursts, where it does.
    pub bursts: Option<Bursts>,
    /// The verdict.
    pub verdict: Verdict,
    /// What is neither named nor noise, as a share of the effort (amplitudes): sqrt(held_out^2 - floor^2) / rms(tau), or what stands against one variable
    /// where that is more.
    pub unexplained_fraction: f64,
    /// How the motion was prepared.
    pub settings: MotionSettings,
    /// Whether its cut-off was lowered for a slow motion.
    pub cutoff_lowered: bool,
    /// Samples that the fits used.
    pub used: usize,
    /// Samples taken out, by gate.
    pub gated: BTreeMap<&'static str, usize>,
    /// The whole motion for the plot of the probing: time, q, dq at about 50 Hz.
    pub probing: FitSeries,
    /// What the fits saw.
    pub series: FitSeries,
}

impl Analysis {
    /// Smallest and largest velocity that the fit saw, rad/s or m/s.
    #[must_use]
    pub fn speeds(&self) -> [f64; 2] {
        let (slowest, fastest) = crate::samples::extrema(&self.series.dq);
        [slowest, fastest]
    }
}

/// Up to so many times the floor no rivals are tried and no name is doubted. The verdict asks for a little less.
pub const EXPLAINED_BELOW: f64 = 1.15;
/// The floor is estimated to a few percent: up to so many times the estimate the verdict is `explained`.
pub(crate) const SURELY_BELOW: f64 = 1.10;
/// The same where pads or play are named: how these meet the handle is in no model, and what their forms leave is not to pass for noise.
const SURELY_BELOW_CRUDE: f64 = 1.03;

/// Fits the base, names what it lacks, and fits the full model on it.
///
/// # Errors
/// [`DynamicsError`].
pub fn analyse(
    samples: &JointSamples,
    settings: &MotionSettings,
) -> Result<Analysis, DynamicsError> {
    analyse_confirmed(samples, settings, &[])
}

/// As [`analyse`]; an effect must hold on each of `others` (file name, samples of the same joint) too.
///
/// # Errors
/// [`DynamicsError`].
pub fn analyse_confirmed(
    samples: &JointSamples,
    settings: &MotionSettings,
    others: &[(String, JointSamples)],
) -> Result<Analysis, DynamicsError> {
    let asked = settings;
    let settings = &asked.quiet_for(samples, others.iter().map(|(_, other)| other))?;
    let (mut diagnosis, mut confirmed) = confirmed_diagnosis(samples, settings, others)?;
    let lag = aligned(&mut diagnosis, settings)?;
    leave_out_turns(&mut diagnosis)?;
    drop_useless(&mut diagnosis, &mut confirmed)?;
    state_spread(&mut diagnosis)?;
    take_from_both(&mut diagnosis)?;
    let mut base = fit_base(&diagnosis.motion)?;
    let (samples, motion) = (&diagnosis.samples, &diagnosis.motion);
    let mut named = diagnosis.model.clone();
    let (full, jointly, left_to_mechanism) = with_mechanism(motion, &diagnosis)?;
    for model in [&mut base, &mut named] {
        model.withdraw_friction_of_one_way(motion);
    }
    let found = diagnosis.found();
    let floor = floor_of(samples, motion, &full, &found)?;
    let tau = motion.regressor(&motion.tau)?;
    // What is below the digits of a file is arithmetic, and no noise to compare with.
    let is_noise = floor.rms > LEAST_FLOOR * rms(&tau);
    let structure = structure(motion, &named.residual, named.effective_samples)?;
    let left = (&named, if is_noise { structure.as_slice() } else { &[] });
    let (mut verdict, unexplained_fraction) = judge(left, &found, floor.rms, rms(&tau));
    let nothing = full.terms.iter().all(|term| term.value.is_none());
    if nothing && (diagnosis.effects.is_empty() || motion.goes_one_way()) {
        verdict = Verdict::NotIdentifiable;
    }
    let bursts = is_noise
        .then(|| bursts(motion, &named.residual, named.effective_samples))
        .flatten();
    let evidence = evidence(motion, &named, &diagnosis.effects).map_err(DynamicsError::from)?;
    let (low, high) = samples.q_range();
    let at =
        |series: &[f64], step: usize| series.iter().step_by(step).copied().collect::<Vec<f64>>();
    let step = ((0.02 / motion.period) as usize).max(1);
    Ok(Analysis {
        kind: samples.kind,
        q_range: [low, high],
        structure,
        lag,
        bursts,
        verdict,
        unexplained_fraction,
        settings: *settings,
        cutoff_lowered: settings != asked,
        used: motion.kept.len(),
        gated: motion.gated.clone(),
        probing: FitSeries {
            time: at(&motion.time, step),
            q: at(&motion.q, step),
            dq: at(&motion.dq, step),
            tau: Vec::new(),
        },
        series: FitSeries {
            time: motion.at_kept(&motion.time),
            q: motion.at_kept(&motion.q),
            dq: motion.at_kept(&motion.dq),
            tau,
        },
        base,
        named,
        full,
        left_to_mechanism,
        jointly,
        floor,
        evidence,
        confirmed,
        diagnosis: Some(diagnosis),
    })
}

/// Looks, asks the other recordings, and looks again without the first that they refused: something else may stand in its place.
fn confirmed_diagnosis(
    samples: &JointSamples,
    settings: &MotionSettings,
    others: &[(String, JointSamples)],
) -> Result<(Diagnosis, Vec<Confirmation>), DynamicsError> {
    let mut barred: Vec<&'static str> = Vec::new();
    let (samples, mut earlier) = confirmed_change(samples, others);
    let mut best = None;
    let mut least = f64::INFINITY;
    loop {
        // Slips seen beside a model that was refused may be none.
        let mut diagnosis = diagnose_rid_of_slips(&samples, settings, &barred)?;
        let others = others_rid_of_slips(&diagnosis, others, settings)?;
        let known = diagnosis.refused.len();
        let confirmed = confirm(&mut diagnosis, &others, settings)?;
        let mut refused: Vec<Refused> = diagnosis.refused[known..].to_vec();
        // Of several dampers one may be too many; where the tool slid is in no model, confirmed or not.
        refused.retain(|refused| {
            let there = |e: &NamedEffect| e.found.kind.name == refused.name;
            refused.name != SLIP.name && !diagnosis.effects.iter().any(there)
        });
        // A search that begins anew may end in a worse place than the one before it did without what was refused.
        let error = diagnosis.model.held_out_rms;
        least = least.min(error);
        let ends = refused.is_empty() || barred.len() >= MOST_BARRED;
        let stays = |_: &mut _| least < STAYS_BELOW * error;
        let last = (diagnosis, confirmed, others);
        let (mut diagnosis, mut confirmed, others) = best.take_if(stays).unwrap_or(last);
        if ends {
            let named = |name| diagnosis.effects.iter().any(|e| e.found.kind.name == name);
            earlier.retain(|known| !diagnosis.refused.contains(known) && !named(known.name));
            diagnosis.refused.extend(earlier);
            add_stiction(&mut diagnosis, &mut confirmed, &others, settings)?;
            return Ok((diagnosis, confirmed));
        }
        // What was refused after the first may have been so for want of it only.
        best = Some((diagnosis, confirmed, others));
        refused.truncate(1);
        barred.extend(refused.iter().map(|refused| refused.name));
        earlier.extend(refused);
    }
}

/// Leaves a change of the tool in the effort when another recording does not show the same.
fn confirmed_change<'a>(
    samples: &'a JointSamples,
    others: &[(String, JointSamples)],
) -> (Cow<'a, JointSamples>, Vec<Refused>) {
    let Some(change) = &samples.aside.change else {
        return (Cow::Borrowed(samples), Vec::new());
    };
    let same = |other: &JointSamples| {
        other.aside.change.as_ref().is_some_and(|there| {
            let ratio = there.size / change.size;
            there.name == change.name && (SAME..1.0 / SAME).contains(&ratio)
        })
    };
    let Some((file, _)) = others.iter().find(|(_, other)| !same(other)) else {
        return (Cow::Borrowed(samples), Vec::new());
    };
    let refused = Refused {
        name: change.name,
        reason: format!("not confirmed: free air after the release of {file} does not show it"),
        held_out_rms: [f64::NAN, f64::NAN],
    };
    (Cow::Owned(samples.with_change_left_in()), vec![refused])
}

/// Changes of the tool in two recordings are the same within this factor.
const SAME: f64 = 0.4;

/// What a search found stays when the least error on held-out strokes so far is so much smaller than that of the search after it.
const STAYS_BELOW: f64 = 0.9;

/// After so many refusals by other recordings the search is not begun anew.
const MOST_BARRED: usize = 6;

/// Takes out a lag that was too small to be named.
fn aligned(
    diagnosis: &mut Diagnosis,
    settings: &MotionSettings,
) -> Result<Option<Lag>, DynamicsError> {
    let found = diagnosis.found();
    let (samples, motion, mut lag) = align(&diagnosis.samples, settings, &beside_rigid(&found))?;
    // Free air, where nothing gives, knows better.
    let late = diagnosis.samples.aside.late;
    if let Some(lag) = &mut lag {
        lag.applied &= late.is_none_or(|late| !is_another(lag.value_s, late));
    }
    if let Some(lag) = lag.as_mut().filter(|lag| lag.applied) {
        let before = diagnosis.model.held_out_rms;
        let (samples, motion) = (
            core::mem::replace(&mut diagnosis.samples, samples),
            core::mem::replace(&mut diagnosis.motion, motion),
        );
        let (effects, model, floor) = (
            diagnosis.effects.clone(),
            diagnosis.model.clone(),
            diagnosis.floor,
        );
        let fitted = shown(diagnosis.refit())?.is_some();
        // A grasp that gives looks like a lag and is none.
        if !fitted || diagnosis.model.held_out_rms > before && lag.value_s.abs() <= USUAL_S {
            (diagnosis.samples, diagnosis.motion) = (samples, motion);
            (diagnosis.effects, diagnosis.model, diagnosis.floor) = (effects, model, floor);
            lag.applied = false;
        }
    }
    let named = diagnosis.lag_s.unwrap_or(0.0);
    Ok(lag.map(|lag| match (lag.applied, named == 0.0) {
        (false, true) => lag,
        (applied, _) => Lag {
            value_s: named + if applied { lag.value_s } else { 0.0 },
            applied: true,
            ..lag
        },
    }))
}

/// Leaves out where the joint turns, unless what is named foretells held-out strokes worse then, or is not shown any more: a grasp that
/// gives turns before the joint does.
fn leave_out_turns(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let slides = diagnosis.motion.leave_out_turns();
    let (effects, model, floor) = (
        diagnosis.effects.clone(),
        diagnosis.model.clone(),
        diagnosis.floor,
    );
    let fitted = shown(diagnosis.refit())?.is_some();
    if !fitted || diagnosis.model.held_out_rms > model.held_out_rms {
        diagnosis.motion.slides = slides;
        (diagnosis.effects, diagnosis.model, diagnosis.floor) = (effects, model, floor);
    }
    Ok(())
}

/// Takes out of a model, one after the other, what lowers no error on held-out strokes beside all others: a lag or turns that were taken out since
/// may have been what it stood for. An object's effect in a recording has evidence elsewhere, too.
fn drop_useless(
    diagnosis: &mut Diagnosis,
    confirmed: &mut [Confirmation],
) -> Result<(), DynamicsError> {
    loop {
        let mut useless = None;
        for i in 0..diagnosis.effects.len() {
            let found = &diagnosis.effects[i].found;
            let of_object = found.kind.belongs == Belongs::Object;
            if found.taken_out() || of_object && !diagnosis.is_table {
                continue;
            }
            let without = diagnosis.error_without(i)?;
            if without <= diagnosis.model.held_out_rms {
                useless = Some((i, without));
                break;
            }
        }
        let Some((i, without)) = useless else {
            break;
        };
        let name = diagnosis.effects[i].found.kind.name;
        diagnosis.refused.push(Refused {
            name,
            reason: "beside all others it does not lower the error on held-out strokes".to_owned(),
            held_out_rms: [without, diagnosis.model.held_out_rms],
        });
        diagnosis.effects.remove(i);
        diagnosis.refit()?;
        for there in &mut *confirmed {
            there.rms.remove(i);
        }
    }
    Ok(())
}

/// I, mu, b, the named effects and the mechanism at once; the terms are I, mu, b, and what is left of an effect beside the
/// mechanism stands in `theta` only. Where the named effects leave more than the floor, their shapes may be wrong: then those
/// that a mechanism can be by itself are left to it, if that foretells held-out strokes better; then the last value is true.
fn with_mechanism(
    motion: &Motion,
    diagnosis: &Diagnosis,
) -> Result<(EffortModel, Option<JointFit>, bool), DynamicsError> {
    let mut left = false;
    let found = diagnosis.found();
    // A friction of one way no mechanism has.
    let by_state = |found: &Found| found.kind.at.is_some() && !found.kind.is(&ASYMMETRIC);
    let floor = diagnosis.floor.rms.max(diagnosis.simulated_rms);
    let mut used = vec![vec![true; found.len()]];
    if diagnosis.model.held_out_rms > EXPLAINED_BELOW * floor && found.iter().any(by_state) {
        used.push(found.iter().map(|found| !by_state(found)).collect());
    }
    // Side by side only while that is no question of memory: of an hour each takes some hundred megabytes.
    let at_once = if motion.q.len() < MANY { usize::MAX } else { 1 };
    let fits = in_parallel_on(at_once, &used, |used| {
        beside_mechanism(
            motion,
            diagnosis.is_table,
            &found,
            used,
            EXPLAINED_BELOW * floor,
        )
    });
    let mut fits = fits.into_iter();
    let Some(all) = fits.next() else {
        unreachable!("one item has one result")
    };
    let (mut model, mut jointly) = all?;
    if let Some(without) = fits.next() {
        let without = without?;
        if without.0.held_out_rms < LEFT_BELOW * model.held_out_rms {
            (model, jointly) = without;
            left = true;
        }
    }
    let alone = shown(fit_parametric(motion, &beside_rigid(&found)))?;
    let above = if diagnosis.together.is_some() {
        KNOWN_ALONE_ABOVE
    } else {
        ALONE_ABOVE
    };
    if let Some(mut alone) = alone.filter(|alone| above * alone.held_out_rms < model.held_out_rms) {
        // A mechanism that takes up what a named effect is: the effects alone foretell. What the full model does not know stays unknown.
        jointly.clone_from(&diagnosis.together);
        if jointly.is_some() {
            alone = EffortModel {
                held_out_rms: alone.held_out_rms,
                ..diagnosis.model.clone()
            };
        }
        model = known_to_all(alone, [&model, &diagnosis.model]);
        for (term, stated) in jointly
            .iter_mut()
            .flat_map(|fit| &mut fit.terms)
            .zip(&model.terms)
        {
            term.std = stated.std;
        }
        left = false;
    } else {
        keep_loads_named(&mut model, jointly.as_mut(), diagnosis, left);
    }
    model.withdraw_friction_of_one_way(motion);
    model.terms.truncate(3);
    model.covariance = model.covariance.view((0, 0), (3, 3)).into_owned();
    let terms = &model.terms;
    model
        .not_identified
        .retain(|name, _| terms.iter().any(|term| term.name == *name));
    // What the data do not show they do not show here either.
    for (term, plain) in jointly.iter_mut().flat_map(|fit| &mut fit.terms).zip(terms) {
        if plain.value.is_none() {
            (term.value, term.std) = (None, None);
        }
    }
    Ok((model, jointly, left))
}

/// A load over the whole range can be a named effect's or the mechanism's, and nothing tells which; nor does anything tell a friction of one way from
/// a constant load and half of it both ways. They are given back to the effects, as much as these have in the named model (of friction as much as the full model has):
/// of loads those that are not `left` to the mechanism. The effort within the probed range stays the same.
fn keep_loads_named(
    full: &mut EffortModel,
    jointly: Option<&mut JointFit>,
    diagnosis: &Diagnosis,
    left: bool,
) {
    let Some(mechanism) = &mut full.mechanism else {
        return;
    };
    let named = &diagnosis.model;
    let (mut both_ways, mut at) = (0.0, 3);
    for found in diagnosis.found() {
        // What the named effect has more of, by its terms, is taken out of g.
        let mut more = [0.0; 2];
        let used = found.used.iter().enumerate().filter(|(_, used)| **used);
        for (k, _) in used {
            let value = named.theta[at];
            let kept = if found.kind.is(&ASYMMETRIC) {
                Some(value.min(2.0 * full.theta[COULOMB].max(0.0)))
            } else {
                (!left && is_smooth_load(found.kind)).then_some(value)
            };
            if let Some(value) = kept {
                more[k] = value - full.theta[at];
                full.theta[at] = value;
            }
            at += 1;
        }
        if found.kind.is(&ASYMMETRIC) {
            both_ways += 0.5 * more[0];
            mechanism.take_load(|_| 0.5 * more[0] * found.shape[0]);
        } else if let Some(of_state) = found.kind.at.filter(|_| more != [0.0; 2]) {
            mechanism.take_load(|q| {
                let [first, second] = of_state(&found.shape, q + found.datum, 0.0);
                more[0] * first + more[1] * second
            });
        }
    }
    if both_ways == 0.0 {
        return;
    }
    full.theta[COULOMB] -= both_ways;
    let variance = named.covariance[(COULOMB, COULOMB)];
    let widest = full.covariance[(COULOMB, COULOMB)].max(variance);
    full.covariance[(COULOMB, COULOMB)] = widest;
    let jointly = jointly.and_then(|fit| fit.terms.get_mut(COULOMB));
    for term in full.terms.get_mut(COULOMB).into_iter().chain(jointly) {
        term.value = term.value.map(|value| (value - both_ways).max(0.0));
        term.std = term.std.map(|std| std.max(variance.sqrt()));
        // What is left of it may not be known where the sum is.
        if named.terms[COULOMB].value.is_none() {
            (term.value, term.std) = (None, None);
        }
    }
    let coulomb = &named.terms[COULOMB].name;
    if let Some(reason) = named.not_identified.get(coulomb) {
        full.not_identified.insert(coulomb.clone(), reason.clone());
    }
}

/// Where Coulomb friction is among the parameters.
const COULOMB: usize = 1;

/// Named effects are left to the mechanism when it does so much better on held-out strokes.
const LEFT_BELOW: f64 = 0.97;

/// Samples at the work rate, 20 min of them, from which on memory counts for more than time.
const MANY: usize = 120_000;

/// A mechanism that foretells held-out strokes so many times worse than the named effects by themselves is none.
const ALONE_ABOVE: f64 = 1.5;
/// The same where motion and effort together have the effects' parameters.
const KNOWN_ALONE_ABOVE: f64 = 1.02;

/// `model` as uncertain in inertia and friction as any of the others says, and without what `full` has not.
fn known_to_all(mut model: EffortModel, others: [&EffortModel; 2]) -> EffortModel {
    let [full, _] = others;
    for (j, (term, other)) in model.terms.iter_mut().zip(&full.terms).take(3).enumerate() {
        let variances = others.map(|other| other.covariance[(j, j)]);
        let widest = variances
            .into_iter()
            .fold(model.covariance[(j, j)], f64::max);
        model.covariance[(j, j)] = widest;
        term.std = term.std.map(|_| widest.max(0.0).sqrt());
        if other.value.is_none() {
            (term.value, term.std) = (None, None);
            let reason = full.not_identified.get(&term.name).cloned();
            model
                .not_identified
                .extend(reason.map(|reason| (term.name.clone(), reason)));
        }
    }
    model
}

/// I, mu, b, those of `found` that are `used`, and the mechanism, beside what a force sensor usually drifts; the parameters of the
/// others are zero.
fn beside_mechanism(
    motion: &Motion,
    is_table: bool,
    found: &[Found],
    used: &[bool],
    whole_below: f64,
) -> Result<(EffortModel, Option<JointFit>), DynamicsError> {
    // Beside a load that may be any constant a friction of one way is one of both.
    let tells = |found: &Found| !found.kind.is(&ASYMMETRIC);
    let used = found.iter().zip(used);
    let used: Vec<bool> = used.map(|(found, used)| *used && tells(found)).collect();
    let some = found.iter().zip(&used).filter(|(_, used)| **used);
    let mut effects = beside_rigid(some.map(|(found, _)| found));
    let is_named = |found: &Found| found.kind.name == SENSOR_DRIFT.name;
    if !is_table && !found.iter().any(is_named) {
        effects.push(&BiasDrift);
    }
    let (mut model, jointly) = fit_jointly(motion, &effects, whole_below)?;
    let mut fitted = model.theta.iter().copied();
    let mut theta: Vec<f64> = fitted.by_ref().take(3).collect();
    for (found, used) in found.iter().zip(&used) {
        for _ in found.terms() {
            theta.push(if *used {
                fitted.next().unwrap_or(0.0)
            } else {
                0.0
            });
        }
    }
    model.bias_drift = BiasDrift::range(&fitted.collect::<Vec<f64>>());
    model.theta = DVector::from_vec(theta);
    Ok((model, jointly))
}

/// Verdict and unexplained share of a model with `effects`, and of what its residual stands against: what is explained leaves as much as noise
/// does, and is white.
#[must_use]
pub fn judge(
    (model, structure): (&EffortModel, &[Structure]),
    effects: &[Found],
    floor: f64,
    effort_rms: f64,
) -> (Verdict, f64) {
    let is_crude = effects.iter().any(|found| gives(found.kind));
    let most = if is_crude {
        SURELY_BELOW_CRUDE
    } else {
        SURELY_BELOW
    };
    let left = model.held_out_rms;
    let not_white = not_white(structure);
    let verdict = if model.terms.iter().all(|term| term.value.is_none()) {
        Verdict::NotIdentifiable
    } else if left <= most * floor && not_white.is_none() {
        Verdict::Explained
    } else {
        Verdict::Unexplained
    };
    let above = left.powi(2) - floor.powi(2);
    let shaped = not_white.map_or(0.0, |one| one.share * left.powi(2));
    let over = above.max(shaped).sqrt();
    (verdict, over / effort_rms.max(f64::MIN_POSITIVE))
}
