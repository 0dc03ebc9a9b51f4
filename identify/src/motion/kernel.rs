//! The fit's filter at single samples: what a zero-phase low-pass makes of a series is a weighted mean around each sample,
//! so regressors that are zero nearly everywhere are filtered where they are not, and only for the samples that fits use.

use core::ops::Range;

use nalgebra::DMatrix;

use crate::filter::{FilterError, LowPass};

/// Weights of the zero-phase filter by distance, in samples.
#[derive(Clone, Debug)]
pub(super) struct Kernel(Vec<f64>);

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
        Ok(Self(weights))
    }

    /// What a series of non-negative values may at most leave at each sample of `runs` through the filter's side lobes.
    pub(super) fn reach_of(&self, runs: &[Range<usize>], series: &[f64]) -> Vec<f64> {
        let mut envelope: Vec<f64> = self.0.iter().map(|weight| weight.abs()).collect();
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
    fn each(&self, run: &Range<usize>, at: usize, mut f: impl FnMut(usize, f64)) {
        let reach = self.0.len() - 1;
        f(at, self.0[0]);
        let inside = reach.min(at - run.start).min(run.end - 1 - at);
        for (d, weight) in self.0.iter().enumerate().take(inside + 1).skip(1) {
            f(at - d, *weight);
            f(at + d, *weight);
        }
        let last = run.end - 1;
        for (d, weight) in self.0.iter().enumerate().skip(inside + 1) {
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

    /// The filtered series at one sample of a run.
    pub(super) fn at(&self, run: &Range<usize>, at: usize, series: &[f64]) -> f64 {
        let reach = self.0.len() - 1;
        if at >= run.start + reach && at + reach < run.end {
            let ahead = &series[at + 1..=at + reach];
            let behind = series[at - reach..at].iter().rev();
            let sides = ahead.iter().zip(behind).zip(&self.0[1..]);
            return self.0[0] * series[at] + sides.map(|((a, b), w)| w * (a + b)).sum::<f64>();
        }
        let mut sum = 0.0;
        self.each(run, at, |i, weight| sum += weight * series[i]);
        sum
    }
}

/// Regressors of which few are not zero at each sample.
#[derive(Clone, Debug, Default)]
pub struct SparseColumns {
    ends: Vec<usize>,
    entries: Vec<(usize, f64)>,
}

impl SparseColumns {
    /// No sample yet; room for `samples` with `each` entries.
    #[must_use]
    pub fn with_capacity(samples: usize, each: usize) -> Self {
        Self {
            ends: Vec::with_capacity(samples),
            entries: Vec::with_capacity(samples * each),
        }
    }

    /// Adds the next sample's columns and values.
    pub fn push(&mut self, entries: impl IntoIterator<Item = (usize, f64)>) {
        self.entries.extend(entries);
        self.ends.push(self.entries.len());
    }

    fn at(&self, sample: usize) -> &[(usize, f64)] {
        let start = if sample == 0 {
            0
        } else {
            self.ends[sample - 1]
        };
        &self.entries[start..self.ends[sample]]
    }

    /// Filtered at `kept` (ascending) without the samples that are not of `slides`, (kept, columns).
    pub(super) fn filtered(
        &self,
        kernel: &Kernel,
        runs: &[Range<usize>],
        (kept, slides): (&[usize], &[bool]),
        columns: usize,
    ) -> DMatrix<f64> {
        // Rows are made one after the other, and a matrix is stored column by column.
        let mut rows = DMatrix::zeros(columns, kept.len());
        let mut run = 0;
        for (&at, mut row) in kept.iter().zip(rows.column_iter_mut()) {
            while run + 1 < runs.len() && at >= runs[run].end {
                run += 1;
            }
            kernel.each(&runs[run], at, |i, weight| {
                if !slides[i] {
                    return;
                }
                for &(column, value) in self.at(i) {
                    row[column] += weight * value;
                }
            });
        }
        rows.transpose()
    }
}
