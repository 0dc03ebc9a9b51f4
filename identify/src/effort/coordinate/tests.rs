use core::f64::consts::{PI, SQRT_2};

use ft_wire::time::HostTime;
use nalgebra::{DMatrix, Isometry3, Unit, UnitQuaternion};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;
use crate::joint_graph::Wander;
use crate::screw::ScrewAxis;

const PERIOD: f64 = 0.008;
const SAMPLES: usize = 60_000;
const CUTOFF_HZ: f64 = 6.0;
const RADIUS: f64 = 0.7;
/// Noise of the tracker's own position over the radius, and of its rotation, rad.
const OWN: f64 = 4e-5;
const TURN: f64 = 9e-5;

const STILL: Wander = Wander {
    white: 0.0,
    wander: 0.0,
    time_constant: 1.0,
};

/// A hinge that lies askew, and what a tracker with a known lever saw of 100 degrees of it, back and forth.
struct Seen {
    joint: RefinedJoint,
    tool: ToolSamples,
    /// Truth.
    q: Vec<f64>,
    /// Errors of the angle by positions and of that by rotations, rad.
    errors: [Vec<f64>; 2],
}

impl Seen {
    /// `lever` = from the tracker to the TCP, outwards, ahead and along the axis, over the radius.
    fn new([outwards, ahead, along]: [f64; 3], sense: f64, slides: bool) -> Self {
        let random = &mut ChaCha8Rng::seed_from_u64(3);
        let axis = ScrewAxis {
            direction: Unit::new_normalize(Vector3::new(0.3, -0.8, 0.5)),
            point: Point3::new(0.2, 1.1, -0.4),
            kind: JointKind::Revolute,
        };
        let e3 = axis.direction.into_inner();
        let e1 = perpendiculars(&axis.direction).0;
        let e2 = e3.cross(&e1);
        let basis = |v: [f64; 3]| e1 * v[0] + e2 * v[1] + e3 * v[2];
        let tool_position = axis.point + e1 * RADIUS + e3 * 0.3;
        let tool_rotation = UnitQuaternion::from_euler_angles(0.4, -0.9, 2.0);
        let lever = basis([outwards, ahead, along]) * RADIUS;
        let mut three = |std: f64| {
            [(); 3]
                .map(|()| -> f64 { StandardNormal.sample(random) })
                .map(|v: f64| std * v)
        };
        let mut out = Self {
            joint: RefinedJoint {
                axis,
                tool_position,
                tool_rotation,
                uses_rotations: true,
                q: Vec::new(),
                direction_std: 0.0,
                position_std: 0.0,
                radius_std: 0.0,
                covariance: DMatrix::zeros(4, 4),
                position_rms: 0.0,
                position_noise: STILL,
                rotation_noise: STILL,
            },
            tool: ToolSamples {
                at_extremes: Vec::new(),
                start: HostTime::EPOCH,
                period: PERIOD,
                runs: vec![0..SAMPLES],
                time: (0..SAMPLES).map(|i| i as f64 * PERIOD).collect(),
                position: Vec::new(),
                rotation: Vec::new(),
                wrench: vec![[0.0; 6]; SAMPLES],
                tcp_from_ft_sensor: Isometry3::identity(),
                gaps: 0,
                interpolated: 0.0,
            },
            q: Vec::new(),
            errors: [Vec::new(), Vec::new()],
        };
        for i in 0..SAMPLES {
            let phase = 2.0 * PI * 0.1 * i as f64 * PERIOD;
            let q = sense * 100_f64.to_radians() * 0.5 * (1.0 - phase.cos());
            let (own, turn) = (three(OWN), three(TURN));
            let mut slid = [Vector3::zeros(), Vector3::zeros()];
            if slides && i > SAMPLES / 3 {
                // Up the handle, and tilted, with nothing along the path or about the axis.
                slid = [e3 * 0.004, e1 * 0.02];
            }
            let moved = axis.motion(q);
            let error = moved.rotation * basis(turn);
            let true_tool = moved * (tool_position + slid[0]);
            let shift = basis(own) * RADIUS;
            out.tool
                .position
                .push(true_tool + moved.rotation * shift + error.cross(&(moved.rotation * lever)));
            let rotation =
                moved.rotation * UnitQuaternion::from_scaled_axis(slid[1]) * tool_rotation;
            out.tool
                .rotation
                .push(UnitQuaternion::from_scaled_axis(error) * rotation);
            out.q.push(q);
            out.errors[0].push(own[1] + turn[2] * outwards - turn[0] * along);
            out.errors[1].push(turn[2]);
        }
        out
    }

    fn coordinate(&self) -> Coordinate {
        let index: Vec<usize> = (0..SAMPLES).collect();
        let path = &self.tool.position;
        let run = core::slice::from_ref(&self.tool.runs[0]);
        Coordinate::of(&self.tool, &index, path, run, &self.joint, CUTOFF_HZ).unwrap()
    }

