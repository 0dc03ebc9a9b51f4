//! A joint whose axis moves aside as it opens: a hinge that sags, a rail that is bent.

use core::f64::consts::PI;

use nalgebra::{Matrix4, Matrix4x2, RowVector2, Vector4};

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable};
use crate::least_squares::Bound::Free;
use crate::screw::JointKind;

/// The axis has moved by `shift (1 - cos(pi u)) / 2` at the share `u` of the range: forces across the joint do work on that way,
/// and about an axis that is elsewhere they have another moment. `first` and `second` are the shift along the directions of
/// [`crate::samples::Aside::across`]. The effort is stated about the straight joint that fits the crooked path best, and where that lies
/// the shift says. Seen by the forces across the joint alone, which no other effect has to do with.
pub const AXIS_OFFSET: Kind = Kind {
    name: "axis_offset",
    belongs: Belongs::Recording,
    terms: &[
        ("first", Unit::Length, Free),
        ("second", Unit::Length, Free),
    ],
    shape: &[
        ("from", Unit::Position, Search::Fixed),
        ("range", Unit::Position, Search::Fixed),
    ],
    variable: Variable::Q,
    grid: |scope| {
        if scope.motion.across.len() == 2 {
            vec![vec![scope.q[0], scope.range()]]
        } else {
            vec![]
        }
    },
    series: |scope, shape| {
        if scope.motion.across.len() == 2 {
            moved(scope, shape)
        } else {
            vec![vec![0.0; scope.motion.q.len()]; 2]
        }
    },
    at: None,
    separate: "strokes while the handle is pushed across its path, both ways",
};

/// No axis moves farther, m: forces across a hinge hold the effort itself, and with larger terms they could make up anything.
pub const FARTHEST: f64 = 0.1;

fn moved(scope: &Scope<'_>, shape: &[f64]) -> Vec<Vec<f64>> {
    let motion = scope.motion;
    let turning = motion.kind == JointKind::Revolute;
    let (first, second) = (&motion.across[0], &motion.across[1]);
    let [by_first, by_second] = if turning {
        axis_fitted(shape[0], shape[1])
    } else {
        [[0.0, TILT / shape[1]], [-TILT / shape[1], 0.0]]
    };
    let mut out = vec![Vec::new(); 2];
    for i in 0..motion.q.len() {
        let u = ((motion.q[i] + scope.datum - shape[0]) / shape[1]).clamp(0.0, 1.0);
        let (sin, cos) = (PI * u).sin_cos();
        let slope = 0.5 * PI / shape[1] * sin;
        let moment = if turning { 0.5 * (1.0 - cos) } else { 0.0 };
        // A moment about an axis that is elsewhere.
        let about = |away: [f64; 2]| away[1] * first[i] - away[0] * second[i];
        out[0].push(about([by_first[0], by_first[1] - slope]) + moment * second[i]);
        out[1].push(about([by_second[0] + slope, by_second[1]]) - moment * first[i]);
    }
    out
}

/// Slope over the share of the range of the straight line that fits `(1 - cos(pi u)) / 2` best.
const TILT: f64 = 12.0 / (PI * PI);

/// Where the axis of the circle lies that fits the path about an axis which moves by one along the first direction best, and the same
/// for the second: by places evenly over the range.
fn axis_fitted(from: f64, range: f64) -> [[f64; 2]; 2] {
    let (mut gram, mut right) = (Matrix4::zeros(), Matrix4x2::zeros());
    for k in 0..PLACES {
        let u = (f64::from(k) + 0.5) / f64::from(PLACES);
        let (sin, cos) = (from + range * u).sin_cos();
        let away = 0.5 * (1.0 - (PI * u).cos());
        // The distance is off by the axis' place and by the radius, the way along the path by the axis' place and by the angle's zero.
        for (row, [first, second], weight) in [
            (Vector4::new(cos, sin, 1.0, 0.0), [cos, sin], 1.0),
            (Vector4::new(-sin, cos, 0.0, 1.0), [-sin, cos], ALONG),
        ] {
            gram += weight * row * row.transpose();
            right += weight * row * RowVector2::new(away * first, away * second);
        }
    }
    gram.cholesky().map_or([[0.0; 2]; 2], |factor| {
        let fitted = factor.solve(&right);
        [0, 1].map(|k| [fitted[(0, k)], fitted[(1, k)]])
    })
}

const PLACES: i32 = 48;
/// Weight of the way along the path against the distance: rotations, which tell the angle, and positions are about as good in trackers.
const ALONG: f64 = 0.5;

#[cfg(test)]
mod tests {
    use super::*;

    /// Against `numpy.linalg.lstsq` over 4 001 places.
    #[test]
    fn a_hinge_fitted_to_the_path_about_an_axis_that_moves_lies_where_least_squares_has_it() {
        let [first, second] = axis_fitted(0.2, 0.5 * PI);
        let expected = [[0.5164, 0.7254], [-0.7116, 0.4836]];
        for (fitted, expected) in [first, second].iter().zip(expected) {
            for (fitted, expected) in fitted.iter().zip(expected) {
                assert!((fitted - expected).abs() < 2e-3, "{first:?} {second:?}");
            }
        }
    }
}
