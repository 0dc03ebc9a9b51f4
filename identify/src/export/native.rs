//! What a simulator's own joint attributes can hold of a twin.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use crate::least_squares::{Bound, FitError, bounded_least_squares};
use crate::twin::Evaluator;

/// Nodes of the fit over each of q and speed.
const NODES: usize = 60;
/// A polynomial that is zero only so many ranges away is not written about that place: its terms would cancel each other.
const FAR: f64 = 100.0;
/// Change over the range, relative to itself, of a load that is the same everywhere, so that a spring can hold it.
const WEAKEST: f64 = 1e-4;

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
    /// Root mean square of what the twin has beyond this over its own root mean square, over the probed coordinates and both
    /// directions up to the fastest speed.
    pub relative_error: Option<f64>,
}

impl Native {
    /// Nothing at all.
    fn none() -> Self {
        Self {
            reference: 0.0,
            stiffness: [0.0; 3],
            damping: [0.0; 3],
            friction: 0.0,
            relative_error: None,
        }
    }

    /// The nearest with cubic stiffness and cubic damping (MuJoCo).
    ///
    /// # Errors
    /// When the twin's efforts are no numbers.
    pub fn polynomial(twin: &Evaluator) -> Result<Self, FitError> {
        let cubic = Self::fit(twin, &[Bound::Free; 3], 3)?;
        match cubic {
            Some(cubic) => Ok(cubic),
            None => Self::linear(twin, Bound::Free, 3),
        }
    }

    /// The nearest with one spring and one damper (a drive of UsdPhysics).
    ///
    /// # Errors
    /// When the twin's efforts are no numbers.
    pub fn spring(twin: &Evaluator) -> Result<Self, FitError> {
        Self::linear(twin, Bound::NonNegative, 1)
    }

    /// The nearest with a damper and dry friction only (URDF).
    ///
    /// # Errors
    /// When the twin's efforts are no numbers.
    pub fn friction(twin: &Evaluator) -> Result<Self, FitError> {
        Ok(Self::fit(twin, &[], 1)?.unwrap_or_else(Self::none))
    }

    fn linear(twin: &Evaluator, spring: Bound, dampers: usize) -> Result<Self, FitError> {
        Ok(Self::fit(twin, &[spring], dampers)?.unwrap_or_else(Self::none))
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

    /// Nothing when the cubic cannot be written about a place where it is zero.
    fn fit(twin: &Evaluator, springs: &[Bound], dampers: usize) -> Result<Option<Self>, FitError> {
        let states = states(twin);
        let [low, high] = twin.domain().q;
        let middle = 0.5 * (low + high);
        let effort = DVector::from_iterator(
            states.len(),
            states.iter().map(|[q, dq]| twin.effort(*q, *dq, 0.0)),
        );
        // A constant goes with the springs, whose reference then makes it. Without springs it is fitted and left out, so
        // that it does not pass for friction.
        let first_damper = 1 + springs.len();
        let columns = first_damper + dampers + 1;
        let regressor = DMatrix::from_fn(states.len(), columns, |i, j| {
            let [q, dq] = states[i];
            if j < first_damper {
                (q - middle).powi(j as i32)
            } else if j + 1 < columns {
                dq * dq.abs().powi((j - first_damper) as i32)
            } else {
                dq.signum()
            }
        });
        let mut bounds = vec![Bound::Free];
        bounds.extend(springs);
        bounds.resize(columns, Bound::NonNegative);
        let fit = bounded_least_squares(&regressor, &effort, &bounds, 1e-12)?;
        let theta = fit.theta.as_slice();
        let mut out = Self::none();
        if !springs.is_empty() {
            let Some((reference, stiffness)) = about_a_root(&theta[..first_damper], high - low)
            else {
                return Ok(None);
            };
            (out.reference, out.stiffness) = (middle + reference, stiffness);
        }
        out.damping[..dampers].copy_from_slice(&theta[first_damper..columns - 1]);
        out.friction = theta[columns - 1];
        out.relative_error = Some(off(twin, |q, dq| out.effort(q, dq)));
        Ok(Some(out))
    }
}

/// Root mean square of what the twin has beyond `held`, over the twin's own.
pub(super) fn off(twin: &Evaluator, held: impl Fn(f64, f64) -> f64) -> f64 {
    let (mut left, mut all) = (0.0, 0.0);
    for [q, dq] in states(twin) {
        let effort = twin.effort(q, dq, 0.0);
        left += (effort - held(q, dq)).powi(2);
        all += effort * effort;
    }
    (left / f64::max(all, f64::MIN_POSITIVE)).sqrt()
}

/// States over the probed coordinates, both directions up to the fastest speed, even in the root of the speed.
fn states(twin: &Evaluator) -> Vec<[f64; 2]> {
    let [low, high] = twin.domain().q;
    let fastest = twin.fastest();
    let part = |i: usize| (i as f64 + 0.5) / NODES as f64;
    let mut out = Vec::with_capacity(2 * NODES * NODES);
    for i in 0..NODES {
        for j in 0..NODES {
            let (q, dq) = (low + part(i) * (high - low), part(j).powi(2) * fastest);
            out.extend([[q, dq], [q, -dq]]);
        }
    }
    out
}

/// `c0 + c1 y + c2 y^2 + c3 y^3` as `k1 x + k2 x^2 + k3 x^3` with `x = y - reference`; nothing when it is zero only far
/// outside the range, and more than a line.
fn about_a_root(coefficients: &[f64], range: f64) -> Option<(f64, [f64; 3])> {
    let at = |k: usize| coefficients.get(k).copied().unwrap_or(0.0);
    let [c0, mut c1, c2, c3] = [at(0), at(1), at(2), at(3)];
    if coefficients.len() <= 2 {
        // A line is exact wherever its zero lies; one that is level gets the weakest slope.
        if c1.abs() * range < WEAKEST * c0.abs() {
            c1 = WEAKEST * c0.abs() / range;
        }
        let reference = if c1 == 0.0 { 0.0 } else { -c0 / c1 };
        return Some((reference, [c1, 0.0, 0.0]));
    }
    let value = |y: f64| c0 + y * (c1 + y * (c2 + y * c3));
    let mut reach = range;
    while reach < FAR * range {
        for far in [reach, -reach] {
            if value(0.0) * value(far) <= 0.0 {
                let y = bisect(value, 0.0, far);
                return Some((
                    y,
                    [c1 + y * (2.0 * c2 + 3.0 * y * c3), c2 + 3.0 * y * c3, c3],
                ));
            }
        }
        reach *= 2.0;
    }
    None
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