    /// Error of the angle, as acceleration, when positions have that share.
    fn mixed(&self, share: f64) -> f64 {
        let [by_position, by_rotation] = &self.errors;
        let mixed = by_position.iter().zip(by_rotation);
        let mixed = mixed.map(|(p, r)| share * p + (1.0 - share) * r);
        level(&mixed.collect::<Vec<f64>>())
    }
}

fn level(series: &[f64]) -> f64 {
    rms(&acceleration_below(series, PERIOD, CUTOFF_HZ).unwrap())
}

const LEVERS: [[f64; 3]; 5] = [
    [0.0; 3],
    [0.3, -0.1, 0.2],
    [-0.25, 0.3, 0.0],
    [0.0, 0.6, 0.1],
    [0.8, -0.1, 0.2],
];

#[test]
fn the_angle_is_the_best_mix_and_its_noise_is_told() {
    for (k, lever) in LEVERS.into_iter().enumerate() {
        let sense = if k % 2 == 0 { 1.0 } else { -1.0 };
        for slides in [false, true] {
            let seen = Seen::new(lever, sense, slides);
            let found = seen.coordinate();
            let offset = found.q[0] - seen.q[0];
            let errors = found.q.iter().zip(&seen.q).map(|(f, t)| f - t - offset);
            let errors: Vec<f64> = errors.collect();
            assert!(errors.iter().all(|e| e.abs() < 1e-2), "{lever:?}");

            let truth = level(&errors);
            let shares = (0..=100).map(|k| f64::from(k) / 100.0);
            let best = shares
                .map(|share| seen.mixed(share))
                .fold(f64::INFINITY, f64::min);
            assert!(
                truth < 1.01 * best,
                "{lever:?}, slides {slides}: {truth} for {best}"
            );
            if !slides {
                let told = level(&found.noise[0]).hypot(level(&found.noise[1])) / SQRT_2;
                let ratio = told / truth;
                assert!((0.93..1.07).contains(&ratio), "{lever:?}: {ratio}");
            }
        }
    }
}

#[test]
fn a_tool_on_the_axis_gives_numbers() {
    let mut seen = Seen::new([0.0; 3], 1.0, false);
    seen.joint.tool_position = seen.joint.axis.point;
    let found = seen.coordinate();
    assert!(
        found
            .q
            .iter()
            .chain(found.noise.iter().flatten())
            .all(|v| v.is_finite())
    );
}

/// A drawer on an askew rail, the tracker behind the TCP along the way.
#[test]
fn the_noise_along_a_rail_is_told() {
    for (lever, across_too_much) in [([0.0, 0.0, 0.3], true), ([0.2, 0.1, 0.1], false)] {
        let mut seen = Seen::new([0.0; 3], 1.0, false);
        let axis = &mut seen.joint.axis;
        axis.kind = JointKind::Prismatic;
        let direction = axis.direction.into_inner();
        let (e1, e2) = perpendiculars(&axis.direction);
        let lever = e1 * lever[0] + e2 * lever[1] + direction * lever[2];
        let random = &mut ChaCha8Rng::seed_from_u64(5);
        let mut three = |std: f64| {
            let each = [(); 3].map(|()| -> f64 { StandardNormal.sample(random) });
            Vector3::from(each) * std
        };
        let mut errors = [const { Vec::new() }; 3];
        for i in 0..SAMPLES {
            let q = 0.2 * (1.0 - (2.0 * PI * 0.1 * i as f64 * PERIOD).cos());
            let (own, turn) = (three(2e-5), three(TURN));
            let error = own + turn.cross(&lever);
            seen.tool.position[i] = seen.joint.tool_position + direction * q + error;
            seen.tool.rotation[i] =
                UnitQuaternion::from_scaled_axis(turn) * seen.joint.tool_rotation;
            for (errors, e) in errors.iter_mut().zip([direction, e1, e2]) {
                errors.push(error.dot(&e));
            }
        }
        let found = seen.coordinate();
        let [truth, first, second] = errors.each_ref().map(|e| level(e));
        let told = level(&found.noise[0]).hypot(level(&found.noise[1])) / SQRT_2;
        assert!((0.95..1.05).contains(&(told / truth)), "{told} for {truth}");
        let across = first.hypot(second) / SQRT_2;
        assert_eq!(
            across > 1.2 * truth,
            across_too_much,
            "{across} for {truth}"
        );
        // Where the tool is across its path stays what it is.
        for (beside, error) in found.beside.iter().zip(&errors[1..]) {
            assert!(beside.iter().zip(error).all(|(b, e)| (b - e).abs() < 1e-9));
        }
    }
}
