//! Joint geometry and all per-sample states refined together, as a chain-shaped factor graph.
//!
//! Unknown are the axis (two tilts, and two shifts when revolute), the grasp (where the tool sits on the part: two
//! components of its position and its rotation), and for each sample the joint coordinate `q` and what the tracker has
//! wandered, `w` (position) and `v` (rotation):
//!
//! ```text
//! p = motion(q) p0 + w + white noise         log(R (motion(q) R0)^-1) = v + white noise
//! w[i] = rho w[i-1] + noise,  v likewise     (a wander of standard deviation s and time constant T, rho = exp(-dt/T))
//! ```
//!
//! Of a revolute joint's rotations only the two components across the axis count: they say where the axis points. How far
//! the tool turned about the axis is left out, because a grasp that gives, or a tracker that reads angles short, would pull
//! the radius.
//!
//! Each Gauss-Newton step is a block-tridiagonal elimination of either wander with the geometry as a border, side by side, linear in the number of
//! samples; each `q` is then where the path is nearest. The wander's size and time constant are estimated from how the residuals across the motion grow with lag, so
//! correlated noise is neither over-trusted (a covariance that counts each sample) nor averaged as if it were white.
//! A revolute joint has pitch 0 by construction.
//!
//! A track of fewer than four strokes cannot tell a wander from the shape of the path: there all noise is taken as white
//! and the covariance is inflated by the number of samples that the correlated residual is worth.

mod chain;
mod frame;
mod noise;

pub use noise::Wander;

use core::f64::consts::TAU;

use nalgebra::{DMatrix, DVector, Isometry3, Point3, SVector, UnitQuaternion, Vector3};

use crate::least_squares::effective_count;
use crate::motion::strokes;
use crate::parallel::both;
use crate::products::in_vectors;
use crate::samples::extrema;
use crate::screw::{Candidates, JointKind, PoseSamples, ScrewAxis, perpendiculars};
use chain::{Chain, Dynamics, Linearized, Measured, Step};
use frame::Frame;

/// Number of geometry parameters: tilt 2, shift 2, grasp position 2, grasp rotation 3.
const GEOMETRY: usize = 9;

/// Strokes from which on a wander can be told from the shape of the path.
const MIN_STROKES: usize = 4;

/// How often the noise is estimated anew.
const MOST_ESTIMATES: usize = 6;
/// Gauss-Newton steps at most, those included that failed.
const MOST_STEPS: usize = 24;

/// A refined joint.
#[derive(Clone, Debug, PartialEq)]
pub struct RefinedJoint {
    /// The axis. `point` lies at the height of the middle of the track along the axis.
    pub axis: ScrewAxis,
    /// Tool position on the part at q = 0, m.
    pub tool_position: Point3<f64>,
    /// Tool rotation at q = 0; identity when orientations were not used.
    pub tool_rotation: UnitQuaternion<f64>,
    /// Whether orientations were used.
    pub uses_rotations: bool,
    /// Joint coordinate of each sample of the track, rad or m.
    pub q: Vec<f64>,
    /// Standard deviation of the axis direction, rad (root of the sum of the variances of both tilts).
    pub direction_std: f64,
    /// Standard deviation of the axis position across the axis, m; 0 for a prismatic joint, whose line is free.
    pub position_std: f64,
    /// Standard deviation of the tool's distance from the axis, m; 0 for a prismatic joint.
    pub radius_std: f64,
    /// Covariance of [tilt, tilt, shift, shift], rad and m, along [`perpendiculars`] of the direction.
    pub covariance: DMatrix<f64>,
    /// Root mean square distance of the positions from the path, m.
    pub position_rms: f64,
    /// The tracker's position noise as estimated, m.
    pub position_noise: Wander,
    /// The tracker's rotation noise as estimated, rad.
    pub rotation_noise: Wander,
}

#[derive(Clone, Debug)]
struct State {
    axis: ScrewAxis,
    p0: Point3<f64>,
    r0: UnitQuaternion<f64>,
    q: Vec<f64>,
    wander: Vec<[Vector3<f64>; 2]>,
}

/// A path so many times as far from the positions as the candidate's was bent by a wander that is none, such as a marker read askew at
/// some places.
const STRAYS: f64 = 1.3;

/// Refines the chosen candidate over all samples of `track`.
#[must_use]
pub fn refine(track: &PoseSamples, chosen: &Candidates) -> RefinedJoint {
    let uses_rotations = chosen.orientation_agrees && track.has_rotations();
    let start = State::start(track, chosen, uses_rotations);
    let repeated = start.strokes() >= MIN_STROKES;
    let most = STRAYS * start.clone().distance(track);
    let refined = refined(track, start.clone(), uses_rotations, repeated);
    if repeated && refined.position_rms > most {
        return self::refined(track, start, uses_rotations, false);
    }
    refined
}

