//! The adapter's stamps on our clock.

use ft_wire::{HostTime, Unwrapper};

use crate::translate::{OneWay, OneWayConfig};

/// Puts the adapter's microseconds onto the host clock by [`OneWay`].
#[derive(Debug)]
pub(super) struct AdapterClock {
    unwrapper: Unwrapper,
    translator: OneWay,
    last: HostTime,
}

impl AdapterClock {
    pub(super) fn new() -> Self {
        Self {
            unwrapper: Unwrapper::new(32),
            translator: OneWay::new(OneWayConfig::default()),
            last: HostTime::EPOCH,
        }
    }

    /// When a frame came that was read at `now`; never later than that, and never before the frame before it.
    pub(super) fn arrival(&mut self, time_us: Option<u32>, now: HostTime) -> HostTime {
        let at = time_us.map_or(now, |raw| {
            let device_ns = self.unwrapper.unwrap(raw).saturating_mul(1_000);
            self.translator.observe(device_ns, now).at
        });
        self.last = at.max(self.last).min(now);
        self.last
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const START: HostTime = HostTime::from_nanos(1_000_000_000_000);

    #[test]
    fn without_stamps_a_frame_came_when_it_was_read() {
        let mut clock = AdapterClock::new();
        assert_eq!(clock.arrival(None, START), START);
    }

    /// Reads are up to 3 ms late, in a pattern; the adapter's clock wraps on the way.
    #[test]
    fn late_reads_do_not_move_the_arrival() {
        let mut clock = AdapterClock::new();
        let mut last = START;
        for count in 0_u32..5_000 {
            let came = START + Duration::from_millis(u64::from(count));
            let late = Duration::from_micros(u64::from(count * 7_919 % 3_000));
            let raw = (u32::MAX - 1_000_000).wrapping_add(count * 1_000);
            let read = (came + late).max(last);
            last = read;
            let arrival = clock.arrival(Some(raw), read);
            assert!(arrival <= read);
            if count > 1_000 {
                let off = arrival.seconds_since(came);
                assert!((-2e-5..2e-4).contains(&off), "{count}: {off} s");
            }
        }
    }
}
