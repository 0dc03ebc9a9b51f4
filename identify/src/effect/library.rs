//! The library of effects that a model may lack: what each adds to the effort, on a prepared motion.
//!
//! A [`Kind`] gives regressors for a set of shape parameters (where a detent sits, how long a bristle is). The shapes start
//! on a coarse grid and are refined by nonlinear least squares; the terms are linear. Efforts are applied by the tool, so
//! what resists the motion has a positive term. Every regressor goes through the effort's filter.

use crate::least_squares::Bound;
use crate::motion::Motion;
use crate::products::in_vectors;
use crate::samples::extrema;
use crate::screw::JointKind;

use super::{axis, damping, friction, load, measurement, memory, slip};

/// Whether an effect is a property of the object, or of one recording (its constants are then fitted anew).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Belongs {
    /// To the object: must be there, and equal, in every recording of it.
    Object,
    /// To the recording: sensor, timing, grasp, temperature, load.
    Recording,
}

/// A variable against which an effect or a residual shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Variable {
    /// Coordinate.
    Q,
    /// Velocity.
    Dq,
    /// Acceleration.
    Ddq,
    /// Sign of the velocity.
    Sign,
    /// Time.
    Time,
    /// Way gone since the last reversal.
    SinceReversal,
    /// Force on the object that does no work.
    OffAxis,
}

impl Variable {
    /// As a sentence has it.
    #[must_use]
    pub const fn in_words(self) -> &'static str {
        match self {
            Self::Q => "q",
            Self::Dq => "dq",
            Self::Ddq => "ddq",
            Self::Sign => "sign",
            Self::Time => "time",
            Self::SinceReversal => "the way since a reversal",
            Self::OffAxis => "the off-axis force",
        }
    }
}

/// What a number is measured in, by kind of joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// N m or N.
    Effort,
    /// N m/rad or N/m.
    Stiffness,
    /// N m s/rad or N s/m.
    Viscous,
    /// N m s^2/rad^2 or N s^2/m^2.
    Drag,
    /// kg m^2 or kg.
    Inertia,
    /// Effort per second.
    EffortRate,
    /// rad or m.
    Position,
    /// rad/s or m/s.
    Speed,
    /// s.
    Time,
    /// kg.
    Mass,
    /// N.
    Force,
    /// m.
    Length,
    /// rad/(N m) or m/N.
    Compliance,
    /// No unit.
    One,
}

impl Unit {
    /// The unit's text.
    #[must_use]
    pub fn text(self, kind: JointKind) -> String {
        let turning = kind == JointKind::Revolute;
        let pick = |a: &str, b: &str| if turning { a } else { b }.to_owned();
        match self {
            Self::Effort => kind.effort_unit().to_owned(),
            Self::Stiffness => pick("N m/rad", "N/m"),
            Self::Viscous => kind.viscous_unit().to_owned(),
            Self::Drag => pick("N m s^2/rad^2", "N s^2/m^2"),
            Self::Inertia => kind.inertia_unit().to_owned(),
            Self::EffortRate => pick("N m/s", "N/s"),
            Self::Position => kind.position_unit().to_owned(),
            Self::Speed => pick("rad/s", "m/s"),
            Self::Time => "s".to_owned(),
            Self::Mass => "kg".to_owned(),
            Self::Force => "N".to_owned(),
            Self::Length => "m".to_owned(),
            Self::Compliance => pick("rad/(N m)", "m/N"),
            Self::One => "1".to_owned(),
        }
    }
}

/// How a shape parameter is refined from its value on the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Search {
    /// Not at all: a choice.
    Fixed,
    /// One of two forms, 0 or 1: the other one is tried after each effect.
    Form,
    /// Within so much of the coordinate's range, either way.
    Way(f64),
    /// Within this factor, either way.
    Factor(f64),
    /// Within so many seconds, either way.
    Seconds(f64),
    /// Anywhere below the greatest speed, down to an eighth: what opens sooner is no valve but friction.
    Below,
    /// Between these shares of the coordinate's range.
    Between(f64, f64),
    /// Between so many seconds.
    Lasting(f64, f64),
    /// Between a few strokes and several times the recording: a shorter one is a jolt of the first stroke.
    Drift,
    /// As many times as large as the effect's one term says, until that is near 1: alone either does as well.
    ByShare,
}

/// How long a drift takes at least, where the recording is short, and at most, as shares of the recording.
pub(crate) const SHORTEST_DRIFT: f64 = 0.07;
pub(crate) const LONGEST_DRIFT: f64 = 10.0;

