//! Effort of a twin at a state, term by term, for controllers and simulators.

use super::pieces::Pieces;
use super::rows::{Rest, Rows};
use super::{Coordinate, Twin};
use crate::effect::library::{AtState, form};
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

/// Named effects keep to their laws up to this many times the fastest probed speed, and go on straight beyond; exported tables
/// end there, and go on straight too.
pub(crate) const BEYOND: f64 = 2.0;
/// Where the line begins that goes on: an exported table's last node but one, over the last.
const LAST_BUT_ONE: f64 = (63.0 / 64.0) * (63.0 / 64.0);

/// A state that was not probed. What the twin says there means nothing: its curves are held at their edges, damping as that at
/// the edge of speed; named effects keep to their laws, beyond twice the fastest probed speed they go on straight.
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
    range: [f64; 2],
    rest: Rest,
    effects: Vec<Effect>,
    mechanism: Option<Pieces>,
    rows: Option<Rows>,
}

#[derive(Clone, Debug)]
struct Effect {
    law: AtState,
    fastest: f64,
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
                let kind = form(&effect.name, effect.shape.len())?;
                let term = |name: &str| {
                    let found = effect.terms.iter().find(|term| term.name == name);
                    found.map_or(0.0, |term| term.value)
                };
                Some(Effect {
                    law: kind.at?,
                    fastest: BEYOND * fastest(&twin.domain),
                    shape: effect.shape.iter().map(|number| number.value).collect(),
                    terms: [0, 1].map(|i| kind.terms.get(i).map_or(0.0, |of| term(of.0))),
                })
            })
            .collect();
        let mechanism = twin.mechanism.as_ref().map(Pieces::of);
        let rest = Rest {
            inertia: value("inertia"),
            coulomb: value("coulomb"),
            viscous: value("viscous"),
            load: value("load"),
        };
        Self {
            rows: Rows::of(mechanism.as_ref(), rest, twin.joint.coordinate),
            kind: twin.joint.kind,
            coordinate: twin.joint.coordinate,
            domain: twin.domain.clone(),
            range: twin.joint.q_range,
            rest,
            effects,
            mechanism,
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
            inertia: sign * self.rest.inertia * ddq,
            coulomb: sign * self.rest.coulomb * sgn,
            viscous: sign * self.rest.viscous * dq,
            effects: sign * (self.rest.load + named),
            mechanism: sign * mechanism,
        }
    }

    /// Effort that the tool must apply at a state of the twin's coordinate.
    #[must_use]
    pub fn effort(&self, q: f64, dq: f64, ddq: f64) -> f64 {
        self.terms(q, dq, ddq).total()
    }

    /// The table for many states at once, when there is one.
    pub(super) fn rows(&self) -> Option<&Rows> {
        self.rows.as_ref()
    }

    /// Adds the efforts of named effects, which no table has.
    pub(super) fn add_named(&self, q: &[f64], dq: &[f64], out: &mut [f64]) {
        let Coordinate { sign, offset } = self.coordinate;
        for effect in &self.effects {
            for ((out, q), dq) in out.iter_mut().zip(q).zip(dq) {
                *out += sign * effect.effort(sign * (q - offset), sign * dq);
            }
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
            self.rest.viscous + by_dq + named_dq,
            self.rest.inertia,
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
        fastest(&self.domain)
    }

    /// What kind of joint it is.
    #[must_use]
    pub fn kind(&self) -> JointKind {
        self.kind
    }

    /// Inertia, kg m^2 or kg; 0 when it was not identified.
    #[must_use]
    pub fn inertia(&self) -> f64 {
        self.rest.inertia
    }

    /// Range of the joint as far as it is known, rad or m, in the twin's coordinate.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// Where the twin was probed, in its own coordinate.
    #[must_use]
    pub fn domain(&self) -> &Domain {
        &self.domain
    }
}

impl Effect {
    fn effort(&self, q: f64, dq: f64) -> f64 {
        let within = dq.clamp(-self.fastest, self.fastest);
        let effort = self.by_law(q, within);
        if within == dq {
            return effort;
        }
        let before = self.by_law(q, LAST_BUT_ONE * within);
        effort + (effort - before) * (dq / within - 1.0) / (1.0 - LAST_BUT_ONE)
    }

    fn by_law(&self, q: f64, dq: f64) -> f64 {
        let per_term = (self.law)(&self.shape, q, dq);
        self.terms[0] * per_term[0] + self.terms[1] * per_term[1]
    }
}

/// Highest speed that was probed in either direction, at least 0.001 rad/s or m/s.
fn fastest(domain: &Domain) -> f64 {
    domain.dq.iter().fold(1e-3, |all, v| all.max(v.abs()))
}
