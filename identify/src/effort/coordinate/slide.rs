//! The noise along a straight path, from that across it.
//!
//! A tracker's rotations act about a place of their own, so that the TCP moves by what they turn wrongly, but not along the line from
//! there: where a drawer is drawn along the wrist, rotations move the TCP across its path alone. On a rail the rotation stays, and what
//! it does is known.

use core::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::{ABOVE_HANDS, shaken};
use crate::least_squares::rms;
use crate::motion::MotionError;

/// Two series with the noise of the coordinate below `cutoff_hz`: the position's own across the path, m, and what a rotation moves along it. `across` and
/// `tilts`, rad, are along and about the first and the second perpendicular, the latter about the direction, too.
///
/// A hand turns the tool in its grasp, which moves no TCP: where the position shakes more without what the tilts make of it, it stays as it is;
/// and of the two tilts that move it along the path that with the least of the hand's stands for both, as if a tracker turned as much about each.
pub(super) fn noise(
    across: &[Vec<f64>; 2],
    tilts: &[Vec<f64>; 3],
    runs: &[Range<usize>],
    period: f64,
    cutoff_hz: f64,
) -> Result<[Vec<f64>; 2], MotionError> {
    let [first, second] = across;
    let [t1, t2, t3] = tilts;
    let below = |hz: f64| shaken([first, second, t1, t2, t3], runs, period, hz);
    let lever = lever(&below(ABOVE_HANDS * cutoff_hz)?);
    let [first, second, tilted @ ..] = below(cutoff_hz)?;
    let own = |[first, second]: [&[f64]; 2], tilts: [&[f64]; 3]| -> [Vec<f64>; 2] {
        let by = |k: usize, i: usize| rows(tilts.map(|tilt| tilt[i]))[k].dot(&lever);
        let less = |k: usize, series: &[f64]| {
            let numbered = series.iter().enumerate();
            numbered.map(|(i, value)| value - by(k, i)).collect()
        };
        [less(0, first), less(1, second)]
    };
    let [left, right] = own([&first, &second], tilted.each_ref().map(Vec::as_slice));
    if rms(&left).hypot(rms(&right)) > rms(&first).hypot(rms(&second)) {
        return Ok(across.clone());
    }
    let along = lever.xy().norm();
    let least = usize::from(rms(&tilted[1]) < rms(&tilted[0]));
    let [first, second] = across.each_ref().map(Vec::as_slice);
    let mut told = own([first, second], tilts.each_ref().map(Vec::as_slice));
    for series in &mut told {
        for (value, tilt) in series.iter_mut().zip(&tilts[least]) {
            *value += along * tilt;
        }
    }
    Ok(told)
}

/// From where the rotations act to the TCP, m, along both perpendiculars and the direction, by what the positions across the path share
/// with the tilts; zero as far as rotations without noise do not tell.
fn lever([first, second, t1, t2, t3]: &[Vec<f64>; 5]) -> Vector3<f64> {
    let (mut gram, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for i in 0..first.len() {
        let [by_first, by_second] = rows([t1[i], t2[i], t3[i]]);
        for (row, moved) in [(by_first, first[i]), (by_second, second[i])] {
            gram += row * row.transpose();
            right += row * moved;
        }
    }
    let gram = gram.svd(true, true);
    let least = TOLD * gram.singular_values.max();
    let lever = gram.solve(&right, least).unwrap_or_default();
    if lever.norm() < FARTHEST_M {
        lever
    } else {
        Vector3::zeros()
    }
}

/// Share of the largest below which a singular value tells nothing.
const TOLD: f64 = 1e-6;

/// No tracker sits farther from the TCP, m.
const FARTHEST_M: f64 = 1.0;

/// What rotations move the TCP by along the first and second perpendicular, per unit of the lever.
fn rows([t1, t2, t3]: [f64; 3]) -> [Vector3<f64>; 2] {
    [Vector3::new(0.0, -t3, t2), Vector3::new(t3, 0.0, -t1)]
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::noise::acceleration_below;

    const PERIOD: f64 = 0.008;
    const SAMPLES: usize = 60_000;
    const CUTOFF_HZ: f64 = 6.0;
    /// Noise of the tracker's own position, m, and of its rotation, rad.
    const OWN: f64 = 2e-5;
    const TURN: f64 = 9e-5;

    /// Accelerations of the error along the path, of that across it and of the noise told for it; m/s^2. `held` = what the hand turns the
    /// tool by about the TCP, at most, rad.
    fn levels(lever: [f64; 3], turn: [f64; 3], held: f64) -> [f64; 3] {
        let random = &mut ChaCha8Rng::seed_from_u64(3);
        let mut series = |std: f64| -> Vec<f64> {
            let normal = (0..SAMPLES).map(|_| StandardNormal.sample(random));
            normal.map(|v: f64| std * v).collect()
        };
        let mut moved = [(); 3].map(|()| series(OWN));
        let mut turned = turn.map(&mut series);
        for i in 0..SAMPLES {
            let by = Vector3::from(turned.each_ref().map(|t| t[i])).cross(&Vector3::from(lever));
            for (moved, by) in moved.iter_mut().zip(by.iter()) {
                moved[i] += by;
            }
            for (turned, hz) in turned.iter_mut().zip([3.0, 4.0, 5.0]) {
                turned[i] += held * (core::f64::consts::TAU * hz * PERIOD * i as f64).sin();
            }
        }
        let level = |series: &[f64]| rms(&acceleration_below(series, PERIOD, CUTOFF_HZ).unwrap());
        let [first, second, along] = moved;
        let (across, truth) = (level(&first).hypot(level(&second)), level(&along));
        let runs = core::slice::from_ref(&(0..SAMPLES));
        let told = noise(&[first, second], &turned, runs, PERIOD, CUTOFF_HZ).unwrap();
        let told = level(&told[0]).hypot(level(&told[1]));
        [truth, across / 2.0_f64.sqrt(), told / 2.0_f64.sqrt()]
    }

    #[test]
    fn what_rotations_move_across_the_path_is_no_noise_along_it() {
        for lever in [[0.0, 0.0, 0.2], [0.2, 0.0, 0.0], [-0.1, 0.3, 0.2], [0.0; 3]] {
            let [truth, across, told] = levels(lever, [TURN; 3], 0.0);
            let ratio = told / truth;
            assert!((0.95..1.05).contains(&ratio), "{lever:?}: {ratio}");
            if lever == [0.0, 0.0, 0.2] {
                assert!(across > 1.15 * truth, "{across} for {truth}");
            }
        }
        // About the path it turns less, and the TCP goes as far along the path.
        let quiet = [TURN, TURN, 0.2 * TURN];
        let [truth, _, told] = levels([0.2, 0.0, 0.0], quiet, 0.0);
        assert!((told / truth - 1.0).abs() < 0.05, "{told} for {truth}");
        // About one axis it does not turn at all.
        let [truth, _, told] = levels([0.0, 0.0, 0.2], [TURN, TURN, 0.0], 0.0);
        assert!((told / truth - 1.0).abs() < 0.05, "{told} for {truth}");
    }

    #[test]
    fn rotations_without_noise_and_those_of_the_hand_leave_that_across_the_path_as_it_is() {
        for (turn, held) in [(0.0, 0.0), (1e-12, 0.0), (TURN, 2e-3)] {
            let [_, across, told] = levels([0.0, 0.0, 0.2], [turn; 3], held);
            assert!((told / across - 1.0).abs() < 0.01, "{told} for {across}");
        }
    }
}
