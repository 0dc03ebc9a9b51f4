//! The time by which the effort lags behind the motion, from the fit itself.
//!
//! A lag `L` leaves `L dtau/dt` in the residual. The effort is shifted over a range, a memoryless model (inertia,
//! friction, mechanism) is fitted at each shift, and the parabola through the smallest sums of squares gives
//! the lag to a fraction of a sample. Grasp compliance looks the same; this does not tell them apart.

use nalgebra::{DMatrix, DVector};

use crate::least_squares::effective_count;
use crate::motion::{Motion, MotionError};
use crate::parallel::in_parallel;

/// An estimated lag of the effort behind the motion.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Lag {
    /// Best estimate, s; positive when the effort is stamped late.
    pub value_s: f64,
    /// Standard deviation, s.
    pub std_s: f64,
    /// Whether the effort was shifted by it before the final fit.
    pub applied: bool,
}

/// As far as streams usually are apart, either way, s: a grasp that gives looks like no more than this.
pub const USUAL_S: f64 = 0.06;
/// As far as those are whose clocks nobody has synchronised.
pub const FAR_S: f64 = 0.25;
/// Of the squares that no lag leaves, one beyond the usual leaves at most this share: few strokes fit by chance at some far lag.
const FAR_LEAVES: f64 = 0.25;

/// Scans the lag over +-60 ms or two samples, and over +-250 ms when the best lies at the end of that, for the linear model `y` (kept
/// samples, columns) with normal matrix `gram`, which may hold penalties. `None` when the best lies at the end of the range still, two
/// samples are longer than that, or the motion cannot show it.
///
/// # Errors
/// When the motion cannot be filtered.
pub fn scan(
    motion: &Motion,
    y: &DMatrix<f64>,
    gram: &DMatrix<f64>,
) -> Result<Option<Lag>, MotionError> {
    // Two samples either way are the least for a parabola; so seldom they show no lag that streams have.
    if 2.0 * motion.period > FAR_S {
        return Ok(None);
    }
    for (range, leaves) in [(USUAL_S, 1.0), (FAR_S, FAR_LEAVES)] {
        let steps = (range / motion.period).round().max(2.0) as isize;
        match scan_over(motion, y, gram.clone(), steps)? {
            Scanned::Within(_, share) if share > leaves => return Ok(None),
            Scanned::Within(lag, _) => return Ok(Some(lag)),
            Scanned::Blind => return Ok(None),
            Scanned::AtTheEnd => {}
        }
    }
    Ok(None)
}

/// What a range of lags shows.
enum Scanned {
    /// The lag, and what it leaves of the squares that no lag leaves.
    Within(Lag, f64),
    /// The best lies at an end of the range.
    AtTheEnd,
    /// The motion cannot show a lag.
    Blind,
}

/// As [`scan`], over so many samples either way.
fn scan_over(
    motion: &Motion,
    y: &DMatrix<f64>,
    mut gram: DMatrix<f64>,
    steps: isize,
) -> Result<Scanned, MotionError> {
    let inside: Vec<usize> = (0..motion.kept.len())
        .filter(|&k| {
            let i = motion.kept[k] as isize;
            motion
                .runs
                .iter()
                .any(|run| i - steps >= run.start as isize && i + steps < run.end as isize)
        })
        .collect();
    if inside.len() < 60 {
        return Ok(Scanned::Blind);
    }
    let y = y.select_rows(&inside);
    for j in 0..gram.ncols() {
        gram[(j, j)] *= 1.0 + 1e-9;
        gram[(j, j)] += 1e-12;
    }
    let Some(factor) = gram.cholesky() else {
        return Ok(Scanned::Blind);
    };
    let residual = |shift: isize| -> Result<DVector<f64>, MotionError> {
        let tau = motion.regressor(&shifted(motion, shift))?;
        let target = DVector::from_iterator(inside.len(), inside.iter().map(|&k| tau[k]));
        let theta = factor.solve(&y.tr_mul(&target));
        Ok(target - &y * theta)
    };
    let shifts: Vec<isize> = (-steps..=steps).collect();
    let sums = in_parallel(&shifts, |shift| Ok(residual(*shift)?.norm_squared()));
    let sums = sums
        .into_iter()
        .collect::<Result<Vec<f64>, MotionError>>()?;
    let Some(best) = (0..sums.len()).min_by(|&a, &b| sums[a].total_cmp(&sums[b])) else {
        return Ok(Scanned::Blind);
    };
    if best == 0 || best + 1 == sums.len() {
        return Ok(Scanned::AtTheEnd);
    }
    let curvature = sums[best - 1] - 2.0 * sums[best] + sums[best + 1];
    let offset = 0.5 * (sums[best - 1] - sums[best + 1]) / curvature;
    let left = residual(best as isize - steps)?;
    let variance = sums[best] / effective_count(left.as_slice()).max(1.0);
    let std_s = (2.0 * variance / curvature).max(0.0).sqrt() * motion.period;
    let value_s = (best as f64 - steps as f64 + offset) * motion.period;
    Ok(if value_s.is_finite() && std_s.is_finite() {
        let lag = Lag {
            value_s,
            std_s,
            applied: false,
        };
        Scanned::Within(lag, sums[best] / sums[steps as usize])
    } else {
        Scanned::Blind
    })
}

/// The effort of `shift` samples later, held at the ends of the runs.
fn shifted(motion: &Motion, shift: isize) -> Vec<f64> {
    let mut out = motion.tau.clone();
    for run in &motion.runs {
        for i in run.clone() {
            let at = i.saturating_add_signed(shift);
            out[i] = motion.tau[at.clamp(run.start, run.end - 1)];
        }
    }
    out
}
