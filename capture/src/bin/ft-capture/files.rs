//! `ft-capture devices`, `init`, `check`, `recover` and `replay`.

use std::path::{Path, PathBuf};

use ft_capture::init::{self, Found};
use ft_capture::session::{replay, retime};
use ft_recording::{TopicMap, check, recover};

use crate::terminal::say;
use crate::{CommandResult, Outcome};

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
    let text = init::capture_toml(&Found::now());
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
    let report = check::check_mapped(retimed.unwrap_or(file), &map)?;
    match (&moved, json) {
        (None, true) => say(&serde_json::to_string_pretty(&report)?)?,
        (Some(moved), true) => {
            let both = serde_json::json!({ "check": report, "retimed": moved });
            say(&serde_json::to_string_pretty(&both)?)?;
        }
        (moved, false) => {
            if let Some(moved) = moved {
                say(&moved.to_string())?;
            }
            say(&report.to_string())?;
        }
    }
    Ok(Outcome::of(report.lost_data()))
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
    let recovered = recover::recover(file, &output, force)?;
    if json {
        say(&serde_json::to_string_pretty(&recovered)?)?;
    } else {
        say(&recovered.to_string())?;
        say(&format!("written to {}", output.display()))?;
    }
    Ok(Outcome::of(recovered.lost_data()))
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
    let summary = replay::replay(file, output, force)?;
    if json {
        say(&serde_json::to_string_pretty(&summary)?)?;
    } else {
        say(&summary.to_string())?;
    }
    Ok(Outcome::of(summary.lost_data()))
}
