//! Efforts that depend on where the joint stands: loads, springs, weights, notches, magnets, rollers.

use core::f64::consts::{PI, TAU};

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable, even, geometric};
use crate::least_squares::Bound::{Free, NonNegative};
use crate::screw::JointKind;

/// `tau = load`. One alias class with a sensor bias and with Coulomb friction that differs between the directions.
pub const CONSTANT_LOAD: Kind = Kind {
    name: "constant_load",
    belongs: Belongs::Recording,
    equation: "tau = load",
    terms: &[("load", Unit::Effort, Free)],
    shape: &[],
    variable: Variable::Q,
    grid: |_| vec![vec![]],
    series: |scope, _| vec![scope.by_state(|_, _, _| 1.0)],
    at: Some(|_, _, _| [1.0, 0.0]),
    separate: "a tare in free air before and after (sensor bias), and the force at which the joint starts from rest in either direction",
};

/// `tau = preload + stiffness q`, `stiffness >= 0`. On a short range the same as gravity; makes inertia too small when missing.
pub const SPRING: Kind = Kind {
    name: "spring",
    belongs: Belongs::Object,
    equation: "tau = preload + stiffness q",
    terms: &[
        ("stiffness", Unit::Stiffness, NonNegative),
        ("preload", Unit::Effort, Free),
    ],
    shape: &[],
    variable: Variable::Q,
    grid: |_| vec![vec![]],
    series: |scope, _| vec![scope.by_state(|q, _, _| q), scope.by_state(|_, _, _| 1.0)],
    at: Some(|_, q, _| [q, 1.0]),
    separate: "slow strokes over the whole range",
};

/// What a spring between two pivots does per unit of its terms: the part of its rate, and the part of its force.
fn strut(shape: &[f64], q: f64) -> [f64; 2] {
    let (ratio, (sin, cos)) = (shape[1], (q + shape[0]).sin_cos());
    let length = (1.0 + ratio * (ratio - 2.0 * cos)).max(1e-12).sqrt();
    [sin, ratio * sin / length]
}

/// `tau = stiffness sin p + pull ratio sin p / sqrt(1 + ratio^2 - 2 ratio cos p)`, `p = q + angle`, `stiffness >= 0`: a spring or gas
/// spring between two pivots, one of them `ratio` times as far from the hinge as the other. With the distance R of the other
/// and a spring of k N/m that is F N strong at no length, `stiffness = k R^2 ratio` and `pull = F R`; a gas spring pushes, so that
/// its pull is negative, and has hardly a stiffness. Which of the pivots is on the frame nothing shows (`ratio` and `1 / ratio` have
/// one shape), nor does the motion show `stiffness` apart from a weight: beside `gravity` it is left out, and the terms of that
/// effect are those of both.
///
/// Looked for at hinges about which weight acts, against which such springs are fitted, and where hinge and pivots do not come into
/// one line on the way: there it would snap over.
pub const STRUT: Kind = Kind {
    name: SPRING.name,
    belongs: Belongs::Object,
    equation: "tau = stiffness sin p + pull ratio sin p / sqrt(1 + ratio^2 - 2 ratio cos p), p = q + angle",
    terms: &[
        ("stiffness", Unit::Effort, NonNegative),
        ("pull", Unit::Effort, Free),
    ],
    shape: &[
        ("angle", Unit::Position, Search::Way(0.12)),
        ("ratio", Unit::One, Search::Factor(1.5)),
    ],
    variable: Variable::Q,
    grid: |scope| {
        let [low, high] = scope.q;
        if !scope.motion.lies || !(0.3..0.9 * PI).contains(&scope.range()) {
            return vec![];
        }
        let mut out = Vec::new();
        for ratio in [0.15, 0.25, 0.4, 0.6, 0.8] {
            for first in even(0.0, PI - scope.range(), 6) {
                // Both ways round: the length grows as the joint opens, or it shrinks.
                out.push(vec![first - low, ratio]);
                out.push(vec![-first - high, ratio]);
            }
        }
        out
    },
    series: |scope, shape| {
        let (rate, force) = scope.both_by_state(|q, _, _| strut(shape, q));
        vec![rate, force]
    },
    at: Some(|shape, q, _| strut(shape, q)),
    separate: "unhooking the spring, or weighing the part: weight and the rate of a spring between pivots have one shape",
};

