//! Simulated recordings identified and compared with what was simulated. Everything here is simulation.

use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use ft_capture::session::Plan;
use ft_capture::simulated;
use ft_capture::summary::Summary;
use ft_identify::dynamics::Term;
use ft_identify::motion::{Motion, MotionSettings};
use ft_identify::paper::PaperSettings;
use ft_identify::pipeline::{Identified, identify_recording};
use ft_identify::screw::{JointKind, ScrewAxis};
use ft_identify::twin::Twin;
use ft_recording::TopicMap;
use ft_sim_hw::{Scenario, Simulation, Truth};

/// Records a built-in scenario on the simulated clock, drivers and all.
///
/// # Panics
/// The scenario is unknown, or the recording cannot be written.
#[must_use]
pub fn record(scenario: &str, seed: u64, file: &Path) -> Truth {
    let loaded = Scenario::load(scenario).unwrap_or_else(|error| panic!("{scenario}: {error}"));
    record_scenario(&loaded, seed, file)
}

/// Records a scenario on the simulated clock, drivers and all.
///
/// # Panics
/// It cannot be played, or the recording cannot be written.
#[must_use]
pub fn record_scenario(scenario: &Scenario, seed: u64, file: &Path) -> Truth {
    record_trial(&Trial::plain(scenario.clone()), seed, file)
}

/// A scenario, and what its operator has wrong.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The scenario.
    pub scenario: Scenario,
    /// What the calibration says too much of the mass in front of the sensor, kg.
    pub calibration_off_kg: f64,
}

impl Trial {
    /// Nothing wrong.
    #[must_use]
    pub fn plain(scenario: Scenario) -> Self {
        Self {
            scenario,
            calibration_off_kg: 0.0,
        }
    }
}

fn record_trial(trial: &Trial, seed: u64, file: &Path) -> Truth {
    let scenario = &trial.scenario.name;
    let (truth, summary) =
        try_record(trial, seed, None, file).unwrap_or_else(|error| panic!("{scenario}: {error}"));
    assert!(!summary.lost_data(), "{scenario}: {summary}");
    truth
}

/// Records a trial on the simulated clock, drivers and all, for `duration` or as long as a session takes.
///
/// # Errors
/// What cannot be played or written.
pub fn try_record(
    trial: &Trial,
    seed: u64,
    duration: Option<Duration>,
    file: &Path,
) -> Result<(Truth, Summary), String> {
    let mut simulation = Simulation::new(&trial.scenario, seed, simulated::START, duration)
        .map_err(|error| format!("not simulated: {error}"))?;
    let port = |_: &ft_sim_hw::Fitted| "in-process".to_owned();
    let mut known = simulation.known_setup();
    known.payload.mass_kg += trial.calibration_off_kg;
    let config = simulated::config("study", simulation.fitted(), &known, port)
        .map_err(|error| format!("not simulated: {error}"))?;
    let plan = Plan {
        config,
        record: Some(file.to_owned()),
        overwrite: true,
        duration: None,
        publish: false,
    };
    let summary = simulated::run(&plan, &mut simulation, |_| {}, || false)
        .map_err(|error| format!("not recorded: {error}"))?;
    Ok((simulation.truth(), summary))
}

/// Records a scenario and identifies it with the default settings.
///
/// # Panics
/// It cannot be recorded or identified.
#[must_use]
pub fn twin_of(scenario: &Scenario, seed: u64, file: &Path) -> (Truth, Twin) {
    let truth = record_scenario(scenario, seed, file);
    let settings = MotionSettings::default();
    let identified = identify_recording(file, &TopicMap::default(), &settings, &mut |_| {})
        .unwrap_or_else(|error| panic!("{} seed {seed}: {error}", scenario.name));
    let twin = identified
        .twin
        .unwrap_or_else(|| panic!("{} seed {seed}: no twin", scenario.name));
    (truth, twin)
}

