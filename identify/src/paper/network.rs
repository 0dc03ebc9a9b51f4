//! The paper's residual network: `g(q) + c±(q, |dq|) dq`, two tanh layers each, softplus heads by direction.
//!
//! Trained as the paper says: full batch, mean squared error, AdamW with learning rate and weight decay 1e-3, a random quarter
//! for validation, at most 1200 epochs, stopped after 120 without a better validation error, the best weights kept. Inputs
//! and target are scaled to about one, which the paper leaves open. Single precision.

mod loss;
mod net;

use crate::mechanism::Mechanism;
use crate::random::Random;
use loss::{Loss, Pair, softplus};
use net::{Net, Pass};

/// How the network is trained.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Training {
    /// Most epochs.
    pub epochs: usize,
    /// Epochs without a better validation error after which training ends.
    pub patience: usize,
    /// Units of each hidden layer.
    pub units: usize,
    /// Learning rate, and decay of the weights per unit of it.
    pub rate: f32,
    /// Weight decay.
    pub decay: f32,
    /// Share of the samples for validation.
    pub validation: f64,
    /// Seed of the first weights and of the split.
    pub seed: u64,
}

impl Default for Training {
    /// The paper's.
    fn default() -> Self {
        Self {
            epochs: 1200,
            patience: 120,
            units: 64,
            rate: 1e-3,
            decay: 1e-3,
            validation: 0.25,
            seed: 1,
        }
    }
}

/// The trained mechanism.
#[derive(Clone, Debug)]
pub struct MlpMechanism {
    pair: Pair,
    scale: Scale,
    /// Epochs that the training took.
    pub epochs: usize,
}

impl Mechanism for MlpMechanism {
    fn effort(&self, q: f64, dq: f64) -> f64 {
        let [q, dq] = self.scale.state([q, dq]);
        let [load, damping] = [&self.pair.load, &self.pair.damping];
        let load = Pass::of(load, 1).forward(load, &[q], 1)[0];
        let c = softplus(
            Pass::of(damping, 1).forward(damping, &[q, dq.abs()], 1)[usize::from(dq < 0.0)],
        );
        f64::from(load + c * dq) * self.scale.tau
    }

    fn kind(&self) -> &'static str {
        "mlp"
    }
}

#[derive(Clone, Copy, Debug)]
struct Scale {
    q: [f64; 2],
    dq: f64,
    tau: f64,
}

impl Scale {
    fn of(states: &[[f64; 2]], tau: &[f64]) -> Self {
        let n = states.len().max(1) as f64;
        let mean = states.iter().map(|s| s[0]).sum::<f64>() / n;
        let spread = |sum: f64| (sum / n).sqrt().max(1e-9);
        Self {
            q: [
                mean,
                spread(states.iter().map(|s| (s[0] - mean).powi(2)).sum()),
            ],
            dq: spread(states.iter().map(|s| s[1] * s[1]).sum()),
            tau: spread(tau.iter().map(|t| t * t).sum()),
        }
    }

    fn state(&self, [q, dq]: [f64; 2]) -> [f32; 2] {
        [((q - self.q[0]) / self.q[1]) as f32, (dq / self.dq) as f32]
    }
}

/// Trains on `tau` at `states` = q and dq.
#[must_use]
pub fn train(states: &[[f64; 2]], tau: &[f64], training: &Training) -> MlpMechanism {
    let scale = Scale::of(states, tau);
    let mut random = Random::new(training.seed);
    let mut order: Vec<usize> = (0..states.len()).collect();
    for i in (1..order.len()).rev() {
        order.swap(i, (random.unit() * (i + 1) as f64) as usize % (i + 1));
    }
    let (held, fitted) = order.split_at((training.validation * states.len() as f64) as usize);
    let units = training.units;
    let mut pair = Pair {
        load: Net::new([1, units, units, 1], &mut random),
        damping: Net::new([2, units, units, 2], &mut random),
    };
    let loss = |rows: &[usize]| Loss::of(rows, states, tau, &scale, &pair);
    let mut judged = loss(if held.is_empty() { fitted } else { held });
    let mut fitted = loss(fitted);
    let mut gradient = pair.zeros_like();
    let mut adam = Adam::of(&pair);
    let mut best = (f32::INFINITY, pair.clone(), 0);
    let mut epochs = 0;
    loop {
        // One round of the threads gives the gradient of the next epoch and the error after the last one.
        let error = if epochs < training.epochs {
            fitted.gradient_and_error(&mut judged, &pair, &mut gradient)
        } else {
            judged.error(&pair)
        };
        if epochs > 0 && error < best.0 {
            best = (error, pair.clone(), epochs);
        }
        if epochs == training.epochs || epochs - best.2 >= training.patience.max(1) {
            break;
        }
        epochs += 1;
        adam.step(&mut pair, &gradient, training, epochs);
    }
    MlpMechanism {
        pair: best.1,
        scale,
        epochs,
    }
}

/// Moments of the gradient.
struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
}

impl Adam {
    fn of(pair: &Pair) -> Self {
        let zeros: Vec<f32> = pair.values().map(|_| 0.0).collect();
        Self {
            first: zeros.clone(),
            second: zeros,
        }
    }

    /// One step of AdamW (Loshchilov and Hutter, 2019) with the customary 0.9, 0.999, 1e-8.
    fn step(&mut self, pair: &mut Pair, gradient: &Pair, training: &Training, epoch: usize) {
        const KEEP: [f32; 2] = [0.9, 0.999];
        let unbias = KEEP.map(|keep| 1.0 - keep.powi(epoch as i32));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((value, g), (m, v)) in pair.values_mut().zip(gradient.values()).zip(moments) {
            *m = KEEP[0] * *m + (1.0 - KEEP[0]) * g;
            *v = KEEP[1] * *v + (1.0 - KEEP[1]) * g * g;
            let change = (*m / unbias[0]) / ((*v / unbias[1]).sqrt() + 1e-8);
            *value -= training.rate * (change + training.decay * *value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn closer() -> (Vec<[f64; 2]>, Vec<f64>) {
        let states: Vec<[f64; 2]> = (0..800)
            .map(|i| {
                let t = f64::from(i) * 0.05;
                [
                    0.6 - 0.6 * (0.9 * t).cos(),
                    0.54 * (0.9 * t).sin() * (1.0 + 0.4 * (0.23 * t).sin()),
                ]
            })
            .collect();
        let tau = states
            .iter()
            .map(|[q, dq]| 4.0 + 3.0 * q + if *dq < 0.0 { 8.0 * dq } else { 0.0 })
            .collect();
        (states, tau)
    }

    #[test]
    fn a_closer_is_learnt_and_the_same_seed_gives_the_same_network() {
        let (states, tau) = closer();
        let training = Training {
            units: 16,
            epochs: 800,
            rate: 5e-3,
            ..Training::default()
        };
        let one = train(&states, &tau, &training);
        let errors: f64 = states
            .iter()
            .zip(&tau)
            .map(|([q, dq], tau)| (one.effort(*q, *dq) - tau).powi(2))
            .sum();
        let rms = (errors / tau.len() as f64).sqrt();
        assert!(rms < 0.25, "{rms} after {} epochs", one.epochs);
        let two = train(&states, &tau, &training);
        assert_eq!(one.effort(0.4, -0.3), two.effort(0.4, -0.3));
        assert_eq!(one.kind(), "mlp");
    }
}