/// `tau = sine sin(q - lowest) + cosine cos(q - lowest)`: weight about an axis that is not vertical. Revolute joints. Where the
/// axis is seen to lean, `lowest` is known and the sine alone is used.
pub const GRAVITY: Kind = Kind {
    name: "gravity",
    belongs: Belongs::Object,
    equation: "tau = sine sin(q - lowest) + cosine cos(q - lowest)",
    terms: &[("sine", Unit::Effort, Free), ("cosine", Unit::Effort, Free)],
    shape: &[("lowest", Unit::Position, Search::Fixed)],
    variable: Variable::Q,
    grid: |scope| {
        if scope.motion.kind == JointKind::Revolute && scope.range() > 0.3 {
            vec![vec![0.0]]
        } else {
            vec![]
        }
    },
    series: |scope, shape| {
        let (sine, cosine) = scope.both_by_state(|q, _, _| (q - shape[0]).sin_cos().into());
        vec![sine, cosine]
    },
    at: Some(|shape, q, _| [(q - shape[0]).sin(), (q - shape[0]).cos()]),
    separate: "a larger angle, or the direction of gravity against the axis",
};

fn notch(shape: &[f64], q: f64) -> f64 {
    let u = (q - shape[0]) / shape[1];
    if shape[2] > 0.5 {
        if u.abs() < 2.0 {
            (0.5 * PI * u).sin()
        } else {
            0.0
        }
    } else {
        u * (0.5 * (1.0 - u * u)).exp()
    }
}

/// `tau = hold u exp((1 - u^2) / 2)`, `u = (q - centre) / width`, `hold >= 0`: pulled to the centre from both sides. Or, `round`
/// = 1, a notch that ends at two widths: `hold sin(pi u / 2)`. Both have their greatest effort at one width, which is at most a tenth of
/// the range that was recorded: what acts over half of it is no place.
pub const DETENT: Kind = Kind {
    name: "detent",
    belongs: Belongs::Object,
    equation: "tau = hold u exp((1 - u^2) / 2), u = (q - centre) / width; round = 1: hold sin(pi u / 2) for |u| < 2",
    terms: &[("hold", Unit::Effort, NonNegative)],
    shape: &[
        ("centre", Unit::Position, Search::Way(0.03)),
        ("width", Unit::Position, Search::Between(0.004, 0.1)),
        ("round", Unit::One, Search::Form),
    ],
    variable: Variable::Q,
    grid: |scope| {
        let mut out = Vec::new();
        for width in [0.012_f64, 0.025, 0.05, 0.09] {
            let count = (0.7 / width).clamp(12.0, 60.0) as usize;
            for at in even(0.03, 0.97, count) {
                for round in [0.0, 1.0] {
                    let centre = scope.q[0] + at * scope.range();
                    out.push(vec![centre, width * scope.range(), round]);
                }
            }
        }
        out
    },
    series: |scope, shape| vec![scope.by_state(|q, _, _| notch(shape, q))],
    at: Some(|shape, q, _| [notch(shape, q), 0.0]),
    separate: "slow strokes back and forth through the place",
};

/// A magnet's pull when it is stated at another closed end than `shape` has, which then has that one, and what it grows by per unit of what pull and
/// reach were: the effort beyond both ends stays. Nothing where the other one lies so far below that the law ends before.
pub(crate) fn restated(pull: f64, shape: &mut [f64], closed: f64) -> Option<(f64, [f64; 2])> {
    let [own, reach, inverse_square] = shape else {
        return None;
    };
    let far = (closed - *own) / *reach;
    if far < FARTHEST_BELOW {
        return None;
    }
    let (left, by_reach, longer) = if *inverse_square > 0.5 {
        let left = (1.0 + far).powi(-2);
        (left, 2.0 * left * far / (1.0 + far), far * *reach)
    } else {
        ((-far).exp(), (-far).exp() * far, 0.0)
    };
    let slopes = [left, pull * by_reach / *reach];
    *own = closed;
    *reach += longer;
    Some((pull * left, slopes))
}

/// A magnet is stated anew at most so far below its closed end, in reaches.
const FARTHEST_BELOW: f64 = -0.5;

