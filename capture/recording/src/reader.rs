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

mod chunk;
mod damage;
mod record;

use chunk::{LIMIT, Unpacked, unpack};
pub use damage::{Damage, DamageKind};
use record::{CHUNK, ChunkHeader, DATA_END, FOOTER, MESSAGE};
pub use record::{Attachment, Channel, RawMessage, Record, Schema};

const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
/// Opcode and length.
const FRAME: u64 = 9;
/// A chunk record with more behind its content has a wrong length.
const MAX_PADDING: u64 = 4096;
/// How much of the file is looked at in one go for the next chunk.
const SCAN_WINDOW: usize = 1 << 16;

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
    chunk: Vec<u8>,
    /// What is left of `chunk`.
    in_chunk: Range<usize>,
    /// Offset in the file of the chunk or record at hand.
    offset: u64,
    good_end: u64,
    complete: bool,
    state: State,
    damage: Vec<Damage>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Records,
    EndMagic,
    Ended,
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
    /// When it cannot be read or is not an MCAP.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let io = |call| move |source| ReadError::Io { call, path: path.to_owned(), source };
        let file = File::open(path).map_err(io("open"))?;
        let length = file.metadata().map_err(io("get the size of"))?.len();
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
            chunk: Vec::new(),
            in_chunk: 0..0,
            offset: 0,
            good_end: 0,
            complete: false,
            state: State::Records,
            damage: Vec::new(),
        };
        reader.read_body(16.min(length)).map_err(|error| reader.io_error(error))?;
        if !reader.body.starts_with(&MAGIC) {
            return Err(ReadError::NotMcap { path: path.to_owned(), found: FirstBytes::new(&reader.body) });
        }
        reader.seek_to(MAGIC.len() as u64).map_err(|error| reader.io_error(error))?;
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
        let Some((opcode, place)) = found else { return Ok(None) };
        let body = match place {
            Place::Body => self.body.as_slice(),
            Place::Chunk(range) => self.chunk.get(range).unwrap_or_default(),
        };
        Ok(Some(Record::parse(opcode, body).unwrap_or_else(|| {
            self.damage.push(Damage { offset: self.offset, kind: DamageKind::Unreadable { opcode } });
            Record::Unreadable { opcode }
        })))
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
        let rest = self.chunk.get(self.in_chunk.clone()).filter(|rest| !rest.is_empty())?;
        let Some((opcode, length)) = frame(rest).filter(|(_, length)| *length <= (rest.len() - 9) as u64) else {
            let opcode = rest.first().copied().unwrap_or(0);
            self.damage.push(Damage { offset: self.offset, kind: DamageKind::Unreadable { opcode } });
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
        if left == 0 {
            self.end(DamageKind::Unfinished);
            return Ok(None);
        }
        self.read_body(FRAME.min(left))?;
        let Some((opcode, length)) = frame(&self.body) else {
            let opcode = self.body.first().copied().unwrap_or(0);
            self.end(DamageKind::Truncated { opcode, left, messages: 0 });
            return Ok(None);
        };
        let left = left - FRAME;
        match opcode {
            0 => self.resync()?,
            CHUNK => self.read_chunk(length, left)?,
            _ if length > left => self.cut_record(opcode, left)?,
            _ if length > LIMIT => {
                self.note(DamageKind::TooLarge { opcode, length });
                self.seek_to(self.position + length)?;
            }
            _ => {
                self.read_body(length)?;
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
                self.note(DamageKind::Garbage { skipped: self.length - self.position });
            }
        } else if MAGIC.starts_with(&self.body) {
            self.note(DamageKind::Truncated { opcode: FOOTER, left, messages: 0 });
        } else {
            self.state = State::Records;
            self.resync()?;
        }
        Ok(())
    }

    /// A record that claims to go on behind the end of the file: cut there, or its length is wrong.
    fn cut_record(&mut self, opcode: u8, left: u64) -> io::Result<()> {
        match self.find_chunk(self.offset + 1)? {
            Some(found) => self.skip_garbage(found),
            None => {
                self.end(DamageKind::Truncated { opcode, left: left + FRAME, messages: 0 });
                Ok(())
            }
        }
    }

    fn read_chunk(&mut self, length: u64, left: u64) -> io::Result<()> {
        let start = self.position;
        let Some(header) = self.read_chunk_header(left)? else {
            return match left < (ChunkHeader::MIN_LENGTH + ChunkHeader::MAX_NAME) as u64 {
                true => self.cut_record(CHUNK, left),
                false => self.resync(),
            };
        };
        let claimed = header.length.saturating_add(header.compressed_size);
        if claimed > left {
            return self.read_cut_chunk(&header, left);
        }
        // A record length that contradicts the chunk's own header is not believed.
        let padded = claimed..=left.min(claimed.saturating_add(MAX_PADDING));
        let length = if padded.contains(&length) { length } else { claimed };
        if length > LIMIT || header.uncompressed_size > LIMIT {
            self.note(DamageKind::TooLarge { opcode: CHUNK, length: length.max(header.uncompressed_size) });
            return self.seek_to(start + length);
        }
        self.read_more(length - header.length)?;
        self.good_end = self.position;
        self.open_chunk(&header);
        Ok(())
    }

    /// Reads exactly the header into `body`.
    fn read_chunk_header(&mut self, left: u64) -> io::Result<Option<ChunkHeader>> {
        self.read_body(left.min(ChunkHeader::MIN_LENGTH as u64))?;
        let name = ChunkHeader::name_length(&self.body).filter(|name| *name <= ChunkHeader::MAX_NAME as u64);
        let Some(name) = name else { return Ok(None) };
        self.read_more(name.min(left.saturating_sub(ChunkHeader::MIN_LENGTH as u64)))?;
        Ok(ChunkHeader::parse(&self.body))
    }

    /// Unpacks the chunk in `body`; its records are there to be read only when it is right.
    fn open_chunk(&mut self, header: &ChunkHeader) {
        let unpacked = unpack(&header.compression, packed(&self.body, header), &mut self.chunk);
        let got = self.chunk.len() as u64;
        let (saved, expected) = (header.uncompressed_crc, header.uncompressed_size);
        let calculated = if saved == 0 { 0 } else { crc32fast::hash(&self.chunk) };
        if unpacked == Unpacked::Unsupported {
            self.note(DamageKind::Compression { name: header.compression.clone() });
        } else if unpacked == Unpacked::Partly || got != expected {
            self.note(DamageKind::ChunkContent { compression: header.compression.clone(), expected, got });
        } else if calculated != saved {
            self.note(DamageKind::ChunkCrc { saved, calculated });
        } else {
            self.in_chunk = 0..self.chunk.len();
        }
    }

    /// The chunk at the end of a file that was cut, or that was being written: gives the whole records in it.
    fn read_cut_chunk(&mut self, header: &ChunkHeader, left: u64) -> io::Result<()> {
        if let Some(found) = self.find_chunk(self.offset + 1)? {
            return self.skip_garbage(found);
        }
        self.seek_to(self.offset + FRAME)?;
        self.read_body(left.min(LIMIT))?;
        unpack(&header.compression, packed(&self.body, header), &mut self.chunk);
        let whole = whole_records(&self.chunk);
        self.end(DamageKind::Truncated { opcode: CHUNK, left: left + FRAME, messages: whole.messages });
        self.in_chunk = 0..whole.end;
        Ok(())
    }

    fn check_data_crc(&mut self, before: Option<crc32fast::Hasher>) {
        let Some(&[a, b, c, d]) = self.body.first_chunk::<4>() else { return };
        let saved = u32::from_le_bytes([a, b, c, d]);
        if let Some(calculated) = before.map(crc32fast::Hasher::finalize)
            && saved != 0
            && saved != calculated
        {
            self.note(DamageKind::DataCrc { saved, calculated });
        }
    }

    /// Looks for the next chunk behind a place that is no record.
    fn resync(&mut self) -> io::Result<()> {
        match self.find_chunk(self.offset + 1)? {
            Some(found) => self.skip_garbage(found),
            None => {
                self.end(DamageKind::Garbage { skipped: self.length - self.offset });
                Ok(())
            }
        }
    }

    fn skip_garbage(&mut self, to: u64) -> io::Result<()> {
        self.note(DamageKind::Garbage { skipped: to - self.offset });
        self.seek_to(to)
    }

    /// Where the next chunk at or behind `from` begins, judged by its header.
    fn find_chunk(&mut self, from: u64) -> io::Result<Option<u64>> {
        let overlap = 9 + ChunkHeader::MIN_LENGTH + ChunkHeader::MAX_NAME;
        let mut start = from;
        while start < self.length {
            self.seek_to(start)?;
            self.read_body((SCAN_WINDOW as u64).min(self.length - start))?;
            let found = (0..self.body.len()).find(|at| {
                let left = self.length - start - *at as u64;
                self.body.get(*at..).is_some_and(|bytes| looks_like_chunk(bytes, left))
            });
            if let Some(at) = found {
                return Ok(Some(start + at as u64));
            }
            if self.body.len() < SCAN_WINDOW {
                break;
            }
            start += (SCAN_WINDOW - overlap) as u64;
        }
        Ok(None)
    }

    fn end(&mut self, kind: DamageKind) {
        self.note(kind);
        self.state = State::Ended;
    }

    fn note(&mut self, kind: DamageKind) {
        self.damage.push(Damage { offset: self.offset, kind });
    }

    /// Replaces `body` by the next `length` bytes, fewer when the file has shrunk meanwhile.
    fn read_body(&mut self, length: u64) -> io::Result<()> {
        self.body.clear();
        self.read_more(length)
    }

    fn read_more(&mut self, length: u64) -> io::Result<()> {
        let before = self.body.len();
        let read = (&mut self.source).take(length).read_to_end(&mut self.body)? as u64;
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
        ReadError::Io { call: "read", path: self.path.clone(), source }
    }
}

