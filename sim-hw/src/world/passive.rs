//! What acts on the joint by itself: mechanisms, and effects that nobody declared.

use std::fmt;

/// Where the joint is at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointState {
    /// Seconds since the simulation began.
    pub t: f64,
    /// Position, rad or m.
    pub q: f64,
    /// Rate, rad/s or m/s.
    pub dq: f64,
}

/// Dry friction by direction, N m or N; never negative.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DryFriction {
    /// While q grows.
    pub forward: f64,
    /// While q shrinks.
    pub backward: f64,
    /// What must be exceeded at rest for q to grow.
    pub breakaway_forward: f64,
    /// What must be exceeded at rest for q to shrink.
    pub breakaway_backward: f64,
}

impl DryFriction {
    /// The same in both directions.
    #[must_use]
    pub fn symmetric(kinetic: f64, breakaway: f64) -> Self {
        Self {
            forward: kinetic,
            backward: kinetic,
            breakaway_forward: breakaway,
            breakaway_backward: breakaway,
        }
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self {
            forward: self.forward + other.forward,
            backward: self.backward + other.backward,
            breakaway_forward: self.breakaway_forward + other.breakaway_forward,
            breakaway_backward: self.breakaway_backward + other.breakaway_backward,
        }
    }

    pub(crate) fn kinetic(self, direction: f64) -> f64 {
        if direction > 0.0 {
            self.forward
        } else {
            self.backward
        }
    }
}

/// Something that acts on the joint: a mechanism, or an undeclared effect. It may have a memory of its own.
///
/// Within a step the memory is held while `effort` and `dry_friction` are asked several times; `advance` moves it on once per
/// step, before the next one begins. A passive thing must not feed energy in for ever; nothing checks that.
pub trait Passive: fmt::Debug + Send {
    /// Effort on the object, N m or N; positive opens.
    fn effort(&self, at: JointState) -> f64;

    /// Dry friction on top of the object's own; the world makes stick and slip of it.
    fn dry_friction(&self, _at: JointState) -> DryFriction {
        DryFriction::default()
    }

    /// Inertia on top of the object's own, kg m^2 or kg.
    fn added_inertia(&self, _t: f64) -> f64 {
        0.0
    }

    /// Moves the memory on over one step.
    fn advance(&mut self, _from: JointState, _to: JointState) {}

    /// Begins anew with the joint at `at`: time starts at 0, or the joint was put there.
    fn restart(&mut self, _at: JointState) {}
}
