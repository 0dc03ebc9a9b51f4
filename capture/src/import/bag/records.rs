//! The records of a bag, one after another: format 2.0, chunks that are not packed.
//!
//! ```text
//! "#ROSBAG V2.0\n", then records: u32 length, header, u32 length, data; a header is fields: u32 length, name "=" value
//! op 5 chunk: compression, size; its data are records   op 7 connection: conn, topic; data: type=, md5sum=, ...
//! op 2 message: conn, time (u32 s, u32 ns)              op 3, 4, 6: bag header, indices; not needed
//! ```
//!
//! All numbers are little endian. The indices are not used, so a bag whose recorder was killed reads as far as it goes.
//!
//! # Source
//! wiki.ros.org/Bags/Format/2.0.

use std::collections::BTreeMap;
use std::io::{BufRead, ErrorKind};

use sha2::{Digest as _, Sha256};

use crate::import::hex;

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
const OP_MESSAGE: u8 = 2;
const OP_CHUNK: u8 = 5;
const OP_CONNECTION: u8 = 7;
/// Longest header, connection and wanted message that are believed, bytes.
const MOST_HEADER: u32 = 1 << 16;
const MOST_CONNECTION: u32 = 1 << 24;
const MOST_MESSAGE: u32 = 1 << 16;
/// Bytes between two words on the progress.
const PROGRESS_EVERY: u64 = 1 << 24;

/// Why a bag gives nothing.
pub(super) enum ScanError {
    Io(std::io::Error),
    /// What is wrong and what to do.
    Format(String),
}

impl From<std::io::Error> for ScanError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

/// A topic of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Connection {
    pub(super) topic: String,
    pub(super) kind: String,
}

/// What was seen on the way to the end.
#[derive(Debug)]
pub(super) struct Scanned {
    /// Whether the end of the file cut a record.
    pub(super) cut_short: bool,
    /// Chunks with a record that does not fit.
    pub(super) damaged_chunks: u64,
    /// SHA-256 of the file, 64 hex digits.
    pub(super) sha256: String,
}

/// Takes messages.
pub(super) trait Sink {
    /// Whether messages of this connection are wanted; others are not even copied.
    fn wants(&self, connection: &Connection) -> bool;
    /// Takes the data of a wanted message.
    fn take(&mut self, connection: &Connection, data: &[u8]);
}

/// A bag that is being read.
pub(super) struct Records<R> {
    input: R,
    hasher: Sha256,
    at: u64,
    connections: BTreeMap<u32, Connection>,
}

impl<R: BufRead> Records<R> {
    pub(super) fn new(input: R) -> Self {
        Self {
            input,
            hasher: Sha256::new(),
            at: 0,
            connections: BTreeMap::new(),
        }
    }

    /// Topics and their types, as far as was read.
    pub(super) fn topics(&self) -> BTreeMap<&str, &str> {
        self.connections
            .values()
            .map(|one| (one.topic.as_str(), one.kind.as_str()))
            .collect()
    }

    /// Reads to the end; wanted messages are given to `sink`. `progress` hears the bytes read.
    pub(super) fn scan(
        &mut self,
        sink: &mut dyn Sink,
        progress: &mut dyn FnMut(u64),
    ) -> Result<Scanned, ScanError> {
        let mut first = vec![0; MAGIC.len()];
        if !self.fill(&mut first)? || first != MAGIC {
            return Err(ScanError::Format(
                "it is no ROS 1 bag of format 2.0 (a ROS 2 bag is read with --map as it is)"
                    .to_owned(),
            ));
        }
        let (mut cut_short, mut damaged_chunks) = (false, 0);
        let mut chunk_end: Option<u64> = None;
        let mut told = 0;
        while !self.buffered()?.is_empty() {
            if chunk_end.is_some_and(|end| self.at >= end) {
                chunk_end = None;
            }
            let limit = chunk_end.unwrap_or(u64::MAX);
            match self.record(limit, chunk_end.is_none(), sink)? {
                Step::Record => {}
                Step::Chunk(end) => chunk_end = Some(end),
                Step::End => cut_short = true,
                Step::DoesNotFit => match chunk_end.take() {
                    // The next chunk stands where this one ends.
                    Some(end) => {
                        damaged_chunks += 1;
                        cut_short |= !self.skip(end.saturating_sub(self.at))?;
                    }
                    None => {
                        cut_short = true;
                        self.skip(u64::MAX)?;
                    }
                },
            }
            if self.at >= told + PROGRESS_EVERY {
                told = self.at;
                progress(told);
            }
        }
        cut_short |= chunk_end.is_some_and(|end| self.at < end);
        Ok(Scanned {
            cut_short,
            damaged_chunks,
            sha256: hex(&std::mem::take(&mut self.hasher).finalize()),
        })
    }

