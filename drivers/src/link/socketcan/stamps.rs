//! The kernel's receive stamps, which are on the system's clock, on the host clock, which never steps.
//!
//! A stamp goes over by what the two clocks differ. When the system's clock is stepped while frames wait to be read, those
//! before the step go over by the old difference and those after it by the new one; which one a frame belongs to is seen by
//! that it cannot have come after it was read. Where both could be, the later counts: an arrival that is too late by less than
//! the frame waited is one of many, but one that is too early pulls the device's whole clock.

use ft_wire::HostTime;

/// Both clocks at one moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct BothClocks {
    /// The system's, ns since the Unix epoch; to be read first, so that what comes between makes a frame late and not early.
    pub(super) system_ns: i64,
    pub(super) host: HostTime,
}

impl BothClocks {
    /// By how much the system's clock is ahead, ns.
    const fn ahead_ns(self) -> i64 {
        self.system_ns.saturating_sub(self.host.as_nanos())
    }
}

/// A smaller difference is the reading of the clocks, or a clock that is slewed, ns.
const STEP_NS: i64 = 1_000_000;

/// Puts arrivals in order on the host clock.
#[derive(Debug)]
pub(super) struct KernelStamps {
    /// When last no frame waited.
    settled: BothClocks,
    last_arrival: HostTime,
}

impl KernelStamps {
    pub(super) const fn new(clocks: BothClocks) -> Self {
        Self {
            settled: clocks,
            last_arrival: HostTime::EPOCH,
        }
    }

    /// No frame waits: all that come were stamped after this.
    pub(super) const fn nothing_waits(&mut self, clocks: BothClocks) {
        self.settled = clocks;
    }

    /// When a frame arrived that was stamped `stamp_ns` and is read now; now, when it has no stamp.
    pub(super) fn arrival(&mut self, stamp_ns: Option<i64>, clocks: BothClocks) -> HostTime {
        let now = clocks.host;
        let by = |clocks: BothClocks| {
            let stamp_ns = stamp_ns?;
            Some(HostTime::from_nanos(
                stamp_ns.saturating_sub(clocks.ahead_ns()),
            ))
        };
        let stepped = clocks.ahead_ns().abs_diff(self.settled.ahead_ns()) > STEP_NS as u64;
        let before = by(self.settled).filter(|_| stepped);
        let possible = [by(clocks), before].into_iter().flatten();
        let arrival = possible.filter(|at| *at <= now).max().unwrap_or(now);
        self.last_arrival = arrival.max(self.last_arrival).min(now);
        self.last_arrival
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START_NS: i64 = 1_700_000_000_000_000_000;

    /// The clocks `ms` after the start, the system's being `ahead_ms` ahead.
    fn at(ms: f64, ahead_ms: f64) -> BothClocks {
        let [host_ns, ahead_ns] = [ms, ahead_ms].map(|ms| (1e6 * ms).round() as i64);
        BothClocks {
            system_ns: START_NS + host_ns + ahead_ns,
            host: HostTime::from_nanos(START_NS + host_ns),
        }
    }

    /// A frame that arrives at `arrives` while the system's clock is `then` ahead and is read at `read` while it is `now` ahead;
    /// all in ms. What is made of it, ms after the start.
    fn read(
        stamps: &mut KernelStamps,
        (arrives, then): (f64, f64),
        (read, now): (f64, f64),
    ) -> f64 {
        let arrival = stamps.arrival(Some(at(arrives, then).system_ns), at(read, now));
        ((arrival.as_nanos() - START_NS) as f64 / 1e3).round() / 1e3
    }

    #[test]
    fn a_frame_goes_over_by_its_age() {
        let mut stamps = KernelStamps::new(at(0.0, 0.0));
        assert_eq!(read(&mut stamps, (10.0, 0.0), (10.3, 0.0)), 10.0);
        // A clock that was stepped long ago, or is slewed, is as good.
        stamps.nothing_waits(at(11.0, 5_000.0));
        assert_eq!(read(&mut stamps, (12.0, 5_000.0), (12.5, 5_000.02)), 11.98);
        assert_eq!(stamps.arrival(None, at(13.0, 0.0)), at(13.0, 0.0).host);
    }

    #[test]
    fn frames_that_wait_while_the_clock_is_stepped_are_not_stamped_before_they_arrived() {
        for step_ms in [60_000.0, 5.0, -5.0, -60_000.0] {
            let mut stamps = KernelStamps::new(at(0.0, 0.0));
            assert_eq!(read(&mut stamps, (10.0, 0.0), (10.2, 0.0)), 10.0);
            stamps.nothing_waits(at(10.3, 0.0));
            // Three before the step at 13.5 ms, three after it, all read at 16.1 ms.
            for k in 11..17 {
                let arrives = f64::from(k);
                let then = if k < 14 { 0.0 } else { step_ms };
                let found = read(&mut stamps, (arrives, then), (16.1, step_ms));
                assert!(
                    (arrives - 0.001..=16.1).contains(&found),
                    "{step_ms}: {arrives} {found}"
                );
                // A step that is longer than the wait leaves no doubt.
                if step_ms.abs() > 10.0 {
                    assert!(
                        (found - arrives).abs() < 0.001,
                        "{step_ms}: {arrives} {found}"
                    );
                }
            }
            stamps.nothing_waits(at(16.3, step_ms));
            assert_eq!(read(&mut stamps, (17.0, step_ms), (17.4, step_ms)), 17.0);
        }
    }
}
