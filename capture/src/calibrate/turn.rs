//! How the sensor is turned on the tool, when nobody knows: from the same free air.
//!
//! Still or slow, the sensor reads `force = m R^T s + bias`, with `s` gravity minus acceleration in the axes of `tcp`. The best affine
//! map from `s` to the force over the search of the offset gives `m R^T` by its polar part; then three small turns are fitted beside
//! the tool, the bias and the delay, until nothing moves. Where the sensor sits on the tool must be known.

use ft_recording::{Pose7, Recording};
use nalgebra::{
    Matrix3, Matrix4, Matrix4x3, Quaternion, Rotation3, UnitQuaternion, Vector3, Vector4,
};
use serde::Serialize;

use super::CalibrateOptions;
use super::error::CalibrateError;
use super::fit::{Delay, Extras, Problem, ROW_STEP_S};
use super::series::PoseSide;

/// Step of the search over the offset, s.
const STEP_S: f64 = 1.0 / 64.0;
/// Rows that the search needs.
const MIN_ROWS: usize = 120;
/// Shifts that cover less than this share of the most rows do not compete.
const MIN_COVER: f64 = 0.6;
/// A map that is no rotation squeezes an axis to less than this of the longest.
const MIN_AXIS: f64 = 0.6;
/// Turn by which the derivative is taken, rad.
pub(super) const TURN_STEP: f64 = 1e-4;
const ROUNDS: usize = 6;
const SETTLED_RAD: f64 = 1e-7;
/// A rotation that is worse known is refused, rad.
const MAX_STD: f64 = 0.02;

/// How the sensor is turned on the tool.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SensorRotation {
    /// Takes `ft_sensor` axes to `tcp` axes: quaternion x y z w.
    pub quaternion_xyzw: [f64; 4],
    /// One standard deviation about the sensor's x, y and z, deg.
    pub std_deg: [f64; 3],
}

/// The rotation, and the recording with it.
pub(super) fn find(
    recording: &Recording,
    options: &CalibrateOptions,
) -> Result<(SensorRotation, Recording), CalibrateError> {
    let start = super::start_of(recording);
    let mut turned = with_rotation(recording, UnitQuaternion::identity());
    let problem = Problem::of(&turned, options)?;
    let (offset_s, mut rotation) = coarse(&problem, options.search_s)?;
    let mut std = [f64::INFINITY; 3];
    for _ in 0..ROUNDS {
        turned = with_rotation(recording, rotation);
        let mut problem = Problem::of(&turned, options)?;
        let mut sides = Vec::with_capacity(3);
        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
            let step = UnitQuaternion::from_scaled_axis(axis * TURN_STEP);
            sides.push(PoseSide::of(
                &with_rotation(recording, rotation * step),
                start,
            )?);
        }
        problem.turned = <[PoseSide; 3]>::try_from(sides).ok();
        let delay = Delay {
            offset_s,
            skew: 0.0,
            middle_s: problem.middle_s(),
        };
        let extras = |delay: bool| Extras {
            delay,
            turn: true,
            ..Extras::default()
        };
        // Still poses show no delay, and need none.
        let fit = problem
            .fit(delay, &extras(true))
            .or_else(|| problem.fit(delay, &extras(false)));
        let (fit, at) = fit
            .and_then(|fit| Some((fit.turn_at?, fit)))
            .map(|(at, fit)| (fit, at))
            .ok_or(CalibrateError::Singular)?;
        let turn = Vector3::from_fn(|k, _| fit.theta[at + k]);
        std = core::array::from_fn(|k| fit.std(at + k));
        rotation *= UnitQuaternion::from_scaled_axis(turn);
        if turn.norm() < SETTLED_RAD {
            break;
        }
    }
    let worst = std.iter().copied().fold(0.0, f64::max);
    if worst.is_nan() || worst >= MAX_STD {
        return Err(CalibrateError::RotationUnknown {
            std_deg: worst.to_degrees(),
            needed_deg: MAX_STD.to_degrees(),
        });
    }
    let found = SensorRotation {
        quaternion_xyzw: rotation.coords.into(),
        std_deg: std.map(f64::to_degrees),
    };
    Ok((found, with_rotation(recording, rotation)))
}

