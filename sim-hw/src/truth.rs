//! What is so: for tests and for judging, in a file apart from any recording.

use ft_wire::HostTime;
use serde::Serialize;

use crate::scenario::{
    EffectSpec, JointKind, MechanismSpec, ObjectSpec, PersonSpec, Scenario, SensorSpec, ToolSpec,
    TrackerSpec,
};
use crate::scene::Scene;
use crate::setting::Setting;
use crate::world::{Free, Joint, JointState, World, mechanism};

/// Everything about a simulation that a measurement is judged against. SI; poses and points in `world`.
#[derive(Clone, Debug, Serialize)]
pub struct Truth {
    /// `"ft-sim-hw/truth/1"`.
    pub schema: &'static str,
    /// The scenario's name.
    pub scenario: String,
    /// The seed.
    pub seed: u64,
    /// What the scenario mixes into it.
    pub salt: u32,
    /// Revolute or prismatic.
    pub joint_kind: JointKind,
    /// Unit direction; q grows right-handed about it or along it, opening.
    pub axis_direction: [f64; 3],
    /// The same without an undeclared lean; [`Truth::effort`] takes the panel's weight about this one.
    pub declared_axis_direction: [f64; 3],
    /// A point on the axis, m (revolute).
    pub axis_point: [f64; 3],
    /// Closed and open stop, rad or m.
    pub q_range: [f64; 2],
    /// Where the object rests when it is grasped, rad or m.
    pub q_at_grasp: f64,
    /// Tool centre point at q = 0, m.
    pub grasp_position: [f64; 3],
    /// Inertia, friction, stops, weight.
    pub object: ObjectSpec,
    /// The panel's centre of mass at q = 0 from `axis_point`, m, world axes.
    pub panel_com: [f64; 3],
    /// What else acts on the joint.
    pub mechanisms: Vec<MechanismSpec>,
    /// What no model was told of, with its parameters.
    pub undeclared: Vec<EffectSpec>,
    /// The payload as it is.
    pub tool: ToolSpec,
    /// The person.
    pub person: PersonSpec,
    /// Noise of the sensor.
    pub sensor: SensorSpec,
    /// Bias and drift as drawn.
    pub sensor_errors: SensorTruth,
    /// Noise of the tracker.
    pub tracker: TrackerSpec,
    /// The devices' clocks.
    pub clocks: Vec<ClockTruth>,
    /// Unix ns.
    pub start_ns: i64,
    /// Unix ns.
    pub free_air_begin_ns: i64,
    /// Unix ns.
    pub grasp_ns: i64,
    /// Unix ns.
    pub release_ns: i64,
    /// Unix ns.
    pub end_ns: i64,
}

/// What a sensor adds to the wrench besides noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SensorTruth {
    /// At the start; N and N m, axes of `ft_sensor`.
    pub bias: [f64; 6],
    /// N/s and N m/s.
    pub drift_per_s: [f64; 6],
}

/// A device's clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ClockTruth {
    /// Which device.
    pub device: String,
    /// What it reads at the start, s, before wrapping.
    pub reads_s: f64,
    /// How much faster than the host's it goes, parts per million.
    pub skew_ppm: f64,
}

impl Truth {
    pub(crate) fn of(
        scenario: &Scenario,
        seed: u64,
        scene: &Scene,
        start: HostTime,
        (sensor_errors, clocks): (SensorTruth, Vec<ClockTruth>),
    ) -> Self {
        let (timeline, setting) = (scene.timeline, scene.setting());
        let joint = &setting.joint;
        let instant = |t: f64| start.offset_by_seconds(t).as_nanos();
        Self {
            schema: "ft-sim-hw/truth/1",
            scenario: scenario.name.clone(),
            seed,
            salt: scenario.salt,
            joint_kind: joint.kind,
            axis_direction: joint.axis.into_inner().into(),
            declared_axis_direction: setting.declared_axis.into_inner().into(),
            axis_point: joint.point.into(),
            q_range: joint.range,
            q_at_grasp: scene.world.state().q,
            grasp_position: setting.grasp_position.into(),
            object: scenario.object.clone(),
            panel_com: joint.panel_com.into(),
            mechanisms: scenario.mechanisms.clone(),
            undeclared: scenario.undeclared.clone(),
            tool: scenario.tool.clone(),
            person: scenario.person.clone(),
            sensor: scenario.sensor.clone(),
            sensor_errors,
            tracker: scenario.tracker.clone(),
            clocks,
            start_ns: start.as_nanos(),
            free_air_begin_ns: instant(timeline.free_air_begin),
            grasp_ns: instant(timeline.grasp),
            release_ns: instant(timeline.release),
            end_ns: instant(timeline.end),
        }
    }

    /// The effort that the tool must put on the object for a motion, N m or N, by the declared parts, which have no memory.
    /// `q` counts from the closed stop; friction takes the sign of `dq`, and is left out at `dq = 0`.
    #[must_use]
    pub fn effort(&self, q: f64, dq: f64, ddq: f64) -> f64 {
        Declared::of(self.declared_joint(), self.object.clone(), &self.mechanisms)
            .effort(q, dq, ddq)
    }

    /// Time in s that the declared object, let go at rest at `from`, takes until it passes `until`; nothing when it has not
    /// after `longest` seconds. Coordinates count from the closed stop.
    #[must_use]
    pub fn swing_time(&self, from: f64, until: f64, longest: f64) -> Option<f64> {
        let mut world = self.world(from);
        let side = (from - until).signum();
        let start = world.state().t;
        while world.state().t - start < longest {
            world.step(&Free);
            if (world.state().q - until) * side <= 0.0 {
                return Some(world.state().t - start);
            }
        }
        None
    }

    /// The declared object at rest at `q` (from the closed stop), for whatever is to act on it.
    #[must_use]
    pub fn world(&self, q: f64) -> World {
        let Declared(mut world) =
            Declared::of(self.declared_joint(), self.object.clone(), &self.mechanisms);
        world.place(q, 0.0);
        world
    }

    fn declared_joint(&self) -> Joint {
        Joint {
            kind: self.joint_kind,
            axis: nalgebra::Unit::new_normalize(self.declared_axis_direction.into()),
            point: self.axis_point.into(),
            range: self.q_range,
            panel_com: self.panel_com.into(),
            axis_drift: nalgebra::Vector3::zeros(),
        }
    }
}

/// The object without anything undeclared, as an equation of motion.
#[derive(Debug)]
pub(crate) struct Declared(World);

impl Declared {
    pub(crate) fn new(scenario: &Scenario, setting: &Setting) -> Self {
        let joint = Joint {
            axis: setting.declared_axis,
            ..setting.joint.clone()
        };
        Self::of(joint, scenario.object.clone(), &scenario.mechanisms)
    }

    fn of(joint: Joint, object: ObjectSpec, mechanisms: &[MechanismSpec]) -> Self {
        let passives = mechanisms.iter().map(mechanism::build).collect();
        Self(World::new(joint, object, passives))
    }

    /// What a tool must put on the object, N m or N; without dry friction at `dq = 0`.
    pub(crate) fn effort(&self, q: f64, dq: f64, ddq: f64) -> f64 {
        let direction = if dq == 0.0 { 0.0 } else { dq.signum() };
        self.0
            .needed_effort(JointState { t: 0.0, q, dq }, ddq, direction)
    }

    /// What dry friction holds at rest.
    pub(crate) fn breakaway(&self) -> f64 {
        self.0.holding_effort(0.0)
    }
}
