//! World, person and tool together: what is true at an instant.

use crate::hold::{Grasp, Hold};
use crate::measurement::Measurement;
use crate::motion::{Jet, RigidMotion};
use crate::person::contact::Grip;
use crate::person::free_air::FreeAir;
use crate::person::plan::{self, Occasion, Segment};
use crate::person::{Hand, Person};
use crate::random::{Random, Stream};
use crate::scenario::{Scenario, ScenarioError};
use crate::setting::Setting;
use crate::tool::{ContactWrench, Tool};
use crate::world::{Drive, Free, Moment, Passive, STEPS_PER_SECOND, World, effect, mechanism};

/// Seconds from the start of the simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Timeline {
    pub(crate) free_air_begin: f64,
    pub(crate) grasp: f64,
    pub(crate) release: f64,
    pub(crate) end: f64,
}

const LEAD_IN_S: f64 = 2.0;
const PROBING_S: f64 = 60.0;
const TAIL_S: f64 = 1.0;
const LEAST_S: f64 = 4.0;

impl Timeline {
    /// The parts of a run that lasts `seconds` in all, or of one with a minute of probing, with as long a free-air part.
    pub(crate) fn lasting(seconds: Option<f64>, free_air_s: f64) -> Result<Self, ScenarioError> {
        let around = LEAD_IN_S + free_air_s + TAIL_S;
        let total = seconds.unwrap_or(around + PROBING_S);
        if total.is_nan() || total < LEAST_S {
            return Err(ScenarioError::TooShort {
                asked_s: total,
                least_s: LEAST_S,
            });
        }
        // At least half of a short run is probing.
        let share = seconds.map_or(1.0, |total| (0.5 * total / around).min(1.0));
        let on_step =
            |t: f64| (t * f64::from(STEPS_PER_SECOND)).round() / f64::from(STEPS_PER_SECOND);
        Ok(Self {
            free_air_begin: on_step(share * LEAD_IN_S),
            grasp: on_step(share * (LEAD_IN_S + free_air_s)),
            release: on_step(total - share * TAIL_S),
            end: total,
        })
    }

    fn free_air_seconds(&self) -> [f64; 2] {
        [self.free_air_begin, self.grasp]
    }
}

#[derive(Debug)]
enum Phase {
    Before,
    Held(Box<Hold>),
    After(RigidMotion),
}

/// What is true at an instant.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    /// The tool centre point.
    pub(crate) tcp: RigidMotion,
    /// What an ideal sensor reports.
    pub(crate) wrench: [f64; 6],
    /// The joint's motion and the effort on it.
    pub(crate) moment: Moment,
    /// Where the hand is in the joint's coordinate; the joint itself while nobody holds it.
    pub(crate) hand: Jet,
}

#[derive(Debug)]
pub(crate) struct Scene {
    pub(crate) world: World,
    pub(crate) tool: Tool,
    pub(crate) timeline: Timeline,
    setting: Setting,
    phase: Phase,
    plan: Vec<Segment>,
    hand: Hand,
    grip: Grip,
    free_air: FreeAir,
    handle_width: f64,
    grasp: Grasp,
    measurement: Measurement,
}

impl Scene {
    pub(crate) fn new(
        scenario: &Scenario,
        seed: u64,
        seconds: Option<f64>,
    ) -> Result<Self, ScenarioError> {
        let timeline = Timeline::lasting(seconds, scenario.person.free_air_s)?;
        let seed = scenario.salted(seed);
        let setting = Setting::draw(scenario, &mut Random::new(seed, Stream::Setting));
        let (object, undeclared) = (&scenario.object, &scenario.undeclared);
        let mut passives: Vec<Box<dyn Passive>> =
            scenario.mechanisms.iter().map(mechanism::build).collect();
        let open = scenario.joint.range[1];
        passives.extend(effect::build(undeclared, object, open, timeline.grasp));
        let object = effect::without_bristles(undeclared, object);
        let mut world = World::new(setting.joint.clone(), object, passives);
        world.settle()?;
        let measurement = Measurement::new(undeclared);
        let tool = Tool::new(&scenario.tool);
        let mut random = Random::new(seed, Stream::Person);
        let at_grasp = setting.carry(Jet::constant(world.state().q));
        let inertia = hand_inertia(scenario, &setting, &tool, &at_grasp);
        let hand = Hand::new(
            &scenario.person,
            setting.lever(),
            scenario.object.inertia,
            inertia,
            &mut random,
        );
        let occasion = occasion(scenario, &setting, &world, inertia);
        let probing = timeline.release - timeline.grasp;
        Ok(Self {
            plan: plan::protocol(&occasion, probing, &mut Random::new(seed, Stream::Plan)),
            grip: Grip::new(
                &scenario.person,
                [timeline.grasp, timeline.release],
                &mut Random::new(seed, Stream::OffAxis),
            ),
            free_air: FreeAir::new(
                at_grasp.position,
                at_grasp.rotation,
                timeline.free_air_seconds(),
                &mut random,
            ),
            handle_width: scenario.grasp.handle_width_m,
            grasp: Grasp::new(undeclared, &setting, timeline.grasp),
            measurement,
            phase: Phase::Before,
            hand,
            world,
            tool,
            timeline,
            setting,
        })
    }

    /// Moves on to the first step that ends at or after `t` seconds.
    pub(crate) fn advance_to(&mut self, t: f64) {
        while self.world.state().t < t {
            self.begin_step();
            match &self.phase {
                Phase::Held(hold) => self.world.step(hold.as_ref()),
                _ => self.world.step(&Free),
            }
            if self.measurement.remembers() {
                let t = self.world.state().t;
                let sight = self.sight(t);
                self.measurement.remember(t, sight);
            }
        }
    }

