//! What makes regressors: the weights of the fit's filter at the samples that fits use, made once, as a search makes thousands of them.

use core::ops::Range;

use super::kernel::Kernel;
use crate::parallel::in_parallel;
use crate::products::{LANES, dot_inline, in_vectors};

/// What makes a regressor of a series at the samples that fits use: the weights of a kernel there, on a series without what a smoother
/// leaves of it where the joint rests. Weights are zeros where they fill up whole vectors, which may go over the end of a run.
#[derive(Debug)]
pub(super) struct Rows {
    runs: Vec<Range<usize>>,
    kept: Vec<usize>,
    slides: Vec<bool>,
    /// For each kept sample the first that counts, and its weights' place in `weights`.
    pub(super) places: Vec<(usize, Range<usize>)>,
    /// First those that all samples have which see no rest and no end.
    pub(super) weights: Vec<f64>,
}

impl Rows {
    /// At the samples `kept` of `runs`; the joint rests where it does not slide.
    pub(super) fn of(
        [kernel, smoother]: [&Kernel; 2],
        runs: &[Range<usize>],
        kept: &[usize],
        slides: &[bool],
    ) -> Self {
        let common = kernel.both_ways.len().next_multiple_of(LANES);
        let each = in_parallel(kept, |&at| {
            let run = &runs[runs.partition_point(|run| run.end <= at)];
            let (from, weights) = kernel.weights_about(run, at);
            let (from, weights) = smoother.without_rests(run, slides, from, weights);
            let is_common = weights == kernel.both_ways && from + common <= slides.len();
            (from, (!is_common).then_some(weights))
        });
        let own = each.iter().filter_map(|(_, own)| own.as_ref());
        let own: usize = own.map(|own| own.len() + LANES).sum();
        let mut all = Self {
            runs: runs.to_vec(),
            kept: kept.to_vec(),
            slides: slides.to_vec(),
            places: Vec::with_capacity(kept.len()),
            weights: Vec::with_capacity(common + own),
        };
        all.weights.extend_from_slice(&kernel.both_ways);
        all.weights.resize(common, 0.0);
        for (from, own) in each {
            match own {
                Some(weights) => all.push(from, &weights),
                None => all.places.push((from, 0..common)),
            }
        }
        all
    }

    /// Adds the weights of the next sample, with zeros behind them, or before where the series ends.
    fn push(&mut self, from: usize, weights: &[f64]) {
        let more = weights.len().next_multiple_of(LANES) - weights.len();
        let (before, behind) = if from + weights.len() + more <= self.slides.len() {
            (0, more)
        } else {
            (more.min(from), 0)
        };
        let begin = self.weights.len();
        self.weights.resize(begin + before, 0.0);
        self.weights.extend_from_slice(weights);
        self.weights.resize(self.weights.len() + behind, 0.0);
        self.places.push((from - before, begin..self.weights.len()));
    }

    /// Whether it is of these samples and rests.
    pub(super) fn is_of(&self, runs: &[Range<usize>], kept: &[usize], slides: &[bool]) -> bool {
        self.runs == runs && self.kept == kept && self.slides == slides
    }

    /// The regressor of a series.
    pub(super) fn filtered(&self, series: &[f64]) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.places.len());
        in_vectors(
            #[inline(always)]
            || {
                for (from, weights) in &self.places {
                    let weights = &self.weights[weights.clone()];
                    out.push(dot_inline(weights, &series[*from..*from + weights.len()]));
                }
            },
        );
        out
    }
}
