//! Fields out of bytes, without indexing: a short slice is `None`, never a panic.

/// The `N` bytes at `at`.
pub(crate) fn field<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..)?.first_chunk().copied()
}

/// Writes fields one after another into an array of known length.
#[derive(Debug)]
pub(crate) struct Layout<const N: usize> {
    bytes: [u8; N],
    len: usize,
}

impl<const N: usize> Layout<N> {
    pub(crate) const fn new() -> Self {
        Self {
            bytes: [0; N],
            len: 0,
        }
    }

    /// Appends `field`; what does not fit is left out.
    pub(crate) fn put(&mut self, field: &[u8]) -> &mut Self {
        let free = self.bytes.get_mut(self.len..).unwrap_or_default();
        for (slot, byte) in free.iter_mut().zip(field) {
            *slot = *byte;
            self.len += 1;
        }
        self
    }

    pub(crate) fn so_far(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or_default()
    }

    pub(crate) const fn finish(&self) -> [u8; N] {
        self.bytes
    }
}
