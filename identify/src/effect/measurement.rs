//! Effects of the measurement: time, sensor, load, grasp.

use super::library::{Belongs, Kind, LONGEST_DRIFT, Search, Unit, Variable, even, geometric};
use super::memory;
use crate::least_squares::Bound::{Free, NonNegative};
use crate::least_squares::rms;

/// `tau_measured(t) = tau(t - lag)`; to first order `-lag dtau/dt`. Refined by really shifting the effort.
pub const TIME_LAG: Kind = Kind {
    name: "time_lag",
    belongs: Belongs::Recording,
    equation: "measured tau(t) = tau(t - lag)",
    terms: &[("lag", Unit::Time, Free)],
    shape: &[],
    variable: Variable::Ddq,
    grid: |_| vec![vec![]],
    series: |scope, _| {
        let slope = scope.motion.derivative(&scope.motion.tau);
        vec![slope.into_iter().map(|v| -v).collect()]
    },
    at: None,
    separate: "sharp taps, and a hand-shake in free air: a lag is there too, compliance is not",
};

/// `tau = inertia ddq` from a time on: something was put in or taken out.
pub const PAYLOAD_SWITCH: Kind = Kind {
    name: "payload_switch",
    belongs: Belongs::Recording,
    equation: "tau = inertia ddq from the time at on",
    terms: &[("inertia", Unit::Inertia, Free)],
    shape: &[("at", Unit::Time, Search::Seconds(2.0))],
    variable: Variable::Ddq,
    grid: |scope| {
        let motion = scope.motion;
        let start = motion.time.first().copied().unwrap_or(0.0);
        even(0.1, 0.9, 25)
            .into_iter()
            .map(|share| vec![start + share * scope.duration()])
            .collect()
    },
    series: |scope, shape| {
        let motion = scope.motion;
        vec![
            motion
                .ddq
                .iter()
                .zip(&motion.time)
                .map(|(a, t)| if *t >= shape[0] { *a } else { 0.0 })
                .collect(),
        ]
    },
    at: None,
    separate: "the same quick strokes before and after",
};

/// `tau = start + rise (1 - exp(-t / time)) / (1 - exp(-whole / time))`: the sensor's zero goes away as it warms up, by `rise` over the `whole`
/// recording.
pub const SENSOR_DRIFT: Kind = Kind {
    name: "sensor_drift",
    belongs: Belongs::Recording,
    equation: "tau = start + rise (1 - exp(-t / time)) / (1 - exp(-whole / time)), whole = the recording's length",
    terms: &[("rise", Unit::Effort, Free), ("start", Unit::Effort, Free)],
    shape: &[("time", Unit::Time, Search::Drift)],
    variable: Variable::Time,
    grid: |scope| {
        geometric(0.15 * scope.duration(), LONGEST_DRIFT * scope.duration(), 5)
            .into_iter()
            .map(|time| vec![time])
            .collect()
    },
    series: |scope, shape| {
        let start = scope.motion.time.first().copied().unwrap_or(0.0);
        let since = scope.motion.time.iter();
        let gone = |t: f64| -(-t / shape[0]).exp_m1();
        let whole = gone(scope.duration()).max(f64::MIN_POSITIVE);
        vec![
            since.map(|t| gone(t - start) / whole).collect(),
            scope.by_state(|_, _, _| 1.0),
        ]
    },
    at: None,
    separate: "free air before the grasp and after the release",
};

/// A mass that was put on the tool after the free air: to a held object it is inertia and weight, so that free air after the
/// release alone shows it ([`crate::payload::Payload::after_release`]). Taken out of the effort, no regressor.
pub const TOOL_MASS: Kind = Kind {
    name: "tool_mass",
    belongs: Belongs::Recording,
    equation: "mass in front of the sensor that the free air before did not have",
    terms: &[],
    shape: &[("mass", Unit::Mass, Search::Fixed)],
    variable: Variable::Ddq,
    grid: |_| vec![],
    series: |_, _| vec![],
    at: None,
    separate: "shaking the tool in free air with everything on it that it has in contact",
};

/// The object stands at `q - x`, `x + retardation dx/dt = compliance tau`: pads and fingers give, rubber the slower the more it damps. One regressor,
/// the difference that this makes with the object as far as it is known; its term should be near 1.
///
/// # Source
/// The Kelvin-Voigt solid; Flügge, *Viscoelasticity*, 1975, chapter 1.
pub const GRASP_COMPLIANCE: Kind = Kind {
    name: "grasp_compliance",
    belongs: Belongs::Recording,
    equation: "the object is at q - x, x + retardation dx/dt = share compliance tau",
    terms: &[("share", Unit::One, NonNegative)],
    shape: &[
        ("compliance", Unit::Compliance, Search::ByShare),
        ("retardation", Unit::Time, RETARDATION),
    ],
    variable: Variable::Ddq,
    grid: |scope| {
        let effort = rms(&scope.motion.tau).max(1e-12);
        geometric(0.0005, 0.04, 8)
            .into_iter()
            .map(|share| vec![share * scope.range() / effort, USUAL_RETARDATION_S])
            .collect()
    },
    series: |scope, shape| vec![memory::given(scope, shape)],
    at: None,
    separate: "a firmer grasp, or pulling against a locked joint",
};

/// How much later pads give, s: less is as good as none, more than rubber has, and a wrench that is late by as much.
pub(super) const RETARDATION: Search = Search::Lasting(3e-4, 0.03);
/// Where it is looked for first, s.
pub(super) const USUAL_RETARDATION_S: f64 = 0.003;
