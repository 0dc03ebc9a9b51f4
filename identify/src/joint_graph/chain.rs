//! The normal equations of chains of per-sample wanders bordered by the geometry, and their elimination.
//!
//! The joint coordinate of a sample follows from the rest and is in no chain: what a change of it could explain does not count
//! ([`Measured::ignored`]).

use nalgebra::{DMatrix, DVector, Matrix3, SVector, Vector3};

use super::{GEOMETRY, Wander};
use crate::products::in_vectors;

/// Of a wander, of the position or of the rotation.
const STATE: usize = 3;

/// A sample's wander in the normal equations.
#[derive(Clone)]
struct Link {
    diagonal: [[f64; STATE]; STATE],
    /// Coupling to the next sample's, the same for each component.
    next: f64,
    /// A row per component.
    border: [[f64; GEOMETRY]; STATE],
    right: [f64; STATE],
}

/// What stands beside a link's diagonal block: border, right side, identity.
const BESIDE: usize = GEOMETRY + 1 + STATE;
/// Where the identity begins there.
const IDENTITY: usize = GEOMETRY + 1;

impl Link {
    const EMPTY: Self = Self {
        diagonal: [[0.0; STATE]; STATE],
        next: 0.0,
        border: [[0.0; GEOMETRY]; STATE],
        right: [0.0; STATE],
    };

    /// The inverse of the diagonal block's lower Cholesky factor times what stands beside the block.
    #[inline(always)]
    fn reduced(&self) -> Option<[[f64; BESIDE]; STATE]> {
        let mut block = self.diagonal;
        let mut beside = [[0.0; BESIDE]; STATE];
        for (k, row) in beside.iter_mut().enumerate() {
            row[..GEOMETRY].copy_from_slice(&self.border[k]);
            row[GEOMETRY] = self.right[k];
            row[IDENTITY + k] = 1.0;
        }
        for k in 0..STATE {
            let pivot = block[k][k];
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            let scale = 1.0 / pivot.sqrt();
            let upper = block[k].map(|value| value * scale);
            let done = beside[k].map(|value| value * scale);
            beside[k] = done;
            for row in k + 1..STATE {
                for (value, above) in block[row].iter_mut().zip(&upper) {
                    *value -= upper[row] * above;
                }
                for (value, above) in beside[row].iter_mut().zip(&done) {
                    *value -= upper[row] * above;
                }
            }
        }
        Some(beside)
    }
}

