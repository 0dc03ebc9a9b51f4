//! The mechanism: `g(q) + c(q, |dq|) dq` with `c >= 0` for each direction, as penalized B-splines.
//!
//! `g` is cubic with a second-difference penalty and any sign. `c` has one surface for opening (dq > 0) and one for
//! closing, a tensor product over q and sqrt(|dq|) (finer at low speeds, where a valve opens), with non-negative
//! coefficients, so it is non-negative everywhere. The effort `c dq` may bend at any speed, as behind a relief valve; over q
//! a fine division may have edges, found by weighing the penalty anew with what was fitted.
//! A constant part of `c` is the same as viscous friction: the smallest coefficient is moved there
//! ([`SplineMechanism::take_common_damping`]), so that the smallest `c` is zero. Outside the domain where it was probed the
//! curves go on at their end values and mean nothing.

use nalgebra::DMatrix;

use crate::least_squares::{Bound, rms};
use crate::motion::{Motion, MotionError};
use crate::samples::{extrema, quantile};
use crate::spline::Basis;

/// Effort of a mechanism as a function of the joint's state.
pub trait Mechanism: core::fmt::Debug {
    /// Effort that must be applied to hold the mechanism at coordinate `q` and velocity `dq`.
    fn effort(&self, q: f64, dq: f64) -> f64;

    /// Name of the representation, as in reports.
    fn kind(&self) -> &'static str;
}

/// Where the mechanism was probed.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Domain {
    /// Smallest and largest coordinate.
    pub q: [f64; 2],
    /// Smallest and largest velocity.
    pub dq: [f64; 2],
}

/// The mechanism as B-splines.
#[derive(Clone, Debug, PartialEq)]
pub struct SplineMechanism {
    load: Basis,
    damping_q: Basis,
    damping_speed: Basis,
    /// Coefficients of g.
    pub load_coefficients: Vec<f64>,
    /// Coefficients of c for opening and for closing, coordinate first: index = i_q * speeds + i_speed.
    pub damping_coefficients: [Vec<f64>; 2],
    /// Where it was probed.
    pub domain: Domain,
}

/// How finely a mechanism is divided: pieces of g over q, and of c over q and over speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fineness {
    /// Pieces of g over the coordinate.
    pub load: usize,
    /// Pieces of c over the coordinate.
    pub damping: usize,
    /// Pieces of c over the root of the speed.
    pub speed: usize,
    /// Degree of c over the coordinate.
    pub degree: usize,
}

impl Fineness {
    /// Smooth mechanisms, and all that a lag is looked for with.
    pub const COARSE: Self = Self {
        load: 20,
        damping: 12,
        speed: 3,
        degree: 2,
    };
    /// Zones with edges, and valves that open at a pressure.
    pub const FINE: Self = Self {
        load: 20,
        damping: 28,
        speed: 7,
        degree: 1,
    };
}

impl SplineMechanism {
    /// A mechanism of zero effort over the domain of a motion.
    #[must_use]
    pub fn over(motion: &Motion) -> Self {
        Self::divided(motion, Fineness::COARSE)
    }

    /// A mechanism of zero effort over the domain of a motion, divided as asked for.
    #[must_use]
    pub fn divided(motion: &Motion, fineness: Fineness) -> Self {
        let q = motion.at_kept(&motion.q);
        let dq = motion.at_kept(&motion.dq);
        let speed: Vec<f64> = dq.iter().map(|v| v.abs()).collect();
        let (low, high) = extrema(&q);
        let load = Basis::new(low, high, fineness.load, 3);
        let damping_q = Basis::new(low, high, fineness.damping, fineness.degree);
        let damping_speed = Basis::new(
            0.0,
            quantile(&speed, 0.999).max(1e-9).sqrt(),
            fineness.speed,
            1,
        );
        let zeros = vec![0.0; damping_q.len() * damping_speed.len()];
        let (slowest, fastest) = extrema(&dq);
        Self {
            load_coefficients: vec![0.0; load.len()],
            load,
            damping_q,
            damping_speed,
            damping_coefficients: [zeros.clone(), zeros],
            domain: Domain {
                q: [low, high],
                dq: [slowest, fastest],
            },
        }
    }

    /// The basis of g.
    #[must_use]
    pub fn load_basis(&self) -> &Basis {
        &self.load
    }

    /// The bases of c, in the coordinate and in the square root of the speed.
    #[must_use]
    pub fn damping_bases(&self) -> (&Basis, &Basis) {
        (&self.damping_q, &self.damping_speed)
    }

