//! Motion and dynamics fitted together, so that the wrench tells of the acceleration too.
//!
//! On a heavy object the tracker's noise, differentiated twice and multiplied by the inertia, is far above the wrench's: plain
//! differentiation takes it as it comes. Here the motion is a curve of quintic B-splines, and one fit finds the curve and the
//! parameters that are likeliest for both sensors:
//!
//! ```text
//! (q measured - q(t)) whitened by the tracker's own noise,   (tau - model(q, dq, ddq)) / effort's noise   -> least squares
//! ```
//!
//! Gauss and Newton's steps; each is a band (the curve) with a border (the parameters). The effort's noise is what makes both
//! series likeliest (marginal likelihood, the curve integrated out). Effort counts where the joint slides, away from
//! reversals: there sticking makes kinks that neither the curve nor the model has.
//!
//! The smoothness of the mechanism is that of the plain fit. Which parts of its damping are there is taken from it too. Without a
//! mechanism the shapes of the effects are fitted as well.

mod arrow;
mod colour;
mod covariance;
mod curve;
mod measured;
mod position;
mod shapes;

use nalgebra::{DMatrix, DVector};

use super::Term;
use super::design::{Design, scaled};
use crate::effect::Effect;
use crate::least_squares::{Bound, bounded_quadratic, rms};
use crate::mechanism::{Mechanism, SplineMechanism};
use crate::motion::{Motion, MotionError};
use crate::parallel::in_parallel_on;
use arrow::{Arrow, Eliminated};
use colour::Colour;
use curve::{Curve, LOCAL, Weights};
use measured::{tool_acceleration, upper_band, used_samples};
use position::position_equations;
use shapes::{Moved, Shapes};

/// Distance of the curve's knots, s: it follows a hand's motion up to about 15 Hz.
const KNOTS_S: f64 = 0.03;
/// Gauss and Newton's steps, at most.
const STEPS: usize = 8;
/// The same where shapes are fitted, and below which change of theirs these are steady.
const SHAPED_STEPS: usize = 16;
const STEADY: f64 = 1e-3;
/// Fits that are made at a time: each takes a good part of the memory that an hour takes.
const AT_ONCE: usize = 2;
/// Coefficients of the mechanism that an effort depends on, at most: of the load, and of the damping as a surface.
const MOST_SPLINES: usize = 10;
/// Place of viscous friction among the parameters.
const VISCOUS: usize = 2;
/// Inertia, dry and viscous friction are so many parameters.
const RIGID: usize = 3;
/// What the parameters are held with where they were, in the units of a diagonal element: a named line and the load's own are the same
/// effort, and rounding would carry the two away from each other without end.
const HELD: f64 = 1e-6;
/// The same without a mechanism: what the data hardly tell apart stays as uncertain as it is.
const HARDLY_HELD: f64 = 1e-12;
/// What holds a shape at its limit, in the same units.
const FIXED: f64 = 1e6;
/// So many standard deviations of their difference two fits differ by chance.
const DOUBTED: f64 = 2.0;
/// Effort noise that is tried, over the sensor's.
const NOISES: [f64; 9] = [1.0, 1.4, 2.0, 2.8, 4.0, 5.7, 8.0, 16.0, 32.0];

/// What the joint fit gives.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct JointFit {
    /// Inertia, Coulomb and viscous friction, in the order and units of the plain fit.
    pub terms: Vec<Term>,
    /// Standard deviation of an effort sample at the work rate, N m or N.
    pub effort_noise: f64,
    /// Root mean square residual of the effort along the fitted motion, filtered and sampled as in the plain fit.
    pub rms: f64,
    /// The same on strokes whose effort had no part in the parameters. Their motion is known by it all the same.
    pub held_out_rms: f64,
    /// Whether the full model has these parameters: they are more certain than those of the plain fit, and it lacks nothing; or it is the named effects
    /// alone, which are fitted so.
    pub stands: bool,
}

