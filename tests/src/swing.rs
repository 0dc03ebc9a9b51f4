//! Free swing, as the paper's table of closing times: the simulated door against its identified twin. All is simulation.
//!
//! A door goes where it goes: one with a closer shuts, the built-in oven's falls open. The oven opens to 87 degrees only and rests there,
//! so it is let go from 20 and 45 degrees.

use std::path::Path;

use ft_identify::simulate::{End, Release, release};
use ft_sim_hw::scenario::MechanismSpec;
use ft_sim_hw::{Scenario, Truth};

use crate::control::PRIOR_INERTIA_ERROR;
use crate::truth::twin_of;

/// Where the swing is timed: as far before a stop as the twin was probed, at least, rad.
const LAST: f64 = 0.03;
/// No swing takes longer, s.
const LONGEST: f64 = 60.0;
/// The built-in doors, and from where each is let go, deg.
pub const DOORS: [(&str, [f64; 2]); 3] = [
    ("wood_door", [45.0, 90.0]),
    ("metal_door", [45.0, 90.0]),
    ("oven_door", [20.0, 45.0]),
];

/// Closing times from one angle.
#[derive(Clone, Debug)]
pub struct Closing {
    /// The scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// Where the door was let go, deg.
    pub from_deg: f64,
    /// The simulated door's time, s; nothing when it stays where it is.
    pub truth: Option<f64>,
    /// The identified twin's.
    pub twin: Option<f64>,
    /// The guess's: the true springs and friction, no oil, and an inertia that is 53 % too low.
    pub prior: Option<f64>,
}

impl Closing {
    /// Relative error of a time; nothing when one of the two stays where it is.
    #[must_use]
    pub fn error(&self, time: Option<f64>) -> Option<f64> {
        Some((time? / self.truth? - 1.0).abs())
    }
}

/// Records and identifies a door, and lets door, twin and guess go from each angle.
///
/// # Panics
/// The scenario cannot be recorded or identified.
#[must_use]
pub fn closings(scenario: &str, seed: u64, angles_deg: &[f64], file: &Path) -> Vec<Closing> {
    let loaded = Scenario::load(scenario).unwrap_or_else(|error| panic!("{scenario}: {error}"));
    let (truth, twin) = twin_of(&loaded, seed, file);
    let (ends, twin) = (twin.joint.q_range, twin.evaluator());
    let prior = guess(&truth);
    let [low, high] = twin.domain().q;
    let open_stop = truth.q_range[1] - truth.q_at_grasp;
    let stops = [low.max(LAST), high.min(open_stop - LAST)];
    // The twin counts from where the grasp began, the truth from the closed stop.
    let real = |of: &Truth, from: f64, until: f64| {
        of.swing_time(from + truth.q_at_grasp, until + truth.q_at_grasp, LONGEST)
    };
    angles_deg
        .iter()
        .map(|&from_deg| {
            let from = from_deg.to_radians();
            let until = stops
                .into_iter()
                .find(|until| real(&truth, from, *until).is_some())
                .unwrap_or(stops[0]);
            let how = Release {
                from,
                until,
                step: 1e-4,
                longest: LONGEST,
            };
            let swing = release(&twin, ends, &how)
                .unwrap_or_else(|error| panic!("{scenario} seed {seed}, {from_deg} deg: {error}"));
            Closing {
                scenario: scenario.to_owned(),
                seed,
                from_deg,
                truth: real(&truth, from, until),
                twin: match swing.end {
                    End::Arrived { time, .. } => Some(time),
                    _ => None,
                },
                prior: real(&prior, from, until),
            }
        })
        .collect()
}

fn guess(truth: &Truth) -> Truth {
    let mut prior = truth.clone();
    prior.object.inertia *= 1.0 + PRIOR_INERTIA_ERROR;
    for mechanism in &mut prior.mechanisms {
        if let MechanismSpec::Closer { zones, .. } = mechanism {
            zones.clear();
        }
    }
    prior
}
