//! How well either joint predicts the tool's rotation.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::candidate::{Curve, independent};
use super::{JointKind, PoseSamples, ScrewAxis};
use crate::parallel::both;

pub(super) struct Turn {
    pub(super) bic_revolute: f64,
    pub(super) bic_prismatic: f64,
    rms_revolute: f64,
    rms_prismatic: f64,
    sweep: f64,
}

impl Turn {
    /// Whether the tool turns by what a circle has it, to a fifth of the sweep, however small that is: the radius of a short arc is as uncertain.
    pub(super) fn follows(&self) -> bool {
        self.rms_revolute < 0.2 * self.sweep
    }

    /// Whether the tool's rotation is what the joint would give it, to a tenth of the sweep or 3 degrees.
    pub(super) fn agrees(&self, kind: JointKind) -> bool {
        match kind {
            JointKind::Revolute => self.rms_revolute < (0.1 * self.sweep).max(0.05),
            JointKind::Prismatic => self.rms_prismatic < 0.05,
        }
    }
}

/// How well either joint predicts the tool's rotation, the grasp rotation fitted robustly.
pub(super) fn orientation_criteria(track: &PoseSamples, circle: &Curve) -> Turn {
    let predicted = angles(&track.positions, &circle.axis);
    let sweep = predicted.iter().copied().fold(f64::NEG_INFINITY, f64::max)
        - predicted.iter().copied().fold(f64::INFINITY, f64::min);
    let with_the_circle =
        |i: usize| UnitQuaternion::from_axis_angle(&circle.axis.direction, predicted[i]);
    let (turned, still) = both(
        || rotation_residuals(track, with_the_circle),
        || rotation_residuals(track, |_| UnitQuaternion::identity()),
    );
    let better = if robust_rms(&turned) < robust_rms(&still) {
        &turned
    } else {
        &still
    };
    let m = independent(better);
    let bic = |series: &[Vec<f64>]| m * robust_rms(series).powi(2).max(1e-12).ln() + 3.0 * m.ln();
    Turn {
        bic_revolute: bic(&turned),
        bic_prismatic: bic(&still),
        rms_revolute: robust_rms(&turned),
        rms_prismatic: robust_rms(&still),
        sweep,
    }
}

/// Angle of each position about a revolute axis, unwrapped, 0 at the first, rad.
pub(crate) fn angles(positions: &[Point3<f64>], axis: &ScrewAxis) -> Vec<f64> {
    let Some(first) = positions.first() else {
        return Vec::new();
    };
    let flat = |p: &Point3<f64>| {
        let arm = p - axis.point;
        arm - axis.direction.into_inner() * axis.direction.dot(&arm)
    };
    let start = flat(first);
    let mut last = 0.0;
    positions
        .iter()
        .map(|p| {
            let arm = flat(p);
            let raw = axis
                .direction
                .dot(&start.cross(&arm))
                .atan2(start.dot(&arm));
            last = raw + core::f64::consts::TAU * ((last - raw) / core::f64::consts::TAU).round();
            last
        })
        .collect()
}

/// Rotation left over when the tool turned as `motion` says, about its robust mean; three series, rad.
fn rotation_residuals(
    track: &PoseSamples,
    motion: impl Fn(usize) -> UnitQuaternion<f64>,
) -> Vec<Vec<f64>> {
    let grasp: Vec<UnitQuaternion<f64>> = track
        .rotations
        .iter()
        .enumerate()
        .map(|(i, r)| motion(i).inverse() * r)
        .collect();
    let mean = robust_mean(&grasp);
    let logs: Vec<Vector3<f64>> = grasp
        .iter()
        .map(|g| (g * mean.inverse()).scaled_axis())
        .collect();
    (0..3)
        .map(|k| logs.iter().map(|l| l[k]).collect())
        .collect()
}

/// Mean rotation with weights that fall off with the angle.
pub(crate) fn robust_mean(rotations: &[UnitQuaternion<f64>]) -> UnitQuaternion<f64> {
    let mut mean = rotations
        .get(rotations.len() / 2)
        .copied()
        .unwrap_or_default();
    for _ in 0..15 {
        let logs: Vec<Vector3<f64>> = rotations
            .iter()
            .map(|r| (r * mean.inverse()).scaled_axis())
            .collect();
        let mut norms: Vec<f64> = logs.iter().map(Vector3::norm).collect();
        let middle = norms.len() / 2;
        let median = *norms.select_nth_unstable_by(middle, f64::total_cmp).1;
        let scale = (2.0 * median).max(1e-9);
        let weight = |l: &Vector3<f64>| 1.0 / (1.0 + (l.norm() / scale).powi(2));
        let total: f64 = logs.iter().map(weight).sum();
        let step = logs.iter().map(|l| l * weight(l)).sum::<Vector3<f64>>() / total;
        mean = UnitQuaternion::from_scaled_axis(step) * mean;
        if step.norm() < 1e-9 {
            break;
        }
    }
    mean
}

/// Spread from the median absolute value, so that flips of a marker do not count.
fn robust_rms(series: &[Vec<f64>]) -> f64 {
    let n = series.first().map_or(0, Vec::len);
    let mut norms: Vec<f64> = (0..n)
        .map(|i| series.iter().map(|s| s[i] * s[i]).sum::<f64>().sqrt())
        .collect();
    if norms.is_empty() {
        return 0.0;
    }
    // Median of the length of a 3-vector with unit components is 1.538.
    *norms.select_nth_unstable_by(n / 2, f64::total_cmp).1 / 1.538
}