/// A shape parameter: name, unit, refinement.
pub type Shape = (&'static str, Unit, Search);
/// A linear term: name, unit, sign.
pub type TermOf = (&'static str, Unit, Bound);

/// Regressors from shape, q and dq; the second is 0 where a kind has one term.
pub type AtState = fn(&[f64], f64, f64) -> [f64; 2];

/// One effect of the library.
#[derive(Clone, Copy)]
pub struct Kind {
    /// Name from the project's vocabulary.
    pub name: &'static str,
    /// Object or recording.
    pub belongs: Belongs,
    /// What it adds to the effort, by the names of its terms and shape parameters, for those who read a report.
    pub equation: &'static str,
    /// Linear terms, one per regressor.
    pub terms: &'static [TermOf],
    /// Shape parameters.
    pub shape: &'static [Shape],
    /// Where its evidence shows.
    pub variable: Variable,
    /// Shapes to begin with; none when the effect cannot be or cannot be seen here.
    pub grid: fn(&Scope<'_>) -> Vec<Vec<f64>>,
    /// Regressors at the work rate, before the filter.
    pub series: fn(&Scope<'_>, &[f64]) -> Vec<Vec<f64>>,
    /// Regressors at a state (shape, q, dq), for twins and for an object elsewhere than the tool; nothing for effects with memory and of the
    /// measurement.
    pub at: Option<AtState>,
    /// What would tell it from those that look alike.
    pub separate: &'static str,
}

impl core::fmt::Debug for Kind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Kind({})", self.name)
    }
}

impl Kind {
    /// Whether it is that kind, in that form. By what it says: a constant has no one address, and which uses of it share one is the
    /// compiler's choice.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        self.name == other.name && self.shape.len() == other.shape.len()
    }

    /// Number of free numbers: terms, and shapes that are refined.
    #[must_use]
    pub fn freedom(&self) -> usize {
        let chosen = |s: &&Shape| matches!(s.2, Search::Fixed | Search::Form | Search::ByShare);
        self.terms.len() + self.shape.len() - self.shape.iter().filter(chosen).count()
    }

    /// The same when some terms are left out; a relief that no term asks for is none.
    #[must_use]
    pub fn freedom_of(&self, used: &[bool]) -> usize {
        let unused = used.iter().filter(|used| !**used).count();
        let reliefs = self.shape.iter().filter(|s| s.2 == Search::Below).count();
        self.freedom() - unused - if unused > 0 { reliefs } else { 0 }
    }
}

/// The object as far as it is known, for effects that act through it.
#[derive(Clone, Debug, Default)]
pub struct Object {
    /// Inertia, Coulomb and viscous friction.
    pub rigid: [f64; 3],
    /// Its effects that are functions of the state.
    pub effects: Vec<OfState>,
}

/// An effect that is a function of the state, with its numbers.
#[derive(Clone, Debug)]
pub struct OfState {
    /// Regressors from shape, q and dq.
    pub at: AtState,
    /// Shape parameters.
    pub shape: Vec<f64>,
    /// Factors of the regressors, 0 for those that are not used.
    pub theta: [f64; 2],
}

impl OfState {
    fn effort(&self, q: f64, dq: f64) -> f64 {
        let [first, second] = (self.at)(&self.shape, q, dq);
        self.theta[0] * first + self.theta[1] * second
    }
}

/// A motion as the library sees it.
#[derive(Clone, Copy, Debug)]
pub struct Scope<'a> {
    /// The motion.
    pub motion: &'a Motion,
    /// The object as far as it is known.
    pub object: &'a Object,
    /// Smallest and largest coordinate.
    pub q: [f64; 2],
    /// What the coordinate of this recording lacks to that in which shapes were found.
    pub datum: f64,
}

impl<'a> Scope<'a> {
    /// The scope of a motion.
    #[must_use]
    pub fn of(motion: &'a Motion, object: &'a Object) -> Self {
        let (low, high) = extrema(&motion.q);
        Self {
            motion,
            object,
            q: [low, high],
            datum: 0.0,
        }
    }

    /// Range of the coordinate.
    #[must_use]
    pub fn range(&self) -> f64 {
        (self.q[1] - self.q[0]).max(1e-9)
    }

    /// Greatest speed, either way.
    #[must_use]
    pub fn fastest(&self) -> f64 {
        let (slowest, fastest) = extrema(&self.motion.dq);
        fastest.max(-slowest).max(1e-9)
    }

