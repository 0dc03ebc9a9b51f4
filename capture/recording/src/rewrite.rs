//! Writes a recording anew with topics added, left out or stamped otherwise; the source stays as it is.
//!
//! Messages keep their order, numbers, `log_time` (unless a new stamp is later) and bytes; those that are added come in between by their `log_time`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use ft_wire::HostTime;

mod frames;

use frames::{Changes, Wanted};

pub use crate::error::ReadError;
use crate::message::{Imu, JointState, Message, PoseStamped, Temperature, Time, WrenchStamped};
use crate::qos::Qos;
use crate::reader::{RawMessage, Record, RecordReader, Schema};
use crate::recording::{Pose7, TopicMap};
use crate::topic;
use crate::writer::{ChannelId, Finished, MessageStamps, RecordingWriter, WriterOptions};

/// Gives a message its new stamp from its topic, its stamp and its arrival.
type Restamp<'a> = Box<dyn FnMut(&str, HostTime, HostTime) -> HostTime + 'a>;

/// What a new recording has that its source has not, and the other way round.
#[derive(Default)]
pub struct Rewrite<'a> {
    left_out: BTreeSet<String>,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    added: Vec<Added>,
    restamp: Option<Restamp<'a>>,
    frames: Wanted,
}

impl std::fmt::Debug for Rewrite<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Rewrite")
            .field("left_out", &self.left_out)
            .field("metadata", &self.metadata)
            .field("added", &self.added.len())
            .finish_non_exhaustive()
    }
}

/// A topic on its way in.
struct Added {
    open: fn(&mut RecordingWriter, &str, Qos) -> Result<ChannelId, crate::WriteError>,
    topic: String,
    qos: Qos,
    messages: Vec<(MessageStamps, Vec<u8>)>,
}

impl<'a> Rewrite<'a> {
    /// Changes nothing yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Leaves a topic of the source out.
    pub fn leave_out(&mut self, topic: &str) -> &mut Self {
        self.left_out.insert(topic.to_owned());
        self
    }

