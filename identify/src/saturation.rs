//! A force-torque sensor at the end of its range: its channel stays at its own extreme while the others move.

use core::ops::Range;

/// A channel that stayed at its extreme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Saturated {
    /// 0 to 5: force x y z, torque x y z.
    pub channel: usize,
    /// Where it stayed, N or N m.
    pub value: f64,
    /// Samples there.
    pub samples: usize,
    /// Samples that were looked at.
    pub of: usize,
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

    /// Share of the samples.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.samples as f64 / self.of.max(1) as f64
    }
}

/// Equal samples on end that no noisy signal has at its very extreme.
const LASTING: usize = 8;
/// Of means at least so many.
const LASTING_MEANS: usize = 3;

/// The channel of `wrench`, each a mean of so many that are `averaged`, that is longest at its extreme within `held`; nothing when none is. A device
/// that repeats whole samples is not saturated.
#[must_use]
pub fn find(wrench: &[[f64; 6]], averaged: usize, held: &[Range<usize>]) -> Option<Saturated> {
    let lasting = LASTING.div_ceil(averaged.max(1)).max(LASTING_MEANS);
    let of = held.iter().map(Range::len).sum();
    let channels = (0..6).filter_map(|channel| {
        let moves = |k: usize| {
            (0..6).any(|other| other != channel && wrench[k][other] != wrench[k - 1][other])
        };
        let (value, samples) = longest_of(lasting, held, |i| wrench[i][channel], moves)?;
        Some(Saturated {
            channel,
            value,
            samples,
            of,
        })
    });
    channels.max_by_key(|found| found.samples)
}

/// The extreme at which a series stays longest while something else `moves` from a sample's predecessor to it, and for how many samples; nothing
/// when it does at neither.
pub(crate) fn longest(
    held: &[Range<usize>],
    value: impl Fn(usize) -> f64,
    moves: impl Fn(usize) -> bool,
) -> Option<(f64, usize)> {
    longest_of(LASTING, held, value, moves)
}

/// As [`longest`], counting stretches of `lasting` samples and more.
fn longest_of(
    lasting: usize,
    held: &[Range<usize>],
    value: impl Fn(usize) -> f64,
    moves: impl Fn(usize) -> bool,
) -> Option<(f64, usize)> {
    let ends = [1.0, -1.0].map(|sign| {
        let all = held.iter().flat_map(Clone::clone);
        let (least, extreme) = all
            .map(|i| sign * value(i))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                (low.min(v), high.max(v))
            });
        // What never moves is not at its end.
        let is_extreme = |i: usize| extreme > least && sign * value(i) >= extreme;
        let stretches = held
            .iter()
            .flat_map(|run| at_extreme(lasting, run, &value, is_extreme, &moves));
        let stretches: Vec<(usize, bool)> = stretches.collect();
        // A range ends at one value each time; two tops of a signal are hardly as high.
        let clipped = stretches.len() > MOST_ROUND;
        let samples = stretches.iter().filter(|(_, round)| clipped || !round);
        (
            sign * extreme,
            samples.map(|(length, _)| length).sum::<usize>(),
        )
    });
    let longest = ends.into_iter().max_by_key(|(_, samples)| *samples);
    longest.filter(|(_, samples)| *samples > 0)
}

/// Lengths of the stretches of a run of at least `lasting` samples where `is_extreme` holds and something else moves, and whether each is the round
/// top of a signal of coarse steps: there for no longer than [`ROUND`] times what it is one step lower on a side.
fn at_extreme(
    lasting: usize,
    run: &Range<usize>,
    value: &impl Fn(usize) -> f64,
    is_extreme: impl Fn(usize) -> bool,
    moves: &impl Fn(usize) -> bool,
) -> Vec<(usize, bool)> {
    let mut out = Vec::new();
    let mut start = run.start;
    for i in run.start..=run.end {
        if i < run.end && is_extreme(i) {
            continue;
        }
        let mut stretch = start..i;
        let length = stretch.len();
        if length >= lasting && stretch.by_ref().skip(1).any(moves) {
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
            out.push((length, ROUND * sum >= count.max(1) * length));
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
        let found = find(&wrench(45.0), 1, &[0..400, 500..1000]).unwrap();
        assert_eq!((found.name(), found.unit()), ("force y", "N"));
        assert_eq!(found.value.abs(), 45.0);
        assert!(found.share() > 0.05 && found.share() < 0.3, "{found:?}");
    }

    #[test]
    fn short_clips_are_found_in_means() {
        // 22 ms at the end of the range each time, at 1 kHz, and its means over 5 ms.
        let at = |i: usize| {
            let force = (i as f64 * 0.05).sin().min(0.85);
            [force, i as f64 * 1e-3, 0.0, 0.0, 0.0, 0.0]
        };
        let wrench: Vec<[f64; 6]> = (0..1000).map(at).collect();
        let mean = |part: &[[f64; 6]]| {
            core::array::from_fn(|k| part.iter().map(|w| w[k]).sum::<f64>() / 5.0)
        };
        let means: Vec<[f64; 6]> = wrench.chunks(5).map(mean).collect();
        assert!(find(&wrench, 1, &[0..1000]).is_some());
        assert!(find(&means, 5, &[0..200]).is_some());
        assert_eq!(find(&means, 1, &[0..200]), None);
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
        assert_eq!(find(&coarse(9.0), 1, &[0..8000]), None);
        assert!(find(&coarse(6.0), 1, &[0..8000]).is_some());
    }

    #[test]
    fn a_channel_within_its_range_and_a_repeated_sample_are_not() {
        assert_eq!(find(&wrench(60.0), 1, &[0..1000]), None);
        assert_eq!(
            find(&[[3.0, 1.0, 0.0, 0.0, 0.0, 0.0]; 50], 1, &[0..50]),
            None
        );
    }
}
