//! A force-torque sensor at the end of its range: its channel stays at its own extreme while the others move.

use core::ops::Range;

use ft_recording::Stamped;
use ft_wire::time::HostTime;

/// A channel that stayed at its extreme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturated {
    /// 0 to 5: force x y z, torque x y z.
    pub channel: usize,
    /// Where it stayed, N or N m.
    pub value: f64,
    /// How long, s.
    pub seconds: f64,
    /// How long was looked at, s.
    pub of: f64,
}

impl Saturated {
    /// Name of the channel.
    #[must_use]
    pub fn name(&self) -> &'static str {
        [
            "force x", "force y", "force z", "torque x", "torque y", "torque z",
        ][self.channel]
    }

    /// Unit of the channel.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        if self.channel < 3 { "N" } else { "N m" }
    }

    /// Share of the time.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.seconds / self.of.max(f64::MIN_POSITIVE)
    }
}

/// A channel at one of its extremes for a while.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Stretch {
    channel: usize,
    value: f64,
    /// s.
    at: Range<f64>,
    round: bool,
}

/// Equal samples on end that no noisy signal has at its very extreme.
const LASTING: usize = 8;

/// Where the channels of `wrench` stay at their extremes, s from `start`. A device that repeats whole samples is not there.
pub(crate) fn stretches(wrench: &[Stamped<[f64; 6]>], start: HostTime) -> Vec<Stretch> {
    let time = |i: usize| wrench[i.min(wrench.len() - 1)].at.seconds_since(start);
    let of_channel = |channel: usize| {
        let value = |i: usize| wrench[i].value[channel];
        let others = |i: usize| {
            (0..6)
                .filter(|k| *k != channel)
                .map(move |k| wrench[i].value[k])
        };
        let moves = |i: usize| others(i).ne(others(i - 1));
        let stretch = |extreme: f64, (samples, round): (Range<usize>, bool)| Stretch {
            channel,
            value: extreme,
            at: time(samples.start)..time(samples.end),
            round,
        };
        let ends = at_extremes(&[0..wrench.len()], value, moves).into_iter();
        let stretches =
            ends.flat_map(|(extreme, found)| found.into_iter().map(move |one| (extreme, one)));
        stretches
            .map(|(extreme, one)| stretch(extreme, one))
            .collect::<Vec<_>>()
    };
    (0..6).flat_map(of_channel).collect()
}

/// The channel that was longest at one of its extremes within `held`, s; nothing when none was.
#[must_use]
pub(crate) fn find(stretches: &[Stretch], held: &[Range<f64>]) -> Option<Saturated> {
    let of = held.iter().map(|part| part.end - part.start).sum();
    let within = |at: &Range<f64>| {
        let of = |part: &Range<f64>| part.end.min(at.end) - part.start.max(at.start);
        held.iter().map(|part| of(part).max(0.0)).sum::<f64>()
    };
    let mut longest: Option<Saturated> = None;
    for same in stretches.chunk_by(|a, b| a.channel == b.channel && a.value == b.value) {
        let each: Vec<(f64, bool)> = same.iter().map(|s| (within(&s.at), s.round)).collect();
        let there = || each.iter().filter(|(seconds, _)| *seconds > 0.0);
        let clipped = there().count() > MOST_ROUND;
        let seconds = there()
            .filter(|(_, round)| clipped || !round)
            .map(|s| s.0)
            .sum();
        if seconds > longest.map_or(0.0, |found| found.seconds) {
            let (channel, value) = (same[0].channel, same[0].value);
            longest = Some(Saturated {
                channel,
                value,
                seconds,
                of,
            });
        }
    }
    longest
}

/// The extreme at which a series stays longest while something else `moves` from a sample's predecessor to it, and for how many samples; nothing
/// when it does at neither.
pub(crate) fn longest(
    runs: &[Range<usize>],
    value: impl Fn(usize) -> f64,
    moves: impl Fn(usize) -> bool,
) -> Option<(f64, usize)> {
    let counted = at_extremes(runs, value, moves).map(|(extreme, found)| {
        // A range ends at one value each time; two tops of a signal are hardly as high.
        let clipped = found.len() > MOST_ROUND;
        let samples = found.iter().filter(|(_, round)| clipped || !round);
        (extreme, samples.map(|(stretch, _)| stretch.len()).sum())
    });
    let longest = counted.into_iter().max_by_key(|(_, samples)| *samples);
    longest.filter(|(_, samples)| *samples > 0)
}

/// Either extreme of a series, and its stretches there as [`at_extreme`] has them.
#[expect(clippy::type_complexity, reason = "two of a kind")]
fn at_extremes(
    runs: &[Range<usize>],
    value: impl Fn(usize) -> f64,
    moves: impl Fn(usize) -> bool,
) -> [(f64, Vec<(Range<usize>, bool)>); 2] {
    [1.0, -1.0].map(|sign| {
        let all = runs.iter().flat_map(Clone::clone);
        let (least, extreme) = all
            .map(|i| sign * value(i))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
        // What never moves is not at its end.
        let is_extreme = |i: usize| extreme > least && sign * value(i) >= extreme;
        let stretches = runs
            .iter()
            .flat_map(|run| at_extreme(run, &value, is_extreme, &moves));
        (sign * extreme, stretches.collect())
    })
}

