//! What a residual may stand against.

use std::borrow::Cow;

use super::Motion;
use crate::effect::library::Variable;
use crate::screw::JointKind;

impl Motion {
    /// A variable at each sample, SI: of a slide's off-axis force along both perpendiculars, of a hinge's away from its axis, and none where it was
    /// not measured.
    #[must_use]
    pub fn variable(&self, variable: Variable) -> Vec<Cow<'_, [f64]>> {
        let one = match variable {
            Variable::Q => &self.q,
            Variable::Dq => &self.dq,
            Variable::Ddq => &self.ddq,
            Variable::Sign => &self.sign,
            Variable::Time => &self.time,
            Variable::SinceReversal => return vec![self.since_reversal().into()],
            Variable::OffAxis => return self.off_axis(),
        };
        vec![one.into()]
    }

    fn since_reversal(&self) -> Vec<f64> {
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

    fn off_axis(&self) -> Vec<Cow<'_, [f64]>> {
        let [first, second] = self.across.as_slice() else {
            return Vec::new();
        };
        if self.kind == JointKind::Prismatic {
            return vec![first.into(), second.into()];
        }
        let forces = first.iter().zip(second).zip(&self.q);
        let outwards = forces.map(|((first, second), q)| first * q.cos() + second * q.sin());
        vec![outwards.collect::<Vec<f64>>().into()]
    }
}