    /// Adds a metadata record, in place of one of that name.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> &mut Self {
        self.metadata.insert(name.to_owned(), entries);
        self
    }

    /// Adds a topic, in place of one of that name. Messages may come in any order.
    pub fn add<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
        messages: impl IntoIterator<Item = (MessageStamps, M)>,
    ) -> &mut Self {
        let encoded = |(stamps, message): (MessageStamps, M)| {
            let mut bytes = Vec::new();
            message.encode(&mut bytes);
            (stamps, bytes)
        };
        let mut messages: Vec<_> = messages.into_iter().map(encoded).collect();
        messages.sort_by_key(|(stamps, _)| stamps.log_time);
        self.left_out.insert(topic.to_owned());
        self.added.push(Added {
            open: |writer, topic, qos| writer.add_channel::<M>(topic, qos),
            topic: topic.to_owned(),
            qos,
            messages,
        });
        self
    }

    /// Puts `frame` at `base_from_frame` in the source's static transforms (`/tf_static`, or what `map` calls so): only the transform of
    /// the chain between them that leads to `frame` is changed, in the direction in which it stands; one is added, stamped `at`, when no
    /// chain joins them.
    pub fn set_frame(
        &mut self,
        base: &str,
        frame: &str,
        base_from_frame: Pose7,
        map: &TopicMap,
        at: HostTime,
    ) -> &mut Self {
        let names = (base.to_owned(), frame.to_owned());
        self.frames.frames.push((names.0, names.1, base_from_frame));
        (self.frames.map, self.frames.at) = (map.clone(), at);
        self
    }

    /// Stamps messages of the types that have a stamp with what `stamp` makes of (topic, stamp, arrival).
    pub fn restamp(
        &mut self,
        stamp: impl FnMut(&str, HostTime, HostTime) -> HostTime + 'a,
    ) -> &mut Self {
        self.restamp = Some(Box::new(stamp));
        self
    }

    /// Writes `out` from `source`, or from what was added alone.
    ///
    /// # Errors
    /// When the source cannot be read, is no MCAP or is damaged ([`recover`](crate::recover::recover) it first), and when
    /// `out` exists and `overwrite` is not set, is the source, or cannot be written.
    pub fn write(
        mut self,
        source: Option<&Path>,
        out: &Path,
        overwrite: bool,
    ) -> Result<Finished, ReadError> {
        let mut reader = source.map(RecordReader::open).transpose()?;
        let mut changes = self.frames.changes(source)?;
        if let Some(message) = changes.left() {
            let at = self.frames.at;
            let stamps = MessageStamps {
                log_time: at,
                publish_time: at,
            };
            self.add(topic::TF_STATIC, Qos::LATCHED, [(stamps, message)]);
        }
        if let Some(source) = source
            && crate::recover::same_file(source, out)
        {
            return Err(crate::WriteError::Exists {
                path: out.to_owned(),
            }
            .into());
        }
        let options = WriterOptions {
            overwrite,
            ..WriterOptions::default()
        };
        let mut writer = RecordingWriter::create(out, &options)?;
        let result = self.fill(&mut writer, reader.as_mut(), source, &mut changes);
        match result {
            Ok(()) => Ok(writer.finish_or_discard()?),
            Err(error) => {
                // Half a copy is of no use, and the source is still there.
                writer.discard();
                Err(match error {
                    ReadError::Write(error) => error.of_nothing(out).into(),
                    error => error,
                })
            }
        }
    }

    fn fill(
        &mut self,
        writer: &mut RecordingWriter,
        reader: Option<&mut RecordReader<std::io::BufReader<std::fs::File>>>,
        source: Option<&Path>,
        changes: &mut Changes,
    ) -> Result<(), ReadError> {
        for (name, entries) in &self.metadata {
            writer.write_metadata(name, entries)?;
        }
        let mut pending = Pending::open(std::mem::take(&mut self.added), writer)?;
        let mut channels: BTreeMap<u16, Copied> = BTreeMap::new();
        let mut schemas = BTreeMap::new();
        if let Some(reader) = reader {
            while let Some(record) = reader.next_record()? {
                if let Record::Message(message) = &record
                    && let Some(copied) = channels.get(&message.channel_id)
                    && changes.concern(&copied.topic)
                {
                    pending.write_until(Some(message.log_time), writer)?;
                    let changed = changes.apply(message.data);
                    let data = changed.as_deref().unwrap_or(message.data);
                    let message = RawMessage { data, ..*message };
                    self.copy_message(writer, copied, &message)?;
                    continue;
                }
                self.copy(writer, &mut pending, &mut channels, &mut schemas, record)?;
            }
            if let Some(damage) = reader.damage().first() {
                return Err(ReadError::Damaged {
                    path: source.unwrap_or(Path::new("")).to_owned(),
                    damage: damage.to_string(),
                });
            }
        }
        pending.write_until(None, writer)
    }

    fn copy(
        &mut self,
        writer: &mut RecordingWriter,
        pending: &mut Pending,
        channels: &mut BTreeMap<u16, Copied>,
        schemas: &mut BTreeMap<u16, Schema>,
        record: Record<'_>,
    ) -> Result<(), ReadError> {
        match record {
            Record::Schema(schema) => {
                schemas.entry(schema.id).or_insert(schema);
            }
            Record::Channel(channel)
                if !channels.contains_key(&channel.id)
                    && !self.left_out.contains(&channel.topic) =>
            {
                let schema = schemas.get(&channel.schema_id);
                let kind = schema.map_or("", |schema| &schema.name);
                let copied = Copied {
                    to: writer.add_channel_of(&channel, schema)?,
                    stamped: channel.message_encoding == "cdr" && is_stamped(kind),
                    topic: channel.topic,
                };
                channels.insert(channel.id, copied);
            }
            Record::Message(message) => {
                pending.write_until(Some(message.log_time), writer)?;
                if let Some(copied) = channels.get(&message.channel_id) {
                    self.copy_message(writer, copied, &message)?;
                }
            }
            Record::Attachment(attachment) => writer.attach(&attachment)?,
            Record::Metadata { name, entries } if !self.metadata.contains_key(&name) => {
                writer.write_metadata(&name, &entries)?;
            }
            _ => {}
        }
        Ok(())
    }

    fn copy_message(
        &mut self,
        writer: &mut RecordingWriter,
        copied: &Copied,
        message: &RawMessage<'_>,
    ) -> Result<(), ReadError> {
        let time = |nanos| i64::try_from(nanos).map_or(HostTime::FAR_FUTURE, HostTime::from_nanos);
        let mut stamps = MessageStamps {
            log_time: time(message.log_time),
            publish_time: time(message.publish_time),
        };
        let restamped = match (&mut self.restamp, copied.stamped) {
            (Some(restamp), true) => stamp_of(message.data)
                .map(|stamp| restamp(&copied.topic, stamp, stamps.log_time))
                .and_then(|stamp| Some((stamp, with_stamp(message.data, stamp)?))),
            _ => None,
        };
        let data = match &restamped {
            Some((stamp, data)) => {
                stamps.publish_time = *stamp;
                // Nothing is true after it arrived.
                stamps.log_time = stamps.log_time.max(*stamp);
                data.as_slice()
            }
            None => message.data,
        };
        Ok(writer.write_numbered(copied.to, message.sequence, stamps, data)?)
    }
}

