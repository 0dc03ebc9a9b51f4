//! Uniform B-splines on an interval, and the difference penalty that makes them smooth (Eilers and Marx, P-splines, 1996).

use nalgebra::DMatrix;

/// Uniform B-splines of one degree over `[low, high]`.
///
/// The functions are non-negative and sum to one, so non-negative coefficients give a non-negative curve. Outside the
/// interval the argument is clamped: the curve goes on at its end value.
#[derive(Clone, Debug, PartialEq)]
pub struct Basis {
    low: f64,
    high: f64,
    intervals: usize,
    degree: usize,
}

impl Basis {
    /// Splines of `degree` (0 to 5) with `intervals` pieces over `[low, high]`.
    #[must_use]
    pub fn new(low: f64, high: f64, intervals: usize, degree: usize) -> Self {
        Self {
            low,
            high: high.max(low + f64::MIN_POSITIVE),
            intervals: intervals.max(1),
            degree: degree.min(5),
        }
    }

    /// Number of functions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.intervals + self.degree
    }

    /// Never: a basis has at least one function.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// The interval.
    #[must_use]
    pub fn interval(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    /// Degree of the pieces.
    #[must_use]
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Number of pieces.
    #[must_use]
    pub fn intervals(&self) -> usize {
        self.intervals
    }

    /// Where function `index` has its middle (outside the interval for the outermost).
    #[must_use]
    pub fn centre(&self, index: usize) -> f64 {
        let step = (self.high - self.low) / self.intervals as f64;
        self.low + step * (index as f64 - (self.degree as f64 - 1.0) / 2.0)
    }

    /// Index of the first function that is not zero at `x`, and the `degree + 1` values from there.
    #[inline]
    #[must_use]
    pub fn evaluate(&self, x: f64) -> (usize, [f64; 6]) {
        let scaled = ((x - self.low) / (self.high - self.low) * self.intervals as f64)
            .clamp(0.0, self.intervals as f64);
        let piece = (scaled as usize).min(self.intervals - 1);
        let u = scaled - piece as f64;
        let values = match self.degree {
            0 => functions::<0>(u),
            1 => functions::<1>(u),
            2 => functions::<2>(u),
            3 => functions::<3>(u),
            4 => functions::<4>(u),
            _ => functions::<5>(u),
        };
        (piece, values)
    }

    /// The curve with `coefficients` at `x`.
    #[must_use]
    pub fn value(&self, coefficients: &[f64], x: f64) -> f64 {
        let (first, values) = self.evaluate(x);
        values
            .iter()
            .take(self.degree + 1)
            .enumerate()
            .map(|(j, v)| v * coefficients.get(first + j).copied().unwrap_or(0.0))
            .sum()
    }

    /// `D'D` of the `order`-th differences of the coefficients.
    #[must_use]
    pub fn penalty(&self, order: usize) -> DMatrix<f64> {
        let mut difference = DMatrix::<f64>::identity(self.len(), self.len());
        for _ in 0..order.min(self.len() - 1) {
            let rows = difference.nrows() - 1;
            difference = difference.rows(1, rows) - difference.rows(0, rows);
        }
        difference.transpose() * difference
    }

    /// `D'WD` of the first differences of the coefficients, `weights` (one less than the functions) on the diagonal of W.
    #[must_use]
    pub fn weighted_penalty(&self, weights: &[f64]) -> DMatrix<f64> {
        let mut out = DMatrix::zeros(self.len(), self.len());
        for (i, weight) in weights.iter().enumerate().take(self.len() - 1) {
            out[(i, i)] += weight;
            out[(i + 1, i + 1)] += weight;
            out[(i, i + 1)] -= weight;
            out[(i + 1, i)] -= weight;
        }
        out
    }
}

/// The functions that are not zero on a piece, `u` (0 to 1) along it, by Cox and de Boor on unit knots: after round d, values[j] is
/// the degree-d function number j of this piece.
#[inline(always)]
fn functions<const DEGREE: usize>(u: f64) -> [f64; 6] {
    let mut values = [0.0; 6];
    values[0] = 1.0;
    for d in 1..=DEGREE {
        let mut carried = 0.0;
        for (j, value) in values.iter_mut().enumerate().take(d + 1) {
            let old = if j < d { *value } else { 0.0 };
            let old = old * (1.0 / d as f64);
            *value = carried + (j as f64 + 1.0 - u) * old;
            carried = (u + (d - 1 - j.min(d - 1)) as f64) * old;
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_functions_are_non_negative_and_sum_to_one(x in -2.0..5.0_f64, degree in 0_usize..=5, intervals in 1_usize..30) {
            let basis = Basis::new(-1.0, 3.0, intervals, degree);
            let (first, values) = basis.evaluate(x);
            prop_assert!(first + degree < basis.len());
            prop_assert!(values.iter().all(|v| *v >= -1e-15));
            prop_assert!((values.iter().take(degree + 1).sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn coefficients_at_the_centres_give_back_a_line() {
        for degree in 1..=5 {
            let basis = Basis::new(0.5, 2.5, 7, degree);
            let coefficients: Vec<f64> = (0..basis.len())
                .map(|j| 3.0 * basis.centre(j) - 1.0)
                .collect();
            for i in 0..=40 {
                let x = 0.5 + 0.05 * f64::from(i);
                assert!(
                    (basis.value(&coefficients, x) - (3.0 * x - 1.0)).abs() < 1e-12,
                    "degree {degree} at {x}"
                );
            }
        }
    }

    #[test]
    fn the_second_difference_penalty_is_blind_to_lines_only() {
        let basis = Basis::new(0.0, 1.0, 10, 3);
        let penalty = basis.penalty(2);
        let line = nalgebra::DVector::from_fn(basis.len(), |i, _| 2.0 + 0.3 * i as f64);
        assert!((&penalty * &line).norm() < 1e-12);
        let bend = line.map(|v| v * v);
        assert!((bend.transpose() * &penalty * &bend)[0] > 1e-3);
    }

    #[test]
    fn the_weighted_penalty_with_even_weights_is_the_plain_one_of_first_order() {
        let basis = Basis::new(0.0, 1.0, 9, 1);
        let even = vec![2.0; basis.len() - 1];
        assert!((basis.weighted_penalty(&even) - basis.penalty(1) * 2.0).norm() < 1e-12);
    }
}
