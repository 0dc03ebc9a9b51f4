//! However a capture ends (killed, stopped, the disk full, the clock set, somebody reading), it loses at most a quarter of a second.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ft_recording::{Recording, TopicMap};
use ft_tests::programs::{self, Finished};
use ft_tests::workspace_root;
use serde_json::Value;
use tempfile::tempdir;

const ROUNDS: u64 = 20;
/// What an end may cost each stream.
const LOSS: Duration = Duration::from_millis(250);
const STREAMS: [&str; 3] = ["/ft/wrench", "/aria/pose", "/raw/ft_sensor"];

/// Captures in real time are tested one after the other: two at once would take each other's time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A simulated capture in real time into `a.mcap`.
fn capture(folder: &Path, seed: u64) -> Command {
    let (seed, endpoint) = (seed.to_string(), "tcp/127.0.0.1:17448");
    let arguments = [
        "--sim", "--speed", "1", "-o", "a.mcap", "--listen", endpoint, "--seed", &seed,
    ];
    programs::command("ft-capture", &arguments, folder)
}

fn started(mut command: Command) -> Child {
    command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn ended(child: Child) -> Finished {
    Finished::new("ft-capture", &child.wait_with_output().unwrap())
}

/// Asserts that every stream of a report of `check` or `recover` reaches to within [`LOSS`] of `end_ns`, whole.
fn assert_reaches(report: &Value, end_ns: i64, what: &str) {
    for topic in STREAMS {
        let entry = &report["topics"][topic];
        let last = entry["last_ns"]
            .as_i64()
            .unwrap_or_else(|| panic!("{what}: {topic}: {report}"));
        let lost = Duration::from_nanos(u64::try_from(end_ns - last).unwrap_or(0));
        assert!(lost <= LOSS, "{what}: {topic}: {lost:?} lost: {report}");
        assert_eq!(entry["missing_sequences"], 0, "{what}: {topic}: {report}");
    }
}

fn checked(folder: &Path, file: &str) -> Value {
    programs::run("ft-capture", &["check", file, "--json"], folder).json()
}

#[test]
fn killed_at_a_random_moment_it_gives_back_all_but_the_last_quarter_second() {
    let _alone = alone();
    for round in 0..ROUNDS {
        let folder = tempdir().unwrap();
        let mut command = capture(folder.path(), round);
        let mut capture = command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // Spread over 2.0 to 3.0 s, another place in the flush period each time.
        wait(Duration::from_millis(2000 + (round * 618) % 1000));
        let killed_at = unix_ns();
        capture.kill().unwrap();
        capture.wait().unwrap();
        let finished = programs::run(
            "ft-capture",
            &["recover", "a.mcap.partial", "--json"],
            folder.path(),
        );
        let report = finished.expect_code(3).json();
        assert_reaches(&report, killed_at, &format!("round {round}"));
        programs::run("ft-capture", &["check", "a.mcap"], folder.path()).expect_code(3);
    }
}

#[test]
fn told_to_stop_it_finishes_the_file_up_to_that_moment() {
    let _alone = alone();
    for (signal, seed) in [("TERM", 31), ("INT", 32)] {
        let folder = tempdir().unwrap();
        let capture = started(capture(folder.path(), seed));
        wait(Duration::from_millis(2500));
        let told_at = unix_ns();
        let mut kill = Command::new("sh");
        let sent = kill
            .args(["-c", &format!("kill -{signal} {}", capture.id())])
            .status();
        assert!(sent.unwrap().success());
        let finished = ended(capture);
        let took = Duration::from_nanos(u64::try_from(unix_ns() - told_at).unwrap());
        // 3 only when the machine was too busy for the simulated devices: the ledger says so.
        let lost = finished.stdout.contains("DATA WAS LOST");
        assert_eq!(
            finished.code,
            Some(if lost { 3 } else { 0 }),
            "{finished:?}"
        );
        assert!(took < Duration::from_secs(3), "{signal}: {took:?}");
        assert!(!folder.path().join("a.mcap.partial").exists(), "{signal}");
        let report = checked(folder.path(), "a.mcap");
        assert_eq!(report["is_complete"], true, "{report}");
        assert_eq!(report["damage"], serde_json::json!([]), "{report}");
        assert_reaches(&report, told_at, signal);
    }
}

/// The limit of a process's file size stands in for a full disk: the system writes what still fits and then refuses.
#[test]
fn a_full_disk_ends_it_with_everything_so_far_readable() {
    let _alone = alone();
    let folder = tempdir().unwrap();
    let inner = capture(folder.path(), 41);
    let mut shell = Command::new("sh");
    // 512-byte blocks: about two seconds of recording.
    shell
        .arg("-c")
        .arg("trap '' XFSZ; ulimit -f 600; exec \"$0\" \"$@\"");
    shell
        .arg(inner.get_program())
        .args(inner.get_args())
        .current_dir(folder.path())
        .stdin(Stdio::null());
    let finished = ended(started(shell)).expect_code(1);
    finished.complains(&["no space left", "ft-capture recover"]);
    let partial = folder.path().join("a.mcap.partial");
    // The last write that reached the file, on the clock of the stamps.
    let full_at = modified_ns(&partial);
    assert!(!folder.path().join("a.mcap").exists());
    let recovered = programs::run(
        "ft-capture",
        &["recover", "a.mcap.partial", "--json"],
        folder.path(),
    );
    let report = recovered.expect_code(3).json();
    assert_reaches(&report, full_at, "disk full");
    let messages = report["topics"]["/ft/wrench"]["messages"].as_u64().unwrap();
    assert!(messages > 200, "{report}");
}

#[test]
fn a_clock_that_is_set_moves_no_sample() {
    let _alone = alone();
    let folder = tempdir().unwrap();
    let library = folder.path().join("clock_step.so");
    let built = Command::new("cc")
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .arg(workspace_root().join("tests/peers/clock_step.c"))
        .status();
    assert!(
        built.unwrap().success(),
        "cc cannot build tests/peers/clock_step.c"
    );
    let log = folder.path().join("clock.log");
    // A busy machine may lose samples by itself, which the exit code 3 says: then once more.
    let run = || {
        let mut command = capture(folder.path(), 51);
        command
            .env("LD_PRELOAD", &library)
            .env("CLOCK_STEP_LOG", &log)
            .args(["--duration", "5s", "--force"]);
        let began_at = unix_ns();
        (began_at, ended(started(command)), unix_ns())
    };
    let (began_at, finished, ended_at) = (0..3)
        .map(|_| run())
        .find(|(_, finished, _)| finished.code != Some(3))
        .expect("samples are lost three times in a row: something else keeps this machine busy");
    assert_eq!(finished.code, Some(0), "{finished:?}");
    let asked = std::fs::read_to_string(&log).unwrap();
    println!(
        "the capture asked for the wall clock {} times (in all, after the first step)",
        asked.trim()
    );
    assert!(
        asked
            .split_whitespace()
            .next()
            .unwrap()
            .parse::<u64>()
            .unwrap()
            > 0,
        "the clock was never asked"
    );

    let report = checked(folder.path(), "a.mcap");
    let first = report["start_ns"].as_i64().unwrap();
    assert!(
        (began_at..ended_at).contains(&first),
        "begins at {first}, ran from {began_at} to {ended_at}"
    );
    let duration_s = report["duration_s"].as_f64().unwrap();
    assert!((4.0..5.1).contains(&duration_s), "{report}");
    for topic in STREAMS {
        let entry = &report["topics"][topic];
        // Raw frames are stamped by their arrival: a busy machine makes pauses there.
        let holes = (!topic.starts_with("/raw/")).then_some("holes");
        for what in ["out_of_order", "duplicates", "after_arrival"]
            .into_iter()
            .chain(holes)
        {
            assert_eq!(entry[what], 0, "{topic}: {what}: {report}");
        }
        assert!(
            entry["last_ns"].as_i64().unwrap() < ended_at,
            "{topic}: {report}"
        );
    }
}

#[test]
fn a_reader_sees_all_but_the_last_quarter_second_and_costs_the_writer_nothing() {
    let _alone = alone();
    let folder = tempdir().unwrap();
    let mut command = capture(folder.path(), 61);
    command.args(["--duration", "6s"]);
    let capture = started(command);
    let partial = folder.path().join("a.mcap.partial");
    let mut before = 0;
    for _ in 0..3 {
        wait(Duration::from_millis(1200));
        let asked_at = unix_ns();
        let report = checked(folder.path(), "a.mcap.partial");
        assert_eq!(report["is_complete"], false, "{report}");
        assert_reaches(&report, asked_at, "while writing");
        let read = Recording::load(&partial, &TopicMap::default())
            .unwrap()
            .wrench
            .len();
        assert!(read > before + 500, "{read} after {before}");
        before = read;
        // Recovery keeps its hands off what is being written.
        let refused = programs::run("ft-capture", &["recover", "a.mcap.partial"], folder.path());
        refused.expect_code(1).complains(&["being written"]);
    }
    let finished = ended(capture);
    assert!(matches!(finished.code, Some(0 | 3)), "{finished:?}");
    let report = checked(folder.path(), "a.mcap");
    assert_eq!(report["is_complete"], true, "{report}");
    assert_eq!(report["damage"], serde_json::json!([]), "{report}");
    for topic in STREAMS {
        assert_eq!(report["topics"][topic]["missing_sequences"], 0, "{report}");
    }
}

fn modified_ns(path: &PathBuf) -> i64 {
    let modified = std::fs::metadata(path).unwrap().modified().unwrap();
    nanos(modified)
}

fn nanos(at: std::time::SystemTime) -> i64 {
    let since = at.duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(since.as_nanos()).unwrap()
}

#[allow(
    clippy::disallowed_methods,
    reason = "the moment of the end, on the clock of the recording's stamps"
)]
fn unix_ns() -> i64 {
    nanos(std::time::SystemTime::now())
}

#[allow(clippy::disallowed_methods, reason = "an end comes when it comes")]
fn wait(time: Duration) {
    std::thread::sleep(time);
}
