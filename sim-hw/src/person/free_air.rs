//! The tool in free air: held still in four orientations, shaken, and brought to the handle.

use nalgebra::{Unit, UnitQuaternion, Vector3};

use crate::motion::{Jet, RigidMotion};
use crate::random::{Random, Wave};

/// Seconds of the free-air part at its usual length, to which those below belong.
const FULL_S: f64 = 8.0;
const TURN_S: f64 = 0.5;
const STILL_S: f64 = 0.8;
const SHAKE_S: f64 = 1.7;
const APPROACH_S: f64 = FULL_S - 4.0 * (TURN_S + STILL_S) - SHAKE_S;

#[derive(Clone, Copy, Debug)]
struct Stance {
    position: Vector3<f64>,
    rotation: UnitQuaternion<f64>,
}

/// The tool's motion from the start to the grasp, and after the release.
#[derive(Clone, Debug)]
pub(crate) struct FreeAir {
    stances: Vec<Stance>,
    grasp: Stance,
    begins: f64,
    /// How the part's times are stretched.
    stretch: f64,
    shake_share: f64,
    tremor: [Wave; 3],
    shifts: [[f64; 3]; 3],
    turns: [[f64; 3]; 3],
}

impl FreeAir {
    /// Ends at (`position`, `rotation`) at `ends`; the stances are taken from `begins` on.
    pub(crate) fn new(
        position: Vector3<f64>,
        rotation: UnitQuaternion<f64>,
        [begins, ends]: [f64; 2],
        random: &mut Random,
    ) -> Self {
        let stretch = (ends - begins) / FULL_S;
        // Less time, smaller turns: nobody whips a gripper about.
        let share = (stretch / 0.8).powi(2).min(1.0);
        let away = rotation * Vector3::new(0.0, 0.0, -0.35);
        let mut turn = |least: f64, most: f64| random.uniform(least, most).to_radians() * share;
        let offsets = [
            [turn(-12.0, 12.0), 0.0, 0.0],
            [turn(-75.0, -60.0), 0.0, turn(-20.0, 20.0)],
            [0.0, turn(55.0, 70.0), 0.0],
            [turn(50.0, 65.0), turn(-30.0, -15.0), turn(60.0, 80.0)],
            [turn(-30.0, -15.0), turn(-20.0, 20.0), 0.0],
        ];
        let stances = offsets
            .iter()
            .enumerate()
            .map(|(index, offset)| Stance {
                position: position + away + Vector3::new(0.0, 0.0, 0.02 * index as f64 * share),
                rotation: rotation * UnitQuaternion::from_scaled_axis(Vector3::from(*offset)),
            })
            .collect();
        let mut oscillation = |amplitude: f64| {
            [
                amplitude * random.uniform(0.8, 1.2),
                random.uniform(1.6, 3.2),
                random.uniform(0.0, std::f64::consts::TAU),
            ]
        };
        let shifts = std::array::from_fn(|_| oscillation(0.035));
        let turns = std::array::from_fn(|_| oscillation(0.28));
        Self {
            stances,
            grasp: Stance { position, rotation },
            begins,
            stretch,
            shake_share: share,
            tremor: std::array::from_fn(|_| Wave::new(random, 3e-5, [8.0, 12.0])),
            shifts,
            turns,
        }
    }

    /// The tool centre point at `t`, before the grasp.
    pub(crate) fn before(&self, t: f64) -> RigidMotion {
        let since = (t - self.begins) / self.stretch;
        let leg = TURN_S + STILL_S;
        let shake_begins = 4.0 * leg;
        let approach_begins = shake_begins + SHAKE_S;
        let calm = Jet::constant(1.0).plus(
            Jet::rise(t - self.time(approach_begins), self.stretch * APPROACH_S).scaled(-1.0),
        );
        let motion = if since < shake_begins {
            let index = (since / leg).floor().clamp(0.0, 3.0) as usize;
            self.travel(
                self.stances[index],
                self.stances[index + 1],
                t,
                index as f64 * leg,
                TURN_S,
            )
        } else if since < approach_begins {
            self.shake(t - self.time(shake_begins))
        } else {
            self.travel(self.stances[4], self.grasp, t, approach_begins, APPROACH_S)
        };
        self.tremor
            .iter()
            .enumerate()
            .fold(motion, |motion, (axis, wave)| {
                motion.shifted(Vector3::ith(axis, 1.0), wave.at(t).times(calm))
            })
    }

