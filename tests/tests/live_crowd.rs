//! Many viewers, many grippers, many samples.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeSet;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use ft_recording::{Recording, TopicMap};
use ft_tests::programs::{end, signal};
use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

/// One test at a time: each fills the machine.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

#[allow(clippy::disallowed_methods, reason = "a person takes a moment, too")]
fn wait(milliseconds: u64) {
    std::thread::sleep(std::time::Duration::from_millis(milliseconds));
}

fn spawn(command: &mut Command) -> Child {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn program(name: &str, arguments: &[&str], folder: &Path) -> Child {
    spawn(&mut programs::command(name, arguments, folder))
}

/// A peer's script that says when it is ready.
fn peer(test: &str, script: &str, arguments: &[&str]) -> Option<Child> {
    let mut child = spawn(&mut peers::command(test, script, arguments)?);
    let mut line = String::new();
    BufReader::new(child.stdout.as_mut().unwrap())
        .read_line(&mut line)
        .unwrap();
    assert_eq!(line.trim(), "ready", "{script}");
    Some(child)
}

/// Seconds of processor time that a process has had.
fn processor_s(child: &Child) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap();
    let fields: Vec<_> = stat
        .rsplit(')')
        .next()
        .unwrap()
        .split_whitespace()
        .collect();
    let ticks: f64 = fields[11..13]
        .iter()
        .map(|text| text.parse::<f64>().unwrap())
        .sum();
    ticks / 100.0
}

#[test]
fn a_page_gets_its_frames_at_8_khz_and_costs_little() {
    let test = "a_page_gets_its_frames_at_8_khz_and_costs_little";
    let Some(_) = peers::python(test) else { return };
    let _alone = alone();
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17484";
    let mut flood = peer(test, "flood.py", &[endpoint, "8000"]).unwrap();
    let arguments = ["--connect", endpoint, "--web", "127.0.0.1:17485"];
    let viewer = program("ft-view", &arguments, folder.path());
    wait(2000);
    let seconds = 6.0;
    let look = |count: usize| {
        let before = processor_s(&viewer);
        let arguments = ["127.0.0.1:17485", &count.to_string(), &seconds.to_string()];
        let seen = peers::run(test, "viewers.py", &arguments).unwrap();
        let cost = processor_s(&viewer) - before;
        (seen.expect_code(0).json(), cost / seconds)
    };
    let (of_one, cost_of_one) = look(1);
    let (of_many, cost_of_many) = look(11);
    let ended = end("ft-view", viewer);
    flood.kill().unwrap();
    flood.wait().unwrap();
    ended.expect_code(0);
    let each = (cost_of_many - cost_of_one) / 10.0;
    println!("{of_one} {of_many}");
    println!(
        "server: {:.1} % of a core with one viewer, {:.2} % for each more",
        100.0 * cost_of_one,
        100.0 * each
    );
    for frames in of_one["frames"]
        .as_array()
        .unwrap()
        .iter()
        .chain(of_many["frames"].as_array().unwrap())
    {
        assert!(
            frames.as_f64().unwrap() / seconds > 30.0,
            "{of_one} {of_many}"
        );
    }
    assert!(each < 0.1, "{each} of a core for each viewer");
}

#[test]
fn ten_of_twenty_viewers_stop_and_the_recording_does_not_notice() {
    let test = "ten_of_twenty_viewers_stop_and_the_recording_does_not_notice";
    let _alone = alone();
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17486";
    let arguments = ["--sim", "-o", "a.mcap", "--json", "--listen", endpoint];
    let capture = program("ft-capture", &arguments, folder.path());
    wait(2500);
    let viewers: Vec<_> = (0..20)
        .map(|_| {
            program(
                "ft-view",
                &["--connect", endpoint, "--plain"],
                folder.path(),
            )
        })
        .collect();
    wait(5000);
    let (stopped, running) = viewers.split_at(10);
    stopped.iter().for_each(|viewer| signal(viewer, "-STOP"));
    wait(15_000);
    stopped.iter().for_each(|viewer| signal(viewer, "-CONT"));
    assert_eq!(running.len(), 10);
    wait(6000);
    let screens: Vec<_> = viewers
        .into_iter()
        .map(|viewer| end("ft-view", viewer).expect_code(0).stdout)
        .collect();
    let ended = end("ft-capture", capture);
    let summary: Value = ended.json();
    let counts: Vec<_> = screens.iter().map(|screen| counts(screen)).collect();
    println!("{counts:?}\n{summary:#}");
    for stream in summary["streams"].as_array().unwrap() {
        assert_eq!(
            (&stream["drops"], &stream["view_drops"]),
            (&0.into(), &0.into()),
            "{test}: {summary}"
        );
    }
    for (index, (received, missed)) in counts.iter().enumerate() {
        if index < 10 {
            assert!(
                *missed > 1000,
                "a stopped viewer counts what it missed: {counts:?}"
            );
        } else {
            assert!(
                *received > 15_000 && *missed < received / 10,
                "the others go on: {counts:?}"
            );
        }
    }
}

