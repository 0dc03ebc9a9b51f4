//! `ft-identify`: joint, dynamics and twin from a recording, a table or a track.
#![forbid(unsafe_code)]

mod use_error;
mod use_twin;

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use clap::{Args, Parser, Subcommand, ValueEnum};
use ft_identify::analysis::analyse_confirmed;
use ft_identify::batch::{self, BatchOptions};
use ft_identify::error::IdentifyError;
use ft_identify::motion::MotionSettings;
use ft_identify::output::{FILES, refuse_existing, replace, write_to};
use ft_identify::paper::PaperSettings;
use ft_identify::pipeline::{
    DAMAGED, Identified, MOST_OFF_PATH_M, Stage, identified_table, identify_confirmed,
};
use ft_identify::report::Joint;
use ft_identify::screw::JointKind;
use ft_identify::table::{Recipe, TableColumns, doubts, identify_published, read_table};
use ft_identify::track::{TrackError, TrackJoint, identify_track};
use ft_recording::{ReadError, TopicMap};
use indicatif::{ProgressBar, ProgressStyle};
use sha2::{Digest, Sha256};

use use_error::UseError;
use use_twin::{Compare, Export, Simulate, positive};

const EXAMPLES: &str = "Examples:
  ft-identify door.mcap -o door                       joint, dynamics, twin; look at door/report.html
  ft-identify door.mcap --confirm again.mcap -o door    only what another recording of the door shows, too
  ft-identify bag.mcap --map /wrench=/ft/wrench -o out    a recording with other topic names
  ft-identify --batch recordings/ -o results         all of them, and results/summary.csv
  ft-identify door.mcap --estimator paper -o door     the paper's estimator beside ours
  ft-identify table axis.csv --time t --position q --effort f --kind prismatic -o axis
  ft-identify track poses.log                         the joint of a track of poses
  ft-identify simulate door/twin.json --release 45deg    let it go: when does it close
  ft-identify export door/twin.json --to mjcf,usd -o assets

Exit codes: 0 fine, 1 failed, 2 wrong arguments, 3 finished but data was lost.";

/// Finds the joint of a door or drawer, what it takes to move it, and what the model still lacks.
#[derive(Parser)]
#[command(version, after_help = EXAMPLES, args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    recording: RecordingArguments,
}

#[derive(Subcommand)]
enum Command {
    /// Position and effort of one joint from a CSV file
    Table(TableArguments),
    /// The joint alone, from a track of poses (3 or 7 columns per line, or CSV by header)
    Track(TrackArguments),
    /// Lets a twin go: when does it arrive, or where does friction hold it
    Simulate(Simulate),
    /// A twin for a simulator: MJCF, URDF, USD, or its effort as ONNX
    Export(Export),
    /// Twins beside each other
    Compare(Compare),
}

#[derive(Args)]
struct RecordingArguments {
    /// Recording (MCAP) with /ft/wrench and /tcp/pose or /aria/pose
    #[arg(required_unless_present = "batch")]
    recording: Option<PathBuf>,
    /// Identify every recording below this directory, each into its own directory below --output; goes on where an earlier run
    /// was stopped (--force begins anew), and ends with one table, summary.csv; exit code 1 when one of them failed
    #[arg(long, value_name = "DIR", conflicts_with_all = ["recording", "confirm"])]
    batch: Option<PathBuf>,
    /// With --batch: recordings at a time [default: one per processor]
    #[arg(long, value_name = "N", requires = "batch", conflicts_with = "recording", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Directory for report.json, report.html and twin.json
    #[arg(short, long, value_name = "DIR", required = true)]
    output: Option<PathBuf>,
    /// A topic of the recording in place of one of ours: /their/topic=/ft/wrench
    #[arg(long, value_name = "THEIRS=OURS")]
    map: Vec<String>,
    #[command(flatten)]
    common: Common,
}

