//! The normal equations of a chain of per-sample states bordered by the geometry, and their elimination.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};

use super::{GEOMETRY, Wander};
use crate::products::in_vectors;

/// Joint coordinate 1, position wander 3, rotation wander 3.
const STATE: usize = 7;

type Block = SMatrix<f64, STATE, STATE>;
/// One column per state.
type Border = SMatrix<f64, GEOMETRY, STATE>;
type StateVector = SVector<f64, STATE>;

struct Link {
    diagonal: Block,
    /// Coupling to the next sample; diagonal, so a vector.
    next: StateVector,
    border: Border,
    right: StateVector,
}

/// What stands beside a link's diagonal block: border, right side, identity.
const BESIDE: usize = GEOMETRY + 1 + STATE;
/// Where the identity begins there.
const IDENTITY: usize = GEOMETRY + 1;

impl Link {
    /// The inverse of the diagonal block's lower Cholesky factor times what stands beside the block.
    #[inline(always)]
    fn reduced(&self) -> Option<[[f64; BESIDE]; STATE]> {
        let mut block: [[f64; STATE]; STATE] = self.diagonal.into();
        let mut beside = [[0.0; BESIDE]; STATE];
        for (k, row) in beside.iter_mut().enumerate() {
            row[..GEOMETRY].copy_from_slice(self.border.column(k).as_slice());
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

/// One linearization of the graph.
pub(super) struct Linearized {
    links: Vec<Link>,
    geometry: SMatrix<f64, GEOMETRY, GEOMETRY>,
    right: SVector<f64, GEOMETRY>,
    active: Vec<usize>,
    /// Sum of squared, weighted, whitened residuals.
    pub(super) cost: f64,
    rows: f64,
}

/// A Gauss-Newton step.
pub(super) struct Step {
    pub(super) geometry: SVector<f64, GEOMETRY>,
    pub(super) states: Vec<StateVector>,
    /// Covariance of the geometry with all states eliminated; zero rows where a parameter is not active.
    pub(super) covariance: DMatrix<f64>,
    /// Residual rows minus unknowns.
    pub(super) freedom: f64,
}

impl Linearized {
    pub(super) fn new(count: usize, active: Vec<usize>) -> Self {
        let links = (0..count)
            .map(|_| Link {
                diagonal: Block::zeros(),
                next: StateVector::zeros(),
                border: Border::zeros(),
                right: StateVector::zeros(),
            })
            .collect();
        Self {
            links,
            geometry: SMatrix::zeros(),
            right: SVector::zeros(),
            active,
            cost: 0.0,
            rows: 0.0,
        }
    }

    /// Adds a measured 3-vector of sample `i`; `part` 0 = position, 1 = rotation; the component along `ignored` counts for
    /// nothing. Outliers beyond three standard deviations lose weight as (3 sigma / distance)^2.
    pub(super) fn measure(
        &mut self,
        i: usize,
        part: usize,
        jacobian: &[Vector3<f64>; GEOMETRY + 1],
        residual: Vector3<f64>,
        white: f64,
        ignored: Option<Vector3<f64>>,
    ) {
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
        let jacobian = jacobian.map(|column| keep * column);
        // Joint coordinate, geometry, residual.
        let mut rows = [[0.0; GEOMETRY + 2]; 3];
        for (axis, row) in rows.iter_mut().enumerate() {
            for (value, column) in row.iter_mut().zip(jacobian.iter().chain([&residual])) {
                *value = root * column[axis];
            }
        }
        let [own, by_geometry @ .., _] = products(&rows);
        let link = &mut self.links[i];
        let wander = 1 + 3 * part;
        link.diagonal[(0, 0)] += own[0];
        link.right[0] += own[GEOMETRY + 1];
        for (k, row) in rows.iter().enumerate() {
            for other in 0..3 {
                link.diagonal[(wander + k, wander + other)] += weight * keep[(k, other)];
            }
            link.diagonal[(0, wander + k)] += root * row[0];
            link.diagonal[(wander + k, 0)] += root * row[0];
            link.right[wander + k] += weight * residual[k];
        }
        for (column, products) in by_geometry.iter().enumerate() {
            link.border[(column, 0)] += own[1 + column];
            for (k, row) in rows.iter().enumerate() {
                link.border[(column, wander + k)] += root * row[1 + column];
            }
            self.right[column] += products[GEOMETRY + 1];
            for other in 0..GEOMETRY {
                self.geometry[(column, other)] += products[1 + other];
            }
        }
        self.cost += weight * residual.norm_squared();
        self.rows += components;
    }

    /// Adds the wander's own dynamics between sample `i` and the one `before` it, or its prior at the start of a run.
    pub(super) fn walk(
        &mut self,
        i: usize,
        part: usize,
        before: Option<Vector3<f64>>,
        now: Vector3<f64>,
        noise: &Wander,
        period: f64,
    ) {
        let rho = if before.is_some() {
            (-period / noise.time_constant).exp()
        } else {
            0.0
        };
        let weight = 1.0 / (noise.wander * noise.wander * (1.0 - rho * rho));
        let error = now - before.unwrap_or_default() * rho;
        for k in 0..3 {
            let at = 1 + 3 * part + k;
            self.links[i].diagonal[(at, at)] += weight;
            self.links[i].right[at] -= weight * error[k];
            if before.is_some() {
                let link = &mut self.links[i - 1];
                link.diagonal[(at, at)] += weight * rho * rho;
                link.next[at] = -weight * rho;
                link.right[at] += weight * rho * error[k];
            }
        }
        self.cost += weight * error.norm_squared();
        self.rows += 3.0;
    }

    /// Eliminates the chain, solves for the geometry, and substitutes back.
    pub(super) fn solve(mut self) -> Option<Step> {
        in_vectors(
            #[inline(always)]
            || self.eliminate(),
        )?;
        let (geometry, covariance) = self.solve_geometry()?;
        let count = self.links.len();
        let mut states = vec![StateVector::zeros(); count];
        let mut following = StateVector::zeros();
        for (link, state) in self.links.iter().zip(&mut states).rev() {
            let from_next = link.next.component_mul(&following);
            for k in 0..STATE {
                let inverse = link.diagonal.column(k);
                let left = link.right[k] - link.border.column(k).dot(&geometry);
                *state += inverse * (left - inverse.dot(&from_next));
            }
            following = *state;
        }
        let unknowns = (count * STATE + self.active.len()) as f64;
        Some(Step {
            geometry,
            states,
            covariance,
            freedom: self.rows - unknowns,
        })
    }

    /// Takes one state after the other out of those that follow and out of the geometry. Leaves in its link, for each row of the
    /// inverse Cholesky factor, that row as a column of `diagonal` and its products with `border` and `right`.
    #[inline(always)]
    fn eliminate(&mut self) -> Option<()> {
        for i in 0..self.links.len() {
            let reduced = self.links[i].reduced()?;
            let products = products(&reduced);
            for (column, products) in products[..GEOMETRY].iter().enumerate() {
                self.right[column] -= products[GEOMETRY];
                for (other, product) in products[..GEOMETRY].iter().enumerate() {
                    self.geometry[(other, column)] -= product;
                }
            }
            let link = &mut self.links[i];
            let next = link.next;
            for (k, row) in reduced.iter().enumerate() {
                link.right[k] = row[GEOMETRY];
                link.border.column_mut(k).copy_from_slice(&row[..GEOMETRY]);
                let inverse = &row[IDENTITY..];
                link.diagonal.column_mut(k).copy_from_slice(inverse);
            }
            let Some(following) = self.links.get_mut(i + 1) else {
                continue;
            };
            for (k, products) in products[IDENTITY..].iter().enumerate() {
                following.right[k] -= next[k] * products[GEOMETRY];
                for (column, product) in products[..GEOMETRY].iter().enumerate() {
                    following.border[(column, k)] -= next[k] * product;
                }
                for (other, product) in products[IDENTITY..].iter().enumerate() {
                    following.diagonal[(other, k)] -= next[other] * product * next[k];
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
            .map(|&j| self.geometry[(j, j)].max(1e-12).sqrt())
            .collect();
        let part = DMatrix::from_fn(n, n, |i, j| {
            let ridge = if i == j { 1e-12 } else { 0.0 };
            self.geometry[(self.active[i], self.active[j])] / (scale[i] * scale[j]) + ridge
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
