//! The object: one joint, integrated on its own at 8 kHz.
//!
//! `M ddq = hand + gravity + passives - viscous dq + stops - dry`, where `M` is the inertia of object and hand. Each step is
//! a midpoint step (second order, no energy gained or lost on a spring). Dry friction is exact: at rest it holds anything up
//! to breakaway, in motion it has its kinetic value, and a change of direction is located inside the step, where the joint
//! either sticks or goes on. Nothing smooths the sign.

mod closer;
pub(crate) mod effect;
pub(crate) mod joint;
pub(crate) mod mechanism;
pub mod passive;
mod strut;

use nalgebra::Vector3;

pub use joint::Joint;
pub use passive::{DryFriction, JointState, Passive};

use crate::scenario::{ObjectSpec, ScenarioError};

/// Steps per second.
pub const STEPS_PER_SECOND: u32 = 8000;
/// Earth's pull in `world`, m/s^2.
pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.80665);

pub(crate) const STEP: f64 = 1.0 / STEPS_PER_SECOND as f64;

/// What drives the joint besides the object itself.
pub trait Drive {
    /// Effort along the joint, N m or N.
    fn effort(&self, at: JointState) -> f64;
    /// Inertia that moves along with the object, kg m^2 or kg.
    fn inertia(&self) -> f64;
}

/// Nobody holds the object.
#[derive(Clone, Copy, Debug)]
pub struct Free;

