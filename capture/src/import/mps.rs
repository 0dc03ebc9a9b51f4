//! Trajectories of Project Aria's machine perception services (MPS).
//!
//! `closed_loop_trajectory.csv` and `open_loop_trajectory.csv`, old and new; columns are found by name. Times are of the
//! glasses' own clock; utc is a phone's, in the closed-loop file a staircase of 100 ms, and -1 where it is not known.
//!
//! # Source
//! `facebookresearch/projectaria_tools` commit 90f70ff, the sample files in `data/gen1/mps_sample/trajectory`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use ft_recording::Pose7;
use serde::Serialize;

mod upright;

use upright::Upright;

use super::clock_map::{ClockMap, median};
use super::order::in_order;
use super::table::{Column, Table};
use super::{ImportError, sha256};

/// Which trajectory a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TrajectoryKind {
    /// Optimised with loop closures, in one world.
    ClosedLoop,
    /// Odometry; drifts.
    OpenLoop,
}

/// A pose of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MpsPose {
    /// The glasses' clock, ns.
    pub device_ns: i64,
    /// The phone's clock, ns since the Unix epoch, as written.
    pub utc_ns: Option<i64>,
    /// `world_from_device`, z up.
    pub pose: Pose7,
    /// Angular rate in device axes, rad/s; NaN where the file has none.
    pub rate: [f64; 3],
    /// 0 to 1; 1 where the file has none.
    pub quality: f64,
}

/// A trajectory file.
#[derive(Clone, Debug)]
pub struct Trajectory {
    /// The file.
    pub path: PathBuf,
    /// What it holds.
    pub kind: TrajectoryKind,
    /// Its poses, by the glasses' clock, turned so that gravity points along -z.
    pub poses: Vec<MpsPose>,
    /// What was left out.
    pub counts: TrajectoryCounts,
}

/// What a trajectory's file has, and what of it was left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TrajectoryCounts {
    /// Rows of the file.
    pub rows: u64,
    /// Rows whose stamp is empty, before 0 or after the year 2096: left out.
    pub no_stamp: u64,
    /// Rows of another time, hours from the most, or some few with holes of 10 s around them: left out.
    pub far: u64,
    /// Rows that stood elsewhere than by their stamps: put in their places.
    pub moved: u64,
    /// Rows that, put in their places, are not later than the one before: left out.
    pub not_later: u64,
    /// Rows by a clock that was set back, or by the one before it, whichever are fewer: left out.
    pub set_back: u64,
    /// Rows whose quaternion is no rotation, whose numbers are not finite, or that were cut short: left out.
    pub no_pose: u64,
    /// Length of the first quaternion that is none; 1 is expected.
    pub quaternion_length: Option<f64>,
    /// Rows of a quality below what was asked for: left out.
    pub low_quality: u64,
    /// Rows in another world than the most: left out.
    pub other_world: u64,
    /// Poses kept although their quality is below 0.5.
    pub doubtful: u64,
    /// Rows without utc.
    pub without_utc: u64,
    /// Angle by which the world was turned to have z up, deg.
    pub turned_deg: f64,
    /// Smallest quality of the poses kept.
    pub least_quality: f64,
}

impl TrajectoryCounts {
    /// Whether rows by another clock, or more than half of the rows, are left out for another reason than a quality that was asked for.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.set_back > 0 || self.lost_most()
    }

    /// Whether more than half of the rows are.
    pub(super) const fn lost_most(&self) -> bool {
        let lost = self.no_stamp
            + self.far
            + self.not_later
            + self.set_back
            + self.no_pose
            + self.other_world;
        2 * lost > self.rows
    }

    /// What was wrong with the first quaternion that is none; empty when there is none such.
    pub(super) fn quaternion_text(&self) -> String {
        self.quaternion_length.map_or_else(String::new, |length| {
            format!(" (the first quaternion that is none has the length {length:.3}, expected 1)")
        })
    }
}

/// A file of a folder, and its hash.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SourceFile {
    /// Its path below the folder.
    pub name: String,
    /// SHA-256, 64 hex digits.
    pub sha256: String,
}

impl SourceFile {
    /// The file at `path`.
    ///
    /// # Errors
    /// It cannot be read.
    pub fn of(path: &Path) -> Result<Self, ImportError> {
        Ok(Self::named(path, sha256(path)?))
    }

