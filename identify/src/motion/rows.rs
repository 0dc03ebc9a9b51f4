//! What makes regressors: the weights of the fit's filter at the samples that fits use, made once, as a search makes thousands of them.

use core::ops::Range;

use super::kernel::Kernel;
use crate::parallel::in_parallel;
use crate::products::{LANES, dot_inline, in_vectors};

/// What makes a regressor of a series at the samples that fits use: the weights of a kernel there, on a series without what a smoother
/// leaves of it where the joint rests.
#[derive(Debug)]
pub(super) struct Rows {
    kept: Vec<usize>,
    slides: Vec<bool>,
    /// For each kept sample the first that counts, and its weights' place in `weights`.
    pub(super) rows: Vec<(usize, Range<usize>)>,
    /// Those of a sample that sees no rest and no end come first: most have them.
    pub(super) weights: Vec<f64>,
}

/// Samples whose weights, or whose rows of a matrix, are made in one go.
pub(super) const TOGETHER: usize = 16;

impl Rows {
    /// At the samples `kept` (ascending) of `runs`; the joint rests where it does not slide.
    pub(super) fn of(
        [kernel, smoother]: [&Kernel; 2],
        runs: &[Range<usize>],
        kept: &[usize],
        slides: &[bool],
    ) -> Self {
        let common = kernel.both_ways.len().next_multiple_of(LANES);
        let parts: Vec<&[usize]> = kept.chunks(TOGETHER).collect();
        let parts = in_parallel(&parts, |part| {
            let own = part.iter().map(|&at| {
                let run = &runs[runs.partition_point(|run| run.end <= at)];
                let mut weights = Vec::new();
                let from = kernel.weights_about(run, at, &mut weights);
                let from = smoother.without_rests(run, slides, from, &mut weights);
                let is_common = weights == kernel.both_ways && from + common <= slides.len();
                (from, (!is_common).then_some(weights))
            });
            own.collect::<Vec<_>>()
        });
        let rows = parts.iter().flatten();
        let own: usize = rows
            .flat_map(|(_, own)| own)
            .map(|own| own.len() + LANES)
            .sum();
        let mut all = Self {
            kept: kept.to_vec(),
            slides: slides.to_vec(),
            rows: Vec::with_capacity(kept.len()),
            weights: Vec::with_capacity(common + own),
        };
        all.weights.extend_from_slice(&kernel.both_ways);
        all.weights.resize(common, 0.0);
        for (from, own) in parts.into_iter().flatten() {
            match own {
                Some(weights) => all.push(from, &weights),
                None => all.rows.push((from, 0..common)),
            }
        }
        all
    }

    /// Adds the weights of the next sample, with zeros where they make whole vectors.
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
        self.rows.push((from - before, begin..self.weights.len()));
    }

    /// Whether it is of these samples and rests.
    pub(super) fn is_of(&self, kept: &[usize], slides: &[bool]) -> bool {
        self.kept == kept && self.slides == slides
    }

    /// The regressor of a series.
    pub(super) fn filtered(&self, series: &[f64]) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.rows.len());
        in_vectors(
            #[inline(always)]
            || {
                for (from, weights) in &self.rows {
                    let weights = &self.weights[weights.clone()];
                    out.push(dot_inline(weights, &series[*from..*from + weights.len()]));
                }
            },
        );
        out
    }
}