/// The joint fit as a model.
pub(super) struct Together {
    pub(super) fit: JointFit,
    /// Parameters of the effects, as [`Plain::theta`].
    pub(super) theta: DVector<f64>,
    /// Steps by which their shapes were moved, effect by effect; none beside a mechanism.
    pub(super) steps: Vec<f64>,
    /// Of these parameters and steps.
    pub(super) covariance: DMatrix<f64>,
    /// What goes with them.
    pub(super) mechanism: SplineMechanism,
    /// Lowest place of each visit of the motion to its low end.
    pub(super) lowest: Vec<f64>,
    /// Whether the steps came to rest.
    pub(super) converged: bool,
}

impl Together {
    /// Whether it came to rest and its inertia and friction are more certain than the plain fit's `theta`. Behind valves it is not
    /// asked: here their bends stay where they are, there they do not.
    pub(super) fn is_more_certain(&self, theta: &DVector<f64>, plain: &DMatrix<f64>) -> bool {
        let bends = self.mechanism.len() > self.mechanism.first_bend();
        self.converged && !bends && more_certain([&self.theta, theta], [&self.covariance, plain])
    }

    /// Whether its inertia and friction are at the same bounds as those of a plain fit.
    pub(super) fn has_bounds_of(&self, plain: &DVector<f64>) -> bool {
        at_same_bounds(&self.theta.as_slice()[..RIGID], plain.as_slice())
    }

    /// Counts what its inertia and friction differ by from the plain fit's, by more than both scatter, as uncertainty: of the two the
    /// plain fit presumes less. `common` = damping of the plain fit's mechanism that is viscous friction.
    pub(super) fn doubt(&mut self, theta: &DVector<f64>, common: f64, plain: &DMatrix<f64>) {
        for (j, term) in self.fit.terms.iter_mut().enumerate() {
            let other = theta[j] + if j == VISCOUS { common } else { 0.0 };
            let off = (term.value.unwrap_or(other) - other).powi(2);
            if off > DOUBTED.powi(2) * (self.covariance[(j, j)] + plain[(j, j)]) {
                self.covariance[(j, j)] += off;
                term.std = Some(self.covariance[(j, j)].sqrt());
            }
        }
    }
}

fn at_same_bounds(ours: &[f64], plain: &[f64]) -> bool {
    ours.iter()
        .zip(plain)
        .all(|(a, b)| (*a == 0.0) == (*b == 0.0))
}

/// Whether the product of the variances of inertia and friction is smaller in the first than in the second, both being at the same
/// bounds: what a parameter at its bound scatters has no place in the comparison.
fn more_certain(theta: [&DVector<f64>; 2], covariance: [&DMatrix<f64>; 2]) -> bool {
    let [ours, plain] = theta;
    let at_same_bounds = at_same_bounds(ours.as_slice(), plain.as_slice());
    let [of_ours, of_plain] = covariance;
    let ratio: f64 = (0..RIGID)
        .filter(|j| ours[*j] != 0.0)
        .map(|j| of_ours[(j, j)] / of_plain[(j, j)])
        .product();
    at_same_bounds && ratio < 1.0
}

/// Where the plain fit ended.
pub(super) struct Plain<'a> {
    /// Parameters of the effects, in the order of their columns.
    pub(super) theta: &'a [f64],
    /// The mechanism; there is none where `design` has no columns of it.
    pub(super) mechanism: &'a SplineMechanism,
    /// The design that it was solved with.
    pub(super) design: &'a Design,
    /// Smoothing of load and damping.
    pub(super) smoothing: &'a [f64; 2],
}

/// Fits motion and dynamics together from where the plain fit ended; nothing when the equations are singular.
///
/// # Errors
/// When a series does not fit the motion.
pub(super) fn fit(
    motion: &Motion,
    effects: &[&dyn Effect],
    plain: &Plain<'_>,
) -> Result<Option<Together>, MotionError> {
    let Some(problem) = Problem::new(motion, effects, plain) else {
        return Ok(None);
    };
    problem.solve()
}

struct Problem<'a> {
    motion: &'a Motion,
    effects: &'a [&'a dyn Effect],
    /// The shapes that are fitted, whose steps are the last of the parameters.
    shapes: Shapes,
    mechanism: SplineMechanism,
    /// Of each linear coefficient of the mechanism its place among the parameters; nothing when it is held at zero.
    places: Vec<Option<usize>>,
    /// Parameters of effects, which come first.
    linear: usize,
    bounds: Vec<Bound>,
    penalty: DMatrix<f64>,
    /// See [`HELD`].
    hold: f64,
    curve: Curve,
    colour: Colour,
    /// The equations of the curve by the measured coordinate alone, whitened.
    position: Arrow,
    /// Samples whose effort counts, and which of the fit's samples each is near.
    used: Vec<(usize, usize)>,
    sensor: f64,
    start: DVector<f64>,
    /// The acceleration by which the tool's own inertia was taken off the effort.
    taken_off: Vec<f64>,
}

