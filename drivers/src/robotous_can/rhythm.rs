//! When samples are due, by the first halves that came.

use std::time::Duration;

use ft_wire::HostTime;

/// Gaps from which the period is taken: an odd number, so that the median is one of them.
const GAPS: usize = 15;

/// The period of a stream as the median of the gaps between its first halves: lost, late and crowded ones do not move it.
#[derive(Debug, Default)]
pub(super) struct Rhythm {
    gaps: [Duration; GAPS],
    known: usize,
    next: usize,
    last: Option<HostTime>,
}

impl Rhythm {
    /// A first half came.
    pub(super) fn beat(&mut self, at: HostTime) {
        let Some(last) = self.last.replace(at) else {
            return;
        };
        if let Some(slot) = self.gaps.get_mut(self.next) {
            *slot = at.saturating_since(last);
        }
        self.next = (self.next + 1) % GAPS;
        self.known = GAPS.min(self.known + 1);
    }

    /// Time between two samples; `None` before the second one.
    pub(super) fn period(&self) -> Option<Duration> {
        let mut gaps = self.gaps;
        let gaps = gaps.get_mut(..self.known)?;
        gaps.sort_unstable();
        gaps.get(gaps.len() / 2).copied()
    }

    /// The stream was lost: the next one may have another period.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_and_late_samples_do_not_move_the_period() {
        let mut rhythm = Rhythm::default();
        assert_eq!(rhythm.period(), None);
        // Every fifth is lost, every seventh is half a period late.
        for sample in (0_i64..40).filter(|sample| sample % 5 != 0) {
            let late = if sample % 7 == 0 { 500_000 } else { 0 };
            rhythm.beat(HostTime::from_nanos(sample * 1_000_000 + late));
        }
        assert_eq!(rhythm.period(), Some(Duration::from_millis(1)));
        rhythm.forget();
        assert_eq!(rhythm.period(), None);
    }
}
