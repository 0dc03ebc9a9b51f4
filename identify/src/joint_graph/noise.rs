//! A tracker's noise as white noise plus a wander, estimated from how differences grow with lag.

use crate::samples::quantile;
use crate::screw::PoseSamples;

/// White noise plus an exponentially correlated wander, per component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wander {
    /// Standard deviation of the white part, m or rad.
    pub white: f64,
    /// Standard deviation of the wander, m or rad.
    pub wander: f64,
    /// Time constant of the wander, s.
    pub time_constant: f64,
}

impl Wander {
    /// Whether both parts and their time are the same to 2 %.
    pub(super) fn is_near(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.02;
        near(self.white, other.white)
            && near(self.wander, other.wander)
            && near(self.time_constant, other.time_constant)
    }

    pub(super) fn start(size: f64, period: f64) -> Self {
        Self {
            white: size,
            wander: size,
            time_constant: 100.0 * period,
        }
    }

    /// All of the residual as white noise.
    pub(super) fn none(series: &[Vec<f64>]) -> Self {
        let absolute: Vec<f64> = series.iter().flatten().map(|v| v.abs()).collect();
        // 1.4826 median absolute values are a standard deviation.
        let white = (1.4826 * quantile(&absolute, 0.5)).max(1e-6);
        Self {
            white,
            wander: 1e-4 * white,
            time_constant: 1e3,
        }
    }

    /// Fits `D(lag) = 2 white^2 + 2 wander^2 (1 - exp(-lag / T))` to the mean squared differences of `series`, T from a
    /// grid, each lag weighted by its own size. `None` when there are too few samples.
    pub(super) fn estimate(series: &[Vec<f64>], track: &PoseSamples, floor: f64) -> Option<Self> {
        let count = track.positions.len();
        let mut lags = Vec::new();
        let mut lag = 1;
        while lag < count / 3 {
            lags.push(lag);
            lag = (lag + 1).max(lag * 3 / 2);
        }
        let points: Vec<(f64, f64)> = lags
            .iter()
            .filter_map(|&lag| Some((lag as f64 * track.period, structure(series, track, lag)?)))
            .collect();
        if points.len() < 3 {
            return None;
        }
        let longest = points.last().map_or(1.0, |p| p.0);
        let best = (0..40)
            .map(|k| track.period * 2.0_f64.powf(f64::from(k) / 2.0))
            .take_while(|t| *t < 4.0 * longest)
            .map(|t| (fit(&points, t), t))
            .min_by(|a, b| a.0.2.total_cmp(&b.0.2))?;
        let ((white, wander, _), time_constant) = best;
        let wander = (wander / 2.0).sqrt();
        // A hundredth of the wander at least: less is beyond the arithmetic of the elimination.
        let white = (white / 2.0).sqrt().max(floor).max(0.01 * wander);
        Some(Self {
            white,
            wander: wander.max(floor.max(0.01 * white)),
            time_constant,
        })
    }
}

/// Mean squared difference at `lag`, from the median, so that outliers do not count.
fn structure(series: &[Vec<f64>], track: &PoseSamples, lag: usize) -> Option<f64> {
    let mut squares = Vec::new();
    let count = track.positions.len();
    for values in series {
        // Within one run: no start between the two.
        let ends = track.starts.iter().copied().chain([count]);
        let mut from = 0;
        for to in ends {
            let run = values.get(from..to).unwrap_or_default();
            let both = run.iter().zip(run.iter().skip(lag));
            squares.extend(both.map(|(one, other)| (other - one).powi(2)));
            from = to;
        }
    }
    if squares.len() < 20 {
        return None;
    }
    // The median of a squared normal variable is 0.4549 of its mean.
    Some((quantile(&squares, 0.5) / 0.4549).max(1e-18))
}

/// Non-negative (2 white^2, 2 wander^2) and the sum of squared relative errors for one time constant.
fn fit(points: &[(f64, f64)], time_constant: f64) -> (f64, f64, f64) {
    let growth = |t: f64| 1.0 - (-t / time_constant).exp();
    let (mut s11, mut s12, mut s22, mut r1, mut r2) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for &(t, d) in points {
        let (a, b) = (1.0 / d, growth(t) / d);
        s11 += a * a;
        s12 += a * b;
        s22 += b * b;
        r1 += a;
        r2 += b;
    }
    let determinant = s11 * s22 - s12 * s12;
    let (mut white, mut wander) = (
        (r1 * s22 - r2 * s12) / determinant,
        (s11 * r2 - s12 * r1) / determinant,
    );
    if !(white.is_finite() && wander.is_finite()) || wander < 0.0 {
        (white, wander) = (r1 / s11, 0.0);
    } else if white < 0.0 {
        (white, wander) = (0.0, r2 / s22);
    }
    let error = points
        .iter()
        .map(|&(t, d)| ((white + wander * growth(t)) / d - 1.0).powi(2))
        .sum();
    (white, wander, error)
}
