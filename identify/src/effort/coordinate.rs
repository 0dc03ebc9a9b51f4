//! The joint's coordinate from the tool's poses, and what the poses' noise makes of it.

use core::ops::Range;

use nalgebra::{Matrix2, Point3, Vector2, Vector3};

use crate::joint_graph::RefinedJoint;
use crate::least_squares::rms;
use crate::motion::MotionError;
use crate::noise::acceleration_below;
use crate::parallel::{both, in_parallel};
use crate::screw::{JointKind, angles, perpendiculars};
use crate::tool::ToolSamples;

pub(super) struct Coordinate {
    pub(super) q: Vec<f64>,
    pub(super) noise: Vec<Vec<f64>>,
    /// See [`Aside::beside`].
    pub(super) beside: Vec<Vec<f64>>,
    /// See [`JointEffort::acceleration_noise`](super::JointEffort::acceleration_noise).
    pub(super) acceleration: [Option<f64>; 2],
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
            let across = |e: Vector3<f64>| {
                path.iter()
                    .map(|p| e.dot(&(p - joint.tool_position)))
                    .collect::<Vec<f64>>()
            };
            let noise = [across(first), across(second)];
            let acceleration = mean_noise(&noise, runs, tool.period, cutoff_hz)?;
            let q = path
                .iter()
                .map(|p| direction.dot(&(p - joint.tool_position)))
                .collect();
            return Ok(Self {
                q,
                noise: noise.to_vec(),
                beside: Vec::new(),
                acceleration: [Some(acceleration), None],
            });
        }
        let radius = axis.distance(&joint.tool_position).max(1e-3);
        let height = direction.dot(&(joint.tool_position - axis.point));
        let noise = || -> Result<_, MotionError> {
            let across: [Vec<f64>; 2] = [
                path.iter()
                    .map(|p| (direction.dot(&(p - axis.point)) - height) / radius)
                    .collect(),
                path.iter()
                    .map(|p| (axis.distance(p) - radius) / radius)
                    .collect(),
            ];
            let size = mean_noise(&across, runs, tool.period, cutoff_hz)?;
            Ok((across, size))
        };
        let (noise, by_position) = both(noise, || angles(path, axis));
        let (position_noise, from_position) = noise?;
        if !joint.uses_rotations {
            return Ok(Self {
                q: by_position,
                noise: position_noise.to_vec(),
                beside: Vec::new(),
                acceleration: [Some(from_position), None],
            });
        }
        // Angle of the first position from the joint's origin, so that both angles count from one place.
        let start = path
            .first()
            .map_or(0.0, |p| angles(&[joint.tool_position, *p], axis)[1]);
        let samples: Vec<(usize, f64)> = index.iter().copied().zip(by_position.clone()).collect();
        let outwards = joint.tool_position - axis.point;
        let outwards = (outwards - direction * direction.dot(&outwards)).normalize();
        let rests = in_parallel(&samples, |(i, q)| {
            let turned = axis.motion(start + q).rotation;
            let expected = turned * joint.tool_rotation;
            turned.inverse() * (tool.rotation[*i] * expected.inverse()).scaled_axis()
        });
        let part = |e: Vector3<f64>| rests.iter().map(move |rest| rest.dot(&e));
        let turned = by_position.iter().zip(part(direction));
        let by_rotation: Vec<f64> = turned.map(|(q, rest)| q + rest).collect();
        let tilts = [outwards, direction.cross(&outwards)].map(|e| part(e).collect::<Vec<f64>>());
        let shaken = |series: &[f64]| shaken(series, runs, tool.period, cutoff_hz);
        let lever = Lever::of(&position_noise, &tilts, shaken)?;
        let own = lever.without(&position_noise, &tilts);
        let from_own = mean_noise(&own, runs, tool.period, cutoff_hz)?;
        let from_rotation = mean_noise(&tilts, runs, tool.period, cutoff_hz)?;
        let share = lever.share(from_own, from_rotation);
        let mixed = by_position.iter().zip(&by_rotation);
        let q = mixed.map(|(a, b)| share * a + (1.0 - share) * b).collect();
        Ok(Self {
            q,
            noise: lever.noise(share, &own, &tilts),
            beside: position_noise.to_vec(),
            acceleration: [Some(from_position), Some(from_rotation)],
        })
    }
}

