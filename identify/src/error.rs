//! Why an identification gives no result.

use std::path::PathBuf;

use ft_recording::ReadError;

use crate::dynamics::DynamicsError;
use crate::filter::FilterError;
use crate::motion::MotionError;
use crate::payload::PayloadError;
use crate::screw::SelectError;
use crate::table::TableError;
use crate::tool::AlignError;
use crate::track::TrackError;

/// Why an identification gives no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IdentifyError {
    /// A directory in place of a recording.
    #[error("{} is a directory; name one recording, or identify all of them with --batch {}", .0.display(), .0.display())]
    Directory(PathBuf),
    /// The recording cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Its streams have no common grid.
    #[error(transparent)]
    Align(#[from] AlignError),
    /// The object was held too briefly.
    #[error(
        "the object is held for {held_s:.1} s, need at least {needed_s:.0} s; set the marks `grasp` and `release` around the probing and record longer"
    )]
    HeldTooShort {
        /// Held time, s.
        held_s: f64,
        /// Needed, s.
        needed_s: f64,
    },
    /// The tool touches nothing.
    #[error(
        "no contact: the force on the object is {force_n:.2} N root mean square while it should be held, need at least {needed_n:.1} N; \
         check that the object was grasped and that the force-torque sensor was on"
    )]
    NoContact {
        /// Contact force, N.
        force_n: f64,
        /// Needed, N.
        needed_n: f64,
    },
    /// The force-torque sensor was at the end of its range.
    #[error(
        "the sensor is saturated: {channel} stays at {value:.1} {unit} for {:.1} % of the time that the object was held (at most {:.1} %); the effort is cut \
         off there: probe more gently, hold the handle farther from the axis, or set the sensor to a wider range",
        100.0 * share, 100.0 * allowed
    )]
    Saturated {
        /// `force x` and so on.
        channel: &'static str,
        /// Where it stays, N or N m.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// Share of the held time.
        share: f64,
        /// Most that is allowed.
        allowed: f64,
    },
    /// The tool's motion is that of no one joint although it was held all the while.
    #[error(
        "neither a hinge nor a slide: positions are {rms_m:.3} m root mean square off the best one while the object was held (at most {allowed_m:.3} m); the \
         tool slid along the handle, the object has more than one joint, or the tracker jumped: grasp firmly and probe one joint at a time"
    )]
    NeitherJoint {
        /// Distance of the positions from the joint's path, m.
        rms_m: f64,
        /// Most that a joint may leave, m.
        allowed_m: f64,
    },
    /// What a damaged recording holds before the damage does not do.
    #[error(
        "{source} (the file is damaged, and only what came before was used: {damage}; see what there is with `ft-capture check`)"
    )]
    Damaged {
        /// Where and what.
        damage: String,
        /// Why that is not enough.
        source: Box<IdentifyError>,
    },
    /// Free air was marked, a grasp was not.
    #[error(
        "nothing was held: there is a mark `free_air_begin` and no `grasp`; the recording ended before the object was grasped, or the mark is \
         missing: record the probing too, and set the marks `grasp` and `release` around it"
    )]
    NeverGrasped,
    /// Without marks, the whole recording is no motion of one joint.
    #[error(
        "the motion is not that of one joint: positions are {rms_m:.3} m root mean square off the best one (at most {allowed_m:.3} m); nothing says when \
         the object was held: set the marks `grasp` and `release` around the probing, or give the recording a calibration"
    )]
    NotOneJoint {
        /// Distance of the positions from the joint's path, m.
        rms_m: f64,
        /// Most that a joint may leave, m.
        allowed_m: f64,
    },
    /// Without the tool's weight there is no effort.
    #[error(transparent)]
    Payload(#[from] PayloadError),
    /// A recording that was to confirm cannot be used.
    #[error("{} cannot confirm anything: {source}", path.display())]
    Confirm {
        /// The recording.
        path: PathBuf,
        /// Why.
        source: Box<IdentifyError>,
    },
    /// A recording was to confirm itself.
    #[error("it is the same recording; record the same joint a second time")]
    ConfirmsItself,
    /// A recording that was to confirm is of another joint.
    #[error(
        "it shows a {there} joint, the other recording a {here} one; record the same joint a second time"
    )]
    OtherJoint {
        /// Kind of the joint that is identified.
        here: &'static str,
        /// Kind of the joint that was to confirm it.
        there: &'static str,
    },
    /// No joint can be named.
    #[error(transparent)]
    Select(#[from] SelectError),
    /// The motion cannot be used.
    #[error(transparent)]
    Motion(#[from] MotionError),
    /// A filter does not fit the data.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The effort model cannot be fitted.
    #[error(transparent)]
    Dynamics(#[from] DynamicsError),
    /// The table is wrong.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The track is wrong.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// A result of an earlier run is there.
    #[error("{} exists: choose another directory with -o, or replace it with --force", path.display())]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// A folder of recordings cannot be listed.
    #[error("cannot list {}: {source}", path.display())]
    List {
        /// The folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A folder has no recordings.
    #[error("no recordings (*.mcap) below {}", path.display())]
    NoRecordings {
        /// The folder.
        path: PathBuf,
    },
    /// A result cannot be written.
    #[error("cannot write {}: {source}; check that the directory exists and has room", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}

impl IdentifyError {
    /// Whether what was asked for is wrong, rather than the input or the system.
    #[must_use]
    pub const fn is_of_arguments(&self) -> bool {
        matches!(
            self,
            Self::Directory(_)
                | Self::Read(ReadError::Map { .. })
                | Self::Table(TableError::SameColumn { .. } | TableError::NothingLeft { .. })
                | Self::Filter(FilterError::Cutoff { .. })
                | Self::Motion(MotionError::Filter(FilterError::Cutoff { .. }))
                | Self::Dynamics(DynamicsError::Motion(MotionError::Filter(
                    FilterError::Cutoff { .. }
                )))
        )
    }

    /// Whether the same input may give a result later, because the system refused to read or write, or another process was writing.
    #[must_use]
    pub const fn is_transient(&self) -> bool {
        matches!(
            self,
            Self::Write { .. }
                | Self::Read(
                    ReadError::Io { .. }
                        | ReadError::Busy { .. }
                        | ReadError::NoRoom { .. }
                        | ReadError::Write(_)
                )
                | Self::Track(TrackError::Io { .. })
        )
    }
}
