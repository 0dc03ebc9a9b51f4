//! A motion as quintic B-splines on even knots, one curve per gapless run.

use core::ops::Range;

use crate::spline::Basis;

/// Functions that are not zero at a sample.
pub(super) const LOCAL: usize = 6;

/// Coordinate, velocity and acceleration per coefficient at a place between two knots.
pub(super) type Weights = [[f64; LOCAL]; 3];

/// Where the knots are, and what the functions are at each sample.
#[derive(Clone, Debug)]
pub(super) struct Curve {
    step: usize,
    /// Of each run: its samples, and its first coefficient.
    runs: Vec<(Range<usize>, usize)>,
    phases: Vec<Weights>,
    count: usize,
}

impl Curve {
    /// Knots every `knots_s` s or the nearest number of samples, `period` s apart.
    pub(super) fn new(runs: &[Range<usize>], period: f64, knots_s: f64) -> Self {
        let step = (knots_s / period).round().max(1.0) as usize;
        let width = step as f64 * period;
        let phases = (0..step)
            .map(|phase| weights(phase as f64 / step as f64, width))
            .collect();
        let mut count = 0;
        let mut placed = Vec::with_capacity(runs.len());
        for run in runs {
            placed.push((run.clone(), count));
            count += run.len().saturating_sub(1) / step + LOCAL;
        }
        Self {
            step,
            runs: placed,
            phases,
            count,
        }
    }

    /// Number of coefficients.
    pub(super) fn len(&self) -> usize {
        self.count
    }

    /// Samples between knots.
    pub(super) fn step(&self) -> usize {
        self.step
    }

    /// Calls `f` with each run: its samples, in order.
    pub(super) fn runs(&self) -> impl Iterator<Item = &Range<usize>> {
        self.runs.iter().map(|(run, _)| run)
    }

    /// First coefficient and weights at each sample, run by run.
    pub(super) fn at_samples(&self) -> Vec<(usize, &Weights)> {
        let of_run = |(run, first): &(Range<usize>, usize)| {
            let first = *first;
            (0..run.len()).map(move |n| (first + n / self.step, &self.phases[n % self.step]))
        };
        self.runs.iter().flat_map(of_run).collect()
    }
}

/// Value, first and second derivative of the six functions at `u` of a piece `width` long.
fn weights(u: f64, width: f64) -> Weights {
    let of = |degree: usize| Basis::new(0.0, 1.0, 1, degree).evaluate(u).1;
    let [third, fourth, fifth] = [3, 4, 5].map(of);
    let at = |values: &[f64; 6], j: isize, degree: isize| {
        if (0..=degree).contains(&j) {
            values[j as usize]
        } else {
            0.0
        }
    };
    let mut out = [[0.0; LOCAL]; 3];
    for j in 0..LOCAL as isize {
        let i = j as usize;
        out[0][i] = fifth[i];
        out[1][i] = (at(&fourth, j - 1, 4) - at(&fourth, j, 4)) / width;
        out[2][i] =
            (at(&third, j - 2, 3) - 2.0 * at(&third, j - 1, 3) + at(&third, j, 3)) / width.powi(2);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_has_its_value_slope_and_curvature() {
        // With coefficients c_j = j^2 at even knots a B-spline curve of degree 5 is u^2 plus a constant, u counted in pieces.
        let width = 0.03;
        for u in [0.0, 0.25, 0.8] {
            let weights = weights(u, width);
            let sum = |k: usize| -> f64 {
                (0..LOCAL)
                    .map(|j| weights[k][j] * (j as f64 - 2.0).powi(2))
                    .sum()
            };
            assert!((sum(1) * width - 2.0 * u).abs() < 1e-12, "{u}");
            assert!((sum(2) * width * width - 2.0).abs() < 1e-12, "{u}");
            let constant = sum(0) - u * u;
            assert!((constant - 0.5).abs() < 1e-12, "{constant}");
        }
    }

    #[test]
    fn each_run_has_its_own_coefficients() {
        let curve = Curve::new(&[0..13, 13..19], 0.01, 0.03);
        assert_eq!(curve.step(), 3);
        assert_eq!(curve.len(), 4 + 6 + 1 + 6);
        let first: Vec<usize> = curve.at_samples().iter().map(|place| place.0).collect();
        assert_eq!(first.len(), 19);
        assert_eq!([first[12], first[13]], [4, 10]);
        assert_eq!(first[18] + LOCAL, curve.len());
    }
}
