//! The command: exit codes, what goes to which stream, and messages for wrong input.
#![allow(clippy::unwrap_used)]

use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ft-identify"))
        .args(arguments)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn table(directory: &std::path::Path, rows: impl Iterator<Item = [f64; 3]>) -> String {
    let path = directory.join("axis.csv");
    let mut content = "t,q,f\n".to_owned();
    for [t, q, f] in rows {
        content += &format!("{t},{q},{f}\n");
    }
    std::fs::write(&path, content).unwrap();
    path.to_str().unwrap().to_owned()
}

/// A slide of 2 kg, 1.5 N, 3 N s/m, pushed to and fro ever faster.
fn slide() -> impl Iterator<Item = [f64; 3]> {
    (0..12000).map(|i| {
        let t = 0.0025 * f64::from(i);
        let (phi, d1, d2) = (0.5 * t + 0.06 * t * t, 0.5 + 0.12 * t, 0.12);
        let (dq, ddq) = (
            0.15 * phi.sin() * d1,
            0.15 * (phi.cos() * d1 * d1 + phi.sin() * d2),
        );
        [
            t,
            0.15 * (1.0 - phi.cos()),
            2.0 * ddq + 1.5 * dq.signum() + 3.0 * dq + 0.01 * (f64::from(i) * 2.39).sin(),
        ]
    })
}

#[test]
fn a_table_gives_parameters_and_three_files() {
    let directory = tempfile::tempdir().unwrap();
    let file = table(directory.path(), slide());
    let out = directory.path().join("out");
    let output = out.to_str().unwrap();
    let columns = [
        "--time",
        "t",
        "--position",
        "q",
        "--effort",
        "f",
        "--kind",
        "prismatic",
    ];
    let done = run(&[&["table", &file, "-o", output], &columns[..]].concat());
    assert_eq!(done.status.code(), Some(0), "{}", text(&done.stderr));
    assert!(
        text(&done.stdout).contains("inertia    2.0"),
        "{}",
        text(&done.stdout)
    );
    for name in ["report.json", "report.html", "twin.json"] {
        assert!(out.join(name).exists());
    }
    let again = [&["table", &file, "-o", output, "--json"], &columns[..]].concat();
    let refused = run(&again);
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        text(&refused.stderr).contains("report.json exists: choose another directory with -o"),
        "{}",
        text(&refused.stderr)
    );
    let done = run(&[&again[..], &["--force"]].concat());
    let report: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(report["joint"]["kind"], "prismatic");
}

#[test]
fn the_papers_estimator_stands_beside_ours_when_asked_for() {
    let directory = tempfile::tempdir().unwrap();
    let file = table(directory.path(), slide());
    let output = directory.path().join("out").display().to_string();
    let arguments = [
        "table",
        &file,
        "--time",
        "t",
        "--position",
        "q",
        "--effort",
        "f",
        "--kind",
        "prismatic",
        "-o",
        &output,
    ];
    let plain = run(&[&arguments[..], &["--json"]].concat());
    let report: serde_json::Value = serde_json::from_slice(&plain.stdout).unwrap();
    assert!(report.get("paper").is_none());
    let both = run(&[
        &arguments[..],
        &["--json", "--force", "--estimator", "paper"],
    ]
    .concat());
    let report: serde_json::Value = serde_json::from_slice(&both.stdout).unwrap();
    let paper = &report["paper"];
    assert_eq!(paper["mechanism"], "mlp");
    assert!(paper["epochs"].as_u64().unwrap() > 100, "{paper}");
    assert_eq!(paper["terms"][0]["name"], "inertia");
    assert!(paper["terms"][0]["value"].as_f64().unwrap() > 0.0);
    assert!(paper["mechanism_rms"].as_f64().unwrap() <= paper["rms"].as_f64().unwrap());
}

