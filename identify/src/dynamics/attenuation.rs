//! Errors in variables: noise of the position stands in the acceleration, and least squares then finds less inertia than there is.
//! How much noise stands there is known from the poses across the motion, so what it takes can be given back.
//!
//! # Source
//! Fuller, *Measurement error models*, 1987, section 2.2: the normal matrix less the noise's.

use nalgebra::DVector;

use super::design::Design;
use crate::motion::{Motion, MotionError};
use crate::noise::usual_square;

/// Noise that takes a larger share than this of the inertia is too much for a correction.
const MOST: f64 = 0.2;

/// What the inertia among the parameters `theta` of `design` lacks; zero where the position's noise is not known.
pub(super) fn taken(
    motion: &Motion,
    design: &Design,
    smoothing: &[f64; 2],
    theta: &DVector<f64>,
) -> Result<f64, MotionError> {
    let Some(inertia) = design.names.iter().position(|name| *name == "inertia") else {
        return Ok(0.0);
    };
    let mut square = 0.0;
    for series in &motion.noise_of_q {
        let noise = usual_square(motion, &motion.second_derivative(series))?;
        square += noise / motion.noise_of_q.len() as f64;
    }
    let share = design.inverse(smoothing)[(inertia, inertia)] * square * motion.kept.len() as f64;
    if share > MOST || theta[inertia] == 0.0 {
        return Ok(0.0);
    }
    // The effort lacks the tool's own, which has the same noise.
    let felt = theta[inertia] + motion.tool_inertia;
    Ok(share / (1.0 - share) * felt)
}
