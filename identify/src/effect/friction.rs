//! Dry friction beyond one constant.

use super::library::{
    Belongs, Kind, LONGEST_DRIFT, SHORTEST_DRIFT, Scope, Search, Unit, Variable, even, geometric,
};
use crate::least_squares::Bound::{Free, NonNegative};
use crate::samples::quantile;

/// `tau = coulomb sgn(dq)` one way only, `coulomb >= 0`. While moving the same as a constant load.
pub const ASYMMETRIC: Kind = Kind {
    name: "asymmetric_coulomb",
    belongs: Belongs::Object,
    equation: "tau = coulomb sgn(dq); direction = 1: only as q grows, -1: only as it falls",
    terms: &[("coulomb", Unit::Effort, NonNegative)],
    shape: &[("direction", Unit::One, Search::Fixed)],
    variable: Variable::Dq,
    grid: |_| vec![vec![-1.0], vec![1.0]],
    series: |scope, shape| vec![scope.by_state(|_, _, s| if s * shape[0] > 0.0 { s } else { 0.0 })],
    at: Some(|shape, _, dq| [if dq * shape[0] > 0.0 { shape[0] } else { 0.0 }, 0.0]),
    separate: "rest in the middle of the range with no hand force: a load moves or is held there, friction is not",
};

/// `tau = extra sgn(dq) / (1 + (dq / speed)^2)`, `extra >= 0`: friction that falls as a film builds up.
///
/// # Source
/// Armstrong-Helouvry, Dupont and Canudas de Wit, *A survey of models ... for machines with friction*, Automatica 30, 1994.
pub const STRIBECK: Kind = Kind {
    name: "stribeck",
    belongs: Belongs::Object,
    equation: "tau = extra sgn(dq) / (1 + (dq / speed)^2)",
    terms: &[("extra", Unit::Effort, NonNegative)],
    shape: &[("speed", Unit::Speed, Search::Factor(1.8))],
    variable: Variable::Dq,
    grid: |scope| {
        let fast = usual_speed(scope);
        geometric(0.02 * fast, 0.5 * fast, 7)
            .into_iter()
            .map(|v| vec![v])
            .collect()
    },
    series: |scope, shape| vec![scope.by_state(|_, dq, s| s * falling(shape[0], dq))],
    at: Some(|shape, _, dq| [sign(dq) * falling(shape[0], dq), 0.0]),
    separate: "slow steady strokes at a few speeds below the typical one",
};

/// Share of the extra friction that is left at the velocity `dq`.
pub(crate) fn falling(speed: f64, dq: f64) -> f64 {
    1.0 / (1.0 + (dq / speed).powi(2))
}

/// The speed below which the joint is for 95 % of the time.
fn usual_speed(scope: &Scope<'_>) -> f64 {
    let speeds: Vec<f64> = scope.motion.dq.iter().map(|v| v.abs()).collect();
    quantile(&speeds, 0.95).max(1e-9)
}

/// `tau = extra sgn(dq) exp(-(|dq| / speed)^power)`, `extra >= 0`, `power` = 2: the same where nothing is left of it at speed.
///
/// # Source
/// As [`STRIBECK`], which has both.
pub const STRIBECK_FADING: Kind = Kind {
    equation: "tau = extra sgn(dq) exp(-(|dq| / speed)^power)",
    shape: &[
        ("speed", Unit::Speed, Search::Factor(1.4)),
        ("power", Unit::One, Search::Fixed),
    ],
    grid: |scope| {
        let fast = usual_speed(scope);
        // Slower, and it would be nothing but what smoothing does to the turns.
        let speeds = geometric(0.06 * fast, 0.6 * fast, 6);
        speeds.into_iter().map(|v| vec![v, 2.0]).collect()
    },
    series: |scope, shape| vec![scope.by_state(|_, dq, s| s * fading(shape, dq))],
    at: Some(|shape, _, dq| [sign(dq) * fading(shape, dq), 0.0]),
    ..STRIBECK
};

fn fading(shape: &[f64], dq: f64) -> f64 {
    (-(dq.abs() / shape[0]).powf(shape[1])).exp()
}

/// More friction to break away from rest than to slide, by `extra`. While it rests, friction takes up what the hand gives, and fits of
/// the motion leave that out; it is read off the effort before the joint leaves rest. No regressor.
pub const STICTION: Kind = Kind {
    name: "stiction",
    belongs: Belongs::Object,
    equation: "coulomb + extra to break away from rest",
    terms: &[],
    shape: &[("extra", Unit::Effort, Search::Fixed)],
    variable: Variable::SinceReversal,
    grid: |_| vec![],
    series: |_, _| vec![],
    at: None,
    separate: "many slow starts from rest, pulling until it breaks away",
};