/// A channel of the source in the new recording.
struct Copied {
    to: ChannelId,
    topic: String,
    stamped: bool,
}

/// Whether messages of this type begin with a `std_msgs/msg/Header`.
fn is_stamped(kind: &str) -> bool {
    [
        WrenchStamped::TYPE_NAME,
        PoseStamped::TYPE_NAME,
        JointState::TYPE_NAME,
        Temperature::TYPE_NAME,
        Imu::TYPE_NAME,
    ]
    .contains(&kind)
}

/// The stamp that a message begins with, behind the 4 bytes of the CDR header.
fn stamp_of(data: &[u8]) -> Option<HostTime> {
    let (header, rest) = data.split_first_chunk::<4>()?;
    let (sec, rest) = rest.split_first_chunk::<4>()?;
    let nanosec = rest.first_chunk::<4>()?;
    let little = header[1] & 1 == 1;
    let time = if little {
        Time {
            sec: i32::from_le_bytes(*sec),
            nanosec: u32::from_le_bytes(*nanosec),
        }
    } else {
        Time {
            sec: i32::from_be_bytes(*sec),
            nanosec: u32::from_be_bytes(*nanosec),
        }
    };
    Some(time.into())
}

fn with_stamp(data: &[u8], stamp: HostTime) -> Option<Vec<u8>> {
    let mut out = data.to_vec();
    let little = out.get(1)? & 1 == 1;
    let Time { sec, nanosec } = Time::from(stamp);
    let bytes = if little {
        [sec.to_le_bytes(), nanosec.to_le_bytes()]
    } else {
        [sec.to_be_bytes(), nanosec.to_be_bytes()]
    };
    out.get_mut(4..12)?.copy_from_slice(bytes.as_flattened());
    Some(out)
}

/// Messages that are added, by `log_time`.
struct Pending {
    messages: std::iter::Peekable<std::vec::IntoIter<(MessageStamps, ChannelId, Vec<u8>)>>,
}

impl Pending {
    fn open(added: Vec<Added>, writer: &mut RecordingWriter) -> Result<Self, ReadError> {
        let mut messages = Vec::new();
        for topic in added {
            let channel = (topic.open)(writer, &topic.topic, topic.qos)?;
            messages.extend(
                topic
                    .messages
                    .into_iter()
                    .map(|(stamps, bytes)| (stamps, channel, bytes)),
            );
        }
        messages.sort_by_key(|(stamps, ..)| stamps.log_time);
        Ok(Self {
            messages: messages.into_iter().peekable(),
        })
    }

    /// Writes what comes before `log_time`, ns since the Unix epoch; all when there is none.
    fn write_until(
        &mut self,
        log_time: Option<u64>,
        writer: &mut RecordingWriter,
    ) -> Result<(), ReadError> {
        let is_due = |stamps: &MessageStamps| {
            log_time.is_none_or(|end| i128::from(stamps.log_time.as_nanos()) < i128::from(end))
        };
        while let Some((stamps, channel, bytes)) =
            self.messages.next_if(|(stamps, ..)| is_due(stamps))
        {
            writer.write(channel, stamps, &bytes)?;
        }
        Ok(())
    }
}
