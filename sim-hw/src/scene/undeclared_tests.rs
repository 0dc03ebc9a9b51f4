//! Undeclared effects of grasp and measurement, and all of them in a whole run.

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::scenario::{EffectSpec, JointKind};
use crate::world::JointState;

fn scenario(name: &str, undeclared: &[EffectSpec]) -> Scenario {
    let mut scenario = Scenario::builtin(name).unwrap();
    scenario.undeclared = undeclared.to_vec();
    Scenario::from_toml(&scenario.to_toml().unwrap()).unwrap()
}

fn scene(name: &str, undeclared: &[EffectSpec], seconds: f64) -> Scene {
    Scene::new(&scenario(name, undeclared), 5, Some(seconds)).unwrap()
}

/// Visits from grasp to release at 997 Hz.
fn visit(scene: &mut Scene, mut look: impl FnMut(&Scene, f64, &Sight)) {
    let (mut t, release) = (scene.timeline.grasp + 1e-3, scene.timeline.release);
    while t < release {
        scene.advance_to(t);
        look(scene, t, &scene.sight(t));
        t += 1.0 / 997.0;
    }
}

/// The effort on the object that the ideal sensor's reading stands for.
fn effort_of_reading(scene: &Scene, sight: &Sight) -> f64 {
    let mut own = scene
        .tool
        .sensor_wrench(&sight.tcp, &ContactWrench::default());
    if let Some((mass, place)) = scene.measurement.attached {
        let added = scene.tool.wrench_of_mass(&sight.tcp, mass, place);
        own = std::array::from_fn(|axis| own[axis] + added[axis]);
    }
    let rotation = sight.tcp.rotation * scene.tool.tcp_from_ft_sensor.rotation;
    let part = |first: usize| {
        -(rotation * Vector3::from_fn(|row, _| sight.wrench[first + row] - own[first + row]))
    };
    let sensor =
        sight.tcp.position + sight.tcp.rotation * scene.tool.tcp_from_ft_sensor.translation.vector;
    scene
        .setting
        .joint_at(sight.moment.state.q)
        .effort_of(sensor, part(0), part(3))
}

fn every_effect() -> Vec<EffectSpec> {
    let text = include_str!("../../tests/every_effect.toml");
    Scenario::from_toml(text).unwrap().undeclared
}

#[test]
fn with_every_effect_alone_the_wrench_is_the_objects_equation_of_motion() {
    let effects = every_effect();
    assert_eq!(effects.len(), 26);
    for effect in effects {
        let mut scene = scene("wood_door", std::slice::from_ref(&effect), 16.0);
        let (mut slipping, mut worst, mut worst_reading) = (0, 0.0_f64, 0.0_f64);
        visit(&mut scene, |scene, _, sight| {
            let reading = effort_of_reading(scene, sight);
            worst_reading = worst_reading.max((reading - sight.moment.tool_effort).abs());
            let JointState { dq, .. } = sight.moment.state;
            if dq != 0.0 {
                let Moment { state, ddq, .. } = sight.moment;
                let needed = scene.world.needed_effort(state, ddq, dq.signum());
                worst = worst.max((needed - sight.moment.tool_effort).abs());
                slipping += 1;
            }
        });
        assert!(slipping > 2000, "{effect:?}: {slipping}");
        assert!(worst < 1e-8, "{effect:?}: {worst}");
        // Where hand and object part, the force acts at the hand, millimetres beside the handle.
        assert!(worst_reading < 1e-8, "{effect:?}: {worst_reading}");
    }
}

#[test]
fn with_every_effect_alone_the_tools_motion_is_the_derivative_of_itself() {
    for effect in every_effect() {
        let mut scene = scene("wood_door", std::slice::from_ref(&effect), 16.0);
        let mut past: Option<(f64, RigidMotion)> = None;
        let mut worst = [0.0_f64; 2];
        visit(&mut scene, |_, t, sight| {
            if let Some((before, tool)) = past {
                let h = t - before;
                let velocity = (sight.tcp.position - tool.position) / h;
                let mean = 0.5 * (sight.tcp.velocity + tool.velocity);
                worst[0] = worst[0].max((velocity - mean).norm());
                let rate = (sight.tcp.rotation * tool.rotation.inverse()).scaled_axis() / h;
                worst[1] = worst[1].max((rate - 0.5 * (sight.tcp.rate + tool.rate)).norm());
            }
            past = Some((t, sight.tcp));
        });
        assert!(worst[0] < 2e-2 && worst[1] < 2e-2, "{effect:?}: {worst:?}");
    }
}

