//! The network with keys: who is let in, what each role may do, and who does not hold it up; with Zenoh's Python library as
//! the intruder.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::Path;
use std::process::{Child, Stdio};

use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

fn make_keys(folder: &Path, name: &str, more: &[&str]) {
    let mut arguments = vec!["keys", "-o", name, "--host", "127.0.0.1"];
    arguments.extend(more);
    let made = programs::run("ft-capture", &arguments, folder).expect_code(0);
    assert!(
        made.stdout.contains("--connect tls/127.0.0.1:7447"),
        "{}",
        made.stdout
    );
}

fn capture(folder: &Path, more: &[&str]) -> Child {
    let mut arguments = vec!["--sim", "-o", "a.mcap", "--json"];
    arguments.extend(more);
    let capture = programs::command("ft-capture", &arguments, folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait(4000);
    capture
}

/// Ends the capture and gives its summary and what it said.
fn end(capture: Child) -> (Value, String) {
    let id = capture.id().to_string();
    let killed = std::process::Command::new("kill")
        .args(["-INT", &id])
        .status();
    assert!(killed.unwrap().success());
    let finished = programs::Finished::new("ft-capture", &capture.wait_with_output().unwrap());
    assert!(matches!(finished.code, Some(0 | 3)), "{}", finished.stderr);
    (finished.json(), finished.stderr)
}

#[allow(clippy::disallowed_methods, reason = "a person takes a moment, too")]
fn wait(milliseconds: u64) {
    std::thread::sleep(std::time::Duration::from_millis(milliseconds));
}

fn assert_roles(seen: &Value) {
    for (attempt, answer) in [
        ("viewer: status", "done"),
        ("viewer: tare", "no answer"),
        ("viewer: mark", "no answer"),
        ("viewer: start", "no answer"),
        ("viewer: stop", "no answer"),
        ("operator: status", "done"),
        ("operator: mark", "done"),
        ("operator: tare", "done"),
    ] {
        assert_eq!(seen[attempt], answer, "{attempt}: {seen}");
    }
    for count in ["forged", "unanswered"] {
        assert_eq!(seen[count], 0, "{count}: {seen}");
    }
    for count in ["viewer hears", "operator hears"] {
        assert!(seen[count].as_u64().unwrap() > 1000, "{count}: {seen}");
    }
    assert!(seen["viewer lists"].as_u64().unwrap() > 5, "{seen}");
    assert!(seen["asked"].as_u64().unwrap() > 50, "{seen}");
}

fn assert_unaffected(folder: &Path, summary: &Value, said: &str) {
    let recording =
        ft_recording::Recording::load(&folder.join("a.mcap"), &ft_recording::TopicMap::default())
            .unwrap();
    let marks: Vec<_> = recording
        .marks
        .iter()
        .map(|mark| mark.value.as_str())
        .collect();
    assert!(!marks.contains(&"forged"), "{marks:?}");
    for stream in summary["streams"].as_array().unwrap() {
        assert_eq!(stream["drops"], 0, "{summary}");
    }
    // Each place in Zenoh speaks once.
    assert!(said.lines().count() < 40, "{said}");
}

#[test]
fn without_a_certificate_nobody_looks_and_a_viewer_does_not_command() {
    let test = "without_a_certificate_nobody_looks_and_a_viewer_does_not_command";
    let Some(_) = peers::python(test) else { return };
    let folder = tempdir().unwrap();
    make_keys(folder.path(), "keys", &[]);
    make_keys(folder.path(), "others", &[]);
    let endpoint = "tls/127.0.0.1:17481";
    let capture = capture(
        folder.path(),
        &["--keys", "keys/capture", "--listen", endpoint],
    );
    let path = |name: &str| folder.path().join(name).display().to_string();
    let arguments = [
        "certificates",
        endpoint,
        "wood_door",
        &path("keys"),
        &path("others"),
    ];
    let seen = peers::run(test, "zenoh_intruder.py", &arguments);
    let own = programs::run(
        "ft-view",
        &[
            "--keys",
            "keys/viewer",
            "--connect",
            endpoint,
            "--duration",
            "2s",
            "--plain",
        ],
        folder.path(),
    );
    let recorded = programs::run(
        "ft-view",
        &[
            "--keys",
            "keys/viewer",
            "--connect",
            endpoint,
            "--duration",
            "2s",
            "--record",
            "viewer.mcap",
            "--json",
        ],
        folder.path(),
    );
    let strange = programs::run(
        "ft-view",
        &[
            "--keys",
            "others/viewer",
            "--connect",
            endpoint,
            "--duration",
            "2s",
            "--plain",
        ],
        folder.path(),
    );
    let (summary, said) = end(capture);
    own.expect_code(0);
    // A viewer may also ask for what it missed: here what was published before it came.
    let ledger = &recorded.expect_code(0).json()["topics"]["/ft/wrench"];
    assert_eq!(
        (&ledger["gaps"], &ledger["earlier"]),
        (&0.into(), &0.into())
    );
    assert!(ledger["recovered"].as_u64().unwrap() > 2000, "{ledger}");
    strange.expect_code(1);
    let seen = seen.unwrap().expect_code(0).json();
    println!("{seen:#}\n{said}");
    for attempt in [
        "in the clear",
        "no certificate",
        "certificate of another authority",
        "capture of another authority",
    ] {
        assert_eq!(seen[attempt], "shut out", "{attempt}: {seen}");
    }
    assert_eq!(seen["viewer"], "done", "{seen}");
    assert_roles(&seen);
    assert_unaffected(folder.path(), &summary, &said);
}

#[test]
fn a_wrong_password_opens_nothing() {
    let test = "a_wrong_password_opens_nothing";
    let Some(_) = peers::python(test) else { return };
    let folder = tempdir().unwrap();
    make_keys(folder.path(), "keys", &["--passwords"]);
    let endpoint = "tls/127.0.0.1:17482";
    let capture = capture(
        folder.path(),
        &["--keys", "keys/capture", "--listen", endpoint],
    );
    let keys = folder.path().join("keys").display().to_string();
    let seen = peers::run(
        test,
        "zenoh_intruder.py",
        &["passwords", endpoint, "wood_door", &keys],
    );
    let (summary, said) = end(capture);
    let seen = seen.unwrap().expect_code(0).json();
    println!("{seen:#}\n{said}");
    for attempt in [
        "no password",
        "wrong password",
        "unknown name",
        "another's password",
    ] {
        assert_eq!(seen[attempt], "shut out", "{attempt}: {seen}");
    }
    assert_eq!(
        seen["wrong passwords"],
        serde_json::json!(["shut out"]),
        "{seen}"
    );
    assert_roles(&seen);
    assert_unaffected(folder.path(), &summary, &said);
}

#[test]
fn a_huge_message_and_a_thousand_connections_disturb_nobody() {
    let test = "a_huge_message_and_a_thousand_connections_disturb_nobody";
    let Some(_) = peers::python(test) else { return };
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17483";
    let capture = capture(folder.path(), &["--listen", endpoint]);
    let seen = peers::run(test, "zenoh_intruder.py", &["open", endpoint, "wood_door"]);
    let (summary, said) = end(capture);
    let seen = seen.unwrap().expect_code(0).json();
    println!("{seen:#}\n{said}");
    assert_ne!(seen["100 MB"], "done", "{seen}");
    let before = seen["before"].as_f64().unwrap() / 3.0;
    let during = seen["during 1000 connections, a second"].as_f64().unwrap();
    assert!(during > 0.5 * before, "{seen}");
    assert!(
        seen["after"].as_f64().unwrap() / 3.0 > 0.5 * before,
        "{seen}"
    );
    assert_eq!(
        (&seen["the good one"], &seen["newcomer"]),
        (&"done".into(), &"done".into()),
        "{seen}"
    );
    assert_unaffected(folder.path(), &summary, &said);
}
