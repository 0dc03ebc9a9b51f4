//! Sealed draws: what they hold, and that they repeat themselves.
#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::process::Command;
use std::time::Duration;

use ft_sim_hw::sealed::Mechanisms;
use ft_sim_hw::{Scenario, SealedDraw, SealedError, SealedOptions, Simulation};
use ft_wire::HostTime;

fn draw(seed: u64) -> SealedDraw {
    SealedDraw::draw(seed, &SealedOptions::default()).unwrap()
}

fn only(name: &str, seed: u64) -> SealedDraw {
    let options = SealedOptions {
        only: vec![name.to_owned()],
        ..SealedOptions::default()
    };
    SealedDraw::draw(seed, &options).unwrap()
}

#[test]
fn a_seed_draws_the_same_again_and_another_seed_something_else() {
    let (first, again, other) = (draw(11), draw(11), draw(12));
    assert_eq!(first.main, again.main);
    assert_eq!(first.confirm, again.confirm);
    let truth = |draw: &SealedDraw| serde_json::to_string(&draw.truth).unwrap();
    assert_eq!(truth(&first), truth(&again));
    assert_ne!(first.main.object, other.main.object);
}

#[test]
fn main_and_confirm_are_one_object_and_two_persons() {
    for seed in 20..24 {
        let SealedDraw { main, confirm, .. } = draw(seed);
        assert_eq!(main.object, confirm.object);
        assert_eq!(main.joint, confirm.joint);
        assert_eq!(main.grasp, confirm.grasp);
        assert_eq!(main.mechanisms, confirm.mechanisms);
        assert_eq!(main.undeclared, confirm.undeclared);
        assert_ne!(main.person, confirm.person);
        assert_ne!(main.salt, confirm.salt);
        let start = HostTime::from_nanos(1_750_000_000_000_000_000);
        let [one, two] = [&main, &confirm].map(|scenario| {
            let length = Some(Duration::from_secs(8));
            Simulation::new(scenario, 1, start, length).unwrap().truth()
        });
        assert_ne!(
            one.sensor_errors, two.sensor_errors,
            "another day under the same seed"
        );
    }
}

#[test]
fn draws_are_spread_over_objects_sizes_and_effects() {
    let draws: Vec<SealedDraw> = (100..136).map(draw).collect();
    let counted = |count: usize| {
        draws
            .iter()
            .filter(|draw| draw.truth.effects.len() == count)
            .count()
    };
    assert!((1..14).contains(&counted(0)), "none: {}", counted(0));
    assert!((2..16).contains(&counted(2)), "two: {}", counted(2));
    let outside = draws
        .iter()
        .filter(|draw| {
            draw.truth
                .effects
                .iter()
                .any(|effect| !effect.in_vocabulary)
        })
        .count();
    assert!((1..12).contains(&outside), "outside: {outside}");
    let mut objects: Vec<&str> = draws
        .iter()
        .map(|draw| draw.truth.object.as_str())
        .collect();
    objects.sort_unstable();
    objects.dedup();
    assert_eq!(objects.len(), 6, "{objects:?}");
    for draw in &draws {
        let sizes = draw.truth.sizes;
        let base = Scenario::builtin(&draw.truth.object).unwrap();
        let share = draw.main.object.inertia / base.object.inertia;
        assert!((share - sizes.inertia).abs() < 1e-9 && (0.5..1.5).contains(&share));
        for effect in &draw.truth.effects {
            assert!(
                !draw.truth.mechanism_effects.contains(&effect.name),
                "the object has its own {}",
                effect.name
            );
        }
        let moved = draw.truth.together;
        if draw.truth.effects.is_empty() {
            assert!(moved.main.moved_rms < 0.02, "{moved:?}");
        }
        assert!(moved.main.effort_rms > 1.0 && moved.confirm.effort_rms > 1.0);
    }
}

#[test]
fn every_effect_can_be_drawn_and_what_it_moves_is_told() {
    let names = include_str!("every_effect.toml")
        .lines()
        .filter_map(|line| line.strip_prefix("effect = "))
        .map(|name| name.trim_matches('"'));
    for name in names {
        let SealedDraw { main, truth, .. } = only(name, 5);
        assert_eq!(truth.effects.len(), 1, "{name}");
        assert_eq!(main.undeclared[0].name(), name);
        let moved = truth.effects[0].alone.main;
        assert!(
            moved.moved_rms > 0.01 && moved.moved_rms < 60.0,
            "{name}: {moved:?}"
        );
    }
}

#[test]
fn without_mechanisms_only_inertia_and_friction_are_left() {
    let options = SealedOptions {
        mechanisms: Mechanisms::Dropped,
        ..SealedOptions::default()
    };
    for seed in 40..46 {
        let SealedDraw { main, truth, .. } = SealedDraw::draw(seed, &options).unwrap();
        assert!(main.mechanisms.is_empty() && truth.mechanism_effects.is_empty());
    }
}

#[test]
fn an_unknown_effect_is_refused_with_those_there_are() {
    let options = SealedOptions {
        only: vec!["wobble".to_owned()],
        ..SealedOptions::default()
    };
    let error = SealedDraw::draw(1, &options).unwrap_err();
    assert!(matches!(error, SealedError::UnknownEffect { .. }));
    let text = error.to_string();
    assert!(
        text.contains("wobble") && text.contains("toggle_linkage"),
        "{text}"
    );
}

fn sealed(folder: &Path, arguments: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_ft-sim-hw"))
        .args(["sealed", "-o"])
        .arg(folder)
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn the_command_writes_files_that_load_and_never_overwrites() {
    let directory = tempfile::tempdir().unwrap();
    let folder = directory.path().join("draws");
    let output = sealed(&folder, &["--seed", "70", "--count", "2"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    for (name, seed) in [("0001", 70), ("0002", 71)] {
        let path = |file: &str| folder.join(name).join(file);
        let expected = draw(seed);
        for (file, scenario) in [
            ("main.toml", &expected.main),
            ("confirm.toml", &expected.confirm),
        ] {
            let loaded = Scenario::load(path(file).to_str().unwrap()).unwrap();
            assert_eq!(&loaded, scenario);
        }
        let truth: serde_json::Value =
            serde_json::from_str(&std::fs::read_to_string(path("truth.json")).unwrap()).unwrap();
        assert_eq!(truth["schema"], "ft-sim-hw/sealed/1");
        assert_eq!(truth["seed"], seed);
    }
    let again = sealed(&folder, &["--seed", "72", "--count", "1"]);
    assert_eq!(again.status.code(), Some(1));
    assert!(
        String::from_utf8(again.stderr)
            .unwrap()
            .contains("0001/main.toml")
    );
    let unknown = sealed(&folder, &["--seed", "72", "--effect", "wobble"]);
    assert_eq!(unknown.status.code(), Some(2));
    let odds = sealed(&folder, &["--seed", "72", "--none", "0.9", "--two", "0.9"]);
    assert_eq!(odds.status.code(), Some(2));
    assert_eq!(
        sealed(&folder, &["--seed", "1", "--none", "2"])
            .status
            .code(),
        Some(2)
    );
}

#[test]
fn no_draws_are_a_wrong_argument() {
    let folder = tempfile::tempdir().unwrap();
    let done = sealed(folder.path(), &["--seed", "1", "--count", "0"]);
    assert_eq!(done.status.code(), Some(2));
}
