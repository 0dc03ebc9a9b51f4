//! How certain the parameters of the joint fit are: by what each stretch of both series moves them, the curve going with them.
//!
//! With the curve's coefficients eliminated a row `l x + a theta = right` says `(a - l G) theta = ...`, G being what each coefficient changes
//! by per parameter. These rows are left out block by block ([`super::super::left_out`]).

use core::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::super::left_out::{LeftOut, blocks};
use super::arrow::Eliminated;
use super::position::position_rows;
use super::{Place, Problem, Slopes, held};

/// What all stretches have wrong alike (the mechanism's form, the axis, clocks that drift apart) moves the parameters and does not scatter.
/// The standard deviations of all but the inertia are so many times what scatters, as friction in simulated recordings asks for (`study`, 40
/// recordings of each of thirteen objects); inertia does not, but where a damper bends, and there the joint fit never stands.
const SHARED: f64 = 1.4;
/// Rows that are multiplied at a time; a long rest has many.
const AT_A_TIME: usize = 2048;

/// What the rows of a stretch leave, and what they have of the parameters beside the curve.
struct Stretch<'a> {
    x: &'a [f64],
    theta: &'a DVector<f64>,
    /// A column per coefficient of the curve.
    shares: &'a DMatrix<f64>,
    /// Parameters that are not at their bound, and what they are counted in.
    free: &'a [usize],
    scale: &'a DVector<f64>,
    of: LeftOut<'a>,
    /// One after the other, of all parameters, that `of` does not have yet.
    rows: Vec<f64>,
    residual: Vec<f64>,
}

impl Stretch<'_> {
    fn add(
        &mut self,
        first: usize,
        curve: &[f64],
        params: &[(usize, f64)],
        right: f64,
        weight: f64,
    ) {
        let start = self.rows.len();
        self.rows.resize(start + self.theta.len(), 0.0);
        let row = &mut self.rows[start..];
        let mut left = right;
        for (j, value) in (first..).zip(curve) {
            left -= value * self.x[j];
            let of_params = self.shares.column(j);
            row.iter_mut()
                .zip(of_params.iter())
                .for_each(|(row, share)| *row -= value * share);
        }
        for &(j, value) in params {
            left -= value * self.theta[j];
            row[j] += value;
        }
        row.iter_mut().for_each(|value| *value *= weight);
        self.residual.push(weight * left);
        if self.residual.len() == AT_A_TIME {
            self.hand_over();
        }
    }

    fn hand_over(&mut self) {
        if self.residual.is_empty() {
            return;
        }
        let rows = DMatrix::from_fn(self.residual.len(), self.free.len(), |i, k| {
            self.rows[i * self.theta.len() + self.free[k]] / self.scale[k]
        });
        self.of.add(&rows, &self.residual);
        self.rows.clear();
        self.residual.clear();
    }

    /// Leaves the stretch out, and begins the next one.
    fn leave_out(&mut self) {
        self.hand_over();
        self.of.leave_out();
    }
}

impl Problem<'_> {
    /// Covariance of the effects' parameters, and of the steps of their shapes where these are fitted, at the minimum of `all`; what of the mechanism is at a bound stays there, as in the plain fit.
    pub(super) fn covariance(
        &self,
        at: (&Place, &Slopes),
        all: Eliminated,
        noise: f64,
        at_bound: &[bool],
    ) -> DMatrix<f64> {
        let theta = self.minimum(&all, &at.0.theta);
        let x = all.coefficients(&theta);
        // Without a mechanism the steps are next after the terms.
        let own = self.linear + self.shapes.len();
        let free: Vec<usize> = (0..theta.len())
            .filter(|&j| j < own || !at_bound[j])
            .collect();
        let corner = all.corner().select_rows(&free).select_columns(&free);
        let (corner, scale) = held(&corner, self.hold);
        let mut stretch = Stretch {
            x: &x,
            theta: &theta,
            shares: &all.shares(),
            free: &free,
            scale: &scale,
            of: LeftOut::new(&corner, own),
            rows: Vec::new(),
            residual: Vec::new(),
        };
        let places = self.curve.at_samples();
        for samples in self.stretches() {
            let used = self.used.partition_point(|(i, _)| *i < samples.start)
                ..self.used.partition_point(|(i, _)| *i < samples.end);
            position_rows(
                self.motion,
                &self.curve,
                &self.colour,
                &places,
                samples,
                |first, curve, right| stretch.add(first, curve, &[], right, 1.0),
            );
            self.effort_rows(
                self.used[used].iter().map(|(i, _)| *i),
                &places,
                at,
                |first, curve, params, right| {
                    stretch.add(first, curve, params, right, 1.0 / noise);
                },
            );
            stretch.leave_out();
        }
        let grown = |j: usize| if j == 0 { 1.0 } else { SHARED } / scale[j];
        let mut out = stretch.of.covariance();
        // What is known of a step beforehand does not scatter with the data either.
        if let (true, Some(factor)) = (!self.shapes.is_empty(), corner.clone().cholesky()) {
            let inverse = factor.inverse();
            for (j, loose) in (self.linear..).zip(self.shapes.looseness()) {
                let known = (loose * scale[j]).powi(-2);
                let moved = inverse.view((0, j), (own, 1));
                out += known * moved * moved.transpose();
            }
        }
        for i in 0..own {
            for j in 0..own {
                out[(i, j)] *= grown(i) * grown(j);
            }
        }
        out
    }

    /// The blocks of the fit's samples, as samples at the work rate, which no block leaves out.
    fn stretches(&self) -> impl Iterator<Item = Range<usize>> {
        let kept = &self.motion.kept;
        let mut from = 0;
        blocks(self.motion).map(move |block| {
            let to = kept.get(block.end).copied().unwrap_or(self.motion.q.len());
            core::mem::replace(&mut from, to)..to
        })
    }
}
