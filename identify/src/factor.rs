//! Cholesky's factor of a matrix in nalgebra's form, made by faer: from some tens of columns on it takes a fraction of the time.

use faer::linalg::solvers::{Llt, SolveCore};
use faer::{Conj, MatMut, MatRef, Side};
use nalgebra::DMatrix;

/// The factor of a symmetric positive definite matrix.
pub(crate) struct Factor(Llt<f64>);

impl Factor {
    /// Nothing where `matrix` is not positive definite or not finite.
    pub(crate) fn of(matrix: &DMatrix<f64>) -> Option<Self> {
        Self::of_columns(matrix.as_slice(), matrix.nrows())
    }

    /// As [`Factor::of`], of a matrix of `size` rows, column by column.
    pub(crate) fn of_columns(matrix: &[f64], size: usize) -> Option<Self> {
        let viewed = MatRef::from_column_major_slice(matrix, size, size);
        Llt::new(viewed, Side::Lower).ok().map(Self)
    }

    /// Rows of the matrix.
    pub(crate) fn size(&self) -> usize {
        self.0.L().nrows()
    }

    /// The inverse of the matrix times `right`.
    pub(crate) fn solve(&self, mut right: DMatrix<f64>) -> DMatrix<f64> {
        self.solve_in_place(right.as_mut_slice());
        right
    }

    /// Makes of the columns `right` the inverse of the matrix times them.
    pub(crate) fn solve_in_place(&self, right: &mut [f64]) {
        let columns = right.len().checked_div(self.size()).unwrap_or(0);
        let viewed = MatMut::from_column_major_slice_mut(right, self.size(), columns);
        self.0.solve_in_place_with_conj(Conj::No, viewed);
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
        let same = matrix.cholesky().unwrap();
        assert!((factor.solve(right.clone()) - same.solve(&right)).amax() < 1e-12);
        for (a, b) in factor.diagonal().zip(&same.l().diagonal()) {
            assert!((a - b).abs() < 1e-12, "{a} {b}");
        }
        assert_eq!(factor.solve(DMatrix::zeros(7, 0)).shape(), (7, 0));
    }

    #[test]
    fn what_is_not_positive_definite_has_none() {
        let ones = DMatrix::from_element(3, 3, 1.0);
        for diagonal in [-2.0, 0.0, f64::NAN, f64::INFINITY] {
            let matrix = &ones + DMatrix::from_diagonal_element(3, 3, diagonal);
            assert!(Factor::of(&matrix).is_none(), "{diagonal}");
        }
        let nothing = Factor::of(&DMatrix::zeros(0, 0)).unwrap();
        assert_eq!(nothing.solve(DMatrix::zeros(0, 2)).shape(), (0, 2));
    }
}