/// From where the tracker's rotation acts to the TCP, over the joint's radius: what the tracker turns wrongly moves the TCP by it, so that
/// errors of position and of rotation are not independent. Components away from the axis, along the path and along the axis.
struct Lever {
    outwards: f64,
    ahead: f64,
    along: f64,
}

impl Lever {
    /// From what the position across the path (`across`: along the axis and outwards, over the radius) shares with the rotations about
    /// the directions `outwards` and `ahead`, the `tilts`, as accelerations.
    fn of(
        across: &[Vec<f64>; 2],
        tilts: &[Vec<f64>; 2],
        shaken: impl Fn(&[f64]) -> Result<Vec<f64>, MotionError>,
    ) -> Result<Self, MotionError> {
        let [along, outwards] = [shaken(&across[0])?, shaken(&across[1])?];
        let [roll, pitch] = [shaken(&tilts[0])?, shaken(&tilts[1])?];
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let gram = Matrix2::new(
            dot(&roll, &roll),
            dot(&roll, &pitch),
            dot(&roll, &pitch),
            dot(&pitch, &pitch),
        );
        let by_tilts = |series: &[f64]| {
            let right = Vector2::new(dot(&roll, series), dot(&pitch, series));
            gram.lu().solve(&right).unwrap_or_default()
        };
        let (lifted, pushed) = (by_tilts(&along), by_tilts(&outwards));
        Ok(Self {
            outwards: -lifted.y,
            ahead: lifted.x,
            along: pushed.y,
        })
    }

    /// The position's noise across the path less what comes from tilts; what rotation about the axis puts into it outwards stays.
    fn without(&self, across: &[Vec<f64>; 2], [roll, pitch]: &[Vec<f64>; 2]) -> [Vec<f64>; 2] {
        let [along, outwards] = across;
        let tilts = roll.iter().zip(pitch);
        let along = along.iter().zip(tilts);
        let along = along.map(|(v, (roll, pitch))| v - self.ahead * roll + self.outwards * pitch);
        let outwards = outwards.iter().zip(pitch);
        let outwards = outwards.map(|(v, pitch)| v - self.along * pitch);
        [along.collect(), outwards.collect()]
    }

    /// The weight of the angle by positions beside that by rotations which leaves least noise: the positions' own, over the radius, and
    /// the rotations', which is in both.
    fn share(&self, own: f64, rotation: f64) -> f64 {
        let (own, rotation) = (own.powi(2), rotation.powi(2).max(f64::MIN_POSITIVE));
        let apart = 1.0 - self.outwards;
        let both = own + rotation * (apart.powi(2) + self.along.powi(2));
        (rotation * apart / both).max(0.0)
    }

    /// Two series with the noise of the angle mixed so: that of the positions across the path in place of theirs along it, and the tilts
    /// in place of each other and of the rotation about the axis.
    fn noise(
        &self,
        share: f64,
        own: &[Vec<f64>; 2],
        [roll, pitch]: &[Vec<f64>; 2],
    ) -> Vec<Vec<f64>> {
        let about = 1.0 - share * (1.0 - self.outwards);
        let across = share * self.along;
        let mix = |own: &[f64], [one, other]: [&[f64]; 2]| {
            let tilts = one.iter().zip(other);
            let all = own.iter().zip(tilts);
            all.map(|(own, (one, other))| share * own + about * one - across * other)
                .collect()
        };
        vec![mix(&own[0], [pitch, roll]), mix(&own[1], [roll, pitch])]
    }
}

