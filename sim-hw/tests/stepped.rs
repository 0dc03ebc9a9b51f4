//! The whole simulation, stepped: what a host sees on the links.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use ft_drivers::Link;
use ft_sim_hw::{Bus, Scenario, ScenarioError, SimSerialLink, Simulation};
use ft_wire::{CanFrame, Chunk, HostTime};

const START: HostTime = HostTime::from_nanos(1_750_000_000_000_000_000);

fn simulation(name: &str, seed: u64, seconds: Option<f64>) -> Simulation {
    let scenario = Scenario::builtin(name).unwrap();
    Simulation::new(&scenario, seed, START, seconds.map(Duration::from_secs_f64)).unwrap()
}

/// All that arrives on a link by `until`.
fn drained<L: Link>(link: &mut L, until: HostTime) -> Vec<(L::Frame, HostTime)> {
    let mut frames = Vec::new();
    while let Some((frame, stamps)) = link.recv(until).unwrap() {
        frames.push((frame, stamps.arrival));
    }
    frames
}

fn bytes(chunks: &[(Chunk, HostTime)]) -> Vec<u8> {
    chunks
        .iter()
        .flat_map(|(chunk, _)| chunk.as_slice().to_vec())
        .collect()
}

/// Runs to the end in steps of `step` and gives all frames of one serial device.
fn recorded(
    simulation: &mut Simulation,
    link: &mut SimSerialLink,
    step: Duration,
) -> Vec<(Chunk, HostTime)> {
    let (mut now, mut frames) = (START, Vec::new());
    while !simulation.is_over() {
        now = now + step;
        simulation.advance_to(now);
        frames.extend(drained(link, now));
    }
    frames
}

#[test]
fn two_runs_of_one_seed_give_the_same_bytes_at_the_same_instants() {
    let run = |seed: u64, step: u64| {
        let mut simulation = simulation("wood_door", seed, Some(8.0));
        let mut sensor = simulation.serial_link("ft_sensor").unwrap();
        recorded(&mut simulation, &mut sensor, Duration::from_micros(step))
    };
    let first = run(3, 10_000);
    assert!(first == run(3, 10_000));
    assert!(bytes(&first) != bytes(&run(4, 10_000)));
    // Without commands the step does not matter either, but for what is on its way at the end.
    let other = run(3, 7_300);
    let both = first.len().min(other.len()) - 5;
    assert!(first[..both] == other[..both]);
}

#[test]
fn every_stream_comes_at_its_rate_and_in_order() {
    let mut simulation = simulation("wood_door", 1, Some(10.0));
    let mut sensor = simulation.serial_link("ft_sensor").unwrap();
    let mut tracker = simulation.serial_link("aria").unwrap();
    simulation.advance_to(simulation.end());
    let end = simulation.end();
    for (link, length, rate) in [(&mut sensor, 37, 800.0), (&mut tracker, 74, 1000.0)] {
        let frames = drained(link, end);
        assert!(
            frames.windows(2).all(|pair| pair[0].1 <= pair[1].1),
            "no frame overtakes another"
        );
        let count = bytes(&frames).len() as f64 / f64::from(length);
        assert!(
            (count - 10.0 * rate).abs() < 0.001 * 10.0 * rate + 2.0,
            "{count}"
        );
        assert!(
            frames.len() as f64 > 1.02 * count,
            "some frames come in two pieces"
        );
    }
}

#[test]
fn arrivals_are_never_before_the_line_has_carried_the_bytes() {
    let mut simulation = simulation("wood_door", 2, Some(6.0));
    let mut tracker = simulation.serial_link("aria").unwrap();
    simulation.advance_to(simulation.end());
    let clock = simulation
        .truth()
        .clocks
        .into_iter()
        .find(|clock| clock.device == "aria")
        .unwrap();
    let mut least = f64::MAX;
    let mut stream = Vec::new();
    for (chunk, arrival) in drained(&mut tracker, simulation.end()) {
        stream.extend_from_slice(chunk.as_slice());
        while stream.len() >= 74 {
            let frame: Vec<u8> = stream.drain(..74).collect();
            let stamp = u64::from_le_bytes(frame[4..12].try_into().unwrap()) as f64 * 1e-9;
            let sampled = (stamp - clock.reads_s) / (1.0 + clock.skew_ppm * 1e-6);
            least = least.min(arrival.seconds_since(START) - sampled);
        }
    }
    assert!(
        (370e-6..400e-6).contains(&least),
        "74 bytes at 2 Mbit/s: {least}"
    );
}

