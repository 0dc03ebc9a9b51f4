//! Pads that slide on the handle: the tool jumps against the object, at instants that the pose across the path shows.

use super::library::{Belongs, Kind, Search, Unit, Variable};
use crate::motion::{Motion, Slip};
use crate::samples::{Slid, extrema, quantile};

/// At most so many instants are reported.
const MOST: usize = 5;
/// Seconds left out about an instant, and taken on either side of it.
const APART_S: f64 = 0.06;
const SIDE_S: f64 = 0.06;
/// A jump is so many times what the path usually does in that time, and this share of the range.
const LEAST: f64 = 6.5;
const LEAST_WAY: f64 = 0.002;
/// One of so many times is plain to see, whatever the effort says, where they do not come back: who is pushed gives and comes back.
const PLAIN: f64 = 2.0 * LEAST;
/// Two jumps are so far apart, s: gap and side reach as far as that where a slip lasts as long as slips do.
const BETWEEN_S: f64 = 0.22;
/// A slip takes about twice that, s.
const GOES_S: f64 = 0.05;
/// How long before and after an instant the tool is taken to slide, s.
pub(crate) const SLIDES_S: f64 = 0.15;
/// Jumps of which more than half lie so near a turn, s, and that come back to within this share of the way that they went together
/// are how the grasp gives, and no slips; so many it takes to tell.
const TURNS_S: f64 = 0.25;
const BACK: f64 = 0.3;
const SOME: usize = 4;
/// The time of an instant that is not there.
const NONE: f64 = -1.0;

