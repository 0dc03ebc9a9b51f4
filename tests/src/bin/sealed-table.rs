//! Sealed draws, diagnosed and compared with the truth: `cargo run --release -p ft-tests --bin sealed-table -- --help`.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use clap::Parser;
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::{Identified, identify_confirmed, joint_samples};
use ft_recording::{Recording, TopicMap};
use ft_sim_hw::Scenario;
use ft_sim_hw::sealed::{Mechanisms, SealedDraw, SealedError, SealedOptions};
use ft_tests::arguments::probability;
use ft_tests::sealed::{Judged, simulated_floor, tables};
use ft_tests::truth::{Trial, try_record};

/// Sealed draws recorded through the drivers, diagnosed with a confirming recording, and compared with the truth, by effect.
///
/// All figures are simulated. A line per draw goes to standard output as it is done; the tables over all draws so far are written after
/// each, so that they are there whenever the run is ended.
///
/// The identification is given two recordings; the truth and a third recording, of sensors without noise, go to the judge alone. Draws
/// without any effect are identified without confirmation too.
#[derive(Parser)]
#[command(after_help = "Example:\n  sealed-table 20 501 --effect ripple --keep draws")]
struct Options {
    /// Draws
    #[arg(default_value_t = 20, value_parser = clap::value_parser!(u64).range(1..))]
    draws: u64,
    /// Seed of the first
    #[arg(default_value_t = 1000)]
    first_seed: u64,
    /// File of the tables
    #[arg(short, long, value_name = "FILE", default_value = "sealed-table.md")]
    output: PathBuf,
    /// Objects without their own mechanisms
    #[arg(long)]
    bare: bool,
    /// Probability that nothing is undeclared
    #[arg(long, value_name = "P", default_value_t = SealedOptions::default().none, value_parser = probability)]
    none: f64,
    /// Probability of two effects
    #[arg(long, value_name = "P", default_value_t = SealedOptions::default().two, value_parser = probability)]
    two: f64,
    /// Probability of an effect that the report has no name for
    #[arg(long, value_name = "P", default_value_t = SealedOptions::default().outside, value_parser = probability)]
    outside: f64,
    /// Draws this effect only; may be given several times to draw one of them
    #[arg(long, value_name = "NAME")]
    effect: Vec<String>,
    /// Identifies without the confirming recording
    #[arg(long)]
    alone: bool,
    /// Folder for recordings, truths and reports; recordings already there are used again
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Draws at a time
    #[arg(long, default_value_t = processors(), value_parser = clap::value_parser!(u16).range(1..))]
    jobs: u16,
}

fn processors() -> u16 {
    let found = std::thread::available_parallelism();
    found.map_or(1, |found| u16::try_from(found.get()).unwrap_or(u16::MAX))
}

fn main() -> ExitCode {
    let options = Options::parse();
    // Before the work, so that none is lost.
    if let Err((code, reason)) = options.check() {
        eprintln!("{reason}");
        return ExitCode::from(code);
    }
    let next = AtomicU64::new(options.first_seed);
    let judged = Mutex::new(Vec::new());
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= options.first_seed + options.draws {
                return;
            }
            match one(seed, &options) {
                Ok(line) => {
                    let mut judged = judged
                        .lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner);
                    judged.push(line);
                    if let Some(last) = judged.last() {
                        let _ = writeln!(std::io::stdout(), "{last}");
                    }
                    said(&judged, &options).unwrap_or_else(|error| eprintln!("{error}"));
                }
                Err(reason) => eprintln!("{seed}: {reason}"),
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..options.jobs {
            scope.spawn(work);
        }
    });
    let judged = judged
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    // A closed pipe ends the tables and nothing else.
    let _ = std::io::stdout().write_all(tables(&judged).as_bytes());
    ExitCode::from(u8::from(judged.is_empty()))
}

/// The tables over all, into their file.
fn said(judged: &[Judged], options: &Options) -> Result<(), String> {
    let text = format!(
        "{} of {} draws from seed {}\n\n{}",
        judged.len(),
        options.draws,
        options.first_seed,
        tables(judged)
    );
    let file = &options.output;
    std::fs::write(file, text).map_err(|error| format!("cannot write {}: {error}", file.display()))
}