#[test]
fn a_reader_that_has_gone_makes_no_panic() {
    use std::io::Write as _;
    // The track comes from standard input, so that the reader is gone before anything is printed.
    let mut child = Command::new(env!("CARGO_BIN_EXE_ft-identify"))
        .args(["track", "/dev/stdin", "--json"])
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let mut track = child.stdin.take().unwrap();
    for i in 0..120 {
        let a = 0.01 * f64::from(i);
        let noise = 1e-3 * (a * 91.0).sin();
        writeln!(track, "{} {} {noise}", 0.5 * a.cos(), 0.5 * a.sin()).unwrap();
    }
    drop(track);
    let done = child.wait_with_output().unwrap();
    assert!(
        !text(&done.stderr).contains("panicked"),
        "{}",
        text(&done.stderr)
    );
}

#[test]
fn wrong_arguments_end_with_2_and_wrong_input_with_1() {
    assert_eq!(run(&[]).status.code(), Some(2));
    assert_eq!(run(&["x.mcap"]).status.code(), Some(2), "-o is needed");
    assert_eq!(
        run(&["table", "x.csv", "--kind", "helical"]).status.code(),
        Some(2)
    );
    for more in [
        ["--map", "foo"],
        ["--cutoff-hz", "0"],
        ["--cutoff-hz", "nan"],
        ["--cutoff-hz", "inf"],
        ["--jobs", "2"],
    ] {
        let done = run(&[&["/nonexistent/x.mcap", "-o", "/tmp/never"], &more[..]].concat());
        assert_eq!(done.status.code(), Some(2), "{more:?}");
    }
    let missing = run(&["/nonexistent/x.mcap", "-o", "/tmp/never"]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(
        text(&missing.stderr).starts_with("ft-identify: ") && missing.stdout.is_empty(),
        "{}",
        text(&missing.stderr)
    );
    let directory = tempfile::tempdir().unwrap();
    let foreign = directory.path().join("foreign.mcap");
    std::fs::write(&foreign, b"this is not a recording").unwrap();
    assert_eq!(
        run(&[foreign.to_str().unwrap(), "-o", "/tmp/never"])
            .status
            .code(),
        Some(1)
    );
}

#[test]
fn a_table_does_not_confirm_itself() {
    let directory = tempfile::tempdir().unwrap();
    let file = table(directory.path(), slide());
    let copy = directory.path().join("copy.csv");
    std::fs::copy(&file, &copy).unwrap();
    let out = directory.path().join("out");
    let columns = ["--time", "t", "--position", "q", "--effort", "f"];
    let rest = ["--kind", "prismatic", "-o", out.to_str().unwrap()];
    for other in [&file, copy.to_str().unwrap()] {
        let confirm = ["--confirm", other];
        let done = run(&[&["table", &file], &columns[..], &rest, &confirm].concat());
        assert_eq!(done.status.code(), Some(1));
        let said = text(&done.stderr);
        assert!(said.contains("it is the same recording"), "{said}");
    }
    assert!(!out.exists());
}

#[test]
fn other_units_in_a_table_are_doubted_and_no_error() {
    let directory = tempfile::tempdir().unwrap();
    let file = table(directory.path(), slide().map(|[t, q, f]| [t, 1e3 * q, f]));
    let out = directory.path().join("out");
    let columns = ["--time", "t", "--position", "q", "--effort", "f"];
    let rest = ["--kind", "prismatic", "-o", out.to_str().unwrap()];
    let done = run(&[&["table", &file], &columns[..], &rest].concat());
    let said = text(&done.stderr);
    assert_eq!(done.status.code(), Some(0), "{said}");
    let report = std::fs::read_to_string(out.join("report.json")).unwrap();
    for said in [said, report] {
        assert!(
            said.contains("doubtful: positions reach over 300 m"),
            "{said}"
        );
    }
}

#[test]
fn numbers_out_of_range_are_wrong_arguments() {
    let directory = tempfile::tempdir().unwrap();
    let file = table(directory.path(), slide());
    let out = directory.path().join("out");
    let columns = ["--time", "t", "--position", "q", "--effort", "f"];
    let rest = ["--kind", "prismatic", "-o", out.to_str().unwrap()];
    for cutoff in ["200.1", "1e6"] {
        let cutoff = ["--cutoff-hz", cutoff];
        let done = run(&[&["table", &file], &columns[..], &rest, &cutoff].concat());
        let said = text(&done.stderr);
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.contains("half the rate of 400 Hz"), "{said}");
    }
    let recipe = [
        "--lowpass-hz",
        "50",
        "--lowpass-order",
        "4",
        "--decimate",
        "10",
    ];
    let nothing_left = [&recipe[..], &["--drop-border", "99999"]].concat();
    for (wrong, why) in [
        (&["--cutoff-hz", "-3"][..], "not a number above 0"),
        (&nothing_left, "--drop-border 99999 leaves none of"),
    ] {
        let done = run(&[&["table", &file], &columns[..], &rest, wrong].concat());
        let said = text(&done.stderr);
        assert_eq!(done.status.code(), Some(2), "{said}");
        assert!(said.contains(why), "{said}");
    }
    assert!(!out.exists());
}

