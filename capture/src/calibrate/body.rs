//! From the fitted parameters, which are linear in the wrench, to those of a body, with their covariance.
//!
//! ```text
//! fitted   m, h = m c, Jo (about the sensor's origin), bias
//! written  m, c = h / m, Jc = Jo - m (|c|^2 1 - c c^T) (about the centre of mass), bias
//! ```

use ft_recording::calibration::PARAMETERS;
use ft_recording::{Calibration, Estimate};
use nalgebra::{Matrix3, SMatrix, SymmetricEigen, Vector3};

use super::CalibrateError;
use super::fit::Fit;

type Covariance = SMatrix<f64, PARAMETERS, PARAMETERS>;

/// Row and column of an inertia's entries: xx xy yy xz yz zz.
const ENTRIES: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)];
/// Where the parts stand among the parameters.
const CENTRE: usize = 1;
const INERTIA: usize = 4;
const BIAS: usize = super::fit::BIAS;

/// Mass, centre of mass and inertia about it, and whether the inertia had to be made one of a body.
pub(super) fn body(fit: &Fit) -> Result<(Calibration, bool), CalibrateError> {
    let (mass, std_kg) = (fit.theta[0], fit.std(0));
    if !(mass > 0.0 && std_kg < 0.03 * mass) {
        return Err(CalibrateError::MassUnknown {
            mass_kg: mass,
            std_kg,
        });
    }
    let com = Vector3::new(fit.theta[1], fit.theta[2], fit.theta[3]) / mass;
    let by_fitted = jacobian(mass, &com);
    let fitted = fit.covariance.fixed_view::<PARAMETERS, PARAMETERS>(0, 0);
    let mut covariance: Covariance = by_fitted * fitted * by_fitted.transpose();
    let measured = inertia_about(&com, mass, fit);
    let (inertia, made_possible) = possible(&measured);
    for (k, entry) in ENTRIES.into_iter().enumerate() {
        // How far it was moved is not known either.
        covariance[(INERTIA + k, INERTIA + k)] += (inertia[entry] - measured[entry]).powi(2);
    }
    covariance = 0.5 * (covariance + covariance.transpose());
    let std = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    let worst = (CENTRE..INERTIA).map(std).fold(0.0, f64::max);
    if worst >= 0.005 {
        return Err(CalibrateError::ComUnknown { std_m: worst });
    }
    let largest = |from: usize| (from..from + 3).map(std).fold(0.0, f64::max);
    let (std_n, std_nm) = (largest(BIAS), largest(BIAS + 3));
    if !(std_n < 0.1 && std_nm < 0.005) {
        return Err(CalibrateError::BiasUnknown { std_n, std_nm });
    }
    let calibration = Calibration {
        payload_mass_kg: Estimate {
            value: mass,
            std: std(0),
        },
        payload_com_m: Estimate {
            value: com.into(),
            std: core::array::from_fn(|k| std(CENTRE + k)),
        },
        payload_inertia_kgm2: Estimate {
            value: ENTRIES.map(|entry| inertia[entry]),
            std: core::array::from_fn(|k| std(INERTIA + k)),
        },
        wrench_bias: Some(Estimate {
            value: core::array::from_fn(|k| fit.theta[BIAS + k]),
            std: core::array::from_fn(|k| std(BIAS + k)),
        }),
        covariance: Some(Box::new(core::array::from_fn(|i| {
            core::array::from_fn(|j| covariance[(i, j)])
        }))),
    };
    Ok((calibration, made_possible))
}

fn inertia_about(com: &Vector3<f64>, mass: f64, fit: &Fit) -> Matrix3<f64> {
    let j = |k: usize| fit.theta[INERTIA + k];
    let about_origin = Matrix3::new(j(0), j(1), j(3), j(1), j(2), j(4), j(3), j(4), j(5));
    about_origin - (Matrix3::identity() * com.norm_squared() - com * com.transpose()) * mass
}

/// Derivatives of what is written by what is fitted.
fn jacobian(mass: f64, com: &Vector3<f64>) -> Covariance {
    let mut out = Covariance::identity();
    let shift = Matrix3::identity() * com.norm_squared() - com * com.transpose();
    for k in 0..3 {
        out[(CENTRE + k, CENTRE + k)] = 1.0 / mass;
        out[(CENTRE + k, 0)] = -com[k] / mass;
    }
    for (row, (a, b)) in ENTRIES.into_iter().enumerate() {
        // Jc = Jo - (|h|^2 1 - h h^T) / m.
        out[(INERTIA + row, 0)] = shift[(a, b)];
        for k in 0..3 {
            let same = |i: usize, j: usize| f64::from(u8::from(i == j));
            let slope = 2.0 * com[k] * same(a, b) - same(a, k) * com[b] - same(b, k) * com[a];
            out[(INERTIA + row, CENTRE + k)] = -slope;
        }
    }
    out
}

/// The nearest inertia that a body can have: its second moments `tr(J)/2 - J` are not negative.
fn possible(inertia: &Matrix3<f64>) -> (Matrix3<f64>, bool) {
    let moments = Matrix3::identity() * (0.5 * inertia.trace()) - inertia;
    let mut eigen = SymmetricEigen::new(moments);
    let least = 1e-9;
    if eigen.eigenvalues.iter().all(|value| *value >= least) {
        return (*inertia, false);
    }
    eigen.eigenvalues.apply(|value| *value = value.max(least));
    let moments = eigen.recompose();
    (Matrix3::identity() * moments.trace() - moments, true)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivatives_are_those_of_the_formula() {
        let written = |theta: &[f64; 10]| -> [f64; 10] {
            let [m, hx, hy, hz, jo @ ..] = *theta;
            let c = Vector3::new(hx, hy, hz) / m;
            let shift = (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * m;
            let mut out = [m, c.x, c.y, c.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
            for (k, entry) in ENTRIES.into_iter().enumerate() {
                out[INERTIA + k] = jo[k] - shift[entry];
            }
            out
        };
        let theta = [0.6, 0.012, -0.02, 0.05, 0.01, 1e-3, 0.02, -2e-3, 3e-3, 0.03];
        let com = Vector3::new(theta[1], theta[2], theta[3]) / theta[0];
        let by_formula = jacobian(theta[0], &com);
        for column in 0..10 {
            let step = 1e-6;
            let moved = |by: f64| {
                let mut theta = theta;
                theta[column] += by;
                written(&theta)
            };
            let (before, after) = (moved(-step), moved(step));
            for row in 0..10 {
                let numeric = (after[row] - before[row]) / (2.0 * step);
                let error = (numeric - by_formula[(row, column)]).abs();
                assert!(error < 1e-7, "{row} {column}: {numeric}");
            }
        }
    }

    #[test]
    fn an_inertia_that_no_body_has_is_moved_to_one_and_others_stay() {
        let real = Matrix3::from_diagonal(&Vector3::new(2.0, 3.0, 4.0));
        assert_eq!(possible(&real), (real, false));
        let (moved, made_possible) =
            possible(&Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 3.0)));
        assert!(made_possible);
        let [x, y, z] = [moved.m11, moved.m22, moved.m33];
        assert!(x + y >= z && x > 0.0, "{moved}");
    }
}
