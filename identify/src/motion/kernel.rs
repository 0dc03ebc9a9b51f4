//! The fit's filter at single samples: what a zero-phase low-pass makes of a series is a weighted mean around each sample.

use core::ops::Range;

use crate::filter::{FilterError, LowPass};
use crate::products::in_vectors;

/// The zero-phase filter as weights.
#[derive(Clone, Debug)]
pub(super) struct Kernel {
    /// By distance, in samples.
    weights: Vec<f64>,
    /// From the farthest behind to the farthest ahead.
    pub(super) both_ways: Vec<f64>,
}

/// Weights below this share of the largest are left out.
const LEAST: f64 = 1e-5;

impl Kernel {
    pub(super) fn of(filter: &LowPass, cutoff_hz: f64, rate_hz: f64) -> Result<Self, FilterError> {
        let reach = (6.0 * rate_hz / cutoff_hz).ceil() as usize;
        let mut impulse = vec![0.0; 4 * reach + 1];
        impulse[2 * reach] = 1.0;
        let response = filter.zero_phase(&impulse)?;
        let mut weights = response[2 * reach..=3 * reach].to_vec();
        while weights.len() > 1 && weights.last().is_some_and(|w| w.abs() < LEAST * weights[0]) {
            weights.pop();
        }
        let whole = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
        for weight in &mut weights {
            *weight /= whole;
        }
        let behind = weights[1..].iter().rev();
        Ok(Self {
            both_ways: behind.chain(&weights).copied().collect(),
            weights,
        })
    }

    /// What a series of non-negative values may at most leave at each sample of `runs` through the filter's side lobes.
    pub(super) fn reach_of(&self, runs: &[Range<usize>], series: &[f64]) -> Vec<f64> {
        let mut envelope: Vec<f64> = self.weights.iter().map(|weight| weight.abs()).collect();
        for d in (1..envelope.len()).rev() {
            envelope[d - 1] = envelope[d - 1].max(envelope[d]);
        }
        let mut out = vec![0.0; series.len()];
        for run in runs {
            for from in run.clone().filter(|&i| series[i] > 0.0) {
                let first = run.start.max((from + 1).saturating_sub(envelope.len()));
                let end = run.end.min(from + envelope.len());
                for (at, out) in (first..).zip(&mut out[first..end]) {
                    *out += envelope[at.abs_diff(from)] * series[from];
                }
            }
        }
        out
    }

    /// Calls `f` with each sample that counts at `at` and its weight; beyond the ends of `run` the series goes on as its
    /// mirror image in the end point.
    pub(super) fn each(&self, run: &Range<usize>, at: usize, mut f: impl FnMut(usize, f64)) {
        let reach = self.weights.len() - 1;
        f(at, self.weights[0]);
        let inside = reach.min(at - run.start).min(run.end - 1 - at);
        for (d, weight) in self.weights.iter().enumerate().take(inside + 1).skip(1) {
            f(at - d, *weight);
            f(at + d, *weight);
        }
        let last = run.end - 1;
        for (d, weight) in self.weights.iter().enumerate().skip(inside + 1) {
            if let Some(i) = at.checked_sub(d).filter(|i| *i >= run.start) {
                f(i, *weight);
            } else {
                let mirrored = run.start + (run.start + d - at);
                f(run.start, 2.0 * weight);
                f(mirrored.min(last), -weight);
            }
            if at + d <= last {
                f(at + d, *weight);
            } else {
                let over = at + d - last;
                f(last, 2.0 * weight);
                f(last.saturating_sub(over).max(run.start), -weight);
            }
        }
    }

    /// The first of the samples about `at`, and the weights of all of them.
    pub(super) fn weights_about(&self, run: &Range<usize>, at: usize) -> (usize, Vec<f64>) {
        let reach = self.weights.len() - 1;
        let from = run.start.max(at.saturating_sub(reach));
        if from + reach == at && at + reach < run.end {
            return (from, self.both_ways.clone());
        }
        let mut weights = vec![0.0; run.end.min(at + reach + 1) - from];
        self.each(run, at, |i, weight| weights[i - from] += weight);
        (from, weights)
    }

    /// Of the weights of the samples from `from` on, those of a series without what this filter leaves of it at rest, which reach farther;
    /// the first of the samples comes before them.
    pub(super) fn without_rests(
        &self,
        run: &Range<usize>,
        slides: &[bool],
        from: usize,
        whole: Vec<f64>,
    ) -> (usize, Vec<f64>) {
        let to = from + whole.len();
        let Some(first) = (from..to).find(|&i| !slides[i]) else {
            return (from, whole);
        };
        let last = (first..to).rfind(|&i| !slides[i]).unwrap_or(first);
        let reach = self.weights.len() - 1;
        let wider = from.min(run.start.max(first.saturating_sub(reach)));
        let mut weights = vec![0.0; to.max(run.end.min(last + reach + 1)) - wider];
        weights[from - wider..to - wider].copy_from_slice(&whole);
        in_vectors(
            #[inline(always)]
            || {
                for i in (first..=last).filter(|&i| !slides[i]) {
                    let own = whole[i - from];
                    if i >= run.start + reach && i + reach < run.end {
                        let about = &mut weights[i - reach - wider..=i + reach - wider];
                        for (weight, by) in about.iter_mut().zip(&self.both_ways) {
                            *weight -= own * by;
                        }
                    } else {
                        self.each(run, i, |at, by| weights[at - wider] -= own * by);
                    }
                }
            },
        );
        (wider, weights)
    }
}
