//! A tool that a person turns over and shakes in free air: poses and wrench, by Newton and Euler on the body itself, with
//! derivatives taken numerically from the path. It shares no formula with the calibration.
#![allow(dead_code, reason = "each test file uses a part of it")]

use std::path::PathBuf;

use ft_recording::{Pose7, PoseTrack, Recording, Stamped, TrackedFrame};
use ft_wire::HostTime;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

pub(crate) const START: HostTime = HostTime::from_nanos(1_700_000_000_000_000_000);

/// A generator of numbers that look random (splitmix64); the same for the same seed.
pub(crate) struct Numbers(pub(crate) u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In `from..to`.
    pub(crate) fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * ((self.next() >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// Normal with standard deviation 1.
    pub(crate) fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.within(1e-300, 1.0).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.within(0.0, 1.0)).cos()
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.within(-size, size))
    }

    fn normals(&mut self, std: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| std * self.normal())
    }

    fn rotation(&mut self) -> UnitQuaternion<f64> {
        let quaternion =
            nalgebra::Quaternion::new(self.normal(), self.normal(), self.normal(), self.normal());
        UnitQuaternion::from_quaternion(quaternion)
    }
}

/// Sum of sines: amplitude, rad/s, phase.
struct Wave(Vec<(f64, f64, f64)>);

impl Wave {
    fn random(numbers: &mut Numbers, amplitude: f64, from_hz: f64, to_hz: f64) -> Self {
        let count = 7;
        let parts = (0..count).map(|_| {
            let hz = numbers.within(from_hz, to_hz);
            let share = amplitude / (count as f64).sqrt() * numbers.within(0.6, 1.4);
            (share, std::f64::consts::TAU * hz, numbers.within(0.0, 6.3))
        });
        Self(parts.collect())
    }

    fn at(&self, t: f64) -> f64 {
        self.0.iter().map(|(a, w, p)| a * (w * t + p).sin()).sum()
    }
}

/// How the tool is moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    /// Size of the turns, rad, and of the strokes, m.
    pub(crate) turns_rad: f64,
    pub(crate) strokes_m: f64,
    /// Fastest part, Hz.
    pub(crate) to_hz: f64,
    pub(crate) duration_s: f64,
    pub(crate) kind: MotionKind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum MotionKind {
    /// Irregular.
    Shake,
    /// One frequency only.
    Swing,
    /// Two seconds still, two on the way, and so on.
    Stills,
}

impl MotionKind {
    /// Time along the path at `t`.
    fn along(self, t: f64) -> f64 {
        if self != Self::Stills {
            return t;
        }
        let whole = (t / 4.0).floor();
        let part = t / 4.0 - whole;
        let u = (2.0 * part - 1.0).max(0.0);
        4.0 * (whole + u * u * u * (10.0 - 15.0 * u + 6.0 * u * u))
    }
}

impl Motion {
    /// Ten seconds of a good shake.
    pub(crate) const SHAKE: Self = Self {
        turns_rad: 1.2,
        strokes_m: 0.06,
        to_hz: 2.5,
        duration_s: 10.0,
        kind: MotionKind::Shake,
    };
    /// A tool that is turned over, with pauses.
    pub(crate) const STILLS: Self = Self {
        turns_rad: 1.5,
        strokes_m: 0.05,
        to_hz: 0.3,
        duration_s: 40.0,
        kind: MotionKind::Stills,
    };
}

