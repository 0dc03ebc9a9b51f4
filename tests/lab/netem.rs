//! A recorder behind a poor network: delay, loss, reordering, and a link that is gone for a while.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use ft_drivers::{Clock as _, MonotonicClock};
use ft_recording::{Recording, TopicMap};
use serde_json::Value;

use crate::Case;
use crate::hear::Played;
use crate::machine::{load, run, wait_for};

pub(crate) const CASES: &[Case] = &[(
    "network_that_delays_loses_and_reorders_costs_no_sample",
    poor_network,
)];

/// For a program that starts in a slow guest.
const PATIENCE: Duration = Duration::from_secs(60);
const ENDPOINT: &str = "tcp/127.0.0.1:17448";

fn start(folder: &Path, name: &str, arguments: &[&str]) -> Child {
    let program = PathBuf::from(std::env::var("FT_LAB_BIN").unwrap()).join(name);
    let file = |end: &str| fs::File::create(folder.join(format!("{name}.{end}"))).unwrap();
    Command::new(program)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(file("json"))
        .stderr(file("log"))
        .spawn()
        .unwrap()
}

fn end(folder: &Path, name: &str, mut child: Child) -> Value {
    run(&format!("kill -INT {}", child.id()));
    child.wait().unwrap();
    let said = fs::read_to_string(folder.join(format!("{name}.json"))).unwrap();
    let log = || fs::read_to_string(folder.join(format!("{name}.log"))).unwrap();
    serde_json::from_str(&said).unwrap_or_else(|error| panic!("{error}: {said}; {}", log()))
}

fn stamps(file: &Path) -> BTreeSet<i64> {
    let recording = Recording::load(file, &TopicMap::default()).unwrap();
    let wrenches = recording.wrench.iter();
    wrenches.map(|wrench| wrench.at.as_nanos()).collect()
}

fn poor_network() {
    load("sch_netem");
    let clock = MonotonicClock::anchored_now();
    let wait = |seconds| clock.wait_until(clock.now() + Duration::from_secs(seconds));
    let folder = Path::new("/run/netem");
    fs::create_dir_all(folder).unwrap();
    // What is sent and what is acknowledged go through it alike.
    run("ip link set lo mtu 1500");
    let netem = |how: &str| {
        run(&format!(
            "tc qdisc replace dev lo root netem limit 20000 {how}"
        ))
    };
    let poor = "delay 10ms 5ms loss 1% reorder 25% 50% duplicate 1%";
    netem(poor);
    // The guest emulates every instruction: what it cannot take in time is no loss of the network's.
    let mut scenario = Played::scenario("bota_serial", 200.0);
    scenario.tracker.rate_hz = 100.0;
    let text = toml::to_string(&scenario).unwrap();
    fs::write(folder.join("slow.toml"), text).unwrap();
    let recording = ["--sim", "slow.toml", "-o", "local.mcap", "--json"];
    let arguments = [&recording[..], &["--listen", ENDPOINT]].concat();
    let capture = start(folder, "ft-capture", &arguments);
    wait_for("a recording", PATIENCE, || {
        fs::metadata(folder.join("local.mcap.partial")).is_ok_and(|file| file.len() > 50_000)
    });
    let arguments = ["--connect", ENDPOINT, "--record", "remote.mcap", "--json"];
    let recorder = start(folder, "ft-view", &arguments);
    wait_for("a remote recording", PATIENCE, || {
        fs::metadata(folder.join("remote.mcap.partial")).is_ok_and(|file| file.len() > 50_000)
    });
    wait(8);
    netem("loss 100%");
    wait(5);
    netem(poor);
    wait(10);
    let summary = end(folder, "ft-capture", capture);
    let recorded = end(folder, "ft-view", recorder);
    run("tc qdisc del dev lo root");

    for stream in summary["streams"].as_array().unwrap() {
        assert_eq!(stream["drops"], 0, "the local recording noticed: {summary}");
    }
    let ledger = &recorded["topics"]["/ft/wrench"];
    let (local, remote) = (
        stamps(&folder.join("local.mcap")),
        stamps(&folder.join("remote.mcap")),
    );
    let missing = local.difference(&remote).count();
    eprintln!("{missing} of {} missing; {ledger}", local.len());
    assert!(local.len() > 3000, "{summary}");
    assert!(ledger["recovered"].as_u64().unwrap() > 100, "{ledger}");
    assert_eq!((missing, &ledger["gaps"]), (0, &0.into()), "{ledger}");
}
