//! `ft-capture import-aria`, `import-hoi`, `import-csv` and `import-bag`.

use std::path::{Path, PathBuf};

use clap::Args;
use ft_capture::calibrate::CalibrateOptions;
use ft_capture::config::{ConfigError, SaidFrames, load_calibration};
use ft_capture::import::aria::{AriaOptions, import_aria};
use ft_capture::import::bag::{BagTopics, import_bag};
use ft_capture::import::hoi;
use ft_capture::import::tables::{RowTime, TableOptions, import_tables};
use ft_recording::TopicMap;

use crate::calibrate::{positive, seconds_range};
use crate::files::refuse_source;
use crate::terminal::say;
use crate::{CommandResult, Outcome};

const ARIA_EXAMPLES: &str = "Examples:
  ft-capture import-aria rec.mcap --mps mps_glasses/ -o door.mcap
  ft-capture import-aria rec.mcap --mps mps/slam/open_loop_trajectory.csv --frames capture.toml -o door.mcap
  ft-capture import-aria rec.mcap --mps mps/ --starts-at 38.5 -o door.mcap      no utc, or a wrong one: 38.5 s after the first wrench, +-10 s

The offset between the glasses and the wrench is found from the free air (marks free_air_begin and grasp): shake and turn
the tool there for 10 s, and for 6 s after the release too: both show how the clocks drift apart, and that is taken out. --no-align
keeps the times as they are. A gyroscope in the recording that has the wrench's clock checks the result: /ft/imu, or another name by
--map /their/imu=/ft/imu.

Exit code 3 when more than half of the poses are left out, or poses have no wrench, or wrenches no poses, for 2 s or more.";

/// What to import.
#[derive(Debug, Args)]
#[command(after_help = ARIA_EXAMPLES)]
pub(crate) struct AriaArguments {
    /// Recording of the wrench
    recording: PathBuf,
    /// Folder of the MPS results, or one trajectory file
    #[arg(long, value_name = "DIR")]
    mps: PathBuf,
    /// The new recording
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
    /// A capture.toml, or another file, with [frames]; what it does not say is taken from the recording's /tf_static
    #[arg(long, value_name = "FILE.toml")]
    frames: Option<PathBuf>,
    /// Seconds after the first wrench at which the trajectory begins [default: by utc]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = seconds)]
    starts_at: Option<f64>,
    /// Keep the times: do not align by the tool's own wrench
    #[arg(long)]
    no_align: bool,
    /// Free air, s after the first wrench [default: by the marks, else all]
    #[arg(long, value_name = "FROM..TO", value_parser = seconds_range)]
    free_air: Option<(f64, f64)>,
    /// How far the times may be off, s
    #[arg(long, default_value_t = 10.0, value_parser = positive)]
    search: f64,
    /// Leave out poses of a lower quality_score, 0 to 1
    #[arg(long, default_value_t = 0.0, value_parser = quality)]
    min_quality: f64,
    /// Take the open-loop trajectory even when there is a closed-loop one
    #[arg(long)]
    open_loop: bool,
    /// Read a topic of another name: /their/topic=/ft/wrench; in the new recording it keeps its name
    #[arg(long, value_name = "THEIRS=OURS")]
    map: Vec<String>,
    /// Replace an existing recording
    #[arg(long)]
    force: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// What `load` makes of the file of an option, if it is given.
fn of_file<T>(
    option: &str,
    path: Option<&Path>,
    load: impl FnOnce(&Path) -> Result<T, ConfigError>,
) -> Result<Option<T>, Box<dyn std::error::Error>> {
    let loaded = path.map(|path| match load(path) {
        Ok(loaded) => Ok(loaded),
        Err(ConfigError::Unreadable { path, source }) => {
            Err(format!("{option} {}: {source}", path.display()).into())
        }
        Err(error) => Err(Box::<dyn std::error::Error>::from(error)),
    });
    loaded.transpose()
}

/// A span, either way.
fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok();
    number
        .filter(|number| number.abs() <= 1e8)
        .ok_or_else(|| "a number from -1e8 to 1e8".to_owned())
}

