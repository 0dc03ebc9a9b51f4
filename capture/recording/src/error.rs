//! What can go wrong with a recording: writing it, reading it, its calibration.

use std::fmt;
use std::io;
use std::path::PathBuf;

use thiserror::Error;

/// The recording cannot go on, or could not be begun or finished.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The file is there already.
    #[error("{path} exists already: choose another name, or allow overwriting with --force")]
    Exists {
        /// The finished recording's path.
        path: PathBuf,
    },
    /// An unfinished recording of that name is there already.
    #[error(
        "{partial} is left from a recording that did not finish: give its data back with \
         `ft-capture recover {partial}`, choose another name, or allow overwriting with --force"
    )]
    Leftover {
        /// The unfinished recording.
        partial: PathBuf,
    },
    /// Another process is writing this recording.
    #[error("{partial} is being written by another process: stop it or choose another name")]
    Busy {
        /// The unfinished recording.
        partial: PathBuf,
    },
    /// The disk is full, or a quota or file size limit is reached. What was flushed stays readable.
    #[error(
        "no space left while writing {path}: what was flushed is kept; free some space, then \
         `ft-capture recover {path}` completes the file"
    )]
    NoSpace {
        /// The unfinished recording.
        path: PathBuf,
    },
    /// The disk is full, or a quota or file size limit is reached, and what there was of the file is of no use and removed.
    #[error("no space left for {path}: free some space or write to another disk, then try again")]
    NoRoom {
        /// The recording that was to be written.
        path: PathBuf,
    },
    /// The name is a folder's.
    #[error("{path} is a folder: name a file in it")]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("cannot {call} {path}: {source}")]
    Io {
        /// What was tried.
        call: &'static str,
        /// On which file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The content cannot be put into an MCAP.
    #[error("cannot write to {path}: {source}")]
    Format {
        /// The unfinished recording.
        path: PathBuf,
        /// Why not.
        source: mcap::McapError,
    },
    /// The topic has a channel already.
    #[error("topic {topic} has a channel already")]
    DuplicateTopic {
        /// The topic.
        topic: String,
    },
    /// The channel is of another recording.
    #[error("channel {channel} is not one of the {channels} of this recording")]
    UnknownChannel {
        /// Its number.
        channel: u16,
        /// Channels of this recording.
        channels: usize,
    },
    /// MCAP has no instants before 1970.
    #[error("instant {nanos} ns lies before 1970, which a recording cannot hold")]
    BeforeEpoch {
        /// Nanoseconds since the Unix epoch.
        nanos: i64,
    },
    /// An earlier error ended the recording.
    #[error("recording to {path} has stopped after an earlier error")]
    Stopped {
        /// The unfinished recording.
        path: PathBuf,
    },
}