/// Positions of hand and handle and the effort between them, in a run of `seconds`.
fn parted(name: &str, effect: EffectSpec, seconds: f64) -> Vec<(f64, f64, f64)> {
    let mut scene = scene(name, &[effect], seconds);
    let mut seen = Vec::new();
    visit(&mut scene, |_, _, sight| {
        let state = sight.moment.state;
        seen.push((sight.hand.value, state.q, sight.moment.tool_effort));
    });
    seen
}

#[test]
fn in_play_nothing_is_felt_and_the_hand_goes_as_far_as_the_gap() {
    let (gap, stiffness) = (0.002, 1e5);
    let effect = EffectSpec::Backlash {
        gap_m: gap,
        stiffness_n_per_m: stiffness,
    };
    let seen = parted("drawer_loaded", effect, 30.0);
    let (mut crossings, mut side) = (0, 0.0);
    for (hand, handle, effort) in &seen {
        let apart = hand - handle;
        if apart.abs() <= 0.5 * gap {
            assert_eq!(*effort, 0.0, "in play");
        } else {
            assert!(effort * apart >= 0.0, "a pad pushes only: {apart} {effort}");
            crossings += u32::from(apart * side < 0.0);
            side = apart.signum();
        }
        assert!(apart.abs() < 0.5 * gap + 200.0 / stiffness, "{apart}");
    }
    let pressed = seen.iter().filter(|(_, _, effort)| *effort != 0.0).count();
    assert!(
        crossings > 20 && pressed > seen.len() / 3,
        "{crossings} {pressed}"
    );
}

#[test]
fn pads_part_hand_and_handle_by_force_over_stiffness() {
    let effect = EffectSpec::GraspCompliance {
        stiffness_n_per_m: 2e4,
        damping_ratio: 0.3,
    };
    let seen = parted("drawer_loaded", effect, 30.0);
    // By least squares over the whole run; the damping averages out.
    let (product, square) = seen.iter().fold((0.0, 0.0), |(product, square), seen| {
        let apart = seen.0 - seen.1;
        (product + apart * seen.2, square + apart * apart)
    });
    assert!(
        (product / square - 2e4).abs() < 200.0,
        "{}",
        product / square
    );
    let widest = seen
        .iter()
        .map(|seen| (seen.0 - seen.1).abs())
        .fold(0.0, f64::max);
    assert!((1e-3..6e-3).contains(&widest), "{widest}");
}

#[test]
fn hand_and_object_on_yielding_pads_share_the_hands_momentum() {
    // No friction, no stops near: what the hand puts in is what both have.
    for effect in [
        EffectSpec::GraspCompliance {
            stiffness_n_per_m: 1e4,
            damping_ratio: 0.2,
        },
        EffectSpec::Backlash {
            gap_m: 0.004,
            stiffness_n_per_m: 1e5,
        },
    ] {
        let mut scenario = scenario("drawer_loaded", &[effect]);
        scenario.mechanisms.clear();
        scenario.object.viscous = 0.0;
        let mut scene = Scene::new(&scenario, 5, Some(20.0)).unwrap();
        scene.advance_to(scene.timeline.grasp + 2.0);
        let (mut impulse, mut friction) = (0.0, 0.0);
        let mut momenta = Vec::new();
        for _ in 0..12_000 {
            scene.advance_to(scene.world.state().t + 1e-9);
            let Phase::Held(hold) = &scene.phase else {
                unreachable!("held")
            };
            let t = scene.world.state().t;
            let sight = scene.sight(t);
            let (hand, inertia) = (sight.hand, hold.hand_inertia());
            momenta.push(scenario.object.inertia * sight.moment.state.dq + inertia * hand.rate);
            let hands = hold.hands_effort(JointState {
                t,
                q: hand.value,
                dq: hand.rate,
            });
            impulse += hands / 8000.0;
            let net = scenario.object.inertia * sight.moment.ddq - sight.moment.tool_effort;
            friction += net / 8000.0;
        }
        let gained = momenta[momenta.len() - 1] - momenta[0];
        assert!(impulse.abs() > 1.0, "{impulse}");
        assert!(
            (gained - impulse - friction).abs() < 0.02,
            "{gained} {impulse} {friction}"
        );
    }
}

