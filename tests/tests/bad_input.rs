//! What is wrong is named, with where and what to do; the exit code says it, and nothing is lost.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::Path;

use ft_tests::programs;
use tempfile::tempdir;

fn capture(folder: &Path, arguments: &[&str]) -> programs::Finished {
    programs::run("ft-capture", arguments, folder)
}

fn identify(folder: &Path, arguments: &[&str]) -> programs::Finished {
    programs::run("ft-identify", arguments, folder)
}

fn write(folder: &Path, name: &str, text: &str) {
    std::fs::write(folder.join(name), text).unwrap();
}

const DEVICE: &str = "[[device]]\nname = \"ft_sensor\"\ndriver = \"bota_serial\"\n";

#[test]
fn an_unknown_scenario_is_answered_with_the_known_ones() {
    let folder = tempdir().unwrap();
    capture(folder.path(), &["--sim", "wooden_door"])
        .expect_code(2)
        .complains(&["wooden_door", "wood_door", "oven_door"]);
}

#[test]
fn wrong_arguments_are_refused_with_two() {
    let folder = tempdir().unwrap();
    capture(folder.path(), &["--sim", "--speed", "3"])
        .expect_code(2)
        .complains(&["max"]);
    capture(folder.path(), &["--speed", "max"]).expect_code(2);
    capture(folder.path(), &["--sim", "--duration", "soon"])
        .expect_code(2)
        .complains(&["--duration"]);
    identify(folder.path(), &["table"]).expect_code(2);
}

#[test]
fn no_configuration_points_to_the_simulation() {
    let folder = tempdir().unwrap();
    capture(folder.path(), &[])
        .expect_code(1)
        .complains(&["capture.toml", "--sim"]);
}

#[test]
fn an_unknown_key_is_named_with_its_line() {
    let folder = tempdir().unwrap();
    write(
        folder.path(),
        "capture.toml",
        &format!("{DEVICE}prot = \"/dev/ttyUSB0\"\n"),
    );
    capture(folder.path(), &[]).expect_code(1).complains(&[
        "capture.toml",
        "prot",
        "line 4",
        "port",
    ]);
    let settings =
        format!("{DEVICE}port = \"/dev/ttyUSB0\"\n[device.settings]\nbuad_bps = 460800\n");
    write(folder.path(), "capture.toml", &settings);
    capture(folder.path(), &[])
        .expect_code(1)
        .complains(&["ft_sensor", "buad_bps", "baud_bps"]);
}

#[test]
fn a_port_that_is_not_there_is_named() {
    let folder = tempdir().unwrap();
    write(
        folder.path(),
        "capture.toml",
        &format!("{DEVICE}port = \"/dev/ttyNOTHERE\"\n"),
    );
    capture(folder.path(), &["-o", "a.mcap"])
        .expect_code(1)
        .complains(&["ft_sensor", "/dev/ttyNOTHERE", "does not exist"]);
    assert!(!folder.path().join("a.mcap.partial").exists());
}

#[test]
fn a_folder_that_is_not_there_is_named() {
    let folder = tempdir().unwrap();
    capture(
        folder.path(),
        &["--sim", "--speed", "max", "-o", "nowhere/a.mcap"],
    )
    .expect_code(1)
    .complains(&["nowhere/a.mcap"]);
}

