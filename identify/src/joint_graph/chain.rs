//! The normal equations of a chain of per-sample states bordered by the geometry, and their elimination.

use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector3};

use super::{GEOMETRY, Wander};

/// Joint coordinate 1, position wander 3, rotation wander 3.
const STATE: usize = 7;

type Block = SMatrix<f64, STATE, STATE>;
type Border = SMatrix<f64, STATE, GEOMETRY>;
type StateVector = SVector<f64, STATE>;

struct Link {
    diagonal: Block,
    /// Coupling to the next sample; diagonal, so a vector.
    next: StateVector,
    border: Border,
    right: StateVector,
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
        let jacobian = jacobian.map(|column| keep * column);
        let link = &mut self.links[i];
        let wander = 1 + 3 * part;
        link.diagonal[(0, 0)] += weight * jacobian[0].norm_squared();
        link.right[0] += weight * jacobian[0].dot(&residual);
        for k in 0..3 {
            for other in 0..3 {
                link.diagonal[(wander + k, wander + other)] += weight * keep[(k, other)];
            }
            link.diagonal[(0, wander + k)] += weight * jacobian[0][k];
            link.diagonal[(wander + k, 0)] += weight * jacobian[0][k];
            link.right[wander + k] += weight * residual[k];
        }
        for column in 0..GEOMETRY {
            let g = &jacobian[1 + column];
            link.border[(0, column)] += weight * jacobian[0].dot(g);
            for k in 0..3 {
                link.border[(wander + k, column)] += weight * g[k];
            }
            self.right[column] += weight * g.dot(&residual);
            for other in 0..GEOMETRY {
                self.geometry[(column, other)] += weight * g.dot(&jacobian[1 + other]);
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
        let count = self.links.len();
        let mut eliminated = Vec::with_capacity(count);
        for i in 0..count {
            let inverse = self.links[i].diagonal.cholesky()?.inverse();
            let border = inverse * self.links[i].border;
            let right = inverse * self.links[i].right;
            self.geometry -= self.links[i].border.tr_mul(&border);
            self.right -= self.links[i].border.tr_mul(&right);
            if let [link, following, ..] = &mut self.links[i..] {
                let next = &link.next;
                following.diagonal -=
                    Block::from_fn(|row, column| next[row] * inverse[(row, column)] * next[column]);
                following.border -=
                    Border::from_fn(|row, column| next[row] * border[(row, column)]);
                following.right -= next.component_mul(&right);
            }
            eliminated.push((inverse, border, right));
        }
        let (geometry, covariance) = self.solve_geometry()?;
        let mut states = vec![StateVector::zeros(); count];
        for i in (0..count).rev() {
            let (inverse, border, right) = &eliminated[i];
            let mut state = right - border * geometry;
            if let Some(next) = states.get(i + 1) {
                state -= inverse * self.links[i].next.component_mul(next);
            }
            states[i] = state;
        }
        let unknowns = (count * STATE + self.active.len()) as f64;
        Some(Step {
            geometry,
            states,
            covariance,
            freedom: self.rows - unknowns,
        })
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
