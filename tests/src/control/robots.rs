//! Two arms and what each has to open.
//!
//! What is published, and what is assumed:
//! - Franka-like. Published ("Control Interface Specification and Robot Limits", frankarobotics.github.io): 87 N m on each of the
//!   first four joints, 1 kHz. With the reach of 0.855 m of the maker's data sheet the first joint gives 87 / 0.855 = 102 N at the hand in
//!   every posture, which is taken for the limit.
//! - Spot-like. Published ("Supplemental Data" of the joint control documentation, dev.bostondynamics.com): motors of 0.89 N m behind 1:101 in
//!   the shoulder, 90 N m, so some 91 N for an instant at a reach of about 0.98 m. What it can hold is less. ASSUMED: 49 N, the continuous
//!   lift of 5 kg that the maker's brochure gives as far as is known here; the document itself was not at hand.
//! - ASSUMED for both, since no public document gives them: delay, bandwidth of the force, the hand's mass, and the
//!   stiffness and damping of the "fixed controller". The paper's own rows without feed-forward bound its stiffness: where
//!   they stall below 5 %, stiffness times the way to the goal is less than what the mechanism asks for.
//! - ASSUMED: the goals ("embodiment-specific" in the paper). An arm on a table pulls a handle some 0.3 m; a walking robot takes a
//!   door to 90 degrees.

use ft_sim_hw::Scenario;
use ft_sim_hw::scenario::MechanismSpec;

/// An arm under a Cartesian impedance controller, as the object feels it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Robot {
    /// Its name.
    pub name: &'static str,
    /// Largest force of the hand, N.
    pub force_n: f64,
    /// N/m, the same in all directions.
    pub stiffness: f64,
    /// N s/m.
    pub damping: f64,
    /// Controller's ticks per second; divides 8000.
    pub rate_hz: u32,
    /// From a measurement to the force, s.
    pub delay_s: f64,
    /// Corner of the first-order lag with which the force follows its command, Hz.
    pub bandwidth_hz: f64,
    /// Mass of the hand as the handle feels it, kg.
    pub mass_kg: f64,
}

/// An object, and how far each robot is to open it, rad or m, in the order of [`robots`].
#[derive(Clone, Debug)]
pub struct Task {
    /// The object.
    pub scenario: Scenario,
    /// Goals.
    pub goals: [f64; 2],
}

/// The two arms.
#[must_use]
pub fn robots() -> [Robot; 2] {
    [
        Robot {
            name: "Spot-like",
            force_n: 49.0,
            stiffness: 60.0,
            damping: 40.0,
            rate_hz: 250,
            delay_s: 0.02,
            bandwidth_hz: 5.0,
            mass_kg: 2.0,
        },
        Robot {
            name: "Franka-like",
            force_n: 102.0,
            stiffness: 100.0,
            damping: 40.0,
            rate_hz: 1000,
            delay_s: 0.002,
            bandwidth_hz: 20.0,
            mass_kg: 3.0,
        },
    ]
}

/// Five objects as in the paper: drawer (weak mechanism), sliding door (none), wood door (medium), oven and metal door (strong).
///
/// The built-in oven is balanced and easy; the paper's is "strong". So a spring of 12 N m and 3 N m/rad is added to it.
///
/// # Panics
/// A built-in scenario is missing.
#[must_use]
pub fn tasks() -> Vec<Task> {
    let builtin =
        |name: &str| Scenario::builtin(name).unwrap_or_else(|error| panic!("{name}: {error}"));
    let mut oven = builtin("oven_door");
    oven.name = "strong_oven".to_owned();
    oven.mechanisms.push(MechanismSpec::SpringHinge {
        preload: 12.0,
        rate: 3.0,
    });
    let deg = f64::to_radians;
    let task = |scenario: Scenario, goals: [f64; 2]| Task { scenario, goals };
    vec![
        task(builtin("drawer_light"), [0.35, 0.3]),
        task(builtin("sliding_door"), [0.6, 0.3]),
        task(builtin("wood_door"), [deg(90.0), deg(20.0)]),
        task(oven, [deg(60.0), deg(40.0)]),
        task(builtin("metal_door"), [deg(90.0), deg(20.0)]),
    ]
}
