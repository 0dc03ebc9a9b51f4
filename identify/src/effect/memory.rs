//! Effects with a state that the motion drives: bristles and play.

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable, geometric};
use crate::least_squares::Bound::NonNegative;
use crate::least_squares::rms;

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
/// friction found so far; its term should be near 1.
pub const BACKLASH: Kind = Kind {
    name: "backlash",
    belongs: Belongs::Object,
    terms: &[("share", Unit::One, NonNegative)],
    shape: &[("gap", Unit::Position, Search::Factor(1.6))],
    variable: Variable::SinceReversal,
    grid: |scope| {
        geometric(0.0002, 0.03, 10)
            .into_iter()
            .map(|gap| vec![gap * scope.range()])
            .collect()
    },
    series: |scope, shape| vec![played(scope, shape[0])],
    at: None,
    separate: "quick small strokes: the force is zero within the gap, and a firmer grasp does not change it",
};

/// Share of the usual effort below which the object is taken to be between the sides.
const BETWEEN: f64 = 0.15;

fn played(scope: &Scope<'_>, gap: f64) -> Vec<f64> {
    let motion = scope.motion;
    let Ok(effort) = motion.filtered(&motion.tau) else {
        return Vec::new();
    };
    let level = (BETWEEN * rms(&effort)).max(1e-12);
    let aside: Vec<f64> = effort
        .iter()
        .map(|tau| -0.5 * gap * (tau / level).tanh())
        .collect();
    scope.moved_object(&aside)
}
