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