impl Drive for Free {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }
    fn inertia(&self) -> f64 {
        0.0
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Contact {
    Stuck,
    Slipping { direction: f64 },
}

/// A stretch of a step without an event: constant acceleration from `from`.
#[derive(Clone, Copy, Debug)]
struct Piece {
    from: JointState,
    acceleration: f64,
    seconds: f64,
    contact: Contact,
}

/// The joint's motion at an instant, with what moves it.
#[derive(Clone, Copy, Debug)]
pub struct Moment {
    /// Position, rate and time.
    pub state: JointState,
    /// Acceleration, rad/s^2 or m/s^2.
    pub ddq: f64,
    /// Effort by the tool on the object, N m or N: the hand's, less what its own mass takes.
    pub tool_effort: f64,
}

/// The object and all that acts on it but the hand.
#[derive(Debug)]
pub struct World {
    joint: Joint,
    object: ObjectSpec,
    passives: Vec<Box<dyn Passive>>,
    state: JointState,
    contact: Contact,
    pieces: Vec<Piece>,
    steps: u64,
    /// The last step, which the passives' memories have not taken in yet: until the next one, the motion inside it is asked for.
    untold: Option<[JointState; 2]>,
}

impl World {
    /// An object at rest at `q = 0`.
    #[must_use]
    pub fn new(joint: Joint, object: ObjectSpec, passives: Vec<Box<dyn Passive>>) -> Self {
        let state = JointState {
            t: 0.0,
            q: joint.range[0],
            dq: 0.0,
        };
        Self {
            joint,
            object,
            passives,
            state,
            contact: Contact::Stuck,
            pieces: Vec::new(),
            steps: 0,
            untold: None,
        }
    }

    /// Where the joint is.
    #[must_use]
    pub fn state(&self) -> JointState {
        self.state
    }

    /// The joint's geometry.
    #[must_use]
    pub fn joint(&self) -> &Joint {
        &self.joint
    }

    /// Whether dry friction holds the joint.
    #[must_use]
    pub fn is_stuck(&self) -> bool {
        self.contact == Contact::Stuck
    }

    /// Puts the joint somewhere, at rest or moving, without changing the time.
    pub fn place(&mut self, q: f64, dq: f64) {
        self.state.q = q;
        self.state.dq = dq;
        self.contact = if dq == 0.0 {
            Contact::Stuck
        } else {
            Contact::Slipping {
                direction: dq.signum(),
            }
        };
        self.pieces.clear();
        self.restart();
    }

    /// Passives begin with the joint as it stands.
    fn restart(&mut self) {
        self.untold = None;
        for passive in &mut self.passives {
            passive.restart(self.state);
        }
    }

    /// Lets the object come to rest by itself, then starts the time anew.
    ///
    /// # Errors
    /// It does not rest within 20 s.
    pub(crate) fn settle(&mut self) -> Result<(), ScenarioError> {
        const LONGEST_S: u32 = 20;
        let mut resting = 0;
        for _ in 0..LONGEST_S * STEPS_PER_SECOND {
            self.step(&Free);
            resting = if self.is_stuck() { resting + 1 } else { 0 };
            if resting == STEPS_PER_SECOND / 2 {
                self.steps = 0;
                self.state.t = 0.0;
                self.pieces.clear();
                self.restart();
                return Ok(());
            }
        }
        Err(ScenarioError::NeverRests {
            rate: self.state.dq,
            waited_s: f64::from(LONGEST_S),
        })
    }

    /// One step of 1/8000 s under `drive`.
    pub fn step(&mut self, drive: &dyn Drive) {
        if let Some([from, to]) = self.untold.take() {
            for passive in &mut self.passives {
                passive.advance(from, to);
            }
        }
        let began = self.state;
        let end = (self.steps + 1) as f64 * STEP;
        self.pieces.clear();
        while self.state.t < end {
            // A joint that changes direction more often than that within a step has no net motion.
            let may_slip = self.pieces.len() < 8;
            self.advance(drive, end, may_slip);
        }
        self.steps += 1;
        self.untold = Some([began, self.state]);
    }

    fn advance(&mut self, drive: &dyn Drive, end: f64, may_slip: bool) {
        let from = self.state;
        let left = end - from.t;
        if self.contact == Contact::Stuck && may_slip {
            self.contact = self.breaks_away(drive);
        }
        let Contact::Slipping { direction } = self.contact else {
            self.pieces.push(Piece {
                from,
                acceleration: 0.0,
                seconds: left,
                contact: Contact::Stuck,
            });
            self.state = JointState {
                t: end,
                q: from.q,
                dq: 0.0,
            };
            return;
        };
        let start = self.acceleration(drive, from, direction);
        let middle = JointState {
            t: from.t + 0.5 * left,
            q: from.q + 0.5 * left * from.dq,
            dq: from.dq + 0.5 * left * start,
        };
        let acceleration = self.acceleration(drive, middle, direction);
        let dq = from.dq + left * acceleration;
        if dq * direction > 0.0 || !may_slip {
            self.pieces.push(Piece {
                from,
                acceleration,
                seconds: left,
                contact: self.contact,
            });
            let q = from.q + left * (from.dq + 0.5 * left * acceleration);
            self.state = JointState {
                t: end,
                q,
                dq: if may_slip { dq } else { 0.0 },
            };
            return;
        }
        // The rate passes zero inside the step: stop there, and let breakaway decide.
        let seconds = if acceleration == 0.0 {
            0.0
        } else {
            (-from.dq / acceleration).clamp(0.0, left)
        };
        self.pieces.push(Piece {
            from,
            acceleration,
            seconds,
            contact: self.contact,
        });
        let q = from.q + seconds * (from.dq + 0.5 * seconds * acceleration);
        self.state = JointState {
            t: from.t + seconds,
            q,
            dq: 0.0,
        };
        self.contact = Contact::Stuck;
        if seconds == 0.0 {
            // It broke away and was turned back at once: it holds for this step.
            self.pieces.push(Piece {
                from: self.state,
                acceleration: 0.0,
                seconds: left,
                contact: Contact::Stuck,
            });
            self.state.t = end;
        }
    }

    fn breaks_away(&self, drive: &dyn Drive) -> Contact {
        let net = drive.effort(self.state) + self.smooth_effort(self.state);
        let dry = self.dry_friction(self.state);
        let limit = if net > 0.0 {
            dry.breakaway_forward
        } else {
            dry.breakaway_backward
        };
        if net.abs() <= limit {
            Contact::Stuck
        } else {
            Contact::Slipping {
                direction: net.signum(),
            }
        }
    }

    fn acceleration(&self, drive: &dyn Drive, at: JointState, direction: f64) -> f64 {
        let net = drive.effort(at) + self.smooth_effort(at)
            - self.dry_friction(at).kinetic(direction) * direction;
        net / (self.inertia(at.t) + drive.inertia())
    }

    fn inertia(&self, t: f64) -> f64 {
        self.object.inertia
            + self
                .passives
                .iter()
                .map(|passive| passive.added_inertia(t))
                .sum::<f64>()
    }

    /// All efforts on the object but the tool's and dry friction's.
    fn smooth_effort(&self, at: JointState) -> f64 {
        self.passives
            .iter()
            .map(|passive| passive.effort(at))
            .sum::<f64>()
            + self.joint.gravity_effort(&self.object, at.q)
            + self.stop_effort(at)
            - self.object.viscous * at.dq
    }

    fn stop_effort(&self, at: JointState) -> f64 {
        let [closed, open] = self.joint.range;
        let (depth, inwards) = if at.q < closed {
            (closed - at.q, 1.0)
        } else {
            ((at.q - open).max(0.0), -1.0)
        };
        if depth == 0.0 {
            return 0.0;
        }
        let push = self.object.stop_stiffness * depth - inwards * self.object.stop_damping * at.dq;
        inwards * push.max(0.0)
    }

    fn dry_friction(&self, at: JointState) -> DryFriction {
        let breakaway = self.object.breakaway.unwrap_or(self.object.coulomb);
        let own = DryFriction::symmetric(self.object.coulomb, breakaway);
        self.passives
            .iter()
            .fold(own, |sum, passive| sum.plus(passive.dry_friction(at)))
    }

    /// The motion at `t`, which must lie in the last step.
    #[must_use]
    pub fn moment(&self, drive: &dyn Drive, t: f64) -> Moment {
        let found = self
            .pieces
            .iter()
            .rev()
            .find(|piece| piece.from.t <= t)
            .or(self.pieces.first());
        let Some(piece) = found else {
            return Moment {
                state: self.state,
                ddq: 0.0,
                tool_effort: drive.effort(self.state),
            };
        };
        let ahead = (t - piece.from.t).clamp(0.0, piece.seconds);
        let state = JointState {
            t: piece.from.t + ahead,
            q: piece.from.q + ahead * (piece.from.dq + 0.5 * ahead * piece.acceleration),
            dq: piece.from.dq + ahead * piece.acceleration,
        };
        let ddq = match piece.contact {
            Contact::Stuck => 0.0,
            Contact::Slipping { direction } => self.acceleration(drive, state, direction),
        };
        Moment {
            state,
            ddq,
            tool_effort: drive.effort(state) - drive.inertia() * ddq,
        }
    }

    /// The effort that the object needs for a motion that slips in `direction` (1 or -1); for tests and truth.
    #[must_use]
    pub fn needed_effort(&self, at: JointState, ddq: f64, direction: f64) -> f64 {
        self.inertia(at.t) * ddq - self.smooth_effort(at)
            + direction * self.dry_friction(at).kinetic(direction)
    }

    /// The effort on the object from all but tool and friction when it stands at `q`; positive opens.
    #[must_use]
    pub fn standing_effort(&self, q: f64) -> f64 {
        self.smooth_effort(JointState {
            t: self.state.t,
            q,
            dq: 0.0,
        })
    }

    /// The largest effort that dry friction holds at `q`.
    #[must_use]
    pub fn holding_effort(&self, q: f64) -> f64 {
        let dry = self.dry_friction(JointState {
            t: self.state.t,
            q,
            dq: 0.0,
        });
        dry.breakaway_forward.min(dry.breakaway_backward)
    }
}

#[cfg(test)]
mod tests;
