//! Efforts that grow with speed beyond the viscous friction of the base.

use super::library::{Belongs, Kind, Search, Unit, Variable};
use crate::least_squares::Bound::NonNegative;

/// Share of a zone's edge that is taken to open or close gradually, of the width of the zone.
const BLEND: f64 = 0.08;

fn inside(shape: &[f64], q: f64) -> f64 {
    let (from, to) = (shape[0].min(shape[1]), shape[0].max(shape[1]));
    let blend = (BLEND * (to - from)).max(1e-9);
    let step = |x: f64| {
        let u = (x / blend + 0.5).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    };
    step(q - from) * step(to - q)
}

/// 1 where the motion goes the way of `direction` (1 opening, -1 closing, 0 both).
fn goes(direction: f64, dq: f64) -> f64 {
    if direction == 0.0 || direction * dq > 0.0 {
        1.0
    } else {
        0.0
    }
}

fn zone(shape: &[f64], q: f64, dq: f64) -> f64 {
    dq * goes(shape[2], dq) * inside(shape, q)
}

/// `tau = damping dq` for `from < q < to` and one direction, `damping >= 0`: closers, soft-close dampers, backchecks.
///
/// # Source
/// EN 1154: latching zone 15-0 deg, backcheck from 70 deg.
pub const ZONE: Kind = Kind {
    name: "damping_zone",
    belongs: Belongs::Object,
    terms: &[("damping", Unit::Viscous, NonNegative)],
    shape: &[
        ("from", Unit::Position, Search::Way(0.08)),
        ("to", Unit::Position, Search::Way(0.08)),
        ("direction", Unit::One, Search::Fixed),
    ],
    variable: Variable::Q,
    grid: |scope| {
        let at = |share: f64| scope.q[0] + share * scope.range();
        let mut out = Vec::new();
        for from in 0..9 {
            for to in from + 1..=9 {
                // A zone that reaches an end of the range goes on behind it; all of the range is no zone.
                if from == 0 && to == 9 {
                    continue;
                }
                let low = if from == 0 {
                    -1.0
                } else {
                    f64::from(from) / 9.0
                };
                let high = if to == 9 { 2.0 } else { f64::from(to) / 9.0 };
                for direction in [-1.0, 1.0, 0.0] {
                    out.push(vec![at(low), at(high), direction]);
                }
            }
        }
        out
    },
    series: |scope, shape| vec![scope.by_state(|q, dq, _| zone(shape, q, dq))],
    at: Some(|shape, q, dq| vec![zone(shape, q, dq)]),
    separate: "strokes at different speeds through the zone, both ways",
};

/// `tau = damping dq` one way only, `damping >= 0`.
pub const ASYMMETRIC: Kind = Kind {
    name: "asymmetric_viscous",
    belongs: Belongs::Object,
    terms: &[("damping", Unit::Viscous, NonNegative)],
    shape: &[("direction", Unit::One, Search::Fixed)],
    variable: Variable::Dq,
    grid: |_| vec![vec![-1.0], vec![1.0]],
    series: |scope, shape| vec![scope.by_state(|_, dq, _| dq * goes(shape[0], dq))],
    at: Some(|shape, _, dq| vec![dq * goes(shape[0], dq)]),
    separate: "strokes at two clearly different steady speeds in each direction",
};

/// `tau = drag dq |dq|`, `drag >= 0`: air, an orifice. Three quarters of it look like viscous friction.
pub const QUADRATIC: Kind = Kind {
    name: "quadratic_drag",
    belongs: Belongs::Object,
    terms: &[("drag", Unit::Drag, NonNegative)],
    shape: &[],
    variable: Variable::Dq,
    grid: |_| vec![vec![]],
    series: |scope, _| vec![scope.by_state(|_, dq, _| dq * dq.abs())],
    at: Some(|_, _, dq| vec![dq * dq.abs()]),
    separate: "a few much faster strokes",
};
