//! From joint samples to the effort model with its errors and a verdict: the part that recordings and tables share.

mod full;

use std::borrow::Cow;
use std::collections::BTreeMap;

use self::full::with_mechanism;
use crate::diagnose::{
    Confirmation, Diagnosis, Evidence, Found, LEAST_FLOOR, NamedEffect, Refused, Steps, Stiction,
    add_stiction, beside_rigid, confirm, diagnose_rid_of_slips, evidence, floor_of, gives,
    others_rid_of_slips, shown, state_forms, state_spread, take_from_both,
};
use crate::dynamics::{
    Bursts, DynamicsError, EffortModel, JointFit, Structure, align, bursts, fit_base, not_white,
    structure,
};
use crate::effect::library::Belongs;
use crate::effect::slip::SLIP;
use crate::lag::{Lag, USUAL_S};
use crate::least_squares::rms;
use crate::motion::MotionSettings;
use crate::noise::NoiseFloor;
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
    /// Whether the full model leaves those named effects to its mechanism that a mechanism can be by itself: not a friction of one way.
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
    let settings = asked.quiet_for(samples, others.iter().map(|(_, other)| other))?;
    let (mut diagnosis, mut confirmed, settings) = confirmed_diagnosis(samples, settings, others)?;
    let settings = &settings;
    let lag = aligned(&mut diagnosis, settings)?;
    leave_out_turns(&mut diagnosis)?;
    drop_useless(&mut diagnosis, &mut confirmed)?;
    state_spread(&mut diagnosis)?;
    take_from_both(&mut diagnosis)?;
    state_forms(&mut diagnosis)?;
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
    let structure = structure(motion, &named)?;
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
        cutoff_lowered: settings.cutoff_hz < asked.cutoff_hz,
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

/// As [`asked_of_others`], and gives how the motion was prepared: where the joint leaves rest with a jerk and too much is left while it slides to name
/// stiction, the search is made anew without turns, where no effect has the friction right. What it finds is taken where stiction is then named.
fn confirmed_diagnosis(
    samples: &JointSamples,
    settings: MotionSettings,
    others: &[(String, JointSamples)],
) -> Result<(Diagnosis, Vec<Confirmation>, MotionSettings), DynamicsError> {
    let (steps, mut unconfirmed) = (Steps::default(), Vec::new());
    let mut asked = |settings| asked_of_others(samples, settings, others, &steps, &mut unconfirmed);
    let (diagnosis, confirmed, stiction) = asked(&settings)?;
    if stiction == Stiction::BesideMore && !settings.turns_left_out && !steps.are_enough() {
        let between = MotionSettings {
            turns_left_out: true,
            ..settings
        };
        if let Some((mut again, confirmed, Stiction::Named)) = shown(asked(&between))? {
            let mut known = diagnosis.refused;
            known.retain(|old| {
                let same = |name| name == old.name;
                unconfirmed.contains(&old.name)
                    && !again.refused.iter().any(|refused| same(refused.name))
                    && !again.effects.iter().any(|e| same(e.found.kind.name))
            });
            again.refused.extend(known);
            return Ok((again, confirmed, between));
        }
    }
    Ok((diagnosis, confirmed, settings))
}

/// Looks, asks the other recordings, and looks again without the first that they refused: something else may stand in its place. What they refused comes
/// to the `unconfirmed`.
fn asked_of_others(
    samples: &JointSamples,
    settings: &MotionSettings,
    others: &[(String, JointSamples)],
    steps: &Steps,
    unconfirmed: &mut Vec<&'static str>,
) -> Result<(Diagnosis, Vec<Confirmation>, Stiction), DynamicsError> {
    let mut barred: Vec<&'static str> = Vec::new();
    let (samples, mut earlier) = confirmed_change(samples, others);
    let mut best = None;
    let mut least = f64::INFINITY;
    loop {
        // Slips seen beside a model that was refused may be none.
        let mut diagnosis = diagnose_rid_of_slips(&samples, settings, &barred, steps)?;
        let others = others_rid_of_slips(&diagnosis, others, settings)?;
        let known = diagnosis.refused.clone();
        let confirmed = confirm(&mut diagnosis, &others, settings)?;
        let mut refused = diagnosis.refused.clone();
        refused.retain(|refused| !known.contains(refused));
        // Of several dampers one may be too many; where the tool slid is in no model, confirmed or not.
        refused.retain(|refused| {
            let there = |e: &NamedEffect| e.found.kind.name == refused.name;
            refused.name != SLIP.name && !diagnosis.effects.iter().any(there)
        });
        unconfirmed.extend(refused.iter().map(|refused| refused.name));
        // A search that begins anew may end in a worse place than the one before it did without what was refused.
        let error = diagnosis.model.held_out_rms;
        least = least.min(error);
        let ends = refused.is_empty() || barred.len() >= MOST_BARRED || steps.are_enough();
        let stays = |_: &mut _| least < STAYS_BELOW * error;
        let last = (diagnosis, confirmed, others);
        let (mut diagnosis, mut confirmed, others) = best.take_if(stays).unwrap_or(last);
        if ends {
            let named = |name| diagnosis.effects.iter().any(|e| e.found.kind.name == name);
            earlier.retain(|known| !diagnosis.refused.contains(known) && !named(known.name));
            diagnosis.refused.extend(earlier);
            let stiction = add_stiction(
                &mut diagnosis,
                &mut confirmed,
                &others,
                settings,
                unconfirmed,
            )?;
            return Ok((diagnosis, confirmed, stiction));
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
