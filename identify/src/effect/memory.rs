//! Effects with a state that the motion drives: bristles and play.

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable, geometric};
use super::measurement::{RETARDATION, USUAL_RETARDATION_S};
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
    equation: "tau = coulomb (z - sgn(dq)), dz/dq = (sgn(dq) - z) sgn(dq) / length; stiff = 1: a spring that slides at length",
    terms: &[("coulomb", Unit::Effort, NonNegative)],
    shape: &[
        ("length", Unit::Position, Search::Factor(1.35)),
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
/// changes its sign, not when the motion turns. While there is no effort it goes its own way, and the tool meets it with a blow. One
/// regressor, the difference that the play makes with the object as far as it is known; its term should be near 1, and the play is
/// as large as `share` times `gap`. The pads behind the play give as those of a grasp that gives do.
pub const BACKLASH: Kind = Kind {
    name: "backlash",
    belongs: Belongs::Object,
    equation: "the object is at q - gap / 2 - x while the tool pushes and at q + gap / 2 - x while it pulls, x + retardation dx/dt = compliance tau; the play is share gap",
    terms: &[("share", Unit::One, NonNegative)],
    shape: &[
        ("gap", Unit::Position, Search::ByShare),
        ("compliance", Unit::Compliance, Search::Factor(1.8)),
        ("retardation", Unit::Time, RETARDATION),
    ],
    variable: Variable::SinceReversal,
    grid: |scope| {
        let effort = rms(&scope.motion.tau).max(1e-12);
        let mut out = Vec::new();
        for gap in geometric(0.0003, 0.02, 8) {
            for share in geometric(0.0001, 0.005, 4) {
                let compliance = share * scope.range() / effort;
                out.push(vec![gap * scope.range(), compliance, USUAL_RETARDATION_S]);
            }
        }
        out
    },
    series: |scope, shape| vec![played(scope, shape)],
    at: None,
    separate: "quick small strokes: the force is zero within the gap, and a firmer grasp does not change it",
};

/// What it makes of the effort that the object lags behind the tool by half of a gap towards the effort and by a compliance times it.
fn played(scope: &Scope<'_>, shape: &[f64]) -> Vec<f64> {
    let aside = between_sides(scope.motion, &scope.motion.tau, shape);
    moved(scope, &aside)
}

/// What it makes of the effort that the object lags behind the tool by pads of this compliance and retardation.
pub(super) fn given(scope: &Scope<'_>, shape: &[f64]) -> Vec<f64> {
    let aside = behind_pads(scope.motion, &scope.motion.tau, shape);
    moved(scope, &aside)
}

/// As the column of [`BACKLASH`] or else of a grasp that gives, of an effort without the noise of the poses. `slow` is what the model needs
/// at each sample without inertia.
pub(crate) fn played_quietly(
    scope: &Scope<'_>,
    slow: &[f64],
    kind: &Kind,
    shape: &[f64],
) -> Vec<f64> {
    let tau = on_handle(scope, slow);
    let aside = if kind.is(&BACKLASH) {
        between_sides
    } else {
        behind_pads
    };
    moved(scope, &aside(scope.motion, &tau, shape))
}

/// What the object needs more at its place `aside` of the tool. As smooth as the coordinate, which hides as much of the blow when the sides of a
/// play meet.
fn moved(scope: &Scope<'_>, aside: &[f64]) -> Vec<f64> {
    match scope.motion.smoothed(aside) {
        Ok(aside) => scope.moved_object(&aside),
        Err(_) => Vec::new(),
    }
}

/// How far the object is behind the tool by pads of this compliance and retardation.
fn behind_pads(motion: &Motion, tau: &[f64], pads: &[f64]) -> Vec<f64> {
    let &[compliance, retardation] = pads else {
        return vec![0.0; tau.len()];
    };
    let mut out = vec![0.0; tau.len()];
    for run in &motion.runs {
        let pressed = retarded(&tau[run.clone()], motion.period / retardation);
        for (out, pressed) in out[run.clone()].iter_mut().zip(pressed) {
            *out = -compliance * pressed;
        }
    }
    out
}

/// `x` of `x + retardation dx/dt = tau` at samples `step` retardations apart, settled under the first: exact for a `tau` that is straight between them.
fn retarded(tau: &[f64], step: f64) -> impl Iterator<Item = f64> + '_ {
    let left = (-step).exp();
    // Share of a step's rise that is still to come at its end.
    let late = (1.0 - left) / step;
    let (mut x, mut before) = tau.first().map_or((0.0, 0.0), |&first| (first, first));
    tau.iter().map(move |&tau| {
        x = left * (x - before) + before + (1.0 - late) * (tau - before);
        before = tau;
        x
    })
}

