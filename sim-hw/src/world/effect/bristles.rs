//! Dry friction through bristles: ten springs side by side, each with a slider that gives at its own deflection.
//!
//! All sliders give at the same force, at deflections evenly spread up to `length`. The force depends on the way gone since
//! the last turns and not on the rate, and a small loop inside a large one closes (Iwan's model).

use crate::world::passive::{JointState, Passive};

const COUNT: usize = 10;

#[derive(Clone, Debug)]
pub(crate) struct Bristles {
    /// Of one slider.
    force: f64,
    /// Deflections at which they give.
    give: [f64; COUNT],
    /// Deflections, when the joint was at `from`.
    bent: [f64; COUNT],
    from: f64,
}

impl Bristles {
    /// `level` is the friction when all slide, N m or N; `length` the deflection of the last, rad or m.
    pub(crate) fn new(level: f64, length: f64) -> Self {
        Self {
            force: level / COUNT as f64,
            give: std::array::from_fn(|index| length * (index + 1) as f64 / COUNT as f64),
            bent: [0.0; COUNT],
            from: 0.0,
        }
    }

    fn bent_at(&self, q: f64) -> [f64; COUNT] {
        std::array::from_fn(|index| {
            let give = self.give[index];
            (self.bent[index] + q - self.from).clamp(-give, give)
        })
    }
}

impl Passive for Bristles {
    fn effort(&self, at: JointState) -> f64 {
        let bent = self.bent_at(at.q);
        let shares = bent.iter().zip(&self.give).map(|(bent, give)| bent / give);
        -self.force * shares.sum::<f64>()
    }

    fn advance(&mut self, _from: JointState, to: JointState) {
        self.bent = self.bent_at(to.q);
        self.from = to.q;
    }

    fn restart(&mut self, at: JointState) {
        self.from = at.q;
    }
}
