//! The regressor matrix with its folds, penalties and bounds.

use nalgebra::{DMatrix, DVector};

use super::DynamicsError;
use super::left_out::{self, LeftOut};
use crate::effect::{Column, Effect};
use crate::least_squares::{
    Bound, FitError, Quadratic, bounded_quadratic, covariance_of_free, effective_count,
};
use crate::mechanism::{Linearised, OnMotion, SplineMechanism};
use crate::motion::Motion;
use crate::parallel::in_parallel;
use crate::products::gram;

/// `tau = y [theta, mechanism coefficients]`.
#[derive(Clone)]
pub(super) struct Design {
    pub(super) y: DMatrix<f64>,
    pub(super) tau: DVector<f64>,
    pub(super) bounds: Vec<Bound>,
    pub(super) names: Vec<&'static str>,
    pub(super) units: Vec<String>,
    /// Number of parametric columns, which come first.
    pub(super) params: usize,
    /// Number of columns that may be used: those behind have no part in the effort.
    open: usize,
    pub(super) folds: (Vec<usize>, usize),
    /// Samples that count for held-out errors.
    pub(super) scored: Vec<bool>,
    pub(super) gram: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    pub(super) penalties: Vec<DMatrix<f64>>,
    scale: DVector<f64>,
    /// What a coefficient of the damping must gain before it is let in; zero for all others.
    threshold: DVector<f64>,
}

/// Held-out errors keep so much of the weight of what they leave out: what nothing else shows is then no number at random.
pub(super) const LEFT: f64 = 1e-4;

/// A coefficient of the damping is let in when it moves the effort by more than so many standard deviations of its own.
const DAMPING_EVIDENCE: f64 = 0.8;

/// Relative smoothing of load and damping that the search tries.
pub(super) const LOAD_GRID: [f64; 7] = [1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 100.0];
const DAMPING_GRID: [f64; 5] = [1e-3, 1e-2, 0.1, 1.0, 100.0];
/// Smoothing that it begins with.
pub(super) const MIDDLING: [f64; 2] = [0.01, 0.1];

impl Design {
    /// The columns of `effects` and the mechanism on a prepared motion.
    pub(super) fn new(
        motion: &Motion,
        effects: &[&dyn Effect],
        mechanism: Option<&SplineMechanism>,
    ) -> Result<Self, DynamicsError> {
        let mut columns = Vec::new();
        for effect in effects {
            columns.extend(effect.columns(motion)?);
        }
        let tau = motion.regressor(&motion.tau)?;
        let mut design = Self::of_columns(columns, tau, motion.folds())?;
        design.scored = motion.covered();
        if let Some(mechanism) = mechanism {
            design = design.with_surfaces(motion, mechanism);
        }
        design.check()?;
        Ok(design)
    }

    /// This design's parameters with a mechanism as surfaces, which are linear; only damping that the data ask for is let in.
    pub(super) fn with_surfaces(&self, motion: &Motion, mechanism: &SplineMechanism) -> Self {
        let on = mechanism.on(motion);
        let mut design = self.near(mechanism, &on, &mechanism.linearised(motion, &on));
        design.set_threshold();
        design
    }

    /// This design's parameters with a mechanism near the coefficients it has, all of its damping let in.
    pub(super) fn near(
        &self,
        mechanism: &SplineMechanism,
        on: &OnMotion,
        effort: &Linearised,
    ) -> Self {
        let (params, total) = (self.params, self.params + mechanism.len());
        let parts = [&self.y, &on.load, &effort.damping].map(DMatrix::as_slice);
        let y = DMatrix::from_vec(self.y.nrows(), total, parts.concat());
        let tau = &self.tau - DVector::from_column_slice(&effort.rest);
        let (gram, right) = normal(&y, &tau);
        let mut bounds = self.bounds.clone();
        bounds.extend(mechanism.bounds());
        let mut design = Self {
            y,
            tau,
            bounds,
            names: self.names.clone(),
            units: self.units.clone(),
            params,
            open: total,
            folds: self.folds.clone(),
            scored: self.scored.clone(),
            gram,
            right,
            penalties: Vec::new(),
            scale: self.scale.clone().resize_vertically(total, 1.0),
            threshold: DVector::zeros(total),
        };
        design.weigh_as(mechanism);
        design
    }

