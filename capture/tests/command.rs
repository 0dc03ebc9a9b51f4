//! What the programs say about themselves, and how they end.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};
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
fn every_subcommand_shows_examples_of_its_own() {
    for name in [
        "devices",
        "init",
        "check",
        "recover",
        "replay",
        "keys",
        "calibrate",
        "import-aria",
        "import-hoi",
        "import-csv",
        "import-bag",
    ] {
        let help = capture(&[name, "--help"]);
        let text = String::from_utf8_lossy(&help.stdout);
        assert_eq!(help.status.code(), Some(0), "{name}");
        assert!(text.contains("Examples"), "{name}: {text}");
        assert!(
            text.contains(&format!("  ft-capture {name} ")),
            "{name}: {text}"
        );
    }
}

#[test]
fn the_commands_that_keys_prints_are_those_of_the_port_that_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    for (name, more, port) in [("a", &[][..], 7447), ("b", &["--port", "7500"], 7500)] {
        let keys = folder.path().join(name);
        let keys = keys.to_str().unwrap();
        let output = capture(&[&["keys", "-o", keys, "--host", "192.168.0.7"], more].concat());
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(0), "{text}");
        for wanted in ["tls/0.0.0.0:", "tls/192.168.0.7:"] {
            assert!(text.contains(&format!("{wanted}{port}")), "{text}");
        }
    }
}

#[test]
fn init_writes_no_file_where_nothing_is_plugged_in() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("capture.toml");
    let listed = String::from_utf8(capture(&["devices"]).stdout).unwrap();
    let absent = listed.starts_with("no serial port");
    let output = capture(&["init", "-o", file.to_str().unwrap()]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(i32::from(absent)), "{told}");
    assert_eq!(file.exists(), !absent);
    assert_eq!(told.contains("nothing is plugged in"), absent, "{told}");
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

fn said(output: &Output) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (text(&output.stdout), text(&output.stderr))
}

/// A measured hand-held recording of others: wrench and motion capture at 120 Hz, no times.
#[test]
fn the_handover_baton_converts_by_one_command_and_its_repeated_poses_are_found() {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let data = std::env::var_os("FT_DATA").map_or_else(beside, PathBuf::from);
    let baton = data.join("kth_handover_baton");
    if !baton.is_dir() {
        println!("skipped: {} is not there (set FT_DATA)", baton.display());
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (wrench, pose) = (
        baton.join("Wrench_interaction_saved.csv"),
        baton.join("baton_pose_saved.csv"),
    );
    let out = folder.path().join("baton.mcap");
    let [wrench, pose, out] = [&wrench, &pose, &out].map(|path| path.to_str().unwrap());
    let arguments = [
        "import-csv",
        "--wrench",
        wrench,
        "--pose",
        pose,
        "--rate",
        "120",
        "-o",
        out,
    ];
    let output = capture(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output).1);
    assert!(
        said(&output).0.contains("801 wrenches, 801 poses"),
        "{}",
        said(&output).0
    );
    let again = capture(&arguments);
    assert_eq!(again.status.code(), Some(1));
    assert!(said(&again).1.contains("exists"), "{}", said(&again).1);

    let rows: Vec<String> = std::fs::read_to_string(pose)
        .unwrap()
        .lines()
        .skip(1)
        .map(str::to_owned)
        .collect();
    let repeated = rows.windows(2).filter(|pair| pair[0] == pair[1]).count();
    let share = 100.0 * repeated as f64 / (rows.len() - 1) as f64;
    assert!((share - 9.5).abs() < 0.2, "{share} %");
    let checked = capture(&["check", out, "--json"]);
    assert_eq!(checked.status.code(), Some(0), "{}", said(&checked).0);
    let report: serde_json::Value = serde_json::from_slice(&checked.stdout).unwrap();
    let topic = &report["topics"]["/tcp/pose"];
    assert_eq!(
        (&topic["messages"], &topic["repeated_values"]),
        (&801.into(), &repeated.into())
    );
    assert!(
        (topic["rate_hz"].as_f64().unwrap() - 120.0).abs() < 0.01,
        "{topic}"
    );
    for what in ["holes", "out_of_order", "duplicates"] {
        assert_eq!(topic[what], 0, "{topic}");
    }
    assert!(
        report["topics"]["/ft/wrench"]["repeated_values"]
            .as_u64()
            .unwrap()
            < 10,
        "{report}"
    );
    let table = said(&capture(&["check", out])).0;
    let row = table
        .lines()
        .find(|line| line.trim_start().starts_with("/tcp/pose"))
        .unwrap();
    assert!(
        row.split_whitespace()
            .any(|cell| cell == repeated.to_string()),
        "{table}"
    );
}

