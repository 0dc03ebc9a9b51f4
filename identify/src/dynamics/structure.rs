//! Against which variable a residual still has shape.

use crate::motion::Motion;
use crate::samples::quantile;

/// Share of a residual's variance that one variable explains.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Structure {
    /// `q`, `dq`, `ddq`, `sign` or `time`.
    pub variable: &'static str,
    /// Share of the variance explained by the means of up to 16 bins, corrected for their number; 0 to 1.
    pub share: f64,
}

/// The variables, the strongest first.
#[must_use]
pub fn structure(motion: &Motion, residual: &[f64], effective_samples: f64) -> Vec<Structure> {
    let variables: [(&'static str, &[f64]); 5] = [
        ("q", &motion.q),
        ("dq", &motion.dq),
        ("ddq", &motion.ddq),
        ("sign", &motion.sign),
        ("time", &motion.time),
    ];
    let mut out: Vec<Structure> = variables
        .into_iter()
        .map(|(variable, series)| Structure {
            variable,
            share: explained(&motion.at_kept(series), residual, effective_samples),
        })
        .collect();
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    out
}

fn explained(x: &[f64], residual: &[f64], effective_samples: f64) -> f64 {
    let bins = ((effective_samples / 8.0) as usize).clamp(2, 16);
    let edges: Vec<f64> = (1..bins)
        .map(|b| quantile(x, b as f64 / bins as f64))
        .collect();
    let mut sums = vec![(0.0, 0.0); bins];
    for (x, r) in x.iter().zip(residual) {
        let bin = edges.partition_point(|edge| edge < x);
        sums[bin].0 += r;
        sums[bin].1 += 1.0;
    }
    let n = residual.len() as f64;
    let mean = residual.iter().sum::<f64>() / n;
    let total: f64 = residual.iter().map(|r| (r - mean).powi(2)).sum();
    let between: f64 = sums
        .iter()
        .filter(|s| s.1 > 0.0)
        .map(|s| s.1 * (s.0 / s.1 - mean).powi(2))
        .sum();
    if total <= 0.0 {
        return 0.0;
    }
    let raw = between / total;
    let chance = (bins as f64 - 1.0) / (effective_samples - 1.0).max(1.0);
    (1.0 - (1.0 - raw) / (1.0 - chance).max(0.05)).clamp(0.0, 1.0)
}
