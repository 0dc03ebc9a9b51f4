//! Linear least squares with rank, condition and covariance, and with non-negative parameters where physics asks for it.
//!
//! `tau = Y theta`, Y is (n, p). Residuals of filtered motion data are correlated in time, so the covariance is
//! inflated by what their autocorrelation says (see [`effective_count`]).

mod bounded;

pub(crate) use bounded::Quadratic;
pub use bounded::{Bound, bounded_quadratic};

use nalgebra::{DMatrix, DVector};

use crate::products::dot;

/// Why there is no estimate.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FitError {
    /// Fewer samples than the fit needs.
    #[error(
        "{samples} samples left for {params} parameters, need at least {needed}; record longer or move more"
    )]
    TooFewSamples {
        /// Samples there.
        samples: usize,
        /// Parameters to fit.
        params: usize,
        /// Samples needed.
        needed: usize,
    },
    /// Some combination of the parameters leaves no trace in the data.
    #[error(
        "the motion shows {rank} of {params} parameters apart; add strokes of other speeds and accelerations"
    )]
    RankDeficient {
        /// Numerical rank.
        rank: usize,
        /// Parameters to fit.
        params: usize,
    },
    /// A value is NaN or infinite.
    #[error("sample {row} is not a finite number")]
    NotFinite {
        /// Row, from 0.
        row: usize,
    },
    /// Regressor and effort differ in length.
    #[error("regressor has {rows} rows and the effort {samples}")]
    Shape {
        /// Rows of the regressor.
        rows: usize,
        /// Samples of the effort.
        samples: usize,
    },
}

/// A least-squares estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearFit {
    /// Parameters, (p).
    pub theta: DVector<f64>,
    /// Covariance, (p, p), already inflated for correlated residuals; rows of parameters at their bound are zero.
    pub covariance: DMatrix<f64>,
    /// Measured minus predicted, (n).
    pub residual: DVector<f64>,
    /// Rank of the column-scaled regressor.
    pub rank: usize,
    /// Condition of the column-scaled regressor.
    pub condition: f64,
    /// Independent samples that the residual is worth.
    pub effective_samples: f64,
}

impl LinearFit {
    /// Root mean square of the residual, in the unit of the effort.
    #[must_use]
    pub fn rms(&self) -> f64 {
        rms(self.residual.as_slice())
    }

    /// Standard deviation of parameter `index`.
    #[must_use]
    pub fn std(&self, index: usize) -> f64 {
        self.covariance[(index, index)].max(0.0).sqrt()
    }
}

/// Root mean square; 0 for an empty series.
#[must_use]
pub fn rms(series: &[f64]) -> f64 {
    (series.iter().map(|v| v * v).sum::<f64>() / series.len().max(1) as f64).sqrt()
}

/// Least squares without bounds. `tolerance` is the smallest singular value of the column-scaled regressor, relative to
/// the largest, that still counts.
///
/// # Errors
/// [`FitError`], each of its variants.
pub fn least_squares(
    regressor: &DMatrix<f64>,
    tau: &DVector<f64>,
    tolerance: f64,
) -> Result<LinearFit, FitError> {
    let free = vec![Bound::Free; regressor.ncols()];
    bounded_least_squares(regressor, tau, &free, tolerance)
}

/// Least squares with a lower bound of zero on the parameters marked [`Bound::NonNegative`], by active set.
///
/// # Errors
/// [`FitError`], each of its variants.
pub fn bounded_least_squares(
    regressor: &DMatrix<f64>,
    tau: &DVector<f64>,
    bounds: &[Bound],
    tolerance: f64,
) -> Result<LinearFit, FitError> {
    let (samples, params) = regressor.shape();
    check(regressor, tau)?;
    let scale = DVector::from_fn(params, |j, _| {
        let norm = regressor.column(j).norm();
        if norm > 0.0 { norm } else { 1.0 }
    });
    let scaled = DMatrix::from_fn(samples, params, |i, j| regressor[(i, j)] / scale[j]);
    let (rank, condition) = rank_and_condition(&scaled, tolerance);
    if rank < params {
        return Err(FitError::RankDeficient { rank, params });
    }
    let gram = scaled.transpose() * &scaled;
    let right = scaled.transpose() * tau;
    let solution = bounded_quadratic(&gram, &right, bounds, None);
    let residual = tau - &scaled * &solution;
    let at_bound: Vec<bool> = (0..params)
        .map(|j| bounds.get(j) == Some(&Bound::NonNegative) && solution[j] == 0.0)
        .collect();
    let effective = effective_count(residual.as_slice());
    let freedom = (effective - params as f64).max(1.0);
    let variance = residual.norm_squared() / samples as f64 * (samples as f64 / freedom);
    let covariance = covariance_of_free(&gram, &at_bound) * variance;
    Ok(LinearFit {
        theta: DVector::from_fn(params, |j, _| solution[j] / scale[j]),
        covariance: DMatrix::from_fn(params, params, |i, j| {
            covariance[(i, j)] / (scale[i] * scale[j])
        }),
        residual,
        rank,
        condition,
        effective_samples: effective,
    })
}

