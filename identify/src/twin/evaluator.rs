//! Effort of a twin at a state, term by term, for controllers and simulators, and at many states at once.

use pulp::{Arch, NullaryFnOnce};

use super::pieces::{BLOCK, Pieces};
use super::{Coordinate, Twin};
use crate::effect::library::{AtState, kind};
use crate::mechanism::Domain;
use crate::screw::JointKind;

/// A speed so small that every term has its value at the start of a motion, in rad/s or m/s.
const CREEP: f64 = 1e-9;

/// What the effort at a state is made of, N m or N, in the twin's coordinate. Efforts are the tool's: what resists a
/// motion has the motion's sign.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// `I ddq`.
    pub inertia: f64,
    /// `mu sgn(dq)`.
    pub coulomb: f64,
    /// `b dq`.
    pub viscous: f64,
    /// The constant load and the effects that the analysis named.
    pub effects: f64,
    /// `g(q) + c(q, |dq|) dq`.
    pub mechanism: f64,
}

impl Terms {
    /// Their sum.
    #[must_use]
    pub fn total(&self) -> f64 {
        self.inertia + self.coulomb + self.viscous + self.effects + self.mechanism
    }
}

/// A state that was not probed. What the twin says there means nothing: its curves are held at their edges, damping as that at
/// the edge of speed, and named effects go on by their law.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outside {
    /// The coordinate is outside.
    Coordinate,
    /// The velocity is outside.
    Velocity,
}

/// A twin made ready for evaluation. Parameters that were not identified count as 0.
#[derive(Clone, Debug)]
pub struct Evaluator {
    kind: JointKind,
    coordinate: Coordinate,
    domain: Domain,
    inertia: f64,
    coulomb: f64,
    viscous: f64,
    load: f64,
    effects: Vec<Effect>,
    mechanism: Option<Pieces>,
}

/// One quantity of many states.
#[derive(Clone, Copy, Debug)]
pub enum Each<'a> {
    /// The same in all.
    Same(f64),
    /// One number for each.
    Own(&'a [f64]),
}

/// Arrays of states that are not of one length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` has {got} states, the efforts have {expected}: give as many, or one number")]
pub struct LengthError {
    /// `q`, `dq` or `ddq`.
    pub name: &'static str,
    /// Length of the array for the efforts.
    pub expected: usize,
    /// Length of the array.
    pub got: usize,
}

#[derive(Clone, Debug)]
struct Effect {
    at: AtState,
    shape: Vec<f64>,
    terms: [f64; 2],
}

impl Evaluator {
    /// Of a twin.
    #[must_use]
    pub fn new(twin: &Twin) -> Self {
        let value = |wanted: &str| {
            let found = twin.beta.names.iter().position(|name| name == wanted);
            found
                .and_then(|at| twin.beta.values.get(at).copied().flatten())
                .unwrap_or(0.0)
        };
        let effects = twin
            .effects
            .iter()
            .filter_map(|effect| {
                let kind = kind(&effect.name)?;
                let term = |name: &str| {
                    let found = effect.terms.iter().find(|term| term.name == name);
                    found.map_or(0.0, |term| term.value)
                };
                Some(Effect {
                    at: kind.at?,
                    shape: effect.shape.iter().map(|number| number.value).collect(),
                    terms: [0, 1].map(|i| kind.terms.get(i).map_or(0.0, |of| term(of.0))),
                })
            })
            .collect();
        Self {
            kind: twin.joint.kind,
            coordinate: twin.joint.coordinate,
            domain: twin.domain.clone(),
            inertia: value("inertia"),
            coulomb: value("coulomb"),
            viscous: value("viscous"),
            load: value("load"),
            effects,
            mechanism: twin.mechanism.as_ref().map(Pieces::of),
        }
    }

    /// The terms of the effort at a state of the twin's coordinate: `q` rad or m, `dq` and `ddq` per second (squared).
    #[must_use]
    pub fn terms(&self, q: f64, dq: f64, ddq: f64) -> Terms {
        let Coordinate { sign, offset } = self.coordinate;
        let (q, dq, ddq) = (sign * (q - offset), sign * dq, sign * ddq);
        let sgn = if dq == 0.0 { 0.0 } else { dq.signum() };
        let named: f64 = self.effects.iter().map(|effect| effect.effort(q, dq)).sum();
        let mechanism = self.mechanism.as_ref();
        let mechanism = mechanism.map_or(0.0, |pieces| pieces.effort(q, dq));
        Terms {
            inertia: sign * self.inertia * ddq,
            coulomb: sign * self.coulomb * sgn,
            viscous: sign * self.viscous * dq,
            effects: sign * (self.load + named),
            mechanism: sign * mechanism,
        }
    }

