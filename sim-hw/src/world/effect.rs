//! The undeclared effects that act on the joint, each integrated from what it is made of.
//!
//! Effects of the grasp and of the measurement are elsewhere: `grasp`, `measurement`, `setting`.

mod bristles;
mod dry;
mod leaf;
mod payload;
mod smooth;

use super::mechanism::Catch;
use super::passive::Passive;
use crate::scenario::{EffectSpec, ObjectSpec};

/// Share of the object's dry friction that does not act through bristles when there are any.
const STIFF_SHARE: f64 = 0.05;

/// Those of `effects` that act on the joint; `grasp` is when the object is grasped, s, and `open` its open stop.
pub(crate) fn build(
    effects: &[EffectSpec],
    object: &ObjectSpec,
    open: f64,
    grasp: f64,
) -> Vec<Box<dyn Passive>> {
    effects
        .iter()
        .filter_map(|effect| one(effect, object, open, grasp))
        .collect()
}

/// The object as the world has it: bristles take over most of its dry friction.
pub(crate) fn without_bristles(effects: &[EffectSpec], object: &ObjectSpec) -> ObjectSpec {
    let mut object = object.clone();
    if effects
        .iter()
        .any(|effect| matches!(effect, EffectSpec::Presliding { .. }))
    {
        object.coulomb *= STIFF_SHARE;
        object.breakaway = None;
    }
    object
}

fn one(
    effect: &EffectSpec,
    object: &ObjectSpec,
    open: f64,
    grasp: f64,
) -> Option<Box<dyn Passive>> {
    use EffectSpec as E;
    Some(match *effect {
        E::Spring { rate, rest } => Box::new(smooth::Spring { rate, rest }),
        E::ConstantLoad { effort } => Box::new(smooth::Load { effort }),
        E::Detent { at, reach, hold } => Box::new(smooth::Notch { at, reach, hold }),
        E::Catch { pull, reach, at } => Box::new(Catch { pull, reach, at }),
        E::DampingZone {
            from,
            to,
            direction,
            damping,
            blend,
        } => Box::new(smooth::OneWay {
            zone: Some([from, to, blend]),
            sign: direction.sign(),
            damping,
        }),
        E::AsymmetricViscous { direction, damping } => Box::new(smooth::OneWay {
            zone: None,
            sign: direction.sign(),
            damping,
        }),
        E::AsymmetricCoulomb { direction, coulomb } => Box::new(dry::OneWay {
            sign: direction.sign(),
            coulomb,
        }),
        E::QuadraticDrag { drag } => Box::new(smooth::Drag { drag }),
        E::Stribeck { extra, rate } => Box::new(dry::Lubricated { extra, rate }),
        E::Stiction { extra } => Box::new(dry::Sticky { extra }),
        E::Presliding { length } => Box::new(bristles::Bristles::new(
            (1.0 - STIFF_SHARE) * object.coulomb,
            length,
        )),
        E::PositionDependentFriction { growth, power } => Box::new(dry::Narrowing {
            growth,
            power,
            open,
        }),
        E::Ripple {
            amplitude,
            period,
            phase_rad,
        } => Box::new(smooth::Ripple {
            amplitude,
            period,
            phase: phase_rad,
        }),
        E::FrictionDrift {
            extra,
            seconds,
            travel,
        } => Box::new(dry::Cold::new(extra, seconds, travel)),
        E::PayloadSwitch { inertia, after_s } => {
            Box::new(payload::PutIn::new(inertia, grasp + after_s))
        }
        E::ToggleLinkage {
            at,
            arm,
            height_m,
            free_length_m,
            stiffness_n_per_m,
        } => Box::new(smooth::Toggle {
            at,
            arm,
            height: height_m,
            free_length: free_length_m,
            stiffness: stiffness_n_per_m,
        }),
        E::HealingSeal { bond, heal_s, peel } => Box::new(dry::Seal::rested(bond, heal_s, peel)),
        E::SecondLeaf {
            from,
            inertia,
            coulomb,
            stiffness,
        } => Box::new(leaf::Leaf::new(from, inertia, coulomb, stiffness)),
        E::Backlash { .. }
        | E::Gravity { .. }
        | E::TimeLag { .. }
        | E::ToolMass { .. }
        | E::SensorDrift { .. }
        | E::GraspCompliance { .. }
        | E::AxisOffset { .. }
        | E::Slip { .. } => return None,
    })
}

#[cfg(test)]
mod tests;
