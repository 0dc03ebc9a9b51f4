//! The gripper's part in front of the sensor, and what the sensor feels of it.
//!
//! With mass m, centre of mass c and inertia J of that part, environment on tool, axes and origin of `ft_sensor`:
//! `force = F_env + m (g - a)`, `torque = M_env + c x m (g - a) - (J dw + w x J w)`.

use nalgebra::{Isometry3, Matrix3, Vector3};

use crate::motion::RigidMotion;
use crate::scenario::ToolSpec;
use crate::world::GRAVITY;

/// What the tool does to the object, at the tool centre point, world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ContactWrench {
    /// Force on the object, N.
    pub(crate) force: Vector3<f64>,
    /// Moment on the object about the tool centre point, N m.
    pub(crate) moment: Vector3<f64>,
}

/// Mass properties and mounting of the gripper.
#[derive(Clone, Debug)]
pub(crate) struct Tool {
    mass: f64,
    com: Vector3<f64>,
    inertia: Matrix3<f64>,
    /// Takes `ft_sensor` coordinates to `tcp`.
    pub(crate) tcp_from_ft_sensor: Isometry3<f64>,
    /// Takes `tcp` coordinates to `aria_device`.
    pub(crate) aria_device_from_tcp: Isometry3<f64>,
}

impl Tool {
    /// The gripper with its usual mounting: sensor 0.172 m behind the pads, glasses above it.
    pub(crate) fn new(spec: &ToolSpec) -> Self {
        let [xx, xy, yy, xz, yz, zz] = spec.inertia_kgm2;
        let tcp_from_ft_sensor = Isometry3::new(
            Vector3::new(0.004, -0.002, -0.172),
            nalgebra::UnitQuaternion::from_euler_angles(0.012, -0.02, -0.79).scaled_axis(),
        );
        let aria_device_from_tcp = Isometry3::new(
            Vector3::new(0.031, 0.118, 0.236),
            nalgebra::UnitQuaternion::from_euler_angles(-0.36, 0.07, 1.51).scaled_axis(),
        );
        Self {
            mass: spec.mass_kg,
            com: Vector3::from(spec.com_m),
            inertia: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            tcp_from_ft_sensor,
            aria_device_from_tcp,
        }
    }

    /// What an ideal sensor reports, force then torque, axes and origin of `ft_sensor`.
    pub(crate) fn sensor_wrench(&self, tcp: &RigidMotion, contact: &ContactWrench) -> [f64; 6] {
        let world_from_sensor = tcp.rotation * self.tcp_from_ft_sensor.rotation;
        let to_sensor = tcp.rotation * self.tcp_from_ft_sensor.translation.vector;
        let acceleration = tcp.acceleration_at(to_sensor + world_from_sensor * self.com);
        let own = world_from_sensor.inverse() * ((GRAVITY - acceleration) * self.mass);
        let rate = world_from_sensor.inverse() * tcp.rate;
        let rate_change = world_from_sensor.inverse() * tcp.rate_change;
        let spin = self.inertia * rate_change + rate.cross(&(self.inertia * rate));
        let (force_env, moment_env) = (-contact.force, -contact.moment);
        let force = world_from_sensor.inverse() * force_env + own;
        let moment_at_sensor =
            world_from_sensor.inverse() * (moment_env + (-to_sensor).cross(&force_env));
        let torque = moment_at_sensor + self.com.cross(&own) - spin;
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }

    /// What a further mass at `at` (`ft_sensor` axes and origin) adds to the sensor's reading.
    pub(crate) fn wrench_of_mass(
        &self,
        tcp: &RigidMotion,
        mass: f64,
        at: Vector3<f64>,
    ) -> [f64; 6] {
        let world_from_sensor = tcp.rotation * self.tcp_from_ft_sensor.rotation;
        let to_sensor = tcp.rotation * self.tcp_from_ft_sensor.translation.vector;
        let acceleration = tcp.acceleration_at(to_sensor + world_from_sensor * at);
        let force = world_from_sensor.inverse() * ((GRAVITY - acceleration) * mass);
        let torque = at.cross(&force);
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }

