//! What a scenario's values may be.

mod effect;

use super::{JointKind, MechanismSpec, Scenario, ScenarioError, SensorDriver, StrutSpec};
use crate::robotous::Model;
use crate::{kunwei_kwr75, leptrino, optoforce};

fn refuse<T>(
    key: &str,
    value: impl std::fmt::Debug,
    allowed: impl Into<String>,
) -> Result<T, ScenarioError> {
    Err(ScenarioError::Value {
        key: key.to_owned(),
        value: format!("{value:?}"),
        allowed: allowed.into(),
    })
}

fn within(key: &str, value: f64, least: f64, most: f64) -> Result<(), ScenarioError> {
    if (least..=most).contains(&value) {
        Ok(())
    } else {
        refuse(key, value, format!("from {least} to {most}"))
    }
}

fn direction(key: &str, value: [f64; 3]) -> Result<(), ScenarioError> {
    let length = value
        .iter()
        .map(|component| component * component)
        .sum::<f64>()
        .sqrt();
    if length > 1e-6 && length.is_finite() {
        Ok(())
    } else {
        refuse(key, value, "three numbers, not all zero")
    }
}

fn point(key: &str, value: [f64; 3]) -> Result<(), ScenarioError> {
    if value.iter().all(|component| component.abs() <= 1e3) {
        Ok(())
    } else {
        refuse(key, value, "within 1000 m")
    }
}

impl Scenario {
    pub(super) fn check(&self) -> Result<(), ScenarioError> {
        self.check_object()?;
        self.check_grasp()?;
        for (index, mechanism) in self.mechanisms.iter().enumerate() {
            check_mechanism(
                &format!("mechanism {}", index + 1),
                mechanism,
                self.joint.kind,
            )?;
        }
        self.check_undeclared()?;
        self.check_sensor()?;
        self.check_person_and_tool()
    }

    fn check_object(&self) -> Result<(), ScenarioError> {
        let object = &self.object;
        direction("joint.axis", self.joint.axis)?;
        point("joint.point", self.joint.point)?;
        let [closed, open] = self.joint.range;
        if !(open - closed >= 0.05 && open - closed <= 10.0 && closed == 0.0) {
            return refuse(
                "joint.range",
                self.joint.range,
                "0 and then an opening from 0.05 to 10 (rad or m)",
            );
        }
        within("object.inertia", object.inertia, 0.01, 1e4)?;
        within("object.coulomb", object.coulomb, 0.0, 1e3)?;
        if let Some(breakaway) = object.breakaway {
            within("object.breakaway", breakaway, object.coulomb, 1e3)?;
        }
        within("object.viscous", object.viscous, 0.0, 1e4)?;
        // 8 kHz steps follow a stop up to about a tenth of the step rate.
        within(
            "object.stop_stiffness",
            object.stop_stiffness,
            1.0,
            5e5 * object.inertia,
        )?;
        within(
            "object.stop_damping",
            object.stop_damping,
            0.0,
            1e3 * object.inertia,
        )?;
        within("object.panel_mass_kg", object.panel_mass_kg, 0.0, 1e3)?;
        point("object.panel_com_m", object.panel_com_m)
    }

    fn check_grasp(&self) -> Result<(), ScenarioError> {
        point("grasp.tcp_point", self.grasp.tcp_point)?;
        direction("grasp.approach", self.grasp.approach)?;
        within("grasp.roll_deg", self.grasp.roll_deg, -360.0, 360.0)?;
        within(
            "grasp.handle_width_m",
            self.grasp.handle_width_m,
            0.018,
            0.12,
        )?;
        if self.joint.kind == JointKind::Revolute {
            let lever = crate::world::joint::distance_to_axis(
                self.joint.point,
                self.joint.axis,
                self.grasp.tcp_point,
            );
            if lever < 0.05 {
                return refuse(
                    "grasp.tcp_point",
                    self.grasp.tcp_point,
                    "at least 0.05 m away from the joint's axis",
                );
            }
        }
        Ok(())
    }

