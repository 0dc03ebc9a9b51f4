//! A calibration by the files that it reads and writes.

use std::path::Path;

use ft_recording::rewrite::Rewrite;
use ft_recording::{Pose7, Recording, TopicMap, metadata, topic};
use ft_wire::frames::{Frame as _, FtSensor, Tcp};

use super::{CalibrateError, CalibrateOptions, Calibrated, calibrate, plot};
use crate::config::{Frames, StaticPose};

/// Calibrates `file` and writes what was asked for: a new recording with `ft.calibration`, its poses shifted by the
/// alignment when `shift` is set; a `calibration.toml`; a page with the residuals.
///
/// # Errors
/// [`CalibrateError`].
pub fn calibrate_file(
    file: &Path,
    map: &TopicMap,
    options: &CalibrateOptions,
    outputs: &Outputs<'_>,
) -> Result<Calibrated, CalibrateError> {
    let there = [outputs.toml, outputs.plot].into_iter().flatten();
    if let Some(path) = there
        .filter(|path| path.exists())
        .find(|_| !outputs.overwrite)
    {
        return Err(CalibrateError::Exists {
            path: path.to_owned(),
        });
    }
    let recording = Recording::load(file, map)?;
    let found = calibrate(&recording, options)?;
    if let Some(out) = outputs.recording {
        let mut rewrite = Rewrite::new();
        rewrite.metadata(metadata::CALIBRATION, found.calibration.to_metadata()?);
        rewrite.metadata(
            metadata::CALIBRATED,
            found.details(&recording, outputs.shift && found.alignment.is_some()),
        );
        let start = super::start_of(&recording);
        if let Some(frames) = found.frames(&recording) {
            let sensor = &frames.tcp_from_ft_sensor;
            let pose = Pose7 {
                position: sensor.position_m,
                quaternion: sensor.quaternion_xyzw,
            };
            rewrite.set_frame(Tcp::NAME, FtSensor::NAME, pose, map, start);
        }
        if let (true, Some(alignment)) = (outputs.shift, found.alignment) {
            let map = map.clone();
            rewrite.restamp(move |name, stamp, _| match map.resolve(name) {
                Some(topic::ARIA_POSE | topic::TCP_POSE) => alignment.shifted(stamp, start),
                _ => stamp,
            });
        }
        rewrite.write(Some(file), out, outputs.overwrite)?;
    }
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).map_err(|source| CalibrateError::Write {
            path: path.to_owned(),
            source,
        })
    };
    if let Some(path) = outputs.toml {
        write(path, found.to_toml(&recording)?)?;
    }
    if let Some(path) = outputs.plot {
        write(path, plot::page(&recording, &found))?;
    }
    Ok(found)
}

/// What [`calibrate_file`] writes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outputs<'a> {
    /// The new recording.
    pub recording: Option<&'a Path>,
    /// The `[calibration]` of later recordings.
    pub toml: Option<&'a Path>,
    /// The residuals as a page.
    pub plot: Option<&'a Path>,
    /// Shift the new recording's poses by the alignment.
    pub shift: bool,
    /// Replace existing files.
    pub overwrite: bool,
}

impl Calibrated {
    /// The frames with the rotation that was found.
    pub(super) fn frames(&self, recording: &Recording) -> Option<Frames> {
        let pose = |pose: &Pose7| StaticPose {
            position_m: pose.position,
            quaternion_xyzw: pose.quaternion,
        };
        Some(Frames {
            aria_device_from_tcp: pose(&recording.aria_device_from_tcp),
            tcp_from_ft_sensor: StaticPose {
                position_m: recording.tcp_from_ft_sensor.position,
                quaternion_xyzw: self.rotation?.quaternion_xyzw,
            },
        })
    }
}
