//! What a complete model would leave: the sensors' noise through the pipeline's filters.
//!
//! - Wrench: away from turns, the effort above 30 Hz (or the upper half of the band) is taken as noise and as white. Simulated noise
//!   of that size goes through the rests and the filter.
//! - Position: the residuals across the motion have the tracker's noise and nothing else, but for what its rotations do; they go through the same
//!   derivatives, the same rests and the same filter and are weighed with the inertia, the tool's own among it, all damping where it
//!   is, and the slope of the load. For hinges also as relative error of the lever. Where there are none (tables), white noise does so,
//!   as large as the position's own content in the upper half of its band; at low sample rates that is motion, too, so that
//!   [`crate::samples::Aside::floor_at_most`] may bound the floor.
//!
//! Not covered: slow drift of the force sensor, anything that both streams share, and what processing adds (signs near reversals, smoothing twice).

use crate::diagnose::per_velocity;
use crate::dynamics::EffortModel;
use crate::effect::slip;
use crate::filter::{LowPass, second_derivative};
use crate::least_squares::rms;
use crate::mechanism::{Mechanism as _, SplineMechanism};
use crate::motion::{Motion, MotionError, Slip};
use crate::random::Random;
use crate::samples::{JointSamples, extrema, quantile};
use crate::screw::JointKind;
use nalgebra::{SMatrix, SVector};

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

impl NoiseFloor {
    /// With less of the position's part, and then of the wrench's, where both together are more than `most`.
    #[must_use]
    pub fn at_most(self, most: f64) -> Self {
        if self.rms <= most {
            return self;
        }
        let wrench_rms = self.wrench_rms.min(most);
        Self {
            rms: most,
            wrench_rms,
            position_rms: (most * most - wrench_rms * wrench_rms).sqrt(),
        }
    }
}

/// What an effort grows by at each sample of a motion, beside inertia and viscous friction.
#[derive(Clone, Debug)]
pub struct Slopes {
    /// Per unit of the acceleration.
    pub inertia: Vec<f64>,
    /// Per unit of the coordinate.
    pub load: Vec<f64>,
    /// Per unit of the velocity.
    pub damping: Vec<f64>,
}

impl Slopes {
    /// Of no effort.
    #[must_use]
    pub fn none(samples: usize) -> Self {
        Self {
            inertia: vec![0.0; samples],
            load: vec![0.0; samples],
            damping: vec![0.0; samples],
        }
    }

    fn add_mechanism(&mut self, motion: &Motion, mechanism: &SplineMechanism) {
        let step = 1e-3 * (mechanism.domain.q[1] - mechanism.domain.q[0]).max(1e-9);
        let fastest = motion
            .dq
            .iter()
            .fold(1e-9_f64, |most, dq| most.max(dq.abs()));
        for i in 0..motion.q.len() {
            let (q, dq) = (motion.q[i], motion.dq[i]);
            self.load[i] += (mechanism.load(q + step) - mechanism.load(q - step)) / (2.0 * step);
            self.damping[i] += per_velocity(dq, 2e-3 * fastest, |dq| mechanism.effort(q, dq));
        }
    }
}