/// One recording compared with its truth.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// Whether the kind of joint is right.
    pub kind_is_right: bool,
    /// Angle between the axes, deg.
    pub axis_deg: f64,
    /// Distance between the axes (revolute), mm.
    pub axis_mm: f64,
    /// True inertia, kg m^2 or kg.
    pub inertia: f64,
    /// (estimate - truth) / truth of inertia, Coulomb and viscous friction; `None` where not identified.
    pub relative: [Option<f64>; 3],
    /// The same in standard deviations that the report states.
    pub sigmas: [Option<f64>; 3],
    /// Held-out RMS of the paper's base model, N m or N.
    pub base_held_out: f64,
    /// Held-out RMS of the full model.
    pub held_out: f64,
    /// What the report takes for the noise floor.
    pub floor_estimated: f64,
    /// What the true parameters leave on the same measured signals through the same pipeline.
    pub floor_true: f64,
    /// The report's verdict.
    pub verdict: String,
    /// The paper's estimator on the same samples: (estimate - truth) / truth of inertia, Coulomb and viscous friction.
    pub paper: [Option<f64>; 3],
    /// The same of inertia with a smoother of 255 ms.
    pub paper_long: Option<f64>,
    /// Whether the report warns of a lag, of a mass or of a calibration.
    pub flagged: bool,
    /// The joint fit of motion and dynamics: relative errors of inertia, Coulomb and viscous friction.
    pub joint_relative: [Option<f64>; 3],
    /// The same in standard deviations that the report states.
    pub joint_sigmas: [Option<f64>; 3],
    /// Held-out RMS of the joint fit.
    pub joint_held_out: f64,
    /// Share of the paper's base model's residual that the full model takes away, on held-out strokes.
    pub reduction: f64,
}

/// Identifies `file` and compares.
///
/// # Panics
/// It cannot be identified.
#[must_use]
pub fn compare(scenario: &str, seed: u64, file: &Path, truth: &Truth) -> Comparison {
    let settings = MotionSettings::default();
    let identified = identify_recording(file, &TopicMap::default(), &settings, &mut |_| {})
        .unwrap_or_else(|error| panic!("{scenario} seed {seed}: {error}"));
    let (axis_deg, axis_mm) = axis_error(&identified, truth);
    let report = &identified.report;
    let finals = &report.last;
    let wanted = [
        ("inertia", truth.object.inertia),
        ("coulomb", truth.object.coulomb),
        ("viscous", truth.object.viscous),
    ];
    let compared = |term: &Term, true_value: f64| {
        let (value, std) = (term.value?, term.std?);
        Some((
            (value - true_value) / true_value,
            (value - true_value) / std,
        ))
    };
    let terms = wanted.map(|(name, truth)| compared(report.term(name)?, truth));
    let fitted = report.joint_fit.as_ref();
    let jointly = [0, 1, 2].map(|j| compared(&fitted?.terms[j], wanted[j].1));
    let kind = identified.axis.as_ref().map(|axis| axis.kind);
    Comparison {
        scenario: scenario.to_owned(),
        seed,
        kind_is_right: kind.is_some_and(|kind| (kind == JointKind::Revolute) == is_revolute(truth)),
        axis_deg,
        axis_mm,
        inertia: truth.object.inertia,
        relative: terms.map(|term| term.map(|(relative, _)| relative)),
        sigmas: terms.map(|term| term.map(|(_, sigmas)| sigmas)),
        base_held_out: report.base.held_out_rms.unwrap_or(f64::NAN),
        held_out: finals.held_out_rms.unwrap_or(f64::NAN),
        floor_estimated: finals.noise_floor_rms.unwrap_or(f64::NAN),
        floor_true: true_floor(&identified, truth),
        verdict: format!("{:?}", finals.verdict).to_lowercase(),
        paper: paper(&identified, wanted.map(|(_, value)| value), 0.155),
        paper_long: paper(&identified, wanted.map(|(_, value)| value), 0.255)[0],
        flagged: report.lag.is_some_and(|lag| lag.applied)
            || report
                .payload
                .as_ref()
                .is_some_and(|payload| payload.contradicted_kg.is_some())
            || report
                .effects
                .iter()
                .any(|effect| effect.name == "tool_mass"),
        joint_relative: jointly.map(|term| term.map(|(relative, _)| relative)),
        joint_sigmas: jointly.map(|term| term.map(|(_, sigmas)| sigmas)),
        joint_held_out: fitted.map_or(f64::NAN, |fit| fit.held_out_rms),
        reduction: match (report.base.held_out_rms, finals.held_out_rms) {
            (Some(base), Some(full)) => 1.0 - full / base,
            _ => f64::NAN,
        },
    }
}

/// Relative errors of the paper's estimator, without its network, which does not change them.
fn paper(identified: &Identified, truth: [f64; 3], window_s: f64) -> [Option<f64>; 3] {
    let settings = PaperSettings {
        window_s,
        training: None,
        ..PaperSettings::default()
    };
    let Ok(fit) = ft_identify::paper::identify(&identified.samples, &settings) else {
        return [None; 3];
    };
    [0, 1, 2].map(|j| fit.terms[j].value.map(|value| value / truth[j] - 1.0))
}

