//! Against which variable a residual still has shape.

use super::EffortModel;
use crate::digits::six;
use crate::effect::library::Variable;
use crate::least_squares::rms;
use crate::motion::{Motion, MotionError};
use crate::noise::usual_square;
use crate::samples::quantile;

/// Share of a residual's variance that one variable explains.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Structure {
    /// Which.
    pub variable: Variable,
    /// Share of the variance explained by the means of up to 16 bins, corrected for their number; 0 to 1.
    pub share: f64,
    /// What white noise has of that, against one variable, in one recording of three hundred, and errors of the motion make of it, which are in the acceleration and in the
    /// residual; 1 and more where nothing can tell, as of the acceleration in a table.
    pub chance: f64,
    /// Mean of the variable in each bin, SI.
    pub x: Vec<f64>,
    /// Mean of the residual in each bin, in the unit of the effort.
    pub mean: Vec<f64>,
}

/// What a residual that is not white stands against most.
#[must_use]
pub fn not_white(structure: &[Structure]) -> Option<&Structure> {
    structure
        .iter()
        .find(|one| one.share > WHITE_BELOW.max(one.chance))
}

/// A residual is white with less of its variance against each variable, however sure that is.
const WHITE_BELOW: f64 = 0.04;
/// Standard deviations of a normal variable that chance exceeds once in three hundred times.
const SURE: f64 = 2.71;

const VARIABLES: [Variable; 7] = [
    Variable::Q,
    Variable::Dq,
    Variable::Ddq,
    Variable::Sign,
    Variable::Time,
    Variable::SinceReversal,
    Variable::OffAxis,
];

/// What a model leaves against each variable, the strongest first; of two off-axis forces the stronger.
///
/// # Errors
/// When the motion cannot be filtered.
pub fn structure(motion: &Motion, model: &EffortModel) -> Result<Vec<Structure>, MotionError> {
    let (residual, effective_samples) = (&model.residual, model.effective_samples);
    let mut out = Vec::new();
    for variable in VARIABLES {
        let made = if variable == Variable::Ddq {
            made_by_errors(motion, model)?
        } else {
            0.0
        };
        let each = motion.variable(variable).into_iter().map(|series| {
            let x = motion.at_kept(&series);
            explained((variable, made), &x, residual, effective_samples)
        });
        out.extend(each.max_by(|a, b| a.share.total_cmp(&b.share)));
    }
    out.sort_by(|a, b| b.share.total_cmp(&a.share));
    Ok(out)
}

/// Share of a residual's variance that stands against the acceleration because both have the position's errors: where the joint accelerates little,
/// the measured acceleration is mostly error. Found with the noise across the path in the place of that along it, beside a motion that has as much of it
/// more; all where that is not known.
fn made_by_errors(motion: &Motion, model: &EffortModel) -> Result<f64, MotionError> {
    if motion.noise_of_q.is_empty() {
        return Ok(1.0);
    }
    // The effort lacks the tool's own, which has the same errors.
    let felt = model.theta[0] + motion.tool_inertia;
    let left = rms(&model.residual).max(f64::MIN_POSITIVE);
    let mut made = 0.0;
    for noise in &motion.noise_of_q {
        let more = motion.second_derivative(&motion.smoothed(noise)?);
        let both = motion.ddq.iter().zip(&more);
        let x: Vec<f64> = both.map(|(ddq, more)| ddq + more).collect();
        let error_ddq = motion.second_derivative(noise);
        let error = motion.regressor(&error_ddq)?;
        let alone = (Variable::Ddq, 0.0);
        let of_error = explained(alone, &motion.at_kept(&x), &error, model.effective_samples);
        let part = usual_square(motion, &error_ddq)? * (felt / left).powi(2);
        made += of_error.share * part.min(1.0);
    }
    Ok(KNOWN_TO * made / motion.noise_of_q.len() as f64)
}

/// How well that is known: a factor. Where the acceleration is all error, one that has as much more has half of what there is.
const KNOWN_TO: f64 = 3.0;

fn explained(
    (variable, made): (Variable, f64),
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
    // A sign fills two.
    sums.retain(|[.., count]| *count > 0.0);
    let n = residual.len() as f64;
    let mean = residual.iter().sum::<f64>() / n;
    let total: f64 = residual.iter().map(|r| (r - mean).powi(2)).sum();
    let between: f64 = sums
        .iter()
        .map(|[_, r, count]| count * (r / count - mean).powi(2))
        .sum();
    let raw = if total > 0.0 { between / total } else { 0.0 };
    let free = (sums.len() as f64 - 1.0).max(0.0);
    let effective = (effective_samples - 1.0).max(1.0);
    let share = 1.0 - (1.0 - raw) / (1.0 - free / effective).max(0.05);
    // The quantile of a chi-squared variable (Wilson and Hilferty 1931).
    let chance = if free > 0.0 {
        let part = 2.0 / (9.0 * free);
        free * ((1.0 - part + SURE * part.sqrt()).powi(3) - 1.0) / effective
    } else {
        0.0
    };
    Structure {
        variable,
        share: share.clamp(0.0, 1.0),
        chance: six(chance + made),
        x: sums.iter().map(|[x, _, count]| six(x / count)).collect(),
        mean: sums.iter().map(|[_, r, count]| six(r / count)).collect(),
    }
}