#[derive(Args)]
struct Common {
    /// Cut-off of the zero-phase filter for effort and regressors, Hz [default: 6, and lower for a motion so slow that the poses' noise hides its
    /// acceleration]
    #[arg(long, value_name = "HZ", value_parser = positive, allow_negative_numbers = true)]
    cutoff_hz: Option<f64>,
    /// Another recording (or table) of the same joint, in which every added effect must be too; may be given several times
    #[arg(long, value_name = "FILE")]
    confirm: Vec<PathBuf>,
    /// `paper` puts the paper's own estimator (smoothed differentiation, least squares, network) beside ours in the report
    #[arg(long, value_name = "NAME", value_enum, default_value_t = Estimator::Matched)]
    estimator: Estimator,
    /// Replace the files of an earlier run in the output directory
    #[arg(long)]
    force: bool,
    /// Print report.json instead of the summary
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Estimator {
    Matched,
    Paper,
}

#[derive(Clone, Copy, ValueEnum)]
enum Kind {
    Revolute,
    Prismatic,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  ft-identify table axis.csv --time t --position q --effort f --kind prismatic -o axis
  ft-identify table DATA_EMPS.csv --time t_s --position qm_m --effort force_N --kind prismatic \\
      --lowpass-hz 100 --lowpass-order 4 --decimate 10 --drop-border 50 --offset -o emps     the published recipe")]
struct TableArguments {
    /// CSV file with a header; columns separated by commas, semicolons or tabs
    table: PathBuf,
    /// Column of time, s
    #[arg(long, value_name = "COLUMN")]
    time: String,
    /// Column of the joint coordinate, rad or m
    #[arg(long, value_name = "COLUMN")]
    position: String,
    /// Column of the effort on the joint, N m or N
    #[arg(long, value_name = "COLUMN")]
    effort: String,
    /// What the joint does
    #[arg(long, value_enum)]
    kind: Kind,
    /// Directory for report.json, report.html and twin.json
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Published least-squares recipe instead of ours: low-pass of the position, Hz
    #[arg(long, value_name = "HZ", requires_all = ["lowpass_order", "decimate"])]
    lowpass_hz: Option<f64>,
    /// Recipe: Butterworth order of that low-pass in each of its two passes
    #[arg(long, value_name = "N", requires = "lowpass_hz", value_parser = clap::value_parser!(u8).range(1..=12))]
    lowpass_order: Option<u8>,
    /// Recipe: keep every so many-th sample
    #[arg(long, value_name = "N", requires = "lowpass_hz", value_parser = clap::value_parser!(u16).range(1..=1000))]
    decimate: Option<u16>,
    /// Recipe: first sample kept, counted from 1; differences at the very start are off
    #[arg(long, value_name = "N", requires = "lowpass_hz", default_value_t = 0)]
    drop_border: usize,
    /// Recipe: fit a constant load too
    #[arg(long, requires = "lowpass_hz")]
    offset: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Args)]
#[command(after_help = "\
Examples:
  ft-identify track poses.log
  ft-identify track doors/*.log --json -o joints

A motion that is not that of one joint, with positions more than 10 mm root mean square off the best one, is said to be so
(`one_joint` in joint.json), with exit code 3. A track that fails is named and stops nothing; the exit code is 1 then.")]
struct TrackArguments {
    /// Tracks; text with x y z or x y z qx qy qz qw per line, or CSV with a header
    #[arg(required = true)]
    tracks: Vec<PathBuf>,
    /// Directory for joint.json
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Replace joint.json of an earlier run
    #[arg(long)]
    force: bool,
    /// Print JSON instead of the table
    #[arg(long)]
    json: bool,
}

/// How a run ended that has a result.
enum Outcome {
    Fine,
    /// Some of several inputs, each named.
    Failed,
    /// Also: a track is not one joint.
    DataLost,
}

fn main() -> ExitCode {
    // `ft-identify ... | head` ends quietly; every file is written before the summary is printed.
    sigpipe::reset();
    let arguments = Arguments::parse();
    let outcome = match &arguments.command {
        Some(Command::Table(table)) => run_table(table),
        Some(Command::Track(track)) => run_track(track),
        Some(Command::Simulate(simulate)) => return used(simulate.run()),
        Some(Command::Export(export)) => return used(export.run()),
        Some(Command::Compare(compare)) => return used(compare.run()),
        None => run_recording(&arguments.recording),
    };
    match outcome {
        Ok(Outcome::Fine) => ExitCode::SUCCESS,
        Ok(Outcome::Failed) => ExitCode::FAILURE,
        Ok(Outcome::DataLost) => ExitCode::from(3),
        Err(error) => {
            eprintln!("ft-identify: {}", with_input(&error, &arguments));
            ExitCode::from(if error.is_of_arguments() { 2 } else { 1 })
        }
    }
}

fn used(result: Result<(), UseError>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("ft-identify: {error}");
            ExitCode::from(if matches!(error, UseError::Place { .. }) {
                2
            } else {
                1
            })
        }
    }
}

/// The error with the file that it is about, whether its own text names it or not.
fn with_input(error: &IdentifyError, arguments: &Arguments) -> String {
    let file = match &arguments.command {
        Some(Command::Table(table)) => Some(&table.table),
        Some(_) => None,
        None => arguments.recording.recording.as_ref(),
    };
    let mut text = error.to_string();
    let is_text = |file: &PathBuf| {
        let extension = file.extension().map(|e| e.to_ascii_lowercase());
        extension.is_some_and(|e| e == "csv" || e == "tsv" || e == "txt")
    };
    if arguments.command.is_none()
        && matches!(error, IdentifyError::Read(ReadError::NotMcap { .. }))
        && file.is_some_and(is_text)
    {
        text += "; a table of samples is read by `ft-identify table`, see its --help";
    }
    match file.map(|file| file.display().to_string()) {
        Some(file) if !text.contains(&file) => format!("{file}: {text}"),
        _ => text,
    }
}

/// A recording that fails is a row of the table and stops nothing; the exit code tells.
fn run_batch(
    arguments: &RecordingArguments,
    directory: &Path,
    output: &Path,
) -> Result<Outcome, IdentifyError> {
    let options = BatchOptions {
        jobs: arguments.jobs.map_or_else(
            || std::thread::available_parallelism().map_or(1, usize::from),
            usize::from,
        ),
        again: arguments.common.force,
        map: TopicMap::from_arguments(arguments.map.iter().map(String::as_str))?,
        settings: settings(&arguments.common),
    };
    let is_watched = std::io::stderr().is_terminal();
    let total = batch::recordings(directory)?.len();
    let bar = if is_watched {
        ProgressBar::new(total as u64)
    } else {
        ProgressBar::hidden()
    };
    let done = AtomicUsize::new(0);
    let rows = batch::run(directory, output, &options, &|row, is_old| {
        bar.inc(1);
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        // A log shows how far a long batch is.
        if !is_watched && !is_old {
            let failed = if row.outcome == batch::Outcome::Failed {
                ", failed"
            } else {
                ""
            };
            eprintln!("{done} of {}: {}{failed}", total.max(done), row.name);
        }
    })?;
    bar.finish_and_clear();
    if arguments.common.json {
        println!("{:#}", serde_json::json!(rows));
    } else {
        for row in &rows {
            println!("{}", row.line());
        }
        let count = |outcome| rows.iter().filter(|row| row.outcome == outcome).count();
        println!(
            "{} recording{}: {} identified, {} not identifiable, {} failed; {}",
            rows.len(),
            if rows.len() == 1 { "" } else { "s" },
            count(batch::Outcome::Identified),
            count(batch::Outcome::NotIdentifiable),
            count(batch::Outcome::Failed),
            output.join("summary.csv").display()
        );
    }
    let has_failed = |row: &batch::BatchRow| row.outcome == batch::Outcome::Failed;
    Ok(if rows.iter().any(has_failed) {
        Outcome::Failed
    } else if rows.iter().any(|row| row.damage.is_some()) {
        Outcome::DataLost
    } else {
        Outcome::Fine
    })
}

fn run_recording(arguments: &RecordingArguments) -> Result<Outcome, IdentifyError> {
    if let (Some(directory), Some(output)) = (&arguments.batch, &arguments.output) {
        return run_batch(arguments, directory, output);
    }
    let (Some(recording), Some(output)) = (&arguments.recording, &arguments.output) else {
        return Ok(Outcome::Fine);
    };
    if recording.is_dir() {
        return Err(IdentifyError::Directory(recording.clone()));
    }
    let map = TopicMap::from_arguments(arguments.map.iter().map(String::as_str))?;
    refuse_existing(output, &FILES, arguments.common.force)?;
    let progress = Progress::start();
    let settings = settings(&arguments.common);
    let identified = identify_confirmed(
        recording,
        &arguments.common.confirm,
        &map,
        &settings,
        &mut |stage| progress.finished(stage),
    )?;
    progress.end();
    let lost = identified
        .report
        .notes
        .iter()
        .any(|note| note.starts_with(DAMAGED));
    finish(identified, output, &arguments.common)?;
    Ok(if lost {
        Outcome::DataLost
    } else {
        Outcome::Fine
    })
}

fn run_table(arguments: &TableArguments) -> Result<Outcome, IdentifyError> {
    let columns = TableColumns {
        time: arguments.time.clone(),
        position: arguments.position.clone(),
        effort: arguments.effort.clone(),
    };
    let kind = match arguments.kind {
        Kind::Revolute => JointKind::Revolute,
        Kind::Prismatic => JointKind::Prismatic,
    };
    refuse_existing(&arguments.output, &FILES, arguments.common.force)?;
    let progress = Progress::start();
    let mut doubtful = Vec::new();
    let mut read = |path: &Path| -> Result<_, IdentifyError> {
        let samples = read_table(path, &columns, kind)?;
        for doubt in doubts(&samples) {
            let doubt = format!("{}: doubtful: {doubt}", path.display());
            eprintln!("{doubt}");
            doubtful.push(doubt);
        }
        Ok(samples)
    };
    let samples = read(&arguments.table)?;
    progress.finished(Stage::Read);
    let hash = sha256(&arguments.table)?;
    let recipe = arguments.lowpass_hz.map(|lowpass_hz| Recipe {
        lowpass_hz,
        lowpass_order: arguments.lowpass_order.map_or(4, usize::from),
        decimate: arguments.decimate.map_or(1, usize::from),
        drop_border: arguments.drop_border,
        offset: arguments.offset,
    });
    let analysis = match recipe {
        Some(recipe) => identify_published(&samples, &recipe)?,
        None => {
            let mut others = Vec::new();
            for path in &arguments.common.confirm {
                if sha256(path)? == hash {
                    return Err(IdentifyError::Confirm {
                        path: path.clone(),
                        source: Box::new(IdentifyError::ConfirmsItself),
                    });
                }
                let name = path
                    .file_name()
                    .map_or_else(String::new, |n| n.to_string_lossy().into_owned());
                others.push((name, read(path)?));
            }
            analyse_confirmed(&samples, &settings(&arguments.common), &others)?
        }
    };
    progress.end();
    let mut identified = identified_table(&arguments.table, hash, &samples, analysis);
    identified.report.notes.extend(doubtful);
    finish(identified, &arguments.output, &arguments.common)?;
    Ok(Outcome::Fine)
}

fn run_track(arguments: &TrackArguments) -> Result<Outcome, IdentifyError> {
    if let Some(directory) = &arguments.output {
        refuse_existing(directory, &["joint.json"], arguments.force)?;
    }
    let mut found = Vec::new();
    let mut outcome = Outcome::Fine;
    if !arguments.json {
        println!(
            "{:<28} {:<10} {:>9} {:>6} {:>8}  {:<22}  point m",
            "track", "kind", "size m", "+- m", "rms mm", "axis"
        );
    }
    for path in &arguments.tracks {
        let joint = match identify_track(path) {
            Ok(joint) => joint,
            Err(error) => {
                eprintln!("ft-identify: {error}");
                outcome = Outcome::Failed;
                continue;
            }
        };
        let one_joint = joint.is_one_joint();
        if !one_joint && !matches!(outcome, Outcome::Failed) {
            outcome = Outcome::DataLost;
        }
        let name = path
            .file_name()
            .map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        if !arguments.json {
            println!("{}", track_line(&name, &joint));
        }
        let described = Joint::of_poses(
            &joint.joint.axis,
            &joint.joint,
            &joint.candidates,
            joint.q_range,
        );
        found.push(serde_json::json!({ "file": name, "one_joint": one_joint, "joint": described }));
    }
    let none = found.is_empty();
    let text = format!("{:#}", serde_json::Value::Array(found));
    if arguments.json {
        println!("{text}");
    }
    if let Some(directory) = arguments.output.as_ref().filter(|_| !none) {
        let path = directory.join("joint.json");
        std::fs::create_dir_all(directory)
            .and_then(|()| replace(&path, &text))
            .map_err(|source| IdentifyError::Write {
                path: path.clone(),
                source,
            })?;
        eprintln!("wrote {}", path.display());
    }
    Ok(outcome)
}

fn track_line(name: &str, found: &TrackJoint) -> String {
    let size = found.radius.unwrap_or(found.q_range[1] - found.q_range[0]);
    let what = if found.radius.is_some() { "r" } else { "l" };
    let spread = found
        .radius
        .map_or_else(String::new, |_| format!("{:.3}", found.joint.radius_std));
    if !found.is_one_joint() {
        return format!(
            "{name:<28} not one joint: the best one is {}, positions are {:.1} mm root mean square off it (at most {:.0} mm)",
            found.candidates.kind.name(),
            1e3 * found.joint.position_rms,
            1e3 * MOST_OFF_PATH_M
        );
    }
    let three = |v: [f64; 3]| format!("[{:.3} {:.3} {:.3}]", v[0], v[1], v[2]);
    let axis = &found.joint.axis;
    // A slide has no place.
    let point = found
        .radius
        .map_or_else(String::new, |_| three(axis.point.coords.into()));
    let line = format!(
        "{name:<28} {:<10} {what} {size:7.3} {spread:>6} {:8.2}  {:<22}  {point}",
        found.candidates.kind.name(),
        1e3 * found.joint.position_rms,
        three(axis.direction.into_inner().into()),
    );
    line.trim_end().to_owned()
}

fn finish(mut identified: Identified, output: &Path, common: &Common) -> Result<(), IdentifyError> {
    if common.estimator == Estimator::Paper {
        match ft_identify::paper::identify(&identified.samples, &PaperSettings::default()) {
            Ok(fit) => identified.report = identified.report.with_paper(&fit),
            Err(error) => {
                let note = format!("the paper's estimator gives nothing: {error}");
                identified.report.notes.push(note);
            }
        }
    }
    let files = write_to(output, &identified)?;
    if common.json {
        let text = identified.report.to_json();
        println!(
            "{}",
            text.map_err(|error| IdentifyError::Write {
                path: output.to_owned(),
                source: error.into()
            })?
        );
    } else {
        print!("{}", identified.report.summary());
        if let Some(page) = files
            .iter()
            .find(|file| file.extension().is_some_and(|e| e == "html"))
        {
            println!("report     {}", page.display());
        }
    }
    Ok(())
}

fn settings(common: &Common) -> MotionSettings {
    let usual = MotionSettings::default();
    match common.cutoff_hz {
        Some(cutoff_hz) => MotionSettings {
            cutoff_hz,
            gives_way: false,
            ..usual
        },
        None => usual,
    }
}

fn sha256(path: &Path) -> Result<String, IdentifyError> {
    let bytes = std::fs::read(path).map_err(|source| TrackError::Io {
        path: path.to_owned(),
        source,
    })?;
    Ok(Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect())
}

/// A line on the terminal once the work has taken two seconds; nothing when there is no terminal.
struct Progress(ProgressBar);

impl Progress {
    fn start() -> Self {
        if !std::io::stderr().is_terminal() {
            return Self(ProgressBar::hidden());
        }
        let bar = ProgressBar::new(5);
        if let Ok(style) = ProgressStyle::with_template("{bar:20} {msg} {elapsed}") {
            bar.set_style(style);
        }
        bar.set_draw_target(indicatif::ProgressDrawTarget::stderr_with_hz(1));
        bar.enable_steady_tick(Duration::from_secs(2));
        Self(bar)
    }

    fn finished(&self, stage: Stage) {
        let next = match stage {
            Stage::Read => "aligning the streams",
            Stage::Aligned => "weighing the tool",
            Stage::Payload => "finding the joint",
            Stage::Joint => "fitting the dynamics",
            Stage::Dynamics => "writing the report",
        };
        if self.0.elapsed() > Duration::from_secs(2) {
            self.0.set_message(next);
        }
        self.0.inc(1);
    }

    fn end(&self) {
        self.0.finish_and_clear();
    }
}