    /// One record, which must end at `limit` at the latest.
    fn record(&mut self, limit: u64, outer: bool, sink: &mut dyn Sink) -> Result<Step, ScanError> {
        let room = |at: u64, length: u32| at.saturating_add(u64::from(length)) <= limit;
        if !room(self.at, 4) {
            return Ok(Step::DoesNotFit);
        }
        let Some(length) = self.word()? else {
            return Ok(Step::End);
        };
        if length > MOST_HEADER || !room(self.at, length.saturating_add(4)) {
            return Ok(Step::DoesNotFit);
        }
        let Some(header) = self.bytes(length)? else {
            return Ok(Step::End);
        };
        let Some(length) = self.word()? else {
            return Ok(Step::End);
        };
        if !room(self.at, length) {
            return Ok(Step::DoesNotFit);
        }
        let fields = fields(&header);
        let id = fields
            .get("conn")
            .and_then(|value| value.first_chunk::<4>())
            .map(|value| u32::from_le_bytes(*value));
        match (fields.get("op").and_then(|op| op.first()), id) {
            (Some(&OP_CHUNK), _) if outer => {
                let packed = fields.get("compression").copied().unwrap_or(b"none");
                if packed != b"none" {
                    return Err(ScanError::Format(format!(
                        "its chunks are packed by {}: unpack it first with `rosbag decompress`",
                        String::from_utf8_lossy(packed)
                    )));
                }
                return Ok(Step::Chunk(self.at.saturating_add(u64::from(length))));
            }
            (Some(&OP_CONNECTION), Some(id)) if length <= MOST_CONNECTION => {
                let Some(data) = self.bytes(length)? else {
                    return Ok(Step::End);
                };
                let text = |bytes: Option<&&[u8]>| {
                    bytes.map_or(String::new(), |bytes| {
                        String::from_utf8_lossy(bytes).into_owned()
                    })
                };
                let connection = Connection {
                    topic: text(fields.get("topic")),
                    kind: text(self::fields(&data).get("type")),
                };
                self.connections.insert(id, connection);
                return Ok(Step::Record);
            }
            (Some(&OP_MESSAGE), Some(id)) if length <= MOST_MESSAGE => {
                let connection = self.connections.get(&id);
                if connection.is_some_and(|connection| sink.wants(connection)) {
                    let Some(data) = self.bytes(length)? else {
                        return Ok(Step::End);
                    };
                    if let Some(connection) = self.connections.get(&id) {
                        sink.take(connection, &data);
                    }
                    return Ok(Step::Record);
                }
            }
            _ => {}
        }
        Ok(if self.skip(length.into())? {
            Step::Record
        } else {
            Step::End
        })
    }

    fn word(&mut self) -> std::io::Result<Option<u32>> {
        let mut bytes = [0; 4];
        Ok(self.fill(&mut bytes)?.then(|| u32::from_le_bytes(bytes)))
    }

    fn bytes(&mut self, length: u32) -> std::io::Result<Option<Vec<u8>>> {
        let mut bytes = vec![0; length as usize];
        Ok(self.fill(&mut bytes)?.then_some(bytes))
    }

    /// Whether all of it was there.
    fn fill(&mut self, bytes: &mut [u8]) -> std::io::Result<bool> {
        let mut filled = 0;
        while filled < bytes.len() {
            let taken = self.take(bytes.len() - filled, |piece| {
                bytes[filled..filled + piece.len()].copy_from_slice(piece);
            })?;
            if taken == 0 {
                return Ok(false);
            }
            filled += taken;
        }
        Ok(true)
    }

    /// Whether all of it was there.
    fn skip(&mut self, mut length: u64) -> std::io::Result<bool> {
        while length > 0 {
            let most = usize::try_from(length).unwrap_or(usize::MAX);
            match self.take(most, |_| {})? {
                0 => return Ok(false),
                taken => length -= taken as u64,
            }
        }
        Ok(true)
    }

    /// What is there without waiting for more; empty at the end.
    fn buffered(&mut self) -> std::io::Result<&[u8]> {
        while let Err(error) = self.input.fill_buf() {
            if error.kind() != ErrorKind::Interrupted {
                return Err(error);
            }
        }
        self.input.fill_buf()
    }

    /// Takes at most `most` bytes of what is buffered; 0 at the end.
    fn take(&mut self, most: usize, mut give: impl FnMut(&[u8])) -> std::io::Result<usize> {
        self.buffered()?;
        let piece = self.input.fill_buf()?;
        let length = piece.len().min(most);
        let piece = &piece[..length];
        self.hasher.update(piece);
        give(piece);
        self.input.consume(length);
        self.at += length as u64;
        Ok(length)
    }
}

/// What a record was.
enum Step {
    Record,
    /// A chunk's header; its records follow, up to there.
    Chunk(u64),
    /// The file ends in it.
    End,
    DoesNotFit,
}

/// `name=value` fields of a header.
fn fields(mut bytes: &[u8]) -> BTreeMap<&str, &[u8]> {
    let mut found = BTreeMap::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<4>() {
        let Some((field, rest)) = usize::try_from(u32::from_le_bytes(*length))
            .ok()
            .and_then(|length| rest.split_at_checked(length))
        else {
            break;
        };
        bytes = rest;
        if let Some(equals) = field.iter().position(|byte| *byte == b'=')
            && let Ok(name) = std::str::from_utf8(&field[..equals])
        {
            found.insert(name, &field[equals + 1..]);
        }
    }
    found
}
