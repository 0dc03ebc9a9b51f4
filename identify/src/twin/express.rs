//! The same twin in another frame and in another joint coordinate: the effort stays (the paper's twin assembly).

use nalgebra::{Isometry3, Point3, Vector3};

use super::{Coordinate, Twin};
use crate::mechanism::Domain;

impl Twin {
    /// The twin with its axis in frame `name`, `name_from_old` taking the old frame's coordinates there. The joint
    /// coordinate and the effort stay.
    #[must_use]
    pub fn in_frame(&self, name: &str, name_from_old: &Isometry3<f64>) -> Self {
        let mut twin = self.clone();
        twin.joint.frame = name.to_owned();
        twin.joint.axis_direction = self
            .joint
            .axis_direction
            .map(|d| (name_from_old.rotation * Vector3::from(d)).into());
        twin.joint.axis_point = self
            .joint
            .axis_point
            .map(|p| (name_from_old * Point3::from(p)).coords.into());
        twin.joint.tool_position = self
            .joint
            .tool_position
            .map(|p| (name_from_old * Point3::from(p)).coords.into());
        twin
    }

    /// The twin in the coordinate `s q + offset`, `s` = 1 or (when `reversed`) -1. The axis turns with the sense.
    #[must_use]
    pub fn in_coordinate(&self, reversed: bool, offset: f64) -> Self {
        let s = if reversed { -1.0 } else { 1.0 };
        let mut twin = self.clone();
        let old = self.joint.coordinate;
        twin.joint.coordinate = Coordinate {
            sign: s * old.sign,
            offset: s * old.offset + offset,
        };
        let mapped = |[low, high]: [f64; 2], offset: f64| {
            let (a, b) = (s * low + offset, s * high + offset);
            [a.min(b), a.max(b)]
        };
        twin.joint.q_range = mapped(self.joint.q_range, offset);
        twin.domain = Domain {
            q: mapped(self.domain.q, offset),
            dq: mapped(self.domain.dq, 0.0),
        };
        twin.joint.axis_direction = self.joint.axis_direction.map(|d| d.map(|v| s * v));
        twin
    }
}
