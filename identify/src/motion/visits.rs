//! Where a motion goes, and how often.

use std::collections::BTreeSet;

use super::Motion;
use crate::samples::{extrema, quantile};

/// Parts of the range in which that is looked at.
const PARTS: usize = 20;
/// Friction is known where the motion goes both ways over this share of its range.
const LEAST_BOTH_WAYS: f64 = 0.15;
/// A visit to the low end comes this near to the lowest place, and has ended when the motion is twice as far away, as a share of the range.
const NEAR_LOW: f64 = 0.05;
/// One pass is one time at each place: what time does, the place may have done. The second shows that something changed, the third
/// that it was time.
const LEAST_PASSES: usize = 3;

impl Motion {
    /// The strokes to which samples in each part of the kept samples' range belong, backward and forward.
    fn passes(&self, samples: impl Iterator<Item = usize>) -> [[BTreeSet<usize>; 2]; PARTS] {
        let (low, high) = extrema(&self.at_kept(&self.q));
        let mut passes: [[BTreeSet<usize>; 2]; PARTS] = Default::default();
        let mut last = None;
        for i in samples {
            let part = (self.q[i] - low) / (high - low) * PARTS as f64;
            let here = (
                (part as usize).min(PARTS - 1),
                usize::from(self.dq[i] > 0.0),
                self.stroke[i],
            );
            if last.replace(here) != Some(here) {
                let (part, way, stroke) = here;
                passes[part][way].insert(stroke);
            }
        }
        passes
    }

    /// The lowest place of each visit to the low end.
    pub(crate) fn visits_to_the_low_end(&self) -> Vec<f64> {
        let (low, high) = extrema(&self.q);
        let near = NEAR_LOW * (high - low);
        let mut visits = Vec::new();
        let mut is_there = false;
        for q in &self.q {
            is_there &= *q < low + 2.0 * near;
            match visits.last_mut() {
                Some(lowest) if is_there => *lowest = q.min(*lowest),
                _ if *q < low + near => {
                    visits.push(*q);
                    is_there = true;
                }
                _ => {}
            }
        }
        visits
    }

    /// Share of the range over which the kept samples go both ways.
    pub(crate) fn both_ways(&self) -> f64 {
        let passes = self.passes(self.kept.iter().copied());
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
        // The kept samples of a fast stroke are farther apart than the parts.
        let moving = (0..self.q.len()).filter(|&i| self.slides[i]);
        let most = |ways: &[BTreeSet<usize>; 2]| ways[0].len().max(ways[1].len()) as f64;
        let passes: Vec<f64> = self.passes(moving).iter().map(most).collect();
        quantile(&passes, 0.5) >= LEAST_PASSES as f64
    }
}
