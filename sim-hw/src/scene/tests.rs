use nalgebra::Vector3;

use super::*;

/// Visits `scenario` at 997 Hz (never on the steps' grid) from grasp to release.
fn visit(name: &str, seconds: Option<f64>, mut look: impl FnMut(&Scene, f64, &Sight)) {
    let scenario = Scenario::builtin(name).unwrap();
    let mut scene = Scene::new(&scenario, 5, seconds).unwrap();
    let timeline = scene.timeline;
    let mut t = 0.0;
    while t < timeline.end {
        scene.advance_to(t);
        look(&scene, t, &scene.sight(t));
        t += 1.0 / 997.0;
    }
}

#[test]
fn the_recorded_wrench_is_the_objects_equation_of_motion() {
    for name in Scenario::builtin_names() {
        let (mut slipping, mut worst) = (0, 0.0_f64);
        visit(name, Some(30.0), |scene, t, sight| {
            if !scene.holds(t) {
                return;
            }
            let (joint, tcp) = (&scene.setting().joint, sight.tcp);
            // From the sensor's reading back to the object, with the tool's own share taken off.
            let [fx, fy, fz, tx, ty, tz] = sight.wrench;
            let own = scene.tool.sensor_wrench(&tcp, &ContactWrench::default());
            let world_from_sensor = tcp.rotation * scene.tool.tcp_from_ft_sensor.rotation;
            let force = -(world_from_sensor * Vector3::new(fx - own[0], fy - own[1], fz - own[2]));
            let moment = -(world_from_sensor * Vector3::new(tx - own[3], ty - own[4], tz - own[5]));
            let sensor =
                tcp.position + tcp.rotation * scene.tool.tcp_from_ft_sensor.translation.vector;
            let effort = joint.effort_of(sensor, force, moment);
            let crate::world::JointState { dq, .. } = sight.moment.state;
            if dq != 0.0 {
                let needed =
                    scene
                        .world
                        .needed_effort(sight.moment.state, sight.moment.ddq, dq.signum());
                worst = worst.max((effort - needed).abs());
                slipping += 1;
            }
            assert!((effort - sight.moment.tool_effort).abs() < 1e-9);
        });
        assert!(slipping > 5000, "{name}: {slipping}");
        assert!(worst < 1e-9, "{name}: {worst}");
    }
}

#[test]
fn the_tools_motion_is_the_derivative_of_itself_all_along() {
    let mut past: Option<(f64, RigidMotion)> = None;
    let mut worst = [0.0_f64; 2];
    visit("wood_door", Some(40.0), |_, t, sight| {
        if let Some((before, tool)) = past {
            let h = t - before;
            let velocity = (sight.tcp.position - tool.position) / h;
            worst[0] = worst[0].max((velocity - 0.5 * (sight.tcp.velocity + tool.velocity)).norm());
            let rate = (sight.tcp.rotation * tool.rotation.inverse()).scaled_axis() / h;
            worst[1] = worst[1].max((rate - 0.5 * (sight.tcp.rate + tool.rate)).norm());
        }
        past = Some((t, sight.tcp));
    });
    assert!(worst[0] < 2e-3 && worst[1] < 1e-2, "{worst:?}");
}

