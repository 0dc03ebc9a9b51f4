//! Poses without frames in their types, and static transforms between named frames.

use std::collections::BTreeMap;

use crate::message::TransformStamped;

/// A pose: position and unit quaternion. Which frames it stands between is said by the name of the field that holds it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose7 {
    /// m.
    pub position: [f64; 3],
    /// x y z w, of length 1.
    pub quaternion: [f64; 4],
}

impl Pose7 {
    /// Frames that coincide.
    pub const IDENTITY: Self = Self {
        position: [0.0; 3],
        quaternion: [0.0, 0.0, 0.0, 1.0],
    };

    /// A pose with its quaternion (x y z w) brought to length 1; `None` when a number is not finite or the quaternion's
    /// length is not within 0.5 and 2, so that it is no rotation.
    #[must_use]
    pub fn normalised(position: [f64; 3], quaternion: [f64; 4]) -> Option<Self> {
        let length = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
        let usable = position.iter().all(|p| p.is_finite()) && (0.5..=2.0).contains(&length);
        usable.then(|| Self {
            position,
            quaternion: quaternion.map(|q| q / length),
        })
    }

    /// `a_from_c` from `a_from_b` (self) and `b_from_c`.
    #[must_use]
    pub fn then(&self, b_from_c: &Self) -> Self {
        let [ax, ay, az, aw] = self.quaternion;
        let [bx, by, bz, bw] = b_from_c.quaternion;
        let [rx, ry, rz] = self.rotate(b_from_c.position);
        let [px, py, pz] = self.position;
        Self {
            position: [px + rx, py + ry, pz + rz],
            quaternion: [
                aw * bx + ax * bw + ay * bz - az * by,
                aw * by - ax * bz + ay * bw + az * bx,
                aw * bz + ax * by - ay * bx + az * bw,
                aw * bw - ax * bx - ay * by - az * bz,
            ],
        }
    }

    /// `b_from_a` from `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let [x, y, z, w] = self.quaternion;
        let turned = Self {
            position: [0.0; 3],
            quaternion: [-x, -y, -z, w],
        };
        Self {
            position: turned.rotate(self.position).map(|p| -p),
            ..turned
        }
    }

    /// Turns a direction of b to a.
    #[must_use]
    pub fn rotate(&self, [vx, vy, vz]: [f64; 3]) -> [f64; 3] {
        let [x, y, z, w] = self.quaternion;
        let [tx, ty, tz] = [
            2.0 * (y * vz - z * vy),
            2.0 * (z * vx - x * vz),
            2.0 * (x * vy - y * vx),
        ];
        [
            vx + w * tx + y * tz - z * ty,
            vy + w * ty + z * tx - x * tz,
            vz + w * tz + x * ty - y * tx,
        ]
    }
}

/// Static transforms, by child frame and by parent frame.
#[derive(Debug, Default)]
pub(crate) struct StaticTransforms {
    /// `parent_from_child` by parent, then child; and its inverse the other way.
    edges: BTreeMap<String, BTreeMap<String, Pose7>>,
}

impl StaticTransforms {
    /// Takes a transform in; `false` when it is no pose. A later one between the same frames replaces the earlier.
    pub(crate) fn add(&mut self, transform: &TransformStamped) -> bool {
        let parent = frame_name(&transform.header.frame_id);
        let child = frame_name(&transform.child_frame_id);
        let transform = transform.transform;
        let pose = Pose7::normalised(transform.translation.into(), transform.rotation.into());
        if let Some(pose) = pose {
            self.set(parent, child, pose);
        }
        pose.is_some()
    }

    /// Puts `child` at `parent_from_child`.
    pub(crate) fn set(&mut self, parent: &str, child: &str, pose: Pose7) {
        self.edges
            .entry(parent.to_owned())
            .or_default()
            .insert(child.to_owned(), pose);
        self.edges
            .entry(child.to_owned())
            .or_default()
            .insert(parent.to_owned(), pose.inverse());
    }

    /// `to_from_from` along the shortest chain of transforms; `None` when none leads there.
    pub(crate) fn between(&self, to: &str, from: &str) -> Option<Pose7> {
        let mut steps = self.path(to, from)?.into_iter();
        steps.try_fold(Pose7::IDENTITY, |pose, (parent, child)| {
            Some(pose.then(self.edges.get(&parent)?.get(&child)?))
        })
    }

