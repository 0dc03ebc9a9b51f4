//! Efforts as the current model would give them on this motion, with the sensors' noise, through the same pipeline: what a
//! search finds in these is found by chance.
//!
//! The motion is taken as true, the model's effort computed on it, noise of the wrench added, and then a noisy motion is
//! prepared from it and the model's columns computed anew. So the error of differentiated positions, of signs near
//! reversals and of everything that depends on them is in it.

use super::model::{Found, Ground};
use crate::effect::RigidBody;
use crate::least_squares::rms;
use crate::motion::{Motion, MotionError, MotionSettings};
use crate::noise::NoiseFloor;
use crate::parallel::in_parallel;
use crate::products::{combine, residual};
use crate::random::Random;
use crate::samples::{Aside, JointSamples};

/// At most so many times the level of the estimated noise is the null raised, towards what the model leaves.
const MOST_RAISED: f64 = 1.6;

/// `count` efforts at the fit's samples as a model (of base and `effects`: its terms, and the rms that is left beside it) would
/// give them, and the rms of their errors before it is raised.
pub(super) fn replicates(
    ground: &Ground,
    effects: &[Found],
    (theta, left): (&[f64], f64),
    floor: &NoiseFloor,
    settings: &MotionSettings,
    count: usize,
) -> Result<(Vec<Vec<f64>>, f64), MotionError> {
    let fitted = combine(&ground.all_columns(effects)?, theta);
    let raw = raw_effort(&ground.motion, effects, theta);
    let seeds: Vec<u64> = (0..count as u64).collect();
    let noise = &ground.motion.noise_of_q;
    let model = (effects, theta, raw.as_slice());
    let errors: Vec<Option<Vec<f64>>> = in_parallel(&seeds, |seed| {
        error_of(ground, model, (floor, noise), settings, *seed).ok()
    });
    let errors: Vec<Vec<f64>> = errors.into_iter().flatten().collect();
    let squares: f64 = errors.iter().map(|error| rms(error).powi(2)).sum();
    let usual = (squares / errors.len().max(1) as f64).sqrt();
    let raised = (left / usual.max(1e-12)).clamp(1.0, MOST_RAISED);
    let efforts = errors
        .iter()
        .map(|error| {
            let both = fitted.iter().zip(error);
            both.map(|(f, e)| f + raised * e).collect()
        })
        .collect();
    Ok((efforts, usual))
}

/// The model's effort on the smoothed motion, unfiltered. It turns where its own velocity does.
fn raw_effort(motion: &Motion, effects: &[Found], theta: &[f64]) -> Vec<f64> {
    let states = [&motion.q, &motion.dq, &motion.ddq].map(Clone::clone);
    let motion = &motion.with_states(states);
    let mut series = vec![motion.ddq.clone(), motion.sign.clone(), motion.dq.clone()];
    for effect in effects {
        series.extend(effect.series(motion));
    }
    combine(&series, theta)
}

/// What a model needs at each sample without inertia, unfiltered.
pub(super) fn slow_effort(motion: &Motion, effects: &[Found], theta: &[f64]) -> Vec<f64> {
    let mut series = vec![motion.sign.clone(), motion.dq.clone()];
    for effect in effects {
        series.extend(effect.series(motion));
    }
    combine(&series, theta.get(1..).unwrap_or(&[]))
}

fn error_of(
    ground: &Ground,
    (effects, theta, raw): (&[Found], &[f64], &[f64]),
    (floor, series): (&NoiseFloor, &[Vec<f64>]),
    settings: &MotionSettings,
    seed: u64,
) -> Result<Vec<f64>, MotionError> {
    let motion = &ground.motion;
    let mut random = Random::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5DEE_CE66_D1CE_4E5B);
    let white: Vec<f64> = (0..raw.len()).map(|_| random.normal()).collect();
    let level = floor.wrench_rms / rms(&motion.regressor(&white)?).max(1e-12);
    let noise = position_noise(motion, theta, (floor, series), &mut random)?;
    // What was taken off for the tool has the noise of the poses.
    let tool = motion.second_derivative(&noise);
    let tool = tool.iter().map(|a| motion.tool_inertia * a);
    let noisy = JointSamples {
        kind: motion.kind,
        period: motion.period,
        runs: motion.runs.clone(),
        time: motion.time.clone(),
        q: motion.q.iter().zip(&noise).map(|(q, n)| q + n).collect(),
        tau: raw
            .iter()
            .zip(&white)
            .zip(tool)
            .map(|((t, w), own)| t + level * w - own)
            .collect(),
        noise_of_q: if series.is_empty() {
            Vec::new()
        } else {
            vec![noise.clone()]
        },
        aside: Aside {
            across: motion.across.clone(),
            ..Aside::default()
        },
    };
    left_by(&motion.prepare_alike(&noisy, settings)?, effects, theta)
}

