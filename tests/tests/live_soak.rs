//! The page in a real browser at 8 kHz: it draws, it costs little, it does not grow.
//!
//! ```text
//! FT_SOAK_S=1800 cargo test -p ft-tests --test live_soak -- --nocapture       half an hour instead of half a minute
//! ```
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};

use ft_tests::programs::end;
use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

/// Starts `command` and waits for the line on its standard output or error that begins with `wanted`: what follows.
fn started(mut command: Command, wanted: &str) -> (Child, String) {
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let said: Box<dyn std::io::Read> = match wanted {
        "ready" => Box::new(child.stdout.take().unwrap()),
        _ => Box::new(child.stderr.take().unwrap()),
    };
    let rest = BufReader::new(said)
        .lines()
        .map_while(Result::ok)
        .find_map(|line| Some(line.strip_prefix(wanted)?.trim().to_owned()))
        .unwrap();
    (child, rest)
}

/// The increase from the middle third to the last, median to median.
fn growth(samples: &[Value], of: &str) -> f64 {
    let median = |samples: &[Value]| {
        let mut values: Vec<_> = samples
            .iter()
            .map(|sample| sample[of].as_f64().unwrap())
            .collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let third = samples.len() / 3;
    median(&samples[2 * third..]) - median(&samples[third..2 * third])
}

#[test]
fn a_page_that_stays_open_at_8_khz_draws_and_does_not_grow() {
    let test = "a_page_that_stays_open_at_8_khz_draws_and_does_not_grow";
    let (Some(chromium), Some(_)) = (peers::chromium(test), peers::python(test)) else {
        return;
    };
    let seconds = std::env::var("FT_SOAK_S").unwrap_or_else(|_| "24".to_owned());
    let folder = tempdir().unwrap();
    let endpoint = "tcp/127.0.0.1:17488";
    let flood = peers::command(test, "flood.py", &[endpoint, "8000"]).unwrap();
    let (mut flood, _) = started(flood, "ready");
    let arguments = ["--connect", endpoint, "--web", "127.0.0.1:0"];
    let viewer = programs::command("ft-view", &arguments, folder.path());
    let (viewer, url) = started(viewer, "live page: ");
    let (chromium, id) = (chromium.display().to_string(), viewer.id().to_string());
    let mut arguments = vec![chromium.as_str(), &url, &id, &seconds];
    let pictures = std::env::var("FT_SCREENSHOTS").ok();
    arguments.extend(pictures.as_deref());
    let seen = peers::run(test, "soak.py", &arguments).unwrap();
    end("ft-view", viewer).expect_code(0);
    flood.kill().unwrap();
    flood.wait().unwrap();

    let seen = seen.expect_code(0).json();
    assert_eq!(seen["errors"], serde_json::json!([]));
    let samples = seen["samples"].as_array().unwrap();
    let (first, last) = (samples.first().unwrap(), samples.last().unwrap());
    let between = |of: &str| last[of].as_f64().unwrap() - first[of].as_f64().unwrap();
    let elapsed = between("at_s");
    let (drawn_hz, frames_hz) = (between("drawn") / elapsed, between("frames") / elapsed);
    let server = between("server_s") / elapsed;
    // What 8 kHz cost without anybody who looks is no viewer's.
    let alone = seen["alone"].as_f64().unwrap();
    let (heap, held) = (
        growth(samples, "heap") / 1e6,
        growth(samples, "server_kB") / 1e3,
    );
    println!(
        "{elapsed:.0} s: {frames_hz:.1} frames a second came, {drawn_hz:.1} were drawn, {} lost; server {:.1} % of a core (without a viewer \
         {:.1} %), {} kB then {} kB; page's heap {} then {} bytes; from the middle third to the last: heap {heap:+.3} MB, server {held:+.3} MB; {} then {} \
         nodes",
        last["lost"],
        100.0 * server,
        100.0 * alone,
        first["server_kB"],
        last["server_kB"],
        first["heap"],
        last["heap"],
        first["nodes"],
        last["nodes"]
    );
    assert!(frames_hz > 30.0 && drawn_hz > 30.0);
    let viewer = server - alone;
    assert!(viewer < 0.1, "{viewer} of a core for a viewer");
    assert!(heap < 0.5, "the page grows by {heap} MB");
    assert!(held < 2.0, "the server grows by {held} MB");
}