    fn check_sensor(&self) -> Result<(), ScenarioError> {
        let sensor = &self.sensor;
        match sensor.driver {
            SensorDriver::BotaSerial => within("sensor.rate_hz", sensor.rate_hz, 12.5, 1000.0)?,
            SensorDriver::KunweiKwr75 => {
                let only = kunwei_kwr75::RATE_HZ;
                within("sensor.rate_hz", sensor.rate_hz, only, only)?;
            }
            SensorDriver::Leptrino => {
                let most = leptrino::MAX_RATE_HZ;
                within("sensor.rate_hz", sensor.rate_hz, 1.0, most)?;
            }
            SensorDriver::AtiNetcanoem => within("sensor.rate_hz", sensor.rate_hz, 1.0, 800.0)?,
            SensorDriver::OptoforceSerial | SensorDriver::OptoforceCan => {
                if !optoforce::has_rate(sensor.rate_hz) {
                    return refuse(
                        "sensor.rate_hz",
                        sensor.rate_hz,
                        format!("one of {}", optoforce::rates_text()),
                    );
                }
            }
            SensorDriver::RobotousCan | SensorDriver::RobotousUart => {
                let Some(model) = Model::named(&sensor.model) else {
                    return refuse(
                        "sensor.model",
                        &sensor.model,
                        format!("one of {}", Model::names().join(", ")),
                    );
                };
                if model.rate_code(sensor.rate_hz).is_none() {
                    return refuse(
                        "sensor.rate_hz",
                        sensor.rate_hz,
                        format!("one of {}", model.rates_text()),
                    );
                }
            }
        }
        within("sensor.force_noise_n", sensor.force_noise_n, 0.0, 50.0)?;
        within("sensor.torque_noise_nm", sensor.torque_noise_nm, 0.0, 5.0)?;
        within("sensor.force_bias_n", sensor.force_bias_n, 0.0, 100.0)?;
        within("sensor.torque_bias_nm", sensor.torque_bias_nm, 0.0, 10.0)?;
        within(
            "sensor.force_drift_n_per_min",
            sensor.force_drift_n_per_min,
            0.0,
            50.0,
        )?;
        for (key, clock) in [
            ("sensor.clock", &sensor.clock),
            ("tracker.clock", &self.tracker.clock),
        ] {
            within(&format!("{key}.skew_ppm"), clock.skew_ppm, -1000.0, 1000.0)?;
            within(
                &format!("{key}.reads_s"),
                clock.reads_s.unwrap_or(0.0),
                0.0,
                1e9,
            )?;
        }
        for (key, link) in [
            ("sensor.link", &sensor.link),
            ("tracker.link", &self.tracker.link),
        ] {
            within(&format!("{key}.burst_ms"), link.burst_ms, 0.0, 255.0)?;
            within(&format!("{key}.delay_ms"), link.delay_ms, 0.0, 1000.0)?;
        }
        within("tracker.rate_hz", self.tracker.rate_hz, 10.0, 2000.0)?;
        within("tracker.white_m", self.tracker.white_m, 0.0, 0.1)?;
        within("tracker.white_deg", self.tracker.white_deg, 0.0, 10.0)?;
        within("tracker.wander_m", self.tracker.wander_m, 0.0, 1.0)?;
        within("tracker.wander_deg", self.tracker.wander_deg, 0.0, 10.0)?;
        within("tracker.wander_s", self.tracker.wander_s, 0.1, 1e4)?;
        if !(1..=252).contains(&self.gripper.id) {
            return refuse("gripper.id", self.gripper.id, "from 1 to 252");
        }
        if crate::dynamixel::baud_code(self.gripper.baud_bps).is_none() {
            return refuse(
                "gripper.baud_bps",
                self.gripper.baud_bps,
                crate::dynamixel::BAUDS_TEXT,
            );
        }
        within("gripper.rate_hz", self.gripper.rate_hz, 1.0, 500.0)?;
        within("gripper.jitter_m", self.gripper.jitter_m, 0.0, 0.005)
    }

