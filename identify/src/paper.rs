//! The paper's own estimator, to stand beside ours: a smoothed joint coordinate, differentiated; gates; non-negative least
//! squares for mu, b, I; then a network on what they leave ([`network`]).
//!
//! The paper does not name its smoother nor the thresholds of its gates. Here the smoother is a local cubic (Savitzky and
//! Golay) over [`PaperSettings::window_s`], which the effort does not go through; that difference between effort and
//! acceleration is what biases the inertia. Gates: the outermost 2 % of the range, speeds below 2 % of the fast strokes', and
//! accelerations beyond three times what 99 % of the samples reach.
//!
//! # Source
//! Engelbracht et al., *ForceTwin*, sections "Dynamics Identification" and "Residual Fitting".

pub mod network;

use nalgebra::{DMatrix, DVector};

use crate::dynamics::Term;
use crate::least_squares::{Bound, FitError, bounded_least_squares, rms};
use crate::mechanism::Mechanism;
use crate::samples::{JointSamples, quantile};
use network::{MlpMechanism, Training, train};

/// How the paper's estimator is run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaperSettings {
    /// Length of the smoother, s.
    pub window_s: f64,
    /// Rate at which samples are used, Hz; the nearest whole fraction of the recording's own.
    pub rate_hz: f64,
    /// How the network is trained; nothing to leave it out.
    pub training: Option<Training>,
}

impl Default for PaperSettings {
    /// 155 ms, 100 samples a second, the paper's training.
    fn default() -> Self {
        Self {
            window_s: 0.155,
            rate_hz: 100.0,
            training: Some(Training::default()),
        }
    }
}

/// What the paper's estimator gives.
#[derive(Clone, Debug)]
pub struct PaperFit {
    /// Inertia, Coulomb and viscous friction, in the order and units of ours.
    pub terms: Vec<Term>,
    /// Samples that passed the gates.
    pub samples: usize,
    /// Root mean square of what mu, b, I leave, N m or N.
    pub rms: f64,
    /// The same with the network.
    pub mechanism_rms: Option<f64>,
    /// The network.
    pub mechanism: Option<MlpMechanism>,
}

/// Runs the paper's estimator.
///
/// # Errors
/// [`FitError`]: too few samples pass the gates, or the motion does not show all three parameters.
pub fn identify(samples: &JointSamples, settings: &PaperSettings) -> Result<PaperFit, FitError> {
    let motion = gated(samples, settings);
    let count = motion.len();
    let regressor = DMatrix::from_fn(count, 3, |i, j| match j {
        0 => motion[i].ddq,
        1 => motion[i].dq.signum(),
        _ => motion[i].dq,
    });
    let tau = DVector::from_fn(count, |i, _| motion[i].tau);
    let fit = bounded_least_squares(&regressor, &tau, &[Bound::NonNegative; 3], 1e-9)?;
    let kind = samples.kind;
    let units = [
        ("inertia", kind.inertia_unit()),
        ("coulomb", kind.effort_unit()),
        ("viscous", kind.viscous_unit()),
    ];
    let terms = units.iter().enumerate().map(|(j, (name, unit))| Term {
        name: (*name).to_owned(),
        value: Some(fit.theta[j]),
        std: Some(fit.std(j)),
        unit: (*unit).to_owned(),
    });
    let residual = fit.residual.as_slice();
    let mechanism = settings.training.as_ref().map(|training| {
        let states: Vec<[f64; 2]> = motion.iter().map(|m| [m.q, m.dq]).collect();
        train(&states, residual, training)
    });
    let left = mechanism.as_ref().map(|mechanism| {
        let rest: Vec<f64> = motion
            .iter()
            .zip(residual)
            .map(|(m, r)| r - mechanism.effort(m.q, m.dq))
            .collect();
        rms(&rest)
    });
    Ok(PaperFit {
        terms: terms.collect(),
        samples: count,
        rms: rms(residual),
        mechanism_rms: left,
        mechanism,
    })
}

/// A sample that passed the gates.
#[derive(Clone, Copy)]
struct State {
    q: f64,
    dq: f64,
    ddq: f64,
    tau: f64,
}