fn check(regressor: &DMatrix<f64>, tau: &DVector<f64>) -> Result<(), FitError> {
    let (samples, params) = regressor.shape();
    if samples != tau.len() {
        return Err(FitError::Shape {
            rows: samples,
            samples: tau.len(),
        });
    }
    if samples <= params {
        return Err(FitError::TooFewSamples {
            samples,
            params,
            needed: params + 1,
        });
    }
    let bad = (0..samples)
        .find(|i| !(tau[*i].is_finite() && regressor.row(*i).iter().all(|v| v.is_finite())));
    bad.map_or(Ok(()), |row| Err(FitError::NotFinite { row }))
}

/// Rank and condition from the triangular factor, whose singular values are the regressor's.
fn rank_and_condition(scaled: &DMatrix<f64>, tolerance: f64) -> (usize, f64) {
    let singular = scaled.clone().qr().r().singular_values();
    let (largest, smallest) = (singular.max(), singular.min());
    let rank = singular
        .iter()
        .filter(|s| **s > tolerance * largest && **s > 0.0)
        .count();
    (
        rank,
        if smallest > 0.0 {
            largest / smallest
        } else {
            f64::INFINITY
        },
    )
}

/// Inverse of the normal matrix over the parameters that are not at a bound; zero elsewhere.
pub(crate) fn covariance_of_free(gram: &DMatrix<f64>, at_bound: &[bool]) -> DMatrix<f64> {
    let free: Vec<usize> = (0..gram.ncols()).filter(|j| !at_bound[*j]).collect();
    let mut full = DMatrix::zeros(gram.nrows(), gram.ncols());
    let part = DMatrix::from_fn(free.len(), free.len(), |i, j| gram[(free[i], free[j])]);
    let Some(inverse) = part
        .clone()
        .cholesky()
        .map(|c| c.inverse())
        .or_else(|| part.pseudo_inverse(1e-12).ok())
    else {
        return full;
    };
    for (i, &row) in free.iter().enumerate() {
        for (j, &column) in free.iter().enumerate() {
            full[(row, column)] = inverse[(i, j)];
        }
    }
    full
}

/// Lags of the autocorrelation that are taken one by one before pairs of samples are taken together.
const LAGS_AT_A_STEP: usize = 128;

