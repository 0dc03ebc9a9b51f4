//! `ft-capture calibrate`.

use std::path::PathBuf;

use clap::Args;
use ft_capture::calibrate::{CalibrateOptions, Outputs, calibrate_file};
use ft_recording::TopicMap;

use crate::files::refuse_source;
use crate::terminal::say;
use crate::{CommandResult, Outcome};

const EXAMPLES: &str = "Examples:
  ft-capture calibrate shake.mcap                                   print it
  ft-capture calibrate shake.mcap --toml calibration.toml           for the [calibration] of later recordings
  ft-capture calibrate door.mcap -o door-cal.mcap --plot cal.html   into a new recording, from its free air before the grasp
  ft-capture calibrate door.mcap -o door-cal.mcap --align           and shift the poses by the offset found
  ft-capture calibrate shake.mcap --find-rotation --toml cal.toml   the sensor's rotation on the tool too, as [frames]

Hold the tool still for 2 s in four orientations or more, then shake and turn it for 10 s, in free air. A gyroscope in the recording that
has the wrench's clock (/ft/imu, or --map /their/imu=/ft/imu) checks the offset found. --json has everything, the covariance too.
Exit codes: 0 fine, 1 the data cannot tell, 3 done, and the recording's file is damaged.";

/// What to calibrate.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct CalibrateArguments {
    /// The recording
    file: PathBuf,
    /// A new recording with ft.calibration
    #[arg(short, long, value_name = "FILE.mcap")]
    output: Option<PathBuf>,
    /// The [calibration] of later recordings
    #[arg(long, value_name = "FILE.toml")]
    toml: Option<PathBuf>,
    /// A page with the residuals
    #[arg(long, value_name = "FILE.html")]
    plot: Option<PathBuf>,
    /// Shift the new recording's poses by the offset found
    #[arg(long, requires = "output")]
    align: bool,
    /// Free air, s after the first wrench [default: by the marks free_air_begin, grasp and release, else all]
    #[arg(long, value_name = "FROM..TO", value_parser = seconds_range)]
    free_air: Option<(f64, f64)>,
    /// How far pose and wrench may be apart, s
    #[arg(long, default_value_t = 10.0, value_parser = positive)]
    search: f64,
    /// Find how the sensor is turned on the tool too, whatever /tf_static says (where it sits must be known)
    #[arg(long)]
    find_rotation: bool,
    /// A topic in place of one of ours: /their/topic=/ft/wrench
    #[arg(long)]
    map: Vec<String>,
    /// Replace existing files
    #[arg(long)]
    force: bool,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// `3..20`, seconds.
pub(crate) fn seconds_range(text: &str) -> Result<(f64, f64), String> {
    let parts = text.split_once("..").and_then(|(from, to)| {
        let range: (f64, f64) = (from.parse().ok()?, to.parse().ok()?);
        (range.0 < range.1 && range.0.is_finite() && range.1.is_finite()).then_some(range)
    });
    parts.ok_or_else(|| "two numbers like 3..20, the first the smaller".to_owned())
}

/// A number above 0.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok();
    number
        .filter(|number| *number > 0.0 && *number <= 3600.0)
        .ok_or_else(|| "a number above 0 and at most 3600".to_owned())
}

/// Carries the command out.
pub(crate) fn run(arguments: &CalibrateArguments) -> CommandResult {
    let map = TopicMap::from_arguments(arguments.map.iter().map(String::as_str))?;
    let options = CalibrateOptions {
        free_air: arguments.free_air,
        search_s: arguments.search,
        find_rotation: arguments.find_rotation,
    };
    let outputs = Outputs {
        recording: arguments.output.as_deref(),
        toml: arguments.toml.as_deref(),
        plot: arguments.plot.as_deref(),
        shift: arguments.align,
        overwrite: arguments.force,
    };
    for output in [outputs.recording, outputs.toml, outputs.plot]
        .into_iter()
        .flatten()
    {
        refuse_source(&arguments.file, output)?;
    }
    let found = calibrate_file(&arguments.file, &map, &options, &outputs)?;
    if arguments.json {
        say(&serde_json::to_string_pretty(&found)?)?;
    } else {
        say(&found.to_string())?;
    }
    if let (true, Some(reason)) = (arguments.align, &found.not_aligned) {
        return Err(format!("the poses were not shifted: {reason}").into());
    }
    Ok(Outcome::of(found.damage.is_some()))
}