/// The stretches of a run of at least [`LASTING`] samples where `is_extreme` holds and something else moves, and whether each is the round
/// top of a signal of coarse steps: there for no longer than [`ROUND`] times what it is one step lower on a side.
fn at_extreme(
    run: &Range<usize>,
    value: &impl Fn(usize) -> f64,
    is_extreme: impl Fn(usize) -> bool,
    moves: &impl Fn(usize) -> bool,
) -> Vec<(Range<usize>, bool)> {
    let mut out = Vec::new();
    let mut start = run.start;
    for i in run.start..=run.end {
        if i < run.end && is_extreme(i) {
            continue;
        }
        let stretch = start..i;
        let length = stretch.len();
        if length >= LASTING && stretch.clone().skip(1).any(moves) {
            // Next to it, one step lower.
            let near = |from: usize| {
                let step = 1.5 * (value(from) - value(start)).abs();
                move |k: &usize| (value(*k) - value(start)).abs() <= step
            };
            let before = (start > run.start)
                .then(|| (run.start..start).rev().take_while(near(start - 1)).count());
            let after = (i < run.end).then(|| (i..run.end).take_while(near(i)).count());
            let sides = [before, after].into_iter().flatten();
            let (sum, count) = sides.fold((0, 0), |(sum, n), side| (sum + side, n + 1));
            out.push((stretch, ROUND * sum >= count.max(1) * length));
        }
        start = i + 1;
    }
    out
}

/// See [`at_extreme`].
const ROUND: usize = 8;
/// More stretches at one extreme are no tops.
const MOST_ROUND: usize = 3;

#[cfg(test)]
mod tests {
    use super::*;

    /// What is found in samples 1 ms apart.
    fn found(wrench: &[[f64; 6]], held: &[Range<f64>]) -> Option<Saturated> {
        let stamped = (0..).zip(wrench).map(|(i, value)| Stamped {
            at: HostTime::from_nanos(i * 1_000_000),
            value: *value,
        });
        find(
            &stretches(&stamped.collect::<Vec<_>>(), HostTime::EPOCH),
            held,
        )
    }

    fn wrench(limit: f64) -> Vec<[f64; 6]> {
        (0..1000)
            .map(|i| {
                let t = f64::from(i) * 0.02;
                let mut out = [0.0; 6];
                out[1] = (50.0 * t.sin()).clamp(-limit, limit);
                out[4] = t.cos();
                out
            })
            .collect()
    }

    #[test]
    fn a_clipped_channel_is_found() {
        let found = found(&wrench(45.0), &[0.0..0.4, 0.5..1.0]).unwrap();
        assert_eq!((found.name(), found.unit()), ("force y", "N"));
        assert_eq!(found.value.abs(), 45.0);
        assert!(found.share() > 0.05 && found.share() < 0.3, "{found:?}");
    }

    #[test]
    fn short_clips_count_where_the_object_is_held() {
        // 9 ms at the end of the range, every 0.126 s.
        let at = |i: usize| {
            [
                (i as f64 * 0.05).sin().min(0.975),
                i as f64 * 1e-3,
                0.0,
                0.0,
                0.0,
                0.0,
            ]
        };
        let wrench: Vec<[f64; 6]> = (0..1000).map(at).collect();
        let all = found(&wrench, &[0.0..1.0]).unwrap();
        assert!((all.seconds - 8.0 * 9e-3).abs() < 6e-3, "{all:?}");
        let half = found(&wrench, &[0.0..0.5]).unwrap();
        assert!((half.seconds - 4.0 * 9e-3).abs() < 4e-3, "{half:?}");
        assert_eq!(found(&wrench, &[0.0..0.02]), None);
    }

    #[test]
    fn a_round_top_of_coarse_steps_is_none_and_a_clipped_one_is() {
        let coarse = |limit: f64| -> Vec<[f64; 6]> {
            let at = |i: usize| {
                let t = i as f64 * 0.001;
                let force = (7.12 * (2.0 * t).sin()).clamp(-limit, limit);
                [(force * 10.0).round() / 10.0, t.cos(), 0.0, 0.0, 0.0, 0.0]
            };
            (0..8000).map(at).collect()
        };
        assert_eq!(found(&coarse(9.0), &[0.0..8.0]), None);
        assert!(found(&coarse(6.0), &[0.0..8.0]).is_some());
    }

    #[test]
    fn a_channel_within_its_range_and_a_repeated_sample_are_not() {
        assert_eq!(found(&wrench(60.0), &[0.0..1.0]), None);
        assert_eq!(
            found(&[[3.0, 1.0, 0.0, 0.0, 0.0, 0.0]; 50], &[0.0..0.05]),
            None
        );
    }
}
