//! Makes a complete recording of what a crash left.
//!
//! Everything that [`RecordReader`] gives is written to a new file with index and summary: channels with their numbers,
//! messages with their sequences and stamps, attachments, metadata. What was found goes into the metadata record
//! `ft.recovered` too.

use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use ft_wire::HostTime;
use mcap::McapError;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use serde::Serialize;

pub use crate::error::ReadError;
use crate::error::WriteError;
use crate::metadata;
use crate::reader::{Attachment, Channel, RawMessage, Record, RecordReader, Schema};
use crate::sequences::Sequences;
use crate::writer::{LIBRARY, WriterOptions, format_error, io_error, mcap_options};

type Output = mcap::Writer<NoSeek<BufWriter<File>>>;

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

/// Writes a complete recording `out` of what can be read of `source`, which stays as it is.
///
/// # Errors
/// When `source` cannot be read, is no MCAP or is still being written; when `out` exists and `overwrite` is not set, or
/// cannot be written.
pub fn recover(source: &Path, out: &Path, overwrite: bool) -> Result<Recovered, ReadError> {
    let modified = refuse_busy(source)?;
    if !overwrite && out.exists() {
        return Err(WriteError::Exists { path: out.to_owned() }.into());
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
        fs::rename(&temporary, out).map_err(|source| io_error("give the final name to", &temporary, source))?;
        Ok(recovered)
    });
    if recovered.is_err() {
        // Half a copy is of no use, and the source is still there.
        let _ = fs::remove_file(&temporary);
    }
    recovered
}

/// Refuses a recording that is being written; gives its modification time.
fn refuse_busy(source: &Path) -> Result<Option<i64>, ReadError> {
    let io = |call| move |error| ReadError::Io { call, path: source.to_owned(), source: error };
    let file = File::open(source).map_err(io("open"))?;
    if let Err(TryLockError::WouldBlock) = file.try_lock_shared() {
        return Err(ReadError::Busy { path: source.to_owned() });
    }
    let modified = file.metadata().and_then(|metadata| metadata.modified()).ok();
    let since = modified.and_then(|modified| modified.duration_since(UNIX_EPOCH).ok());
    Ok(since.and_then(|since| i64::try_from(since.as_nanos()).ok()))
}

fn temporary_path(out: &Path) -> PathBuf {
    let mut name = out.as_os_str().to_owned();
    name.push(".recovering");
    PathBuf::from(name)
}

/// A recording on its way into another file.
struct Copy {
    path: PathBuf,
    file: File,
    /// Made when the source's header is known.
    writer: Option<Output>,
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Source>,
    left_out: BTreeMap<u16, u64>,
    attachments: u64,
    last: Option<(u16, u32, i64)>,
    ours: bool,
}

/// A channel of the source.
struct Source {
    topic: String,
    sequences: Sequences,
    first_ns: i64,
    last_ns: i64,
}

impl Copy {
    fn begin(path: &Path) -> Result<Self, WriteError> {
        let file = OpenOptions::new().write(true).create(true).truncate(true).open(path);
        Ok(Self {
            path: path.to_owned(),
            file: file.map_err(|source| io_error("create", path, source))?,
            writer: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            left_out: BTreeMap::new(),
            attachments: 0,
            last: None,
            ours: false,
        })
    }

    fn take(&mut self, record: Record<'_>) -> Result<(), WriteError> {
        match record {
            Record::Header { profile, library } if self.writer.is_none() => {
                self.ours = library.starts_with("ft-capture ");
                let library = format!("{LIBRARY} (recovered; written by {library})");
                self.writer = Some(self.start(&profile, &library)?);
                Ok(())
            }
            Record::Schema(schema) => {
                self.schemas.entry(schema.id).or_insert(schema);
                Ok(())
            }
            Record::Channel(channel) => self.add_channel(&channel),
            Record::Message(message) => self.add_message(message),
            Record::Attachment(attachment) => self.add_attachment(attachment),
            Record::Metadata { name, entries } => {
                self.write(|writer| writer.write_metadata(&Metadata { name, metadata: entries }))
            }
            _ => Ok(()),
        }
    }

    fn start(&self, profile: &str, library: &str) -> Result<Output, WriteError> {
        let clone = self.file.try_clone();
        let clone = clone.map_err(|source| io_error("duplicate the handle of", &self.path, source))?;
        mcap_options(&WriterOptions::default())
            .profile(profile)
            .library(library)
            .create(NoSeek::new(BufWriter::new(clone)))
            .map_err(|error| format_error(error, &self.path))
    }

    /// The writer, begun without a profile when the source's header is lost.
    fn write<T>(&mut self, call: impl FnOnce(&mut Output) -> Result<T, McapError>) -> Result<T, WriteError> {
        if self.writer.is_none() {
            self.writer = Some(self.start("", LIBRARY)?);
        }
        match &mut self.writer {
            Some(writer) => call(writer).map_err(|error| format_error(error, &self.path)),
            None => Err(WriteError::Stopped { path: self.path.clone() }),
        }
    }

