//! Devices that are not what was expected, or leave while they are recorded. `ft-sim-hw serve` plays them in a process of
//! its own, so that they can be unplugged.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

use ft_tests::programs;
use tempfile::tempdir;

/// A simulated gripper in another process; dropping it unplugs all its devices at once.
struct Gripper {
    process: Child,
    ports: Vec<(String, PathBuf)>,
    /// Names of the devices in the test's own folder.
    links: Vec<PathBuf>,
}

impl Gripper {
    fn plug_in(scenario: &str, folder: &Path) -> Self {
        let mut command = programs::command("ft-sim-hw", &["serve", scenario], folder);
        let mut process = command
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stdout.take().unwrap()).lines();
        let (mut ports, mut links) = (Vec::new(), Vec::new());
        while ports.len() < 3 {
            let line = lines.next().unwrap().unwrap();
            let words: Vec<_> = line.split_whitespace().collect();
            if let [name, _driver, port, ..] = words[..]
                && port.starts_with("/dev/")
            {
                // Another process may get the pseudo-terminal of a device that left: its link leaves first.
                let link = folder.join(format!("plugged_{name}"));
                std::os::unix::fs::symlink(port, &link).unwrap();
                ports.push((name.to_owned(), link.clone()));
                links.push(link);
            }
        }
        // The pipe stays open, or the process would end at its next line.
        std::thread::spawn(move || lines.for_each(drop));
        Self {
            process,
            ports,
            links,
        }
    }

    fn port(&self, name: &str) -> &str {
        let found = self.ports.iter().find(|(known, _)| known == name).unwrap();
        found.1.to_str().unwrap()
    }
}

impl Drop for Gripper {
    fn drop(&mut self) {
        // In a test that fails already nothing here may panic.
        let _ = self.process.kill();
        let _ = self.process.wait();
        for link in &self.links {
            let _ = std::fs::remove_file(link);
        }
    }
}

fn configure(folder: &Path, gripper: &Gripper, baud_bps: u32) {
    let text = format!(
        "[[device]]\nname = \"ft_sensor\"\ndriver = \"bota_serial\"\nport = \"{}\"\n\
         [device.settings]\nbaud_bps = {baud_bps}\n\
         [[device]]\nname = \"aria\"\ndriver = \"pose_stream\"\nport = \"{}\"\n",
        gripper.port("ft_sensor"),
        gripper.port("aria")
    );
    std::fs::write(folder.join("capture.toml"), text).unwrap();
}

#[test]
fn devices_that_leave_are_reported_and_what_they_said_is_kept() {
    let folder = tempdir().unwrap();
    let gripper = Gripper::plug_in("wood_door", folder.path());
    configure(folder.path(), &gripper, 460_800);
    let arguments = [
        "--duration",
        "6s",
        "-o",
        "a.mcap",
        "--json",
        "--listen",
        "tcp/127.0.0.1:17451",
    ];
    let mut capture = programs::command("ft-capture", &arguments, folder.path());
    let capture = capture
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait(3000);
    drop(gripper);
    let output = capture.wait_with_output().unwrap();
    let finished = programs::Finished::new("ft-capture", &output).expect_code(3);
    finished.complains(&["ft_sensor: lost", "aria: lost", "gone"]);
    let summary = finished.json();
    for stream in summary["streams"].as_array().unwrap() {
        assert_eq!(stream["state"], "lost", "{summary}");
        assert_eq!(stream["interruptions"], 1, "{summary}");
        assert!(stream["received"].as_u64().unwrap() > 1000, "{summary}");
    }
    let report = programs::run("ft-capture", &["check", "a.mcap", "--json"], folder.path())
        .expect_code(3)
        .json();
    assert_eq!(
        report["topics"]["/ft/wrench"]["messages"],
        summary["streams"][0]["received"]
    );
}

#[test]
fn a_device_that_is_plugged_in_later_is_recorded_from_then_on() {
    let folder = tempdir().unwrap();
    let mut gripper = Gripper::plug_in("wood_door", folder.path());
    let (name, there) = gripper.ports[0].clone();
    assert_eq!(name, "ft_sensor");
    // Its name is not there yet.
    let later = folder.path().join("sensor");
    gripper.ports[0].1 = later.clone();
    configure(folder.path(), &gripper, 460_800);
    let arguments = ["-o", "a.mcap", "--json", "--listen", "tcp/127.0.0.1:17456"];
    let mut capture = programs::command("ft-capture", &arguments, folder.path());
    let log = folder.path().join("log.txt");
    let capture = capture
        .stdout(Stdio::piped())
        .stderr(std::fs::File::create(&log).unwrap())
        .spawn()
        .unwrap();
    let said = || std::fs::read_to_string(&log).unwrap();
    wait_for(said, || said().contains("ft_sensor: not open"));
    std::os::unix::fs::symlink(there, later).unwrap();
    let least = [("/ft/wrench", 500), ("/aria/pose", 4000)];
    let recorded = || {
        let check = ["check", "a.mcap.partial", "--json"];
        let report = programs::run("ft-capture", &check, folder.path());
        let report = serde_json::from_str(&report.stdout).unwrap_or(serde_json::Value::Null);
        least.map(|(topic, _)| report["topics"][topic]["messages"].as_u64().unwrap_or(0))
    };
    wait_for(said, || {
        let mut recorded = recorded().into_iter().zip(least);
        recorded.all(|(count, (_, least))| count > least)
    });
    let finished = programs::end("ft-capture", capture);
    let summary = finished.json();
    let streams = summary["streams"].as_array().unwrap();
    for (stream, (_, least)) in streams.iter().zip(least) {
        assert_eq!(stream["state"], "streaming", "{summary}");
        assert!(stream["received"].as_u64().unwrap() > least, "{summary}");
    }
    // A device that this machine does not play for half a second is lost for so long, and that is told.
    let whole = streams.iter().all(|stream| stream["interruptions"] == 0);
    let finished = finished.expect_code(if whole { 0 } else { 3 });
    let finished = programs::Finished {
        stderr: said(),
        ..finished
    };
    finished.complains(&["ft_sensor: not open", "does not exist", "as soon as"]);
    let report = programs::run("ft-capture", &["check", "a.mcap", "--json"], folder.path()).json();
    let device = &report["devices"]["ft_sensor: bota_serial"];
    assert_eq!(device["settings.rate_hz"], "800.0", "{device}");
    assert_eq!(
        device["serial_number"],
        streams[0]["identity"]["serial_number"]
    );
}

