//! How the clocks of poses and gyroscope drift apart: a line through the offsets of the parts of a recording.

use ft_wire::HostTime;

use super::{HALF_NS, STEP_NS, best};
use crate::calibrate::NORMAL_95;

/// A part, ns, ...
const PART_NS: i64 = 10_000_000_000;
/// ... but no more parts than these, ...
const MOST_PARTS: i64 = 12;
/// ... of which so many must show an offset, ...
const LEAST_PARTS: usize = 4;
/// ... the middles of the first and the last so far apart, s.
const LEAST_APART_S: f64 = 20.0;
/// Rows that a part needs.
const LEAST_ROWS: usize = 400;
/// Offsets of parts lie so near to that of the whole, steps.
const NEAR: i64 = 10;
/// 95 % of Student's distribution lie within so many standard deviations, by degrees of freedom from 1 on.
const STUDENT_95: [f64; 11] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201,
];

/// What a part says.
struct Part {
    middle_s: f64,
    offset_us: f64,
    /// One standard deviation, by the residuals' own size.
    std_us: f64,
}

/// By how much the poses' clock is slow, ppm, and one standard deviation, such that 1.96 of these are the 95 % interval. `turned` is what
/// the poses turn by, `shift` their offset in steps; `None` when too few parts of the recording show one.
pub(super) fn skew_ppm(
    turned: &[(i64, f64)],
    sums: &[(HostTime, f64)],
    shift: f64,
) -> Option<[f64; 2]> {
    let (first, last) = (turned.first()?.0, turned.last()?.0);
    let count = (last.saturating_sub(first) / PART_NS).clamp(1, MOST_PARTS);
    let length = (last - first) / count + 1;
    let parts: Vec<Part> = turned
        .chunk_by(|a, b| (a.0 - first) / length == (b.0 - first) / length)
        .filter_map(|rows| part(rows, sums, shift, first))
        .collect();
    let apart_s = parts.last()?.middle_s - parts.first()?.middle_s;
    if parts.len() < LEAST_PARTS || apart_s < LEAST_APART_S {
        return None;
    }
    let total = |value: &dyn Fn(&Part) -> f64| -> f64 {
        let weighted = parts
            .iter()
            .map(|part| value(part) / (part.std_us * part.std_us));
        weighted.sum()
    };
    let weight = total(&|_| 1.0);
    let (middle, offset) = (
        total(&|part| part.middle_s) / weight,
        total(&|part| part.offset_us) / weight,
    );
    let squares = total(&|part| (part.middle_s - middle).powi(2));
    // us in a second are ppm.
    let skew = total(&|part| (part.middle_s - middle) * part.offset_us) / squares;
    let freedom = parts.len() - 2;
    let left = total(&|part| (part.offset_us - offset - skew * (part.middle_s - middle)).powi(2));
    let scatter = (left / freedom as f64).sqrt().max(1.0);
    let student = STUDENT_95.get(freedom - 1).copied().unwrap_or(NORMAL_95);
    let std = scatter * student / NORMAL_95 / squares.sqrt();
    std.is_finite().then_some([skew, std])
}

fn part(rows: &[(i64, f64)], sums: &[(HostTime, f64)], shift: f64, first: i64) -> Option<Part> {
    let (from, to) = (rows.first()?.0, rows.last()?.0);
    #[allow(clippy::cast_possible_truncation, reason = "a shift is small")]
    let near = shift.round() as i64;
    let best = best(rows, sums, near - NEAR..=near + NEAR, LEAST_ROWS)?;
    if (best.shift - shift).abs() >= (NEAR - 1) as f64 || best.bend <= 0.0 {
        return None;
    }
    // Rows nearer to each other than what a rate is taken over say the same.
    let apart = (to - from) as f64 / best.rows as f64;
    let own = best.rows as f64 * (apart / (2 * HALF_NS) as f64).min(1.0);
    let step_us = 1e-3 * STEP_NS as f64;
    Some(Part {
        middle_s: 1e-9 * (0.5 * ((from - first) + (to - first)) as f64),
        offset_us: step_us * best.shift,
        std_us: step_us * (2.0 * best.left.max(1e-9) / (best.bend * own)).sqrt(),
    })
}
