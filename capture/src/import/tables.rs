//! A wrench and poses that lie in two plain tables, as a recording of ours.
//!
//! Columns are found by name. Rows without a time column are taken to be even, at a rate that is given; both tables then begin
//! together.

use std::fmt;
use std::path::{Path, PathBuf};

use ft_recording::message::{Header, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{MessageStamps, Pose7, Stamped, metadata, topic};
use ft_wire::HostTime;
use ft_wire::frames::{Frame, FtSensor};
use serde::Serialize;

use super::ImportError;
use super::aria::{add_poses, import_entries};
use super::mps::SourceFile;
use super::table::{Column, Table};

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
    /// Poses whose quaternion is none, left out.
    pub no_rotation: u64,
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
    let mut messages = Vec::with_capacity(wrenches.len());
    for (row, at) in times.into_iter().enumerate() {
        let values = wrenches.numbers(row, columns)?.map(|value| sign * value);
        let stamps = MessageStamps {
            log_time: at,
            publish_time: at,
        };
        let header = Header::new(at, FtSensor::NAME);
        let wrench = values.into();
        messages.push((stamps, WrenchStamped { header, wrench }));
    }
    let (track, no_rotation) = track(&poses, options)?;
    let report = TablesReport {
        path: out.to_owned(),
        sources: vec![SourceFile::of(wrench)?, SourceFile::of(pose)?],
        samples: [messages.len() as u64, track.len() as u64],
        no_rotation,
        times_made_up: matches!(options.time, RowTime::Rate(_)),
    };
    let mut rewrite = Rewrite::new();
    rewrite.add(topic::WRENCH, Qos::SENSOR, messages);
    add_poses(&mut rewrite, topic::TCP_POSE, &track);
    rewrite.metadata(metadata::IMPORT, import_entries("tables", &report));
    rewrite.write(None, out, options.overwrite)?;
    Ok(report)
}

/// Poses by time, and how many rows were left out.
fn track(poses: &Table, options: &TableOptions) -> Result<(Vec<Stamped<Pose7>>, u64), ImportError> {
    let columns = named(poses, options.pose_columns.as_ref(), &POSE_NAMES)?;
    let (mut track, mut no_rotation) = (Vec::with_capacity(poses.len()), 0);
    for (row, at) in times(poses, &options.time)?.into_iter().enumerate() {
        let [x, y, z, rotation @ ..] = poses.numbers(row, columns)?;
        match Pose7::normalised([x, y, z], rotation) {
            Some(value) => track.push(Stamped { at, value }),
            None => no_rotation += 1,
        }
    }
    Ok((track, no_rotation))
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

fn times(table: &Table, time: &RowTime) -> Result<Vec<HostTime>, ImportError> {
    match time {
        RowTime::Rate(hz) => Ok((0..table.len())
            .map(|row| super::shifted(UNKNOWN_BEGIN, row as f64 / hz))
            .collect()),
        RowTime::Column(name, unit_ns) => {
            let column = table.column(name)?;
            (0..table.len())
                .map(|row| {
                    // Whole numbers stay exact.
                    let nanos = match table.number::<i64>(row, column) {
                        Ok(whole) => whole.checked_mul(*unit_ns),
                        Err(_) => {
                            let seconds = table.number::<f64>(row, column)? * *unit_ns as f64 * 1e-9;
                            Some(super::nanos(seconds))
                        }
                    };
                    nanos
                        .filter(|nanos| *nanos >= 0 && *nanos < i64::MAX)
                        .map(HostTime::from_nanos)
                        .ok_or_else(|| ImportError::Content {
                            path: table.path().to_owned(),
                            reason: format!(
                                "row {} of {name} is no instant from 1970 on; --time-unit says what its numbers are",
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
        if self.no_rotation > 0 {
            write!(
                f,
                ", {} poses without a rotation left out",
                self.no_rotation
            )?;
        }
        if self.times_made_up {
            write!(f, ", times made up from the rate (begin 2020-01-01)")?;
        }
        Ok(())
    }
}