#[test]
fn a_lagging_sensor_feels_what_was_so_and_the_tracker_sees_what_is() {
    let lag = 0.0073;
    let mut late = scene("wood_door", &[EffectSpec::TimeLag { lag_s: lag }], 16.0);
    let mut right = scene("wood_door", &[], 16.0);
    let mut compared = 0;
    visit(&mut late, |late, t, sight| {
        right.advance_to(t - lag);
        let then = right.sight(t - lag);
        assert_eq!(late.seen(t).tcp.position, sight.tcp.position);
        if then.moment.state.dq != 0.0 {
            // 1/8000 s of a stick's end is what interpolation may smear.
            let off = (late.felt(t)[0] - then.wrench[0]).abs();
            compared += u32::from(off < 0.02);
        } else {
            compared += 1;
        }
    });
    let all = (late.timeline.release - late.timeline.grasp) * 997.0;
    assert!(
        f64::from(compared) > 0.995 * all - 3.0,
        "{compared} of {all}"
    );
}

#[test]
fn a_negative_lag_makes_the_pose_old_instead() {
    let effect = EffectSpec::TimeLag { lag_s: -0.012 };
    let mut late = scene("wood_door", &[effect], 16.0);
    let mut right = scene("wood_door", &[], 16.0);
    visit(&mut late, |late, t, sight| {
        right.advance_to(t - 0.012);
        let then = right.sight(t - 0.012).tcp;
        let seen = late.seen(t).tcp;
        assert!((seen.position - then.position).norm() < 1e-7, "at {t}");
        assert!(seen.rotation.angle_to(&then.rotation) < 1e-6, "at {t}");
        assert_eq!(late.felt(t), sight.wrench);
    });
}

#[test]
fn a_mass_put_on_at_the_grasp_is_felt_from_then_on() {
    let effect = EffectSpec::ToolMass {
        mass_kg: 0.2,
        at_m: [0.03, 0.0, 0.1],
    };
    let mut heavy = scene("wood_door", &[effect], 16.0);
    let mut right = scene("wood_door", &[], 16.0);
    for t in [0.5, 1.7, heavy.timeline.grasp - 0.01] {
        heavy.advance_to(t);
        right.advance_to(t);
        assert_eq!(heavy.felt(t), right.felt(t), "free air knows nothing of it");
    }
    let mut weighed = (Vector3::zeros(), 0.0);
    visit(&mut heavy, |heavy, t, sight| {
        right.advance_to(t);
        let (with, without) = (heavy.felt(t), right.felt(t));
        let added = Vector3::from_fn(|axis, _| with[axis] - without[axis]);
        let rotation = sight.tcp.rotation * heavy.tool.tcp_from_ft_sensor.rotation;
        weighed = (weighed.0 + rotation * added, weighed.1 + 1.0);
    });
    let mean: Vector3<f64> = weighed.0 / weighed.1;
    assert!((mean.z + 0.2 * 9.80665).abs() < 0.02, "{mean}");
}

#[test]
fn a_drifting_sensor_drifts_by_its_slope_and_levels_off() {
    let drifting = |warm_up_s: Option<f64>, t: f64| {
        let effect = EffectSpec::SensorDrift {
            force_n_per_min: [3.0, 0.0, -6.0],
            torque_nm_per_min: [0.0, 0.6, 0.0],
            warm_up_s,
        };
        let mut scene = scene("wood_door", &[effect], 40.0);
        scene.advance_to(t);
        let (felt, so) = (scene.felt(t), scene.sight(t).wrench);
        std::array::from_fn::<f64, 6, _>(|axis| felt[axis] - so[axis])
    };
    let steady = drifting(None, 30.0);
    assert!((steady[0] - 1.5).abs() < 1e-9 && (steady[2] + 3.0).abs() < 1e-9);
    assert!((steady[4] - 0.3).abs() < 1e-9 && steady[1] == 0.0);
    let warmed = drifting(Some(5.0), 39.0);
    assert!(
        (warmed[0] - 0.25).abs() < 1e-3,
        "3 N/min for 5 s: {}",
        warmed[0]
    );
}

