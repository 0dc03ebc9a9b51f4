//! Frames out of chunks: a fixed buffer, a lock on frame boundaries, and a search when the lock is lost.

use ft_wire::{Chunk, DecodeError, Parsed};

/// Room for one chunk behind the longest frame that may still be incomplete.
const ROOM: usize = Chunk::CAPACITY + 128;

/// Assembles frames of a byte stream across chunks.
///
/// Locked: a frame ended right here, so what follows must be a frame; when it is not, one frame is counted as refused
/// and the search begins. Searching: bytes are skipped one by one until a whole frame with a right check sum comes.
#[derive(Debug)]
pub(crate) struct Framer {
    bytes: [u8; ROOM],
    start: usize,
    end: usize,
    locked: bool,
    counting: bool,
    /// Bytes skipped since the newest frame, and frames that went with those before it.
    passed: usize,
    missing: u64,
    pub(crate) refused: u64,
    pub(crate) skipped: u64,
}

/// What the framer found next.
#[derive(Debug, PartialEq)]
pub(crate) enum Found<T> {
    /// A whole frame.
    Frame(T),
    /// Where a frame should have begun, there was none.
    Refused(DecodeError),
    /// Nothing more in the bytes so far.
    Nothing,
}

impl Framer {
    pub(crate) const fn new() -> Self {
        Self {
            bytes: [0; ROOM],
            start: 0,
            end: 0,
            locked: false,
            counting: false,
            passed: 0,
            missing: 0,
            refused: 0,
            skipped: 0,
        }
    }

    /// Appends what a link delivered. Every byte that `next` can use up must have been used up before.
    pub(crate) fn push(&mut self, chunk: &Chunk) {
        self.bytes.copy_within(self.start..self.end, 0);
        self.end -= self.start;
        self.start = 0;
        let free = self.bytes.get_mut(self.end..).unwrap_or_default();
        for (slot, byte) in free.iter_mut().zip(chunk.as_slice()) {
            *slot = *byte;
            self.end += 1;
        }
    }

    /// Forgets the bytes so far and the lock; the counters stay.
    pub(crate) fn clear(&mut self) {
        (self.start, self.end, self.locked, self.counting) = (0, 0, false, false);
        (self.passed, self.missing) = (0, 0);
    }

    /// How many frames the bytes were that were skipped before the newest: of parts of frames, each counts.
    pub(crate) const fn take_missing(&mut self) -> u64 {
        core::mem::replace(&mut self.missing, 0)
    }

    /// Gives up the bytes so far as skipped; lock and counters stay.
    pub(crate) fn discard(&mut self) {
        let left = u64::try_from(self.end - self.start).unwrap_or(0);
        self.skipped += if self.counting { left } else { 0 };
        (self.start, self.end) = (0, 0);
    }

    /// What follows need not be a frame: a search from here is no refused frame.
    pub(crate) const fn unlock(&mut self) {
        self.locked = false;
    }

    /// From now on skipped bytes count: the stream has begun.
    pub(crate) const fn begin_counting(&mut self) {
        self.counting = true;
    }

    /// The next frame; bytes that belong to none go to `skipped`.
    pub(crate) fn next<T>(
        &mut self,
        decode: impl Fn(&[u8]) -> Result<Parsed<T>, DecodeError>,
        skipped: impl FnMut(u8),
    ) -> Found<T> {
        self.next_by_lock(|bytes, _| decode(bytes), skipped)
    }

    /// As [`Framer::next`], for frames that prove little by themselves: `decode` is told whether a frame ended right here.
    pub(crate) fn next_by_lock<T>(
        &mut self,
        decode: impl Fn(&[u8], bool) -> Result<Parsed<T>, DecodeError>,
        mut skipped: impl FnMut(u8),
    ) -> Found<T> {
        loop {
            let rest = self.bytes.get(self.start..self.end).unwrap_or_default();
            match decode(rest, self.locked) {
                Ok(Parsed::Complete { value, used }) => {
                    self.start = (self.start + used).min(self.end);
                    self.locked = true;
                    let missing = frames_in(core::mem::take(&mut self.passed), used);
                    self.missing += u64::try_from(missing).unwrap_or(0);
                    return Found::Frame(value);
                }
                Ok(Parsed::Incomplete) => return Found::Nothing,
                Err(error) => {
                    let Some(byte) = rest.first() else {
                        return Found::Nothing;
                    };
                    skipped(*byte);
                    self.start += 1;
                    self.skipped += u64::from(self.counting);
                    self.passed += usize::from(self.counting);
                    if core::mem::take(&mut self.locked) && self.counting {
                        self.refused += 1;
                        return Found::Refused(error);
                    }
                }
            }
        }
    }
}

