//! Frames of ours that are under way: the adapter gives each one's tag back when it was acknowledged.

/// Frames under way at most; candleLight's firmware has room for more, Linux's driver keeps to as many.
const MOST: u32 = 10;

/// The tags that are out.
#[derive(Debug, Default)]
pub(super) struct Echoes {
    out: u32,
}

impl Echoes {
    /// A tag that is free; `None` when nobody acknowledges what was sent before.
    pub(super) fn take(&mut self) -> Option<u32> {
        let tag = self.out.trailing_ones();
        (tag < MOST).then(|| {
            self.out |= 1 << tag;
            tag
        })
    }

    /// A tag that came back is free again; one that was not out is nobody's.
    pub(super) fn came_back(&mut self, tag: u32) {
        if tag < MOST {
            self.out &= !(1 << tag);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_frames_without_an_answer_are_the_most() {
        let mut echoes = Echoes::default();
        let taken: Vec<_> = (0..11).map(|_| echoes.take()).collect();
        let expected: Vec<_> = (0..10).map(Some).chain([None]).collect();
        assert_eq!(taken, expected);
        echoes.came_back(4);
        echoes.came_back(10);
        echoes.came_back(u32::MAX);
        assert_eq!((echoes.take(), echoes.take()), (Some(4), None));
    }
}
