//! Kinds and sizes of the effects of a draw.
//!
//! Sizes are forces at the handle, taken to the joint by the lever L (m; 1 for a prismatic joint), after the magnitudes that
//! are published or usual: springs 10-30 N/m, detents 5-7 N, catches up to 60 N, payloads from 0.5 kg, lags 1-20 ms,
//! presliding 2-10 mm, friction that warms away by 12 % and more.

use std::f64::consts::TAU;

use super::{SealedError, SealedOptions, object};
use crate::random::Random;
use crate::scenario::{EffectSpec, JointKind, Scenario, SwingDirection};

/// The report's vocabulary.
pub(super) const VOCABULARY: [&str; 23] = [
    "spring",
    "constant_load",
    "detent",
    "catch",
    "damping_zone",
    "asymmetric_viscous",
    "asymmetric_coulomb",
    "quadratic_drag",
    "stribeck",
    "stiction",
    "presliding",
    "backlash",
    "position_dependent_friction",
    "ripple",
    "gravity",
    "time_lag",
    "tool_mass",
    "payload_switch",
    "friction_drift",
    "sensor_drift",
    "grasp_compliance",
    "axis_offset",
    "slip",
];
/// What it has no name for.
pub(super) const OUTSIDE: [&str; 3] = ["toggle_linkage", "healing_seal", "second_leaf"];

/// The kinds of effect of a draw.
pub(super) fn names(
    options: &SealedOptions,
    random: &mut Random,
) -> Result<Vec<&'static str>, SealedError> {
    let all = || VOCABULARY.into_iter().chain(OUTSIDE);
    if !options.only.is_empty() {
        let known = options.only.iter().map(|wanted| {
            let found = all().find(|name| name == wanted);
            found.ok_or_else(|| SealedError::UnknownEffect {
                name: wanted.clone(),
                known: all().collect::<Vec<_>>().join(", "),
            })
        });
        let known = known.collect::<Result<Vec<_>, _>>()?;
        return Ok(vec![known[random.below(known.len())]]);
    }
    let lot = random.uniform(0.0, 1.0);
    if lot < options.none {
        return Ok(Vec::new());
    }
    if lot < options.none + options.outside {
        return Ok(vec![OUTSIDE[random.below(OUTSIDE.len())]]);
    }
    let first = random.below(VOCABULARY.len());
    if lot < options.none + options.outside + options.two {
        let second = (first + 1 + random.below(VOCABULARY.len() - 1)) % VOCABULARY.len();
        return Ok(vec![VOCABULARY[first], VOCABULARY[second]]);
    }
    Ok(vec![VOCABULARY[first]])
}

struct Scale<'a> {
    scenario: &'a Scenario,
    lever: f64,
    open: f64,
    random: &'a mut Random,
}

impl Scale<'_> {
    fn between(&mut self, least: f64, most: f64) -> f64 {
        self.random.uniform(least, most)
    }

    fn odds(&mut self, probability: f64) -> bool {
        self.between(0.0, 1.0) < probability
    }

    /// An effort, from newtons at the handle.
    fn effort(&mut self, least_n: f64, most_n: f64) -> f64 {
        self.between(least_n, most_n) * self.lever
    }

    /// A way of the joint, from metres at the handle.
    fn way(&mut self, least_m: f64, most_m: f64) -> f64 {
        self.between(least_m, most_m) / self.lever
    }

    /// A place of the joint, from shares of its range.
    fn place(&mut self, least: f64, most: f64) -> f64 {
        self.between(least, most) * self.open
    }

    /// Friction as shares of the object's own, but not less than `floor_n` at the handle.
    fn friction(&mut self, least: f64, most: f64, floor_n: f64) -> f64 {
        let own = self.scenario.object.coulomb.max(floor_n * self.lever);
        self.between(least, most) * own
    }

    fn direction(&mut self, closing: f64) -> SwingDirection {
        if self.odds(closing) {
            SwingDirection::Closing
        } else {
            SwingDirection::Opening
        }
    }

    fn unit(&mut self) -> nalgebra::Vector3<f64> {
        nalgebra::Vector3::from(self.random.normals::<3>()).normalize()
    }
}

