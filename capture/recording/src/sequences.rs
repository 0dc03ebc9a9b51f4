//! Gaps in a channel's sequence numbers.

/// Counts which sequence numbers of a channel did not come. Order does not matter; repetitions hide as many gaps.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sequences {
    lowest: u32,
    highest: u32,
    messages: u64,
}

impl Default for Sequences {
    fn default() -> Self {
        Self {
            lowest: u32::MAX,
            highest: 0,
            messages: 0,
        }
    }
}

impl Sequences {
    pub(crate) fn add(&mut self, sequence: u32) {
        self.lowest = self.lowest.min(sequence);
        self.highest = self.highest.max(sequence);
        self.messages += 1;
    }

    pub(crate) fn messages(&self) -> u64 {
        self.messages
    }

    /// Whether the writer counted at all; many write 0 everywhere.
    pub(crate) fn counted(&self) -> bool {
        self.highest > 0
    }

    /// Numbers that are missing up to the highest one, of a writer that counts from `start`; 0 when it is not known to, so that gaps
    /// before the first number are not seen.
    pub(crate) fn missing(&self, start: u32) -> u64 {
        if self.messages == 0 || !self.counted() {
            return 0;
        }
        let lowest = if start > 0 {
            start.min(self.lowest)
        } else {
            self.lowest
        };
        (u64::from(self.highest - lowest) + 1).saturating_sub(self.messages)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn missing(start: u32, numbers: &[u32]) -> u64 {
        let mut sequences = Sequences::default();
        numbers.iter().for_each(|number| sequences.add(*number));
        sequences.missing(start)
    }

    #[test]
    fn gaps_are_counted_in_any_order() {
        assert_eq!(missing(1, &[1, 2, 3]), 0);
        assert_eq!(missing(1, &[4, 3, 6]), 3);
        assert_eq!(missing(0, &[4, 3, 6]), 1);
        assert_eq!(missing(1, &[]), 0);
    }

    #[test]
    fn a_writer_that_does_not_count_misses_nothing() {
        assert_eq!(missing(0, &[0, 0, 0]), 0);
    }
}
