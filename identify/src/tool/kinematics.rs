//! What the tool's own weight and inertia depend on, at the sensor and in its axes.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::ToolSamples;
use crate::filter::{FilterError, LowPass, first_derivative, second_derivative};

/// Standard gravity, m/s^2; `world` has z up.
pub(crate) const GRAVITY: f64 = 9.80665;

/// Cut-off of the low-pass on poses before they are differentiated, Hz: well above the fit's, so that the tool's inertial
/// wrench is whole there.
const SMOOTH_HZ: f64 = 20.0;

/// That cut-off for poses at a rate.
pub(crate) fn smoothing_hz(rate_hz: f64) -> f64 {
    SMOOTH_HZ.min(0.2 * rate_hz)
}

/// Motion of the sensor frame over the samples of a [`ToolSamples`].
#[derive(Clone, Debug)]
pub struct ToolKinematics {
    /// Gravity minus the acceleration of the sensor's origin, m/s^2, in `ft_sensor`.
    pub specific: Vec<Vector3<f64>>,
    /// Angular rate, rad/s, in `ft_sensor`.
    pub rate: Vec<Vector3<f64>>,
    /// Angular acceleration, rad/s^2, in `ft_sensor`.
    pub angular: Vec<Vector3<f64>>,
}

impl ToolKinematics {
    /// Gravity minus acceleration, angular rate and angular acceleration at sample `i`, in `ft_sensor`.
    #[must_use]
    pub fn at(&self, i: usize) -> [Vector3<f64>; 3] {
        [self.specific[i], self.rate[i], self.angular[i]]
    }

    /// Differentiates the poses, run by run. Runs too short for the filter get the still tool's values.
    ///
    /// # Errors
    /// [`FilterError::Cutoff`] when the rate is too low for any filter.
    pub fn of(tool: &ToolSamples) -> Result<Self, FilterError> {
        let rate_hz = 1.0 / tool.period;
        let filter = LowPass::butterworth(4, smoothing_hz(rate_hz), rate_hz)?;
        let count = tool.time.len();
        let turn = tool.tcp_from_ft_sensor.rotation;
        let arm = tool.tcp_from_ft_sensor.translation.vector;
        let rotation: Vec<_> = tool.rotation.iter().map(|r| r * turn).collect();
        let mut out = Self {
            specific: Vec::with_capacity(count),
            rate: Vec::with_capacity(count),
            angular: Vec::with_capacity(count),
        };
        for run in &tool.runs {
            let rotations = &rotation[run.clone()];
            let origin: Vec<[f64; 3]> = run
                .clone()
                .map(|i| (tool.position[i].coords + tool.rotation[i] * arm).into())
                .collect();
            if run.len() <= filter.edge_samples() + 4 {
                let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
                let still = rotations.iter().map(|r| r.inverse() * gravity);
                out.specific.extend(still);
                out.rate.extend(rotations.iter().map(|_| Vector3::zeros()));
                out.angular
                    .extend(rotations.iter().map(|_| Vector3::zeros()));
                continue;
            }
            let smooth = smoothed(rotations, &filter)?;
            let origin = filter.zero_phase_settled_each(&origin)?;
            let acceleration = per_axis(&origin, |x| second_derivative(x, tool.period));
            let rate = body_rates(&smooth, tool.period);
            let angular = per_axis(&rate, |x| first_derivative(x, tool.period));
            let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
            let specific = acceleration.iter().zip(&smooth);
            out.specific
                .extend(specific.map(|(a, r)| r.inverse() * (gravity - a)));
            out.rate.extend(rate);
            out.angular.extend(angular);
        }
        Ok(out)
    }
}

fn per_axis<V: core::ops::Index<usize, Output = f64>>(
    series: &[V],
    f: impl Fn(&[f64]) -> Vec<f64>,
) -> Vec<Vector3<f64>> {
    let axis = |k: usize| f(&series.iter().map(|v| v[k]).collect::<Vec<_>>());
    let (x, y, z) = (axis(0), axis(1), axis(2));
    (0..series.len())
        .map(|i| Vector3::new(x[i], y[i], z[i]))
        .collect()
}

/// Rotations through the filter, component by component and brought back to length 1.
fn smoothed(
    rotations: &[UnitQuaternion<f64>],
    filter: &LowPass,
) -> Result<Vec<UnitQuaternion<f64>>, FilterError> {
    let mut last = rotations
        .first()
        .map_or(Quaternion::identity(), |r| r.into_inner());
    let on_one_side = |rotation: &UnitQuaternion<f64>| -> [f64; 4] {
        let q = rotation.into_inner();
        last = if q.coords.dot(&last.coords) < 0.0 {
            -q
        } else {
            q
        };
        last.coords.into()
    };
    let components: Vec<[f64; 4]> = rotations.iter().map(on_one_side).collect();
    let smooth = filter.zero_phase_settled_each(&components)?;
    let rotation = |q: [f64; 4]| UnitQuaternion::from_quaternion(Quaternion::from(q));
    Ok(smooth.into_iter().map(rotation).collect())
}

/// Angular rate in body axes, from each sample's four neighbours, fourth order as the accelerations; from two near the ends.
fn body_rates(rotations: &[UnitQuaternion<f64>], period: f64) -> Vec<Vector3<f64>> {
    let last = rotations.len() - 1;
    (0..rotations.len())
        .map(|i| {
            if i >= 2 && i + 2 <= last {
                let turn = |k: usize| (rotations[i - k].inverse() * rotations[i + k]).scaled_axis();
                return (turn(1) * 8.0 - turn(2)) / (12.0 * period);
            }
            let (a, b) = (i.saturating_sub(1), (i + 1).min(last));
            (rotations[a].inverse() * rotations[b]).scaled_axis() / ((b - a).max(1) as f64 * period)
        })
        .collect()
}
