//! The paper's residual network: `g(q) + c±(q, |dq|) dq`, two tanh layers each, softplus heads by direction.
//!
//! Trained as the paper says: full batch, mean squared error, AdamW with learning rate and weight decay 1e-3, a random quarter
//! for validation, at most 1200 epochs, stopped after 120 without a better validation error, the best weights kept. Inputs
//! and target are scaled to about one, which the paper leaves open. Single precision.

use nalgebra::{DMatrix, DVector};

use crate::mechanism::Mechanism;

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
    load: Net,
    damping: Net,
    scale: Scale,
    /// Epochs that the training took.
    pub epochs: usize,
}

impl Mechanism for MlpMechanism {
    fn effort(&self, q: f64, dq: f64) -> f64 {
        let [q, dq] = self.scale.state([q, dq]);
        let load = self.load.run(&DMatrix::from_element(1, 1, q));
        let heads = self
            .damping
            .run(&DMatrix::from_column_slice(2, 1, &[q, dq.abs()]));
        let c = softplus(heads[(usize::from(dq < 0.0), 0)]);
        f64::from(load[(0, 0)] + c * dq) * self.scale.tau
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
    let mut random = Random(training.seed);
    let mut order: Vec<usize> = (0..states.len()).collect();
    for i in (1..order.len()).rev() {
        order.swap(i, (random.uniform() * (i + 1) as f64) as usize % (i + 1));
    }
    let held = (training.validation * states.len() as f64) as usize;
    let batch = |rows: &[usize]| Batch::of(rows, states, tau, &scale);
    let (validation, fitted) = (batch(&order[..held]), batch(&order[held..]));
    let units = training.units;
    let mut load = Net::new([1, units, units, 1], &mut random);
    let mut damping = Net::new([2, units, units, 2], &mut random);
    let mut best = (f32::INFINITY, load.clone(), damping.clone(), 0);
    let mut steps = [Adam::of(&load), Adam::of(&damping)];
    let mut epochs = 0;
    for epoch in 1..=training.epochs {
        epochs = epoch;
        let (by_load, by_damping) = fitted.gradient(&load, &damping);
        steps[0].step(&mut load, &by_load, training, epoch);
        steps[1].step(&mut damping, &by_damping, training, epoch);
        let error = if held == 0 {
            fitted.error(&load, &damping)
        } else {
            validation.error(&load, &damping)
        };
        if error < best.0 {
            best = (error, load.clone(), damping.clone(), epoch);
        } else if epoch - best.3 >= training.patience {
            break;
        }
    }
    MlpMechanism {
        load: best.1,
        damping: best.2,
        scale,
        epochs,
    }
}

/// Samples as columns.
struct Batch {
    q: DMatrix<f32>,
    state: DMatrix<f32>,
    dq: Vec<f32>,
    tau: Vec<f32>,
}

impl Batch {
    fn of(rows: &[usize], states: &[[f64; 2]], tau: &[f64], scale: &Scale) -> Self {
        let scaled: Vec<[f32; 2]> = rows.iter().map(|&i| scale.state(states[i])).collect();
        let count = rows.len();
        Self {
            q: DMatrix::from_fn(1, count, |_, i| scaled[i][0]),
            state: DMatrix::from_fn(2, count, |j, i| {
                if j == 0 {
                    scaled[i][0]
                } else {
                    scaled[i][1].abs()
                }
            }),
            dq: scaled.iter().map(|s| s[1]).collect(),
            tau: rows.iter().map(|&i| (tau[i] / scale.tau) as f32).collect(),
        }
    }

    /// Predicted minus true, and the heads before softplus.
    fn residual(&self, load: &DMatrix<f32>, heads: &DMatrix<f32>) -> Vec<f32> {
        (0..self.tau.len())
            .map(|i| {
                let dq = self.dq[i];
                let head = heads[(usize::from(dq < 0.0), i)];
                load[(0, i)] + softplus(head) * dq - self.tau[i]
            })
            .collect()
    }

    fn error(&self, load: &Net, damping: &Net) -> f32 {
        let residual = self.residual(&load.run(&self.q), &damping.run(&self.state));
        residual.iter().map(|r| r * r).sum::<f32>() / residual.len().max(1) as f32
    }

    fn gradient(&self, load: &Net, damping: &Net) -> (Net, Net) {
        let of_load = load.layers_of(&self.q);
        let of_damping = damping.layers_of(&self.state);
        let heads = &of_damping[2];
        let residual = self.residual(&of_load[2], heads);
        let unit = 2.0 / residual.len().max(1) as f32;
        let to_load = DMatrix::from_fn(1, residual.len(), |_, i| unit * residual[i]);
        let mut to_heads = DMatrix::zeros(2, residual.len());
        for (i, r) in residual.iter().enumerate() {
            let j = usize::from(self.dq[i] < 0.0);
            to_heads[(j, i)] = unit * r * self.dq[i] * sigmoid(heads[(j, i)]);
        }
        (
            load.backward(&self.q, &of_load, to_load),
            damping.backward(&self.state, &of_damping, to_heads),
        )
    }
}

/// Three layers, tanh after the first two. Also holds gradients and moments, which have the same shape.
#[derive(Clone, Debug)]
struct Net {
    weights: [DMatrix<f32>; 3],
    biases: [DVector<f32>; 3],
}

impl Net {
    /// Weights and biases uniform within one over the root of the inputs.
    fn new(sizes: [usize; 4], random: &mut Random) -> Self {
        let mut layer = |i: usize| {
            let bound = 1.0 / (sizes[i] as f64).sqrt();
            let mut draw = || ((2.0 * random.uniform() - 1.0) * bound) as f32;
            (
                DMatrix::from_fn(sizes[i + 1], sizes[i], |_, _| draw()),
                DVector::from_fn(sizes[i + 1], |_, _| draw()),
            )
        };
        let [a, b, c] = [layer(0), layer(1), layer(2)];
        Self {
            weights: [a.0, b.0, c.0],
            biases: [a.1, b.1, c.1],
        }
    }

