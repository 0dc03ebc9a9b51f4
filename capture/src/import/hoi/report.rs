//! What became of a recording of the dataset.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::calibrate::Alignment;
use crate::gyro::GyroCheck;
use crate::import::mps::{SourceFile, TrajectoryCounts};

/// What became of a recording.
#[derive(Clone, Debug, Serialize)]
pub struct HoiReport {
    /// `<location>_<range>`.
    pub name: String,
    /// The new recording.
    pub path: PathBuf,
    /// Wrenches and poses written.
    pub samples: [u64; 2],
    /// Wrenches that have an empty field, are not finite or cut short, or are stamped as another, not at all, or hours away.
    pub left_out: u64,
    /// What the trajectory has and what of it was left out.
    pub counts: TrajectoryCounts,
    /// Where the calibration comes from.
    pub calibration: HoiCalibration,
    /// How far the poses were moved; none when the free air does not show it.
    pub alignment: Option<Alignment>,
    /// What the sensor's own gyroscope says of the times that were written; none when it shows nothing.
    pub gyro_check: Option<GyroCheck>,
    /// What looks like other units.
    pub doubts: Vec<String>,
    /// What is not there, and what that costs.
    pub missing: Vec<String>,
    /// What is there and is not in the recording.
    pub unused: Vec<String>,
    /// What it was made from.
    pub sources: Vec<SourceFile>,
}

/// Where a calibration comes from.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum HoiCalibration {
    /// Free air of the recording, s from its start.
    FreeAir {
        /// Its begin, s.
        from_s: f64,
        /// End of the free air, s.
        until_s: f64,
    },
    /// The dataset's mass and centre of mass, and the bias of quiet stretches.
    Constants {
        /// Quiet stretches, s.
        quiet_s: f64,
    },
}

impl fmt::Display for HoiReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} wrenches, {} poses -> {}",
            self.name,
            self.samples[0],
            self.samples[1],
            self.path.display()
        )?;
        if self.left_out > 0 {
            write!(
                f,
                "\n  {} wrenches left out: a field empty or not finite, or stamped as another or at another time",
                self.left_out
            )?;
        }
        let counts = &self.counts;
        let poses = [
            (
                counts.other_world,
                "of other worlds (graph_uid or session_uid)",
            ),
            (counts.not_later, "not later than the one before"),
            (counts.no_pose, "without a rotation, or with an empty field"),
            (counts.no_stamp, "without a stamp"),
            (counts.low_quality, "without a quality"),
        ];
        for (count, what) in poses.into_iter().filter(|(count, _)| *count > 0) {
            write!(f, "\n  {count} poses left out: {what}")?;
        }
        match &self.calibration {
            HoiCalibration::FreeAir { from_s, until_s } => write!(
                f,
                "\n  tool weighed in free air, {from_s:.0} to {until_s:.0} s"
            )?,

            HoiCalibration::Constants { quiet_s } => {
                write!(
                    f,
                    "\n  tool by the dataset's constants, bias from {quiet_s:.0} quiet s"
                )?;
            }
        }
        if let Some(alignment) = &self.alignment {
            write!(f, "\n  {alignment}")?;
        }
        if let Some(check) = &self.gyro_check {
            write!(f, "\n  the sensor's gyroscope {check}")?;
        }
        for doubt in &self.doubts {
            write!(f, "\n  doubtful: {doubt}")?;
        }
        for missing in &self.missing {
            write!(f, "\n  missing: {missing}")?;
        }
        for unused in &self.unused {
            write!(f, "\n  not used: {unused}")?;
        }
        Ok(())
    }
}
