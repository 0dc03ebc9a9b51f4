//! Springs between a pivot on the frame and a pivot on the part that turns.
//!
//! With radii a, b and the angle p between the pivots, the length is `l^2 = a^2 + b^2 - 2 a b cos p` and the lever is
//! `dl/dq = a b sin p / l`.

use super::passive::{JointState, Passive};
use crate::scenario::StrutSpec;

impl StrutSpec {
    fn length(&self, q: f64) -> f64 {
        let (a, b) = (self.frame_radius_m, self.part_radius_m);
        (a * a + b * b - 2.0 * a * b * (self.angle_rad + q).cos()).sqrt()
    }

    fn lever(&self, q: f64) -> f64 {
        self.frame_radius_m * self.part_radius_m * (self.angle_rad + q).sin() / self.length(q)
    }
}

#[derive(Clone, Debug)]
pub(crate) struct GasSpring {
    force: f64,
    rate: f64,
    damping: f64,
    strut: StrutSpec,
    length_at_zero: f64,
}

impl GasSpring {
    pub(crate) fn new(force: f64, rate: f64, damping: f64, strut: StrutSpec) -> Self {
        let length_at_zero = strut.length(0.0);
        Self {
            force,
            rate,
            damping,
            strut,
            length_at_zero,
        }
    }
}

impl Passive for GasSpring {
    fn effort(&self, at: JointState) -> f64 {
        let lever = self.strut.lever(at.q);
        let push = self.force + self.rate * (self.length_at_zero - self.strut.length(at.q));
        (push - self.damping * lever * at.dq) * lever
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Counterbalance {
    pub(crate) stiffness: f64,
    pub(crate) free_length: f64,
    pub(crate) strut: StrutSpec,
}

impl Passive for Counterbalance {
    fn effort(&self, at: JointState) -> f64 {
        let pull = self.stiffness * (self.strut.length(at.q) - self.free_length).max(0.0);
        -pull * self.strut.lever(at.q)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRUT: StrutSpec = StrutSpec {
        frame_radius_m: 0.3,
        part_radius_m: 0.11,
        angle_rad: 0.2,
    };

    #[test]
    fn the_lever_is_the_slope_of_the_length() {
        for q in [0.0, 0.4, 1.1, 2.0] {
            let slope = (STRUT.length(q + 1e-6) - STRUT.length(q - 1e-6)) / 2e-6;
            assert!((slope - STRUT.lever(q)).abs() < 1e-8);
        }
    }

    #[test]
    fn a_counterbalance_pulls_shut_and_a_gas_spring_pushes_open() {
        let at = JointState {
            t: 0.0,
            q: 0.8,
            dq: 0.0,
        };
        assert!(
            Counterbalance {
                stiffness: 900.0,
                free_length: 0.1,
                strut: STRUT
            }
            .effort(at)
                < -1.0
        );
        assert!(GasSpring::new(200.0, 100.0, 50.0, STRUT).effort(at) > 1.0);
    }

    #[test]
    fn a_gas_spring_takes_energy_out_in_both_directions() {
        let spring = GasSpring::new(200.0, 100.0, 50.0, STRUT);
        let still = spring.effort(JointState {
            t: 0.0,
            q: 0.8,
            dq: 0.0,
        });
        for dq in [-0.7, 0.7] {
            assert!((spring.effort(JointState { t: 0.0, q: 0.8, dq }) - still) * dq < 0.0);
        }
    }
}
