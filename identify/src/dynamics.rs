//! The effort model fitted to a prepared motion: `base` (the paper's I, mu, b) and `final` (those, further effects, and
//! the mechanism, all at once).
//!
//! The joint fit is a penalized least squares with bounds; smoothing of the mechanism is chosen by the error on held-out
//! strokes. Fitting everything at once keeps a mechanism that nothing else explains out of I, mu and b; fitting in turn,
//! as the paper does, does not.

mod attenuation;
mod bursts;
mod design;
mod joint;
mod left_out;
mod shaped;
mod structure;
mod turns;
mod valved;

pub use bursts::{Bursts, bursts};
pub use joint::JointFit;
pub(crate) use left_out::covariance_of_columns;
pub(crate) use shaped::{Shaped, fit_shapes, model_with};
pub use structure::{Structure, not_white, structure};

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use crate::digits::with_std;
use crate::effect::{Column, Effect, RigidBody};
use crate::lag::{self, FAR_S, Lag};
use crate::least_squares::{Bound, FitError, bounded_least_squares, effective_count, rms};
use crate::mechanism::SplineMechanism;
use crate::motion::{Motion, MotionError, MotionSettings};
use crate::parallel::in_parallel;
use crate::samples::JointSamples;
use attenuation::Taken;
use design::{Design, LOAD_GRID, MIDDLING};
use valved::Valved;

/// Why there is no effort model.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DynamicsError {
    /// The motion cannot be used.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// One parameter.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Term {
    /// Name, as in the project's vocabulary.
    pub name: String,
    /// Estimate in SI, or nothing when the data do not show it.
    pub value: Option<f64>,
    /// Standard deviation, with correlated residuals accounted for.
    pub std: Option<f64>,
    /// Unit.
    pub unit: String,
}

/// A fitted effort model.
#[derive(Clone, Debug, PartialEq)]
pub struct EffortModel {
    /// Parameters in the order of the effects.
    pub terms: Vec<Term>,
    /// Estimates as fitted, also of those that `terms` leaves out.
    pub theta: DVector<f64>,
    /// Covariance of the terms.
    pub covariance: DMatrix<f64>,
    /// Rank of the parametric part.
    pub rank: usize,
    /// Condition of the column-scaled parametric part.
    pub condition: f64,
    /// The mechanism, for the final model.
    pub mechanism: Option<SplineMechanism>,
    /// How far the sensor's bias goes where its drift was fitted beside the rest, N m or N; in no parameter.
    pub bias_drift: f64,
    /// Predicted effort at the kept samples.
    pub predicted: Vec<f64>,
    /// Measured minus predicted.
    pub residual: Vec<f64>,
    /// Root mean square residual.
    pub rms: f64,
    /// Residual over effort, both as root mean squares.
    pub relative_error: f64,
    /// Root mean square error on strokes left out of the fit to the smoothed motion; where [`JointFit::stands`], of the fit that
    /// it started from.
    pub held_out_rms: f64,
    /// Independent samples that the residual is worth.
    pub effective_samples: f64,
    /// What is not identified, and why and what to do.
    pub not_identified: BTreeMap<String, String>,
}

impl EffortModel {
    /// The estimate of a term, when it is identified.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<f64> {
        self.terms.iter().find(|term| term.name == name)?.value
    }

    /// The standard deviation of a term, when it is identified.
    #[must_use]
    pub fn std(&self, name: &str) -> Option<f64> {
        self.terms.iter().find(|term| term.name == name)?.std
    }
}

/// Fits the paper's model: non-negative I, mu, b and nothing else.
///
/// # Errors
/// [`DynamicsError`].
pub fn fit_base(motion: &Motion) -> Result<EffortModel, DynamicsError> {
    fit_parametric(motion, &[&RigidBody])
}

/// Fits the parameters of `effects` without a mechanism.
///
/// # Errors
/// [`DynamicsError`].
pub fn fit_parametric(
    motion: &Motion,
    effects: &[&dyn Effect],
) -> Result<EffortModel, DynamicsError> {
    Design::new(motion, effects, None)?.parametric()
}