    /// Takes the penalties that `mechanism` has with the coefficients it has now.
    pub(super) fn weigh_as(&mut self, mechanism: &SplineMechanism) {
        let (params, total) = (self.params, self.y.ncols());
        let whole = mechanism.penalties().map(|penalty| {
            let mut full = DMatrix::zeros(total, total);
            full.view_mut((params, params), penalty.shape())
                .copy_from(&penalty);
            full
        });
        self.penalties = whole.to_vec();
    }

    /// Columns without a mechanism; `folds` = fold of each sample and their number.
    pub(super) fn of_columns(
        columns: Vec<Column>,
        tau: Vec<f64>,
        folds: (Vec<usize>, usize),
    ) -> Result<Self, DynamicsError> {
        let (params, samples) = (columns.len(), tau.len());
        let needed = 3 * params + 10;
        if samples < needed {
            return Err(FitError::TooFewSamples {
                samples,
                params,
                needed,
            }
            .into());
        }
        let mut y = DMatrix::zeros(samples, params);
        for (j, column) in columns.iter().enumerate() {
            y.column_mut(j).copy_from_slice(&column.values);
        }
        let scale = DVector::from_fn(params, |j, _| y.column(j).norm().max(1e-12));
        let tau = DVector::from_vec(tau);
        let (gram, right) = normal(&y, &tau);
        let bounds = columns.iter().map(|column| column.bound).collect();
        let names = columns.iter().map(|column| column.name).collect();
        let units = columns.into_iter().map(|column| column.unit).collect();
        let design = Self {
            y,
            tau,
            bounds,
            names,
            units,
            params,
            open: params,
            scored: vec![true; folds.0.len()],
            folds,
            gram,
            right,
            penalties: Vec::new(),
            threshold: DVector::zeros(params),
            scale,
        };
        design.check()?;
        Ok(design)
    }

    /// Effort of the damping of a solution over the measured effort, both as root mean squares.
    pub(super) fn damping_share(&self, mut solution: DVector<f64>) -> f64 {
        for j in 0..solution.len() {
            if j < self.params || self.bounds[j] == Bound::Free {
                solution[j] = 0.0;
            }
        }
        (&self.y * solution).norm() / self.tau.norm().max(f64::MIN_POSITIVE)
    }

    /// The threshold from the residual of a fit without one.
    fn set_threshold(&mut self) {
        let h = self.penalized(&self.gram, &MIDDLING, 1.0);
        let x = bounded_quadratic(
            &self.scaled(&h),
            &self.right.component_div(&self.scale),
            &self.bounds,
            None,
        );
        let residual = &self.tau - &self.y * x.component_div(&self.scale);
        let samples = self.tau.len() as f64;
        let independent = effective_count(residual.as_slice()).max(1.0);
        let sigma = (residual.norm_squared() / samples).sqrt() * (samples / independent).sqrt();
        for j in self.params..self.y.ncols() {
            if self.bounds[j] == Bound::NonNegative {
                self.threshold[j] = DAMPING_EVIDENCE * sigma * self.gram[(j, j)].sqrt();
            }
        }
    }

    /// The same design with none of the mechanism's damping let in.
    pub(super) fn undamped(&self) -> Self {
        let mechanism = self.bounds[self.params..].iter();
        let loads = mechanism.take_while(|bound| **bound == Bound::Free).count();
        Self {
            open: self.params + loads,
            ..self.clone()
        }
    }

    fn check(&self) -> Result<(), DynamicsError> {
        let bad =
            |i: &usize| !self.tau[*i].is_finite() || self.y.row(*i).iter().any(|v| !v.is_finite());
        if let Some(row) = (0..self.tau.len()).find(bad) {
            return Err(FitError::NotFinite { row }.into());
        }
        let (rank, _) = self.rank_and_condition();
        if rank < self.params {
            return Err(FitError::RankDeficient {
                rank,
                params: self.params,
            }
            .into());
        }
        Ok(())
    }

    /// Rank and condition of the parametric columns, each scaled to length 1.
    pub(super) fn rank_and_condition(&self) -> (usize, f64) {
        if self.params == 0 {
            return (0, 1.0);
        }
        let part = DMatrix::from_fn(self.params, self.params, |i, j| {
            self.gram[(i, j)] / (self.scale[i] * self.scale[j])
        });
        let eigen = part.symmetric_eigenvalues();
        let (largest, smallest) = (eigen.max(), eigen.min().max(0.0));
        let rank = eigen.iter().filter(|v| **v > 1e-12 * largest).count();
        (rank, (largest / smallest).sqrt())
    }

