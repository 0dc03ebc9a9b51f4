//! Cholesky's factor of a matrix in nalgebra's form, made by faer: from some tens of columns on it takes a fraction of the time.

use faer::linalg::solvers::{Llt, SolveCore};
use faer::{Conj, MatMut, MatRef, Side};
use nalgebra::DMatrix;

/// The factor of a symmetric positive definite matrix.
pub(crate) struct Factor(Llt<f64>);

impl Factor {
    /// Nothing where `matrix` is not positive definite.
    pub(crate) fn of(matrix: &DMatrix<f64>) -> Option<Self> {
        let n = matrix.nrows();
        let viewed = MatRef::from_column_major_slice(matrix.as_slice(), n, n);
        Llt::new(viewed, Side::Lower).ok().map(Self)
    }

    /// The inverse of the matrix times `right`.
    pub(crate) fn solve(&self, right: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = right.clone();
        let (rows, columns) = out.shape();
        let viewed = MatMut::from_column_major_slice_mut(out.as_mut_slice(), rows, columns);
        self.0.solve_in_place_with_conj(Conj::No, viewed);
        out
    }

    /// Rows of the matrix.
    pub(crate) fn size(&self) -> usize {
        self.0.L().nrows()
    }

    /// The diagonal of the factor.
    pub(crate) fn diagonal(&self) -> impl Iterator<Item = f64> {
        let lower = self.0.L();
        (0..lower.nrows()).map(move |j| lower[(j, j)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_that_of_nalgebra() {
        let part = DMatrix::from_fn(9, 7, |i, j| ((3 * i + 5 * j) as f64).sin());
        let matrix = part.tr_mul(&part) + DMatrix::identity(7, 7);
        let right = DMatrix::from_fn(7, 3, |i, j| (i as f64 - j as f64).cos());
        let factor = Factor::of(&matrix).unwrap();
        let same = matrix.clone().cholesky().unwrap();
        assert!((factor.solve(&right) - same.solve(&right)).amax() < 1e-12);
        let diagonals = factor.diagonal().zip(
            same.l_dirty()
                .diagonal()
                .iter()
                .copied()
                .collect::<Vec<_>>(),
        );
        for (a, b) in diagonals {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
        assert!(Factor::of(&(matrix - DMatrix::identity(7, 7) * 50.0)).is_none());
    }
}