/// The tool, the sensor, and how they are recorded.
#[derive(Clone, Debug)]
pub(crate) struct Setup {
    pub(crate) mass: f64,
    pub(crate) com: Vector3<f64>,
    /// About the centre of mass, in sensor axes.
    pub(crate) inertia: Matrix3<f64>,
    pub(crate) bias: [f64; 6],
    /// Per second.
    pub(crate) bias_rate: [f64; 6],
    /// The bias follows the temperature, per kelvin.
    pub(crate) bias_per_kelvin: [f64; 6],
    /// The sensor warms up and cools down by so much, K; 0 for a sensor without a thermometer.
    pub(crate) warms_k: f64,
    pub(crate) tcp_from_ft_sensor: Pose7,
    pub(crate) motion: Motion,
    /// Seconds to add to the pose's stamps to make them right.
    pub(crate) offset_s: f64,
    /// The pose's clock is slow by this, parts of one, about 0 s.
    pub(crate) skew: f64,
    pub(crate) pose_hz: f64,
    pub(crate) wrench_hz: f64,
    pub(crate) force_noise: f64,
    pub(crate) torque_noise: f64,
    /// White, per pose; second differences of measured Aria positions have 58 um, so 24 um each.
    pub(crate) position_noise_m: f64,
    pub(crate) rotation_noise_rad: f64,
    /// The tracker begins so much later than the sensor.
    pub(crate) pose_late_s: f64,
    pub(crate) seed: u64,
}

impl Setup {
    pub(crate) fn random(seed: u64, motion: Motion) -> Self {
        let mut numbers = Numbers(seed.wrapping_mul(0x5851_f42d_4c95_7f2d) + 99);
        let mass = numbers.within(0.25, 1.2);
        // A box of point masses: an inertia that a body can have.
        let half = Vector3::from_fn(|_, _| numbers.within(0.015, 0.07));
        let turn = numbers.rotation().to_rotation_matrix();
        let squares = half.component_mul(&half);
        let diagonal = Matrix3::from_diagonal(
            &Vector3::new(
                squares.y + squares.z,
                squares.x + squares.z,
                squares.x + squares.y,
            )
            .scale(mass / 3.0),
        );
        let com = Vector3::new(
            numbers.within(-0.03, 0.03),
            numbers.within(-0.03, 0.03),
            numbers.within(0.03, 0.12),
        );
        let force = numbers.vector(6.0);
        let torque = numbers.vector(0.3);
        let sensor = numbers.rotation();
        let position = numbers.vector(0.15);
        Self {
            mass,
            com,
            inertia: turn * diagonal * turn.transpose(),
            bias: [force.x, force.y, force.z, torque.x, torque.y, torque.z],
            bias_rate: [0.0; 6],
            bias_per_kelvin: [0.0; 6],
            warms_k: 0.0,
            tcp_from_ft_sensor: pose7(&position, &sensor),
            motion,
            offset_s: numbers.within(-3.0, 3.0),
            skew: 0.0,
            pose_hz: 1000.0,
            wrench_hz: 1000.0,
            force_noise: 0.05,
            torque_noise: 0.002,
            position_noise_m: 25e-6,
            rotation_noise_rad: 0.1e-3,
            pose_late_s: 0.0,
            seed,
        }
    }

    /// Kelvin above the mean at `t`, up and down within a minute.
    fn warmer(&self, t: f64) -> f64 {
        0.5 * self.warms_k * (t / 10.0).sin()
    }

