use nalgebra::{Unit, Vector3};

use super::*;
use crate::scenario::JointKind;

pub(super) fn object(inertia: f64) -> ObjectSpec {
    ObjectSpec {
        inertia,
        coulomb: 0.0,
        breakaway: None,
        viscous: 0.0,
        stop_stiffness: 1e4,
        stop_damping: 0.0,
        panel_mass_kg: 0.0,
        panel_com_m: [0.0; 3],
    }
}

pub(super) fn joint(kind: JointKind, axis: Vector3<f64>, range: [f64; 2]) -> Joint {
    let (axis, point) = (Unit::new_normalize(axis), Vector3::new(0.3, -1.0, 0.4));
    Joint {
        kind,
        axis,
        point,
        range,
        panel_com: Vector3::zeros(),
        axis_drift: Vector3::zeros(),
    }
}

pub(super) fn slider(object: ObjectSpec) -> World {
    let mut world = World::new(
        joint(JointKind::Prismatic, Vector3::x(), [-100.0, 100.0]),
        object,
        Vec::new(),
    );
    world.place(0.0, 0.0);
    world
}

/// A force that is a function of the joint's state.
pub(super) struct Pull<F>(pub(super) F);

impl<F: Fn(JointState) -> f64> Drive for Pull<F> {
    fn effort(&self, at: JointState) -> f64 {
        (self.0)(at)
    }
    fn inertia(&self) -> f64 {
        0.0
    }
}

pub(super) fn run(world: &mut World, drive: &dyn Drive, seconds: f64) {
    for _ in 0..(seconds * f64::from(STEPS_PER_SECOND)).round() as u32 {
        world.step(drive);
    }
}

#[test]
fn a_free_swing_on_a_spring_follows_the_cosine_and_keeps_its_energy() {
    let mut world = slider(object(3.0));
    world.place(0.5, 0.0);
    let spring = Pull(|at: JointState| -300.0 * at.q);
    for second in 1..=30 {
        run(&mut world, &spring, 1.0);
        let JointState { q, dq, .. } = world.state();
        let expected = 0.5 * (10.0 * f64::from(second)).cos();
        // 8 kHz steps lag by (omega h)^2 / 24 of the phase.
        assert!(
            (q - expected).abs() < 2e-5 * f64::from(second),
            "{q} {expected}"
        );
        let energy = 150.0 * q * q + 1.5 * dq * dq;
        assert!((energy - 37.5).abs() < 1e-4, "{energy}");
    }
}

#[test]
fn a_slide_under_dry_friction_stops_where_it_must_and_stays() {
    let mut world = slider(ObjectSpec {
        coulomb: 6.0,
        ..object(3.0)
    });
    world.place(0.0, 1.3);
    run(&mut world, &Free, 2.0);
    // v^2 / (2 mu / m), whatever the step.
    assert!(
        (world.state().q - 1.3 * 1.3 / 4.0).abs() < 1e-9,
        "{}",
        world.state().q
    );
    assert!(world.is_stuck());
    let at = world.state().q;
    run(&mut world, &Free, 5.0);
    assert_eq!(world.state().q, at);
}

#[test]
fn a_swing_under_dry_friction_loses_the_same_at_every_half_swing() {
    let (stiffness, friction) = (200.0, 5.0);
    let mut world = slider(ObjectSpec {
        coulomb: friction,
        ..object(2.0)
    });
    world.place(0.4, 0.0);
    let spring = Pull(|at: JointState| -stiffness * at.q);
    let mut turns = Vec::new();
    let mut last = 0.0;
    for _ in 0..8000 * 6 {
        world.step(&spring);
        let dq = world.state().dq;
        if dq * last < 0.0 || (last != 0.0 && world.is_stuck()) {
            turns.push(world.state().q.abs());
        }
        last = dq;
    }
    // The amplitude falls by 2 mu / k at each turn, until the spring is within friction.
    for (turn, amplitude) in turns.iter().enumerate() {
        let expected = 0.4 - 2.0 * friction / stiffness * (turn + 1) as f64;
        assert!(
            (amplitude - expected.abs()).abs() < 1e-6,
            "turn {turn}: {amplitude} {expected}"
        );
    }
    assert_eq!(turns.len(), 8, "{turns:?}");
    assert!(world.is_stuck() && stiffness * world.state().q.abs() <= friction);
}

#[test]
fn below_breakaway_nothing_moves_for_ever() {
    let mut world = slider(ObjectSpec {
        coulomb: 4.0,
        breakaway: Some(5.0),
        ..object(1.0)
    });
    run(&mut world, &Pull(|_| 4.999), 20.0);
    assert_eq!((world.state().q, world.state().dq), (0.0, 0.0));
    run(
        &mut world,
        &Pull(|at: JointState| 4.9 * (40.0 * at.t).sin()),
        20.0,
    );
    assert_eq!(world.state().q, 0.0);
    run(&mut world, &Pull(|_| 5.001), 1.0);
    assert!(
        (world.state().q - 0.5 * 1.001).abs() < 1e-9,
        "kinetic friction once it moves: {}",
        world.state().q
    );
}

#[test]
fn viscous_drag_decays_as_it_should() {
    let mut world = slider(ObjectSpec {
        viscous: 6.0,
        ..object(3.0)
    });
    world.place(0.0, 2.0);
    run(&mut world, &Free, 1.5);
    assert!((world.state().dq - 2.0 * (-3.0_f64).exp()).abs() < 1e-8);
}

