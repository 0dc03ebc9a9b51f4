//! The mechanism: `g(q) + c(q, |dq|) dq` with `c >= 0` for each direction, as penalized B-splines.
//!
//! `g` is cubic with a second-difference penalty and any sign. `c` comes in two forms, both non-negative everywhere:
//! - a surface for opening (dq > 0) and one for closing, a tensor product over q and sqrt(|dq|) with non-negative coefficients;
//! - behind a valve: `c dq = P(c0(q) |dq|)`, as in a cylinder whose ports depend on q and whose valve has one
//!   characteristic [`Valve`] for all q. `c0` is finely divided and may have edges, found by weighing its penalty anew with what
//!   was fitted. Edges of zones and relief valves need this form, and it says more about speeds that were seen at few places.
//!
//! A constant part of `c` is the same as viscous friction: the smallest coefficient is moved there
//! ([`SplineMechanism::take_common_damping`]), so that the smallest `c` is zero. Outside the domain where it was probed the
//! curves go on at their end values and mean nothing.

mod valve;

pub use valve::{Bend, Valve};

use nalgebra::{DMatrix, DVector};

use crate::least_squares::Bound;
use crate::motion::{Motion, SparseColumns};
use crate::parallel::both;
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
    /// What becomes of the damping's effort `c |dq|`, for opening and for closing.
    pub valves: [Valve; 2],
    /// Where it was probed.
    pub domain: Domain,
}

/// A mechanism's functions on a motion: they do not depend on its coefficients.
#[derive(Clone, Debug)]
pub struct OnMotion {
    /// Effort per coefficient of the load, filtered like the measured effort, (kept samples, coefficients of g).
    pub load: DMatrix<f64>,
    /// Functions of the damping that are not zero at each sample, and their values: as many for each sample.
    damping: Vec<(usize, f64)>,
    /// Effort per coefficient of the damping behind straight valves, filtered too, (kept samples, coefficients of c).
    straight: DMatrix<f64>,
}

/// A mechanism's effort as a linear function of its coefficients, near those it has.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Effort per coefficient behind those of the load, (kept samples, coefficients of c and of bends).
    pub damping: DMatrix<f64>,
    /// The effort less what all columns times the coefficients give, one per kept sample; zero while the valves are straight.
    pub rest: Vec<f64>,
}

/// Pieces of g, and of c over q and over sqrt(|dq|) as a surface and over q behind a valve.
const LOAD_PIECES: usize = 20;
const SURFACE_PIECES: [usize; 2] = [12, 3];
const VALVED_PIECES: usize = 40;
/// Functions of the damping that are not zero at a state, at most.
const MOST_FUNCTIONS: usize = 6;
/// Strength of the pull of damping behind a valve to zero, over that of the data.
const LEVEL: f64 = 3e-4;
/// Square of a step or level of the damping, over its mean square, that counts as a step or level at all.
const SMALL: f64 = 1e-3;

impl SplineMechanism {
    /// A mechanism of zero effort over the domain of a motion, its damping as surfaces.
    #[must_use]
    pub fn over(motion: &Motion) -> Self {
        let [over_q, over_speed] = SURFACE_PIECES;
        Self::divided(motion, (over_q, 2), (over_speed, 1))
    }

    /// A mechanism of zero effort over the domain of a motion, its damping behind valves that are straight.
    #[must_use]
    pub fn valved(motion: &Motion) -> Self {
        Self::divided(motion, (VALVED_PIECES, 1), (1, 0))
    }