#[test]
fn a_batch_of_which_one_fails_has_failed() {
    let directory = tempfile::tempdir().unwrap();
    let (recordings, out) = (directory.path().join("in"), directory.path().join("out"));
    std::fs::create_dir_all(&recordings).unwrap();
    std::fs::write(recordings.join("a.mcap"), b"no recording").unwrap();
    let [recordings, out] = [&recordings, &out].map(|path| path.to_str().unwrap());
    let done = run(&["--batch", recordings, "-o", out]);
    assert_eq!(done.status.code(), Some(1));
    assert!(text(&done.stdout).contains("1 failed"));
}

#[test]
fn a_table_without_the_column_lists_those_there() {
    let directory = tempfile::tempdir().unwrap();
    let file = table(directory.path(), slide().take(200));
    let done = run(&[
        "table",
        &file,
        "--time",
        "t",
        "--position",
        "angle",
        "--effort",
        "f",
        "--kind",
        "revolute",
        "-o",
        "x",
    ]);
    assert_eq!(done.status.code(), Some(1));
    assert!(
        text(&done.stderr).contains("no column `angle`; there are: t, q, f"),
        "{}",
        text(&done.stderr)
    );
}

#[test]
fn a_track_prints_kind_and_size() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("track.txt");
    let line = |i: i32| {
        let a = 0.01 * f64::from(i);
        format!(
            "{} {} {}\n",
            0.5 * a.cos() + 1e-3 * (a * 91.0).sin(),
            0.5 * a.sin(),
            1e-3 * (a * 77.0).cos()
        )
    };
    std::fs::write(&path, (0..120).map(line).collect::<String>()).unwrap();
    let done = run(&["track", path.to_str().unwrap()]);
    assert_eq!(done.status.code(), Some(0), "{}", text(&done.stderr));
    assert!(
        text(&done.stdout).contains("revolute   r   0.5"),
        "{}",
        text(&done.stdout)
    );
    let out = directory.path().join("out");
    let done = run(&[
        "track",
        path.to_str().unwrap(),
        "--json",
        "-o",
        out.to_str().unwrap(),
    ]);
    let found: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(found[0]["joint"]["kind"], "revolute");
    assert!(out.join("joint.json").exists());
}

