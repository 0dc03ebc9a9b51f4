//! Which samples a fit may use, and how many each gate took.

use super::Motion;
use crate::samples::quantile;

/// Fills `kept`, `gated` and `slow_speed`; gives the number of samples before the gates.
///
/// | gate | takes out |
/// |---|---|
/// | `border` | the filter's length at either end of a run |
/// | `slow` | within half a filter length of a speed below the threshold: stuck, or about to reverse |
/// | `limit` | within 0.5 % of the range of either end: end stops |
/// | `acceleration` | beyond three times what 99 % of the samples reach: a tracker that jumped |
pub(super) fn apply(motion: &mut Motion, cutoff_hz: f64) -> usize {
    let step = ((1.0 / (4.0 * cutoff_hz)) / motion.period).round().max(1.0) as usize;
    let border = (1.5 / cutoff_hz / motion.period).ceil() as usize;
    let window = (0.5 / cutoff_hz / motion.period).ceil() as usize;
    motion.slow_speed = slow_speed(motion);
    let stuck = widened(motion, window);
    let speeds: Vec<f64> = motion.ddq.iter().map(|a| a.abs()).collect();
    let implausible = 3.0 * quantile(&speeds, 0.99);
    let (low, high) = (quantile(&motion.q, 0.0), quantile(&motion.q, 1.0));
    let margin = 0.005 * (high - low);
    let mut total = 0;
    for run in motion.runs.clone() {
        for i in run.clone().step_by(step) {
            total += 1;
            let gate = if i < run.start + border || i + border >= run.end {
                Some("border")
            } else if stuck[i] {
                Some("slow")
            } else if motion.q[i] < low + margin || motion.q[i] > high - margin {
                Some("limit")
            } else if motion.ddq[i].abs() > implausible {
                Some("acceleration")
            } else {
                None
            };
            match gate {
                Some(name) => *motion.gated.entry(name).or_insert(0) += 1,
                None => motion.kept.push(i),
            }
        }
    }
    total
}

/// 2 % of the fast strokes' speed, but four times the velocity noise where that is known and larger, and never more
/// than a third of the typical speed, so that slow strokes survive.
fn slow_speed(motion: &Motion) -> f64 {
    let speeds: Vec<f64> = motion.dq.iter().map(|v| v.abs()).collect();
    let moving: Vec<f64> = speeds.iter().copied().filter(|v| *v > 0.02 * quantile(&speeds, 0.95)).collect();
    let noise = motion
        .noise_of_q
        .iter()
        .filter_map(|series| motion.filtered(&motion.derivative(series)).ok())
        .map(|series| crate::least_squares::rms(&series))
        .fold(0.0, f64::max);
    (0.02 * quantile(&speeds, 0.95)).max(4.0 * noise).min(quantile(&moving, 0.5) / 3.0)
}

/// True within `window` samples of a slow one, not across gaps.
fn widened(motion: &Motion, window: usize) -> Vec<bool> {
    let mut stuck = vec![false; motion.dq.len()];
    for run in &motion.runs {
        let mut until = 0;
        for i in run.clone() {
            if motion.dq[i].abs() < motion.slow_speed {
                until = i + window + 1;
            }
            stuck[i] = i < until;
        }
        let mut from = usize::MAX;
        for i in run.clone().rev() {
            if motion.dq[i].abs() < motion.slow_speed {
                from = i.saturating_sub(window);
            }
            stuck[i] |= i >= from;
        }
    }
    stuck
}
