//! `[[undeclared]]` as a user meets it: files, truth, bytes.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use ft_drivers::Link;
use ft_sim_hw::scenario::EffectSpec;
use ft_sim_hw::{Scenario, Simulation};
use ft_wire::HostTime;

const START: HostTime = HostTime::from_nanos(1_750_000_000_000_000_000);
const EVERY: &str = include_str!("every_effect.toml");

fn wood_door(undeclared: &str) -> Result<Scenario, String> {
    let text = include_str!("../scenarios/wood_door.toml");
    Scenario::from_toml(&format!("{text}\n{undeclared}")).map_err(|error| error.to_string())
}

fn simulation(scenario: &Scenario, seed: u64) -> Simulation {
    Simulation::new(scenario, seed, START, Some(Duration::from_secs(12))).unwrap()
}

/// All frames of a Bota sensor that streams from power-up: wrench and stamp, us.
fn sensor_frames(scenario: &Scenario) -> Vec<([f32; 6], u32)> {
    let mut simulation = simulation(scenario, 1);
    let mut link = simulation.serial_link("ft_sensor").unwrap();
    let mut bytes = Vec::new();
    let mut now = START;
    while !simulation.is_over() {
        now = now + Duration::from_millis(20);
        simulation.advance_to(now);
        while let Some((chunk, _)) = link.recv(now).unwrap() {
            bytes.extend_from_slice(chunk.as_slice());
        }
    }
    bytes
        .chunks_exact(37)
        .map(|frame| {
            let word = |at: usize| <[u8; 4]>::try_from(&frame[at..at + 4]).unwrap();
            let wrench = std::array::from_fn(|axis| f32::from_le_bytes(word(3 + 4 * axis)));
            (wrench, u32::from_le_bytes(word(27)))
        })
        .collect()
}

#[test]
fn a_lag_of_eight_samples_shifts_the_bytes_by_eight_samples_under_the_same_stamps() {
    let silent = |undeclared: &str| {
        let mut scenario = wood_door(undeclared).unwrap();
        scenario.sensor.force_noise_n = 0.0;
        scenario.sensor.torque_noise_nm = 0.0;
        scenario.sensor.force_drift_n_per_min = 0.0;
        scenario
    };
    let right = sensor_frames(&silent(""));
    let late = sensor_frames(&silent(
        "[[undeclared]]\neffect = \"time_lag\"\nlag_s = 0.010",
    ));
    assert_eq!(right.len(), late.len());
    let (mut shifted, mut unshifted, mut compared) = (0.0, 0.0, 0);
    for index in 3000..right.len() - 8 {
        assert_eq!(right[index].1, late[index].1, "stamps are as they were");
        for axis in 0..3 {
            shifted += f64::from(late[index + 8].0[axis] - right[index].0[axis]).powi(2);
            unshifted += f64::from(late[index].0[axis] - right[index].0[axis]).powi(2);
            compared += 1;
        }
    }
    let rms = |sum: f64| (sum / f64::from(compared)).sqrt();
    assert!(
        rms(shifted) < 0.02 && rms(unshifted) > 0.3,
        "{} {}",
        rms(shifted),
        rms(unshifted)
    );
}

#[test]
fn every_effect_survives_being_written_and_read() {
    let scenario = Scenario::from_toml(EVERY).unwrap();
    let again = Scenario::from_toml(&scenario.to_toml().unwrap()).unwrap();
    assert_eq!(scenario, again);
    let mut names: Vec<&str> = again.undeclared.iter().map(EffectSpec::name).collect();
    for (effect, name) in again.undeclared.iter().zip(&names) {
        let json = serde_json::to_value(effect).unwrap();
        assert_eq!(json["effect"], *name, "the name is the tag");
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 26);
    let outside = again
        .undeclared
        .iter()
        .filter(|effect| !effect.is_in_vocabulary());
    assert_eq!(outside.count(), 3);
    for name in Scenario::builtin_names() {
        let builtin = Scenario::builtin(name).unwrap();
        let text = builtin.to_toml().unwrap();
        assert!(
            !text.contains("undeclared") && !text.contains("salt"),
            "{text}"
        );
        assert_eq!(Scenario::from_toml(&text).unwrap(), builtin);
    }
}

