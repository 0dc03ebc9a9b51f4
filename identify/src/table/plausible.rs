//! What looks like other units in a table, or like a sensor at the end of its range. Nothing is changed for it: it is told.

use crate::samples::{JointSamples, quantile};
use crate::saturation;
use crate::screw::JointKind;

/// Slower nothing of a hand's motion is seen, faster nothing is sampled, Hz.
const RATE_HZ: [f64; 2] = [5.0, 100_000.0];
/// No slide reaches farther, m; the least that is in cm or mm does.
const MAX_SPAN_M: f64 = 20.0;
/// Three turns and a bit, rad; a quarter of a turn in degrees is more.
const MAX_SPAN_RAD: f64 = 20.0;
/// Half of the time a joint moves slower, m/s and rad/s.
const MAX_MEDIAN_SPEED: [f64; 2] = [2.0, 10.0];
/// Speeds are taken over this long, s: from one sample to the next noise is faster.
const SPEED_OVER_S: f64 = 0.02;

/// An effort that stays at its extreme for so much of the samples is cut off: a drive's may be limited, a sensor's is not known there.
const MOST_AT_EXTREME: f64 = 0.002;

/// Of samples that [`super::read_table`] gave; each asks a question.
#[must_use]
pub fn doubts(samples: &JointSamples) -> Vec<String> {
    let mut doubts = Vec::new();
    let rate = samples.rate_hz();
    if !(RATE_HZ[0]..=RATE_HZ[1]).contains(&rate) {
        doubts.push(format!(
            "{rate:.3e} samples per second (expected {} to {}): is the time in s?",
            RATE_HZ[0], RATE_HZ[1]
        ));
    }
    let (low, high) = samples.q_range();
    let span = high - low;
    let (max_span, max_speed, others) = match samples.kind {
        JointKind::Revolute => (MAX_SPAN_RAD, MAX_MEDIAN_SPEED[1], "degrees"),
        JointKind::Prismatic => (MAX_SPAN_M, MAX_MEDIAN_SPEED[0], "cm or mm"),
    };
    let unit = samples.kind.position_unit();
    if span > max_span {
        doubts.push(format!(
            "positions reach over {span:.0} {unit} (expected less than {max_span} {unit}): are they in {unit}, and not in {others}?"
        ));
    }
    let moves = |i: usize| samples.q[i] != samples.q[i - 1];
    if let Some((value, count)) = saturation::longest(&samples.runs, |i| samples.tau[i], moves) {
        let share = count as f64 / samples.len() as f64;
        if share > MOST_AT_EXTREME {
            doubts.push(format!(
                "the effort stays at {value:.1} {} for {:.1} % of the rows: is the sensor at the end of its range? What is cut off there cannot be identified",
                samples.kind.effort_unit(),
                100.0 * share
            ));
        }
    }
    let step = ((SPEED_OVER_S / samples.period).ceil() as usize).max(1);
    let seconds = step as f64 * samples.period;
    let speeds: Vec<f64> = samples
        .runs
        .iter()
        .flat_map(|run| {
            let q = &samples.q[run.clone()];
            q.iter()
                .zip(q.iter().skip(step))
                .map(|(a, b)| (b - a).abs() / seconds)
        })
        .collect();
    if speeds.is_empty() {
        return doubts;
    }
    let speed = quantile(&speeds, 0.5);
    if speed > max_speed {
        doubts.push(format!(
            "half of the time the joint moves faster than {speed:.1} {unit}/s (expected less than {max_speed} {unit}/s): are positions in {unit} and times in s?"
        ));
    }
    doubts
}