#[test]
fn tables_are_read_by_their_column_of_time_and_what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(
        path("w.csv"),
        "us,a,b,c,d,e,f\n1000000,1,2,3,4,5,6\n1000500.5,1,2,3,4,5,7\n",
    )
    .unwrap();
    std::fs::write(
        path("p.csv"),
        "us,x,y,z,qx,qy,qz,qw\n1000000,0,0,1,0,0,0,2\n1001000,0,0,1,0,0,0,0\n",
    )
    .unwrap();
    let (wrench, pose, out) = (path("w.csv"), path("p.csv"), path("a.mcap"));
    let import = |more: &[&str]| {
        let mut arguments = vec![
            "import-csv",
            "--wrench",
            &wrench,
            "--pose",
            &pose,
            "-o",
            &out,
            "--force",
        ];
        arguments.extend(more);
        capture(&arguments)
    };
    let good = [
        "--time",
        "us",
        "--time-unit",
        "us",
        "--wrench-columns",
        "a,b,c,d,e,f",
        "--negate",
    ];
    let output = import(&good);
    assert_eq!(output.status.code(), Some(0), "{}", said(&output).1);
    assert!(
        said(&output)
            .0
            .contains("2 wrenches, 1 poses, 1 poses left out (a field is empty, missing or not finite, or the quaternion is none)"),
        "{}",
        said(&output).0
    );
    let recording =
        ft_recording::Recording::load(Path::new(&out), &ft_recording::TopicMap::default()).unwrap();
    let stamps: Vec<_> = recording
        .wrench
        .iter()
        .map(|sample| sample.at.as_nanos())
        .collect();
    assert_eq!(stamps, [1_000_000_000, 1_000_500_500]);
    assert_eq!(
        recording.wrench[0].value,
        [-1.0, -2.0, -3.0, -4.0, -5.0, -6.0]
    );
    assert_eq!(
        recording.pose.samples[0].value.quaternion,
        [0.0, 0.0, 0.0, 1.0]
    );
    for (arguments, code, wanted) in [
        (&["--rate", "100"][..], 1, "no column Fx"),
        (&["--rate", "0"][..], 2, "0.1 to 100000"),
        (&[][..], 2, "--rate"),
        (
            &["--time", "t", "--wrench-columns", "a,b,c,d,e,f"][..],
            1,
            "no column t",
        ),
        (
            &["--time", "us", "--wrench-columns", "a,b"][..],
            1,
            "2 names, expected 6",
        ),
    ] {
        let output = import(arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}");
        assert!(
            said(&output).1.contains(wanted),
            "{arguments:?}: {}",
            said(&output).1
        );
    }
}

/// 200 wrenches and poses in s from 100 s on, and `import-csv` of them after `change` was made to the wrench's rows.
fn csv_of(folder: &Path, change: impl Fn(&mut Vec<String>), more: &[&str]) -> Output {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let time = |k: u32| 100.0 + 0.01 * f64::from(k);
    let mut rows: Vec<String> = (0..200)
        .map(|k| format!("{:.2},{},1,-4,0.1,0.2,0.3", time(k), k % 5))
        .collect();
    change(&mut rows);
    let wrench = format!("t,Fx,Fy,Fz,Tx,Ty,Tz\n{}\n", rows.join("\n"));
    std::fs::write(path("w.csv"), wrench).unwrap();
    let poses: String = (0..200)
        .map(|k| format!("{:.2},0,0,1,0,0,0,1\n", time(k)))
        .collect();
    std::fs::write(path("p.csv"), format!("t,x,y,z,qx,qy,qz,qw\n{poses}")).unwrap();
    let [wrench, pose, out] = ["w.csv", "p.csv", "a.mcap"].map(path);
    let fixed = [
        "import-csv",
        "--wrench",
        &wrench,
        "--pose",
        &pose,
        "--time",
        "t",
    ];
    let mut arguments = fixed.to_vec();
    arguments.extend(["-o", &out, "--force"]);
    arguments.extend(more);
    capture(&arguments)
}

