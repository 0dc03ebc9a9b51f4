//! Recordings of the public Hoi! dataset in their extracted layout, one of ours for each.
//!
//! ```text
//! .../gripper/<name>_gripper_bag/force_torque/ft_sensor0/ft_sensor_readings/{wrench,temperature}/data.csv
//! .../gripper/<name>_gripper_bag/calib/{*camchain.yaml,*imu.yaml}
//! .../aria_gripper/<name>_gripper_vrs/slam/closed_loop_trajectory/data.csv
//! .../aria_gripper/<name>_gripper_vrs/calib/calib.json
//! ```
//!
//! Any folder may be a zip, also `gripper/`, the location's, or all. The stamps of both devices are already on one clock up to some ms; the tool's own wrench in the
//! free air before the grasp takes these away when it can, and weighs the tool. What is not there is named.
//!
//! # Source
//! `timengelbracht/hoi-dataset-tools`, commit f60ef16: `data_loader_gripper.py`, `data_loader_aria.py`, `utils_calibration.py`.

mod gyro;
mod pieces;
mod report;
mod weigh;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use ft_recording::message::{Header, Temperature, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{
    Calibration, Estimate, MessageStamps, Pose7, PoseTrack, Recording, Stamped, TrackedFrame,
    metadata, topic,
};
use ft_wire::HostTime;
use ft_wire::frames::{Frame, FtSensor};

pub use gyro::GyroCheck;
use pieces::Import;
pub use report::{HoiCalibration, HoiReport};
use weigh::{free_air, quiet_bias};

use super::archive::Tree;
use super::aria::{add_poses, import_entries};
use super::{ImportError, io, plausible};
use crate::calibrate::{Alignment, Calibrated};
use crate::config::Frames;
use crate::encode::static_transforms;

const BAG: &str = "_gripper_bag";
const VRS: &str = "_gripper_vrs";
/// Folders below the one that is given.
const DEPTH: usize = 6;
/// The dataset's own constants: kg, m in the sensor's axes.
const MASS_KG: f64 = 0.490;
const COM_M: [f64; 3] = [0.021, 0.020, 0.059];
const GRAVITY: f64 = 9.80665;

/// One recording of the dataset.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct HoiPart {
    /// `<location>_<range>`.
    pub name: String,
    /// The folder with `gripper/` and `aria_gripper/`; where an archive `a.zip` leads to it, it is named as a folder `a`.
    pub base: PathBuf,
}

/// The recordings below a folder.
#[derive(Debug, Default)]
pub struct HoiParts {
    /// By name and folder.
    pub parts: Vec<HoiPart>,
    /// Archives that could not be looked into.
    pub unreadable: Vec<ImportError>,
}

impl HoiParts {
    /// Where each part's recording goes below the folder of all: `<name>.mcap`, and for parts of one name in several folders of the
    /// dataset below these folders' names.
    #[must_use]
    pub fn outputs(&self) -> Vec<PathBuf> {
        let above = self.parts.first().map_or(Path::new(""), |first| {
            let holds_all =
                |folder: &&Path| self.parts.iter().all(|part| part.base.starts_with(folder));
            first
                .base
                .ancestors()
                .find(holds_all)
                .unwrap_or(Path::new(""))
        });
        let output = |part: &HoiPart| {
            let file = format!("{}.mcap", part.name);
            let alike = self.parts.iter().filter(|other| other.name == part.name);
            if alike.count() < 2 {
                return PathBuf::from(file);
            }
            part.base
                .strip_prefix(above)
                .unwrap_or(Path::new(""))
                .join(file)
        };
        self.parts.iter().map(output).collect()
    }
}

/// The recordings below a folder: their bags' folders or archives, also within archives.
///
/// # Errors
/// A folder cannot be listed, or there is none.
pub fn parts(folder: &Path) -> Result<HoiParts, ImportError> {
    // `.` has no parent by name.
    let folder = &folder.canonicalize().map_err(io("find", folder))?;
    let mut search = Search::default();
    search.visit(folder, DEPTH)?;
    let Search {
        found, unreadable, ..
    } = search;
    if found.is_empty() {
        let unreadable: Vec<_> = unreadable.iter().map(|e| format!(" ({e})")).collect();
        return Err(ImportError::Missing {
            path: folder.to_owned(),
            missing: format!("no folder or zip *{BAG}{}", unreadable.concat()),
            hint: "give <base>/extracted/<location>/gripper, or a folder above it; the raw layout (.bag, MPS folders) is read in \
                   steps: see `ft-capture import-bag --help`",
        });
    }
    Ok(HoiParts {
        parts: found.into_iter().collect(),
        unreadable,
    })
}

#[derive(Default)]
struct Search {
    tree: Tree,
    found: BTreeSet<HoiPart>,
    unreadable: Vec<ImportError>,
}