    /// What the sensor and the tracker deliver.
    pub(crate) fn record(&self) -> Recording {
        let mut numbers = Numbers(self.seed + 7);
        let Motion {
            turns_rad,
            strokes_m,
            to_hz,
            duration_s,
            kind,
        } = self.motion;
        let (turns_from, turns_to, strokes_from) = match kind {
            MotionKind::Swing => (to_hz, to_hz, to_hz),
            _ => (0.15, to_hz.max(0.4) * 0.5, 0.2),
        };
        let turns: [Wave; 3] =
            std::array::from_fn(|_| Wave::random(&mut numbers, turns_rad, turns_from, turns_to));
        let strokes: [Wave; 3] =
            std::array::from_fn(|_| Wave::random(&mut numbers, strokes_m, strokes_from, to_hz));
        let tcp = |t: f64| {
            let t = kind.along(t);
            let rotation =
                Rotation3::from_euler_angles(turns[0].at(t), turns[1].at(t), turns[2].at(t));
            let position = Vector3::from_fn(|k, _| strokes[k].at(t));
            (position, UnitQuaternion::from_rotation_matrix(&rotation))
        };
        let mount = quaternion(&self.tcp_from_ft_sensor);
        let arm = Vector3::from(self.tcp_from_ft_sensor.position);
        // Sensor's rotation and the place of the centre of mass.
        let body = |t: f64| {
            let (position, rotation) = tcp(t);
            let sensor = rotation * mount;
            (sensor, position + rotation * arm + sensor * self.com)
        };
        let wrench = |t: f64| {
            let h = 2e-4;
            let rate = |t: f64| {
                let step = body(t - h).0.inverse() * body(t + h).0;
                step.scaled_axis() / (2.0 * h)
            };
            let (rotation, place) = body(t);
            let acceleration = (body(t + h).1 - place * 2.0 + body(t - h).1) / (h * h);
            let gravity = Vector3::new(0.0, 0.0, -9.80665);
            let force = self.mass * (rotation.inverse() * (gravity - acceleration));
            let (w, dw) = (rate(t), (rate(t + h) - rate(t - h)) / (2.0 * h));
            let torque =
                self.com.cross(&force) - (self.inertia * dw + w.cross(&(self.inertia * w)));
            (force, torque)
        };
        let stamp = |t: f64| HostTime::from_nanos(START.as_nanos() + (t * 1e9).round() as i64);
        let samples = |hz: f64| (0..(duration_s * hz) as usize).map(move |k| k as f64 / hz);
        let wrench = samples(self.wrench_hz).map(|t| {
            let (force, torque) = wrench(t);
            let value = std::array::from_fn(|k| {
                let (own, noise) = match k {
                    0..3 => (force[k], self.force_noise),
                    _ => (torque[k - 3], self.torque_noise),
                };
                let bias =
                    self.bias[k] + self.bias_rate[k] * t + self.bias_per_kelvin[k] * self.warmer(t);
                own + bias + noise * numbers.normal()
            });
            Stamped {
                at: stamp(t),
                value,
            }
        });
        let wrench: Vec<_> = wrench.collect();
        let poses = samples(self.pose_hz)
            .filter(|t| *t >= self.pose_late_s)
            .map(|t| {
                let (position, rotation) = tcp(t);
                let position = position + numbers.normals(self.position_noise_m);
                let wobble =
                    UnitQuaternion::from_scaled_axis(numbers.normals(self.rotation_noise_rad));
                Stamped {
                    at: stamp(t - self.offset_s - self.skew * t),
                    value: pose7(&position, &(rotation * wobble)),
                }
            });
        Recording {
            path: PathBuf::from("simulated.mcap"),
            sha256: String::new(),
            pose: PoseTrack {
                frame: TrackedFrame::Tcp,
                samples: poses.collect(),
            },
            wrench,
            gripper_width: Vec::new(),
            temperature: match self.warms_k {
                0.0 => Vec::new(),
                _ => samples(1.0)
                    .map(|t| Stamped {
                        at: stamp(t),
                        value: 25.0 + self.warmer(t),
                    })
                    .collect(),
            },
            angular_rate: Vec::new(),
            aria_device_from_tcp: Pose7::IDENTITY,
            tcp_from_ft_sensor: self.tcp_from_ft_sensor,
            marks: Vec::new(),
            calibration: None,
            session: std::collections::BTreeMap::new(),
            health: ft_recording::recording::ReadHealth::default(),
        }
    }
}

fn quaternion(pose: &Pose7) -> UnitQuaternion<f64> {
    let [x, y, z, w] = pose.quaternion;
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z))
}

fn pose7(position: &Vector3<f64>, rotation: &UnitQuaternion<f64>) -> Pose7 {
    let q = rotation.coords;
    Pose7 {
        position: (*position).into(),
        quaternion: [q.x, q.y, q.z, q.w],
    }
}
