//! The normal equations of chains of per-sample wanders bordered by the geometry, and their elimination.
//!
//! The joint coordinate of a sample follows from the rest and is in no chain: what a change of it could explain does not count
//! ([`Measured::ignored`]).

use nalgebra::{DMatrix, DVector, Matrix3, SVector, Vector3};

use super::{GEOMETRY, Wander};

/// Of a wander, of the position or of the rotation.
const STATE: usize = 3;

/// A sample's wander in the normal equations: a row for each component.
#[derive(Clone, Copy)]
struct Link {
    rows: [[f64; WIDE]; STATE],
    /// Coupling to the next sample's, the same for each component.
    next: f64,
}

/// Of a row: its border with the geometry, its right side, after the elimination the inverse of the Cholesky factor, the diagonal block.
const WIDE: usize = DIAGONAL + STATE;
const RIGHT: usize = GEOMETRY;
const INVERSE: usize = RIGHT + 1;
const DIAGONAL: usize = INVERSE + STATE;
// Whole vectors of the processor.
const _: () = assert!(WIDE.is_multiple_of(8));

impl Link {
    const EMPTY: Self = Self {
        rows: [[0.0; WIDE]; STATE],
        next: 0.0,
    };

    /// Multiplies the rows by the inverse of the diagonal block's lower Cholesky factor, and notes it.
    #[inline(always)]
    fn reduce(&mut self) -> Option<()> {
        for k in 0..STATE {
            self.rows[k][INVERSE + k] = 1.0;
            let pivot = self.rows[k][DIAGONAL + k];
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            let scale = 1.0 / pivot.sqrt();
            let done = self.rows[k].map(|value| value * scale);
            self.rows[k] = done;
            for below in k + 1..STATE {
                add(&mut self.rows[below], -done[DIAGONAL + below], &done);
            }
        }
        Some(())
    }
}

/// Adds `factor` times `values`.
#[inline(always)]
fn add<const N: usize>(sums: &mut [f64; N], factor: f64, values: &[f64; N]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += factor * value;
    }
}

/// A measured 3-vector.
pub(super) struct Measured<'a> {
    /// Of the prediction by the geometry, as columns.
    pub(super) jacobian: &'a [Vector3<f64>; GEOMETRY],
    /// Measured minus predicted.
    pub(super) residual: Vector3<f64>,
    /// Standard deviation of its white noise, per component.
    pub(super) white: f64,
    /// Unit vector; the component along it counts for nothing.
    pub(super) ignored: Option<Vector3<f64>>,
}

/// A chain of wanders, of the position or of the rotation, and what its samples say of the geometry.
pub(super) struct Chain {
    links: Vec<Link>,
    /// Normal equations of the geometry, and their right side; what follows in a row says nothing.
    geometry: [[f64; WIDE]; GEOMETRY],
    /// Sum of squared, weighted, whitened residuals.
    cost: f64,
    /// Number of residuals.
    residuals: f64,
}

/// One linearization of the graph: chains that were eliminated, and the sum of what they leave of the geometry.
pub(super) struct Linearized {
    chains: [Chain; 2],
    geometry: [[f64; WIDE]; GEOMETRY],
    active: Vec<usize>,
    /// Sum of squared, weighted, whitened residuals.
    pub(super) cost: f64,
}

/// A Gauss-Newton step.
pub(super) struct Step {
    pub(super) geometry: SVector<f64, GEOMETRY>,
    /// Of the position's wander and the rotation's; empty where there is no such.
    pub(super) wanders: [Vec<Vector3<f64>>; 2],
    /// Covariance of the geometry with all states eliminated; zero rows where a parameter is not active.
    pub(super) covariance: DMatrix<f64>,
    /// Residual rows minus unknowns.
    pub(super) freedom: f64,
}

impl Chain {
    pub(super) fn new(count: usize) -> Self {
        Self {
            links: vec![Link::EMPTY; count],
            geometry: [[0.0; WIDE]; GEOMETRY],
            cost: 0.0,
            residuals: 0.0,
        }
    }

    /// Adds what is measured of sample `i`. Outliers beyond three standard deviations lose weight as (3 sigma / distance)^2.
    #[inline(always)]
    pub(super) fn measure(&mut self, i: usize, measured: &Measured) {
        let Measured {
            jacobian,
            residual,
            white,
            ignored,
        } = *measured;
        let keep = Matrix3::identity() - ignored.map_or_else(Matrix3::zeros, |u| u * u.transpose());
        let components = if ignored.is_some() { 2.0_f64 } else { 3.0 };
        let residual = keep * residual;
        let distance = residual.norm() / (white * components.sqrt());
        let weight = if distance < 3.0 {
            1.0
        } else {
            (3.0 / distance).powi(2)
        } / (white * white);
        let root = weight.sqrt();
        let mut rows = [[0.0; WIDE]; STATE];
        for (j, column) in jacobian.iter().enumerate() {
            let column = keep * column;
            for (axis, row) in rows.iter_mut().enumerate() {
                row[j] = root * column[axis];
            }
        }
        let link = &mut self.links[i];
        for (k, row) in rows.iter_mut().enumerate() {
            row[RIGHT] = root * residual[k];
            add(&mut link.rows[k], root, row);
            for other in 0..STATE {
                link.rows[k][DIAGONAL + other] += weight * keep[(k, other)];
            }
        }
        for (column, sums) in self.geometry.iter_mut().enumerate() {
            for row in &rows {
                add(sums, row[column], row);
            }
        }
        self.cost += weight * residual.norm_squared();
        self.residuals += components;
    }

