//! `ft-capture --sim` in real time: ptys, threads, Zenoh, and a subscriber of other people's making.
//!
//! Alone in its file, so that no other test takes the processor from it.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

fn assert_nothing_lost(summary: &Value, rates: &[(&str, f64)]) {
    let streams = summary["streams"].as_array().unwrap();
    assert_eq!(streams.len(), rates.len(), "{summary}");
    for (name, rate) in rates {
        let stream = streams
            .iter()
            .find(|stream| stream["name"] == *name)
            .unwrap();
        for count in [
            "gaps",
            "drops",
            "refused",
            "duplicated",
            "invalid",
            "interruptions",
            "view_drops",
        ] {
            assert_eq!(stream[count], 0, "{name}: {count}: {summary}");
        }
        assert_eq!(stream["state"], "streaming", "{name}");
        let seen = stream["rate_hz"].as_f64().unwrap();
        assert!(
            (seen / rate - 1.0).abs() < 0.05,
            "{name}: {seen} Hz, wanted {rate}"
        );
    }
}

#[test]
fn zenohs_own_recorder_comes_late_and_gets_everything() {
    let test = "zenohs_own_recorder_comes_late_and_gets_everything";
    let Some(_) = peers::python(test) else { return };
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17449";
    let arguments = ["--sim", "--no-record", "--json", "--listen", endpoint];
    let capture = programs::command("ft-capture", &arguments, folder.path())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    wait(6000);
    let seen = peers::run(test, "advanced.py", &[endpoint, "4"]).unwrap();
    let ended = programs::end("ft-capture", capture);
    assert_eq!(ended.code, Some(0), "{}", ended.stderr);
    let seen = seen.expect_code(0).json();
    println!("{seen}");
    let count = |of: &str| seen[of].as_u64().unwrap();
    assert_eq!((count("first"), count("backwards")), (1, 0), "{seen}");
    assert_eq!(
        count("last"),
        count("different"),
        "no number is missing: {seen}"
    );
    assert_eq!(count("received"), count("different"), "{seen}");
    assert!(count("last") > 4000, "{seen}");
}

#[test]
fn a_real_time_session_reaches_a_ros_2_subscriber_and_loses_nothing() {
    let test = "a_real_time_session_reaches_a_ros_2_subscriber_and_loses_nothing";
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17447";
    let arguments = [
        "--sim",
        "wood_door",
        "--speed",
        "1",
        "--duration",
        "20s",
        "-o",
        "live.mcap",
        "--json",
        "--listen",
        endpoint,
    ];
    let mut capture = programs::command("ft-capture", &arguments, folder.path());
    let capture = capture
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // The first seconds are set-up; the subscriber asks until it is connected.
    let subscriber = peers::command(test, "live_wrench.py", &[endpoint, "8"]).map(|mut command| {
        wait(3000);
        command.output().unwrap()
    });
    let finished =
        programs::Finished::new("ft-capture", &capture.wait_with_output().unwrap()).expect_code(0);
    assert_nothing_lost(
        &finished.json(),
        &[("ft_sensor", 800.0), ("gripper", 50.0), ("aria", 1000.0)],
    );
    if let Some(output) = subscriber {
        let heard = programs::Finished::new("live_wrench.py", &output)
            .expect_code(0)
            .json();
        // A viewer on a busy machine may miss samples; it sees how many.
        let (received, missed) = (
            heard["received"].as_u64().unwrap(),
            heard["missed"].as_u64().unwrap(),
        );
        assert!(received > 5000 && missed < received / 10, "{heard}");
        assert_eq!(heard["frame_ids"][0], "ft_sensor", "{heard}");
        assert_eq!(
            heard["topics"]["/ft/wrench"], "geometry_msgs::msg::dds_::WrenchStamped_",
            "{heard}"
        );
    }
}

#[allow(clippy::disallowed_methods, reason = "a person takes a moment, too")]
fn wait(milliseconds: u64) {
    std::thread::sleep(std::time::Duration::from_millis(milliseconds));
}

#[test]
fn sensors_without_a_clock_on_can_and_uart_lose_nothing_either() {
    let folder = tempdir().unwrap();
    for (scenario, rate) in [("metal_door", 1000.0), ("drawer_light", 1000.0)] {
        let arguments = [
            "--sim",
            scenario,
            "--duration",
            "8s",
            "-o",
            "a.mcap",
            "--json",
            "--force",
            "--listen",
            "tcp/127.0.0.1:17457",
        ];
        let finished = programs::run("ft-capture", &arguments, folder.path()).expect_code(0);
        assert_nothing_lost(
            &finished.json(),
            &[("ft_sensor", rate), ("gripper", 50.0), ("aria", 1000.0)],
        );
        programs::run("ft-capture", &["check", "a.mcap"], folder.path()).expect_code(0);
    }
}

#[test]
fn commands_over_the_network_are_obeyed_and_answered() {
    let test = "commands_over_the_network_are_obeyed_and_answered";
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17458";
    let arguments = ["--sim", "-o", "a.mcap", "--json", "--listen", endpoint];
    let Some(mut commands) = peers::command(test, "commands.py", &[endpoint, "wood_door"]) else {
        return;
    };
    let mut capture = programs::command("ft-capture", &arguments, folder.path());
    let capture = capture
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    wait(2000);
    let answers = programs::Finished::new("commands.py", &commands.output().unwrap())
        .expect_code(0)
        .json();
    programs::Finished::new("ft-capture", &capture.wait_with_output().unwrap()).expect_code(0);
    for command in ["mark", "tare", "status", "stop"] {
        assert_eq!(answers[command]["ok"], true, "{answers}");
    }
    assert_eq!(answers["mark without text"]["ok"], false, "{answers}");
    assert_eq!(
        answers["status"]["streams"].as_array().unwrap().len(),
        3,
        "{answers}"
    );
    let recording = ft_recording::Recording::load(
        &folder.path().join("a.mcap"),
        &ft_recording::TopicMap::default(),
    )
    .unwrap();
    let marks: Vec<_> = recording
        .marks
        .iter()
        .map(|mark| mark.value.as_str())
        .collect();
    assert!(
        marks.contains(&"door squeaks here") && marks.contains(&"tare"),
        "{marks:?}"
    );
}
