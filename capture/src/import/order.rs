//! Rows by their stamps, without those that are stamped at another time or by a clock that was set back.

use ft_recording::Stamped;
use ft_wire::HostTime;

use super::plausible::keep_near;

mod runs;

use runs::one_clock;

/// A hole that parts groups of rows, ns.
const HOLE_NS: i64 = 10_000_000_000;
/// Fewer rows than this with holes around them show no motion: their stamps are wrong.
const MIN_GROUP: usize = 20;

/// What to do about rows of another clock.
pub(super) const SET_BACK: &str = "by a clock that was set back, or by the one before: of two times in one file the longer is kept; \
                                   cut the file where the clock was set back to import each";

/// Rows by their stamps, and what became of the others.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Ordered<T> {
    /// Stamp, ns, and row; each later than the one before.
    pub(super) rows: Vec<(i64, T)>,
    /// Rows hours from the most, or some few with holes of 10 s around them: left out.
    pub(super) far: u64,
    /// Rows that stood elsewhere than by their stamps: put in their places.
    pub(super) moved: u64,
    /// Rows of the stamp of another, of which the first of the file is kept: left out.
    pub(super) repeated: u64,
    /// Rows by a clock that was set back, or by the one before it, whichever are fewer: left out.
    pub(super) set_back: u64,
}

impl<T> Ordered<T> {
    /// What the lines of a report say of rows that are left out; `None` when none is.
    pub(super) fn left_out(&self) -> Option<String> {
        let Self {
            far,
            repeated,
            set_back,
            ..
        } = self;
        (far + repeated + set_back > 0).then(|| {
            format!("{far} rows at another time, {repeated} of a stamp that was there, {set_back} by a clock that was set back: left out")
        })
    }

    /// The rows as samples.
    pub(super) fn stamped(self) -> Vec<Stamped<T>> {
        let rows = self.rows.into_iter();
        rows.map(|(at, value)| Stamped {
            at: HostTime::from_nanos(at),
            value,
        })
        .collect()
    }
}

/// Puts rows with their stamps, ns, in order; those of one stamp as they stand. Of several clocks, which would be mixed, the one with
/// most rows is taken.
pub(super) fn in_order<T: PartialEq>(rows: Vec<(i64, T)>) -> Ordered<T> {
    let mut places: Vec<(i64, usize, T)> = rows
        .into_iter()
        .enumerate()
        .map(|(place, (at, row))| (at, place, row))
        .collect();
    let set_back = one_clock(&mut places);
    places.sort_by_key(|(at, _, _)| *at);
    let all = places.len();
    // First: many rows of one wrong stamp are no majority.
    places.dedup_by_key(|(at, _, _)| *at);
    let later = places.len();
    keep_near(&mut places, |(at, _, _)| *at);
    leave_out_alone(&mut places);
    let moved = places.len() - longest_rise(places.iter().map(|(_, place, _)| *place));
    Ordered {
        far: (later - places.len()) as u64,
        moved: moved as u64,
        repeated: (all - later) as u64 + set_back.repeated,
        set_back: set_back.left_out,
        rows: places.into_iter().map(|(at, _, row)| (at, row)).collect(),
    }
}

fn leave_out_alone<T>(places: &mut Vec<(i64, usize, T)>) {
    let groups = places.chunk_by(|a, b| b.0.saturating_sub(a.0) < HOLE_NS);
    let kept: Vec<bool> = groups
        .flat_map(|group| std::iter::repeat_n(group.len() >= MIN_GROUP, group.len()))
        .collect();
    if kept.contains(&true) {
        let mut kept = kept.into_iter();
        places.retain(|_| kept.next().unwrap_or(true));
    }
}

