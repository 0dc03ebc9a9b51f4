//! The paper's impedance controller opening simulated objects, its feed-forward from three sources. All is simulation.
//!
//! `f = K (x_d - x) + D (v_d - v) + (J^T)^+ tau(q_d, dq_d, ddq_d)`: the force of the hand, through delay, bandwidth and limit of
//! the arm, opens the declared object; `q_d(t)` goes from rest where the handle was grasped to rest at the goal in 6 s
//! with the least jerk. Only `tau` differs between the sources; all use the identified axis. The arm compensates its own
//! weight and friction; what its mass adds to the object's is felt, and not known to the feed-forward.

mod robots;
mod study;

use std::collections::VecDeque;
use std::path::Path;

use ft_identify::screw::{JointKind, ScrewAxis};
use ft_identify::simulate::{Demand, Opening, demand};
use ft_identify::twin::Twin;
use ft_sim_hw::scenario::JointKind as TrueKind;
use ft_sim_hw::world::{Drive, JointState, STEPS_PER_SECOND};
use ft_sim_hw::{Scenario, Truth};
use nalgebra::{Point3, Unit, Vector3};

pub use robots::{Robot, Task, robots, tasks};
pub use study::markdown;

use crate::truth::twin_of;

/// Time of an opening, s; the paper's.
pub const DURATION: f64 = 6.0;
/// Error of inertia of a guess from appearance, as the paper gives it for its prior (macro mean; it is always too low).
pub const PRIOR_INERTIA_ERROR: f64 = -0.53;
/// Less than this share of the goal is a stall.
pub const WHOLE: f64 = 0.98;

/// Where the feed-forward comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The identified twin.
    Identified,
    /// What appearance tells: an inertia that is 53 % too low, no mechanism. Friction is the true one, which flatters it:
    /// the paper gives no figure.
    Prior,
    /// None.
    Kinematics,
}

/// All of them, in the paper's order.
pub const SOURCES: [Source; 3] = [Source::Identified, Source::Prior, Source::Kinematics];

/// One attempt to open an object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Furthest coordinate over the goal, at most 1: the paper's `Complete`.
    pub complete: f64,
    /// Root mean square of `q - q_d` over the goal: the paper's `Track`.
    pub track: f64,
    /// Furthest coordinate, rad or m from where the handle was grasped.
    pub furthest: f64,
}

/// One object under one robot, with one recording's twin.
#[derive(Clone, Debug)]
pub struct Attempt {
    /// The object.
    pub object: String,
    /// The robot.
    pub robot: &'static str,
    /// Seed of the recording.
    pub seed: u64,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Goal from where the handle was grasped, rad or m.
    pub goal: f64,
    /// Largest force at the handle that the opening needs, by the twin, N.
    pub needs_n: f64,
    /// The robot's.
    pub has_n: f64,
    /// Where the twin says that the robot's force is not enough, before the attempt; rad or m.
    pub exceeds_at: Option<f64>,
    /// What happened, in the order of [`SOURCES`].
    pub trials: [Trial; 3],
}

/// Records and identifies the task's object, and lets each robot open it with each source.
///
/// # Panics
/// It cannot be recorded or identified, or its twin has no axis.
#[must_use]
pub fn attempts(task: &Task, seed: u64, file: &Path) -> Vec<Attempt> {
    attempts_by(&robots(), task, seed, file)
}

/// As [`attempts`] with other arms.
///
/// # Panics
/// As [`attempts`].
#[must_use]
pub fn attempts_by(robots: &[Robot; 2], task: &Task, seed: u64, file: &Path) -> Vec<Attempt> {
    let (truth, twin) = twin_of(&task.scenario, seed, file);
    robots
        .iter()
        .zip(task.goals)
        .map(|(robot, goal)| attempt(&task.scenario, seed, (&truth, &twin), robot, goal))
        .collect()
}

