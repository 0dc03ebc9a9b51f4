//! Normal equations of the shape that a motion and its dynamics give: a band for the motion's coefficients, which touch their
//! neighbours only, and a border for the parameters, which touch all of them.

use nalgebra::{DMatrix, DVector};

/// Columns of the border that are multiplied at a time.
const PIECE: usize = 4096;

/// `[B C; C' D] [x; theta] = [f; g]`, B banded.
#[derive(Clone, Debug)]
pub(super) struct Arrow {
    width: usize,
    params: usize,
    /// Row i holds B(i, i), B(i, i - 1), ... B(i, i - width).
    band: Vec<f64>,
    /// C', a column per coefficient.
    border: DMatrix<f64>,
    pub(super) corner: DMatrix<f64>,
    right: Vec<f64>,
    corner_right: DVector<f64>,
    /// Sum of the squared right sides of the rows.
    square: f64,
}

impl Arrow {
    /// Of `count` coefficients, each linked to `width` neighbours on either side, and `params` parameters; empty.
    pub(super) fn new(count: usize, width: usize, params: usize) -> Self {
        Self {
            width,
            params,
            band: vec![0.0; count * (width + 1)],
            border: DMatrix::zeros(params, count),
            corner: DMatrix::zeros(params, params),
            right: vec![0.0; count],
            corner_right: DVector::zeros(params),
            square: 0.0,
        }
    }

    /// Of the same coefficients with parameters, empty.
    pub(super) fn with_params(&self, params: usize) -> Self {
        Self::new(self.right.len(), self.width, params)
    }

    /// Adds the row `coefficients (from first on) x + params theta = right`.
    pub(super) fn add(
        &mut self,
        first: usize,
        coefficients: &[f64],
        params: &[(usize, f64)],
        right: f64,
    ) {
        let stride = self.width + 1;
        for (a, &va) in coefficients.iter().enumerate() {
            let i = first + a;
            for (back, &vb) in coefficients[..=a].iter().rev().enumerate() {
                self.band[i * stride + back] += va * vb;
            }
            for &(k, value) in params {
                self.border[(k, i)] += va * value;
            }
            self.right[i] += va * right;
        }
        for &(j, vj) in params {
            for &(k, vk) in params {
                self.corner[(j, k)] += vj * vk;
            }
            self.corner_right[j] += vj * right;
        }
        self.square += right * right;
    }

    /// `weight` times these, and `motion`, which knows of no parameters.
    pub(super) fn weighted_beside(mut self, weight: f64, motion: &Self) -> Self {
        let add = |a: &mut [f64], b: &[f64]| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = weight * *a + b);
        };
        add(&mut self.band, &motion.band);
        add(&mut self.right, &motion.right);
        self.border *= weight;
        self.corner *= weight;
        self.corner_right *= weight;
        self.square = weight * self.square + motion.square;
        self
    }

    /// Eliminates the band; nothing when it is not positive definite.
    pub(super) fn eliminate(mut self) -> Option<Eliminated> {
        let (stride, count) = (self.width + 1, self.right.len());
        let mut log_determinant = 0.0;
        for i in 0..count {
            let reach = self.width.min(i);
            for back in (0..=reach).rev() {
                let j = i - back;
                // What rows i and j share to the left of j.
                let shared = self.width.min(j).min(self.width - back);
                let mut sum = self.band[i * stride + back];
                for k in 1..=shared {
                    sum -= self.band[i * stride + back + k] * self.band[j * stride + k];
                }
                self.band[i * stride + back] = if back > 0 {
                    sum / self.band[j * stride]
                } else {
                    if sum <= 0.0 || !sum.is_finite() {
                        return None;
                    }
                    log_determinant += sum.ln();
                    sum.sqrt()
                };
            }
            let (diagonal, links) = (
                self.band[i * stride],
                &self.band[i * stride + 1..=i * stride + reach],
            );
            let params = self.params;
            let (before, here) = self.border.as_mut_slice().split_at_mut(i * params);
            let here = &mut here[..params];
            for (back, link) in links.iter().enumerate() {
                let j = i - 1 - back;
                let there = &before[j * params..(j + 1) * params];
                here.iter_mut().zip(there).for_each(|(a, b)| *a -= link * b);
                self.right[i] -= link * self.right[j];
            }
            here.iter_mut().for_each(|value| *value /= diagonal);
            self.right[i] /= diagonal;
        }
        let left = DVector::from_column_slice(&self.right);
        self.corner_right -= &self.border * &left;
        // Turned piece by piece: the border is most of the memory that this takes.
        for first in (0..count).step_by(PIECE) {
            let piece = self.border.columns(first, PIECE.min(count - first));
            self.corner -= piece * piece.transpose();
        }
        self.square -= left.norm_squared();
        Some(Eliminated {
            arrow: self,
            log_determinant,
        })
    }
}

