//! The same lower envelope for a finished recording: windows around each instant, not only before it.
//!
//! The stamps are cut where the causal translator begins anew. In each piece a hull is put over the window around every knot, and
//! an instant gets the lines of the two knots around it, blended. A clock that bends (a crystal that warms up) is so followed
//! from both sides, and the first seconds are as good as the others.

use ft_wire::HostTime;

use super::hull::{Hull, Line};
use super::{OneWay, OneWayConfig, TRUSTED_AFTER_S, nanos};

/// Knots within a window.
const KNOTS: i64 = 6;
/// A clock that was set back shows only after a while: the place is looked for so many samples back.
const LOOK_BACK: usize = 4_000;

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
    let mut seen = 0;
    for (i, (device_ns, arrival)) in observations.iter().enumerate() {
        causal.observe(*device_ns, *arrival);
        let now = causal.status().map_or(0, |status| status.observations);
        if now < seen {
            let from = i
                .saturating_sub(LOOK_BACK)
                .max(cuts.last().copied().unwrap_or(0));
            cuts.push(largest_step(observations, from, i));
        }
        seen = now;
    }
    cuts.push(observations.len());
    cuts.dedup();
    cuts.iter()
        .zip(cuts.iter().skip(1))
        .map(|(from, to)| *from..*to)
        .collect()
}

/// Where between `from` and `to` the device clock jumped most against the arrivals.
fn largest_step(observations: &[(i64, HostTime)], from: usize, to: usize) -> usize {
    let offset = |i: usize| {
        let (device_ns, arrival) = observations.get(i)?;
        Some(arrival.as_nanos().saturating_sub(*device_ns))
    };
    let step = |i: &usize| {
        let (now, before) = (offset(*i)?, offset(i - 1)?);
        Some(now.saturating_sub(before).unsigned_abs())
    };
    (from + 1..=to).max_by_key(step).unwrap_or(to)
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
    let count = (last - first - window).max(0) / step;
    (0..=count)
        .map(|k| {
            // The last window ends with the piece.
            let from = if k == count {
                (last - window).max(*first)
            } else {
                first + k * step
            };
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
        })
        .collect()
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
            let share = (x - xa) as f64 / (xb - xa).max(1) as f64;
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
