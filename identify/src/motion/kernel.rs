//! The fit's filter at single samples: what a zero-phase low-pass makes of a series is a weighted mean around each sample,
//! so regressors that are zero nearly everywhere are filtered where they are not, and only for the samples that fits use.

use core::ops::Range;

use nalgebra::DMatrix;

use crate::filter::{FilterError, LowPass};
use crate::parallel::in_parallel;
use crate::products::{dot_inline, in_vectors};

/// The zero-phase filter as weights.
#[derive(Clone, Debug)]
pub(super) struct Kernel {
    /// By distance, in samples.
    weights: Vec<f64>,
    /// From the farthest behind to the farthest ahead.
    both_ways: Vec<f64>,
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
    fn each(&self, run: &Range<usize>, at: usize, mut f: impl FnMut(usize, f64)) {
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

    /// Fills `weights` with those of the samples about `at`, and gives the first of these samples.
    fn weights_about(&self, run: &Range<usize>, at: usize, weights: &mut Vec<f64>) -> usize {
        let reach = self.weights.len() - 1;
        let from = run.start.max(at.saturating_sub(reach));
        weights.clear();
        if from + reach == at && at + reach < run.end {
            weights.extend_from_slice(&self.both_ways);
        } else {
            weights.resize(run.end.min(at + reach + 1) - from, 0.0);
            self.each(run, at, |i, weight| weights[i - from] += weight);
        }
        from
    }

    /// Makes `weights` of the samples from `from` on those of a series without what this filter leaves of it at rest, and gives the
    /// first of the samples that they then reach.
    fn without_rests(
        &self,
        run: &Range<usize>,
        slides: &[bool],
        from: usize,
        weights: &mut Vec<f64>,
    ) -> usize {
        let to = from + weights.len();
        let Some(first) = (from..to).find(|&i| !slides[i]) else {
            return from;
        };
        let last = (first..to).rfind(|&i| !slides[i]).unwrap_or(first);
        let reach = self.weights.len() - 1;
        let wider = from.min(run.start.max(first.saturating_sub(reach)));
        let whole = weights.clone();
        weights.clear();
        weights.resize(from - wider, 0.0);
        weights.extend_from_slice(&whole);
        weights.resize(to.max(run.end.min(last + reach + 1)) - wider, 0.0);
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
        wider
    }

    /// The filtered series at the samples `kept` (ascending) of `runs`.
    pub(super) fn filtered(
        &self,
        runs: &[Range<usize>],
        kept: &[usize],
        series: &[f64],
    ) -> Vec<f64> {
        let mut out = Vec::with_capacity(kept.len());
        in_vectors(
            #[inline(always)]
            || {
                let mut run = 0;
                for &i in kept {
                    while run + 1 < runs.len() && i >= runs[run].end {
                        run += 1;
                    }
                    out.push(self.at(&runs[run], i, series));
                }
            },
        );
        out
    }

    /// The first so many samples of which the filtered series at the samples `kept` (ascending) is made.
    pub(super) fn reached(&self, kept: &[usize], samples: usize) -> Vec<Range<usize>> {
        let reach = self.weights.len() - 1;
        let mut out: Vec<Range<usize>> = Vec::new();
        for &at in kept {
            let about = at.saturating_sub(reach)..samples.min(at + reach + 1);
            match out.last_mut() {
                Some(last) if about.start <= last.end => last.end = about.end,
                _ => out.push(about),
            }
        }
        out
    }

    /// Takes off `out`, a copy of `series`, what the filter leaves of it at the samples of `parts` (ascending) that are not of `slides`.
    pub(super) fn take_off(
        &self,
        runs: &[Range<usize>],
        (parts, slides): (&[Range<usize>], &[bool]),
        series: &[f64],
        out: &mut [f64],
    ) {
        in_vectors(
            #[inline(always)]
            || {
                let mut run = 0;
                for i in parts.iter().flat_map(Range::clone) {
                    if slides[i] {
                        continue;
                    }
                    while run + 1 < runs.len() && i >= runs[run].end {
                        run += 1;
                    }
                    out[i] -= self.at(&runs[run], i, series);
                }
            },
        );
    }

    #[inline(always)]
    fn at(&self, run: &Range<usize>, at: usize, series: &[f64]) -> f64 {
        let reach = self.weights.len() - 1;
        if at >= run.start + reach && at + reach < run.end {
            return dot_inline(&self.both_ways, &series[at - reach..=at + reach]);
        }
        self.near_end(run, at, series)
    }

    #[cold]
    fn near_end(&self, run: &Range<usize>, at: usize, series: &[f64]) -> f64 {
        let mut sum = 0.0;
        self.each(run, at, |i, weight| sum += weight * series[i]);
        sum
    }
}

/// Regressors of which few are not zero at each sample.
#[derive(Clone, Debug, Default)]
pub struct SparseColumns {
    stretches: Vec<Stretch>,
    /// Of all stretches, one after the other.
    columns: Vec<usize>,
    /// The first, the next, ... values of each sample, as many levels as it takes for the columns of its stretch.
    levels: Vec<Vec<[f64; WIDTH]>>,
    samples: usize,
}

/// Samples in a row at which the same columns are not zero.
#[derive(Clone, Debug)]
struct Stretch {
    samples: Range<usize>,
    columns: Range<usize>,
}

/// Values of a level.
const WIDTH: usize = 4;
/// Samples whose filtered rows are made in one go.
const TOGETHER: usize = 16;

impl SparseColumns {
    /// No sample yet; room for `samples` with `each` entries.
    #[must_use]
    pub fn with_capacity(samples: usize, each: usize) -> Self {
        let level = || Vec::with_capacity(samples);
        Self {
            levels: (0..each.div_ceil(WIDTH)).map(|_| level()).collect(),
            ..Self::default()
        }
    }

