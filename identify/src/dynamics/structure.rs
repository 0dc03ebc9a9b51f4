//! Against which variable a residual still has shape.

use core::borrow::Borrow as _;
use std::borrow::Cow;

use crate::digits::six;
use crate::motion::Motion;
use crate::samples::quantile;

/// Share of a residual's variance that one variable explains.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Structure {
    /// `q`, `dq`, `ddq`, `sign` (of the velocity), `time`, `since_reversal` (the way since then) or `off_axis` (force across the path, N: of a
    /// hinge that away from its axis).
    pub variable: &'static str,
    /// Share of the variance explained by the means of up to 16 bins, corrected for their number; 0 to 1.
    pub share: f64,
    /// Standard deviation of that by chance.
    #[serde(skip)]
    pub chance: f64,
    /// Mean of the variable in each bin, SI.
    pub x: Vec<f64>,
    /// Mean of the residual in each bin, in the unit of the effort.
    pub mean: Vec<f64>,
}

impl Structure {
    /// The variable as a sentence has it.
    #[must_use]
    pub fn in_words(&self) -> &'static str {
        match self.variable {
            "since_reversal" => "the way since a reversal",
            "off_axis" => "the off-axis force",
            name => name,
        }
    }
}

/// What a residual that is not white stands against most. Against `ddq` every one stands a little: errors of the motion are in the
/// acceleration, and in the residual with the other sign.
#[must_use]
pub fn shape(structure: &[Structure]) -> Option<&Structure> {
    structure
        .iter()
        .find(|one| one.variable != "ddq" && one.share > NO_NOISE && one.share > SURE * one.chance)
}

/// Noise stands against a variable with less of its variance.
const NO_NOISE: f64 = 0.04;
/// Standard deviations beyond which it is no chance: one of six variables in six hundred recordings.
const SURE: f64 = 3.5;

/// The variables, the strongest first.
#[must_use]
pub fn structure(motion: &Motion, residual: &[f64], effective_samples: f64) -> Vec<Structure> {
    let mut variables: Vec<(&'static str, Cow<'_, [f64]>)> = vec![
        ("q", (&motion.q).into()),
        ("dq", (&motion.dq).into()),
        ("ddq", (&motion.ddq).into()),
        ("sign", (&motion.sign).into()),
        ("time", (&motion.time).into()),
        ("since_reversal", motion.since_reversal().into()),
    ];
    let off_axis = motion.off_axis().into_iter();
    variables.extend(off_axis.map(|force| ("off_axis", force.into())));
    let explained = variables.iter().map(|(variable, series)| {
        explained(
            variable,
            &motion.at_kept(series.borrow()),
            residual,
            effective_samples,
        )
    });
    let mut out: Vec<Structure> = explained.collect();
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    // The stronger of two forces.
    let mut seen = Vec::new();
    out.retain(|one| {
        let is_new = !seen.contains(&one.variable);
        seen.push(one.variable);
        is_new
    });
    out
}

fn explained(
    variable: &'static str,
    x: &[f64],
    residual: &[f64],
    effective_samples: f64,
) -> Structure {
    let bins = ((effective_samples / 8.0) as usize).clamp(2, 16);
    let edges: Vec<f64> = (1..bins)
        .map(|b| quantile(x, b as f64 / bins as f64))
        .collect();
    let mut sums = vec![[0.0; 3]; bins];
    for (x, r) in x.iter().zip(residual) {
        let bin = &mut sums[edges.partition_point(|edge| edge < x)];
        for (sum, value) in bin.iter_mut().zip([*x, *r, 1.0]) {
            *sum += value;
        }
    }
    sums.retain(|[.., count]| *count > 0.0);
    let n = residual.len() as f64;
    let mean = residual.iter().sum::<f64>() / n;
    let total: f64 = residual.iter().map(|r| (r - mean).powi(2)).sum();
    let between: f64 = sums
        .iter()
        .map(|[_, r, count]| count * (r / count - mean).powi(2))
        .sum();
    let raw = if total > 0.0 { between / total } else { 0.0 };
    let free = bins as f64 - 1.0;
    let effective = (effective_samples - 1.0).max(1.0);
    let share = 1.0 - (1.0 - raw) / (1.0 - free / effective).max(0.05);
    Structure {
        variable,
        share: share.clamp(0.0, 1.0),
        chance: (2.0 * free).sqrt() / effective,
        x: sums.iter().map(|[x, _, count]| six(x / count)).collect(),
        mean: sums.iter().map(|[_, r, count]| six(r / count)).collect(),
    }
}
