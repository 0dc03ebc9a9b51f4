//! The two forms of the mechanism on the same effort: splines and the paper's network. Everything here is simulation.

use std::path::Path;
use std::time::Instant;

use ft_identify::dynamics::{fit_base, fit_with_mechanism};
use ft_identify::least_squares::rms;
use ft_identify::mechanism::Mechanism;
use ft_identify::motion::{Motion, MotionSettings};
use ft_identify::paper::network::{Training, train};
use ft_identify::pipeline::identify_recording;
use ft_recording::TopicMap;
use ft_sim_hw::Scenario;

use crate::truth::record_scenario;

/// What one form of the mechanism makes of a recording.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    /// Root mean square error on strokes that were left out, N m or N.
    pub held_out: f64,
    /// Share of the root mean square of the effort besides I, mu and b that it takes away on the strokes it was fitted to.
    pub in_sample: f64,
    /// The same on strokes that were left out.
    pub reduction: f64,
    /// One fit with its choice of smoothing or its validation, s.
    pub seconds: f64,
}

/// Both forms on the effort of one recording that the simulated I, mu and b leave.
#[derive(Clone, Debug)]
pub struct Forms {
    /// The scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// The paper's base model on left-out strokes, N m or N.
    pub base_held_out: f64,
    /// Splines.
    pub spline: Form,
    /// The paper's network.
    pub mlp: Form,
}

/// Records and identifies a scenario, takes I, mu and b as simulated out of the effort, and fits what is left in both forms.
///
/// # Panics
/// It cannot be recorded or identified.
#[must_use]
pub fn forms_of(scenario: &Scenario, seed: u64, file: &Path) -> Forms {
    let truth = record_scenario(scenario, seed, file);
    let settings = MotionSettings::default();
    let identified = identify_recording(file, &TopicMap::default(), &settings, &mut |_| {})
        .unwrap_or_else(|error| panic!("{} seed {seed}: {error}", scenario.name));
    let analysis = identified
        .analysis
        .unwrap_or_else(|| panic!("{} seed {seed}: no dynamics", scenario.name));
    // The samples with a lag taken out where there is one, and the simulated inertia and friction: neither form has an advantage.
    let samples = analysis
        .diagnosis
        .map_or(identified.samples, |diagnosis| diagnosis.samples);
    let mut motion = Motion::prepare(&samples, &settings)
        .unwrap_or_else(|error| panic!("{} seed {seed}: {error}", scenario.name));
    let base_held_out = held_out(fit_base(&motion));
    let object = &truth.object;
    let theta = [object.inertia, object.coulomb, object.viscous];
    for i in 0..motion.tau.len() {
        let body = theta[0] * motion.ddq[i] + theta[1] * motion.sign[i] + theta[2] * motion.dq[i];
        motion.tau[i] -= body;
    }
    let left = motion
        .regressor(&motion.tau)
        .unwrap_or_else(|error| panic!("{}: {error}", scenario.name));
    let covered = motion.covered();
    let scored: Vec<f64> = left
        .iter()
        .zip(&covered)
        .filter(|(_, c)| **c)
        .map(|(t, _)| *t)
        .collect();
    Forms {
        scenario: scenario.name.clone(),
        seed,
        base_held_out,
        spline: spline(&motion, rms(&left), rms(&scored)),
        mlp: mlp(&motion, &left, &covered, rms(&scored)),
    }
}

fn held_out<E: core::fmt::Display>(model: Result<ft_identify::dynamics::EffortModel, E>) -> f64 {
    model.map_or_else(|error| panic!("{error}"), |model| model.held_out_rms)
}

#[allow(clippy::disallowed_methods, reason = "a stopwatch")]
fn spline(motion: &Motion, all: f64, scored: f64) -> Form {
    let started = Instant::now();
    let model = fit_with_mechanism(motion, &[]).unwrap_or_else(|error| panic!("{error}"));
    Form {
        held_out: model.held_out_rms,
        in_sample: 1.0 - model.rms / all,
        reduction: 1.0 - model.held_out_rms / scored,
        seconds: started.elapsed().as_secs_f64(),
    }
}

