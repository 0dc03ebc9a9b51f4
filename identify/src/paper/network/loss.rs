//! Mean squared error of load and damping on samples, and its gradient, on a few threads.

use super::Scale;
use super::net::{BLOCK, Net, Pass};
use crate::parallel::for_each;

/// Into how many pieces the samples are cut, each for a thread. It is not the number of processors, so that sums come out the same on
/// every machine.
const PIECES: usize = 4;

/// The load over q, and the damping over q and the size of dq.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    pub(super) load: Net,
    pub(super) damping: Net,
}

impl Pair {
    pub(super) fn zeros_like(&self) -> Self {
        Self {
            load: self.load.zeros_like(),
            damping: self.damping.zeros_like(),
        }
    }

    pub(super) fn values_mut(&mut self) -> impl Iterator<Item = &mut f32> {
        self.load.values.iter_mut().chain(&mut self.damping.values)
    }

    pub(super) fn values(&self) -> impl Iterator<Item = &f32> {
        self.load.values.iter().chain(&self.damping.values)
    }
}

/// Samples, scaled.
struct Samples {
    q: Vec<f32>,
    /// q and the size of dq of each.
    state: Vec<f32>,
    dq: Vec<f32>,
    tau: Vec<f32>,
}

/// A piece of the samples and what its thread needs.
struct Piece {
    samples: Samples,
    load: Pass,
    damping: Pass,
    gradient: Pair,
    /// Sum of the squared differences.
    square: f64,
}

/// Samples to fit or to be judged by.
pub(super) struct Loss {
    pieces: Vec<Piece>,
    count: usize,
}

impl Loss {
    /// For nets of the shape of `pair`.
    pub(super) fn of(
        rows: &[usize],
        states: &[[f64; 2]],
        tau: &[f64],
        scale: &Scale,
        pair: &Pair,
    ) -> Self {
        let size = rows.len().div_ceil(PIECES).max(1);
        let piece = |rows: &[usize]| {
            let scaled: Vec<[f32; 2]> = rows.iter().map(|&i| scale.state(states[i])).collect();
            let samples = Samples {
                q: scaled.iter().map(|s| s[0]).collect(),
                state: scaled.iter().flat_map(|s| [s[0], s[1].abs()]).collect(),
                dq: scaled.iter().map(|s| s[1]).collect(),
                tau: rows.iter().map(|&i| (tau[i] / scale.tau) as f32).collect(),
            };
            Piece {
                samples,
                load: Pass::of(&pair.load, BLOCK),
                damping: Pass::of(&pair.damping, BLOCK),
                gradient: pair.zeros_like(),
                square: 0.0,
            }
        };
        Self {
            pieces: rows.chunks(size).map(piece).collect(),
            count: rows.len(),
        }
    }

    /// Mean squared difference.
    pub(super) fn error(&mut self, pair: &Pair) -> f32 {
        for_each(&mut self.pieces, |piece| piece.run(pair, None));
        self.mean_square()
    }

    /// Gradient of the mean squared difference, into `gradient`, and the mean squared difference of `other`.
    pub(super) fn gradient_and_error(
        &mut self,
        other: &mut Self,
        pair: &Pair,
        gradient: &mut Pair,
    ) -> f32 {
        let unit = 2.0 / self.count.max(1) as f32;
        let own = self.pieces.iter_mut().map(|piece| (piece, Some(unit)));
        let others = other.pieces.iter_mut().map(|piece| (piece, None));
        for_each(own.chain(others), |(piece, unit)| piece.run(pair, unit));
        gradient.values_mut().for_each(|value| *value = 0.0);
        for piece in &self.pieces {
            for (sum, value) in gradient.values_mut().zip(piece.gradient.values()) {
                *sum += value;
            }
        }
        other.mean_square()
    }

    fn mean_square(&self) -> f32 {
        let square: f64 = self.pieces.iter().map(|piece| piece.square).sum();
        (square / self.count.max(1) as f64) as f32
    }
}

impl Piece {
    /// The sum of squares, and with `unit` (the gradient of the error by half a square) the gradient.
    fn run(&mut self, pair: &Pair, unit: Option<f32>) {
        self.square = 0.0;
        if unit.is_some() {
            self.gradient.values_mut().for_each(|value| *value = 0.0);
        }
        let Samples { q, state, dq, tau } = &self.samples;
        for from in (0..tau.len()).step_by(BLOCK) {
            let to = (from + BLOCK).min(tau.len());
            let count = to - from;
            let (q, state) = (&q[from..to], &state[2 * from..2 * to]);
            self.load.forward(&pair.load, q, count);
            self.damping.forward(&pair.damping, state, count);
            let (load, to_load) = self.load.ends(count);
            let (heads, to_heads) = self.damping.ends(count);
            for (i, (dq, tau)) in dq[from..to].iter().zip(&tau[from..to]).enumerate() {
                let head = 2 * i + usize::from(*dq < 0.0);
                let (c, slope) = softplus_and_slope(heads[head]);
                let rest = load[i] + c * dq - tau;
                self.square += f64::from(rest * rest);
                let by = unit.unwrap_or(0.0) * rest;
                to_load[i] = by;
                to_heads[2 * i..2 * i + 2].fill(0.0);
                to_heads[head] = by * dq * slope;
            }
            if unit.is_some() {
                let gradient = &mut self.gradient;
                self.load.backward(&pair.load, q, count, &mut gradient.load);
                self.damping
                    .backward(&pair.damping, state, count, &mut gradient.damping);
            }
        }
    }
}

pub(super) fn softplus(x: f32) -> f32 {
    softplus_and_slope(x).0
}

/// `ln(1 + exp x)` and its derivative, without overflow.
fn softplus_and_slope(x: f32) -> (f32, f32) {
    let small = (-x.abs()).exp();
    let rest = small / (1.0 + small);
    let slope = if x < 0.0 { rest } else { 1.0 - rest };
    (x.max(0.0) + small.ln_1p(), slope)
}

#[cfg(test)]
mod tests {
    use super::super::tests::closer;
    use super::super::{Random, Scale};
    use super::*;

    #[test]
    fn the_gradient_is_that_of_the_error() {
        let (states, tau) = closer();
        let scale = Scale::of(&states, &tau);
        let mut random = Random::new(3);
        let pair = Pair {
            load: Net::new([1, 5, 5, 1], &mut random),
            damping: Net::new([2, 5, 5, 2], &mut random),
        };
        // As many as leave every piece a whole block and a part of one.
        let rows: Vec<usize> = (0..1100).map(|i| i * 7 % states.len()).collect();
        let mut loss = Loss::of(&rows, &states, &tau, &scale, &pair);
        let mut gradient = pair.zeros_like();
        let mut judged = Loss::of(&rows, &states, &tau, &scale, &pair);
        let error = loss.gradient_and_error(&mut judged, &pair, &mut gradient);
        assert_eq!(error, loss.error(&pair));
        let gradient: Vec<f32> = gradient.values().copied().collect();
        for k in (0..gradient.len()).step_by(5) {
            let mut moved = |by: f32| {
                let mut pair = pair.clone();
                *pair.values_mut().nth(k).unwrap() += by;
                loss.error(&pair)
            };
            let slope = (moved(1e-2) - moved(-1e-2)) / 2e-2;
            assert!(
                (slope - gradient[k]).abs() < 3e-3 + 0.02 * slope.abs(),
                "value {k}: {slope} {}",
                gradient[k]
            );
        }
    }
}
