//! Sums of products in vectors as wide as the processor has. They are added up in an order of their own, which is the same on every
//! processor.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::{Accum, MatMut, MatRef, Par};
use nalgebra::DMatrix;

/// Sums that are carried side by side.
pub(crate) const LANES: usize = 16;

/// Runs `f`, compiled for the widest vectors of the processor.
#[inline(always)]
pub(crate) fn in_vectors<R>(f: impl FnOnce() -> R) -> R {
    #[cfg(target_arch = "x86_64")]
    if let Some(wide) = pulp::x86::V3::try_new() {
        return wide.vectorize(f);
    }
    f()
}

/// The scalar product of `a` and `b`.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    in_vectors(
        #[inline(always)]
        || dot_inline(a, b),
    )
}

/// As [`dot`], for use inside of [`in_vectors`].
#[inline(always)]
pub(crate) fn dot_inline(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for ((sum, a), b) in sums.iter_mut().zip(a).zip(b) {
            *sum += a * b;
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    let mut half = LANES / 2;
    while half > 0 {
        let (low, high) = sums.split_at_mut(half);
        low.iter_mut().zip(high).for_each(|(a, b)| *a += *b);
        half /= 2;
    }
    sums[0] + rest
}

/// What the columns times their terms leave of `y`.
pub(crate) fn residual<'a>(
    y: &[f64],
    x: impl IntoIterator<Item = &'a Vec<f64>>,
    theta: &[f64],
) -> Vec<f64> {
    let mut left = y.to_vec();
    for (column, theta) in x.into_iter().zip(theta) {
        for (left, value) in left.iter_mut().zip(column) {
            *left -= theta * value;
        }
    }
    left
}

/// The sum of columns times their terms; empty without columns.
pub(crate) fn combine(x: &[Vec<f64>], theta: &[f64]) -> Vec<f64> {
    let mut out = vec![0.0; x.first().map_or(0, Vec::len)];
    for (column, theta) in x.iter().zip(theta) {
        for (out, value) in out.iter_mut().zip(column) {
            *out += theta * value;
        }
    }
    out
}

/// `y' y`.
pub(crate) fn gram(y: &DMatrix<f64>) -> DMatrix<f64> {
    let count = y.ncols();
    let mut out = DMatrix::zeros(count, count);
    triangular::matmul(
        MatMut::from_column_major_slice_mut(out.as_mut_slice(), count, count),
        BlockStructure::TriangularLower,
        Accum::Replace,
        viewed(y).transpose(),
        BlockStructure::Rectangular,
        viewed(y),
        BlockStructure::Rectangular,
        1.0,
        Par::Seq,
    );
    out.fill_upper_triangle_with_lower_triangle();
    out
}

/// `a' b`.
pub(crate) fn crossed(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    let mut out = DMatrix::zeros(a.ncols(), b.ncols());
    matmul(
        MatMut::from_column_major_slice_mut(out.as_mut_slice(), a.ncols(), b.ncols()),
        Accum::Replace,
        viewed(a).transpose(),
        viewed(b),
        1.0,
        Par::Seq,
    );
    out
}

fn viewed(matrix: &DMatrix<f64>) -> MatRef<'_, f64> {
    MatRef::from_column_major_slice(matrix.as_slice(), matrix.nrows(), matrix.ncols())
}

/// Columns side by side, for their products with others fold by fold.
pub(crate) struct Table {
    /// Blocks of columns; in each of them one row after the other.
    rows: Vec<[f64; LANES]>,
    columns: usize,
    /// Stretches of samples of one fold: the fold, and how many.
    stretches: Vec<(usize, usize)>,
    folds: usize,
}

