//! What is not known of when the joint turns: Coulomb friction changes its sign then, and friction that turns late looks like inertia.
//!
//! A joint that sticks for some ms as it turns, seen through a smoothed velocity, turns late each time. Where turns are left out of the fit
//! their instants matter as far as the smoothing carries them beyond; elsewhere (a noisy tracker, a fit that foretells better with
//! them) in full. Meant is the friction of the rigid body; effects that change it as the joint turns are not counted.

use nalgebra::{DMatrix, DVector};

use super::design::Design;
use crate::motion::{Motion, MotionError};

/// What turns may be late by, all alike: one standard deviation, in periods of the cut-off of the velocity they are seen by.
const LATE: f64 = 0.024;

/// Covariance of the parameters, `theta`, by turns that are late.
pub(super) fn covariance(
    motion: &Motion,
    design: &Design,
    smoothing: &[f64; 2],
    theta: &DVector<f64>,
) -> Result<DMatrix<f64>, MotionError> {
    let params = theta.len();
    let Some(coulomb) = design.names.iter().position(|name| *name == "coulomb") else {
        return Ok(DMatrix::zeros(params, params));
    };
    let late_s = LATE / motion.turning_hz;
    let mut late = vec![0.0; motion.sign.len()];
    for run in &motion.runs {
        let signs = motion.sign[run.clone()].windows(2);
        for (late, pair) in late[run.clone()].iter_mut().skip(1).zip(signs) {
            *late = (pair[0] - pair[1]) * late_s / motion.period;
        }
    }
    let late = DVector::from_vec(motion.regressor(&late)?) * theta[coulomb];
    if late.amax() == 0.0 {
        return Ok(DMatrix::zeros(params, params));
    }
    let change = design.inverse_of_free(smoothing) * design.y.tr_mul(&late);
    let change = change.rows(0, params);
    Ok(change * change.transpose())
}
