//! A load that is put in while the object rests, so that no blow comes with it.

use crate::world::passive::{JointState, Passive};

#[derive(Clone, Debug)]
pub(crate) struct PutIn {
    inertia: f64,
    not_before: f64,
    is_in: bool,
}

impl PutIn {
    pub(crate) fn new(inertia: f64, not_before: f64) -> Self {
        Self {
            inertia,
            not_before,
            is_in: false,
        }
    }
}

impl Passive for PutIn {
    fn effort(&self, _at: JointState) -> f64 {
        0.0
    }

    fn added_inertia(&self, _t: f64) -> f64 {
        if self.is_in { self.inertia } else { 0.0 }
    }

    fn advance(&mut self, _from: JointState, to: JointState) {
        self.is_in |= to.t >= self.not_before && to.dq == 0.0;
    }

    fn restart(&mut self, _at: JointState) {
        self.is_in = false;
    }
}
