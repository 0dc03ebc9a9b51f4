//! Errors in variables: noise of the position stands in the acceleration, and least squares then finds less inertia than there is;
//! what goes with the acceleration, a spring's load above all, stands in for it. How much noise stands there is known from the poses
//! across the motion, so what it takes can be given back.
//!
//! # Source
//! Fuller, *Measurement error models*, 1987, section 2.2: the normal matrix less the noise's, here by the Sherman-Morrison formula.

use nalgebra::{DMatrix, DVector};

use super::design::Design;
use crate::motion::{Motion, MotionError};
use crate::noise::usual_square;

/// Noise that takes a larger share than this of the inertia is too much for a correction.
const MOST: f64 = 0.5;
/// How well the noise along the motion is known from that across it: one standard deviation of what is given back.
const KNOWN_TO: f64 = 0.3;

/// What the noise of the position takes.
pub(super) enum Taken {
    /// Nothing, or nobody knows.
    Nothing,
    /// So much, to be given back.
    Some(GivenBack),
    /// This share of the inertia: more than can be given back.
    TooMuch(f64),
}

/// What is given back: `change` to all coefficients, `per_inertia` for each unit of inertia that the motion feels.
pub(super) struct GivenBack {
    pub(super) change: DVector<f64>,
    inertia: usize,
    per_inertia: DVector<f64>,
}

/// What the coefficients of `design`, the parameters `theta` first, lack.
pub(super) fn taken(
    motion: &Motion,
    design: &Design,
    smoothing: &[f64; 2],
    theta: &DVector<f64>,
) -> Result<Taken, MotionError> {
    let Some(inertia) = design.names.iter().position(|name| *name == "inertia") else {
        return Ok(Taken::Nothing);
    };
    if motion.noise_of_q.is_empty() || theta[inertia] == 0.0 {
        return Ok(Taken::Nothing);
    }
    let mut square = 0.0;
    for series in &motion.noise_of_q {
        let noise = usual_square(motion, &motion.second_derivative(series))?;
        square += noise / motion.noise_of_q.len() as f64;
    }
    let noise = square * motion.kept.len() as f64;
    let column = design.inverse_of_free(smoothing).column(inertia) * noise;
    let share = column[inertia];
    if share > MOST {
        return Ok(Taken::TooMuch(share));
    }
    let per_inertia = column / (1.0 - share);
    // The effort lacks the tool's own, which has the same noise.
    let felt = theta[inertia] + motion.tool_inertia;
    Ok(Taken::Some(GivenBack {
        change: &per_inertia * felt,
        inertia,
        per_inertia,
    }))
}

impl GivenBack {
    /// Covariance of the parameters once it was given back.
    pub(super) fn widened(&self, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let params = covariance.nrows();
        let mut turn = DMatrix::identity(params, params);
        for j in 0..params {
            turn[(j, self.inertia)] += self.per_inertia[j];
        }
        let change = self.change.rows(0, params) * KNOWN_TO;
        &turn * covariance * turn.transpose() + &change * change.transpose()
    }
}
