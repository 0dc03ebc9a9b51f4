//! Four hosts as network namespaces: source, router, recorder, viewer. Links are cut, programs killed; the recorder's file
//! has what the source's own file has.
//!
//! ```text
//! source 10.77.1.2 ── 10.77.1.1 ┐
//! recorder 10.77.2.2 ─ 10.77.2.1 ┼ router (a plain Zenoh router)
//! viewer 10.77.3.2 ── 10.77.3.1 ┘
//! ```
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeSet;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use ft_recording::{Recording, TopicMap};
use ft_tests::programs::{end, signal};
use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

const HOSTS: [&str; 3] = ["source", "recorder", "viewer"];

/// The four hosts; they are gone when it is dropped.
struct Lan(String);

impl Lan {
    /// `None` after printing one line that says what `test` skips without namespaces.
    fn new(test: &str) -> Option<Self> {
        let lan = Self(format!("ft{}", std::process::id()));
        if !lan.ip(&["netns", "add", &lan.host("router")]) {
            let _ = writeln!(
                std::io::stderr(),
                "skipped: {test}: no network namespaces here (they need root and iproute2)"
            );
            return None;
        }
        for (index, name) in HOSTS.into_iter().enumerate() {
            let (host, router, net) = (lan.host(name), lan.host("router"), index + 1);
            let (outer, inner) = (format!("r{net}"), "eth");
            assert!(lan.ip(&["netns", "add", &host]));
            assert!(lan.ip(&[
                "-n", &router, "link", "add", &outer, "type", "veth", "peer", "name", inner,
                "netns", &host
            ]));
            for (of, link, address) in [(&router, outer.as_str(), 1), (&host, inner, 2)] {
                let address = format!("10.77.{net}.{address}/24");
                assert!(lan.ip(&["-n", of, "addr", "add", &address, "dev", link]));
                assert!(lan.ip(&["-n", of, "link", "set", link, "up"]));
                assert!(lan.ip(&["-n", of, "link", "set", "lo", "up"]));
            }
        }
        Some(lan)
    }

    fn host(&self, name: &str) -> String {
        format!("{}{name}", self.0)
    }

    fn ip(&self, arguments: &[&str]) -> bool {
        let status = Command::new("ip")
            .args(arguments)
            .stderr(Stdio::null())
            .status();
        status.is_ok_and(|status| status.success())
    }

    /// Cuts or mends the link between a host and the router.
    fn link(&self, name: &str, state: &str) {
        let net = 1 + HOSTS.iter().position(|host| *host == name).unwrap();
        assert!(self.ip(&[
            "-n",
            &self.host("router"),
            "link",
            "set",
            &format!("r{net}"),
            state
        ]));
    }

    /// Starts a command on a host.
    fn spawn(&self, name: &str, command: &Command) -> Child {
        let mut inside = Command::new("ip");
        inside
            .args(["netns", "exec", &self.host(name)])
            .arg(command.get_program())
            .args(command.get_args())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        if let Some(folder) = command.get_current_dir() {
            inside.current_dir(folder);
        }
        inside.spawn().unwrap()
    }

    fn router(&self, test: &str) -> Option<Child> {
        let endpoint = "tcp/0.0.0.0:7447";
        let mut router = self.spawn("router", &peers::command(test, "router.py", &[endpoint])?);
        let mut line = String::new();
        BufReader::new(router.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        assert_eq!(line.trim(), "ready");
        Some(router)
    }

    fn source(&self, folder: &Path, file: &str) -> Child {
        let arguments = [
            "--sim",
            "--connect",
            "tcp/10.77.1.1:7447",
            "-o",
            file,
            "--json",
        ];
        let source = self.spawn(
            "source",
            &programs::command("ft-capture", &arguments, folder),
        );
        wait(3000);
        source
    }
}

impl Drop for Lan {
    fn drop(&mut self) {
        for name in HOSTS.into_iter().chain(["router"]) {
            self.ip(&["netns", "del", &self.host(name)]);
        }
    }
}

#[allow(clippy::disallowed_methods, reason = "the network needs its time")]
fn wait(milliseconds: u64) {
    std::thread::sleep(std::time::Duration::from_millis(milliseconds));
}

/// Stamps of the wrenches in a file, ns.
fn stamps(folder: &Path, file: &str) -> BTreeSet<i64> {
    let recording = Recording::load(&folder.join(file), &TopicMap::default()).unwrap();
    recording
        .wrench
        .iter()
        .map(|wrench| wrench.at.as_nanos())
        .collect()
}

fn assert_nothing_dropped(summary: &Value) {
    for stream in summary["streams"].as_array().unwrap() {
        assert_eq!(stream["drops"], 0, "the local recording noticed: {summary}");
    }
}

#[test]
fn a_remote_recording_survives_cuts_and_restarts() {
    let test = "a_remote_recording_survives_cuts_and_restarts";
    let (Some(_), Some(lan)) = (peers::python(test), Lan::new(test)) else {
        return;
    };
    // The long cut is longer than Zenoh keeps a silent connection: it has to be made anew.
    let long = std::env::var("FT_LONG_CUT_MS").map_or(12_000, |text| text.parse().unwrap());
    let folder = tempdir().unwrap();
    let folder = folder.path();
    let mut router = lan.router(test).unwrap();
    let source = lan.source(folder, "first.mcap");
    let record = [
        "--connect",
        "tcp/10.77.2.1:7447",
        "--record",
        "remote.mcap",
        "--json",
    ];
    let recorder = lan.spawn("recorder", &programs::command("ft-view", &record, folder));
    let look = ["--connect", "tcp/10.77.3.1:7447", "--plain"];
    let viewer = lan.spawn("viewer", &programs::command("ft-view", &look, folder));
    wait(4000);

    for cut in [5000, long] {
        lan.link("recorder", "down");
        wait(cut);
        lan.link("recorder", "up");
        wait(8000);
    }
    signal(&router, "-KILL");
    router.wait().unwrap();
    wait(2000);
    let mut router = lan.router(test).unwrap();
    wait(10_000);
    let first = end("ft-capture", source);
    wait(1000);
    let source = lan.source(folder, "second.mcap");
    wait(5000);

    let recorded = end("ft-view --record", recorder);
    let viewed = end("ft-view", viewer);
    let second = end("ft-capture", source);
    signal(&router, "-KILL");
    router.wait().unwrap();
    println!(
        "{}\n{}\n{}",
        recorded.stdout, recorded.stderr, viewed.stdout
    );
    assert_nothing_dropped(&first.json());
    assert_nothing_dropped(&second.json());
    viewed.expect_code(0);

    let summary = recorded.json();
    let ledger = &summary["topics"]["/ft/wrench"];
    let (remote, local) = (stamps(folder, "remote.mcap"), stamps(folder, "first.mcap"));
    let restarted = stamps(folder, "second.mcap");
    let (begin, last) = (*remote.first().unwrap(), *local.last().unwrap());
    let missing = local
        .range(begin..)
        .filter(|stamp| !remote.contains(stamp))
        .count();
    println!("{missing} of {} missing", local.len());
    assert!(ledger["recovered"].as_u64().unwrap() > 8000, "{summary}");
    assert_eq!(
        ledger["gaps"].as_u64().unwrap(),
        missing as u64,
        "the ledger is exact: {summary}"
    );
    assert_eq!(missing, 0, "{summary}");
    assert!(remote.last().unwrap() > &last && restarted.iter().any(|stamp| remote.contains(stamp)));
}
