//! The command line: what it prints and the codes it exits with.
#![allow(clippy::unwrap_used)]

use std::io::{BufRead, BufReader};
use std::process::{Command, Output, Stdio};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ft-sim-hw"))
        .args(arguments)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn the_scenarios_are_listed_with_the_default_first() {
    let output = run(&["scenarios"]);
    assert_eq!(output.status.code(), Some(0));
    let listed = text(&output.stdout);
    assert!(listed.starts_with("wood_door"), "{listed}");
    assert_eq!(listed.lines().count(), 6);
}

#[test]
fn wrong_arguments_exit_with_2_and_say_what_is_right() {
    let unknown = run(&["serve", "wooden"]);
    assert_eq!(unknown.status.code(), Some(2));
    assert!(text(&unknown.stderr).contains("one of wood_door"));
    assert_eq!(run(&["sing"]).status.code(), Some(2));
    assert_eq!(
        run(&["serve", "wood_door", "--duration", "x"])
            .status
            .code(),
        Some(2)
    );
    let short = run(&["serve", "wood_door", "--duration", "1"]);
    assert_eq!(short.status.code(), Some(2));
    assert!(text(&short.stderr).contains("at least 4 s"));
}

#[test]
fn a_gadget_for_a_device_that_is_not_there_or_on_another_bus_is_refused() {
    for (option, device, there) in [
        ("--gadget", "foo=/dev/ttyGS0", "ft_sensor, gripper, aria"),
        ("--candlelight", "ft_sensor=/run/candle", "none"),
    ] {
        let refused = run(&["serve", "wood_door", "--duration", "4", option, device]);
        let told = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(2), "{told}");
        let name = device.split_once('=').unwrap().0;
        assert!(told.contains(&format!("{name} is no device on")), "{told}");
        assert!(told.contains(&format!("there is {there}")), "{told}");
    }
}

#[test]
fn help_has_examples() {
    let help = text(&run(&["--help"]).stdout);
    assert!(
        help.contains("ft-sim-hw serve wood_door") && help.contains("Exit codes"),
        "{help}"
    );
}

#[test]
fn a_truth_file_is_never_overwritten() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("truth.json");
    std::fs::write(&path, "mine").unwrap();
    let output = run(&["serve", "wood_door", "--truth", path.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("truth.json"));
    assert_eq!(std::fs::read_to_string(&path).unwrap(), "mine");
}

#[test]
fn serving_names_the_sensor_that_is_there() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_ft-sim-hw"))
        .args(["serve", "wood_door", "--sensor", "leptrino"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let printed: Vec<_> = lines
        .map_while(Result::ok)
        .take_while(|line| !line.contains("Ctrl-C"))
        .collect();
    child.kill().unwrap();
    child.wait().unwrap();
    let printed = printed.join("\n").to_lowercase();
    assert!(printed.contains("ft_sensor  leptrino"), "{printed}");
    assert!(!printed.contains("bota"), "{printed}");
}

#[test]
fn serving_prints_the_ports_and_stops_on_a_signal() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("truth.json");
    let mut child = Command::new(env!("CARGO_BIN_EXE_ft-sim-hw"))
        .args(["serve", "metal_door", "--truth", path.to_str().unwrap()])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut printed = String::new();
    while !printed.contains("Ctrl-C") {
        printed.push_str(&lines.next().unwrap().unwrap());
        printed.push('\n');
    }
    assert!(
        printed.contains("gripper    dynamixel      /dev/pts/"),
        "{printed}"
    );
    assert!(
        printed.contains("robotous_can   not reachable: give --vcan"),
        "{printed}"
    );
    let stopped = Command::new("kill")
        .arg("-INT")
        .arg(child.id().to_string())
        .status()
        .unwrap();
    assert!(stopped.success());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    assert_eq!(truth["object"]["inertia"], 14.0);
}
