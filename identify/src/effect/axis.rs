//! A joint whose axis moves aside as it opens: a hinge that sags, a rail that is bent.

use core::f64::consts::PI;

use nalgebra::{Matrix4, Matrix4x2, RowVector2, Vector4};

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable};
use crate::least_squares::Bound::Free;
use crate::screw::JointKind;

/// The axis has moved by `shift (1 - cos(pi u)) / 2` at the share `u` of the range: forces across the joint do work on that way,
/// and about an axis that is elsewhere they have another moment. `first` and `second` are the shift along the directions of
/// [`crate::samples::Aside::across`]. The effort is stated about the straight joint that fits the crooked path of its recording best, and
/// where that lies the shift says. Seen by the forces across the joint alone, which no other effect has to do with.
pub const AXIS_OFFSET: Kind = Kind {
    name: "axis_offset",
    belongs: Belongs::Recording,
    equation: "the axis is aside by (first, second) (1 - cos(pi u)) / 2, u = (q - from) / range",
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
    let share = |q: f64| ((q + scope.datum - shape[0]) / shape[1]).clamp(0.0, 1.0);
    let away = |q: f64| 0.5 * (1.0 - (PI * share(q)).cos());
    let [by_first, by_second] = if turning {
        hinge_fitted(scope.q, away)
    } else {
        let slope = slide_fitted(scope.q, away);
        [[0.0, slope], [-slope, 0.0]]
    };
    let mut out = vec![Vec::new(); 2];
    for i in 0..motion.q.len() {
        let slope = 0.5 * PI / shape[1] * (PI * share(motion.q[i])).sin();
        let moment = if turning { away(motion.q[i]) } else { 0.0 };
        // A moment about an axis that is elsewhere.
        let about = |away: [f64; 2]| away[1] * first[i] - away[0] * second[i];
        out[0].push(about([by_first[0], by_first[1] - slope]) + moment * second[i]);
        out[1].push(about([by_second[0] + slope, by_second[1]]) - moment * first[i]);
    }
    out
}

/// Slope of the straight line that fits a path best which goes aside by `away(q)`, by places evenly over the range.
fn slide_fitted([low, high]: [f64; 2], away: impl Fn(f64) -> f64) -> f64 {
    let middle = 0.5 * (low + high);
    let (mut across, mut along) = (0.0, 0.0);
    for q in places([low, high]) {
        across += (q - middle) * away(q);
        along += (q - middle).powi(2);
    }
    across / along
}

/// Where the axis of the circle lies that fits the path about an axis best which moves by `away(q)` along the first direction, and the
/// same for the second: by places evenly over the range.
fn hinge_fitted(range: [f64; 2], away: impl Fn(f64) -> f64) -> [[f64; 2]; 2] {
    let (mut gram, mut right) = (Matrix4::zeros(), Matrix4x2::zeros());
    for q in places(range) {
        let (sin, cos) = q.sin_cos();
        // The distance is off by the axis' place and by the radius, the way along the path by the axis' place and by the angle's zero.
        for (row, [first, second], weight) in [
            (Vector4::new(cos, sin, 1.0, 0.0), [cos, sin], 1.0),
            (Vector4::new(-sin, cos, 0.0, 1.0), [-sin, cos], ALONG),
        ] {
            gram += weight * row * row.transpose();
            right += weight * away(q) * row * RowVector2::new(first, second);
        }
    }
    gram.cholesky().map_or([[0.0; 2]; 2], |factor| {
        let fitted = factor.solve(&right);
        [0, 1].map(|k| [fitted[(0, k)], fitted[(1, k)]])
    })
}

fn places([low, high]: [f64; 2]) -> impl Iterator<Item = f64> {
    (0..PLACES).map(move |k| low + (high - low) * (f64::from(k) + 0.5) / f64::from(PLACES))
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
        let away = |q: f64| 0.5 * (1.0 - (2.0 * (q - 0.2)).cos());
        let [first, second] = hinge_fitted([0.2, 0.2 + 0.5 * PI], away);
        let expected = [[0.5164, 0.7254], [-0.7116, 0.4836]];
        for (fitted, expected) in [first, second].iter().zip(expected) {
            for (fitted, expected) in fitted.iter().zip(expected) {
                assert!((fitted - expected).abs() < 2e-3, "{first:?} {second:?}");
            }
        }
    }

    /// The line that fits `(1 - cos(pi u)) / 2` has the slope `12 / pi^2` over the share `u`.
    #[test]
    fn a_slide_fitted_to_a_crooked_path_has_the_slope_of_least_squares() {
        let away = |q: f64| 0.5 * (1.0 - (PI * q / 0.4).cos());
        let slope = slide_fitted([0.0, 0.4], away);
        assert!((0.4 * slope - 12.0 / PI.powi(2)).abs() < 2e-3, "{slope}");
    }
}
