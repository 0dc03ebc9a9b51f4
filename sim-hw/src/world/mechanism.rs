//! The declared mechanisms, each from its table of the scenario.

use super::closer::Closer;
use super::passive::{JointState, Passive};
use super::strut::{Counterbalance, GasSpring};
use crate::scenario::MechanismSpec;

/// The mechanism that `spec` describes.
pub(crate) fn build(spec: &MechanismSpec) -> Box<dyn Passive> {
    match spec {
        MechanismSpec::Closer {
            preload,
            rate,
            blend,
            relief,
            zones,
        } => Box::new(Closer {
            preload: *preload,
            rate: *rate,
            blend: *blend,
            relief: *relief,
            zones: zones.clone(),
        }),
        MechanismSpec::SpringHinge { preload, rate } => Box::new(SpringHinge {
            preload: *preload,
            rate: *rate,
        }),
        MechanismSpec::Catch { pull, reach } => Box::new(Catch {
            pull: *pull,
            reach: *reach,
            at: 0.0,
        }),
        MechanismSpec::GasSpring {
            force_n,
            rate_n_per_m,
            damping,
            strut,
        } => Box::new(GasSpring::new(
            *force_n,
            *rate_n_per_m,
            *damping,
            strut.clone(),
        )),
        MechanismSpec::Counterbalance {
            stiffness_n_per_m,
            free_length_m,
            strut,
        } => Box::new(Counterbalance {
            stiffness: *stiffness_n_per_m,
            free_length: *free_length_m,
            strut: strut.clone(),
        }),
    }
}

#[derive(Clone, Debug)]
struct SpringHinge {
    preload: f64,
    rate: f64,
}

impl Passive for SpringHinge {
    fn effort(&self, at: JointState) -> f64 {
        -(self.preload + self.rate * at.q)
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Catch {
    pub(crate) pull: f64,
    pub(crate) reach: f64,
    pub(crate) at: f64,
}

impl Passive for Catch {
    fn effort(&self, at: JointState) -> f64 {
        let gap = 1.0 + (at.q - self.at).max(0.0) / self.reach;
        -self.pull / (gap * gap)
    }
}