impl Options {
    /// Whether the draws can be drawn, kept and told of; otherwise why not, and the program's code.
    fn check(&self) -> Result<(), (u8, String)> {
        if self.none + self.outside + self.two > 1.0 {
            return Err((
                2,
                "--none, --outside and --two are more than 1 together".to_owned(),
            ));
        }
        let unknown = |error: &SealedError| matches!(error, SealedError::UnknownEffect { .. });
        let drawn = SealedDraw::draw(self.first_seed, &self.sealed());
        if let Some(error) = drawn.err().filter(unknown) {
            return Err((2, error.to_string()));
        }
        let cannot = |what: &Path, error| (1, format!("cannot write {}: {error}", what.display()));
        if let Some(folder) = &self.keep {
            std::fs::create_dir_all(folder).map_err(|error| cannot(folder, error))?;
        }
        let mut file = std::fs::OpenOptions::new();
        let opened = file.append(true).create(true).open(&self.output);
        opened.map_err(|error| cannot(&self.output, error))?;
        Ok(())
    }

    fn sealed(&self) -> SealedOptions {
        SealedOptions {
            mechanisms: if self.bare {
                Mechanisms::Dropped
            } else {
                Mechanisms::Kept
            },
            two: self.two,
            none: self.none,
            outside: self.outside,
            only: self.effect.clone(),
        }
    }
}

/// Records and identifies one draw.
fn one(seed: u64, options: &Options) -> Result<Judged, String> {
    let draw =
        SealedDraw::draw(seed, &options.sealed()).map_err(|error| format!("not drawn: {error}"))?;
    let mut temporary = None;
    let folder = match &options.keep {
        Some(keep) => keep.join(seed.to_string()),
        None => temporary
            .insert(tempfile::tempdir().map_err(|error| format!("no folder: {error}"))?)
            .path()
            .to_owned(),
    };
    std::fs::create_dir_all(&folder).map_err(|error| format!("no folder: {error}"))?;
    let recorded = |name: &str, scenario: &Scenario, seed: u64| {
        let file = folder.join(name);
        if file.exists() {
            return Ok(file);
        }
        try_record(&Trial::plain(scenario.clone()), seed, None, &file).map(|_| file)
    };
    let main = recorded("main.mcap", &draw.main, seed)?;
    let confirm = recorded("confirm.mcap", &draw.confirm, seed + 1)?;
    if options.keep.is_some() {
        write(&folder.join("truth.json"), &draw.truth)?;
    }
    let quiet = recorded("quiet.mcap", &without_noise(&draw.main), seed)?;
    #[allow(clippy::disallowed_methods, reason = "a stopwatch")]
    let started = Instant::now();
    let found = identified(&main, (!options.alone).then_some(confirm));
    let seconds = started.elapsed().as_secs_f64();
    let found = match found {
        Ok(found) => found,
        Err(reason) => {
            eprintln!("{seed}: {reason}");
            return Ok(Judged::failed(&draw.truth, seconds));
        }
    };
    if options.keep.is_some() {
        write(&folder.join("report.json"), &found.report)?;
    }
    let settings = MotionSettings::default();
    let floor = Recording::load(&quiet, &TopicMap::default())
        .ok()
        .and_then(|quiet| joint_samples(&quiet, &settings).ok())
        .and_then(|quiet| simulated_floor(&found, &quiet));
    let judged = Judged::of(&draw.truth, &found, floor, seconds);
    if draw.truth.effects.is_empty() && !options.alone {
        match identified(&main, None) {
            Ok(alone) => return Ok(judged.with_alone(&draw.truth, &alone.report)),
            Err(reason) => eprintln!("{seed}, without confirmation: {reason}"),
        }
    }
    Ok(judged)
}

fn without_noise(scenario: &Scenario) -> Scenario {
    let mut quiet = scenario.clone();
    let (sensor, tracker) = (&mut quiet.sensor, &mut quiet.tracker);
    (sensor.force_noise_n, sensor.torque_noise_nm) = (0.0, 0.0);
    (tracker.white_m, tracker.white_deg) = (0.0, 0.0);
    (tracker.wander_m, tracker.wander_deg) = (0.0, 0.0);
    quiet
}

/// What the identification sees: two files.
fn identified(main: &Path, confirm: Option<PathBuf>) -> Result<Identified, String> {
    let (map, settings) = (TopicMap::default(), MotionSettings::default());
    let confirm: Vec<PathBuf> = confirm.into_iter().collect();
    identify_confirmed(main, &confirm, &map, &settings, &mut |_| ())
        .map_err(|error| format!("not identified: {error}"))
}

fn write(file: &Path, value: &impl serde::Serialize) -> Result<(), String> {
    let text = serde_json::to_string_pretty(value).map_err(|error| error.to_string())?;
    std::fs::write(file, text).map_err(|error| format!("cannot write {}: {error}", file.display()))
}
