//! Runs of rows by one clock. A clock that is set back, and goes on from there, gives times that were there already: sorted, the rows of
//! both would be mixed. Rows that are late, or stamped wrong, and behind which time goes on as before, are no other clock.

use std::collections::BTreeSet;

use super::MIN_GROUP;

/// A row with its stamp, ns, and its place in the file.
type Place<T> = (i64, usize, T);

/// So many rows on either side, by their medians, say whether time went on or back: two of them may be wrong.
const BESIDE: usize = 5;

/// A step longer than so many usual ones begins another piece. The medians of either side are five apart without one.
const JUMP: i64 = 10;

/// In a run no more than one row in so many stands elsewhere than it should.
const MOST_FALLS: usize = 10;

/// Parts of one time that stand in another order join when they are sorted: no hole between them is longer, ns.
const JOINED_NS: i64 = 1_000_000_000;

/// What was left out for the sake of one clock.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct SetBack {
    /// Rows by other clocks.
    pub(super) left_out: u64,
    /// Rows of these that are in the kept run as well, with the same stamp.
    pub(super) repeated: u64,
}

/// Leaves the run with most rows, the first of several such, and all that is by the same clock.
pub(super) fn one_clock<T: PartialEq>(places: &mut Vec<Place<T>>) -> SetBack {
    let (of, count) = runs(places);
    let rows = |run: usize| of.iter().filter(|of| **of == Some(run)).count();
    let Some(kept) = (0..count).rev().max_by_key(|run| rows(*run)) else {
        return SetBack::default();
    };
    let others = other_clocks(places, &of, count, kept);
    if !others.contains(&true) {
        return SetBack::default();
    }
    // Single rows go with those before them.
    let mut run = kept;
    let leaves = of.iter().map(|of| {
        run = of.unwrap_or(run);
        others.get(run).copied().unwrap_or(false)
    });
    let leaves: Vec<bool> = leaves.collect();
    let all = std::mem::take(places).into_iter().zip(leaves);
    let (left, stay): (Vec<_>, Vec<_>) = all.partition(|(_, leaves)| *leaves);
    *places = stay.into_iter().map(|(place, _)| place).collect();
    let mut known: Vec<&Place<T>> = places.iter().collect();
    known.sort_by_key(|(at, _, _)| *at);
    let is_known = |(at, _, row): &Place<T>| {
        let first = known.partition_point(|(known, _, _)| known < at);
        let found = known.get(first);
        found.is_some_and(|(known, _, same)| known == at && same == row)
    };
    let repeated = left.iter().filter(|(place, _)| is_known(place)).count() as u64;
    SetBack {
        left_out: left.len() as u64 - repeated,
        repeated,
    }
}

/// A part of the file in which time goes on by small steps, single rows aside.
struct Piece {
    from: usize,
    to: usize,
    /// Medians of its first and of its last rows.
    begins: i64,
    ends: i64,
    /// The piece of the same run before it.
    before: Option<usize>,
    after: Option<usize>,
    /// Rows of the run up to here.
    rows: usize,
}

/// The run of each row, none for those that are too few to be one, and how many runs there are.
///
/// A piece goes on from the latest end that is not after its begin: behind rows that are late or wrong time goes on where it was before.
fn runs<T>(places: &[Place<T>]) -> (Vec<Option<usize>>, usize) {
    let longest_step = JUMP.saturating_mul(usual_step(places));
    let mut pieces = pieces(places, longest_step);
    let mut ends = BTreeSet::new();
    for index in 0..pieces.len() {
        let begins = pieces[index].begins;
        if let Some(&(end, last)) = ends.range(..=(begins, index)).next_back() {
            let at_pace = begins.saturating_sub(end) <= longest_step;
            let goes_on = match pieces[last].after {
                None => at_pace || last + 1 == index || pieces[last].rows >= MIN_GROUP,
                // What went on from there by a jump was stamped ahead.
                Some(after) => at_pace && begins < pieces[after].begins,
            };
            if goes_on {
                if let Some(after) = pieces[last].after.replace(index) {
                    pieces[after].before = None;
                }
                pieces[index].before = Some(last);
                pieces[index].rows += pieces[last].rows;
            }
        }
        ends.insert((pieces[index].ends, index));
    }
    let mut run_of: Vec<usize> = Vec::new();
    // Rows, and of these such as are not later than those before, by run.
    let mut sizes: Vec<(usize, usize)> = Vec::new();
    for piece in &pieces {
        let run = piece.before.map_or(sizes.len(), |before| run_of[before]);
        if run == sizes.len() {
            sizes.push((0, 0));
        }
        run_of.push(run);
        let rows = places.get(piece.from..piece.to).unwrap_or_default();
        sizes[run].0 += rows.len();
        let goes_on = |before: usize| pieces[before].ends < piece.begins;
        let falls = rows.windows(2).filter(|pair| pair[1].0 <= pair[0].0);
        sizes[run].1 += falls.count() + usize::from(!piece.before.is_none_or(goes_on));
    }
    let mut count = 0;
    let numbers: Vec<Option<usize>> = sizes
        .iter()
        .map(|(rows, falls)| {
            let is_run = *rows >= MIN_GROUP && MOST_FALLS * falls <= *rows;
            count += usize::from(is_run);
            is_run.then(|| count - 1)
        })
        .collect();
    let of = pieces.iter().zip(run_of);
    let of = of.flat_map(|(piece, run)| std::iter::repeat_n(numbers[run], piece.to - piece.from));
    (of.collect(), count)
}

