//! Where the tool is when the grasp is rigid: where the joint carries it.
//!
//! A tracker's pose wanders by millimetres and milliradians over seconds. Turned wrongly by `d`, a tool of 0.8 kg seems to push with 8 N times `d`,
//! and held at a wrong place the hand's push at a hinge seems to have another lever; a few slow strokes then show a friction that is not there.
//! Where position and orientation stay within what a tracker wanders, they are better taken from the joint than from the tracker, and so are the tool's
//! accelerations. Where they are far outside of it, the tool has turned or slid in the grasp, and the tracker is believed. Between the two it is believed
//! where the effort that follows from its poses is better explained than the one that follows from the joint's.

use core::ops::Range;

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};

use crate::filter::{FilterError, LowPass, first_derivative, second_derivative};
use crate::joint_graph::RefinedJoint;
use crate::parallel::in_parallel;
use crate::screw::{JointKind, ScrewAxis};
use crate::tool::{GRAVITY, ToolSamples, smoothing_hz};

/// Root mean squares up to which a tool is carried by the joint: m off its path, rad off its orientation.
const FIRM_M: f64 = 4e-3;
const FIRM_RAD: f64 = 6e-3;
/// In each third of the recording the mean is off by at most this share of them: a tracker wanders over seconds, a tool that has turned or slid
/// in the grasp stays so.
const STAYS_OFF: f64 = 0.5;
/// From so many times these on it is not.
const LOOSE: f64 = 3.0;

/// How the tool holds the part.
pub(super) enum Grip<'a> {
    /// As one body.
    Firm(Rigid<'a>),
    /// As one body, or not.
    Doubtful(Rigid<'a>),
    /// It turns or slides.
    Loose,
}

/// A tool that the joint carries.
pub(super) struct Rigid<'a> {
    axis: &'a ScrewAxis,
    /// At q = 0, in `world`.
    position: Point3<f64>,
    rotation: UnitQuaternion<f64>,
    tcp_from_ft_sensor: &'a Isometry3<f64>,
    /// Of the coordinate, smoothed as the poses are for [`ToolKinematics`](crate::tool::ToolKinematics), at each sample.
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    /// How far the tracker turns it wrongly, rad, rms.
    pub(super) turned: f64,
}

impl<'a> Grip<'a> {
    /// `q` of the samples `index`, in `runs`, `positions` of the TCP taken back to q = 0, and their mean.
    ///
    /// # Errors
    /// When the coordinate cannot be filtered.
    pub(super) fn of(
        tool: &'a ToolSamples,
        (index, runs, q): (&[usize], &[Range<usize>], &[f64]),
        (joint, axis): (&RefinedJoint, &'a ScrewAxis),
        (positions, position): (&[Vector3<f64>], Point3<f64>),
    ) -> Result<Self, FilterError> {
        if !joint.uses_rotations {
            return Ok(Self::Loose);
        }
        let from_mean = |p: &Vector3<f64>| p - position.coords;
        let off_path: Vec<Vector3<f64>> = positions.iter().map(from_mean).collect();
        let samples: Vec<(usize, f64)> = index.iter().copied().zip(q.iter().copied()).collect();
        let taken_back = in_parallel(&samples, |(i, q)| {
            axis.motion(-q).rotation * tool.rotation[*i]
        });
        let Some(first) = taken_back.first().copied() else {
            return Ok(Self::Loose);
        };
        let off = |mean: &UnitQuaternion<f64>| -> Vec<Vector3<f64>> {
            let inverse = mean.inverse();
            let turned = taken_back.iter().map(|r| (r * inverse).scaled_axis());
            turned.collect()
        };
        let count = taken_back.len() as f64;
        let mean = off(&first).into_iter().sum::<Vector3<f64>>() / count;
        let rotation = UnitQuaternion::from_scaled_axis(mean) * first;
        let turns = off(&rotation);
        let square: f64 = turns.iter().map(Vector3::norm_squared).sum();
        let turned = (square / count).sqrt();
        let stays = |off: &[Vector3<f64>]| stays_off(off) / STAYS_OFF;
        let moved = joint.position_rms.max(stays(&off_path)) / FIRM_M;
        let off = moved.max(turned.max(stays(&turns)) / FIRM_RAD);
        if off > LOOSE {
            return Ok(Self::Loose);
        }
        let [velocity, acceleration] = rates(q, runs, tool.period)?;
        let rigid = Rigid {
            axis,
            position,
            rotation,
            tcp_from_ft_sensor: &tool.tcp_from_ft_sensor,
            velocity,
            acceleration,
            turned,
        };
        Ok(if off <= 1.0 {
            Self::Firm(rigid)
        } else {
            Self::Doubtful(rigid)
        })
    }
}

impl Rigid<'_> {
    /// `world_from_tcp` at `q`.
    pub(super) fn at(&self, q: f64) -> (Point3<f64>, UnitQuaternion<f64>) {
        let motion = self.axis.motion(q);
        (motion * self.position, motion.rotation * self.rotation)
    }