fn grown(shape: &[f64], q: f64) -> f64 {
    ((q - shape[1]) / shape[2]).clamp(0.0, 1.0).powf(shape[0])
}

/// `tau = growth sgn(dq) ((q - from) / range)^power`: a warped rail, a hinge that binds.
pub const POSITION_DEPENDENT: Kind = Kind {
    name: "position_dependent_friction",
    belongs: Belongs::Object,
    equation: "tau = growth sgn(dq) ((q - from) / range)^power",
    terms: &[("growth", Unit::Effort, Free)],
    shape: &[
        ("power", Unit::One, Search::Factor(1.4)),
        ("from", Unit::Position, Search::Fixed),
        ("range", Unit::Position, Search::Fixed),
    ],
    variable: Variable::Q,
    grid: |scope| {
        [0.5, 1.0, 2.0, 3.5]
            .into_iter()
            .map(|power| vec![power, scope.q[0], scope.range()])
            .collect()
    },
    series: |scope, shape| vec![scope.by_state(|q, _, s| s * grown(shape, q))],
    at: Some(|shape, q, dq| [sign(dq) * grown(shape, q), 0.0]),
    separate: "slow strokes over the whole range, both ways",
};

/// `tau = growth sgn(dq) exp(-u^2 / 2)`, `u = (q - centre) / width`, `growth >= 0`: a rail that binds at a place.
pub const AT_A_PLACE: Kind = Kind {
    equation: "tau = growth sgn(dq) exp(-u^2 / 2), u = (q - centre) / width",
    terms: &[("growth", Unit::Effort, NonNegative)],
    shape: &[
        ("centre", Unit::Position, Search::Way(0.05)),
        ("width", Unit::Position, Search::Factor(1.6)),
    ],
    grid: |scope| {
        let mut out = Vec::new();
        // One way it is a load at a place.
        if scope.motion.goes_one_way() {
            return out;
        }
        for (width, count) in [(0.06, 14), (0.12, 9), (0.25, 6)] {
            for at in even(0.05, 0.95, count) {
                out.push(vec![scope.q[0] + at * scope.range(), width * scope.range()]);
            }
        }
        out
    },
    series: |scope, shape| vec![scope.by_state(|q, _, s| s * bump(shape, q))],
    at: Some(|shape, q, dq| [sign(dq) * bump(shape, q), 0.0]),
    ..POSITION_DEPENDENT
};

fn bump(shape: &[f64], q: f64) -> f64 {
    let u = (q - shape[0]) / shape[1];
    (-0.5 * u * u).exp()
}

/// `tau = extra sgn(dq) exp(-t / time)`: friction that changes while a hinge warms up. Where it takes longer than the recording, what it comes to
/// in the end nobody has seen: it is `tau = extra sgn(dq) (exp(-t / time) - exp(-whole / time)) / (1 - exp(-whole / time))` then, and `coulomb` that at
/// the end of the `whole` recording.
pub const DRIFT: Kind = Kind {
    name: "friction_drift",
    belongs: Belongs::Recording,
    equation: "tau = extra sgn(dq) exp(-t / time); coulomb is that at the end",
    terms: &[("extra", Unit::Effort, Free)],
    shape: &[("time", Unit::Time, Search::Drift)],
    variable: Variable::Time,
    grid: |scope| {
        let duration = scope.duration();
        geometric(SHORTEST_DRIFT * duration, LONGEST_DRIFT * duration, 8)
            .into_iter()
            .map(|time| vec![time])
            .collect()
    },
    series: |scope, shape| {
        let start = scope.motion.time.first().copied().unwrap_or(0.0);
        let motion = scope.motion;
        let left = |t: f64| (-t / shape[0]).exp();
        let end = if shape[0] > scope.duration() {
            left(scope.duration())
        } else {
            0.0
        };
        let share = |t: f64| (left(t - start) - end) / (1.0 - end).max(f64::MIN_POSITIVE);
        let signs = motion.sign.iter().zip(&motion.time);
        vec![signs.map(|(s, t)| s * share(*t)).collect()]
    },
    at: None,
    separate: "the same slow strokes at the beginning and at the end",
};

fn sign(dq: f64) -> f64 {
    if dq == 0.0 { 0.0 } else { dq.signum() }
}
