//! What became of a recording of the dataset.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use super::Drift;
use crate::calibrate::Alignment;
use crate::gyro::GyroCheck;
use crate::import::cover::Uncovered;
use crate::import::mps::{SourceFile, TrajectoryCounts};
use crate::import::order::SET_BACK;

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
    /// Of these, wrenches by a clock that was set back, or by the one before it.
    pub set_back: u64,
    /// Where one stream is there and the other is not.
    pub uncovered: Uncovered,
    /// What the trajectory has and what of it was left out.
    pub counts: TrajectoryCounts,
    /// Where the calibration comes from.
    pub calibration: HoiCalibration,
    /// How far the poses were moved; none when the free air does not show it.
    pub alignment: Option<Alignment>,
    /// How the clocks drift apart; none without an alignment.
    pub drift: Option<Drift>,
    /// What the sensor's own gyroscope says of the times that were written; none when it shows nothing.
    pub gyro_check: Option<GyroCheck>,
    /// Why the tool was not weighed although it moved.
    pub not_weighed: Option<String>,
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

impl HoiReport {
    /// Whether a stretch by another clock, or more than half, of the wrench or of the trajectory is missing, or poses have no wrench or wrenches no pose.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.set_back > 0
            || self.counts.lost_data()
            || self.lost_most()
            || self.uncovered.lost_data()
    }

    const fn lost_most(&self) -> bool {
        self.left_out > self.samples[0] || self.counts.lost_most()
    }
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
        if self.set_back > 0 {
            write!(f, "\n  {} of these are {SET_BACK}", self.set_back)?;
        }
        let counts = &self.counts;
        let poses = [
            (
                counts.other_world,
                "of other worlds (graph_uid or session_uid)",
            ),
            (counts.not_later, "not later than the one before"),
            (counts.set_back, SET_BACK),
            (counts.no_pose, "without a rotation, or with an empty field"),
            (counts.no_stamp, "without a stamp"),
            (counts.far, "stamped at another time than the most"),
            (counts.low_quality, "without a quality"),
        ];
        for (count, what) in poses.into_iter().filter(|(count, _)| *count > 0) {
            write!(f, "\n  {count} poses left out: {what}")?;
        }
        if counts.quaternion_length.is_some() {
            write!(f, "\n  no rotation:{}", counts.quaternion_text())?;
        }
        if counts.moved > 0 {
            write!(f, "\n  {} poses put in order by their stamps", counts.moved)?;
        }
        if self.lost_most() {
            write!(
                f,
                "\n  MORE THAN HALF of the rows of the wrench or the trajectory are left out"
            )?;
        }
        write!(f, "{}", self.uncovered)?;
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
        if let Some(drift) = &self.drift {
            write!(f, "\n  {drift}")?;
        }
        if let Some(check) = &self.gyro_check {
            write!(f, "\n  the sensor's gyroscope {check}")?;
        }
        if let Some(reason) = &self.not_weighed {
            write!(f, "\n  not weighed: {reason}")?;
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
