//! What a residual may stand against, beside the motion's states.

use super::Motion;
use crate::screw::JointKind;

impl Motion {
    /// Way gone since the velocity last changed its sign, rad or m.
    #[must_use]
    pub fn since_reversal(&self) -> Vec<f64> {
        let mut out = vec![0.0; self.q.len()];
        for run in &self.runs {
            let mut turned = self.q[run.start];
            for i in run.clone() {
                if i > run.start && self.dq[i] * self.dq[i - 1] < 0.0 {
                    turned = self.q[i];
                }
                out[i] = (self.q[i] - turned).abs();
            }
        }
        out
    }

    /// Force on the object that does no work, N: of a hinge that away from its axis, of a slide those along two perpendiculars. Empty where it was
    /// not measured.
    #[must_use]
    pub fn off_axis(&self) -> Vec<Vec<f64>> {
        let [first, second] = self.across.as_slice() else {
            return Vec::new();
        };
        if self.kind == JointKind::Prismatic {
            return vec![first.clone(), second.clone()];
        }
        let forces = first.iter().zip(second).zip(&self.q);
        let outwards = forces.map(|((first, second), q)| first * q.cos() + second * q.sin());
        vec![outwards.collect()]
    }
}
