//! Pads that slide on the handle: the tool jumps against the object, at instants that the pose across the path shows.

use super::library::{Belongs, Kind, Scope, Search, Unit, Variable};
use crate::least_squares::Bound::Free;
use crate::motion::Motion;
use crate::samples::quantile;

/// At most so many instants.
const MOST: usize = 5;
/// Seconds left out about an instant, and taken on either side of it.
const APART_S: f64 = 0.08;
const SIDE_S: f64 = 0.25;
/// A jump is so many times what the path usually does in that time.
const LEAST: f64 = 7.0;
/// How long one is taken to last, s.
const LASTS_S: f64 = 0.06;
/// The shape of an instant that is not there.
const NONE: f64 = -1.0;

/// `q` of the tool jumps by `step` at up to five instants; a regressor is what the jump's speed and acceleration make of the
/// inertia and viscous friction found so far. The instants come from the pose across the path, where nothing else jumps.
pub const SLIP: Kind = Kind {
    name: "slip",
    belongs: Belongs::Recording,
    terms: &[
        ("step_1", Unit::Position, Free),
        ("step_2", Unit::Position, Free),
        ("step_3", Unit::Position, Free),
        ("step_4", Unit::Position, Free),
        ("step_5", Unit::Position, Free),
    ],
    shape: &[
        ("at_1", Unit::Time, Search::Seconds(0.15)),
        ("at_2", Unit::Time, Search::Seconds(0.15)),
        ("at_3", Unit::Time, Search::Seconds(0.15)),
        ("at_4", Unit::Time, Search::Seconds(0.15)),
        ("at_5", Unit::Time, Search::Seconds(0.15)),
    ],
    variable: Variable::Time,
    grid: |scope| {
        let mut at = jumps(scope.motion);
        if at.is_empty() {
            return vec![];
        }
        at.resize(MOST, NONE);
        vec![at]
    },
    series: |scope, shape| shape.iter().map(|at| jump(scope, *at)).collect(),
    at: None,
    separate: "a mark on the handle beside the pads, or a firmer grasp",
};

/// Effort of a jump by one at `at`, s.
fn jump(scope: &Scope<'_>, at: f64) -> Vec<f64> {
    let motion = scope.motion;
    if at <= NONE {
        return vec![0.0; motion.time.len()];
    }
    let aside: Vec<f64> = motion
        .time
        .iter()
        .map(|t| {
            let u = ((t - at) / LASTS_S + 0.5).clamp(0.0, 1.0);
            u * u * (3.0 - 2.0 * u)
        })
        .collect();
    let (speed, acceleration) = (motion.derivative(&aside), motion.second_derivative(&aside));
    let [inertia, _, viscous] = scope.rigid;
    let both = acceleration.iter().zip(&speed);
    both.map(|(a, v)| inertia * a + viscous * v).collect()
}

/// Instants at which the pose across the path jumps, the largest first, s.
pub(crate) fn jumps(motion: &Motion) -> Vec<f64> {
    let count = motion.time.len();
    let mut sizes = vec![0.0; count];
    for series in &motion.noise_of_q {
        let step = differences(motion, series);
        let usual: Vec<f64> = step.iter().map(|v| v.abs()).filter(|v| *v > 0.0).collect();
        let usual = quantile(&usual, 0.5).max(1e-12) / 0.6745;
        for (size, step) in sizes.iter_mut().zip(&step) {
            *size = f64::hypot(*size, step / usual);
        }
    }
    let apart = (0.4 / motion.period) as usize;
    let mut order: Vec<usize> = (0..count).filter(|&i| sizes[i] > LEAST).collect();
    order.sort_by(|&a, &b| sizes[b].total_cmp(&sizes[a]));
    let mut taken: Vec<usize> = Vec::new();
    for i in order {
        if taken.len() < MOST && taken.iter().all(|j| i.abs_diff(*j) > apart) {
            taken.push(i);
        }
    }
    taken.into_iter().map(|i| motion.time[i]).collect()
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
            jumps(&motion)
        };
        assert!(found(time.iter().map(wander).collect()).is_empty());
        let jumped = |t: &f64| wander(t) + if *t > 11.0 { 0.006 } else { 0.0 };
        let at = found(time.iter().map(jumped).collect());
        assert_eq!(at.len(), 1, "{at:?}");
        assert!((at[0] - 11.0).abs() < 0.15, "{at:?}");
    }
}
