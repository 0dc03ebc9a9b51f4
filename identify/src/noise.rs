//! What a complete model would leave: the sensors' noise through the pipeline's filters.
//!
//! - Wrench: the effort above 30 Hz (or the upper half of the band) is taken as noise and as white, and carried through
//!   the filter.
//! - Position: the residuals across the motion have the tracker's noise and nothing else; they go through the same
//!   derivatives and the same filter and are weighed with the inertia, the viscous friction and the slope of the load.
//!   For hinges also as relative error of the lever. Where there are none (tables), the position's own content in the upper half of its band, taken as white.
//!
//! Not covered: slow drift of the force sensor, and anything that both streams share.

use crate::dynamics::EffortModel;
use crate::effect::slip::jumps;
use crate::filter::{LowPass, first_derivative, second_derivative};
use crate::least_squares::rms;
use crate::motion::{Motion, MotionError};
use crate::samples::{JointSamples, quantile};
use crate::screw::JointKind;

/// Root mean square noise of the effort at the fit's samples, in the unit of the effort.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct NoiseFloor {
    /// Both parts together.
    pub rms: f64,
    /// From the wrench.
    pub wrench_rms: f64,
    /// From the position, through inertia, friction and load.
    pub position_rms: f64,
}

/// Estimates the floor of `model` on `motion`, which was prepared from `samples`; `slope` = what the model's effects grow by per
/// unit of the coordinate, at each sample of the motion, none when there are none.
///
/// # Errors
/// When the motion cannot be filtered.
pub fn floor(
    samples: &JointSamples,
    motion: &Motion,
    model: &EffortModel,
    slope: &[f64],
) -> Result<NoiseFloor, MotionError> {
    let white = |std: f64, weight: &dyn Fn(f64) -> f64| {
        std * (2.0 * samples.period * band_integral(motion, weight)).sqrt()
    };
    let wrench_rms = white(white_noise(samples, &samples.tau, 30.0)?, &|_| 1.0);
    let theta = |name: &str| {
        model
            .terms
            .iter()
            .position(|term| term.name == name)
            .map_or(0.0, |j| model.theta[j])
    };
    let (inertia, viscous) = (theta("inertia"), theta("viscous"));
    let slope = load_slope(motion, model, slope);
    let position_rms = if motion.noise_of_q.is_empty() {
        let usual = quantile(&slope.iter().map(|s| s.abs()).collect::<Vec<_>>(), 0.5);
        let q_white = white_noise(samples, &samples.q, 0.25 * samples.rate_hz())?;
        let through = |hz: f64| {
            let w = core::f64::consts::TAU * hz;
            (inertia * w * w - usual).powi(2) + (viscous * w).powi(2)
        };
        white(q_white, &through)
    } else {
        let slid = jumps(motion);
        let mut squares = 0.0;
        for series in &motion.noise_of_q {
            let away = level(motion, &slid, series);
            let (velocity, acceleration) =
                (motion.derivative(series), motion.second_derivative(series));
            let effort: Vec<f64> = (0..series.len())
                .map(|i| inertia * acceleration[i] + viscous * velocity[i] + slope[i] * away[i])
                .collect();
            squares += usual_square(motion, &effort)? / motion.noise_of_q.len() as f64;
        }
        squares.sqrt()
    };
    let position_rms = position_rms.hypot(lever_rms(motion)?);
    Ok(NoiseFloor {
        rms: wrench_rms.hypot(position_rms),
        wrench_rms,
        position_rms,
    })
}

/// Mean square at the fit's samples of what noise makes, away from where the pads slid on the handle: that is no noise. A stretch
/// counts as such when the pose across the path jumps there, or when it has many times what is usual.
fn usual_square(motion: &Motion, effort: &[f64]) -> Result<f64, MotionError> {
    let slid = jumps(motion);
    let values = motion.regressor_of_all(effort)?;
    let mut stretches: std::collections::BTreeMap<i64, (f64, usize)> =
        std::collections::BTreeMap::new();
    for (&i, value) in motion.kept.iter().zip(values) {
        let at = motion.time[i];
        if slid.iter().all(|jump| (at - jump).abs() > SLIDES_S) {
            let stretch = stretches.entry((at / STRETCH_S) as i64).or_default();
            *stretch = (stretch.0 + value * value, stretch.1 + 1);
        }
    }
    let each: Vec<f64> = stretches
        .values()
        .map(|(sum, count)| sum / *count as f64)
        .collect();
    let usual = quantile(&each, 0.5);
    // Poses that stand still for half of the time say nothing of what is usual.
    let most = if usual > 0.0 {
        UNUSUAL * usual
    } else {
        f64::INFINITY
    };
    let usual = stretches
        .values()
        .filter(|(sum, count)| sum / *count as f64 <= most);
    let (sum, count) = usual.fold((0.0, 0), |all, one| (all.0 + one.0, all.1 + one.1));
    Ok(sum / f64::from(u32::try_from(count.max(1)).unwrap_or(u32::MAX)))
}