    /// Pieces and degree of c over q and over speed.
    fn divided(motion: &Motion, over_q: (usize, usize), over_speed: (usize, usize)) -> Self {
        let q = motion.at_kept(&motion.q);
        let dq = motion.at_kept(&motion.dq);
        let speed: Vec<f64> = dq.iter().map(|v| v.abs()).collect();
        let (low, high) = extrema(&q);
        debug_assert!((over_q.1 + 1) * (over_speed.1 + 1) <= MOST_FUNCTIONS);
        let load = Basis::new(low, high, LOAD_PIECES, 3);
        let damping_q = Basis::new(low, high, over_q.0, over_q.1);
        let fastest = quantile(&speed, 0.999).max(1e-9).sqrt();
        let damping_speed = Basis::new(0.0, fastest, over_speed.0, over_speed.1);
        let zeros = vec![0.0; damping_q.len() * damping_speed.len()];
        let (slowest, fastest) = extrema(&dq);
        Self {
            load_coefficients: vec![0.0; load.len()],
            load,
            damping_q,
            damping_speed,
            damping_coefficients: [zeros.clone(), zeros],
            valves: [Valve::default(), Valve::default()],
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
        let before = self.proportional(q, dq);
        let valve = &self.valves[usize::from(dq < 0.0)];
        if valve.is_straight() || dq == 0.0 {
            return before;
        }
        valve.effort(before * dq.abs()) / dq.abs()
    }

    /// Takes the damping that `other` has at the slowest fifth of the motion's samples.
    pub(crate) fn damp_as_slow(&mut self, other: &Self, motion: &Motion) {
        let speeds: Vec<f64> = motion.at_kept(&motion.dq).iter().map(|v| v.abs()).collect();
        let slow = quantile(&speeds, 0.2);
        for (coefficients, dq) in self.damping_coefficients.iter_mut().zip([slow, -slow]) {
            for (j, c) in coefficients.iter_mut().enumerate() {
                *c = other.damping(self.damping_q.centre(j), dq);
            }
        }
    }

    /// The damping before the valve.
    fn proportional(&self, q: f64, dq: f64) -> f64 {
        self.proportional_of(self.tensor(q, dq.abs()), dq)
    }

    /// The damping before the valve where these functions are not zero.
    fn proportional_of(&self, functions: impl Iterator<Item = (usize, f64)>, dq: f64) -> f64 {
        let coefficients = &self.damping_coefficients[usize::from(dq < 0.0)];
        functions
            .map(|(index, value)| coefficients[index] * value)
            .sum()
    }

    /// What the valve of the direction of `dq` is given at each sample of a motion; `on` = [`SplineMechanism::on`] of it.
    pub(crate) fn proportional_efforts(&self, motion: &Motion, on: &OnMotion) -> Vec<f64> {
        let samples = self.functions_at_samples(on).zip(&motion.dq);
        samples
            .map(|(here, &dq)| self.proportional_of(here.iter().copied(), dq) * dq.abs())
            .collect()
    }

    fn functions_at_samples<'a>(
        &self,
        on: &'a OnMotion,
    ) -> impl Iterator<Item = &'a [(usize, f64)]> {
        on.damping.chunks_exact(self.functions_at_a_state())
    }

    /// How many functions of the damping are not zero at a state.
    fn functions_at_a_state(&self) -> usize {
        (self.damping_q.degree() + 1) * (self.damping_speed.degree() + 1)
    }

    /// Effort of the damping at each sample of a motion; `on` = [`SplineMechanism::on`] of it.
    pub(crate) fn damping_efforts(&self, motion: &Motion, on: &OnMotion) -> Vec<f64> {
        let efforts = self.proportional_efforts(motion, on).into_iter();
        let behind = |(u, &dq): (f64, &f64)| {
            if dq < 0.0 {
                -self.valves[1].effort(u)
            } else {
                self.valves[0].effort(u)
            }
        };
        efforts.zip(&motion.dq).map(behind).collect()
    }

    /// Moves the constant part of the damping out of the mechanism and gives it, to be added to viscous friction. Behind a
    /// valve that bends it stays.
    pub fn take_common_damping(&mut self) -> f64 {
        if !self.valves.iter().all(Valve::is_straight) {
            return 0.0;
        }
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

    /// Takes a load over the coordinate out of g, by least squares over its interval: exactly what is a cubic, such as a straight line.
    pub fn take_load(&mut self, load: impl Fn(f64) -> f64) {
        let (low, high) = self.load.interval();
        let (count, places) = (self.load.len(), 4 * self.load.len());
        let (mut gram, mut right) = (DMatrix::zeros(count, count), DVector::zeros(count));
        for k in 0..=places {
            let q = low + (high - low) * k as f64 / places as f64;
            let (first, values) = self.load.evaluate(q);
            let values = &values[..=self.load.degree()];
            for (i, value) in values.iter().enumerate() {
                right[first + i] += value * load(q);
                for (j, other) in values.iter().enumerate() {
                    gram[(first + i, first + j)] += value * other;
                }
            }
        }
        let Some(gram) = gram.cholesky() else {
            unreachable!("splines are independent at more places than there are of them")
        };
        let taken = gram.solve(&right);
        for (coefficient, taken) in self.load_coefficients.iter_mut().zip(taken.iter()) {
            *coefficient -= taken;
        }
    }

    /// Number of coefficients: load, opening, closing, and two per bend of a valve.
    #[must_use]
    pub fn len(&self) -> usize {
        let bends: usize = self.valves.iter().map(|valve| valve.bends.len()).sum();
        self.first_bend() + 2 * bends
    }

    /// Never: there is always a load.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Where the valves' coefficients begin.
    pub(crate) fn first_bend(&self) -> usize {
        self.load.len() + 2 * self.damping_coefficients[0].len()
    }

    /// All coefficients: load, damping when opening and when closing, then place and slope of each bend of the valves.
    #[must_use]
    pub fn coefficients(&self) -> Vec<f64> {
        let [opening, closing] = &self.damping_coefficients;
        let bends = self.valves.iter().flat_map(|valve| &valve.bends);
        let linear = self.load_coefficients.iter().chain(opening).chain(closing);
        linear
            .copied()
            .chain(bends.flat_map(|bend| [bend.at, bend.slope]))
            .collect()
    }

    /// Sets all coefficients, in the order of [`SplineMechanism::coefficients`]; bends stay in order and apart.
    pub fn set(&mut self, coefficients: &[f64]) {
        let (load, rest) = coefficients.split_at(self.load.len().min(coefficients.len()));
        self.load_coefficients = load.to_vec();
        let half = self.damping_coefficients[0].len();
        let (opening, rest) = rest.split_at(half.min(rest.len()));
        let (closing, bends) = rest.split_at(half.min(rest.len()));
        self.damping_coefficients = [opening.to_vec(), closing.to_vec()];
        let mut bends = bends.chunks_exact(2);
        for valve in &mut self.valves {
            let mut least = 0.0;
            for (bend, new) in valve.bends.iter_mut().zip(&mut bends) {
                *bend = Bend {
                    at: new[0].max(least),
                    slope: new[1],
                };
                least = 1.05 * bend.at;
            }
        }
    }

    /// Bounds of the coefficients.
    #[must_use]
    pub fn bounds(&self) -> Vec<Bound> {
        let mut bounds = vec![Bound::Free; self.load.len()];
        bounds.resize(self.len(), Bound::NonNegative);
        bounds
    }

    /// Its functions on a motion.
    #[must_use]
    pub fn on(&self, motion: &Motion) -> OnMotion {
        let loads = || {
            let functions = self.load.degree() + 1;
            let mut load = SparseColumns::with_capacity(motion.q.len(), functions);
            for &q in &motion.q {
                let (first, values) = self.load.evaluate(q);
                load.push((first..).zip(values).take(functions));
            }
            motion.sparse_regressor(&load, self.load.len())
        };
        let dampings = || {
            let functions = self.functions_at_a_state();
            let coefficients = self.damping_coefficients[0].len();
            let mut damping = Vec::with_capacity(functions * motion.q.len());
            let mut entries = SparseColumns::with_capacity(motion.q.len(), functions);
            for (&q, &dq) in motion.q.iter().zip(&motion.dq) {
                let start = usize::from(dq < 0.0) * coefficients;
                let here = damping.len();
                damping.extend(self.tensor(q, dq.abs()));
                entries.push(
                    damping[here..]
                        .iter()
                        .map(|(j, value)| (start + j, value * dq)),
                );
            }
            let straight = motion.sparse_regressor(&entries, 2 * coefficients);
            (damping, straight)
        };
        let (load, (damping, straight)) = both(loads, dampings);
        OnMotion {
            load,
            damping,
            straight,
        }
    }

    /// Effort per coefficient near the coefficients it has, filtered like the measured effort; `on` = [`SplineMechanism::on`]
    /// of this motion.
    #[must_use]
    pub fn linearised(&self, motion: &Motion, on: &OnMotion) -> Linearised {
        if self.valves.iter().all(Valve::is_straight) {
            return Linearised {
                damping: on.straight.clone(),
                rest: vec![0.0; on.straight.nrows()],
            };
        }
        let first = self.load.len();
        let total = self.len() - first;
        let bends =
            [0, 2 * self.valves[0].bends.len()].map(|after| self.first_bend() - first + after);
        // Only behind a bend there is anything else than behind a straight valve.
        let mut entries = SparseColumns::with_capacity(motion.q.len(), self.functions_at_a_state());
        for (here, &dq) in self.functions_at_samples(on).zip(&motion.dq) {
            let closing = usize::from(dq < 0.0);
            let valve = &self.valves[closing];
            let u = self.proportional_of(here.iter().copied(), dq) * dq.abs();
            if valve.bends.first().is_none_or(|bend| u <= bend.at) {
                entries.push([]);
                continue;
            }
            let start = closing * self.damping_coefficients[0].len();
            let change = (valve.slope(u) - 1.0) * dq;
            let own = here.iter().map(|(j, value)| (start + j, change * value));
            let sign = if closing == 1 { -1.0 } else { 1.0 };
            entries.push(own.chain(bends_of(valve, u, sign, bends[closing], total)));
        }
        let mut damping = motion.sparse_regressor(&entries, total + 1);
        let rest = damping.column(total).iter().copied().collect();
        damping = damping.resize_horizontally(total, 0.0);
        let mut linear = damping.columns_mut(0, on.straight.ncols());
        linear += &on.straight;
        Linearised { damping, rest }
    }

    /// Effort per coefficient of the damping, counted from the first, where the valve is given `u`.
    fn damping_row(&self, q: f64, dq: f64, u: f64) -> impl Iterator<Item = (usize, f64)> {
        let closing = usize::from(dq < 0.0);
        let slope = self.valves[closing].slope(u);
        let start = closing * self.damping_coefficients[0].len();
        self.tensor(q, dq.abs())
            .map(move |(index, value)| (start + index, slope * value * dq))
    }

    /// Effort per coefficient of load and damping at a state, unfiltered; the valves' bends stay where they are.
    pub(crate) fn linear_row(&self, q: f64, dq: f64) -> impl Iterator<Item = (usize, f64)> {
        let (first, values) = self.load.evaluate(q);
        let load = (first..).zip(values).take(self.load.degree() + 1);
        let u = self.proportional(q, dq) * dq.abs();
        let loads = self.load.len();
        let damping = self.damping_row(q, dq, u);
        load.chain(damping.map(move |(index, value)| (loads + index, value)))
    }

    /// Penalties of roughness of g and of c over q, whose strengths are chosen, and a fixed one that keeps c small and, as a
    /// surface, even over speed; each (coefficients, coefficients).
    ///
    /// Behind valves the penalties depend on the damping there is: c is held constant and near zero but where it has a step
    /// or is not small, so that edges stay sharp and damping that viscous friction explains is left to it.
    #[must_use]
    pub fn penalties(&self) -> [DMatrix<f64>; 3] {
        let total = self.len();
        let mut load = DMatrix::zeros(total, total);
        load.view_mut((0, 0), (self.load.len(), self.load.len()))
            .copy_from(&self.load.penalty(2));
        let surface = self.damping_coefficients[0].len();
        let twice = |block: &dyn Fn(&[f64]) -> DMatrix<f64>| {
            let mut full = DMatrix::zeros(total, total);
            for (direction, coefficients) in self.damping_coefficients.iter().enumerate() {
                let at = self.load.len() + direction * surface;
                full.view_mut((at, at), (surface, surface))
                    .copy_from(&block(coefficients));
            }
            full
        };
        if self.damping_speed.degree() == 0 {
            let squares = self.damping_coefficients.iter().flatten().map(|c| c * c);
            let size = squares.sum::<f64>() / (2 * surface) as f64;
            let weight = |change: f64| {
                if size > 0.0 {
                    1.0 / (SMALL + change * change / size)
                } else {
                    1.0
                }
            };
            let over_q = |c: &[f64]| {
                let steps: Vec<f64> = c.windows(2).map(|w| weight(w[1] - w[0])).collect();
                self.damping_q.weighted_penalty(&steps)
            };
            let level = |c: &[f64]| {
                let levels = c.iter().map(|c| LEVEL * weight(*c));
                DMatrix::from_diagonal(&DVector::from_iterator(surface, levels))
            };
            return [load, twice(&over_q), twice(&level)];
        }
        let one = |n: usize| DMatrix::<f64>::identity(n, n);
        let (nq, nv) = (self.damping_q.len(), self.damping_speed.len());
        let over_q = self.damping_q.penalty(2).kronecker(&one(nv));
        let over_speed =
            one(nq).kronecker(&self.damping_speed.penalty(1)) * 0.03 + one(nq * nv) * 1e-4;
        [
            load,
            twice(&|_| over_q.clone()),
            twice(&|_| over_speed.clone()),
        ]
    }

    /// Functions of the damping that are not zero at a state, and their values: as many at each.
    #[inline]
    fn tensor(&self, q: f64, speed: f64) -> impl Iterator<Item = (usize, f64)> {
        let (first_q, in_q) = self.damping_q.evaluate(q);
        let (first_speed, in_speed) = self.damping_speed.evaluate(speed.sqrt());
        let (over_q, over_speed) = (self.damping_q.degree(), self.damping_speed.degree());
        let speeds = self.damping_speed.len();
        let mut functions = [(0, 0.0); MOST_FUNCTIONS];
        let mut places = functions.iter_mut();
        for (i, in_q) in (first_q..).zip(in_q).take(over_q + 1) {
            let over_speed = (first_speed..).zip(in_speed).take(over_speed + 1);
            for ((j, in_speed), place) in over_speed.zip(&mut places) {
                *place = (i * speeds + j, in_q * in_speed);
            }
        }
        functions.into_iter().take(self.functions_at_a_state())
    }
}

