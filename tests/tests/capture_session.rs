//! `ft-capture --sim --speed max`, as a user runs it.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeMap;
use std::path::Path;

use ft_recording::message::PoseStamped;
use ft_recording::reader::{Record, RecordReader};
use ft_recording::recording::Recording;
use ft_recording::{Message as _, TopicMap};
use ft_tests::{peers, programs, workspace_root};
use tempfile::tempdir;

fn record(folder: &Path, name: &str, extra: &[&str]) -> programs::Finished {
    let mut arguments = vec![
        "--sim",
        name,
        "--speed",
        "max",
        "--duration",
        "12s",
        "-o",
        "a.mcap",
        "--json",
    ];
    arguments.extend(extra);
    programs::run("ft-capture", &arguments, folder)
}

#[test]
fn every_built_in_scenario_records_without_a_loss() {
    let scenarios = [
        ("wood_door", 800.0),
        ("metal_door", 1000.0),
        ("drawer_light", 1000.0),
        ("drawer_loaded", 800.0),
        ("sliding_door", 1000.0),
        ("oven_door", 1000.0),
    ];
    for (name, rate) in scenarios {
        let folder = tempdir().unwrap();
        let finished = record(folder.path(), name, &[]).expect_code(0);
        let summary = finished.json();
        let streams = summary["streams"].as_array().unwrap();
        assert!(
            streams
                .iter()
                .all(|stream| stream["gaps"] == 0 && stream["refused"] == 0),
            "{name}: {summary}"
        );
        let sensor = streams
            .iter()
            .find(|stream| stream["name"] == "ft_sensor")
            .unwrap();
        let seen = sensor["rate_hz"].as_f64().unwrap();
        assert!((seen / rate - 1.0).abs() < 0.01, "{name}: {seen} Hz");
        assert!(
            folder.path().join("a.mcap").exists() && !folder.path().join("a.mcap.partial").exists()
        );
        assert!(folder.path().join("a.truth.json").exists());
    }
}

#[test]
fn one_seed_is_one_file_and_another_seed_another() {
    let bytes = |seed: &str| {
        let folder = tempdir().unwrap();
        record(folder.path(), "wood_door", &["--seed", seed]).expect_code(0);
        std::fs::read(folder.path().join("a.mcap")).unwrap()
    };
    let first = bytes("5");
    assert!(first == bytes("5"), "the same seed gave another file");
    assert!(first != bytes("6"), "another seed gave the same file");
}

#[test]
fn an_existing_recording_is_kept_unless_forced() {
    let folder = tempdir().unwrap();
    std::fs::write(folder.path().join("a.mcap"), "precious").unwrap();
    record(folder.path(), "wood_door", &[])
        .expect_code(1)
        .complains(&["a.mcap", "exists", "--force"]);
    assert_eq!(
        std::fs::read(folder.path().join("a.mcap")).unwrap(),
        b"precious"
    );
    record(folder.path(), "wood_door", &["--force"]).expect_code(0);
}

#[test]
fn other_peoples_tools_read_the_recording() {
    let test = "other_peoples_tools_read_the_recording";
    let folder = tempdir().unwrap();
    record(folder.path(), "wood_door", &[]).expect_code(0);
    let file = folder.path().join("a.mcap");
    let Some(finished) = peers::run(test, "read_recording.py", &[&file]) else {
        return;
    };
    let counts = finished.expect_code(0).json();
    for reader in ["rosbags", "mcap_ros2"] {
        assert!(
            counts[reader]["/ft/wrench"]
                .as_u64()
                .is_some_and(|count| count > 9000),
            "{reader}: {counts}"
        );
    }
    let Some(bin) = peers::programs(test) else {
        return;
    };
    let rerun = std::process::Command::new(bin.join("rerun"))
        .args(["mcap", "check"])
        .arg(&file)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&rerun.stderr);
    assert!(rerun.status.success(), "{said}");
}

