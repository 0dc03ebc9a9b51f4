//! A joint whose axis moves aside as it opens: a hinge that sags, a rail that is bent.

use core::f64::consts::PI;

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable};
use crate::least_squares::Bound::Free;
use crate::screw::JointKind;

/// The axis has moved by `shift (1 - cos(pi u)) / 2` at the share `u` of the range: forces across the joint do work on that way,
/// and about an axis that is elsewhere they have another moment. `first` and `second` are the shift along the perpendiculars of
/// the axis; the further terms are what the straight joint, fitted to the crooked path, errs by itself. Seen by the forces
/// across the joint alone, which no other effect has to do with.
pub const AXIS_OFFSET: Kind = Kind {
    name: "axis_offset",
    belongs: Belongs::Recording,
    terms: &[
        ("first", Unit::Length, Free),
        ("second", Unit::Length, Free),
        ("first_fit", Unit::One, Free),
        ("second_fit", Unit::One, Free),
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
            vec![vec![0.0; scope.motion.q.len()]; 4]
        }
    },
    at: None,
    separate: "strokes while the handle is pushed across its path, both ways",
};

/// What the fitted axis errs by for a term of one: its place, m, and its direction, rad.
const FIT_M: f64 = 0.02;
const FIT_RAD: f64 = 0.1;
/// No axis moves farther, m; and what a fitted axis errs by in the units above. Forces across a hinge hold the effort itself, and
/// with larger terms they could make up anything.
pub const FARTHEST: [f64; 2] = [0.1, 1.5];

fn moved(scope: &Scope<'_>, shape: &[f64]) -> Vec<Vec<f64>> {
    let motion = scope.motion;
    let turning = motion.kind == JointKind::Revolute;
    let (first, second) = (&motion.across[0], &motion.across[1]);
    let fit = if turning { FIT_M } else { FIT_RAD };
    let mut out = vec![Vec::new(); 4];
    for i in 0..motion.q.len() {
        let u = ((motion.q[i] + scope.datum - shape[0]) / shape[1]).clamp(0.0, 1.0);
        let (sin, cos) = (PI * u).sin_cos();
        let slope = 0.5 * PI / shape[1] * sin;
        let moment = if turning { 0.5 * (1.0 - cos) } else { 0.0 };
        out[0].push(moment * second[i] - slope * first[i]);
        out[1].push(-moment * first[i] - slope * second[i]);
        out[2].push(fit * first[i]);
        out[3].push(fit * second[i]);
    }
    out
}
