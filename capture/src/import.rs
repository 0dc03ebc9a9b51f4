//! Recordings and trajectories that others made, as recordings of ours.

use std::path::{Path, PathBuf};

use ft_recording::{ReadError, WriteError};
use ft_wire::HostTime;

use crate::calibrate::CalibrateError;

pub mod archive;
pub mod aria;
pub mod bag;
pub mod clock_map;
mod cover;
mod drift;
mod free_air;
pub mod hoi;
pub mod matrix;
pub mod mps;
mod order;
mod plausible;
pub mod table;
pub mod tables;
mod topics;

pub use cover::Uncovered;

/// Something cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The operating system refused.
    #[error("cannot {call} {path}: {source}")]
    Io {
        /// What was tried.
        call: &'static str,
        /// On which file.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// Files that are needed are not there.
    #[error("{path} has {missing}; {hint}")]
    Missing {
        /// The folder.
        path: PathBuf,
        /// What it lacks.
        missing: String,
        /// What to do.
        hint: &'static str,
    },
    /// A table lacks a column.
    #[error("{path} has no column {column}; its columns are {there}")]
    Column {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// The columns that it has.
        there: String,
    },
    /// A table's field is not what its column holds.
    #[error("{path} line {line}: {column} is {got:?}, expected {expected}")]
    Field {
        /// The file.
        path: PathBuf,
        /// Its line, from 1.
        line: u64,
        /// The column.
        column: String,
        /// What is there.
        got: String,
        /// What should be.
        expected: &'static str,
    },
    /// A table cannot be read as one.
    #[error("{path} line {line}: {reason}")]
    Table {
        /// The file.
        path: PathBuf,
        /// Its line, from 1; 0 for the whole file.
        line: u64,
        /// What is wrong.
        reason: String,
    },
    /// A file's content is not what it should be.
    #[error("{path}: {reason}")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The trajectory and the recording do not meet in time.
    #[error(
        "the trajectory ({trajectory_s:.1} s) and the wrench ({wrench_s:.1} s) do not overlap: by utc the trajectory begins {begins_s:+.1} s after the wrench; \
         the glasses' utc is a phone's and may be off: pass --starts-at with the seconds after the first wrench at which the trajectory begins"
    )]
    Apart {
        /// Length of the trajectory, s.
        trajectory_s: f64,
        /// Length of the wrench, s.
        wrench_s: f64,
        /// First pose minus first wrench, s.
        begins_s: f64,
    },
    /// The trajectory has no utc, and nothing else says when it was.
    #[error(
        "no utc in {path} ({why}): pass --starts-at with the seconds after the first wrench at which the trajectory begins"
    )]
    NoUtc {
        /// The trajectory.
        path: PathBuf,
        /// What its column has instead.
        why: &'static str,
    },
    /// Pose and wrench could not be aligned.
    #[error("pose and wrench cannot be aligned: {source}. {hint}")]
    Align {
        /// Why not.
        source: CalibrateError,
        /// What else can be done.
        hint: &'static str,
    },
    /// The source recording cannot be read, or the new one not be written.
    #[error(transparent)]
    Recording(#[from] ReadError),
    /// The new recording cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// SHA-256 of a file, 64 hex digits.
///
/// # Errors
/// It cannot be read.
pub(crate) fn sha256(path: &Path) -> Result<String, ImportError> {
    use sha2::{Digest as _, Sha256};
    let mut file = std::fs::File::open(path).map_err(io("open", path))?;
    let mut hasher = Sha256::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = std::io::Read::read(&mut file, &mut buffer).map_err(io("read", path))?;
        if read == 0 {
            return Ok(hex(&hasher.finalize()));
        }
        hasher.update(&buffer[..read]);
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

pub(crate) fn io(call: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> ImportError {
    move |source| ImportError::Io {
        call,
        path: path.to_owned(),
        source,
    }
}

/// Nanoseconds of a span in seconds.
#[allow(
    clippy::cast_possible_truncation,
    reason = "a float to integer `as` saturates"
)]
pub(crate) fn nanos(seconds: f64) -> i64 {
    (seconds * 1e9).round() as i64
}

/// `at` plus a span in seconds, which may be negative.
pub(crate) fn shifted(at: HostTime, seconds: f64) -> HostTime {
    HostTime::from_nanos(at.as_nanos().saturating_add(nanos(seconds)))
}
