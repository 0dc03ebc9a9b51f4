//! Why an identification gives no result.

use std::path::PathBuf;

use ft_recording::ReadError;

use crate::dynamics::DynamicsError;
use crate::filter::FilterError;
use crate::motion::MotionError;
use crate::screw::SelectError;
use crate::table::TableError;
use crate::tool::AlignError;
use crate::track::TrackError;

/// Why an identification gives no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IdentifyError {
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
    /// A result cannot be written.
    #[error("cannot write {}: {source}; check that the directory exists and has room", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
}