/// An effect of that kind at a realistic size; `None` when the object cannot have it.
pub(super) fn draw(name: &str, scenario: &Scenario, random: &mut Random) -> Option<EffectSpec> {
    let revolute = scenario.joint.kind == JointKind::Revolute;
    let lever = if revolute {
        crate::world::joint::distance_to_axis(
            scenario.joint.point,
            scenario.joint.axis,
            scenario.grasp.tcp_point,
        )
    } else {
        1.0
    };
    let mut scale = Scale {
        scenario,
        lever,
        open: scenario.joint.range[1],
        random,
    };
    of_the_object(name, &mut scale)
        .or_else(|| with_memory(name, &mut scale))
        .or_else(|| of_the_measurement(name, &mut scale))
}

fn of_the_object(name: &str, scale: &mut Scale<'_>) -> Option<EffectSpec> {
    use EffectSpec as E;
    let square = scale.lever * scale.lever;
    Some(match name {
        "spring" => E::Spring {
            rate: scale.between(10.0, 30.0) * square,
            rest: scale.place(-0.3, 0.4),
        },
        "constant_load" => {
            let sign = if scale.odds(0.75) { -1.0 } else { 1.0 };
            E::ConstantLoad {
                effort: sign * scale.effort(2.0, 6.0),
            }
        }
        "detent" => E::Detent {
            at: scale.place(0.3, 0.8),
            reach: scale.way(0.012, 0.035),
            hold: scale.effort(4.0, 9.0),
        },
        "catch" => E::Catch {
            pull: scale.effort(8.0, 40.0),
            reach: scale.way(0.01, 0.04),
            at: 0.0,
        },
        "damping_zone" => {
            let direction = scale.direction(0.7);
            let width = scale.place(0.2, 0.4);
            let open = scale.open;
            let (from, to) = match direction {
                SwingDirection::Closing => (-open, width),
                SwingDirection::Opening => (open - width, 2.0 * open),
            };
            E::DampingZone {
                from,
                to,
                direction,
                damping: scale.between(12.0, 45.0) * square,
                blend: scale.place(0.02, 0.06),
            }
        }
        "asymmetric_viscous" => E::AsymmetricViscous {
            direction: scale.direction(0.5),
            damping: scale.between(5.0, 15.0) * square,
        },
        "asymmetric_coulomb" => E::AsymmetricCoulomb {
            direction: scale.direction(0.5),
            coulomb: scale.effort(1.5, 5.0),
        },
        "quadratic_drag" => E::QuadraticDrag {
            drag: scale.between(4.0, 14.0) * square * scale.lever,
        },
        "stribeck" => E::Stribeck {
            extra: scale.friction(0.5, 1.2, 3.0),
            rate: scale.way(0.01, 0.06),
        },
        "stiction" => E::Stiction {
            extra: scale.friction(0.6, 2.0, 3.0),
        },
        "position_dependent_friction" => E::PositionDependentFriction {
            growth: scale.friction(0.4, 1.2, 4.0),
            power: scale.between(0.9, 1.5),
        },
        "ripple" => E::Ripple {
            amplitude: scale.effort(0.5, 2.5),
            period: scale.way(0.03, 0.12),
            phase_rad: scale.between(0.0, TAU),
        },
        "gravity" => {
            if scale.scenario.object.panel_mass_kg == 0.0 || object::lies(scale.scenario) {
                return None;
            }
            E::Gravity {
                tilt_deg: scale.between(0.8, 3.0),
                azimuth_deg: scale.between(-180.0, 180.0),
            }
        }
        "toggle_linkage" => toggle(scale),
        _ => return None,
    })
}