#[test]
fn the_gripper_reads_its_weight_in_free_air() {
    let mut simulation = simulation("wood_door", 1, None);
    let mut sensor = simulation.serial_link("ft_sensor").unwrap();
    simulation.advance_to(START + Duration::from_millis(1900));
    let truth = simulation.truth();
    let stream = bytes(&drained(&mut sensor, START + Duration::from_millis(1900)));
    let mut sum = [0.0; 3];
    let frames = stream.chunks_exact(37).count() as f64;
    for frame in stream.chunks_exact(37) {
        for (axis, total) in sum.iter_mut().enumerate() {
            let value = f32::from_le_bytes(frame[3 + 4 * axis..7 + 4 * axis].try_into().unwrap());
            *total += f64::from(value) / frames - truth.sensor_errors.bias[axis] / frames;
        }
    }
    let weight = sum.iter().map(|force| force * force).sum::<f64>().sqrt();
    assert!((weight - 0.49 * 9.80665).abs() < 0.03, "{weight}");
}

#[test]
fn marks_come_in_order_at_their_times_and_once() {
    let mut simulation = simulation("drawer_light", 1, None);
    let mut marks = Vec::new();
    for second in 0..80 {
        simulation.advance_to(START + Duration::from_secs(second));
        marks.extend(simulation.drain_marks());
    }
    let seconds: Vec<(f64, &str)> = marks
        .iter()
        .map(|(at, text)| (at.seconds_since(START), text.as_str()))
        .collect();
    assert_eq!(
        seconds,
        [(2.0, "free_air_begin"), (10.0, "grasp"), (70.0, "release")]
    );
    assert!(simulation.is_over() && simulation.end() == START + Duration::from_secs(71));
}

#[test]
fn a_command_of_the_host_is_heard_and_answered() {
    let mut simulation = simulation("metal_door", 1, Some(10.0));
    let mut sensor = simulation.can_link("ft_sensor").unwrap();
    simulation.advance_to(START + Duration::from_millis(100));
    assert!(
        drained(&mut sensor, simulation.end()).is_empty(),
        "idle after power-up"
    );
    let command = |data: [u8; 8]| CanFrame::standard(0x64, &data).unwrap();
    sensor.send(&command([0x0F, 8, 0, 0, 0, 0, 0, 0])).unwrap();
    simulation.advance_to(START + Duration::from_millis(110));
    let answer = drained(&mut sensor, simulation.end());
    assert_eq!(answer[0].0.payload()[..2], [0x0F, 1]);
    assert!(answer[0].1 > START + Duration::from_millis(100));
    sensor.send(&command([0x0B, 0, 0, 0, 0, 0, 0, 0])).unwrap();
    simulation.advance_to(START + Duration::from_millis(1110));
    let frames = drained(&mut sensor, START + Duration::from_millis(1110));
    assert!(
        (1990..=2002).contains(&frames.len()),
        "1 kHz in pairs: {}",
        frames.len()
    );
}

#[test]
fn a_sensor_that_was_left_streaming_streams() {
    let mut scenario = Scenario::builtin("metal_door").unwrap();
    scenario.sensor.already_streaming = true;
    let mut simulation =
        Simulation::new(&scenario, 1, START, Some(Duration::from_secs(5))).unwrap();
    let mut sensor = simulation.can_link("ft_sensor").unwrap();
    simulation.advance_to(START + Duration::from_secs(1));
    assert!(drained(&mut sensor, START + Duration::from_secs(1)).len() > 1900);
}

#[test]
fn every_builtin_scenario_is_fitted_and_differs_by_seed() {
    for name in Scenario::builtin_names() {
        let simulation = simulation(name, 1, None);
        let names: Vec<&str> = simulation
            .fitted()
            .iter()
            .map(|fitted| fitted.name.as_str())
            .collect();
        assert_eq!(names, ["ft_sensor", "gripper", "aria"]);
        for fitted in simulation.fitted() {
            let linked = match fitted.bus {
                Bus::Serial { .. } => simulation.serial_link(&fitted.name).is_some(),
                Bus::Can { .. } => simulation.can_link(&fitted.name).is_some(),
            };
            assert!(linked, "{name} {}", fitted.name);
        }
        let (truth, other) = (simulation.truth(), self::simulation(name, 2, None).truth());
        assert_ne!(truth.grasp_position, other.grasp_position, "{name}");
        assert_ne!(truth.sensor_errors, other.sensor_errors, "{name}");
        let known = simulation.known_setup();
        assert_ne!(
            known.payload.mass_kg, truth.tool.mass_kg,
            "nobody knows the truth"
        );
        assert!(
            (known.payload.mass_kg - truth.tool.mass_kg).abs() < 2.0 * known.payload.mass_std_kg
        );
        serde_json::to_string(&truth).unwrap();
    }
}

