//! How far the pose's stamps are from the wrench's, from the tool's own weight and inertia in free air.
//!
//! The tool's wrench follows from its motion (`series`). The pose is shifted over the search range, and at each shift mass,
//! first moment and bias are fitted; the best shift is refined by Gauss-Newton with all parameters free, which is the
//! maximum-likelihood estimate for the residuals' own size, and its interval counts correlated residuals once.

use nalgebra::{SMatrix, SVector};
use serde::Serialize;

use super::fit::{Delay, Extras, Fit, Problem};
use super::{CalibrateError, NORMAL_95};

/// How far apart two stamps of the same instant are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Alignment {
    /// To add to the pose's stamps, s.
    pub offset_s: f64,
    /// One standard deviation.
    pub std_s: f64,
    /// 95 % interval of the offset, s.
    pub interval_s: [f64; 2],
    /// By how much the pose's clock is slow, ppm, and one standard deviation; none in a short free air.
    pub skew_ppm: Option<[f64; 2]>,
    /// Where the offset holds, s after the first wrench.
    pub at_s: f64,
    /// Share of the wrench's variance in free air that the tool's motion explains.
    pub explained: f64,
    /// Free air used, s.
    pub free_air_s: f64,
}

/// Step of the coarse search, s.
const STEP_S: f64 = 1.0 / 64.0;
/// Coarse rows are this many steps apart.
const ROWS_EVERY: i64 = 4;
const MIN_FREE_AIR_S: f64 = 4.0;
/// Shifts that cover less than this share of the most rows do not compete.
const MIN_COVER: f64 = 0.6;
/// The tool's motion must explain so much of the wrench; of the coarse search, which knows no inertia, less is asked.
pub(super) const MIN_EXPLAINED: f64 = 0.9;
pub(super) const MIN_EXPLAINED_COARSE: f64 = 0.5;
/// Poses must show the tool turned or shaken by so much (gravity minus acceleration, m/s^2 rms about its mean): below, what
/// the tracker wobbles by pulls the offset away.
const MIN_MOTION: f64 = 1.0;
/// An offset that is worse known is refused, s.
const MAX_STD_S: f64 = 0.002;
/// Another shift at least so far away counts as another answer, s ...
const APART_S: f64 = 0.3;
/// ... when the data prefer the best by less than this (log likelihood).
const MIN_EVIDENCE: f64 = 10.0;
/// Free air over which a skew shows, s.
const SKEW_NEEDS_S: f64 = 60.0;

/// Aligns, the shift within +-`search_s` of `around_s`.
pub(super) fn align(
    problem: &Problem,
    around_s: f64,
    search_s: f64,
) -> Result<(Alignment, Fit), CalibrateError> {
    let coarse = Coarse::of(problem).scan(around_s, search_s);
    let Some(best) = coarse.iter().min_by(|a, b| a.left.total_cmp(&b.left)) else {
        return Err(CalibrateError::FreeAirShort {
            free_air_s: overlap(problem, around_s),
            needed_s: MIN_FREE_AIR_S,
        });
    };
    let explained = 1.0 - best.left;
    if explained < MIN_EXPLAINED_COARSE {
        return Err(CalibrateError::Unrelated { explained });
    }
    if (best.shift_s - around_s).abs() > search_s - 2.0 * STEP_S {
        return Err(CalibrateError::AtTheEnd {
            offset_s: best.shift_s,
            search_s,
        });
    }
    let middle_s = problem.middle_s();
    let start = Delay {
        offset_s: best.shift_s,
        skew: 0.0,
        middle_s,
    };
    let span =
        problem.windows.last().map_or(0.0, |w| w.1) - problem.windows.first().map_or(0.0, |w| w.0);
    let extras = Extras {
        delay: true,
        skew: span >= SKEW_NEEDS_S,
        drift: span >= super::DRIFT_NEEDS_S,
        temperature: None,
        turn: false,
    };
    let fit = problem.fit(start, &extras);
    let fit = fit.filter(|fit| (fit.delay.offset_s - best.shift_s).abs() < 4.0 * STEP_S);
    let Some(fit) = fit else {
        return Err(CalibrateError::OffsetUnknown {
            std_ms: f64::INFINITY,
            needed_ms: 1e3 * MAX_STD_S,
        });
    };
    // Little motion explains little: that is to be said first.
    let motion = fit.motion(problem);
    if motion < MIN_MOTION {
        return Err(CalibrateError::TooStill {
            motion,
            needed: MIN_MOTION,
        });
    }
    let explained = fit.explained(problem);
    if explained < MIN_EXPLAINED {
        return Err(CalibrateError::Unrelated { explained });
    }
    let std_s = fit.delay_std[0];
    if std_s.is_nan() || std_s > MAX_STD_S {
        return Err(CalibrateError::OffsetUnknown {
            std_ms: 1e3 * std_s,
            needed_ms: 1e3 * MAX_STD_S,
        });
    }
    let rival = coarse
        .iter()
        .filter(|other| (other.shift_s - best.shift_s).abs() > APART_S)
        .min_by(|a, b| a.left.total_cmp(&b.left));
    if let Some(rival) = rival {
        let evidence = 0.5 * fit.worth * 6.0 * (rival.left / best.left).ln();
        if evidence < MIN_EVIDENCE {
            return Err(CalibrateError::Ambiguous {
                first_s: best.shift_s,
                second_s: rival.shift_s,
            });
        }
    }
    if fit.theta[0] <= 0.0 {
        return Err(CalibrateError::Reversed { explained });
    }
    let offset_s = fit.delay.offset_s;
    let reach = NORMAL_95 * std_s;
    let alignment = Alignment {
        offset_s,
        std_s,
        interval_s: [offset_s - reach, offset_s + reach],
        skew_ppm: extras
            .skew
            .then(|| [1e6 * fit.delay.skew, 1e6 * fit.delay_std[1]]),
        at_s: middle_s,
        explained,
        free_air_s: fit.residuals.len() as f64 * super::fit::ROW_STEP_S,
    };
    Ok((alignment, fit))
}

