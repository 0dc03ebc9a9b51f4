//! A recording in the layout of the public Hoi! dataset comes back to the same joint and parameters. Everything is simulated;
//! the layout is written by `peers/write_hoi.py`, which shares no code with the importer.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use ft_capture::import::hoi::{HoiCalibration, HoiReport, import_part, parts};
use ft_identify::batch::{BatchRow, Outcome};
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::{Identified, identify_recording};
use ft_recording::{Pose7, Recording, TopicMap, TrackedFrame};
use ft_tests::truth::{compare, record};
use ft_tests::{programs, workspace_root};

/// Writes what the script takes; `false` when there is no Python.
fn write_tree(recording: &Path, base: &Path, name: (&str, &str), zip: bool) -> bool {
    let more = if zip { &["zip"][..] } else { &[] };
    write_tree_as(recording, base, name, more)
}

/// As [`write_tree`], with more words for the script.
fn write_tree_as(recording: &Path, base: &Path, name: (&str, &str), more: &[&str]) -> bool {
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
        .args([name.0, name.1])
        .args(more);
    match script.status() {
        Ok(status) => {
            assert!(status.success());
            true
        }
        Err(error) => {
            let required = std::env::var_os("FT_REQUIRE_PEERS").is_some();
            assert!(!required, "the Hoi! layout: python3: {error}");
            println!("skipped: the Hoi! layout: python3: {error}");
            false
        }
    }
}

