use super::*;
use crate::scenario::JointKind;
use crate::world::tests::{Pull, joint, object, run, slider};
use crate::world::{Drive, Free, JointState, STEPS_PER_SECOND, World};

fn built(effect: &EffectSpec, object: &ObjectSpec) -> Box<dyn Passive> {
    one(effect, object, 1.0, 0.0).unwrap()
}

/// A mass on a line without stops, with `effect`, at 0 and at rest.
fn world(object: ObjectSpec, effect: EffectSpec) -> World {
    let axis = joint(
        JointKind::Prismatic,
        nalgebra::Vector3::x(),
        [-100.0, 100.0],
    );
    let passives = vec![built(&effect, &object)];
    let object = without_bristles(std::slice::from_ref(&effect), &object);
    let mut world = World::new(axis, object, passives);
    world.place(0.0, 0.0);
    world
}

fn at(q: f64, dq: f64) -> JointState {
    JointState { t: 0.0, q, dq }
}

fn rough(mass: f64, coulomb: f64) -> ObjectSpec {
    ObjectSpec {
        coulomb,
        ..object(mass)
    }
}

/// The work that an effect does on the way from `from` to `to`.
fn work(effect: &dyn Passive, from: f64, to: f64) -> f64 {
    let steps = 20_000;
    let way = (to - from) / f64::from(steps);
    (0..steps)
        .map(|step| effect.effort(at(from + (f64::from(step) + 0.5) * way, way)) * way)
        .sum()
}

const NOTCH: EffectSpec = EffectSpec::Detent {
    at: 0.4,
    reach: 0.05,
    hold: 6.0,
};
const TOGGLE: EffectSpec = EffectSpec::ToggleLinkage {
    at: 0.5,
    arm: 1.0,
    height_m: 0.08,
    free_length_m: 0.2,
    stiffness_n_per_m: 300.0,
};

#[test]
fn springs_notches_ripples_and_toggles_give_back_what_they_took() {
    let ripple = EffectSpec::Ripple {
        amplitude: 2.0,
        period: 0.07,
        phase_rad: 1.0,
    };
    let spring = EffectSpec::Spring {
        rate: 30.0,
        rest: 0.2,
    };
    for effect in [NOTCH, TOGGLE, ripple, spring] {
        let passive = built(&effect, &object(1.0));
        let (there, back) = (
            work(passive.as_ref(), 0.1, 0.9),
            work(passive.as_ref(), 0.9, 0.1),
        );
        assert!((there + back).abs() < 1e-9, "{effect:?}: {there} {back}");
        let (half, rest) = (
            work(passive.as_ref(), 0.1, 0.42),
            work(passive.as_ref(), 0.42, 0.9),
        );
        assert!(
            (half + rest - there).abs() < 1e-4 && half.abs() > 0.01,
            "{effect:?}"
        );
    }
}

#[test]
fn a_notch_draws_in_from_both_sides_and_is_felt_nowhere_else() {
    let notch = built(&NOTCH, &object(1.0));
    assert_eq!(notch.effort(at(0.34, 0.0)), 0.0);
    assert_eq!(notch.effort(at(0.46, 0.0)), 0.0);
    assert!(
        (notch.effort(at(0.375, 0.0)) - 6.0).abs() < 1e-12,
        "half-way up, towards it"
    );
    assert!((notch.effort(at(0.425, 0.0)) + 6.0).abs() < 1e-12);
    // A mass let go on the flank swings about the middle for ever.
    let mut world = world(object(2.0), NOTCH);
    world.place(0.38, 0.0);
    run(&mut world, &Free, 7.0);
    let energy = |q: f64, dq: f64| {
        dq * dq
            - 6.0 * 0.05 / std::f64::consts::PI * (std::f64::consts::PI * (q - 0.4) / 0.05).cos()
    };
    let state = world.state();
    assert!((energy(state.q, state.dq) - energy(0.38, 0.0)).abs() < 1e-5);
}

