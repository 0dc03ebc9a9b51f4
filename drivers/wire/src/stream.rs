//! Frames in byte streams: what a parser answers, and a piece of a stream as a link hands it over.

/// What a parser found at the start of the bytes it was given.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Parsed<T> {
    /// A whole frame.
    Complete {
        /// What it says.
        value: T,
        /// Bytes it took.
        used: usize,
    },
    /// A frame that may still become whole: come again with more bytes.
    Incomplete,
}

/// At most [`Chunk::CAPACITY`] bytes of a stream, as one read delivered them; no heap.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Chunk {
    bytes: [u8; Self::CAPACITY],
    len: usize,
}

impl Chunk {
    /// The most bytes that one chunk carries.
    pub const CAPACITY: usize = 256;

    /// A chunk of the first bytes of `bytes`, and how many it took.
    #[must_use]
    pub fn take_from(bytes: &[u8]) -> (Self, usize) {
        let mut chunk = Self::default();
        let mut taken = 0;
        for (slot, byte) in chunk.bytes.iter_mut().zip(bytes) {
            *slot = *byte;
            taken += 1;
        }
        chunk.len = taken;
        (chunk, taken)
    }

    /// A chunk of all of `bytes`, or `None` when they are more than fit.
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        let (chunk, taken) = Self::take_from(bytes);
        (taken == bytes.len()).then_some(chunk)
    }

    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }
}

impl Default for Chunk {
    fn default() -> Self {
        Self {
            bytes: [0; Self::CAPACITY],
            len: 0,
        }
    }
}

impl core::fmt::Debug for Chunk {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("Chunk").field(&self.as_slice()).finish()
    }
}