fn attempt(
    scenario: &Scenario,
    seed: u64,
    (truth, twin): (&Truth, &Twin),
    robot: &Robot,
    goal: f64,
) -> Attempt {
    let name = &scenario.name;
    let axis = identified_axis(twin).unwrap_or_else(|| panic!("{name} seed {seed}: no axis"));
    let evaluator = twin.evaluator();
    let lever = match axis.kind {
        JointKind::Revolute => twin.radius().unwrap_or(f64::NAN),
        JointKind::Prismatic => 1.0,
    };
    let opening = Opening {
        from: 0.0,
        to: goal,
        duration: DURATION,
    };
    let needed: Demand = demand(&evaluator, &opening);
    let object = &truth.object;
    let trials = SOURCES.map(|source| {
        let feed = |[q, dq, ddq]: [f64; 3]| match source {
            Source::Identified => evaluator.effort(q, dq, ddq),
            Source::Prior => {
                let sign = if dq == 0.0 { 0.0 } else { dq.signum() };
                (1.0 + PRIOR_INERTIA_ERROR) * object.inertia * ddq
                    + object.coulomb * sign
                    + object.viscous * dq
            }
            Source::Kinematics => 0.0,
        };
        open(truth, &axis, robot, &opening, &feed)
    });
    Attempt {
        object: name.clone(),
        robot: robot.name,
        seed,
        kind: axis.kind,
        goal,
        needs_n: needed.peak.abs() / lever,
        has_n: robot.force_n,
        exceeds_at: needed.exceeds(robot.force_n * lever),
        trials,
    }
}

fn identified_axis(twin: &Twin) -> Option<ScrewAxis> {
    Some(ScrewAxis {
        direction: Unit::new_normalize(Vector3::from(twin.joint.axis_direction?)),
        point: Point3::from(twin.joint.axis_point?),
        kind: twin.joint.kind,
    })
}

/// The hand on the true handle: a force that the arm holds between two ticks of its controller.
struct Hand {
    axis: ScrewAxis,
    grasp: Point3<f64>,
    force: Vector3<f64>,
    mass: f64,
}

impl Hand {
    /// Where the handle is, and how it moves per unit of dq; `q` from the closed stop.
    fn handle(&self, q: f64) -> (Point3<f64>, Vector3<f64>) {
        let at = self.axis.motion(q) * self.grasp;
        (at, self.axis.velocity_at(&at))
    }
}

impl Drive for Hand {
    fn effort(&self, at: JointState) -> f64 {
        self.handle(at.q).1.dot(&self.force)
    }
    fn inertia(&self) -> f64 {
        self.mass * self.handle(0.0).1.norm_squared()
    }
}

/// Opens the true object from where it rested when it was grasped.
fn open(
    truth: &Truth,
    axis: &ScrewAxis,
    robot: &Robot,
    opening: &Opening,
    feed: &dyn Fn([f64; 3]) -> f64,
) -> Trial {
    let start = truth.q_at_grasp;
    let mut world = truth.world(start);
    let mut hand = Hand {
        axis: ScrewAxis {
            direction: Unit::new_normalize(truth.axis_direction.into()),
            point: truth.axis_point.into(),
            kind: match truth.joint_kind {
                TrueKind::Revolute => JointKind::Revolute,
                TrueKind::Prismatic => JointKind::Prismatic,
            },
        },
        grasp: truth.grasp_position.into(),
        force: Vector3::zeros(),
        mass: robot.mass_kg,
    };
    let grasped = hand.handle(start).0;
    let steps = STEPS_PER_SECOND / robot.rate_hz;
    let tick = f64::from(steps) / f64::from(STEPS_PER_SECOND);
    let ticks = (DURATION / tick).round() as usize;
    let mut on_its_way = VecDeque::from(vec![
        Vector3::zeros();
        (robot.delay_s / tick).round() as usize
    ]);
    let follow = 1.0 - (-core::f64::consts::TAU * robot.bandwidth_hz * tick).exp();
    let (mut furthest, mut squares) = (0.0_f64, 0.0);
    for k in 0..ticks {
        let wanted = opening.at(k as f64 * tick);
        let state = world.state();
        let (x, per_rate) = hand.handle(state.q);
        let x_d = axis.motion(wanted[0]) * grasped;
        // The arm sees its own hand; where the joint's axis is it has from the twin.
        let jacobian = axis.velocity_at(&x);
        let forward = jacobian * (feed(wanted) / jacobian.norm_squared());
        let back = robot.stiffness * (x_d - x)
            + robot.damping * (axis.velocity_at(&x_d) * wanted[1] - per_rate * state.dq);
        on_its_way.push_back(limited(back + forward, robot.force_n));
        if let Some(command) = on_its_way.pop_front() {
            hand.force += follow * (command - hand.force);
        }
        squares += (state.q - start - wanted[0]).powi(2);
        furthest = furthest.max(state.q - start);
        for _ in 0..steps {
            world.step(&hand);
        }
    }
    Trial {
        complete: (furthest / opening.to).min(1.0),
        track: (squares / ticks as f64).sqrt() / opening.to,
        furthest,
    }
}

fn limited(force: Vector3<f64>, limit: f64) -> Vector3<f64> {
    force * (limit / force.norm().max(limit))
}