#[test]
fn a_toggle_snaps_away_from_its_dead_centre_on_both_sides_and_goes_slack() {
    let toggle = built(&TOGGLE, &object(1.0));
    assert_eq!(toggle.effort(at(0.5, 0.0)), 0.0);
    assert!(toggle.effort(at(0.45, 0.0)) < -5.0 && toggle.effort(at(0.55, 0.0)) > 5.0);
    let slack = 0.5 + (0.2_f64 * 0.2 - 0.08 * 0.08).sqrt();
    assert_eq!(toggle.effort(at(slack + 1e-6, 0.0)), 0.0);
}

#[test]
fn a_constant_load_and_a_magnet_pull_as_they_say() {
    let mut world = world(object(2.0), EffectSpec::ConstantLoad { effort: -3.0 });
    run(&mut world, &Free, 1.0);
    assert!((world.state().q + 0.75).abs() < 1e-9, "{}", world.state().q);
    let magnet = built(
        &EffectSpec::Catch {
            pull: 20.0,
            reach: 0.02,
            at: 0.0,
        },
        &object(1.0),
    );
    assert_eq!(magnet.effort(at(0.0, 0.0)), -20.0);
    assert_eq!(magnet.effort(at(0.02, 0.0)), -5.0);
}

#[test]
fn one_way_dampers_act_one_way_and_a_zone_only_inside() {
    let zone = built(
        &EffectSpec::DampingZone {
            from: -1.0,
            to: 0.3,
            direction: crate::scenario::SwingDirection::Closing,
            damping: 20.0,
            blend: 0.02,
        },
        &object(1.0),
    );
    assert_eq!(zone.effort(at(0.2, -0.5)), 10.0);
    assert_eq!(zone.effort(at(0.2, 0.5)), 0.0);
    assert_eq!(zone.effort(at(0.4, -0.5)), 0.0);
    assert!(
        (zone.effort(at(0.3, -0.5)) - 5.0).abs() < 1e-12,
        "half at its edge"
    );
    let everywhere = built(
        &EffectSpec::AsymmetricViscous {
            direction: crate::scenario::SwingDirection::Opening,
            damping: 8.0,
        },
        &object(1.0),
    );
    assert_eq!(everywhere.effort(at(7.0, 0.5)), -4.0);
    assert_eq!(everywhere.effort(at(7.0, -0.5)), 0.0);
}

#[test]
fn dry_friction_that_acts_one_way_stops_one_way() {
    let slid = |dq: f64| {
        let effect = EffectSpec::AsymmetricCoulomb {
            direction: crate::scenario::SwingDirection::Opening,
            coulomb: 3.0,
        };
        let mut world = world(rough(2.0, 1.0), effect);
        world.place(0.0, dq);
        run(&mut world, &Free, 4.0);
        assert!(world.is_stuck());
        world.state().q
    };
    assert!((slid(1.0) - 2.0 / (2.0 * 4.0)).abs() < 1e-9);
    assert!((slid(-1.0) + 2.0 / (2.0 * 1.0)).abs() < 1e-9);
}

#[test]
fn drag_slows_as_the_square() {
    let mut world = world(object(2.0), EffectSpec::QuadraticDrag { drag: 6.0 });
    world.place(0.0, 1.5);
    run(&mut world, &Free, 1.0);
    // dv/dt = -c v^2 / m.
    assert!((world.state().dq - 1.5 / (1.0 + 3.0 * 1.5)).abs() < 1e-6);
    world.place(0.0, -1.5);
    run(&mut world, &Free, 1.0);
    assert!((world.state().dq + 1.5 / 5.5).abs() < 1e-6);
}

/// A mass dragged by a spring whose end goes at `rate`.
fn times_stopped(world: &mut World, rate: f64, seconds: f64) -> u32 {
    let pull = Pull(|at: JointState| 400.0 * (rate * at.t - at.q) + 20.0 * (rate - at.dq));
    let (mut stopped, mut was_stuck) = (0, true);
    for _ in 0..(seconds * f64::from(STEPS_PER_SECOND)) as u32 {
        world.step(&pull);
        stopped += u32::from(world.is_stuck() && !was_stuck);
        was_stuck = world.is_stuck();
    }
    stopped
}

