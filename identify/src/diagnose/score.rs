//! Held-out errors of many candidate regressors on many efforts at once: the same normal matrices serve the measured effort
//! and every simulated one.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use crate::least_squares::rms;
use crate::products::{Table, dot, in_vectors, residual};

/// Blocks of strokes that are held out in turn: fold of each sample, and their number.
pub(super) type Folds = (Vec<usize>, usize);

/// The current model with one or many efforts.
pub(super) struct Problem<'a> {
    x: &'a [Vec<f64>],
    ys: &'a [Vec<f64>],
    /// The model's columns, and behind them the efforts.
    table: Table,
    /// By fold.
    gram: Vec<DMatrix<f64>>,
    /// By fold: products of the model's columns with the efforts.
    right: Vec<Many>,
    /// By fold: squares of the efforts.
    square: Vec<Vec<f64>>,
    samples: usize,
}

/// A candidate on one effort.
#[derive(Clone, Debug)]
pub(super) struct Outcome {
    /// Mean square error on held-out blocks.
    pub(super) mse: f64,
    /// Mean square error of the fit to all blocks.
    pub(super) fit: f64,
    /// Share of the blocks' squared error that each block has.
    pub(super) blocks: Vec<f64>,
    /// Estimates of the candidate's own columns over all blocks.
    pub(super) theta: Vec<f64>,
    /// Estimates of the current model's columns beside it.
    pub(super) rest: Vec<f64>,
}

impl<'a> Problem<'a> {
    pub(super) fn new(x: &'a [Vec<f64>], ys: &'a [Vec<f64>], folds: &'a Folds) -> Self {
        let (p, count) = (x.len(), folds.1);
        let all: Vec<&[f64]> = x.iter().chain(ys).map(Vec::as_slice).collect();
        let table = Table::new(all.into_iter(), folds);
        let mut gram = vec![DMatrix::zeros(p, p); count];
        let mut right = vec![Many::zeros(p, ys.len()); count];
        for (i, column) in x.iter().enumerate() {
            let products = table.products(column);
            for (fold, products) in products.chunks(p + ys.len()).enumerate() {
                for (j, value) in products[..p].iter().enumerate() {
                    gram[fold][(i, j)] = *value;
                }
                right[fold].row_mut(i).copy_from_slice(&products[p..]);
            }
        }
        let by_effort: Vec<Vec<f64>> = ys.iter().map(|y| table.by_fold(y, y)).collect();
        let of_fold = |fold: usize| by_effort.iter().map(|squares| squares[fold]).collect();
        let square = (0..count).map(of_fold).collect();
        Self {
            x,
            ys,
            table,
            gram,
            right,
            square,
            samples: folds.0.len(),
        }
    }

    /// The current model's columns.
    pub(super) fn columns(&self) -> &[Vec<f64>] {
        self.x
    }

    /// The measured effort.
    pub(super) fn effort(&self) -> &[f64] {
        &self.ys[0]
    }

    /// Independent samples: the fit's rate is four times the cut-off, twice what the band holds.
    pub(super) fn independent(&self) -> f64 {
        0.5 * self.samples as f64
    }

    /// The current model alone.
    pub(super) fn alone(&self) -> Option<Vec<Outcome>> {
        self.with(&[], self.ys.len())
    }

    /// The model with further columns, on the first `efforts` efforts; nothing when they add nothing new.
    pub(super) fn with(&self, columns: &[&[f64]], efforts: usize) -> Option<Vec<Outcome>> {
        self.scored(columns, efforts, true)
    }

    /// The model with further columns on the measured effort, new or not.
    pub(super) fn complete(&self, columns: &[&[f64]]) -> Option<Outcome> {
        self.scored(columns, 1, false)?.into_iter().next()
    }