/// The median of the steps forward, ns.
fn usual_step<T>(places: &[Place<T>]) -> i64 {
    let steps = places.windows(2);
    let steps = steps.map(|pair| pair[1].0.saturating_sub(pair[0].0));
    let mut steps: Vec<i64> = steps.filter(|step| *step > 0).collect();
    let middle = steps.len() / 2;
    match steps.is_empty() {
        true => 0,
        false => *steps.select_nth_unstable(middle).1,
    }
}

fn pieces<T>(places: &[Place<T>], longest_step: i64) -> Vec<Piece> {
    let mut pieces = Vec::new();
    let mut from = 0;
    let mut push = |from: usize, to: usize| {
        pieces.push(Piece {
            from,
            to,
            begins: median(places, from, to.min(from + BESIDE)),
            ends: median(places, from.max(to.saturating_sub(BESIDE)), to),
            before: None,
            after: None,
            rows: to - from,
        });
    };
    for (place, pair) in (1_usize..).zip(places.windows(2)) {
        let step = pair[1].0.saturating_sub(pair[0].0);
        if (1..=longest_step).contains(&step) {
            continue;
        }
        let before = median(places, from.max(place.saturating_sub(BESIDE)), place);
        let after = median(places, place, places.len().min(place + BESIDE));
        let ends = if step > 0 {
            after.saturating_sub(before) > longest_step
        } else {
            after <= before
        };
        if ends {
            push(from, place);
            from = place;
        }
    }
    if from < places.len() {
        push(from, places.len());
    }
    pieces
}

fn median<T>(places: &[Place<T>], from: usize, to: usize) -> i64 {
    let beside = places.get(from..to).unwrap_or_default();
    let mut stamps: Vec<i64> = beside.iter().map(|(at, _, _)| *at).collect();
    stamps.sort_unstable();
    stamps.get(stamps.len() / 2).copied().unwrap_or(0)
}

/// How a run stands to the kept one by time and by place in the file.
#[derive(Clone, Default)]
struct Beside {
    /// Kept rows before its first row by time, and before its latest so far; ...
    kept_before: Option<(usize, usize)>,
    /// ... how often there are such between two of its rows.
    parted: usize,
    /// Whether no hole parts it from the kept run.
    joins: bool,
}

/// Which runs, sorted, would stand among the rows of the kept one, or not join it. If neither, they are parts of one clock's time that
/// stand in another order.
fn other_clocks<T: PartialEq>(
    places: &[Place<T>],
    of: &[Option<usize>],
    count: usize,
    kept: usize,
) -> Vec<bool> {
    let sorted = by_time(places, of);
    // Stretches of time between holes that have one run before and another behind.
    let mut stretch = 0;
    let hole = |pair: &[(i64, usize)]| {
        pair[0].1 != pair[1].1 && pair[1].0.saturating_sub(pair[0].0) > JOINED_NS
    };
    let later = sorted.windows(2).map(|pair| {
        stretch += usize::from(hole(pair));
        stretch
    });
    let stretches: Vec<usize> = std::iter::once(0).chain(later).collect();
    let of_kept = || {
        sorted
            .iter()
            .zip(&stretches)
            .filter(|((_, run), _)| *run == kept)
    };
    let kept_in: BTreeSet<usize> = of_kept().map(|(_, stretch)| *stretch).collect();
    let mut beside = vec![Beside::default(); count];
    let mut before = 0;
    for ((_, run), stretch) in sorted.iter().zip(&stretches) {
        before += usize::from(*run == kept);
        let beside = &mut beside[*run];
        let (first, latest) = beside.kept_before.unwrap_or((before, before));
        beside.parted += usize::from(latest != before);
        beside.kept_before = Some((first, before));
        beside.joins |= kept_in.contains(stretch);
    }
    // Where the kept run goes on behind another, no clock was set back.
    let first = of.iter().position(|of| *of == Some(kept));
    let last = of.iter().rposition(|of| *of == Some(kept));
    let mut returns = vec![true; count];
    for (place, run) in of.iter().enumerate() {
        if let Some(run) = run {
            returns[*run] &= Some(place) > first && Some(place) < last;
        }
    }
    let mut others: Vec<bool> = beside
        .iter()
        .zip(returns)
        .map(|(run, returns)| {
            let Some((first, latest)) = run.kept_before else {
                return false;
            };
            let changes = 2 * (run.parted + 1);
            let changes = changes - usize::from(first == 0) - usize::from(latest == before);
            changes > 2 || !(run.joins || returns)
        })
        .collect();
    others[kept] = false;
    // What is left may still be mixed without the kept run.
    let left = others.iter().filter(|other| !**other).count();
    let mut runs: Vec<usize> = sorted.iter().map(|(_, run)| *run).collect();
    runs.retain(|run| !others[*run]);
    runs.dedup();
    if runs.len() > 2 * (left - 1) + 1 {
        others.fill(true);
        others[kept] = false;
    }
    others
}

/// Stamps and runs, the same row of several runs once. Single rows that are elsewhere than they should be say nothing of their run.
fn by_time<T: PartialEq>(places: &[Place<T>], of: &[Option<usize>]) -> Vec<(i64, usize)> {
    let falls = |place: usize| {
        let pair = places.get(place.wrapping_sub(1)).zip(places.get(place));
        pair.is_some_and(|(a, b)| a.0 > b.0 && of[place - 1] == of[place])
    };
    let rows = places.iter().zip(of).enumerate();
    let mut sorted: Vec<(&Place<T>, usize)> = rows
        .filter(|(place, _)| !falls(*place) && !falls(place + 1))
        .filter_map(|(_, (row, run))| Some((row, (*run)?)))
        .collect();
    sorted.sort_by_key(|((at, _, _), _)| *at);
    sorted.dedup_by(|(b, _), (a, _)| a.0 == b.0 && a.2 == b.2);
    sorted.iter().map(|(row, run)| (row.0, *run)).collect()
}
