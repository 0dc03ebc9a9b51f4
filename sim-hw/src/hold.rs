//! How the hand holds the handle: firmly, with pads that give or have play, sliding at instants.
//!
//! The hand is at x, the handle at q, both in the joint's coordinate, and s is how far the pads have slid along the motion.
//! Firmly, x = q + s and the hand's inertia moves along. With pads, the hand is a body of its own:
//! `inertia ddx = hand - pads`, `pads = stiffness d + damping dd` with `d = x - q - s` less the play.

use nalgebra::Vector3;

use crate::motion::{Jet, RigidMotion};
use crate::person::Person;
use crate::scenario::EffectSpec;
use crate::setting::Setting;
use crate::world::{Drive, JointState, STEP};

/// What is between hand and handle, in the joint's units.
#[derive(Clone, Debug, Default)]
pub(crate) struct Grasp {
    pads: Option<Pads>,
    slips: Option<Slips>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Pads {
    half_play: f64,
    stiffness: f64,
    damping_ratio: f64,
}

#[derive(Clone, Debug)]
struct Slips {
    begins: Vec<f64>,
    lasts: f64,
    /// Of one, in the joint's coordinate.
    along: f64,
    /// Of one, across the motion, m, world at q = 0.
    across: Vector3<f64>,
}

impl Slips {
    fn count(&self, t: f64) -> Jet {
        self.begins.iter().fold(Jet::default(), |sum, begin| {
            sum.plus(Jet::rise(t - begin, self.lasts))
        })
    }
}

impl Grasp {
    /// Those of `effects` that sit between hand and handle; the object is grasped at `grasp` seconds.
    pub(crate) fn new(effects: &[EffectSpec], setting: &Setting, grasp: f64) -> Self {
        let lever = setting.lever();
        let mut made = Self::default();
        for effect in effects {
            match effect {
                EffectSpec::Backlash {
                    gap_m,
                    stiffness_n_per_m,
                } => made.add_pads(0.5 * gap_m / lever, stiffness_n_per_m * lever * lever, 0.5),
                EffectSpec::GraspCompliance {
                    stiffness_n_per_m,
                    damping_ratio,
                } => made.add_pads(0.0, stiffness_n_per_m * lever * lever, *damping_ratio),
                EffectSpec::Slip {
                    step_m,
                    after_s,
                    lasts_s,
                } => {
                    let step = setting.turn * Vector3::from(*step_m);
                    let along = setting
                        .joint
                        .velocity_per_rate(setting.grasp_position)
                        .normalize();
                    made.slips = Some(Slips {
                        begins: after_s.iter().map(|after| grasp + after).collect(),
                        lasts: *lasts_s,
                        along: along.dot(&step) / lever,
                        across: step - along * along.dot(&step),
                    });
                }
                _ => {}
            }
        }
        made
    }

    /// Play and yielding pads are one behind the other.
    fn add_pads(&mut self, half_play: f64, stiffness: f64, damping_ratio: f64) {
        let new = Pads {
            half_play,
            stiffness,
            damping_ratio,
        };
        self.pads = Some(match self.pads {
            None => new,
            Some(old) => Pads {
                half_play: old.half_play + half_play,
                stiffness: 1.0 / (1.0 / old.stiffness + 1.0 / stiffness),
                damping_ratio: old.damping_ratio.min(damping_ratio),
            },
        });
    }
}

/// The hand while it moves on its own, during a step.
#[derive(Clone, Copy, Debug)]
struct Apart {
    began: JointState,
    ddx: f64,
}

impl Apart {
    fn at(&self, t: f64) -> JointState {
        let since = t - self.began.t;
        JointState {
            t,
            q: self.began.q + since * (self.began.dq + 0.5 * since * self.ddx),
            dq: self.began.dq + since * self.ddx,
        }
    }
}

/// A person who holds the object.
#[derive(Debug)]
pub(crate) struct Hold {
    person: Person,
    grasp: Grasp,
    apart: Apart,
}

impl Hold {
    /// Hand and handle at `state`.
    pub(crate) fn new(person: Person, grasp: Grasp, state: JointState) -> Self {
        let apart = Apart {
            began: state,
            ddx: 0.0,
        };
        Self {
            person,
            grasp,
            apart,
        }
    }

