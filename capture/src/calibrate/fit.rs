//! Least squares of the tool's parameters, the sensor's bias and the delay between the two stamps.

use ft_identify::least_squares::{effective_count, rms};
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::series::{PoseSide, TOOL, WrenchSide};
use super::turn::TURN_STEP;

/// Rows stand this far apart, s: a quarter period of the low-pass.
pub(super) const ROW_STEP_S: f64 = 1.0 / (4.0 * super::series::CUTOFF_HZ);
/// Where the bias stands among the parameters, and where what follows begins.
pub(super) const BIAS: usize = TOOL;
const EXTRAS: usize = TOOL + 6;

/// What is fitted beside the tool and a constant bias.
#[derive(Clone, Debug, Default)]
pub(super) struct Extras {
    /// A bias that drifts linearly in time.
    pub(super) drift: bool,
    /// A bias that follows the temperature: (s, K above the mean), by time.
    pub(super) temperature: Option<Vec<(f64, f64)>>,
    /// Small turns of the sensor on the tool, about its axes; [`Problem::turned`] must be there.
    pub(super) turn: bool,
    /// A delay of the pose's stamps.
    pub(super) delay: bool,
    /// A delay that grows linearly in time.
    pub(super) skew: bool,
}

/// Where a pose that is stamped `t` truly belongs: `t + offset + skew (t - middle)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Delay {
    pub(super) offset_s: f64,
    pub(super) skew: f64,
    pub(super) middle_s: f64,
}

impl Delay {
    /// The pose's stamp of what is true at `t`.
    fn stamp_of(&self, t: f64) -> f64 {
        t - self.offset_s - self.skew * (t - self.middle_s)
    }
}

/// Both sides and where they are in free air.
#[derive(Clone, Debug)]
pub(super) struct Problem {
    pub(super) pose: PoseSide,
    pub(super) wrench: WrenchSide,
    /// Free air, s, by the wrench's stamps.
    pub(super) windows: Vec<(f64, f64)>,
    /// The poses as a sensor sees them that is turned by [`TURN_STEP`] about its x, y and z.
    pub(super) turned: Option<[PoseSide; 3]>,
}

/// A fit.
#[derive(Clone, Debug)]
pub(super) struct Fit {
    pub(super) theta: DVector<f64>,
    /// Holds for correlated residuals too.
    pub(super) covariance: DMatrix<f64>,
    pub(super) delay: Delay,
    /// Standard deviations of offset, s, and skew; infinite when not fitted.
    pub(super) delay_std: [f64; 2],
    /// Root mean square of the residuals of force and torque.
    pub(super) rms: [f64; 2],
    /// (s, measured minus predicted).
    pub(super) residuals: Vec<(f64, [f64; 6])>,
    /// Independent samples that the force's residuals are worth.
    pub(super) worth: f64,
    /// Where each extra begins.
    pub(super) drift_at: Option<usize>,
    pub(super) temperature_at: Option<usize>,
    pub(super) turn_at: Option<usize>,
}

impl Fit {
    pub(super) fn std(&self, k: usize) -> f64 {
        self.covariance[(k, k)].max(0.0).sqrt()
    }

    /// Whether the tool would surely have a mass below 0.
    pub(super) fn is_reversed(&self) -> bool {
        self.theta[0] < -3.0 * self.std(0)
    }

    /// Gravity minus acceleration about its mean in the sensor's axes, m/s^2 rms.
    pub(super) fn motion(&self, problem: &Problem) -> f64 {
        let specific = |t: f64| {
            let columns = problem.pose.at(self.delay.stamp_of(t))?;
            Some(columns.fixed_view::<3, 1>(0, 0).into_owned())
        };
        let seen: Vec<_> = self
            .residuals
            .iter()
            .filter_map(|(t, _)| specific(*t))
            .collect();
        let n = seen.len().max(1) as f64;
        let mean = seen.iter().sum::<nalgebra::Vector3<f64>>() / n;
        (seen.iter().map(|s| (s - mean).norm_squared()).sum::<f64>() / n).sqrt()
    }

    /// Share of the wrench's variance that the fit explains, of force or torque, whichever is less.
    pub(super) fn explained(&self, problem: &Problem) -> f64 {
        let share = |part: usize| {
            let (mut left, mut whole) = (0.0, 0.0);
            for axis in 3 * part..3 * part + 3 {
                let measured: Vec<f64> = self
                    .residuals
                    .iter()
                    .filter_map(|(t, _)| Some(problem.wrench.at(*t)?[axis]))
                    .collect();
                let mean = measured.iter().sum::<f64>() / measured.len().max(1) as f64;
                whole += measured
                    .iter()
                    .map(|value| (value - mean).powi(2))
                    .sum::<f64>();
                left += self
                    .residuals
                    .iter()
                    .map(|(_, r)| r[axis].powi(2))
                    .sum::<f64>();
            }
            1.0 - left / whole.max(1e-300)
        };
        share(0).min(share(1))
    }
}