fn pull(shape: &[f64], q: f64) -> f64 {
    let distance = (q - shape[0]).max(0.0);
    if shape[2] > 0.5 {
        (1.0 + distance / shape[1]).powi(-2)
    } else {
        (-distance / shape[1]).exp()
    }
}

/// A magnet reaches at most so far, as a share of the range.
pub(crate) const FARTHEST_REACH: f64 = 0.15;

/// `tau = pull exp(-(q - closed) / reach)` or `pull / (1 + (q - closed) / reach)^2`, `pull >= 0`: a magnet or a gasket at the
/// closed end. Its reach is at most 15 % of the range: what reaches farther is a spring.
pub const CATCH: Kind = Kind {
    name: "catch",
    belongs: Belongs::Object,
    equation: "tau = pull exp(-(q - closed) / reach); inverse_square = 1: pull / (1 + (q - closed) / reach)^2",
    terms: &[("pull", Unit::Effort, NonNegative)],
    shape: &[
        ("closed", Unit::Position, Search::Fixed),
        (
            "reach",
            Unit::Position,
            Search::Between(0.005, FARTHEST_REACH),
        ),
        ("inverse_square", Unit::One, Search::Form),
    ],
    variable: Variable::Q,
    grid: |scope| {
        let mut out = Vec::new();
        for form in [0.0, 1.0] {
            for reach in geometric(0.01, 0.13, 7) {
                out.push(vec![scope.q[0], reach * scope.range(), form]);
            }
        }
        out
    },
    series: |scope, shape| vec![scope.by_state(|q, _, _| pull(shape, q))],
    at: Some(|shape, q, _| [pull(shape, q), 0.0]),
    separate: "slow strokes that begin and end closed",
};

/// `tau = sine sin(2 pi q / pitch) + cosine cos(2 pi q / pitch)`: rollers, gear teeth, a magnetic motor.
pub const RIPPLE: Kind = Kind {
    name: "ripple",
    belongs: Belongs::Object,
    equation: "tau = sine sin(2 pi q / pitch) + cosine cos(2 pi q / pitch)",
    terms: &[("sine", Unit::Effort, Free), ("cosine", Unit::Effort, Free)],
    shape: &[("pitch", Unit::Position, Search::Factor(1.02))],
    variable: Variable::Q,
    grid: |scope| {
        waves(scope)
            .into_iter()
            .map(|cycles| vec![scope.range() / cycles])
            .collect()
    },
    series: |scope, shape| {
        let (sine, cosine) = scope.both_by_state(|q, _, _| (TAU * q / shape[0]).sin_cos().into());
        vec![sine, cosine]
    },
    at: Some(|shape, q, _| [(TAU * q / shape[0]).sin(), (TAU * q / shape[0]).cos()]),
    separate: "slow strokes over many periods",
};

/// Cycles over the range, in thirds, from three up to where slow strokes pass the filter.
fn waves(_: &Scope<'_>) -> Vec<f64> {
    (9..=150).map(|k| f64::from(k) / 3.0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_magnet_that_is_stated_elsewhere_pulls_as_much() {
        for (inverse_square, closed) in [(0.0, 0.014), (1.0, 0.014), (0.0, 0.004), (1.0, 0.004)] {
            let shape = [0.01, 0.02, inverse_square];
            let mut moved = shape;
            let (there, slopes) = restated(6.0, &mut moved, closed).unwrap();
            assert_eq!(moved[0], closed);
            for q in [0.014, 0.02, 0.05] {
                let [before, after] = [6.0 * pull(&shape, q), there * pull(&moved, q)];
                assert!((before - after).abs() < 1e-12, "{before} {after}");
            }
            let mut longer = [0.01, 0.02 + 1e-6, inverse_square];
            let (by_reach, _) = restated(6.0, &mut longer, closed).unwrap();
            let (by_pull, _) = restated(6.0 + 1e-6, &mut shape.clone(), closed).unwrap();
            for (slope, moved) in slopes.iter().zip([by_pull, by_reach]) {
                let numeric = (moved - there) / 1e-6;
                assert!(
                    (slope - numeric).abs() < 1e-3 * numeric.abs(),
                    "{slope} {numeric}"
                );
            }
        }
        assert!(restated(6.0, &mut [0.01, 0.02, 1.0], -0.015).is_none());
    }
}