impl Table {
    /// `folds` = fold of each sample, and their number.
    pub(crate) fn new<'a>(
        columns: impl ExactSizeIterator<Item = &'a [f64]>,
        (fold_of, folds): &(Vec<usize>, usize),
    ) -> Self {
        let (samples, count) = (fold_of.len(), columns.len());
        let mut rows = vec![[0.0; LANES]; samples * count.div_ceil(LANES)];
        for (j, column) in columns.enumerate() {
            let block = &mut rows[j / LANES * samples..];
            for (row, value) in block.iter_mut().zip(column) {
                row[j % LANES] = *value;
            }
        }
        let stretches = fold_of.chunk_by(|a, b| a == b);
        Self {
            rows,
            columns: count,
            stretches: stretches.map(|one| (one[0], one.len())).collect(),
            folds: *folds,
        }
    }

    /// Products of `other` with each column over the samples of each fold: those with all columns in the first fold come first.
    pub(crate) fn products(&self, other: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.folds * self.columns];
        if other.is_empty() {
            return out;
        }
        let mut sums = vec![[0.0; LANES]; self.folds];
        for (block, rows) in self.rows.chunks(other.len()).enumerate() {
            sums.fill([0.0; LANES]);
            in_vectors(
                #[inline(always)]
                || self.add(&mut sums, rows, other),
            );
            let first = block * LANES;
            let some = first..self.columns.min(first + LANES);
            for (out, sums) in out.chunks_exact_mut(self.columns).zip(&sums) {
                let out = &mut out[some.clone()];
                out.copy_from_slice(&sums[..out.len()]);
            }
        }
        out
    }

    /// Products of `a` and `b` over the samples of each fold.
    pub(crate) fn by_fold(&self, a: &[f64], b: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.folds];
        in_vectors(
            #[inline(always)]
            || {
                let mut from = 0;
                for &(fold, count) in &self.stretches {
                    let stretch = from..from + count;
                    out[fold] += dot_inline(&a[stretch.clone()], &b[stretch]);
                    from += count;
                }
            },
        );
        out
    }

    #[inline(always)]
    fn add(&self, sums: &mut [[f64; LANES]], mut rows: &[[f64; LANES]], mut other: &[f64]) {
        for &(fold, count) in &self.stretches {
            let (some, values);
            (some, rows) = rows.split_at(count);
            (values, other) = other.split_at(count);
            let mut sum = sums[fold];
            for (row, value) in some.iter().zip(values) {
                for (sum, entry) in sum.iter_mut().zip(row) {
                    *sum += entry * value;
                }
            }
            sums[fold] = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(n: usize, f: f64) -> Vec<f64> {
        (0..n).map(|i| (f * i as f64).sin()).collect()
    }

    #[test]
    fn the_scalar_product_is_that_of_a_plain_loop_at_any_length() {
        for n in 0..70 {
            let (a, b) = (wave(n, 0.7), wave(n, 0.31));
            let plain: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
            assert!((dot(&a, &b) - plain).abs() < 1e-13, "{n}");
        }
    }

    #[test]
    fn products_of_matrices_are_those_of_their_columns() {
        let matrix = |columns: usize, f: f64| {
            let values: Vec<f64> = (0..columns)
                .flat_map(|j| wave(50, f + 0.2 * j as f64))
                .collect();
            DMatrix::from_vec(50, columns, values)
        };
        let (a, b) = (matrix(21, 0.3), matrix(5, 0.4));
        assert!((gram(&a) - a.transpose() * &a).amax() < 1e-12);
        assert!((crossed(&a, &b) - a.transpose() * &b).amax() < 1e-12);
        assert_eq!(gram(&DMatrix::zeros(9, 0)).shape(), (0, 0));
    }

    #[test]
    fn products_with_a_table_are_those_of_each_fold() {
        let n = 100;
        let folds: (Vec<usize>, usize) = ((0..n).map(|i| i / 7 % 3).collect(), 3);
        let columns: Vec<Vec<f64>> = (0..21).map(|j| wave(n, 0.1 + 0.07 * j as f64)).collect();
        let other = wave(n, 0.9);
        let table = Table::new(columns.iter().map(Vec::as_slice), &folds);
        let products = table.products(&other);
        for (j, column) in columns.iter().enumerate() {
            for fold in 0..3 {
                let plain: f64 = (0..n)
                    .filter(|&i| folds.0[i] == fold)
                    .map(|i| column[i] * other[i])
                    .sum();
                let value = products[fold * columns.len() + j];
                assert!((value - plain).abs() < 1e-13, "{j} {fold}");
                assert!((table.by_fold(column, &other)[fold] - plain).abs() < 1e-13);
            }
        }
    }
}
