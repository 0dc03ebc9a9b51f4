//! Free swing, as the paper's table of closing times: the simulated door against its identified twin. All is simulation.

use std::path::Path;

use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::identify_recording;
use ft_identify::simulate::{End, Release, release};
use ft_recording::TopicMap;
use ft_sim_hw::Truth;
use ft_sim_hw::scenario::MechanismSpec;

use crate::truth::record;

/// Error of inertia of a guess from appearance, as the paper gives it for its prior (macro mean; it is always too low).
const PRIOR_INERTIA_ERROR: f64 = -0.53;
/// Where the swing is timed: as far before the closed stop as the twin was probed, at least, rad.
const LAST: f64 = 0.03;

/// Closing times from one angle.
#[derive(Clone, Debug)]
pub struct Closing {
    /// The scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// Where the door was let go, deg.
    pub from_deg: f64,
    /// The simulated door's time, s; nothing when it stays open.
    pub truth: Option<f64>,
    /// The identified twin's.
    pub twin: Option<f64>,
    /// The guess's: the true springs and friction, no oil, and an inertia that is 53 % too low.
    pub prior: Option<f64>,
}

impl Closing {
    /// Relative error of a time; nothing when one of the two stays open.
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
    let truth = record(scenario, seed, file);
    let settings = MotionSettings::default();
    let identified = identify_recording(file, &TopicMap::default(), &settings, &mut |_| {})
        .unwrap_or_else(|error| panic!("{scenario} seed {seed}: {error}"));
    let twin = identified
        .twin
        .unwrap_or_else(|| panic!("{scenario} seed {seed}: no twin"));
    let (ends, twin) = (twin.joint.q_range, twin.evaluator());
    let prior = guess(&truth);
    let until = twin.domain().q[0].max(LAST);
    angles_deg
        .iter()
        .map(|&from_deg| {
            let from = from_deg.to_radians();
            let how = Release {
                from,
                until,
                step: 1e-4,
                longest: 60.0,
            };
            let swing = release(&twin, ends, &how)
                .unwrap_or_else(|error| panic!("{scenario} seed {seed}, {from_deg} deg: {error}"));
            // The twin counts from where the grasp began, the truth from the closed stop.
            let real =
                |of: &Truth| of.swing_time(from + truth.q_at_grasp, until + truth.q_at_grasp, 60.0);
            Closing {
                scenario: scenario.to_owned(),
                seed,
                from_deg,
                truth: real(&truth),
                twin: match swing.end {
                    End::Arrived { time, .. } => Some(time),
                    _ => None,
                },
                prior: real(&prior),
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