    /// Steps along the shortest chain, from frame to frame; `None` when none leads there.
    pub(crate) fn path(&self, from: &str, to: &str) -> Option<Vec<(String, String)>> {
        let mut before: BTreeMap<&str, Option<&str>> = BTreeMap::from([(from, None)]);
        let mut front = vec![from];
        while !front.is_empty() && !before.contains_key(to) {
            let mut next = Vec::new();
            for frame in front {
                for neighbour in self.edges.get(frame).into_iter().flat_map(BTreeMap::keys) {
                    if !before.contains_key(neighbour.as_str()) {
                        before.insert(neighbour, Some(frame));
                        next.push(neighbour.as_str());
                    }
                }
            }
            front = next;
        }
        before.get(to)?;
        let step_to = |frame: &str| {
            let above = (*before.get(frame)?)?;
            Some((above.to_owned(), frame.to_owned()))
        };
        let back = std::iter::successors(step_to(to), |(above, _)| step_to(above));
        let mut path: Vec<_> = back.collect();
        path.reverse();
        Some(path)
    }
}

/// A frame's name without the slash that ROS 1 wrote before it.
pub(crate) fn frame_name(name: &str) -> &str {
    name.strip_prefix('/').unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Header;

    fn transform(parent: &str, child: &str, pose: Pose7) -> TransformStamped {
        let mut message = TransformStamped {
            header: Header {
                frame_id: parent.to_owned(),
                ..Header::default()
            },
            child_frame_id: child.to_owned(),
            ..TransformStamped::default()
        };
        message.transform.translation = pose.position.into();
        message.transform.rotation = pose.quaternion.into();
        message
    }

    fn assert_close(a: Pose7, b: Pose7) {
        for (a, b) in a
            .position
            .iter()
            .chain(&a.quaternion)
            .zip(b.position.iter().chain(&b.quaternion))
        {
            assert!((a - b).abs() < 1e-12, "{a} is not {b}");
        }
    }

    const HALF: f64 = std::f64::consts::FRAC_1_SQRT_2;
    /// A quarter turn about z, then one metre along the turned x.
    const TURNED: Pose7 = Pose7 {
        position: [0.0, 1.0, 0.0],
        quaternion: [0.0, 0.0, HALF, HALF],
    };

    #[test]
    fn a_quarter_turn_about_z_takes_x_to_y() {
        let [x, y, z] = TURNED.rotate([1.0, 0.0, 0.0]);
        assert!(x.abs() < 1e-12 && (y - 1.0).abs() < 1e-12 && z.abs() < 1e-12);
    }

    #[test]
    fn a_pose_and_its_inverse_are_nothing() {
        assert_close(TURNED.then(&TURNED.inverse()), Pose7::IDENTITY);
        assert_close(TURNED.inverse().then(&TURNED), Pose7::IDENTITY);
    }

    #[test]
    fn chains_and_inverted_edges_are_followed() {
        let mut transforms = StaticTransforms::default();
        let step = Pose7 {
            position: [1.0, 0.0, 0.0],
            ..Pose7::IDENTITY
        };
        assert!(transforms.add(&transform("/aria_device", "mount", TURNED)));
        assert!(transforms.add(&transform("tcp", "mount", step)));
        let found = transforms.between("aria_device", "tcp").unwrap();
        assert_close(found, TURNED.then(&step.inverse()));
        assert_eq!(transforms.between("aria_device", "ft_sensor"), None);
    }

    #[test]
    fn a_quaternion_of_no_length_is_no_pose() {
        assert_eq!(Pose7::normalised([0.0; 3], [0.0; 4]), None);
        assert_eq!(Pose7::normalised([0.0; 3], [0.0, 0.0, 0.0, f64::NAN]), None);
        assert_eq!(
            Pose7::normalised([f64::INFINITY, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]),
            None
        );
        assert_eq!(
            Pose7::normalised([0.0; 3], [0.0, 0.0, 0.0, 0.999]).map(|pose| pose.quaternion),
            Some([0.0, 0.0, 0.0, 1.0])
        );
    }
}
