//! The joint's coordinate from the tool's poses, and what the poses' noise makes of it.

mod slide;

use core::ops::Range;

use nalgebra::{Matrix2, Point3, Vector2, Vector3};

use crate::joint_graph::RefinedJoint;
use crate::least_squares::rms;
use crate::motion::MotionError;
use crate::noise::{STRETCH_S, UNUSUAL, acceleration_below};
use crate::parallel::{both, in_parallel};
use crate::samples::quantile;
use crate::screw::{JointKind, angles, perpendiculars};
use crate::tool::ToolSamples;

pub(super) struct Coordinate {
    pub(super) q: Vec<f64>,
    /// See [`JointEffort::by_path`](super::JointEffort::by_path).
    pub(super) by_path: f64,
    pub(super) noise: Vec<Vec<f64>>,
    /// See [`Aside::beside`](crate::samples::Aside::beside).
    pub(super) beside: Vec<Vec<f64>>,
}

impl Coordinate {
    pub(super) fn of(
        tool: &ToolSamples,
        index: &[usize],
        path: &[Point3<f64>],
        runs: &[Range<usize>],
        joint: &RefinedJoint,
        cutoff_hz: f64,
    ) -> Result<Self, MotionError> {
        let axis = &joint.axis;
        let direction = axis.direction.into_inner();
        if axis.kind == JointKind::Prismatic {
            let (first, second) = perpendiculars(&axis.direction);
            let along = |e: Vector3<f64>| -> Vec<f64> {
                let way = path.iter().map(|p| e.dot(&(p - joint.tool_position)));
                way.collect()
            };
            let across = [along(first), along(second)];
            let (noise, beside) = if joint.uses_rotations {
                let held = joint.tool_rotation.inverse();
                let rests = index
                    .iter()
                    .map(|&i| (tool.rotation[i] * held).scaled_axis());
                let rests: Vec<Vector3<f64>> = rests.collect();
                let part = |e: Vector3<f64>| rests.iter().map(|rest| rest.dot(&e)).collect();
                let tilts = [first, second, direction].map(part);
                let noise = slide::noise(&across, &tilts, runs, tool.period, cutoff_hz)?;
                (noise, across.to_vec())
            } else {
                (across, Vec::new())
            };
            return Ok(Self {
                q: along(direction),
                by_path: 1.0,
                noise: noise.to_vec(),
                beside,
            });
        }
        let radius = axis.distance(&joint.tool_position).max(1e-3);
        let height = direction.dot(&(joint.tool_position - axis.point));
        let rise = |p: &Point3<f64>| (direction.dot(&(p - axis.point)) - height) / radius;
        let way_out = |p: &Point3<f64>| (axis.distance(p) - radius) / radius;
        let across = || -> [Vec<f64>; 2] {
            [
                path.iter().map(rise).collect(),
                path.iter().map(way_out).collect(),
            ]
        };
        let (across, by_position) = both(across, || angles(path, axis));
        if !joint.uses_rotations {
            return Ok(Self {
                q: by_position,
                by_path: 1.0,
                noise: across.to_vec(),
                beside: Vec::new(),
            });
        }
        // Angle of the first position from the joint's origin, so that both angles count from one place.
        let start = path
            .first()
            .map_or(0.0, |p| angles(&[joint.tool_position, *p], axis)[1]);
        let samples: Vec<(usize, f64)> = index.iter().copied().zip(by_position.clone()).collect();
        let outwards = joint.tool_position - axis.point;
        let outwards = (outwards - direction * direction.dot(&outwards))
            .try_normalize(f64::EPSILON)
            .unwrap_or_else(|| perpendiculars(&axis.direction).0);
        let rests = in_parallel(&samples, |(i, q)| {
            let turned = axis.motion(start + q).rotation;
            let expected = turned * joint.tool_rotation;
            turned.inverse() * (tool.rotation[*i] * expected.inverse()).scaled_axis()
        });
        let part = |e: Vector3<f64>| rests.iter().map(move |rest| rest.dot(&e));
        let turned = by_position.iter().zip(part(direction));
        let by_rotation: Vec<f64> = turned.map(|(q, rest)| q + rest).collect();
        let tilts = [outwards, direction.cross(&outwards)].map(|e| part(e).collect::<Vec<f64>>());
        let shaken = |below_hz| Shaken::of(&across, &tilts, runs, tool.period, below_hz);
        let (quick, slow) = both(|| shaken(ABOVE_HANDS * cutoff_hz), || shaken(cutoff_hz));
        let lever = Lever::of(&quick?);
        let share = lever.share(&slow?);
        let mixed = by_position.iter().zip(&by_rotation);
        Ok(Self {
            q: mixed.map(|(a, b)| share * a + (1.0 - share) * b).collect(),
            by_path: share,
            noise: lever.noise(share, &across[0], &tilts),
            beside: across.to_vec(),
        })
    }
}

/// The lever is told by accelerations up to so many times the fit's cut-off, as far as the poses' rate goes: most of what stands there
/// is the tracker's alone, while hands and an axis slightly off shake both series below the cut-off.
const ABOVE_HANDS: f64 = 4.0;

/// From where the tracker's rotation acts to the TCP, over the joint's radius: what the tracker turns wrongly moves the TCP by it, so that
/// errors of position and of rotation are not independent. Components away from the axis, along the path and along the axis.
#[derive(Clone, Copy, Debug)]
struct Lever {
    outwards: f64,
    ahead: f64,
    along: f64,
}

