//! Effects with a state that the motion drives: bristles and play.

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable, geometric};
use crate::least_squares::Bound::NonNegative;
use crate::least_squares::rms;
use crate::motion::Motion;

/// `tau = coulomb (z - sgn(dq))`, `dz/dq = (sgn(dq) - z) sgn(dq) / length` (or, `stiff` = 1, a spring that slides at `length`):
/// friction that builds up over a way after each reversal. No function of q and dq can be this.
///
/// # Source
/// P. Dahl, *A solid friction model*, 1968; Maxwell-slip element for the stiff form.
pub const PRESLIDING: Kind = Kind {
    name: "presliding",
    belongs: Belongs::Object,
    terms: &[("coulomb", Unit::Effort, NonNegative)],
    shape: &[
        ("length", Unit::Position, Search::Factor(1.6)),
        ("stiff", Unit::One, Search::Form),
    ],
    variable: Variable::SinceReversal,
    grid: |scope| {
        let mut out = Vec::new();
        for stiff in [0.0, 1.0] {
            for length in geometric(0.0015, 0.5, 12) {
                out.push(vec![length * scope.range(), stiff]);
            }
        }
        out
    },
    series: |scope, shape| {
        let z = bristle(scope, shape);
        let s = &scope.motion.sign;
        vec![z.iter().zip(s).map(|(z, s)| z - s).collect()]
    },
    at: None,
    separate: "small strokes of a few millimetres about one place, and rests held under force",
};

fn bristle(scope: &Scope<'_>, shape: &[f64]) -> Vec<f64> {
    let motion = scope.motion;
    let mut out = vec![0.0; motion.q.len()];
    for run in &motion.runs {
        let mut z = 0.0_f64;
        for i in run.clone() {
            let step = if i > run.start {
                motion.q[i] - motion.q[i - 1]
            } else {
                0.0
            };
            z = if shape[1] > 0.5 {
                (z + step / shape[0]).clamp(-1.0, 1.0)
            } else {
                let s = if step < 0.0 { -1.0 } else { 1.0 };
                s + (z - s) * (-step.abs() / shape[0]).exp()
            };
            out[i] = z;
        }
    }
    out
}

/// The object stands at `q - gap/2` while the tool pushes and at `q + gap/2` while it pulls: it changes sides when the effort
/// changes its sign, not when the motion turns. One regressor, the difference that the play makes with the inertia and
/// friction found so far; its term should be near 1. The pads behind the play give by `compliance` times the effort.
pub const BACKLASH: Kind = Kind {
    name: "backlash",
    belongs: Belongs::Object,
    terms: &[("share", Unit::One, NonNegative)],
    shape: &[
        ("gap", Unit::Position, Search::Factor(1.6)),
        ("compliance", Unit::Compliance, Search::Factor(1.8)),
    ],
    variable: Variable::SinceReversal,
    grid: |scope| {
        let effort = rms(&scope.motion.tau).max(1e-12);
        let mut out = Vec::new();
        for gap in geometric(0.0003, 0.02, 8) {
            for share in geometric(0.0001, 0.005, 4) {
                out.push(vec![gap * scope.range(), share * scope.range() / effort]);
            }
        }
        out
    },
    series: |scope, shape| vec![played(scope, shape[0], shape[1])],
    at: None,
    separate: "quick small strokes: the force is zero within the gap, and a firmer grasp does not change it",
};

/// Share of the usual effort below which the object is taken to be between the sides.
const BETWEEN: f64 = 0.12;

/// What it makes of the effort that the object lags behind the tool by half of `gap` towards the effort and by `compliance` times it.
pub(super) fn played(scope: &Scope<'_>, gap: f64, compliance: f64) -> Vec<f64> {
    let motion = scope.motion;
    let Ok(effort) = motion.smoothed_effort() else {
        return Vec::new();
    };
    let sides = if gap == 0.0 {
        vec![0.0; effort.len()]
    } else {
        sides(motion, effort)
    };
    let aside: Vec<f64> = effort
        .iter()
        .zip(sides)
        .map(|(tau, side)| -0.5 * gap * side - compliance * tau)
        .collect();
    scope.moved_object(&aside)
}

/// The side of the play that the effort presses against: 1 or -1, and evenly from one to the other while there is next to none.
fn sides(motion: &Motion, effort: &[f64]) -> Vec<f64> {
    let level = BETWEEN * rms(effort);
    let mut out = vec![0.0; effort.len()];
    for run in &motion.runs {
        // Where it last pressed, and against which side.
        let mut last: Option<(usize, f64)> = None;
        for i in run.clone().filter(|i| effort[*i].abs() > level) {
            let side = effort[i].signum();
            let (from, was) = last.unwrap_or((run.start, side));
            for (k, out) in out[from..=i].iter_mut().enumerate() {
                *out = was + (side - was) * k as f64 / (i - from).max(1) as f64;
            }
            last = Some((i, side));
        }
        if let Some((from, side)) = last {
            out[from..run.end].fill(side);
        }
    }
    out
}
