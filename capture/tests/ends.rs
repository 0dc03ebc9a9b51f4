//! How the programs end when nothing, or not enough, can be done: at once, in words, without litter.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output, Stdio};

const CAPTURE: &str = env!("CARGO_BIN_EXE_ft-capture");
const VIEW: &str = env!("CARGO_BIN_EXE_ft-view");

fn command(program: &str, arguments: &[&str], folder: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The Zenoh session of a viewer must not close inside the runtime of its page.
#[test]
fn programs_that_serve_a_page_end_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let arguments = [
        "--sim",
        "--no-record",
        "--view",
        "127.0.0.1:0",
        "--foxglove",
        "127.0.0.1:0",
        "--duration",
        "8s",
        "--listen",
        &endpoint,
    ];
    let capture = command(CAPTURE, &arguments, folder.path()).spawn().unwrap();
    let arguments = [
        "--connect",
        &endpoint,
        "--web",
        "127.0.0.1:0",
        "--foxglove",
        "127.0.0.1:0",
        "--duration",
        "2s",
    ];
    let viewed = (0..5)
        .map(|_| command(VIEW, &arguments, folder.path()).output().unwrap())
        .find(|viewed| said(viewed).contains("live page: "))
        .unwrap();
    let captured = capture.wait_with_output().unwrap();
    for ended in [&viewed, &captured] {
        assert_eq!(ended.status.code(), Some(0), "{}", said(ended));
        assert!(said(ended).contains("live page: "), "{}", said(ended));
        assert!(!said(ended).contains("panicked"), "{}", said(ended));
    }
}
