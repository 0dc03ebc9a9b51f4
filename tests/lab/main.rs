//! `lab-guest`: the lab's cases, run as root in the guest that `--test lab` boots; useless elsewhere.
//!
//! Each case prints one line: `case NAME ok`, or `case NAME FAILED` and why.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a case that cannot go on has failed"
)]

mod can;
mod candle;
mod gadget;
mod hear;
mod hid;
mod machine;
mod netem;
mod serial;
mod service;
mod udev;

use std::any::Any;
use std::io::Write as _;

/// A case: it panics when it does not hold.
type Case = (&'static str, fn());

fn main() {
    let only = std::env::var("FT_LAB_ONLY").unwrap_or_default();
    let groups = [
        can::CASES,
        serial::CASES,
        hid::CASES,
        udev::CASES,
        service::CASES,
        candle::CASES,
        netem::CASES,
    ];
    let all = groups.into_iter().flatten();
    for (name, case) in all.filter(|(name, _)| only.split(',').any(|part| name.contains(part))) {
        eprintln!("== {name} at {} s", machine::uptime());
        let line = match std::panic::catch_unwind(case) {
            Ok(()) => format!("case {name} ok"),
            Err(cause) => format!("case {name} FAILED {}", text(&*cause)),
        };
        // The host misses a line that is not there.
        let _ = writeln!(std::io::stdout(), "{line}");
    }
}

fn text(cause: &(dyn Any + Send)) -> String {
    let text = cause
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| cause.downcast_ref::<&str>().copied());
    text.unwrap_or("panicked").replace('\n', " ")
}