#[test]
fn friction_that_falls_with_speed_makes_slow_motion_stick_and_slip() {
    let stribeck = EffectSpec::Stribeck {
        extra: 6.0,
        rate: 0.02,
    };
    let passive = built(&stribeck, &object(1.0));
    let level = |dq: f64| passive.dry_friction(at(0.0, dq)).kinetic(dq);
    assert!((level(0.02) - 3.0).abs() < 1e-12 && level(1e-6) > 5.99 && level(0.2) < 0.06);
    assert_eq!(level(-0.05), level(0.05));
    assert_eq!(passive.dry_friction(at(0.0, 0.0)).breakaway_forward, 6.0);
    let slow = times_stopped(&mut world(rough(2.0, 2.0), stribeck.clone()), 0.01, 20.0);
    let fast = times_stopped(&mut world(rough(2.0, 2.0), stribeck), 0.3, 5.0);
    let without = times_stopped(&mut slider(rough(2.0, 2.0)), 0.01, 20.0);
    // It slips by up to twice the fall of the force over the stiffness, 30 mm, and is dragged 200 mm.
    assert!((5..12).contains(&slow), "{slow}");
    assert!(fast <= 1 && without <= 1, "{fast} {without}");
}

#[test]
fn stiction_holds_more_than_it_slides_with() {
    let effect = EffectSpec::Stiction { extra: 3.0 };
    let mut held = world(rough(1.0, 4.0), effect.clone());
    run(&mut held, &Pull(|_| 6.999), 5.0);
    assert_eq!(held.state().q, 0.0);
    let mut broken = world(rough(1.0, 4.0), effect);
    run(&mut broken, &Pull(|_| 7.001), 1.0);
    assert!(
        (broken.state().q - 0.5 * 3.001).abs() < 1e-9,
        "{}",
        broken.state().q
    );
}

const BRISTLES: EffectSpec = EffectSpec::Presliding { length: 0.005 };

#[test]
fn bristles_bend_before_they_slide_and_spring_back() {
    // Half of the friction bends them; nothing slides away.
    let mut held = world(rough(1.0, 8.0), BRISTLES);
    let slow = |peak: f64| Pull(move |at: JointState| peak * (at.t / 4.0).min(1.0));
    run(&mut held, &slow(4.0), 5.0);
    let bent = held.state().q;
    assert!((2e-4..2.5e-3).contains(&bent), "{bent}");
    let from = held.state().t;
    let release = Pull(move |at: JointState| 4.0 * (1.0 - (at.t - from) / 4.0).max(0.0));
    run(&mut held, &release, 6.0);
    let left = held.state().q;
    assert!(
        left < 0.6 * bent && left > 0.0,
        "some of it stays: {left} of {bent}"
    );
    // A little more than all of the friction, and it goes.
    let mut gone = world(rough(1.0, 8.0), BRISTLES);
    run(&mut gone, &slow(8.2), 10.0);
    assert!(gone.state().q > 0.05, "{}", gone.state().q);
}