/// From `state` on; all noise is white unless strokes were `repeated`.
fn refined(
    track: &PoseSamples,
    mut state: State,
    uses_rotations: bool,
    repeated: bool,
) -> RefinedJoint {
    let mut noise = [
        Wander::start(1e-3, track.period),
        Wander::start(5e-3, track.period),
    ];
    let (mut last, mut cost) = (None, f64::INFINITY);
    // Noise and geometry follow each other until the noise settles, then the geometry goes on alone.
    let (mut settled, mut estimates) = (false, 0);
    // Where the elimination is beyond the arithmetic the matrix is better conditioned with more white noise.
    let mut whiter = 1.0;
    for _ in 0..MOST_STEPS {
        if !settled {
            let before = noise;
            noise = if repeated {
                state.estimate_noise(track, uses_rotations, noise)
            } else {
                state
                    .across(track, uses_rotations)
                    .map(|series| Wander::none(&series))
            };
            noise.iter_mut().for_each(|noise| noise.white *= whiter);
            let same = |(now, before): (&Wander, &Wander)| now.is_near(before);
            estimates += 1;
            settled = estimates == MOST_ESTIMATES || noise.iter().zip(&before).all(same);
            cost = f64::INFINITY;
        }
        let linear = state.linearize(track, uses_rotations, &noise);
        let Some((step, now)) = linear.and_then(|linear| Some((linear.solve()?, linear.cost)))
        else {
            noise.iter_mut().for_each(|noise| noise.white *= 3.0);
            (whiter, cost) = (3.0 * whiter, f64::INFINITY);
            continue;
        };
        let done = (cost - now).abs() < 1e-7 * now;
        cost = now;
        let small = state.apply(track, &step);
        last = Some((step, cost));
        if settled && (done || small) {
            break;
        }
    }
    state.finish(track, uses_rotations, noise, last, repeated)
}

impl State {
    fn start(track: &PoseSamples, chosen: &Candidates, uses_rotations: bool) -> Self {
        let mut axis = chosen.axis;
        let count = track.positions.len();
        let middle = track
            .positions
            .iter()
            .map(|p| p.coords)
            .sum::<Vector3<f64>>()
            / count.max(1) as f64;
        let along = axis.direction.into_inner() * axis.direction.dot(&(middle - axis.point.coords));
        if axis.kind == JointKind::Revolute {
            axis.point += along;
        }
        let first = track
            .positions
            .first()
            .copied()
            .unwrap_or_else(Point3::origin);
        let (q, p0) = match axis.kind {
            JointKind::Prismatic => {
                let q0 = axis.direction.dot(&(first - axis.point));
                let q = track
                    .positions
                    .iter()
                    .map(|p| axis.direction.dot(&(p - axis.point)) - q0)
                    .collect();
                (q, axis.point + axis.direction.into_inner() * q0)
            }
            JointKind::Revolute => {
                let arm = first - axis.point;
                let height = axis.direction.dot(&arm);
                let flat = arm - axis.direction.into_inner() * height;
                let level = axis.direction.dot(&(Point3::from(middle) - axis.point));
                let p0 = axis.point
                    + flat.normalize() * chosen.radius
                    + axis.direction.into_inner() * level;
                (crate::screw::angles(&track.positions, &axis), p0)
            }
        };
        let mut state = Self {
            axis,
            p0,
            r0: UnitQuaternion::identity(),
            q,
            wander: vec![[Vector3::zeros(); 2]; count],
        };
        if uses_rotations {
            let grasp: Vec<UnitQuaternion<f64>> = track
                .rotations
                .iter()
                .zip(&state.q)
                .map(|(r, q)| state.axis.motion(*q).rotation.inverse() * r)
                .collect();
            state.r0 = crate::screw::robust_mean(&grasp);
        }
        state
    }

    fn strokes(&self) -> usize {
        let (low, high) = extrema(&self.q);
        strokes(&[0..self.q.len()], &self.q, 0.1 * (high - low))
            .last()
            .map_or(0, |last| last + 1)
    }

    /// Position and rotation left over at sample `i`, wander included.
    fn leftover(&self, track: &PoseSamples, i: usize, uses_rotations: bool) -> [Vector3<f64>; 2] {
        self.leftover_of(track, i, &self.axis.motion(self.q[i]), uses_rotations)
    }

    /// As [`State::leftover`]; `motion` = that of the sample's joint coordinate.
    fn leftover_of(
        &self,
        track: &PoseSamples,
        i: usize,
        motion: &Isometry3<f64>,
        uses_rotations: bool,
    ) -> [Vector3<f64>; 2] {
        let rotation = if uses_rotations {
            (track.rotations[i] * (motion.rotation * self.r0).inverse()).scaled_axis()
        } else {
            Vector3::zeros()
        };
        [track.positions[i] - motion * self.p0, rotation]
    }

