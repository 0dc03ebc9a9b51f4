//! Dry friction besides the object's own; the world makes stick and slip of it.

use crate::world::passive::{DryFriction, JointState, Passive};

#[derive(Clone, Debug)]
pub(crate) struct OneWay {
    pub(crate) sign: f64,
    pub(crate) coulomb: f64,
}

impl Passive for OneWay {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn dry_friction(&self, _at: JointState) -> DryFriction {
        let [forward, backward] = if self.sign > 0.0 {
            [self.coulomb, 0.0]
        } else {
            [0.0, self.coulomb]
        };
        DryFriction {
            forward,
            backward,
            breakaway_forward: forward,
            breakaway_backward: backward,
        }
    }
}

/// Friction that a film of lubricant takes away as it builds up (Hess and Soom's curve).
#[derive(Clone, Debug)]
pub(crate) struct Lubricated {
    pub(crate) extra: f64,
    pub(crate) rate: f64,
}

impl Passive for Lubricated {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn dry_friction(&self, at: JointState) -> DryFriction {
        let film = at.dq / self.rate;
        DryFriction::symmetric(self.extra / (1.0 + film * film), self.extra)
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Sticky {
    pub(crate) extra: f64,
}

impl Passive for Sticky {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn dry_friction(&self, _at: JointState) -> DryFriction {
        DryFriction::symmetric(0.0, self.extra)
    }
}

/// A rail that narrows, or a panel that jams, on the way to the open stop.
#[derive(Clone, Debug)]
pub(crate) struct Narrowing {
    pub(crate) growth: f64,
    pub(crate) power: f64,
    pub(crate) open: f64,
}

impl Passive for Narrowing {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn dry_friction(&self, at: JointState) -> DryFriction {
        let level = self.growth * (at.q / self.open).max(0.0).powf(self.power);
        DryFriction::symmetric(level, level)
    }
}

/// Cold grease: it goes with the time since it first moved, with the way gone, or with both.
#[derive(Clone, Debug)]
pub(crate) struct Cold {
    extra: f64,
    seconds: f64,
    travel: f64,
    left: f64,
    moved: bool,
}

impl Cold {
    pub(crate) fn new(extra: f64, seconds: Option<f64>, travel: Option<f64>) -> Self {
        Self {
            extra,
            seconds: seconds.unwrap_or(f64::INFINITY),
            travel: travel.unwrap_or(f64::INFINITY),
            left: 1.0,
            moved: false,
        }
    }
}

impl Passive for Cold {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn dry_friction(&self, _at: JointState) -> DryFriction {
        let level = self.extra * self.left;
        DryFriction::symmetric(level, level)
    }

    fn advance(&mut self, from: JointState, to: JointState) {
        let way = (to.q - from.q).abs();
        self.moved |= way > 0.0;
        if self.moved {
            self.left *= (-(to.t - from.t) / self.seconds - way / self.travel).exp();
        }
    }

    fn restart(&mut self, _at: JointState) {
        (self.left, self.moved) = (1.0, false);
    }
}

/// A seal: its bond grows while it rests and peels off as it moves.
#[derive(Clone, Debug)]
pub(crate) struct Seal {
    most: f64,
    heal_s: f64,
    peel: f64,
    bond: f64,
}

impl Seal {
    pub(crate) fn rested(most: f64, heal_s: f64, peel: f64) -> Self {
        Self {
            most,
            heal_s,
            peel,
            bond: most,
        }
    }
}

impl Passive for Seal {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn dry_friction(&self, _at: JointState) -> DryFriction {
        DryFriction::symmetric(self.bond, self.bond)
    }

    fn advance(&mut self, from: JointState, to: JointState) {
        let way = (to.q - from.q).abs();
        if way == 0.0 {
            self.bond += (self.most - self.bond) * (1.0 - (-(to.t - from.t) / self.heal_s).exp());
        } else {
            self.bond *= (-way / self.peel).exp();
        }
    }

    fn restart(&mut self, _at: JointState) {
        self.bond = self.most;
    }
}
