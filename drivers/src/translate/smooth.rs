//! The same lower envelope for a finished recording: windows around each instant, not only before it.
//!
//! The stamps are cut where the causal translator begins anew. In each piece a hull is put over the window around every knot, and
//! an instant gets the lines of the two knots around it, blended. A clock that bends (a crystal that warms up) is so followed
//! from both sides, and the first seconds are as good as the others.

use std::time::Duration;

use ft_wire::HostTime;

use super::hull::{Hull, Line};
use super::{OneWay, OneWayConfig, TRUSTED_AFTER_S, nanos};

/// Knots within a window.
const KNOTS: i64 = 6;
/// A clock that was set back shows only after a while: the place is looked for so long before, beyond the time that it takes.
const LOOK_BACK: Duration = Duration::from_secs(1);
/// ... and at least so many samples.
const LOOK_BACK_SAMPLES: usize = 64;

/// Translates (instant on the unwrapped device clock, ns; arrival) of one device, in the order of arrival. No answer is later than
/// its arrival, and within a piece the answers do not go back when the device's instants do not.
#[must_use]
pub fn smooth(observations: &[(i64, HostTime)], config: &OneWayConfig) -> Vec<HostTime> {
    let mut out = Vec::with_capacity(observations.len());
    for piece in pieces(observations, config) {
        translate(
            observations.get(piece).unwrap_or_default(),
            config,
            &mut out,
        );
    }
    out
}

/// Between restarts of the device clock.
fn pieces(observations: &[(i64, HostTime)], config: &OneWayConfig) -> Vec<core::ops::Range<usize>> {
    let mut causal = OneWay::new(*config);
    let mut cuts = vec![0];
    let mut resets = causal.resets;
    for (i, (device_ns, arrival)) in observations.iter().enumerate() {
        causal.observe(*device_ns, *arrival);
        if causal.resets != resets {
            let since = *arrival - config.set_back_after - LOOK_BACK;
            let earlier = observations.get(..i).unwrap_or_default();
            let near = earlier.iter().rev().take_while(|(_, at)| *at >= since);
            let from = i
                .saturating_sub(near.count().max(LOOK_BACK_SAMPLES))
                .max(cuts.last().copied().unwrap_or(0));
            cuts.push(step_between(observations, from, i));
        }
        resets = causal.resets;
    }
    cuts.push(observations.len());
    cuts.dedup();
    cuts.iter()
        .zip(cuts.iter().skip(1))
        .map(|(from, to)| *from..*to)
        .collect()
}

/// Where between `from` and `to` the device clock was set back: from there on all come late, against the promptest before. A link that
/// stalls is late, too, but not until `to`; a clock that went ahead shows at once, at `to`.
fn step_between(observations: &[(i64, HostTime)], from: usize, to: usize) -> usize {
    let offset =
        |(device_ns, arrival): &(i64, HostTime)| arrival.as_nanos().saturating_sub(*device_ns);
    let stretch = observations.get(from..=to).unwrap_or_default();
    let offsets: Vec<i64> = stretch.iter().map(offset).collect();
    let least = |least: &mut i64, offset: &i64| {
        *least = offset.min(least).to_owned();
        Some(*least)
    };
    let promptest: Vec<i64> = offsets.iter().scan(i64::MAX, least).collect();
    let (mut after, mut whole, mut place) = (i64::MAX, None, to);
    let behind_first = offsets.iter().skip(1).zip(&promptest).enumerate();
    for (i, (offset, promptest_before)) in behind_first.rev() {
        after = after.min(*offset);
        let late = after.saturating_sub(*promptest_before);
        let whole = *whole.get_or_insert(late);
        if whole <= 0 || late < whole / 2 {
            break;
        }
        place = from + i + 1;
    }
    place
}

fn translate(piece: &[(i64, HostTime)], config: &OneWayConfig, out: &mut Vec<HostTime>) {
    let mut growing: Vec<(i64, i64)> = Vec::with_capacity(piece.len());
    for (device_ns, arrival) in piece {
        if growing.last().is_none_or(|(last, _)| device_ns > last) {
            growing.push((*device_ns, arrival.as_nanos()));
        }
    }
    let knots = knots(&growing, config);
    let mut before: Option<(i64, HostTime)> = None;
    for (device_ns, arrival) in piece {
        let host = HostTime::from_nanos(blended(&knots, *device_ns)) - config.link_delay;
        let mut at = host.min(*arrival);
        if let Some((newest, newest_at)) = before
            && *device_ns >= newest
        {
            at = at.max(newest_at).min(*arrival);
        }
        if before.is_none_or(|(newest, _)| *device_ns >= newest) {
            before = Some((*device_ns, at));
        }
        out.push(at);
    }
}

/// Lines of windows, by the device's instant in the middle of each.
fn knots(growing: &[(i64, i64)], config: &OneWayConfig) -> Vec<(i64, Line)> {
    let (Some((first, _)), Some((last, _))) = (growing.first(), growing.last()) else {
        return Vec::new();
    };
    let window = nanos(config.window).max(1);
    let step = (window / KNOTS).max(1);
    // The last window ends with the piece.
    let end = last.saturating_sub(window).max(*first);
    let mut knots = Vec::new();
    let mut from = *first;
    loop {
        if from.saturating_add(step) > end {
            from = end;
        }
        knots.push(knot(growing, from, window, config));
        if from == end {
            return knots;
        }
        // A hole is passed over: what is far off must not ask for windows without end.
        let next = from.saturating_add(step);
        let after = growing.partition_point(|(x, _)| *x < next);
        let ahead = growing
            .get(after)
            .map_or(end, |(x, _)| x.saturating_sub(window));
        from = next.max(ahead).min(end);
    }
}

/// The line of the window that begins at `from`, and its middle.
fn knot(growing: &[(i64, i64)], from: i64, window: i64, config: &OneWayConfig) -> (i64, Line) {
    let to = from.saturating_add(window);
    let begin = growing.partition_point(|(x, _)| *x < from);
    let end = growing.partition_point(|(x, _)| *x <= to);
    let inside = growing.get(begin..end).unwrap_or_default();
    let mut hull = Hull::new();
    for (x, y) in inside {
        hull.add(*x, *y);
    }
    let ends = inside.first().zip(inside.last());
    let middle = ends.map_or(from, |((a, _), (b, _))| a.midpoint(*b));
    (middle, line(&hull, config))
}

fn line(hull: &Hull, config: &OneWayConfig) -> Line {
    let bound = config.max_skew_ppm.abs() * 1e-6;
    let trust = (hull.span_s() / TRUSTED_AFTER_S).powi(2).min(1.0);
    hull.support((trust * hull.middle_slope()).clamp(-bound, bound))
}

/// The lines of the two knots around `x`, each by how near it is; of the nearest beyond the ends.
fn blended(knots: &[(i64, Line)], x: i64) -> i64 {
    let after = knots.partition_point(|(middle, _)| *middle <= x);
    let left = after.checked_sub(1).and_then(|i| knots.get(i));
    match (left, knots.get(after)) {
        (Some((xa, a)), Some((xb, b))) => {
            let (ya, yb) = (a.at(x), b.at(x));
            let share = x.saturating_sub(*xa) as f64 / xb.saturating_sub(*xa).max(1) as f64;
            #[allow(
                clippy::cast_possible_truncation,
                reason = "a float to integer `as` saturates"
            )]
            let moved = (share * yb.saturating_sub(ya) as f64) as i64;
            ya.saturating_add(moved)
        }
        (Some((_, only)), None) | (None, Some((_, only))) => only.at(x),
        (None, None) => x,
    }
}
