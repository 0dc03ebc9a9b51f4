//! How often somebody may do something.

use ft_wire::HostTime;

/// So many at once, and so many a second.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Allowance {
    per_second: f64,
    at_once: f64,
    left: f64,
    since: HostTime,
}

impl Allowance {
    pub(crate) const fn new(per_second: f64, at_once: f64, now: HostTime) -> Self {
        Self {
            per_second,
            at_once,
            left: at_once,
            since: now,
        }
    }

    /// Whether it may be done once more now.
    pub(crate) fn spend(&mut self, now: HostTime) -> bool {
        let earned = now.seconds_since(self.since) * self.per_second;
        self.left = (self.left + earned).min(self.at_once);
        self.since = now;
        let granted = self.left >= 1.0;
        if granted {
            self.left -= 1.0;
        }
        granted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_granted_and_then_what_was_earned() {
        let at = |milliseconds| HostTime::from_nanos(milliseconds * 1_000_000);
        let mut allowance = Allowance::new(10.0, 20.0, at(0));
        let mut granted = |from: i64, to: i64| {
            (from..to)
                .filter(|millisecond| allowance.spend(at(*millisecond)))
                .count()
        };
        assert_eq!(granted(0, 20), 20);
        assert_eq!(granted(20, 1020), 10);
        assert_eq!(granted(60_000, 60_150), 21);
    }
}
