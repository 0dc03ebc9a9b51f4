//! A net of three layers, tanh after the first two, on blocks of samples: values and gradient without allocation.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use pulp::{Arch, NullaryFnOnce};

use crate::random::Random;

/// Samples that are taken through a net at once: few enough that all layers stay in the second cache.
pub(super) const BLOCK: usize = 256;

/// Weights and biases, layer by layer, in one row. Gradients and moments have the same shape.
#[derive(Clone, Debug)]
pub(super) struct Net {
    sizes: [usize; 4],
    pub(super) values: Vec<f32>,
}

impl Net {
    /// Weights and biases uniform within one over the root of the inputs.
    pub(super) fn new(sizes: [usize; 4], random: &mut Random) -> Self {
        let mut values = Vec::new();
        for k in 0..3 {
            let bound = 1.0 / (sizes[k] as f64).sqrt();
            let count = sizes[k + 1] * (sizes[k] + 1);
            values.extend((0..count).map(|_| ((2.0 * random.unit() - 1.0) * bound) as f32));
        }
        Self { sizes, values }
    }

    pub(super) fn zeros_like(&self) -> Self {
        Self {
            sizes: self.sizes,
            values: vec![0.0; self.values.len()],
        }
    }

    /// Weights of the layer, outputs by inputs, and the place of its biases.
    fn layer(&self, k: usize) -> (MatRef<'_, f32>, &[f32]) {
        let [inputs, outputs] = [self.sizes[k], self.sizes[k + 1]];
        let (weights, biases) =
            self.values[self.place(k)..][..outputs * (inputs + 1)].split_at(outputs * inputs);
        (
            MatRef::from_column_major_slice(weights, outputs, inputs),
            biases,
        )
    }

    fn layer_mut(&mut self, k: usize) -> (MatMut<'_, f32>, &mut [f32]) {
        let [inputs, outputs] = [self.sizes[k], self.sizes[k + 1]];
        let place = self.place(k);
        let (weights, biases) =
            self.values[place..][..outputs * (inputs + 1)].split_at_mut(outputs * inputs);
        (
            MatMut::from_column_major_slice_mut(weights, outputs, inputs),
            biases,
        )
    }

    fn place(&self, k: usize) -> usize {
        (0..k)
            .map(|k| self.sizes[k + 1] * (self.sizes[k] + 1))
            .sum()
    }
}

/// What comes out of each layer for one block of samples, and the error's gradient by it; samples one behind the other.
#[derive(Debug)]
pub(super) struct Pass {
    sizes: [usize; 4],
    out: [Vec<f32>; 3],
    to: [Vec<f32>; 3],
}

impl Pass {
    /// Room for up to `count` samples through nets of one shape.
    pub(super) fn of(net: &Net, count: usize) -> Self {
        let room = || [1, 2, 3].map(|k| vec![0.0; net.sizes[k] * count]);
        Self {
            sizes: net.sizes,
            out: room(),
            to: room(),
        }
    }

    /// Takes the samples of `input` (`count` times as many numbers as the net has inputs) through the net; gives the last layer.
    pub(super) fn forward(&mut self, net: &Net, input: &[f32], count: usize) -> &[f32] {
        for k in 0..3 {
            let (before, this) = self.out.split_at_mut(k);
            let input = before.last().map_or(input, Vec::as_slice);
            let (weights, biases) = net.layer(k);
            let out = &mut this[0][..self.sizes[k + 1] * count];
            let samples = columns(input, self.sizes[k], count);
            let product = MatMut::from_column_major_slice_mut(&mut *out, self.sizes[k + 1], count);
            matmul(product, Accum::Replace, weights, samples, 1.0, Par::Seq);
            if k < 2 {
                Arch::new().dispatch(Tanh { out, biases });
            } else {
                for sample in out.chunks_exact_mut(biases.len()) {
                    for (value, bias) in sample.iter_mut().zip(biases) {
                        *value += bias;
                    }
                }
            }
        }
        &self.out[2][..self.sizes[3] * count]
    }

