//! The live page in a real browser, and those who should not be let in.
//!
//! Alone in its file, so that no other test takes the processor from it.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Output, Stdio};

use ft_capture::rmw;
use ft_recording::message::{Message as _, PoseStamped};
use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

/// A program that serves a page, and the page's address.
struct Serving {
    /// Until it was ended.
    child: Option<Child>,
    url: String,
    /// Takes what it goes on to say.
    said: Option<std::thread::JoinHandle<String>>,
}

/// A test that fails leaves no program behind that holds the port of the next one.
impl Drop for Serving {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn serve(name: &str, arguments: &[&str], folder: &Path) -> Serving {
    let mut child = programs::command(name, arguments, folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut said = String::new();
    let url = loop {
        let mut line = String::new();
        assert!(
            stderr.read_line(&mut line).unwrap() > 0,
            "{name} ended: {said}"
        );
        said.push_str(&line);
        if let Some(url) = line.strip_prefix("live page: ") {
            break url.trim().to_owned();
        }
    };
    let said = std::thread::spawn(move || {
        stderr.lines().map_while(Result::ok).for_each(|line| {
            said.push_str(&line);
            said.push('\n');
        });
        said
    });
    Serving {
        child: Some(child),
        url,
        said: Some(said),
    }
}

impl Serving {
    /// Ends it as Ctrl-C does; what it said on the way.
    fn end(mut self) -> (Output, String) {
        let (child, said) = (self.child.take().unwrap(), self.said.take().unwrap());
        let killed = std::process::Command::new("kill")
            .args(["-INT", &child.id().to_string()])
            .status();
        assert!(killed.unwrap().success());
        let output = child.wait_with_output().unwrap();
        (output, said.join().unwrap())
    }
}

fn capture(folder: &Path, endpoint: &str) -> Serving {
    let arguments = [
        "--sim",
        "--no-record",
        "--json",
        "--view",
        "127.0.0.1:0",
        "--listen",
        endpoint,
    ];
    serve("ft-capture", &arguments, folder)
}

fn press_everything(test: &str, chromium: &Path, page: &Serving) -> Value {
    let chromium = chromium.to_str().unwrap();
    let pictures = std::env::var("FT_SCREENSHOTS").ok();
    let mut arguments = vec![chromium, page.url.as_str()];
    arguments.extend(pictures.as_deref());
    let pressed = peers::run(test, "page.py", &arguments).unwrap();
    pressed.expect_code(0).json()
}

/// Ends with 0, or with 3 where a busy machine cost the simulated devices some samples: that is not tested here.
fn expect_ended(name: &str, output: &Output) -> programs::Finished {
    let finished = programs::Finished::new(name, output);
    match finished.code {
        Some(3) => finished,
        _ => finished.expect_code(0),
    }
}

fn assert_pressed(seen: &Value, folder: &Path) {
    assert_eq!(seen["errors"], serde_json::json!([]), "{seen}");
    assert_eq!(seen["recording before"], "not recording", "{seen}");
    assert_eq!(seen["after one press"], true, "{seen}");
    assert_eq!(
        seen["sideways"], 0,
        "the page is wider than the phone: {seen}"
    );
    assert!(
        !seen["address"].as_str().unwrap().contains("token"),
        "{seen}"
    );
    assert!(seen["frames_hz"].as_f64().unwrap() > 30.0, "{seen}");
    assert!(
        seen["devices"].as_str().unwrap().contains("ft_sensor"),
        "{seen}"
    );
    let answer = seen["answer"].as_str().unwrap();
    let file = answer
        .strip_prefix("finished ")
        .unwrap()
        .split(',')
        .next()
        .unwrap();
    let path = folder.join(file);
    let recording =
        ft_recording::Recording::load(&path, &ft_recording::TopicMap::default()).unwrap();
    let marks: Vec<_> = recording
        .marks
        .iter()
        .map(|mark| mark.value.as_str())
        .collect();
    for wanted in ["tare", "hinge squeaks <b>here</b>", "grasp"] {
        assert!(marks.contains(&wanted), "no {wanted:?} in {marks:?}");
    }
    let check = programs::run("ft-capture", &["check", "--json", file], folder).json();
    assert_eq!(check["is_complete"], true, "{check}");
    assert!(!folder.join(format!("{file}.partial")).exists());
}

#[test]
fn every_button_of_the_page_does_what_it_says() {
    let test = "every_button_of_the_page_does_what_it_says";
    let (Some(chromium), Some(_)) = (peers::chromium(test), peers::python(test)) else {
        return;
    };
    let folder = tempdir().unwrap();
    let page = capture(folder.path(), "tcp/127.0.0.1:17470");
    let seen = press_everything(test, &chromium, &page);
    let (output, said) = page.end();
    let summary = expect_ended("ft-capture", &output).json();
    assert!(!said.contains("WARN"), "{said}");
    println!("{seen:#}");
    assert_pressed(&seen, folder.path());
    assert_eq!(summary["files"].as_array().unwrap().len(), 1, "{summary}");
}

#[test]
fn the_page_of_a_viewer_commands_the_capture_through_zenoh() {
    let test = "the_page_of_a_viewer_commands_the_capture_through_zenoh";
    let (Some(chromium), Some(_)) = (peers::chromium(test), peers::python(test)) else {
        return;
    };
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17471";
    let capture = capture(folder.path(), endpoint);
    let viewer = serve(
        "ft-view",
        &["--connect", endpoint, "--web", "127.0.0.1:0"],
        folder.path(),
    );
    let seen = press_everything(test, &chromium, &viewer);
    let (viewed, _) = viewer.end();
    let (captured, _) = capture.end();
    programs::Finished::new("ft-view", &viewed).expect_code(0);
    expect_ended("ft-capture", &captured);
    assert_pressed(&seen, folder.path());
}

#[test]
fn intruders_are_refused_and_nobody_else_notices() {
    let test = "intruders_are_refused_and_nobody_else_notices";
    let Some(_) = peers::python(test) else { return };
    let folder = tempdir().unwrap();
    let page = capture(folder.path(), "tcp/127.0.0.1:17472");
    let (address, token) = page.url.split_once("/#token=").unwrap();
    let (host, port) = address
        .strip_prefix("http://")
        .unwrap()
        .split_once(':')
        .unwrap();
    let seen = peers::run(test, "intruder.py", &[host, port, token]).unwrap();
    let (output, said) = page.end();
    let summary = expect_ended("ft-capture", &output).json();
    let seen = seen.expect_code(0).json();
    println!("{seen:#}\n{said}");
    for (attempt, answer) in [
        ("token", 200),
        ("no token", 401),
        ("wrong token", 401),
        ("command of another origin", 403),
        ("command by another name", 403),
        ("page by another name", 403),
        ("viewer of our origin", 101),
        ("viewer of another origin", 403),
        ("viewer of another port", 403),
        ("huge body", 413),
        ("method", 405),
        ("path", 404),
        ("folder", 400),
        ("afterwards", 200),
    ] {
        assert_eq!(seen[attempt], answer, "{attempt}: {seen}");
    }
    assert!(
        [0, 400, 403]
            .map(Value::from)
            .contains(&seen["page without a name"]),
        "{seen}"
    );
    assert_eq!(seen["wrong tokens"], serde_json::json!([401]), "{seen}");
    assert_eq!(
        seen["too many commands"],
        serde_json::json!([200, 429]),
        "{seen}"
    );
    assert_eq!(seen["huge message"][0], "hung up", "{seen}");
    assert!(
        seen["huge message"][1].as_u64().unwrap() < 20_000_000,
        "{seen}"
    );
    assert_eq!(seen["talkative"][0], "hung up", "{seen}");
    assert!(seen["of 1000 connections"].as_u64().unwrap() < 64, "{seen}");
    assert!(
        seen["frames_hz meanwhile"].as_f64().unwrap() > 30.0,
        "{seen}"
    );
    let silent = seen["silent for"].as_f64().unwrap();
    assert!((8.0..13.0).contains(&silent), "{seen}");
    for reason in [
        "too many connections",
        "another origin",
        "without the right token",
        "host name",
        "too many commands",
        "talks too much",
    ] {
        let lines = said.lines().filter(|line| line.contains(reason)).count();
        assert!((1..=2).contains(&lines), "{reason}: {lines} lines\n{said}");
    }
    assert_eq!(summary["own_drops"], 0, "{summary}");
    let stream = &summary["streams"][0];
    assert_eq!(
        (&stream["gaps"], &stream["drops"]),
        (&0.into(), &0.into()),
        "{summary}"
    );
}

/// What each topic has to bring, messages a second.
const TOPICS: [(&str, f64); 11] = [
    ("/ft/wrench", 600.0),
    ("/ft/wrench_view", 150.0),
    ("/ft/force_arrow", 30.0),
    ("/ft/temperature", 0.75),
    ("/gripper/joint_states", 37.5),
    ("/aria/pose", 750.0),
    ("/tcp/pose", 20.0),
    ("/tf", 30.0),
    ("/tf_static", 0.125),
    ("/marks", 0.125),
    ("/diagnostics", 0.75),
];

fn assert_every_topic(seen: &Value, seconds: f64) {
    let topics = seen["topics"].as_object().unwrap();
    assert_eq!(topics.len(), TOPICS.len(), "{seen}");
    for (topic, rate_hz) in TOPICS {
        let count = topics[topic]["count"].as_f64().unwrap();
        assert!(
            count >= rate_hz * seconds,
            "{topic}: {count}, wanted {rate_hz} a second: {seen}"
        );
    }
    let last = |topic: &str| &topics[topic]["last"];
    let arrow = last("/ft/force_arrow");
    assert_eq!(arrow["header"]["frame_id"], "ft_sensor", "{arrow}");
    assert_eq!(arrow["points"].as_array().unwrap().len(), 2, "{arrow}");
    let tf = &last("/tf")["transforms"][0];
    assert_eq!(
        (&tf["header"]["frame_id"], &tf["child_frame_id"]),
        (&"world".into(), &"aria_device".into()),
        "{tf}"
    );
    let at = &last("/tcp/pose")["pose"]["position"];
    assert_eq!(
        (&at["x"], &at["y"]),
        (&serde_json::json!(0.25), &serde_json::json!(-0.5)),
        "{at}"
    );
    let width = &last("/gripper/joint_states")["position"][0];
    assert!(width.as_f64().unwrap() > 0.0, "{width}");
    assert_eq!(
        last("/ft/wrench")["header"]["frame_id"],
        "ft_sensor",
        "{seen}"
    );
}

#[test]
fn clients_of_the_foxglove_protocol_decode_every_topic() {
    let test = "clients_of_the_foxglove_protocol_decode_every_topic";
    let seconds = 10.0;
    let (address, of_capture) = ("127.0.0.1:17480", "127.0.0.1:17479");
    let url = format!("ws://{address}");
    let (Some(_), Some(mut own_client)) = (
        peers::python(test),
        peers::node(test, "foxglove.js", &[&url, &seconds.to_string()]),
    ) else {
        return;
    };
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17473";
    let arguments = [
        "--sim",
        "--no-record",
        "--router",
        "--foxglove",
        of_capture,
        "--view",
        "127.0.0.1:0",
        "--listen",
        endpoint,
    ];
    let capture = serve("ft-capture", &arguments, folder.path());
    // The tool's pose comes from elsewhere on the network.
    let key = rmw::Topic::new(
        "/tcp/pose",
        PoseStamped::TYPE_NAME,
        PoseStamped::TYPE_HASH,
        rmw::Profile::Jazzy,
    );
    let mut tracker = peers::command(test, "tracker.py", &[endpoint, &key.key_expr(0)])
        .unwrap()
        .spawn()
        .unwrap();
    let arguments = [
        "--connect",
        endpoint,
        "--foxglove",
        address,
        "--web",
        "127.0.0.1:0",
    ];
    let viewer = serve("ft-view", &arguments, folder.path());
    let foxgloves = own_client
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let seen = peers::run(test, "foxglove.py", &[&url, &seconds.to_string()]);
    let foxgloves = programs::Finished::new("foxglove.js", &foxgloves.wait_with_output().unwrap());
    let local = peers::run(
        test,
        "foxglove.py",
        &[&format!("ws://{of_capture}"), "2", "foxglove.websocket.v1"],
    );
    tracker.kill().unwrap();
    tracker.wait().unwrap();
    let (viewed, _) = viewer.end();
    let (captured, _) = capture.end();
    programs::Finished::new("ft-view", &viewed).expect_code(0);
    expect_ended("ft-capture", &captured);

    let seen = seen.unwrap().expect_code(0).json();
    for (topic, said) in seen["topics"].as_object().unwrap() {
        assert_eq!(said["backwards"], 0, "{topic}: {seen}");
    }
    assert_every_topic(&seen, seconds);
    let foxgloves = foxgloves.expect_code(0).json();
    assert_eq!(foxgloves["complaints"], serde_json::json!([]));
    assert_every_topic(&foxgloves, seconds - 2.0);
    let local = local.unwrap().expect_code(0).json();
    assert!(
        local["topics"]["/ft/wrench"]["count"].as_u64() > Some(1000),
        "{local}"
    );
}