/// Stretches over which noise is compared, s, and the share of the median square beyond which one is no noise.
const STRETCH_S: f64 = 1.0;
const UNUSUAL: f64 = 12.0;

/// Time about a slip within which the pose across the path is no noise, s.
const SLIDES_S: f64 = 0.4;

/// A hinge's effort is a force times a lever, and the lever is read off the same positions.
fn lever_rms(motion: &Motion) -> Result<f64, MotionError> {
    if motion.kind != JointKind::Revolute {
        return Ok(0.0);
    }
    let slid = jumps(motion);
    let mut squares = 0.0;
    for series in &motion.noise_of_q {
        let away = level(motion, &slid, series);
        let effort: Vec<f64> = away
            .iter()
            .zip(&motion.tau)
            .map(|(n, tau)| n * tau)
            .collect();
        squares += usual_square(motion, &effort)? / motion.noise_of_q.len() as f64;
    }
    Ok(squares.sqrt())
}

/// A series less its mean between the instants at which the pads slid on the handle: what they slid by is no noise.
fn level(motion: &Motion, slid: &[f64], series: &[f64]) -> Vec<f64> {
    let stretch = |i: usize| slid.iter().filter(|at| **at < motion.time[i]).count();
    let mut sums = vec![(0.0, 0_usize); slid.len() + 1];
    for (i, value) in series.iter().enumerate() {
        let sum = &mut sums[stretch(i)];
        *sum = (sum.0 + value, sum.1 + 1);
    }
    let mean = |i: usize| sums[stretch(i)].0 / sums[stretch(i)].1.max(1) as f64;
    let numbered = series.iter().enumerate();
    numbered.map(|(i, value)| value - mean(i)).collect()
}

/// Slope of the whole load at each sample: a position that is off by little reads another load. Slow errors of the position
/// count where the load is steep.
fn load_slope(motion: &Motion, model: &EffortModel, effects: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; motion.q.len()];
    if let Some(mechanism) = &model.mechanism {
        let step = 1e-3 * (mechanism.domain.q[1] - mechanism.domain.q[0]).max(1e-9);
        for (out, q) in out.iter_mut().zip(&motion.q) {
            *out = (mechanism.load(q + step) - mechanism.load(q - step)) / (2.0 * step);
        }
    }
    for (out, slope) in out.iter_mut().zip(effects) {
        *out += slope;
    }
    out
}

/// Standard deviation of the white noise that fills the band above `from_hz`: the median over windows of a quarter second.
fn white_noise(samples: &JointSamples, series: &[f64], from_hz: f64) -> Result<f64, MotionError> {
    let rate = samples.rate_hz();
    let from = from_hz.min(0.25 * rate);
    let filter = LowPass::butterworth(4, from, rate)?;
    let mut variances = Vec::new();
    for run in samples
        .runs
        .iter()
        .filter(|run| run.len() as f64 * samples.period > 1.0)
    {
        let part = &series[run.clone()];
        let low = filter.zero_phase(part)?;
        let high: Vec<f64> = part.iter().zip(&low).map(|(a, b)| a - b).collect();
        let window = ((0.25 * rate) as usize).max(8);
        variances.extend(high.chunks(window).map(|chunk| rms(chunk).powi(2)));
    }
    let share = 1.0 - from / (rate / 2.0);
    Ok((quantile(&variances, 0.5) / share.max(0.1)).sqrt())
}

/// Integral of `weight` times the filter's power gain over frequency, Hz.
fn band_integral(motion: &Motion, weight: &dyn Fn(f64) -> f64) -> f64 {
    let half = 0.5 / motion.period;
    let steps = 2000;
    let width = half / f64::from(steps);
    (0..steps)
        .map(|k| (f64::from(k) + 0.5) * width)
        .map(|hz| weight(hz) * motion.power_gain(hz) * width)
        .sum()
}

/// Root mean square acceleration and velocity of a noise series below `cutoff_hz`, for weighing sensors by what they do to
/// the dynamics.
///
/// # Errors
/// When the series is too short.
pub fn acceleration_noise(
    series: &[f64],
    period: f64,
    cutoff_hz: f64,
) -> Result<[f64; 2], MotionError> {
    let rate = 1.0 / period;
    let filter = LowPass::butterworth(4, cutoff_hz.min(0.2 * rate), rate)?;
    let smooth = filter.zero_phase_settled(series)?;
    let middle = |x: Vec<f64>| {
        let edge = (x.len() / 20).min((rate * 0.5) as usize);
        rms(&x[edge..x.len() - edge])
    };
    Ok([
        middle(second_derivative(&smooth, period)),
        middle(first_derivative(&smooth, period)),
    ])
}