/// A share.
fn quality(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok();
    number
        .filter(|number| (0.0..=1.0).contains(number))
        .ok_or_else(|| "a number from 0 to 1".to_owned())
}

/// Carries `import-aria` out.
pub(crate) fn aria(arguments: &AriaArguments) -> CommandResult {
    let frames = of_file("--frames", arguments.frames.as_deref(), SaidFrames::load)?;
    let options = AriaOptions {
        frames,
        starts_at_s: arguments.starts_at,
        align: !arguments.no_align,
        calibrate: CalibrateOptions {
            free_air: arguments.free_air,
            search_s: arguments.search,
            find_rotation: false,
        },
        min_quality: arguments.min_quality,
        open_loop: arguments.open_loop,
        map: TopicMap::from_arguments(arguments.map.iter().map(String::as_str))?,
        overwrite: arguments.force,
    };
    refuse_source(&arguments.recording, &arguments.output)?;
    let report = import_aria(
        &arguments.recording,
        &arguments.mps,
        &arguments.output,
        &options,
    )?;
    told(&report, arguments.json)?;
    Ok(Outcome::of(report.lost_data()))
}

const HOI_EXAMPLES: &str = "Examples:
  ft-capture import-hoi extracted/kitchen/gripper -o recordings/      every recording of a location
  ft-capture import-hoi extracted/ -o recordings/                     of all locations; those already there are passed over
  ft-identify --batch recordings/ -o results/                         then identify them all

Clocks that are up to 0.5 s apart are put right by the free air before the grasp. Poses without a wrench for 2 s or more, by a file that is
cut short, are said, with exit code 3.

DIR holds gripper/<name>_gripper_bag and aria_gripper/<name>_gripper_vrs; any folder may be a zip, also gripper/ itself or the location's.
Recordings of one name in several folders go below these folders' names.";

/// What to import.
#[derive(Debug, Args)]
#[command(after_help = HOI_EXAMPLES)]
pub(crate) struct HoiArguments {
    /// Folder of the extracted dataset, or any part of it
    directory: PathBuf,
    /// Folder of the new recordings, <name>.mcap each; or one FILE.mcap for a single recording
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Replace existing recordings
    #[arg(long)]
    force: bool,
    /// Print the reports as JSON
    #[arg(long)]
    json: bool,
}

