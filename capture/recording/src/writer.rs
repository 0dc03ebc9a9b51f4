//! Writes a recording that a crash cannot take back.
//!
//! Chunks are built in memory and reach the file whole, every [`WriterOptions::flush_period`]; so whatever ends the
//! process, every reader gets all messages up to the last flush. (The usual way, writing through and patching the chunk's
//! header afterwards, loses the open chunk and stops some readers.) The file is called `PATH.partial` until
//! [`RecordingWriter::finish`].
//!
//! It does not protect against power loss by itself: call `sync_data` on [`RecordingWriter::sync_handle`] from another
//! thread every second or two.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ft_wire::HostTime;
use mcap::McapError;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;

pub use crate::error::WriteError;
use crate::message::Message;
use crate::qos::Qos;
use crate::reader::{self, Attachment, Schema};

pub(crate) mod file;

pub use file::partial_path;
use file::{Counted, format_error, io_error, open, sync_directory};

/// What `Header.library` of a recording says.
pub(crate) const LIBRARY: &str = concat!("ft-capture ", env!("CARGO_PKG_VERSION"));
/// Message encoding of the raw channels.
pub(crate) const RAW_ENCODING: &str = "application/octet-stream";

type McapWriter = mcap::Writer<NoSeek<BufWriter<Counted>>>;

/// How chunks are packed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// As they are.
    None,
    /// Zstandard, on the calling thread.
    #[default]
    Zstd,
}

/// How to write a recording.
#[derive(Clone, Debug)]
pub struct WriterOptions {
    /// Replace an existing recording, or the leftover of one.
    pub overwrite: bool,
    /// How chunks are packed.
    pub compression: Compression,
    /// A message is in the file at the latest this long after it was written, as long as
    /// [`RecordingWriter::flush_if_due`] is called.
    pub flush_period: Duration,
    /// A chunk is closed early when it holds more than this, bytes before compression.
    pub chunk_bytes: u64,
}

impl Default for WriterOptions {
    /// Zstandard, 100 ms, 1 MiB, no overwriting.
    fn default() -> Self {
        Self {
            overwrite: false,
            compression: Compression::Zstd,
            flush_period: Duration::from_millis(100),
            chunk_bytes: 1 << 20,
        }
    }
}

/// A channel of the recording that gave it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ChannelId(u16);

/// When a message came and when its content was true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageStamps {
    /// Arrival at the host. Players and viewers order by it.
    pub log_time: HostTime,
    /// Sample time, the same as `header.stamp`; `log_time` when there is none.
    pub publish_time: HostTime,
}

/// A recording that is complete.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finished {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Messages by topic.
    pub messages: BTreeMap<String, u64>,
}

#[derive(Debug)]
struct Channel {
    id: u16,
    topic: String,
    sequence: u32,
    messages: u64,
}

/// Writes one recording. Give it its own thread: a write to disk may take tens of milliseconds.
///
/// Dropping it without [`Self::finish`] keeps the data under the name `PATH.partial`.
pub struct RecordingWriter {
    writer: Option<McapWriter>,
    file: File,
    bytes: Arc<AtomicU64>,
    path: PathBuf,
    partial: PathBuf,
    options: WriterOptions,
    channels: Vec<Channel>,
    last_flush: Option<HostTime>,
    pending: bool,
}

impl std::fmt::Debug for RecordingWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RecordingWriter")
            .field("partial", &self.partial)
            .field("channels", &self.channels)
            .field("bytes", &self.bytes)
            .finish_non_exhaustive()
    }
}

impl RecordingWriter {
    /// Begins a recording that will be `path`; until it is finished it is `path` with `.partial` behind.
    ///
    /// # Errors
    /// When either file exists and `options.overwrite` is not set, another process is writing it, or the file cannot be
    /// created.
    pub fn create(path: &Path, options: &WriterOptions) -> Result<Self, WriteError> {
        let partial = partial_path(path);
        if path.is_dir() {
            return Err(WriteError::Folder {
                path: path.to_owned(),
            });
        }
        if !options.overwrite && path.exists() {
            return Err(WriteError::Exists {
                path: path.to_owned(),
            });
        }
        let file = open(&partial, options.overwrite)?;
        let bytes = Arc::new(AtomicU64::new(0));
        let writer = begin(&file, &bytes, &partial, options).map_err(|error| {
            // Nothing is in it yet. What cannot be removed is a leftover like any other.
            let _ = fs::remove_file(&partial);
            error.of_nothing(path)
        })?;
        Ok(Self {
            writer: Some(writer),
            file,
            bytes,
            path: path.to_owned(),
            partial,
            options: options.clone(),
            channels: Vec::new(),
            last_flush: None,
            pending: false,
        })
    }

