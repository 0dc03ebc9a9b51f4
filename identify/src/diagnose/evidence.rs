//! The residual against the variable of an effect, without it and with it.

use super::diagnosis::NamedEffect;
use super::model::{Found, RIGID};
use crate::digits::six;
use crate::dynamics::EffortModel;
use crate::effect::library::Variable;
use crate::motion::{Motion, MotionError};

/// Points of the evidence plot of one effect.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Evidence {
    /// Against what.
    pub variable: Variable,
    /// Values of the variable, SI.
    pub x: Vec<f64>,
    /// Residual with all other effects, but without this one.
    pub before: Vec<f64>,
    /// Residual with it too.
    pub after: Vec<f64>,
}

const POINTS: usize = 700;

/// Evidence of each effect in `named` (none for a lag, which has no regressor any more, nor against a variable that the motion has not).
///
/// # Errors
/// When the motion cannot be filtered.
pub fn evidence(
    motion: &Motion,
    model: &EffortModel,
    named: &[NamedEffect],
) -> Result<Vec<Option<Evidence>>, MotionError> {
    let mut at = RIGID;
    let step = motion.kept.len().div_ceil(POINTS).max(1);
    named
        .iter()
        .map(|effect| {
            if effect.found.taken_out() {
                return Ok(None);
            }
            let own = own_effort(motion, &effect.found, model.theta.as_slice(), &mut at)?;
            let variable = effect.found.kind.variable;
            let Some(against) = motion.variable(variable).into_iter().next() else {
                return Ok(None);
            };
            let x = motion.at_kept(&against);
            let each = |series: &[f64]| series.iter().step_by(step).map(|v| six(*v)).collect();
            let without: Vec<f64> = model
                .residual
                .iter()
                .zip(&own)
                .map(|(r, o)| r + o)
                .collect();
            Ok(Some(Evidence {
                variable,
                x: each(&x),
                before: each(&without),
                after: each(&model.residual),
            }))
        })
        .collect()
}

fn own_effort(
    motion: &Motion,
    found: &Found,
    theta: &[f64],
    at: &mut usize,
) -> Result<Vec<f64>, MotionError> {
    let mut sum = vec![0.0; motion.kept.len()];
    for series in found.series(motion) {
        let theta = theta.get(*at).copied().unwrap_or(0.0);
        *at += 1;
        for (sum, value) in sum.iter_mut().zip(motion.regressor(&series)?) {
            *sum += theta * value;
        }
    }
    Ok(sum)
}