#[test]
fn tracks_that_fail_or_are_not_one_joint_are_named_and_stop_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let written = |name: &str, line: &dyn Fn(f64) -> [f64; 3]| {
        let path = directory.path().join(name);
        let lines = (0..200).map(|i| {
            let [x, y, z] = line(0.01 * f64::from(i));
            format!("{x} {y} {z}\n")
        });
        std::fs::write(&path, lines.collect::<String>()).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let noise = |a: f64| 1e-3 * (a * 91.0).sin();
    let hinge = written("hinge.log", &|a| [0.5 * a.cos(), 0.5 * a.sin(), noise(a)]);
    let knot = written("knot.log", &|a| {
        [(3.0 * a).sin(), (4.1 * a).sin(), (5.3 * a).cos()]
    });
    let bad = directory.path().join("bad.log");
    std::fs::write(&bad, "1 2\n").unwrap();
    let bad = bad.to_str().unwrap();
    let out = directory.path().join("out");
    let output = ["-o", out.to_str().unwrap(), "--force"];
    for (tracks, code) in [
        (&[bad, &hinge, &knot][..], 1),
        (&[&knot, bad, &hinge], 1),
        (&[&knot, &hinge], 3),
        (&[&hinge], 0),
    ] {
        let done = run(&[&["track"], tracks, &output].concat());
        let said = text(&done.stderr);
        assert_eq!(done.status.code(), Some(code), "{said}");
        assert_eq!(said.contains("bad.log: line 1"), code == 1, "{said}");
        let doubt = text(&done.stdout).contains("not one joint: the best one is");
        assert_eq!(doubt, tracks.contains(&knot.as_str()));
        let found: serde_json::Value =
            serde_json::from_slice(&std::fs::read(out.join("joint.json")).unwrap()).unwrap();
        for entry in found.as_array().unwrap() {
            assert_eq!(entry["one_joint"], entry["file"] == "hinge.log");
        }
    }
}

/// The directory with the twin of the slide.
fn identified_slide(directory: &std::path::Path) -> std::path::PathBuf {
    let (file, out) = (table(directory, slide()), directory.join("out"));
    let columns = ["--time", "t", "--position", "q", "--effort", "f"];
    let rest = ["--kind", "prismatic", "-o", out.to_str().unwrap()];
    let done = run(&[&["table", &file], &columns[..], &rest[..]].concat());
    assert_eq!(done.status.code(), Some(0), "{}", text(&done.stderr));
    out
}

#[test]
fn a_twin_is_let_go_exported_and_compared() {
    let directory = tempfile::tempdir().unwrap();
    let out = identified_slide(directory.path());
    let twin = out.join("twin.json");
    let twin = twin.to_str().unwrap();
    let said = |arguments: &[&str], code: i32| {
        let done = run(arguments);
        assert_eq!(done.status.code(), Some(code), "{}", text(&done.stderr));
        text(&done.stdout) + &text(&done.stderr)
    };
    let swing = said(&["simulate", twin, "--release", "200mm"], 0);
    assert!(
        swing.contains("stays at 0.200 m: dry friction holds it"),
        "{swing}"
    );
    assert!(
        said(&["simulate", twin, "--release", "20deg"], 2)
            .contains("give a number with mm or cm or m")
    );
    assert!(said(&["simulate", twin, "--release", "9m"], 1).contains("outside the range"));
    let opening = said(
        &[
            "simulate", twin, "--open", "200mm", "--within", "2", "--limit", "1",
        ],
        0,
    );
    assert!(
        opening.contains("to 0.200 m within 2 s takes up to")
            && opening.contains(
                "1 N are not enough: more is needed from 0.000 m on; nor are they however slowly"
            ),
        "{opening}"
    );
    assert!(
        said(&["simulate", twin, "--open", "200mm", "--limit", "90"], 0)
            .contains("90 N are enough")
    );
    for more in [&[][..], &["--limit", "90"], &["--json"]] {
        let beyond = [&["simulate", twin, "--open", "9m"], more].concat();
        let told = said(&beyond, 1);
        assert!(
            told.contains("9.000 m lies outside the range") && !told.contains("takes up to"),
            "{told}"
        );
    }
    assert_eq!(run(&["simulate", twin]).status.code(), Some(2));
    for more in [["--limit", "5"], ["--within", "2"]] {
        let arguments = [&["simulate", twin, "--release", "0.2m"][..], &more].concat();
        assert!(said(&arguments, 2).contains("cannot be used with"));
    }
    let assets = directory.path().join("assets");
    let assets = assets.to_str().unwrap();
    let told = said(
        &["export", twin, "--to", "mjcf,urdf,usd,onnx", "-o", assets],
        0,
    );
    assert!(
        told.contains("object.onnx") && told.contains("joint attributes alone"),
        "{told}"
    );
    assert!(
        said(&["export", twin, "--to", "urdf", "-o", assets], 1).contains("object.urdf exists")
    );
    assert_eq!(
        run(&[
            "export", twin, "--to", "urdf", "--name", "a b", "-o", assets
        ])
        .status
        .code(),
        Some(2)
    );
    let beside: serde_json::Value =
        serde_json::from_str(&said(&["compare", twin, twin, "--json"], 0)).unwrap();
    assert_eq!(beside[1]["effort_difference"], 0.0);
    let report = out.join("report.json");
    assert!(
        said(&["compare", twin, report.to_str().unwrap()], 1)
            .contains("give the twin.json that ft-identify wrote")
    );
}