/// Iterations of Gauss-Newton and of the noise.
const ROUNDS: usize = 12;
const MIN_ROWS: usize = 40;

impl Problem {
    /// Instants of the rows, s.
    pub(super) fn times(&self) -> Vec<f64> {
        let mut times = Vec::new();
        for (from, to) in &self.windows {
            let count = ((to - from) / ROW_STEP_S).floor().max(0.0) as usize;
            times.extend((0..=count).map(|k| from + k as f64 * ROW_STEP_S));
        }
        times
    }

    /// Middle of the free air, s.
    pub(super) fn middle_s(&self) -> f64 {
        let first = self.windows.first().map_or(0.0, |window| window.0);
        let last = self.windows.last().map_or(0.0, |window| window.1);
        0.5 * (first + last)
    }

    /// Fits from `start`; `None` when there are too few rows or they determine nothing.
    pub(super) fn fit(&self, start: Delay, extras: &Extras) -> Option<Fit> {
        let mut delay = start;
        let mut noise = [0.1, 0.005];
        let mut theta: Option<DVector<f64>> = None;
        let mut last = None;
        for _ in 0..ROUNDS {
            let round = self.round(delay, extras, noise, theta.as_ref())?;
            let moved = (round.delay.offset_s - delay.offset_s).abs();
            (delay, noise) = (round.delay, round.noise);
            theta = Some(round.fit.theta.clone());
            last = Some(round.fit);
            if theta.is_some() && extras.delay && moved > 0.25 {
                return None;
            }
        }
        last
    }