/// `a' a` of a few rows.
#[inline(always)]
fn products<const N: usize>(rows: &[[f64; N]]) -> [[f64; N]; N] {
    let mut out = [[0.0; N]; N];
    for (i, sums) in out.iter_mut().enumerate() {
        for row in rows {
            for (sum, value) in sums.iter_mut().zip(row) {
                *sum += row[i] * value;
            }
        }
    }
    out
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

/// One linearization of the graph.
pub(super) struct Linearized {
    /// Of the position's wander, of the rotation's.
    chains: [Vec<Link>; 2],
    geometry: [[f64; GEOMETRY]; GEOMETRY],
    right: [f64; GEOMETRY],
    active: Vec<usize>,
    /// Sum of squared, weighted, whitened residuals.
    pub(super) cost: f64,
    rows: f64,
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

impl Linearized {
    /// Of so many samples; without rotations their chain is empty.
    pub(super) fn new(count: usize, uses_rotations: bool, active: Vec<usize>) -> Self {
        let rotations = if uses_rotations { count } else { 0 };
        Self {
            chains: [count, rotations].map(|count| vec![Link::EMPTY; count]),
            geometry: [[0.0; GEOMETRY]; GEOMETRY],
            right: [0.0; GEOMETRY],
            active,
            cost: 0.0,
            rows: 0.0,
        }
    }

    /// Adds what is measured of sample `i`; `part` 0 = position, 1 = rotation. Outliers beyond three standard deviations lose weight
    /// as (3 sigma / distance)^2.
    #[inline(always)]
    pub(super) fn measure(&mut self, i: usize, part: usize, measured: &Measured) {
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
        // Geometry, residual.
        let mut rows = [[0.0; GEOMETRY + 1]; STATE];
        for (j, column) in jacobian.iter().enumerate() {
            let column = keep * column;
            for (axis, row) in rows.iter_mut().enumerate() {
                row[j] = root * column[axis];
            }
        }
        for (axis, row) in rows.iter_mut().enumerate() {
            row[GEOMETRY] = root * residual[axis];
        }
        let link = &mut self.chains[part][i];
        for (k, row) in rows.iter().enumerate() {
            for other in 0..STATE {
                link.diagonal[k][other] += weight * keep[(k, other)];
            }
            for (sum, value) in link.border[k].iter_mut().zip(row) {
                *sum += root * value;
            }
            link.right[k] += root * row[GEOMETRY];
        }
        for (column, products) in products(&rows)[..GEOMETRY].iter().enumerate() {
            self.right[column] += products[GEOMETRY];
            for (sum, product) in self.geometry[column].iter_mut().zip(products) {
                *sum += product;
            }
        }
        self.cost += weight * residual.norm_squared();
        self.rows += components;
    }

    /// Adds the wander's own dynamics between sample `i` and the one `before` it, or its prior at the start of a run.
    #[inline(always)]
    pub(super) fn walk(
        &mut self,
        i: usize,
        part: usize,
        before: Option<Vector3<f64>>,
        now: Vector3<f64>,
        dynamics: &Dynamics,
    ) {
        let (weight, rho) = match before {
            Some(_) => (dynamics.weight, dynamics.rho),
            None => (dynamics.first, 0.0),
        };
        let error = now - before.unwrap_or_default() * rho;
        let links = &mut self.chains[part];
        for k in 0..STATE {
            links[i].diagonal[k][k] += weight;
            links[i].right[k] -= weight * error[k];
        }
        if before.is_some() {
            let link = &mut links[i - 1];
            link.next = -weight * rho;
            for k in 0..STATE {
                link.diagonal[k][k] += weight * rho * rho;
                link.right[k] += weight * rho * error[k];
            }
        }
        self.cost += weight * error.norm_squared();
        self.rows += STATE as f64;
    }

    /// Eliminates the chains, solves for the geometry, and substitutes back.
    pub(super) fn solve(mut self) -> Option<Step> {
        for part in 0..self.chains.len() {
            in_vectors(
                #[inline(always)]
                || self.eliminate(part),
            )?;
        }
        let (geometry, covariance) = self.solve_geometry()?;
        let wanders = self.chains.each_ref().map(|links| back(links, &geometry));
        let states: usize = self.chains.iter().map(|links| STATE * links.len()).sum();
        Some(Step {
            geometry,
            wanders,
            covariance,
            freedom: self.rows - (states + self.active.len()) as f64,
        })
    }

    /// Takes one sample's wander after the other out of those that follow and out of the geometry. Leaves in its link, for each row of
    /// the inverse Cholesky factor, that row in `diagonal` and its products with `border` and `right`.
    #[inline(always)]
    fn eliminate(&mut self, part: usize) -> Option<()> {
        let links = &mut self.chains[part];
        for i in 0..links.len() {
            let reduced = links[i].reduced()?;
            let products = products(&reduced);
            for (column, products) in products[..GEOMETRY].iter().enumerate() {
                self.right[column] -= products[GEOMETRY];
                for (sum, product) in self.geometry[column].iter_mut().zip(products) {
                    *sum -= product;
                }
            }
            let next = links[i].next;
            for (k, row) in reduced.iter().enumerate() {
                let link = &mut links[i];
                link.right[k] = row[GEOMETRY];
                link.border[k].copy_from_slice(&row[..GEOMETRY]);
                link.diagonal[k].copy_from_slice(&row[IDENTITY..]);
            }
            let Some(following) = links.get_mut(i + 1) else {
                continue;
            };
            for (k, products) in products[IDENTITY..].iter().enumerate() {
                following.right[k] -= next * products[GEOMETRY];
                for (sum, product) in following.border[k].iter_mut().zip(products) {
                    *sum -= next * product;
                }
                for (sum, product) in following.diagonal[k].iter_mut().zip(&products[IDENTITY..]) {
                    *sum -= next * next * product;
                }
            }
        }
        Some(())
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
        let right = DVector::from_fn(n, |i, _| self.right[self.active[i]] / scale[i]);
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

/// The wanders of a chain that was eliminated.
fn back(links: &[Link], geometry: &SVector<f64, GEOMETRY>) -> Vec<Vector3<f64>> {
    let mut states = vec![Vector3::zeros(); links.len()];
    let mut following = Vector3::zeros();
    for (link, state) in links.iter().zip(&mut states).rev() {
        let from_next: Vector3<f64> = following * link.next;
        for k in 0..STATE {
            let inverse = Vector3::from(link.diagonal[k]);
            let left = link.right[k] - SVector::from(link.border[k]).dot(geometry);
            *state += inverse * (left - inverse.dot(&from_next));
        }
        following = *state;
    }
    states
}