/// Free air that has poses when these are shifted by `shift_s`, s.
fn overlap(problem: &Problem, shift_s: f64) -> f64 {
    let both = problem
        .times()
        .into_iter()
        .filter(|t| problem.pose.at(t - shift_s).is_some() && problem.wrench.at(*t).is_some());
    both.count() as f64 * super::fit::ROW_STEP_S
}

/// Both sides on one grid of [`STEP_S`], so that a shift is a whole number of steps.
struct Coarse {
    /// Columns of m and h, from the first pose's step on.
    columns: Vec<Option<SMatrix<f64, 6, 4>>>,
    first: i64,
    /// (step, wrench over its standard deviation by part).
    rows: Vec<(i64, SVector<f64, 6>)>,
    scale: [f64; 2],
}

/// What a shift leaves.
struct Shift {
    shift_s: f64,
    /// Share of the wrench's variance.
    left: f64,
}

impl Coarse {
    fn of(problem: &Problem) -> Self {
        let step = |t: f64| (t / STEP_S).round() as i64;
        let (first, last) = problem
            .pose
            .span()
            .map_or((0, -1), |(a, b)| (step(a), step(b)));
        let columns = (first..=last).map(|k| {
            let all = problem.pose.at(k as f64 * STEP_S)?;
            Some(all.fixed_columns::<4>(0).into_owned())
        });
        let mut rows = Vec::new();
        for (from, to) in &problem.windows {
            let mut k = step(*from);
            while k <= step(*to) {
                if let Some(wrench) = problem.wrench.at(k as f64 * STEP_S) {
                    rows.push((k, wrench));
                }
                k += ROWS_EVERY;
            }
        }
        let mut scale = [0.0; 2];
        for (part, scale) in scale.iter_mut().enumerate() {
            for axis in 3 * part..3 * part + 3 {
                let mean = rows.iter().map(|r| r.1[axis]).sum::<f64>() / rows.len().max(1) as f64;
                *scale += rows.iter().map(|r| (r.1[axis] - mean).powi(2)).sum::<f64>();
            }
            *scale = (*scale / (3 * rows.len().max(1)) as f64).sqrt().max(1e-9);
        }
        Self {
            columns: columns.collect(),
            first,
            rows,
            scale,
        }
    }

    fn scan(&self, around_s: f64, search_s: f64) -> Vec<Shift> {
        let around = (around_s / STEP_S).round() as i64;
        let reach = (search_s / STEP_S).ceil() as i64;
        let least = (MIN_FREE_AIR_S / (STEP_S * ROWS_EVERY as f64)) as usize;
        let found: Vec<_> = (around - reach..=around + reach)
            .filter_map(|shift| {
                let (left, rows) = self.left(shift)?;
                Some((shift as f64 * STEP_S, left, rows))
            })
            .collect();
        let most = found.iter().map(|f| f.2).max().unwrap_or(0);
        let enough = least.max((MIN_COVER * most as f64) as usize);
        found
            .into_iter()
            .filter(|(_, _, rows)| *rows >= enough)
            .map(|(shift_s, left, _)| Shift { shift_s, left })
            .collect()
    }

    /// Share of the wrench's variance that m, h and bias leave at a shift, and rows.
    fn left(&self, shift: i64) -> Option<(f64, usize)> {
        let mut normal = SMatrix::<f64, 10, 10>::zeros();
        let mut right = SVector::<f64, 10>::zeros();
        let mut total = 0.0;
        let mut sums = SVector::<f64, 6>::zeros();
        let mut count = 0;
        for (k, wrench) in &self.rows {
            let index = usize::try_from(k - shift - self.first).ok();
            let Some(Some(columns)) = index.and_then(|index| self.columns.get(index)) else {
                continue;
            };
            count += 1;
            for axis in 0..6 {
                let scale = self.scale[axis / 3];
                let mut row = SVector::<f64, 10>::zeros();
                for j in 0..4 {
                    row[j] = columns[(axis, j)] / scale;
                }
                row[4 + axis] = 1.0;
                let value = wrench[axis] / scale;
                normal += row * row.transpose();
                right += row * value;
                total += value * value;
                sums[axis] += value;
            }
        }
        let n = count as f64;
        let about_mean = total - sums.norm_squared() / n;
        for k in 0..10 {
            normal[(k, k)] += 1e-9;
        }
        let theta = normal.cholesky()?.solve(&right);
        let left = total - theta.dot(&right);
        (count > 0 && about_mean > 0.0).then(|| ((left / about_mean).clamp(1e-12, 1.0), count))
    }
}