fn with_memory(name: &str, scale: &mut Scale<'_>) -> Option<EffectSpec> {
    use EffectSpec as E;
    let square = scale.lever * scale.lever;
    let inertia = scale.scenario.object.inertia;
    Some(match name {
        "presliding" => E::Presliding {
            length: scale.way(0.002, 0.01),
        },
        "payload_switch" => E::PayloadSwitch {
            inertia: scale.between(0.1, 0.4) * inertia.max(2.0 * square),
            after_s: scale.between(15.0, 40.0),
        },
        "friction_drift" => {
            let by_time = scale.odds(0.5);
            let seconds = scale.between(15.0, 50.0);
            let travel = scale.place(6.0, 20.0);
            E::FrictionDrift {
                extra: scale.friction(0.2, 0.9, 3.0),
                seconds: by_time.then_some(seconds),
                travel: (!by_time).then_some(travel),
            }
        }
        "healing_seal" => E::HealingSeal {
            bond: scale.effort(10.0, 30.0),
            heal_s: scale.between(0.1, 1.5),
            peel: scale.way(0.008, 0.04),
        },
        "second_leaf" => E::SecondLeaf {
            from: scale.place(0.25, 0.5),
            inertia: scale.between(0.15, 0.5) * inertia,
            coulomb: scale.effort(3.0, 8.0),
            stiffness: scale.between(0.6, 2.0) * 1e3 * inertia,
        },
        _ => return None,
    })
}

fn of_the_measurement(name: &str, scale: &mut Scale<'_>) -> Option<EffectSpec> {
    use EffectSpec as E;
    Some(match name {
        "backlash" => E::Backlash {
            gap_m: scale.between(0.3e-3, 1.5e-3),
            stiffness_n_per_m: scale.between(0.6e5, 1.5e5),
        },
        "grasp_compliance" => E::GraspCompliance {
            stiffness_n_per_m: scale.between(1e4, 6e4),
            damping_ratio: scale.between(0.15, 0.4),
        },
        "time_lag" => {
            let sign = if scale.odds(0.7) { 1.0 } else { -1.0 };
            E::TimeLag {
                lag_s: sign * scale.between(3e-3, 20e-3),
            }
        }
        "tool_mass" => E::ToolMass {
            mass_kg: scale.between(0.05, 0.25),
            at_m: [
                scale.between(-0.04, 0.04),
                scale.between(-0.04, 0.04),
                scale.between(0.02, 0.14),
            ],
        },
        "sensor_drift" => {
            let slope = scale.between(0.8, 4.0);
            let force = scale.unit() * slope;
            let torque = scale.unit() * (0.03 * slope);
            let levels_off = scale.odds(0.5);
            let time = scale.between(20.0, 90.0);
            E::SensorDrift {
                force_n_per_min: force.into(),
                torque_nm_per_min: torque.into(),
                warm_up_s: levels_off.then_some(time),
            }
        }
        "axis_offset" => {
            let size = scale.between(0.015, 0.06);
            let axis = nalgebra::Vector3::from(scale.scenario.joint.axis).normalize();
            let aside = scale.unit();
            E::AxisOffset {
                shift_m: ((aside - axis * axis.dot(&aside)).normalize() * size).into(),
            }
        }
        "slip" => {
            let step = scale.unit() * scale.between(0.003, 0.012);
            let times = 2 + scale.random.below(4);
            let mut after_s: Vec<f64> = (0..times).map(|_| scale.between(3.0, 57.0)).collect();
            after_s.sort_by(f64::total_cmp);
            E::Slip {
                step_m: step.into(),
                after_s,
                lasts_s: scale.between(0.03, 0.12),
            }
        }
        _ => return None,
    })
}

fn toggle(scale: &mut Scale<'_>) -> EffectSpec {
    let arm = match scale.scenario.joint.kind {
        JointKind::Prismatic => 1.0,
        JointKind::Revolute => scale.between(0.12, 0.25),
    };
    let height: f64 = scale.between(0.06, 0.12);
    let free_length = height * scale.between(1.3, 1.8);
    let at = scale.place(0.35, 0.65);
    let wanted = scale.effort(6.0, 16.0);
    // The largest effort of a spring of 1 N/m.
    let most = (1..200)
        .map(|step| {
            let aside = 0.005 * f64::from(step) * free_length;
            let length = height.hypot(aside);
            (free_length - length).max(0.0) * aside / length * arm
        })
        .fold(0.0, f64::max);
    EffectSpec::ToggleLinkage {
        at,
        arm,
        height_m: height,
        free_length_m: free_length,
        stiffness_n_per_m: wanted / most,
    }
}