    /// The file at `path`, whose hash is known.
    pub(super) fn named(path: &Path, sha256: String) -> Self {
        let name = path.file_name().unwrap_or_default();
        Self {
            name: name.to_string_lossy().into_owned(),
            sha256,
        }
    }
}

impl Trajectory {
    /// Reads a file; poses of a quality below `min_quality` are left out.
    ///
    /// # Errors
    /// It cannot be read, lacks a column, has a field that is no number, or no pose is left.
    pub fn open(path: &Path, min_quality: f64) -> Result<Self, ImportError> {
        Self::from_table(&Table::open(path)?, min_quality)
    }

    /// Reads a table: the clock in `timestamp` (ns) as the Hoi! dataset has it, else in `tracking_timestamp_us`. Of several worlds
    /// (`graph_uid`, or `session_uid` of odometry) the one with most poses is taken.
    ///
    /// # Errors
    /// As [`Trajectory::open`].
    pub fn from_table(table: &Table, min_quality: f64) -> Result<Self, ImportError> {
        let kind = if table.find("tx_odometry_device").is_some() {
            TrajectoryKind::OpenLoop
        } else {
            TrajectoryKind::ClosedLoop
        };
        let world = match kind {
            TrajectoryKind::ClosedLoop => "world",
            TrajectoryKind::OpenLoop => "odometry",
        };
        let (time, scale) = match table.find("timestamp") {
            Some(column) => (column, 1),
            None => (table.column("tracking_timestamp_us")?, 1_000),
        };
        let named = |what: &str| table.column(&format!("{what}_{world}_device"));
        let position = [named("tx")?, named("ty")?, named("tz")?];
        let turn = [named("qx")?, named("qy")?, named("qz")?, named("qw")?];
        let axes = ["x", "y", "z"];
        let rate = axes.map(|axis| table.find(&format!("angular_velocity_{axis}_device")));
        let gravity = axes.map(|axis| table.find(&format!("gravity_{axis}_{world}")));
        let (utc, quality) = (table.find("utc_timestamp_ns"), table.find("quality_score"));
        let mut out = Self {
            path: table.path().to_owned(),
            kind,
            poses: Vec::with_capacity(table.len()),
            counts: TrajectoryCounts {
                rows: table.len() as u64 + table.cut_rows(),
                no_pose: table.cut_rows(),
                ..TrajectoryCounts::default()
            },
        };
        let world = match kind {
            TrajectoryKind::ClosedLoop => table.find("graph_uid"),
            TrajectoryKind::OpenLoop => table.find("session_uid"),
        };
        let world = world.and_then(|column| most_frequent(table, column).map(|uid| (column, uid)));
        let mut up = Upright::default();
        for row in 0..table.len() {
            let Some(device_ns) = table.instant(row, time, scale)? else {
                out.counts.no_stamp += 1;
                continue;
            };
            let quality = quality.map_or(Ok(1.0), |column| table.float(row, column))?;
            // Empty, -1 and anything else that is no instant mean that it is not known.
            let utc_ns = utc.and_then(|column| table.instant(row, column, 1).ok()?);
            let utc_ns = utc_ns.filter(|utc| *utc > 0);
            out.counts.without_utc += u64::from(utc_ns.is_none());
            let (position, turn) = (table.numbers(row, position)?, table.numbers(row, turn)?);
            let Some(pose) = Pose7::normalised(position, turn) else {
                out.counts.no_pose += 1;
                let length = turn.iter().map(|q| q * q).sum::<f64>().sqrt();
                if length.is_finite() && !(0.5..=2.0).contains(&length) {
                    out.counts.quaternion_length.get_or_insert(length);
                }
                continue;
            };
            if quality.is_nan() || quality < min_quality {
                out.counts.low_quality += 1;
                continue;
            }
            if let Some((column, uid)) = &world
                && table.text(row, *column) != uid
            {
                out.counts.other_world += 1;
                continue;
            }
            if let [Some(x), Some(y), Some(z)] = gravity {
                up.add(table.numbers(row, [x, y, z])?);
            }
            let rate = match rate {
                [Some(x), Some(y), Some(z)] => table.numbers(row, [x, y, z])?,
                _ => [f64::NAN; 3],
            };
            out.poses.push(MpsPose {
                device_ns,
                utc_ns,
                pose,
                rate,
                quality,
            });
        }
        out.finish(&up)
    }