    /// Smoothing with the least held-out error, and that error. One strength after the other, twice.
    pub(super) fn choose_smoothing(&self, folds: &[Fold]) -> ([f64; 2], f64) {
        self.choose_among(folds, MIDDLING, [&LOAD_GRID, &DAMPING_GRID])
    }

    /// As [`Design::choose_smoothing`], of the load only.
    pub(super) fn choose_load(&self, folds: &[Fold], start: [f64; 2]) -> ([f64; 2], f64) {
        self.choose_among(folds, start, [&LOAD_GRID, &[]])
    }

    /// As [`Design::choose_smoothing`], from `start` on, among the values given for load and damping.
    pub(super) fn choose_among(
        &self,
        folds: &[Fold],
        start: [f64; 2],
        grids: [&[f64]; 2],
    ) -> ([f64; 2], f64) {
        let whole = self.penalized(&self.gram, &start, 1.0);
        let whole = self.minimum(&whole, &self.right, 1.0, None);
        let warm: Vec<bool> = whole.iter().map(|v| *v != 0.0).collect();
        let mut best = (start, f64::INFINITY);
        let mut known: Vec<([f64; 2], f64)> = Vec::new();
        let turns: &[usize] = if grids[1].is_empty() {
            &[0]
        } else {
            &[0, 1, 0]
        };
        for &grid in turns {
            let with = |value: &f64| {
                let mut smoothing = best.0;
                smoothing[grid] = *value;
                smoothing
            };
            let tried: Vec<[f64; 2]> = grids[grid]
                .iter()
                .map(with)
                .filter(|smoothing| known.iter().all(|(tried, _)| tried != smoothing))
                .collect();
            let errors = in_parallel(&tried, |smoothing| {
                self.held_out_of(folds, smoothing, Some(&warm))
            });
            for (smoothing, error) in tried.into_iter().zip(errors) {
                known.push((smoothing, error));
                if error < best.1 {
                    best = (smoothing, error);
                }
            }
        }
        best
    }

    /// Held-out root mean square error with one smoothing.
    pub(super) fn held_out(&self, smoothing: &[f64; 2]) -> f64 {
        self.held_out_of(&self.fold_normals(), smoothing, None)
    }

    /// Parameters with one smoothing.
    pub(super) fn solve(&self, smoothing: &[f64; 2]) -> DVector<f64> {
        let h = self.penalized(&self.gram, smoothing, 1.0);
        self.minimum(&h, &self.right, 1.0, None)
    }

    /// Covariance of the parametric ones of `solution`, by what each stretch of the recording moves them; what of the mechanism is at a
    /// bound stays there.
    pub(super) fn covariance(
        &self,
        motion: &Motion,
        solution: &DVector<f64>,
        smoothing: &[f64; 2],
    ) -> DMatrix<f64> {
        let free: Vec<usize> = (0..solution.len())
            .filter(|&j| j < self.params || self.bounds[j] == Bound::Free || solution[j] != 0.0)
            .collect();
        let h = self.scaled(&self.penalized(&self.gram, smoothing, 1.0));
        let h = h.select_rows(&free).select_columns(&free);
        let residual = &self.tau - &self.y * solution;
        let mut left_out = LeftOut::new(&h, self.params);
        left_out.leave_out_each(left_out::blocks(motion), |block| {
            let mut rows = self.y.rows_range(block.clone()).select_columns(&free);
            for (&j, mut column) in free.iter().zip(rows.column_iter_mut()) {
                column /= self.scale[j];
            }
            (rows, &residual.as_slice()[block])
        });
        self.unscaled(&left_out.covariance())
    }

    /// The inverse of the normal matrix with one smoothing, zero where a coefficient is at its bound.
    pub(super) fn inverse_of_free(&self, smoothing: &[f64; 2]) -> DMatrix<f64> {
        let h = self.penalized(&self.gram, smoothing, 1.0);
        let solution = self.minimum(&h, &self.right, 1.0, None);
        let at_bound: Vec<bool> = (0..solution.len())
            .map(|j| self.bounds[j] == Bound::NonNegative && solution[j] == 0.0)
            .collect();
        self.unscaled(&covariance_of_free(&self.scaled(&h), &at_bound))
    }