/// The tool's motion is not the object's while the pads slide: those samples are left out of every fit. The instants come from the
/// pose across the path, where nothing else jumps, and from pulses of the effort; how far the tool slid along the path is told by how much springs and
/// catches seem to have moved, and not at all without them.
pub const SLIP: Kind = Kind {
    name: "slip",
    belongs: Belongs::Recording,
    equation: "the tool slid on the handle at the times at_1 ..., by across, across the path, and by along, along it",
    terms: &[],
    shape: &[
        ("count", Unit::One, Search::Fixed),
        ("across", Unit::Position, Search::Fixed),
        ("along", Unit::Position, Search::Fixed),
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
    separate: "a mark on the handle beside the pads, or a firmer grasp; a tracker that found its place anew looks the same",
};

/// How many, how far across the path and along it the farthest went, and when the first ones were.
pub(crate) fn shape(slips: &[Slip]) -> Vec<f64> {
    let farthest = slips.iter().map(|slip| slip.across).fold(0.0, f64::max);
    let along = |far: f64, slip: &Slip| {
        if slip.along.abs() > far.abs() {
            slip.along
        } else {
            far
        }
    };
    let along = slips.iter().fold(0.0, along);
    let mut out = vec![slips.len() as f64, farthest, along];
    out.extend(slips.iter().map(|slip| slip.at).take(MOST));
    out.resize(3 + MOST, NONE);
    out
}

/// Whether the tool slides on the handle at `t`, s.
pub(crate) fn slides(slips: &[Slip], t: f64) -> bool {
    slips.iter().any(|slip| (t - slip.at).abs() < SLIDES_S)
}

/// Share of a slip's way that is gone `t` after its instant, s.
pub(crate) fn gone(t: f64) -> f64 {
    (0.5 + t / (2.0 * GOES_S)).clamp(0.0, 1.0)
}

/// Whether two instants are of one slip.
pub(crate) fn is_one(at: f64, other: f64) -> bool {
    (at - other).abs() < BETWEEN_S
}

/// Whether the joint turns near sample `i` of the motion.
pub(crate) fn turns_near(motion: &Motion, i: usize) -> bool {
    let near = (TURNS_S / motion.period) as usize;
    let around = i.saturating_sub(near)..(i + near).min(motion.turning.len());
    let turning = &motion.turning[around];
    turning.windows(2).any(|pair| pair[0] * pair[1] <= 0.0)
}

/// The jumps of the pose across the path, and the instants at which the effort shows that it slid along it, in the order of their time.
pub(crate) fn all(motion: &Motion, beside: &[Vec<f64>], slid: &[Slid]) -> Vec<Slip> {
    let mut out = jumps(motion, beside);
    for slid in slid {
        match out.iter_mut().find(|slip| is_one(slip.at, slid.at)) {
            Some(slip) => slip.along += slid.along,
            None => out.push(Slip {
                at: slid.at,
                across: 0.0,
                along: slid.along,
                is_plain: false,
            }),
        }
    }
    out.sort_unstable_by(|a, b| a.at.total_cmp(&b.at));
    out
}

/// The jumps of the pose across the path, `beside` it, in the order of their time.
fn jumps(motion: &Motion, beside: &[Vec<f64>]) -> Vec<Slip> {
    let count = motion.time.len();
    let (low, high) = extrema(&motion.q);
    let mut ways = vec![0.0; count];
    let mut sizes = vec![0.0; count];
    let steps: Vec<Vec<f64>> = beside
        .iter()
        .map(|series| differences(motion, series))
        .collect();
    for steps in &steps {
        let moves = |i: &usize| motion.dq[*i].abs() > motion.slow_speed && steps[*i] != 0.0;
        let usual: Vec<f64> = (0..count).filter(moves).map(|i| steps[i].abs()).collect();
        let usual = quantile(&usual, 0.5).max(1e-12) / 0.6745;
        for ((way, size), step) in ways.iter_mut().zip(&mut sizes).zip(steps) {
            if step.abs() > LEAST_WAY * (high - low) {
                *way = f64::hypot(*way, *step);
                *size = f64::hypot(*size, step / usual);
            }
        }
    }
    let apart = (BETWEEN_S / motion.period) as usize;
    let mut order: Vec<usize> = (0..count).filter(|i| sizes[*i] > LEAST).collect();
    order.sort_by(|&a, &b| sizes[b].total_cmp(&sizes[a]));
    let mut taken: Vec<usize> = Vec::new();
    for i in order {
        if taken.iter().all(|j| i.abs_diff(*j) > apart) {
            taken.push(i);
        }
    }
    let turns = |i: &&usize| turns_near(motion, **i);
    let went: f64 = taken.iter().map(|i| ways[*i]).sum();
    let sum = |steps: &Vec<f64>| taken.iter().map(|i| steps[*i]).sum::<f64>();
    let came = steps.iter().map(sum).fold(0.0, f64::hypot);
    let at_turns = 2 * taken.iter().filter(turns).count() > taken.len();
    let comes_back = came < BACK * went;
    if taken.len() >= SOME && at_turns && comes_back {
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
            along: 0.0,
            is_plain: sizes[i] > PLAIN && !comes_back,
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
    fn a_grasp_that_shifts_at_every_turn_does_not_slip() {
        let time: Vec<f64> = (0..12_000).map(|i| 0.005 * f64::from(i)).collect();
        for stroke_s in [1.2, 2.0, 4.0] {
            let turning = |t: f64| (core::f64::consts::PI * t / stroke_s).sin();
            let across =
                |t: &f64| 0.0005 * (turning(*t) / 0.05).tanh() + 0.00006 * (911.0 * t).sin();
            let q = |t: &f64| 0.2 - 0.2 * (core::f64::consts::PI * t / stroke_s).cos();
            let samples = JointSamples {
                kind: JointKind::Prismatic,
                period: 0.005,
                runs: vec![0..12_000],
                q: time.iter().map(q).collect(),
                tau: time.iter().map(|t| turning(*t)).collect(),
                noise_of_q: vec![time.iter().map(across).collect()],
                aside: crate::samples::Aside::default(),
                time: time.clone(),
            };
            let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
            assert_eq!(motion.slips, [], "{stroke_s}");
        }
    }

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
        assert!(at[0].is_plain, "{at:?}");
        let pushed = |t: &f64| wander(t) + if (11.0..11.6).contains(t) { 0.006 } else { 0.0 };
        let at = found(time.iter().map(pushed).collect());
        assert!(
            at.len() == 2 && at.iter().all(|slip| !slip.is_plain),
            "{at:?}"
        );
    }
}