/// Fits columns that the caller filtered; `folds` = fold of each sample and their number, for the held-out error.
///
/// # Errors
/// [`DynamicsError::Fit`].
pub fn fit_columns(
    columns: Vec<Column>,
    tau: Vec<f64>,
    folds: (Vec<usize>, usize),
) -> Result<EffortModel, DynamicsError> {
    Design::of_columns(columns, tau, folds)?.parametric()
}

/// Fits the parameters of `effects` together with the mechanism: as surfaces, and behind valves where there is damping and
/// that foretells held-out strokes better.
///
/// # Errors
/// [`DynamicsError`].
pub fn fit_with_mechanism(
    motion: &Motion,
    effects: &[&dyn Effect],
) -> Result<EffortModel, DynamicsError> {
    Ok(fit_full(motion, effects, None)?.0)
}

/// As [`fit_with_mechanism`], and then motion and dynamics together from there, nothing when that foretells held-out strokes
/// no better; where its inertia and friction are more certain, the model has its parameters and its mechanism. It takes from the
/// wrench how the joint moved, so it presumes that the model lacks nothing: only where the smoothed motion leaves at most
/// `whole_below` on held-out strokes, N m or N.
///
/// # Errors
/// [`DynamicsError`].
pub fn fit_jointly(
    motion: &Motion,
    effects: &[&dyn Effect],
    whole_below: f64,
) -> Result<(EffortModel, Option<JointFit>), DynamicsError> {
    fit_full(motion, effects, Some(whole_below))
}