/// Received and missed wrenches on a viewer's last screen.
fn counts(screen: &str) -> (u64, u64) {
    let line = screen
        .lines()
        .find(|line| line.starts_with("/ft/wrench "))
        .unwrap();
    let fields: Vec<_> = line.split_whitespace().collect();
    (fields[2].parse().unwrap(), fields[3].parse().unwrap())
}

fn stamps(file: &Path, topic: &str) -> BTreeSet<i64> {
    let map = match topic {
        "/ft/wrench" => TopicMap::default(),
        _ => TopicMap::from_arguments([
            format!("{topic}=/ft/wrench").as_str(),
            format!("{}=/aria/pose", topic.replace("ft/wrench", "aria/pose")).as_str(),
        ])
        .unwrap(),
    };
    let recording = Recording::load(file, &map).unwrap();
    recording
        .wrench
        .iter()
        .map(|wrench| wrench.at.as_nanos())
        .collect()
}

#[test]
fn eight_grippers_to_one_recorder_lose_nothing() {
    let test = "eight_grippers_to_one_recorder_lose_nothing";
    let Some(_) = peers::python(test) else { return };
    let _alone = alone();
    let folder = tempdir().unwrap();
    let folder = folder.path();
    let endpoint = "tcp/127.0.0.1:17487";
    let mut router = peer(test, "router.py", &[endpoint]).unwrap();
    let recorder = program(
        "ft-view",
        &["--connect", endpoint, "--record", "all.mcap", "--json"],
        folder,
    );
    wait(1000);
    let names: Vec<_> = (0..8).map(|index| format!("g{index}")).collect();
    let grippers: Vec<_> = names
        .iter()
        .map(|name| {
            let file = format!("{name}.mcap");
            let arguments = [
                "--sim",
                "metal_door",
                "--id",
                name,
                "--namespace",
                name,
                "--connect",
                endpoint,
                "-o",
                &file,
                "--json",
            ];
            program("ft-capture", &arguments, folder)
        })
        .collect();
    wait(15_000);
    let summaries: Vec<_> = grippers
        .into_iter()
        .map(|gripper| end("ft-capture", gripper).json())
        .collect();
    let recorded = end("ft-view", recorder);
    router.kill().unwrap();
    router.wait().unwrap();
    let ledger = recorded.expect_code(0).json();
    println!("{ledger:#}");
    for (name, summary) in names.iter().zip(&summaries) {
        for stream in summary["streams"].as_array().unwrap() {
            assert_eq!(stream["drops"], 0, "{name}: {summary}");
        }
        let topic = format!("/{name}/ft/wrench");
        let local = stamps(&folder.join(format!("{name}.mcap")), "/ft/wrench");
        let remote = stamps(&folder.join("all.mcap"), &topic);
        let missing = local.difference(&remote).count();
        let count = |of: &str| ledger["topics"][&topic][of].as_u64().unwrap();
        println!(
            "{name}: {} samples, {missing} missing, {} recovered",
            local.len(),
            count("recovered")
        );
        assert!(local.len() > 5000, "{name}: {summary}");
        assert_eq!(
            count("gaps") + count("earlier"),
            missing as u64,
            "the ledger is exact: {name}: {ledger}"
        );
        assert_eq!(missing, 0, "{name}: {ledger}");
    }
}
