//! Forces across the motion and torques that do no work, as a person's grip makes them.
//!
//! The effort along the joint stays exact: what the torque about the axis adds, the force along the motion takes away.

use nalgebra::Vector3;

use crate::motion::Jet;
use crate::random::{Random, Wave};
use crate::scenario::{JointKind, PersonSpec};
use crate::tool::ContactWrench;
use crate::world::Joint;

/// How much of the force along the motion leaks across it.
const LEAK: f64 = 0.12;
/// Slow enough for a person who leans on the tool.
const LEAN_HZ: [f64; 2] = [0.05, 0.7];

#[derive(Clone, Debug)]
pub(crate) struct Grip {
    across: [Wave; 2],
    torques: [Wave; 3],
    about_axis: Wave,
    grasp: f64,
    release: f64,
}

impl Grip {
    pub(crate) fn new(spec: &PersonSpec, [grasp, release]: [f64; 2], random: &mut Random) -> Self {
        let share = std::f64::consts::FRAC_1_SQRT_2;
        Self {
            across: std::array::from_fn(|_| {
                Wave::new(random, share * spec.off_axis_force_n, LEAN_HZ)
            }),
            torques: std::array::from_fn(|_| {
                Wave::new(random, spec.off_axis_torque_nm / 3.0_f64.sqrt(), LEAN_HZ)
            }),
            about_axis: Wave::new(random, spec.about_axis_torque_nm, LEAN_HZ),
            grasp,
            release,
        }
    }

    /// The wrench on the object whose effort along the joint is `effort`, at the tool centre point `tcp`.
    pub(crate) fn wrench(
        &self,
        joint: &Joint,
        tcp: Vector3<f64>,
        effort: f64,
        t: f64,
    ) -> ContactWrench {
        let held = Jet::window(t - self.grasp, self.release - self.grasp, 0.4).value;
        let per_rate = joint.velocity_per_rate(tcp);
        let lever = per_rate.norm();
        let along = per_rate / lever;
        let axis = joint.axis.into_inner();
        let helper = if along.z.abs() < 0.9 {
            Vector3::z()
        } else {
            Vector3::x()
        };
        let first = along.cross(&helper).normalize();
        let second = along.cross(&first);
        let mut moment = Vector3::from_fn(|row, _| held * self.torques[row].value(t));
        let mut working = 0.0;
        if joint.kind == JointKind::Revolute {
            working = held * self.about_axis.value(t);
            moment += axis * (working - axis.dot(&moment));
        }
        let push = (effort - working) / lever;
        let lean = first * (held * self.across[0].value(t))
            + second * (held * self.across[1].value(t) + LEAK * push);
        ContactWrench {
            force: along * push + lean,
            moment,
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Unit;

    use super::*;
    use crate::random::Stream;

    #[test]
    fn leaning_on_the_tool_does_no_work() {
        let spec = PersonSpec {
            off_axis_force_n: 15.0,
            ..PersonSpec::default()
        };
        for kind in [JointKind::Revolute, JointKind::Prismatic] {
            let joint = Joint {
                kind,
                axis: Unit::new_normalize(Vector3::new(0.2, -0.3, 0.9)),
                point: Vector3::new(1.0, -2.0, 0.3),
                range: [0.0, 1.0],
                panel_com: Vector3::zeros(),
                axis_drift: Vector3::zeros(),
            };
            let grip = Grip::new(&spec, [0.0, 60.0], &mut Random::new(4, Stream::OffAxis));
            let tcp = Vector3::new(1.4, -1.5, 0.9);
            let mut across = 0.0_f64;
            for step in 0..600 {
                let t = 0.1 * f64::from(step);
                let wrench = grip.wrench(&joint, tcp, 12.5, t);
                assert!((joint.effort_of(tcp, wrench.force, wrench.moment) - 12.5).abs() < 1e-12);
                let along = joint.velocity_per_rate(tcp).normalize();
                across = across.max((wrench.force - along * along.dot(&wrench.force)).norm());
            }
            assert!((10.0..40.0).contains(&across), "{across}");
        }
    }
}
