//! Minimum of a convex quadratic with some variables non-negative, by active set.
//!
//! # Source
//! Lawson and Hanson, *Solving Least Squares Problems*, 1974, chapter 23, written for the normal matrix.

use nalgebra::{DMatrix, DVector};

use crate::factor::Factor;
use crate::products::in_vectors;

/// What a parameter may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bound {
    /// Any value.
    Free,
    /// Zero or more.
    NonNegative,
}

/// Minimizes `x' H x / 2 - f' x` with the bounds; `start` names the variables first taken as not at their bound.
///
/// `H` is symmetric and positive definite on the variables that end up free; where it is singular a variable stays at
/// its bound. The result keeps the Karush-Kuhn-Tucker conditions to rounding: bounded variables are >= 0, those at zero
/// have a gradient >= 0.
#[must_use]
pub fn bounded_quadratic(
    h: &DMatrix<f64>,
    f: &DVector<f64>,
    bounds: &[Bound],
    start: Option<&[bool]>,
) -> DVector<f64> {
    Quadratic::new(h).minimum(f, bounds, start, |_| false)
}

/// Quadratics of one matrix `H`.
pub(crate) struct Quadratic<'a> {
    h: &'a DMatrix<f64>,
    /// The variables that were free last, and the factor of their part of `H`.
    last: Option<(Vec<usize>, Factor)>,
}

impl<'a> Quadratic<'a> {
    pub(crate) const fn new(h: &'a DMatrix<f64>) -> Self {
        Self { h, last: None }
    }

    /// As [`bounded_quadratic`], with zero for the variables that are `out`.
    pub(crate) fn minimum(
        &mut self,
        f: &DVector<f64>,
        bounds: &[Bound],
        start: Option<&[bool]>,
        out: impl Fn(usize) -> bool,
    ) -> DVector<f64> {
        let n = f.len();
        let bounded = |j: usize| bounds.get(j) == Some(&Bound::NonNegative) && !out(j);
        let mut free: Vec<bool> = (0..n)
            .map(|j| !out(j) && (!bounded(j) || start.is_some_and(|s| s[j])))
            .collect();
        if let Some(x) = self.exchanged(f, &bounded, &mut free) {
            return x;
        }
        // A warm start may be infeasible: drop what comes out negative until it is not.
        let mut x = loop {
            let candidate = self.solve_free(f, &mut free);
            let negative: Vec<usize> = (0..n)
                .filter(|&j| free[j] && bounded(j) && candidate[j] <= 0.0)
                .collect();
            if negative.is_empty() {
                break candidate;
            }
            for j in negative {
                free[j] = false;
            }
        };
        let tolerance = 1e-10 * f.amax().max(f64::MIN_POSITIVE);
        let mut banned = vec![false; n];
        for _ in 0..6 * n + 20 {
            let gradient = left(self.h, f, &x);
            let entering = (0..n)
                .filter(|&j| !free[j] && !out(j) && !banned[j] && gradient[j] > tolerance)
                .max_by(|&a, &b| gradient[a].total_cmp(&gradient[b]));
            let Some(entering) = entering else { break };
            free[entering] = true;
            let before = x.clone();
            self.step_to_feasible(f, &mut free, &mut x, &bounded);
            // Singular or degenerate: the variable fell straight back; do not try it again before something else moved.
            if free[entering] {
                banned.fill(false);
            } else {
                banned[entering] = true;
                if (&x - &before).amax() > 0.0 {
                    banned.fill(false);
                    banned[entering] = true;
                }
            }
        }
        x
    }

