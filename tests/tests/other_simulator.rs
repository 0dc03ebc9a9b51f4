//! What the model lacks, of drawers that a program in C integrates (`peers/joint.c`), which shares no formula with this project: two tables of
//! each, of which the second confirms what the first shows.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::{Path, PathBuf};
use std::process::Command;

use ft_tests::{programs, workspace_root};
use tempfile::tempdir;

/// What is put in, what is to be named, the verdict.
struct Case(&'static str, &'static [&'static str], &'static str);

/// What the library has names for, alone and in twos, and what it has none for.
const CASES: [Case; 22] = [
    Case("none", &[], "explained"),
    Case("spring", &["spring"], "explained"),
    Case("constant_load", &["constant_load"], "explained"),
    Case("stribeck", &["stribeck"], "explained"),
    Case("presliding", &["presliding"], "explained"),
    Case("detent", &["detent"], "explained"),
    Case("catch", &["catch"], "explained"),
    Case("ripple", &["ripple"], "explained"),
    Case("quadratic_drag", &["quadratic_drag"], "explained"),
    Case("asymmetric_viscous", &["asymmetric_viscous"], "explained"),
    Case(
        "position_dependent_friction",
        &["position_dependent_friction"],
        "explained",
    ),
    Case("friction_drift", &["friction_drift"], "explained"),
    Case("spring+stribeck", &["spring", "stribeck"], "explained"),
    Case("detent+presliding", &["detent", "presliding"], "explained"),
    Case(
        "spring+position_dependent_friction",
        &["spring", "position_dependent_friction"],
        "explained",
    ),
    Case("root", &[], "unexplained"),
    Case("brake", &["position_dependent_friction"], "unexplained"),
    Case("hardening", &["spring"], "unexplained"),
    // Beside a load of no name: a notch, and a corner that looks like one.
    Case("detent+hardening", &["detent", "spring"], "unexplained"),
    Case("bumper", &[], "unexplained"),
    Case("liquid", &[], "unexplained"),
    Case("relaxing", &[], "unexplained"),
];

/// Seeds of drawers; the next one confirms.
const SEEDS: [u32; 2] = [10, 12];

/// Writes a table and gives mass, Coulomb and viscous friction.
fn table(joint: &Path, effects: &str, seed: u32, to: &Path) -> [f64; 3] {
    let done = Command::new(joint)
        .args([effects, &seed.to_string()])
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    std::fs::write(to, &done.stdout).unwrap();
    let told = String::from_utf8(done.stderr).unwrap();
    let numbers: Vec<f64> = told
        .split_whitespace()
        .map(|n| n.parse().unwrap())
        .collect();
    numbers.try_into().unwrap()
}

/// Where the rubber begins, m.
const BUMPER_AT: f64 = 0.34;

/// The first corner of a load of no name that a report tells of.
fn corner(report: &serde_json::Value) -> Option<f64> {
    let mut refused = report["refused"].as_array()?.iter();
    refused.find_map(|refused| {
        let (_, at) = refused["reason"].as_str()?.split_once("corner at ")?;
        at.split(';').next()?.parse().ok()
    })
}

/// Builds the simulator.
fn built(folder: &Path) -> PathBuf {
    let joint = folder.join("joint");
    let built = Command::new("cc")
        .args(["-O2", "-o"])
        .arg(&joint)
        .arg(workspace_root().join("tests/peers/joint.c"))
        .arg("-lm")
        .status();
    assert!(built.unwrap().success(), "cc cannot build joint.c");
    joint
}

/// What `ft-identify` is asked of two tables.
const ASKED: &str = "table first.csv --confirm second.csv --time t --position q --effort f --kind prismatic --force -o out --json";

#[test]
fn an_effect_that_is_not_elsewhere_is_told_as_such() {
    let folder = tempdir().unwrap();
    let joint = built(folder.path());
    table(&joint, "detent", SEEDS[0], &folder.path().join("first.csv"));
    table(
        &joint,
        "none",
        SEEDS[0] + 1,
        &folder.path().join("second.csv"),
    );
    let arguments: Vec<&str> = ASKED.split(' ').collect();
    let found = programs::run("ft-identify", &arguments, folder.path()).expect_code(0);
    let report = found.json();
    assert!(report["effects"].as_array().unwrap().is_empty(), "{report}");
    let notes = report["notes"].to_string();
    let told = "without detent, not confirmed elsewhere";
    assert!(
        notes.contains(told) && notes.contains("second.csv"),
        "{notes}"
    );
}

#[test]
fn what_another_simulator_puts_in_is_named() {
    let folder = tempdir().unwrap();
    let joint = built(folder.path());
    for Case(effects, wanted, verdict) in CASES {
        for seed in SEEDS {
            let [first, second] = ["first.csv", "second.csv"].map(|name| folder.path().join(name));
            let truth = table(&joint, effects, seed, &first);
            table(&joint, effects, seed + 1, &second);
            let mut arguments: Vec<&str> = ASKED.split(' ').collect();
            let found = programs::run("ft-identify", &arguments, folder.path()).expect_code(0);
            let report = found.json();
            let named: Vec<&str> = report["effects"]
                .as_array()
                .unwrap()
                .iter()
                .map(|effect| effect["name"].as_str().unwrap())
                .collect();
            let last = &report["final"];
            let said = (named.as_slice(), last["verdict"].as_str());
            assert_eq!(said, (wanted, Some(verdict)), "{effects}, seed {seed}");
            if effects == "bumper" {
                let at = corner(&report).unwrap_or_else(|| panic!("seed {seed}: no corner"));
                assert!((at - BUMPER_AT).abs() < 0.002, "seed {seed}: {at}");
            }
            let alone = &last["named"]["terms"];
            let alone: Vec<&str> = alone
                .as_array()
                .unwrap()
                .iter()
                .filter_map(|term| term["name"].as_str())
                .collect();
            assert_eq!(alone, ["inertia", "coulomb", "viscous"]);
            if verdict != "explained" && seed == SEEDS[0] {
                arguments.pop();
                let told = programs::run("ft-identify", &arguments, folder.path())
                    .expect_code(0)
                    .stdout;
                assert_eq!(
                    told.contains("with these alone: inertia "),
                    !wanted.is_empty(),
                    "{told}"
                );
                let refused = report["refused"].as_array().unwrap();
                assert_eq!(
                    told.contains("\nrefused    "),
                    !refused.is_empty(),
                    "{told}"
                );
            }
            if verdict != "explained" {
                continue;
            }
            // What grows along the way is counted from the lowest place that was probed, two hundredths of the range from where it begins here.
            let grows = wanted.contains(&"position_dependent_friction");
            let allowed = [0.005, if grows { 0.03 } else { 0.005 }, 0.01];
            let terms = last["terms"].as_array().unwrap();
            for ((term, truth), allowed) in terms.iter().zip(truth).zip(allowed) {
                let off = term["value"].as_f64().unwrap() / truth - 1.0;
                assert!(
                    off.abs() < allowed,
                    "{effects}, seed {seed}: {term}, put in {truth}"
                );
            }
        }
    }
}