#[test]
fn bristles_make_a_loop_whose_area_is_the_friction_and_inner_loops_close() {
    let mut bristles = bristles::Bristles::new(8.0, 0.005);
    let mut q = 0.0;
    let mut go = |bristles: &mut bristles::Bristles, to: f64| {
        let (steps, mut done) = (2000, 0.0);
        let way = (to - q) / f64::from(steps);
        for _ in 0..steps {
            let (from, to) = (at(q, way), at(q + way, way));
            done += 0.5 * (bristles.effort(from) + bristles.effort(to)) * way;
            bristles.advance(from, to);
            q += way;
        }
        done
    };
    go(&mut bristles, 0.1);
    assert!((bristles.effort(at(0.1, 1.0)) + 8.0).abs() < 1e-9);
    let before = bristles.effort(at(0.1, 0.0));
    // A small turn and back: the same force, and the loop took energy.
    let lost = go(&mut bristles, 0.097) + go(&mut bristles, 0.1);
    assert!((bristles.effort(at(0.1, 0.0)) - before).abs() < 1e-9 && lost < -1e-4);
    // A large one: the parallelogram, less what the bending leaves out.
    let large = go(&mut bristles, -0.1) + go(&mut bristles, 0.1);
    assert!((large + 2.0 * 8.0 * 0.2).abs() < 0.1 * 3.2, "{large}");
}

#[test]
fn friction_along_the_way_and_while_cold_is_what_it_says() {
    let narrowing = built(
        &EffectSpec::PositionDependentFriction {
            growth: 4.0,
            power: 1.0,
        },
        &object(1.0),
    );
    assert_eq!(narrowing.dry_friction(at(0.5, 0.3)).forward, 2.0);
    assert_eq!(narrowing.dry_friction(at(0.0, 0.3)).backward, 0.0);
    let level = |world: &World| world.needed_effort(at(0.0, 1e-9), 0.0, 1.0);
    let by_time = EffectSpec::FrictionDrift {
        extra: 5.0,
        seconds: Some(3.0),
        travel: None,
    };
    let mut cold = world(rough(1.0, 1.0), by_time);
    run(&mut cold, &Free, 4.0);
    assert!((level(&cold) - 6.0).abs() < 1e-6, "cold until it moves");
    let there_and_back = Pull(|at: JointState| 40.0 * (9.0 * at.t).sin());
    run(&mut cold, &there_and_back, 3.0);
    assert!(
        (level(&cold) - (1.0 + 5.0 / std::f64::consts::E)).abs() < 0.01,
        "{}",
        level(&cold)
    );
    let by_way = EffectSpec::FrictionDrift {
        extra: 5.0,
        seconds: None,
        travel: Some(2.0),
    };
    let mut cold = world(rough(1.0, 0.0), by_way);
    while cold.state().q < 2.0 {
        run(&mut cold, &Pull(|_| 9.0), 1.0 / 8000.0);
    }
    assert!(
        (level(&cold) - 5.0 / std::f64::consts::E).abs() < 0.01,
        "{}",
        level(&cold)
    );
}

#[test]
fn a_load_is_put_in_at_rest_and_brings_no_blow() {
    let effect = EffectSpec::PayloadSwitch {
        inertia: 2.0,
        after_s: 1.0,
    };
    let mut world = world(rough(1.0, 3.0), effect);
    world.place(0.0, 1.0);
    let along = Pull(|at: JointState| if at.t < 1.5 { 3.0 } else { 0.0 });
    run(&mut world, &along, 1.4);
    assert_eq!(
        world.state().dq,
        1.0,
        "carried on, and still without a load"
    );
    assert!((world.needed_effort(at(0.0, 1.0), 1.0, 1.0) - 4.0).abs() < 1e-9);
    run(&mut world, &along, 1.0);
    assert!(world.is_stuck());
    run(&mut world, &along, 0.01);
    assert!((world.needed_effort(at(0.0, 1.0), 1.0, 1.0) - 6.0).abs() < 1e-9);
}

#[test]
fn a_seal_sticks_more_the_longer_it_rested() {
    let breakaway_after = |rest: f64| {
        let effect = EffectSpec::HealingSeal {
            bond: 10.0,
            heal_s: 1.0,
            peel: 0.01,
        };
        let mut world = world(rough(1.0, 2.0), effect);
        run(&mut world, &Pull(|_| 15.0), 0.5);
        let brake = Pull(|at: JointState| if at.dq > 0.0 { -30.0 } else { 0.0 });
        while !world.is_stuck() {
            world.step(&brake);
        }
        assert!(world.holding_effort(0.0) < 2.01, "peeled off");
        run(&mut world, &Free, rest);
        let from = world.state().t;
        let ramp = Pull(move |at: JointState| 20.0 * (at.t - from));
        while world.is_stuck() {
            world.step(&ramp);
        }
        20.0 * (world.state().t - from)
    };
    let (short, long) = (breakaway_after(0.1), breakaway_after(6.0));
    // The ramp's own time counts as rest.
    assert!((11.8..12.05).contains(&long), "{long}");
    assert!(short < 0.7 * long && short > 3.0, "{short}");
}