/// Estimates the floor of `model` on `motion`, which was prepared from `samples`; `slopes` = those of the model's effects.
///
/// # Errors
/// When the motion cannot be filtered.
pub fn floor(
    samples: &JointSamples,
    motion: &Motion,
    model: &EffortModel,
    mut slopes: Slopes,
) -> Result<NoiseFloor, MotionError> {
    // Friction that turns jumps, and a jump is in every band.
    let band = White {
        from_hz: 30.0,
        stretch_s: 0.05,
        interpolated: samples.aside.interpolated[1],
    };
    let std = band.std(samples, &samples.tau, &turns(motion))?;
    let wrench_rms = of_all(motion, &white_series(motion, samples, std), <[f64]>::to_vec)?;
    let theta = |name: &str| {
        model
            .terms
            .iter()
            .position(|term| term.name == name)
            .map_or(0.0, |j| model.theta[j])
    };
    // The tool's own inertia was taken off by the same poses.
    let inertia = theta("inertia") + motion.tool_inertia;
    let viscous = theta("viscous");
    if let Some(mechanism) = &model.mechanism {
        slopes.add_mechanism(motion, mechanism);
    }
    let white;
    let noise = if motion.noise_of_q.is_empty() {
        let band = White {
            from_hz: 0.25 * samples.rate_hz(),
            stretch_s: 0.25,
            interpolated: samples.aside.interpolated[0],
        };
        white = white_series(motion, samples, band.std(samples, &samples.q, &[])?);
        &white
    } else {
        &motion.noise_of_q
    };
    let position_rms = of_all(motion, noise, |series| {
        let (velocity, acceleration) =
            (motion.derivative(series), motion.second_derivative(series));
        let effort = |i: usize| {
            let damping = viscous + slopes.damping[i];
            (inertia + slopes.inertia[i]) * acceleration[i]
                + damping * velocity[i]
                + slopes.load[i] * series[i]
        };
        (0..series.len()).map(effort).collect()
    })?;
    let position_rms = position_rms.hypot(lever_rms(motion)?);
    let floor = NoiseFloor {
        rms: wrench_rms.hypot(position_rms),
        wrench_rms,
        position_rms,
    };
    let most = samples.aside.floor_at_most;
    Ok(most.map_or(floor, |most| floor.at_most(most)))
}

/// What noise makes, of which there are several series: their root mean square at the fit's samples.
fn of_all(
    motion: &Motion,
    noise: &[Vec<f64>],
    effort: impl Fn(&[f64]) -> Vec<f64>,
) -> Result<f64, MotionError> {
    let mut squares = 0.0;
    for series in noise {
        squares += usual_square(motion, &effort(series))? / noise.len() as f64;
    }
    Ok(squares.sqrt())
}