/// How many frames of `used` bytes so many skipped bytes were: what is lost of frames is lost in one piece, so that up to a quarter more
/// is noise. A single byte is noise, too.
const fn frames_in(passed: usize, used: usize) -> usize {
    match passed.saturating_sub(used / 4) {
        0 => (passed > 1) as usize,
        rest if used > 0 => rest.div_ceil(used),
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_frames_count_as_frames() {
        // Whole; cut; with a few bytes of noise; noise alone.
        for (passed, frames) in [(28, 1), (8, 1), (27, 1), (33, 1), (2, 1), (1, 0), (0, 0)] {
            assert_eq!(frames_in(passed, 28), frames, "{passed}");
        }
        // A piece of 14 bytes of two neighbours.
        assert_eq!(frames_in(26, 20), 2);
        assert_eq!(frames_in(84, 28), 3);
    }

    /// Two bytes: 0x7E, then any value below 0x80.
    fn decode(bytes: &[u8]) -> Result<Parsed<u8>, DecodeError> {
        match bytes {
            [] | [0x7E] => Ok(Parsed::Incomplete),
            [0x7E, value, ..] if *value < 0x80 => Ok(Parsed::Complete {
                value: *value,
                used: 2,
            }),
            [first, ..] => Err(DecodeError::Field {
                name: "first",
                value: (*first).into(),
            }),
        }
    }

    fn run(framer: &mut Framer, bytes: &[u8]) -> (Vec<u8>, usize) {
        framer.push(&Chunk::new(bytes).unwrap());
        let (mut frames, mut refused) = (Vec::new(), 0);
        loop {
            match framer.next(decode, |_| ()) {
                Found::Frame(value) => frames.push(value),
                Found::Refused(_) => refused += 1,
                Found::Nothing => return (frames, refused),
            }
        }
    }

    #[test]
    fn frames_join_across_chunks() {
        let mut framer = Framer::new();
        assert_eq!(run(&mut framer, &[0x7E]), (vec![], 0));
        assert_eq!(run(&mut framer, &[1, 0x7E, 2, 0x7E]), (vec![1, 2], 0));
        assert_eq!(run(&mut framer, &[3]), (vec![3], 0));
    }

    #[test]
    fn one_broken_frame_counts_once_however_long_the_search_is() {
        let mut framer = Framer::new();
        framer.begin_counting();
        assert_eq!(
            run(&mut framer, &[0x7E, 1, 0x7E, 0x90, 0, 0, 0, 0x7E, 2]),
            (vec![1, 2], 1)
        );
        assert_eq!((framer.refused, framer.skipped), (1, 5));
    }

    #[test]
    fn frames_that_went_with_skipped_bytes_are_told_and_stray_bytes_are_none() {
        let mut framer = Framer::new();
        framer.begin_counting();
        // Four bytes of two frames, then one that was lost to its neighbour, then none.
        for (bytes, missing) in [
            (&[0x7E, 1, 0x7E, 0x90, 0x7E, 0x91, 0x7E, 2][..], 2),
            (&[0x7E, 3, 0x7E], 0),
            (&[0x95, 0x7E, 4, 0x7E, 5], 1),
        ] {
            assert_eq!(run(&mut framer, bytes).1, usize::from(missing > 0));
            assert_eq!(framer.take_missing(), missing, "{bytes:?}");
        }
    }

    #[test]
    fn bytes_before_the_first_frame_are_no_refused_frame() {
        let mut framer = Framer::new();
        framer.begin_counting();
        assert_eq!(run(&mut framer, &[9, 9, 0x7E, 1]), (vec![1], 0));
        assert_eq!((framer.refused, framer.skipped), (0, 2));
    }

    #[test]
    fn the_buffer_takes_full_chunks_for_ever() {
        let mut framer = Framer::new();
        let mut chunk = vec![0x7E];
        chunk.extend([5, 0x7E].repeat(127));
        chunk.push(5);
        for _ in 0..10 {
            assert_eq!(run(&mut framer, &chunk).0.len(), 128);
        }
    }
}
