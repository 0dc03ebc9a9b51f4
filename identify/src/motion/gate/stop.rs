//! An end stop: where the joint meets it, and what it carries.

use super::{Motion, inside, quantile};

/// The stop at one end of the range, or that end where no stop shows.
pub(super) struct Stop {
    /// 1 at the upper end, -1 at the lower.
    outwards: f64,
    /// Coordinate, outwards, from which on it is taken as touched.
    begins: f64,
    /// Effort per depth, and depth at which it begins, where it gives way that much.
    soft: Option<[f64; 2]>,
    /// Effort outwards that the joint usually and at most needs between the ends; infinite where no stop shows.
    needed: [f64; 2],
}

/// Share of the range within which an end counts as touched.
const MARGIN: f64 = 0.01;
/// Share of the range in which an end's stop is looked for.
const OUTER: f64 = 0.15;
/// Effort beyond all that is needed between the ends, as a share of that, which only a stop takes.
const BEYOND: f64 = 0.5;
/// Correlation of effort and depth above which a stop gives way.
const GIVES_WAY: f64 = 0.7;

impl Stop {
    /// The stop at an end of `range`; `blows` = samples at which one turned the joint.
    pub(super) fn find(motion: &Motion, range: [f64; 2], at_high: bool, blows: &[usize]) -> Self {
        let outwards = if at_high { 1.0 } else { -1.0 };
        let [end, middle] = [range[usize::from(at_high)], 0.5 * (range[0] + range[1])];
        let turned = blows
            .iter()
            .map(|&i| outwards * motion.q[i])
            .filter(|depth| *depth > outwards * middle);
        let innermost = turned.fold(f64::INFINITY, f64::min);
        let [least, usual, most] =
            sorted(between(motion, range, &motion.tau).map(|v| outwards * v));
        let pushes = most + BEYOND * (most - least);
        let soft = soft(
            motion,
            outwards,
            [
                outwards * end - OUTER * (range[1] - range[0]),
                pushes,
                usual,
            ],
        );
        let begins = soft.map_or(innermost, |[_, begins]| begins.min(innermost));
        Self {
            outwards,
            begins: begins.min(outwards * end) - MARGIN * (range[1] - range[0]),
            soft,
            needed: if begins.is_finite() {
                [usual, most]
            } else {
                [f64::INFINITY; 2]
            },
        }
    }

    /// Whether the joint touches it at a coordinate.
    pub(super) fn touches(&self, q: f64) -> bool {
        self.outwards * q > self.begins
    }

    /// About the effort it carries, where `tau` is applied at a coordinate: all beyond what is usual, or beyond what the joint needs
    /// at most; none where no stop shows.
    pub(super) fn carries(&self, q: f64, tau: f64, whole: bool) -> f64 {
        if !self.touches(q) {
            return 0.0;
        }
        let by_depth = self.soft.map_or(0.0, |[stiffness, begins]| {
            stiffness * (self.outwards * q - begins)
        });
        let needed = self.needed[usize::from(!whole)];
        by_depth.max(self.outwards * tau - needed).max(0.0)
    }
}

/// Nearly the least, the usual and nearly the largest value between the outer tenths of a range.
pub(super) fn between(motion: &Motion, [low, high]: [f64; 2], series: &[f64]) -> [f64; 3] {
    let outer = 0.1 * (high - low);
    let values: Vec<f64> = inside(motion, [low + outer, high - outer], series).collect();
    [0.001, 0.5, 0.999].map(|level| quantile(&values, level))
}

fn sorted(mut values: [f64; 3]) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    values
}

/// Effort per depth of a stop that gives way, and the depth at which it begins to: where the joint is pushed outwards by
/// more than `pushes` beyond depth `from`, the line through depth and effort, down to the `usual` effort. A catch that takes
/// as much is passed, so that its effort does not grow to the end.
fn soft(motion: &Motion, outwards: f64, [from, pushes, usual]: [f64; 3]) -> Option<[f64; 2]> {
    let pushed: Vec<[f64; 2]> = motion
        .q
        .iter()
        .zip(&motion.tau)
        .map(|(q, tau)| [outwards * q, outwards * tau])
        .filter(|[depth, push]| *depth > from && *push > pushes)
        .collect();
    let count = pushed.len() as f64;
    if count * motion.period < 0.05 {
        return None;
    }
    let mean = |k: usize| pushed.iter().map(|state| state[k]).sum::<f64>() / count;
    let means = [mean(0), mean(1)];
    let moment = |j: usize, k: usize| {
        let product = |state: &[f64; 2]| (state[j] - means[j]) * (state[k] - means[k]);
        pushed.iter().map(product).sum::<f64>() / count
    };
    let both = moment(0, 1);
    if both <= GIVES_WAY * (moment(0, 0) * moment(1, 1)).sqrt() {
        return None;
    }
    let stiffness = moment(1, 1) / both;
    let begins = means[0] - (means[1] - usual.min(0.0)) / stiffness;
    // What would begin farther in is a preload and no spring.
    (begins > from).then_some([stiffness, begins])
}
