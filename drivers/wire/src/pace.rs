//! How even a stream is: what of the times between its samples is jitter, and what a gap.

/// Times between samples that stay so near to whole periods (root mean square, in periods) are even: samples that are missing show there
/// as two periods, or more.
const EVEN: f64 = 0.15;
/// Whole periods can still be told up to here; times that have nothing to do with a period come to 0.289.
const LOST: f64 = 0.275;
/// Of times that still show periods one in ten is shorter by no more than this, in periods.
const MOST_SHORT: f64 = 0.5;
/// How far jitter reaches above the period, in what one time in ten is shorter by: 2.6 standard deviations of normal jitter. Missing
/// samples make no time shorter.
const REACH_SHORT: f64 = 2.0;
/// Of times without a period nine in ten are no longer than a certain one; a gap is longer than the median by so many times what that
/// one is. Of intervals by pure chance one in 20 000 is.
const REACH: f64 = 6.0;

/// The longest time between two samples that the jitter of their stream explains, in the unit of `sorted`, the times between neighbours
/// from the shortest on; 0 for a stream that is even about its `period`: its jitter explains no gap.
///
/// A tracker that delivers when it has something, and not by a clock, loses nothing by that. What it does lose can be told only where the
/// gap is longer than its own jitter.
#[must_use]
pub fn longest_by_jitter(sorted: &[f64], period: f64) -> f64 {
    if sorted.is_empty() || period.is_nan() || period <= 0.0 || off_periods(sorted, period) <= EVEN
    {
        return 0.0;
    }
    if shows_period(sorted, period) {
        return period + REACH_SHORT * (period - part(sorted, 1, 10)).max(0.0);
    }
    let median = part(sorted, 1, 2);
    median + REACH * (part(sorted, 9, 10) - median)
}

/// Whether times between samples, from the shortest on, are whole periods and jitter.
#[must_use]
pub fn shows_period(sorted: &[f64], period: f64) -> bool {
    off_periods(sorted, period) <= LOST && period - part(sorted, 1, 10) <= MOST_SHORT * period
}

/// Root mean square of how far the times are from whole periods, in periods.
fn off_periods(sorted: &[f64], period: f64) -> f64 {
    let off = |interval: &f64| {
        let periods = interval / period;
        (periods - periods.round()).powi(2)
    };
    (sorted.iter().map(off).sum::<f64>() / sorted.len() as f64).sqrt()
}

/// The time that `of / all` of the times are shorter than.
fn part(sorted: &[f64], of: usize, all: usize) -> f64 {
    sorted
        .get(sorted.len() * of / all)
        .copied()
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sorted(mut intervals: Vec<f64>) -> Vec<f64> {
        intervals.sort_unstable_by(f64::total_cmp);
        intervals
    }

    #[test]
    fn an_even_stream_explains_no_gap_however_many_it_has() {
        for every in [2, 5, 50] {
            let gap = |k: usize| if k.is_multiple_of(every) { 3.0 } else { 1.0 };
            let wobble = |k: usize| 0.02 * ((7 * k % 11) as f64 - 5.0);
            let intervals = (0..500).map(|k| gap(k) + wobble(k));
            assert_eq!(longest_by_jitter(&sorted(intervals.collect()), 1.0), 0.0);
        }
        assert_eq!(longest_by_jitter(&[], 1.0), 0.0);
        assert_eq!(longest_by_jitter(&[0.0, 0.0], 0.0), 0.0);
    }

    #[test]
    fn the_jitter_of_an_uneven_stream_is_no_gap() {
        // 0.5 to 1.5, and by pure chance.
        let uniform: Vec<_> = (0..500).map(|k| 0.5 + (k as f64 + 0.5) / 500.0).collect();
        let longest = longest_by_jitter(&sorted(uniform), 1.0);
        assert!((1.5..4.0).contains(&longest), "{longest}");
        let chance = (0..500).map(|k| -((f64::from(k) + 0.5) / 500.0).ln());
        let longest = longest_by_jitter(&sorted(chance.collect()), core::f64::consts::LN_2);
        assert!((9.0..12.0).contains(&longest), "{longest}");
    }
    #[test]
    fn jitter_of_a_period_explains_none_that_is_missing() {
        let mut state = 1_u64;
        let mut chance = move || {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            (state >> 33) as f64 / f64::from(1_u32 << 31)
        };
        for (jitter, lost) in [(0.12, 0.05), (0.12, 0.3), (0.15, 0.15), (0.2, 0.05)] {
            let mut stamps = Vec::new();
            for sample in 0..20_000 {
                // The sum of twelve is normal, with a standard deviation of 1.
                let normal = (0..12).map(|_| chance()).sum::<f64>() - 6.0;
                if chance() >= lost {
                    stamps.push(f64::from(sample) + jitter * normal);
                }
            }
            stamps.sort_unstable_by(f64::total_cmp);
            let intervals: Vec<_> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let intervals = sorted(intervals);
            let longest = longest_by_jitter(&intervals, intervals[intervals.len() / 2]);
            assert!(longest < 2.0, "{jitter} {lost}: {longest}");
        }
    }
}
