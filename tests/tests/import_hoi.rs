//! A recording in the layout of the public Hoi! dataset comes back to the same joint and parameters. Everything is simulated;
//! the layout is written by `peers/write_hoi.py`, which shares no code with the importer.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use ft_capture::import::hoi::{HoiCalibration, HoiReport, import_part, parts};
use ft_identify::batch::{self, BatchOptions, Outcome};
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::{Identified, identify_recording};
use ft_recording::{Pose7, Recording, TopicMap, TrackedFrame};
use ft_tests::truth::record;
use ft_tests::workspace_root;

/// Writes what the script takes; `false` when there is no Python.
fn write_tree(recording: &Path, base: &Path, name: (&str, &str), zip: bool) -> bool {
    let loaded = Recording::load(recording, &TopicMap::default()).unwrap();
    assert_eq!(loaded.pose.frame, TrackedFrame::AriaDevice);
    let scratch = tempfile::tempdir().unwrap();
    let (mut wrench, mut poses) = (String::new(), String::new());
    for sample in &loaded.wrench {
        let values = sample.value.map(|value| value.to_string()).join(" ");
        writeln!(wrench, "{} {values}", sample.at.as_nanos()).unwrap();
    }
    let line = |pose: &Pose7| {
        let numbers = pose.position.iter().chain(&pose.quaternion);
        numbers.map(f64::to_string).collect::<Vec<_>>().join(" ")
    };
    for sample in &loaded.pose.samples {
        writeln!(poses, "{} {}", sample.at.as_nanos(), line(&sample.value)).unwrap();
    }
    let frames = format!(
        "{}\n{}\n",
        line(&loaded.aria_device_from_tcp),
        line(&loaded.tcp_from_ft_sensor)
    );
    for (file, text) in [
        ("wrench.txt", wrench),
        ("pose.txt", poses),
        ("frames.txt", frames),
    ] {
        std::fs::write(scratch.path().join(file), text).unwrap();
    }
    let mut script = Command::new("python3");
    script
        .arg(workspace_root().join("tests/peers/write_hoi.py"))
        .args([scratch.path(), base])
        .args([name.0, name.1]);
    if zip {
        script.arg("zip");
    }
    match script.status() {
        Ok(status) => {
            assert!(status.success());
            true
        }
        Err(error) => {
            println!("skipped: the Hoi! layout: python3: {error}");
            false
        }
    }
}

fn import(base: &Path, out: &Path) -> HoiReport {
    let found = parts(base).unwrap();
    assert_eq!(found.len(), 1, "{found:?}");
    import_part(&found[0], out, false).unwrap()
}