#[test]
fn every_object_is_probed_over_its_range_and_speeds_and_is_at_rest_in_the_end() {
    for name in Scenario::builtin_names() {
        let (mut least, mut most, mut fastest, mut hardest, mut strongest) =
            (9.0_f64, -9.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        let mut slow = 0;
        let mut last = None;
        let mut lever = 1.0;
        visit(name, None, |scene, t, sight| {
            if !scene.holds(t) {
                return;
            }
            lever = scene.setting().lever();
            let state = sight.moment.state;
            (least, most) = (least.min(state.q), most.max(state.q));
            fastest = fastest.max(state.dq.abs() * lever);
            hardest = hardest.max(sight.moment.ddq.abs() * lever);
            strongest = strongest.max(sight.moment.tool_effort.abs() / lever);
            slow += u32::from((0.02..0.2).contains(&(state.dq.abs() * lever)));
            last = Some(state);
        });
        let [closed, open] = Scenario::builtin(name).unwrap().joint.range;
        println!(
            "{name:14} q {least:.3}..{most:.3} of {closed}..{open}, {fastest:.2} m/s, {hardest:.1} m/s2, {strongest:.0} N, slow {slow}"
        );
        assert!(
            least < closed + 0.05 * (open - closed) && most > 0.85 * open,
            "{name}"
        );
        assert!((0.5..2.2).contains(&fastest), "{name}: {fastest} m/s");
        assert!(hardest > 2.5, "{name}: {hardest} m/s^2");
        assert!(strongest < 140.0, "{name}: {strongest} N");
        assert!(slow > 5000, "{name}: {slow}");
        let last = last.unwrap();
        assert!(
            last.dq == 0.0 && last.q < closed + 0.05 * (open - closed),
            "{name}: {last:?}"
        );
    }
}

#[test]
fn a_closer_pulls_the_door_shut_while_the_hand_yields() {
    let scenario = Scenario::builtin("wood_door").unwrap();
    let mut scene = Scene::new(&scenario, 5, None).unwrap();
    let mut following = Vec::new();
    let timeline = scene.timeline;
    let mut t = timeline.grasp;
    while t < timeline.release {
        scene.advance_to(t);
        let sight = scene.sight(t);
        if matches!(&scene.phase, Phase::Held(person) if person.yields()) {
            following.push((sight.moment.state.q, sight.moment.tool_effort));
        }
        t += 0.01;
    }
    assert!(following.len() > 500, "{}", following.len());
    let (least, most) = following
        .iter()
        .fold((9.0_f64, -9.0_f64), |(least, most), (q, _)| {
            (least.min(*q), most.max(*q))
        });
    assert!(
        most > 1.0 && least < 0.05,
        "it closes by itself: {least} to {most}"
    );
    let soft = following
        .iter()
        .filter(|(_, effort)| effort.abs() < 4.0)
        .count();
    assert!(
        soft * 2 > following.len(),
        "the hand hardly pushes: {soft} of {}",
        following.len()
    );
}

#[test]
fn a_run_too_short_to_grasp_is_refused() {
    let scenario = Scenario::builtin("wood_door").unwrap();
    for seconds in [0.0, 3.9, f64::NAN] {
        assert!(matches!(
            Scene::new(&scenario, 1, Some(seconds)),
            Err(ScenarioError::TooShort { .. })
        ));
    }
    for seconds in [4.0, 8.0, 20.0, 71.0, 200.0] {
        let timeline = Timeline::lasting(Some(seconds), 8.0).unwrap();
        assert!(
            timeline.release - timeline.grasp >= 0.49 * seconds,
            "{timeline:?}"
        );
        assert_eq!(timeline.end, seconds);
    }
    let whole = Timeline::lasting(None, 8.0).unwrap();
    assert!(
        (whole.release - whole.grasp - 60.0).abs() < 1e-9
            && (whole.grasp - whole.free_air_begin - 8.0).abs() < 1e-9
    );
    let calm = Timeline::lasting(None, 100.0).unwrap();
    assert!(
        (calm.release - calm.grasp - 60.0).abs() < 1e-9
            && (calm.grasp - calm.free_air_begin - 100.0).abs() < 1e-9
    );
}

#[test]
fn an_object_that_never_rests_is_refused() {
    let mut scenario = Scenario::builtin("oven_door").unwrap();
    scenario.object.coulomb = 0.0;
    scenario.object.breakaway = None;
    scenario.object.viscous = 0.0;
    scenario.object.stop_damping = 0.0;
    scenario.object.stop_stiffness = 50.0;
    scenario.mechanisms.clear();
    assert!(matches!(
        Scene::new(&scenario, 1, None),
        Err(ScenarioError::NeverRests { .. })
    ));
}