#[allow(clippy::disallowed_methods, reason = "a stopwatch")]
fn mlp(motion: &Motion, left: &[f64], covered: &[bool], scored: f64) -> Form {
    let states: Vec<[f64; 2]> = motion
        .kept
        .iter()
        .map(|&i| [motion.q[i], motion.dq[i]])
        .collect();
    let training = Training::default();
    let errors = |rows: &[usize], without: Option<(&[usize], usize)>| -> Vec<f64> {
        let seen: Vec<usize> = (0..left.len())
            .filter(|&i| without.is_none_or(|(fold_of, fold)| fold_of[i] != fold))
            .collect();
        let of = |rows: &[usize]| rows.iter().map(|&i| states[i]).collect::<Vec<_>>();
        let tau: Vec<f64> = seen.iter().map(|&i| left[i]).collect();
        let mechanism = train(&of(&seen), &tau, &training);
        rows.iter()
            .map(|&i| left[i] - mechanism.effort(states[i][0], states[i][1]))
            .collect()
    };
    let rows: Vec<usize> = (0..left.len()).collect();
    let started = Instant::now();
    let seen = errors(&rows, None);
    let seconds = started.elapsed().as_secs_f64();
    let (fold_of, count) = motion.folds();
    let mut unseen = Vec::new();
    for fold in 0..count {
        let rows: Vec<usize> = rows
            .iter()
            .copied()
            .filter(|&i| fold_of[i] == fold && covered[i])
            .collect();
        unseen.extend(errors(&rows, Some((&fold_of, fold))));
    }
    Form {
        held_out: rms(&unseen),
        in_sample: 1.0 - rms(&seen) / rms(left),
        reduction: 1.0 - rms(&unseen) / scored,
        seconds,
    }
}

/// The table as Markdown, scenario by scenario.
#[must_use]
pub fn markdown(results: &[Forms]) -> String {
    let mut out = String::from(
        "Simulated. The effort that the true I, mu and b leave, fitted as splines and by the paper's network on the same samples and \
         folds of strokes (the splines choose their smoothing by those folds, the network stops by a random quarter of what it is given): error on left-out strokes, N m or N; share taken away in the fit and on left-out strokes; time of one fit, s, in one run.\n\n\
         | scenario | seed | I, mu, b alone | spline | network | spline / network | in the fit, spline, network | left out, spline, network | s, spline, network | spline / network |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for one in results {
        let Forms { spline, mlp, .. } = one;
        out += &format!(
            "| {} | {} | {:.3} | {:.3} | {:.3} | {:.2} | {:.0} %, {:.0} % | {:.0} %, {:.0} % | {:.2}, {:.2} | 1/{:.0} |\n",
            one.scenario,
            one.seed,
            one.base_held_out,
            spline.held_out,
            mlp.held_out,
            spline.held_out / mlp.held_out,
            100.0 * spline.in_sample,
            100.0 * mlp.in_sample,
            100.0 * spline.reduction,
            100.0 * mlp.reduction,
            spline.seconds,
            mlp.seconds,
            mlp.seconds / spline.seconds
        );
    }
    out += "\nOver all seeds: root mean square of the errors on left-out strokes, sum of the times.\n\n\
            | scenario | seeds | spline | network | spline / network | s, spline, network | spline / network |\n\
            |---|---|---|---|---|---|---|\n";
    for seeds in results.chunk_by(|a, b| a.scenario == b.scenario) {
        let error = |form: fn(&Forms) -> Form| {
            rms(&seeds
                .iter()
                .map(|one| form(one).held_out)
                .collect::<Vec<_>>())
        };
        let time =
            |form: fn(&Forms) -> Form| -> f64 { seeds.iter().map(|one| form(one).seconds).sum() };
        let [spline, mlp] = [error(|one| one.spline), error(|one| one.mlp)];
        let [spline_s, mlp_s] = [time(|one| one.spline), time(|one| one.mlp)];
        out += &format!(
            "| {} | {} | {spline:.3} | {mlp:.3} | {:.2} | {spline_s:.2}, {mlp_s:.2} | 1/{:.0} |\n",
            seeds[0].scenario,
            seeds.len(),
            spline / mlp,
            mlp_s / spline_s
        );
    }
    out
}
