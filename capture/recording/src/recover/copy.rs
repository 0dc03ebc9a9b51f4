//! Records of a source on their way into a new recording.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;

use super::{LastMessage, Recovered, RecoveredTopic};
use crate::error::WriteError;
use crate::metadata;
use crate::reader::{
    Attachment, Channel, RawMessage, Record, RecordReader, Schema, UnknownChannels,
};
use crate::sequences::Sequences;
use crate::writer::file::{format_error, io_error};
use crate::writer::{LIBRARY, WriterOptions, mcap_options};

type Output = mcap::Writer<NoSeek<BufWriter<File>>>;

/// A recording on its way into another file.
pub(super) struct Copy {
    path: PathBuf,
    file: File,
    /// Made when the source's header is known.
    writer: Option<Output>,
    schemas: BTreeMap<u16, Schema>,
    channels: BTreeMap<u16, Source>,
    unknown: UnknownChannels,
    attachments: u64,
    last: Option<(u16, u32, i64)>,
    /// Whether one of our programs wrote it, ...
    ours: bool,
    /// ... from devices: what was made of another's recording has that one's numbers.
    has_session: bool,
}

/// A channel of the source.
struct Source {
    topic: String,
    sequences: Sequences,
    first_ns: i64,
    last_ns: i64,
}

impl Copy {
    pub(super) fn begin(path: &Path) -> Result<Self, WriteError> {
        let file = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(path);
        Ok(Self {
            path: path.to_owned(),
            file: file.map_err(|source| io_error("create", path, source))?,
            writer: None,
            schemas: BTreeMap::new(),
            channels: BTreeMap::new(),
            unknown: UnknownChannels::default(),
            attachments: 0,
            last: None,
            ours: false,
            has_session: false,
        })
    }

    pub(super) fn take(&mut self, record: Record<'_>) -> Result<(), WriteError> {
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
                self.has_session |= name == metadata::SESSION;
                self.write(|writer| {
                    writer.write_metadata(&Metadata {
                        name,
                        metadata: entries,
                    })
                })
            }
            _ => Ok(()),
        }
    }

    fn start(&self, profile: &str, library: &str) -> Result<Output, WriteError> {
        let clone = self.file.try_clone();
        let clone =
            clone.map_err(|source| io_error("duplicate the handle of", &self.path, source))?;
        mcap_options(&WriterOptions::default())
            .profile(profile)
            .library(library)
            .create(NoSeek::new(BufWriter::new(clone)))
            .map_err(|error| format_error(error, &self.path))
    }

    /// The writer, begun without a profile when the source's header is lost.
    fn write<T>(
        &mut self,
        call: impl FnOnce(&mut Output) -> Result<T, McapError>,
    ) -> Result<T, WriteError> {
        if self.writer.is_none() {
            self.writer = Some(self.start("", LIBRARY)?);
        }
        match &mut self.writer {
            Some(writer) => call(writer).map_err(|error| format_error(error, &self.path)),
            None => Err(WriteError::Stopped {
                path: self.path.clone(),
            }),
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
                writer.add_schema_with_id(
                    schema.id,
                    &schema.name,
                    &schema.encoding,
                    &schema.data,
                )?;
            }
            let Channel {
                id,
                schema_id,
                topic,
                message_encoding,
                metadata,
            } = channel;
            writer.add_channel_with_id(*id, *schema_id, topic, message_encoding, metadata)
        });
        match added {
            Err(WriteError::Format { .. }) => Ok(()),
            Err(error) => Err(error),
            Ok(_) => {
                let source = Source {
                    topic: channel.topic.clone(),
                    sequences: Sequences::default(),
                    first_ns: i64::MAX,
                    last_ns: i64::MIN,
                };
                self.channels.insert(channel.id, source);
                Ok(())
            }
        }
    }

    fn add_message(&mut self, message: RawMessage<'_>) -> Result<(), WriteError> {
        let RawMessage {
            channel_id,
            sequence,
            log_time,
            publish_time,
            data,
        } = message;
        let Some(source) = self.channels.get_mut(&channel_id) else {
            self.unknown.add(channel_id);
            return Ok(());
        };
        let publish_ns = i64::try_from(publish_time).unwrap_or(i64::MAX);
        source.sequences.add(sequence);
        source.first_ns = source.first_ns.min(publish_ns);
        source.last_ns = source.last_ns.max(publish_ns);
        self.last = Some((
            channel_id,
            sequence,
            i64::try_from(log_time).unwrap_or(i64::MAX),
        ));
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time,
        };
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

    pub(super) fn report<R: io::Read + io::Seek>(
        &self,
        source: &Path,
        out: &Path,
        reader: &RecordReader<R>,
    ) -> Recovered {
        let first = u32::from(self.ours && self.has_session);
        let mut topics: BTreeMap<String, RecoveredTopic> = BTreeMap::new();
        for source in self.channels.values() {
            let topic = topics.entry(source.topic.clone()).or_default();
            topic.messages += source.sequences.messages();
            topic.missing_sequences += source.sequences.missing(first);
            if source.sequences.messages() > 0 {
                topic.first_ns = Some(
                    topic
                        .first_ns
                        .map_or(source.first_ns, |first| first.min(source.first_ns)),
                );
                topic.last_ns = topic.last_ns.max(Some(source.last_ns));
            }
        }
        let last_message = self.last.and_then(|(channel_id, sequence, log_time_ns)| {
            let topic = self.channels.get(&channel_id)?.topic.clone();
            Some(LastMessage {
                topic,
                sequence,
                log_time_ns,
            })
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
            damage: self.unknown.behind(reader.damage()).collect(),
        }
    }

    pub(super) fn finish(&mut self, recovered: &Recovered) -> Result<(), WriteError> {
        let name = recovered
            .source
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        let entries = BTreeMap::from([
            ("source".to_owned(), name.into_owned()),
            (
                "was_complete".to_owned(),
                recovered.was_complete.to_string(),
            ),
            (
                "unread_bytes".to_owned(),
                recovered.unread_bytes.to_string(),
            ),
            ("damage".to_owned(), recovered.damage.join("\n")),
        ]);
        let record = Metadata {
            name: metadata::RECOVERED.to_owned(),
            metadata: entries,
        };
        self.write(|writer| {
            writer.write_metadata(&record)?;
            writer.finish()
        })?;
        self.writer = None;
        self.file
            .sync_all()
            .map_err(|source| io_error("sync", &self.path, source))
    }
}
