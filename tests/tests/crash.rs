//! A capture that is killed loses at most a quarter of a second.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::process::Stdio;
use std::time::Duration;

use ft_tests::programs;
use tempfile::tempdir;

const ROUNDS: u64 = 20;
/// What a crash may cost each stream.
const LOSS: Duration = Duration::from_millis(250);

#[test]
fn killed_at_a_random_moment_it_gives_back_all_but_the_last_quarter_second() {
    let folder = tempdir().unwrap();
    for round in 0..ROUNDS {
        let name = format!("r{round}.mcap");
        let endpoint = "tcp/127.0.0.1:17448";
        let arguments = [
            "--sim",
            "--speed",
            "1",
            "-o",
            &name,
            "--listen",
            endpoint,
            "--seed",
            &round.to_string(),
        ];
        let mut command = programs::command("ft-capture", &arguments, folder.path());
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

        let partial = format!("{name}.partial");
        let finished = programs::run(
            "ft-capture",
            &["recover", &partial, "--json"],
            folder.path(),
        );
        let report = finished.expect_code(3).json();
        for topic in ["/ft/wrench", "/aria/pose", "/raw/ft_sensor"] {
            let entry = &report["topics"][topic];
            let last = entry["last_ns"].as_i64().unwrap();
            let lost = Duration::from_nanos(u64::try_from(killed_at - last).unwrap_or(0));
            assert!(
                lost <= LOSS,
                "round {round}: {topic}: {lost:?} lost: {report}"
            );
            assert_eq!(
                entry["missing_sequences"], 0,
                "round {round}: {topic}: {report}"
            );
        }
        programs::run("ft-capture", &["check", &name], folder.path()).expect_code(3);
    }
}

#[allow(
    clippy::disallowed_methods,
    reason = "the moment of the crash, on the clock of the recording's stamps"
)]
fn unix_ns() -> i64 {
    let since = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap();
    i64::try_from(since.as_nanos()).unwrap()
}

#[allow(clippy::disallowed_methods, reason = "a crash comes when it comes")]
fn wait(time: Duration) {
    std::thread::sleep(time);
}