    fn unscaled(&self, inverse: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(inverse.nrows(), inverse.ncols(), |i, j| {
            inverse[(i, j)] / (self.scale[i] * self.scale[j])
        })
    }

    /// Sum of squared residuals with one smoothing and with all the damping that fits, asked for or not, open or not.
    pub(super) fn cost(&self, smoothing: &[f64; 2]) -> f64 {
        let h = self.scaled(&self.penalized(&self.gram, smoothing, 1.0));
        let x = bounded_quadratic(
            &h,
            &self.right.component_div(&self.scale),
            &self.bounds,
            None,
        );
        (&self.tau - &self.y * x.component_div(&self.scale)).norm_squared()
    }

    /// The columns that are not at a bound in `solution`, and their normal matrix with penalties.
    pub(super) fn free_part(
        &self,
        solution: &DVector<f64>,
        smoothing: &[f64; 2],
    ) -> (DMatrix<f64>, DMatrix<f64>) {
        let free: Vec<usize> = (0..solution.len())
            .filter(|&j| self.bounds[j] == Bound::Free || solution[j] > 0.0)
            .collect();
        let h = self.penalized(&self.gram, smoothing, 1.0);
        (
            self.y.select_columns(&free),
            h.select_rows(&free).select_columns(&free),
        )
    }

    /// The folds of held-out errors.
    pub(super) fn fold_normals(&self) -> Vec<Fold> {
        let (fold_of, count) = &self.folds;
        let folds: Vec<usize> = (0..*count).collect();
        let normals = in_parallel(&folds, |&fold| {
            let rows: Vec<usize> = (0..fold_of.len()).filter(|&i| fold_of[i] == fold).collect();
            if rows.is_empty() || rows.len() == fold_of.len() {
                return None;
            }
            let unscored: Vec<usize> = rows.iter().copied().filter(|&i| !self.scored[i]).collect();
            let all = self.part(&rows);
            Some(Fold {
                gram: self.scaled(&(&self.gram - &all.gram * (1.0 - LEFT))),
                right: &self.right - &all.right * (1.0 - LEFT),
                share: 1.0 - rows.len() as f64 / self.tau.len() as f64,
                scored: all.without(&self.part(&unscored)),
            })
        });
        normals.into_iter().flatten().collect()
    }

    pub(super) fn part(&self, rows: &[usize]) -> Part {
        let (y, tau) = (self.y.select_rows(rows), self.tau.select_rows(rows));
        let (gram, right) = normal(&y, &tau);
        Part {
            gram,
            right,
            square: tau.norm_squared(),
            samples: rows.len(),
        }
    }

    /// `warm` names the coefficients that are first taken as not at their bound.
    pub(super) fn held_out_of(
        &self,
        folds: &[Fold],
        smoothing: &[f64; 2],
        warm: Option<&[bool]>,
    ) -> f64 {
        let mut square = 0.0;
        let mut samples = 0;
        let mut warm = warm.map(<[bool]>::to_vec);
        let open = (self.open, self.open);
        let penalty = self.penalty(smoothing).resize(open.0, open.1, 0.0);
        let mut h = penalty.clone();
        for fold in folds {
            // The penalty is about columns of scale 1 only.
            h.copy_from(&fold.gram.view((0, 0), open));
            h.zip_apply(&penalty, |a, p| *a += fold.share * p);
            let right = fold.right.rows(0, self.open).into_owned();
            let (x, let_in) = self.minimum_of_open(&h, &right, fold.share, warm.as_deref());
            warm = Some(let_in);
            let part = &fold.scored;
            let (gram, right) = (part.gram.view((0, 0), open), part.right.rows(0, self.open));
            square += (part.square - 2.0 * x.dot(&right) + x.dot(&(gram * &x))).max(0.0);
            samples += part.samples;
        }
        (square / samples.max(1) as f64).sqrt()
    }

    /// Normal matrix with penalties; `share` of the samples are in it.
    pub(super) fn penalized(
        &self,
        gram: &DMatrix<f64>,
        smoothing: &[f64; 2],
        share: f64,
    ) -> DMatrix<f64> {
        let mut out = self.penalty(smoothing);
        out.zip_apply(gram, |penalty, entry| *penalty = entry + *penalty * share);
        out
    }

