//! The noise along a straight path, from that across it.
//!
//! A tracker's rotations act about a place of their own, so that the TCP moves by what they turn wrongly, but not along the line from
//! there: where a drawer is drawn along the wrist, rotations move the TCP across its path alone. On a rail the rotation stays, and what
//! it does is known.

use core::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::shaken;
use crate::motion::MotionError;

/// Two series with the noise of the coordinate: the position's own across the path, m, and what the rotations move along it. `across`
/// and `tilts`, rad, are along and about the first and the second perpendicular (the latter about the direction, too).
pub(super) fn noise(
    mut across: [Vec<f64>; 2],
    tilts: &[Vec<f64>; 3],
    runs: &[Range<usize>],
    period: f64,
    below_hz: f64,
) -> Result<[Vec<f64>; 2], MotionError> {
    let [first, second] = &across;
    let [t1, t2, t3] = tilts;
    let lever = lever(&shaken(
        [first, second, t1, t2, t3],
        runs,
        period,
        below_hz,
    )?);
    for i in 0..across[0].len() {
        let [by_first, by_second, by_direction] =
            rows([t1[i], t2[i], t3[i]]).map(|r| r.dot(&lever));
        across[0][i] += by_direction - by_first;
        across[1][i] += by_direction - by_second;
    }
    Ok(across)
}

/// From where the rotations act to the TCP, m, along both perpendiculars and the direction, by what the positions across the path share
/// with the tilts.
fn lever([first, second, t1, t2, t3]: &[Vec<f64>; 5]) -> Vector3<f64> {
    let (mut gram, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for i in 0..first.len() {
        let [by_first, by_second, _] = rows([t1[i], t2[i], t3[i]]);
        for (row, moved) in [(by_first, first[i]), (by_second, second[i])] {
            gram += row * row.transpose();
            right += row * moved;
        }
    }
    let lever = gram.cholesky().map(|factor| factor.solve(&right));
    // Rotations without noise tell no lever.
    lever
        .filter(|lever| lever.norm() < FARTHEST_M)
        .unwrap_or_default()
}

/// No tracker sits farther from the TCP, m.
const FARTHEST_M: f64 = 1.0;

/// What rotations move the TCP by along the first and second perpendicular and the direction, per unit of the lever.
fn rows([t1, t2, t3]: [f64; 3]) -> [Vector3<f64>; 3] {
    [
        Vector3::new(0.0, -t3, t2),
        Vector3::new(t3, 0.0, -t1),
        Vector3::new(-t2, t1, 0.0),
    ]
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::least_squares::rms;
    use crate::noise::acceleration_below;

    const PERIOD: f64 = 0.008;
    const SAMPLES: usize = 60_000;
    const CUTOFF_HZ: f64 = 6.0;
    /// Noise of the tracker's own position, m, and of its rotation, rad.
    const OWN: f64 = 2e-5;
    const TURN: f64 = 9e-5;

    /// Accelerations of the error along the path, of that across it and of the noise told for it; m/s^2.
    fn levels(lever: [f64; 3], turn: f64) -> [f64; 3] {
        let random = &mut ChaCha8Rng::seed_from_u64(3);
        let mut series = |std: f64| -> Vec<f64> {
            let normal = (0..SAMPLES).map(|_| StandardNormal.sample(random));
            normal.map(|v: f64| std * v).collect()
        };
        let mut moved = [(); 3].map(|()| series(OWN));
        let turned = [(); 3].map(|()| series(turn));
        for i in 0..SAMPLES {
            let by = Vector3::from(turned.each_ref().map(|t| t[i])).cross(&Vector3::from(lever));
            for (moved, by) in moved.iter_mut().zip(by.iter()) {
                moved[i] += by;
            }
        }
        let level = |series: &[f64]| rms(&acceleration_below(series, PERIOD, CUTOFF_HZ).unwrap());
        let [first, second, along] = moved;
        let (across, truth) = (level(&first).hypot(level(&second)), level(&along));
        let runs = core::slice::from_ref(&(0..SAMPLES));
        let told = noise([first, second], &turned, runs, PERIOD, 4.0 * CUTOFF_HZ).unwrap();
        let told = level(&told[0]).hypot(level(&told[1]));
        [truth, across / 2.0_f64.sqrt(), told / 2.0_f64.sqrt()]
    }

    #[test]
    fn what_rotations_move_across_the_path_is_no_noise_along_it() {
        for lever in [[0.0, 0.0, 0.2], [0.2, 0.0, 0.0], [-0.1, 0.3, 0.2], [0.0; 3]] {
            let [truth, across, told] = levels(lever, TURN);
            assert!(
                (0.95..1.05).contains(&(told / truth)),
                "{lever:?}: {told} for {truth}"
            );
            if lever[..2] == [0.0; 2] && lever[2] > 0.0 {
                assert!(across > 1.2 * truth, "{across} for {truth}");
            }
        }
    }

    #[test]
    fn rotations_without_noise_leave_that_across_the_path_as_it_is() {
        for turn in [0.0, 1e-12] {
            let [_, across, told] = levels([0.0, 0.0, 0.2], turn);
            assert!((told / across - 1.0).abs() < 0.01, "{told} for {across}");
        }
    }
}