    /// Adds the next sample's columns and values.
    pub fn push(&mut self, entries: impl IntoIterator<Item = (usize, f64)>) {
        let (first_column, sample) = (self.columns.len(), self.samples);
        let mut row = [0.0; WIDTH];
        let mut count = 0;
        for (column, value) in entries {
            row[count % WIDTH] = value;
            self.columns.push(column);
            count += 1;
            if count.is_multiple_of(WIDTH) {
                self.set(count / WIDTH - 1, sample, row);
                row = [0.0; WIDTH];
            }
        }
        if !count.is_multiple_of(WIDTH) {
            self.set(count / WIDTH, sample, row);
        }
        let own = first_column..self.columns.len();
        match self.stretches.last_mut() {
            Some(last) if self.columns[last.columns.clone()] == self.columns[own.clone()] => {
                last.samples.end += 1;
                self.columns.truncate(first_column);
            }
            _ => self.stretches.push(Stretch {
                samples: sample..sample + 1,
                columns: own,
            }),
        }
        self.samples += 1;
    }

    fn set(&mut self, level: usize, sample: usize, row: [f64; WIDTH]) {
        if level == self.levels.len() {
            self.levels.push(Vec::new());
        }
        let rows = &mut self.levels[level];
        // Samples without so many columns have nothing there.
        rows.resize(sample, [0.0; WIDTH]);
        rows.push(row);
    }

    /// Filtered at `kept` (ascending), without what `smoother` leaves at the samples that are not of `slides`: (kept, columns).
    pub(super) fn filtered(
        &self,
        kernel: &Kernel,
        runs: &[Range<usize>],
        (kept, slides, smoother): (&[usize], &[bool], &Kernel),
        columns: usize,
    ) -> DMatrix<f64> {
        let parts: Vec<&[usize]> = kept.chunks(TOGETHER).collect();
        let parts = in_parallel(&parts, |part| {
            self.filtered_rows(kernel, runs, (part, slides, smoother), columns)
        });
        // A matrix is stored column by column.
        let mut out = DMatrix::zeros(kept.len(), columns);
        for (first, rows) in (0..).step_by(TOGETHER).zip(&parts) {
            for (j, mut column) in out.column_iter_mut().enumerate() {
                let rows = rows.iter().skip(j).step_by(columns);
                for (value, new) in column.as_mut_slice()[first..].iter_mut().zip(rows) {
                    *value = *new;
                }
            }
        }
        out
    }

    /// As [`SparseColumns::filtered`], row by row.
    fn filtered_rows(
        &self,
        kernel: &Kernel,
        runs: &[Range<usize>],
        (kept, slides, smoother): (&[usize], &[bool], &Kernel),
        columns: usize,
    ) -> Vec<f64> {
        let mut rows = vec![0.0; kept.len() * columns];
        let mut weights = Vec::new();
        for (&at, row) in kept.iter().zip(rows.chunks_exact_mut(columns.max(1))) {
            let run = runs.partition_point(|run| run.end <= at);
            let run = &runs[run];
            let from = kernel.weights_about(run, at, &mut weights);
            let from = smoother.without_rests(run, slides, from, &mut weights);
            let near = self
                .stretches
                .partition_point(|one| one.samples.end <= from);
            in_vectors(
                #[inline(always)]
                || self.add_weighted(near, from, &weights, row),
            );
        }
        rows
    }

    /// Adds the samples from `from` on, each with its weight, to a row; stretch `near` holds the first of them.
    #[inline(always)]
    fn add_weighted(&self, near: usize, from: usize, weights: &[f64], out: &mut [f64]) {
        let to = from + weights.len();
        let all = self.stretches[near..].iter();
        for stretch in all.take_while(|stretch| stretch.samples.start < to) {
            let samples = stretch.samples.start.max(from)..stretch.samples.end.min(to);
            let weights = &weights[samples.start - from..samples.end - from];
            let columns = self.columns[stretch.columns.clone()].chunks(WIDTH);
            for (columns, rows) in columns.zip(&self.levels) {
                let sums = weighted_sums(&rows[samples.clone()], weights);
                for (&column, sum) in columns.iter().zip(sums) {
                    out[column] += sum;
                }
            }
        }
    }
}

/// The sum of all rows, weighted; four sums are carried side by side, so that none waits for the one before.
#[inline(always)]
fn weighted_sums(rows: &[[f64; WIDTH]], weights: &[f64]) -> [f64; WIDTH] {
    let mut sums = [[0.0; WIDTH]; 4];
    let ((rows, last), (weights, rest)) = (rows.as_chunks::<4>(), weights.as_chunks::<4>());
    for (rows, weights) in rows.iter().zip(weights) {
        for ((sums, row), weight) in sums.iter_mut().zip(rows).zip(weights) {
            for (sum, entry) in sums.iter_mut().zip(row) {
                *sum += entry * weight;
            }
        }
    }
    let [mut first, second, third, fourth] = sums;
    for (row, weight) in last.iter().zip(rest) {
        for (sum, entry) in first.iter_mut().zip(row) {
            *sum += entry * weight;
        }
    }
    core::array::from_fn(|k| (first[k] + second[k]) + (third[k] + fourth[k]))
}
