//! Efforts that grow with speed beyond the viscous friction of the base.

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable};
use crate::least_squares::Bound::NonNegative;

/// Share of the range over which a zone begins and ends, to start with.
pub(crate) const EDGE: f64 = 0.04;

/// How far a coordinate is inside of a zone: from 0 to 1.
fn inside(shape: &[f64]) -> impl Fn(f64) -> f64 + use<> {
    let (from, to) = (shape[0].min(shape[1]), shape[0].max(shape[1]));
    let edge = shape[3].max(1e-9);
    let step = move |x: f64| {
        let u = (x / edge + 0.5).clamp(0.0, 1.0);
        u * u * (3.0 - 2.0 * u)
    };
    move |q| step(q - from) * step(to - q)
}

/// Whether a zone of this shape is all of the range.
pub(crate) fn is_everywhere(shape: &[f64], scope: &Scope<'_>) -> bool {
    shape[0].min(shape[1]) < scope.q[0] && shape[0].max(shape[1]) > scope.q[1]
}

/// 1 where the motion goes the way of `direction` (1 opening, -1 closing, 0 both).
fn goes(direction: f64, dq: f64) -> f64 {
    if direction == 0.0 || direction * dq > 0.0 {
        1.0
    } else {
        0.0
    }
}

fn zone(shape: &[f64]) -> impl Fn(f64, f64) -> [f64; 2] + use<> {
    let (inside, direction, relief) = (inside(shape), shape[2], shape[4]);
    move |q, dq| {
        let here = dq.signum() * goes(direction, dq) * inside(q);
        let below = dq.abs().min(relief);
        [here * below, here * (dq.abs() - below)]
    }
}

/// `tau = damping dq` for `from < q < to` and one direction, `damping >= 0`: closers, soft-close dampers, backchecks. Above the
/// speed `relief` a valve opens and the effort grows by `beyond` only.
///
/// # Source
/// EN 1154: latching zone 15-0 deg, backcheck from 70 deg; pressure relief valves of closers open at a pressure, so at a
/// damping effort.
pub const ZONE: Kind = Kind {
    name: "damping_zone",
    belongs: Belongs::Object,
    equation: "tau = damping dq between from and to, setting in over edge; direction = 1: only as q grows, -1: only as it falls; above the speed relief it grows by beyond",
    terms: &[
        ("damping", Unit::Viscous, NonNegative),
        ("beyond", Unit::Viscous, NonNegative),
    ],
    shape: &[
        ("from", Unit::Position, Search::Way(0.12)),
        ("to", Unit::Position, Search::Way(0.12)),
        ("direction", Unit::One, Search::Fixed),
        ("edge", Unit::Position, Search::Between(0.01, 0.12)),
        ("relief", Unit::Speed, Search::Below),
    ],
    variable: Variable::Q,
    grid: |scope| {
        let at = |share: f64| scope.q[0] + share * scope.range();
        let edge = EDGE * scope.range();
        // Nothing is faster: no relief.
        let relief = scope.fastest();
        let mut out = Vec::new();
        for from in 0..9 {
            for to in from + 1..=9 {
                // A zone that reaches an end of the range goes on behind it; all of the range, without a valve, is no zone.
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
                    out.push(vec![at(low), at(high), direction, edge, relief]);
                }
            }
        }
        out
    },
    series: |scope, shape| {
        let zone = zone(shape);
        let (below, beyond) = scope.both_by_state(|q, dq, _| zone(q, dq));
        vec![below, beyond]
    },
    at: Some(|shape, q, dq| zone(shape)(q, dq)),
    separate: "strokes at different speeds through the zone, both ways",
};

/// `tau = damping dq` one way only, `damping >= 0`.
pub const ASYMMETRIC: Kind = Kind {
    name: "asymmetric_viscous",
    belongs: Belongs::Object,
    equation: "tau = damping dq; direction = 1: only as q grows, -1: only as it falls",
    terms: &[("damping", Unit::Viscous, NonNegative)],
    shape: &[("direction", Unit::One, Search::Fixed)],
    variable: Variable::Dq,
    grid: |_| vec![vec![-1.0], vec![1.0]],
    series: |scope, shape| vec![scope.by_state(|_, dq, _| dq * goes(shape[0], dq))],
    at: Some(|shape, _, dq| [dq * goes(shape[0], dq), 0.0]),
    separate: "strokes at two clearly different steady speeds in each direction",
};

/// `tau = drag dq |dq|`, `drag >= 0`: air, an orifice. Three quarters of it look like viscous friction.
pub const QUADRATIC: Kind = Kind {
    name: "quadratic_drag",
    belongs: Belongs::Object,
    equation: "tau = drag dq |dq|",
    terms: &[("drag", Unit::Drag, NonNegative)],
    shape: &[],
    variable: Variable::Dq,
    grid: |_| vec![vec![]],
    series: |scope, _| vec![scope.by_state(|_, dq, _| dq * dq.abs())],
    at: Some(|_, _, dq| [dq * dq.abs(), 0.0]),
    separate: "a few much faster strokes",
};
