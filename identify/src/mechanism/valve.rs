//! What a damper's valve makes of the pressure that the oil would build up if it flowed in proportion.
//!
//! Straight through until it bends: a relief valve opens at a pressure and lets the rest flow more easily; an orifice
//! chokes. A valve is one for all coordinates, so what a fast stroke shows of it at one place holds at all others.

use serde::{Deserialize, Serialize};

/// Where a valve's line changes its slope.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bend {
    /// Effort at which it bends, N m or N.
    pub at: f64,
    /// Effort per effort from there on; 1 before the first bend, never negative.
    pub slope: f64,
}

/// A piecewise straight line from zero, at first of slope 1.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Valve {
    /// Ascending.
    pub bends: Vec<Bend>,
}

impl Valve {
    /// Whether it does nothing.
    #[must_use]
    pub fn is_straight(&self) -> bool {
        self.bends.is_empty()
    }

    /// The effort at the proportional effort `u` >= 0.
    #[must_use]
    pub fn effort(&self, u: f64) -> f64 {
        let mut slope = 1.0;
        let mut out = u;
        for bend in &self.bends {
            out += (bend.slope - slope) * (u - bend.at).max(0.0);
            slope = bend.slope;
        }
        out
    }

    /// Its slope at `u`.
    #[must_use]
    pub fn slope(&self, u: f64) -> f64 {
        let passed = self.bends.iter().take_while(|bend| u > bend.at);
        passed.last().map_or(1.0, |bend| bend.slope)
    }

    /// Change of the effort at `u` per change of each bend's place and of each bend's slope.
    pub(crate) fn by_bends(&self, u: f64) -> impl Iterator<Item = [f64; 2]> {
        self.bends.iter().enumerate().map(move |(j, bend)| {
            let before = if j == 0 { 1.0 } else { self.bends[j - 1].slope };
            let next = self.bends.get(j + 1).map_or(f64::INFINITY, |b| b.at);
            if u <= bend.at {
                return [0.0, 0.0];
            }
            [before - bend.slope, (u.min(next) - bend.at).max(0.0)]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn relief() -> Valve {
        let bend = |at, slope| Bend { at, slope };
        Valve {
            bends: vec![bend(10.0, 0.2), bend(20.0, 0.5)],
        }
    }

    #[test]
    fn a_valve_is_straight_until_it_bends() {
        let valve = relief();
        for (u, effort, slope) in [
            (0.0, 0.0, 1.0),
            (10.0, 10.0, 1.0),
            (15.0, 11.0, 0.2),
            (24.0, 14.0, 0.5),
        ] {
            assert!((valve.effort(u) - effort).abs() < 1e-12);
            assert!((valve.slope(u) - slope).abs() < 1e-12);
        }
        assert!(Valve::default().is_straight());
    }

    #[test]
    fn the_derivatives_are_those_of_the_effort() {
        let valve = relief();
        for u in [5.0, 13.0, 19.0, 31.0] {
            for (j, [by_place, by_slope]) in valve.by_bends(u).enumerate() {
                let changed = |place: f64, slope: f64| {
                    let mut other = valve.clone();
                    other.bends[j].at += place;
                    other.bends[j].slope += slope;
                    (other.effort(u) - valve.effort(u)) * 1e6
                };
                assert!((changed(1e-6, 0.0) - by_place).abs() < 1e-4, "{u} {j}");
                assert!((changed(0.0, 1e-6) - by_slope).abs() < 1e-4, "{u} {j}");
            }
        }
    }
}
