//! Makes a complete recording of what a crash left.
//!
//! Everything that [`RecordReader`] gives is written to a new file with index and summary: channels with their numbers,
//! messages with their sequences and stamps, attachments, metadata. What was found goes into the metadata record
//! `ft.recovered` too.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, TryLockError};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use ft_wire::HostTime;
use serde::Serialize;

pub use crate::error::ReadError;
use crate::error::WriteError;
use crate::reader::{RecordReader, open_regular};
use crate::writer::file::io_error;

mod copy;

use copy::Copy;

/// What was given back, and what is gone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recovered {
    /// The new recording.
    pub path: PathBuf,
    /// What it was made from.
    pub source: PathBuf,
    /// By topic.
    pub topics: BTreeMap<String, RecoveredTopic>,
    /// Attachments given back.
    pub attachments: u64,
    /// Size of the source, bytes.
    pub source_bytes: u64,
    /// Bytes at the end of the source behind its last whole record.
    pub unread_bytes: u64,
    /// The last message given back.
    pub last_message: Option<LastMessage>,
    /// When the source was last written to, ns since the Unix epoch, by the system's clock: what came later than one
    /// flush period before is lost. A copied file may say when it was copied.
    pub source_modified_ns: Option<i64>,
    /// Whether the source was a finished recording.
    pub was_complete: bool,
    /// What is wrong with the source, one line each.
    pub damage: Vec<String>,
}

/// What was given back of one topic.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RecoveredTopic {
    /// Messages.
    pub messages: u64,
    /// Earliest publish time, ns since the Unix epoch.
    pub first_ns: Option<i64>,
    /// Latest publish time, ns since the Unix epoch.
    pub last_ns: Option<i64>,
    /// Sequence numbers that are missing before or between the messages given back.
    pub missing_sequences: u64,
}

/// Behind it, nothing is known.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LastMessage {
    /// Its topic.
    pub topic: String,
    /// Its number on its channel.
    pub sequence: u32,
    /// When it was recorded, ns since the Unix epoch.
    pub log_time_ns: i64,
}

impl Recovered {
    /// Whether something that was recorded may be missing: the source was not finished, or is damaged.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        !self.was_complete || !self.damage.is_empty()
    }
}

/// What the metadata `ft.recovered` says is missing in the recording that has it.
pub(crate) fn loss_before_recovery(entries: &BTreeMap<String, String>) -> Option<String> {
    let entry = |key| entries.get(key).map_or("", String::as_str);
    let damage = entry("damage").lines().next().unwrap_or_default();
    let whole = entry("was_complete") == "true" && damage.is_empty();
    let source = entry("source");
    (!whole).then(|| format!("recovered from {source}, which was not whole: {damage}"))
}

/// Writes a complete recording `out` of what can be read of `source`, which stays as it is.
///
/// # Errors
/// When `source` cannot be read, is no MCAP or is still being written; when `out` exists and `overwrite` is not set, or
/// cannot be written.
pub fn recover(source: &Path, out: &Path, overwrite: bool) -> Result<Recovered, ReadError> {
    let modified = refuse_busy(source)?;
    if same_file(source, out) {
        return Err(WriteError::Exists {
            path: out.to_owned(),
        }
        .into());
    }
    if !overwrite && out.exists() {
        return Err(WriteError::Exists {
            path: out.to_owned(),
        }
        .into());
    }
    let mut reader = RecordReader::open(source)?;
    let temporary = temporary_path(out);
    let mut copy = Copy::begin(&temporary)?;
    let result = loop {
        match reader.next_record() {
            Ok(Some(record)) => {
                if let Err(error) = copy.take(record) {
                    break Err(error.into());
                }
            }
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    let recovered = result.and_then(|()| {
        let mut recovered = copy.report(source, out, &reader);
        recovered.source_modified_ns = modified;
        copy.finish(&recovered)?;
        fs::rename(&temporary, out)
            .map_err(|source| io_error("give the final name to", &temporary, source))?;
        Ok(recovered)
    });
    recovered.map_err(|error| {
        // Half a copy is of no use, and the source is still there.
        let _ = fs::remove_file(&temporary);
        match error {
            ReadError::Write(WriteError::NoSpace { .. }) => ReadError::NoRoom {
                path: source.to_owned(),
                out: out.to_owned(),
                needed_bytes: reader.length(),
            },
            error => error,
        }
    })
}

/// Whether both names lead to one file: the source is never replaced, not even when overwriting is allowed.
pub(crate) fn same_file(source: &Path, out: &Path) -> bool {
    matches!((fs::canonicalize(source), fs::canonicalize(out)), (Ok(a), Ok(b)) if a == b)
}

/// Refuses a recording that is being written; gives its modification time.
fn refuse_busy(source: &Path) -> Result<Option<i64>, ReadError> {
    let (file, _) = open_regular(source)?;
    if let Err(TryLockError::WouldBlock) = file.try_lock_shared() {
        return Err(ReadError::Busy {
            path: source.to_owned(),
        });
    }
    let modified = file
        .metadata()
        .and_then(|metadata| metadata.modified())
        .ok();
    let since = modified.and_then(|modified| modified.duration_since(UNIX_EPOCH).ok());
    Ok(since.and_then(|since| i64::try_from(since.as_nanos()).ok()))
}

fn temporary_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".recovering");
    PathBuf::from(name)
}

impl fmt::Display for Recovered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let messages: u64 = self.topics.values().map(|topic| topic.messages).sum();
        writeln!(
            f,
            "{}: {messages} messages given back to {}",
            self.source.display(),
            self.path.display()
        )?;
        for (topic, found) in &self.topics {
            write!(f, "  {topic}: {} messages", found.messages)?;
            if let (Some(first), Some(last)) = (found.first_ns, found.last_ns) {
                let [first, last] = [first, last].map(HostTime::from_nanos);
                write!(
                    f,
                    ", from {first} to {last} ({:.3} s)",
                    last.seconds_since(first)
                )?;
            }
            match found.missing_sequences {
                0 => writeln!(f, ", none missing inside")?,
                missing => writeln!(f, ", {missing} MISSING inside")?,
            }
        }
        for line in &self.damage {
            writeln!(f, "  {line}")?;
        }
        match &self.last_message {
            _ if !self.lost_data() => f.write_str("  the source was complete: nothing is lost"),
            None => f.write_str("  no message could be read"),
            Some(LastMessage {
                topic,
                sequence,
                log_time_ns,
            }) => {
                let at = HostTime::from_nanos(*log_time_ns);
                write!(
                    f,
                    "  last message: {topic} number {sequence} at {at}; nothing is known after it"
                )?;
                let modified = self.source_modified_ns.map(HostTime::from_nanos);
                modified.map_or(Ok(()), |at| {
                    write!(f, " (the source was last written to at {at})")
                })
            }
        }
    }
}
