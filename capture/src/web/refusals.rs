//! What was refused: counted always, said once a minute.

use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;

/// How long one reason stays said.
const QUIET: Duration = Duration::from_secs(60);

/// Reasons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Why {
    TooMany,
    Host,
    Origin,
    Token,
    TooFast,
    TooMuch,
}

impl Why {
    const ALL: usize = 6;

    const fn text(self) -> &'static str {
        match self {
            Self::TooMany => "too many connections",
            Self::Host => "a host name that is not this machine's",
            Self::Origin => "a page of another origin",
            Self::Token => "a command without the right token",
            Self::TooFast => "too many commands",
            Self::TooMuch => "a viewer that talks too much",
        }
    }
}

/// Counts by reason.
#[derive(Debug)]
pub(crate) struct Refusals {
    clock: MonotonicClock,
    counts: Mutex<[(u64, Option<HostTime>); Why::ALL]>,
}

impl Refusals {
    pub(crate) const fn new(clock: MonotonicClock) -> Self {
        Self {
            clock,
            counts: Mutex::new([(0, None); Why::ALL]),
        }
    }

    /// Somebody at `address` was refused.
    pub(crate) fn add(&self, why: Why, address: IpAddr) {
        if let Some(count) = self.count(why, self.clock.now()) {
            tracing::warn!("refused: {} (from {address}, {count} so far)", why.text());
        }
    }

    /// The count, when it is to be said.
    fn count(&self, why: Why, now: HostTime) -> Option<u64> {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let (count, said) = &mut counts[why as usize];
        *count += 1;
        let quiet = said.is_some_and(|then| now.saturating_since(then) < QUIET);
        if quiet {
            return None;
        }
        *said = Some(now);
        Some(*count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_said_once_a_minute() {
        let refusals = Refusals::new(MonotonicClock::anchored_now());
        let said: Vec<_> = (0..100)
            .filter_map(|second| {
                refusals.count(Why::Token, HostTime::from_nanos(second * 1_000_000_000))
            })
            .collect();
        assert_eq!(said, [1, 61]);
        assert_eq!(refusals.count(Why::Origin, HostTime::EPOCH), Some(1));
    }
}