fn with_rotation(recording: &Recording, rotation: UnitQuaternion<f64>) -> Recording {
    Recording {
        tcp_from_ft_sensor: Pose7 {
            position: recording.tcp_from_ft_sensor.position,
            quaternion: rotation.coords.into(),
        },
        ..recording.clone()
    }
}

/// The offset and the rotation of the affine map that leaves least of the force.
fn coarse(problem: &Problem, search_s: f64) -> Result<(f64, UnitQuaternion<f64>), CalibrateError> {
    let reach = (search_s / STEP_S).ceil() as i64;
    let maps: Vec<_> = (-reach..=reach)
        .filter_map(|k| Affine::at(problem, k as f64 * STEP_S))
        .collect();
    let most = maps.iter().map(|map| map.rows).max().unwrap_or(0);
    let enough = MIN_ROWS.max((MIN_COVER * most as f64) as usize);
    let best = maps
        .iter()
        .filter(|map| map.rows >= enough)
        .min_by(|a, b| a.left.total_cmp(&b.left));
    let Some(best) = best else {
        return Err(CalibrateError::FreeAirShort {
            free_air_s: most as f64 * ROW_STEP_S,
            needed_s: MIN_ROWS as f64 * ROW_STEP_S,
        });
    };
    if best.left > 1.0 - super::align::MIN_EXPLAINED_COARSE {
        return Err(CalibrateError::Unrelated {
            explained: 1.0 - best.left,
        });
    }
    let svd = best.map.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Err(CalibrateError::Singular);
    };
    let squeezed = svd.singular_values.min() / svd.singular_values.max();
    let sensor_from_tcp = u * v_t;
    if squeezed.is_nan() || squeezed < MIN_AXIS || sensor_from_tcp.determinant() < 0.0 {
        return Err(CalibrateError::NoRotation { squeezed });
    }
    let rotation = Rotation3::from_matrix_unchecked(sensor_from_tcp.transpose());
    Ok((
        best.shift_s,
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

/// `force = map s + constant` at a shift of the poses.
struct Affine {
    shift_s: f64,
    map: Matrix3<f64>,
    /// Share of the force's variance that it leaves.
    left: f64,
    rows: usize,
}

impl Affine {
    fn at(problem: &Problem, shift_s: f64) -> Option<Self> {
        let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Matrix4x3::<f64>::zeros());
        let (mut total, mut sum, mut rows) = (0.0, Vector3::zeros(), 0);
        for t in problem.times() {
            let (Some(columns), Some(wrench)) =
                (problem.pose.at(t - shift_s), problem.wrench.at(t))
            else {
                continue;
            };
            let row = Vector4::new(columns[(0, 0)], columns[(1, 0)], columns[(2, 0)], 1.0);
            let force = Vector3::new(wrench[0], wrench[1], wrench[2]);
            normal += row * row.transpose();
            right += row * force.transpose();
            total += force.norm_squared();
            sum += force;
            rows += 1;
        }
        let theta = normal.cholesky()?.solve(&right);
        let about_mean = total - sum.norm_squared() / f64::from(rows.max(1));
        let left = total - theta.component_mul(&right).sum();
        (about_mean > 0.0).then(|| Self {
            shift_s,
            map: theta.fixed_rows::<3>(0).transpose(),
            left: left / about_mean,
            rows: rows as usize,
        })
    }
}

impl SensorRotation {
    /// Angle to another rotation, deg.
    #[must_use]
    pub fn angle_deg(&self, other_xyzw: [f64; 4]) -> f64 {
        let unit =
            |[x, y, z, w]: [f64; 4]| UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        unit(self.quaternion_xyzw)
            .angle_to(&unit(other_xyzw))
            .to_degrees()
    }
}