    /// The tool centre point after it let go at `held`, at `released`.
    pub(crate) fn after(&self, held: &RigidMotion, released: f64, t: f64) -> RigidMotion {
        let back = held.rotation * Vector3::new(0.0, 0.0, -1.0);
        let distance = Jet::rise(t - released - 0.15, 0.7).scaled(0.12);
        RigidMotion::still(held.position, held.rotation).shifted(back, distance)
    }

    fn time(&self, since: f64) -> f64 {
        self.begins + self.stretch * since
    }

    fn travel(&self, from: Stance, to: Stance, t: f64, begins: f64, seconds: f64) -> RigidMotion {
        let rise = Jet::rise(t - self.time(begins), self.stretch * seconds);
        let turn = (from.rotation.inverse() * to.rotation).scaled_axis();
        let motion = RigidMotion::still(from.position, from.rotation)
            .shifted(to.position - from.position, rise);
        match Unit::try_new_and_get(turn, 1e-9) {
            Some((axis, angle)) => motion.turned(axis, rise.scaled(angle)),
            None => motion,
        }
    }

    fn shake(&self, t: f64) -> RigidMotion {
        let Stance { position, rotation } = self.stances[4];
        let window =
            Jet::window(t, self.stretch * SHAKE_S, 0.45 * self.stretch).scaled(self.shake_share);
        let mut motion = RigidMotion::still(position, rotation);
        for axis in 0..3 {
            let [amplitude, hz, phase] = self.shifts[axis];
            motion = motion.shifted(
                Vector3::ith(axis, 1.0),
                Jet::sine(amplitude, hz, phase, t).times(window),
            );
        }
        for axis in 0..3 {
            let [amplitude, hz, phase] = self.turns[axis];
            let unit = Unit::new_unchecked(Vector3::ith(axis, 1.0));
            motion = motion.turned(unit, Jet::sine(amplitude, hz, phase, t).times(window));
        }
        motion
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    fn free_air() -> FreeAir {
        let rotation = UnitQuaternion::from_euler_angles(1.2, 0.1, 0.4);
        FreeAir::new(
            Vector3::new(1.0, 2.0, 1.1),
            rotation,
            [2.0, 10.0],
            &mut Random::new(8, Stream::Person),
        )
    }

    #[test]
    fn the_tool_never_jumps_and_its_rates_are_true() {
        let free_air = free_air();
        let h = 1e-5;
        for step in 0..1990 {
            let t = 0.005 * f64::from(step) + 0.0017;
            let (before, here, after) = (
                free_air.before(t - h),
                free_air.before(t),
                free_air.before(t + h),
            );
            let velocity = (after.position - before.position) / (2.0 * h);
            let rate = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
            let acceleration = (after.velocity - before.velocity) / (2.0 * h);
            assert!(
                (velocity - here.velocity).norm() < 1e-4,
                "at {t}: {velocity} {}",
                here.velocity
            );
            assert!((rate - here.rate).norm() < 1e-4, "at {t}");
            assert!((acceleration - here.acceleration).norm() < 0.05, "at {t}");
        }
    }

    #[test]
    fn it_is_held_still_in_four_different_orientations() {
        let free_air = free_air();
        let held: Vec<_> = (0..4)
            .map(|index| free_air.before(2.0 + 1.3 * f64::from(index) + 0.9))
            .collect();
        for motion in &held {
            assert!(motion.rate.norm() < 1e-12 && motion.acceleration.norm() < 1.0);
        }
        for (first, second) in [(0, 1), (1, 2), (2, 3), (0, 2)] {
            assert!(held[first].rotation.angle_to(&held[second].rotation) > 0.6);
        }
    }

    #[test]
    fn it_reaches_the_handle_at_rest() {
        let end = free_air().before(10.0);
        assert!((end.position - Vector3::new(1.0, 2.0, 1.1)).norm() < 1e-12);
        assert!(end.velocity.norm() < 1e-9 && end.rate.norm() < 1e-9);
    }
}