#[test]
fn the_axis_does_not_pass_through_the_worlds_origin() {
    let truth = simulation("oven_door", 1, None).truth();
    let [x, y, z] = truth.axis_direction;
    assert!(
        z.abs() < 1e-12 && x.abs() > 0.01 && y.abs() > 0.01,
        "level, and turned by the world's yaw"
    );
    assert!(
        truth
            .axis_point
            .iter()
            .map(|component| component * component)
            .sum::<f64>()
            > 0.04
    );
}

#[test]
fn the_truths_effort_is_what_a_slow_hand_needs() {
    let truth = simulation("wood_door", 1, None).truth();
    // Preload and rate of the closer plus friction; the panel hangs on a vertical axis.
    assert!((truth.effort(0.5, 0.01, 0.0) - (11.0 + 2.25 + 1.4 + 0.008)).abs() < 1e-9);
    assert!((truth.effort(0.5, 0.01, 2.0) - truth.effort(0.5, 0.01, 0.0) - 12.0).abs() < 1e-9);
    let closing = truth.effort(0.8, -0.1, 0.0);
    assert!(
        (closing - (11.0 + 3.6 - 1.4 - 0.08 - 4.2)).abs() < 1e-9,
        "the sweep zone damps closing: {closing}"
    );
}

#[test]
fn the_truths_effort_is_the_tools_effort_all_along() {
    for name in Scenario::builtin_names() {
        let mut simulation = simulation(name, 1, Some(30.0));
        let truth = simulation.truth();
        let (mut now, mut compared) = (START, 0);
        while now < simulation.end() {
            now = now + Duration::from_micros(7300);
            simulation.advance_to(now);
            let held = (truth.grasp_ns..truth.release_ns).contains(&now.as_nanos());
            let moment = simulation.moment();
            if held && moment.state.dq != 0.0 {
                let needed = truth.effort(moment.state.q, moment.state.dq, moment.ddq);
                assert!(
                    (needed - moment.tool_effort).abs() < 1e-9,
                    "{name}: {moment:?} {needed}"
                );
                compared += 1;
            }
        }
        assert!(compared > 1000, "{name}: {compared}");
    }
}

#[test]
fn a_bad_scenario_says_what_is_wrong_and_what_is_allowed() {
    let good = include_str!("../scenarios/wood_door.toml");
    let says = |text: String| Scenario::from_toml(&text).unwrap_err().to_string();
    let unknown = says(good.replace("coulomb = 1.4", "coulom = 1.4"));
    assert!(
        unknown.contains("coulom") && unknown.contains("expected") && unknown.contains("coulomb"),
        "{unknown}"
    );
    let missing = says(good.replace("inertia = 6.0", ""));
    assert!(missing.contains("inertia"), "{missing}");
    let negative = says(good.replace("inertia = 6.0", "inertia = -6.0"));
    assert!(
        negative.contains("object.inertia is -6.0") && negative.contains("0.01"),
        "{negative}"
    );
    let kind = says(good.replace("kind = \"revolute\"", "kind = \"helical\""));
    assert!(
        kind.contains("helical") && kind.contains("revolute") && kind.contains("prismatic"),
        "{kind}"
    );
    let mechanism = says(good.replace("kind = \"closer\"", "kind = \"toggle\""));
    assert!(
        mechanism.contains("toggle") && mechanism.contains("gas_spring"),
        "{mechanism}"
    );
    let not_finite = says(good.replace("coulomb = 1.4", "coulomb = nan"));
    assert!(not_finite.contains("object.coulomb"), "{not_finite}");
    let metal = include_str!("../scenarios/metal_door.toml");
    let model = says(metal.replace("RFT80-6A01", "RFT99"));
    assert!(
        model.contains("RFT99") && model.contains("RFT80-6A01"),
        "{model}"
    );
    let rate = says(metal.replace("rate_hz = 1000.0", "rate_hz = 800.0"));
    assert!(
        rate.contains("sensor.rate_hz is 800") && rate.contains("500, 1000"),
        "{rate}"
    );
    assert!(says("this is no toml".to_owned()).contains("expected"));
}

#[test]
fn a_scenario_that_does_not_exist_is_named_with_those_that_do() {
    let error = Scenario::load("wooden_door").unwrap_err();
    assert!(matches!(error, ScenarioError::UnknownName { .. }));
    assert!(
        error.to_string().contains("wooden_door")
            && error.to_string().contains("wood_door, metal_door")
    );
    assert!(matches!(
        Scenario::load("no/such.toml"),
        Err(ScenarioError::Read { .. })
    ));
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("mine.toml");
    std::fs::write(
        &path,
        include_str!("../scenarios/oven_door.toml").replace("coulomb = 1.1", "coulomb = -1"),
    )
    .unwrap();
    let error = Scenario::load(path.to_str().unwrap())
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("mine.toml") && error.contains("object.coulomb"),
        "{error}"
    );
}