/// The equations with the band eliminated: what is left for the parameters, and the way back.
#[derive(Clone, Debug)]
pub(super) struct Eliminated {
    arrow: Arrow,
    log_determinant: f64,
}

impl Eliminated {
    /// Normal matrix of the parameters alone.
    pub(super) fn corner(&self) -> &DMatrix<f64> {
        &self.arrow.corner
    }

    /// Right side of the parameters alone.
    pub(super) fn right(&self) -> &DVector<f64> {
        &self.arrow.corner_right
    }

    /// Logarithm of the determinant of the band.
    pub(super) fn log_determinant(&self) -> f64 {
        self.log_determinant
    }

    /// Sum of the squared residuals at parameters `theta` and the coefficients that go with them.
    pub(super) fn square_at(&self, theta: &DVector<f64>) -> f64 {
        let linear = 2.0 * self.arrow.corner_right.dot(theta);
        self.arrow.square - linear + theta.dot(&(&self.arrow.corner * theta))
    }

    /// What each coefficient changes by per parameter, a column per coefficient, with the sign turned round.
    pub(super) fn shares(self) -> DMatrix<f64> {
        let Arrow {
            width,
            params,
            band,
            mut border,
            ..
        } = self.arrow;
        back_substitute(&band, width, params, border.as_mut_slice());
        border
    }

    /// The coefficients that go with parameters `theta`.
    pub(super) fn coefficients(&self, theta: &DVector<f64>) -> Vec<f64> {
        let arrow = &self.arrow;
        let mut x: Vec<f64> = arrow
            .border
            .column_iter()
            .zip(&arrow.right)
            .map(|(border, right)| right - border.dot(theta))
            .collect();
        back_substitute(&arrow.band, arrow.width, 1, &mut x);
        x
    }
}

/// Solves the transposed band of `width` for right sides in place; `at_once` numbers of each coefficient lie one after the other.
fn back_substitute(band: &[f64], width: usize, at_once: usize, right: &mut [f64]) {
    let stride = width + 1;
    for i in (0..right.len() / at_once.max(1)).rev() {
        let (before, here) = right.split_at_mut(i * at_once);
        let here = &mut here[..at_once];
        here.iter_mut().for_each(|value| *value /= band[i * stride]);
        for back in 1..=width.min(i) {
            let link = band[i * stride + back];
            let there = &mut before[(i - back) * at_once..][..at_once];
            there
                .iter_mut()
                .zip(&*here)
                .for_each(|(a, b)| *a -= link * b);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deterministic numbers between -1 and 1.
    fn number(i: usize, j: usize) -> f64 {
        (((i * 7919 + j * 104_729 + 13) % 1000) as f64 / 500.0) - 1.0
    }

    #[test]
    fn it_solves_what_a_dense_solver_solves() {
        let (count, width, params, rows) = (12, 3, 2, 60);
        let mut arrow = Arrow::new(count, width, params);
        let mut dense = DMatrix::<f64>::zeros(rows, count + params);
        let mut right = DVector::<f64>::zeros(rows);
        for row in 0..rows {
            let first = (row * 5) % (count - width);
            let values: Vec<f64> = (0..=width).map(|j| number(row, j)).collect();
            let theta = [(0, number(row, 20)), (1, number(row, 21))];
            right[row] = number(row, 30);
            arrow.add(first, &values, &theta, right[row]);
            for (j, value) in values.iter().enumerate() {
                dense[(row, first + j)] = *value;
            }
            for (k, value) in theta {
                dense[(row, count + k)] = value;
            }
        }
        let expected = dense.clone().svd(true, true).solve(&right, 1e-12).unwrap();
        let eliminated = arrow.eliminate().unwrap();
        let theta = eliminated
            .corner()
            .clone()
            .cholesky()
            .unwrap()
            .solve(eliminated.right());
        let x = eliminated.coefficients(&theta);
        for (a, b) in x.iter().chain(theta.iter()).zip(expected.iter()) {
            assert!((a - b).abs() < 1e-9, "{a} {b}");
        }
        let shares = eliminated.clone().shares();
        for k in 0..params {
            let mut moved = theta.clone();
            moved[k] += 1.0;
            for (i, (moved, before)) in eliminated.coefficients(&moved).iter().zip(&x).enumerate() {
                assert!((before - moved - shares[(k, i)]).abs() < 1e-9, "{k} {i}");
            }
        }
        let square = (&right - &dense * &expected).norm_squared();
        assert!((eliminated.square_at(&theta) - square).abs() < 1e-9);
        let band = dense.columns(0, count).into_owned();
        let determinant = (band.transpose() * band).determinant().ln();
        assert!((eliminated.log_determinant() - determinant).abs() < 1e-8);
    }

    #[test]
    fn a_coefficient_without_a_row_is_no_solution() {
        let mut arrow = Arrow::new(3, 1, 0);
        arrow.add(0, &[1.0, 0.5], &[], 1.0);
        assert!(arrow.eliminate().is_none());
    }
}
