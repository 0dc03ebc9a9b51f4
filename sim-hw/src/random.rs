//! Seeded randomness: every part of the simulation draws from a stream of its own, so that one more draw in one part does not
//! change the others.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use crate::motion::Jet;

/// Which part draws.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Stream {
    Setting = 1,
    Person = 2,
    OffAxis = 3,
    Sensor = 4,
    Tracker = 5,
    Gripper = 6,
    SensorLine = 7,
    TrackerLine = 8,
    GripperLine = 9,
    Clocks = 10,
    Plan = 11,
    Calibration = 12,
    Sealed = 13,
}

/// Random numbers of one stream of a seed.
#[derive(Debug)]
pub(crate) struct Random(ChaCha8Rng);

impl Random {
    pub(crate) fn new(seed: u64, stream: Stream) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(stream as u64);
        Self(rng)
    }

    pub(crate) fn uniform(&mut self, least: f64, most: f64) -> f64 {
        least + (most - least) * self.0.random::<f64>()
    }

    /// One of 0 to `count` - 1.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((self.uniform(0.0, count as f64)) as usize).min(count.saturating_sub(1))
    }

    pub(crate) fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }

    pub(crate) fn normals<const N: usize>(&mut self) -> [f64; N] {
        std::array::from_fn(|_| self.normal())
    }

    /// Exponentially distributed with the given mean.
    pub(crate) fn waiting(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.0.random::<f64>()).ln()
    }
}

/// A slowly varying quantity of a person: sines of seeded frequency and phase, with a known rms.
#[derive(Clone, Debug)]
pub(crate) struct Wave(Vec<[f64; 3]>);

impl Wave {
    /// `rms` in any unit, frequencies between `least_hz` and `most_hz`.
    pub(crate) fn new(random: &mut Random, rms: f64, [least_hz, most_hz]: [f64; 2]) -> Self {
        let weights: [f64; 4] = std::array::from_fn(|_| random.uniform(0.5, 1.0));
        let power: f64 = weights.iter().map(|weight| 0.5 * weight * weight).sum();
        let scale = rms / power.sqrt();
        Self(
            weights
                .iter()
                .map(|weight| {
                    let hz = random.uniform(least_hz, most_hz);
                    [
                        scale * weight,
                        hz,
                        random.uniform(0.0, std::f64::consts::TAU),
                    ]
                })
                .collect(),
        )
    }

    pub(crate) fn at(&self, t: f64) -> Jet {
        self.0
            .iter()
            .fold(Jet::default(), |sum, [amplitude, hz, phase]| {
                sum.plus(Jet::sine(*amplitude, *hz, *phase, t))
            })
    }

    pub(crate) fn value(&self, t: f64) -> f64 {
        self.at(t).value
    }
}

/// First-order Gauss-Markov process: mean 0, given rms, forgets over `memory_s`.
#[derive(Clone, Debug)]
pub(crate) struct Wander<const N: usize> {
    values: [f64; N],
    rms: [f64; N],
    memory_s: f64,
    t: f64,
}

impl<const N: usize> Wander<N> {
    pub(crate) fn new(random: &mut Random, rms: [f64; N], memory_s: f64) -> Self {
        let values = std::array::from_fn(|axis| rms[axis] * random.normal());
        Self {
            values,
            rms,
            memory_s,
            t: 0.0,
        }
    }

    /// Its values at `t`, which must not go back.
    pub(crate) fn at(&mut self, random: &mut Random, t: f64) -> [f64; N] {
        let keep = (-(t - self.t).max(0.0) / self.memory_s).exp();
        let fresh = (1.0 - keep * keep).sqrt();
        for (value, rms) in self.values.iter_mut().zip(self.rms) {
            *value = keep * *value + fresh * rms * random.normal();
        }
        self.t = t;
        self.values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wave_has_the_rms_it_was_given() {
        let wave = Wave::new(&mut Random::new(3, Stream::Person), 2.0, [0.5, 3.0]);
        let mean_square = (0..400_000)
            .map(|i| wave.value(f64::from(i) * 1e-3).powi(2))
            .sum::<f64>()
            / 4e5;
        assert!(
            (mean_square.sqrt() - 2.0).abs() < 0.1,
            "{}",
            mean_square.sqrt()
        );
    }

    #[test]
    fn a_wander_has_the_rms_and_the_memory_it_was_given() {
        let mut random = Random::new(5, Stream::Tracker);
        let mut wander = Wander::new(&mut random, [1.5], 10.0);
        let values: Vec<f64> = (0..400_000)
            .map(|i| wander.at(&mut random, f64::from(i) * 0.1)[0])
            .collect();
        let square = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
        assert!((square.sqrt() - 1.5).abs() < 0.15, "{}", square.sqrt());
        let lagged = values
            .iter()
            .zip(&values[100..])
            .map(|(a, b)| a * b)
            .sum::<f64>()
            / values.len() as f64;
        assert!(
            (lagged / square - (-1.0_f64).exp()).abs() < 0.08,
            "{}",
            lagged / square
        );
    }

    #[test]
    fn streams_of_one_seed_differ_and_repeat() {
        let draw = |stream| Random::new(9, stream).normal();
        assert_eq!(draw(Stream::Sensor), draw(Stream::Sensor));
        assert_ne!(draw(Stream::Sensor), draw(Stream::Tracker));
    }
}