/// The effort on the handle without the noise of the poses. What was taken off for the tool has their acceleration's, which is also what a fit
/// leaves most of; a deflection made of it would explain that. The sensor itself has none: it shows the inertia of tool and object, of which the
/// object has its share.
fn on_handle(scope: &Scope<'_>, slow: &[f64]) -> Vec<f64> {
    let motion = scope.motion;
    let inertia = scope.object.rigid[0];
    if motion.tool_inertia == 0.0 || inertia == 0.0 {
        return motion.tau.clone();
    }
    let share = inertia / (inertia + motion.tool_inertia);
    let efforts = motion.tau.iter().zip(&motion.ddq).zip(slow);
    efforts
        .map(|((tau, ddq), slow)| {
            let measured = tau + motion.tool_inertia * ddq;
            share * measured + (1.0 - share) * slow
        })
        .collect()
}

/// How far the object is aside of the tool: against a side of the play while it is pressed, and on its own way from there to where it
/// is pressed next, as fast as it was when it was let go, slowed evenly.
fn between_sides(motion: &Motion, tau: &[f64], shape: &[f64]) -> Vec<f64> {
    let (gap, behind) = (shape[0], behind_pads(motion, tau, &shape[1..]));
    let (level, q) = (PRESSED * motion.fast_noise_of_tau(), &motion.q_measured);
    let shortest = (SHORTEST_S / motion.period).ceil() as usize;
    let side = |tau: f64| {
        if tau.abs() > level { tau.signum() } else { 0.0 }
    };
    let mut out = vec![0.0; q.len()];
    for run in &motion.runs {
        // Where it was pressed last, and how far aside.
        let mut last: Option<(usize, f64)> = None;
        let mut begin = run.start;
        for stretch in tau[run.clone()].chunk_by(|a, b| side(*a) == side(*b)) {
            let pressed = begin..begin + stretch.len();
            begin = pressed.end;
            let side = side(stretch[0]);
            if side == 0.0 || stretch.len() < shortest {
                continue;
            }
            for i in pressed.clone() {
                out[i] = behind[i] - 0.5 * gap * side;
            }
            let (i, aside) = (pressed.start, out[pressed.start]);
            if let Some((from, left)) = last {
                let steps = (i - from) as f64;
                let speed = motion.dq[from] * motion.period;
                let slowed = (q[i] + aside - q[from] - left) / steps - speed;
                // Without an effort it is nowhere but in the play, and no farther than the pads hold it.
                let most = left.abs().max(aside.abs());
                for (step, k) in (1..).zip(from + 1..i) {
                    let step = f64::from(step);
                    let way = step * (speed + slowed * step / steps);
                    out[k] = (q[from] + left + way - q[k]).clamp(-most, most);
                }
            } else {
                out[run.start..i].fill(aside);
            }
            last = Some((pressed.end - 1, out[pressed.end - 1]));
        }
        if let Some((from, left)) = last {
            out[from..run.end].fill(left);
        }
    }
    out
}

/// The object is pressed where the effort is so many standard deviations of its noise,
const PRESSED: f64 = 5.0;
/// for so long at least, s: before and after a blow the effort rings in the filter that takes it to the work rate.
const SHORTEST_S: f64 = 0.015;

#[cfg(test)]
mod tests {
    use super::retarded;

    /// Of a wave the Kelvin-Voigt solid shows 1 / (1 + i w T).
    #[test]
    fn pads_give_as_much_less_and_later_as_they_damp() {
        let (period, retardation, w) = (1e-3, 0.02, 40.0);
        let phase = |i: usize| w * period * i as f64;
        let tau: Vec<f64> = (0..4000).map(|i| phase(i).sin()).collect();
        let [less, later] = [(w * retardation).hypot(1.0), (w * retardation).atan()];
        let given = retarded(&tau, period / retardation).enumerate();
        for (i, x) in given.skip(500) {
            let wanted = (phase(i) - later).sin() / less;
            assert!((x - wanted).abs() < 2e-4, "{i}: {x} {wanted}");
        }
        // None to speak of: as the effort itself.
        let at_once = retarded(&tau, 1e3).zip(&tau);
        assert!(at_once.into_iter().all(|(x, tau)| (x - tau).abs() < 1e-3));
    }
}
