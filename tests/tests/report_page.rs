//! The report of `ft-identify` in other people's browser.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use ft_tests::{peers, programs};
use tempfile::tempdir;

#[test]
fn a_report_shows_its_numbers_and_plots_and_the_papers_beside() {
    let test = "a_report_shows_its_numbers_and_plots_and_the_papers_beside";
    let (Some(chromium), Some(_)) = (peers::chromium(test), peers::python(test)) else {
        return;
    };
    let folder = tempdir().unwrap();
    let record = ["--sim", "oven_door", "--speed", "max", "-o", "oven.mcap"];
    programs::run("ft-capture", &record, folder.path()).expect_code(0);
    let identify = ["oven.mcap", "-o", "twin", "--estimator", "paper"];
    programs::run("ft-identify", &identify, folder.path()).expect_code(0);
    let report = folder.path().join("twin/report.html");
    let arguments = [chromium.to_str().unwrap(), report.to_str().unwrap()];
    let seen = peers::run(test, "report.py", &arguments).unwrap();
    let seen = seen.expect_code(0).json();
    assert_eq!(seen["errors"].as_array().unwrap().len(), 0, "{seen}");
    let terms = seen["terms"].as_str().unwrap();
    for wanted in [
        "inertia about the axis",
        "noise floor",
        "the paper's estimator",
        "its network",
    ] {
        assert!(terms.contains(wanted), "{wanted}: {seen}");
    }
    assert!(seen["said"].as_str().unwrap().contains("kg m^2"), "{seen}");
    assert!(seen["plots"].as_u64().unwrap() >= 4, "{seen}");
}