    /// Duration, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        let (low, high) = extrema(&self.motion.time);
        high - low
    }

    /// What it changes of the effort that the object, as far as it is known, is `aside` of the tool.
    pub(super) fn moved_object(&self, aside: &[f64]) -> Vec<f64> {
        let motion = self.motion;
        let [inertia, coulomb, viscous] = self.object.rigid;
        let (dq, ddq) = (motion.derivative(aside), motion.second_derivative(aside));
        (0..aside.len())
            .map(|i| {
                let sign = (motion.turning[i] + dq[i]).signum();
                let (q, here, there) =
                    (motion.q[i] + self.datum, motion.dq[i], motion.dq[i] + dq[i]);
                let (here, there) = (here.abs() * motion.sign[i], there.abs() * sign);
                let of_state = self.object.effects.iter();
                let of_state: f64 = of_state
                    .map(|effect| effect.effort(q + aside[i], there) - effect.effort(q, here))
                    .sum();
                inertia * ddq[i] + coulomb * (sign - motion.sign[i]) + viscous * dq[i] + of_state
            })
            .collect()
    }

    /// Two regressors from the state alone.
    pub(super) fn both_by_state(
        &self,
        f: impl Fn(f64, f64, f64) -> [f64; 2],
    ) -> (Vec<f64>, Vec<f64>) {
        let motion = self.motion;
        let mut out = (vec![0.0; motion.q.len()], vec![0.0; motion.q.len()]);
        in_vectors(
            #[inline(always)]
            || {
                let states = motion.q.iter().zip(&motion.dq).zip(&motion.sign);
                for (((q, dq), sign), both) in states.zip(out.0.iter_mut().zip(&mut out.1)) {
                    [*both.0, *both.1] = f(q + self.datum, *dq, *sign);
                }
            },
        );
        out
    }

    /// A regressor from the state alone.
    pub(super) fn by_state(&self, f: impl Fn(f64, f64, f64) -> f64) -> Vec<f64> {
        let motion = self.motion;
        let states = motion.q.iter().zip(&motion.dq).zip(&motion.sign);
        states
            .map(|((q, dq), sign)| f(q + self.datum, *dq, *sign))
            .collect()
    }
}

/// All effects, simple ones before those that contain them.
pub const LIBRARY: [&Kind; 26] = [
    &load::CONSTANT_LOAD,
    &load::SPRING,
    &load::STRUT,
    &load::GRAVITY,
    &load::DETENT,
    &load::CATCH,
    &load::RIPPLE,
    &damping::ZONE,
    &damping::ASYMMETRIC,
    &damping::QUADRATIC,
    &friction::ASYMMETRIC,
    &friction::STRIBECK,
    &friction::STRIBECK_FADING,
    &friction::STICTION,
    &friction::POSITION_DEPENDENT,
    &friction::AT_A_PLACE,
    &friction::DRIFT,
    &memory::PRESLIDING,
    &memory::BACKLASH,
    &measurement::TIME_LAG,
    &measurement::PAYLOAD_SWITCH,
    &measurement::SENSOR_DRIFT,
    &measurement::GRASP_COMPLIANCE,
    &measurement::TOOL_MASS,
    &axis::AXIS_OFFSET,
    &slip::SLIP,
];

/// The effect of that name; of several forms the simplest.
#[must_use]
pub fn kind(name: &str) -> Option<&'static Kind> {
    LIBRARY.into_iter().find(|kind| kind.name == name)
}

/// The form of the effect of that name which has so many shape parameters.
#[must_use]
pub fn form(name: &str, shapes: usize) -> Option<&'static Kind> {
    let fits = |kind: &&Kind| kind.name == name && kind.shape.len() == shapes;
    LIBRARY.into_iter().find(fits)
}

/// Values from `low` to `high` in equal steps or, with [`geometric`], in equal factors.
pub(super) fn even(low: f64, high: f64, count: usize) -> Vec<f64> {
    (0..count)
        .map(|i| low + (high - low) * i as f64 / (count.max(2) - 1) as f64)
        .collect()
}

/// Values in equal factors.
pub(super) fn geometric(low: f64, high: f64, count: usize) -> Vec<f64> {
    even(low.ln(), high.ln(), count)
        .into_iter()
        .map(f64::exp)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::LIBRARY;

    #[test]
    fn every_effect_is_described_for_those_who_read_its_name() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/diagnosis.md");
        let text = std::fs::read_to_string(path).unwrap();
        for kind in LIBRARY {
            let row = format!("\n| `{}` | ", kind.name);
            assert_eq!(text.matches(&row).count(), 1, "{}", kind.name);
        }
    }
}