    /// Adds the topic of the messages `M`.
    ///
    /// # Errors
    /// When the topic has a channel already, or on any error of [`Self::write`].
    pub fn add_channel<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
    ) -> Result<ChannelId, WriteError> {
        self.refuse_duplicate(topic)?;
        let metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), qos.to_yaml()),
            ("topic_type_hash".to_owned(), M::TYPE_HASH.to_owned()),
        ]);
        let id = self.attempt(|writer| {
            let schema = writer.add_schema(M::TYPE_NAME, "ros2msg", M::DEFINITION.as_bytes())?;
            writer.add_channel(schema, topic, "cdr", &metadata)
        })?;
        self.remember(id, topic)
    }

    /// Adds a topic of bytes as they came from a device: no schema, encoding `application/octet-stream`.
    ///
    /// # Errors
    /// When the topic has a channel already, or on any error of [`Self::write`].
    pub fn add_raw_channel(&mut self, topic: &str) -> Result<ChannelId, WriteError> {
        self.refuse_duplicate(topic)?;
        let id =
            self.attempt(|writer| writer.add_channel(0, topic, RAW_ENCODING, &BTreeMap::new()))?;
        self.remember(id, topic)
    }

    /// Adds a channel as another recording has it; several may share a topic.
    pub(crate) fn add_channel_of(
        &mut self,
        channel: &reader::Channel,
        schema: Option<&Schema>,
    ) -> Result<ChannelId, WriteError> {
        let id = self.attempt(|writer| {
            let schema = match schema {
                Some(schema) => writer.add_schema(&schema.name, &schema.encoding, &schema.data)?,
                None => 0,
            };
            let (topic, encoding) = (&channel.topic, &channel.message_encoding);
            writer.add_channel(schema, topic, encoding, &channel.metadata)
        })?;
        self.remember(id, &channel.topic)
    }

    /// Adds an attachment as another recording has it.
    pub(crate) fn attach(&mut self, attachment: &Attachment<'_>) -> Result<(), WriteError> {
        let copy = mcap::Attachment {
            log_time: attachment.log_time,
            create_time: attachment.create_time,
            name: attachment.name.to_owned(),
            media_type: attachment.media_type.to_owned(),
            data: attachment.data.into(),
        };
        self.attempt(|writer| writer.attach(&copy))
    }

    /// Writes one message; its `sequence` is the channel's own counter, from 1. Messages stand in the file in the order
    /// in which they are given, so give them by `log_time`.
    ///
    /// # Errors
    /// When the channel is not of this recording, an instant lies before 1970, the disk is full or fails, or an earlier
    /// error has ended the recording.
    pub fn write(
        &mut self,
        channel: ChannelId,
        stamps: MessageStamps,
        payload: &[u8],
    ) -> Result<(), WriteError> {
        let last = self.channels.get(usize::from(channel.0));
        let sequence = last.map_or(0, |last| last.sequence).wrapping_add(1);
        self.write_numbered(channel, sequence, stamps, payload)
    }

    /// As [`Self::write`], with the number that another recording gave.
    pub(crate) fn write_numbered(
        &mut self,
        channel: ChannelId,
        sequence: u32,
        stamps: MessageStamps,
        payload: &[u8],
    ) -> Result<(), WriteError> {
        let log_time = unix_nanos(stamps.log_time)?;
        let publish_time = unix_nanos(stamps.publish_time)?;
        let channels = self.channels.len();
        let entry =
            self.channels
                .get_mut(usize::from(channel.0))
                .ok_or(WriteError::UnknownChannel {
                    channel: channel.0,
                    channels,
                })?;
        let header = MessageHeader {
            channel_id: entry.id,
            sequence,
            log_time,
            publish_time,
        };
        let Some(writer) = &mut self.writer else {
            return Err(WriteError::Stopped {
                path: self.partial.clone(),
            });
        };
        if let Err(error) = writer.write_to_known_channel(&header, payload) {
            return Err(self.stop(error));
        }
        entry.sequence = sequence;
        entry.messages += 1;
        self.pending = true;
        Ok(())
    }

    /// Puts everything written into the file when [`WriterOptions::flush_period`] has passed since that was last done.
    /// Call it often, with or without new messages; `now` is on the clock of the stamps.
    ///
    /// # Errors
    /// When the disk is full or fails, or an earlier error has ended the recording.
    pub fn flush_if_due(&mut self, now: HostTime) -> Result<(), WriteError> {
        let last_flush = *self.last_flush.get_or_insert(now);
        if !self.pending {
            self.last_flush = Some(now);
        } else if now.saturating_since(last_flush) >= self.options.flush_period {
            self.attempt(McapWriter::flush)?;
            self.pending = false;
            self.last_flush = Some(now);
        }
        Ok(())
    }

    /// Writes a metadata record and flushes. Readers take the last one of a name.
    ///
    /// # Errors
    /// When the disk is full or fails, or an earlier error has ended the recording.
    pub fn write_metadata(
        &mut self,
        name: &str,
        entries: &BTreeMap<String, String>,
    ) -> Result<(), WriteError> {
        let record = Metadata {
            name: name.to_owned(),
            metadata: entries.clone(),
        };
        self.attempt(|writer| {
            writer.write_metadata(&record)?;
            writer.flush()
        })?;
        self.pending = false;
        Ok(())
    }

    /// A handle for `sync_data` from another thread.
    ///
    /// # Errors
    /// When the process has no more file descriptors.
    pub fn sync_handle(&self) -> Result<File, WriteError> {
        let clone = self.file.try_clone();
        clone.map_err(|source| io_error("duplicate the handle of", &self.partial, source))
    }

    /// Bytes given to the operating system so far.
    #[must_use]
    pub fn bytes_written(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Writes index and summary, waits until all is on the disk, and gives the file its final name.
    ///
    /// # Errors
    /// When the disk is full or fails, an earlier error has ended the recording, or the final name was taken in the
    /// meantime. The data stay in `PATH.partial`.
    pub fn finish(mut self) -> Result<Finished, WriteError> {
        self.attempt(|writer| writer.finish().map(drop))?;
        self.writer = None;
        self.file
            .sync_all()
            .map_err(|source| io_error("sync", &self.partial, source))?;
        if !self.options.overwrite && self.path.exists() {
            return Err(WriteError::Exists {
                path: self.path.clone(),
            });
        }
        fs::rename(&self.partial, &self.path)
            .map_err(|source| io_error("give the final name to", &self.partial, source))?;
        sync_directory(&self.path);
        let messages = self
            .channels
            .iter()
            .map(|channel| (channel.topic.clone(), channel.messages));
        Ok(Finished {
            path: self.path.clone(),
            bytes: self.bytes_written(),
            messages: messages.collect(),
        })
    }

    /// [`Self::finish`] for what can be made again: what cannot be finished is removed.
    pub(crate) fn finish_or_discard(self) -> Result<Finished, WriteError> {
        let (partial, path) = (self.partial.clone(), self.path.clone());
        self.finish().map_err(|error| {
            let _ = fs::remove_file(partial);
            error.of_nothing(&path)
        })
    }

    /// Takes the file back, as if it had never been begun.
    pub(crate) fn discard(self) {
        let partial = self.partial.clone();
        drop(self);
        // What cannot be removed is a leftover like any other.
        let _ = fs::remove_file(partial);
    }

    fn refuse_duplicate(&self, topic: &str) -> Result<(), WriteError> {
        match self.channels.iter().any(|channel| channel.topic == topic) {
            true => Err(WriteError::DuplicateTopic {
                topic: topic.to_owned(),
            }),
            false => Ok(()),
        }
    }

    fn remember(&mut self, id: u16, topic: &str) -> Result<ChannelId, WriteError> {
        let index = u16::try_from(self.channels.len());
        let index = index.map_err(|_| format_error(McapError::TooManyChannels, &self.partial))?;
        self.channels.push(Channel {
            id,
            topic: topic.to_owned(),
            sequence: 0,
            messages: 0,
        });
        self.pending = true;
        Ok(ChannelId(index))
    }

    fn attempt<T>(
        &mut self,
        call: impl FnOnce(&mut McapWriter) -> Result<T, McapError>,
    ) -> Result<T, WriteError> {
        let Some(writer) = &mut self.writer else {
            return Err(WriteError::Stopped {
                path: self.partial.clone(),
            });
        };
        call(writer).map_err(|error| self.stop(error))
    }

    /// Lets go of the writer, so that nothing is written behind a torn record.
    fn stop(&mut self, error: McapError) -> WriteError {
        if let Some(writer) = self.writer.take() {
            let (_file, _unwritten) = writer.into_inner().into_inner().into_parts();
        }
        format_error(error, &self.partial)
    }
}

