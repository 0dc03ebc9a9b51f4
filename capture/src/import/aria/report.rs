//! What became of a trajectory.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::calibrate::Alignment;
use crate::gyro::{GyroCheck, Gyroscope};
use crate::import::cover::Uncovered;
use crate::import::drift::Drift;
use crate::import::mps::{SourceFile, TrajectoryCounts, TrajectoryKind};
use crate::import::order::SET_BACK;

/// What was imported.
#[derive(Clone, Debug, Serialize)]
pub struct AriaReport {
    /// The new recording.
    pub path: PathBuf,
    /// What it was made from.
    pub sources: Vec<SourceFile>,
    /// Which trajectory.
    pub kind: TrajectoryKind,
    /// Poses written.
    pub poses: u64,
    /// What its file has and what was left out.
    pub counts: TrajectoryCounts,
    /// Root mean square of utc about the line that was put through it, ms; none without utc.
    pub utc_rms_ms: Option<f64>,
    /// The first pose after the first wrench by utc or by `starts_at_s`, s.
    pub begins_s: f64,
    /// What the tool's own wrench adds to that; none when it was not asked.
    pub alignment: Option<Alignment>,
    /// How the clocks drift apart over the recording; none without an alignment.
    pub drift: Option<Drift>,
    /// Poses that the source recording had, by topic: they are not in the new one.
    pub replaced: BTreeMap<String, u64>,
    /// Where one of wrench and poses is there and the other is not.
    pub uncovered: Uncovered,
    /// What looks like other units.
    pub doubts: Vec<String>,
    /// Whether `/tcp/pose` was written: it needs to know where the tool is on the glasses.
    pub has_tcp: bool,
    /// What a gyroscope of the wrench's clock says of the times that were written; none when the recording has no inertial unit.
    pub gyroscope: Option<Gyroscope>,
    /// How the trajectory's own angular rates fit its rotations; none where it has none, or hardly turns.
    pub own_rate: Option<GyroCheck>,
    /// Time offsets of the glasses' inertial sensors (online calibration), ms: least and largest by sensor. They concern these sensors'
    /// raw samples: the trajectory's stamps are the glasses' clock already.
    pub imu_offsets_ms: BTreeMap<String, [f64; 2]>,
    /// What of the online calibration could not be read; it is only reported, so that this stops nothing.
    pub not_read: Option<String>,
}

impl AriaReport {
    /// Whether a stretch by another clock, or more than half of the trajectory, is missing, or one stream beside the other.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.counts.lost_data() || self.uncovered.lost_data()
    }
}

impl fmt::Display for AriaReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = &self.counts;
        let kind = match self.kind {
            TrajectoryKind::ClosedLoop => "closed-loop",
            TrajectoryKind::OpenLoop => "open-loop",
        };
        writeln!(
            f,
            "{}: {} {kind} poses of {} rows (left out: {} not later than the one before, {} no rotation or an empty field, {} of low quality); \
             least quality {:.2}",
            self.path.display(),
            self.poses,
            counts.rows,
            counts.not_later,
            counts.no_pose,
            counts.low_quality,
            counts.least_quality
        )?;
        if counts.quaternion_length.is_some() {
            writeln!(f, "no rotation:{}", counts.quaternion_text())?;
        }
        if counts.far > 0 {
            writeln!(
                f,
                "{} rows stamped at another time than the most left out",
                counts.far
            )?;
        }
        if counts.set_back > 0 {
            writeln!(f, "{} rows left out {SET_BACK}", counts.set_back)?;
        }
        if counts.moved > 0 {
            writeln!(f, "{} rows put in order by their stamps", counts.moved)?;
        }
        if counts.no_stamp > 0 {
            writeln!(
                f,
                "{} rows without a usable stamp left out",
                counts.no_stamp
            )?;
        }
        if counts.other_world > 0 {
            writeln!(
                f,
                "{} poses of other worlds (graph_uid or session_uid) left out: they do not join the others",
                counts.other_world
            )?;
        }
        if counts.doubtful > 0 {
            writeln!(
                f,
                "{} poses of a quality below 0.5 kept; --min-quality 0.5 leaves them out",
                counts.doubtful
            )?;
        }
        if let Some(text) = &self.not_read {
            writeln!(f, "not read: {text}")?;
        }
        if counts.turned_deg > 0.01 {
            writeln!(
                f,
                "world turned by {:.1} deg, so that z is up",
                counts.turned_deg
            )?;
        }
        write!(
            f,
            "the first pose is {:+.3} s after the first wrench",
            self.begins_s
        )?;
        match self.utc_rms_ms {
            Some(rms) => writeln!(f, " (utc is a line to {rms:.3} ms rms)")?,
            None => writeln!(f, " (no utc)")?,
        }
        match &self.alignment {
            Some(alignment) => writeln!(f, "{alignment}")?,
            None => writeln!(
                f,
                "not aligned: the times are those of utc or --starts-at, which may be seconds off"
            )?,
        }
        if let Some(drift) = &self.drift {
            writeln!(f, "{drift}")?;
        }
        if let Some(gyroscope) = &self.gyroscope {
            writeln!(f, "{gyroscope}")?;
        }
        if let Some(check) = &self.own_rate {
            writeln!(f, "the trajectory's own angular rate {check}")?;
        }
        if !self.imu_offsets_ms.is_empty() {
            let sensors = self.imu_offsets_ms.iter();
            let texts: Vec<_> = sensors
                .map(|(name, [least, most])| format!("{name} {least:.2} to {most:.2} ms"))
                .collect();
            writeln!(
                f,
                "online calibration: the glasses' inertial sensors are off their clock by {}; the poses' stamps are that clock and are not moved",
                texts.join(", ")
            )?;
        }
        for (name, messages) in &self.replaced {
            writeln!(
                f,
                "the recording's own {name} ({messages} poses) is not in the new one: these poses take its place"
            )?;
        }
        for doubt in &self.doubts {
            writeln!(f, "doubtful: {doubt}")?;
        }
        if !self.has_tcp {
            writeln!(
                f,
                "no /tcp/pose: nothing says where the tool is on the glasses (--frames)"
            )?;
        }
        if counts.lost_most() {
            writeln!(f, "MORE THAN HALF of the trajectory's rows are left out")?;
        }
        write!(f, "from")?;
        for file in &self.sources {
            write!(
                f,
                " {} ({}...)",
                file.name,
                file.sha256.get(..12).unwrap_or("")
            )?;
        }
        write!(f, "{}", self.uncovered)
    }
}
