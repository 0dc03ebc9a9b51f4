//! What the parameters of an undeclared effect may be.

use super::{refuse, within};
use crate::scenario::{EffectSpec, JointKind, Scenario, ScenarioError};

impl Scenario {
    pub(super) fn check_undeclared(&self) -> Result<(), ScenarioError> {
        for (index, effect) in self.undeclared.iter().enumerate() {
            let name = effect.name();
            if effect.is_single()
                && self.undeclared[..index]
                    .iter()
                    .any(|other| other.name() == name)
            {
                return refuse(
                    &format!("undeclared {}, effect", index + 1),
                    name,
                    "given once in a scenario",
                );
            }
            Checked {
                at: format!("undeclared {} ({name})", index + 1),
                scenario: self,
            }
            .check(effect)?;
        }
        Ok(())
    }
}

struct Checked<'a> {
    at: String,
    scenario: &'a Scenario,
}

impl Checked<'_> {
    fn within(&self, field: &str, value: f64, least: f64, most: f64) -> Result<(), ScenarioError> {
        within(&format!("{}, {field}", self.at), value, least, most)
    }

    /// A place on the way.
    fn place(&self, field: &str, value: f64) -> Result<(), ScenarioError> {
        let [closed, open] = self.scenario.joint.range;
        self.within(
            field,
            value,
            closed - (open - closed),
            open + (open - closed),
        )
    }

    fn vector(&self, field: &str, value: [f64; 3], most: f64) -> Result<(), ScenarioError> {
        for (component, axis) in value.iter().zip(["x", "y", "z"]) {
            self.within(&format!("{field} {axis}"), *component, -most, most)?;
        }
        Ok(())
    }

    fn check(&self, effect: &EffectSpec) -> Result<(), ScenarioError> {
        use EffectSpec as E;
        match *effect {
            E::Spring { rate, rest } => {
                self.within("rate", rate, 0.0, 1e4)?;
                self.within("rest", rest, -100.0, 100.0)
            }
            E::ConstantLoad { effort } => self.within("effort", effort, -1e3, 1e3),
            E::Detent { at, reach, hold } => {
                self.place("at", at)?;
                self.within("reach", reach, 1e-3, 1.0)?;
                self.within("hold", hold, 0.0, 1e3)
            }
            E::Catch { pull, reach, at } => {
                self.within("pull", pull, 0.0, 1e3)?;
                self.within("reach", reach, 1e-3, 10.0)?;
                self.place("at", at)
            }
            E::DampingZone {
                from,
                to,
                damping,
                blend,
                ..
            } => {
                self.within("from", from, -100.0, 100.0)?;
                self.within("to", to, from, 100.0)?;
                self.within("damping", damping, 0.0, 1e4)?;
                self.within("blend", blend, 1e-4, 1.0)
            }
            E::AsymmetricViscous { damping, .. } => self.within("damping", damping, 0.0, 1e4),
            E::AsymmetricCoulomb { coulomb, .. } => self.within("coulomb", coulomb, 0.0, 1e3),
            E::QuadraticDrag { drag } => self.within("drag", drag, 0.0, 1e4),
            E::Stribeck { extra, rate } => {
                self.within("extra", extra, 0.0, 1e3)?;
                self.within("rate", rate, 1e-4, 10.0)
            }
            E::Stiction { extra } => self.within("extra", extra, 0.0, 1e3),
            E::Presliding { length } => self.within("length", length, 1e-4, 0.5),
            E::PositionDependentFriction { growth, power } => {
                self.within("growth", growth, 0.0, 1e3)?;
                self.within("power", power, 0.2, 5.0)
            }
            E::Ripple {
                amplitude,
                period,
                phase_rad,
            } => {
                self.within("amplitude", amplitude, 0.0, 1e3)?;
                self.within("period", period, 1e-3, 10.0)?;
                self.within("phase_rad", phase_rad, -10.0, 10.0)
            }
            E::Gravity {
                tilt_deg,
                azimuth_deg,
            } => self.gravity(tilt_deg, azimuth_deg),
            E::ToggleLinkage {
                at,
                arm,
                height_m,
                free_length_m,
                stiffness_n_per_m,
            } => {
                self.place("at", at)?;
                self.within("arm", arm, 0.01, 2.0)?;
                self.within("height_m", height_m, 0.01, 1.0)?;
                self.within("free_length_m", free_length_m, height_m, 2.0)?;
                self.within("stiffness_n_per_m", stiffness_n_per_m, 0.0, 1e5)
            }
            E::HealingSeal { bond, heal_s, peel } => {
                self.within("bond", bond, 0.0, 1e3)?;
                self.within("heal_s", heal_s, 1e-2, 1e3)?;
                self.within("peel", peel, 1e-4, 1.0)
            }
            E::SecondLeaf {
                from,
                inertia,
                coulomb,
                stiffness,
            } => {
                self.within("from", from, 0.0, self.scenario.joint.range[1])?;
                self.within("inertia", inertia, 0.01, 1e4)?;
                self.within("coulomb", coulomb, 0.0, 1e3)?;
                let lightest = inertia.min(self.scenario.object.inertia);
                self.within("stiffness", stiffness, 1.0, 5e5 * lightest)
            }
            E::PayloadSwitch { inertia, after_s } => {
                self.within("inertia", inertia, 0.0, 1e4)?;
                self.within("after_s", after_s, 0.0, 1e5)
            }
            E::FrictionDrift {
                extra,
                seconds,
                travel,
            } => {
                self.within("extra", extra, 0.0, 1e3)?;
                self.within("seconds", seconds.unwrap_or(1.0), 0.1, 1e5)?;
                self.within("travel", travel.unwrap_or(1.0), 1e-3, 1e5)?;
                if seconds.is_none() && travel.is_none() {
                    return refuse(
                        &format!("{}, seconds", self.at),
                        seconds,
                        "given, or travel, or both",
                    );
                }
                Ok(())
            }
            _ => self.check_measurement(effect),
        }
    }

    fn check_measurement(&self, effect: &EffectSpec) -> Result<(), ScenarioError> {
        use EffectSpec as E;
        match effect {
            E::Backlash {
                gap_m,
                stiffness_n_per_m,
            } => {
                self.within("gap_m", *gap_m, 0.0, 0.05)?;
                self.within("stiffness_n_per_m", *stiffness_n_per_m, 1e3, 3e5)
            }
            E::TimeLag { lag_s } => self.within("lag_s", *lag_s, -0.2, 0.2),
            E::ToolMass { mass_kg, at_m } => {
                self.within("mass_kg", *mass_kg, 0.0, 5.0)?;
                self.vector("at_m", *at_m, 0.5)
            }
            E::SensorDrift {
                force_n_per_min,
                torque_nm_per_min,
                warm_up_s,
            } => {
                self.vector("force_n_per_min", *force_n_per_min, 50.0)?;
                self.vector("torque_nm_per_min", *torque_nm_per_min, 5.0)?;
                self.within("warm_up_s", warm_up_s.unwrap_or(1.0), 0.1, 1e5)
            }
            E::GraspCompliance {
                stiffness_n_per_m,
                damping_ratio,
            } => {
                self.within("stiffness_n_per_m", *stiffness_n_per_m, 1e3, 3e5)?;
                self.within("damping_ratio", *damping_ratio, 0.0, 3.0)
            }
            E::AxisOffset { shift_m } => self.vector("shift_m", *shift_m, 0.3),
            E::Slip {
                step_m,
                after_s,
                lasts_s,
            } => {
                self.vector("step_m", *step_m, 0.1)?;
                self.within("lasts_s", *lasts_s, 0.005, 5.0)?;
                after_s
                    .iter()
                    .try_for_each(|after| self.within("after_s", *after, 0.0, 1e5))
            }
            _ => Ok(()),
        }
    }

    fn gravity(&self, tilt_deg: f64, azimuth_deg: f64) -> Result<(), ScenarioError> {
        self.within("tilt_deg", tilt_deg, -20.0, 20.0)?;
        self.within("azimuth_deg", azimuth_deg, -360.0, 360.0)?;
        let scenario = self.scenario;
        if scenario.joint.kind == JointKind::Prismatic || scenario.object.panel_mass_kg == 0.0 {
            return refuse(
                &format!("{}, tilt_deg", self.at),
                tilt_deg,
                "on a revolute joint with object.panel_mass_kg above 0",
            );
        }
        Ok(())
    }
}
