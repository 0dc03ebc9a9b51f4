//! From joint samples to the effort model with its errors and a verdict: the part that recordings and tables share.

use std::collections::BTreeMap;

use crate::dynamics::{
    DynamicsError, EffortModel, Structure, align, fit_base, fit_with_mechanism, structure,
};
use crate::effect::RigidBody;
use crate::lag::Lag;
use crate::least_squares::rms;
use crate::motion::MotionSettings;
use crate::noise::{self, NoiseFloor};
use crate::samples::JointSamples;
use crate::screw::JointKind;

/// What the final model leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The held-out residual is at the noise floor.
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
    /// The full model.
    pub full: EffortModel,
    /// Lag of the effort behind the motion.
    pub lag: Option<Lag>,
    /// What a complete model would leave.
    pub floor: NoiseFloor,
    /// Against what the full model's residual stands, strongest first.
    pub structure: Vec<Structure>,
    /// The verdict.
    pub verdict: Verdict,
    /// What is neither modelled nor noise, as a share of the effort (amplitudes): sqrt(held_out^2 - floor^2) / rms(tau).
    pub unexplained_fraction: f64,
    /// Samples that the fits used.
    pub used: usize,
    /// Samples taken out, by gate.
    pub gated: BTreeMap<&'static str, usize>,
    /// The whole motion for the plot of the probing: time, q, dq at about 50 Hz.
    pub probing: FitSeries,
    /// What the fits saw.
    pub series: FitSeries,
}

/// Above so many times the floor a held-out residual counts as unexplained.
pub const EXPLAINED_BELOW: f64 = 1.25;

/// Fits the base and the full model.
///
/// # Errors
/// [`DynamicsError`].
pub fn analyse(
    samples: &JointSamples,
    settings: &MotionSettings,
) -> Result<Analysis, DynamicsError> {
    let (samples, motion, lag) = align(samples, settings, &[&RigidBody])?;
    let base = fit_base(&motion)?;
    let full = fit_with_mechanism(&motion, &[&RigidBody])?;
    let floor = noise::floor(&samples, &motion, &full)?;
    let tau = motion.regressor(&motion.tau)?;
    let (verdict, unexplained_fraction) = judge(&full, floor.rms, rms(&tau));
    let (low, high) = samples.q_range();
    let at =
        |series: &[f64], step: usize| series.iter().step_by(step).copied().collect::<Vec<f64>>();
    let step = ((0.02 / motion.period) as usize).max(1);
    Ok(Analysis {
        kind: samples.kind,
        q_range: [low, high],
        structure: structure(&motion, &full.residual, full.effective_samples),
        lag,
        verdict,
        unexplained_fraction,
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
        full,
        floor,
    })
}

/// Verdict and unexplained share of a model.
#[must_use]
pub fn judge(model: &EffortModel, floor: f64, effort_rms: f64) -> (Verdict, f64) {
    let over = (model.held_out_rms.powi(2) - floor.powi(2)).max(0.0).sqrt();
    let verdict = if model.terms.iter().all(|term| term.value.is_none()) {
        Verdict::NotIdentifiable
    } else if model.held_out_rms <= EXPLAINED_BELOW * floor {
        Verdict::Explained
    } else {
        Verdict::Unexplained
    };
    (verdict, over / effort_rms.max(f64::MIN_POSITIVE))
}
