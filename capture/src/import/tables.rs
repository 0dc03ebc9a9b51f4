//! A wrench and poses that lie in two plain tables, as a recording of ours.
//!
//! Columns are found by name. Rows without a time column are taken to be even, at a rate that is given; both tables then begin
//! together.

use std::fmt;
use std::path::{Path, PathBuf};

use ft_recording::rewrite::Rewrite;
use ft_recording::{Pose7, Stamped, metadata, topic};
use ft_wire::HostTime;
use serde::Serialize;

use super::ImportError;
use super::mps::SourceFile;
use super::table::{Column, LAST_INSTANT, Table};
use super::topics::{add_poses, add_wrench, import_entries};

/// Rows at a rate begin here, because nothing says when they were: 2020-01-01 00:00:00 UTC.
const UNKNOWN_BEGIN: HostTime = HostTime::from_nanos(1_577_836_800_000_000_000);
/// Names of columns that are known, the first that fits is taken.
const WRENCH_NAMES: [[&str; 6]; 3] = [
    ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"],
    ["fx", "fy", "fz", "tx", "ty", "tz"],
    [
        "force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z",
    ],
];
const POSE_NAMES: [[&str; 7]; 3] = [
    ["x", "y", "z", "qx", "qy", "qz", "qw"],
    ["x", "y", "z", "q0", "q1", "q2", "q3"],
    ["tx", "ty", "tz", "qx", "qy", "qz", "qw"],
];

/// When rows were true.
#[derive(Clone, Debug, PartialEq)]
pub enum RowTime {
    /// Even, Hz.
    Rate(f64),
    /// By a column, in a unit of so many nanoseconds.
    Column(String, i64),
}

/// How to read the tables.
#[derive(Clone, Debug)]
pub struct TableOptions {
    /// When rows were true.
    pub time: RowTime,
    /// Columns of force (N) and torque (N m), x y z each; else by the known names.
    pub wrench_columns: Option<[String; 6]>,
    /// Columns of position (m) and quaternion x y z w; else by the known names, of which `q0..q3` has w last.
    pub pose_columns: Option<[String; 7]>,
    /// The sensor reports what the tool does to the environment: turn the signs round.
    pub negate_wrench: bool,
    /// Replace an existing recording.
    pub overwrite: bool,
}

/// What was made.
#[derive(Clone, Debug, Serialize)]
pub struct TablesReport {
    /// The recording.
    pub path: PathBuf,
    /// What it was made from.
    pub sources: Vec<SourceFile>,
    /// Wrenches and poses written.
    pub samples: [u64; 2],
    /// Rows of wrench and poses that are left out: a field is empty, missing or not finite, or the quaternion is none.
    pub left_out: [u64; 2],
    /// What looks like other units.
    pub doubts: Vec<String>,
    /// Whether the times are made up from a rate.
    pub times_made_up: bool,
}

/// Writes `out` from a table of wrenches and one of poses (`world_from_tcp`).
///
/// # Errors
/// A table cannot be read, lacks a column, has a field that is no number or a time that is none, or `out` cannot be written.
pub fn import_tables(
    wrench: &Path,
    pose: &Path,
    out: &Path,
    options: &TableOptions,
) -> Result<TablesReport, ImportError> {
    let (wrenches, poses) = (Table::open(wrench)?, Table::open(pose)?);
    let sign = if options.negate_wrench { -1.0 } else { 1.0 };
    let columns = named(&wrenches, options.wrench_columns.as_ref(), &WRENCH_NAMES)?;
    let times = times(&wrenches, &options.time)?;
    let mut samples = Vec::with_capacity(wrenches.len());
    for (row, at) in times.into_iter().enumerate() {
        let value = wrenches.numbers(row, columns)?.map(|value| sign * value);
        let is_finite = value.iter().all(|value| value.is_finite());
        samples.extend(at.filter(|_| is_finite).map(|at| Stamped { at, value }));
    }
    let track = track(&poses, options)?;
    for (path, count) in [(wrench, samples.len()), (pose, track.len())] {
        if count == 0 {
            return Err(ImportError::Content {
                path: path.to_owned(),
                reason: "no row of it can be used: every one has an empty field or one that is not finite".to_owned(),
            });
        }
    }
    let left_out =
        |table: &Table, used: usize| table.len().saturating_sub(used) as u64 + table.cut_rows();
    let mut doubts = super::plausible::of_wrench(&samples);
    doubts.extend(super::plausible::of_poses(&track));
    let report = TablesReport {
        path: out.to_owned(),
        sources: vec![SourceFile::of(wrench)?, SourceFile::of(pose)?],
        samples: [samples.len() as u64, track.len() as u64],
        left_out: [
            left_out(&wrenches, samples.len()),
            left_out(&poses, track.len()),
        ],
        doubts,
        times_made_up: matches!(options.time, RowTime::Rate(_)),
    };
    let mut rewrite = Rewrite::new();
    add_wrench(&mut rewrite, &samples);
    add_poses(&mut rewrite, topic::TCP_POSE, &track);
    rewrite.metadata(metadata::IMPORT, import_entries("tables", &report));
    rewrite.write(None, out, options.overwrite)?;
    Ok(report)
}

