//! A calibration by the files that it reads and writes.

use std::fs::File;
use std::io::Write as _;
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
    outputs.refuse_twice(file)?;
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
        let file = if outputs.overwrite {
            File::create(path)
        } else {
            File::create_new(path)
        };
        file.and_then(|mut file| file.write_all(text.as_bytes()))
            .map_err(|source| CalibrateError::Write {
                path: path.to_owned(),
                source,
            })
    };
    if let Some(path) = outputs.toml {
        write(path, found.to_toml(&recording)?)?;
    }
    if let Some(path) = outputs.plot {
        write(path, plot::page(&recording.path, &found))?;
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

impl Outputs<'_> {
    /// Refuses outputs of one name, and one that is the source: the later would take the place of the other.
    fn refuse_twice(&self, source: &Path) -> Result<(), CalibrateError> {
        let named = [Some(source), self.recording, self.toml, self.plot];
        let named: Vec<&Path> = named.into_iter().flatten().collect();
        for (i, path) in named.iter().enumerate() {
            let before = named.get(..i).unwrap_or_default();
            if before.iter().any(|other| is_one_file(other, path)) {
                return Err(CalibrateError::Twice {
                    path: (*path).to_owned(),
                });
            }
        }
        Ok(())
    }
}

/// Whether both names lead to one file, also to one that is not there yet.
fn is_one_file(a: &Path, b: &Path) -> bool {
    let place = |path: &Path| {
        path.canonicalize().ok().or_else(|| {
            let folder = path.parent().filter(|folder| *folder != Path::new(""));
            let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
            Some(folder.join(path.file_name()?))
        })
    };
    a == b || place(a).is_some_and(|a| place(b) == Some(a))
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

    use super::*;

    #[test]
    fn no_output_takes_the_place_of_the_source_or_of_another() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let source = path("shake.mcap");
        std::fs::write(&source, b"the only one").unwrap();
        let link = path("link.toml");
        std::os::unix::fs::symlink(&source, &link).unwrap();
        let (toml, plot, same) = (path("a.toml"), path("a.html"), path("./a.toml"));
        let asked = |outputs: Outputs<'_>| {
            let outputs = Outputs {
                overwrite: true,
                ..outputs
            };
            let options = CalibrateOptions::default();
            let error = calibrate_file(&source, &TopicMap::default(), &options, &outputs);
            matches!(error, Err(CalibrateError::Twice { .. }))
        };
        let with = |toml, plot| Outputs {
            toml: Some(toml),
            plot: Some(plot),
            ..Outputs::default()
        };
        assert!(asked(with(&source, &plot)));
        assert!(asked(with(&toml, &source)));
        assert!(asked(with(&link, &plot)));
        assert!(asked(with(&toml, &same)));
        let both = Outputs {
            recording: Some(&same),
            toml: Some(&toml),
            ..Outputs::default()
        };
        assert!(asked(both));
        assert_eq!(std::fs::read(&source).unwrap(), b"the only one");
        // What is no recording is refused for that.
        assert!(!asked(with(&toml, &plot)));
    }
}
