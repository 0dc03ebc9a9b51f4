//! Poses of a slow tracker on a fine grid.
//!
//! Straight lines between poses of 100 Hz take a thousandth off the accelerations, which is more than what the free air leaves
//! unknown of the mass; natural cubic splines through position and quaternion take a millionth.

use ft_recording::{Pose7, Stamped};
use ft_wire::HostTime;

/// Longer than this, s, and than three periods is a hole, as in `ft_identify::tool`.
const HOLE_S: f64 = 0.020;
/// A stretch of fewer poses stays as it is.
const MIN_POSES: usize = 4;

/// The poses every `step_ns` after the first, where they are further apart than that; others as they are.
pub(super) fn dense(samples: &[Stamped<Pose7>], step_ns: i64) -> Vec<Stamped<Pose7>> {
    let Some(first) = samples.first() else {
        return Vec::new();
    };
    let seconds = |sample: &Stamped<Pose7>| sample.at.seconds_since(first.at);
    let steps: Vec<f64> = samples
        .windows(2)
        .map(|pair| seconds(&pair[1]) - seconds(&pair[0]))
        .collect();
    let period = super::median(&steps).unwrap_or(0.0);
    if period < 1.5e-9 * step_ns as f64 {
        return samples.to_vec();
    }
    let (hole, least) = (HOLE_S.max(3.0 * period), 0.25 * period);
    let mut out = Vec::new();
    for stretch in samples.chunk_by(|a, b| seconds(b) - seconds(a) <= hole) {
        let (mut times, mut values): (Vec<f64>, Vec<[f64; 7]>) = (Vec::new(), Vec::new());
        for sample in stretch {
            let t = seconds(sample);
            if times.last().is_none_or(|last| t - last >= least) {
                values.push(beside(values.last(), &sample.value));
                times.push(t);
            }
        }
        if times.len() < MIN_POSES {
            out.extend_from_slice(stretch);
            continue;
        }
        let bends = bends(&times, &values);
        let mut i = 0;
        let from = (times[0] * 1e9 / step_ns as f64).ceil() as i64;
        let to = (times[times.len() - 1] * 1e9 / step_ns as f64).floor() as i64;
        for k in from..=to {
            let t = (k * step_ns) as f64 * 1e-9;
            while i + 2 < times.len() && times[i + 1] <= t {
                i += 1;
            }
            let (h, u) = (times[i + 1] - times[i], t - times[i]);
            let v = h - u;
            let value: [f64; 7] = core::array::from_fn(|c| {
                let (a, b) = (bends[i][c], bends[i + 1][c]);
                (a * v.powi(3) + b * u.powi(3)) / (6.0 * h)
                    + (values[i][c] / h - a * h / 6.0) * v
                    + (values[i + 1][c] / h - b * h / 6.0) * u
            });
            let [x, y, z, rotation @ ..] = value;
            out.extend(Pose7::normalised([x, y, z], rotation).map(|value| Stamped {
                at: HostTime::from_nanos(first.at.as_nanos() + k * step_ns),
                value,
            }));
        }
    }
    out
}

/// Position and quaternion, the latter on the side of the one before.
fn beside(before: Option<&[f64; 7]>, pose: &Pose7) -> [f64; 7] {
    let ([x, y, z], q) = (pose.position, pose.quaternion);
    let dot = before.map_or(1.0, |b| (0..4).map(|k| b[3 + k] * q[k]).sum::<f64>());
    let [a, b, c, d] = q.map(|value| if dot < 0.0 { -value } else { value });
    [x, y, z, a, b, c, d]
}

/// Second derivatives of the natural cubic spline at its knots (Thomas algorithm).
fn bends(times: &[f64], values: &[[f64; 7]]) -> Vec<[f64; 7]> {
    let n = times.len();
    let mut upper = vec![0.0; n];
    let mut bends = vec![[0.0; 7]; n];
    for i in 1..n - 1 {
        let (h0, h1) = (times[i] - times[i - 1], times[i + 1] - times[i]);
        let pivot = 2.0 * (h0 + h1) - h0 * upper[i - 1];
        upper[i] = h1 / pivot;
        for c in 0..7 {
            let right = 6.0
                * ((values[i + 1][c] - values[i][c]) / h1 - (values[i][c] - values[i - 1][c]) / h0);
            bends[i][c] = (right - h0 * bends[i - 1][c]) / pivot;
        }
    }
    for i in (1..n - 1).rev() {
        let after = bends[i + 1];
        for (bend, after) in bends[i].iter_mut().zip(after) {
            *bend -= upper[i] * after;
        }
    }
    bends
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_path_is_followed_between_its_poses_and_not_across_a_hole() {
        let at = |t: f64| HostTime::from_nanos(1_700_000_000_000_000_000 + (t * 1e9) as i64);
        let angle = |t: f64| 3.0 * (6.0 * t).sin();
        let path = |t: f64| {
            let (sin, cos) = (0.5 * angle(t)).sin_cos();
            Pose7::normalised([(9.0 * t).sin(), t * t, 1.0], [0.0, sin, 0.0, cos]).unwrap()
        };
        let samples: Vec<_> = (0..200)
            .filter(|k| !(80..100).contains(k))
            .map(|k| 0.01 * f64::from(k))
            .map(|t| Stamped {
                at: at(t),
                value: path(t),
            })
            .collect();
        let dense = dense(&samples, 2_000_000);
        assert!(dense.len() > 880 && dense.len() < 901, "{}", dense.len());
        for sample in &dense {
            let t = sample.at.seconds_since(samples[0].at);
            assert!(!(0.791..0.999).contains(&t), "{t}");
            // A natural spline has no bend at its ends.
            if [0.0, 0.79, 1.0, 1.99]
                .iter()
                .any(|end| (t - end).abs() < 0.06)
            {
                continue;
            }
            // 5/384 of the fourth power of the step times the fourth derivative.
            let truth = path(t);
            for c in 0..3 {
                let error = (sample.value.position[c] - truth.position[c]).abs();
                assert!(error < 1e-6, "{t}: {error}");
            }
            let dot: f64 = (0..4)
                .map(|k| sample.value.quaternion[k] * truth.quaternion[k])
                .sum();
            assert!(1.0 - dot.abs() < 1e-11, "{t}: {dot}");
        }
    }

    #[test]
    fn a_fast_tracker_is_left_alone() {
        let samples: Vec<_> = (0..100)
            .map(|k| Stamped {
                at: HostTime::from_nanos(k * 1_000_000),
                value: Pose7::IDENTITY,
            })
            .collect();
        assert_eq!(dense(&samples, 2_000_000).len(), 100);
        assert!(dense(&[], 2_000_000).is_empty());
    }
}