    fn check_person_and_tool(&self) -> Result<(), ScenarioError> {
        let person = &self.person;
        within(
            "person.stiffness_n_per_m",
            person.stiffness_n_per_m,
            50.0,
            5000.0,
        )?;
        within("person.damping_ratio", person.damping_ratio, 0.05, 3.0)?;
        within("person.moving_mass_kg", person.moving_mass_kg, 0.0, 20.0)?;
        within("person.max_force_n", person.max_force_n, 5.0, 500.0)?;
        within("person.top_speed_m_s", person.top_speed_m_s, 0.05, 3.0)?;
        within("person.shake_m_s2", person.shake_m_s2, 0.5, 30.0)?;
        within("person.free_air_s", person.free_air_s, 4.0, 3600.0)?;
        within("person.tremor_n", person.tremor_n, 0.0, 10.0)?;
        within(
            "person.off_axis_force_n",
            person.off_axis_force_n,
            0.0,
            50.0,
        )?;
        within(
            "person.off_axis_torque_nm",
            person.off_axis_torque_nm,
            0.0,
            10.0,
        )?;
        within(
            "person.about_axis_torque_nm",
            person.about_axis_torque_nm,
            0.0,
            5.0,
        )?;
        within("tool.mass_kg", self.tool.mass_kg, 0.0, 10.0)?;
        for (component, name) in self.tool.com_m.iter().zip(["x", "y", "z"]) {
            within(&format!("tool.com_m {name}"), *component, -0.5, 0.5)?;
        }
        let [xx, _, yy, _, _, zz] = self.tool.inertia_kgm2;
        if [xx, yy, zz]
            .iter()
            .any(|moment| !(0.0..=1.0).contains(moment))
        {
            return refuse(
                "tool.inertia_kgm2",
                self.tool.inertia_kgm2,
                "xx xy yy xz yz zz with moments from 0 to 1",
            );
        }
        Ok(())
    }
}

fn check_mechanism(
    name: &str,
    mechanism: &MechanismSpec,
    kind: JointKind,
) -> Result<(), ScenarioError> {
    let key = |field: &str| format!("{name}, {field}");
    match mechanism {
        MechanismSpec::Closer {
            preload,
            rate,
            blend,
            relief,
            zones,
        } => {
            within(&key("preload"), *preload, 0.0, 1e3)?;
            within(&key("rate"), *rate, 0.0, 1e4)?;
            within(&key("blend"), *blend, 1e-4, 1.0)?;
            within(&key("relief"), relief.unwrap_or(1.0), 0.1, 1e4)?;
            for zone in zones {
                within(&key("zones.damping"), zone.damping, 0.0, 1e4)?;
                within(&key("zones.to"), zone.to, zone.from, 100.0)?;
            }
            Ok(())
        }
        MechanismSpec::SpringHinge { preload, rate } => {
            within(&key("preload"), *preload, 0.0, 1e3)?;
            within(&key("rate"), *rate, 0.0, 1e4)
        }
        MechanismSpec::Catch { pull, reach } => {
            within(&key("pull"), *pull, 0.0, 1e3)?;
            within(&key("reach"), *reach, 1e-3, 10.0)
        }
        MechanismSpec::GasSpring {
            force_n,
            rate_n_per_m,
            damping,
            strut,
        } => {
            within(&key("force_n"), *force_n, 0.0, 1e4)?;
            within(&key("rate_n_per_m"), *rate_n_per_m, 0.0, 1e5)?;
            within(&key("damping"), *damping, 0.0, 1e4)?;
            check_strut(name, strut, kind)
        }
        MechanismSpec::Counterbalance {
            stiffness_n_per_m,
            free_length_m,
            strut,
        } => {
            within(&key("stiffness_n_per_m"), *stiffness_n_per_m, 0.0, 1e5)?;
            within(&key("free_length_m"), *free_length_m, 0.0, 10.0)?;
            check_strut(name, strut, kind)
        }
    }
}

fn check_strut(name: &str, strut: &StrutSpec, kind: JointKind) -> Result<(), ScenarioError> {
    if kind == JointKind::Prismatic {
        return refuse(&format!("{name}, strut"), strut, "on a revolute joint");
    }
    within(
        &format!("{name}, strut.frame_radius_m"),
        strut.frame_radius_m,
        0.01,
        10.0,
    )?;
    within(
        &format!("{name}, strut.part_radius_m"),
        strut.part_radius_m,
        0.01,
        10.0,
    )?;
    if (strut.frame_radius_m - strut.part_radius_m).abs() < 1e-3 {
        return refuse(
            &format!("{name}, strut.part_radius_m"),
            strut.part_radius_m,
            "different from frame_radius_m",
        );
    }
    Ok(())
}