    /// Residual components that no joint motion can explain: two of the position, two of the rotation.
    fn across(&self, track: &PoseSamples, uses_rotations: bool) -> [Vec<Vec<f64>>; 2] {
        let count = track.positions.len();
        let (first, second) = perpendiculars(&self.axis.direction);
        let mut position = vec![Vec::with_capacity(count), Vec::with_capacity(count)];
        let mut rotation = vec![Vec::with_capacity(count), Vec::with_capacity(count)];
        for i in 0..count {
            let [p, r] = self.leftover(track, i, uses_rotations);
            let (a, b) = match self.axis.kind {
                JointKind::Prismatic => (first, second),
                JointKind::Revolute => {
                    let path = self.axis.motion(self.q[i]) * self.p0;
                    let along = self.axis.velocity_at(&path).normalize();
                    (
                        self.axis.direction.into_inner(),
                        along.cross(&self.axis.direction),
                    )
                }
            };
            position[0].push(p.dot(&a));
            position[1].push(p.dot(&b));
            rotation[0].push(r.dot(&first));
            rotation[1].push(r.dot(&second));
        }
        [position, rotation]
    }

    fn estimate_noise(
        &self,
        track: &PoseSamples,
        uses_rotations: bool,
        before: [Wander; 2],
    ) -> [Wander; 2] {
        let [position, rotation] = self.across(track, uses_rotations);
        let estimate = |series: &[Vec<f64>]| Wander::estimate(series, track, 1e-6);
        let (rotation, position) = if uses_rotations {
            both(|| estimate(&rotation), || estimate(&position))
        } else {
            (None, estimate(&position))
        };
        [position.unwrap_or(before[0]), rotation.unwrap_or(before[1])]
    }

    /// Nothing where the elimination is beyond the arithmetic.
    fn linearize(
        &self,
        track: &PoseSamples,
        uses_rotations: bool,
        noise: &[Wander; 2],
    ) -> Option<Linearized> {
        let active = match (self.axis.kind, uses_rotations) {
            (JointKind::Revolute, true) => vec![0, 1, 2, 3, 4, 5, 6, 7],
            (JointKind::Revolute, false) => vec![0, 1, 2, 3, 4, 5],
            (JointKind::Prismatic, true) => vec![0, 1, 4, 5, 6, 7, 8],
            (JointKind::Prismatic, false) => vec![0, 1, 4, 5],
        };
        let frame = Frame::new(self);
        let dynamics = noise.map(|noise| Dynamics::of(&noise, track.period));
        let direction = self.axis.direction.into_inner();
        let chain = |part: usize| {
            let count = if part == 0 || uses_rotations {
                track.positions.len()
            } else {
                0
            };
            in_vectors(
                #[inline(always)]
                || {
                    let mut chain = Chain::new(count);
                    for i in 0..count {
                        let motion = self.axis.motion(self.q[i]);
                        let jacobians = frame.jacobians(self, self.q[i], &motion.rotation);
                        // The sample's joint coordinate explains what lies along the path.
                        let ignored = match part {
                            0 => jacobians.along.try_normalize(0.0),
                            _ => (self.axis.kind == JointKind::Revolute).then_some(direction),
                        };
                        let leftover = self.leftover_of(track, i, &motion, part == 1)[part];
                        let measured = Measured {
                            jacobian: &jacobians.geometry[part],
                            residual: leftover - self.wander[i][part],
                            white: noise[part].white,
                            ignored,
                        };
                        chain.measure(i, &measured);
                        let before = track.follows(i).then(|| self.wander[i - 1][part]);
                        chain.walk(i, before, self.wander[i][part], &dynamics[part]);
                    }
                    chain.eliminate()?;
                    Some(chain)
                },
            )
        };
        let (rotations, positions) = if uses_rotations {
            both(|| chain(1), || chain(0))
        } else {
            (chain(1), chain(0))
        };
        Some(Linearized::of([positions?, rotations?], active))
    }

    /// Applies a step; true when it was too small to matter.
    fn apply(&mut self, track: &PoseSamples, step: &Step) -> bool {
        self.shift(&step.geometry);
        for (part, changes) in step.wanders.iter().enumerate() {
            for (wander, change) in self.wander.iter_mut().zip(changes) {
                wander[part] += change;
            }
        }
        self.follow(track);
        // A tenth of a micrometre, or of a microradian.
        step.geometry.amax() < 1e-7
    }