/// Mean square at the fit's samples of what noise makes, away from where the pads slid on the handle: that is no noise. A stretch
/// counts as such when the pose across the path jumps there, or when it has many times what is usual.
pub(crate) fn usual_square(motion: &Motion, effort: &[f64]) -> Result<f64, MotionError> {
    let values = motion.regressor(effort)?;
    let mut stretches: std::collections::BTreeMap<i64, (f64, usize)> =
        std::collections::BTreeMap::new();
    for (&i, value) in motion.kept.iter().zip(values) {
        let at = motion.time[i];
        let slid = |slip: &Slip| (at - slip.at).abs() < NO_NOISE_S;
        if !motion.slips.iter().any(slid) {
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
pub(crate) const STRETCH_S: f64 = 1.0;
pub(crate) const UNUSUAL: f64 = 12.0;

/// Time about a slip within which the pose across the path is no noise, as far as the filters carry what it slid by, s.
const NO_NOISE_S: f64 = 0.4;

/// A hinge's effort is a force times a lever, and the lever is read off the same positions: its relative error is taken to be as large
/// as the coordinate's, rad.
fn lever_rms(motion: &Motion) -> Result<f64, MotionError> {
    if motion.kind != JointKind::Revolute {
        return Ok(0.0);
    }
    of_all(motion, &motion.noise_of_q, |series| {
        let both = series.iter().zip(&motion.tau);
        both.map(|(n, tau)| n * tau).collect()
    })
}

/// A series less its mean between the instants at which the tool slid on the handle, and straight across them: what it slid by is
/// no noise.
pub(crate) fn level(motion: &Motion, series: &[f64]) -> Vec<f64> {
    let slips = &motion.slips;
    let stretch = |i: usize| slips.iter().filter(|s| s.at < motion.time[i]).count();
    let mut sums = vec![(0.0, 0_usize); slips.len() + 1];
    for (i, value) in series.iter().enumerate() {
        let sum = &mut sums[stretch(i)];
        *sum = (sum.0 + value, sum.1 + 1);
    }
    let mean = |i: usize| sums[stretch(i)].0 / sums[stretch(i)].1.max(1) as f64;
    let numbered = series.iter().enumerate();
    let mut out: Vec<f64> = numbered.map(|(i, value)| value - mean(i)).collect();
    let slides = |i: &usize| slip::slides(slips, motion.time[*i]);
    for run in &motion.runs {
        let mut rest = run.clone().peekable();
        while let Some(from) = rest.find(slides) {
            while rest.next_if(slides).is_some() {}
            let to = rest.peek().copied().unwrap_or(run.end);
            let outside = |i: usize| run.contains(&i).then(|| out[i]);
            let [before, after] = [outside(from.wrapping_sub(1)), outside(to)];
            let before = before.or(after).unwrap_or(0.0);
            let after = after.unwrap_or(before);
            for (k, between) in out[from..to].iter_mut().enumerate() {
                let share = (k + 1) as f64 / (to + 1 - from) as f64;
                *between = before + share * (after - before);
            }
        }
    }
    out
}

/// The position sensor's noise without what is a smooth function of the coordinate: the path of the tool is no perfect circle
/// or line when the axis shifts or the grasp gives, and that is no noise. Taken out where the rest accelerates less; what only
/// looks like a path by chance adds acceleration.
///
/// # Errors
/// When the motion cannot be filtered.
pub(crate) fn less_path(motion: &Motion, series: Vec<f64>) -> Result<Vec<f64>, MotionError> {
    let path = by_coordinate(motion, &series);
    let rest: Vec<f64> = series.iter().zip(&path).map(|(s, p)| s - p).collect();
    let shake = |series: &[f64]| -> Result<f64, MotionError> {
        Ok(rms(&motion.regressor(&motion.second_derivative(series))?))
    };
    Ok(if shake(&rest)? < shake(&series)? {
        rest
    } else {
        series
    })
}

/// The part of a series that is a smooth function of the coordinate, by the velocities: where a tracker wanders is no path, and strokes that
/// are faster than it wanders tell them apart.
fn by_coordinate(motion: &Motion, series: &[f64]) -> Vec<f64> {
    let (low, high) = extrema(&motion.q);
    let basis: Vec<SVector<f64, PATH_TERMS>> = motion
        .q
        .iter()
        .map(|q| {
            let x = 2.0 * (q - low) / (high - low).max(f64::MIN_POSITIVE) - 1.0;
            let mut out = SVector::from_element(x);
            let mut before = 1.0;
            for k in 1..PATH_TERMS {
                out[k] = 2.0 * x * out[k - 1] - before;
                before = out[k - 1];
            }
            out
        })
        .collect();
    let mut gram = SMatrix::<f64, PATH_TERMS, PATH_TERMS>::zeros();
    let mut right = SVector::<f64, PATH_TERMS>::zeros();
    for run in &motion.runs {
        let steps = basis[run.clone()]
            .windows(2)
            .zip(series[run.clone()].windows(2));
        for (basis, series) in steps {
            let row = basis[1] - basis[0];
            gram += row * row.transpose();
            right += row * (series[1] - series[0]);
        }
    }
    let Some(factor) = gram.cholesky() else {
        return vec![0.0; series.len()];
    };
    let theta = factor.solve(&right);
    let path: Vec<f64> = basis.iter().map(|basis| basis.dot(&theta)).collect();
    // Where the path lies at rest no velocity says.
    let aside = series.iter().sum::<f64>() - path.iter().sum::<f64>();
    let aside = aside / series.len().max(1) as f64;
    path.iter().map(|path| path + aside).collect()
}

/// Chebyshev polynomials of the coordinate that a path may have, beside the constant.
const PATH_TERMS: usize = 6;

/// Some series at the work rate of noise that is white at the samples' own, the same each time.
fn white_series(motion: &Motion, samples: &JointSamples, std: f64) -> Vec<Vec<f64>> {
    let std = std * (samples.period / motion.period).sqrt();
    let mut random = Random::new(0);
    let mut series = || motion.q.iter().map(|_| std * random.normal()).collect();
    let needed = WHITE_S / (motion.q.len() as f64 * motion.period);
    (0..(needed as usize).clamp(1, 4))
        .map(|_| series())
        .collect()
}

/// So much noise has a root mean square of a few percent.
const WHITE_S: f64 = 300.0;

/// When the joint turns, s.
fn turns(motion: &Motion) -> Vec<f64> {
    let mut out = Vec::new();
    for run in &motion.runs {
        let turning = motion.turning[run.clone()].windows(2);
        let turns = turning.zip(&motion.time[run.clone()]);
        out.extend(
            turns
                .filter(|(pair, _)| pair[0] * pair[1] <= 0.0)
                .map(|(_, t)| *t),
        );
    }
    out
}

/// White noise is looked for above a frequency, by the median over stretches.
struct White {
    from_hz: f64,
    stretch_s: f64,
    /// As [`crate::samples::Aside`] has it.
    interpolated: f64,
}

impl White {
    /// Standard deviation of the white noise that fills the band of `series`, away from `turns` (ascending) unless that leaves too little.
    fn std(
        &self,
        samples: &JointSamples,
        series: &[f64],
        turns: &[f64],
    ) -> Result<f64, MotionError> {
        let rate = samples.rate_hz();
        let from = self.from_hz.min(0.25 * rate);
        let filter = LowPass::butterworth(4, from, rate)?;
        let length = ((self.stretch_s * rate) as usize).max(LEAST_OF_WHITE);
        let rings_s = RINGS / from;
        let (mut squares, mut away) = (Vec::new(), Vec::new());
        for run in &samples.runs {
            if run.len() as f64 * samples.period <= 1.0 {
                continue;
            }
            let part = &series[run.clone()];
            let low = filter.zero_phase(part)?;
            let high: Vec<f64> = part.iter().zip(&low).map(|(a, b)| a - b).collect();
            let times = samples.time[run.clone()].chunks_exact(length);
            for (high, times) in high.chunks_exact(length).zip(times) {
                let square = rms(high).powi(2);
                squares.push(square);
                let next = turns.partition_point(|t| *t < times[0] - rings_s);
                if turns
                    .get(next)
                    .is_none_or(|t| *t > times[length - 1] + rings_s)
                {
                    away.push(square);
                }
            }
        }
        if away.len() >= ENOUGH {
            squares = away;
        }
        // Of white noise so much is left by the filter's complement, and between two samples.
        let left = mean_over_band(rate, |hz| {
            let turned = (core::f64::consts::TAU * hz / rate).cos();
            let between = 1.0 - self.interpolated * (1.0 - turned);
            (1.0 - filter.gain(hz, rate).powi(2)).powi(2) * between
        });
        // The median of a chi-squared variable is less than its mean (Wilson and Hilferty 1931).
        let free = (1.0 - 2.0 * from / rate) * length as f64;
        let of_mean = (1.0 - 2.0 / (9.0 * free)).powi(3);
        Ok((quantile(&squares, 0.5) / of_mean / left).sqrt())
    }
}

/// Samples of a stretch, at least.
const LEAST_OF_WHITE: usize = 8;
/// So many stretches are enough.
const ENOUGH: usize = 20;
/// How long a jump rings in the band above a frequency, in its periods.
const RINGS: f64 = 1.2;

/// Mean of `weight`, of a frequency in Hz, over the band of a sample rate.
fn mean_over_band(rate_hz: f64, weight: impl Fn(f64) -> f64) -> f64 {
    let steps = 2000;
    let width = 0.5 * rate_hz / f64::from(steps);
    let sum: f64 = (0..steps)
        .map(|k| weight((f64::from(k) + 0.5) * width))
        .sum();
    sum / f64::from(steps)
}

/// Acceleration of a noise series below `cutoff_hz`, away from its ends: for weighing sensors by what they do to the dynamics.
///
/// # Errors
/// When the series is too short.
pub(crate) fn acceleration_below(
    series: &[f64],
    period: f64,
    cutoff_hz: f64,
) -> Result<Vec<f64>, MotionError> {
    let rate = 1.0 / period;
    let filter = LowPass::butterworth(4, cutoff_hz.min(0.2 * rate), rate)?;
    let acceleration = second_derivative(&filter.zero_phase_settled(series)?, period);
    let edge = (series.len() / 20).min((rate * 0.5) as usize);
    Ok(acceleration[edge..acceleration.len() - edge].to_vec())
}
