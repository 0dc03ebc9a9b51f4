//! The clocks: the only place, with the link back ends, that reads one or waits for one.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ft_wire::HostTime;

/// Tells the host time.
pub trait Clock: Send + Sync {
    /// The present instant; never earlier than an answer before.
    fn now(&self) -> HostTime;
}

/// The host's monotonic clock, anchored to its real-time clock once.
///
/// A step of the real-time clock (NTP) after the anchoring does not move it.
#[derive(Clone, Copy, Debug)]
pub struct MonotonicClock {
    started: Instant,
    anchor: HostTime,
}

impl MonotonicClock {
    /// Anchors a clock now.
    #[must_use]
    #[allow(clippy::disallowed_methods, reason = "this is the clock")]
    pub fn anchored_now() -> Self {
        let since_epoch = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        Self {
            started: Instant::now(),
            anchor: HostTime::EPOCH + since_epoch,
        }
    }

    /// The real-time instant at which the clock was anchored.
    #[must_use]
    pub const fn anchor(&self) -> HostTime {
        self.anchor
    }

    /// Waits until `instant`; returns at once when it has passed.
    #[allow(clippy::disallowed_methods, reason = "this is the clock")]
    pub fn wait_until(&self, instant: HostTime) {
        let left = instant.saturating_since(self.now());
        if left > Duration::ZERO {
            std::thread::sleep(left);
        }
    }
}

impl Clock for MonotonicClock {
    fn now(&self) -> HostTime {
        self.anchor + self.started.elapsed()
    }
}

/// A clock that goes only when it is told to: for simulations faster than real time, and for tests.
#[derive(Clone, Debug)]
pub struct SteppedClock {
    now: Arc<AtomicI64>,
}

impl SteppedClock {
    /// A clock that stands at `start`.
    #[must_use]
    pub fn new(start: HostTime) -> Self {
        Self {
            now: Arc::new(AtomicI64::new(start.as_nanos())),
        }
    }

    /// Moves the clock on to `instant`; an earlier one is ignored.
    pub fn advance_to(&self, instant: HostTime) {
        self.now.fetch_max(instant.as_nanos(), Ordering::Relaxed);
    }
}

impl Clock for SteppedClock {
    fn now(&self) -> HostTime {
        HostTime::from_nanos(self.now.load(Ordering::Relaxed))
    }
}