    /// Effort that the tool must apply at a state of the twin's coordinate.
    #[must_use]
    pub fn effort(&self, q: f64, dq: f64, ddq: f64) -> f64 {
        self.terms(q, dq, ddq).total()
    }

    /// Writes the efforts at as many states as `out` has room for, as [`Self::effort`] gives them one by one, in vectors and without
    /// allocation. The states may be cut and given to several threads.
    ///
    /// # Errors
    /// [`LengthError`]: an array is longer or shorter than `out`, which is left as it was.
    pub fn efforts<'a>(
        &self,
        q: impl Into<Each<'a>>,
        dq: impl Into<Each<'a>>,
        ddq: impl Into<Each<'a>>,
        out: &mut [f64],
    ) -> Result<(), LengthError> {
        let states = [q.into(), dq.into(), ddq.into()];
        for (each, name) in states.into_iter().zip(["q", "dq", "ddq"]) {
            if let Some(got) = each.len().filter(|got| *got != out.len()) {
                let expected = out.len();
                return Err(LengthError {
                    name,
                    expected,
                    got,
                });
            }
        }
        Arch::new().dispatch(Batch {
            evaluator: self,
            states,
            out,
        });
        Ok(())
    }

    #[inline(always)]
    fn block(&self, [q, dq, ddq]: [&[f64; BLOCK]; 3], out: &mut [f64; BLOCK]) {
        let Coordinate { sign, offset } = self.coordinate;
        let (mut at, mut rate) = ([0.0; BLOCK], [0.0; BLOCK]);
        for k in 0..BLOCK {
            at[k] = sign * (q[k] - offset);
            rate[k] = sign * dq[k];
            let dry = if rate[k] == 0.0 {
                0.0
            } else {
                self.coulomb.copysign(rate[k])
            };
            out[k] = self.inertia * sign * ddq[k] + dry + self.viscous * rate[k] + self.load;
        }
        if let Some(pieces) = &self.mechanism {
            pieces.add(&at, &rate, out);
        }
        for effect in &self.effects {
            for k in 0..BLOCK {
                out[k] += effect.effort(at[k], rate[k]);
            }
        }
        for effort in out {
            *effort *= sign;
        }
    }

    /// Efforts between which the joint rests at `q`: below the first it begins to move backward, above the second forward.
    #[must_use]
    pub fn rest_band(&self, q: f64) -> [f64; 2] {
        let (backward, forward) = (self.effort(q, -CREEP, 0.0), self.effort(q, CREEP, 0.0));
        [backward.min(forward), backward.max(forward)]
    }

    /// Derivative of the effort by (q, dq, ddq), with the direction of motion held, at rest forward; dry friction has none. Exact but for
    /// named effects: theirs are central differences over a thousandth of the domain, one-sided in dq near rest.
    #[must_use]
    pub fn gradient(&self, q: f64, dq: f64) -> [f64; 3] {
        let Coordinate { sign, offset } = self.coordinate;
        let (at, rate) = (sign * (q - offset), sign * dq);
        // Forward in the twin's own coordinate.
        let rate = if rate == 0.0 { sign * CREEP } else { rate };
        let mechanism = self.mechanism.as_ref();
        let [by_q, by_dq] = mechanism.map_or([0.0; 2], |pieces| pieces.gradient(at, rate));
        let [named_q, named_dq] = self.named_gradient(at, rate);
        // Effort and coordinate turn their signs together.
        [
            by_q + named_q,
            self.viscous + by_dq + named_dq,
            self.inertia,
        ]
    }

    /// Of the named effects, by the recording's coordinate and rate.
    fn named_gradient(&self, q: f64, dq: f64) -> [f64; 2] {
        if self.effects.is_empty() {
            return [0.0; 2];
        }
        let named = |q: f64, dq: f64| -> f64 {
            self.effects.iter().map(|effect| effect.effort(q, dq)).sum()
        };
        let span = |[low, high]: [f64; 2]| (1e-3 * (high - low)).max(1e-6);
        let (step_q, step_dq) = (span(self.domain.q), span(self.domain.dq));
        let moving = |at: f64| {
            if at * dq > 0.0 {
                at
            } else {
                CREEP.copysign(dq)
            }
        };
        let (low, high) = (moving(dq - step_dq), moving(dq + step_dq));
        [
            (named(q + step_q, dq) - named(q - step_q, dq)) / (2.0 * step_q),
            (named(q, high) - named(q, low)) / (high - low),
        ]
    }

    /// What of the state lies outside the probed domain, if anything.
    #[must_use]
    pub fn outside(&self, q: f64, dq: f64) -> Option<Outside> {
        // What is no number was not probed either.
        let beyond = |value: f64, [low, high]: [f64; 2]| !(low..=high).contains(&value);
        if beyond(q, self.domain.q) {
            Some(Outside::Coordinate)
        } else if beyond(dq, self.domain.dq) {
            Some(Outside::Velocity)
        } else {
            None
        }
    }

    /// Root mean square difference of the passive efforts (`ddq` = 0) of two twins over the domain that both have probed, over
    /// that of `other`; nothing when there is none.
    #[must_use]
    pub fn difference(&self, other: &Self) -> Option<f64> {
        const NODES: usize = 40;
        let common = |a: [f64; 2], b: [f64; 2]| {
            Some([a[0].max(b[0]), a[1].min(b[1])]).filter(|[low, high]| low < high)
        };
        let q = common(self.domain.q, other.domain.q)?;
        let dq = common(self.domain.dq, other.domain.dq)?;
        let node =
            |i: usize, [low, high]: [f64; 2]| low + (i as f64 + 0.5) / NODES as f64 * (high - low);
        let (mut left, mut all) = (0.0, 0.0);
        for i in 0..NODES {
            for j in 0..NODES {
                let (q, dq) = (node(i, q), node(j, dq));
                let effort = other.effort(q, dq, 0.0);
                left += (self.effort(q, dq, 0.0) - effort).powi(2);
                all += effort * effort;
            }
        }
        Some((left / f64::max(all, f64::MIN_POSITIVE)).sqrt())
    }

    /// Highest speed that was probed in either direction, at least 0.001 rad/s or m/s.
    #[must_use]
    pub fn fastest(&self) -> f64 {
        self.domain.dq.iter().fold(1e-3, |all, v| all.max(v.abs()))
    }

    /// What kind of joint it is.
    #[must_use]
    pub fn kind(&self) -> JointKind {
        self.kind
    }

    /// Inertia, kg m^2 or kg; 0 when it was not identified.
    #[must_use]
    pub fn inertia(&self) -> f64 {
        self.inertia
    }

    /// Where the twin was probed, in its own coordinate.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.domain
    }
}