impl Search {
    fn visit(&mut self, path: &Path, depth: usize) -> Result<(), ImportError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if bag_name(&name).is_some() {
            self.add(path);
        } else if name.trim_end_matches(".zip").ends_with(VRS) {
            // Nothing but a trajectory is in it.
        } else if path.is_dir() {
            if depth == 0 {
                return Ok(());
            }
            for entry in std::fs::read_dir(path).map_err(io("list", path))? {
                self.visit(&entry.map_err(io("list", path))?.path(), depth - 1)?;
            }
        } else if name.ends_with(".zip")
            && let Err(error) = self.look_into(path)
        {
            self.unreadable.push(error);
        }
        Ok(())
    }

    /// Bags within an archive, by the names of its files.
    fn look_into(&mut self, zip: &Path) -> Result<(), ImportError> {
        let is_wanted = |name: &str| name.split('/').any(|part| bag_name(part).is_some());
        let names = self.tree.names(zip, "gripper", &is_wanted)?;
        let root = zip.with_extension("");
        for name in names.iter().filter(|name| is_wanted(name)) {
            let mut path = root.join(name);
            // Down to the bag itself.
            while path
                .file_name()
                .is_some_and(|last| bag_name(&last.to_string_lossy()).is_none())
            {
                path.pop();
            }
            self.add(&path);
        }
        Ok(())
    }

    /// Takes in the bag at `path`.
    fn add(&mut self, path: &Path) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let base = path.parent().and_then(Path::parent);
        if let (Some(name), Some(base)) = (bag_name(&name), base) {
            self.found.insert(HoiPart {
                name: name.to_owned(),
                base: base.to_owned(),
            });
        }
    }
}

/// The recording's name, of its bag's.
fn bag_name(name: &str) -> Option<&str> {
    name.strip_suffix(".zip").unwrap_or(name).strip_suffix(BAG)
}

/// Writes `out` from one recording of the dataset.
///
/// # Errors
/// [`ImportError`]: the wrench, the trajectory or the calibration between them is missing, or something cannot be read.
pub fn import_part(part: &HoiPart, out: &Path, overwrite: bool) -> Result<HoiReport, ImportError> {
    let mut import = Import {
        part,
        tree: Tree::default(),
        sources: Vec::new(),
        missing: Vec::new(),
        left_out: 0,
    };
    let wrench = import.wrench()?;
    let trajectory = import.trajectory()?;
    let frames = import.frames()?;
    let temperature = import.temperature()?;
    let gyro = import.gyro()?;
    let width = ["dynamixel_workbench", "joint_states", "data.csv"];
    if import.in_bag(&width)?.is_none() {
        let text = format!("{}: no jaw width", width.join("/"));
        import.missing.push(text);
    }
    let pose = |frame: &crate::config::StaticPose| Pose7 {
        position: frame.position_m,
        quaternion: frame.quaternion_xyzw,
    };
    let mut recording = Recording {
        path: out.to_owned(),
        sha256: String::new(),
        wrench,
        pose: PoseTrack {
            frame: TrackedFrame::AriaDevice,
            samples: trajectory
                .poses
                .iter()
                .map(|pose| Stamped {
                    at: HostTime::from_nanos(pose.device_ns),
                    value: pose.pose,
                })
                .collect(),
        },
        gripper_width: Vec::new(),
        temperature,
        aria_device_from_tcp: pose(&frames.aria_device_from_tcp),
        tcp_from_ft_sensor: pose(&frames.tcp_from_ft_sensor),
        marks: Vec::new(),
        calibration: None,
        session: std::collections::BTreeMap::new(),
        health: ft_recording::recording::ReadHealth::default(),
    };
    import.refuse_apart(&recording)?;
    let (calibration, kind, alignment) = import.weigh(&recording);
    let start = recording.wrench[0].at;
    if let Some(alignment) = alignment {
        for sample in &mut recording.pose.samples {
            sample.at = alignment.shifted(sample.at, start);
        }
    }
    let gyro_check = gyro::check(&recording.pose.samples, &gyro);
    if gyro_check.is_none() && !gyro.is_empty() {
        let text =
            "no check by the sensor's own gyroscope: it and the poses do not show the same turns";
        import.missing.push(text.to_owned());
    }
    let mut doubts = plausible::of_wrench(&recording.wrench);
    doubts.extend(plausible::of_poses(&recording.pose.samples));
    doubts.extend(plausible::of_mounts([
        ("glasses and tool", &recording.aria_device_from_tcp),
        ("tool and sensor", &recording.tcp_from_ft_sensor),
    ]));
    let report = HoiReport {
        doubts,
        gyro_check,
        name: part.name.clone(),
        path: out.to_owned(),
        samples: [
            recording.wrench.len() as u64,
            recording.pose.samples.len() as u64,
        ],
        left_out: import.left_out,
        counts: trajectory.counts,
        calibration: kind,
        alignment,
        missing: import.missing,
        sources: import.sources,
    };
    write(&recording, &frames, &calibration, &report, out, overwrite)?;
    Ok(report)
}

