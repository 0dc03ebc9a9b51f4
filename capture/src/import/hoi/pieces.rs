//! The files of one recording: wrench, temperature, trajectory, and the calibration between them.

use std::path::Path;

use ft_recording::Stamped;

use super::{BAG, HoiPart, VRS};
use crate::config::Frames;
use crate::import::archive::{Found, Tree};
use crate::import::aria::static_pose;
use crate::import::clock_map::median;
use crate::import::matrix::{from_json, from_yaml};
use crate::import::mps::{SourceFile, Trajectory};
use crate::import::order::{Ordered, in_order};
use crate::import::table::Table;
use crate::import::{ImportError, hex};

/// Everything of one recording on its way in.
pub(super) struct Import<'a> {
    pub(super) part: &'a HoiPart,
    pub(super) tree: Tree,
    pub(super) sources: Vec<SourceFile>,
    pub(super) missing: Vec<String>,
    /// Why the tool was not weighed although it moved.
    pub(super) not_weighed: Option<String>,
    /// Wrenches that are not finite, cut short, or stamped as another or at another time.
    pub(super) left_out: u64,
    /// Of these, wrenches by a clock that was set back, or by the one before it.
    pub(super) set_back: u64,
}

/// Median time between wrenches that is believed, s.
const STEPS_S: (f64, f64) = (5e-5, 0.5);
/// Fewer rows show no pace.
const MIN_JUDGED: usize = 20;

/// Stamps in s, ms or us would put years of wrenches into seconds; nothing after could say so.
fn refuse_other_units(
    samples: &[Stamped<[f64; 6]>],
    rows: usize,
    path: &Path,
) -> Result<(), ImportError> {
    let steps = samples
        .windows(2)
        .map(|pair| pair[1].at.seconds_since(pair[0].at));
    let step = median(steps.collect()).unwrap_or(0.0);
    if rows < MIN_JUDGED || (STEPS_S.0..STEPS_S.1).contains(&step) {
        return Ok(());
    }
    Err(ImportError::Content {
        path: path.to_owned(),
        reason: format!(
            "wrenches stand {step:.3e} s apart, expected {:.0e} to {} s: timestamp must be in ns since 1970",
            STEPS_S.0, STEPS_S.1
        ),
    })
}