    /// The load `g(q)`.
    #[must_use]
    pub fn load(&self, q: f64) -> f64 {
        self.load.value(&self.load_coefficients, q)
    }

    /// The damping `c(q, |dq|)` of the direction of `dq`.
    #[must_use]
    pub fn damping(&self, q: f64, dq: f64) -> f64 {
        let coefficients = &self.damping_coefficients[usize::from(dq < 0.0)];
        self.tensor(q, dq.abs())
            .map(|(index, value)| coefficients[index] * value)
            .sum()
    }

    /// Moves the constant part of the damping out of the mechanism and gives it, to be added to viscous friction.
    pub fn take_common_damping(&mut self) -> f64 {
        let common = self
            .damping_coefficients
            .iter()
            .flatten()
            .copied()
            .fold(f64::INFINITY, f64::min);
        for coefficient in self.damping_coefficients.iter_mut().flatten() {
            *coefficient -= common;
        }
        common
    }

    /// Number of coefficients: load, opening, closing.
    #[must_use]
    pub fn len(&self) -> usize {
        self.load.len() + 2 * self.damping_coefficients[0].len()
    }

    /// Never: there is always a load.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Sets all coefficients, in the order of [`SplineMechanism::regressor`].
    pub fn set(&mut self, coefficients: &[f64]) {
        let (load, damping) = coefficients.split_at(self.load.len().min(coefficients.len()));
        self.load_coefficients = load.to_vec();
        let half = damping.len() / 2;
        self.damping_coefficients = [damping[..half].to_vec(), damping[half..].to_vec()];
    }

    /// Bounds of the coefficients.
    #[must_use]
    pub fn bounds(&self) -> Vec<Bound> {
        let mut bounds = vec![Bound::Free; self.load.len()];
        bounds.resize(self.len(), Bound::NonNegative);
        bounds
    }

    /// Effort per coefficient, filtered like the measured effort, (kept samples, coefficients).
    ///
    /// # Errors
    /// When the motion cannot be filtered.
    pub fn regressor(&self, motion: &Motion) -> Result<DMatrix<f64>, MotionError> {
        let count = motion.q.len();
        let mut out = DMatrix::zeros(motion.kept.len(), self.len());
        let mut raw = vec![vec![0.0; count]; self.len()];
        let surface = self.damping_coefficients[0].len();
        for (i, (&q, &dq)) in motion.q.iter().zip(&motion.dq).enumerate() {
            let (first, values) = self.load.evaluate(q);
            for (j, value) in values.iter().take(self.load.degree() + 1).enumerate() {
                raw[first + j][i] = *value;
            }
            let start = self.load.len() + if dq < 0.0 { surface } else { 0 };
            for (index, value) in self.tensor(q, dq.abs()) {
                raw[start + index][i] += value * dq;
            }
        }
        for (j, series) in raw.into_iter().enumerate() {
            out.column_mut(j)
                .copy_from_slice(&motion.regressor(&series)?);
        }
        Ok(out)
    }

    /// Penalties of roughness of g and of c over q, whose strengths are chosen, and a fixed one that keeps c even over speed;
    /// each (coefficients, coefficients). With `edges` = weight of each step of c over q for opening and for closing, c is
    /// held constant where the weights are large and may jump where they are small ([`SplineMechanism::edges`]).
    #[must_use]
    pub fn penalties(&self, edges: Option<&[Vec<f64>; 2]>) -> [DMatrix<f64>; 3] {
        let total = self.len();
        let mut load = DMatrix::zeros(total, total);
        load.view_mut((0, 0), (self.load.len(), self.load.len()))
            .copy_from(&self.load.penalty(2));
        let in_speed = if edges.is_some() {
            // Below where valves open, oil flows in proportion to its pressure: c hardly changes at low speeds, and leaves
            // dry friction alone.
            let weights: Vec<f64> = (1..self.damping_speed.len())
                .map(|j| 1.0 + (4.0 / j as f64).powi(6))
                .collect();
            self.damping_speed.weighted_penalty(&weights)
        } else {
            self.damping_speed.penalty(1)
        };
        let (nq, nv) = (self.damping_q.len(), self.damping_speed.len());
        let one = |n: usize| DMatrix::<f64>::identity(n, n);
        let twice = |block: [DMatrix<f64>; 2]| {
            let mut full = DMatrix::zeros(total, total);
            for (direction, block) in block.into_iter().enumerate() {
                let at = self.load.len() + direction * nq * nv;
                full.view_mut((at, at), (nq * nv, nq * nv))
                    .copy_from(&block);
            }
            full
        };
        let over_q = |direction: usize| {
            let even = edges.map_or_else(
                || self.damping_q.penalty(2),
                |edges| self.damping_q.weighted_penalty(&edges[direction]),
            );
            even.kronecker(&one(nv))
        };
        let [speed, ridge] = if edges.is_some() {
            [1e-3, 1e-6]
        } else {
            [0.03, 1e-4]
        };
        let over_speed = one(nq).kronecker(&in_speed) * speed + one(nq * nv) * ridge;
        [
            load,
            twice([over_q(0), over_q(1)]),
            twice([over_speed.clone(), over_speed]),
        ]
    }