    fn run(&self, input: &DMatrix<f32>) -> DMatrix<f32> {
        let [_, _, out] = self.layers_of(input);
        out
    }

    /// What comes out of each layer, samples as columns.
    fn layers_of(&self, input: &DMatrix<f32>) -> [DMatrix<f32>; 3] {
        let layer = |k: usize, x: &DMatrix<f32>| {
            let mut out = &self.weights[k] * x;
            for mut column in out.column_iter_mut() {
                column += &self.biases[k];
            }
            if k < 2 {
                out.apply(|v| *v = tanh(*v));
            }
            out
        };
        let first = layer(0, input);
        let second = layer(1, &first);
        let third = layer(2, &second);
        [first, second, third]
    }

    /// Gradient of an error whose gradient by the output is `to_output`.
    fn backward(
        &self,
        input: &DMatrix<f32>,
        out: &[DMatrix<f32>; 3],
        to_output: DMatrix<f32>,
    ) -> Self {
        let through = |k: usize, later: &DMatrix<f32>| {
            let mut to = self.weights[k + 1].transpose() * later;
            to.zip_apply(&out[k], |d, y| *d *= 1.0 - y * y);
            to
        };
        let second = through(1, &to_output);
        let first = through(0, &second);
        let inputs = [input, &out[0], &out[1]];
        let to = [first, second, to_output];
        Self {
            weights: [0, 1, 2].map(|k| &to[k] * inputs[k].transpose()),
            biases: [0, 1, 2].map(|k| to[k].column_sum()),
        }
    }

    fn values(&self) -> impl Iterator<Item = &f32> {
        self.weights
            .iter()
            .flat_map(|w| w.iter())
            .chain(self.biases.iter().flat_map(|b| b.iter()))
    }

    fn values_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.weights
            .iter_mut()
            .flat_map(|w| w.iter_mut())
            .chain(self.biases.iter_mut().flat_map(|b| b.iter_mut()))
    }
}

/// Moments of the gradient.
struct Adam {
    first: Vec<f32>,
    second: Vec<f32>,
}

impl Adam {
    fn of(net: &Net) -> Self {
        let zeros: Vec<f32> = net.values().map(|_| 0.0).collect();
        Self {
            first: zeros.clone(),
            second: zeros,
        }
    }

    /// One step of AdamW (Loshchilov and Hutter, 2019) with the customary 0.9, 0.999, 1e-8.
    fn step(&mut self, net: &mut Net, gradient: &Net, training: &Training, epoch: usize) {
        const KEEP: [f32; 2] = [0.9, 0.999];
        let unbias = KEEP.map(|keep| 1.0 - keep.powi(epoch as i32));
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((value, g), (m, v)) in net.values_mut().zip(gradient.values()).zip(moments) {
            *m = KEEP[0] * *m + (1.0 - KEEP[0]) * g;
            *v = KEEP[1] * *v + (1.0 - KEEP[1]) * g * g;
            let change = (*m / unbias[0]) / ((*v / unbias[1]).sqrt() + 1e-8);
            *value -= training.rate * (change + training.decay * *value);
        }
    }
}

fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The hyperbolic tangent to 1e-6, by its continued fraction; exact libraries take most of a training's time.
fn tanh(x: f32) -> f32 {
    let x = x.clamp(-7.9, 7.9);
    // tanh x = 2 tanh(x/2) / (1 + tanh(x/2)^2), whose fraction converges fast for small arguments.
    let h = 0.25 * x;
    let s = h * h;
    let t = h * (10395.0 + s * (1260.0 + 21.0 * s)) / (10395.0 + s * (4725.0 + s * (210.0 + s)));
    let t = 2.0 * t / (1.0 + t * t);
    2.0 * t / (1.0 + t * t)
}

/// SplitMix64.
struct Random(u64);

impl Random {
    /// In 0..1.
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn closer() -> (Vec<[f64; 2]>, Vec<f64>) {
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
    fn the_hyperbolic_tangent_is_right_to_a_millionth() {
        for i in -1000..=1000 {
            let x = 0.01 * i as f32;
            assert!(
                (tanh(x) - x.tanh()).abs() < 2e-6,
                "{x}: {} {}",
                tanh(x),
                x.tanh()
            );
        }
    }

    #[test]
    fn the_gradient_is_that_of_the_error() {
        let (states, tau) = closer();
        let scale = Scale::of(&states, &tau);
        let rows: Vec<usize> = (0..40).map(|i| 20 * i).collect();
        let batch = Batch::of(&rows, &states, &tau, &scale);
        let mut random = Random(3);
        let load = Net::new([1, 5, 5, 1], &mut random);
        let damping = Net::new([2, 5, 5, 2], &mut random);
        let (by_load, by_damping) = batch.gradient(&load, &damping);
        for (which, gradient) in [(0, &by_load), (1, &by_damping)] {
            let gradient: Vec<f32> = gradient.values().copied().collect();
            for k in (0..gradient.len()).step_by(7) {
                let moved = |by: f32| {
                    let mut nets = [load.clone(), damping.clone()];
                    *nets[which].values_mut().nth(k).unwrap() += by;
                    batch.error(&nets[0], &nets[1])
                };
                let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
                assert!(
                    (slope - gradient[k]).abs() < 3e-3 + 0.02 * slope.abs(),
                    "net {which} value {k}: {slope} {}",
                    gradient[k]
                );
            }
        }
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