impl Import<'_> {
    fn refuse_apart(&self, recording: &Recording) -> Result<(), ImportError> {
        let span = |first: HostTime, last: HostTime| last.seconds_since(first);
        let (wrench, pose) = (&recording.wrench, &recording.pose.samples);
        let (w0, w1) = (wrench[0].at, wrench[wrench.len() - 1].at);
        let (p0, p1) = (pose[0].at, pose[pose.len() - 1].at);
        if p0 < w1 && w0 < p1 {
            return Ok(());
        }
        Err(ImportError::Content {
            path: self.part.base.clone(),
            reason: format!(
                "{}: the poses ({:.1} s) begin {:+.1} s after the wrench ({:.1} s) and do not overlap it: the streams were not aligned by the \
                 dataset's own tools; run their time alignment first",
                self.part.name,
                span(p0, p1),
                p0.seconds_since(w0),
                span(w0, w1)
            ),
        })
    }

    /// Weighs the tool in the free air at the start, as long as it lasts; else by the dataset's constants.
    fn weigh(&mut self, recording: &Recording) -> (Calibration, HoiCalibration, Option<Alignment>) {
        let end = recording.wrench[recording.wrench.len() - 1]
            .at
            .seconds_since(recording.wrench[0].at);
        // The tool may lie on a table first.
        for from_s in [0.0, 5.0, 10.0, 20.0, 30.0] {
            let mut best: Option<(f64, Calibrated)> = None;
            let mut until_s = from_s + 6.0;
            while until_s < end.min(90.0) {
                match free_air(recording, from_s, until_s) {
                    Some(found) => best = Some((until_s, found)),
                    None if best.is_some() => break,
                    None => {}
                }
                until_s += 3.0;
            }
            if let Some((until_s, found)) = best {
                let kind = HoiCalibration::FreeAir { from_s, until_s };
                return (found.calibration, kind, found.alignment);
            }
        }
        let (bias, quiet_s) = quiet_bias(recording);
        self.missing.push(
            "free air with the tool turned and shaken before the grasp: mass and centre of mass are the dataset's, the milliseconds between the \
             clocks stay"
                .to_owned(),
        );
        if bias.is_none() {
            self.missing
                .push("a contact-free stretch of 5 s: the sensor's bias is unknown".to_owned());
        }
        let calibration = Calibration {
            payload_mass_kg: Estimate {
                value: MASS_KG,
                std: 0.01,
            },
            payload_com_m: Estimate {
                value: COM_M,
                std: [0.003; 3],
            },
            payload_inertia_kgm2: Estimate {
                value: [0.0; 6],
                std: [0.001; 6],
            },
            wrench_bias: bias,
        };
        (calibration, HoiCalibration::Constants { quiet_s }, None)
    }
}

fn write(
    recording: &Recording,
    frames: &Frames,
    calibration: &Calibration,
    report: &HoiReport,
    out: &Path,
    overwrite: bool,
) -> Result<(), ImportError> {
    let stamps = |at: HostTime| MessageStamps {
        log_time: at,
        publish_time: at,
    };
    let mut rewrite = Rewrite::new();
    let wrench = recording.wrench.iter().map(|sample| {
        let message = WrenchStamped {
            header: Header::new(sample.at, FtSensor::NAME),
            wrench: sample.value.into(),
        };
        (stamps(sample.at), message)
    });
    rewrite.add(topic::WRENCH, Qos::SENSOR, wrench);
    add_poses(&mut rewrite, topic::ARIA_POSE, &recording.pose.samples);
    let tcp: Vec<_> = recording
        .pose
        .samples
        .iter()
        .map(|sample| Stamped {
            at: sample.at,
            value: sample.value.then(&recording.aria_device_from_tcp),
        })
        .collect();
    add_poses(&mut rewrite, topic::TCP_POSE, &tcp);
    if !recording.temperature.is_empty() {
        let messages = recording.temperature.iter().map(|sample| {
            let message = Temperature {
                header: Header::new(sample.at, FtSensor::NAME),
                temperature: sample.value,
                variance: 0.0,
            };
            (stamps(sample.at), message)
        });
        rewrite.add(topic::TEMPERATURE, Qos::SENSOR, messages);
    }
    let start = recording.wrench[0].at;
    rewrite.add(
        topic::TF_STATIC,
        Qos::LATCHED,
        [(stamps(start), static_transforms(frames, start))],
    );
    let calibration =
        calibration
            .to_metadata()
            .map_err(|source| ft_recording::ReadError::Calibration {
                path: out.to_owned(),
                source,
            })?;
    rewrite.metadata(metadata::CALIBRATION, calibration);
    rewrite.metadata(metadata::IMPORT, import_entries("hoi", report));
    rewrite.write(None, out, overwrite)?;
    Ok(())
}
