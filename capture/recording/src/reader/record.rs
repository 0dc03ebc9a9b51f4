//! Bodies of MCAP records, read without trust.
//!
//! # Source
//! MCAP specification, version 0 (`website/docs/spec/index.md` of `foxglove/mcap`). Integers are little endian, a string is
//! u32 length and UTF-8, a map is u32 length in bytes and string pairs. Bytes after the last field are padding.

use std::collections::BTreeMap;

pub(crate) const HEADER: u8 = 0x01;
pub(crate) const FOOTER: u8 = 0x02;
pub(crate) const SCHEMA: u8 = 0x03;
pub(crate) const CHANNEL: u8 = 0x04;
pub(crate) const MESSAGE: u8 = 0x05;
pub(crate) const CHUNK: u8 = 0x06;
pub(crate) const MESSAGE_INDEX: u8 = 0x07;
pub(crate) const ATTACHMENT: u8 = 0x09;
pub(crate) const METADATA: u8 = 0x0c;
pub(crate) const DATA_END: u8 = 0x0f;

/// One record of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Record<'a> {
    /// The file's first record.
    Header {
        /// Conventions that the file keeps, `ros2`.
        profile: String,
        /// What wrote it.
        library: String,
    },
    /// A schema; repeated in the summary.
    Schema(Schema),
    /// A channel; repeated in the summary.
    Channel(Channel),
    /// A message.
    Message(RawMessage<'a>),
    /// An attachment whose CRC is right or absent.
    Attachment(Attachment<'a>),
    /// A metadata record.
    Metadata {
        /// Its name.
        name: String,
        /// Its entries.
        entries: BTreeMap<String, String>,
    },
    /// The end of the messages.
    DataEnd {
        /// CRC-32 of everything before, 0 when absent.
        data_section_crc: u32,
    },
    /// The file's last record.
    Footer {
        /// Where the summary begins, 0 when there is none.
        summary_start: u64,
        /// Where the summary's table of contents begins, 0 when there is none.
        summary_offset_start: u64,
        /// CRC-32 of the summary, 0 when absent. It is not checked.
        summary_crc: u32,
    },
    /// An index, a statistic, a private record or one of a later version.
    Other {
        /// What it is.
        opcode: u8,
        /// Its bytes.
        body: &'a [u8],
    },
    /// A record whose content contradicts itself. The reader's damage list has it too.
    Unreadable {
        /// What it claims to be.
        opcode: u8,
    },
}

/// A schema record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Number in this file, not 0.
    pub id: u16,
    /// `geometry_msgs/msg/WrenchStamped`.
    pub name: String,
    /// `ros2msg`.
    pub encoding: String,
    /// The definition.
    pub data: Vec<u8>,
}

/// A channel record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Number in this file.
    pub id: u16,
    /// Its schema, 0 for none.
    pub schema_id: u16,
    /// Topic.
    pub topic: String,
    /// `cdr`.
    pub message_encoding: String,
    /// `offered_qos_profiles` and the like.
    pub metadata: BTreeMap<String, String>,
}

/// A message record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawMessage<'a> {
    /// Its channel.
    pub channel_id: u16,
    /// The writer's counter, 0 when it has none.
    pub sequence: u32,
    /// When it was recorded, ns since the Unix epoch.
    pub log_time: u64,
    /// When it was published or true, ns since the Unix epoch.
    pub publish_time: u64,
    /// Its bytes.
    pub data: &'a [u8],
}

/// An attachment record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment<'a> {
    /// When it was recorded, ns since the Unix epoch.
    pub log_time: u64,
    /// When it was made, ns since the Unix epoch, 0 when unknown.
    pub create_time: u64,
    /// File name.
    pub name: &'a str,
    /// Media type.
    pub media_type: &'a str,
    /// Content.
    pub data: &'a [u8],
}

/// Everything of a chunk record before the packed records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChunkHeader {
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) uncompressed_size: u64,
    pub(crate) uncompressed_crc: u32,
    pub(crate) compression: String,
    pub(crate) compressed_size: u64,
    /// Bytes of this header.
    pub(crate) length: u64,
}

