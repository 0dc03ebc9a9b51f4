//! The priority of threads that a busy machine must not keep waiting.

mod shared;

pub use shared::SharedProcessor;

/// What a thread does whose lateness costs somebody something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Duty {
    /// Reads a port, whose buffer (4096 bytes, 55 ms of a tracker at 1 kHz) would run over.
    Acquisition,
    /// Publishes what was read to who waits for it.
    Publishing,
}

impl Duty {
    /// A nice value above ordinary programs and below the system's own real-time threads.
    const fn nice(self) -> i32 {
        match self {
            Self::Acquisition => -10,
            // Whoever waits for a sample waits for both: no further below than it takes to let the next one be read first.
            Self::Publishing => -9,
        }
    }
}

/// Asks the system to prefer the calling thread to ordinary ones. Whether it was granted: it takes `CAP_SYS_NICE`, and nothing else
/// depends on it.
pub fn prefer_this_thread(duty: Duty) -> bool {
    // On Linux a nice value belongs to the thread, and a thread id stands for it.
    rustix::process::setpriority_process(Some(rustix::thread::gettid()), duty.nice()).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_calling_thread_is_preferred() {
        for duty in [Duty::Acquisition, Duty::Publishing] {
            let granted = std::thread::spawn(move || {
                let granted = prefer_this_thread(duty);
                let own = rustix::process::getpriority_process(Some(rustix::thread::gettid()));
                (granted, own)
            });
            let (granted, own) = granted.join().unwrap();
            assert_eq!(granted, own == Ok(duty.nice()));
            let this = Some(rustix::thread::gettid());
            let other = rustix::process::getpriority_process(this).unwrap();
            assert_ne!(other, duty.nice());
        }
    }
}