/// Poses by time, as far as they are usable.
fn track(poses: &Table, options: &TableOptions) -> Result<Vec<Stamped<Pose7>>, ImportError> {
    let columns = named(poses, options.pose_columns.as_ref(), &POSE_NAMES)?;
    let mut track = Vec::with_capacity(poses.len());
    for (row, at) in times(poses, &options.time)?.into_iter().enumerate() {
        let [x, y, z, rotation @ ..] = poses.numbers(row, columns)?;
        let pose = at.zip(Pose7::normalised([x, y, z], rotation));
        track.extend(pose.map(|(at, value)| Stamped { at, value }));
    }
    Ok(track)
}

fn named<const N: usize>(
    table: &Table,
    given: Option<&[String; N]>,
    known: &[[&str; N]],
) -> Result<[Column; N], ImportError> {
    if let Some(given) = given {
        return table.columns(core::array::from_fn(|k| given[k].as_str()));
    }
    let fitting = known
        .iter()
        .find(|names| names.iter().all(|name| table.find(name).is_some()));
    table.columns(*fitting.unwrap_or(&known[0]))
}

/// When each row was true; `None` where its field says nothing.
fn times(table: &Table, time: &RowTime) -> Result<Vec<Option<HostTime>>, ImportError> {
    match time {
        RowTime::Rate(hz) => Ok((0..table.len())
            .map(|row| Some(super::shifted(UNKNOWN_BEGIN, row as f64 / hz)))
            .collect()),
        RowTime::Column(name, unit_ns) => {
            let column = table.column(name)?;
            (0..table.len())
                .map(|row| {
                    // Whole numbers stay exact.
                    let nanos = match table.number::<i64>(row, column) {
                        Ok(whole) => whole.checked_mul(*unit_ns),
                        Err(_) => {
                            let number = table.float(row, column)?;
                            if number.is_nan() {
                                return Ok(None);
                            }
                            Some(super::nanos(number * *unit_ns as f64 * 1e-9))
                        }
                    };
                    nanos
                        .filter(|nanos| (0..=LAST_INSTANT).contains(nanos))
                        .map(|nanos| Some(HostTime::from_nanos(nanos)))
                        .ok_or_else(|| ImportError::Content {
                            path: table.path().to_owned(),
                            reason: format!(
                                "row {} of {name} is no instant from 1970 to 2096; --time-unit says what its numbers are",
                                row + 1
                            ),
                        })
                })
                .collect()
        }
    }
}

impl fmt::Display for TablesReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} wrenches, {} poses",
            self.path.display(),
            self.samples[0],
            self.samples[1]
        )?;
        for (count, what) in self.left_out.into_iter().zip(["wrenches", "poses"]) {
            if count > 0 {
                write!(
                    f,
                    ", {count} {what} left out (a field is empty, missing or not finite, or the quaternion is none)"
                )?;
            }
        }
        if self.times_made_up {
            write!(f, ", times made up from the rate (begin 2020-01-01)")?;
        }
        for doubt in &self.doubts {
            write!(f, "\n  doubtful: {doubt}")?;
        }
        Ok(())
    }
}
