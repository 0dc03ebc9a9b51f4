//! Recordings made from formulas: a tool that moves in free air, grasps an object and probes it.
//!
//! Accelerations are differences of the exact poses, and the tool's wrench is written at its centre of mass, as the design
//! states it; nothing here uses the crate's own kinematics.
#![allow(dead_code, unreachable_pub)]

use std::collections::BTreeMap;
use std::path::PathBuf;

use ft_recording::{Calibration, Estimate, Pose7, PoseTrack, Recording, Stamped, TrackedFrame};
use ft_wire::time::HostTime;
use nalgebra::{Isometry3, Matrix3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

pub const MASS: f64 = 0.49;
pub const COM: [f64; 3] = [0.021, 0.020, 0.059];
pub const BIAS: [f64; 6] = [1.1, -0.7, 0.4, 0.03, -0.05, 0.02];
pub const INERTIA: [f64; 3] = [0.0010, 0.0009, 0.0005];
const START_NS: i64 = 1_700_000_000_000_000_000;
const GRASP_S: f64 = 9.0;

/// What is simulated.
#[derive(Clone)]
pub struct Scene {
    pub revolute: bool,
    pub inertia: f64,
    pub coulomb: f64,
    pub viscous: f64,
    pub load: fn(f64) -> f64,
    pub range: f64,
    pub probing_s: f64,
    /// Below 1 all strokes are slower by that.
    pub pace: f64,
    pub free_after_s: f64,
    pub wander: [f64; 2],
    pub drift_n_per_s: f64,
    /// By how much the wrench comes later than it is stamped, s.
    pub late_s: f64,
    /// White noise of each pose, m.
    pub pose_noise_m: f64,
    /// Angle by which the tool turns on what it holds, half way through.
    pub turned_in_grasp: f64,
    pub seed: u64,
}

impl Scene {
    pub fn door() -> Self {
        Self {
            revolute: true,
            inertia: 4.0,
            coulomb: 1.5,
            viscous: 0.9,
            load: |q| 2.0 + 3.0 * q,
            range: 1.2,
            probing_s: 40.0,
            pace: 1.0,
            free_after_s: 0.0,
            wander: [1.5e-3, 2e-3],
            drift_n_per_s: 0.0,
            late_s: 0.0,
            pose_noise_m: 2.4e-5,
            turned_in_grasp: 0.0,
            seed: 1,
        }
    }

    pub fn drawer() -> Self {
        Self {
            revolute: false,
            inertia: 6.0,
            coulomb: 4.0,
            viscous: 5.0,
            load: |_| 0.0,
            range: 0.4,
            ..Self::door()
        }
    }

    /// Axis direction and point in `world`.
    pub fn axis(&self) -> (Unit<Vector3<f64>>, Point3<f64>) {
        if self.revolute {
            (
                Unit::new_normalize(Vector3::new(0.03, -0.02, 1.0)),
                Point3::new(0.2, 1.4, 0.0),
            )
        } else {
            (
                Unit::new_normalize(Vector3::new(1.0, 0.1, 0.02)),
                Point3::origin(),
            )
        }
    }

    fn moved(&self, q: f64) -> Isometry3<f64> {
        let (direction, point) = self.axis();
        if self.revolute {
            let turn = UnitQuaternion::from_axis_angle(&direction, q);
            Isometry3::from_parts(Translation3::from(point.coords - turn * point.coords), turn)
        } else {
            Isometry3::from_parts(
                Translation3::from(direction.into_inner() * q),
                UnitQuaternion::identity(),
            )
        }
    }

    fn grasp_pose() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.95, 1.3, 1.05), Vector3::new(0.4, -1.1, 0.3))
    }

    fn release_s(&self) -> f64 {
        GRASP_S + self.probing_s
    }

    /// `world_from_tcp` at a time.
    pub fn tcp(&self, t: f64) -> Isometry3<f64> {
        let (q, free) = if t < GRASP_S {
            (0.0, smooth((GRASP_S - t) / 2.0))
        } else {
            (self.q(t), smooth((t - self.release_s()) / 2.0))
        };
        let turn = Vector3::new(
            1.1 * (1.3 * t).sin(),
            0.9 * (1.7 * t + 0.4).sin(),
            0.7 * (2.3 * t).cos(),
        ) * free;
        let shift = Vector3::new((5.1 * t).sin(), (4.3 * t).cos(), (6.2 * t).sin()) * 0.06 * free;
        let since = (t - GRASP_S - 0.5 * self.probing_s) / 2.0;
        let turned = Vector3::new(0.0, self.turned_in_grasp * smooth(since), 0.0);
        self.moved(q)
            * Self::grasp_pose()
            * Isometry3::new(shift, turn)
            * UnitQuaternion::from_scaled_axis(turned)
    }

    /// Where the sensor sits.
    pub fn tcp_from_sensor() -> Isometry3<f64> {
        Isometry3::new(
            Vector3::new(0.01, -0.02, -0.12),
            Vector3::new(0.0, 0.3, 0.8),
        )
    }

    /// Joint coordinate while held: strokes that grow faster.
    pub fn q(&self, t: f64) -> f64 {
        let t = self.pace * (t - GRASP_S).clamp(0.0, self.probing_s);
        let phi = 0.4 * t + 0.055 * t * t + 0.35 * (1.0 - (1.3 * t).cos());
        self.range * (1.0 - phi.cos()) / 2.0
    }

    pub fn record(&self) -> Recording {
        let mut noise = Noise::new(self.seed);
        let end = self.release_s() + self.free_after_s;
        let tcp_from_sensor = Self::tcp_from_sensor();
        let device_from_tcp =
            Isometry3::new(Vector3::new(0.05, -0.12, 0.2), Vector3::new(0.5, 0.1, -0.2));
        let wrench = (0..(800.0 * end) as usize)
            .map(|i| i as f64 / 800.0)
            .map(|t| Stamped {
                at: at(t),
                value: self.wrench(t - self.late_s, &tcp_from_sensor, &mut noise),
            })
            .collect();
        let mut drift = [
            noise.vector() * self.wander[0],
            noise.vector() * self.wander[1],
        ];
        let rho = (-0.001_f64 / 10.0).exp();
        let poses = (0..(1000.0 * end) as usize)
            .map(|i| {
                let t = i as f64 * 0.001;
                for (d, size) in drift.iter_mut().zip(self.wander) {
                    *d = *d * rho + noise.vector() * (size * (1.0 - rho * rho).sqrt());
                }
                let mut pose = self.tcp(t) * device_from_tcp.inverse();
                pose.translation.vector += drift[0] + noise.vector() * self.pose_noise_m;
                pose.rotation = UnitQuaternion::from_scaled_axis(drift[1] + noise.vector() * 8e-5)
                    * pose.rotation;
                Stamped {
                    at: at(t),
                    value: pose7(&pose),
                }
            })
            .collect();
        let mark = |t: f64, name: &str| Stamped {
            at: at(t),
            value: name.to_owned(),
        };
        let marks = vec![
            mark(0.5, "free_air_begin"),
            mark(GRASP_S, "grasp"),
            mark(self.release_s(), "release"),
        ];
        Recording {
            path: PathBuf::from("made.mcap"),
            sha256: "0".repeat(64),
            wrench,
            pose: PoseTrack {
                frame: TrackedFrame::AriaDevice,
                samples: poses,
            },
            gripper_width: Vec::new(),
            temperature: Vec::new(),
            angular_rate: Vec::new(),
            aria_device_from_tcp: pose7(&device_from_tcp),
            tcp_from_ft_sensor: pose7(&tcp_from_sensor),
            marks,
            calibration: None,
            session: BTreeMap::new(),
            health: Default::default(),
        }
    }

    /// What the sensor reads: the object's reaction, the tool's weight and inertia, bias, noise.
    fn wrench(&self, t: f64, tcp_from_sensor: &Isometry3<f64>, noise: &mut Noise) -> [f64; 6] {
        let h = 2e-4;
        let sensor = |t: f64| self.tcp(t) * tcp_from_sensor;
        let now = sensor(t);
        let c = Vector3::from(COM);
        let com = |t: f64| (sensor(t) * Point3::from(c)).coords;
        let acceleration = (com(t + h) - com(t) * 2.0 + com(t - h)) / (h * h);
        let rate = |t: f64| {
            let turned = sensor(t + h).rotation * sensor(t - h).rotation.inverse();
            sensor(t).rotation.inverse() * turned.scaled_axis() / (2.0 * h)
        };
        let (w, dw) = (rate(t), (rate(t + h) - rate(t - h)) / (2.0 * h));
        let own = now.rotation.inverse() * (Vector3::new(0.0, 0.0, -9.80665) - acceleration) * MASS;
        let j = Matrix3::from_diagonal(&Vector3::from(INERTIA));
        let mut force = own;
        let mut torque = c.cross(&own) - (j * dw + w.cross(&(j * w)));
        if t >= GRASP_S && t <= self.release_s() {
            let by_object = -self.by_tool(t);
            let at_tcp = self.tcp(t).translation.vector - now.translation.vector;
            force += now.rotation.inverse() * by_object;
            torque += now.rotation.inverse() * at_tcp.cross(&by_object);
        }
        let drifted = self.drift_n_per_s * t;
        core::array::from_fn(|k| {
            let (value, std) = if k < 3 {
                (force[k] + drifted, 0.08)
            } else {
                (torque[k - 3], 0.003)
            };
            value + BIAS[k] + std * noise.normal()
        })
    }

    /// Force of the tool on the object at the TCP: what the joint asks for, and a part across it.
    fn by_tool(&self, t: f64) -> Vector3<f64> {
        let h = 2e-4;
        let (a, b, c) = (self.q(t - h), self.q(t), self.q(t + h));
        let (dq, ddq) = ((c - a) / (2.0 * h), (c - 2.0 * b + a) / (h * h));
        let tau =
            self.inertia * ddq + self.coulomb * dq.signum() + self.viscous * dq + (self.load)(b);
        let (direction, point) = self.axis();
        if !self.revolute {
            let across = direction.cross(&Vector3::z()) * 4.0 * (0.9 * t).sin();
            return direction.into_inner() * tau + across;
        }
        let arm = self.tcp(t).translation.vector - point.coords;
        let along = direction.cross(&arm);
        along * (tau / along.norm_squared())
            + direction.into_inner() * (5.0 * (0.9 * t).sin())
            + (along.cross(&direction)).normalize() * 4.0 * (0.6 * t).cos()
    }
}