    /// As [`ToolKinematics::at`](crate::tool::ToolKinematics::at), at sample `k`, where the coordinate is `q`.
    pub(super) fn moving(&self, k: usize, q: f64) -> [Vector3<f64>; 3] {
        let (tcp, rotation) = self.at(q);
        let sensor = tcp + rotation * self.tcp_from_ft_sensor.translation.vector;
        let (dq, ddq) = (self.velocity[k], self.acceleration[k]);
        let per_unit = self.axis.velocity_at(&sensor);
        let (turning, centripetal) = match self.axis.kind {
            JointKind::Prismatic => (Vector3::zeros(), Vector3::zeros()),
            JointKind::Revolute => {
                let direction = self.axis.direction.into_inner();
                (direction, direction.cross(&per_unit))
            }
        };
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
        let falling = gravity - per_unit * ddq - centripetal * (dq * dq);
        let into_sensor = (rotation * self.tcp_from_ft_sensor.rotation).inverse();
        [falling, turning * dq, turning * ddq].map(|v| into_sensor * v)
    }
}

/// First and second derivative of a coordinate, smoothed as poses are; zero in runs too short for the filter.
fn rates(q: &[f64], runs: &[Range<usize>], period: f64) -> Result<[Vec<f64>; 2], FilterError> {
    let rate_hz = 1.0 / period;
    let filter = LowPass::butterworth(4, smoothing_hz(rate_hz), rate_hz)?;
    let mut out = [vec![0.0; q.len()], vec![0.0; q.len()]];
    for run in runs {
        if run.len() <= filter.edge_samples() + 4 {
            continue;
        }
        let smooth = filter.zero_phase_settled(&q[run.clone()])?;
        out[0][run.clone()].copy_from_slice(&first_derivative(&smooth, period));
        out[1][run.clone()].copy_from_slice(&second_derivative(&smooth, period));
    }
    Ok(out)
}

/// How far the mean of a third of the recording is off, at most.
fn stays_off(off: &[Vector3<f64>]) -> f64 {
    off.chunks(off.len().div_ceil(3).max(1))
        .map(|third| (third.iter().sum::<Vector3<f64>>() / third.len() as f64).norm())
        .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_stays_off_and_what_wanders_does_not() {
        let turned = |f: fn(usize) -> f64| -> f64 {
            let off: Vec<Vector3<f64>> = (0..900).map(|i| Vector3::new(0.0, f(i), 0.0)).collect();
            stays_off(&off)
        };
        let step = turned(|i| if i < 450 { -5e-3 } else { 5e-3 });
        let wander = turned(|i| 5e-3 * (0.2 * i as f64).sin());
        assert!(
            step > STAYS_OFF * FIRM_RAD && wander < 1e-3,
            "{step} {wander}"
        );
        assert_eq!(stays_off(&[]), 0.0);
    }
}
