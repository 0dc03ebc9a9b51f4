//! A plain body for a twin that has no geometry: a panel and a handle.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::screw::JointKind;
use crate::twin::Twin;

/// Thickness of the panel, m.
const THICKNESS: f64 = 0.02;
/// Height of a panel whose size nobody measured, over its width.
const HEIGHT_PER_WIDTH: f64 = 1.0;

/// A body on one joint, everything in the twin's frame at joint coordinate 0.
///
/// The centre of mass of a turning body is put on the axis: the twin's effort has gravity in it already, and a simulator
/// must not add it again. Its inertia about the axis is the twin's; those across only have to be those of some rigid body.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Origin of the body: on the axis, beside the handle; m.
    pub origin: Point3<f64>,
    /// Unit direction of the joint.
    pub axis: Vector3<f64>,
    /// Rotation that takes x to the axis.
    pub x_to_axis: UnitQuaternion<f64>,
    /// Mass, kg.
    pub mass: f64,
    /// Principal inertias in the frame whose x is the axis, kg m^2.
    pub inertia: [f64; 3],
    /// Centre of the panel from the origin, m.
    pub panel_centre: Vector3<f64>,
    /// Orientation of the panel: x across, y along the axis or upward, z through.
    pub panel_rotation: UnitQuaternion<f64>,
    /// Width, height and thickness of the panel, m.
    pub panel_size: [f64; 3],
    /// Handle from the origin, m.
    pub handle: Vector3<f64>,
    /// Smallest and largest coordinate, rad or m.
    pub range: [f64; 2],
}

impl Scene {
    /// Of a twin. Without a measured axis: about (or along) z through the origin, with a handle at 0.5 m.
    #[must_use]
    pub fn of(twin: &Twin) -> Self {
        let kind = twin.joint.kind;
        let axis = Vector3::from(twin.joint.axis_direction.unwrap_or([0.0, 0.0, 1.0])).normalize();
        let point = Point3::from(twin.joint.axis_point.unwrap_or([0.0; 3]));
        let across = crate::screw::perpendiculars(&nalgebra::Unit::new_unchecked(axis)).0;
        let handle = twin.tool_at_zero().unwrap_or(match kind {
            JointKind::Revolute => point + 0.5 * across,
            JointKind::Prismatic => point,
        });
        let (origin, width, out) = match kind {
            JointKind::Revolute => {
                let foot = point + axis * axis.dot(&(handle - point));
                let arm = handle - foot;
                let width = arm.norm().max(0.01);
                (
                    foot,
                    width,
                    if arm.norm() > 1e-9 {
                        arm / width
                    } else {
                        across
                    },
                )
            }
            JointKind::Prismatic => (handle, 0.4, across),
        };
        let value = twin.evaluator().inertia();
        let (mass, inertia, panel_x, panel_y) = match kind {
            JointKind::Revolute => {
                // A thin plate hinged at its edge: I = m w^2 / 3. Those across must let the triangle inequality hold.
                (
                    3.0 * value / (width * width),
                    [value, 0.6 * value, 0.6 * value],
                    out,
                    axis,
                )
            }
            JointKind::Prismatic => {
                let of_plate = value * 0.4 * 0.4 / 12.0;
                let up = if axis.z.abs() < 0.9 {
                    Vector3::z()
                } else {
                    Vector3::y()
                };
                let side = up.cross(&axis).normalize();
                (
                    value,
                    [2.0 * of_plate, of_plate, of_plate],
                    side,
                    axis.cross(&side),
                )
            }
        };
        let panel_rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[
            panel_x,
            panel_y,
            panel_x.cross(&panel_y),
        ]));
        let panel_centre = match kind {
            JointKind::Revolute => 0.5 * width * out,
            JointKind::Prismatic => Vector3::zeros(),
        };
        Self {
            kind,
            origin,
            axis,
            x_to_axis: UnitQuaternion::rotation_between(&Vector3::x(), &axis).unwrap_or_else(
                || UnitQuaternion::from_axis_angle(&Vector3::y_axis(), core::f64::consts::PI),
            ),
            mass,
            inertia,
            panel_centre,
            panel_rotation: UnitQuaternion::from_rotation_matrix(&panel_rotation),
            panel_size: [width, HEIGHT_PER_WIDTH * width, THICKNESS],
            handle: handle - origin,
            range: twin.joint.q_range,
        }
    }
}

/// Three numbers, separated by blanks.
pub(super) fn three(v: &Vector3<f64>) -> String {
    format!("{} {} {}", v.x, v.y, v.z)
}

/// A quaternion as w x y z, separated by blanks.
pub(super) fn wxyz(q: &UnitQuaternion<f64>) -> String {
    format!("{} {} {} {}", q.w, q.i, q.j, q.k)
}