    /// Inertia that the part adds to a joint when it is fixed to the object, kg m^2 about `axis` or kg.
    pub(crate) fn inertia_about(
        &self,
        tcp: &RigidMotion,
        axis: Vector3<f64>,
        point: Vector3<f64>,
    ) -> f64 {
        let world_from_sensor = tcp.rotation * self.tcp_from_ft_sensor.rotation;
        let com = tcp.position
            + tcp.rotation * self.tcp_from_ft_sensor.translation.vector
            + world_from_sensor * self.com;
        let arm = axis.cross(&(com - point)).norm();
        let own = world_from_sensor.inverse() * axis;
        self.mass * arm * arm + own.dot(&(self.inertia * own))
    }

    /// kg.
    pub(crate) fn mass(&self) -> f64 {
        self.mass
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::motion::Jet;

    fn tool() -> Tool {
        Tool::new(&ToolSpec::default())
    }

    #[test]
    fn a_still_tool_in_free_air_reads_its_weight() {
        let rotation = UnitQuaternion::from_euler_angles(0.4, -0.9, 2.0);
        let still = RigidMotion::still(Vector3::new(1.0, 2.0, 0.5), rotation);
        let [fx, fy, fz, tx, ty, tz] = tool().sensor_wrench(&still, &ContactWrench::default());
        let world_from_sensor = rotation * tool().tcp_from_ft_sensor.rotation;
        let weight = world_from_sensor.inverse() * Vector3::new(0.0, 0.0, -0.49 * 9.80665);
        assert!((Vector3::new(fx, fy, fz) - weight).norm() < 1e-12);
        let moment = Vector3::new(0.021, 0.020, 0.059).cross(&weight);
        assert!((Vector3::new(tx, ty, tz) - moment).norm() < 1e-12);
    }

    #[test]
    fn a_pull_reads_as_the_object_pulling_back() {
        let identity = RigidMotion::still(
            Vector3::zeros(),
            tool().tcp_from_ft_sensor.rotation.inverse(),
        );
        let contact = ContactWrench {
            force: Vector3::new(20.0, 0.0, 0.0),
            moment: Vector3::zeros(),
        };
        let pulled = tool().sensor_wrench(&identity, &contact);
        let free = tool().sensor_wrench(&identity, &ContactWrench::default());
        assert!(
            (pulled[0] - free[0] + 20.0).abs() < 1e-12,
            "pulling along +x reads a negative x force"
        );
    }

    #[test]
    fn the_wrench_does_the_work_that_the_energy_takes() {
        // Power of the wrench that the sensor's side puts on the part = change of its kinetic and potential energy.
        let tool = tool();
        let motion = |t: f64| {
            RigidMotion::still(
                Vector3::new(0.3, 0.1, 1.0),
                UnitQuaternion::from_euler_angles(0.3, 0.2, -0.4),
            )
            .shifted(Vector3::new(0.3, -0.5, 0.8), Jet::sine(0.1, 1.4, 0.3, t))
            .turned(Vector3::y_axis(), Jet::sine(0.7, 0.9, 0.1, t))
            .turned(Vector3::x_axis(), Jet::sine(0.6, 1.3, 1.1, t))
        };
        let energy = |t: f64| {
            let m = motion(t);
            let world_from_sensor = m.rotation * tool.tcp_from_ft_sensor.rotation;
            let lever = m.rotation * tool.tcp_from_ft_sensor.translation.vector
                + world_from_sensor * tool.com;
            let velocity = m.velocity + m.rate.cross(&lever);
            let rate = world_from_sensor.inverse() * m.rate;
            0.5 * tool.mass * velocity.norm_squared() + 0.5 * rate.dot(&(tool.inertia * rate))
                - tool.mass * GRAVITY.dot(&(m.position + lever))
        };
        for t in [0.11, 0.43, 0.79] {
            let m = motion(t);
            let world_from_sensor = m.rotation * tool.tcp_from_ft_sensor.rotation;
            let [fx, fy, fz, tx, ty, tz] = tool.sensor_wrench(&m, &ContactWrench::default());
            let lever = m.rotation * tool.tcp_from_ft_sensor.translation.vector;
            let velocity = m.velocity + m.rate.cross(&lever);
            // The sensor holds the part with the opposite of what it reports.
            let power = -(world_from_sensor * Vector3::new(fx, fy, fz)).dot(&velocity)
                - (world_from_sensor * Vector3::new(tx, ty, tz)).dot(&m.rate);
            let slope = (energy(t + 1e-5) - energy(t - 1e-5)) / 2e-5;
            assert!((power - slope).abs() < 1e-6, "{power} {slope}");
        }
    }
}