fn second_leaf(coulomb: f64) -> EffectSpec {
    EffectSpec::SecondLeaf {
        from: 0.3,
        inertia: 2.0,
        coulomb,
        stiffness: 4000.0,
    }
}

#[test]
fn a_second_leaf_takes_the_momentum_that_the_first_one_loses() {
    let mut leaf = leaf::Leaf::new(0.3, 2.0, 0.0, 4000.0);
    // The first leaf, 3 kg, coasts into it: explicit steps of our own, leaf asked for its force.
    let (mut q, mut dq, mut t) = (0.29, 0.8, 0.0);
    leaf.restart(at(q, dq));
    let h = 1.0 / f64::from(STEPS_PER_SECOND);
    for _ in 0..4000 {
        let from = JointState { t, q, dq };
        let ddq = leaf.effort(from) / 3.0;
        let middle = JointState {
            t: t + 0.5 * h,
            q: q + 0.5 * h * dq,
            dq: dq + 0.5 * h * ddq,
        };
        let ddq = leaf.effort(middle) / 3.0;
        q += h * (dq + 0.5 * h * ddq);
        dq += h * ddq;
        t += h;
        leaf.advance(from, JointState { t, q, dq });
    }
    // Parted after one bounce: momentum is shared out, and energy is not made.
    let other = (3.0 * 0.8 - 3.0 * dq) / 2.0;
    let [_, rate] = leaf.position_and_rate(t);
    assert!((rate - other).abs() < 2e-3, "{rate} {other}");
    let energy = 1.5 * dq * dq + rate * rate;
    assert!(
        rate > dq && energy < 0.96 && energy > 0.5,
        "{rate} {dq} {energy}"
    );
}

#[test]
fn a_second_leaf_is_picked_up_on_the_way_and_left_behind() {
    let mut world = world(rough(3.0, 1.0), second_leaf(5.0));
    let drag = |to: f64, rate: f64, world: &mut World| {
        let (from, began) = (world.state().q, world.state().t);
        let seconds = (to - from).abs() / rate;
        let hand = Pull(move |at: JointState| {
            let share = ((at.t - began) / seconds).min(1.0);
            2000.0 * (from + share * (to - from) - at.q) - 150.0 * at.dq
        });
        let mut efforts = Vec::new();
        for _ in 0..((seconds + 0.5) * 8000.0) as u32 {
            world.step(&hand);
            let state = world.state();
            if state.dq.abs() > 0.8 * rate {
                efforts.push((state.q, hand.effort(state)));
            }
        }
        let mean = |least: f64, most: f64| {
            let inside: Vec<f64> = efforts
                .iter()
                .filter(|(q, _)| (least..most).contains(q))
                .map(|(_, effort)| *effort)
                .collect();
            inside.iter().sum::<f64>() / inside.len() as f64
        };
        (mean(0.1, 0.25), mean(0.4, 0.55))
    };
    let (alone, dragged) = drag(0.6, 0.1, &mut world);
    assert!(
        (alone - 1.0).abs() < 0.1 && (dragged - 6.0).abs() < 0.2,
        "{alone} {dragged}"
    );
    // Back: it stays at 0.3 until the first leaf is there again.
    let (taken_back, left) = drag(0.0, 0.1, &mut world);
    assert!(
        (left + 1.0).abs() < 0.1 && (taken_back + 6.0).abs() < 0.2,
        "{left} {taken_back}"
    );
}
