//! Gaps, duplicates and restarts, seen by the device's own clock.

use ft_wire::HostTime;
use ft_wire::pace::{longest_by_jitter, shows_period};

/// Intervals from which the nominal period is learned.
const LEARNED_FROM: usize = 16;
/// Latest intervals that show how uneven the stream is.
const LATEST: usize = 128;
/// Samples remembered to tell a duplicate from a late one.
const REMEMBERED: usize = 16;
/// A device clock that jumps by more than this against the host's was restarted, ns.
const RESTART_NS: i64 = 1_000_000_000;

/// So many in a row that are older than the newest, each later than the one before, are no late samples: the device's clock
/// was set back.
const SET_BACK_SAMPLES: u32 = 8;

/// How a sample's stamp stands to the ones before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Seen {
    /// Later than all before.
    New,
    /// Older than the newest, but not seen yet.
    Late,
    /// Seen already.
    Duplicate,
    /// The device's clock began anew.
    Restarted {
        /// Newest stamp before, ns.
        was_ns: i64,
    },
}

/// Follows the stamps of one stream.
///
/// The nominal period is the median of the first 16 intervals and then follows slowly; an interval of n periods
/// shows n - 1 missing samples (a refused frame is such a sample too). The first 16 intervals are judged when the
/// period is known. Losing more than every second sample from the start is mistaken for a slower stream. Of a tracker that delivers
/// unevenly only intervals count that are longer than its jitter.
#[derive(Debug)]
pub(crate) struct Sequence {
    last: Option<i64>,
    recent: [i64; REMEMBERED],
    recent_len: usize,
    recent_at: usize,
    /// Smallest host minus device, ns: how early a stamp can at most be.
    earliest_offset: i64,
    /// The latest, in any order.
    intervals: [i64; LATEST],
    intervals_len: usize,
    intervals_at: usize,
    period_ns: Option<f64>,
    gaps: u64,
    /// Newest and number of a growing run of older samples, and the gaps before it.
    older_run: Option<(i64, u32, u64)>,
}

impl Sequence {
    pub(crate) const fn new() -> Self {
        Self {
            last: None,
            recent: [0; REMEMBERED],
            recent_len: 0,
            recent_at: 0,
            earliest_offset: i64::MAX,
            intervals: [0; LATEST],
            intervals_len: 0,
            intervals_at: 0,
            period_ns: None,
            gaps: 0,
            older_run: None,
        }
    }

    /// Samples missing so far.
    pub(crate) const fn gaps(&self) -> u64 {
        self.gaps
    }

    /// Forgets the stream, after a restart or a pause; the count stays.
    pub(crate) fn forget(&mut self) {
        *self = Self {
            gaps: self.gaps,
            ..Self::new()
        };
    }

    /// Takes the stamp of a sample.
    pub(crate) fn observe(&mut self, device_ns: i64, arrival: HostTime) -> Seen {
        let offset = arrival.as_nanos().saturating_sub(device_ns);
        let Some(last) = self.last else {
            self.earliest_offset = offset;
            self.accept(device_ns);
            return Seen::New;
        };
        let step = device_ns.saturating_sub(last);
        if step < -RESTART_NS || offset < self.earliest_offset.saturating_sub(RESTART_NS) {
            self.forget();
            self.earliest_offset = offset;
            self.accept(device_ns);
            return Seen::Restarted { was_ns: last };
        }
        self.earliest_offset = self.earliest_offset.min(offset);
        if step <= 0 {
            if self.was_set_back(device_ns, step) {
                self.forget();
                self.earliest_offset = offset;
                self.accept(device_ns);
                return Seen::Restarted { was_ns: last };
            }
            return self.older(device_ns);
        }
        self.older_run = None;
        self.count_gaps(step);
        self.accept(device_ns);
        Seen::New
    }

    /// Follows a run of older samples; the gaps that they seemed to fill come back when it was none.
    fn was_set_back(&mut self, device_ns: i64, step: i64) -> bool {
        let (samples, gaps) = match self.older_run {
            Some((last, samples, gaps)) if step < 0 && device_ns > last => (samples + 1, gaps),
            _ => (1, self.gaps),
        };
        self.older_run = (step < 0).then_some((device_ns, samples, gaps));
        let set_back = step < 0 && samples >= SET_BACK_SAMPLES;
        if set_back {
            self.gaps = gaps;
        }
        set_back
    }

