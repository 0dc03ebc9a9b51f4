//! The object of a draw: a built-in one with other sizes, and the person.

use serde::Serialize;

use super::Mechanisms;
use crate::random::Random;
use crate::scenario::{JointKind, MechanismSpec, Scenario};

/// Sizes as shares of the built-in object's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sizes {
    /// Of inertia, weight and stops.
    pub inertia: f64,
    /// Of dry friction.
    pub coulomb: f64,
    /// Of viscous friction.
    pub viscous: f64,
    /// Of the distance from axis to handle (revolute).
    pub lever: f64,
    /// Of the mechanism's efforts.
    pub mechanism: f64,
}

/// The name of the built-in scenario and a scenario of other sizes.
pub(super) fn draw(
    mechanisms: Mechanisms,
    random: &mut Random,
) -> Option<(String, Sizes, Scenario)> {
    let names = Scenario::builtin_names();
    let name = names[random.below(names.len())];
    let mut scenario = Scenario::builtin(name).ok()?;
    let mut share = || random.uniform(0.5, 1.5);
    let sizes = Sizes {
        inertia: share(),
        coulomb: share(),
        viscous: share(),
        lever: share(),
        mechanism: share(),
    };
    let object = &mut scenario.object;
    object.inertia *= sizes.inertia;
    object.panel_mass_kg *= sizes.inertia;
    object.stop_stiffness *= sizes.inertia;
    object.stop_damping *= sizes.inertia;
    object.coulomb *= sizes.coulomb;
    object.breakaway = object.breakaway.map(|level| level * sizes.coulomb);
    object.viscous *= sizes.viscous;
    if scenario.joint.kind == JointKind::Revolute {
        scale_lever(&mut scenario, sizes.lever);
    }
    match mechanisms {
        Mechanisms::Kept => scale_mechanisms(&mut scenario, sizes),
        Mechanisms::Dropped => {
            scenario.mechanisms.clear();
            if lies(&scenario) {
                scenario.object.panel_mass_kg = 0.0;
            }
        }
    }
    Some((name.to_owned(), sizes, scenario))
}

/// Whether the axis is far from upright, so that the panel's weight counts.
pub(super) fn lies(scenario: &Scenario) -> bool {
    let [x, y, z] = scenario.joint.axis;
    z.abs() < 0.9 * (x * x + y * y + z * z).sqrt()
}

fn scale_lever(scenario: &mut Scenario, factor: f64) {
    let axis = nalgebra::Vector3::from(scenario.joint.axis).normalize();
    let on_axis = nalgebra::Vector3::from(scenario.joint.point);
    let from_axis = nalgebra::Vector3::from(scenario.grasp.tcp_point) - on_axis;
    let radial = from_axis - axis * axis.dot(&from_axis);
    scenario.grasp.tcp_point = (on_axis + from_axis + radial * (factor - 1.0)).into();
}

fn scale_mechanisms(scenario: &mut Scenario, sizes: Sizes) {
    for mechanism in &mut scenario.mechanisms {
        match mechanism {
            MechanismSpec::Closer {
                preload,
                rate,
                relief,
                zones,
                ..
            } => {
                *preload *= sizes.mechanism;
                *rate *= sizes.mechanism;
                *relief = relief.map(|level| level * sizes.mechanism);
                for zone in zones {
                    zone.damping *= sizes.mechanism;
                }
            }
            MechanismSpec::SpringHinge { preload, rate } => {
                *preload *= sizes.mechanism;
                *rate *= sizes.mechanism;
            }
            MechanismSpec::Catch { pull, .. } => *pull *= sizes.mechanism,
            MechanismSpec::GasSpring {
                force_n,
                rate_n_per_m,
                ..
            } => {
                *force_n *= sizes.mechanism;
                *rate_n_per_m *= sizes.mechanism;
            }
            // It is chosen for the weight that it balances.
            MechanismSpec::Counterbalance {
                stiffness_n_per_m, ..
            } => *stiffness_n_per_m *= sizes.inertia,
        }
    }
}

/// What the object's mechanisms and weight are called in the report.
pub(super) fn mechanism_effects(scenario: &Scenario) -> Vec<&'static str> {
    let mut names: Vec<&'static str> = Vec::new();
    for mechanism in &scenario.mechanisms {
        names.extend(match mechanism {
            MechanismSpec::Closer { .. } => ["constant_load", "spring", "damping_zone"].as_slice(),
            MechanismSpec::SpringHinge { .. } => &["constant_load", "spring"],
            MechanismSpec::Catch { .. } => &["catch"],
            MechanismSpec::GasSpring { .. } | MechanismSpec::Counterbalance { .. } => {
                &["constant_load", "spring"]
            }
        });
    }
    if lies(scenario) && scenario.object.panel_mass_kg > 0.0 {
        names.push("gravity");
    }
    names.sort_unstable();
    names.dedup();
    names
}

/// Another person on another day.
pub(super) fn vary_person(scenario: &mut Scenario, random: &mut Random) {
    let person = &mut scenario.person;
    let mut vary = |value: &mut f64, by: f64| *value *= random.uniform(1.0 - by, 1.0 + by);
    vary(&mut person.stiffness_n_per_m, 0.25);
    vary(&mut person.damping_ratio, 0.3);
    vary(&mut person.moving_mass_kg, 0.2);
    vary(&mut person.top_speed_m_s, 0.2);
    vary(&mut person.shake_m_s2, 0.25);
    vary(&mut person.tremor_n, 0.4);
    vary(&mut person.off_axis_force_n, 0.4);
    vary(&mut person.off_axis_torque_nm, 0.4);
    vary(&mut person.about_axis_torque_nm, 0.4);
    scenario.salt = 1 + random.below(u32::MAX as usize - 1) as u32;
}