    #[cfg(test)]
    pub(crate) fn yields(&self) -> bool {
        self.person.yields()
    }

    #[cfg(test)]
    pub(crate) fn hand_inertia(&self) -> f64 {
        self.person.inertia()
    }

    #[cfg(test)]
    pub(crate) fn hands_effort(&self, hand: JointState) -> f64 {
        self.person.effort(hand)
    }

    /// Prepares the step that begins with the object at `state`.
    pub(crate) fn begin_step(&mut self, state: JointState) {
        let Some(pads) = self.grasp.pads else {
            self.person.begin_step(self.slid(state));
            return;
        };
        self.apart.began = self.apart.at(state.t);
        self.person.begin_step(self.apart.began);
        // Half a step ahead, with what is known now: the midpoint of the hand's own step.
        self.apart.ddx = self.hand_acceleration(&pads, self.apart.began, state);
        let t = state.t + 0.5 * STEP;
        let ahead = JointState {
            t,
            q: state.q + 0.5 * STEP * state.dq,
            dq: state.dq,
        };
        self.apart.ddx = self.hand_acceleration(&pads, self.apart.at(t), ahead);
    }

    fn hand_acceleration(&self, pads: &Pads, hand: JointState, object: JointState) -> f64 {
        let pushed = self.pads_effort(pads, hand, object);
        (self.person.effort(hand) - pushed) / self.person.inertia()
    }

    /// The handle as the hand has it, firmly held.
    fn slid(&self, at: JointState) -> JointState {
        let Some(slips) = &self.grasp.slips else {
            return at;
        };
        let slid = slips.count(at.t).scaled(slips.along);
        JointState {
            t: at.t,
            q: at.q + slid.value,
            dq: at.dq + slid.rate,
        }
    }

    /// Effort of the pads on the object.
    fn pads_effort(&self, pads: &Pads, hand: JointState, object: JointState) -> f64 {
        let handle = self.slid(object);
        let (apart, rate) = (hand.q - handle.q, hand.dq - handle.dq);
        let damping = 2.0 * pads.damping_ratio * (pads.stiffness * self.person.inertia()).sqrt();
        if pads.half_play == 0.0 {
            return pads.stiffness * apart + damping * rate;
        }
        // In play nothing is felt, and a pad pushes only.
        let side = apart.signum();
        let depth = apart.abs() - pads.half_play;
        if depth <= 0.0 {
            0.0
        } else {
            side * (pads.stiffness * depth + damping * rate * side).max(0.0)
        }
    }

    /// Where the hand is, in the joint's coordinate, with the object at `q`.
    pub(crate) fn hand(&self, q: Jet, t: f64) -> Jet {
        if let Some(pads) = &self.grasp.pads {
            let hand = self.apart.at(t);
            let object = JointState {
                t,
                q: q.value,
                dq: q.rate,
            };
            return Jet {
                value: hand.q,
                rate: hand.dq,
                rate_change: self.hand_acceleration(pads, hand, object),
            };
        }
        match &self.grasp.slips {
            Some(slips) => q.plus(slips.count(t).scaled(slips.along)),
            None => q,
        }
    }

    /// The tool centre point for a hand at `hand`.
    pub(crate) fn tcp(&self, setting: &Setting, hand: Jet, t: f64) -> RigidMotion {
        match &self.grasp.slips {
            Some(slips) => setting.carry_beside(slips.across, slips.count(t), hand),
            None => setting.carry(hand),
        }
    }
}

impl Drive for Hold {
    fn effort(&self, at: JointState) -> f64 {
        if let Some(pads) = &self.grasp.pads {
            return self.pads_effort(pads, self.apart.at(at.t), at);
        }
        match &self.grasp.slips {
            Some(slips) => {
                let pushed = slips.along * slips.count(at.t).rate_change;
                self.person.effort(self.slid(at)) - self.person.inertia() * pushed
            }
            None => self.person.effort(at),
        }
    }

    fn inertia(&self) -> f64 {
        match self.grasp.pads {
            Some(_) => 0.0,
            None => self.person.inertia(),
        }
    }
}