    fn round(
        &self,
        delay: Delay,
        extras: &Extras,
        noise: [f64; 2],
        theta: Option<&DVector<f64>>,
    ) -> Option<Round> {
        let mut width = EXTRAS;
        let mut take = |wanted: bool, count: usize| {
            let at = width;
            width += if wanted { count } else { 0 };
            wanted.then_some(at)
        };
        let drift_at = take(extras.drift, 6);
        let temperature_at = take(extras.temperature.is_some(), 6);
        // The first round has no tool yet whose wrench could be turned or shifted.
        let turned = self.turned.as_ref().filter(|_| extras.turn);
        let turn_at = take(turned.is_some() && theta.is_some(), 3);
        let offset_at = take(extras.delay && theta.is_some(), 1);
        let skew_at = take(extras.skew && offset_at.is_some(), 1);
        let middle = self.middle_s();
        let mut rows: Vec<Row> = Vec::new();
        let step = 0.25 * ROW_STEP_S;
        for t in self.times() {
            let at = delay.stamp_of(t);
            let (Some(columns), Some(measured)) = (self.pose.at(at), self.wrench.at(t)) else {
                continue;
            };
            let mut row = DMatrix::zeros(6, width);
            row.view_mut((0, 0), (6, TOOL)).copy_from(&columns);
            for axis in 0..6 {
                row[(axis, BIAS + axis)] = 1.0;
                if let Some(at) = drift_at {
                    row[(axis, at + axis)] = t - middle;
                }
                if let (Some(at), Some(temperature)) = (temperature_at, &extras.temperature) {
                    row[(axis, at + axis)] = interpolate(temperature, t);
                }
            }
            if let (Some(turn_at), Some(theta), Some(turned)) = (turn_at, theta, turned) {
                let tool = theta.fixed_rows::<TOOL>(0);
                let [Some(x), Some(y), Some(z)] = turned.each_ref().map(|side| side.at(at)) else {
                    continue;
                };
                for (k, side) in [x, y, z].into_iter().enumerate() {
                    let slope = (side - columns) * tool / TURN_STEP;
                    row.view_mut((0, turn_at + k), (6, 1)).copy_from(&slope);
                }
            }
            if let (Some(offset_at), Some(theta)) = (offset_at, theta) {
                let tool = theta.fixed_rows::<TOOL>(0);
                let (Some(before), Some(after)) =
                    (self.pose.at(at - step), self.pose.at(at + step))
                else {
                    continue;
                };
                let slope = -(after - before) * tool / (2.0 * step);
                for axis in 0..6 {
                    row[(axis, offset_at)] = slope[axis];
                    if let Some(skew_at) = skew_at {
                        row[(axis, skew_at)] = slope[axis] * (t - delay.middle_s);
                    }
                }
            }
            rows.push((t, row, measured.into()));
        }
        if rows.len() < MIN_ROWS {
            return None;
        }
        let mut normal = DMatrix::<f64>::zeros(width, width);
        let mut right = DVector::<f64>::zeros(width);
        for (_, row, measured) in &rows {
            for axis in 0..6 {
                let weight = noise[axis / 3].powi(-2);
                let line = row.row(axis).transpose();
                normal.ger(weight, &line, &line, 1.0);
                right.axpy(weight * measured[axis], &line, 1.0);
            }
        }
        let scale = DVector::from_fn(width, |k, _| 1.0 / normal[(k, k)].sqrt().max(1e-12));
        let scaled = DMatrix::from_fn(width, width, |i, j| normal[(i, j)] * scale[i] * scale[j]);
        let inverse = (scaled + DMatrix::identity(width, width) * 1e-12).try_inverse()?;
        let covariance =
            DMatrix::from_fn(width, width, |i, j| inverse[(i, j)] * scale[i] * scale[j]);
        let solution = &covariance * right;
        let mut residuals = Vec::with_capacity(rows.len());
        let mut scores = Vec::with_capacity(rows.len());
        for (t, row, measured) in &rows {
            let left = DVector::from_column_slice(measured) - row * &solution;
            let weighted = DVector::from_fn(6, |k, _| left[k] * noise[k / 3].powi(-2));
            scores.push(row.transpose() * weighted);
            residuals.push((*t, core::array::from_fn(|k| left[k])));
        }
        let all = &covariance * spread_of_stationary(&rows, &residuals, noise) * &covariance;
        let slow = &covariance * spread_of(&scores, SLOW_ROWS) * &covariance;
        let covariance = widened(all, &slow, by_chance(rows.len(), SLOW_ROWS));
        let (rms, worth) = judged(&residuals);
        let next = Delay {
            offset_s: delay.offset_s + offset_at.map_or(0.0, |at| solution[at]),
            skew: delay.skew + skew_at.map_or(0.0, |at| solution[at]),
            middle_s: delay.middle_s,
        };
        let std = |at: Option<usize>| at.map_or(f64::INFINITY, |at| covariance[(at, at)].sqrt());
        Some(Round {
            delay: next,
            noise: rms.map(|rms| rms.max(1e-6)),
            fit: Fit {
                delay_std: [std(offset_at), std(skew_at)],
                theta: solution,
                covariance,
                delay: next,
                rms,
                residuals,
                worth: worth[0],
                drift_at,
                temperature_at,
                turn_at,
            },
        })
    }
}

/// Rows over which residuals may be correlated: 0.5 s, four times what the low-pass makes of white noise, ...
const CORRELATED_ROWS: usize = 16;
/// ... and 1 s for what is slow and comes and goes (a cable, a hand). More alone makes the sum small over a short free air, because
/// the fit takes slow residuals away.
const SLOW_ROWS: usize = 32;

/// A row: when, s; the six lines of the regressor; the wrench.
type Row = (f64, DMatrix<f64>, [f64; 6]);

/// Covariance of the sum of the scores of residuals whose correlation, between axes and over time, is the same throughout. It is
/// taken from all rows together, so that it is known far better than from the scores themselves ([`spread_of`]): these scatter so
/// much that errors of all parameters at once, weighed by their inverse, look a quarter too large.
///
/// Triangular weights keep it non-negative here, too.
fn spread_of_stationary(
    rows: &[Row],
    residuals: &[(f64, [f64; 6])],
    noise: [f64; 2],
) -> DMatrix<f64> {
    let width = rows.first().map_or(0, |(_, row, _)| row.ncols());
    let n = rows.len() as f64;
    let weighted: Vec<SVector<f64, 6>> = residuals
        .iter()
        .map(|(_, left)| SVector::from_fn(|k, _| left[k] * noise[k / 3].powi(-2)))
        .collect();
    // Half of that at lag 0, because the sum is added to its transpose.
    let correlations: Vec<DMatrix<f64>> = (0..=CORRELATED_ROWS.min(rows.len().saturating_sub(1)))
        .map(|lag| {
            let pairs = weighted[lag..].iter().zip(&weighted);
            let sum: SMatrix<f64, 6, 6> = pairs
                .map(|(later, earlier)| later * earlier.transpose())
                .sum();
            let weight = match lag {
                0 => 0.5,
                _ => 1.0 - lag as f64 / (CORRELATED_ROWS + 1) as f64,
            };
            DMatrix::from_column_slice(6, 6, (sum * (weight / n)).as_slice())
        })
        .collect();
    let mut sum = DMatrix::zeros(width, width);
    for (i, (_, row, _)) in rows.iter().enumerate() {
        let mut near = DMatrix::zeros(6, width);
        for (lag, correlation) in correlations.iter().enumerate().take(i + 1) {
            near.gemm(1.0, correlation, &rows[i - lag].1, 1.0);
        }
        sum.gemm_tr(1.0, row, &near, 1.0);
    }
    (&sum + sum.transpose()) * taken_away(rows.len(), width, CORRELATED_ROWS)
}