    /// Adds the wander's own dynamics between sample `i` and the one `before` it, or its prior at the start of a run.
    #[inline(always)]
    pub(super) fn walk(
        &mut self,
        i: usize,
        before: Option<Vector3<f64>>,
        now: Vector3<f64>,
        dynamics: &Dynamics,
    ) {
        let (weight, rho) = match before {
            Some(_) => (dynamics.weight, dynamics.rho),
            None => (dynamics.first, 0.0),
        };
        let error = now - before.unwrap_or_default() * rho;
        let links = &mut self.links;
        for k in 0..STATE {
            links[i].rows[k][DIAGONAL + k] += weight;
            links[i].rows[k][RIGHT] -= weight * error[k];
        }
        if before.is_some() {
            let link = &mut links[i - 1];
            link.next = -weight * rho;
            for k in 0..STATE {
                link.rows[k][DIAGONAL + k] += weight * rho * rho;
                link.rows[k][RIGHT] += weight * rho * error[k];
            }
        }
        self.cost += weight * error.norm_squared();
        self.residuals += STATE as f64;
    }

    /// Takes one sample's wander after the other out of those that follow and out of the geometry.
    #[inline(always)]
    pub(super) fn eliminate(&mut self) -> Option<()> {
        for i in 0..self.links.len() {
            self.links[i].reduce()?;
            let Link { rows, next } = self.links[i];
            for (column, sums) in self.geometry.iter_mut().enumerate() {
                for row in &rows {
                    add(sums, -row[column], row);
                }
            }
            let Some(following) = self.links.get_mut(i + 1) else {
                continue;
            };
            for (k, to) in following.rows.iter_mut().enumerate() {
                for row in &rows {
                    let factor = -next * row[INVERSE + k];
                    let (border, rest) = row.split_at(INVERSE);
                    for (sum, value) in to.iter_mut().zip(border) {
                        *sum += factor * value;
                    }
                    for (sum, value) in to[DIAGONAL..].iter_mut().zip(rest) {
                        *sum += factor * next * value;
                    }
                }
            }
        }
        Some(())
    }

    /// The wanders, when it was eliminated.
    fn back(&self, geometry: &SVector<f64, GEOMETRY>) -> Vec<Vector3<f64>> {
        let mut states = vec![Vector3::zeros(); self.links.len()];
        let mut following = Vector3::zeros();
        for (link, state) in self.links.iter().zip(&mut states).rev() {
            let from_next: Vector3<f64> = following * link.next;
            for k in 0..STATE {
                let row = &link.rows[k];
                let inverse = Vector3::from_column_slice(&row[INVERSE..DIAGONAL]);
                let border = SVector::<f64, GEOMETRY>::from_column_slice(&row[..GEOMETRY]);
                let left = row[RIGHT] - border.dot(geometry);
                *state += inverse * (left - inverse.dot(&from_next));
            }
            following = *state;
        }
        states
    }
}

impl Linearized {
    /// Of the chains of position and rotation, each eliminated; without rotations their chain is empty.
    pub(super) fn of(chains: [Chain; 2], active: Vec<usize>) -> Self {
        let [first, second] = &chains;
        Self {
            geometry: core::array::from_fn(|i| {
                core::array::from_fn(|j| first.geometry[i][j] + second.geometry[i][j])
            }),
            active,
            cost: first.cost + second.cost,
            chains,
        }
    }

    /// Solves for the geometry, and substitutes back.
    pub(super) fn solve(&self) -> Option<Step> {
        let (geometry, covariance) = self.solve_geometry()?;
        let residuals: f64 = self.chains.iter().map(|chain| chain.residuals).sum();
        let states: usize = self
            .chains
            .iter()
            .map(|chain| STATE * chain.links.len())
            .sum();
        Some(Step {
            geometry,
            wanders: self.chains.each_ref().map(|chain| chain.back(&geometry)),
            covariance,
            freedom: residuals - (states + self.active.len()) as f64,
        })
    }

    fn solve_geometry(&self) -> Option<(SVector<f64, GEOMETRY>, DMatrix<f64>)> {
        let n = self.active.len();
        let scale: Vec<f64> = self
            .active
            .iter()
            .map(|&j| self.geometry[j][j].max(1e-12).sqrt())
            .collect();
        let part = DMatrix::from_fn(n, n, |i, j| {
            let ridge = if i == j { 1e-12 } else { 0.0 };
            self.geometry[self.active[i]][self.active[j]] / (scale[i] * scale[j]) + ridge
        });
        let right = DVector::from_fn(n, |i, _| self.geometry[self.active[i]][RIGHT] / scale[i]);
        let factor = part.cholesky()?;
        let solution = factor.solve(&right);
        let inverse = factor.inverse();
        let mut geometry = SVector::zeros();
        let mut covariance = DMatrix::zeros(GEOMETRY, GEOMETRY);
        for i in 0..n {
            geometry[self.active[i]] = solution[i] / scale[i];
            for j in 0..n {
                covariance[(self.active[i], self.active[j])] =
                    inverse[(i, j)] / (scale[i] * scale[j]);
            }
        }
        Some((geometry, covariance))
    }
}

/// A wander's dynamics from one sample to the next.
pub(super) struct Dynamics {
    rho: f64,
    /// One over the variance of a step.
    weight: f64,
    /// One over that of the first.
    first: f64,
}

impl Dynamics {
    pub(super) fn of(noise: &Wander, period: f64) -> Self {
        let rho = (-period / noise.time_constant).exp();
        let first = 1.0 / (noise.wander * noise.wander);
        Self {
            rho,
            weight: first / (1.0 - rho * rho),
            first,
        }
    }
}