/// Number of independent samples that a correlated series is worth: n / (1 + 2 sum of the autocorrelation up to its
/// first value below 0.05 or a quarter of the series). At least 2, at most n.
///
/// # Source
/// The integrated autocorrelation time; Sokal, *Monte Carlo methods in statistical mechanics*, 1997, section 3.
#[must_use]
pub fn effective_count(series: &[f64]) -> f64 {
    let n = series.len();
    if n < 4 {
        return n as f64;
    }
    let mean = series.iter().sum::<f64>() / n as f64;
    let centred: Vec<f64> = series.iter().map(|v| v - mean).collect();
    let power: f64 = centred.iter().map(|v| v * v).sum();
    if power <= 0.0 {
        return n as f64;
    }
    let (mut series, mut step, mut time) = (centred, 1, 1.0);
    let mut lag = 1;
    while lag * step < n / 4 {
        let product = dot(&series[..series.len() - lag], &series[lag..]);
        let rho = product * step as f64 / power;
        if rho < 0.05 {
            break;
        }
        time += 2.0 * rho * step as f64;
        lag += 1;
        if lag > LAGS_AT_A_STEP {
            // What still holds together after so many samples does not change from one to the next.
            series = series
                .chunks_exact(2)
                .map(|pair| 0.5 * (pair[0] + pair[1]))
                .collect();
            step *= 2;
            lag = LAGS_AT_A_STEP / 2 + 1;
        }
    }
    (n as f64 / time).clamp(2.0, n as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn normal(rng: &mut ChaCha8Rng) -> f64 {
        StandardNormal.sample(rng)
    }

    #[test]
    fn a_series_that_drifts_for_an_hour_is_worth_what_all_its_lags_say() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let n = 20_000;
        let series: Vec<f64> = (0..n)
            .map(|i| f64::from(i) / f64::from(n) + 0.5 * normal(&mut rng))
            .collect();
        let mean = series.iter().sum::<f64>() / f64::from(n);
        let centred: Vec<f64> = series.iter().map(|v| v - mean).collect();
        let at = |lag: usize| -> f64 {
            centred
                .iter()
                .zip(&centred[lag..])
                .map(|(a, b)| a * b)
                .sum()
        };
        let rho = (1..series.len() / 4).map(|lag| at(lag) / at(0));
        let time = 1.0 + 2.0 * rho.take_while(|rho| *rho >= 0.05).sum::<f64>();
        let exact = f64::from(n) / time;
        let found = effective_count(&series);
        assert!((found / exact - 1.0).abs() < 0.05, "{found} {exact}");
    }

    #[test]
    fn a_still_joint_cannot_reveal_viscous_friction() {
        let still = DMatrix::from_fn(5, 2, |_, column| if column == 0 { 0.0 } else { 1.0 });
        assert_eq!(
            least_squares(&still, &DVector::zeros(5), 1e-9),
            Err(FitError::RankDeficient { rank: 1, params: 2 })
        );
    }

    #[test]
    fn each_refusal_names_its_number() {
        let y = DMatrix::from_fn(6, 2, |i, j| if j == 0 { 1.0 } else { i as f64 });
        let mut tau = DVector::from_element(6, 1.0);
        assert_eq!(
            least_squares(
                &y.rows(0, 2).into_owned(),
                &tau.rows(0, 2).into_owned(),
                1e-9
            ),
            Err(FitError::TooFewSamples {
                samples: 2,
                params: 2,
                needed: 3
            })
        );
        assert_eq!(
            least_squares(&y, &tau.rows(0, 4).into_owned(), 1e-9),
            Err(FitError::Shape {
                rows: 6,
                samples: 4
            })
        );
        tau[3] = f64::NAN;
        assert_eq!(
            least_squares(&y, &tau, 1e-9),
            Err(FitError::NotFinite { row: 3 })
        );
    }

    #[test]
    fn white_noise_scatters_estimates_as_the_covariance_says() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let y = DMatrix::from_fn(300, 3, |i, j| {
            ((i as f64) * 0.1 * (j + 1) as f64).sin() + 0.3
        });
        let truth = DVector::from_vec(vec![1.0, -2.0, 0.5]);
        let mut inside = 0;
        for _ in 0..200 {
            let tau = &y * &truth + DVector::from_fn(300, |_, _| 0.2 * normal(&mut rng));
            let fit = least_squares(&y, &tau, 1e-9).unwrap();
            inside += usize::from((fit.theta[1] - truth[1]).abs() < 1.96 * fit.std(1));
        }
        assert!((180..=200).contains(&inside), "{inside} of 200 within 95 %");
    }

    #[test]
    fn correlated_noise_widens_the_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let y = DMatrix::from_fn(2000, 1, |_, _| 1.0);
        let mut inside = 0;
        for _ in 0..200 {
            let mut noise = 0.0;
            let tau = DVector::from_fn(2000, |_, _| {
                noise = 0.95 * noise + normal(&mut rng);
                3.0 + noise
            });
            let fit = least_squares(&y, &tau, 1e-9).unwrap();
            inside += usize::from((fit.theta[0] - 3.0).abs() < 1.96 * fit.std(0));
        }
        assert!((178..=200).contains(&inside), "{inside} of 200 within 95 %");
    }

    #[test]
    fn a_parameter_at_its_bound_has_no_spread_and_the_others_are_refitted() {
        let y = DMatrix::from_fn(50, 2, |i, j| if j == 0 { 1.0 } else { i as f64 / 50.0 });
        let tau = DVector::from_fn(50, |i, _| 2.0 - 0.5 * i as f64 / 50.0);
        let fit = bounded_least_squares(&y, &tau, &[Bound::NonNegative; 2], 1e-9).unwrap();
        assert_eq!(fit.theta[1], 0.0);
        assert_eq!(fit.std(1), 0.0);
        assert!((fit.theta[0] - tau.mean()).abs() < 1e-12);
    }

    #[test]
    fn white_noise_counts_fully() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let white: Vec<f64> = (0..1000).map(|_| rng.random_range(-1.0..1.0)).collect();
        assert!(effective_count(&white) > 800.0);
        let slow: Vec<f64> = (0..1000).map(|i| (f64::from(i) / 60.0).sin()).collect();
        assert!(effective_count(&slow) < 30.0);
    }
}
