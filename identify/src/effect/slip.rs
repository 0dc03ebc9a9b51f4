//! Pads that slide on the handle: the tool jumps against the object, at instants that the pose across the path shows.

use super::library::{Belongs, Kind, Search, Unit, Variable};
use crate::motion::{Motion, Slip};
use crate::samples::{extrema, quantile};

/// At most so many instants are reported.
const MOST: usize = 5;
/// Seconds left out about an instant, and taken on either side of it.
const APART_S: f64 = 0.06;
const SIDE_S: f64 = 0.06;
/// A jump is so many times what the path usually does in that time, and this share of the range.
const LEAST: f64 = 6.5;
const LEAST_WAY: f64 = 0.002;
/// Two jumps are so far apart, s.
const BETWEEN_S: f64 = 0.3;
/// How long before and after an instant the tool is taken to slide, s.
const SLIDES_S: f64 = 0.15;
/// What jumps for more than this share of the time is no hand that slips.
const MOST_OF_TIME: f64 = 0.15;
/// The time of an instant that is not there.
const NONE: f64 = -1.0;

/// The tool's motion is not the object's while the pads slide: those samples are left out of every fit. The instants come from the
/// pose across the path, where nothing else jumps; how far the tool slid along the path is not seen.
pub const SLIP: Kind = Kind {
    name: "slip",
    belongs: Belongs::Recording,
    terms: &[],
    shape: &[
        ("count", Unit::One, Search::Fixed),
        ("across", Unit::Position, Search::Fixed),
        ("at_1", Unit::Time, Search::Fixed),
        ("at_2", Unit::Time, Search::Fixed),
        ("at_3", Unit::Time, Search::Fixed),
        ("at_4", Unit::Time, Search::Fixed),
        ("at_5", Unit::Time, Search::Fixed),
    ],
    variable: Variable::Time,
    grid: |_| Vec::new(),
    series: |_, _| Vec::new(),
    at: None,
    separate: "a mark on the handle beside the pads, or a firmer grasp",
};

/// How many, how far across the path the farthest went, and when the first ones were.
pub(crate) fn shape(slips: &[Slip]) -> Vec<f64> {
    let farthest = slips.iter().map(|slip| slip.across).fold(0.0, f64::max);
    let mut out = vec![slips.len() as f64, farthest];
    out.extend(slips.iter().map(|slip| slip.at).take(MOST));
    out.resize(2 + MOST, NONE);
    out
}

/// Whether the tool slides on the handle at `t`, s.
pub(crate) fn slides(slips: &[Slip], t: f64) -> bool {
    slips.iter().any(|slip| (t - slip.at).abs() < SLIDES_S)
}

/// The jumps of the pose across the path, `beside` it, in the order of their time.
pub(crate) fn jumps(motion: &Motion, beside: &[Vec<f64>]) -> Vec<Slip> {
    let count = motion.time.len();
    let mut ways = vec![0.0; count];
    let mut sizes = vec![0.0; count];
    for series in beside {
        let steps = differences(motion, series);
        let usual: Vec<f64> = steps.iter().map(|v| v.abs()).filter(|v| *v > 0.0).collect();
        let usual = quantile(&usual, 0.5).max(1e-12) / 0.6745;
        for ((way, size), step) in ways.iter_mut().zip(&mut sizes).zip(&steps) {
            *way = f64::hypot(*way, *step);
            *size = f64::hypot(*size, step / usual);
        }
    }
    let (low, high) = extrema(&motion.q);
    let jumps = |i: &usize| sizes[*i] > LEAST && ways[*i] > LEAST_WAY * (high - low);
    let apart = (BETWEEN_S / motion.period) as usize;
    let mut order: Vec<usize> = (0..count).filter(jumps).collect();
    order.sort_by(|&a, &b| sizes[b].total_cmp(&sizes[a]));
    let mut taken: Vec<usize> = Vec::new();
    for i in order {
        if taken.iter().all(|j| i.abs_diff(*j) > apart) {
            taken.push(i);
        }
    }
    if 2.0 * SLIDES_S * taken.len() as f64 > MOST_OF_TIME * count as f64 * motion.period {
        return Vec::new();
    }
    taken.sort_unstable();
    // The size stands level while the jump lies within the gap: the middle of it is the instant.
    let reach = ((APART_S + SIDE_S) / motion.period) as usize;
    let slip = |i: usize| {
        let near = i.saturating_sub(reach)..(i + reach + 1).min(count);
        let total: f64 = sizes[near.clone()].iter().sum();
        Slip {
            at: near.map(|k| sizes[k] / total * motion.time[k]).sum(),
            across: ways[i],
        }
    };
    taken.into_iter().map(slip).collect()
}

/// Mean behind each sample less mean before it; zero near the ends of a run.
fn differences(motion: &Motion, series: &[f64]) -> Vec<f64> {
    let (gap, side) = (
        (APART_S / motion.period) as usize,
        ((SIDE_S / motion.period) as usize).max(1),
    );
    let mut out = vec![0.0; series.len()];
    for run in &motion.runs {
        let mut sums = vec![0.0];
        for value in &series[run.clone()] {
            sums.push(sums.last().copied().unwrap_or(0.0) + value);
        }
        for i in gap + side..run.len().saturating_sub(gap + side) {
            let after = sums[i + gap + side] - sums[i + gap];
            let before = sums[i - gap] - sums[i - gap - side];
            out[run.start + i] = (after - before) / side as f64;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::MotionSettings;
    use crate::samples::JointSamples;
    use crate::screw::JointKind;

    #[test]
    fn jumps_of_the_pose_across_the_path_are_found_and_its_wander_is_not() {
        let time: Vec<f64> = (0..6000).map(|i| 0.005 * f64::from(i)).collect();
        let wander = |t: &f64| 0.001 * (0.9 * t).sin() + 0.0002 * (131.0 * t).sin();
        let samples = |across: Vec<f64>| JointSamples {
            kind: JointKind::Prismatic,
            period: 0.005,
            runs: vec![0..6000],
            q: time.iter().map(|t| 0.2 - 0.2 * (1.3 * t).cos()).collect(),
            tau: time.iter().map(|t| (1.3 * t).cos()).collect(),
            noise_of_q: vec![across],
            aside: crate::samples::Aside::default(),
            time: time.clone(),
        };
        let found = |across| {
            let motion = Motion::prepare(&samples(across), &MotionSettings::default()).unwrap();
            motion.slips
        };
        assert!(found(time.iter().map(wander).collect()).is_empty());
        let jumped = |t: &f64| wander(t) + if *t > 11.0 { 0.006 } else { 0.0 };
        let at = found(time.iter().map(jumped).collect());
        assert_eq!(at.len(), 1, "{at:?}");
        assert!((at[0].at - 11.0).abs() < 0.03, "{at:?}");
        assert!((at[0].across - 0.006).abs() < 0.001, "{at:?}");
    }
}