/// The accelerations of a series below the cut-off, run after run.
fn shaken(
    series: &[f64],
    runs: &[Range<usize>],
    period: f64,
    cutoff_hz: f64,
) -> Result<Vec<f64>, MotionError> {
    let mut out = Vec::new();
    for run in runs.iter().filter(|run| run.len() as f64 * period > 1.0) {
        out.extend(acceleration_below(&series[run.clone()], period, cutoff_hz)?);
    }
    Ok(out)
}

/// Acceleration noise over all series and runs, root mean square.
fn mean_noise(
    series: &[Vec<f64>; 2],
    runs: &[Range<usize>],
    period: f64,
    cutoff_hz: f64,
) -> Result<f64, MotionError> {
    let mut squares = 0.0;
    for values in series {
        let level = rms(&shaken(values, runs, period, cutoff_hz)?);
        squares += level * level / series.len() as f64;
    }
    Ok(squares.sqrt())
}

#[cfg(test)]
mod tests {
    use core::f64::consts::SQRT_2;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    const PERIOD: f64 = 1e-3;
    const SAMPLES: usize = 60_000;
    /// Noise of the tracker's own position over the radius, and of its rotation, rad.
    const OWN: f64 = 4e-5;
    const TURN: f64 = 9e-5;

    fn white(random: &mut ChaCha8Rng, std: f64) -> Vec<f64> {
        let one = |_| -> f64 { StandardNormal.sample(random) };
        (0..SAMPLES).map(one).map(|v| std * v).collect()
    }

    fn accelerations(series: &[f64]) -> Result<Vec<f64>, MotionError> {
        shaken(series, core::slice::from_ref(&(0..SAMPLES)), PERIOD, 6.0)
    }

    fn level(series: &[f64]) -> f64 {
        rms(&accelerations(series).unwrap())
    }

    #[test]
    fn what_positions_share_with_rotations_is_found_and_counted_once() {
        let random = &mut ChaCha8Rng::seed_from_u64(3);
        for lever in [[0.3, -0.1, 0.2], [-0.25, 0.3, 0.0], [0.0; 3]] {
            let [outwards, ahead, along] = lever;
            let [roll, pitch, yaw] = [(); 3].map(|()| white(random, TURN));
            let mut moved = |a: &[f64], by_a: f64, b: &[f64], by_b: f64| -> Vec<f64> {
                let own = white(random, OWN);
                let all = own.iter().zip(a.iter().zip(b));
                all.map(|(own, (a, b))| own + by_a * a + by_b * b).collect()
            };
            // The rotation (roll, pitch, yaw) crossed with the lever (outwards, ahead, along).
            let up = moved(&roll, ahead, &pitch, -outwards);
            let out = moved(&pitch, along, &yaw, -ahead);
            let forth = moved(&yaw, outwards, &roll, -along);

            let (across, tilts) = ([up, out], [roll, pitch]);
            let found = Lever::of(&across, &tilts, accelerations).unwrap();
            let error = [
                found.outwards - outwards,
                found.ahead - ahead,
                found.along - along,
            ];
            assert!(error.iter().all(|e| e.abs() < 0.05), "{lever:?}: {error:?}");

            let own = found.without(&across, &tilts);
            let both = |[one, other]: [&Vec<f64>; 2]| level(one).hypot(level(other)) / SQRT_2;
            let share = found.share(both(own.each_ref()), both(tilts.each_ref()));
            let mixed = |share: f64| -> f64 {
                let mixed = forth.iter().zip(&yaw);
                let mixed = mixed.map(|(p, r)| share * p + (1.0 - share) * r);
                level(&mixed.collect::<Vec<f64>>())
            };
            let truth = mixed(share);
            let told = found.noise(share, &own, &tilts);
            let ratio = both([&told[0], &told[1]]) / truth;
            assert!((0.9..1.1).contains(&ratio), "{lever:?}: {ratio}");
            for other in [share - 0.3, share + 0.3] {
                assert!(mixed(other) > truth, "{lever:?}: {share}");
            }
        }
    }
}
