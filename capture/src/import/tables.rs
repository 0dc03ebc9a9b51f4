//! A wrench and poses that lie in two plain tables, as a recording of ours.
//!
//! Columns are found by name. Rows without a time column are taken to be even, at a rate that is given; both tables then begin
//! together.

use std::fmt;
use std::path::{Path, PathBuf};

use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{Calibration, ReadError, metadata, topic};
use ft_wire::HostTime;
use serde::Serialize;

mod rows;

pub use rows::RowCounts;

use super::ImportError;
use super::cover::Uncovered;
use super::mps::SourceFile;
use super::table::{Column, Table};
use super::topics::{add_poses, add_wrench, import_entries, true_at};
use crate::config::SaidFrames;
use crate::encode::said_transforms;

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
    /// Where the sensor is on the tool, which must be said, and the tool on the glasses; of what is not said here nothing is said.
    pub frames: Option<SaidFrames>,
    /// The tool's weight and the sensor's bias, found before.
    pub calibration: Option<Calibration>,
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
    /// Rows of wrench and poses that are left out.
    pub left_out: [u64; 2],
    /// Where one stream is there and the other is not.
    pub uncovered: Uncovered,
    /// Why, of each.
    pub counts: [RowCounts; 2],
    /// What looks like other units.
    pub doubts: Vec<String>,
    /// Whether the times are made up from a rate.
    pub times_made_up: bool,
}

/// Writes `out` from a table of wrenches and one of poses (`world_from_tcp`).
///
/// # Errors
/// A table cannot be read, lacks a column, has a field that is no number or a time that is none, frames are said without where the sensor is
/// on the tool, or `out` cannot be written.
pub fn import_tables(
    wrench: &Path,
    pose: &Path,
    out: &Path,
    options: &TableOptions,
) -> Result<TablesReport, ImportError> {
    // Readers would take a sensor of which nothing is said for one that stands in the tool's frame.
    if let Some(SaidFrames {
        tcp_from_ft_sensor: None,
        ..
    }) = &options.frames
    {
        return Err(ImportError::Missing {
            path: wrench.to_owned(),
            missing: "no place on the tool: --frames has no [frames.tcp_from_ft_sensor]".to_owned(),
            hint: "say it in the file of --frames, or leave --frames out where sensor and tool coincide",
        });
    }
    let (wrenches, poses) = (Table::open(wrench)?, Table::open(pose)?);
    let sign = if options.negate_wrench { -1.0 } else { 1.0 };
    let columns = named(&wrenches, options.wrench_columns.as_ref(), &WRENCH_NAMES)?;
    let signed = |_: &mut RowCounts, value: [f64; 6]| Some(value.map(|value| sign * value));
    let (samples, of_wrench) = RowCounts::read(&wrenches, &options.time, columns, signed)?;
    let columns = named(&poses, options.pose_columns.as_ref(), &POSE_NAMES)?;
    let (track, of_poses) = RowCounts::read(&poses, &options.time, columns, RowCounts::pose)?;
    let mut doubts = super::plausible::of_wrench(&samples);
    doubts.extend(super::plausible::of_poses(&track));
    let report = TablesReport {
        path: out.to_owned(),
        sources: vec![SourceFile::of(wrench)?, SourceFile::of(pose)?],
        samples: [samples.len() as u64, track.len() as u64],
        left_out: [of_wrench.left_out(), of_poses.left_out()],
        uncovered: Uncovered::of(&samples, &track),
        counts: [of_wrench, of_poses],
        doubts,
        times_made_up: matches!(options.time, RowTime::Rate(_)),
    };
    let mut rewrite = Rewrite::new();
    add_wrench(&mut rewrite, &samples);
    add_poses(&mut rewrite, topic::TCP_POSE, &track);
    if let Some(frames) = &options.frames {
        let start = samples.first().map_or(UNKNOWN_BEGIN, |sample| sample.at);
        let transforms = said_transforms(frames, start);
        rewrite.add(
            topic::TF_STATIC,
            Qos::LATCHED,
            [(true_at(start), transforms)],
        );
    }
    if let Some(calibration) = &options.calibration {
        let entries = calibration
            .to_metadata()
            .map_err(|source| ReadError::Calibration {
                path: out.to_owned(),
                source,
            })?;
        rewrite.metadata(metadata::CALIBRATION, entries);
    }
    rewrite.metadata(metadata::IMPORT, import_entries("tables", &report));
    rewrite.write(None, out, options.overwrite)?;
    Ok(report)
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

impl TablesReport {
    /// Whether rows by another clock, or more than half of a table's rows, are missing, or poses have no wrench or wrenches no pose.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        self.lost_most()
            || self.uncovered.lost_data()
            || self.counts.iter().any(|counts| counts.set_back > 0)
    }

    fn lost_most(&self) -> bool {
        let mut tables = self.counts.iter();
        tables.any(|counts| 2 * counts.left_out() > counts.rows)
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
        for (counts, what) in self.counts.iter().zip(["wrenches", "poses"]) {
            let of_values = counts.no_value + counts.no_rotation;
            if of_values > 0 {
                write!(
                    f,
                    ", {of_values} {what} left out (a field is empty, missing or not finite, or the quaternion is none)"
                )?;
            }
        }
        if self.times_made_up {
            write!(f, ", times made up from the rate (begin 2020-01-01)")?;
        }
        for (counts, what) in self.counts.iter().zip(["wrenches", "poses"]) {
            if counts.left_out() > 0 {
                write!(f, "\n  {what} left out: {counts}")?;
            }
            if counts.moved > 0 {
                write!(
                    f,
                    "\n  {} {what} put in order by their stamps",
                    counts.moved
                )?;
            }
        }
        if self.lost_most() {
            write!(f, "\n  MORE THAN HALF of the rows of a table are left out")?;
        }
        write!(f, "{}", self.uncovered)?;
        for doubt in &self.doubts {
            write!(f, "\n  doubtful: {doubt}")?;
        }
        Ok(())
    }
}
