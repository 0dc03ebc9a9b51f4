//! Reads the records of any MCAP, whole or not.
//!
//! Nothing in the file is trusted: lengths are compared with the file, chunks with their CRC-32, and a place that cannot
//! be read becomes an entry of [`RecordReader::damage`] while reading goes on behind it as far as possible. A chunk whose
//! CRC is wrong is left out; the unfinished last chunk of a crashed recording is read as far as it goes. Memory is bounded
//! by the largest record or unpacked chunk, at most 1 GiB each.
//!
//! Messages come in the order of the file. Duplicated keys of a map count once; the summary's CRC is not looked at, because
//! the summary is not used.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use crate::error::{FirstBytes, ReadError};

mod belief;
mod chunk;
mod chunk_records;
mod damage;
mod record;

use belief::{Belief, is_message_index};
use chunk::{LIMIT, Unpacker};
pub(crate) use damage::UnknownChannels;
pub use damage::{Damage, DamageKind};
pub use record::{Attachment, Channel, RawMessage, Record, Schema};
use record::{CHUNK, DATA_END, FOOTER, MESSAGE, MESSAGE_INDEX};

const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Opcode and length.
const FRAME: u64 = 9;

/// Reads records one after the other.
#[derive(Debug)]
pub struct RecordReader<R> {
    source: R,
    path: PathBuf,
    length: u64,
    /// Offset of the next byte of `source`.
    position: u64,
    /// CRC-32 of everything read so far, as long as nothing was skipped.
    crc: Option<crc32fast::Hasher>,
    body: Vec<u8>,
    unpacker: Unpacker,
    chunk: Vec<u8>,
    /// What is left of `chunk`.
    in_chunk: Range<usize>,
    /// Offset in the file of the chunk or record at hand.
    offset: u64,
    good_end: u64,
    complete: bool,
    state: State,
    belief: Belief,
    damage: Vec<Damage>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Records,
    EndMagic,
    Ended,
}

/// Records that were read in one go, but for attachments and indexes.
#[derive(Debug, Default)]
pub(crate) struct Batch {
    bytes: Vec<u8>,
    /// Opcode and place of each.
    records: Vec<(u8, Range<usize>)>,
}

/// A batch is full when it has so many bytes.
const BATCH: usize = 1 << 18;

impl Batch {
    /// Adds a record; false when it contradicts itself.
    fn push(&mut self, opcode: u8, body: &[u8]) -> bool {
        match Record::parse(opcode, body) {
            None => return false,
            Some(Record::Attachment(_) | Record::Other { .. }) => {}
            Some(_) => {
                let start = self.bytes.len();
                self.bytes.extend_from_slice(body);
                self.records.push((opcode, start..self.bytes.len()));
            }
        }
        true
    }

    /// The records.
    pub(crate) fn records(&self) -> impl Iterator<Item = Record<'_>> {
        let record = |(opcode, place): &(u8, Range<usize>)| {
            Record::parse(*opcode, self.bytes.get(place.clone())?)
        };
        self.records.iter().filter_map(record)
    }
}

/// Where the body of the record at hand lies.
enum Place {
    Body,
    Chunk(Range<usize>),
}

impl RecordReader<BufReader<File>> {
    /// Opens a file.
    ///
    /// # Errors
    /// When it cannot be read, is no regular file or is not an MCAP.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let (file, length) = open_regular(path)?;
        Self::new(BufReader::with_capacity(1 << 16, file), length, path)
    }
}

impl<R: Read + Seek> RecordReader<R> {
    /// Reads `length` bytes of `source`, which stands at its start; `path` is for messages only.
    ///
    /// # Errors
    /// When it cannot be read or is not an MCAP.
    pub fn new(source: R, length: u64, path: &Path) -> Result<Self, ReadError> {
        let mut reader = Self {
            source,
            path: path.to_owned(),
            length,
            position: 0,
            crc: Some(crc32fast::Hasher::new()),
            body: Vec::new(),
            unpacker: Unpacker::default(),
            chunk: Vec::new(),
            in_chunk: 0..0,
            offset: 0,
            good_end: 0,
            complete: false,
            state: State::Records,
            belief: Belief::new(length),
            damage: Vec::new(),
        };
        reader
            .read_body(16.min(length))
            .map_err(|error| reader.io_error(error))?;
        if !reader.body.starts_with(&MAGIC) {
            return Err(ReadError::NotMcap {
                path: path.to_owned(),
                found: FirstBytes::new(&reader.body),
            });
        }
        reader
            .seek_to(MAGIC.len() as u64)
            .map_err(|error| reader.io_error(error))?;
        let mut crc = crc32fast::Hasher::new();
        crc.update(&MAGIC);
        reader.crc = Some(crc);
        reader.good_end = reader.position;
        Ok(reader)
    }

