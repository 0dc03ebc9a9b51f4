//! The numbers of one publisher that did not come, as runs.

use std::collections::BTreeMap;

/// Runs of one publisher that are remembered; what does not fit is lost, and counted as that by who asks for it here.
const MOST_RUNS: usize = 65_536;
/// Times that a number is asked for in vain.
const MOST_ASKS: u8 = 8;

/// Runs of missing numbers, and how often each was asked for in vain.
#[derive(Debug, Default)]
pub(super) struct Missing {
    /// By the first number: the last, and the times.
    runs: BTreeMap<i64, (i64, u8)>,
}

impl Missing {
    /// The numbers `first..=last`, of which none was missing so far.
    pub(super) fn add(&mut self, first: i64, last: i64) {
        if first <= last && self.runs.len() < MOST_RUNS {
            self.runs.insert(first, (last, 0));
        }
    }

    /// Whether the number was missing; it is no longer.
    pub(super) fn fill(&mut self, number: i64) -> bool {
        let Some((&first, &(last, asks))) = self.runs.range(..=number).next_back() else {
            return false;
        };
        if number > last {
            return false;
        }
        self.runs.remove(&first);
        if first < number {
            self.runs.insert(first, (number - 1, asks));
        }
        if number < last {
            self.runs.insert(number + 1, (last, asks));
        }
        true
    }

    /// The publisher has nothing before `oldest` any more.
    pub(super) fn forget_before(&mut self, oldest: i64) {
        while let Some(run) = self.runs.first_entry().filter(|run| *run.key() < oldest) {
            let (last, asks) = run.remove();
            if last >= oldest {
                self.runs.insert(oldest, (last, asks));
            }
        }
    }

    /// The next runs to ask for: at most `runs` of together at most `numbers`.
    pub(super) fn portion(&self, runs: usize, numbers: i64) -> Vec<(i64, i64)> {
        let mut left = numbers;
        self.askable()
            .take(runs)
            .map_while(|(first, last)| {
                let last = last.min(first + left - 1);
                left -= last + 1 - first;
                (first <= last).then_some((first, last))
            })
            .collect()
    }

    /// The first number that is still worth asking for.
    pub(super) fn first(&self) -> Option<i64> {
        self.askable().next().map(|(first, _)| first)
    }

    /// The publisher answered, and what is left of these runs was not in it.
    pub(super) fn count_in_vain(&mut self, asked: &[(i64, i64)]) {
        for &(first, last) in asked {
            let before = self.runs.range(..first).next_back();
            let from = match before {
                Some((&start, &(end, _))) if end >= first => start,
                _ => first,
            };
            for (_, (_, asks)) in self.runs.range_mut(from..=last) {
                *asks = asks.saturating_add(1);
            }
        }
    }

    fn askable(&self) -> impl Iterator<Item = (i64, i64)> {
        self.runs
            .iter()
            .filter(|(_, (_, asks))| *asks < MOST_ASKS)
            .map(|(first, (last, _))| (*first, *last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn missing(runs: &[(i64, i64)]) -> Missing {
        let mut missing = Missing::default();
        for &(first, last) in runs {
            missing.add(first, last);
        }
        missing
    }

    #[test]
    fn a_number_that_comes_splits_its_run() {
        let mut missing = missing(&[(3, 9), (12, 12)]);
        assert!(!missing.fill(2) && !missing.fill(10));
        assert!(missing.fill(5) && !missing.fill(5));
        assert!(missing.fill(3) && missing.fill(12) && missing.fill(9));
        assert_eq!(missing.portion(9, 99), [(4, 4), (6, 8)]);
    }

    #[test]
    fn a_portion_is_bounded_in_runs_and_in_numbers() {
        let missing = missing(&[(1, 10), (20, 29), (40, 49)]);
        assert_eq!(missing.portion(9, 15), [(1, 10), (20, 24)]);
        assert_eq!(missing.portion(1, 100), [(1, 10)]);
        assert_eq!(missing.portion(9, 10), [(1, 10)]);
    }

    #[test]
    fn what_the_publisher_forgot_is_not_asked_for() {
        let mut missing = missing(&[(1, 10), (20, 29), (40, 49)]);
        missing.forget_before(25);
        assert_eq!(missing.portion(9, 99), [(25, 29), (40, 49)]);
        missing.forget_before(60);
        assert_eq!(missing.first(), None);
    }

    #[test]
    fn patience_ends_for_what_was_asked_and_only_for_that() {
        let mut missing = missing(&[(1, 10), (20, 29)]);
        for _ in 0..MOST_ASKS {
            missing.count_in_vain(&[(3, 12)]);
        }
        assert_eq!(missing.first(), Some(20));
        assert!(missing.fill(4), "it may come all the same");
    }
}