fn is_revolute(truth: &Truth) -> bool {
    truth.joint_kind == ft_sim_hw::scenario::JointKind::Revolute
}

/// Angle (deg, folded to 0..90) and distance (mm; NaN for a slide) between the identified and the true axis.
fn axis_error(identified: &Identified, truth: &Truth) -> (f64, f64) {
    let Some(axis) = &identified.axis else {
        return (f64::NAN, f64::NAN);
    };
    let true_axis = ScrewAxis {
        direction: nalgebra::Unit::new_normalize(truth.axis_direction.into()),
        point: truth.axis_point.into(),
        kind: axis.kind,
    };
    let (angle, distance) = axis.separation(&true_axis);
    (
        angle.to_degrees(),
        if is_revolute(truth) {
            distance * 1e3
        } else {
            f64::NAN
        },
    )
}

/// What the true parameters leave of the measured effort, motion and effort through the pipeline's own filters.
fn true_floor(identified: &Identified, truth: &Truth) -> f64 {
    let samples = &identified.samples;
    let analysis = identified.analysis.as_ref();
    let settings = analysis.map_or_else(MotionSettings::default, |analysis| analysis.settings);
    let Ok(mut motion) = Motion::prepare(samples, &settings) else {
        return f64::NAN;
    };
    // Where friction was taken to be unknown it is here, too.
    if let Some(diagnosis) = analysis.and_then(|analysis| analysis.diagnosis.as_ref()) {
        let slides = motion.slides.iter_mut().zip(&diagnosis.motion.slides);
        slides.for_each(|(here, there)| *here = *there);
    }
    let needed: Vec<f64> = (0..motion.q.len())
        .map(|i| truth.effort(truth.q_at_grasp + motion.q[i], motion.dq[i], motion.ddq[i]))
        .collect();
    let (Ok(measured), Ok(needed)) = (motion.regressor(&motion.tau), motion.regressor(&needed))
    else {
        return f64::NAN;
    };
    // The same samples as the held-out error's.
    let squares: Vec<f64> = measured
        .iter()
        .zip(&needed)
        .zip(motion.covered())
        .filter(|(_, covered)| *covered)
        .map(|((a, b), _)| (a - b) * (a - b))
        .collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

/// Every trial with each of `seeds`: what is the same in two trials meets the same noise.
#[must_use]
pub fn each_of(trials: Vec<Trial>, seeds: std::ops::Range<u64>) -> Vec<(Trial, u64)> {
    let with_each = |trial: Trial| seeds.clone().map(move |seed| (trial.clone(), seed));
    trials.into_iter().flat_map(with_each).collect()
}

/// Runs each built-in scenario with each of `seeds`, as [`study_of`].
///
/// # Panics
/// As [`study_of`], or a scenario is unknown.
#[must_use]
pub fn study(
    scenarios: &[&str],
    seeds: std::ops::Range<u64>,
    done: impl Fn(&Comparison) + Sync,
) -> Vec<Comparison> {
    let load = |name: &&str| Scenario::load(name).unwrap_or_else(|error| panic!("{name}: {error}"));
    let trials = scenarios.iter().map(load).map(Trial::plain).collect();
    study_of(&each_of(trials, seeds), done)
}

/// Runs trials, each with its seed, on all processors; `done` hears of each. In the order of `jobs`.
///
/// # Panics
/// One of them cannot be recorded or identified.
#[must_use]
pub fn study_of(jobs: &[(Trial, u64)], done: impl Fn(&Comparison) + Sync) -> Vec<Comparison> {
    let next = AtomicUsize::new(0);
    let results = Mutex::new(Vec::new());
    let folder = tempfile::tempdir().unwrap_or_else(|error| panic!("no temporary folder: {error}"));
    let workers = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    std::thread::scope(|scope| {
        for worker in 0..workers {
            let (next, results, done, folder) = (&next, &results, &done, &folder);
            scope.spawn(move || {
                let file = folder.path().join(format!("{worker}.mcap"));
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    let Some((trial, seed)) = jobs.get(k) else {
                        return;
                    };
                    let truth = record_trial(trial, *seed, &file);
                    let comparison = compare(&trial.scenario.name, *seed, &file, &truth);
                    done(&comparison);
                    if let Ok(mut results) = results.lock() {
                        results.push((k, comparison));
                    }
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|(k, _)| *k);
    results.into_iter().map(|(_, one)| one).collect()
}
