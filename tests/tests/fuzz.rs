//! A short run of every fuzz target; `fuzz/run.sh` makes long ones.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::Write as _;
use std::process::Command;

use ft_tests::workspace_root;

#[test]
fn no_decoder_falls_over_in_a_short_run() {
    if std::env::var_os("FT_REQUIRE_PEERS").is_none() {
        let why = "FT_REQUIRE_PEERS=1 downloads libFuzzer and builds it with a C++ compiler";
        writeln!(std::io::stderr(), "skipped: fuzz: {why}").unwrap();
        return;
    }
    let folder = workspace_root().join("fuzz");
    let output = Command::new(folder.join("run.sh"))
        .arg("20000")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}{complaint}");
    let targets = std::fs::read_dir(folder.join("targets")).unwrap().count();
    let ran = said.lines().filter(|line| line.contains("executions"));
    assert_eq!(ran.count(), targets, "{said}");
}
