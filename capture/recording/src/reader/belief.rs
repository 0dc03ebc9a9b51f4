//! Which records are believed. One byte too many or too few shifts all that follows, and then lengths are read out of
//! anything: a record whose length may be wrong counts only when a record begins where it ends.

use std::io::{self, Read, Seek, SeekFrom};

use super::chunk_records::{CHUNK_START, looks_like_chunk};
use super::record::{
    ATTACHMENT, CHANNEL, CHUNK, DATA_END, FOOTER, HEADER, MESSAGE, MESSAGE_INDEX, METADATA, SCHEMA,
};
use super::{FRAME, MAGIC, RecordReader, frame};

/// So many records in a row are no coincidence.
const CHAIN: usize = 4;
/// Nothing of the MCAP's own is padded by more, bytes.
const MAX_PADDING: u64 = 256;

/// What the reader knows about the records that it may believe.
#[derive(Debug)]
pub(super) struct Belief {
    /// Where the damaged chunk begins that was read last; `None` behind records that look right.
    pub(super) suspect_from: Option<u64>,
    /// Whether the record before was a message outside of chunks, or what describes one.
    among_messages: bool,
    /// Whether the messages have ended and the summary has begun.
    in_summary: bool,
    /// Opcodes of others and of later versions that stood at a right place once.
    proven: [bool; 256],
    /// Bytes that may still be read a second time, so that no file takes longer than a few readings.
    again: u64,
}

impl Belief {
    pub(super) const fn new(length: u64) -> Self {
        Self {
            suspect_from: None,
            among_messages: false,
            in_summary: false,
            proven: [false; 256],
            again: length.saturating_mul(4),
        }
    }

    /// Whether a record of this opcode here has to prove that its length is right.
    fn needs_proof(&self, opcode: u8, length: u64) -> bool {
        match opcode {
            // These contradict themselves when they are none.
            HEADER | SCHEMA | CHANNEL | CHUNK | MESSAGE_INDEX | ATTACHMENT | METADATA => false,
            MESSAGE => !self.among_messages,
            DATA_END => length > 4 + MAX_PADDING,
            FOOTER => length > 20 + MAX_PADDING,
            0..=DATA_END => !self.in_summary,
            _ => !self
                .proven
                .get(usize::from(opcode))
                .is_some_and(|known| *known),
        }
    }

    /// Where to look for a chunk when the record at `position` is not believed.
    fn search_from(&mut self, position: u64) -> u64 {
        let Some(from) = self.suspect_from.map(|chunk| chunk + 1) else {
            return position + 1;
        };
        let again = position.saturating_sub(from);
        if again > self.again {
            return position;
        }
        self.again -= again;
        from
    }
}

impl<R: Read + Seek> RecordReader<R> {
    /// Whether the frame that was just read may be believed; else goes on at the next chunk. `left` bytes follow it.
    pub(super) fn believe(&mut self, opcode: u8, length: u64, left: u64) -> io::Result<bool> {
        let believed = if opcode == 0 {
            false
        } else if self.belief.suspect_from.is_some() {
            self.is_chain(self.offset)?
        } else if length <= left && self.belief.needs_proof(opcode, length) {
            self.is_chain(self.position.saturating_add(length))?
        } else {
            true
        };
        if !believed {
            let from = self.belief.search_from(self.offset);
            self.resync_from(from)?;
            return Ok(false);
        }
        self.belief.suspect_from = None;
        self.belief.among_messages = matches!(opcode, SCHEMA | CHANNEL | MESSAGE);
        self.belief.in_summary |= opcode == DATA_END;
        if let Some(proven) = self.belief.proven.get_mut(usize::from(opcode)) {
            *proven = true;
        }
        Ok(true)
    }

    /// At the end of the file: whether there is another chunk in what was read as a damaged one; goes there.
    pub(super) fn look_back(&mut self) -> io::Result<bool> {
        if self.belief.suspect_from.is_none() {
            return Ok(false);
        }
        let from = self.belief.search_from(self.offset);
        self.belief.suspect_from = None;
        let at = self.position;
        match self.find_next(from)? {
            Some(found) => self.skip_garbage(found)?,
            None => self.seek_to(at)?,
        }
        Ok(self.position != at)
    }

    /// Whether the record just read into `body`, which contradicts itself, has a right length all the same; else goes on
    /// at the next chunk.
    pub(super) fn believe_length(&mut self) -> io::Result<bool> {
        let believed = self.is_chain(self.position)?;
        if !believed {
            self.resync()?;
        }
        Ok(believed)
    }

    /// Whether records follow each other from `at` on, as far as a coincidence reaches.
    fn is_chain(&mut self, mut at: u64) -> io::Result<bool> {
        for _ in 0..CHAIN {
            if at == self.length {
                return Ok(true);
            }
            let bytes = self.peek(at)?;
            let left = self.length.saturating_sub(at);
            match link(&bytes, left) {
                Link::None => return Ok(false),
                Link::End => return Ok(true),
                Link::Next(length) => at = at.saturating_add(FRAME + length),
            }
        }
        Ok(true)
    }

    /// The bytes at another place, at most as many as a chunk's header has.
    fn peek(&mut self, at: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::with_capacity(CHUNK_START);
        self.source.seek(SeekFrom::Start(at))?;
        (&mut self.source)
            .take(CHUNK_START as u64)
            .read_to_end(&mut bytes)?;
        self.source.seek(SeekFrom::Start(self.position))?;
        Ok(bytes)
    }
}

/// What stands at a place.
enum Link {
    /// Nothing that is believed.
    None,
    /// A record that no coincidence makes.
    End,
    /// A record of this length.
    Next(u64),
}

fn link(bytes: &[u8], left: u64) -> Link {
    let Some((opcode, length)) = frame(bytes) else {
        return Link::None;
    };
    let body = bytes.get(9..).unwrap_or_default();
    let right = match opcode {
        0 => false,
        // The last one of a file that was cut may be longer.
        CHUNK if looks_like_chunk(bytes, u64::MAX) => return Link::End,
        CHUNK => false,
        MESSAGE_INDEX => is_message_index(body, length),
        DATA_END => (4..=4 + MAX_PADDING).contains(&length),
        FOOTER => {
            let magic = body.get(20..28);
            (20..=20 + MAX_PADDING).contains(&length) && (length > 20 || magic == Some(&MAGIC))
        }
        HEADER | METADATA => length >= 8,
        SCHEMA => length >= 14,
        CHANNEL => length >= 16,
        MESSAGE => length >= 22,
        ATTACHMENT => length >= 36,
        _ => true,
    };
    match left.checked_sub(FRAME) {
        Some(left) if right && length <= left && opcode == FOOTER => Link::End,
        Some(left) if right && length <= left => Link::Next(length),
        _ => Link::None,
    }
}

/// Whether a message index's own length fits its record's; `body` may end early.
pub(super) fn is_message_index(body: &[u8], length: u64) -> bool {
    let Some(&[_, _, a, b, c, d]) = body.first_chunk::<6>() else {
        return false;
    };
    let entries = u64::from(u32::from_le_bytes([a, b, c, d]));
    entries % 16 == 0 && (entries + 6..=entries + 6 + MAX_PADDING).contains(&length)
}