/// The fit takes its own part of the residuals away: what their covariance is to be multiplied by.
fn taken_away(rows: usize, width: usize, correlated: usize) -> f64 {
    let n = rows as f64;
    6.0 * n / (6.0 * n - (width * correlated / 4) as f64).max(n)
}

/// Covariance of the sum of the scores, whose neighbours are correlated; with it, the parameters' covariance holds for
/// residuals of any colour and size.
///
/// # Source
/// Newey and West, *Econometrica* 55, 1987: triangular weights keep it non-negative.
fn spread_of(scores: &[DVector<f64>], correlated: usize) -> DMatrix<f64> {
    let width = scores.first().map_or(0, DVector::len);
    let mut sum = DMatrix::zeros(width, width);
    for (i, score) in scores.iter().enumerate() {
        // Sum of the neighbours before, weighted, so that one product serves them all.
        let mut near = score * 0.5;
        for lag in 1..=correlated.min(i) {
            let weight = 1.0 - lag as f64 / (correlated + 1) as f64;
            near.axpy(weight, &scores[i - lag], 1.0);
        }
        sum.ger(1.0, score, &near, 1.0);
    }
    (&sum + sum.transpose()) * taken_away(scores.len(), width, correlated)
}

/// How many times its mean [`spread_of`] may be by chance: two standard deviations of a sum with triangular weights.
fn by_chance(rows: usize, correlated: usize) -> f64 {
    let share = (correlated + 1) as f64 / rows.max(1) as f64;
    1.0 + 2.0 * (4.0 / 3.0 * share).sqrt()
}

/// The covariance, each parameter widened to what the other says where that is more than `by_chance` times as much. The larger of
/// the two throughout would be too wide for residuals of one kind.
fn widened(covariance: DMatrix<f64>, other: &DMatrix<f64>, by_chance: f64) -> DMatrix<f64> {
    let widen = DVector::from_fn(covariance.nrows(), |k, _| {
        let ratio = other[(k, k)] / covariance[(k, k)].max(1e-300);
        if ratio > by_chance { ratio.sqrt() } else { 1.0 }
    });
    DMatrix::from_fn(covariance.nrows(), covariance.ncols(), |i, j| {
        covariance[(i, j)] * widen[i] * widen[j]
    })
}

struct Round {
    delay: Delay,
    /// What a row's residual counts as.
    noise: [f64; 2],
    fit: Fit,
}

/// RMS of force and torque residuals, and how many independent samples an axis of each is worth.
fn judged(residuals: &[(f64, [f64; 6])]) -> ([f64; 2], [f64; 2]) {
    let axis = |k: usize| -> Vec<f64> { residuals.iter().map(|(_, r)| r[k]).collect() };
    let part = |p: usize| {
        let axes = [axis(3 * p), axis(3 * p + 1), axis(3 * p + 2)];
        let power: f64 = axes.iter().map(|r| rms(r).powi(2)).sum::<f64>() / 3.0;
        // An axis counts by its share of the power: that of the largest residual matters most.
        let worth: f64 = axes
            .iter()
            .map(|r| effective_count(r) * rms(r).powi(2))
            .sum::<f64>()
            / (3.0 * power).max(1e-300);
        (power.sqrt(), worth)
    };
    let (force, torque) = (part(0), part(1));
    ([force.0, torque.0], [force.1, torque.1])
}

/// Linear between neighbours, constant outside.
pub(super) fn interpolate(series: &[(f64, f64)], t: f64) -> f64 {
    let after = series.partition_point(|(at, _)| *at <= t);
    match (
        after.checked_sub(1).and_then(|i| series.get(i)),
        series.get(after),
    ) {
        (Some((ta, a)), Some((tb, b))) => a + (b - a) * (t - ta) / (tb - ta).max(1e-12),
        (Some((_, only)), None) | (None, Some((_, only))) => *only,
        (None, None) => 0.0,
    }
}