#[test]
fn a_full_disk_ends_with_a_reason_and_keeps_what_was_written() {
    let folder = tempdir().unwrap();
    // A limit on the file's size answers a write as a full disk does: with an error, not with a signal.
    let script = "trap '' XFSZ; ulimit -f 1500; exec \"$0\" --sim --speed max -o a.mcap";
    let output = std::process::Command::new("bash")
        .args(["-c", script])
        .arg(programs::folder().join("ft-capture"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    let finished = programs::Finished::new("ft-capture", &output).expect_code(1);
    finished.complains(&["a.mcap.partial", "no space", "recover"]);
    let recovered = capture(folder.path(), &["recover", "a.mcap.partial", "--json"])
        .expect_code(3)
        .json();
    let wrenches = recovered["topics"]["/ft/wrench"]["messages"]
        .as_u64()
        .unwrap();
    assert!(wrenches > 1000, "{recovered}");

    // The copy does not fit either: the leftover stays as it is, and is what the message names.
    let before = std::fs::read(folder.path().join("a.mcap.partial")).unwrap();
    let script = "trap '' XFSZ; ulimit -f 300; exec \"$0\" recover a.mcap.partial -o b.mcap";
    let output = std::process::Command::new("bash")
        .args(["-c", script])
        .arg(programs::folder().join("ft-capture"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    let finished = programs::Finished::new("ft-capture", &output).expect_code(1);
    finished.complains(&["no space left for b.mcap", "a.mcap.partial is unchanged"]);
    assert!(
        !finished.stderr.contains("recovering"),
        "{}",
        finished.stderr
    );
    let names: Vec<_> = std::fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert!(
        !names
            .iter()
            .any(|name| name.to_string_lossy().starts_with("b.mcap")),
        "{names:?}"
    );
    assert_eq!(
        std::fs::read(folder.path().join("a.mcap.partial")).unwrap(),
        before
    );
}

#[test]
fn a_second_process_cannot_write_the_same_recording() {
    let folder = tempdir().unwrap();
    let first = programs::command(
        "ft-capture",
        &["--sim", "-o", "a.mcap", "--duration", "20s"],
        folder.path(),
    )
    .stdout(std::process::Stdio::null())
    .stderr(std::process::Stdio::null())
    .spawn();
    let mut first = first.unwrap();
    let partial = folder.path().join("a.mcap.partial");
    for _ in 0..500 {
        if partial.metadata().is_ok_and(|metadata| metadata.len() > 0) {
            break;
        }
        wait(std::time::Duration::from_millis(20));
    }
    let second = capture(
        folder.path(),
        &[
            "--sim",
            "--speed",
            "max",
            "--duration",
            "5s",
            "-o",
            "a.mcap",
            "--force",
        ],
    );
    // A reader does not disturb the writer, and sees a recording that is not finished.
    let check = capture(folder.path(), &["check", "a.mcap.partial"]);
    first.kill().unwrap();
    first.wait().unwrap();
    second
        .expect_code(1)
        .complains(&["is being written by another process"]);
    assert!(matches!(check.code, Some(3)), "{}", check.stdout);
}

#[test]
fn a_foreign_file_is_named() {
    let folder = tempdir().unwrap();
    write(folder.path(), "notes.mcap", "these are notes");
    capture(folder.path(), &["check", "notes.mcap"])
        .expect_code(1)
        .complains(&["notes.mcap", "MCAP"]);
    identify(folder.path(), &["notes.mcap", "-o", "out"])
        .expect_code(1)
        .complains(&["notes.mcap", "MCAP"]);
    identify(folder.path(), &["nothing.mcap", "-o", "out"])
        .expect_code(1)
        .complains(&["nothing.mcap"]);
}

#[test]
fn what_is_read_is_never_written_over_and_what_is_wrong_is_said() {
    let folder = tempdir().unwrap();
    let arguments = [
        "--sim",
        "--speed",
        "max",
        "--duration",
        "10s",
        "-o",
        "a.mcap",
    ];
    capture(folder.path(), &arguments).expect_code(0);
    std::fs::create_dir(folder.path().join("dir")).unwrap();
    let bytes = || std::fs::read(folder.path().join("a.mcap")).unwrap();
    let before = bytes();
    let refused = |arguments: &[&str], wanted: &[&str]| {
        capture(folder.path(), arguments)
            .expect_code(1)
            .complains(wanted);
        assert!(bytes() == before, "{arguments:?} changed its source");
    };
    let is_source = ["a.mcap is the recording that is read"];
    refused(&["replay", "a.mcap", "-o", "a.mcap", "--force"], &is_source);
    refused(
        &["replay", "./a.mcap", "-o", "dir/../a.mcap", "--force"],
        &["is the recording that is read"],
    );
    refused(
        &["recover", "a.mcap", "-o", "a.mcap", "--force"],
        &is_source,
    );
    refused(
        &["calibrate", "a.mcap", "-o", "a.mcap", "--force"],
        &is_source,
    );
    refused(
        &[
            "import-aria",
            "a.mcap",
            "--mps",
            "dir",
            "-o",
            "a.mcap",
            "--force",
        ],
        &is_source,
    );
    refused(
        &["calibrate", "a.mcap", "-o", "dir", "--force"],
        &["dir is a folder"],
    );
    refused(
        &["calibrate", "a.mcap", "--free-air", "90..95"],
        &["--free-air says 90.0 to 95.0 s", "the wrench lasts"],
    );
    refused(
        &["import-aria", "a.mcap", "--mps", "nope", "-o", "b.mcap"],
        &["cannot find nope: No such file"],
    );
    refused(
        &[
            "import-aria",
            "a.mcap",
            "--mps",
            "dir",
            "--frames",
            "nope.toml",
            "-o",
            "b.mcap",
        ],
        &["--frames nope.toml: No such file"],
    );
}

#[test]
fn a_truncated_recording_is_read_to_its_end_and_recovered() {
    let folder = tempdir().unwrap();
    capture(
        folder.path(),
        &[
            "--sim",
            "--speed",
            "max",
            "--duration",
            "10s",
            "-o",
            "a.mcap",
        ],
    )
    .expect_code(0);
    let bytes = std::fs::read(folder.path().join("a.mcap")).unwrap();
    std::fs::write(folder.path().join("cut.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    capture(folder.path(), &["check", "cut.mcap"]).expect_code(3);
    identify(folder.path(), &["cut.mcap", "-o", "out"])
        .expect_code(1)
        .complains(&[
            "cut.mcap: ",
            "held",
            "the file is damaged",
            "ft-capture check",
        ]);
    capture(folder.path(), &["recover", "cut.mcap"])
        .expect_code(1)
        .complains(&["-o"]);
    capture(folder.path(), &["recover", "cut.mcap", "-o", "saved.mcap"]).expect_code(3);
    capture(folder.path(), &["recover", "cut.mcap", "-o", "saved.mcap"])
        .expect_code(1)
        .complains(&["saved.mcap"]);
    assert_eq!(
        std::fs::read(folder.path().join("cut.mcap")).unwrap().len(),
        bytes.len() / 2
    );
}

#[test]
fn a_recording_that_ends_before_the_grasp_is_no_recording_of_a_joint() {
    let folder = tempdir().unwrap();
    capture(
        folder.path(),
        &[
            "--sim",
            "--speed",
            "max",
            "--duration",
            "5s",
            "-o",
            "a.mcap",
        ],
    )
    .expect_code(0);
    identify(folder.path(), &["a.mcap", "-o", "out"])
        .expect_code(1)
        .complains(&["a.mcap", "held"]);
}

#[test]
fn tables_with_mistakes_are_named_by_row_and_column() {
    let folder = tempdir().unwrap();
    let table = |text: &str| {
        write(folder.path(), "t.csv", text);
        let arguments = [
            "table",
            "t.csv",
            "--time",
            "t",
            "--position",
            "q",
            "--effort",
            "f",
            "--kind",
            "prismatic",
            "-o",
            "out",
        ];
        identify(folder.path(), &arguments).expect_code(1)
    };
    table("t,q\n0,0\n").complains(&["t.csv", "`f`", "t, q"]);
    table("t,q,f\n0,0,1\n0.1,zero,1\n").complains(&["t.csv", "row", "zero", "`q`"]);
    table("t,q,f\n0,0,1\n0.1,NaN,1\n").complains(&["t.csv", "row", "NaN", "`q`"]);
    table("t,q,f\n0,0,1\n0.2,0,1\n0.1,0,1\n").complains(&[
        "t.csv",
        "row 4",
        "0.1 s does not come after 0.2 s",
    ]);
    table("t,q,f\n0,0,1\n0.1,0,1\n").complains(&["t.csv", "2 rows", "at least"]);
}

#[test]
fn a_recording_that_was_stopped_in_free_air_holds_no_joint() {
    let folder = tempdir().unwrap();
    let mut capture = programs::command(
        "ft-capture",
        &["--sim", "-o", "a.mcap", "--listen", "tcp/127.0.0.1:17459"],
        folder.path(),
    );
    let capture = capture
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // Free air is marked at 2 s, the grasp at 10 s.
    wait(std::time::Duration::from_secs(5));
    let id = capture.id().to_string();
    std::process::Command::new("kill")
        .args(["-INT", &id])
        .status()
        .unwrap();
    capture.wait_with_output().unwrap();
    identify(folder.path(), &["a.mcap", "-o", "out"])
        .expect_code(1)
        .complains(&["a.mcap", "nothing was held", "grasp"]);
}

#[test]
fn a_reader_that_has_gone_is_no_error() {
    let folder = tempdir().unwrap();
    let script = "set -o pipefail; \"$0\" --help | head -1 > /dev/null; \"$0\" devices | true";
    let output = std::process::Command::new("bash")
        .args(["-c", script])
        .arg(programs::folder().join("ft-capture"))
        .current_dir(folder.path())
        .output()
        .unwrap();
    let finished = programs::Finished::new("ft-capture", &output);
    assert!(!finished.stderr.contains("panicked"), "{}", finished.stderr);
}

#[allow(
    clippy::disallowed_methods,
    reason = "a person stops a recording after a while"
)]
fn wait(time: std::time::Duration) {
    std::thread::sleep(time);
}

#[test]
fn a_recording_of_another_joint_or_the_same_recording_confirms_nothing() {
    let folder = tempdir().unwrap();
    for (scenario, file) in [("drawer_light", "drawer.mcap"), ("wood_door", "door.mcap")] {
        let _ = ft_tests::truth::record(scenario, 5, &folder.path().join(file));
    }
    for (confirm, why) in [
        ("drawer.mcap", "it is the same recording"),
        (
            "door.mcap",
            "it shows a revolute joint, the other recording a prismatic one",
        ),
    ] {
        let arguments = ["drawer.mcap", "--confirm", confirm, "-o", "twin"];
        identify(folder.path(), &arguments)
            .expect_code(1)
            .complains(&[confirm, "cannot confirm anything", why]);
        assert!(!folder.path().join("twin").exists());
    }
}

#[test]
fn a_damaged_recording_confirms_as_far_as_it_goes_and_is_told() {
    let folder = tempdir().unwrap();
    for (seed, file) in [(5, "drawer.mcap"), (6, "other.mcap")] {
        let _ = ft_tests::truth::record("drawer_light", seed, &folder.path().join(file));
    }
    let bytes = std::fs::read(folder.path().join("other.mcap")).unwrap();
    let most = bytes.len() * 4 / 5;
    std::fs::write(folder.path().join("cut.mcap"), &bytes[..most]).unwrap();
    let arguments = ["drawer.mcap", "--confirm", "cut.mcap", "-o", "twin"];
    let out = identify(folder.path(), &arguments).expect_code(3);
    assert!(
        out.stdout.contains("the file is damaged: cut.mcap: "),
        "{}",
        out.stdout
    );
}