/// Writes the file's header, to see that the disk takes it.
fn begin(
    file: &File,
    bytes: &Arc<AtomicU64>,
    partial: &Path,
    options: &WriterOptions,
) -> Result<McapWriter, WriteError> {
    let clone = file
        .try_clone()
        .map_err(|source| io_error("duplicate the handle of", partial, source))?;
    let sink = NoSeek::new(BufWriter::new(Counted {
        file: clone,
        bytes: Arc::clone(bytes),
    }));
    let mut writer = mcap_options(options)
        .profile("ros2")
        .library(LIBRARY)
        .create(sink)
        .map_err(|error| format_error(error, partial))?;
    writer
        .flush()
        .map_err(|error| format_error(error, partial))?;
    Ok(writer)
}

/// Options of the `mcap` crate for files that are never patched afterwards.
pub(crate) fn mcap_options(options: &WriterOptions) -> mcap::WriteOptions {
    let compression = match options.compression {
        Compression::None => None,
        Compression::Zstd => Some(mcap::Compression::Zstd),
    };
    mcap::WriteOptions::new()
        .compression(compression)
        .compression_threads(0)
        .chunk_size(Some(options.chunk_bytes))
        .disable_seeking(true)
}

fn unix_nanos(at: HostTime) -> Result<u64, WriteError> {
    u64::try_from(at.as_nanos()).map_err(|_| WriteError::BeforeEpoch {
        nanos: at.as_nanos(),
    })
}