/// Carries `import-hoi` out: a recording that cannot be imported does not stop the others.
pub(crate) fn hoi(arguments: &HoiArguments) -> CommandResult {
    let found = hoi::parts(&arguments.directory)?;
    let (outputs, parts) = (found.outputs(), found.parts);
    for error in &found.unreadable {
        eprintln!("ft-capture: not looked into: {error}");
    }
    let is_file = |path: &Path| {
        path.extension()
            .is_some_and(|extension| extension == "mcap")
    };
    let single = is_file(&arguments.output);
    if single && parts.len() > 1 {
        return Err(format!(
            "{} recordings are there: give a folder with -o, not one file",
            parts.len()
        )
        .into());
    }
    let bar = bar_of(parts.len());
    let (mut reports, mut failed) = (Vec::new(), 0);
    let mut lost = !found.unreadable.is_empty();
    for (part, output) in parts.iter().zip(outputs) {
        let out = if single {
            arguments.output.clone()
        } else {
            arguments.output.join(output)
        };
        if let Some(folder) = out.parent().filter(|_| !single) {
            std::fs::create_dir_all(folder)
                .map_err(|error| format!("cannot create {}: {error}", folder.display()))?;
        }
        if !single && !arguments.force && out.exists() {
            reports
                .push(serde_json::json!({ "name": part.name, "path": out, "passed_over": true }));
            if !arguments.json {
                say(&format!(
                    "{}: {} is there already",
                    part.name,
                    out.display()
                ))?;
            }
            continue;
        }
        match hoi::import_part(part, &out, arguments.force) {
            Ok(report) => {
                lost |= report.lost_data();
                if !arguments.json {
                    say(&report.to_string())?;
                }
                reports.push(serde_json::to_value(&report)?);
            }
            Err(error) => {
                failed += 1;
                eprintln!("ft-capture: {}: {error}", part.name);
                reports.push(serde_json::json!({ "name": part.name, "error": error.to_string() }));
            }
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    if arguments.json {
        say(&serde_json::to_string_pretty(&reports)?)?;
    }
    match failed {
        0 => Ok(Outcome::of(lost)),
        _ => Err(format!(
            "{failed} of {} recordings could not be imported",
            parts.len()
        )
        .into()),
    }
}

/// A bar on a terminal when there is more than one recording.
fn bar_of(count: usize) -> indicatif::ProgressBar {
    if count > 1 && std::io::IsTerminal::is_terminal(&std::io::stderr()) {
        indicatif::ProgressBar::new(count as u64)
    } else {
        indicatif::ProgressBar::hidden()
    }
}

const CSV_EXAMPLES: &str = "Examples:
  ft-capture import-csv --wrench Wrench_interaction_saved.csv --pose baton_pose_saved.csv --rate 120 -o baton.mcap
  ft-capture import-csv --wrench ft.csv --pose tracker.csv --time t --time-unit us --wrench-columns a,b,c,d,e,f -o a.mcap
  ft-capture import-csv --wrench ft.csv --pose tcp.csv --time t --frames frames.toml --calibration calibration.toml -o a.mcap
  ft-capture calibrate shake.mcap --find-rotation --toml both.toml      finds both in a recording with free air; both.toml serves for either

Then `ft-capture check baton.mcap` says what the recording is worth. Force and torque in N and N m, environment on tool, in the sensor's
axes; poses in m, world from tool centre point, z up. Rows without a usable stamp, of another time than the most, or of a stamp twice are
left out and counted; exit code 3 when these are more than half, or poses have no wrench for 2 s or more.";

/// What to import.
#[derive(Debug, Args)]
#[command(after_help = CSV_EXAMPLES)]
pub(crate) struct CsvArguments {
    /// Table of the wrench
    #[arg(long, value_name = "FILE.csv")]
    wrench: PathBuf,
    /// Table of the poses
    #[arg(long, value_name = "FILE.csv")]
    pose: PathBuf,
    /// The new recording
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
    /// Rows of both tables are even, so many a second
    #[arg(long, value_name = "HZ", value_parser = rate, required_unless_present = "time", conflicts_with = "time")]
    rate: Option<f64>,
    /// Column of the time in both tables
    #[arg(long, value_name = "COLUMN")]
    time: Option<String>,
    /// Unit of that column
    #[arg(long, value_name = "s|ms|us|ns", default_value = "s", value_parser = ["s", "ms", "us", "ns"])]
    time_unit: String,
    /// Columns of force and torque [default: Fx,Fy,Fz,Tx,Ty,Tz or the like]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    wrench_columns: Vec<String>,
    /// Columns of position and quaternion x y z w [default: x,y,z,qx,qy,qz,qw or x,y,z,q0,q1,q2,q3]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pose_columns: Vec<String>,
    /// The sensor reports what the tool does to the environment: turn the signs round
    #[arg(long)]
    negate: bool,
    /// Where the sensor is on the tool: a file with [frames.tcp_from_ft_sensor]
    #[arg(long, value_name = "FILE.toml")]
    frames: Option<PathBuf>,
    /// The tool's weight and the sensor's bias: a file with [calibration]
    #[arg(long, value_name = "FILE.toml")]
    calibration: Option<PathBuf>,
    /// Replace an existing recording
    #[arg(long)]
    force: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// A rate of rows.
fn rate(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok();
    number
        .filter(|number| (0.1..=100_000.0).contains(number))
        .ok_or_else(|| "a number from 0.1 to 100000".to_owned())
}

/// So many names or none.
fn names<const N: usize>(given: &[String], flag: &str) -> Result<Option<[String; N]>, String> {
    if given.is_empty() {
        return Ok(None);
    }
    <[String; N]>::try_from(given.to_vec())
        .map(Some)
        .map_err(|given| format!("{flag}: {} names, expected {N}", given.len()))
}

/// Carries `import-csv` out.
pub(crate) fn csv(arguments: &CsvArguments) -> CommandResult {
    let unit_ns = match arguments.time_unit.as_str() {
        "ns" => 1,
        "us" => 1_000,
        "ms" => 1_000_000,
        _ => 1_000_000_000,
    };
    let time = match (&arguments.time, arguments.rate) {
        (Some(column), _) => RowTime::Column(column.clone(), unit_ns),
        (None, hz) => RowTime::Rate(hz.unwrap_or(1.0)),
    };
    let options = TableOptions {
        time,
        wrench_columns: names(&arguments.wrench_columns, "--wrench-columns")?,
        pose_columns: names(&arguments.pose_columns, "--pose-columns")?,
        negate_wrench: arguments.negate,
        frames: of_file("--frames", arguments.frames.as_deref(), SaidFrames::load)?,
        calibration: of_file(
            "--calibration",
            arguments.calibration.as_deref(),
            load_calibration,
        )?,
        overwrite: arguments.force,
    };
    let report = import_tables(
        &arguments.wrench,
        &arguments.pose,
        &arguments.output,
        &options,
    )?;
    told(&report, arguments.json)?;
    Ok(Outcome::of(report.lost_data()))
}

const BAG_EXAMPLES: &str = "Examples (the raw form of the Hoi! dataset, whose two clocks are not aligned):
  ft-capture import-bag raw/kitchen/gripper/gripper/kitchen_1-3_2024-05-20.bag -o wrench.mcap
  ft-capture import-aria wrench.mcap --mps raw/kitchen/gripper/aria_gripper/mps_kitchen_1-3_gripper_vrs --frames capture.toml \\
      --free-air 2..14 -o aligned.mcap                      where the tool is in free air says how far the clocks are apart
  ft-capture calibrate aligned.mcap --free-air 2..14 -o kitchen_1-3.mcap   the tool's mass and the bias

Chunks that are packed are refused: `rosbag decompress` unpacks them.";

/// What to import.
#[derive(Debug, Args)]
#[command(after_help = BAG_EXAMPLES)]
pub(crate) struct BagArguments {
    /// The bag
    bag: PathBuf,
    /// The new recording
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
    /// Topic of the wrench, geometry_msgs/WrenchStamped
    #[arg(long, value_name = "TOPIC", default_value = BagTopics::HOI.wrench)]
    wrench: String,
    /// Topic of the sensor's temperature, sensor_msgs/Temperature; may be missing
    #[arg(long, value_name = "TOPIC", default_value = BagTopics::HOI.temperature)]
    temperature: String,
    /// Topic of an inertial unit on the gripper by the wrench's clock, sensor_msgs/Imu; may be missing. Its gyroscope checks the alignment
    #[arg(long, value_name = "TOPIC", default_value = BagTopics::HOI.imu)]
    imu: String,
    /// Replace an existing recording
    #[arg(long)]
    force: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Carries `import-bag` out.
pub(crate) fn bag(arguments: &BagArguments) -> CommandResult {
    let bar = if std::io::IsTerminal::is_terminal(&std::io::stderr()) {
        indicatif::ProgressBar::new(0)
    } else {
        indicatif::ProgressBar::hidden()
    };
    let report = import_bag(
        &arguments.bag,
        &BagTopics {
            wrench: &arguments.wrench,
            temperature: &arguments.temperature,
            imu: &arguments.imu,
        },
        &arguments.output,
        arguments.force,
        &mut |bytes, of| {
            bar.set_length(of);
            bar.set_position(bytes);
        },
    )?;
    bar.finish_and_clear();
    if arguments.json {
        say(&serde_json::to_string_pretty(&report)?)?;
    } else {
        say(&report.to_string())?;
    }
    Ok(Outcome::of(report.lost_data()))
}

/// Says what was done, for people or as JSON.
fn told<R: serde::Serialize + core::fmt::Display>(report: &R, json: bool) -> CommandResult {
    if json {
        say(&serde_json::to_string_pretty(report)?)?;
    } else {
        say(&report.to_string())?;
    }
    Ok(Outcome::Fine)
}
