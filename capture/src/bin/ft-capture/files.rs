//! `ft-capture devices`, `init`, `check`, `recover` and `replay`.

use std::path::{Path, PathBuf};

use ft_capture::gyro::Gyroscope;
use ft_capture::init::{self, Found};
use ft_capture::session::{replay, retime};
use ft_recording::message::Imu;
use ft_recording::{Message as _, ReadError, Recording, TopicMap, check, recover};

use crate::terminal::say;
use crate::{CommandResult, Outcome};

/// Of `devices`.
pub(crate) const DEVICES_EXAMPLES: &str = "Examples:
  ft-capture devices                        ports, CAN interfaces and HID axes, the driver that may take each, and what is missing
  ft-capture devices && ft-capture init     then a first capture.toml from them";

/// Of `init`.
pub(crate) const INIT_EXAMPLES: &str = "Examples:
  ft-capture init                           capture.toml here, with a line to choose a driver for each device
  ft-capture init -o blue.toml              another name; then: ft-capture --config blue.toml
  ft-capture init --force                   in place of one that is there";

/// Of `check`.
pub(crate) const CHECK_EXAMPLES: &str = "Examples:
  ft-capture check door.mcap                            rates, gaps, losses, clocks, and one verdict
  ft-capture check door.mcap --json | jq .verdict       \"fine\", \"lossy\" or \"unusable\"
  ft-capture check door.mcap.partial                    one that was not finished; `recover` makes it whole
  ft-capture check bag.mcap --map /wrench=/ft/wrench --map /pose=/tcp/pose       other topic names
  ft-capture check bag.mcap --map /imu=/ft/imu          compare a gyroscope's turns with the poses' (if it has the wrench's clock)
  ft-capture check door.mcap --retime better.mcap       device clocks smoothed over the whole recording, into a new one

Columns: gaps = numbers that did not come, holes = times of more than three medians that the stream's own jitter does not explain,
dupl. = repeated messages, late = stamped before one that came earlier, same = values that repeat under a new stamp, cover% = time that is in no hole.
Exit codes: 0 nothing is known to be missing, 1 it cannot be read, 3 data was lost or a needed topic is missing.";

/// Of `recover`.
pub(crate) const RECOVER_EXAMPLES: &str = "Examples:
  ft-capture recover door.mcap.partial                  into door.mcap: all but the last quarter of a second
  ft-capture recover torn.mcap -o saved.mcap            of a damaged recording, all that can be read
  ft-capture recover door.mcap.partial -o door.mcap --force --json

The source stays as it is. One that is still being written is refused: end the recording first.
Exit codes: 0 nothing is missing, 1 nothing was written, 3 written, and something is missing.";

/// Of `replay`.
pub(crate) const REPLAY_EXAMPLES: &str = "Examples:
  ft-capture replay door.mcap -o again.mcap             the recorded bytes through the drivers of this version
  ft-capture replay door.mcap -o again.mcap --json      the summary for programs

Needs the topics /raw/<device> and the configuration that ft-capture writes into its own recordings. Marks, calibration and frames come along.";

/// Lists what is plugged in.
pub(crate) fn devices() -> CommandResult {
    let found = Found::now();
    for port in &found.ports {
        say(&port.to_string())?;
    }
    for interface in &found.interfaces {
        say(&interface.to_string())?;
    }
    for adapter in &found.adapters {
        say(&adapter.to_string())?;
    }
    for hid in &found.hids {
        say(&hid.to_string())?;
    }
    if found.is_empty() {
        say(
            "no serial port with a USB identity, no CAN interface or adapter and no HID device with an axis is there",
        )?;
        say("(a simulated gripper needs none: ft-capture --sim)")?;
    }
    Ok(Outcome::Fine)
}

/// Writes a first configuration from what is plugged in.
pub(crate) fn init(output: &Path, force: bool) -> CommandResult {
    let found = Found::now();
    if found.is_empty() {
        return Err("nothing is plugged in that a configuration could be written from: plug the devices in and see \
                    `ft-capture devices`; `ft-capture --sim` needs none"
            .into());
    }
    let text = init::capture_toml(&found);
    let file = if force {
        std::fs::File::create(output)
    } else {
        std::fs::File::create_new(output)
    };
    file.and_then(|mut file| std::io::Write::write_all(&mut file, text.as_bytes()))
        .map_err(|error| match error.kind() {
            std::io::ErrorKind::AlreadyExists => {
                format!(
                    "{} exists: name another with -o, or replace it with --force",
                    output.display()
                )
            }
            _ => format!("{}: {error}", output.display()),
        })?;
    say(&format!(
        "written to {}: choose the drivers in it",
        output.display()
    ))?;
    Ok(Outcome::Fine)
}

/// Tells whether a recording is whole, or the new one that is made of it with its clocks smoothed; `map` as the reader takes it.
pub(crate) fn check(
    file: &Path,
    map: &[String],
    retimed: Option<&Path>,
    force: bool,
    json: bool,
) -> CommandResult {
    let map = TopicMap::from_arguments(map.iter().map(String::as_str))?;
    let moved = retimed
        .map(|out| retime::retime(file, out, force))
        .transpose()?;
    let checked = Checked::of(retimed.unwrap_or(file), &map)?;
    match (&moved, json) {
        (None, true) => say(&serde_json::to_string_pretty(&checked)?)?,
        (Some(moved), true) => {
            let both = serde_json::json!({ "check": checked, "retimed": moved });
            say(&serde_json::to_string_pretty(&both)?)?;
        }
        (moved, false) => {
            if let Some(moved) = moved {
                say(&moved.to_string())?;
            }
            if let Some(gyroscope) = &checked.gyroscope {
                say(&gyroscope.to_string())?;
            }
            say(&checked.report.to_string())?;
        }
    }
    Ok(Outcome::of(checked.report.lost_data()))
}

/// What a recording is worth, and what a gyroscope in it says of its poses' stamps.
#[derive(serde::Serialize)]
struct Checked {
    #[serde(flatten)]
    report: check::Report,
    /// `null` when no inertial unit was recorded.
    gyroscope: Option<Gyroscope>,
}

impl Checked {
    fn of(file: &Path, map: &TopicMap) -> Result<Self, ReadError> {
        let report = check::check_mapped(file, map)?;
        let has_imu = report
            .topics
            .values()
            .any(|topic| topic.kind == Imu::TYPE_NAME);
        // What lacks the wrench or the poses has nothing to be compared.
        let recording = has_imu.then(|| Recording::load(file, map).ok()).flatten();
        let gyroscope =
            recording.and_then(|recording| Gyroscope::of(&recording, &recording.pose.samples));
        Ok(Self { report, gyroscope })
    }
}

/// Makes a complete recording of what a crash left.
pub(crate) fn recover(
    file: &Path,
    output: Option<PathBuf>,
    force: bool,
    json: bool,
) -> CommandResult {
    let output = match output {
        Some(output) => output,
        None => default_output(file)?,
    };
    refuse_source(file, &output)?;
    let recovered = recover::recover(file, &output, force)?;
    if json {
        say(&serde_json::to_string_pretty(&recovered)?)?;
    } else {
        say(&recovered.to_string())?;
        say(&format!("written to {}", output.display()))?;
    }
    Ok(Outcome::of(recovered.lost_data()))
}

/// Refuses to write over what is read, and to write a recording in place of a folder.
pub(crate) fn refuse_source(source: &Path, output: &Path) -> Result<(), String> {
    let name = output.display();
    if replay::is_same(source, output) {
        return Err(format!(
            "{name} is the recording that is read: name another for the new one with -o"
        ));
    }
    if output.is_dir() {
        return Err(format!("{name} is a folder: name a file in it with -o"));
    }
    Ok(())
}

fn default_output(file: &Path) -> Result<PathBuf, String> {
    match file.extension() {
        Some(extension) if extension == "partial" => Ok(file.with_extension("")),
        _ => Err(format!(
            "{}: name the new recording with -o (only *.partial has a default)",
            file.display()
        )),
    }
}

/// Sends a recording's raw frames through the drivers again.
pub(crate) fn replay(file: &Path, output: &Path, force: bool, json: bool) -> CommandResult {
    refuse_source(file, output)?;
    let summary = replay::replay(file, output, force)?;
    if json {
        say(&serde_json::to_string_pretty(&summary)?)?;
    } else {
        say(&summary.to_string())?;
    }
    Ok(Outcome::of(summary.lost_data()))
}