    /// All variables on the wrong side change sides at once, as long as there are ever fewer of them (Portugal, Judice and
    /// Vicente, 1994). A few factorizations instead of one per variable; `None` when it does not settle, `free` is then a start
    /// for the careful way.
    fn exchanged(
        &mut self,
        f: &DVector<f64>,
        bounded: &impl Fn(usize) -> bool,
        free: &mut [bool],
    ) -> Option<DVector<f64>> {
        const PATIENCE: usize = 4;
        let n = f.len();
        let tolerance = 1e-10 * f.amax().max(f64::MIN_POSITIVE);
        let (mut fewest, mut patience) = (usize::MAX, PATIENCE);
        for _ in 0..60 {
            let before = free.to_vec();
            let x = self.solve_free(f, free);
            if before != *free {
                return None;
            }
            let gradient = left(self.h, f, &x);
            let wrong: Vec<usize> = (0..n)
                .filter(|&j| {
                    bounded(j)
                        && if free[j] {
                            x[j] <= 0.0
                        } else {
                            gradient[j] > tolerance
                        }
                })
                .collect();
            if wrong.is_empty() {
                return Some(x);
            }
            if wrong.len() < fewest {
                (fewest, patience) = (wrong.len(), PATIENCE);
            } else if patience == 0 {
                return None;
            } else {
                patience -= 1;
            }
            for j in wrong {
                free[j] = !free[j];
            }
        }
        None
    }

    /// Lawson and Hanson's inner loop: go to the unconstrained optimum of the free set, or as far as the bounds let.
    fn step_to_feasible(
        &mut self,
        f: &DVector<f64>,
        free: &mut [bool],
        x: &mut DVector<f64>,
        bounded: &impl Fn(usize) -> bool,
    ) {
        for _ in 0..=free.len() {
            let target = self.solve_free(f, free);
            let blocking = |j: usize| free[j] && bounded(j) && target[j] <= 0.0;
            let step = (0..x.len())
                .filter(|&j| blocking(j))
                .map(|j| x[j] / (x[j] - target[j]).max(f64::MIN_POSITIVE))
                .fold(f64::INFINITY, f64::min);
            if step.is_infinite() {
                *x = target;
                return;
            }
            let leaving: Vec<usize> = (0..x.len())
                .filter(|&j| {
                    blocking(j)
                        && x[j] / (x[j] - target[j]).max(f64::MIN_POSITIVE) <= step * (1.0 + 1e-12)
                })
                .collect();
            for j in 0..x.len() {
                x[j] = if free[j] {
                    x[j] + step.min(1.0) * (target[j] - x[j])
                } else {
                    0.0
                };
            }
            for j in leaving {
                free[j] = false;
                x[j] = 0.0;
            }
        }
    }

    /// The optimum over the free variables, zero elsewhere. Variables that make the matrix singular are taken out.
    fn solve_free(&mut self, f: &DVector<f64>, free: &mut [bool]) -> DVector<f64> {
        let index: Vec<usize> = (0..f.len()).filter(|&j| free[j]).collect();
        let mut x = DVector::zeros(f.len());
        if index.is_empty() {
            return x;
        }
        if self.last.as_ref().is_none_or(|(last, _)| *last != index) {
            let diagonal = index.iter().map(|&j| self.h[(j, j)].abs());
            let ridge = 1e-13 * diagonal.fold(0.0, f64::max);
            let Some(factor) = factor(self.h, &index, ridge) else {
                // Not even then: leave out the last variable that came in without diagonal weight.
                for &j in &index {
                    if self.h[(j, j)] <= ridge {
                        free[j] = false;
                    }
                }
                return x;
            };
            self.last = Some((index, factor));
        }
        let Some((index, factor)) = &self.last else {
            return x;
        };
        let solved = |right: &DVector<f64>| {
            let mut picked: Vec<f64> = index.iter().map(|&j| right[j]).collect();
            factor.solve_in_place(&mut picked);
            picked
        };
        for (&j, value) in index.iter().zip(solved(f)) {
            x[j] = value;
        }
        // One refinement step takes the ridge's bias away.
        let rest = left(self.h, f, &x);
        for (&j, correction) in index.iter().zip(solved(&rest)) {
            x[j] += correction;
        }
        x
    }
}

