//! Sealed draws recorded through the drivers, diagnosed with a confirming recording, and compared with the truth, by effect.
//! All figures are simulated.
//!
//! ```text
//! cargo run -p ft-tests --bin sealed-table -- [DRAWS] [FIRST_SEED] [-o FILE] [--bare] [--two P] [--none P] [--outside P]
//!     [--effect NAME]... [--alone] [--keep DIR] [--jobs N]
//! ```
//!
//! A line per draw goes to standard output as it is done; the tables over all draws so far are written to FILE
//! (`sealed-table.md` when not given) after each, so that they are there whenever the run is ended.
//!
//! `--alone` identifies without the confirming recording. `--keep DIR` leaves recordings, truths and reports there and takes
//! recordings that are there already. The identification is given two recordings; the truth and a third recording, of
//! sensors without noise, go to the judge alone. Draws without any effect are identified without confirmation too.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::{Identified, identify_confirmed, joint_samples};
use ft_recording::{Recording, TopicMap};
use ft_sim_hw::Scenario;
use ft_sim_hw::sealed::{Mechanisms, SealedDraw, SealedOptions};
use ft_tests::sealed::{Judged, simulated_floor, tables};
use ft_tests::truth::{Trial, try_record};

struct Options {
    draws: u64,
    first: u64,
    sealed: SealedOptions,
    confirm: bool,
    keep: Option<PathBuf>,
    tables: PathBuf,
    jobs: usize,
}

fn main() {
    let options = match Options::parse(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(reason) => {
            eprintln!("sealed-table: {reason}");
            std::process::exit(2);
        }
    };
    let next = AtomicU64::new(options.first);
    let judged = Mutex::new(Vec::new());
    let work = || {
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed >= options.first + options.draws {
                return;
            }
            match one(seed, &options) {
                Ok(line) => {
                    let mut judged = judged
                        .lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner);
                    judged.push(line);
                    said(&judged, &options);
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
}

/// The last draw as a line, and the tables over all.
fn said(judged: &[Judged], options: &Options) {
    if let Some(last) = judged.last() {
        let _ = writeln!(std::io::stdout(), "{last}");
    }
    let text = format!(
        "{} of {} draws from seed {}\n\n{}",
        judged.len(),
        options.draws,
        options.first,
        tables(judged)
    );
    if let Err(error) = std::fs::write(&options.tables, text) {
        eprintln!("cannot write {}: {error}", options.tables.display());
    }
}

impl Options {
    fn parse(arguments: impl Iterator<Item = String>) -> Result<Self, String> {
        let mut out = Self {
            draws: 20,
            first: 1000,
            sealed: SealedOptions::default(),
            confirm: true,
            keep: None,
            tables: PathBuf::from("sealed-table.md"),
            jobs: std::thread::available_parallelism().map_or(1, usize::from),
        };
        let mut numbers = Vec::new();
        let mut arguments = arguments;
        while let Some(argument) = arguments.next() {
            let mut value = || {
                arguments
                    .next()
                    .ok_or_else(|| format!("{argument} needs a value"))
            };
            match argument.as_str() {
                "--bare" => out.sealed.mechanisms = Mechanisms::Dropped,
                "--alone" => out.confirm = false,
                "--two" => out.sealed.two = parsed(&value()?)?,
                "--none" => out.sealed.none = parsed(&value()?)?,
                "--outside" => out.sealed.outside = parsed(&value()?)?,
                "--effect" => out.sealed.only.push(value()?),
                "--keep" => out.keep = Some(PathBuf::from(value()?)),
                "-o" => out.tables = PathBuf::from(value()?),
                "--jobs" => out.jobs = parsed(&value()?)?,
                number => numbers.push(parsed(number)?),
            }
        }
        if let Some(draws) = numbers.first() {
            out.draws = *draws;
        }
        if let Some(first) = numbers.get(1) {
            out.first = *first;
        }
        Ok(out)
    }
}

fn parsed<T: std::str::FromStr>(text: &str) -> Result<T, String> {
    text.parse().map_err(|_| format!("{text:?} is no number"))
}

/// Records and identifies one draw.
fn one(seed: u64, options: &Options) -> Result<Judged, String> {
    let draw =
        SealedDraw::draw(seed, &options.sealed).map_err(|error| format!("not drawn: {error}"))?;
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
    let quiet = recorded("quiet.mcap", &without_noise(&draw.main), seed)?;
    #[allow(clippy::disallowed_methods, reason = "a stopwatch")]
    let started = Instant::now();
    let found = identified(&main, options.confirm.then_some(confirm))?;
    let seconds = started.elapsed().as_secs_f64();
    if options.keep.is_some() {
        write(&folder.join("truth.json"), &draw.truth)?;
        write(&folder.join("report.json"), &found.report)?;
    }
    let settings = MotionSettings::default();
    let floor = Recording::load(&quiet, &TopicMap::default())
        .ok()
        .and_then(|quiet| joint_samples(&quiet, &settings).ok())
        .and_then(|quiet| simulated_floor(&found, &quiet));
    let judged = Judged::of(&draw.truth, &found, floor, seconds);
    if draw.truth.effects.is_empty() && options.confirm {
        let alone = identified(&main, None)?;
        return Ok(judged.with_alone(&draw.truth, &alone.report));
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