/// A motion along the curve, and what the effort there depends on.
struct Place {
    motion: Motion,
    theta: DVector<f64>,
    /// With the parameters.
    mechanism: SplineMechanism,
    /// The effects with their shapes there.
    moved: Moved,
    /// Regressors of each of them, unfiltered.
    series: Vec<Vec<Vec<f64>>>,
}

/// What the effort changes by at a place, at each sample.
struct Slopes {
    /// Per change of the coordinate, the velocity and the acceleration; where the effort counts, and without the inertia's.
    by_state: Vec<[f64; 3]>,
    /// Per step of each shape.
    by_shape: Vec<Vec<f64>>,
}

impl<'a> Problem<'a> {
    fn new(motion: &'a Motion, effects: &'a [&'a dyn Effect], plain: &Plain<'_>) -> Option<Self> {
        let curve = Curve::new(&motion.runs, motion.period, KNOTS_S);
        let colour = Colour::of(&motion.noise_of_q, &motion.runs)
            .unwrap_or_else(|| Colour::white(upper_band(motion, &motion.q_measured)));
        let linear = plain.theta.len();
        let coefficients = plain.mechanism.coefficients();
        let all = plain.mechanism.bounds();
        let columns = plain.design.y.ncols();
        let (mut places, mut bounds) = (Vec::new(), plain.design.bounds[..linear].to_vec());
        let mut start = plain.theta.to_vec();
        let mut chosen: Vec<usize> = (0..linear).collect();
        for (j, value) in coefficients[..plain.mechanism.first_bend()]
            .iter()
            .enumerate()
        {
            let is_there = linear + j < columns;
            let held = !is_there || all[j] == Bound::NonNegative && *value == 0.0;
            places.push((!held).then_some(start.len()));
            if !held {
                start.push(*value);
                bounds.push(all[j]);
                chosen.push(linear + j);
            }
        }
        let used = used_samples(motion);
        let none = DMatrix::zeros(columns, columns);
        let mut penalty = plain
            .design
            .penalized(&none, plain.smoothing, 1.0)
            .select_rows(&chosen)
            .select_columns(&chosen)
            * (used.len() as f64 / motion.kept.len().max(1) as f64);
        // Beside a mechanism a shape is nothing that data show.
        let shapes = if columns > linear {
            Shapes::default()
        } else {
            Shapes::of(effects, motion)
        };
        let count = start.len() + shapes.len();
        penalty = penalty.resize(count, count, 0.0);
        start.resize(count, 0.0);
        bounds.resize(count, Bound::Free);
        let position = position_equations(motion, &curve, &colour);
        let taken_off = tool_acceleration(motion)?;
        (colour.new_std > 0.0 && used.len() > 2 * start.len()).then_some(Self {
            motion,
            effects,
            shapes,
            mechanism: plain.mechanism.clone(),
            places,
            linear,
            bounds,
            penalty,
            hold: if columns > linear { HELD } else { HARDLY_HELD },
            curve,
            colour,
            position,
            used,
            sensor: upper_band(motion, &motion.tau).max(f64::MIN_POSITIVE),
            start: DVector::from_vec(start),
            taken_off,
        })
    }

    fn solve(self) -> Result<Option<Together>, MotionError> {
        let mut theta = self.start.clone();
        let Some(alone) = self.position.clone().eliminate() else {
            return Ok(None);
        };
        let x = alone.coefficients(&DVector::zeros(0));
        drop(alone);
        let mut noise = self.sensor;
        let mut place = self.place(&x, &theta)?;
        let mut converged = false;
        let most = if self.shapes.is_empty() {
            STEPS
        } else {
            SHAPED_STEPS
        };
        for step in 0..most {
            let effort = self.effort(&place, &self.slopes(&place)?, |_| true);
            // Each of these is a good part of the memory that an hour takes.
            drop(place);
            if step < 2 {
                noise = self.likeliest_noise(&effort, &theta).unwrap_or(noise);
            }
            let Some(eliminated) = self.whole(effort, noise) else {
                return Ok(None);
            };
            let before = theta;
            theta = self.minimum(&eliminated, &before);
            let x = eliminated.coefficients(&theta);
            drop(eliminated);
            place = self.place(&x, &theta)?;
            let change = (&theta - &before).component_div(&before.map(|v| v.abs().max(1e-9)));
            let steps = self.steps(&theta) - self.steps(&before);
            converged = step >= 2 && change.rows(0, 3).amax() < 1e-4 && steps.amax() < STEADY;
            if converged {
                break;
            }
        }
        let slopes = self.slopes(&place)?;
        let Some(eliminated) = self.whole(self.effort(&place, &slopes, |_| true), noise) else {
            return Ok(None);
        };
        let at_bound: Vec<bool> = (0..theta.len())
            .map(|j| self.bounds[j] == Bound::NonNegative && theta[j] == 0.0)
            .collect();
        let Some(held_out_rms) = self.held_out((&place, &slopes), &eliminated, noise)? else {
            return Ok(None);
        };
        let covariance = self.covariance((&place, &slopes), eliminated, noise, &at_bound);
        let residual = self.filtered_residual(&place)?;
        let viscous = theta[VISCOUS] + place.mechanism.clone().take_common_damping();
        let kind = self.motion.kind;
        let units = [
            ("inertia", kind.inertia_unit()),
            ("coulomb", kind.effort_unit()),
            ("viscous", kind.viscous_unit()),
        ];
        let terms = units.iter().enumerate().map(|(j, (name, unit))| Term {
            name: (*name).to_owned(),
            value: Some(if j == VISCOUS { viscous } else { theta[j] }),
            std: Some(covariance[(j, j)].max(0.0).sqrt()),
            unit: (*unit).to_owned(),
        });
        let fit = JointFit {
            terms: terms.collect(),
            effort_noise: noise,
            rms: rms(&residual),
            held_out_rms,
            stands: false,
        };
        Ok(Some(Together {
            fit,
            steps: self.steps(&theta).as_slice().to_vec(),
            theta: theta.rows(0, self.linear).into_owned(),
            covariance,
            lowest: place.motion.visits_to_the_low_end(),
            mechanism: place.mechanism,
            converged,
        }))
    }

    /// The motion along the curve with coefficients `x`, with parameters `theta`.
    fn place(&self, x: &[f64], theta: &DVector<f64>) -> Result<Place, MotionError> {
        let motion = self.along(x);
        let steps = self.steps(theta);
        let moved = self
            .shapes
            .moved(self.effects, self.motion, steps.as_slice());
        Ok(Place {
            series: self.series(&moved, &motion)?,
            motion,
            theta: theta.clone(),
            mechanism: self.mechanism_with(theta),
            moved,
        })
    }

    /// The steps of the shapes, which are the last parameters.
    fn steps(&self, theta: &DVector<f64>) -> DVector<f64> {
        let count = self.shapes.len();
        theta.rows(theta.len() - count, count).into_owned()
    }

    /// The mechanism with the parameters put in.
    fn mechanism_with(&self, theta: &DVector<f64>) -> SplineMechanism {
        let mut mechanism = self.mechanism.clone();
        let mut coefficients = mechanism.coefficients();
        for (value, place) in coefficients.iter_mut().zip(&self.places) {
            *value = place.map_or(0.0, |place| theta[place]);
        }
        mechanism.set(&coefficients);
        mechanism
    }

    /// The motion with the curve's states in place of the smoothed ones; so is what the tool's own inertia takes of the effort.
    fn along(&self, x: &[f64]) -> Motion {
        let places = self.curve.at_samples();
        let of = |k: usize| -> Vec<f64> {
            let value = |(first, weights): &(usize, &Weights)| {
                weights[k]
                    .iter()
                    .zip(&x[*first..])
                    .map(|(w, c)| w * c)
                    .sum()
            };
            places.iter().map(value).collect()
        };
        let motion = self.motion.with_states([of(0), of(1), of(2)]);
        let accelerations = self.taken_off.iter().zip(&motion.ddq);
        let tau = (motion.tau.iter().zip(accelerations))
            .map(|(tau, (taken_off, along))| tau + self.motion.tool_inertia * (taken_off - along))
            .collect();
        motion.with_effort(tau)
    }

    /// Regressors of each effect, moved.
    fn series(&self, moved: &Moved, motion: &Motion) -> Result<Vec<Vec<Vec<f64>>>, MotionError> {
        let effects = moved.effects(self.effects);
        effects.map(|effect| effect.series(motion)).collect()
    }

    fn slopes(&self, place: &Place) -> Result<Slopes, MotionError> {
        let terms: Vec<usize> = place.series.iter().map(Vec::len).collect();
        let by_shape = self.shapes.derivatives(
            (self.effects, &terms),
            (self.motion, &place.motion),
            &place.theta,
        )?;
        let by_state = self.slopes_by_state(place)?;
        Ok(Slopes { by_state, by_shape })
    }

    fn slopes_by_state(
        &self,
        Place {
            motion,
            theta,
            mechanism,
            series,
            moved: effects,
        }: &Place,
    ) -> Result<Vec<[f64; 3]>, MotionError> {
        let series: Vec<&Vec<f64>> = series.iter().flatten().collect();
        let domain = &mechanism.domain;
        let most = motion
            .ddq
            .iter()
            .fold(0.0_f64, |most, ddq| most.max(ddq.abs()));
        let small =
            [domain.q, domain.dq, [-most, most]].map(|[low, high]| 1e-4 * (high - low).max(1e-9));
        let mut out = vec![[0.0; 3]; motion.q.len()];
        for &(i, _) in &self.used {
            let (q, dq) = (motion.q[i], motion.dq[i]);
            let [by_q, by_dq] = [[small[0], 0.0], [0.0, small[1]]].map(|[step, faster]| {
                mechanism.effort(q + step, dq + faster) - mechanism.effort(q - step, dq - faster)
            });
            out[i] = [by_q / (2.0 * small[0]), by_dq / (2.0 * small[1]), 0.0];
        }
        for (k, small) in small.into_iter().enumerate() {
            let mut moved = motion.clone();
            let shifted = [&mut moved.q, &mut moved.dq, &mut moved.ddq];
            for shifted in shifted.into_iter().skip(k).take(1) {
                shifted.iter_mut().for_each(|v| *v += small);
            }
            // Inertia and dry friction depend on neither coordinate nor velocity, and of the acceleration only the inertia knows but
            // for named effects.
            let first = if k == 2 { RIGID } else { VISCOUS };
            if series.len() <= first {
                continue;
            }
            let moved = self.series(effects, &moved)?;
            for (j, moved) in moved.iter().flatten().enumerate().skip(first) {
                for (out, (a, b)) in out.iter_mut().zip(moved.iter().zip(series[j])) {
                    out[k] += theta[j] * (a - b) / small;
                }
            }
        }
        Ok(out)
    }

    /// The effort's equations near a place with unit noise, of those samples that are near wanted ones of the fit.
    fn effort(&self, place: &Place, slopes: &Slopes, wanted: impl Fn(usize) -> bool) -> Arrow {
        let mut out = self.position.with_params(place.theta.len());
        let used = self.used.iter().filter(|(_, near)| wanted(*near));
        self.effort_rows(
            used.map(|(i, _)| *i),
            &self.curve.at_samples(),
            (place, slopes),
            |first, curve, params, right| out.add(first, curve, params, right),
        );
        out.corner += &self.penalty;
        out
    }

    /// Calls `row` with the equation of the effort at each of `samples`: the first coefficient of the curve and what the equation has of
    /// it and those after it, what it has of the parameters, and its right side.
    fn effort_rows(
        &self,
        samples: impl Iterator<Item = usize>,
        places: &[(usize, &Weights)],
        (place, slopes): (&Place, &Slopes),
        mut row: impl FnMut(usize, &[f64], &[(usize, f64)], f64),
    ) {
        let Place {
            motion,
            theta,
            mechanism,
            series,
            ..
        } = place;
        let series: Vec<&Vec<f64>> = series.iter().flatten().collect();
        let first_step = theta.len() - self.shapes.len();
        let mut params: Vec<(usize, f64)> = Vec::with_capacity(series.len() + MOST_SPLINES);
        for i in samples {
            let (first, weights) = places[i];
            let (q, dq, ddq) = (motion.q[i], motion.dq[i], motion.ddq[i]);
            params.clear();
            params.extend(series.iter().enumerate().map(|(j, s)| (j, s[i])));
            let mut linear = 0.0;
            for (j, value) in mechanism.linear_row(q, dq) {
                if let Some(place) = self.places[j] {
                    params.push((place, value));
                    linear += value * theta[place];
                }
            }
            let mut moved = 0.0;
            for (k, derivative) in slopes.by_shape.iter().enumerate() {
                params.push((first_step + k, derivative[i]));
                moved += derivative[i] * theta[first_step + k];
            }
            let [by_q, by_dq, by_ddq] = slopes.by_state[i];
            let by = [by_q, by_dq, by_ddq + theta[0] + self.motion.tool_inertia];
            let curve: [f64; LOCAL] =
                core::array::from_fn(|j| (0..3).map(|k| by[k] * weights[k][j]).sum());
            let fixed = mechanism.effort(q, dq) - linear;
            let right = motion.tau[i] - fixed + moved + by[0] * q + by[1] * dq + by[2] * ddq;
            row(first, &curve, &params, right);
        }
    }

    /// The equations of both series, and what is known of the shapes beforehand.
    fn whole(&self, effort: Arrow, noise: f64) -> Option<Eliminated> {
        let mut both = effort.weighted_beside(1.0 / (noise * noise), &self.position);
        let first = both.corner.nrows() - self.shapes.len();
        for (k, loose) in self.shapes.looseness().enumerate() {
            both.corner[(first + k, first + k)] += loose.powi(-2);
        }
        both.eliminate()
    }

    /// The effort's noise with which both series are likeliest, the curve and the parameters integrated out.
    fn likeliest_noise(&self, effort: &Arrow, before: &DVector<f64>) -> Option<f64> {
        // The mechanism's smoothness is stated in units of the noise too.
        let smoothed = self.start.len() - self.linear - self.shapes.len();
        let samples = (self.used.len() + smoothed) as f64;
        let surprise = |noise: f64| {
            let eliminated = self.whole(effort.clone(), noise)?;
            let theta = self.minimum(&eliminated, before);
            let (corner, scale) = held(eliminated.corner(), self.hold);
            let corner = corner.cholesky()?.l();
            let of_params: f64 = corner
                .diagonal()
                .iter()
                .zip(scale.iter())
                .map(|(l, s)| 2.0 * (l * s).ln())
                .sum();
            let value = 2.0 * samples * noise.ln()
                + eliminated.log_determinant()
                + of_params
                + eliminated.square_at(&theta);
            Some((noise, value))
        };
        in_parallel_on(AT_ONCE, &NOISES, |times| surprise(times * self.sensor))
            .into_iter()
            .flatten()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(noise, _)| noise)
    }

