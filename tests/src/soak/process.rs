//! What the system says of this process.

use std::fs;

/// Resident memory, kB; 0 when the system does not say.
pub(super) fn resident_kb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok())
        .unwrap_or(0)
}

/// Processor time of the thread of that name so far, s, in the system's hundredths; the kernel keeps 15 bytes of a name.
pub(super) fn thread_cpu_s(name: &str) -> f64 {
    const TICKS_PER_SECOND: f64 = 100.0;
    let kept = &name[..name.len().min(15)];
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten();
    let stats = tasks.filter_map(|task| fs::read_to_string(task.ok()?.path().join("stat")).ok());
    stats
        .filter_map(|stat| {
            let (head, fields) = stat.rsplit_once(") ")?;
            let (_, this) = head.split_once('(')?;
            let ticks = |at: usize| fields.split(' ').nth(at)?.parse::<f64>().ok();
            // utime and stime are fields 14 and 15, state is the third.
            (this == kept).then_some(ticks(11)? + ticks(12)?)
        })
        .map(|ticks| ticks / TICKS_PER_SECOND)
        .sum()
}