fn import(base: &Path, out: &Path) -> HoiReport {
    let found = parts(base).unwrap().parts;
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

/// Two crystals that differ by 20 ppm put poses and wrench of such a recording 1.3 ms apart at its end; no free air there shows it.
#[test]
fn clocks_that_drift_apart_leave_the_parameters_within_their_intervals() {
    let folder = tempfile::tempdir().unwrap();
    let original = folder.path().join("original.mcap");
    // Another seed by `FT_SEED`.
    let seed = std::env::var("FT_SEED").map_or(35, |text| text.parse().unwrap());
    let truth = record("drawer_loaded", seed, &original);
    for ppm in [20, -20] {
        let base = folder.path().join(format!("hoi{ppm}"));
        let slow = format!("ppm={ppm}");
        if !write_tree_as(&original, &base, ("kitchen", "1-3"), &[&slow]) {
            return;
        }
        let out = folder.path().join(format!("imported{ppm}.mcap"));
        let report = import(&base, &out);
        println!("simulated, {ppm:+} ppm: {report}");
        let found = compare("drawer_loaded", seed, &out, &truth);
        println!(
            "simulated, {ppm:+} ppm: inertia, Coulomb, viscous off by {:.4?}, in standard deviations {:.2?}",
            found.relative, found.sigmas
        );
        assert!(found.kind_is_right && found.axis_deg < 0.5, "{found:?}");
        for (name, sigmas) in ["inertia", "coulomb", "viscous"].iter().zip(found.sigmas) {
            let sigmas = sigmas.unwrap_or(f64::NAN);
            assert!(sigmas.abs() < 2.0, "{ppm} ppm, {name}: {sigmas}");
        }
    }
}

#[test]
fn a_tree_of_another_style_is_the_same_recording() {
    let folder = tempfile::tempdir().unwrap();
    let original = folder.path().join("original.mcap");
    let _ = record("drawer_light", 34, &original);
    let (plain, other) = (folder.path().join("plain"), folder.path().join("other"));
    if !write_tree(&original, &plain, ("bath", "4-4"), false) {
        return;
    }
    let script = workspace_root().join("tests/peers/restyle_hoi.py");
    let names = ["bath", "4-4", "living_room_2", "10-12"];
    let mut restyle = Command::new("python3");
    let status = restyle.arg(script).args([&plain, &other]).args(names);
    assert!(status.status().unwrap().success());
    let [a, b] = [("a.mcap", &plain), ("b.mcap", &other)].map(|(name, base)| {
        let out = folder.path().join(name);
        let report = import(base, &out);
        (report, Recording::load(&out, &TopicMap::default()).unwrap())
    });
    println!("simulated: {}", b.0);
    assert_eq!(
        (a.0.name.as_str(), b.0.name.as_str()),
        ("bath_4-4", "living_room_2_10-12")
    );
    assert_eq!((a.0.left_out, b.0.left_out), (0, 2));
    assert_eq!(a.1.wrench, b.1.wrench);
    assert_eq!(a.1.pose, b.1.pose);
    assert_eq!(a.1.calibration, b.1.calibration);
    for (a, b) in [
        (&a.1.aria_device_from_tcp, &b.1.aria_device_from_tcp),
        (&a.1.tcp_from_ft_sensor, &b.1.tcp_from_ft_sensor),
    ] {
        let apart = a.inverse().then(b).position;
        assert!(apart.iter().all(|m| m.abs() < 1e-9), "{apart:?}");
    }
    // The temperature is in the first tree only, the sensor's gyroscope in the second.
    let lacks =
        |report: &HoiReport, what: &str| report.missing.iter().any(|text| text.contains(what));
    assert!(!lacks(&a.0, "temperature/data.csv") && lacks(&b.0, "temperature/data.csv"));
    assert!(lacks(&a.0, "imu/data.csv") && !lacks(&b.0, "imu/data.csv"));

    // The second tree's gyroscope says that the alignment by the tool's weight is right, to within one of its samples.
    assert_eq!(a.0.gyro_check, None);
    let check = b.0.gyro_check.unwrap();
    assert!(
        check.offset_ms.abs() < 2.0 && check.explained > 0.9,
        "{check:?}"
    );

    // From inside the tree, by a path without a name.
    let inside = other.join("extracted/living_room_2/gripper/gripper");
    programs::run(
        "ft-capture",
        &["import-hoi", ".", "-o", "../c.mcap"],
        &inside,
    )
    .expect_code(0);
    assert!(inside.join("../c.mcap").is_file());
    // A zip that was cut short is named.
    let zip = inside.join("living_room_2_10-12_gripper_bag/force_torque.zip");
    let bytes = std::fs::read(&zip).unwrap();
    std::fs::write(&zip, &bytes[..bytes.len() / 2]).unwrap();
    let out = folder.path().join("d.mcap");
    let text = import_part(&parts(&other).unwrap().parts[0], &out, false)
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("force_torque.zip") && text.contains("cut short"),
        "{text}"
    );
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
    let part = &parts(&bag).unwrap().parts[0];
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
fn a_batch_of_fifty_survives_bad_files_a_kill_and_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = folder.path().join("recordings");
    std::fs::create_dir_all(recordings.join("kitchen")).unwrap();
    let good = recordings.join("kitchen/drawer.mcap");
    let _ = record("drawer_light", 33, &good);
    // Fifty files: four recordings, torn copies of them, and files that are no recordings at all.
    let bytes = std::fs::read(&good).unwrap();
    for k in 0..3 {
        std::fs::copy(&good, recordings.join(format!("z{k}.mcap"))).unwrap();
    }
    for k in 0..46_usize {
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
    let results = folder.path().join("results");
    let note = |name: &str| results.join(name).join("batch.json");
    let arguments = ["--batch", "recordings", "-o", "results", "--jobs", "1"];

    // Killed when all but the last three are done, in the middle of one of these.
    let mut batch = programs::command("ft-identify", &arguments, folder.path());
    let silent = std::process::Stdio::null;
    let mut batch = batch.stdout(silent()).stderr(silent()).spawn().unwrap();
    while !note("torn45").exists() {
        assert!(batch.try_wait().unwrap().is_none(), "ended before its end");
        pause();
    }
    batch.kill().unwrap();
    batch.wait().unwrap();
    assert!(!note("z2").exists());
    // What is done is in the table already.
    let table = std::fs::read_to_string(results.join("summary.csv")).unwrap();
    assert!(
        table.contains("\"torn40\"") && !table.contains("\"z2\""),
        "{table}"
    );
    let written = |name: &str| std::fs::metadata(note(name)).unwrap().modified().unwrap();
    let before = ["kitchen/drawer", "torn00", "torn01", "torn02"].map(written);

    // Meanwhile one result was lost half-way, and one file replaced.
    std::fs::write(note("torn00"), "{\"name\": \"torn").unwrap();
    std::fs::write(recordings.join("torn01.mcap"), b"something else").unwrap();
    // What the system refuses is a failure now, and is tried again: a folder stands where a report is to be written.
    let in_the_way = results.join("z1/report.json");
    std::fs::create_dir_all(&in_the_way).unwrap();
    programs::run("ft-identify", &arguments, folder.path()).expect_code(1);
    let table = std::fs::read_to_string(results.join("summary.csv")).unwrap();
    let failed = |line: &str| line.starts_with("\"z1\",failed,") && line.contains("cannot write");
    assert!(table.lines().any(failed), "{table}");
    assert!(!note("z1").exists());
    std::fs::remove_dir(&in_the_way).unwrap();
    programs::run("ft-identify", &arguments, folder.path()).expect_code(1);
    let after = ["kitchen/drawer", "torn00", "torn01", "torn02"].map(written);
    let again = [0, 1, 2, 3].map(|k| after[k] != before[k]);
    assert_eq!(again, [false, true, true, false], "what was done again");
    let text = std::fs::read_to_string(results.join("summary.json")).unwrap();
    let rows: Vec<BatchRow> = serde_json::from_str(&text).unwrap();
    assert_eq!(rows.len(), 50);
    for row in &rows {
        let is_good = row.name.starts_with('z') || row.name == "kitchen/drawer";
        let wanted = if is_good {
            Outcome::Identified
        } else {
            Outcome::Failed
        };
        assert_eq!(row.outcome, wanted, "{}: {:?}", row.name, row.reason);
        assert_eq!(row.reason.is_none(), is_good, "{}", row.name);
        assert_eq!(
            row.inertia,
            if is_good { rows[0].inertia } else { None },
            "{}",
            row.name
        );
    }
    assert!(results.join("z2/report.json").is_file());
    let table = std::fs::read_to_string(results.join("summary.csv")).unwrap();
    assert_eq!(table.lines().count(), 51);
}

#[allow(clippy::disallowed_methods, reason = "another process is waited for")]
fn pause() {
    std::thread::sleep(std::time::Duration::from_millis(20));
}