    /// The parameters at the minimum, near those `before`.
    fn minimum(&self, eliminated: &Eliminated, before: &DVector<f64>) -> DVector<f64> {
        let (h, scale) = held(eliminated.corner(), self.hold);
        // What these equations do not have at all is not held to what it was, and comes out as none.
        let known = scale.map(|scale| {
            if scale > f64::MIN_POSITIVE.sqrt() {
                scale
            } else {
                0.0
            }
        });
        let right =
            eliminated.right().component_div(&scale) + self.hold * before.component_mul(&known);
        let warm: Vec<bool> = self.start.iter().map(|v| *v != 0.0).collect();
        let solved = |h: &DMatrix<f64>, right: &DVector<f64>| {
            bounded_quadratic(h, right, &self.bounds, Some(&warm)).component_div(&scale)
        };
        let mut theta = solved(&h, &right);
        let first = theta.len() - self.shapes.len();
        let (mut h, mut right) = (h, right);
        // What goes with a shape that is held at its limit is sought anew, which may take another one to its own.
        for _ in 0..self.shapes.len() {
            let beyond = self.shapes.beyond(&theta.as_slice()[first..]);
            if beyond.is_empty() {
                break;
            }
            for (k, limit) in beyond {
                let j = first + k;
                h[(j, j)] += FIXED;
                right[j] += FIXED * limit * scale[j];
            }
            theta = solved(&h, &right);
        }
        for (k, limit) in self.shapes.beyond(&theta.as_slice()[first..]) {
            theta[first + k] = limit;
        }
        theta
    }