impl Import<'_> {
    fn note(&mut self, found: &Found) {
        use sha2::{Digest as _, Sha256};
        let name = found
            .path
            .strip_prefix(&self.part.base)
            .unwrap_or(&found.path);
        self.sources.push(SourceFile {
            name: name.display().to_string(),
            sha256: hex(&Sha256::digest(&found.bytes)),
        });
    }

    fn look(
        &mut self,
        group: &str,
        suffix: &str,
        parts: &[&str],
    ) -> Result<Option<Found>, ImportError> {
        let folder = format!("{}{suffix}", self.part.name);
        let mut path = vec![group, folder.as_str()];
        path.extend(parts);
        let found = self.tree.find(&self.part.base, &path)?;
        if let Some(found) = &found {
            self.note(found);
        }
        Ok(found)
    }

    pub(super) fn in_bag(&mut self, parts: &[&str]) -> Result<Option<Found>, ImportError> {
        self.look("gripper", BAG, parts)
    }

    fn in_vrs(&mut self, parts: &[&str]) -> Result<Option<Found>, ImportError> {
        self.look("aria_gripper", VRS, parts)
    }

    fn needed(&self, found: Option<Found>, what: &str) -> Result<Found, ImportError> {
        found.ok_or_else(|| ImportError::Missing {
            path: self.part.base.clone(),
            missing: format!(
                "no {what} of {}, neither as a folder nor in a zip",
                self.part.name
            ),
            hint: "download this part of the dataset too",
        })
    }

    pub(super) fn wrench(&mut self) -> Result<Vec<Stamped<[f64; 6]>>, ImportError> {
        let parts = [
            "force_torque",
            "ft_sensor0",
            "ft_sensor_readings",
            "wrench",
            "data.csv",
        ];
        let found = self.in_bag(&parts)?;
        let found = self.needed(found, &parts.join("/"))?;
        let table = Table::from_bytes(&found.bytes, &found.path)?;
        let time = table.column("timestamp")?;
        let columns = table.columns([
            "wrench.force.x",
            "wrench.force.y",
            "wrench.force.z",
            "wrench.torque.x",
            "wrench.torque.y",
            "wrench.torque.z",
        ])?;
        let mut samples = Vec::with_capacity(table.len());
        for row in 0..table.len() {
            let value = table.numbers(row, columns)?;
            if let Some(at) = table.instant(row, time, 1)?
                && value.iter().all(|number| number.is_finite())
            {
                samples.push((at, value));
            }
        }
        let ordered = in_order(samples);
        self.set_back = ordered.set_back;
        let samples = ordered.stamped();
        self.left_out = (table.len() - samples.len()) as u64 + table.cut_rows();
        if samples.len() < 2 {
            return Err(ImportError::Content {
                path: found.path,
                reason: format!("{} usable wrenches, need at least 2", samples.len()),
            });
        }
        refuse_other_units(&samples, table.len(), &found.path)?;
        Ok(samples)
    }

    /// Nothing that is needed: what cannot be read of it is missing.
    pub(super) fn temperature(&mut self) -> Result<Vec<Stamped<f64>>, ImportError> {
        let parts = [
            "force_torque",
            "ft_sensor0",
            "ft_sensor_readings",
            "temperature",
            "data.csv",
        ];
        let what = format!("{}: no check of thermal drift", parts.join("/"));
        let Some(found) = self.in_bag(&parts)? else {
            self.missing.push(what);
            return Ok(Vec::new());
        };
        let read = || {
            let table = Table::from_bytes(&found.bytes, &found.path)?;
            let (time, value) = (table.column("timestamp")?, table.column("temperature")?);
            let sample = |row| {
                let (at, value) = (table.instant(row, time, 1)?, table.float(row, value)?);
                Ok(at.filter(|_| value.is_finite()).map(|at| (at, value)))
            };
            let samples = (0..table.len()).filter_map(|row| sample(row).transpose());
            let samples = samples.collect::<Result<Vec<_>, ImportError>>()?;
            Ok(in_order(samples))
        };
        Ok(self.said(read(), &what, &parts.join("/")))
    }

    /// The samples; `what` is missing where they cannot be read, and what is left out of `file` is told.
    fn said<T>(
        &mut self,
        read: Result<Ordered<T>, ImportError>,
        what: &str,
        file: &str,
    ) -> Vec<Stamped<T>> {
        match read {
            Ok(ordered) => {
                let left_out = ordered.left_out();
                self.missing
                    .extend(left_out.map(|rows| format!("{file}: {rows}")));
                ordered.stamped()
            }
            Err(error) => {
                self.missing.push(format!("{what} ({error})"));
                Vec::new()
            }
        }
    }

    /// The sensor's gyroscope, rad/s, by the wrench's clock. Nothing that is needed, either.
    pub(super) fn gyro(&mut self) -> Result<Vec<Stamped<[f64; 3]>>, ImportError> {
        let parts = [
            "force_torque",
            "ft_sensor0",
            "ft_sensor_readings",
            "imu",
            "data.csv",
        ];
        let what = format!(
            "{}: no check by the sensor's own gyroscope",
            parts.join("/")
        );
        let Some(found) = self.in_bag(&parts)? else {
            self.missing.push(what);
            return Ok(Vec::new());
        };
        let read = || {
            let table = Table::from_bytes(&found.bytes, &found.path)?;
            let time = table.column("timestamp")?;
            let rate = table.columns([
                "angular_velocity.x",
                "angular_velocity.y",
                "angular_velocity.z",
            ])?;
            let sample = |row| {
                let (at, value) = (table.instant(row, time, 1)?, table.numbers(row, rate)?);
                let at = at.filter(|_| value.iter().all(|rate| rate.is_finite()));
                Ok(at.map(|at| (at, value)))
            };
            let samples = (0..table.len()).filter_map(|row| sample(row).transpose());
            let samples = samples.collect::<Result<Vec<_>, ImportError>>()?;
            Ok(in_order(samples))
        };
        Ok(self.said(read(), &what, &parts.join("/")))
    }

    pub(super) fn trajectory(&mut self) -> Result<Trajectory, ImportError> {
        let parts = ["slam", "closed_loop_trajectory", "data.csv"];
        let found = self.in_vrs(&parts)?;
        let found = match found {
            Some(found) => Some(found),
            None => {
                let aligned =
                    self.in_vrs(&["slam", "closed_loop_trajectory_aligned", "data.csv"])?;
                if aligned.is_some() {
                    let text = "slam/closed_loop_trajectory: poses taken from closed_loop_trajectory_aligned, in the room scan's frame";
                    self.missing.push(text.to_owned());
                }
                aligned
            }
        };
        let found = self.needed(found, &parts.join("/"))?;
        Trajectory::from_table(&Table::from_bytes(&found.bytes, &found.path)?, 0.0)
    }

    /// `T_device_tool = T_device_camera T_cam_imu T_i_tool`, and the same with `T_i_s`.
    pub(super) fn frames(&mut self) -> Result<Frames, ImportError> {
        let camchain = self.in_bag(&["calib", "*camchain.yaml"])?;
        let camchain = match camchain {
            Some(found) => Some(found),
            None => self.in_bag(&["calib", "*imucam.yaml"])?,
        };
        let camchain = self.needed(camchain, "calib/*camchain.yaml or calib/*imucam.yaml")?;
        let imu = self.in_bag(&["calib", "*imu.yaml"])?;
        let imu = self.needed(imu, "calib/*imu.yaml")?;
        let json = self.in_vrs(&["calib", "calib.json"])?;
        let json = self.needed(json, "calib/calib.json")?;
        let text = |found: &Found| {
            let text = String::from_utf8_lossy(&found.bytes);
            text.trim_start_matches('\u{feff}').to_owned()
        };
        let (chain, imu_text, json_text) = (text(&camchain), text(&imu), text(&json));
        let device_from_camera = from_json(&json_text, "/NON_PINHOLE/T_device_camera", &json.path)?;
        let mut camera_from_imu = from_yaml(&chain, "cam2", "T_cam_imu", &camchain.path);
        if camera_from_imu.is_err()
            && let Some(other) = self.in_bag(&["calib", "*imucam.yaml"])?
        {
            camera_from_imu = from_yaml(&text(&other), "cam2", "T_cam_imu", &other.path);
        }
        let device_from_imu = device_from_camera.then(&camera_from_imu?);
        let of_imu = |key| from_yaml(&imu_text, "imu0", key, &imu.path);
        let device_from_tool = device_from_imu.then(&of_imu("T_i_tool")?);
        let device_from_sensor = device_from_imu.then(&of_imu("T_i_s")?);
        Ok(Frames {
            aria_device_from_tcp: static_pose(&device_from_tool),
            tcp_from_ft_sensor: static_pose(&device_from_tool.inverse().then(&device_from_sensor)),
        })
    }
}