#[test]
fn a_sagging_axis_takes_the_handle_off_its_circle_and_no_work_is_lost() {
    let shift = [0.03, -0.02, 0.0];
    let effect = EffectSpec::AxisOffset { shift_m: shift };
    let mut scene = scene("wood_door", &[effect], 30.0);
    let (mut least, mut most) = (f64::MAX, 0.0_f64);
    visit(&mut scene, |scene, _, sight| {
        let joint = &scene.setting.joint;
        let from_axis = joint.axis.cross(&(sight.tcp.position - joint.point)).norm();
        (least, most) = (least.min(from_axis), most.max(from_axis));
        // Power at the handle is power at the joint.
        let joint = scene.setting.joint_at(sight.moment.state.q);
        let wrench = scene
            .grip
            .wrench(&joint, sight.tcp.position, sight.moment.tool_effort, 0.0);
        let power = wrench.force.dot(&sight.tcp.velocity) + wrench.moment.dot(&sight.tcp.rate);
        let expected = sight.moment.tool_effort * sight.moment.state.dq;
        assert!((power - expected).abs() < 1e-9, "{power} {expected}");
    });
    assert!((0.01..0.08).contains(&(most - least)), "{least} {most}");
}

#[test]
fn a_slip_moves_the_hand_on_the_handle_by_its_step() {
    let step = [0.004, 0.003, 0.006];
    let effect = EffectSpec::Slip {
        step_m: step,
        after_s: vec![3.0, 6.0],
        lasts_s: 0.05,
    };
    let mut scene = scene("drawer_light", &[effect], 20.0);
    let grasp = scene.timeline.grasp;
    visit(&mut scene, |scene, t, sight| {
        let firm = scene.setting.carry(Jet::constant(sight.moment.state.q));
        let beside = scene.setting.turn.inverse() * (sight.tcp.position - firm.position);
        let slips = if t < grasp + 3.0 {
            0.0
        } else if t > grasp + 6.05 {
            2.0
        } else if (grasp + 3.05..grasp + 6.0).contains(&t) {
            1.0
        } else {
            return;
        };
        assert!(
            (beside - slips * Vector3::from(step)).norm() < 1e-9,
            "at {t}: {beside}"
        );
    });
}

#[test]
fn a_door_out_of_plumb_feels_its_weight_about_a_leaning_axis() {
    let effect = EffectSpec::Gravity {
        tilt_deg: 2.0,
        azimuth_deg: 30.0,
    };
    let leaning = scene("wood_door", &[effect], 16.0);
    let upright = scene("wood_door", &[], 16.0);
    let setting = leaning.setting();
    let angle = setting
        .joint
        .axis
        .angle(&setting.declared_axis)
        .to_degrees();
    assert!((angle - 2.0).abs() < 1e-9, "{angle}");
    assert_eq!(upright.setting().joint.axis, setting.declared_axis);
    // Height gained is work done, with the panel's centre as the scenario has it.
    let com = setting.turn * Vector3::new(0.0, 0.42, 1.0);
    let height =
        |q: f64| (UnitQuaternion::from_axis_angle(&setting.joint.axis, q) * com).z * 25.0 * 9.80665;
    for q in [0.2, 0.9, 1.5] {
        let added = leaning.world.standing_effort(q) - upright.world.standing_effort(q);
        let slope = -(height(q + 1e-5) - height(q - 1e-5)) / 2e-5;
        assert!(
            (added - slope).abs() < 1e-5 && slope.abs() < 3.7,
            "{added} {slope}"
        );
    }
}

#[test]
fn all_effects_at_once_stay_finite_and_repeat_themselves() {
    let run = |seed: u64| {
        let text = include_str!("../../tests/every_effect.toml");
        let scenario = Scenario::from_toml(text).unwrap();
        let mut scene = Scene::new(&scenario, seed, Some(20.0)).unwrap();
        assert_eq!(scene.setting().joint.kind, JointKind::Revolute);
        let mut seen = Vec::new();
        visit(&mut scene, |scene, t, _| {
            let (felt, sight) = (scene.felt(t), scene.seen(t));
            assert!(
                felt.iter().all(|value| value.abs() < 500.0),
                "{felt:?} at {t}"
            );
            seen.push((felt, sight.tcp.position));
        });
        seen
    };
    assert!(run(3) == run(3));
    assert!(run(3) != run(4));
}
