//! Held-out errors of many candidate regressors on many efforts at once: the same normal matrices serve the measured effort
//! and every simulated one.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Blocks of strokes that are held out in turn: fold of each sample, and their number.
pub(super) type Folds = (Vec<usize>, usize);

/// The current model with one or many efforts.
pub(super) struct Problem<'a> {
    x: &'a [Vec<f64>],
    ys: &'a [Vec<f64>],
    folds: &'a Folds,
    gram: Vec<DMatrix<f64>>,
    right: Vec<Vec<DVector<f64>>>,
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
        let mut gram = vec![DMatrix::zeros(p, p); count];
        for i in 0..p {
            for j in 0..=i {
                for (fold, value) in by_fold(&x[i], &x[j], folds).into_iter().enumerate() {
                    gram[fold][(i, j)] = value;
                    gram[fold][(j, i)] = value;
                }
            }
        }
        let right = ys
            .iter()
            .map(|y| {
                let mut out = vec![DVector::zeros(p); count];
                for (i, column) in x.iter().enumerate() {
                    for (fold, value) in by_fold(column, y, folds).into_iter().enumerate() {
                        out[fold][i] = value;
                    }
                }
                out
            })
            .collect();
        let square = ys.iter().map(|y| by_fold(y, y, folds)).collect();
        Self {
            x,
            ys,
            folds,
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
        let (p, m, count) = (self.x.len(), columns.len(), self.folds.1);
        let total = p + m;
        let mut gram: Vec<DMatrix<f64>> = self
            .gram
            .iter()
            .map(|old| {
                let mut new = DMatrix::zeros(total, total);
                new.view_mut((0, 0), (p, p)).copy_from(old);
                new
            })
            .collect();
        for (i, column) in columns.iter().enumerate() {
            for j in 0..p + i + 1 {
                let other: &[f64] = if j < p { &self.x[j] } else { columns[j - p] };
                for (fold, value) in by_fold(column, other, self.folds).into_iter().enumerate() {
                    gram[fold][(p + i, j)] = value;
                    gram[fold][(j, p + i)] = value;
                }
            }
        }
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
                for i in 0..total {
                    rest[(i, i)] += UNSEEN * all[(i, i)];
                }
                factor(&rest)
            })
            .collect::<Option<_>>()?;
        let outcomes = (0..efforts).map(|k| {
            let mut right = vec![DVector::zeros(total); count];
            for (fold, old) in right.iter_mut().zip(&self.right[k]) {
                fold.rows_mut(0, p).copy_from(old);
            }
            for (i, column) in columns.iter().enumerate() {
                for (fold, value) in by_fold(column, &self.ys[k], self.folds)
                    .into_iter()
                    .enumerate()
                {
                    right[fold][p + i] = value;
                }
            }
            let together = right
                .iter()
                .fold(DVector::zeros(total), |sum, part| sum + part);
            let theta = full.solve(&together);
            let blocks: Vec<f64> = (0..count)
                .map(|fold| {
                    let mut rest = &together - &right[fold];
                    for i in 0..total {
                        rest[i] += UNSEEN * all[(i, i)] * theta[i];
                    }
                    let theta = parts[fold].solve(&rest);
                    (self.square[k][fold] - 2.0 * theta.dot(&right[fold])
                        + theta.dot(&(&gram[fold] * &theta)))
                    .max(0.0)
                        / self.samples as f64
                })
                .collect();
            let square: f64 = self.square[k].iter().sum();
            Outcome {
                mse: blocks.iter().sum(),
                fit: (square - theta.dot(&together)).max(0.0) / self.samples as f64,
                blocks,
                theta: theta.as_slice()[p..].to_vec(),
                rest: theta.as_slice()[..p].to_vec(),
            }
        });
        Some(outcomes.collect())
    }

    /// Whether each of the columns from `p` on has a part of its own.
    fn adds_something(&self, all: &DMatrix<f64>, p: usize) -> bool {
        let total = all.ncols();
        (p..total).all(|j| {
            let others: Vec<usize> = (0..j).collect();
            let part = all.select_rows(&others).select_columns(&others);
            let Some(factor) = factor(&part) else {
                return false;
            };
            let cross = all.column(j).select_rows(&others);
            let own = all[(j, j)] - cross.dot(&factor.solve(&cross));
            own > 2e-4 * all[(j, j)] && all[(j, j)] > 0.0
        })
    }
}

/// Ridge of a fit to all blocks but one about the fit to all, as a share of each column's square: what many blocks show is
/// tested, what one alone shows (one stroke is fast enough to open a valve) is not made up from nothing.
const UNSEEN: f64 = 0.01;

/// Products of two columns, by fold.
fn by_fold(a: &[f64], b: &[f64], folds: &Folds) -> Vec<f64> {
    let mut out = vec![0.0; folds.1];
    for ((a, b), fold) in a.iter().zip(b).zip(&folds.0) {
        out[*fold] += a * b;
    }
    out
}

fn sum(parts: &[DMatrix<f64>]) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(parts[0].nrows(), parts[0].ncols());
    for part in parts {
        out += part;
    }
    out
}

fn factor(gram: &DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let mut gram = gram.clone();
    for i in 0..gram.ncols() {
        gram[(i, i)] *= 1.0 + 1e-9;
        gram[(i, i)] += 1e-12;
    }
    gram.cholesky()
}

/// Solves the least squares of `y` on `x`.
pub(super) fn solve(x: &[Vec<f64>], y: &[f64]) -> Option<Vec<f64>> {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let gram = DMatrix::from_fn(x.len(), x.len(), |i, j| dot(&x[i], &x[j]));
    let right = DVector::from_fn(x.len(), |i, _| dot(&x[i], y));
    Some(factor(&gram)?.solve(&right).as_slice().to_vec())
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
