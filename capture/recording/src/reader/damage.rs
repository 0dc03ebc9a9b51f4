//! What is wrong with a file, and where.

use std::collections::BTreeMap;
use std::fmt;

use super::record::opcode_name;

/// One place where a recording is damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Where in the file, bytes from its start.
    pub offset: u64,
    /// What is wrong there.
    pub kind: DamageKind,
}

/// What is wrong at one place of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum DamageKind {
    /// The file ends after a complete record, without its summary: the recording was not finished.
    Unfinished,
    /// The file ends inside a record.
    Truncated {
        /// What the record is.
        opcode: u8,
        /// Bytes of the file that belong to it.
        left: u64,
        /// Complete messages that could still be taken out of it.
        messages: u64,
    },
    /// Something that is no record stands where one should. Reading goes on at the next chunk that can be found.
    Garbage {
        /// Bytes skipped; to the end of the file when there is no other chunk.
        skipped: u64,
    },
    /// A chunk's content does not fit its CRC-32. Its messages are left out, because some of them are wrong.
    ChunkCrc {
        /// As the file says.
        saved: u32,
        /// Of what is there.
        calculated: u32,
    },
    /// A chunk does not unpack. Its messages are left out.
    ChunkContent {
        /// How it is packed.
        compression: String,
        /// Bytes it should unpack to.
        expected: u64,
        /// Bytes it does unpack to.
        got: u64,
    },
    /// A chunk is packed in a way that is not supported.
    Compression {
        /// How it is packed.
        name: String,
    },
    /// A record is longer than 1 GiB. It is left out.
    TooLarge {
        /// What the record is.
        opcode: u8,
        /// Its length, bytes.
        length: u64,
    },
    /// A record contradicts itself. It is left out.
    Unreadable {
        /// What the record is.
        opcode: u8,
    },
    /// The file's content does not fit its CRC-32; what has no CRC of its own may be wrong.
    DataCrc {
        /// As the file says.
        saved: u32,
        /// Of what is there.
        calculated: u32,
    },
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "at byte {}: ", self.offset)?;
        match &self.kind {
            DamageKind::Unfinished => {
                f.write_str("the file ends without its summary (it was not finished)")
            }
            DamageKind::Truncated {
                opcode,
                left,
                messages,
            } => write!(
                f,
                "the file ends inside a {} record ({left} bytes of it are there, {messages} whole messages in them)",
                opcode_name(*opcode)
            ),
            DamageKind::Garbage { skipped } => write!(f, "{skipped} bytes are no records"),
            DamageKind::ChunkCrc { saved, calculated } => write!(
                f,
                "chunk content has CRC {calculated:#010x}, expected {saved:#010x}; its messages are left out"
            ),
            DamageKind::ChunkContent {
                compression,
                expected,
                got,
            } => write!(
                f,
                "chunk (\"{compression}\") unpacks to {got} bytes, expected {expected}; its messages are left out"
            ),
            DamageKind::Compression { name } => write!(
                f,
                "chunk is packed with \"{name}\", only zstd, lz4 and none are read; its messages are left out"
            ),
            DamageKind::TooLarge { opcode, length } => {
                write!(
                    f,
                    "{} record of {length} bytes is left out, the limit is 1 GiB",
                    opcode_name(*opcode)
                )
            }
            DamageKind::Unreadable { opcode } => {
                write!(
                    f,
                    "{} record contradicts itself and is left out",
                    opcode_name(*opcode)
                )
            }
            DamageKind::DataCrc { saved, calculated } => write!(
                f,
                "the file up to here has CRC {calculated:#010x}, expected {saved:#010x}: it was altered"
            ),
        }
    }
}

/// Messages that were left out because their channel is not described, by channel.
#[derive(Debug, Default)]
pub(crate) struct UnknownChannels(BTreeMap<u16, u64>);

impl UnknownChannels {
    pub(crate) fn add(&mut self, channel_id: u16) {
        *self.0.entry(channel_id).or_default() += 1;
    }

    /// `damage` and what was left out, one line each.
    pub(crate) fn behind<'a>(&'a self, damage: &'a [Damage]) -> impl Iterator<Item = String> + 'a {
        let left_out = self.0.iter().map(|(channel_id, messages)| {
            format!(
                "{messages} messages of channel {channel_id}, which is not described, are left out"
            )
        });
        damage.iter().map(Damage::to_string).chain(left_out)
    }
}