    /// What the parameters leave of the effort along the motion, filtered, at the fit's samples.
    fn filtered_residual(&self, place: &Place) -> Result<Vec<f64>, MotionError> {
        let motion = &place.motion;
        let left: Vec<f64> = (0..motion.q.len())
            .map(|i| {
                let effects: f64 = place
                    .series
                    .iter()
                    .flatten()
                    .zip(place.theta.iter())
                    .map(|(series, theta)| series[i] * theta)
                    .sum();
                motion.tau[i] - effects - place.mechanism.effort(motion.q[i], motion.dq[i])
            })
            .collect();
        motion.regressor(&left)
    }

    /// Error on strokes that the parameters were not fitted to, the motion being that of `all` strokes. Nothing when less than two
    /// parts could be left out.
    fn held_out(
        &self,
        (place, slopes): (&Place, &Slopes),
        all: &Eliminated,
        noise: f64,
    ) -> Result<Option<f64>, MotionError> {
        let (fold_of, folds) = self.motion.folds();
        let scored = self.motion.covered();
        let without = |fold: usize| -> Result<_, MotionError> {
            let rest = self.effort(place, slopes, |near| fold_of[near] != fold);
            let Some(rest) = self.whole(rest, noise) else {
                return Ok(None);
            };
            let theta = self.minimum(&rest, &place.theta);
            drop(rest);
            let there = self.place(&all.coefficients(&theta), &theta)?;
            self.filtered_residual(&there).map(Some)
        };
        let each: Vec<usize> = (0..folds).collect();
        let fits = in_parallel_on(AT_ONCE, &each, |fold| without(*fold));
        let (mut square, mut samples, mut left_out) = (0.0, 0, 0);
        for (fold, fit) in fits.into_iter().enumerate() {
            let Some(residual) = fit? else {
                continue;
            };
            for (k, residual) in residual.iter().enumerate() {
                if fold_of[k] == fold && scored[k] {
                    square += residual * residual;
                    samples += 1;
                }
            }
            left_out += 1;
        }
        let rms = (square / f64::from(samples.max(1))).sqrt();
        Ok((left_out > 1).then_some(rms))
    }
}