/// Length of the longest part, in its order, that rises: all others stand elsewhere than they should.
fn longest_rise(places: impl Iterator<Item = usize>) -> usize {
    // The least place at which a rise of each length ends.
    let mut ends: Vec<usize> = Vec::new();
    for place in places {
        let length = ends.partition_point(|end| *end < place);
        match ends.get_mut(length) {
            Some(end) => *end = place,
            None => ends.push(place),
        }
    }
    ends.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// At 1 kHz, from 2 min after the clock's begin; a row holds its number.
    fn rows() -> Vec<(i64, usize)> {
        let at = |k: usize| 120_000_000_000 + k as i64 * 1_000_000;
        (0..5_000).map(|k| (at(k), k)).collect()
    }

    fn whole(rows: Vec<(i64, usize)>) -> Ordered<usize> {
        Ordered {
            rows,
            far: 0,
            moved: 0,
            repeated: 0,
            set_back: 0,
        }
    }

    #[test]
    fn one_wrong_stamp_costs_its_own_row_alone() {
        assert_eq!(in_order(rows()), whole(rows()));
        let at = rows()[100].0;
        for wrong in [at + 600_000_000_000, at * 10, at * 1_000, 0, 1_000_000_000] {
            let mut some = rows();
            some[100].0 = wrong;
            let found = in_order(some);
            assert_eq!((found.rows.len(), found.far), (4_999, 1), "{wrong}");
            assert_eq!((found.moved, found.repeated), (0, 0), "{wrong}");
        }
    }

    #[test]
    fn rows_in_any_order_are_the_same() {
        let mut swapped = rows();
        swapped.swap(10, 4_000);
        assert_eq!(in_order(swapped).moved, 2);
        let found = in_order(rows().into_iter().rev().collect());
        assert_eq!((found.rows, found.moved, found.far), (rows(), 4_999, 0));
        let mut mostly_0 = rows();
        mostly_0[1_000..].iter_mut().for_each(|row| row.0 = 0);
        let found = in_order(mostly_0);
        assert_eq!(
            (found.rows.len(), found.far, found.repeated),
            (1_000, 1, 3_999)
        );
        // Twice the same: the first of each pair is kept.
        let found = in_order([rows(), rows()].concat());
        let expected = (rows(), 5_000, 0);
        assert_eq!((found.rows, found.repeated, found.moved), expected);
    }

    #[test]
    fn a_pause_does_not_cost_the_rest() {
        let mut some = rows();
        for row in &mut some[2_000..] {
            row.0 += 90_000_000_000;
        }
        assert_eq!(in_order(some.clone()), whole(some));
        // Few rows are no less than there are.
        let few: Vec<_> = (1..4).map(|k| (k * 60_000_000_000, 0)).collect();
        assert_eq!(in_order(few.clone()), whole(few));
        assert_eq!(in_order(Vec::new()), whole(Vec::new()));
    }

    /// The rows, from number `from` on by a clock that is `back` ns behind.
    fn set_back(from: usize, back: i64) -> Vec<(i64, usize)> {
        let mut some = rows();
        some[from..].iter_mut().for_each(|row| row.0 -= back);
        some
    }

    #[test]
    fn two_clocks_are_not_mixed() {
        // By whole periods, by parts of one, by a few periods, to 2 s before the others, and to where the clock began.
        for back in [
            1_500_000_000,
            1_500_300_000,
            6_500_000,
            12_000_000,
            7_000_000_000,
            100_000_000_000,
        ] {
            for (from, kept) in [(2_000, 2_000..5_000), (3_000, 0..3_000)] {
                let found = in_order(set_back(from, back));
                let numbers: Vec<_> = found.rows.iter().map(|row| row.1).collect();
                assert_eq!(numbers, kept.clone().collect::<Vec<_>>(), "{back} {from}");
                assert_eq!(found.set_back, 5_000 - kept.len() as u64, "{back}");
                assert_eq!((found.moved, found.repeated, found.far), (0, 0, 0));
            }
        }
    }

    #[test]
    fn rows_that_are_late_are_no_clock_that_was_set_back() {
        let mut some = set_back(3_000, 1_500_300_000);
        // One late by some rows on either side, and one of another time where the clock was set back.
        some.swap(500, 520);
        some.swap(4_000, 4_030);
        some[2_999].0 = 125_500_000_000;
        let found = in_order(some);
        assert_eq!((found.rows.len(), found.set_back), (3_000, 2_000));
        assert_eq!(found.moved, 2);
    }

    #[test]
    fn parts_of_one_clock_in_another_order_are_put_together() {
        let all = rows();
        let parts = [&all[3_000..], &all[..1_000], &all[1_000..3_000]].concat();
        let found = in_order(parts);
        assert_eq!((found.rows, found.set_back), (rows(), 0));
        assert!(found.moved >= 2_000);
        // One of the rows again, between the parts.
        let parts = [&all[3_000..], &all[5..6], &all[..3_000]].concat();
        let found = in_order(parts);
        assert_eq!((found.rows, found.set_back, found.repeated), (rows(), 0, 1));
        // As a recorder that writes two buffers by turns does.
        let mut buffers = rows();
        for pair in buffers.chunks_mut(100) {
            pair.rotate_left(50);
        }
        let found = in_order(buffers);
        assert_eq!((found.rows, found.set_back), (rows(), 0));
    }
    #[test]
    fn some_rows_out_of_place_cost_no_others() {
        let wrong = |count: usize, stamp: &dyn Fn(i64) -> i64| {
            let mut some = rows();
            for row in &mut some[2_600..2_600 + count] {
                row.0 = stamp(row.0);
            }
            in_order(some)
        };
        let second = 1_000_000_000;
        for count in [1, 2, 3, 5, 10, 19] {
            for (name, found) in [
                ("at 0", wrong(count, &|_| 0)),
                ("1 min back", wrong(count, &|at| at - 60 * second)),
                ("1 min ahead", wrong(count, &|at| at + 60 * second)),
                ("back", wrong(count, &|at| at - 7 * second / 5)),
            ] {
                let right = found.rows.iter().filter(|row| row.0 == rows()[row.1].0);
                assert_eq!(right.count(), 5_000 - count, "{count} {name}");
                assert_eq!(found.rows.len(), 5_000 - count, "{count} {name}");
                assert_eq!(found.set_back, 0, "{count} {name}");
            }
        }
        // More are told as by another clock where they would be mixed with the others.
        let found = wrong(30, &|at| at - 7 * second / 5 - 300_000);
        assert_eq!((found.rows.len(), found.set_back), (4_970, 30));
    }

    #[test]
    fn rows_that_arrive_late_are_put_in_their_places() {
        for count in [1, 2, 3, 5, 10, 19, 30, 400] {
            let mut late = rows();
            late[1_200..2_600 + count].rotate_left(count);
            let found = in_order(late);
            assert_eq!((found.rows, found.moved), (rows(), count as u64));
        }
        // Past a pause of 5 s, and several times.
        let mut paused = rows();
        for row in &mut paused[3_500..] {
            row.0 += 5_000_000_000;
        }
        let mut late = paused.clone();
        late[3_400..3_600].rotate_left(5);
        assert_eq!(in_order(late).rows, paused);
        let mut late = rows();
        for begin in (100..4_500).step_by(400) {
            late[begin..begin + 300].rotate_left(4);
        }
        assert_eq!(in_order(late).rows, rows());
    }

    #[test]
    fn what_was_written_twice_is_once_there() {
        let all = rows();
        let found = in_order([&all[..3_000], &all[2_000..]].concat());
        assert_eq!((found.rows, found.repeated), (rows(), 1_000));
        // Other rows of the same stamps are by another clock; of these those that are the same are told as such.
        let mut other = all[2_000..4_500].to_vec();
        other[10..].iter_mut().for_each(|row| row.1 += 10_000);
        let found = in_order([&all[..4_000], &other].concat());
        assert_eq!(found.rows, all[..4_000]);
        assert_eq!((found.repeated, found.set_back), (10, 2_490));
    }

    #[test]
    fn a_part_at_an_earlier_time_that_does_not_join_is_told() {
        let mut parts = rows();
        for row in &mut parts[3_000..] {
            row.0 += 2_000_000_000;
        }
        parts.rotate_left(3_000);
        let found = in_order(parts);
        assert_eq!((found.rows.len(), found.set_back), (3_000, 2_000));
    }
}
