//! The line between two clocks, from pairs of their readings that may stand still, be missing or be wrong.

use ft_recording::recording::steps;

/// `to = from + offset + skew (from - reference)`, ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockMap {
    /// Reading of the first clock at which `offset_ns` holds.
    pub reference_ns: i64,
    /// Second clock minus first at the reference.
    pub offset_ns: i64,
    /// How much faster the second clock runs, parts of one.
    pub skew: f64,
    /// Pairs that the line goes through.
    pub used: usize,
    /// Root mean square of what the line leaves, ns.
    pub rms_ns: f64,
}

/// Two clocks of crystals do not differ by more, parts of one.
const MAX_SKEW: f64 = 500e-6;
/// A skew needs this time to show, ns.
const SKEW_NEEDS_NS: i64 = 5_000_000_000;
const ROUNDS: usize = 8;

impl ClockMap {
    /// The second clock's reading at the first clock's `from`.
    #[must_use]
    #[allow(
        clippy::cast_possible_truncation,
        reason = "a float to integer `as` saturates"
    )]
    pub fn at(&self, from: i64) -> i64 {
        let drift = self.skew * from.saturating_sub(self.reference_ns) as f64;
        from.saturating_add(self.offset_ns)
            .saturating_add(drift.round() as i64)
    }

    /// The line through `pairs` (first clock, second clock), in order of the first. A second clock that stands still in
    /// between (a staircase) is true where it steps: only pairs whose reading differs from the one before count, unless
    /// the very first two differ already. Wrong pairs are left out by their residual. `None` with fewer than two pairs
    /// or without a single step.
    #[must_use]
    pub fn through(pairs: &[(i64, i64)]) -> Option<Self> {
        let edges = edges(pairs);
        let &(reference_ns, _) = edges.first()?;
        let points: Vec<(f64, f64)> = {
            let base = median(edges.iter().map(|(from, to)| (to - from) as f64).collect())?;
            edges
                .iter()
                .map(|(from, to)| ((from - reference_ns) as f64, (to - from) as f64 - base))
                .collect()
        };
        let base = median(edges.iter().map(|(from, to)| (to - from) as f64).collect())?;
        let span = edges.last()?.0 - reference_ns;
        let mut keep = vec![true; points.len()];
        let mut line = (0.0, 0.0);
        for _ in 0..ROUNDS {
            line = fit(&points, &keep, span >= SKEW_NEEDS_NS);
            let residuals: Vec<f64> = points
                .iter()
                .map(|(x, y)| y - line.0 - line.1 * x)
                .collect();
            let spread = 1.4826 * median(residuals.iter().map(|r| r.abs()).collect())?;
            let limit = (4.0 * spread).max(1e3);
            let next: Vec<bool> = residuals.iter().map(|r| r.abs() <= limit).collect();
            if next == keep {
                break;
            }
            keep = next;
        }
        let left: Vec<f64> = points
            .iter()
            .zip(&keep)
            .filter(|(_, keep)| **keep)
            .map(|((x, y), _)| (y - line.0 - line.1 * x).powi(2))
            .collect();
        #[allow(
            clippy::cast_possible_truncation,
            reason = "a float to integer `as` saturates"
        )]
        let offset_ns = (base + line.0).round() as i64;
        Some(Self {
            reference_ns,
            offset_ns,
            skew: line.1,
            used: left.len(),
            rms_ns: (left.iter().sum::<f64>() / left.len().max(1) as f64).sqrt(),
        })
    }
}

/// The pairs at which the second clock has just stepped.
fn edges(pairs: &[(i64, i64)]) -> Vec<(i64, i64)> {
    steps(pairs, |a, b| a.1 == b.1).map(|i| pairs[i]).collect()
}

/// Intercept and slope of least squares over what is kept.
fn fit(points: &[(f64, f64)], keep: &[bool], with_skew: bool) -> (f64, f64) {
    let kept: Vec<_> = points
        .iter()
        .zip(keep)
        .filter_map(|(point, keep)| keep.then_some(*point))
        .collect();
    let n = kept.len().max(1) as f64;
    let (mx, my) = kept
        .iter()
        .fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let sxx: f64 = kept.iter().map(|(x, _)| (x - mx).powi(2)).sum();
    let sxy: f64 = kept.iter().map(|(x, y)| (x - mx) * (y - my)).sum();
    let slope = if with_skew && sxx > 0.0 {
        (sxy / sxx).clamp(-MAX_SKEW, MAX_SKEW)
    } else {
        0.0
    };
    (my - slope * mx, slope)
}

pub(super) fn median(mut values: Vec<f64>) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let (_, value, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*value)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;
    const BOOT: i64 = 1_700_000_000_000_000_000;

    fn truth(from: i64) -> i64 {
        BOOT + from + from / 10_000
    }

    #[test]
    fn a_staircase_is_read_at_its_edges() {
        let stairs = (0..30_000_i64).map(|k| (k * MS, truth((k * MS) / (100 * MS) * (100 * MS))));
        let map = ClockMap::through(&stairs.collect::<Vec<_>>()).unwrap();
        assert!((map.skew - 1e-4).abs() < 1e-7, "{map:?}");
        for from in [0, 15_000 * MS, 29_999 * MS] {
            assert!((map.at(from) - truth(from)).abs() < 2_000, "{map:?}");
        }
    }

    #[test]
    fn wrong_readings_are_left_out() {
        let pairs = (0..10_000_i64).map(|k| {
            let wrong = if k % 17 == 0 { 3_000 * MS } else { 0 };
            (k * MS, truth(k * MS) + wrong)
        });
        let map = ClockMap::through(&pairs.collect::<Vec<_>>()).unwrap();
        assert!((map.at(5_000 * MS) - truth(5_000 * MS)).abs() < 1_000);
        assert_eq!(map.used, 10_000 - 10_000_usize.div_ceil(17));
    }

    #[test]
    fn a_clock_that_never_steps_maps_nothing() {
        assert_eq!(ClockMap::through(&[]), None);
        assert_eq!(ClockMap::through(&[(0, 5), (MS, 5), (2 * MS, 5)]), None);
    }
}
