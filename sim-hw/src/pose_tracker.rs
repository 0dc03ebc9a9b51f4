//! The pose tracker: truth plus white noise plus a wander that comes back to zero.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use crate::motion::RigidMotion;
use crate::random::{Random, Wander};
use crate::scenario::TrackerSpec;

#[derive(Debug)]
pub(crate) struct PoseTracker {
    white_m: f64,
    white_rad: f64,
    wander: Wander<6>,
    tcp_from_aria_device: Isometry3<f64>,
    random: Random,
}

impl PoseTracker {
    pub(crate) fn new(
        spec: &TrackerSpec,
        aria_device_from_tcp: &Isometry3<f64>,
        mut random: Random,
    ) -> Self {
        let (shift, turn) = (spec.wander_m, spec.wander_deg.to_radians());
        let wander = Wander::new(
            &mut random,
            [shift, shift, shift, turn, turn, turn],
            spec.wander_s,
        );
        Self {
            white_m: spec.white_m,
            white_rad: spec.white_deg.to_radians(),
            wander,
            tcp_from_aria_device: aria_device_from_tcp.inverse(),
            random,
        }
    }

    /// `world_from_aria_device` as tracked at `t` seconds: position, quaternion x y z w.
    pub(crate) fn read(&mut self, tcp: &RigidMotion, t: f64) -> ([f64; 3], [f64; 4]) {
        let world_from_tcp = Isometry3::from_parts(Translation3::from(tcp.position), tcp.rotation);
        let truth = world_from_tcp * self.tcp_from_aria_device;
        let [x, y, z, turn_x, turn_y, turn_z] = self.wander.at(&mut self.random, t);
        let white = self.random.normals::<6>();
        let shift =
            Vector3::new(x, y, z) + Vector3::new(white[0], white[1], white[2]) * self.white_m;
        let turn = Vector3::new(turn_x, turn_y, turn_z)
            + Vector3::new(white[3], white[4], white[5]) * self.white_rad;
        let position = truth.translation.vector + shift;
        let rotation = UnitQuaternion::from_scaled_axis(turn) * truth.rotation;
        (position.into(), rotation.coords.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn a_still_tool_is_seen_to_wander_by_millimetres_and_to_scatter_by_micrometres() {
        let spec = TrackerSpec::default();
        let mount = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.4, -0.2, 0.1));
        let mut tracker = PoseTracker::new(&spec, &mount, Random::new(2, Stream::Tracker));
        let still = RigidMotion::still(Vector3::new(1.0, 2.0, 3.0), UnitQuaternion::identity());
        let seen: Vec<_> = (0..400_000)
            .map(|i| tracker.read(&still, f64::from(i) * 1e-3))
            .collect();
        let rms = |gap: usize| {
            let (mut shift, mut turn, mut count) = (0.0, 0.0, 0.0);
            for pair in seen.windows(gap + 1).step_by(7) {
                let ((first, a), (last, b)) = (pair[0], pair[gap]);
                shift += (Vector3::from(last) - Vector3::from(first)).norm_squared();
                let [a, b] =
                    [a, b].map(|q| UnitQuaternion::from_quaternion(nalgebra::Quaternion::from(q)));
                turn += a.angle_to(&b).powi(2);
                count += 1.0;
            }
            ((shift / count).sqrt(), (turn / count).sqrt().to_degrees())
        };
        let (shift, turn) = rms(10_000);
        assert!(
            (1.5e-3..5e-3).contains(&shift) && (0.1..0.3).contains(&turn),
            "over 10 s: {shift} m, {turn} deg"
        );
        let (shift, turn) = rms(1);
        // 24 um in each of three axes, twice, and a millisecond of wander.
        assert!(
            (50e-6..90e-6).contains(&shift) && turn < 0.02,
            "over 1 ms: {shift} m, {turn} deg"
        );
    }

    #[test]
    fn without_noise_the_glasses_are_where_they_are_mounted() {
        let quiet = TrackerSpec {
            white_m: 0.0,
            white_deg: 0.0,
            wander_m: 0.0,
            wander_deg: 0.0,
            ..TrackerSpec::default()
        };
        let mount = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::new(0.4, -0.2, 0.1));
        let mut tracker = PoseTracker::new(&quiet, &mount, Random::new(2, Stream::Tracker));
        let tcp = RigidMotion::still(
            Vector3::new(1.0, 2.0, 3.0),
            UnitQuaternion::from_euler_angles(0.3, 0.1, -2.0),
        );
        let (position, _) = tracker.read(&tcp, 0.5);
        // The tool centre point seen from the glasses is aria_device_from_tcp applied to the origin.
        let back = Vector3::from(position)
            + tcp.rotation * mount.rotation.inverse() * mount.translation.vector;
        assert!((back - tcp.position).norm() < 1e-12);
    }
}