fn gated(samples: &JointSamples, settings: &PaperSettings) -> Vec<State> {
    let half = (0.5 * settings.window_s / samples.period).round().max(2.0) as usize;
    let step = (samples.rate_hz() / settings.rate_hz).round().max(1.0) as usize;
    let weights = smoother(half, samples.period);
    let mut all = Vec::new();
    for run in &samples.runs {
        for i in (run.start + half..run.end.saturating_sub(half)).step_by(step) {
            let window = &samples.q[i - half..=i + half];
            let value = |w: &[f64]| w.iter().zip(window).map(|(a, b)| a * b).sum::<f64>();
            all.push(State {
                q: value(&weights[0]),
                dq: value(&weights[1]),
                ddq: value(&weights[2]),
                tau: samples.tau[i],
            });
        }
    }
    let of = |f: fn(&State) -> f64| all.iter().map(f).collect::<Vec<f64>>();
    let (low, high) = samples.q_range();
    let edge = 0.02 * (high - low);
    let slow = 0.02 * quantile(&of(|s| s.dq.abs()), 0.95);
    let implausible = 3.0 * quantile(&of(|s| s.ddq.abs()), 0.99);
    all.retain(|s| {
        s.q > low + edge && s.q < high - edge && s.dq.abs() > slow && s.ddq.abs() < implausible
    });
    all
}

/// Weights that give value, first and second derivative of the cubic through `2 half + 1` samples in the middle.
fn smoother(half: usize, period: f64) -> [Vec<f64>; 3] {
    let count = 2 * half + 1;
    let at = |i: usize| (i as f64 - half as f64) / half as f64;
    let powers = DMatrix::from_fn(count, 4, |i, j| at(i).powi(j as i32));
    let inverse = powers
        .clone()
        .pseudo_inverse(1e-12)
        .unwrap_or_else(|_| DMatrix::zeros(4, count));
    let unit = half as f64 * period;
    [(0, 1.0), (1, 1.0 / unit), (2, 2.0 / (unit * unit))]
        .map(|(row, scale)| inverse.row(row).iter().map(|w| w * scale).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::probing;
    use crate::screw::JointKind;

    fn samples(effort: impl Fn([f64; 3]) -> f64) -> JointSamples {
        let time: Vec<f64> = (0..8000).map(|i| 0.005 * f64::from(i)).collect();
        let states: Vec<[f64; 3]> = time.iter().map(|t| probing(*t, 1.0)).collect();
        JointSamples {
            kind: JointKind::Revolute,
            period: 0.005,
            runs: vec![0..8000],
            q: states.iter().map(|s| s[0]).collect(),
            tau: states.into_iter().map(effort).collect(),
            time,
            noise_of_q: Vec::new(),
            aside: crate::samples::Aside::default(),
        }
    }

    #[test]
    fn the_smoother_differentiates_a_cubic_exactly() {
        let weights = smoother(7, 0.01);
        let cubic = |t: f64| 1.0 + 2.0 * t - 3.0 * t * t + 4.0 * t * t * t;
        for (weights, expected) in weights.iter().zip([1.0, 2.0, -6.0]) {
            let value: f64 = weights
                .iter()
                .enumerate()
                .map(|(i, w)| w * cubic(0.01 * (i as f64 - 7.0)))
                .sum();
            assert!((value - expected).abs() < 1e-8, "{value} {expected}");
        }
    }

    #[test]
    fn a_long_window_makes_the_object_look_heavier_and_a_short_one_does_not() {
        let plain = samples(|[_, dq, ddq]| 2.0 * ddq + 1.2 * dq.signum() + 0.8 * dq);
        let inertia = |window_s: f64| {
            let settings = PaperSettings {
                window_s,
                training: None,
                ..PaperSettings::default()
            };
            identify(&plain, &settings).unwrap().terms[0].value.unwrap()
        };
        let (short, long) = (inertia(0.05), inertia(0.255));
        assert!((short / 2.0 - 1.0).abs() < 0.02, "{short}");
        assert!(long > 1.02 * short, "{long} {short}");
    }

    #[test]
    fn too_little_motion_is_refused() {
        let mut still = samples(|_| 0.0);
        still.runs = vec![0..40];
        let refused = identify(&still, &PaperSettings::default());
        assert!(
            matches!(refused, Err(FitError::TooFewSamples { .. })),
            "{refused:?}"
        );
    }
}