#[test]
fn nothing_is_recorded_where_no_device_is_there() {
    let folder = tempdir().unwrap();
    let mut gripper = Gripper::plug_in("wood_door", folder.path());
    for (name, port) in &mut gripper.ports {
        *port = folder.path().join(&*name);
    }
    configure(folder.path(), &gripper, 460_800);
    let arguments = [
        "--duration",
        "6s",
        "-o",
        "a.mcap",
        "--listen",
        "tcp/127.0.0.1:17462",
    ];
    programs::run("ft-capture", &arguments, folder.path())
        .expect_code(1)
        .complains(&[
            "no device can be opened: ft_sensor: ",
            "; aria: ",
            "does not exist: check the cable",
        ]);
    for file in ["a.mcap", "a.mcap.partial"] {
        assert!(!folder.path().join(file).exists(), "{file}");
    }
}

#[test]
fn a_wrong_bit_rate_ends_with_what_to_check() {
    let folder = tempdir().unwrap();
    let gripper = Gripper::plug_in("wood_door", folder.path());
    configure(folder.path(), &gripper, 230_400);
    let arguments = [
        "--duration",
        "6s",
        "-o",
        "a.mcap",
        "--listen",
        "tcp/127.0.0.1:17452",
    ];
    let finished = programs::run("ft-capture", &arguments, folder.path()).expect_code(3);
    finished.complains(&["ft_sensor: lost", "check the bit rate"]);
    assert!(
        finished.stdout.contains("never delivered a sample"),
        "{}",
        finished.stdout
    );
}

#[test]
fn a_port_that_another_program_holds_is_busy() {
    let folder = tempdir().unwrap();
    let gripper = Gripper::plug_in("wood_door", folder.path());
    configure(folder.path(), &gripper, 460_800);
    let arguments = [
        "--duration",
        "4s",
        "-o",
        "a.mcap",
        "--listen",
        "tcp/127.0.0.1:17453",
    ];
    let mut first = programs::command("ft-capture", &arguments, folder.path());
    let mut first = first
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    wait(1500);
    let arguments = [
        "--duration",
        "1s",
        "-o",
        "b.mcap",
        "--listen",
        "tcp/127.0.0.1:17454",
    ];
    programs::run("ft-capture", &arguments, folder.path())
        .expect_code(1)
        .complains(&["ft_sensor", gripper.port("ft_sensor"), "busy"]);
    assert!(!folder.path().join("b.mcap.partial").exists());
    assert_eq!(
        first.wait().unwrap().code(),
        Some(0),
        "the first capture was disturbed"
    );
}

#[test]
fn ctrl_c_finishes_the_file() {
    let folder = tempdir().unwrap();
    for (signal, name) in [("-INT", "a.mcap"), ("-TERM", "b.mcap")] {
        let arguments = ["--sim", "-o", name, "--listen", "tcp/127.0.0.1:17455"];
        let mut capture = programs::command("ft-capture", &arguments, folder.path());
        let capture = capture
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        wait(2500);
        let id = capture.id().to_string();
        assert!(
            std::process::Command::new("kill")
                .args([signal, &id])
                .status()
                .unwrap()
                .success()
        );
        programs::Finished::new("ft-capture", &capture.wait_with_output().unwrap()).expect_code(0);
        programs::run("ft-capture", &["check", name], folder.path()).expect_code(0);
    }
}

/// Waits until `holds`, at most a minute; then it fails with what was `said`.
fn wait_for(said: impl Fn() -> String, mut holds: impl FnMut() -> bool) {
    for _ in 0..600 {
        if holds() {
            return;
        }
        wait(100);
    }
    panic!("not within a minute: {}", said());
}

#[allow(
    clippy::disallowed_methods,
    reason = "devices are unplugged when it pleases a person"
)]
fn wait(milliseconds: u64) {
    std::thread::sleep(std::time::Duration::from_millis(milliseconds));
}