/// A normal matrix for variables counted in units of `1 / scale`, with `hold` on its diagonal, and the scale.
fn held(matrix: &DMatrix<f64>, hold: f64) -> (DMatrix<f64>, DVector<f64>) {
    let scale = matrix.diagonal().map(|v| v.max(f64::MIN_POSITIVE).sqrt());
    let mut out = scaled(matrix, &scale);
    for j in 0..out.nrows() {
        out[(j, j)] += hold;
    }
    (out, scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_at_a_bound_of_its_own_is_not_more_certain() {
        let theta = DVector::from_row_slice(&[1.0, 0.5, 0.2]);
        let plain = DMatrix::from_diagonal_element(3, 3, 4.0);
        let is = |ours: [f64; 3], variance: f64| {
            let ours = DVector::from_row_slice(&ours);
            let covariance = DMatrix::from_diagonal_element(3, 3, variance);
            more_certain([&ours, &theta], [&covariance, &plain])
        };
        assert!(is([1.1, 0.4, 0.3], 3.0));
        assert!(!is([1.1, 0.4, 0.3], 5.0));
        assert!(!is([1.1, 0.0, 0.3], 3.0));
        assert!(!is([1.1, 0.4, 0.3], f64::NAN));
    }

    #[test]
    fn what_is_at_a_bound_in_both_is_not_compared() {
        let theta = DVector::from_row_slice(&[1.0, 0.5, 0.0]);
        let of = |variances: [f64; 3]| DMatrix::from_diagonal(&DVector::from_row_slice(&variances));
        let (wide, narrow) = (of([4.0, 4.0, 1e-9]), of([3.9, 3.9, 1.0]));
        assert!(more_certain([&theta, &theta], [&narrow, &wide]));
        assert!(!more_certain([&theta, &theta], [&wide, &narrow]));
    }
}