/// The recording cannot be used.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ReadError {
    /// The operating system refused.
    #[error("cannot {call} {path}: {source}")]
    Io {
        /// What was tried.
        call: &'static str,
        /// On which file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A folder, a pipe, a device.
    #[error("{path} is not a regular file")]
    NotRegular {
        /// What it is called.
        path: PathBuf,
    },
    /// The file does not begin like an MCAP.
    #[error(
        "{path} is not an MCAP recording: it begins with {found}, not with \"\\x89MCAP0\\r\\n\""
    )]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// Its first bytes, and what they look like.
        found: FirstBytes,
    },
    /// A topic that is needed is not there.
    #[error(
        "{path} has no {needed}; {topics}. If one of them carries it under another name, pass --map /its/name={map_to}"
    )]
    MissingTopic {
        /// The file.
        path: PathBuf,
        /// Topic and type.
        needed: &'static str,
        /// The topic that `--map` would name.
        map_to: &'static str,
        /// What is there.
        topics: TopicList,
    },
    /// A topic that is needed has no message that can be used.
    #[error(
        "{path}: none of the {messages} messages on {topic} can be used \
         ({undecodable} undecodable, {non_finite} not finite)"
    )]
    NothingUsable {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Messages there.
        messages: u64,
        /// Not of the type.
        undecodable: u64,
        /// With NaN, infinity, or a quaternion of no length.
        non_finite: u64,
    },
    /// A topic has messages of another type.
    #[error("{path}: {topic} is of type {got}, expected {expected}")]
    WrongType {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its type.
        got: String,
        /// The type that this topic must have.
        expected: &'static str,
    },
    /// A topic's messages are not CDR.
    #[error(
        "{path}: {topic} is encoded as \"{encoding}\", only \"cdr\" (ROS 2) is read: convert the recording first"
    )]
    ForeignEncoding {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its message encoding.
        encoding: String,
    },
    /// `ft.calibration` is there and wrong.
    #[error("{path}: metadata ft.calibration: {source}")]
    Calibration {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: CalibrationError,
    },
    /// A `--map` argument names a topic that is not there.
    #[error("{path} has no {topic}, which --map names; {topics}")]
    MapFrom {
        /// The file.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// What is there.
        topics: TopicList,
    },
    /// A `--map` argument is wrong.
    #[error("--map {argument}: {reason}")]
    Map {
        /// The argument.
        argument: String,
        /// What is wrong and what it should look like.
        reason: &'static str,
    },
    /// Another process is still writing the recording.
    #[error("{path} is still being written: stop the recording first")]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// The recording has damage that a copy would hide.
    #[error("{path} is damaged: {damage}; make a whole file of it first with `ft-capture recover`")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The first damage.
        damage: String,
    },
    /// There is no room for the recovered file; the source is as it was.
    #[error(
        "no space left for {out}, which would need about {needed_bytes} bytes; {path} is unchanged: free some space \
         or write to another disk with -o, then try again"
    )]
    NoRoom {
        /// The source.
        path: PathBuf,
        /// The file that was to be written; it was removed again.
        out: PathBuf,
        /// Size of the source.
        needed_bytes: u64,
    },
    /// The recovered file cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// `ft.calibration` does not describe a tool.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum CalibrationError {
    /// The metadata record has no key `json`.
    #[error("has no key \"json\"")]
    NoJson,
    /// Not JSON, a missing or unknown key, or a value of the wrong shape.
    #[error("{0}")]
    Json(#[from] serde_json::Error),
    /// A number is NaN, infinite or too large.
    #[error("{name} is not finite")]
    NotFinite {
        /// The key.
        name: &'static str,
    },
    /// A number is outside of what a body can have.
    #[error("{name} is {got}, must be {must}")]
    Impossible {
        /// The key.
        name: &'static str,
        /// The value.
        got: f64,
        /// The condition.
        must: &'static str,
    },
}

/// The first bytes of a file that is no MCAP.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FirstBytes {
    bytes: [u8; 16],
    length: usize,
}

impl FirstBytes {
    pub(crate) fn new(start: &[u8]) -> Self {
        let mut bytes = [0; 16];
        let length = start.len().min(bytes.len());
        for (to, from) in bytes.iter_mut().zip(start) {
            *to = *from;
        }
        Self { bytes, length }
    }

    fn guess(&self) -> Option<&'static str> {
        let known: [(&[u8], &str); 5] = [
            (
                b"#ROSBAG",
                "a ROS 1 bag; convert it with `rosbags-convert --dst-storage mcap`",
            ),
            (
                b"SQLite format 3",
                "a rosbag2 SQLite file; convert it with `ros2 bag convert` to mcap",
            ),
            (b"\x89HDF\r\n", "an HDF5 file"),
            (b"RRF2", "a Rerun file"),
            (
                b"version https://",
                "a Git LFS pointer; fetch the file itself with `git lfs pull`",
            ),
        ];
        let start = self.bytes.get(..self.length).unwrap_or_default();
        known
            .iter()
            .find(|(magic, _)| start.starts_with(magic))
            .map(|(_, name)| *name)
    }
}

impl fmt::Display for FirstBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.bytes.get(..self.length) {
            None | Some([]) => return f.write_str("nothing (it is empty)"),
            Some(start) => write!(f, "\"{}\"", start.escape_ascii())?,
        }
        self.guess().map_or(Ok(()), |name| write!(f, " ({name})"))
    }
}

/// What a recording has instead of what is missing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicList {
    /// Topic, type (or encoding, when it has no type) and number of messages.
    pub topics: Vec<(String, String, u64)>,
    /// What is wrong with the file, if anything.
    pub damage: Option<String>,
}

impl fmt::Display for TopicList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.topics.is_empty() {
            f.write_str("it has no topics at all")?;
        } else {
            f.write_str("it has ")?;
        }
        for (index, (topic, kind, messages)) in self.topics.iter().enumerate() {
            let comma = if index == 0 { "" } else { ", " };
            write!(f, "{comma}{topic} ({kind}, {messages} messages)")?;
        }
        self.damage.as_ref().map_or(Ok(()), |damage| {
            write!(f, " (the file is damaged: {damage})")
        })
    }
}