    /// The last layer, and where the error's gradient by it is put before [`Self::backward`].
    pub(super) fn ends(&mut self, count: usize) -> (&[f32], &mut [f32]) {
        let len = self.sizes[3] * count;
        (&self.out[2][..len], &mut self.to[2][..len])
    }

    /// Adds the block's part of the error's gradient to `gradient`, after [`Self::forward`] with the same net and input.
    pub(super) fn backward(&mut self, net: &Net, input: &[f32], count: usize, gradient: &mut Net) {
        for k in (0..3).rev() {
            let [inputs, outputs] = [self.sizes[k], self.sizes[k + 1]];
            let (before, this) = self.to.split_at_mut(k);
            let to = &this[0][..outputs * count];
            let came = if k == 0 { input } else { &self.out[k - 1] };
            let (weights, biases) = gradient.layer_mut(k);
            let to_samples = columns(to, outputs, count);
            let samples = columns(came, inputs, count);
            matmul(
                weights,
                Accum::Add,
                to_samples,
                samples.transpose(),
                1.0,
                Par::Seq,
            );
            Arch::new().dispatch(Sums { to, biases });
            if let Some(earlier) = before.last_mut() {
                let earlier = &mut earlier[..inputs * count];
                let product = MatMut::from_column_major_slice_mut(&mut *earlier, inputs, count);
                let weights = net.layer(k).0.transpose();
                matmul(product, Accum::Replace, weights, to_samples, 1.0, Par::Seq);
                Arch::new().dispatch(ThroughTanh {
                    to: earlier,
                    out: &came[..inputs * count],
                });
            }
        }
    }
}

fn columns(values: &[f32], rows: usize, count: usize) -> MatRef<'_, f32> {
    MatRef::from_column_major_slice(&values[..rows * count], rows, count)
}

/// The hyperbolic tangent of each sample and the biases, compiled for what the processor has.
struct Tanh<'a> {
    out: &'a mut [f32],
    biases: &'a [f32],
}

impl NullaryFnOnce for Tanh<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for sample in self.out.chunks_exact_mut(self.biases.len()) {
            for (value, bias) in sample.iter_mut().zip(self.biases) {
                *value = tanh(*value + bias);
            }
        }
    }
}

/// Adds the samples' gradients to that of the biases.
struct Sums<'a> {
    to: &'a [f32],
    biases: &'a mut [f32],
}

impl NullaryFnOnce for Sums<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for sample in self.to.chunks_exact(self.biases.len()) {
            for (sum, value) in self.biases.iter_mut().zip(sample) {
                *sum += value;
            }
        }
    }
}

/// Each gradient by what came out of a tanh becomes that by what went in.
struct ThroughTanh<'a> {
    to: &'a mut [f32],
    out: &'a [f32],
}

impl NullaryFnOnce for ThroughTanh<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (to, out) in self.to.iter_mut().zip(self.out) {
            *to *= 1.0 - out * out;
        }
    }
}

/// The hyperbolic tangent to 1e-6, by its continued fraction at a quarter of the argument, doubled twice before the one division;
/// exact libraries take most of a training's time.
#[inline(always)]
fn tanh(x: f32) -> f32 {
    let h = 0.25 * x.clamp(-7.9, 7.9);
    let s = h * h;
    let (n, d) = (
        h * (10395.0 + s * (1260.0 + 21.0 * s)),
        10395.0 + s * (4725.0 + s * (210.0 + s)),
    );
    // tanh 2x = 2 tanh x / (1 + tanh² x), with tanh x = n / d.
    let (n, d) = (2.0 * n * d, d * d + n * n);
    2.0 * n * d / (d * d + n * n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hyperbolic_tangent_is_right_to_two_millionths() {
        let at: Vec<f32> = (-1000..=1000).map(|i| 0.01 * i as f32).collect();
        let mut values: Vec<f32> = at.iter().map(|x| x - 0.5).collect();
        let out = &mut values;
        Arch::new().dispatch(Tanh {
            out,
            biases: &[0.5],
        });
        for (x, value) in at.iter().zip(values) {
            assert!((value - x.tanh()).abs() < 2e-6, "{x}: {value} {}", x.tanh());
        }
    }
}
