//! What the system says of this process.

use std::fs;

/// Resident memory, kB; 0 when the system does not say.
pub(super) fn resident_kb() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|line| line.split_whitespace().next()?.parse().ok())
        .unwrap_or(0)
}

/// Processor time of the thread of that name so far, s, in the system's hundredths; the kernel keeps 15 bytes of a name. `None` when no
/// thread, or more than one, has it.
pub(super) fn thread_cpu_s(name: &str) -> Option<f64> {
    const TICKS_PER_SECOND: f64 = 100.0;
    let kept = &name[..name.len().min(15)];
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten();
    let stats = tasks.filter_map(|task| fs::read_to_string(task.ok()?.path().join("stat")).ok());
    let mut of_that_name = stats.filter_map(|stat| {
        let (head, fields) = stat.rsplit_once(") ")?;
        let (_, this) = head.split_once('(')?;
        let ticks = |at: usize| fields.split(' ').nth(at)?.parse::<f64>().ok();
        // utime and stime are fields 14 and 15, state is the third.
        (this == kept).then_some(ticks(11)? + ticks(12)?)
    });
    let ticks = of_that_name.next()?;
    of_that_name
        .next()
        .is_none()
        .then_some(ticks / TICKS_PER_SECOND)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_is_not_there_took_no_time_but_is_missing() {
        let named = std::thread::Builder::new().name("ft-named-thread-of-a-test".to_owned());
        let (done, wait) = std::sync::mpsc::channel::<()>();
        let (began, begun) = std::sync::mpsc::channel();
        let thread = named.spawn(move || {
            began.send(()).unwrap();
            wait.recv().unwrap_or_default()
        });
        begun.recv().unwrap();
        assert!(thread_cpu_s("ft-named-thread-of-a-test").is_some());
        assert_eq!(thread_cpu_s("ft-no-such-thread"), None);
        drop(done);
        thread.unwrap().join().unwrap();
    }
}
