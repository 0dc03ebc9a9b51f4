//! A second leaf with its own inertia and friction, between two bumpers of the first.
//!
//! With the first at q and the second at y, the play is `0 <= q - y <= from`: past its upper end the first pushes the second
//! open, past its lower end it takes it back. Bumpers are springs with damping and never pull.

use crate::world::STEP;
use crate::world::passive::{JointState, Passive};

const DAMPING_RATIO: f64 = 0.2;

#[derive(Clone, Debug)]
pub(crate) struct Leaf {
    from: f64,
    inertia: f64,
    coulomb: f64,
    stiffness: f64,
    damping: f64,
    /// At the beginning of the step.
    y: f64,
    dy: f64,
    began: f64,
    /// During the step, until it comes to rest.
    ddy: f64,
    rests_after: f64,
}

impl Leaf {
    pub(crate) fn new(from: f64, inertia: f64, coulomb: f64, stiffness: f64) -> Self {
        Self {
            from,
            inertia,
            coulomb,
            stiffness,
            damping: 2.0 * DAMPING_RATIO * (stiffness * inertia).sqrt(),
            y: 0.0,
            dy: 0.0,
            began: 0.0,
            ddy: 0.0,
            rests_after: f64::INFINITY,
        }
    }

    /// Where the second leaf is and how fast it goes at `t` of this step.
    pub(super) fn position_and_rate(&self, t: f64) -> [f64; 2] {
        let since = (t - self.began).max(0.0);
        let moving = since.min(self.rests_after);
        let rate = if since < self.rests_after {
            self.dy + moving * self.ddy
        } else {
            0.0
        };
        [self.y + moving * (self.dy + 0.5 * moving * self.ddy), rate]
    }

    /// Effort of the first leaf on the second.
    fn push(&self, first: [f64; 2], second: [f64; 2]) -> f64 {
        let ([q, dq], [y, dy]) = (first, second);
        let force = |depth: f64, rate: f64| {
            if depth > 0.0 {
                (self.stiffness * depth + self.damping * rate).max(0.0)
            } else {
                0.0
            }
        };
        force(q - y - self.from, dq - dy) - force(y - q, dy - dq)
    }
}

impl Passive for Leaf {
    fn effort(&self, at: JointState) -> f64 {
        -self.push([at.q, at.dq], self.position_and_rate(at.t))
    }

    fn advance(&mut self, _from: JointState, to: JointState) {
        [self.y, self.dy] = self.position_and_rate(to.t);
        self.began = to.t;
        let middle = [self.y + 0.5 * STEP * self.dy, self.dy];
        let push = self.push([to.q + 0.5 * STEP * to.dq, to.dq], middle);
        let against = if self.dy == 0.0 { push } else { self.dy };
        let holds = self.dy == 0.0 && push.abs() <= self.coulomb;
        self.ddy = if holds {
            0.0
        } else {
            (push - self.coulomb * against.signum()) / self.inertia
        };
        self.rests_after = if self.dy * self.ddy < 0.0 {
            -self.dy / self.ddy
        } else {
            f64::INFINITY
        };
    }

    fn restart(&mut self, at: JointState) {
        // It rests where the first leaf left it last: as far closed as the play allows.
        (self.y, self.dy, self.ddy) = (self.y.clamp(at.q - self.from, at.q), 0.0, 0.0);
        self.rests_after = f64::INFINITY;
        self.began = at.t;
    }
}
