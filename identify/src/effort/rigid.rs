//! Where the tool is when the grasp is rigid: where the joint carries it.
//!
//! A tracker's pose wanders by millimetres and milliradians over seconds. Turned wrongly by `d`, a tool of 0.8 kg seems to push with 8 N times `d`,
//! and held at a wrong place the hand's push at a hinge seems to have another lever; a few slow strokes then show a friction that is not there.
//! Where position and orientation stay within what a tracker wanders, they are better taken from the joint than from the tracker. Where they do not,
//! the tool may have turned or slid in the grasp, and the tracker is believed.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::joint_graph::RefinedJoint;
use crate::parallel::in_parallel;
use crate::screw::ScrewAxis;
use crate::tool::ToolSamples;

/// Root mean squares up to which a tool is carried by the joint: m off its path, rad off its orientation.
const MOST_OFF_M: f64 = 4e-3;
const MOST_TURNED: f64 = 6e-3;
/// In each third of the recording the mean is off by at most this share of them: a tracker wanders over seconds, a tool that has turned or slid
/// in the grasp stays so.
const STAYS_OFF: f64 = 0.5;

/// A tool that the joint carries.
pub(super) struct Rigid<'a> {
    axis: &'a ScrewAxis,
    /// At q = 0, in `world`.
    position: Point3<f64>,
    rotation: UnitQuaternion<f64>,
}

impl<'a> Rigid<'a> {
    /// Nothing when orientations do not go with the joint, or the tool strays from where the joint carries it; `q` of the samples `index`,
    /// `positions` of the TCP taken back to q = 0, and their mean.
    pub(super) fn of(
        tool: &ToolSamples,
        (index, q): (&[usize], &[f64]),
        (joint, axis): (&RefinedJoint, &'a ScrewAxis),
        (positions, position): (&[Vector3<f64>], Point3<f64>),
    ) -> Option<Self> {
        let from_mean = |p: &Vector3<f64>| p - position.coords;
        let off_path: Vec<Vector3<f64>> = positions.iter().map(from_mean).collect();
        if !joint.uses_rotations
            || joint.position_rms > MOST_OFF_M
            || stays_off(&off_path) > STAYS_OFF * MOST_OFF_M
        {
            return None;
        }
        let samples: Vec<(usize, f64)> = index.iter().copied().zip(q.iter().copied()).collect();
        let taken_back = in_parallel(&samples, |(i, q)| {
            axis.motion(-q).rotation * tool.rotation[*i]
        });
        let off = |mean: &UnitQuaternion<f64>| -> Vec<Vector3<f64>> {
            let inverse = mean.inverse();
            let turned = taken_back.iter().map(|r| (r * inverse).scaled_axis());
            turned.collect()
        };
        let first = *taken_back.first()?;
        let count = taken_back.len() as f64;
        let mean = off(&first).into_iter().sum::<Vector3<f64>>() / count;
        let rotation = UnitQuaternion::from_scaled_axis(mean) * first;
        let turned = off(&rotation);
        let square: f64 = turned.iter().map(Vector3::norm_squared).sum();
        let carried =
            (square / count).sqrt() <= MOST_TURNED && stays_off(&turned) <= STAYS_OFF * MOST_TURNED;
        carried.then_some(Self {
            axis,
            position,
            rotation,
        })
    }

    /// `world_from_tcp` at `q`.
    pub(super) fn at(&self, q: f64) -> (Point3<f64>, UnitQuaternion<f64>) {
        let motion = self.axis.motion(q);
        (motion * self.position, motion.rotation * self.rotation)
    }
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
            step > STAYS_OFF * MOST_TURNED && wander < 1e-3,
            "{step} {wander}"
        );
        assert_eq!(stays_off(&[]), 0.0);
    }
}
