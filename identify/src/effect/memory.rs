//! Effects with a state that the motion drives: bristles and play.

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable, geometric};
use crate::filter::{first_derivative, second_derivative};
use crate::least_squares::Bound::NonNegative;

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
        ("stiff", Unit::One, Search::Fixed),
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

/// `tau(q) -> tau(play(q))`: the tool moves by `gap` at each reversal before it takes the object along. One regressor, the
/// difference that the play makes with the inertia and friction found so far; its term should be near 1.
pub const BACKLASH: Kind = Kind {
    name: "backlash",
    belongs: Belongs::Object,
    terms: &[("share", Unit::One, NonNegative)],
    shape: &[("gap", Unit::Position, Search::Factor(1.6))],
    variable: Variable::SinceReversal,
    grid: |scope| {
        geometric(0.001, 0.03, 6)
            .into_iter()
            .map(|gap| vec![gap * scope.range()])
            .collect()
    },
    series: |scope, shape| vec![played(scope, shape[0])],
    at: None,
    separate: "quick small strokes: the force is zero within the gap",
};

fn played(scope: &Scope<'_>, gap: f64) -> Vec<f64> {
    let motion = scope.motion;
    let [inertia, coulomb, viscous] = scope.rigid;
    let mut out = vec![0.0; motion.q.len()];
    for run in &motion.runs {
        let mut object = motion.q[run.start];
        let q: Vec<f64> = run
            .clone()
            .map(|i| {
                object = object.clamp(motion.q[i] - gap / 2.0, motion.q[i] + gap / 2.0);
                object
            })
            .collect();
        let (dq, ddq) = (
            first_derivative(&q, motion.period),
            second_derivative(&q, motion.period),
        );
        for (k, i) in run.clone().enumerate() {
            // No force passes while the object lags within the gap, so its friction is not felt either.
            let carried = if dq[k].abs() < 1e-3 * motion.dq[i].abs() {
                0.0
            } else {
                dq[k].signum()
            };
            out[i] = inertia * (ddq[k] - motion.ddq[i])
                + coulomb * (carried - motion.sign[i])
                + viscous * (dq[k] - motion.dq[i]);
        }
    }
    out
}