fn fit_full(
    motion: &Motion,
    effects: &[&dyn Effect],
    whole_below: Option<f64>,
) -> Result<(EffortModel, Option<JointFit>), DynamicsError> {
    let mut mechanism = SplineMechanism::over(motion);
    let parametric = Design::new(motion, effects, None)?;
    let mut design = parametric.with_surfaces(motion, &mechanism);
    let folds = design.fold_normals();
    let effort = rms(parametric.tau.as_slice());
    let least = |held_out_rms: f64| DAMPED_ABOVE.max(SEEN_ABOVE * held_out_rms / effort);
    let behind_valves = |solution: &DVector<f64>| {
        let mut surfaces = mechanism.clone();
        surfaces.set(&solution.as_slice()[parametric.params..]);
        Valved::fit(&parametric, motion, &surfaces)
    };
    // Valves that foretell far better than surfaces of some smoothings are taken without a search for the best one.
    let mut smoothing = MIDDLING;
    let solution = design.solve(&smoothing);
    let warm: Vec<bool> = solution.iter().map(|v| *v != 0.0).collect();
    let mut held_out_rms = design.held_out_of(&folds, &smoothing, Some(&warm));
    let mut valved = (design.damping_share(solution.clone()) > least(held_out_rms))
        .then(|| behind_valves(&solution));
    let far_better = |(valved, _): &(Valved, Design)| {
        let tried = [valved.smoothing[0], LOAD_GRID[0]].map(|load| [load, MIDDLING[1]]);
        let errors = in_parallel(&tried, |tried| {
            design.held_out_of(&folds, tried, Some(&warm))
        });
        let least = errors.into_iter().fold(held_out_rms, f64::min);
        valved.held_out_rms < FAR_BELOW * least
    };
    if !valved.as_ref().is_some_and(far_better) {
        let undamped = design.undamped();
        let (loaded, without) = undamped.choose_load(&folds, smoothing);
        // To a joint without dampers damping does no good beside the load that it has.
        let damped = || design.held_out_of(&folds, &loaded, Some(&warm));
        let share = if valved.is_none() && without < DAMPED_BELOW * damped() {
            (design, smoothing, held_out_rms) = (undamped, loaded, without);
            0.0
        } else {
            (smoothing, held_out_rms) = design.choose_smoothing(&folds);
            let share = design.damping_share(design.solve(&smoothing));
            if without <= held_out_rms {
                (design, smoothing, held_out_rms) = (undamped, loaded, without);
            }
            share
        };
        valved = (share > least(held_out_rms))
            .then(|| valved.unwrap_or_else(|| behind_valves(&design.solve(&smoothing))));
    }
    let mut exact = None;
    if let Some((valved, near)) = valved
        && valved.held_out_rms < VALVED_BELOW * held_out_rms
    {
        design = near;
        exact = Some((valved.theta.clone(), valved.predicted(&design, &parametric)));
        (mechanism, smoothing, held_out_rms) =
            (valved.mechanism, valved.smoothing, valved.held_out_rms);
    }
    let solution = design.solve(&smoothing);
    let params = design.params;
    let (mut theta, mut predicted) = exact.unwrap_or_else(|| {
        mechanism.set(&solution.as_slice()[params..]);
        (solution.rows(0, params).into_owned(), &design.y * &solution)
    });
    let mut covariance = design.covariance(motion, &solution, &smoothing);
    covariance += turns::covariance(motion, &design, &smoothing, &theta)?;
    let taken = attenuation::taken(motion, &design, &smoothing, &theta)?;
    if let Taken::Some(given) = &taken {
        covariance = given.widened(&covariance);
        let all = theta.iter().copied().chain(mechanism.coefficients());
        let changed: Vec<f64> = all
            .zip(given.change.iter())
            .zip(&design.bounds)
            .map(|((value, change), bound)| match bound {
                Bound::Free => value + change,
                Bound::NonNegative if value > 0.0 => (value + change).max(0.0),
                Bound::NonNegative => value,
            })
            .collect();
        theta.copy_from_slice(&changed[..params]);
        mechanism.set(&changed[params..]);
    }
    let together = if whole_below.is_some() {
        let plain = joint::Plain {
            theta: theta.as_slice(),
            mechanism: &mechanism,
            design: &design,
            smoothing: &smoothing,
        };
        joint::fit(motion, effects, &plain)?.filter(|one| one.fit.held_out_rms <= held_out_rms)
    } else {
        None
    };
    let may_stand =
        !matches!(taken, Taken::TooMuch(_)) && whole_below.is_some_and(|most| held_out_rms <= most);
    let together = together.map(|mut together| {
        // What noise has taken of the plain one is no reason to doubt the other.
        if !matches!(taken, Taken::TooMuch(_)) {
            let common = mechanism.clone().take_common_damping();
            together.doubt(&theta, common, &covariance);
        }
        if may_stand && together.is_more_certain(&theta, &covariance) {
            together.fit.stands = true;
            let all = together.theta.iter().copied();
            let all: Vec<f64> = all.chain(together.mechanism.coefficients()).collect();
            predicted = &design.y * DVector::from_vec(all);
            theta.copy_from(&together.theta);
            (mechanism, covariance) = (together.mechanism, together.covariance);
        }
        together.fit
    });
    let damped = design.damping_share(solution) > DAMPED_ABOVE;
    let common = mechanism.take_common_damping();
    if let Some(viscous) = design.names.iter().position(|name| *name == "viscous") {
        theta[viscous] += common;
    }
    let mut model = parametric.model(theta.as_slice(), covariance, Some(predicted), held_out_rms);
    model.mechanism = Some(mechanism);
    if damped {
        model.withdraw_friction();
    }
    if let Taken::TooMuch(share) = taken {
        model.withdraw_inertia(share);
    }
    Ok((model, together))
}

/// Without damping the error is so many times as large where there is some.
const DAMPED_BELOW: f64 = 1.01;
/// Valves must do so much better on held-out strokes than surfaces.
const VALVED_BELOW: f64 = 0.97;
/// Valves that do so much better than surfaces of three smoothings of the load are taken to do better than those of any.
const FAR_BELOW: f64 = 0.6;
/// Valves are tried when the damping is at least this share of the effort,
const DAMPED_ABOVE: f64 = 0.05;
/// and this share of what is left: edges and valves of less are not seen.
const SEEN_ABOVE: f64 = 0.2;

