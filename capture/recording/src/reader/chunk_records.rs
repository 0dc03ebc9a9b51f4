//! Chunks in the file: whole, wrong, cut, or to be found behind something that is no record.

use std::io::{self, Read, Seek};

use super::chunk::{LIMIT, Unpacked};
use super::damage::DamageKind;
use super::record::{CHUNK, ChunkHeader, MESSAGE, METADATA};
use super::{FRAME, RecordReader, frame};

/// A chunk record with more behind its content has a wrong length.
const MAX_PADDING: u64 = 4096;
/// No chunk's frame and header are longer, bytes, nor a metadata record's frame, name and length.
pub(super) const CHUNK_START: usize = 9 + ChunkHeader::MIN_LENGTH + ChunkHeader::MAX_NAME;
/// How much of the file is looked at in one go for the next chunk.
const SCAN_WINDOW: usize = 1 << 16;

impl<R: Read + Seek> RecordReader<R> {
    pub(super) fn read_chunk(&mut self, length: u64, left: u64) -> io::Result<()> {
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
        let length = if padded.contains(&length) {
            length
        } else {
            claimed
        };
        if length > LIMIT || header.uncompressed_size > LIMIT {
            self.note(DamageKind::TooLarge {
                opcode: CHUNK,
                length: length.max(header.uncompressed_size),
            });
            self.belief.suspect_from = Some(self.offset);
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
        let name = ChunkHeader::name_length(&self.body)
            .filter(|name| *name <= ChunkHeader::MAX_NAME as u64);
        let Some(name) = name else { return Ok(None) };
        self.read_more(name.min(left.saturating_sub(ChunkHeader::MIN_LENGTH as u64)))?;
        Ok(ChunkHeader::parse(&self.body))
    }

    /// Unpacks the chunk in `body`; its records are there to be read only when it is right.
    fn open_chunk(&mut self, header: &ChunkHeader) {
        let (saved, expected) = (header.uncompressed_crc, header.uncompressed_size);
        let unpacked = self.unpacker.unpack(
            &header.compression,
            packed(&self.body, header),
            expected,
            &mut self.chunk,
        );
        let got = self.chunk.len() as u64;
        let calculated = if saved == 0 {
            0
        } else {
            crc32fast::hash(&self.chunk)
        };
        // What follows is believed only when it looks right: a byte too many or too few shifts all.
        self.belief.suspect_from = Some(self.offset);
        if unpacked == Unpacked::Unsupported {
            self.note(DamageKind::Compression {
                name: header.compression.clone(),
            });
        } else if unpacked == Unpacked::Partly || got != expected {
            self.note(DamageKind::ChunkContent {
                compression: header.compression.clone(),
                expected,
                got,
            });
        } else if calculated != saved {
            self.note(DamageKind::ChunkCrc { saved, calculated });
        } else {
            self.in_chunk = 0..self.chunk.len();
            self.belief.suspect_from = None;
        }
    }

    /// The chunk at the end of a file that was cut, or that was being written: gives the whole records in it.
    fn read_cut_chunk(&mut self, header: &ChunkHeader, left: u64) -> io::Result<()> {
        if let Some(found) = self.find_next(self.offset + 1)? {
            return self.skip_garbage(found);
        }
        self.seek_to(self.offset + FRAME)?;
        self.read_body(left.min(LIMIT))?;
        self.unpacker.unpack(
            &header.compression,
            packed(&self.body, header),
            LIMIT,
            &mut self.chunk,
        );
        let whole = whole_records(&self.chunk);
        self.end(DamageKind::Truncated {
            opcode: CHUNK,
            left: left + FRAME,
            messages: whole.messages,
        });
        self.in_chunk = 0..whole.end;
        Ok(())
    }

    /// Looks for the next chunk or metadata behind a place that is no record.
    pub(super) fn resync(&mut self) -> io::Result<()> {
        self.resync_from(self.offset + 1)
    }

    /// As [`Self::resync`], from a place that may lie before: inside of a damaged chunk, which may be longer than it is.
    pub(super) fn resync_from(&mut self, from: u64) -> io::Result<()> {
        match self.find_next(from)? {
            Some(found) => self.skip_garbage(found),
            None => {
                self.end(DamageKind::Garbage {
                    skipped: self.length - self.offset,
                });
                Ok(())
            }
        }
    }

    pub(super) fn skip_garbage(&mut self, to: u64) -> io::Result<()> {
        if to > self.offset {
            self.note(DamageKind::Garbage {
                skipped: to - self.offset,
            });
        }
        self.belief.suspect_from = None;
        self.seek_to(to)
    }

    /// Where the next chunk or metadata record at or behind `from` begins, judged by its header: behind the last chunk stands the
    /// account of all streams.
    pub(super) fn find_next(&mut self, from: u64) -> io::Result<Option<u64>> {
        let overlap = CHUNK_START;
        let mut start = from;
        while start < self.length {
            self.seek_to(start)?;
            self.read_body((SCAN_WINDOW as u64).min(self.length - start))?;
            let found = (0..self.body.len()).find(|at| {
                let left = self.length - start - *at as u64;
                self.body.get(*at..).is_some_and(|bytes| {
                    looks_like_chunk(bytes, left) || looks_like_metadata(bytes, left)
                })
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

    /// A record that claims to go on behind the end of the file: cut there, or its length is wrong.
    pub(super) fn cut_record(&mut self, opcode: u8, left: u64) -> io::Result<()> {
        match self.find_next(self.offset + 1)? {
            Some(found) => self.skip_garbage(found),
            None => {
                self.end(DamageKind::Truncated {
                    opcode,
                    left: left + FRAME,
                    messages: 0,
                });
                Ok(())
            }
        }
    }
}

/// The packed records of a chunk record, as far as they are there.
fn packed<'a>(body: &'a [u8], header: &ChunkHeader) -> &'a [u8] {
    let start = usize::try_from(header.length).unwrap_or(usize::MAX);
    let rest = body.get(start..).unwrap_or_default();
    usize::try_from(header.compressed_size)
        .ok()
        .and_then(|size| rest.get(..size))
        .unwrap_or(rest)
}

struct Whole {
    messages: u64,
    end: usize,
}

/// How far whole records reach in the content of a cut chunk.
fn whole_records(content: &[u8]) -> Whole {
    let mut whole = Whole {
        messages: 0,
        end: 0,
    };
    while let Some((opcode, length)) = content.get(whole.end..).and_then(frame) {
        let end = usize::try_from(length)
            .ok()
            .and_then(|length| whole.end.checked_add(9)?.checked_add(length));
        match end.filter(|end| *end <= content.len() && opcode != 0) {
            Some(end) => whole.end = end,
            None => break,
        }
        whole.messages += u64::from(opcode == MESSAGE);
    }
    whole
}

/// Whether a chunk record begins here of which `left` bytes can be in the file.
pub(super) fn looks_like_chunk(bytes: &[u8], left: u64) -> bool {
    let Some((CHUNK, length)) = frame(bytes) else {
        return false;
    };
    let Some(header) = bytes.get(9..).and_then(ChunkHeader::parse) else {
        return false;
    };
    ["", "zstd", "lz4"].contains(&header.compression.as_str())
        && header.start_time <= header.end_time
        && header.length.checked_add(header.compressed_size) == Some(length)
        && left.checked_sub(FRAME).is_some_and(|left| length <= left)
        && header.uncompressed_size <= LIMIT
}

/// Whether a metadata record begins here, of which all is in the `left` bytes of the file, and whose lengths fit each other.
fn looks_like_metadata(bytes: &[u8], left: u64) -> bool {
    let Some((METADATA, length)) = frame(bytes) else {
        return false;
    };
    let word = |at: usize| {
        let word = bytes.get(at..)?.first_chunk()?;
        Some(u32::from_le_bytes(*word))
    };
    let name = word(9).and_then(|length| usize::try_from(length).ok());
    let name = name.filter(|length| (1..=ChunkHeader::MAX_NAME).contains(length));
    let Some(name) = name.and_then(|length| bytes.get(13..13 + length)) else {
        return false;
    };
    let map = word(13 + name.len()).map(u64::from);
    name.iter().all(u8::is_ascii_graphic)
        && map.is_some_and(|map| 8 + name.len() as u64 + map == length)
        && left.checked_sub(FRAME).is_some_and(|left| length <= left)
}