    /// Moves axis and grasp by a change of the geometry parameters.
    fn shift(&mut self, g: &SVector<f64, GEOMETRY>) {
        let frame = Frame::new(self);
        let tilt = UnitQuaternion::from_scaled_axis(frame.first * g[0] + frame.second * g[1]);
        self.p0 += frame.grasp[0] * g[4] + frame.grasp[1] * g[5];
        if self.axis.kind == JointKind::Revolute {
            self.axis.point += frame.first * g[2] + frame.second * g[3];
        }
        self.axis.direction = tilt * self.axis.direction;
        let [first, second, third] = frame.turns;
        let turn = first * g[6] + second * g[7] + third * g[8];
        self.r0 = UnitQuaternion::from_scaled_axis(turn) * self.r0;
    }

    /// Each joint coordinate to where the path is nearest to the position less its wander.
    fn follow(&mut self, track: &PoseSamples) {
        let direction = self.axis.direction.into_inner();
        let samples = track.positions.iter().zip(&self.wander).zip(&mut self.q);
        match self.axis.kind {
            JointKind::Prismatic => {
                for ((position, wander), q) in samples {
                    *q = direction.dot(&(position - wander[0] - self.p0));
                }
            }
            JointKind::Revolute => {
                let arm = self.p0 - self.axis.point;
                let across = direction.cross(&arm);
                let along = across.cross(&direction);
                for ((position, wander), q) in samples {
                    let there = position - wander[0] - self.axis.point;
                    let angle = across.dot(&there).atan2(along.dot(&there));
                    // The turn that is nearest to where it was.
                    *q = angle + TAU * ((*q - angle) / TAU).round();
                }
            }
        }
    }

    /// Derivative of the tool's distance from the axis by the geometry parameters.
    fn radius_gradient(&self) -> DVector<f64> {
        let frame = Frame::new(self);
        let [radial, direction] = frame.grasp;
        let height = direction.dot(&(self.p0 - self.axis.point));
        let mut gradient = DVector::zeros(GEOMETRY);
        for (k, e) in [frame.first, frame.second].into_iter().enumerate() {
            gradient[k] = -height * radial.dot(&e.cross(&direction));
            gradient[2 + k] = -radial.dot(&e);
        }
        gradient[4] = 1.0;
        gradient
    }

    /// Root mean square distance of the positions from the path, m. Where a line lies matters to nothing but that, and a wander leaves
    /// it loose: it is put through their middle.
    fn distance(&mut self, track: &PoseSamples) -> f64 {
        let [mut position, _] = self.across(track, false);
        let count = position[0].len().max(1) as f64;
        if self.axis.kind == JointKind::Prismatic {
            let (first, second) = perpendiculars(&self.axis.direction);
            for (series, direction) in position.iter_mut().zip([first, second]) {
                let mean = series.iter().sum::<f64>() / count;
                series.iter_mut().for_each(|value| *value -= mean);
                self.p0 += direction * mean;
            }
        }
        let square: f64 = position.iter().flatten().map(|v| v * v).sum();
        (square / count).sqrt()
    }

    fn finish(
        mut self,
        track: &PoseSamples,
        uses_rotations: bool,
        noise: [Wander; 2],
        last: Option<(Step, f64)>,
        repeated: bool,
    ) -> RefinedJoint {
        let position_rms = self.distance(track);
        let [position, _] = self.across(track, false);
        let mut covariance = DMatrix::zeros(4, 4);
        let mut radius_std = 0.0;
        if let Some((step, cost)) = last {
            // The noise model is an estimate: never claim more than the residuals bear out.
            let mut inflation = (cost / step.freedom.max(1.0)).max(1.0);
            if !repeated {
                let worth = position
                    .iter()
                    .map(|series| effective_count(series))
                    .fold(f64::INFINITY, f64::min);
                inflation *= (track.positions.len() as f64 / worth).max(1.0);
            }
            covariance = step.covariance.view((0, 0), (4, 4)) * inflation;
            if self.axis.kind == JointKind::Revolute {
                let radius = self.radius_gradient();
                let variance = (radius.transpose() * &step.covariance * &radius)[(0, 0)];
                radius_std = (variance * inflation).max(0.0).sqrt();
            }
        }
        let variance = |i: usize| covariance[(i, i)].max(0.0);
        let (direction_std, mut position_std) = (
            (variance(0) + variance(1)).sqrt(),
            (variance(2) + variance(3)).sqrt(),
        );
        if self.axis.kind == JointKind::Prismatic {
            position_std = 0.0;
        }
        let origin = self.q.first().copied().unwrap_or(0.0);
        for q in &mut self.q {
            *q -= origin;
        }
        let to_first = self.axis.motion(origin);
        RefinedJoint {
            axis: self.axis,
            tool_position: to_first * self.p0,
            tool_rotation: to_first.rotation * self.r0,
            uses_rotations,
            q: self.q,
            direction_std,
            position_std,
            radius_std,
            covariance,
            position_rms,
            position_noise: noise[0],
            rotation_noise: noise[1],
        }
    }
}

#[cfg(test)]
mod tests;
