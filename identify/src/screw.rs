//! Joints as screws: the kind, the axis, and first fits to a track of poses with the choice between the kinds.
//!
//! Conventions: `|direction| = 1`; revolute joints have pitch 0 and `point` is the foot of the perpendicular from the
//! first retained position; a prismatic joint's `point` is that position (of an effort's axis: from where the tool is at q = 0). All in the track's frame, m and rad.

mod candidate;
mod orientation;

pub use candidate::{Candidates, SelectError, select};
pub(crate) use orientation::{angles, robust_mean};

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

/// What a joint lets its part do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum JointKind {
    /// Turns about an axis; q in rad, effort in N m.
    Revolute,
    /// Slides along a line; q in m, effort in N.
    Prismatic,
}

impl JointKind {
    /// Unit of the joint coordinate.
    #[must_use]
    pub fn position_unit(self) -> &'static str {
        match self {
            Self::Revolute => "rad",
            Self::Prismatic => "m",
        }
    }

    /// Unit of the generalized effort.
    #[must_use]
    pub fn effort_unit(self) -> &'static str {
        match self {
            Self::Revolute => "N m",
            Self::Prismatic => "N",
        }
    }

    /// Unit of the generalized inertia.
    #[must_use]
    pub fn inertia_unit(self) -> &'static str {
        match self {
            Self::Revolute => "kg m^2",
            Self::Prismatic => "kg",
        }
    }

    /// Unit of viscous friction.
    #[must_use]
    pub fn viscous_unit(self) -> &'static str {
        match self {
            Self::Revolute => "N m s/rad",
            Self::Prismatic => "N s/m",
        }
    }

    /// The name used in reports and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Revolute => "revolute",
            Self::Prismatic => "prismatic",
        }
    }
}

/// A joint's axis: a unit direction through a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScrewAxis {
    /// Unit vector; the direction of positive motion (prismatic) or rotation (revolute, right hand).
    pub direction: Unit<Vector3<f64>>,
    /// A point on the axis, m.
    pub point: Point3<f64>,
    /// What kind of joint; a revolute joint's pitch is 0.
    pub kind: JointKind,
}

impl ScrewAxis {
    /// The motion from q = 0 to `q`.
    #[must_use]
    pub fn motion(&self, q: f64) -> Isometry3<f64> {
        match self.kind {
            JointKind::Prismatic => Isometry3::from_parts(
                Translation3::from(self.direction.into_inner() * q),
                UnitQuaternion::identity(),
            ),
            JointKind::Revolute => {
                let turn = UnitQuaternion::from_axis_angle(&self.direction, q);
                let shift = self.point.coords - turn * self.point.coords;
                Isometry3::from_parts(Translation3::from(shift), turn)
            }
        }
    }

    /// Velocity of `point` per unit of joint velocity.
    #[must_use]
    pub fn velocity_at(&self, point: &Point3<f64>) -> Vector3<f64> {
        match self.kind {
            JointKind::Prismatic => self.direction.into_inner(),
            JointKind::Revolute => self.direction.cross(&(point - self.point)),
        }
    }

    /// Distance of `point` from the axis, m.
    #[must_use]
    pub fn distance(&self, point: &Point3<f64>) -> f64 {
        let arm = point - self.point;
        (arm - self.direction.into_inner() * self.direction.dot(&arm)).norm()
    }

    /// The same joint with the coordinate reversed.
    #[must_use]
    pub fn reversed(&self) -> Self {
        Self {
            direction: -self.direction,
            ..*self
        }
    }

    /// Angle between the two lines, folded to [0, pi/2] rad, and their distance along the common perpendicular, m.
    #[must_use]
    pub fn separation(&self, other: &Self) -> (f64, f64) {
        let cross = self.direction.cross(&other.direction);
        let angle = cross
            .norm()
            .atan2(self.direction.dot(&other.direction).abs());
        let between = other.point - self.point;
        let distance = if cross.norm() > 1e-9 {
            between.dot(&cross).abs() / cross.norm()
        } else {
            (between - self.direction.into_inner() * self.direction.dot(&between)).norm()
        };
        (angle, distance)
    }
}

/// Two unit vectors that make a right-handed frame with `direction` as the third.
#[must_use]
pub fn perpendiculars(direction: &Unit<Vector3<f64>>) -> (Vector3<f64>, Vector3<f64>) {
    let helper = if direction.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let first = direction.cross(&helper).normalize();
    (first, direction.cross(&first))
}

/// A track of tool poses for kinematics: positions always, orientations where the source has them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseSamples {
    /// Positions in order of time, m.
    pub positions: Vec<Point3<f64>>,
    /// Rotations of the tool, the same count, or empty when unknown.
    pub rotations: Vec<UnitQuaternion<f64>>,
    /// First index of each gapless run, ascending, starting with 0.
    pub starts: Vec<usize>,
    /// Time between neighbours, s; 1 when the source has no time.
    pub period: f64,
}

impl PoseSamples {
    /// Whether orientations are there.
    #[must_use]
    pub fn has_rotations(&self) -> bool {
        !self.rotations.is_empty() && self.rotations.len() == self.positions.len()
    }

    /// Whether sample `index` follows its predecessor without a gap.
    #[must_use]
    pub fn follows(&self, index: usize) -> bool {
        index > 0 && self.starts.binary_search(&index).is_err()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_velocity_is_the_derivative_of_the_motion() {
        let point = Point3::new(0.4, -0.2, 0.9);
        for kind in [JointKind::Revolute, JointKind::Prismatic] {
            let axis = ScrewAxis {
                direction: Unit::new_normalize(Vector3::new(0.2, 0.5, -0.7)),
                point: Point3::new(1.0, 0.3, -0.1),
                kind,
            };
            let (q, h) = (0.7, 1e-6);
            let here = axis.motion(q) * point;
            let slope = (axis.motion(q + h) * point - axis.motion(q - h) * point) / (2.0 * h);
            assert!((slope - axis.velocity_at(&here)).norm() < 1e-8);
            assert!(
                (axis.distance(&here) - axis.distance(&point)).abs() < 1e-12
                    || kind == JointKind::Prismatic
            );
        }
    }

    #[test]
    fn separation_is_of_lines_not_of_directions() {
        let line = |x: f64, direction: Vector3<f64>| ScrewAxis {
            direction: Unit::new_normalize(direction),
            point: Point3::new(x, 0.0, 5.0),
            kind: JointKind::Revolute,
        };
        let (angle, distance) = line(0.0, Vector3::z()).separation(&line(0.3, -Vector3::z()));
        assert!(angle < 1e-12 && (distance - 0.3).abs() < 1e-12);
        let (angle, distance) = line(0.0, Vector3::z()).separation(&line(0.3, Vector3::y()));
        assert!(
            (angle - core::f64::consts::FRAC_PI_2).abs() < 1e-12 && (distance - 0.3).abs() < 1e-12
        );
    }
}