fn identified(path: &Path) -> Identified {
    let settings = MotionSettings::default();
    identify_recording(path, &TopicMap::default(), &settings, &mut |_| {})
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

#[test]
fn a_zipped_tree_comes_back_to_the_same_joint_and_parameters() {
    let folder = tempfile::tempdir().unwrap();
    let original = folder.path().join("original.mcap");
    let _ = record("drawer_loaded", 31, &original);
    let base = folder.path().join("hoi");
    if !write_tree(&original, &base, ("kitchen", "1-3"), true) {
        return;
    }
    let out = folder.path().join("imported.mcap");
    let report = import(&base, &out);
    println!("simulated: {report}");
    assert!(
        matches!(report.calibration, HoiCalibration::FreeAir { .. }),
        "{report}"
    );
    // The script leaves 3.2 ms between the clocks.
    let offset_ms = 1e3 * report.alignment.unwrap().offset_s;
    assert!((offset_ms + 3.2).abs() < 1.0, "{offset_ms} ms");
    assert!(
        report
            .missing
            .iter()
            .any(|text| text.starts_with("dynamixel_workbench")),
        "{report}"
    );

    let (before, after) = (identified(&original), identified(&out));
    let (a, b) = (before.axis.as_ref().unwrap(), after.axis.as_ref().unwrap());
    assert_eq!(a.kind, b.kind);
    let turned_deg = a.direction.angle(&b.direction).to_degrees();
    assert!(turned_deg.min(180.0 - turned_deg) < 0.2, "{turned_deg} deg");
    for (name, allowed) in [("inertia", 0.03), ("coulomb", 0.05), ("viscous", 0.10)] {
        let value =
            |identified: &Identified| identified.report.term(name).and_then(|term| term.value);
        let (a, b) = (value(&before).unwrap(), value(&after).unwrap());
        println!("simulated: {name} of the original {a:.4}, of the imported {b:.4}");
        assert!((b / a - 1.0).abs() < allowed, "{name}: {a} and {b}");
    }
}

#[test]
fn what_a_tree_lacks_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let text = parts(folder.path()).unwrap_err().to_string();
    assert!(
        text.contains("_gripper_bag") && text.contains("extracted"),
        "{text}"
    );
    let original = folder.path().join("original.mcap");
    let _ = record("drawer_light", 32, &original);
    let base = folder.path().join("hoi");
    if !write_tree(&original, &base, ("bath", "4-4"), false) {
        return;
    }
    let gripper = base.join("extracted/bath/gripper");
    let bag = gripper.join("gripper/bath_4-4_gripper_bag");
    let vrs = gripper.join("aria_gripper/bath_4-4_gripper_vrs");
    let out = folder.path().join("out.mcap");
    let part = &parts(&bag).unwrap()[0];
    assert_eq!(part.name, "bath_4-4");
    let refusal = |path: PathBuf, wanted: &str| {
        let aside = folder.path().join("aside");
        std::fs::rename(&path, &aside).unwrap();
        let text = import_part(part, &out, false).unwrap_err().to_string();
        assert!(text.contains(wanted), "{text}");
        assert!(!out.exists());
        std::fs::rename(&aside, &path).unwrap();
    };
    refusal(
        bag.join("force_torque"),
        "no force_torque/ft_sensor0/ft_sensor_readings/wrench/data.csv of bath_4-4",
    );
    refusal(vrs.join("slam"), "no slam/closed_loop_trajectory/data.csv");
    refusal(bag.join("calib/gripper-imu.yaml"), "no calib/*imu.yaml");
    refusal(
        bag.join("calib/gripper-camchain.yaml"),
        "no calib/*camchain.yaml",
    );
    refusal(vrs.join("calib"), "no calib/calib.json");
    let report = import_part(part, &out, false).unwrap();
    assert_eq!(report.samples[1], report.counts.rows);
}

#[test]
fn a_batch_survives_a_bad_file_and_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("recordings");
    std::fs::create_dir_all(recordings.join("kitchen")).unwrap();
    let good = recordings.join("kitchen/drawer.mcap");
    let _ = record("drawer_light", 33, &good);
    // Fifty files: one recording, its torn copies, and files that are no recordings at all.
    let bytes = std::fs::read(&good).unwrap();
    for k in 0..49_usize {
        let length = if k % 2 == 0 {
            10 * k
        } else {
            bytes.len() / 60 * (k % 7)
        };
        std::fs::write(
            recordings.join(format!("torn{k:02}.mcap")),
            &bytes[..length],
        )
        .unwrap();
    }
    let output = folder.path().join("results");
    let options = BatchOptions {
        jobs: 2,
        again: false,
        map: TopicMap::default(),
        settings: MotionSettings::default(),
    };
    let old = std::sync::atomic::AtomicUsize::new(0);
    let count = |_: &batch::BatchRow, is_old: bool| {
        old.fetch_add(usize::from(is_old), std::sync::atomic::Ordering::Relaxed);
    };
    let rows = batch::run(&recordings, &output, &options, &count).unwrap();
    assert_eq!(
        (rows.len(), old.load(std::sync::atomic::Ordering::Relaxed)),
        (50, 0)
    );
    assert_eq!(
        (rows[0].name.as_str(), rows[0].outcome),
        ("kitchen/drawer", Outcome::Identified)
    );
    assert!(
        rows[1..]
            .iter()
            .all(|row| row.outcome == Outcome::Failed && row.reason.is_some())
    );
    assert!(output.join("kitchen/drawer/report.json").is_file());
    let table = std::fs::read_to_string(output.join("summary.csv")).unwrap();
    assert_eq!(table.lines().count(), 51);

    // Begun again after the first result was lost half-way, and a file was replaced.
    std::fs::write(output.join("torn00/batch.json"), "{\"name\": \"torn").unwrap();
    std::fs::write(recordings.join("torn01.mcap"), b"something else").unwrap();
    let again = batch::run(&recordings, &output, &options, &count).unwrap();
    assert_eq!(old.load(std::sync::atomic::Ordering::Relaxed), 48);
    assert_eq!(again[0], rows[0]);
}