fn frame(bytes: &[u8]) -> Option<(u8, u64)> {
    let (&[opcode], rest) = bytes.split_first_chunk::<1>()?;
    Some((opcode, u64::from_le_bytes(*rest.first_chunk()?)))
}

/// The packed records of a chunk record, as far as they are there.
fn packed<'a>(body: &'a [u8], header: &ChunkHeader) -> &'a [u8] {
    let start = usize::try_from(header.length).unwrap_or(usize::MAX);
    let rest = body.get(start..).unwrap_or_default();
    usize::try_from(header.compressed_size).ok().and_then(|size| rest.get(..size)).unwrap_or(rest)
}

struct Whole {
    messages: u64,
    end: usize,
}

/// How far whole records reach in the content of a cut chunk.
fn whole_records(content: &[u8]) -> Whole {
    let mut whole = Whole { messages: 0, end: 0 };
    while let Some((opcode, length)) = content.get(whole.end..).and_then(frame) {
        let end = usize::try_from(length).ok().and_then(|length| whole.end.checked_add(9)?.checked_add(length));
        match end.filter(|end| *end <= content.len() && opcode != 0) {
            Some(end) => whole.end = end,
            None => break,
        }
        whole.messages += u64::from(opcode == MESSAGE);
    }
    whole
}

fn looks_like_chunk(bytes: &[u8], left: u64) -> bool {
    let Some((CHUNK, length)) = frame(bytes) else { return false };
    let Some(header) = bytes.get(9..).and_then(ChunkHeader::parse) else { return false };
    ["", "zstd", "lz4"].contains(&header.compression.as_str())
        && header.length.checked_add(header.compressed_size) == Some(length)
        && length <= left - FRAME
        && header.uncompressed_size <= LIMIT
}
