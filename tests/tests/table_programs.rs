//! The programs that print tables: help, and a clear end for what they do not take.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::process::{Command, Output};

const PROGRAMS: [(&str, &str); 11] = [
    ("bias-table", env!("CARGO_BIN_EXE_bias-table")),
    ("control-study", env!("CARGO_BIN_EXE_control-study")),
    ("latency-table", env!("CARGO_BIN_EXE_latency-table")),
    ("mechanism-table", env!("CARGO_BIN_EXE_mechanism-table")),
    ("sealed-table", env!("CARGO_BIN_EXE_sealed-table")),
    ("soak", env!("CARGO_BIN_EXE_soak")),
    ("speed", env!("CARGO_BIN_EXE_speed")),
    ("stamps-table", env!("CARGO_BIN_EXE_stamps-table")),
    ("study", env!("CARGO_BIN_EXE_study")),
    ("swing-study", env!("CARGO_BIN_EXE_swing-study")),
    ("truth-table", env!("CARGO_BIN_EXE_truth-table")),
];

fn run(program: &str, arguments: &[&str]) -> Output {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(program);
    command.args(arguments).current_dir(folder.path());
    command.output().unwrap()
}

#[test]
fn each_has_a_help_with_an_example() {
    for (name, program) in PROGRAMS {
        let out = run(program, &["--help"]);
        let said = String::from_utf8(out.stdout).unwrap();
        assert!(out.status.success(), "{name}");
        assert!(said.contains(&format!("\n  {name} ")), "{name}: {said}");
    }
}

#[test]
fn what_they_do_not_take_ends_them_before_any_work() {
    let program = |wanted: &str| PROGRAMS.iter().find(|one| one.0 == wanted).unwrap().1;
    for (name, arguments, word) in [
        ("bias-table", &["1", "1", "nosuch"][..], "no trial"),
        ("mechanism-table", &["1", "1", "nosuch"], "no object"),
        ("study", &["1", "1", "tray", "nosuch"], "no object"),
        ("truth-table", &["1", "nosuch"], "wood_door"),
        (
            "stamps-table",
            &["1", "1", "wood_door", "nosuch"],
            "no scenario",
        ),
        ("speed", &["60", "nosuch"], "no scenario"),
        ("speed", &["nan"], "not a number above 0"),
        ("soak", &["60", "0"], "not a number above 0"),
        ("sealed-table", &["1", "1", "--effect", "nosuch"], "nosuch"),
        ("sealed-table", &["1", "1", "--two", "7"], "from 0 to 1"),
        ("sealed-table", &["0"], "0"),
        ("latency-table", &["1", "2"], "100"),
    ] {
        let out = run(program(name), arguments);
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(2), "{name} {arguments:?}: {said}");
        assert!(said.contains(word), "{name} {arguments:?}: {said}");
    }
}

#[test]
fn a_file_that_cannot_be_written_ends_the_draws_before_the_first() {
    let program = env!("CARGO_BIN_EXE_sealed-table");
    for arguments in [["-o", "missing/tables.md"], ["--keep", "/dev/null/draws"]] {
        let out = run(program, &[&["1", "1"][..], &arguments].concat());
        let said = String::from_utf8(out.stderr).unwrap();
        assert_eq!(out.status.code(), Some(1), "{said}");
        assert!(said.contains(arguments[1]), "{said}");
    }
}

/// A tool that slides by 12 mm five times has no joint's path; nothing is named, and what was put in is missed.
#[test]
fn a_draw_that_cannot_be_identified_counts_as_missed() {
    let program = env!("CARGO_BIN_EXE_sealed-table");
    let folder = tempfile::tempdir().unwrap();
    let tables = folder.path().join("tables.md");
    let out = run(program, &["1", "675100044", "-o", tables.to_str().unwrap()]);
    let said = String::from_utf8(out.stderr).unwrap();
    assert_eq!(out.status.code(), Some(0), "{said}");
    assert!(said.contains("675100044: not identified"), "{said}");
    let tables = std::fs::read_to_string(tables).unwrap();
    let missed = "| two effects of 2 floors: both found | 0 of 1 | 0.0 % |";
    assert!(tables.contains(missed), "{tables}");
}