/// A shorter lag, s, is left in: the shapes of mechanism and friction move the estimate by as much.
const LEAST_LAG_S: f64 = 5e-4;

/// Finds the lag of the effort behind the motion and takes it out: scan, shift, and again until it stays (see
/// [`crate::lag`]). A lag below half a millisecond or three standard deviations is reported and left in.
///
/// # Errors
/// [`DynamicsError`].
pub fn align(
    samples: &JointSamples,
    settings: &MotionSettings,
    effects: &[&dyn Effect],
) -> Result<(JointSamples, Motion, Option<Lag>), DynamicsError> {
    let unmoved = Motion::prepare(samples, settings)?;
    let Some(mut lag) = lag_with_mechanism(&unmoved, effects)? else {
        return Ok((samples.clone(), unmoved, None));
    };
    let is_left_in = |lag: &Lag| lag.value_s.abs() < LEAST_LAG_S.max(3.0 * lag.std_s);
    let mut moved = None;
    for _ in 0..6 {
        if is_left_in(&lag) {
            break;
        }
        let shifted = samples.with_effort_earlier(lag.value_s);
        let motion = Motion::prepare(&shifted, settings)?;
        let Some(rest) = lag_with_mechanism(&motion, effects)? else {
            break;
        };
        moved = Some((shifted, motion));
        lag = Lag {
            value_s: lag.value_s + rest.value_s,
            std_s: rest.std_s,
            applied: true,
        };
        if lag.value_s.abs() > FAR_S {
            return Ok((samples.clone(), unmoved, None));
        }
        if rest.value_s.abs() < 2e-4 {
            break;
        }
    }
    if moved.is_some() {
        lag.value_s = profiled(samples, settings, effects, lag.value_s)?;
        if is_left_in(&lag) {
            lag.applied = false;
            return Ok((samples.clone(), unmoved, Some(lag)));
        }
        let shifted = samples.with_effort_earlier(lag.value_s);
        let motion = Motion::prepare(&shifted, settings)?;
        moved = Some((shifted, motion));
    }
    let (samples, motion) = moved.unwrap_or_else(|| (samples.clone(), unmoved));
    Ok((samples, motion, Some(lag)))
}

/// The lag near `start` at which the whole fit, its damping chosen anew, leaves least: a mechanism chosen at a wrong lag
/// holds the scan there.
fn profiled(
    samples: &JointSamples,
    settings: &MotionSettings,
    effects: &[&dyn Effect],
    start: f64,
) -> Result<f64, DynamicsError> {
    let design = |lag: f64| -> Result<Design, DynamicsError> {
        let motion = Motion::prepare(&samples.with_effort_earlier(lag), settings)?;
        Design::new(&motion, effects, Some(&SplineMechanism::over(&motion)))
    };
    let there = design(start)?;
    let (smoothing, _) = there.choose_smoothing(&there.fold_normals());
    let cost = |lag: f64| -> Result<f64, DynamicsError> { Ok(design(lag)?.cost(&smoothing)) };
    let (mut centre, step) = (start, 2e-3);
    let mut middle = cost(centre)?;
    for _ in 0..6 {
        let (before, after) = (cost(centre - step)?, cost(centre + step)?);
        if before < middle || after < middle {
            (centre, middle) = if before < after {
                (centre - step, before)
            } else {
                (centre + step, after)
            };
            continue;
        }
        let curvature = before - 2.0 * middle + after;
        return Ok(if curvature > 0.0 {
            centre + 0.5 * step * (before - after) / curvature
        } else {
            centre
        });
    }
    Ok(centre)
}

fn lag_with_mechanism(
    motion: &Motion,
    effects: &[&dyn Effect],
) -> Result<Option<Lag>, DynamicsError> {
    let mechanism = SplineMechanism::over(motion);
    let design = Design::new(motion, effects, Some(&mechanism))?;
    let (smoothing, _) = design.choose_smoothing(&design.fold_normals());
    let solution = design.solve(&smoothing);
    let (y, h) = design.free_part(&solution, &smoothing);
    Ok(lag::scan(motion, &y, &h)?)
}

