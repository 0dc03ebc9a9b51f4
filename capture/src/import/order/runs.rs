//! Runs of rows by one clock. A clock that is set back, and goes on from there, gives times that were there already: sorted, the rows of
//! both would be mixed.

use super::MIN_GROUP;

/// A row with its stamp, ns, and its place in the file.
type Place<T> = (i64, usize, T);

/// So many rows on either side, by their medians, say whether time went on or back: two of them may be wrong.
const BESIDE: usize = 5;

/// In a run no more than one row in so many stands elsewhere than it should.
const MOST_FALLS: usize = 10;

/// Parts of one time that stand in another order join when they are sorted: no hole between them is longer, ns.
const JOINED_NS: i64 = 1_000_000_000;

/// What was left out for the sake of one clock.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct SetBack {
    /// Rows by other clocks.
    pub(super) left_out: u64,
    /// Rows of a run whose stamps are all there already: the same rows again.
    pub(super) repeated: u64,
}

/// Leaves the run with most rows, the first of several such, where rows, as they stand in the file, are by more than one clock.
pub(super) fn one_clock<T>(places: &mut Vec<Place<T>>) -> SetBack {
    let starts = starts(places);
    if starts.len() < 2 || !is_mixed(places, &starts) {
        return SetBack::default();
    }
    let ends = starts.iter().skip(1).copied().chain([places.len()]);
    let runs: Vec<_> = starts.iter().copied().zip(ends).collect();
    let longest = runs.iter().rev().max_by_key(|(from, to)| to - from);
    let Some(&(from, to)) = longest else {
        return SetBack::default();
    };
    let stamps = |(from, to): (usize, usize)| {
        let run = places.get(from..to).unwrap_or_default();
        let mut stamps: Vec<i64> = run.iter().map(|(at, _, _)| *at).collect();
        stamps.sort_unstable();
        stamps
    };
    let kept = stamps((from, to));
    let mut set_back = SetBack::default();
    for run in runs.iter().filter(|run| **run != (from, to)) {
        let all_there = stamps(*run).iter().all(|at| kept.binary_search(at).is_ok());
        let rows = (run.1 - run.0) as u64;
        match all_there {
            true => set_back.repeated += rows,
            false => set_back.left_out += rows,
        }
    }
    places.truncate(to);
    places.drain(..from);
    set_back
}

/// Where runs begin: at 0, and where time goes back and on from there.
fn starts<T>(places: &[Place<T>]) -> Vec<usize> {
    let at = |place: usize| places.get(place).map_or(0, |(at, _, _)| *at);
    let mut cuts = vec![0];
    let mut begin = 0;
    for place in 1..places.len() {
        if at(place) > at(place - 1) {
            continue;
        }
        let before = median(places, begin.max(place.saturating_sub(BESIDE)), place);
        let after = median(places, place, places.len().min(place + BESIDE));
        if after <= before {
            cuts.push(place);
            begin = place;
        }
    }
    // What is too short, or does not go on, are single rows elsewhere than they should be: they stay with the run before.
    let mut starts = vec![0];
    let ends = cuts.iter().skip(1).copied().chain([places.len()]);
    let mut has_run = false;
    for (from, to) in cuts.iter().copied().zip(ends) {
        let falls = (from + 1..to).filter(|place| at(*place) < at(place - 1));
        if to - from < MIN_GROUP || MOST_FALLS * falls.count() > to - from {
            continue;
        }
        if has_run {
            starts.push(from);
        }
        has_run = true;
    }
    starts
}

fn median<T>(places: &[Place<T>], from: usize, to: usize) -> i64 {
    let beside = places.get(from..to).unwrap_or_default();
    let mut stamps: Vec<i64> = beside.iter().map(|(at, _, _)| *at).collect();
    stamps.sort_unstable();
    stamps.get(stamps.len() / 2).copied().unwrap_or(0)
}

/// Whether rows of several runs, sorted, would stand among each other, or not join. If neither, they are parts of one clock's time that
/// stand in another order.
fn is_mixed<T>(places: &[Place<T>], starts: &[usize]) -> bool {
    let run = |place: usize| starts.partition_point(|start| *start <= place);
    // Single rows that are elsewhere than they should be say nothing of their run.
    let falls = |place: usize| {
        let pair = places.get(place.wrapping_sub(1)).zip(places.get(place));
        pair.is_some_and(|(a, b)| a.0 > b.0 && run(place - 1) == run(place))
    };
    let stamps = places.iter().enumerate();
    let mut sorted: Vec<(i64, usize)> = stamps
        .filter(|(place, _)| !falls(*place) && !falls(place + 1))
        .map(|(place, (at, _, _))| (*at, run(place)))
        .collect();
    sorted.sort_unstable();
    let changes = || {
        let pairs = sorted.windows(2);
        pairs.filter(|pair| pair[0].1 != pair[1].1)
    };
    let apart = changes().any(|pair| pair[1].0.saturating_sub(pair[0].0) > JOINED_NS);
    apart || changes().count() > 2 * (starts.len() - 1)
}