#[test]
fn a_stop_returns_the_rate_it_was_hit_with() {
    let mut world = World::new(
        joint(JointKind::Prismatic, Vector3::x(), [0.0, 0.3]),
        object(3.0),
        Vec::new(),
    );
    world.place(0.1, 1.0);
    run(&mut world, &Free, 0.35);
    assert!(
        (world.state().dq + 1.0).abs() < 1e-2,
        "{}",
        world.state().dq
    );
    let damped = ObjectSpec {
        stop_damping: 100.0,
        ..object(3.0)
    };
    let mut world = World::new(
        joint(JointKind::Prismatic, Vector3::x(), [0.0, 0.3]),
        damped,
        Vec::new(),
    );
    world.place(0.1, 1.0);
    run(&mut world, &Free, 0.35);
    assert!(
        world.state().dq < 0.0 && world.state().dq > -0.8,
        "{}",
        world.state().dq
    );
}

#[test]
fn a_panel_on_a_horizontal_axis_swings_as_a_pendulum() {
    let object = ObjectSpec {
        panel_mass_kg: 4.0,
        ..object(4.0 * 0.6 * 0.6 + 0.1)
    };
    let mut joint = joint(JointKind::Revolute, Vector3::y(), [-3.0, 3.0]);
    joint.panel_com = Vector3::new(0.0, 0.0, -0.6);
    let inertia = object.inertia;
    let mut world = World::new(joint, object, Vec::new());
    let start = 0.02;
    world.place(start, 0.0);
    let omega = (4.0 * 9.80665 * 0.6 / inertia).sqrt();
    run(&mut world, &Free, 10.0);
    // Small swings; the period of a finite one is longer by start^2 / 16.
    let expected = start * (omega * 10.0 * (1.0 - start * start / 16.0)).cos();
    assert!(
        (world.state().q - expected).abs() < 1e-5,
        "{} {expected}",
        world.state().q
    );
}

#[test]
fn a_level_door_does_not_feel_its_weight_and_a_leaning_one_does() {
    let object = ObjectSpec {
        panel_mass_kg: 30.0,
        ..object(6.0)
    };
    let mut upright = joint(JointKind::Revolute, Vector3::z(), [0.0, 1.5]);
    upright.panel_com = Vector3::new(0.4, 0.0, 1.0);
    assert!(upright.gravity_effort(&object, 0.7).abs() < 1e-12);
    upright.axis = Unit::new_normalize(Vector3::new(0.0, 0.02, 1.0));
    assert!(upright.gravity_effort(&object, 0.7).abs() > 0.5);
}

#[test]
fn gravity_does_the_work_that_the_panel_loses_in_height() {
    let object = ObjectSpec {
        panel_mass_kg: 7.0,
        ..object(1.0)
    };
    let mut joint = joint(
        JointKind::Revolute,
        Vector3::new(0.6, -0.7, 0.3),
        [0.0, 1.5],
    );
    joint.panel_com = Vector3::new(0.2, 0.5, -0.1);
    let height =
        |q: f64| (nalgebra::UnitQuaternion::from_axis_angle(&joint.axis, q) * joint.panel_com).z;
    for q in [0.1, 0.8, 1.4] {
        let slope = -7.0 * 9.80665 * (height(q + 1e-6) - height(q - 1e-6)) / 2e-6;
        assert!((joint.gravity_effort(&object, q) - slope).abs() < 1e-6);
    }
}

#[test]
fn a_change_of_direction_inside_a_step_is_located() {
    // At a constant pull of 20 against 5 of friction the turn is exact: in slows at 25/m, out speeds up at 15/m.
    let mut world = slider(ObjectSpec {
        coulomb: 5.0,
        ..object(1.0)
    });
    world.place(0.0, -0.500_01);
    run(&mut world, &Pull(|_| 20.0), 0.1);
    let turn = 0.500_01 / 25.0;
    let expected = -0.5 * 25.0 * turn * turn + 0.5 * 15.0 * (0.1 - turn) * (0.1 - turn);
    assert!(
        (world.state().q - expected).abs() < 1e-9,
        "{} {expected}",
        world.state().q
    );
}

/// A passive with a memory: friction that grows with the distance travelled, and a payload that comes later.
#[derive(Debug, Default)]
struct Memory {
    travelled: f64,
}

impl Passive for Memory {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }
    fn dry_friction(&self, _at: JointState) -> DryFriction {
        DryFriction::symmetric(self.travelled, self.travelled)
    }
    fn added_inertia(&self, t: f64) -> f64 {
        if t < 1.0 { 0.0 } else { 2.0 }
    }
    fn advance(&mut self, from: JointState, to: JointState) {
        self.travelled += (to.q - from.q).abs();
    }
}

#[test]
fn a_passive_can_remember_rub_and_weigh() {
    let axis = joint(JointKind::Prismatic, Vector3::x(), [-100.0, 100.0]);
    let mut world = World::new(axis, object(1.0), vec![Box::new(Memory::default())]);
    world.place(0.0, 3.0);
    run(&mut world, &Free, 0.9);
    // d2x/dt2 = -x: a quarter of a sine.
    assert!(
        (world.state().q - 3.0 * 0.9_f64.sin()).abs() < 1e-3,
        "{}",
        world.state().q
    );
    run(&mut world, &Free, 0.2);
    let moment = world.moment(&Free, world.state().t);
    let needed = world.needed_effort(moment.state, moment.ddq, 1.0);
    assert!(needed.abs() < 1e-9, "no tool, so no effort: {needed}");
    assert!(
        (moment.ddq + world.state().q / 3.0).abs() < 1e-3,
        "three times the inertia: {}",
        moment.ddq
    );
}
