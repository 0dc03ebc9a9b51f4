//! The guest's own tools.

use std::process::Command;
use std::time::Duration;

use ft_drivers::{Clock as _, MonotonicClock};

/// Runs a program of the system to its end.
pub(crate) fn run(command: &str) {
    let words: Vec<_> = command.split_whitespace().collect();
    let output = Command::new(words[0]).args(&words[1..]).output();
    let output = output.unwrap_or_else(|error| panic!("{command}: {error}"));
    assert!(
        output.status.success(),
        "{command}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Loads a module of the guest's kernel and those it needs.
pub(crate) fn load(module: &str) {
    let kernel = std::env::var("FT_LAB_KERNEL").unwrap();
    run(&format!("modprobe -d {kernel} {module}"));
}

/// Sets one of the network's numbers of the guest's kernel, and says what it was.
pub(crate) fn set_kernel(name: &str, value: &str) -> String {
    let path = std::path::Path::new("/proc/sys/net/core").join(name);
    let before = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, value).unwrap();
    before.trim().to_owned()
}

/// Seconds since the guest booted.
pub(crate) fn uptime() -> String {
    let text = std::fs::read_to_string("/proc/uptime").unwrap_or_default();
    text.split_whitespace().next().unwrap_or("?").to_owned()
}

/// Waits until `holds`, at most `longest`.
pub(crate) fn wait_for(what: &str, longest: Duration, mut holds: impl FnMut() -> bool) {
    let clock = MonotonicClock::anchored_now();
    let end = clock.now() + longest;
    while !holds() {
        assert!(clock.now() < end, "{what}: not within {longest:?}");
        clock.wait_until(clock.now() + Duration::from_millis(20));
    }
}