    /// The next record, `None` after the last one that can be read.
    ///
    /// # Errors
    /// When the operating system cannot read the file.
    pub fn next_record(&mut self) -> Result<Option<Record<'_>>, ReadError> {
        let found = self.advance().map_err(|error| self.io_error(error))?;
        let Some((opcode, place)) = found else {
            return Ok(None);
        };
        let body = match place {
            Place::Body => self.body.as_slice(),
            Place::Chunk(range) => self.chunk.get(range).unwrap_or_default(),
        };
        Ok(Some(Record::parse(opcode, body).unwrap_or_else(|| {
            self.damage.push(Damage {
                offset: self.offset,
                kind: DamageKind::Unreadable { opcode },
            });
            Record::Unreadable { opcode }
        })))
    }

    /// Replaces `batch` by the next records; false behind the last one.
    ///
    /// # Errors
    /// As [`RecordReader::next_record`].
    pub(crate) fn next_batch(&mut self, batch: &mut Batch) -> Result<bool, ReadError> {
        batch.bytes.clear();
        // One long record takes no memory for good.
        batch.bytes.shrink_to(2 * BATCH);
        batch.records.clear();
        while batch.bytes.len() < BATCH {
            let found = self.advance().map_err(|error| self.io_error(error))?;
            let Some((opcode, place)) = found else {
                break;
            };
            if !batch.push(opcode, self.body_at(place)) {
                self.note(DamageKind::Unreadable { opcode });
            }
        }
        Ok(!batch.records.is_empty())
    }

    fn body_at(&self, place: Place) -> &[u8] {
        match place {
            Place::Body => &self.body,
            Place::Chunk(range) => self.chunk.get(range).unwrap_or_default(),
        }
    }

    /// What is wrong with the part read so far.
    #[must_use]
    pub fn damage(&self) -> &[Damage] {
        &self.damage
    }

    /// Whether the end of a finished file was reached.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.complete
    }

    /// Where the last whole record of the part read so far ends, bytes from the start.
    #[must_use]
    pub fn good_end(&self) -> u64 {
        self.good_end
    }

    /// Size of the file, bytes.
    #[must_use]
    pub fn length(&self) -> u64 {
        self.length
    }

    fn advance(&mut self) -> io::Result<Option<(u8, Place)>> {
        loop {
            if let Some(found) = self.next_in_chunk() {
                return Ok(Some(found));
            }
            match self.state {
                State::Records => {
                    if let Some(opcode) = self.next_in_file()? {
                        return Ok(Some((opcode, Place::Body)));
                    }
                }
                State::EndMagic => self.end_magic()?,
                State::Ended => return Ok(None),
            }
        }
    }

    fn next_in_chunk(&mut self) -> Option<(u8, Place)> {
        let rest = self
            .chunk
            .get(self.in_chunk.clone())
            .filter(|rest| !rest.is_empty())?;
        let Some((opcode, length)) =
            frame(rest).filter(|(_, length)| *length <= (rest.len() - 9) as u64)
        else {
            let opcode = rest.first().copied().unwrap_or(0);
            self.note(DamageKind::Unreadable { opcode });
            self.in_chunk = 0..0;
            return None;
        };
        let start = self.in_chunk.start + 9;
        // Compared with the rest just above.
        #[allow(clippy::cast_possible_truncation)]
        let end = start + length as usize;
        self.in_chunk.start = end;
        Some((opcode, Place::Chunk(start..end)))
    }

    /// Reads the next record that is no chunk into `body`, or the next chunk into `chunk`.
    fn next_in_file(&mut self) -> io::Result<Option<u8>> {
        self.offset = self.position;
        let before = self.crc.clone();
        let left = self.length.saturating_sub(self.position);
        if left < FRAME && self.look_back()? {
            return Ok(None);
        }
        if left == 0 {
            self.end(DamageKind::Unfinished);
            return Ok(None);
        }
        self.read_body(FRAME.min(left))?;
        let Some((opcode, length)) = frame(&self.body) else {
            let opcode = self.body.first().copied().unwrap_or(0);
            self.end(DamageKind::Truncated {
                opcode,
                left,
                messages: 0,
            });
            return Ok(None);
        };
        let left = left - FRAME;
        if !self.believe(opcode, length, left)? {
            return Ok(None);
        }
        match opcode {
            CHUNK => self.read_chunk(length, left)?,
            _ if length > left => self.cut_record(opcode, left)?,
            _ if length > LIMIT => {
                self.note(DamageKind::TooLarge { opcode, length });
                self.seek_to(self.position + length)?;
            }
            _ => {
                self.read_body(length)?;
                if !self.fits(opcode, length) && !self.believe_length()? {
                    return Ok(None);
                }
                self.good_end = self.position;
                if opcode == DATA_END {
                    self.check_data_crc(before);
                } else if opcode == FOOTER {
                    self.state = State::EndMagic;
                }
                return Ok(Some(opcode));
            }
        }
        Ok(None)
    }

    /// Whether the record in `body` does not contradict itself.
    fn fits(&self, opcode: u8, length: u64) -> bool {
        match opcode {
            MESSAGE_INDEX => is_message_index(&self.body, length),
            MESSAGE => true,
            _ => Record::parse(opcode, &self.body).is_some(),
        }
    }

    fn end_magic(&mut self) -> io::Result<()> {
        self.offset = self.position;
        let left = self.length.saturating_sub(self.position);
        self.read_body(left.min(MAGIC.len() as u64))?;
        self.state = State::Ended;
        if self.body == MAGIC {
            self.good_end = self.position;
            self.complete = true;
            self.offset = self.position;
            if self.position < self.length {
                self.note(DamageKind::Garbage {
                    skipped: self.length - self.position,
                });
            }
        } else if MAGIC.starts_with(&self.body) {
            self.note(DamageKind::Truncated {
                opcode: FOOTER,
                left,
                messages: 0,
            });
        } else {
            self.state = State::Records;
            self.resync()?;
        }
        Ok(())
    }

    fn check_data_crc(&mut self, before: Option<crc32fast::Hasher>) {
        let Some(&[a, b, c, d]) = self.body.first_chunk::<4>() else {
            return;
        };
        let saved = u32::from_le_bytes([a, b, c, d]);
        if let Some(calculated) = before.map(crc32fast::Hasher::finalize)
            && saved != 0
            && saved != calculated
        {
            self.note(DamageKind::DataCrc { saved, calculated });
        }
    }

    fn end(&mut self, kind: DamageKind) {
        self.note(kind);
        self.state = State::Ended;
    }

    fn note(&mut self, kind: DamageKind) {
        self.damage.push(Damage {
            offset: self.offset,
            kind,
        });
    }

    /// Replaces `body` by the next `length` bytes, fewer when the file has shrunk meanwhile.
    fn read_body(&mut self, length: u64) -> io::Result<()> {
        self.body.clear();
        self.read_more(length)
    }

    fn read_more(&mut self, length: u64) -> io::Result<()> {
        let before = self.body.len();
        let read = (&mut self.source)
            .take(length)
            .read_to_end(&mut self.body)? as u64;
        self.position += read;
        if read < length {
            self.length = self.position;
        }
        if let Some(crc) = &mut self.crc {
            crc.update(self.body.get(before..).unwrap_or_default());
        }
        Ok(())
    }

    /// Goes to another place. What is skipped is not in the CRC, which is given up then.
    fn seek_to(&mut self, position: u64) -> io::Result<()> {
        self.position = self.source.seek(SeekFrom::Start(position))?;
        self.crc = None;
        Ok(())
    }

    fn io_error(&self, source: io::Error) -> ReadError {
        ReadError::Io {
            call: "read",
            path: self.path.clone(),
            source,
        }
    }
}

/// Opens a file for reading, with its length; a pipe would keep the reader waiting for ever.
pub(crate) fn open_regular(path: &Path) -> Result<(File, u64), ReadError> {
    let io = |call| {
        move |source| ReadError::Io {
            call,
            path: path.to_owned(),
            source,
        }
    };
    let metadata = std::fs::metadata(path).map_err(io("open"))?;
    if !metadata.is_file() {
        return Err(ReadError::NotRegular {
            path: path.to_owned(),
        });
    }
    let file = File::open(path).map_err(io("open"))?;
    let length = file.metadata().map_err(io("get the size of"))?.len();
    Ok((file, length))
}

fn frame(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&[opcode], rest) = bytes.split_first_chunk::<1>()?;
    Some((opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}