    /// Adds a channel, unless it or its schema contradicts what is known; its messages are left out then.
    fn add_channel(&mut self, channel: &Channel) -> Result<(), WriteError> {
        if self.channels.contains_key(&channel.id) {
            return Ok(());
        }
        let schema = self.schemas.get(&channel.schema_id).cloned();
        let added = self.write(|writer| {
            if let Some(schema) = schema {
                writer.add_schema_with_id(schema.id, &schema.name, &schema.encoding, &schema.data)?;
            }
            let Channel { id, schema_id, topic, message_encoding, metadata } = channel;
            writer.add_channel_with_id(*id, *schema_id, topic, message_encoding, metadata)
        });
        match added {
            Err(WriteError::Format { .. }) => Ok(()),
            Err(error) => Err(error),
            Ok(_) => {
                let first = u32::from(self.ours);
                let source = Source {
                    topic: channel.topic.clone(),
                    sequences: Sequences::starting_at(first),
                    first_ns: i64::MAX,
                    last_ns: i64::MIN,
                };
                self.channels.insert(channel.id, source);
                Ok(())
            }
        }
    }

    fn add_message(&mut self, message: RawMessage<'_>) -> Result<(), WriteError> {
        let RawMessage { channel_id, sequence, log_time, publish_time, data } = message;
        let Some(source) = self.channels.get_mut(&channel_id) else {
            *self.left_out.entry(channel_id).or_default() += 1;
            return Ok(());
        };
        let publish_ns = i64::try_from(publish_time).unwrap_or(i64::MAX);
        source.sequences.add(sequence);
        source.first_ns = source.first_ns.min(publish_ns);
        source.last_ns = source.last_ns.max(publish_ns);
        self.last = Some((channel_id, sequence, i64::try_from(log_time).unwrap_or(i64::MAX)));
        let header = MessageHeader { channel_id, sequence, log_time, publish_time };
        self.write(|writer| writer.write_to_known_channel(&header, data))
    }

    fn add_attachment(&mut self, attachment: Attachment<'_>) -> Result<(), WriteError> {
        self.attachments += 1;
        let copy = mcap::Attachment {
            log_time: attachment.log_time,
            create_time: attachment.create_time,
            name: attachment.name.to_owned(),
            media_type: attachment.media_type.to_owned(),
            data: attachment.data.into(),
        };
        self.write(|writer| writer.attach(&copy))
    }

    fn report<R: io::Read + io::Seek>(&self, source: &Path, out: &Path, reader: &RecordReader<R>) -> Recovered {
        let mut topics: BTreeMap<String, RecoveredTopic> = BTreeMap::new();
        for source in self.channels.values() {
            let topic = topics.entry(source.topic.clone()).or_default();
            topic.messages += source.sequences.messages();
            topic.missing_sequences += source.sequences.missing();
            if source.sequences.messages() > 0 {
                topic.first_ns = Some(topic.first_ns.map_or(source.first_ns, |first| first.min(source.first_ns)));
                topic.last_ns = topic.last_ns.max(Some(source.last_ns));
            }
        }
        let last_message = self.last.and_then(|(channel_id, sequence, log_time_ns)| {
            let topic = self.channels.get(&channel_id)?.topic.clone();
            Some(LastMessage { topic, sequence, log_time_ns })
        });
        let left_out = self.left_out.iter().map(|(channel_id, messages)| {
            format!("{messages} messages of channel {channel_id}, which is not described, are left out")
        });
        Recovered {
            path: out.to_owned(),
            source: source.to_owned(),
            topics,
            attachments: self.attachments,
            source_bytes: reader.length(),
            unread_bytes: reader.length().saturating_sub(reader.good_end()),
            last_message,
            source_modified_ns: None,
            was_complete: reader.is_complete(),
            damage: reader.damage().iter().map(ToString::to_string).chain(left_out).collect(),
        }
    }

    fn finish(&mut self, recovered: &Recovered) -> Result<(), WriteError> {
        let name = recovered.source.file_name().unwrap_or_default().to_string_lossy();
        let entries = BTreeMap::from([
            ("source".to_owned(), name.into_owned()),
            ("was_complete".to_owned(), recovered.was_complete.to_string()),
            ("unread_bytes".to_owned(), recovered.unread_bytes.to_string()),
            ("damage".to_owned(), recovered.damage.join("\n")),
        ]);
        let record = Metadata { name: metadata::RECOVERED.to_owned(), metadata: entries };
        self.write(|writer| {
            writer.write_metadata(&record)?;
            writer.finish()
        })?;
        self.writer = None;
        self.file.sync_all().map_err(|source| io_error("sync", &self.path, source))
    }
}

impl fmt::Display for Recovered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let messages: u64 = self.topics.values().map(|topic| topic.messages).sum();
        writeln!(f, "{}: {messages} messages given back to {}", self.source.display(), self.path.display())?;
        for (topic, found) in &self.topics {
            write!(f, "  {topic}: {} messages", found.messages)?;
            if let (Some(first), Some(last)) = (found.first_ns, found.last_ns) {
                let [first, last] = [first, last].map(HostTime::from_nanos);
                write!(f, ", from {first} to {last} ({:.3} s)", last.seconds_since(first))?;
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
            Some(LastMessage { topic, sequence, log_time_ns }) => {
                let at = HostTime::from_nanos(*log_time_ns);
                write!(f, "  last message: {topic} number {sequence} at {at}; nothing is known after it")?;
                let modified = self.source_modified_ns.map(HostTime::from_nanos);
                modified.map_or(Ok(()), |at| write!(f, " (the source was last written to at {at})"))
            }
        }
    }
}
