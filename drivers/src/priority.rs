//! The priority of acquisition threads.

/// A nice value above ordinary programs and below the system's own real-time threads.
const ACQUISITION_NICE: i32 = -10;

/// Asks the system to prefer the calling thread to ordinary ones, so that a busy machine does not let a port's buffer (4096
/// bytes, 55 ms of a tracker at 1 kHz) run over. Whether it was granted: it takes `CAP_SYS_NICE`, and nothing else depends on
/// it.
pub fn prefer_this_thread() -> bool {
    // On Linux a nice value belongs to the thread, and a thread id stands for it.
    rustix::process::setpriority_process(Some(rustix::thread::gettid()), ACQUISITION_NICE).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_calling_thread_is_preferred() {
        let granted = std::thread::spawn(|| {
            let granted = prefer_this_thread();
            let own = rustix::process::getpriority_process(Some(rustix::thread::gettid()));
            (granted, own)
        });
        let (granted, own) = granted.join().unwrap();
        assert_eq!(granted, own == Ok(ACQUISITION_NICE));
        let other = rustix::process::getpriority_process(Some(rustix::thread::gettid())).unwrap();
        assert_ne!(other, ACQUISITION_NICE);
    }
}
