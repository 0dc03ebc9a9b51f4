//! A scenario made particular by a seed: where the tracker's world is, and where everything stands in it.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::random::Random;
use crate::scenario::Scenario;
use crate::world::Joint;

/// Joint and grasp in the tracker's world.
#[derive(Clone, Debug)]
pub(crate) struct Setting {
    pub(crate) joint: Joint,
    /// Tool centre point at q = 0.
    pub(crate) grasp_position: Vector3<f64>,
    /// Axes of `tcp` at q = 0.
    pub(crate) grasp_rotation: UnitQuaternion<f64>,
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
        let joint = Joint {
            kind: scenario.joint.kind,
            axis: Unit::new_normalize(turn * Vector3::from(scenario.joint.axis)),
            point: place(scenario.joint.point),
            range: scenario.joint.range,
            panel_com: turn * Vector3::from(scenario.object.panel_com_m),
        };
        let along = turn * Vector3::from(scenario.grasp.approach).normalize();
        Self {
            joint,
            grasp_position: place(scenario.grasp.tcp_point),
            grasp_rotation: facing(along, scenario.grasp.roll_deg.to_radians()),
        }
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