    fn older(&mut self, device_ns: i64) -> Seen {
        if self
            .recent
            .iter()
            .take(self.recent_len)
            .any(|seen| *seen == device_ns)
        {
            return Seen::Duplicate;
        }
        self.remember(device_ns);
        // It was counted as missing when the later one came.
        self.gaps = self
            .gaps
            .saturating_sub(u64::from(self.period_ns.is_some()));
        Seen::Late
    }

    fn accept(&mut self, device_ns: i64) {
        self.last = Some(device_ns);
        self.remember(device_ns);
    }

    fn remember(&mut self, device_ns: i64) {
        if let Some(slot) = self.recent.get_mut(self.recent_at) {
            *slot = device_ns;
        }
        self.recent_at = (self.recent_at + 1) % REMEMBERED;
        self.recent_len = (self.recent_len + 1).min(REMEMBERED);
    }

    fn count_gaps(&mut self, step: i64) {
        if let Some(slot) = self.intervals.get_mut(self.intervals_at) {
            *slot = step;
        }
        self.intervals_at = (self.intervals_at + 1) % LATEST;
        self.intervals_len = (self.intervals_len + 1).min(LATEST);
        if let Some(period) = self.period_ns {
            self.gaps += self.missing(step, period);
            let period = match missing(step, period) {
                0 => period,
                _ => self.towards_median(period),
            };
            self.period_ns = Some(period);
            let deviation = step as f64 - period;
            if deviation.abs() < 0.3 * period {
                self.period_ns = Some(period + deviation / 64.0);
            }
            return;
        }
        if self.intervals_len == LEARNED_FROM {
            let mut sorted = [0.0; LATEST];
            let median = self.sorted(&mut sorted).get(LEARNED_FROM / 2);
            let median = median.copied().unwrap_or(1.0);
            self.period_ns = Some(median);
            let learned = self.intervals.iter().take(LEARNED_FROM);
            self.gaps += learned.map(|step| self.missing(*step, median)).sum::<u64>();
        }
    }

    /// Samples missing in an interval of `step` ns, as far as the stream's jitter does not explain it.
    fn missing(&self, step: i64, period: f64) -> u64 {
        let missing = missing(step, period);
        let mut sorted = [0.0; LATEST];
        if missing > 0 && step as f64 <= longest_by_jitter(self.sorted(&mut sorted), period) {
            return 0;
        }
        missing
    }

    /// Where the intervals show no period, nothing else holds the one that follows them.
    fn towards_median(&self, period: f64) -> f64 {
        let mut sorted = [0.0; LATEST];
        let sorted = self.sorted(&mut sorted);
        match sorted.get(sorted.len() / 2) {
            Some(median) if !shows_period(sorted, period) => period + 0.1 * (median - period),
            _ => period,
        }
    }

    /// The latest intervals, ns, from the shortest on.
    fn sorted<'a>(&self, into: &'a mut [f64; LATEST]) -> &'a [f64] {
        for (slot, step) in into.iter_mut().zip(self.intervals) {
            *slot = step as f64;
        }
        let latest = into.get_mut(..self.intervals_len).unwrap_or_default();
        latest.sort_unstable_by(f64::total_cmp);
        latest
    }
}