/// From 0 to 1 over 0..1 with two continuous derivatives.
fn smooth(u: f64) -> f64 {
    let u = u.clamp(0.0, 1.0);
    u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
}

pub fn calibration() -> Calibration {
    let [xx, yy, zz] = INERTIA;
    Calibration {
        payload_mass_kg: Estimate {
            value: MASS,
            std: 0.002,
        },
        payload_com_m: Estimate {
            value: COM,
            std: [0.001; 3],
        },
        payload_inertia_kgm2: Estimate {
            value: [xx, 0.0, yy, 0.0, 0.0, zz],
            std: [1e-4; 6],
        },
        wrench_bias: Some(Estimate {
            value: BIAS,
            std: [0.02, 0.02, 0.02, 0.002, 0.002, 0.002],
        }),
        covariance: None,
    }
}

pub fn at(t: f64) -> HostTime {
    HostTime::from_nanos(START_NS).offset_by_seconds(t)
}

pub fn pose7(pose: &Isometry3<f64>) -> Pose7 {
    let q = pose.rotation.coords;
    Pose7 {
        position: pose.translation.vector.into(),
        quaternion: [q.x, q.y, q.z, q.w],
    }
}

struct Noise(ChaCha8Rng);

impl Noise {
    fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.normal())
    }
}