    /// Weights that let the damping of `coefficients` (all, as for [`SplineMechanism::set`]) keep its edges: the inverse of the
    /// squared step, relative to the root mean square damping, and at most 100.
    #[must_use]
    pub fn edges(&self, coefficients: &[f64]) -> [Vec<f64>; 2] {
        let (nq, nv) = (self.damping_q.len(), self.damping_speed.len());
        let damping = &coefficients[self.load.len()..];
        let size = rms(damping).powi(2).max(f64::MIN_POSITIVE);
        [0, 1].map(|direction| {
            let surface = &damping[direction * nq * nv..(direction + 1) * nq * nv];
            (0..nq - 1)
                .map(|i| {
                    let step = (0..nv)
                        .map(|j| (surface[(i + 1) * nv + j] - surface[i * nv + j]).powi(2))
                        .sum::<f64>()
                        / nv as f64;
                    1.0 / (0.01 + step / size)
                })
                .collect()
        })
    }

    fn tensor(&self, q: f64, speed: f64) -> impl Iterator<Item = (usize, f64)> {
        let (first_q, in_q) = self.damping_q.evaluate(q);
        let (first_speed, in_speed) = self.damping_speed.evaluate(speed.sqrt());
        let (dq, dv, nv) = (
            self.damping_q.degree() + 1,
            self.damping_speed.degree() + 1,
            self.damping_speed.len(),
        );
        (0..dq * dv).map(move |k| {
            let (i, j) = (k / dv, k % dv);
            ((first_q + i) * nv + first_speed + j, in_q[i] * in_speed[j])
        })
    }
}

impl Mechanism for SplineMechanism {
    fn effort(&self, q: f64, dq: f64) -> f64 {
        self.load(q) + self.damping(q, dq) * dq
    }

    fn kind(&self) -> &'static str {
        "spline"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSettings;
    use crate::samples::JointSamples;
    use crate::screw::JointKind;

    fn motion() -> Motion {
        let time: Vec<f64> = (0..3000).map(|i| 0.005 * f64::from(i)).collect();
        let q: Vec<f64> = time.iter().map(|t| 0.5 - 0.5 * (1.7 * t).cos()).collect();
        let samples = JointSamples {
            kind: JointKind::Revolute,
            period: 0.005,
            runs: vec![0..3000],
            tau: q.clone(),
            q,
            time,
            noise_of_q: Vec::new(),
        };
        Motion::prepare(&samples, &MotionSettings::default()).unwrap()
    }

    #[test]
    fn the_regressor_is_the_effort_by_coefficient() {
        let motion = motion();
        let mut mechanism = SplineMechanism::over(&motion);
        let coefficients: Vec<f64> = (0..mechanism.len())
            .map(|j| ((j * 7) % 5) as f64 * 0.3)
            .collect();
        mechanism.set(&coefficients);
        let by_column =
            mechanism.regressor(&motion).unwrap() * nalgebra::DVector::from_vec(coefficients);
        let direct: Vec<f64> = motion
            .q
            .iter()
            .zip(&motion.dq)
            .map(|(q, dq)| mechanism.effort(*q, *dq))
            .collect();
        let direct = motion.regressor(&direct).unwrap();
        assert!(
            by_column
                .iter()
                .zip(&direct)
                .all(|(a, b)| (a - b).abs() < 1e-9)
        );
    }

    #[test]
    fn common_damping_moves_to_viscous_friction_without_changing_the_effort() {
        let mut mechanism = SplineMechanism::over(&motion());
        let coefficients: Vec<f64> = (0..mechanism.len()).map(|j| 1.0 + (j % 4) as f64).collect();
        mechanism.set(&coefficients);
        let before = mechanism.effort(0.3, -0.8);
        let viscous = mechanism.take_common_damping();
        assert_eq!(viscous, 1.0);
        assert!((mechanism.effort(0.3, -0.8) - 0.8 * viscous - before).abs() < 1e-12);
        assert!(mechanism.damping(0.3, -0.8) >= 0.0);
    }
}
