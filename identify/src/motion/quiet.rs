//! How far a slow motion is smoothed.

use super::{Motion, MotionError, MotionSettings};
use crate::noise::usual_square;
use crate::samples::{JointSamples, extrema};
use nalgebra::{DMatrix, DVector};

/// From this share of the acceleration's mean square on, the position's noise hides the inertia: what can be given back is half of it at most, and
/// what is left looks like effects that are not there.
const HIDDEN_FROM: f64 = 0.02;
/// A lower cut-off must leave so much less of it. Where each stroke is as the one before, none does.
const LESS: f64 = 0.5;
/// Each lower cut-off over the one before it, and the lowest that the cut-off is brought to, Hz: a slow stroke takes some seconds.
const STEP: f64 = 0.8;
const LOWEST_HZ: f64 = 1.5;
/// A lower cut-off has fewer samples, of which so many must be left, and longer borders.
const LEAST_KEPT: usize = 80;

impl MotionSettings {
    /// With the highest cut-off, not above its own, at which the position's noise does not hide the acceleration: it grows with the fifth power of
    /// the cut-off, and slow strokes have no acceleration at 6 Hz. Where none is low enough, that at which it hides least. A cut-off that was asked
    /// for stays, and so does one below which one of `others`, of the same joint, has too few samples, or at which the tool slid on the handle: lower
    /// filters carry that farther.
    ///
    /// # Errors
    /// [`MotionError`]: of the motion at its own cut-off.
    pub fn quiet_for<'a>(
        self,
        samples: &JointSamples,
        others: impl Iterator<Item = &'a JointSamples> + Clone,
    ) -> Result<Self, MotionError> {
        if !self.gives_way || samples.noise_of_q.is_empty() {
            return Ok(self);
        }
        let motion = Motion::prepare(samples, &self)?;
        let own = hidden(&motion)?;
        if own <= HIDDEN_FROM || !motion.slips.is_empty() {
            return Ok(self);
        }
        let mut best = (LESS * own, self);
        let mut lower = self;
        while best.0 > HIDDEN_FROM && STEP * lower.cutoff_hz >= LOWEST_HZ {
            lower.cutoff_hz *= STEP;
            let enough = |samples: &JointSamples| {
                let motion = Motion::prepare(samples, &lower).ok();
                motion.filter(|motion| motion.kept.len() >= LEAST_KEPT)
            };
            let Some(motion) = enough(samples) else {
                break;
            };
            if !others.clone().all(|other| enough(other).is_some()) {
                break;
            }
            let share = hidden(&motion)?;
            if share < best.0 {
                best = (share, lower);
            }
        }
        Ok(best.1)
    }
}

/// Share of the position's noise in the acceleration's mean square, as far as that is not what a load and a damping of the place would be,
/// too: strokes of one kind are as fast at a place each time, and only what differs tells of inertia.
fn hidden(motion: &Motion) -> Result<f64, MotionError> {
    let (low, high) = extrema(&motion.q);
    let place = |q: f64| (2.0 * q - low - high) / (high - low).max(f64::MIN_POSITIVE);
    let by_state = |of: &dyn Fn(f64, f64) -> f64| {
        let states = motion.q.iter().zip(&motion.dq);
        let all: Vec<f64> = states.map(|(q, dq)| of(place(*q), *dq)).collect();
        motion.regressor(&all)
    };
    let mut columns = vec![motion.regressor(&motion.sign)?];
    for power in 0..=LOAD_POWERS {
        columns.push(by_state(&|q, _| q.powi(power))?);
    }
    for power in 0..=DAMPING_POWERS {
        columns.push(by_state(&|q, dq| q.powi(power) * dq.max(0.0))?);
        columns.push(by_state(&|q, dq| q.powi(power) * dq.min(0.0))?);
    }
    let columns: Vec<DVector<f64>> = columns.into_iter().map(DVector::from_vec).collect();
    let columns = DMatrix::from_columns(&columns);
    let acceleration = DVector::from_vec(motion.regressor(&motion.ddq)?);
    // The fit says what is not finite; a decomposition would not end.
    if !columns.iter().chain(&acceleration).all(|v| v.is_finite()) {
        return Ok(0.0);
    }
    let (count, taken) = columns.shape();
    let taken_up = columns.clone().svd(true, true).solve(&acceleration, 1e-9);
    let own = taken_up.map_or_else(|_| acceleration.clone(), |c| &acceleration - columns * c);
    let mut noise = 0.0;
    for series in &motion.noise_of_q {
        let one = usual_square(motion, &motion.second_derivative(series))?;
        noise += one / motion.noise_of_q.len() as f64;
    }
    let own = own.norm_squared() / count.saturating_sub(taken).max(1) as f64;
    Ok(if own > 0.0 { noise / own } else { 0.0 })
}

/// A load of the place and a damping of place and direction, as far as smooth ones go.
const LOAD_POWERS: i32 = 5;
const DAMPING_POWERS: i32 = 2;
