//! Strokes: the motion between two reversals.

use core::ops::Range;

/// The stroke of each sample, counted from 0; a new one starts at each run and where the coordinate turns back by more
/// than `threshold`, counted from the turning point.
#[must_use]
pub fn strokes(runs: &[Range<usize>], q: &[f64], threshold: f64) -> Vec<usize> {
    let mut out = vec![0; q.len()];
    let mut count = 0;
    for (number, run) in runs.iter().enumerate() {
        if number > 0 {
            count += 1;
        }
        let mut turning = run.start;
        let mut direction = 0.0;
        for i in run.clone() {
            let moved = q[i] - q[turning];
            if moved * direction > 0.0 {
                turning = i;
            } else if moved.abs() > threshold {
                if direction != 0.0 {
                    count += 1;
                }
                direction = moved.signum();
                out[turning..i].fill(count);
                turning = i;
            }
            out[i] = count;
        }
    }
    out
}
