//! Effort of a twin at a state, term by term, for controllers and simulators.

use super::{Coordinate, Spline, SurfaceSpline, Twin};
use crate::effect::library::{AtState, kind};
use crate::mechanism::{Domain, Valve};
use crate::screw::JointKind;
use crate::spline::Basis;

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

/// A state that was not probed: what the twin says there is its value at the edge, and means nothing.
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
    mechanism: Option<(Curve, [Surface; 2])>,
}

#[derive(Clone, Debug)]
struct Effect {
    at: AtState,
    shape: Vec<f64>,
    terms: Vec<f64>,
}

#[derive(Clone, Debug)]
struct Curve {
    basis: Basis,
    coefficients: Vec<f64>,
}

#[derive(Clone, Debug)]
struct Surface {
    in_q: Basis,
    in_root_speed: Basis,
    coefficients: Vec<f64>,
    valve: Valve,
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
                    terms: kind.terms.iter().map(|of| term(of.0)).collect(),
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
            mechanism: twin.mechanism.as_ref().map(|mechanism| {
                (
                    Curve::of(&mechanism.load),
                    mechanism.damping.each_ref().map(Surface::of),
                )
            }),
        }
    }

    /// The terms of the effort at a state of the twin's coordinate: `q` rad or m, `dq` and `ddq` per second (squared).
    #[must_use]
    pub fn terms(&self, q: f64, dq: f64, ddq: f64) -> Terms {
        let Coordinate { sign, offset } = self.coordinate;
        let (q, dq, ddq) = (sign * (q - offset), sign * dq, sign * ddq);
        let sgn = if dq == 0.0 { 0.0 } else { dq.signum() };
        let named: f64 = self.effects.iter().map(|effect| effect.effort(q, dq)).sum();
        let mechanism = self.mechanism.as_ref().map_or(0.0, |(load, damping)| {
            load.value(q) + damping[usize::from(dq < 0.0)].effort(q, dq)
        });
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

    /// Efforts between which the joint rests at `q`: below the first it begins to move backward, above the second forward.
    #[must_use]
    pub fn rest_band(&self, q: f64) -> [f64; 2] {
        let (backward, forward) = (self.effort(q, -CREEP, 0.0), self.effort(q, CREEP, 0.0));
        [backward.min(forward), backward.max(forward)]
    }

    /// Derivative of the effort by (q, dq, ddq), with the direction of motion held: central differences over a thousandth
    /// of the domain, one-sided in dq near rest. Exact in ddq and in `b`; dry friction has none.
    #[must_use]
    pub fn gradient(&self, q: f64, dq: f64) -> [f64; 3] {
        let span = |[low, high]: [f64; 2]| (1e-3 * (high - low)).max(1e-6);
        let (step_q, step_dq) = (span(self.domain.q), span(self.domain.dq));
        let by_q =
            (self.effort(q + step_q, dq, 0.0) - self.effort(q - step_q, dq, 0.0)) / (2.0 * step_q);
        let moving = |dq: f64, side: f64| if dq * side > 0.0 { dq } else { side * CREEP };
        let side = if dq < 0.0 { -1.0 } else { 1.0 };
        let (low, high) = (moving(dq - step_dq, side), moving(dq + step_dq, side));
        let by_dq = (self.effort(q, high, 0.0) - self.effort(q, low, 0.0)) / (high - low);
        [by_q, by_dq, self.inertia]
    }

    /// What of the state lies outside the probed domain, if anything.
    #[must_use]
    pub fn outside(&self, q: f64, dq: f64) -> Option<Outside> {
        let beyond = |value: f64, [low, high]: [f64; 2]| value < low || value > high;
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
        self.terms.iter().zip(per_term).map(|(a, b)| a * b).sum()
    }
}

impl Curve {
    fn of(spline: &Spline) -> Self {
        let [low, high] = spline.interval;
        Self {
            basis: Basis::new(low, high, spline.pieces, spline.degree),
            coefficients: spline.coefficients.clone(),
        }
    }

    fn value(&self, q: f64) -> f64 {
        self.basis.value(&self.coefficients, q)
    }
}

impl Surface {
    fn of(spline: &SurfaceSpline) -> Self {
        let basis = |[low, high]: [f64; 2], i: usize| {
            Basis::new(low, high, spline.pieces[i], spline.degree[i])
        };
        Self {
            in_q: basis(spline.interval_q, 0),
            in_root_speed: basis(spline.interval_sqrt_speed, 1),
            coefficients: spline.coefficients.clone(),
            valve: spline.valve.clone(),
        }
    }

    fn effort(&self, q: f64, dq: f64) -> f64 {
        let speed = dq.abs();
        let size = self.valve.effort(self.value(q, speed.sqrt()) * speed);
        if dq < 0.0 { -size } else { size }
    }

    fn value(&self, q: f64, root_speed: f64) -> f64 {
        let (first_q, in_q) = self.in_q.evaluate(q);
        let (first_speed, in_speed) = self.in_root_speed.evaluate(root_speed);
        let row = self.in_root_speed.len();
        let mut sum = 0.0;
        for (i, value_q) in in_q.iter().take(self.in_q.degree() + 1).enumerate() {
            let from = (first_q + i) * row + first_speed;
            for (j, value_speed) in in_speed
                .iter()
                .take(self.in_root_speed.degree() + 1)
                .enumerate()
            {
                sum +=
                    self.coefficients.get(from + j).copied().unwrap_or(0.0) * value_q * value_speed;
            }
        }
        sum
    }
}
