//! Where a motion goes, and how often.

use std::collections::BTreeSet;

use super::Motion;
use crate::samples::{extrema, quantile};

/// Parts of the range in which that is looked at.
const PARTS: usize = 20;
/// Friction is known where the motion goes both ways over this share of its range.
const LEAST_BOTH_WAYS: f64 = 0.15;
/// One pass is one time at each place: what time does, the place may have done. The second shows that something changed, the third
/// that it was time.
const LEAST_PASSES: usize = 3;

impl Motion {
    /// The strokes that pass each part of the range, backward and forward.
    fn passes(&self) -> [[BTreeSet<usize>; 2]; PARTS] {
        let (low, high) = extrema(&self.at_kept(&self.q));
        let mut passes: [[BTreeSet<usize>; 2]; PARTS] = Default::default();
        for &i in &self.kept {
            let part = (self.q[i] - low) / (high - low) * PARTS as f64;
            passes[(part as usize).min(PARTS - 1)][usize::from(self.dq[i] > 0.0)]
                .insert(self.stroke[i]);
        }
        passes
    }

    /// Share of the range over which the kept samples go both ways.
    pub(crate) fn both_ways(&self) -> f64 {
        let passes = self.passes();
        let both = passes
            .iter()
            .filter(|ways| ways.iter().all(|way| !way.is_empty()));
        both.count() as f64 / PARTS as f64
    }

    /// Whether there are few places over which the motion goes both ways.
    #[must_use]
    pub fn goes_one_way(&self) -> bool {
        self.both_ways() < LEAST_BOTH_WAYS
    }

    /// Whether the motion comes to the same places often enough, one way, to tell what changes with time from what changes with the
    /// place.
    #[must_use]
    pub fn shows_time(&self) -> bool {
        let most = |ways: &[BTreeSet<usize>; 2]| ways[0].len().max(ways[1].len()) as f64;
        let passes: Vec<f64> = self.passes().iter().map(most).collect();
        quantile(&passes, 0.5) >= LEAST_PASSES as f64
    }
}
