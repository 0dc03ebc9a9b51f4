//! A device's clock: offset and skew against the host's.

use crate::scenario::ClockSpec;

/// Nanoseconds since the simulation began, on the host's clock.
pub(crate) type SimNanos = i64;

/// A clock that reads `reads_s` when the simulation begins and goes `skew_ppm` too fast.
#[derive(Clone, Copy, Debug)]
pub(crate) struct DeviceClock {
    reads_ns: f64,
    rate: f64,
}

impl DeviceClock {
    pub(crate) fn new(spec: &ClockSpec, drawn_s: f64) -> Self {
        Self {
            reads_ns: spec.reads_s.unwrap_or(drawn_s) * 1e9,
            rate: 1.0 + spec.skew_ppm * 1e-6,
        }
    }

    /// What it shows at `at`, ns, not wrapped.
    pub(crate) fn reading_ns(&self, at: SimNanos) -> u64 {
        (self.reads_ns + self.rate * at as f64).round().max(0.0) as u64
    }

    /// The host's nanoseconds in which it counts `device_seconds`.
    pub(crate) fn host_ns(&self, device_seconds: f64) -> f64 {
        device_seconds * 1e9 / self.rate
    }
}

/// Evenly spaced instants of a device's clock, on the host's.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cadence {
    first: SimNanos,
    period_ns: f64,
    count: u64,
}

impl Cadence {
    pub(crate) fn starting(first: SimNanos, rate_hz: f64, clock: &DeviceClock) -> Self {
        Self {
            first,
            period_ns: clock.host_ns(1.0 / rate_hz),
            count: 0,
        }
    }

    pub(crate) fn next(&self) -> SimNanos {
        self.first + (self.period_ns * self.count as f64).round() as SimNanos
    }

    pub(crate) fn tick(&mut self) {
        self.count += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fast_clock_gains_on_the_host() {
        let clock = DeviceClock::new(
            &ClockSpec {
                reads_s: Some(2.0),
                skew_ppm: 100.0,
            },
            0.0,
        );
        assert_eq!(clock.reading_ns(0), 2_000_000_000);
        assert_eq!(clock.reading_ns(10_000_000_000), 12_001_000_000);
    }

    #[test]
    fn a_cadence_does_not_drift_from_its_clock() {
        let clock = DeviceClock::new(
            &ClockSpec {
                reads_s: Some(0.0),
                skew_ppm: 50.0,
            },
            0.0,
        );
        let mut cadence = Cadence::starting(500, 800.0, &clock);
        for _ in 0..80_000 {
            cadence.tick();
        }
        let shown = clock.reading_ns(cadence.next() - 500);
        assert!(shown.abs_diff(100_000_000_000) <= 1, "{shown}");
    }
}