impl Design {
    fn parametric(&self) -> Result<EffortModel, DynamicsError> {
        let fit = bounded_least_squares(&self.y, &self.tau, &self.bounds, 1e-6)?;
        let held_out_rms = self.held_out(&[0.0, 0.0]);
        Ok(self.model(fit.theta.as_slice(), fit.covariance, None, held_out_rms))
    }

    fn model(
        &self,
        theta: &[f64],
        covariance: DMatrix<f64>,
        predicted: Option<DVector<f64>>,
        held_out_rms: f64,
    ) -> EffortModel {
        let theta = DVector::from_row_slice(theta);
        let predicted = predicted.unwrap_or_else(|| &self.y * &theta);
        let residual = &self.tau - &predicted;
        let (rank, condition) = self.rank_and_condition();
        let effort_rms = rms(self.tau.as_slice());
        let rigid = ["inertia", "coulomb", "viscous"];
        let of_rigid = self.names.iter().zip(theta.iter());
        let mut of_rigid = of_rigid.filter(|(name, _)| rigid.contains(name));
        // On one way there and none back a load does for all of them, and the effort works all the same.
        let viscous = self.names.iter().position(|name| *name == "viscous");
        let takes_power = viscous.is_none_or(|j| self.right[j] < 0.0);
        let is_driven = effort_rms > 0.0 && takes_power && of_rigid.all(|(_, value)| *value == 0.0);
        let mut terms = Vec::new();
        let mut not_identified = BTreeMap::new();
        for (j, name) in self.names.iter().enumerate() {
            let std = covariance[(j, j)].max(0.0).sqrt();
            let shown = Evidence {
                value: theta[j],
                std,
                regressor: rms(self.y.column(j).as_slice()),
                effort: effort_rms,
                is_driven,
            };
            let reason = shown.missing(name, &self.units[j]);
            let known = reason.is_none();
            terms.push(Term {
                name: (*name).to_owned(),
                value: known.then_some(theta[j]),
                std: known.then_some(std),
                unit: self.units[j].clone(),
            });
            if let Some(reason) = reason {
                not_identified.insert((*name).to_owned(), reason);
            }
        }
        EffortModel {
            terms,
            theta,
            covariance,
            rank,
            condition,
            mechanism: None,
            bias_drift: 0.0,
            rms: rms(residual.as_slice()),
            relative_error: residual.norm() / self.tau.norm().max(f64::MIN_POSITIVE),
            held_out_rms,
            effective_samples: effective_count(residual.as_slice()),
            predicted: predicted.as_slice().to_vec(),
            residual: residual.as_slice().to_vec(),
            not_identified,
        }
    }
}

impl EffortModel {
    /// Adds what a relative standard deviation `lever` of the lever does to inertia and friction: the effort is the force times
    /// the lever, and the share `by_path` of the angle a path over it.
    pub fn widen_for_lever(&mut self, lever: f64, by_path: f64) {
        for (i, term) in self.terms.iter_mut().enumerate() {
            let extra = lever_power(&term.name, by_path) * lever * self.theta[i];
            self.covariance[(i, i)] += extra * extra;
            term.std = term.std.map(|std| std.hypot(extra));
        }
    }

    /// Adds a standard deviation to that of inertia: what is not known of the tool's own.
    pub fn widen_inertia(&mut self, std: f64) {
        if let Some(i) = self.terms.iter().position(|term| term.name == "inertia") {
            self.covariance[(i, i)] += std * std;
            let term = &mut self.terms[i];
            term.std = term.std.map(|own| own.hypot(std));
        }
    }

    /// Takes back an inertia of which the tracker's noise takes the share given.
    fn withdraw_inertia(&mut self, share: f64) {
        let inertia = |term: &&mut Term| term.name == "inertia";
        if let Some(term) = self.terms.iter_mut().find(inertia) {
            (term.value, term.std) = (None, None);
            let reason = format!(
                "the noise of the poses is {:.0} % of the acceleration's square, which hides that much of it; shake harder, or see to it \
                 that the tracker is less noisy",
                100.0 * share
            );
            self.not_identified.insert("inertia".to_owned(), reason);
        }
    }