/// The factor of the part of `h` that `index` names, with a ridge; nothing where that is not positive definite.
fn factor(h: &DMatrix<f64>, index: &[usize], ridge: f64) -> Option<Factor> {
    let n = index.len();
    let mut steadied = Vec::with_capacity(n * n);
    for (k, &j) in index.iter().enumerate() {
        let column = &h.as_slice()[j * h.nrows()..][..h.nrows()];
        steadied.extend(index.iter().map(|&i| column[i]));
        steadied[k * n + k] += ridge;
    }
    Factor::of_columns(&steadied, n)
}

/// `f - h x`.
fn left(h: &DMatrix<f64>, f: &DVector<f64>, x: &DVector<f64>) -> DVector<f64> {
    let mut out = f.clone();
    if h.nrows() == 0 {
        return out;
    }
    in_vectors(
        #[inline(always)]
        || {
            let out = out.as_mut_slice();
            for (column, x) in h.as_slice().chunks_exact(out.len()).zip(x.iter()) {
                if *x != 0.0 {
                    for (out, entry) in out.iter_mut().zip(column) {
                        *out -= entry * x;
                    }
                }
            }
        },
    );
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn problem(seed: u64, n: usize) -> (DMatrix<f64>, DVector<f64>, Vec<Bound>) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let y = DMatrix::from_fn(3 * n, n, |_, _| StandardNormal.sample(&mut rng));
        let tau = DVector::from_fn(3 * n, |_, _| StandardNormal.sample(&mut rng));
        let bounds = (0..n)
            .map(|j| {
                if j % 3 == 0 {
                    Bound::Free
                } else {
                    Bound::NonNegative
                }
            })
            .collect();
        (y.transpose() * &y, y.transpose() * tau, bounds)
    }

    proptest! {
        #[test]
        fn the_solution_keeps_the_optimality_conditions(seed in 0_u64..1000, n in 1_usize..20, warm in any::<bool>()) {
            let (h, f, bounds) = problem(seed, n);
            let start = vec![true; n];
            let x = bounded_quadratic(&h, &f, &bounds, warm.then_some(start.as_slice()));
            let gradient = &h * &x - &f;
            let small = 1e-8 * f.amax();
            for j in 0..n {
                match bounds[j] {
                    Bound::Free => prop_assert!(gradient[j].abs() < small),
                    Bound::NonNegative => {
                        prop_assert!(x[j] >= 0.0 && gradient[j] > -small);
                        prop_assert!((x[j] * gradient[j]).abs() < small * (1.0 + x[j]));
                    }
                }
            }
        }
    }

    #[test]
    fn a_second_minimum_of_the_same_matrix_is_that_of_a_first() {
        let (h, f, bounds) = problem(7, 12);
        let mut twice = Quadratic::new(&h);
        let first = twice.minimum(&f, &bounds, None, |_| false);
        let out = |j: usize| j % 4 == 3 || first[j] == 0.0;
        let rest: Vec<usize> = (0..12).filter(|&j| !out(j)).collect();
        let part = h.select_rows(&rest).select_columns(&rest);
        let kinds: Vec<Bound> = rest.iter().map(|&j| bounds[j]).collect();
        for other in [f.clone(), &f * 2.0, -&f] {
            let start = [true; 12];
            let again = twice.minimum(&other, &bounds, Some(&start), out);
            let alone = bounded_quadratic(&part, &other.select_rows(&rest), &kinds, None);
            assert!((again.select_rows(&rest) - alone).amax() < 1e-9 * f.amax());
            assert!((0..12).all(|j| !out(j) || again[j] == 0.0));
        }
    }

    #[test]
    fn two_equal_columns_share_or_leave_but_never_break() {
        let y = DMatrix::from_fn(10, 2, |i, _| 1.0 + i as f64);
        let tau = DVector::from_fn(10, |i, _| 2.0 * (1.0 + i as f64));
        let x = bounded_quadratic(
            &(y.transpose() * &y),
            &(y.transpose() * &tau),
            &[Bound::NonNegative; 2],
            None,
        );
        assert!(x.iter().all(|v| *v >= 0.0));
        assert!((x.sum() - 2.0).abs() < 1e-9);
    }
}