#[test]
fn rows_of_a_table_with_wrong_stamps_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let stamped = |rows: &mut Vec<String>, row: usize, stamp: &str| {
        let (_, rest) = rows[row].split_once(',').unwrap();
        rows[row] = format!("{stamp},{rest}");
    };
    for (stamp, told) in [
        ("-1", "1 stamped before 1970 or after 2096"),
        ("0", "1 stamped at another time"),
        ("1000000000", "1 stamped at another time"),
        ("700", "1 stamped at another time"),
        ("100.49", "1 not later than the one before"),
    ] {
        let output = csv_of(folder.path(), |rows| stamped(rows, 50, stamp), &[]);
        let (out, error) = said(&output);
        assert_eq!(output.status.code(), Some(0), "{out}{error}");
        assert!(out.contains("199 wrenches") && out.contains(told), "{out}");
        let recording = folder.path().join("a.mcap");
        let recording =
            ft_recording::Recording::load(&recording, &ft_recording::TopicMap::default()).unwrap();
        let (first, last) = (&recording.wrench[0], &recording.wrench[198]);
        assert!((last.at.seconds_since(first.at) - 1.99).abs() < 1e-6);
    }
    let turned = csv_of(folder.path(), |rows| rows.reverse(), &[]);
    assert!(
        said(&turned).0.contains("199 wrenches put in order"),
        "{:?}",
        said(&turned)
    );
    // A clock that was set back by half a second is data lost, however little.
    let set_back = |rows: &mut Vec<String>| {
        for row in 150..200 {
            stamped(rows, row, &format!("{}", 100.0 + 0.01 * row as f64 - 0.503));
        }
    };
    let output = csv_of(folder.path(), set_back, &[]);
    assert_eq!(output.status.code(), Some(3), "{:?}", said(&output));
    assert!(
        said(&output).0.contains("50 by a clock that was set back"),
        "{:?}",
        said(&output)
    );
    let most = csv_of(
        folder.path(),
        |rows| (0..150).for_each(|row| stamped(rows, row, "-1")),
        &[],
    );
    assert_eq!(most.status.code(), Some(3), "{:?}", said(&most));
    let none = csv_of(
        folder.path(),
        |rows| (0..200).for_each(|row| stamped(rows, row, "-1")),
        &[],
    );
    assert_eq!(none.status.code(), Some(1));
    assert!(
        said(&none).1.contains("200 stamped before 1970"),
        "{:?}",
        said(&none)
    );
}

#[test]
fn a_table_takes_frames_and_a_calibration_from_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let pose =
        |z: f64| format!("position_m = [0.0, 0.0, {z}]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\n");
    let frames = format!(
        "[frames.aria_device_from_tcp]\n{}[frames.tcp_from_ft_sensor]\n{}",
        pose(0.2),
        pose(-0.1)
    );
    let calibration = "[calibration]\npayload_mass_kg = {value = 0.5, std = 0.01}\n\
                       payload_com_m = {value = [0.0, 0.0, 0.06], std = [0.001, 0.001, 0.001]}\n\
                       payload_inertia_kgm2 = {value = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], std = [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]}\n";
    // Both in one file, as `calibrate --find-rotation --toml` writes it.
    let both = path("both.toml");
    std::fs::write(&both, format!("{calibration}{frames}")).unwrap();
    let output = csv_of(
        folder.path(),
        |_| {},
        &["--frames", &both, "--calibration", &both],
    );
    assert_eq!(output.status.code(), Some(0), "{:?}", said(&output));
    let recording = ft_recording::Recording::load(
        Path::new(&path("a.mcap")),
        &ft_recording::TopicMap::default(),
    )
    .unwrap();
    assert_eq!(recording.tcp_from_ft_sensor.position, [0.0, 0.0, -0.1]);
    let mass = recording.calibration.unwrap().payload_mass_kg.value;
    assert!((mass - 0.5).abs() < 1e-12);
    // The poses are the tool's: where it is on the glasses need not be said, and nothing is made up of it.
    let sensor = path("sensor.toml");
    std::fs::write(
        &sensor,
        format!("[frames.tcp_from_ft_sensor]\n{}", pose(0.3)),
    )
    .unwrap();
    let output = csv_of(folder.path(), |_| {}, &["--frames", &sensor]);
    assert_eq!(output.status.code(), Some(0), "{:?}", said(&output));
    let (recording, known) = ft_recording::Recording::load_without_pose(
        Path::new(&path("a.mcap")),
        &ft_recording::TopicMap::default(),
    )
    .unwrap();
    assert_eq!(recording.tcp_from_ft_sensor.position, [0.0, 0.0, 0.3]);
    assert_eq!(known.aria_device_from_tcp, None);
    // Where the sensor is must be.
    std::fs::write(
        &sensor,
        format!("[frames.aria_device_from_tcp]\n{}", pose(0.3)),
    )
    .unwrap();
    let output = csv_of(folder.path(), |_| {}, &["--frames", &sensor]);
    assert_eq!(output.status.code(), Some(1));
    let wanted = "--frames has no [frames.tcp_from_ft_sensor]";
    assert!(said(&output).1.contains(wanted), "{:?}", said(&output));
    std::fs::write(&both, &frames).unwrap();
    let output = csv_of(folder.path(), |_| {}, &["--calibration", &both]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said(&output).1.contains("there is no [calibration]"),
        "{:?}",
        said(&output)
    );
    // What is no number is a wrong argument.
    for (option, value) in [
        ("--min-quality", "nan"),
        ("--min-quality", "7"),
        ("--starts-at", "nan"),
        ("--starts-at", "inf"),
    ] {
        let output = capture(&["import-aria", "a", "--mps", "b", "-o", "c", option, value]);
        assert_eq!(output.status.code(), Some(2), "{option} {value}");
        assert!(
            said(&output).1.contains("a number from"),
            "{:?}",
            said(&output)
        );
    }
}