    fn begin_step(&mut self) {
        let state = self.world.state();
        match &mut self.phase {
            Phase::Before if state.t >= self.timeline.grasp => {
                let person =
                    Person::grasping(self.hand.clone(), std::mem::take(&mut self.plan), state);
                let mut hold = Hold::new(person, self.grasp.clone(), state);
                hold.begin_step(state);
                self.phase = Phase::Held(Box::new(hold));
            }
            Phase::Held(hold) if state.t >= self.timeline.release => {
                let hand = hold.hand(Jet::constant(state.q), state.t);
                let held = hold.tcp(&self.setting, Jet::constant(hand.value), state.t);
                self.phase = Phase::After(held);
            }
            Phase::Held(hold) => hold.begin_step(state),
            _ => {}
        }
    }

    /// What is true at `t`, which lies in the last step.
    pub(crate) fn sight(&self, t: f64) -> Sight {
        let drive: &dyn Drive = match &self.phase {
            Phase::Held(hold) => hold.as_ref(),
            _ => &Free,
        };
        let moment = self.world.moment(drive, t);
        let mut hand = Jet {
            value: moment.state.q,
            rate: moment.state.dq,
            rate_change: moment.ddq,
        };
        let (tcp, contact) = match &self.phase {
            Phase::Before => (self.free_air.before(t), ContactWrench::default()),
            Phase::After(held) => (
                self.free_air.after(held, self.timeline.release, t),
                ContactWrench::default(),
            ),
            Phase::Held(hold) => {
                hand = hold.hand(hand, t);
                let tcp = hold.tcp(&self.setting, hand, t);
                let joint = self.setting.joint_at(moment.state.q);
                let contact = self
                    .grip
                    .wrench(&joint, tcp.position, moment.tool_effort, t);
                (tcp, contact)
            }
        };
        let mut wrench = self.tool.sensor_wrench(&tcp, &contact);
        if let (Some((mass, at)), false) = (
            self.measurement.attached,
            matches!(self.phase, Phase::Before),
        ) {
            let added = self.tool.wrench_of_mass(&tcp, mass, at);
            wrench = std::array::from_fn(|axis| wrench[axis] + added[axis]);
        }
        Sight {
            tcp,
            wrench,
            moment,
            hand,
        }
    }

    /// What a sensor without noise and bias feels at `t`, which lies in the last step.
    pub(crate) fn felt(&self, t: f64) -> [f64; 6] {
        self.measurement.felt(&self.sight(t), t)
    }

    /// What a tracker without noise sees at `t`, which lies in the last step.
    pub(crate) fn seen(&self, t: f64) -> Sight {
        self.measurement.seen(&self.sight(t), t)
    }

    /// Both at once.
    pub(crate) fn perceived(&self, t: f64) -> ([f64; 6], Sight) {
        let sight = self.sight(t);
        let measurement = &self.measurement;
        (measurement.felt(&sight, t), measurement.seen(&sight, t))
    }

    /// Jaw opening and its rate at `t`, m and m/s.
    pub(crate) fn jaw(&self, t: f64) -> (f64, f64) {
        let wide = self.handle_width.max(0.085);
        let closing = Jet::rise(t - (self.timeline.grasp - 0.35), 0.35);
        let opening = Jet::rise(t - self.timeline.release, 0.35);
        let closed = closing
            .plus(opening.scaled(-1.0))
            .scaled(self.handle_width - wide);
        (wide + closed.value, closed.rate)
    }

    /// Whether the jaws hold the handle at `t`.
    pub(crate) fn holds(&self, t: f64) -> bool {
        (self.timeline.grasp..self.timeline.release).contains(&t)
    }

    pub(crate) fn setting(&self) -> &Setting {
        &self.setting
    }
}

/// What hand and gripper add to the joint's inertia.
fn hand_inertia(
    scenario: &Scenario,
    setting: &Setting,
    tool: &Tool,
    at_grasp: &RigidMotion,
) -> f64 {
    let lever = setting.lever();
    let moving = scenario.person.moving_mass_kg * lever * lever;
    match setting.joint.kind {
        crate::scenario::JointKind::Prismatic => moving + tool.mass(),
        crate::scenario::JointKind::Revolute => {
            moving
                + tool.inertia_about(
                    at_grasp,
                    setting.joint.axis.into_inner(),
                    setting.joint.point,
                )
        }
    }
}

fn occasion(scenario: &Scenario, setting: &Setting, world: &World, hand_inertia: f64) -> Occasion {
    let person = &scenario.person;
    let lever = setting.lever();
    let [closed, open] = setting.joint.range;
    let by_strength = 0.7 * person.max_force_n * lever / (scenario.object.inertia + hand_inertia);
    let goes = |q: f64, direction: f64| {
        direction * world.standing_effort(q) > 1.3 * world.holding_effort(q)
    };
    let (nearly_open, nearly_closed) = (
        closed + 0.85 * (open - closed),
        closed + 0.2 * (open - closed),
    );
    let goes_by_itself = if goes(nearly_open, -1.0) {
        Some(nearly_open)
    } else {
        goes(nearly_closed, 1.0).then_some(nearly_closed)
    };
    Occasion {
        closed: world.state().q,
        open,
        top_rate: person.top_speed_m_s / lever,
        peak_acceleration: (person.shake_m_s2 / lever).min(by_strength),
        goes_by_itself,
    }
}

#[cfg(test)]
mod tests;
#[cfg(test)]
mod undeclared_tests;
