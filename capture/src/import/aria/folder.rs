//! Files of an MPS folder.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::import::archive::read;
use crate::import::clock_map::ClockMap;
use crate::import::mps::{SourceFile, Trajectory, TrajectoryKind};
use crate::import::{ImportError, io};

/// Both files of a session cover its whole time; so much of the shorter one may be missing from the other.
const MAX_OUTSIDE: f64 = 0.5;
/// The staircase of the closed-loop file's utc is 0.1 s high; files that are farther apart are of two sessions, ns.
const MAX_UTC_APART_NS: u64 = 500_000_000;
/// Both files of a session have poses at the same instants of the glasses' clock, to 1 us; of two sessions one in a thousand agrees by
/// chance.
const MIN_SAME: f64 = 0.02;

/// Why two trajectories are not of one session of the glasses; `None` when they seem to be.
fn other_session(closed: &Trajectory, open: &Trajectory) -> Option<String> {
    let span = |of: &Trajectory| {
        let poses = &of.poses;
        Some((poses.first()?.device_ns, poses.last()?.device_ns))
    };
    let ((a, b), (c, d)) = (span(closed)?, span(open)?);
    let shared = b.min(d).saturating_sub(a.max(c)).max(0) as f64;
    let shorter = (b - a).min(d - c) as f64;
    if shared < (1.0 - MAX_OUTSIDE) * shorter {
        return Some(format!(
            "by the glasses' clock it is from {:.1} to {:.1} s, the other from {:.1} to {:.1} s",
            1e-9 * c as f64,
            1e-9 * d as f64,
            1e-9 * a as f64,
            1e-9 * b as f64
        ));
    }
    if let (Some(of_closed), Some(of_open)) = (closed.utc_map(), open.utc_map()) {
        let middle = a.max(c).midpoint(b.min(d));
        let apart = of_closed.at(middle).abs_diff(of_open.at(middle));
        return (apart > MAX_UTC_APART_NS)
            .then(|| format!("their utc differs by {:.1} s", 1e-9 * apart as f64));
    }
    let stamps: BTreeSet<i64> = open.poses.iter().map(|pose| pose.device_ns).collect();
    let within = closed.poses.iter().map(|pose| pose.device_ns);
    let within: Vec<i64> = within.filter(|at| (c..=d).contains(at)).collect();
    let same = within.iter().filter(|at| stamps.contains(at)).count();
    ((same as f64) < MIN_SAME * within.len() as f64)
        .then(|| format!("{same} of {} instants are those of the other", within.len()))
}

/// The trajectories and the online calibration of an MPS folder.
pub(super) struct MpsFolder {
    closed: Option<PathBuf>,
    open: Option<PathBuf>,
    calibration: Option<PathBuf>,
    given: PathBuf,
}

impl MpsFolder {
    /// `path` is a trajectory, its folder, or the folder above `slam/`.
    pub(super) fn find(path: &Path) -> Result<Self, ImportError> {
        std::fs::metadata(path).map_err(io("find", path))?;
        let is_open = |file: &Path| {
            file.file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with("open_loop"))
        };
        if path.is_file() {
            let (closed, open) = if is_open(path) {
                (None, Some(path.to_owned()))
            } else {
                (Some(path.to_owned()), None)
            };
            return Ok(Self {
                closed,
                open,
                calibration: None,
                given: path.to_owned(),
            });
        }
        let find = |name: &str| {
            let packed = format!("{name}.gz");
            let places = [path.to_owned(), path.join("slam"), path.join("trajectory")];
            places
                .iter()
                .flat_map(|place| [place.join(name), place.join(&packed)])
                .find(|file| file.is_file())
        };
        Ok(Self {
            closed: find("closed_loop_trajectory.csv"),
            open: find("open_loop_trajectory.csv"),
            calibration: find("online_calibration.jsonl"),
            given: path.to_owned(),
        })
    }

    pub(super) fn trajectory(&self, open_loop: bool) -> Result<&Path, ImportError> {
        let wanted = if open_loop { &self.open } else { &self.closed };
        let any = if open_loop { None } else { self.open.as_ref() };
        wanted
            .as_ref()
            .or(any)
            .map(PathBuf::as_path)
            .ok_or_else(|| ImportError::Missing {
                path: self.given.clone(),
                missing: if open_loop {
                    "no open_loop_trajectory.csv".to_owned()
                } else {
                    "neither closed_loop_trajectory.csv nor open_loop_trajectory.csv (also not in slam/)"
                        .to_owned()
                },
                hint: "give the folder that MPS wrote for the glasses' recording",
            })
    }

    /// By the open-loop file, whose utc has no steps, when it has one and is of the same session; else by the trajectory's own, and what
    /// was wrong with the open-loop file.
    pub(super) fn utc_map(&self, trajectory: &Trajectory) -> (Option<ClockMap>, Option<String>) {
        let mut wrong = None;
        if let (Some(open), TrajectoryKind::ClosedLoop) = (&self.open, trajectory.kind) {
            match Trajectory::open(open, 0.0) {
                Ok(open) => match open
                    .utc_map()
                    .map(|map| (map, other_session(trajectory, &open)))
                {
                    Some((_, Some(why))) => {
                        wrong = Some(format!(
                            "{} is of another session than {}: {why}; its utc is not used: put the files of one session into the folder",
                            open.path.display(),
                            trajectory.path.display()
                        ));
                    }
                    Some((map, None)) => return (Some(map), None),
                    None => {}
                },
                Err(error) => wrong = Some(error.to_string()),
            }
        }
        (trajectory.utc_map(), wrong)
    }

    pub(super) fn hashes(&self, source: &Path) -> Result<Vec<SourceFile>, ImportError> {
        [
            Some(source),
            self.closed.as_deref(),
            self.open.as_deref(),
            self.calibration.as_deref(),
        ]
        .into_iter()
        .flatten()
        .map(SourceFile::of)
        .collect()
    }

    /// Time offsets of gyroscopes and accelerometers over the file, ms, and the first that was wrong with it.
    pub(super) fn imu_offsets(&self) -> (BTreeMap<String, [f64; 2]>, Option<String>) {
        let mut offsets: BTreeMap<String, [f64; 2]> = BTreeMap::new();
        let Some(path) = &self.calibration else {
            return (offsets, None);
        };
        let text = match read(path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) => return (offsets, Some(error.to_string())),
        };
        let mut wrong = None;
        for (index, line) in text.lines().enumerate() {
            if line.trim().is_empty() {
                continue;
            }
            let value: serde_json::Value = match serde_json::from_str(line) {
                Ok(value) => value,
                Err(error) => {
                    let line = index + 1;
                    wrong.get_or_insert_with(|| format!("{} line {line}: {error}", path.display()));
                    continue;
                }
            };
            for imu in value["ImuCalibrations"].as_array().into_iter().flatten() {
                let label = imu["Label"].as_str().unwrap_or("imu");
                for (part, key) in [
                    ("Gyroscope", "TimeOffsetSec_Device_Gyro"),
                    ("Accelerometer", "TimeOffsetSec_Device_Accel"),
                ] {
                    let Some(ms) = imu[part][key].as_f64().map(|s| 1e3 * s) else {
                        continue;
                    };
                    let name = format!("{label} {}", part.to_lowercase());
                    let range = offsets.entry(name).or_insert([ms, ms]);
                    *range = [range[0].min(ms), range[1].max(ms)];
                }
            }
        }
        (offsets, wrong)
    }
}
