//! Regressors that are zero nearly everywhere are filtered where they are not, all at once.

use core::ops::Range;

use nalgebra::DMatrix;

use super::rows::Rows;
use crate::parallel::in_parallel;
use crate::products::in_vectors;

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

/// Rows of a matrix that are made in one go.
const TOGETHER: usize = 32;
/// Values of a level.
const WIDTH: usize = 4;

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

    /// Their regressors: (kept samples, columns).
    pub(super) fn filtered(&self, rows: &Rows, columns: usize) -> DMatrix<f64> {
        let parts: Vec<&[(usize, Range<usize>)]> = rows.places.chunks(TOGETHER).collect();
        let parts = in_parallel(&parts, |part| {
            let mut row = Row::of(columns);
            let mut entries = Vec::new();
            for (k, (from, weights)) in part.iter().enumerate() {
                let near = self
                    .stretches
                    .partition_point(|one| one.samples.end <= *from);
                let weights = &rows.weights[weights.clone()];
                in_vectors(
                    #[inline(always)]
                    || self.add_weighted(near, *from, weights, &mut row),
                );
                row.hand_over(|column, value| entries.push((k, column, value)));
            }
            entries
        });
        let mut out = DMatrix::zeros(rows.places.len(), columns);
        for (first, entries) in (0..).step_by(TOGETHER).zip(parts) {
            for (k, column, value) in entries {
                out[(first + k, column)] = value;
            }
        }
        out
    }

    /// Adds the samples from `from` on, each with its weight, to a row; stretch `near` holds the first of them.
    #[inline(always)]
    fn add_weighted(&self, near: usize, from: usize, weights: &[f64], out: &mut Row) {
        let to = from + weights.len();
        let all = self.stretches[near..].iter();
        for stretch in all.take_while(|stretch| stretch.samples.start < to) {
            let samples = stretch.samples.start.max(from)..stretch.samples.end.min(to);
            let weights = &weights[samples.start - from..samples.end - from];
            let columns = self.columns[stretch.columns.clone()].chunks(WIDTH);
            for (columns, rows) in columns.zip(&self.levels) {
                let sums = weighted_sums(&rows[samples.clone()], weights);
                for (&column, sum) in columns.iter().zip(sums) {
                    out.add(column, sum);
                }
            }
        }
    }
}

/// A row of a matrix that is zero nearly everywhere.
struct Row {
    values: Vec<f64>,
    /// Columns that something was added to.
    used: Vec<usize>,
    /// Of each column, whether it is one of them.
    is_used: Vec<bool>,
}

impl Row {
    fn of(columns: usize) -> Self {
        Self {
            values: vec![0.0; columns],
            used: Vec::new(),
            is_used: vec![false; columns],
        }
    }

    #[inline(always)]
    fn add(&mut self, column: usize, value: f64) {
        if !self.is_used[column] {
            self.is_used[column] = true;
            self.used.push(column);
        }
        self.values[column] += value;
    }

    /// Gives columns and values of what was added, and empties the row.
    fn hand_over(&mut self, mut give: impl FnMut(usize, f64)) {
        for column in self.used.drain(..) {
            self.is_used[column] = false;
            give(column, core::mem::take(&mut self.values[column]));
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
