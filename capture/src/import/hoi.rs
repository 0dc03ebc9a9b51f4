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

mod pieces;
mod report;
mod search;
mod weigh;

use std::path::Path;

use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{
    Calibration, Estimate, Pose7, PoseTrack, Recording, Stamped, TrackedFrame, metadata, topic,
};
use ft_wire::HostTime;

use pieces::Import;
pub use report::{HoiCalibration, HoiReport};
pub use search::{HoiPart, HoiParts, parts};
use weigh::quiet_bias;

use super::archive::Tree;
use super::cover::Uncovered;
pub use super::drift::Drift;
use super::drift::{move_by, with_drift};
use super::free_air::{NoFreeAir, free_air};
use super::topics::{add_poses, add_rates, add_temperature, add_wrench, import_entries, true_at};
use super::{ImportError, plausible};
use crate::calibrate::{Alignment, Calibrated};
use crate::config::Frames;
use crate::encode::static_transforms;
use crate::gyro;

const BAG: &str = "_gripper_bag";
const VRS: &str = "_gripper_vrs";
/// The dataset's own constants: kg, m in the sensor's axes.
const MASS_KG: f64 = 0.490;
const COM_M: [f64; 3] = [0.021, 0.020, 0.059];
const GRAVITY: f64 = 9.80665;

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
        not_weighed: None,
        left_out: 0,
        set_back: 0,
    };
    let wrench = import.wrench()?;
    let trajectory = import.trajectory()?;
    let frames = import.frames()?;
    let temperature = import.temperature()?;
    let angular_rate = import.gyro()?;
    let width = ["dynamixel_workbench", "joint_states", "data.csv"];
    let mut unused = Vec::new();
    match import.in_bag(&width)? {
        None => import
            .missing
            .push(format!("{}: no jaw width", width.join("/"))),
        Some(_) => unused.push(format!("{}: the jaw's width", width.join("/"))),
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
        angular_rate,
        aria_device_from_tcp: pose(&frames.aria_device_from_tcp),
        tcp_from_ft_sensor: pose(&frames.tcp_from_ft_sensor),
        marks: Vec::new(),
        calibration: None,
        session: std::collections::BTreeMap::new(),
        health: ft_recording::recording::ReadHealth::default(),
    };
    import.refuse_apart(&recording)?;
    let (calibration, kind, alignment) = import.weigh(&recording);
    let mut drift = None;
    let alignment = match (&kind, alignment) {
        (HoiCalibration::FreeAir { until_s, .. }, Some(first)) => {
            let (alignment, found) = with_drift(&recording, first, *until_s);
            drift = Some(found);
            Some(alignment)
        }
        (_, alignment) => alignment,
    };
    if let Some(alignment) = &alignment {
        move_by(&mut recording, alignment);
    }
    let gyro_check = gyro::check(&recording.pose.samples, &recording.angular_rate);
    if gyro_check.is_none() && !recording.angular_rate.is_empty() {
        let text = format!("no check by the sensor's own gyroscope: {}", gyro::NOT_SEEN);
        import.missing.push(text);
    }
    let mut doubts = plausible::of_wrench(&recording.wrench);
    doubts.extend(plausible::of_poses(&recording.pose.samples));
    doubts.extend(plausible::of_mounts([
        ("glasses and tool", &recording.aria_device_from_tcp),
        ("tool and sensor", &recording.tcp_from_ft_sensor),
    ]));
    let uncovered = Uncovered::of(&recording.wrench, &recording.pose.samples);
    let report = HoiReport {
        doubts,
        uncovered,
        gyro_check,
        name: part.name.clone(),
        path: out.to_owned(),
        samples: [
            recording.wrench.len() as u64,
            recording.pose.samples.len() as u64,
        ],
        left_out: import.left_out,
        set_back: import.set_back,
        counts: trajectory.counts,
        calibration: kind,
        alignment,
        drift,
        not_weighed: import.not_weighed,
        missing: import.missing,
        unused,
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
        let mut why = NoFreeAir::Nothing;
        // The tool may lie on a table first.
        for from_s in [0.0, 5.0, 10.0, 20.0, 30.0] {
            let mut best: Option<(f64, Calibrated)> = None;
            let mut until_s = from_s + 6.0;
            while until_s < end.min(90.0) {
                match free_air(recording, from_s, until_s) {
                    Ok(found) => best = Some((until_s, found)),
                    Err(_) if best.is_some() => break,
                    Err(reason) => why = why.or(reason),
                }
                until_s += 3.0;
            }
            if let Some((until_s, found)) = best {
                let kind = HoiCalibration::FreeAir { from_s, until_s };
                return (found.calibration, kind, found.alignment);
            }
        }
        let (bias, quiet_s) = quiet_bias(recording);
        self.not_weighed = why.told();
        let what = match self.not_weighed {
            Some(_) => "a tool weighed in free air",
            None => "free air with the tool turned and shaken before the grasp",
        };
        self.missing.push(format!(
            "{what}: mass and centre of mass are the dataset's, the milliseconds between the clocks stay"
        ));
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
            covariance: None,
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
    let mut rewrite = Rewrite::new();
    add_wrench(&mut rewrite, &recording.wrench);
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
    add_temperature(&mut rewrite, &recording.temperature);
    add_rates(&mut rewrite, &recording.angular_rate);
    let start = recording.wrench[0].at;
    let transforms = static_transforms(frames, start);
    rewrite.add(
        topic::TF_STATIC,
        Qos::LATCHED,
        [(true_at(start), transforms)],
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