/// What a model leaves of a motion's effort at the fit's samples; the filter is linear, so once is enough.
fn left_by(motion: &Motion, effects: &[Found], theta: &[f64]) -> Result<Vec<f64>, MotionError> {
    let mut series = RigidBody::measured(motion).to_vec();
    for effect in effects {
        series.extend(effect.series(motion));
    }
    motion.regressor(&residual(&motion.tau, &series, theta))
}

/// A series like the position sensor's noise: its own series, moved in time and mixed; white when there are none.
fn position_noise(
    motion: &Motion,
    theta: &[f64],
    (floor, series): (&NoiseFloor, &[Vec<f64>]),
    random: &mut Random,
) -> Result<Vec<f64>, MotionError> {
    let n = motion.q.len();
    if series.is_empty() {
        let white: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let (velocity, acceleration) =
            (motion.derivative(&white), motion.second_derivative(&white));
        let effort: Vec<f64> = (0..n)
            .map(|i| (theta[0] + motion.tool_inertia) * acceleration[i] + theta[2] * velocity[i])
            .collect();
        let unit = rms(&motion.regressor(&effort)?);
        let level = if unit > 0.0 {
            floor.position_rms / unit
        } else {
            0.0
        };
        return Ok(white.into_iter().map(|w| w * level).collect());
    }
    let weights: Vec<f64> = series.iter().map(|_| random.normal()).collect();
    let length = weights.iter().map(|w| w * w).sum::<f64>().sqrt().max(1e-9);
    let mut out = vec![0.0; n];
    for (series, weight) in series.iter().zip(&weights) {
        let mean = series.iter().sum::<f64>() / series.len().max(1) as f64;
        let shift = (random.unit() * n as f64) as usize;
        for (i, out) in out.iter_mut().enumerate() {
            *out += weight / length * (series[mirrored(i + shift, series.len())] - mean);
        }
    }
    Ok(out)
}

/// The place `at` of a series of `count` that goes on forth and back: from its end to its beginning a wandering series would jump.
fn mirrored(at: usize, count: usize) -> usize {
    let at = at % (2 * count);
    at.min(2 * count - 1 - at)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::dynamics::drawn;
    use crate::effect::axis::AXIS_OFFSET;

    /// What an axis does that moves is in the simulated recordings as it is in the model.
    #[test]
    fn forces_across_the_joint_are_in_what_is_simulated() {
        let mut samples = drawn();
        let force = |w: f64| samples.time.iter().map(|t| 20.0 * (w * t).sin()).collect();
        samples.aside.across = vec![force(0.7), force(1.9)];
        let settings = MotionSettings::default();
        let ground = Ground::of(Motion::prepare(&samples, &settings).unwrap()).unwrap();
        let floor = NoiseFloor {
            rms: 0.1,
            wrench_rms: 0.1,
            position_rms: 0.0,
        };
        let left = |effects: &[Found], theta: &[f64]| {
            replicates(&ground, effects, (theta, 0.1), &floor, &settings, 4)
                .unwrap()
                .1
        };
        let moved = Found {
            kind: &AXIS_OFFSET,
            shape: vec![0.0, 1.2],
            used: vec![true, true],
            object: Arc::default(),
            datum: 0.0,
        };
        let without = left(&[], &[2.5, 1.2, 0.8]);
        let with = left(&[moved], &[2.5, 1.2, 0.8, 0.03, -0.02]);
        assert!(with < 1.1 * without, "{with} with, {without} without");
    }
}