    fn finish(mut self, up: &Upright) -> Result<Self, ImportError> {
        let poses = std::mem::take(&mut self.poses).into_iter();
        let stamped = poses.map(|pose| (pose.device_ns, pose));
        let ordered = in_order(stamped.collect());
        self.counts.far = ordered.far;
        self.counts.moved = ordered.moved;
        self.counts.not_later = ordered.repeated;
        self.counts.set_back = ordered.set_back;
        self.poses = ordered.rows.into_iter().map(|(_, pose)| pose).collect();
        let turn = up.turn();
        self.counts.turned_deg = turn.rotation_deg;
        if turn.rotation_deg > 0.01 {
            for pose in &mut self.poses {
                pose.pose = turn.pose.then(&pose.pose);
            }
        }
        let least = self.poses.iter().map(|pose| pose.quality);
        self.counts.least_quality = least.fold(1.0, f64::min);
        let doubtful = self.poses.iter().filter(|pose| pose.quality < 0.5);
        self.counts.doubtful = doubtful.count() as u64;
        if self.poses.len() < 2 {
            return Err(ImportError::Content {
                reason: format!(
                    "{} of {} rows are usable poses, need at least 2 (no stamp {}, of another time {}, quality too low {}, no rotation {}{}, not later {}); \
                     lower --min-quality or look at the file",
                    self.poses.len(),
                    self.counts.rows,
                    self.counts.no_stamp,
                    self.counts.far,
                    self.counts.low_quality,
                    self.counts.no_pose,
                    self.counts.quaternion_text(),
                    self.counts.not_later
                ),
                path: self.path,
            });
        }
        self.refuse_other_units()?;
        Ok(self)
    }

    /// A hand does not move as fast, or a tracker answer as rarely, as columns in other units would say.
    fn refuse_other_units(&self) -> Result<(), ImportError> {
        let step_s = |pair: &[MpsPose]| (pair[1].device_ns - pair[0].device_ns) as f64 * 1e-9;
        let speed = |pair: &[MpsPose]| {
            let [a, b] = [pair[0].pose.position, pair[1].pose.position];
            let moved = (0..3).map(|k| (b[k] - a[k]).powi(2)).sum::<f64>().sqrt();
            moved / step_s(pair)
        };
        let pairs = || self.poses.windows(2);
        let step = median(pairs().map(step_s).collect()).unwrap_or(0.0);
        let speed = median(pairs().map(speed).collect()).unwrap_or(0.0);
        let reason = if self.poses.len() < MIN_JUDGED {
            return Ok(());
        } else if !(STEPS_S.0..STEPS_S.1).contains(&step) {
            format!(
                "poses stand {step:.3e} s apart, expected {:.0e} to {} s: tracking_timestamp_us must be in us, timestamp in ns",
                STEPS_S.0, STEPS_S.1
            )
        } else if speed > MAX_SPEED {
            format!(
                "half of the poses move faster than {speed:.0} m/s, at most {MAX_SPEED} m/s are believed: positions must be in m and times \
                 in us (or ns, in a column timestamp)"
            )
        } else {
            return Ok(());
        };
        Err(ImportError::Content {
            path: self.path.clone(),
            reason,
        })
    }

    /// Readings of (glasses' clock, utc), ns.
    #[must_use]
    pub fn utc_pairs(&self) -> Vec<(i64, i64)> {
        let pair = |pose: &MpsPose| Some((pose.device_ns, pose.utc_ns?));
        self.poses.iter().filter_map(pair).collect()
    }

    /// The map from the glasses' clock to utc; `None` when the file has no utc.
    #[must_use]
    pub fn utc_map(&self) -> Option<ClockMap> {
        ClockMap::through(&self.utc_pairs())
    }

    /// Length, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        match (self.poses.first(), self.poses.last()) {
            (Some(first), Some(last)) => (last.device_ns - first.device_ns) as f64 * 1e-9,
            _ => 0.0,
        }
    }
}

/// Trajectories of fewer poses show no pace.
const MIN_JUDGED: usize = 20;
/// Median time between poses that is believed, s.
const STEPS_S: (f64, f64) = (5e-5, 0.3);
/// Median speed that is believed, m/s.
const MAX_SPEED: f64 = 10.0;

/// The text that most rows of a column have.
fn most_frequent(table: &Table, column: Column) -> Option<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for row in 0..table.len() {
        *counts.entry(table.text(row, column)).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|(_, count)| *count)?;
    Some(most.0.to_owned())
}

#[cfg(test)]
mod tests;