impl Effect {
    fn effort(&self, q: f64, dq: f64) -> f64 {
        let per_term = (self.at)(&self.shape, q, dq);
        self.terms[0] * per_term[0] + self.terms[1] * per_term[1]
    }
}

impl Each<'_> {
    fn len(&self) -> Option<usize> {
        match self {
            Self::Same(_) => None,
            Self::Own(values) => Some(values.len()),
        }
    }

    /// The block from `from` on; where the states end within it, their copy in `scratch`, zeros behind it.
    #[inline(always)]
    fn block<'b>(&'b self, from: usize, scratch: &'b mut [f64; BLOCK]) -> &'b [f64; BLOCK] {
        let values = match self {
            Self::Same(value) => {
                *scratch = [*value; BLOCK];
                return scratch;
            }
            Self::Own(values) => values.get(from..).unwrap_or_default(),
        };
        if let Some(whole) = values.first_chunk() {
            return whole;
        }
        *scratch = [0.0; BLOCK];
        for (copy, value) in scratch.iter_mut().zip(values) {
            *copy = *value;
        }
        scratch
    }
}

impl From<f64> for Each<'_> {
    fn from(value: f64) -> Self {
        Self::Same(value)
    }
}

impl<'a> From<&'a [f64]> for Each<'a> {
    fn from(values: &'a [f64]) -> Self {
        Self::Own(values)
    }
}

impl<'a> From<&'a Vec<f64>> for Each<'a> {
    fn from(values: &'a Vec<f64>) -> Self {
        Self::Own(values)
    }
}

/// [`Evaluator::efforts`] as a function that is compiled for what the processor has.
struct Batch<'a> {
    evaluator: &'a Evaluator,
    states: [Each<'a>; 3],
    out: &'a mut [f64],
}

impl NullaryFnOnce for Batch<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self {
            evaluator,
            states: [q, dq, ddq],
            out,
        } = self;
        let [mut a, mut b, mut c, mut rest] = [[0.0; BLOCK]; 4];
        for (i, out) in out.chunks_mut(BLOCK).enumerate() {
            let from = i * BLOCK;
            let states = [
                q.block(from, &mut a),
                dq.block(from, &mut b),
                ddq.block(from, &mut c),
            ];
            match out.first_chunk_mut() {
                Some(whole) => evaluator.block(states, whole),
                None => {
                    evaluator.block(states, &mut rest);
                    for (effort, last) in out.iter_mut().zip(rest) {
                        *effort = last;
                    }
                }
            }
        }
    }
}