/// Samples missing in an interval of `step` ns.
fn missing(step: i64, period: f64) -> u64 {
    let periods = (step as f64 / period).round();
    // A float to integer `as` saturates.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    let periods = periods as u64;
    periods.saturating_sub(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Feeds stamps in ms, each arriving 1 ms late.
    fn feed(sequence: &mut Sequence, stamps: impl IntoIterator<Item = i64>) -> Vec<Seen> {
        let see = |ms: i64| sequence.observe(ms * MS, HostTime::from_nanos((ms + 1) * MS));
        stamps.into_iter().map(see).collect()
    }

    #[test]
    fn missing_samples_are_counted_also_while_the_period_is_learned() {
        let mut sequence = Sequence::new();
        let kept = (0..100).filter(|ms| ![3, 4, 9, 50, 70, 71, 72].contains(ms));
        feed(&mut sequence, kept);
        assert_eq!(sequence.gaps(), 7);
    }

    #[test]
    fn a_duplicate_is_told_from_a_late_sample() {
        let mut sequence = Sequence::new();
        feed(&mut sequence, (0..30).chain([31]));
        assert_eq!(sequence.gaps(), 1);
        assert_eq!(
            feed(&mut sequence, [30, 30, 31]),
            [Seen::Late, Seen::Duplicate, Seen::Duplicate]
        );
        assert_eq!(sequence.gaps(), 0);
    }

    #[test]
    fn a_clock_that_begins_anew_is_a_restart_and_no_gap() {
        let mut sequence = Sequence::new();
        feed(&mut sequence, 5_000..5_100);
        let restarted = sequence.observe(10 * MS, HostTime::from_nanos(5_200 * MS));
        assert_eq!(restarted, Seen::Restarted { was_ns: 5_099 * MS });
        assert_eq!(
            sequence.observe(11 * MS, HostTime::from_nanos(5_201 * MS)),
            Seen::New
        );
        assert_eq!(sequence.gaps(), 0);
    }

    #[test]
    fn a_clock_set_back_by_less_than_a_second_is_a_restart_and_no_gap() {
        let mut sequence = Sequence::new();
        feed(&mut sequence, 5_000..5_100);
        let mut seen = Vec::new();
        for (arrival, device) in (5_100..).zip(4_800..4_820) {
            seen.push(sequence.observe(device * MS, HostTime::from_nanos((arrival + 1) * MS)));
        }
        assert_eq!(seen[7], Seen::Restarted { was_ns: 5_099 * MS });
        assert!(seen[8..].iter().all(|seen| *seen == Seen::New), "{seen:?}");
        assert_eq!(sequence.gaps(), 0);
    }

    #[test]
    fn a_jump_forward_is_a_restart_too() {
        let mut sequence = Sequence::new();
        feed(&mut sequence, 0..50);
        let jumped = sequence.observe(90_000 * MS, HostTime::from_nanos(51 * MS));
        assert_eq!(jumped, Seen::Restarted { was_ns: 49 * MS });
    }

    #[test]
    fn a_host_that_stalls_and_loses_samples_is_no_restart() {
        let mut sequence = Sequence::new();
        feed(&mut sequence, 0..50);
        let late = HostTime::from_nanos(6_000 * MS);
        assert_eq!(sequence.observe(50 * MS, late), Seen::New);
        assert_eq!(sequence.observe(5_990 * MS, late), Seen::New);
        assert_eq!(sequence.gaps(), 5_939);
    }

    #[test]
    fn a_tracker_that_delivers_unevenly_has_gaps_where_it_stops_and_not_by_its_jitter() {
        let mut sequence = Sequence::new();
        let (mut state, mut at) = (1_u64, 0);
        let mut deliver = |count: usize, sequence: &mut Sequence| {
            for _ in 0..count {
                state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
                // 10 to 50 ms.
                at += 10 * MS + (state >> 33) as i64 % (40 * MS);
                sequence.observe(at, HostTime::from_nanos(at + MS));
            }
            at += 570 * MS;
        };
        deliver(1_000, &mut sequence);
        assert_eq!(sequence.gaps(), 0);
        // 20 periods of about 30 ms.
        deliver(1_000, &mut sequence);
        let gaps = sequence.gaps();
        assert!((15..30).contains(&gaps), "{gaps}");
    }

    #[test]
    fn jitter_of_the_device_is_no_gap() {
        let mut sequence = Sequence::new();
        for sample in 0..1_000_i64 {
            let device_ns = sample * MS + (sample * 7_919 % 200_000);
            sequence.observe(device_ns, HostTime::from_nanos(device_ns + MS));
        }
        assert_eq!(sequence.gaps(), 0);
    }
    #[test]
    fn samples_that_are_lost_count_also_when_stamps_have_jitter() {
        let mut state = 1_u64;
        let mut chance = move || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 33) as f64 / f64::from(1_u32 << 31)
        };
        for jitter in [0.1, 0.12, 0.15, 0.2] {
            for lost in [0.0, 0.05, 0.15, 0.3] {
                let (mut stamps, mut missing) = (Vec::new(), 0.0);
                for sample in 0..20_000 {
                    // The sum of twelve is normal, with a standard deviation of 1.
                    let normal = (0..12).map(|_| chance()).sum::<f64>() - 6.0;
                    if chance() < lost {
                        missing += 1.0;
                    } else {
                        stamps.push(((f64::from(sample) + jitter * normal) * MS as f64) as i64);
                    }
                }
                stamps.sort_unstable();
                let mut sequence = Sequence::new();
                for at in stamps {
                    sequence.observe(at, HostTime::from_nanos(at + 10 * MS));
                }
                let wrong = (sequence.gaps() as f64 - missing).abs();
                let most = if lost > 0.0 { 0.2 * missing } else { 300.0 };
                assert!(wrong <= most, "{jitter} {lost}: {}", sequence.gaps());
            }
        }
    }
}
