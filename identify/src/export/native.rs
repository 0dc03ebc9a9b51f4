//! What a simulator's own joint attributes can hold of a twin.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use crate::least_squares::{Bound, bounded_least_squares};
use crate::twin::Evaluator;

/// Nodes of the fit over each of q and speed.
const NODES: usize = 60;

/// A passive joint: effort `stiffness . (x, x^2, x^3) + damping . (v, v|v|, v^3) + friction sgn(v)` with `x = q - reference`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Native {
    /// Coordinate without spring effort, rad or m.
    pub reference: f64,
    /// N m/rad^n or N/m^n, n = 1, 2, 3.
    pub stiffness: [f64; 3],
    /// N m (s/rad)^n or N (s/m)^n, none below 0.
    pub damping: [f64; 3],
    /// Dry friction, N m or N.
    pub friction: f64,
    /// Root mean square of what the twin has beyond this, over the probed domain.
    pub error_rms: f64,
    /// The same over the root mean square effort.
    pub relative_error: f64,
}

impl Native {
    /// Nothing at all.
    #[must_use]
    pub fn none() -> Self {
        Self {
            reference: 0.0,
            stiffness: [0.0; 3],
            damping: [0.0; 3],
            friction: 0.0,
            error_rms: f64::NAN,
            relative_error: f64::NAN,
        }
    }

    /// The nearest with cubic stiffness and cubic damping (MuJoCo).
    #[must_use]
    pub fn polynomial(twin: &Evaluator) -> Self {
        Self::fit(twin, &[Bound::Free; 3], 3)
    }

    /// The nearest with one spring and one damper (a drive of UsdPhysics).
    #[must_use]
    pub fn spring(twin: &Evaluator) -> Self {
        Self::fit(twin, &[Bound::NonNegative], 1)
    }

    /// The nearest with a damper and dry friction only (URDF).
    #[must_use]
    pub fn friction(twin: &Evaluator) -> Self {
        Self::fit(twin, &[], 1)
    }

    /// Effort of these attributes at a state; at rest none of the friction.
    #[must_use]
    pub fn effort(&self, q: f64, dq: f64) -> f64 {
        let x = q - self.reference;
        let [k1, k2, k3] = self.stiffness;
        let [d1, d2, d3] = self.damping;
        let sign = if dq == 0.0 { 0.0 } else { dq.signum() };
        x * (k1 + x * (k2 + x * k3))
            + dq * (d1 + dq.abs() * (d2 + dq.abs() * d3))
            + self.friction * sign
    }

    fn fit(twin: &Evaluator, springs: &[Bound], dampers: usize) -> Self {
        let states = states(twin);
        let [low, high] = twin.domain().q;
        let middle = 0.5 * (low + high);
        let effort = DVector::from_iterator(
            states.len(),
            states.iter().map(|[q, dq]| twin.effort(*q, *dq, 0.0)),
        );
        // A constant goes with the springs, whose reference then makes it.
        let constant = usize::from(!springs.is_empty());
        let columns = constant + springs.len() + dampers + 1;
        let regressor = DMatrix::from_fn(states.len(), columns, |i, j| {
            let [q, dq] = states[i];
            if j < constant + springs.len() {
                (q - middle).powi((j + 1 - constant) as i32)
            } else if j + 1 < columns {
                let power = j - constant - springs.len();
                dq * dq.abs().powi(power as i32)
            } else {
                dq.signum()
            }
        });
        let mut bounds = vec![Bound::Free; constant];
        bounds.extend(springs);
        bounds.resize(columns, Bound::NonNegative);
        let mut out = Self::none();
        if let Ok(fit) = bounded_least_squares(&regressor, &effort, &bounds, 1e-12) {
            let theta = fit.theta.as_slice();
            let polynomial: Vec<f64> = theta[..constant + springs.len()].to_vec();
            (out.reference, out.stiffness) = about_a_root(&polynomial, middle, high - low);
            out.damping[..dampers].copy_from_slice(&theta[constant + springs.len()..columns - 1]);
            out.friction = theta[columns - 1];
        }
        let (mut left, mut all) = (0.0, 0.0);
        for ([q, dq], effort) in states.iter().zip(&effort) {
            left += (effort - out.effort(*q, *dq)).powi(2);
            all += effort * effort;
        }
        out.error_rms = (left / states.len() as f64).sqrt();
        out.relative_error = (left / all.max(f64::MIN_POSITIVE)).sqrt();
        out
    }
}

/// States over the domain, both directions, speeds even in their root from a hundredth of the fastest on.
pub(super) fn states(twin: &Evaluator) -> Vec<[f64; 2]> {
    let domain = twin.domain();
    let [low, high] = domain.q;
    let part = |i: usize| (i as f64 + 0.5) / NODES as f64;
    let mut out = Vec::with_capacity(2 * NODES * NODES);
    for i in 0..NODES {
        for j in 0..NODES {
            let (q, share) = (low + part(i) * (high - low), part(j).powi(2).max(1e-4));
            for fastest in domain.dq {
                if fastest != 0.0 {
                    out.push([q, share * fastest]);
                }
            }
        }
    }
    out
}

/// `c0 + c1 y + c2 y^2 + c3 y^3` with `y = q - middle` as `k1 x + k2 x^2 + k3 x^3` with `x = q - reference`.
fn about_a_root(coefficients: &[f64], middle: f64, range: f64) -> (f64, [f64; 3]) {
    let at = |k: usize| coefficients.get(k).copied().unwrap_or(0.0);
    let [c0, mut c1, c2, c3] = [at(0), at(1), at(2), at(3)];
    if c0 == 0.0 && c1 == 0.0 && c2 == 0.0 && c3 == 0.0 {
        return (middle, [0.0; 3]);
    }
    let value = |y: f64, c1: f64| c0 + y * (c1 + y * (c2 + y * c3));
    let root = |c1: f64| {
        let mut reach = range.max(1e-6);
        for _ in 0..60 {
            for far in [reach, -reach] {
                if value(0.0, c1) * value(far, c1) <= 0.0 {
                    return Some(bisect(|y| value(y, c1), 0.0, far));
                }
            }
            reach *= 2.0;
        }
        None
    };
    // A load that is the same everywhere has no root: the weakest spring that has one, far away.
    let y = root(c1).unwrap_or_else(|| {
        c1 = 1e-5 * c0.abs() / range.max(1e-6);
        -c0 / c1
    });
    let stiffness = [c1 + y * (2.0 * c2 + 3.0 * y * c3), c2 + 3.0 * y * c3, c3];
    (middle + y, stiffness)
}

fn bisect(f: impl Fn(f64) -> f64, mut from: f64, mut to: f64) -> f64 {
    let side = f(from);
    for _ in 0..200 {
        let half = 0.5 * (from + to);
        if f(half) * side > 0.0 {
            from = half;
        } else {
            to = half;
        }
    }
    0.5 * (from + to)
}
