//! How the programs end when nothing, or not enough, can be done: at once, in words, without litter.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::fs;
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

#[test]
fn a_terminal_that_is_closed_ends_the_recording_and_not_its_file() {
    // `nohup` survives it, and ends by another signal.
    for (ignored, signals) in [("", &["-HUP"][..]), ("trap '' HUP;", &["-HUP", "-TERM"])] {
        let folder = tempfile::tempdir().unwrap();
        let script = format!("{ignored} exec \"$0\" --sim -o a.mcap --duration 60s");
        let capture = command("sh", &["-c", &script, CAPTURE], folder.path())
            .spawn()
            .unwrap();
        let script = |script: &str| {
            let mut shell = command("sh", &["-c", script], folder.path());
            assert!(shell.status().unwrap().success(), "{script}");
        };
        script("for i in $(seq 200); do test -e a.mcap.partial && exit; sleep 0.1; done; exit 1");
        for signal in signals {
            script(&format!(
                "sleep 1; test -e a.mcap.partial && kill {signal} {}",
                capture.id()
            ));
        }
        let ended = capture.wait_with_output().unwrap();
        assert!(folder.path().join("a.mcap").exists(), "{}", said(&ended));
        assert!(!folder.path().join("a.mcap.partial").exists());
    }
}

#[test]
fn a_recording_named_as_a_folder_is_refused_before_it_begins() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("there")).unwrap();
    let arguments = [
        "--sim",
        "--speed",
        "max",
        "-o",
        "there",
        "--force",
        "--duration",
        "5s",
    ];
    let ended = command(CAPTURE, &arguments, folder.path())
        .output()
        .unwrap();
    assert_eq!(ended.status.code(), Some(1));
    assert!(
        said(&ended).contains("there is a folder: name a file in it"),
        "{}",
        said(&ended)
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn a_pipe_is_no_recording_and_keeps_nobody_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let made = Command::new("mkfifo")
        .arg("x.mcap")
        .current_dir(folder.path())
        .status();
    assert!(made.unwrap().success());
    for arguments in [
        &["check", "x.mcap"][..],
        &["recover", "x.mcap", "-o", "y.mcap"],
        &["calibrate", "x.mcap"],
    ] {
        let script = "exec timeout 20 \"$0\" \"$@\"";
        let ended = Command::new("sh")
            .args(["-c", script, CAPTURE])
            .args(arguments)
            .current_dir(folder.path())
            .output()
            .unwrap();
        assert_eq!(ended.status.code(), Some(1), "{arguments:?}");
        assert!(
            said(&ended).contains("x.mcap is not a regular file"),
            "{}",
            said(&ended)
        );
    }
}

/// The limit of a process's file size stands in for a full disk.
#[test]
fn a_full_disk_leaves_no_litter_of_what_can_be_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let rows = |columns: &str, values: &str| {
        let rows: String = (0..2000).map(|row| format!("{row}.25{values}\n")).collect();
        format!("{columns}\n{rows}")
    };
    fs::write(
        folder.path().join("ft.csv"),
        rows("fx,fy,fz,tx,ty,tz", ",2,3,0.1,0.2,0.3"),
    )
    .unwrap();
    fs::write(
        folder.path().join("pose.csv"),
        rows("x,y,z,qx,qy,qz,qw", ",0.2,0.3,0,0,0,1"),
    )
    .unwrap();
    let import = "import-csv --wrench ft.csv --pose pose.csv --rate 100 -o a.mcap";
    for blocks in [0, 2] {
        let script = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" {import}");
        let ended = Command::new("sh")
            .args(["-c", &script, CAPTURE])
            .current_dir(folder.path())
            .output()
            .unwrap();
        let text = said(&ended);
        assert_eq!(ended.status.code(), Some(1), "{text}");
        assert!(text.contains("no space left for a.mcap"), "{text}");
        assert!(!text.contains("recover"), "{text}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "{blocks}");
    }
    // Nothing of a recording reached the disk either.
    let script = "trap '' XFSZ; ulimit -f 0; exec \"$0\" --sim --speed max --duration 5s -o b.mcap";
    let ended = Command::new("sh")
        .args(["-c", script, CAPTURE])
        .current_dir(folder.path())
        .output()
        .unwrap();
    let text = said(&ended);
    assert_eq!(ended.status.code(), Some(1), "{text}");
    assert!(text.contains("no space left for b.mcap"), "{text}");
    assert!(!text.contains("recover"), "{text}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}
