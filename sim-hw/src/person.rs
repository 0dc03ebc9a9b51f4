//! The person: holds the tool in free air, grasps the object and drags it along the probing protocol with a springy hand.
//!
//! The hand is a spring and a damper to where the person wants the handle, plus the push that the person has learned the
//! object needs, plus tremor; never more than the person's strength. Following, the hand yields and lets the object go.

pub(crate) mod contact;
pub(crate) mod free_air;
pub(crate) mod plan;

use std::collections::VecDeque;

use crate::motion::{Jet, Quintic};
use crate::person::plan::Segment;
use crate::random::{Random, Wave};
use crate::scenario::PersonSpec;
use crate::world::{Drive, JointState};

/// Time over which the hand stiffens or yields, s.
const BLEND_S: f64 = 0.4;
/// Drag of a yielding hand at the handle, N s/m.
const YIELDING_DRAG: f64 = 1.5;

#[derive(Clone, Copy, Debug)]
enum Curve {
    Still(f64),
    Reach(Quintic),
    Shake {
        centre: f64,
        amplitude: f64,
        hz: f64,
        seconds: f64,
    },
}

impl Curve {
    fn at(&self, t: f64) -> Jet {
        match *self {
            Self::Still(q) => Jet::constant(q),
            Self::Reach(curve) => curve.at(t),
            Self::Shake {
                centre,
                amplitude,
                hz,
                seconds,
            } => {
                // Two frequencies, so that acceleration and position are not in step all the time.
                let swing = Jet::sine(amplitude, hz, 0.0, t).plus(Jet::sine(
                    0.35 * amplitude,
                    1.618 * hz,
                    0.0,
                    t,
                ));
                swing
                    .times(Jet::window(t, seconds, 0.35))
                    .plus(Jet::constant(centre))
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
struct Active {
    began: f64,
    seconds: f64,
    curve: Curve,
    from_share: f64,
    to_share: f64,
}

impl Active {
    /// How firm the hand is, 0 to 1.
    fn share(&self, t: f64) -> f64 {
        self.from_share
            + (self.to_share - self.from_share) * Jet::rise(t - self.began, BLEND_S).value
    }
}

/// What the hand is made of, in the joint's units.
#[derive(Clone, Debug)]
pub(crate) struct Hand {
    stiffness: f64,
    damping: f64,
    max_effort: f64,
    learned_inertia: f64,
    inertia: f64,
    lever: f64,
    tremor: Wave,
}

impl Hand {
    /// A hand at `lever` (m; 1 for a prismatic joint) on an object, itself adding `inertia`.
    pub(crate) fn new(
        spec: &PersonSpec,
        lever: f64,
        object_inertia: f64,
        inertia: f64,
        random: &mut Random,
    ) -> Self {
        let square = lever * lever;
        let stiffness = spec.stiffness_n_per_m * square * random.uniform(0.85, 1.15);
        let total = object_inertia + inertia;
        Self {
            stiffness,
            damping: 2.0 * spec.damping_ratio * (stiffness * total).sqrt(),
            max_effort: spec.max_force_n * lever,
            learned_inertia: total * random.uniform(0.75, 0.95),
            inertia,
            lever,
            tremor: Wave::new(random, spec.tremor_n, [8.0, 12.0]),
        }
    }
}

/// The person while holding the object.
#[derive(Debug)]
pub(crate) struct Person {
    hand: Hand,
    plan: VecDeque<Segment>,
    active: Active,
}

impl Person {
    /// A person who has just grasped the object at `state`.
    pub(crate) fn grasping(hand: Hand, plan: Vec<Segment>, state: JointState) -> Self {
        let curve = Curve::Still(state.q);
        let active = Active {
            began: state.t,
            seconds: 0.0,
            curve,
            from_share: 0.0,
            to_share: 0.0,
        };
        Self {
            hand,
            plan: plan.into(),
            active,
        }
    }

    /// Whether the hand lets the object go where it wants.
    #[cfg(test)]
    pub(crate) fn yields(&self) -> bool {
        self.active.to_share == 0.0
    }

    /// Goes on to the next segment when the present one is over.
    pub(crate) fn begin_step(&mut self, state: JointState) {
        while state.t >= self.active.began + self.active.seconds {
            let Some(segment) = self.plan.pop_front() else {
                return;
            };
            let yielded = self.active.to_share < 1.0;
            let wanted = self.active.curve.at(self.active.seconds).value;
            // A hand that yielded takes over where the object is.
            let (q, dq) = if yielded {
                (state.q, state.dq)
            } else {
                (wanted, 0.0)
            };
            let (curve, seconds, share) = match segment {
                Segment::Hold { seconds } => {
                    (Curve::Reach(Quintic::new(q, dq, q, 0.3)), seconds, 1.0)
                }
                Segment::Reach { to, seconds } => {
                    (Curve::Reach(Quintic::new(q, dq, to, seconds)), seconds, 1.0)
                }
                Segment::Shake {
                    amplitude,
                    hz,
                    seconds,
                } => (
                    Curve::Shake {
                        centre: q,
                        amplitude,
                        hz,
                        seconds,
                    },
                    seconds,
                    1.0,
                ),
                Segment::Follow {
                    seconds,
                    lead: None,
                } => (Curve::Still(q), seconds, 0.0),
                Segment::Follow {
                    seconds,
                    lead: Some(to),
                } => (Curve::Reach(Quintic::new(q, dq, to, seconds)), seconds, 0.2),
            };
            self.active = Active {
                began: self.active.began + self.active.seconds,
                seconds,
                curve,
                from_share: self.active.to_share,
                to_share: share,
            };
        }
    }
}

impl Drive for Person {
    fn effort(&self, at: JointState) -> f64 {
        let hand = &self.hand;
        let wanted = self.active.curve.at(at.t - self.active.began);
        let share = self.active.share(at.t);
        let spring = hand.stiffness * (wanted.value - at.q) + hand.damping * (wanted.rate - at.dq);
        let learned = hand.learned_inertia * wanted.rate_change;
        let drag = (1.0 - share) * YIELDING_DRAG * hand.lever * hand.lever * at.dq;
        let tremor = hand.lever * hand.tremor.value(at.t);
        (share * (spring + learned) - drag + tremor).clamp(-hand.max_effort, hand.max_effort)
    }

    fn inertia(&self) -> f64 {
        self.hand.inertia
    }
}
