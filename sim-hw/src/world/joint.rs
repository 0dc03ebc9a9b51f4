//! Where the joint's coordinate takes points of the object.

use nalgebra::{Unit, UnitQuaternion, Vector3};

use super::GRAVITY;
use crate::motion::{Jet, RigidMotion};
use crate::scenario::{JointKind, ObjectSpec};

/// The joint in the tracker's world.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Direction; q grows right-handed about it or along it.
    pub axis: Unit<Vector3<f64>>,
    /// A point on the axis, m.
    pub point: Vector3<f64>,
    /// The two stops, rad or m.
    pub range: [f64; 2],
    /// Centre of the panel's mass at q = 0 from `point`, m, world axes.
    pub panel_com: Vector3<f64>,
    /// How the axis itself moves per unit of q where the joint is, m/rad or 1; zero for a good hinge.
    pub axis_drift: Vector3<f64>,
}

/// Distance of a point from a line, m.
pub(crate) fn distance_to_axis(on_axis: [f64; 3], axis: [f64; 3], point: [f64; 3]) -> f64 {
    let axis = Vector3::from(axis).normalize();
    let from_axis = Vector3::from(point) - Vector3::from(on_axis);
    (from_axis - axis * axis.dot(&from_axis)).norm()
}

impl Joint {
    /// The motion of a frame that is fixed to the object and is at (`position`, `rotation`) when q = 0.
    #[must_use]
    pub(crate) fn carry(
        &self,
        position: Vector3<f64>,
        rotation: UnitQuaternion<f64>,
        q: Jet,
    ) -> RigidMotion {
        match self.kind {
            JointKind::Prismatic => {
                RigidMotion::still(position, rotation).shifted(self.axis.into_inner(), q)
            }
            JointKind::Revolute => {
                let turn = UnitQuaternion::from_axis_angle(&self.axis, q.value);
                let lever = turn * (position - self.point);
                let mut motion = RigidMotion::still(self.point + lever, turn * rotation);
                motion.rate = self.axis.into_inner() * q.rate;
                motion.rate_change = self.axis.into_inner() * q.rate_change;
                motion.velocity = motion.rate.cross(&lever);
                motion.acceleration =
                    motion.rate_change.cross(&lever) + motion.rate.cross(&motion.velocity);
                motion
            }
        }
    }

    /// How a point of the object at `position` (now, world) moves per unit of dq.
    #[must_use]
    pub fn velocity_per_rate(&self, position: Vector3<f64>) -> Vector3<f64> {
        let drift = self.axis_drift;
        match self.kind {
            JointKind::Prismatic => self.axis.into_inner() + drift,
            JointKind::Revolute => self.axis.cross(&(position - self.point)) + drift,
        }
    }

    /// Effort of a force at `position` and a moment (world axes), by virtual work.
    #[must_use]
    pub fn effort_of(
        &self,
        position: Vector3<f64>,
        force: Vector3<f64>,
        moment: Vector3<f64>,
    ) -> f64 {
        let turning = match self.kind {
            JointKind::Prismatic => 0.0,
            JointKind::Revolute => self.axis.dot(&moment),
        };
        self.velocity_per_rate(position).dot(&force) + turning
    }

    /// Effort of the panel's weight at `q`.
    pub(crate) fn gravity_effort(&self, object: &ObjectSpec, q: f64) -> f64 {
        if object.panel_mass_kg == 0.0 {
            return 0.0;
        }
        let weight = GRAVITY * object.panel_mass_kg;
        match self.kind {
            JointKind::Prismatic => self.axis.dot(&weight),
            JointKind::Revolute => {
                let lever = UnitQuaternion::from_axis_angle(&self.axis, q) * self.panel_com;
                self.axis.dot(&lever.cross(&weight))
            }
        }
    }
}
