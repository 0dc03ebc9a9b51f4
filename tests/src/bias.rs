//! What biases an inertia: one disturbance at a time, on drawers of four masses. Everything here is simulation.

use ft_sim_hw::Scenario;
use ft_sim_hw::scenario::EffectSpec;

use crate::study::Spread;
use crate::truth::{Comparison, Trial};

/// Masses of the drawers, kg.
const MASSES: [f64; 4] = [0.8, 2.0, 6.0, 15.0];

/// The disturbances: name, and what it does to a trial.
type Disturb = fn(&mut Trial);
const DISTURBANCES: [(&str, Disturb); 5] = [
    ("none", |_| {}),
    ("wrench 10 ms late", |trial| {
        let late = EffectSpec::TimeLag { lag_s: 0.01 };
        trial.scenario.undeclared.push(late);
    }),
    ("calibration 0.15 kg too heavy", |trial| {
        trial.calibration_off_kg = 0.15;
    }),
    ("0.15 kg put on at the grasp", |trial| {
        let mass = EffectSpec::ToolMass {
            mass_kg: 0.15,
            at_m: [0.0, 0.0, 0.06],
        };
        trial.scenario.undeclared.push(mass);
    }),
    ("poses 1.5 mm noise", |trial| {
        trial.scenario.tracker.white_m = 1.5e-3;
    }),
];

/// The trials of the table, disturbance by disturbance.
///
/// # Panics
/// The built-in drawer is missing.
#[must_use]
pub fn trials() -> Vec<Trial> {
    let drawer = Scenario::builtin("drawer_light").unwrap_or_else(|error| panic!("{error}"));
    let mut out = Vec::new();
    for (name, disturb) in DISTURBANCES {
        for mass in MASSES {
            let mut scenario = drawer.clone();
            scenario.name = label(name, mass);
            scenario.object.inertia = mass;
            scenario.mechanisms.clear();
            let mut trial = Trial::plain(scenario);
            disturb(&mut trial);
            out.push(trial);
        }
    }
    out
}

fn label(disturbance: &str, mass: f64) -> String {
    format!("{disturbance}, {mass} kg")
}

/// The table as Markdown: bias of the inertia, mean and standard deviation over the recordings, %.
#[must_use]
pub fn markdown(results: &[Comparison]) -> String {
    let mut out = String::from(
        "Simulated. Bias of the inertia, % (mean ± standard deviation over recordings); how many of ours were flagged: withheld, or with a note \
         that names the disturbance or a lag taken out; how many of ours had the truth in their 95 % interval.\n\n\
         | disturbance | kg | `paper`, 155 ms | `paper`, 255 ms | ours | joint fit | flagged | hold |\n|---|---|---|---|---|---|---|---|\n",
    );
    for (name, _) in DISTURBANCES {
        for mass in MASSES {
            let of: Vec<&Comparison> = results
                .iter()
                .filter(|one| one.scenario == label(name, mass))
                .collect();
            if of.is_empty() {
                continue;
            }
            let bias = |f: &dyn Fn(&Comparison) -> Option<f64>| {
                let values: Vec<f64> = of.iter().filter_map(|one| f(one)).collect();
                let spread = Spread::of(values.iter().map(|v| 100.0 * v));
                if spread.count() == 0 {
                    return "-".to_owned();
                }
                format!("{:+.1} ± {:.1}", spread.mean(), spread.deviation())
            };
            let flagged = of
                .iter()
                .filter(|one| one.relative[0].is_none() || one.flagged)
                .count();
            let given: Vec<f64> = of.iter().filter_map(|one| one.sigmas[0]).collect();
            let hold = given.iter().filter(|s| s.abs() < 1.96).count();
            out += &format!(
                "| {name} | {mass} | {} | {} | {} | {} | {flagged} of {} | {hold} of {} |\n",
                bias(&|one| one.paper[0]),
                bias(&|one| one.paper_long),
                bias(&|one| one.relative[0]),
                bias(&|one| one.joint_relative[0]),
                of.len(),
                given.len()
            );
        }
    }
    out
}
