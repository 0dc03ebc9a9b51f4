//! A scenario made particular by a seed: where the tracker's world is, and where everything stands in it.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::motion::{Jet, RigidMotion};
use crate::random::Random;
use crate::scenario::{EffectSpec, Scenario};
use crate::world::Joint;

/// Joint and grasp in the tracker's world.
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    pub(crate) joint: Joint,
    /// Tool centre point at q = 0.
    pub(crate) grasp_position: Vector3<f64>,
    /// Axes of `tcp` at q = 0.
    pub(crate) grasp_rotation: UnitQuaternion<f64>,
    /// Takes the building's axes to the world's.
    pub(crate) turn: UnitQuaternion<f64>,
    /// The axis' direction as the scenario declares it.
    pub(crate) declared_axis: Unit<Vector3<f64>>,
    /// How far the axis has moved at the open stop, m.
    axis_shift: Option<Vector3<f64>>,
}

impl Setting {
    pub(crate) fn draw(scenario: &Scenario, random: &mut Random) -> Self {
        let drawn_yaw = random.uniform(-180.0, 180.0);
        let drawn_origin = [
            random.uniform(-2.0, 2.0),
            random.uniform(-2.0, 2.0),
            random.uniform(-1.6, -1.2),
        ];
        let yaw = scenario.world.yaw_deg.unwrap_or(drawn_yaw).to_radians();
        let origin = Vector3::from(scenario.world.origin_m.unwrap_or(drawn_origin));
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        let world_from_building = Isometry3::from_parts(Translation3::from(origin), turn);
        let place = |point: [f64; 3]| (world_from_building * nalgebra::Point3::from(point)).coords;
        let declared_axis = Unit::new_normalize(turn * Vector3::from(scenario.joint.axis));
        let (mut axis, mut axis_shift) = (declared_axis, None);
        for effect in &scenario.undeclared {
            match effect {
                EffectSpec::Gravity {
                    tilt_deg,
                    azimuth_deg,
                } => {
                    let (sin, cos) = azimuth_deg.to_radians().sin_cos();
                    let lean = turn * Vector3::new(-sin, cos, 0.0) * tilt_deg.to_radians();
                    axis = UnitQuaternion::from_scaled_axis(lean) * axis;
                }
                EffectSpec::AxisOffset { shift_m } => {
                    axis_shift = Some(turn * Vector3::from(*shift_m));
                }
                _ => {}
            }
        }
        let joint = Joint {
            kind: scenario.joint.kind,
            axis,
            point: place(scenario.joint.point),
            range: scenario.joint.range,
            panel_com: turn * Vector3::from(scenario.object.panel_com_m),
            axis_drift: Vector3::zeros(),
        };
        let along = turn * Vector3::from(scenario.grasp.approach).normalize();
        Self {
            joint,
            grasp_position: place(scenario.grasp.tcp_point),
            grasp_rotation: facing(along, scenario.grasp.roll_deg.to_radians()),
            turn,
            declared_axis,
            axis_shift,
        }
    }

    /// The tool centre point's motion while the tool holds the object.
    pub(crate) fn carry(&self, q: Jet) -> RigidMotion {
        let motion = self
            .joint
            .carry(self.grasp_position, self.grasp_rotation, q);
        self.with_axis_moved(motion, q)
    }

    /// The same, `count` times `beside` away from the grasp (world axes at q = 0).
    pub(crate) fn carry_beside(&self, beside: Vector3<f64>, count: Jet, q: Jet) -> RigidMotion {
        let at = self.grasp_position + beside * count.value;
        let mut motion = self.joint.carry(at, self.grasp_rotation, q);
        let beside = motion.rotation * self.grasp_rotation.inverse() * beside;
        motion.velocity += beside * count.rate;
        motion.acceleration +=
            beside * count.rate_change + motion.rate.cross(&beside) * (2.0 * count.rate);
        self.with_axis_moved(motion, q)
    }

    fn with_axis_moved(&self, motion: RigidMotion, q: Jet) -> RigidMotion {
        let Some(shift) = self.axis_shift else {
            return motion;
        };
        let [share, slope, curvature] = self.axis_share(q.value);
        let share = Jet {
            value: share,
            rate: slope * q.rate,
            rate_change: slope * q.rate_change + curvature * q.rate * q.rate,
        };
        motion.shifted(shift, share)
    }

    /// The joint with its axis where it is at `q`.
    pub(crate) fn joint_at(&self, q: f64) -> Joint {
        let mut joint = self.joint.clone();
        if let Some(shift) = self.axis_shift {
            let [share, slope, _] = self.axis_share(q);
            joint.point += shift * share;
            joint.axis_drift = shift * slope;
        }
        joint
    }

    /// Share of the axis' shift at `q` with its first two derivatives: half a wave, flat at both stops.
    fn axis_share(&self, q: f64) -> [f64; 3] {
        let per_q = std::f64::consts::PI / self.joint.range[1];
        let (sin, cos) = (per_q * q).sin_cos();
        [
            0.5 - 0.5 * cos,
            0.5 * per_q * sin,
            0.5 * per_q * per_q * cos,
        ]
    }

    /// Distance from the joint's axis to the tool centre point, m; 1 for a prismatic joint.
    pub(crate) fn lever(&self) -> f64 {
        self.joint.velocity_per_rate(self.grasp_position).norm()
    }
}

/// Axes with z along `along` and x as level as it can be, turned by `roll` about z.
fn facing(along: Vector3<f64>, roll: f64) -> UnitQuaternion<f64> {
    let up = if along.z.abs() < 0.95 {
        Vector3::z()
    } else {
        Vector3::x()
    };
    let x = up.cross(&along).normalize();
    let y = along.cross(&x);
    let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
        Matrix3::from_columns(&[x, y, along]),
    ));
    level * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll)
}
