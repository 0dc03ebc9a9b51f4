//! Effects that are a function of where the joint is and how fast it goes.

use std::f64::consts::{PI, TAU};

use crate::world::passive::{JointState, Passive};

#[derive(Clone, Debug)]
pub(crate) struct Spring {
    pub(crate) rate: f64,
    pub(crate) rest: f64,
}

impl Passive for Spring {
    fn effort(&self, at: JointState) -> f64 {
        -self.rate * (at.q - self.rest)
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Load {
    pub(crate) effort: f64,
}

impl Passive for Load {
    fn effort(&self, _at: JointState) -> f64 {
        self.effort
    }
}

/// A ball on a spring over a notch whose profile is one wave of a cosine: energy `-E (1 + cos(pi x)) / 2` for |x| < 1.
#[derive(Clone, Debug)]
pub(crate) struct Notch {
    pub(crate) at: f64,
    pub(crate) reach: f64,
    pub(crate) hold: f64,
}

impl Passive for Notch {
    fn effort(&self, at: JointState) -> f64 {
        let x = (at.q - self.at) / self.reach;
        if x.abs() < 1.0 {
            -self.hold * (PI * x).sin()
        } else {
            0.0
        }
    }
}

/// A damper that acts one way, everywhere or in a zone with soft ends.
#[derive(Clone, Debug)]
pub(crate) struct OneWay {
    /// Beginning, end, and width of the ends.
    pub(crate) zone: Option<[f64; 3]>,
    pub(crate) sign: f64,
    pub(crate) damping: f64,
}

impl Passive for OneWay {
    fn effort(&self, at: JointState) -> f64 {
        if at.dq * self.sign <= 0.0 {
            return 0.0;
        }
        let share = self.zone.map_or(1.0, |[from, to, blend]| {
            // A valve that opens with the sine of its turn.
            let open = |depth: f64| 0.5 + 0.5 * (PI * (depth / blend).clamp(-0.5, 0.5)).sin();
            open(at.q - from).min(open(to - at.q))
        });
        -share * self.damping * at.dq
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Drag {
    pub(crate) drag: f64,
}

impl Passive for Drag {
    fn effort(&self, at: JointState) -> f64 {
        -self.drag * at.dq * at.dq.abs()
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Ripple {
    pub(crate) amplitude: f64,
    pub(crate) period: f64,
    pub(crate) phase: f64,
}

impl Passive for Ripple {
    fn effort(&self, at: JointState) -> f64 {
        self.amplitude * (TAU * at.q / self.period + self.phase).sin()
    }
}

/// A compressed spring between a fixed pivot and one on the way: length `l^2 = height^2 + u^2`, `u = arm (q - at)`.
#[derive(Clone, Debug)]
pub(crate) struct Toggle {
    pub(crate) at: f64,
    pub(crate) arm: f64,
    pub(crate) height: f64,
    pub(crate) free_length: f64,
    pub(crate) stiffness: f64,
}

impl Passive for Toggle {
    fn effort(&self, at: JointState) -> f64 {
        let aside = self.arm * (at.q - self.at);
        let length = self.height.hypot(aside);
        let push = self.stiffness * (self.free_length - length).max(0.0);
        push * aside / length * self.arm
    }
}