/// Entries of a valve's bends, from column `first` on, and in column `rest` what the linear effort of all coefficients lacks.
fn bends_of(
    valve: &Valve,
    u: f64,
    sign: f64,
    first: usize,
    rest: usize,
) -> impl Iterator<Item = (usize, f64)> {
    let by_bends = valve.by_bends(u).zip(&valve.bends);
    let linear = valve.slope(u) * u
        + by_bends
            .map(|(by, bend)| by[0] * bend.at + by[1] * bend.slope)
            .sum::<f64>();
    let lacking = (rest, sign * (valve.effort(u) - linear));
    let bends = valve
        .by_bends(u)
        .flatten()
        .enumerate()
        .map(move |(j, by)| (first + j, sign * by));
    bends.chain((lacking.1 != 0.0).then_some(lacking))
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
pub(crate) mod tests {
    use super::*;
    use crate::motion::MotionSettings;
    use crate::samples::JointSamples;
    use crate::screw::JointKind;

    /// Strokes of half a unit about the middle, without noise.
    pub(crate) fn motion() -> Motion {
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
            aside: crate::samples::Aside::default(),
        };
        Motion::prepare(&samples, &MotionSettings::default()).unwrap()
    }

    /// What the columns give with the coefficients, and the columns of the damping.
    fn given(mechanism: &SplineMechanism, motion: &Motion) -> (DVector<f64>, Linearised) {
        let on = mechanism.on(motion);
        let linear = mechanism.linearised(motion, &on);
        let mut coefficients = DVector::from_vec(mechanism.coefficients());
        let rest = coefficients.rows(on.load.ncols(), linear.damping.ncols());
        let given = &linear.damping * rest;
        coefficients = coefficients.rows(0, on.load.ncols()).into_owned();
        (on.load * coefficients + given, linear)
    }

    #[test]
    fn the_regressor_is_the_effort_by_coefficient() {
        let motion = motion();
        let mut mechanism = SplineMechanism::over(&motion);
        let coefficients: Vec<f64> = (0..mechanism.len())
            .map(|j| ((j * 7) % 5) as f64 * 0.3)
            .collect();
        mechanism.set(&coefficients);
        let (by_column, _) = given(&mechanism, &motion);
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
    fn behind_a_valve_the_columns_and_the_rest_give_the_effort_and_its_change() {
        let motion = motion();
        let mut mechanism = SplineMechanism::valved(&motion);
        let bend = Bend {
            at: 1.0,
            slope: 1.0,
        };
        mechanism.valves[0].bends = vec![bend];
        mechanism.valves[1].bends = vec![bend; 2];
        let first_bend = mechanism.first_bend();
        let mut coefficients: Vec<f64> = (0..first_bend)
            .map(|j| 1.0 + ((j * 7) % 5) as f64)
            .collect();
        coefficients.extend([0.7, 0.4, 1.5, 0.1, 2.5, 0.6]);
        mechanism.set(&coefficients);
        assert_eq!(mechanism.coefficients(), coefficients);
        let effort = |mechanism: &SplineMechanism| {
            let states = motion.q.iter().zip(&motion.dq);
            let raw: Vec<f64> = states.map(|(q, dq)| mechanism.effort(*q, *dq)).collect();
            motion.regressor(&raw).unwrap()
        };
        let here = effort(&mechanism);
        let (given, linear) = given(&mechanism, &motion);
        for ((g, r), e) in given.iter().zip(&linear.rest).zip(&here) {
            assert!((g + r - e).abs() < 1e-9);
        }
        let loads = mechanism.load.len();
        for j in [25, 70].into_iter().chain(first_bend..coefficients.len()) {
            let mut other = mechanism.clone();
            let mut moved = coefficients.clone();
            moved[j] += 1e-5;
            other.set(&moved);
            let there = effort(&other);
            let error: f64 = (0..here.len())
                .map(|k| ((there[k] - here[k]) / 1e-5 - linear.damping[(k, j - loads)]).abs())
                .fold(0.0, f64::max);
            assert!(error < 2e-3, "{j}: {error}");
        }
    }

    #[test]
    fn a_load_that_is_taken_out_is_missing_everywhere() {
        let motion = motion();
        let mut mechanism = SplineMechanism::over(&motion);
        given(&mechanism, &motion);
        let coefficients: Vec<f64> = (0..mechanism.len())
            .map(|i| (i as f64).sin().abs())
            .collect();
        mechanism.set(&coefficients);
        let before = mechanism.clone();
        let [low, high] = before.domain.q;
        let line = |q: f64| 2.0 - 3.0 * q;
        let weight = |q: f64| 50.0 * q.sin();
        let loads: [(&dyn Fn(f64) -> f64, f64); 2] = [(&line, 1e-12), (&weight, 1e-3)];
        for (load, most) in loads {
            let mut mechanism = mechanism.clone();
            mechanism.take_load(load);
            for i in 0..=20 {
                let q = low + (high - low) * f64::from(i) / 20.0;
                let missing = before.effort(q, 0.2) - mechanism.effort(q, 0.2);
                assert!((missing - load(q)).abs() < most, "{q}: {missing}");
            }
        }
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