#[test]
fn the_truth_lists_the_effects_and_its_effort_leaves_them_out() {
    let spring = "[[undeclared]]\neffect = \"spring\"\nrate = 8.0\nrest = 0.2";
    let truth = simulation(&wood_door(spring).unwrap(), 1).truth();
    let json = serde_json::to_value(&truth).unwrap();
    assert_eq!(json["undeclared"][0]["effect"], "spring");
    assert_eq!(json["undeclared"][0]["rate"], 8.0);
    let plain = simulation(&wood_door("").unwrap(), 1).truth();
    assert_eq!(truth.effort(0.7, 0.3, 1.0), plain.effort(0.7, 0.3, 1.0));
    let lean = "[[undeclared]]\neffect = \"gravity\"\ntilt_deg = 2.0\nazimuth_deg = 30.0";
    let leaning = simulation(&wood_door(lean).unwrap(), 1).truth();
    assert_eq!(leaning.effort(0.7, 0.3, 1.0), plain.effort(0.7, 0.3, 1.0));
    assert_ne!(leaning.axis_direction, plain.axis_direction);
    assert_eq!(leaning.declared_axis_direction, plain.axis_direction);
}

#[test]
fn a_salt_makes_another_day_of_the_same_seed() {
    let salted = |salt: u32| {
        let mut scenario = wood_door("").unwrap();
        scenario.salt = salt;
        simulation(&scenario, 1).truth()
    };
    assert_eq!(salted(7).sensor_errors, salted(7).sensor_errors);
    assert_ne!(salted(7).sensor_errors, salted(8).sensor_errors);
    assert_ne!(salted(7).grasp_position, salted(0).grasp_position);
    assert_eq!(
        salted(0).sensor_errors,
        simulation(&wood_door("").unwrap(), 1).truth().sensor_errors
    );
}

#[test]
fn a_bad_effect_is_refused_by_name() {
    let says = |text: &str| wood_door(text).unwrap_err();
    let unknown = says("[[undeclared]]\neffect = \"wobble\"");
    assert!(
        unknown.contains("wobble") && unknown.contains("grasp_compliance"),
        "{unknown}"
    );
    let key = says("[[undeclared]]\neffect = \"spring\"\nrate = 8.0\nrests = 0.2");
    assert!(key.contains("rests") && key.contains("rest"), "{key}");
    let missing = says("[[undeclared]]\neffect = \"detent\"\nat = 0.3\nhold = 4.0");
    assert!(missing.contains("reach"), "{missing}");
    let range = says("[[undeclared]]\neffect = \"stribeck\"\nextra = 2.0\nrate = 0.0");
    assert!(
        range.contains("undeclared 1 (stribeck), rate is 0.0") && range.contains("0.0001 to 10"),
        "{range}"
    );
    let negative = says("[[undeclared]]\neffect = \"stiction\"\nextra = -1.0");
    assert!(negative.contains("(stiction), extra is -1.0"), "{negative}");
    let drift = says("[[undeclared]]\neffect = \"friction_drift\"\nextra = 1.0");
    assert!(
        drift.contains("(friction_drift), seconds") && drift.contains("travel"),
        "{drift}"
    );
    let lag = "[[undeclared]]\neffect = \"time_lag\"\nlag_s = 0.004\n";
    let twice = says(&format!("{lag}{lag}"));
    assert!(
        twice.contains("undeclared 2") && twice.contains("given once"),
        "{twice}"
    );
    let drawer = include_str!("../scenarios/drawer_light.toml");
    let lean = "[[undeclared]]\neffect = \"gravity\"\ntilt_deg = 2.0\nazimuth_deg = 30.0";
    let error = Scenario::from_toml(&format!("{drawer}\n{lean}"))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("(gravity), tilt_deg") && error.contains("revolute"),
        "{error}"
    );
}

#[test]
fn no_number_of_an_effect_is_taken_without_a_limit() {
    // Every number of every effect, one after another, made absurd.
    let (head, tail) = EVERY.split_once("[[undeclared]]").unwrap();
    let effects: Vec<&str> = tail.split("[[undeclared]]").collect();
    let mut refused = 0;
    for effect in effects {
        for line in effect.lines().filter(|line| line.contains(" = ")) {
            let (key, value) = line.split_once(" = ").unwrap();
            if value.starts_with('"') {
                continue;
            }
            for absurd in ["1e9", "-1e9", "nan"] {
                let bad = if value.starts_with('[') {
                    format!("[{absurd}, {absurd}, {absurd}]")
                } else {
                    absurd.to_owned()
                };
                let text = effect.replace(line, &format!("{key} = {bad}"));
                let error = Scenario::from_toml(&format!("{head}[[undeclared]]{text}"))
                    .expect_err(&text)
                    .to_string();
                assert!(
                    error.contains(key) && error.contains("undeclared 1 ("),
                    "{error}"
                );
                refused += 1;
            }
        }
    }
    assert!(refused > 150, "{refused}");
}