#[test]
fn what_was_not_identified_is_said_and_asked_for_where_it_is_needed() {
    let directory = tempfile::tempdir().unwrap();
    let out = identified_slide(directory.path());
    let mut twin: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("twin.json")).unwrap()).unwrap();
    for parameter in 0..3 {
        twin["beta"]["values"][parameter] = serde_json::Value::Null;
    }
    let (path, assets) = (
        directory.path().join("null.json"),
        directory.path().join("null"),
    );
    std::fs::write(&path, twin.to_string()).unwrap();
    let (twin, assets) = (path.to_str().unwrap(), assets.to_str().unwrap());
    for (arguments, code, says) in [
        (
            ["simulate", twin, "--release", "0.1m"].as_slice(),
            1,
            "no inertia: it was not identifiable; probe with fast strokes",
        ),
        (
            &["export", twin, "--to", "usd", "-o", assets],
            1,
            "export `onnx`, which needs none",
        ),
        (
            &["export", twin, "--to", "onnx", "-o", assets],
            0,
            "not identified: `coulomb` counts as 0",
        ),
        (
            &["simulate", twin, "--open", "0.2m"],
            0,
            "not identified: `inertia` counts as 0",
        ),
    ] {
        let done = run(arguments);
        let said = text(&done.stderr);
        assert_eq!(done.status.code(), Some(code), "{said}");
        assert!(said.contains(says), "{said}");
    }
}

#[test]
fn a_twin_whose_numbers_do_not_fit_together_is_refused() {
    let directory = tempfile::tempdir().unwrap();
    let out = identified_slide(directory.path());
    let whole: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("twin.json")).unwrap()).unwrap();
    let broken: Vec<(&str, serde_json::Value, &str)> = vec![
        ("/schema", "other/1".into(), "schema is `other/1`"),
        (
            "/beta/values",
            serde_json::json!([1.0]),
            "one value per name",
        ),
        (
            "/beta/values/0",
            serde_json::json!(-1.0),
            "inertia is below 0",
        ),
        ("/beta/units/0", "lb".into(), "SI units"),
        ("/domain/q", serde_json::json!([1.0, 1.0]), "no interval"),
        ("/joint/coordinate/sign", 0.5.into(), "not 1 or -1"),
        (
            "/mechanism/load/pieces",
            7.into(),
            "coefficients over an interval",
        ),
        (
            "/mechanism/load/pieces",
            serde_json::json!(u64::MAX),
            "beyond anything",
        ),
        (
            "/beta/values/0",
            serde_json::json!(1e300),
            "beyond anything",
        ),
        ("/mechanism/load/degree", 5.into(), "a degree above 3"),
        (
            "/mechanism/damping/1/interval_q/0",
            serde_json::json!(-7.0),
            "other pieces forward than backward",
        ),
    ];
    for (at, value, said) in broken {
        let mut twin = whole.clone();
        *twin.pointer_mut(at).unwrap_or_else(|| panic!("{at}")) = value;
        let path = directory.path().join("broken.json");
        std::fs::write(&path, twin.to_string()).unwrap();
        let done = run(&["simulate", path.to_str().unwrap(), "--release", "0.1m"]);
        assert_eq!(done.status.code(), Some(1));
        assert!(
            text(&done.stderr).contains(said),
            "{at}: {}",
            text(&done.stderr)
        );
    }
}