    /// Takes back friction where the motion goes over few places both ways: along one way it is a load.
    pub fn withdraw_friction_of_one_way(&mut self, motion: &Motion) {
        if !motion.goes_one_way() {
            return;
        }
        let share = motion.both_ways();
        for term in &mut self.terms {
            if !["coulomb", "viscous"].contains(&term.name.as_str()) || term.value.is_none() {
                continue;
            }
            (term.value, term.std) = (None, None);
            let reason = format!(
                "the motion goes both ways over {:.0} % of its range only, and one way friction cannot be told from a load; move there and back over the same places",
                100.0 * share
            );
            self.not_identified.insert(term.name.clone(), reason);
        }
    }

    /// Takes back friction that a damping mechanism may stand in for: at its bound, or known to no better than a fifth.
    fn withdraw_friction(&mut self) {
        for term in &mut self.terms {
            let (Some(value), Some(std)) = (term.value, term.std) else {
                continue;
            };
            if !["coulomb", "viscous"].contains(&term.name.as_str()) || std < 0.2 * value {
                continue;
            }
            let reason = format!(
                "the mechanism's damping can stand in for it ({} {}); add slow and fast strokes where the mechanism does not damp",
                with_std(value, std),
                term.unit
            );
            (term.value, term.std) = (None, None);
            self.not_identified.insert(term.name.clone(), reason);
        }
    }
}

impl JointFit {
    /// As [`EffortModel::widen_inertia`].
    pub fn widen_inertia(&mut self, std: f64) {
        for term in self.terms.iter_mut().filter(|term| term.name == "inertia") {
            term.std = term.std.map(|own| own.hypot(std));
        }
    }

    /// As [`EffortModel::widen_for_lever`].
    pub fn widen_for_lever(&mut self, lever: f64, by_path: f64) {
        for term in &mut self.terms {
            let extra = lever_power(&term.name, by_path) * lever * term.value.unwrap_or(0.0);
            term.std = term.std.map(|std| std.hypot(extra));
        }
    }
}

/// Power of the lever in a parameter, where it makes so much of the angle.
fn lever_power(name: &str, by_path: f64) -> f64 {
    match name {
        "inertia" | "viscous" => 1.0 + by_path,
        "coulomb" => 1.0,
        _ => 0.0,
    }
}

/// What the data say about one parameter.
struct Evidence {
    value: f64,
    std: f64,
    /// Root mean square of the regressor.
    regressor: f64,
    /// Root mean square of the measured effort.
    effort: f64,
    /// Whether inertia and friction are all at their bound, as if the effort drove the motion backwards.
    is_driven: bool,
}

impl Evidence {
    /// A sentence when the parameter is not identified: its uncertainty is over a third of its value and moves the effort
    /// by more than a twentieth (for inertia, which is never zero: over a third of its value is enough).
    fn missing(&self, name: &str, unit: &str) -> Option<String> {
        // No part is without inertia, and no effort shows nothing: zero there is a bound, not an estimate.
        let bound = self.value == 0.0 && (name == "inertia" || self.effort == 0.0);
        let uncertain = bound || !self.std.is_finite() || self.std > 0.35 * self.value.abs();
        let matters = self.std * self.regressor > 0.05 * self.effort || !self.std.is_finite();
        let todo = match name {
            _ if self.is_driven => {
                "all of I, mu, b would be negative: is the sign of the effort turned round? Positive effort opens"
            }
            "inertia" => "add fast strokes with sharp starts and stops",
            "coulomb" => "add slow strokes in both directions",
            "viscous" => "add strokes at different steady speeds",
            _ => "excite it more strongly or record longer",
        };
        (uncertain && (matters || bound || name == "inertia")).then(|| {
            format!(
                "the motion does not show it apart from the rest ({} {unit}); {todo}",
                with_std(self.value, self.std)
            )
        })
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
pub(crate) use tests::{drawn, probing};
