//! What identification needs from a recording, whoever wrote it.
//!
//! Needed are the wrench and one of the two poses; everything else may be missing. Samples are sorted by `header.stamp`,
//! exact repetitions are removed, and what cannot be used is left out and counted in [`ReadHealth`].

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};
use std::thread::ScopedJoinHandle;

use ft_wire::HostTime;
use sha2::{Digest, Sha256};

use crate::calibration::Calibration;
pub use crate::error::ReadError;
use crate::reader::{Batch, Damage, RecordReader};

mod fresh;
mod loader;
mod pose;
mod topic_map;
mod track;

pub use fresh::{fresh, steps};
use loader::Loader;
pub use pose::Pose7;
pub(crate) use pose::{StaticTransforms, frame_name};
pub use topic_map::TopicMap;
pub use track::{ReadHealth, TopicHealth};

/// A value and when it was true, on the host clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamped<T> {
    /// `header.stamp`.
    pub at: HostTime,
    /// The value.
    pub value: T,
}

/// Whose pose a track gives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackedFrame {
    /// Between the pads (`/tcp/pose`).
    Tcp,
    /// The Aria glasses (`/aria/pose`).
    AriaDevice,
}

/// A tracked frame's poses in `world`.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseTrack {
    /// The tracked frame.
    pub frame: TrackedFrame,
    /// `world_from_<frame>`, by stamp.
    pub samples: Vec<Stamped<Pose7>>,
}

/// A recording as identification sees it. Every vector is sorted by stamp; stamps may repeat with different values.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
    /// Force then torque, N and N m; environment on tool, in `ft_sensor`, neither tared nor compensated.
    pub wrench: Vec<Stamped<[f64; 6]>>,
    /// `/tcp/pose` when it has samples, else `/aria/pose`.
    pub pose: PoseTrack,
    /// Jaw opening, m.
    pub gripper_width: Vec<Stamped<f64>>,
    /// Of the force-torque sensor, degrees Celsius.
    pub temperature: Vec<Stamped<f64>>,
    /// Of a gyroscope on the gripper, by the wrench's clock: rad/s in axes of its own.
    pub angular_rate: Vec<Stamped<[f64; 3]>>,
    /// From `/tf_static`; identity when that does not say.
    pub aria_device_from_tcp: Pose7,
    /// From `/tf_static`; identity when that does not say.
    pub tcp_from_ft_sensor: Pose7,
    /// The operator's marks, at their publish time.
    pub marks: Vec<Stamped<String>>,
    /// The tool's calibration, when the recording has one.
    pub calibration: Option<Calibration>,
    /// Entries of `ft.session`.
    pub session: BTreeMap<String, String>,
    /// What was left out, and what is wrong with the file.
    pub health: ReadHealth,
}

impl Recording {
    /// Reads an MCAP recording.
    ///
    /// # Errors
    /// When the file cannot be read or is no MCAP; the wrench or both poses are missing, of another type, not CDR, or have
    /// no message that can be used; `ft.calibration` is wrong; or `map` names a topic that is not there. A truncated or
    /// damaged file is no error as long as the needed topics have messages before the damage.
    pub fn load(path: &Path, map: &TopicMap) -> Result<Self, ReadError> {
        Self::load_as(path, map, true).map(|(recording, _)| recording)
    }

    /// As [`Recording::load`], for a recording whose poses may come from elsewhere: they may be missing.
    ///
    /// # Errors
    /// As [`Recording::load`], save for missing poses.
    pub fn load_without_pose(
        path: &Path,
        map: &TopicMap,
    ) -> Result<(Self, KnownFrames), ReadError> {
        Self::load_as(path, map, false)
    }

    fn load_as(
        path: &Path,
        map: &TopicMap,
        needs_pose: bool,
    ) -> Result<(Self, KnownFrames), ReadError> {
        // A chunk's messages are sorted while the next one is unpacked and the file is hashed.
        let (sha256, damage, loader) = std::thread::scope(|threads| {
            let (unpacked, batches) = sync_channel(BATCHES_AHEAD);
            let (used, spent) = channel();
            let sha256 = threads.spawn(|| sha256_of(path));
            let damage = threads.spawn(|| read_batches(path, unpacked, spent));
            let mut loader = Loader::new(map);
            for batch in batches {
                batch.records().for_each(|record| loader.take(record));
                // The reader may be done, and needs no room then.
                let _ = used.send(batch);
            }
            (joined(sha256), joined(damage), loader)
        });
        let (sha256, damage) = (sha256?, damage?);
        let frames = loader.known_frames();
        let recording = loader.finish(path, sha256, &damage, needs_pose)?;
        Ok((recording, frames))
    }
}

/// What `/tf_static` says; `None` where it does not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KnownFrames {
    /// Takes coordinates in `tcp` to `aria_device`.
    pub aria_device_from_tcp: Option<Pose7>,
    /// Takes coordinates in `ft_sensor` to `tcp`.
    pub tcp_from_ft_sensor: Option<Pose7>,
}

/// Batches of records that wait to be sorted.
const BATCHES_AHEAD: usize = 1;

/// Reads a file's records into batches, in memory of `spent` ones where there is any, and gives what is wrong with the file.
fn read_batches(
    path: &Path,
    unpacked: SyncSender<Batch>,
    spent: Receiver<Batch>,
) -> Result<Vec<Damage>, ReadError> {
    let mut reader = RecordReader::open(path)?;
    loop {
        let mut batch = spent.try_recv().unwrap_or_default();
        if !reader.next_batch(&mut batch)? || unpacked.send(batch).is_err() {
            return Ok(reader.damage().to_vec());
        }
    }
}

fn joined<T>(thread: ScopedJoinHandle<'_, T>) -> T {
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// SHA-256 of a file, 64 hex digits.
fn sha256_of(path: &Path) -> Result<String, ReadError> {
    let io = |call| {
        move |source| ReadError::Io {
            call,
            path: path.to_owned(),
            source,
        }
    };
    let mut file = BufReader::with_capacity(1 << 16, crate::reader::open_regular(path)?.0);
    let mut hasher = Sha256::new();
    loop {
        let bytes = file.fill_buf().map_err(io("read"))?;
        if bytes.is_empty() {
            return Ok(hasher
                .finalize()
                .iter()
                .map(|byte| format!("{byte:02x}"))
                .collect());
        }
        hasher.update(bytes);
        let length = bytes.len();
        file.consume(length);
    }
}