#[test]
fn arguments_that_cannot_be_are_told_from_work_that_failed() {
    for arguments in [
        &["--sim", "nosuch"][..],
        &["--sim", "--duration", "1s"],
        &["--sim", "--speed", "max", "--duration", "1s"],
        &["--sim", "--vcan", "nocan"],
        &["--sim", "--speed", "max", "--vcan", "nocan"],
        &["check", "a.mcap", "--map", "foo"],
        &["calibrate", "a.mcap", "--map", "foo"],
    ] {
        let output = capture(arguments);
        assert_eq!(
            output.status.code(),
            Some(2),
            "{arguments:?}: {:?}",
            said(&output)
        );
    }
}

#[test]
fn a_replay_keeps_what_was_found_after_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let recorded = path("a.mcap");
    let arguments = ["--sim", "--speed", "max", "--duration", "12s", "-o"];
    let output = capture(&[&arguments[..], &[recorded.to_str().unwrap()]].concat());
    assert!(recorded.exists(), "{:?}", said(&output));
    let map = ft_recording::TopicMap::default();
    let before = ft_recording::Recording::load(&recorded, &map).unwrap();
    let zero = |std| ft_recording::Estimate {
        value: [0.0; 6],
        std: [std; 6],
    };
    let calibration = ft_recording::Calibration {
        payload_mass_kg: ft_recording::Estimate {
            value: 0.321,
            std: 0.01,
        },
        payload_com_m: ft_recording::Estimate {
            value: [0.0; 3],
            std: [0.01; 3],
        },
        payload_inertia_kgm2: zero(0.001),
        wrench_bias: Some(zero(0.1)),
        covariance: None,
    };
    let sensor = ft_recording::Pose7::normalised([0.0, 0.0, 0.123], [0.0, 0.0, 0.0, 1.0]).unwrap();
    let mut rewrite = ft_recording::rewrite::Rewrite::new();
    rewrite.metadata("ft.calibration", calibration.to_metadata().unwrap());
    rewrite.set_frame("tcp", "ft_sensor", sensor, &map, before.wrench[0].at);
    rewrite
        .write(Some(&recorded), &path("b.mcap"), false)
        .unwrap();
    ft_capture::session::replay::replay(&path("b.mcap"), &path("c.mcap"), false).unwrap();
    let replayed = ft_recording::Recording::load(&path("c.mcap"), &map).unwrap();
    assert_eq!(replayed.calibration, Some(calibration));
    assert_eq!(replayed.tcp_from_ft_sensor, sensor);
    assert_eq!(replayed.aria_device_from_tcp, before.aria_device_from_tcp);
}
