//! Values that stand still under new stamps: a tracker of 100 Hz that is published at 1 kHz gives each pose ten times.
//!
//! Such a value was measured when it first came; under its later stamps it is late, by half a period on average.

use std::borrow::Cow;

use super::Stamped;

/// Where the values of a stream begin to differ from the one before: a staircase is true where it steps. The very first counts
/// when the second differs; else nothing says how long it had stood already.
pub fn steps<T>(samples: &[T], is_same: impl Fn(&T, &T) -> bool) -> impl Iterator<Item = usize> {
    let first_differs = matches!(samples, [first, second, ..] if !is_same(first, second));
    let later = samples.windows(2).enumerate();
    first_differs
        .then_some(0)
        .into_iter()
        .chain(later.filter_map(move |(i, pair)| match pair {
            [a, b] if !is_same(a, b) => Some(i + 1),
            _ => None,
        }))
}

/// A value that stays for longer than this many periods stands still itself.
const STILL_PERIODS: f64 = 3.0;
/// In such a stretch values stand this many periods apart at least.
const STILL_SPACING: f64 = 0.75;

/// The samples, which stand by stamp, without those that only repeat the one before. Where a value stays for more than three
/// periods, of the steps' median, the thing itself stands still: some of its repetitions stay there, a period apart, and none
/// in the last period, in which it may have moved on. A tracker that lost its target and repeats the last pose for as long
/// looks the same.
#[must_use]
pub fn fresh<T: Clone + PartialEq>(samples: &[Stamped<T>]) -> Cow<'_, [Stamped<T>]> {
    let begins: Vec<usize> = steps(samples, |a, b| a.value == b.value).collect();
    if begins.len() == samples.len() {
        return Cow::Borrowed(samples);
    }
    let mut periods: Vec<f64> = begins
        .windows(2)
        .filter_map(|pair| match pair {
            [a, b] => Some(samples.get(*b)?.at.seconds_since(samples.get(*a)?.at)),
            _ => None,
        })
        .collect();
    if periods.is_empty() {
        return Cow::Borrowed(samples);
    }
    let middle = periods.len() / 2;
    let period = *periods.select_nth_unstable_by(middle, f64::total_cmp).1;
    let mut kept = Vec::with_capacity(begins.len());
    let mut place = 0;
    for stretch in samples.chunk_by(|a, b| a.value == b.value) {
        let (from, next) = (place, samples.get(place + stretch.len()));
        place += stretch.len();
        let (Some(first), Some(last)) = (stretch.first(), stretch.last()) else {
            continue;
        };
        let until = next.map_or(last.at, |next| next.at);
        let stands = until.seconds_since(first.at) > STILL_PERIODS * period;
        if begins.binary_search(&from).is_err() && !stands {
            continue;
        }
        kept.push(first.clone());
        let mut before = first.at;
        for sample in stretch.iter().skip(1).filter(|_| stands) {
            let may_be_old = next.is_some() && until.seconds_since(sample.at) < period;
            if !may_be_old && sample.at.seconds_since(before) >= STILL_SPACING * period {
                kept.push(sample.clone());
                before = sample.at;
            }
        }
    }
    Cow::Owned(kept)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_wire::HostTime;

    fn held(values: &[(i64, i32)]) -> Vec<Stamped<i32>> {
        let sample = |(ms, value): &(i64, i32)| Stamped {
            at: HostTime::from_nanos(ms * 1_000_000),
            value: *value,
        };
        values.iter().map(sample).collect()
    }

    /// Values that change every `hold` ms from `from` to `to` ms, every ms.
    fn staircase(from: i64, to: i64, hold: i64) -> Vec<(i64, i32)> {
        (from..to).map(|ms| (ms, (ms / hold) as i32)).collect()
    }

    fn stamps_ms(samples: &[Stamped<i32>]) -> Vec<i64> {
        samples
            .iter()
            .map(|s| s.at.as_nanos() / 1_000_000)
            .collect()
    }

    #[test]
    fn a_value_is_true_where_it_steps() {
        // How long the first value had stood already, nobody knows.
        let samples = held(&staircase(3, 100, 10));
        let expected: Vec<i64> = (1..10).map(|k| 10 * k).collect();
        assert_eq!(stamps_ms(&fresh(&samples)), expected);
    }

    #[test]
    fn a_stream_without_repetitions_is_as_it_was() {
        let samples = held(&staircase(0, 50, 1));
        assert!(matches!(fresh(&samples), Cow::Borrowed(_)));
        assert_eq!(fresh(&samples), samples.as_slice());
        assert!(fresh(&held(&[])).is_empty());
        // Nor is one in which nothing ever moves.
        let still = held(&[(0, 7), (1, 7), (2, 7)]);
        assert_eq!(fresh(&still), still.as_slice());
    }

    #[test]
    fn what_stands_still_stays_without_holes() {
        let mut values = staircase(0, 200, 10);
        values.extend((200..1_000).map(|ms| (ms, 19)));
        values.extend(staircase(1_000, 1_200, 10));
        let samples = held(&values);
        let found = stamps_ms(&fresh(&samples));
        let widest = found.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(widest <= Some(20), "{found:?}");
        // In the last period before it moves on it may have moved already.
        assert!(
            !found.iter().any(|ms| (991..1_000).contains(ms)),
            "{found:?}"
        );
        assert!((90..=150).contains(&found.len()), "{found:?}");
    }
}