impl<'a> Record<'a> {
    /// The record of a body; `None` when the body contradicts itself.
    pub(crate) fn parse(opcode: u8, body: &'a [u8]) -> Option<Self> {
        let mut fields = Fields { rest: body };
        Some(match opcode {
            HEADER => Self::Header {
                profile: fields.string()?,
                library: fields.string()?,
            },
            FOOTER => Self::Footer {
                summary_start: fields.u64()?,
                summary_offset_start: fields.u64()?,
                summary_crc: fields.u32()?,
            },
            SCHEMA => Self::Schema(Schema {
                id: fields.u16()?,
                name: fields.string()?,
                encoding: fields.string()?,
                data: fields.prefixed()?.to_vec(),
            }),
            CHANNEL => Self::Channel(Channel {
                id: fields.u16()?,
                schema_id: fields.u16()?,
                topic: fields.string()?,
                message_encoding: fields.string()?,
                metadata: fields.map()?,
            }),
            MESSAGE => Self::Message(RawMessage {
                channel_id: fields.u16()?,
                sequence: fields.u32()?,
                log_time: fields.u64()?,
                publish_time: fields.u64()?,
                data: fields.rest,
            }),
            ATTACHMENT => Self::Attachment(attachment(body)?),
            METADATA => Self::Metadata {
                name: fields.string()?,
                entries: fields.map()?,
            },
            DATA_END => Self::DataEnd {
                data_section_crc: fields.u32()?,
            },
            _ => Self::Other { opcode, body },
        })
    }
}

fn attachment(body: &[u8]) -> Option<Attachment<'_>> {
    let mut fields = Fields { rest: body };
    let attachment = Attachment {
        log_time: fields.u64()?,
        create_time: fields.u64()?,
        name: fields.str()?,
        media_type: fields.str()?,
        data: {
            let length = fields.u64()?;
            fields.take(usize::try_from(length).ok()?)?
        },
    };
    let covered = body.len() - fields.rest.len();
    let saved = fields.u32()?;
    let calculated = crc32fast::hash(body.get(..covered)?);
    (saved == 0 || saved == calculated).then_some(attachment)
}

impl ChunkHeader {
    /// Bytes of a header with an empty compression name.
    pub(crate) const MIN_LENGTH: usize = 8 + 8 + 8 + 4 + 4 + 8;
    /// No compression name is longer.
    pub(crate) const MAX_NAME: usize = 64;

    /// Length of the compression name in a header that is there up to [`Self::MIN_LENGTH`].
    pub(crate) fn name_length(bytes: &[u8]) -> Option<u64> {
        let mut fields = Fields { rest: bytes };
        fields.take(28)?;
        fields.u32().map(u64::from)
    }

    /// The header at the start of `bytes`, which may go on behind it.
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        let mut fields = Fields { rest: bytes };
        let (start_time, end_time) = (fields.u64()?, fields.u64()?);
        let uncompressed_size = fields.u64()?;
        let uncompressed_crc = fields.u32()?;
        let compression = fields
            .str()
            .filter(|name| name.len() <= Self::MAX_NAME)?
            .to_owned();
        let compressed_size = fields.u64()?;
        let length = u64::try_from(bytes.len() - fields.rest.len()).ok()?;
        Some(Self {
            start_time,
            end_time,
            uncompressed_size,
            uncompressed_crc,
            compression,
            compressed_size,
            length,
        })
    }
}

/// Takes fields from the front; `None` when the bytes do not reach.
struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    fn take(&mut self, length: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        Some(taken)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.rest.split_first_chunk()?;
        self.rest = rest;
        Some(*taken)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    fn prefixed(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.take(usize::try_from(length).ok()?)
    }

    fn str(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.prefixed()?).ok()
    }

    fn string(&mut self) -> Option<String> {
        self.str().map(str::to_owned)
    }

    fn map(&mut self) -> Option<BTreeMap<String, String>> {
        let mut inner = Self {
            rest: self.prefixed()?,
        };
        let mut map = BTreeMap::new();
        while !inner.rest.is_empty() {
            map.insert(inner.string()?, inner.string()?);
        }
        Some(map)
    }
}

/// What the records of an opcode are called.
pub(crate) fn opcode_name(opcode: u8) -> &'static str {
    match opcode {
        HEADER => "header",
        FOOTER => "footer",
        SCHEMA => "schema",
        CHANNEL => "channel",
        MESSAGE => "message",
        CHUNK => "chunk",
        MESSAGE_INDEX => "message index",
        0x08 => "chunk index",
        ATTACHMENT => "attachment",
        0x0a => "attachment index",
        0x0b => "statistics",
        METADATA => "metadata",
        0x0d => "metadata index",
        0x0e => "summary offset",
        DATA_END => "data end",
        0x80.. => "private",
        _ => "unknown",
    }
}
