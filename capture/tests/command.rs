//! What the programs say about themselves, and how they end.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::process::{Command, Output};

fn capture(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ft-capture"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn help_has_examples_and_exit_codes() {
    let help = capture(&["--help"]);
    let text = String::from_utf8_lossy(&help.stdout);
    assert_eq!(help.status.code(), Some(0));
    for wanted in [
        "Examples:",
        "ft-capture --sim",
        "recover",
        "Exit codes: 0 fine, 1 failed",
    ] {
        assert!(text.contains(wanted), "no {wanted:?} in {text}");
    }
}

#[test]
fn devices_are_listed_or_said_to_be_absent() {
    let output = capture(&["devices"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(!output.stdout.is_empty());
}

#[test]
fn a_viewer_without_a_capture_says_where_it_looked() {
    let mut viewer = Command::new(env!("CARGO_BIN_EXE_ft-view"));
    let output = viewer
        .args(["--connect", "tcp/127.0.0.1:1", "--duration", "1s"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("tcp/127.0.0.1:1") && text.contains("--listen"),
        "{text}"
    );
}