impl Lever {
    /// From what the position across the path shares with the tilts.
    fn of(shaken: &Shaken) -> Self {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let [up, out] = &shaken.across;
        let [roll, pitch] = &shaken.tilts;
        let shared = dot(roll, pitch);
        let gram = Matrix2::new(dot(roll, roll), shared, shared, dot(pitch, pitch)).lu();
        let by_tilts = |series: &[f64]| {
            let right = Vector2::new(dot(roll, series), dot(pitch, series));
            gram.solve(&right).unwrap_or_default()
        };
        let (lifted, pushed) = (by_tilts(up), by_tilts(out));
        Self {
            outwards: -lifted.y,
            ahead: lifted.x,
            along: pushed.y,
        }
    }

    /// The position's own noise, over the radius: that along the axis less what comes from tilts. (Outwards, rotation about the axis
    /// has a part that tilts do not show.)
    fn own(&self, up: &[f64], [roll, pitch]: &[Vec<f64>; 2]) -> Vec<f64> {
        let tilts = roll.iter().zip(pitch);
        let all = up.iter().zip(tilts);
        all.map(|(up, (roll, pitch))| up - self.ahead * roll + self.outwards * pitch)
            .collect()
    }

    /// The weight of the angle by positions beside that by rotations which leaves least noise: the positions' own, over the radius, and
    /// the rotations', which is in both.
    fn share(&self, shaken: &Shaken) -> f64 {
        let own = rms(&self.own(&shaken.across[0], &shaken.tilts)).powi(2);
        let [roll, pitch] = shaken.tilts.each_ref().map(|tilt| rms(tilt).powi(2));
        let rotation = (0.5 * (roll + pitch)).max(f64::MIN_POSITIVE);
        let apart = 1.0 - self.outwards;
        let both = own + rotation * (apart.powi(2) + self.along.powi(2));
        (rotation * apart / both).clamp(0.0, 1.0)
    }

    /// Two series with the noise of the angle mixed so: the position's own along the axis (`up`, with what the tilts make of it) in
    /// place of that along the path, and the tilts in place of each other and of the rotation about the axis.
    fn noise(&self, share: f64, up: &[f64], tilts: &[Vec<f64>; 2]) -> Vec<Vec<f64>> {
        let about = 1.0 - share * (1.0 - self.outwards);
        let across = share * self.along;
        let own = self.own(up, tilts);
        let [roll, pitch] = tilts;
        let mixed = |[one, other]: [&Vec<f64>; 2]| -> Vec<f64> {
            let all = own.iter().zip(one.iter().zip(other));
            all.map(|(own, (one, other))| share * own + about * one - across * other)
                .collect()
        };
        vec![mixed([pitch, roll]), mixed([roll, pitch])]
    }
}

/// Accelerations below a frequency of the position across the path (along the axis and outwards, over the radius) and of the rotations
/// about the directions outwards and ahead, away from where the tool slid.
struct Shaken {
    across: [Vec<f64>; 2],
    tilts: [Vec<f64>; 2],
}

impl Shaken {
    fn of(
        across: &[Vec<f64>; 2],
        tilts: &[Vec<f64>; 2],
        runs: &[Range<usize>],
        period: f64,
        below_hz: f64,
    ) -> Result<Self, MotionError> {
        let [[up, out], [roll, pitch]] = [across, tilts];
        let [up, out, roll, pitch] = shaken([up, out, roll, pitch], runs, period, below_hz)?;
        Ok(Self {
            across: [up, out],
            tilts: [roll, pitch],
        })
    }
}

/// Accelerations below a frequency of series, away from where the tool slid.
fn shaken<const N: usize>(
    all: [&[f64]; N],
    runs: &[Range<usize>],
    period: f64,
    below_hz: f64,
) -> Result<[Vec<f64>; N], MotionError> {
    let mut accelerations = [const { Vec::new() }; N];
    for run in runs.iter().filter(|run| run.len() as f64 * period > 1.0) {
        for (out, series) in accelerations.iter_mut().zip(all) {
            out.extend(acceleration_below(&series[run.clone()], period, below_hz)?);
        }
    }
    let stretch = (STRETCH_S / period).ceil() as usize;
    let usual = usual(&accelerations, stretch);
    Ok(accelerations.map(|series| {
        let stretches = series.chunks(stretch).zip(&usual);
        let stretches = stretches.filter(|(_, usual)| **usual);
        stretches.flat_map(|(part, _)| part).copied().collect()
    }))
}

/// Stretches in which none of the series has many times its usual square: a tool that slides on the handle is no noise.
fn usual(all: &[Vec<f64>], stretch: usize) -> Vec<bool> {
    let mut usual = vec![true; all[0].len().div_ceil(stretch)];
    for series in all {
        let squares: Vec<f64> = series.chunks(stretch).map(|s| rms(s).powi(2)).collect();
        let most = UNUSUAL * quantile(&squares, 0.5);
        for (usual, square) in usual.iter_mut().zip(squares) {
            // Poses that stand still for half of the time say nothing of what is usual.
            *usual &= square <= most || most == 0.0;
        }
    }
    usual
}

#[cfg(test)]
mod tests;