#[test]
fn a_recording_replays_through_the_drivers_to_the_same_samples() {
    let folder = tempdir().unwrap();
    for scenario in ["wood_door", "metal_door", "drawer_light"] {
        record(folder.path(), scenario, &["--force"]).expect_code(0);
        let arguments = ["replay", "a.mcap", "-o", "b.mcap", "--force"];
        programs::run("ft-capture", &arguments, folder.path()).expect_code(0);
        let load =
            |name: &str| Recording::load(&folder.path().join(name), &TopicMap::default()).unwrap();
        let (before, after) = (load("a.mcap"), load("b.mcap"));
        assert!(before.wrench.len() > 5000, "{scenario}");
        assert!(
            before.wrench == after.wrench,
            "{scenario}: the wrenches differ"
        );
        assert!(
            before.pose.samples == after.pose.samples,
            "{scenario}: the poses differ"
        );
        assert!(
            before.gripper_width == after.gripper_width,
            "{scenario}: the widths differ"
        );
    }
}

/// The example of `capture/README.md`, with a tracker that moves by a millimetre in every pose.
fn readme_example(port: &str) -> String {
    let readme = std::fs::read_to_string(workspace_root().join("capture/README.md")).unwrap();
    let blocks = readme.split("```python\n").skip(1);
    let mut examples = blocks.map(|block| block.split("```").next().unwrap());
    let example = examples.find(|text| text.contains("tracker.read")).unwrap();
    assert!(example.lines().filter(|line| !line.is_empty()).count() <= 15);
    let tracker = format!(
        "import socket, time
class Tracker:
    k = 0
    def read(self):
        time.sleep(0.01)
        self.k += 1
        return (self.k * 10_000_000, (0.001 * self.k, 0.2, -0.3), (0.0, 0.0, 0.6, 0.8)) if self.k <= 200 else None
tracker = Tracker()
while socket.socket().connect_ex((\"127.0.0.1\", {port})):
    time.sleep(0.05)
"
    );
    tracker + &example.replace("7447", port)
}

#[test]
fn poses_that_are_put_on_a_key_as_the_readme_says_are_recorded() {
    let folder = tempdir().unwrap();
    let Some(python) = peers::python("live poses by a key") else {
        return;
    };
    let port = "17461";
    let config = "id = \"blue\"\n[[device]]\nname = \"aria\"\ndriver = \"pose_stream\"\nport = \"zenoh:ft_capture/blue/aria\"\n";
    std::fs::write(folder.path().join("capture.toml"), config).unwrap();
    std::fs::write(folder.path().join("poses.py"), readme_example(port)).unwrap();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let arguments = [
        "--listen",
        &endpoint,
        "-o",
        "a.mcap",
        "--duration",
        "6s",
        "--json",
    ];
    let mut capture = programs::command("ft-capture", &arguments, folder.path());
    let piped = std::process::Stdio::piped;
    let capture = capture.stdout(piped()).stderr(piped()).spawn().unwrap();
    let script = std::process::Command::new(python)
        .arg("poses.py")
        .current_dir(folder.path())
        .output()
        .unwrap();
    let said = programs::Finished::new("poses.py", &script).expect_code(0);
    let finished = programs::Finished::new("ft-capture", &capture.wait_with_output().unwrap());
    let summary = finished.clone().json();
    let stream = &summary["streams"][0];
    assert_eq!(
        (&stream["gaps"], &stream["refused"]),
        (&0.into(), &0.into()),
        "{finished:?} {said:?}"
    );
    assert!(stream["clock"]["spread_us"].as_f64().is_some(), "{summary}");

    let mut reader = RecordReader::open(&folder.path().join("a.mcap")).unwrap();
    let (mut poses, mut topics) = (Vec::new(), BTreeMap::new());
    while let Some(record) = reader.next_record().unwrap() {
        match record {
            Record::Channel(channel) => drop(topics.insert(channel.id, channel.topic)),
            Record::Message(message) if topics[&message.channel_id] == "/aria/pose" => {
                let pose = PoseStamped::decode(message.data).unwrap().pose;
                assert!(message.publish_time <= message.log_time);
                assert_eq!((pose.position.y, pose.orientation.z), (0.2, 0.6));
                poses.push((pose.position.x * 1e3).round() as u64);
            }
            _ => {}
        }
    }
    // The first may be put before the subscription is known there.
    assert!(poses.len() > 150, "{} of 200: {finished:?}", poses.len());
    assert!(
        poses.windows(2).all(|pair| pair[1] == pair[0] + 1),
        "{poses:?}"
    );
    assert_eq!(poses.last(), Some(&200));
}
