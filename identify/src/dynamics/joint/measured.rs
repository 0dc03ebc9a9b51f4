//! What the joint fit takes from the measured series beside their values.

use crate::filter::{LowPass, second_derivative};
use crate::least_squares::rms;
use crate::motion::{Motion, by_run};
use crate::samples::quantile;
use crate::tool::smoothing_hz;

/// Time about a reversal in which the effort does not count, s.
const REVERSAL_S: f64 = 0.06;

/// The joint's acceleration as [`crate::tool`] took it from the poses.
pub(super) fn tool_acceleration(motion: &Motion) -> Option<Vec<f64>> {
    let rate_hz = 1.0 / motion.period;
    let filter = LowPass::butterworth(4, smoothing_hz(rate_hz), rate_hz).ok()?;
    by_run(&motion.runs, &motion.q_measured, |part| {
        let smooth = filter.zero_phase_settled(part)?;
        Ok(second_derivative(&smooth, motion.period))
    })
    .ok()
}

/// Samples near those that the fit uses, while the joint slides one way.
pub(super) fn used_samples(motion: &Motion) -> Vec<(usize, usize)> {
    let reach = motion
        .kept
        .windows(2)
        .map(|w| w[1] - w[0])
        .min()
        .unwrap_or(1)
        / 2;
    let clear = (REVERSAL_S / motion.period).ceil() as usize;
    let mut turned = vec![0_usize; motion.sign.len() + 1];
    for (i, sign) in motion.sign.iter().enumerate() {
        turned[i + 1] =
            turned[i] + usize::from(sign.abs() < 1.0 || motion.dq[i].abs() < motion.slow_speed);
    }
    let mut out: Vec<(usize, usize)> = Vec::new();
    for (near, &kept) in motion.kept.iter().enumerate() {
        let from = out
            .last()
            .map_or(0, |last| last.0 + 1)
            .max(kept.saturating_sub(reach));
        for i in from..=(kept + reach).min(motion.q.len() - 1) {
            let around = i.saturating_sub(clear)..(i + clear + 1).min(motion.sign.len());
            if turned[around.end] == turned[around.start] {
                out.push((i, near));
            }
        }
    }
    out
}

/// Standard deviation of the noise of a series at the work rate, as if what lies in its upper band were white.
pub(super) fn upper_band(motion: &Motion, series: &[f64]) -> f64 {
    const FROM: f64 = 0.15;
    /// Where the anti-alias filter ends.
    const TO: f64 = 0.3;
    let Ok(filter) = LowPass::butterworth(4, FROM / motion.period, 1.0 / motion.period) else {
        return 0.0;
    };
    let window = ((0.25 / motion.period) as usize).max(8);
    let mut variances = Vec::new();
    for run in motion.runs.iter().filter(|run| run.len() > 8 * window) {
        let part = &series[run.clone()];
        let Ok(low) = filter.zero_phase(part) else {
            continue;
        };
        let high: Vec<f64> = part.iter().zip(&low).map(|(a, b)| a - b).collect();
        variances.extend(high.chunks(window).map(|chunk| rms(chunk).powi(2)));
    }
    (quantile(&variances, 0.5) * TO / (TO - FROM)).sqrt()
}