    /// All penalties, and a trace of ridge that keeps the normal matrix definite where the motion never was.
    fn penalty(&self, smoothing: &[f64; 2]) -> DMatrix<f64> {
        let total = self.y.ncols();
        let mut out = DMatrix::zeros(total, total);
        for (penalty, strength) in self.penalties.iter().zip(smoothing.iter().chain(&[1.0])) {
            let weight = strength * self.unit_weight(penalty);
            out.zip_apply(penalty, |a, p| *a += weight * p);
        }
        for j in self.params..total {
            out[(j, j)] += 1e-7 * self.tau.len() as f64 / (total as f64);
        }
        out
    }

    /// Mean diagonal weight of the coefficients that a penalty is about.
    fn unit_weight(&self, penalty: &DMatrix<f64>) -> f64 {
        let about: Vec<usize> = (0..penalty.ncols())
            .filter(|&j| penalty[(j, j)] > 0.0)
            .collect();
        about.iter().map(|&j| self.gram[(j, j)]).sum::<f64>() / about.len().max(1) as f64
    }

    /// Minimum with bounds. First with the threshold, which lets in only the damping that the data ask for; then without
    /// it over what was let in, so that nothing is shrunk.
    pub(super) fn minimum(
        &self,
        h: &DMatrix<f64>,
        right: &DVector<f64>,
        share: f64,
        warm: Option<&[bool]>,
    ) -> DVector<f64> {
        let h = self.scaled(h).resize(self.open, self.open, 0.0);
        let right = right.rows(0, self.open).into_owned();
        let (out, _) = self.minimum_of_open(&h, &right, share, warm);
        out.resize_vertically(self.y.ncols(), 0.0)
    }

    /// As [`Design::minimum`], of the columns that may be used and their normal matrix, which is scaled; and those that were
    /// let in.
    fn minimum_of_open(
        &self,
        scaled: &DMatrix<f64>,
        right: &DVector<f64>,
        share: f64,
        warm: Option<&[bool]>,
    ) -> (DVector<f64>, Vec<bool>) {
        let (scale, threshold) = (
            self.scale.rows(0, self.open),
            self.threshold.rows(0, self.open),
        );
        let held = (right - threshold * share).component_div(&scale);
        let mut quadratic = Quadratic::new(scaled);
        let mut out = quadratic.minimum(&held, &self.bounds, warm, |_| false);
        let let_in: Vec<bool> = out.iter().map(|v| *v != 0.0).collect();
        if threshold.amax() > 0.0 {
            let target = right.component_div(&scale);
            let kept_out = |j: usize| !let_in[j] && threshold[j] > 0.0;
            let all = vec![true; out.len()];
            out = quadratic.minimum(&target, &self.bounds, Some(&all), kept_out);
        }
        out.component_div_assign(&scale);
        (out, let_in)
    }

    fn scaled(&self, h: &DMatrix<f64>) -> DMatrix<f64> {
        scaled(h, &self.scale)
    }
}

/// A normal matrix for variables counted in units of `1 / scale`.
pub(super) fn scaled(matrix: &DMatrix<f64>, scale: &DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| {
        matrix[(i, j)] / (scale[i] * scale[j])
    })
}

/// A fit without the samples of one fold (but for [`LEFT`] of their weight), and those of them that count.
pub(super) struct Fold {
    /// Scaled.
    gram: DMatrix<f64>,
    right: DVector<f64>,
    /// Share of the samples that are left.
    share: f64,
    scored: Part,
}

/// The normal matrix of some samples.
pub(super) struct Part {
    pub(super) gram: DMatrix<f64>,
    right: DVector<f64>,
    square: f64,
    samples: usize,
}

impl Part {
    fn without(&self, other: &Self) -> Self {
        Self {
            gram: &self.gram - &other.gram,
            right: &self.right - &other.right,
            square: self.square - other.square,
            samples: self.samples - other.samples,
        }
    }
}

fn normal(y: &DMatrix<f64>, tau: &DVector<f64>) -> (DMatrix<f64>, DVector<f64>) {
    (gram(y), y.tr_mul(tau))
}