    fn scored(&self, columns: &[&[f64]], efforts: usize, new: bool) -> Option<Vec<Outcome>> {
        let p = self.x.len();
        let (gram, right) = self.normal(columns, efforts);
        let all = sum(&gram);
        if new && !self.adds_something(&all, p) {
            return None;
        }
        let full = factor(&all)?;
        let parts: Vec<Cholesky<f64, Dyn>> = gram
            .iter()
            .map(|fold| {
                // What only the held-out block shows stays as all blocks have it.
                let mut rest = &all - fold;
                for i in 0..all.nrows() {
                    rest[(i, i)] += UNSEEN * all[(i, i)];
                }
                factor(&rest)
            })
            .collect::<Option<_>>()?;
        let mut together = Many::zeros(all.nrows(), efforts);
        for fold in &right {
            together.add(1.0, fold);
        }
        let mut theta = together.clone();
        theta.solve(&full);
        let seen = theta.scaled(all.diagonal().scale(UNSEEN).as_slice());
        // By fold, the mean square of each effort.
        let blocks: Vec<Vec<f64>> = (0..gram.len())
            .map(|fold| {
                let mut rest = together.clone();
                rest.add(-1.0, &right[fold]);
                rest.add(1.0, &seen);
                rest.solve(&parts[fold]);
                let (linear, quadratic) = (rest.dot(&right[fold]), rest.quadratic(&gram[fold]));
                let errors = linear.iter().zip(&quadratic).zip(&self.square[fold]);
                errors
                    .map(|((l, q), square)| (square - 2.0 * l + q).max(0.0) / self.samples as f64)
                    .collect()
            })
            .collect();
        let explained = theta.dot(&together);
        let outcomes = (0..efforts).map(|k| {
            let blocks: Vec<f64> = blocks.iter().map(|block| block[k]).collect();
            let square: f64 = self.square.iter().map(|fold| fold[k]).sum();
            let of = |rows: core::ops::Range<usize>| rows.map(|i| theta.row(i)[k]).collect();
            Outcome {
                mse: blocks.iter().sum(),
                fit: (square - explained[k]).max(0.0) / self.samples as f64,
                blocks,
                theta: of(p..all.nrows()),
                rest: of(0..p),
            }
        });
        Some(outcomes.collect())
    }

    /// By fold, the normal matrix with further columns, and its right sides for the first efforts.
    fn normal(&self, columns: &[&[f64]], efforts: usize) -> (Vec<DMatrix<f64>>, Vec<Many>) {
        let (p, total) = (self.x.len(), self.x.len() + columns.len());
        let folds = self.gram.iter().zip(&self.right);
        let (mut gram, mut right): (Vec<_>, Vec<_>) = folds
            .map(|(gram, right)| {
                let mut wider = Many::zeros(total, efforts);
                for i in 0..p {
                    wider.row_mut(i).copy_from_slice(&right.row(i)[..efforts]);
                }
                (gram.clone().resize(total, total, 0.0), wider)
            })
            .unzip();
        for (i, column) in columns.iter().enumerate() {
            let products = self.table.products(column);
            for (fold, products) in products.chunks(p + self.ys.len()).enumerate() {
                for (j, value) in products[..p].iter().enumerate() {
                    gram[fold][(p + i, j)] = *value;
                    gram[fold][(j, p + i)] = *value;
                }
                let own = right[fold].row_mut(p + i);
                own.copy_from_slice(&products[p..p + efforts]);
            }
            for (j, other) in columns[..=i].iter().enumerate() {
                for (gram, product) in gram.iter_mut().zip(self.table.by_fold(column, other)) {
                    gram[(p + i, p + j)] = product;
                    gram[(p + j, p + i)] = product;
                }
            }
        }
        (gram, right)
    }

    /// Whether each of the columns from `p` on has a part of its own.
    fn adds_something(&self, all: &DMatrix<f64>, p: usize) -> bool {
        let total = all.ncols();
        (p..total).all(|j| {
            let Some(factor) = factor(&all.view((0, 0), (j, j)).into_owned()) else {
                return false;
            };
            let cross = all.view((0, j), (j, 1)).into_owned();
            let own = all[(j, j)] - cross.dot(&factor.solve(&cross));
            own > 2e-4 * all[(j, j)] && all[(j, j)] > 0.0
        })
    }
}

/// Ridge of a fit to all blocks but one about the fit to all, as a share of each column's square: what many blocks show is
/// tested, what one alone shows (one stroke is fast enough to open a valve) is not made up from nothing.
const UNSEEN: f64 = 0.01;

/// Vectors side by side, one for each effort: entry `i` of all of them is row `i`.
#[derive(Clone)]
struct Many {
    values: Vec<f64>,
    count: usize,
}

impl Many {
    fn zeros(length: usize, count: usize) -> Self {
        Self {
            values: vec![0.0; length * count],
            count,
        }
    }

    fn row(&self, i: usize) -> &[f64] {
        &self.values[i * self.count..(i + 1) * self.count]
    }

    fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.values[i * self.count..(i + 1) * self.count]
    }

    fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.values.chunks_exact(self.count)
    }

    fn add(&mut self, times: f64, other: &Self) {
        add(&mut self.values, times, &other.values);
    }

    /// Row `i` times `factors[i]`.
    fn scaled(&self, factors: &[f64]) -> Self {
        let mut out = Self::zeros(factors.len(), self.count);
        for (i, factor) in factors.iter().enumerate() {
            add(out.row_mut(i), *factor, self.row(i));
        }
        out
    }

    /// Takes each vector to the solution with it on the right side.
    fn solve(&mut self, factor: &Cholesky<f64, Dyn>) {
        let lower = factor.l_dirty();
        let n = lower.nrows();
        in_vectors(
            #[inline(always)]
            || {
                for i in 0..n {
                    let (done, rest) = self.values.split_at_mut((i + 1) * self.count);
                    let own = &mut done[i * self.count..];
                    for value in own.iter_mut() {
                        *value /= lower[(i, i)];
                    }
                    for (k, row) in rest.chunks_exact_mut(self.count).enumerate() {
                        add_inline(row, -lower[(i + 1 + k, i)], own);
                    }
                }
                for i in (0..n).rev() {
                    let (before, done) = self.values.split_at_mut((i + 1) * self.count);
                    let own = &mut before[i * self.count..];
                    for (k, row) in done.chunks_exact(self.count).enumerate() {
                        add_inline(own, -lower[(i + 1 + k, i)], row);
                    }
                    for value in own.iter_mut() {
                        *value /= lower[(i, i)];
                    }
                }
            },
        );
    }

    /// Scalar product of each vector with its like in `other`.
    fn dot(&self, other: &Self) -> Vec<f64> {
        let mut out = vec![0.0; self.count];
        for (a, b) in self.rows().zip(other.rows()) {
            for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
                *out += a * b;
            }
        }
        out
    }

    /// `v' A v` of each vector.
    fn quadratic(&self, a: &DMatrix<f64>) -> Vec<f64> {
        let mut product = Self::zeros(a.nrows(), self.count);
        in_vectors(
            #[inline(always)]
            || {
                for i in 0..a.nrows() {
                    for (j, row) in self.values.chunks_exact(self.count).enumerate() {
                        add_inline(product.row_mut(i), a[(i, j)], row);
                    }
                }
            },
        );
        self.dot(&product)
    }
}

fn add(to: &mut [f64], times: f64, what: &[f64]) {
    in_vectors(
        #[inline(always)]
        || add_inline(to, times, what),
    );
}

#[inline(always)]
fn add_inline(to: &mut [f64], times: f64, what: &[f64]) {
    for (to, value) in to.iter_mut().zip(what) {
        *to += times * value;
    }
}

fn sum(parts: &[DMatrix<f64>]) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(parts[0].nrows(), parts[0].ncols());
    for part in parts {
        out += part;
    }
    out
}

/// The normal matrix of least squares, factored.
pub(super) fn factor(gram: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let mut gram = gram.clone();
    for i in 0..gram.ncols() {
        gram[(i, i)] *= 1.0 + 1e-9;
        gram[(i, i)] += 1e-12;
    }
    gram.cholesky()
}

/// Solves the least squares of `y` on `x`.
pub(super) fn solve(x: &[Vec<f64>], y: &[f64]) -> Option<Vec<f64>> {
    let right = DVector::from_fn(x.len(), |i, _| dot(&x[i], y));
    Some(factor(&gram(x))?.solve(&right).as_slice().to_vec())
}

/// What least squares on `x` leaves of `y`, rms.
pub(super) fn rms_beside(x: &[Vec<f64>], y: &[f64]) -> f64 {
    rms(&residual(y, x, &solve(x, y).unwrap_or_default()))
}

/// The normal matrix of least squares on `x`.
pub(super) fn gram(x: &[Vec<f64>]) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(x.len(), x.len());
    for i in 0..x.len() {
        for j in 0..=i {
            out[(i, j)] = dot(&x[i], &x[j]);
            out[(j, i)] = out[(i, j)];
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_is_scored_by_what_it_predicts_on_blocks_it_has_not_seen() {
        let n = 240;
        let wave = |f: f64| (0..n).map(|i| (f * i as f64).sin()).collect::<Vec<f64>>();
        let x = vec![wave(0.7)];
        let missing = wave(0.31);
        let y: Vec<f64> = x[0]
            .iter()
            .zip(&missing)
            .map(|(a, b)| 2.0 * a + 0.5 * b)
            .collect();
        let folds = ((0..n).map(|i| i / 40).collect(), 6);
        let ys = [y];
        let problem = Problem::new(&x, &ys, &folds);
        let before = problem.alone().unwrap()[0].mse;
        let right = &problem.with(&[&missing], 1).unwrap()[0];
        let wrong = &problem.with(&[&wave(1.1)], 1).unwrap()[0];
        assert!((before - 0.125).abs() < 0.01, "{before}");
        assert!(right.mse < 1e-9 && (right.theta[0] - 0.5).abs() < 1e-6);
        assert!(wrong.mse > 0.98 * before);
    }

    #[test]
    fn a_column_that_the_model_has_already_is_no_candidate() {
        let x = vec![
            (0..100).map(f64::from).collect::<Vec<f64>>(),
            vec![1.0; 100],
        ];
        let ys = [vec![1.0; 100]];
        let folds = ((0..100).map(|i| i % 4).collect(), 4);
        let again: Vec<f64> = x[0].iter().map(|v| 2.0 * v + 3.0).collect();
        assert!(Problem::new(&x, &ys, &folds).with(&[&again], 1).is_none());
    }
}
