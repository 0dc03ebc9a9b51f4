//! The equations of the curve by the measured coordinate.

use core::ops::Range;

use super::arrow::Arrow;
use super::colour::Colour;
use super::curve::{Curve, LOCAL, Weights};
use crate::least_squares::rms;
use crate::motion::Motion;

/// The equations of the curve by the measured coordinate alone, whitened.
pub(super) fn position_equations(motion: &Motion, curve: &Curve, colour: &Colour) -> Arrow {
    let width = LOCAL - 1 + colour.past.len().div_ceil(curve.step());
    let mut arrow = Arrow::new(curve.len(), width, 0);
    let places = curve.at_samples();
    position_rows(
        motion,
        curve,
        colour,
        &places,
        0..motion.q.len(),
        |first, row, right| {
            arrow.add(first, row, &[], right);
        },
    );
    for run in curve.runs() {
        // What hardly any sample touches, at a run's end, goes on as smoothly as ten times the motion's own bends allow.
        let bends: Vec<f64> = motion.q[run.clone()]
            .windows(3 * curve.step() + 1)
            .map(|w| [0, 1, 2, 3].map(|k| w[k * curve.step()]))
            .map(|[a, b, c, d]| d - 3.0 * (c - b) - a)
            .collect();
        let loose = 1.0 / (10.0 * rms(&bends)).max(f64::MIN_POSITIVE);
        let (first, last) = (places[run.start].0, places[run.end - 1].0 + LOCAL);
        for j in first..last - 3 {
            let third = [-loose, 3.0 * loose, -3.0 * loose, loose];
            arrow.add(j, &third, &[], 0.0);
        }
    }
    arrow
}

/// Calls `row` with the equation of each of `samples`' measured coordinates, whitened: the first coefficient of the curve, what the
/// equation has of it and those after it, and its right side.
pub(super) fn position_rows(
    motion: &Motion,
    curve: &Curve,
    colour: &Colour,
    places: &[(usize, &Weights)],
    samples: Range<usize>,
    mut row: impl FnMut(usize, &[f64], f64),
) {
    let order = colour.past.len();
    let mut values = vec![0.0; LOCAL + order.div_ceil(curve.step())];
    for run in curve.runs() {
        for i in run.start.max(samples.start)..run.end.min(samples.end) {
            let inside = i - run.start >= order;
            let past: &[f64] = if inside { &colour.past } else { &[] };
            // At a run's start the past is not known; a looser tie stands in for it.
            let weight = if inside { 1.0 } else { 0.2 } / colour.new_std;
            let first = places[i - past.len()].0;
            values.fill(0.0);
            let mut right = 0.0;
            for (back, share) in core::iter::once(-1.0)
                .chain(past.iter().copied())
                .enumerate()
            {
                let (from, weights) = places[i - back];
                for (j, value) in weights[0].iter().enumerate() {
                    values[from - first + j] -= share * value * weight;
                }
                right -= share * motion.q_measured[i - back] * weight;
            }
            row(first, &values[..places[i].0 - first + LOCAL], right);
        }
    }
}
