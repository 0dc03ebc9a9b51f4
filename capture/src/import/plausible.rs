//! What looks like other units. Nothing is changed for it: it is told.
//!
//! Bounds are wide of what a person's hand, a handle and a tracker give, and narrower than the factor of 10 (torque in N cm), 100
//! (positions in cm) or 1000 (mm, N mm) of a wrong unit.

use ft_recording::{Pose7, Stamped};

use super::clock_map::median;

/// A recording of one door or drawer does not reach farther, m.
const MAX_SPAN_M: f64 = 10.0;
/// Half of the time a hand moves slower, m/s.
const MAX_MEDIAN_SPEED: f64 = 2.0;
/// A hand does not pull harder, N, ...
const MAX_FORCE_N: f64 = 2_000.0;
/// ... and a tool of some hundred grams that is moved shows more than this between its largest and its least force, N.
const MIN_FORCE_N: f64 = 0.2;
/// No handle is farther from the sensor, m.
const MAX_LEVER_M: f64 = 1.5;
/// Nothing is mounted farther away on a handheld tool, m.
const MAX_MOUNT_M: f64 = 1.0;
/// Fewer samples show nothing.
const MIN_SAMPLES: usize = 20;

/// No recording lasts so long, ns: 6 h.
const FAR_NS: u64 = 6 * 3_600_000_000_000;

/// Leaves out samples, which stand by time, that are stamped at 1970 or far from the median: one of them would be the recording's begin.
/// Gives how many.
pub(super) fn leave_out_far<T>(samples: &mut Vec<Stamped<T>>) -> u64 {
    let before = samples.len();
    samples.retain(|sample| sample.at.as_nanos() > 0);
    keep_near(samples, |sample| sample.at.as_nanos());
    (before - samples.len()) as u64
}

/// Leaves out what is hours from the median of anything that stands by time, in ns.
pub(super) fn keep_near<T>(samples: &mut Vec<T>, at: impl Fn(&T) -> i64) {
    let Some(middle) = samples.get(samples.len() / 2).map(&at) else {
        return;
    };
    samples.retain(|sample| at(sample).abs_diff(middle) <= FAR_NS);
}

/// Of forces and torques, N and N m.
pub(super) fn of_wrench(samples: &[Stamped<[f64; 6]>]) -> Vec<String> {
    if samples.len() < MIN_SAMPLES {
        return Vec::new();
    }
    let spread = |part: usize| {
        let axis = |k: usize| {
            let n = samples.len() as f64;
            let mean = samples.iter().map(|s| s.value[k]).sum::<f64>() / n;
            samples
                .iter()
                .map(|s| (s.value[k] - mean).powi(2))
                .sum::<f64>()
                / n
        };
        (3 * part..3 * part + 3).map(axis).sum::<f64>().sqrt()
    };
    let size = |value: &[f64; 6]| value[..3].iter().map(|v| v * v).sum::<f64>().sqrt();
    let sizes = || samples.iter().map(|sample| size(&sample.value));
    let (least, most) = (
        sizes().fold(f64::MAX, f64::min),
        sizes().fold(0.0, f64::max),
    );
    let mut doubts = Vec::new();
    if most > MAX_FORCE_N {
        doubts.push(format!(
            "forces of up to {most:.0} N (a hand gives less than {MAX_FORCE_N:.0} N): are they in N?"
        ));
    } else if most - least < MIN_FORCE_N {
        doubts.push(format!(
            "the force changes by {:.3} N in all (a tool that is turned over shows more than {MIN_FORCE_N} N): is it in N, and was it moved?",
            most - least
        ));
    }
    let lever = spread(1) / spread(0).max(1e-9);
    if lever > MAX_LEVER_M {
        doubts.push(format!(
            "torques are as if forces acted {lever:.1} m away from the sensor (expected less than {MAX_LEVER_M} m): are they in N m?"
        ));
    }
    doubts
}

/// Of poses, m.
pub(super) fn of_poses(samples: &[Stamped<Pose7>]) -> Vec<String> {
    if samples.len() < MIN_SAMPLES {
        return Vec::new();
    }
    let reach = |k: usize| {
        let values = || samples.iter().map(|sample| sample.value.position[k]);
        values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
    };
    let span = (0..3).map(|k| reach(k).powi(2)).sum::<f64>().sqrt();
    let speed = |pair: &[Stamped<Pose7>]| {
        let seconds = pair[1].at.seconds_since(pair[0].at);
        let [a, b] = [pair[0].value.position, pair[1].value.position];
        let moved = (0..3).map(|k| (b[k] - a[k]).powi(2)).sum::<f64>().sqrt();
        (seconds > 0.0).then(|| moved / seconds)
    };
    let speed = median(samples.windows(2).filter_map(speed).collect()).unwrap_or(0.0);
    let mut doubts = Vec::new();
    if span > MAX_SPAN_M {
        doubts.push(format!(
            "positions reach over {span:.0} m (expected less than {MAX_SPAN_M:.0} m): are they in m, and not in cm or mm?"
        ));
    }
    if speed > MAX_MEDIAN_SPEED {
        doubts.push(format!(
            "half of the time the tool moves faster than {speed:.1} m/s (expected less than {MAX_MEDIAN_SPEED} m/s): are positions in m and times right?"
        ));
    }
    doubts
}

/// Of where the tool and the sensor are on the tracked body.
pub(super) fn of_mounts(mounts: [(&str, &Pose7); 2]) -> Vec<String> {
    let size = |pose: &Pose7| pose.position.iter().map(|v| v * v).sum::<f64>().sqrt();
    mounts
        .into_iter()
        .filter(|(_, pose)| size(pose) > MAX_MOUNT_M)
        .map(|(name, pose)| {
            format!(
                "{name} are {:.2} m apart (expected less than {MAX_MOUNT_M} m): are the calibration's positions in m?",
                size(pose)
            )
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use ft_wire::HostTime;

    use super::*;

    /// A tool of 0.7 kg that is turned over, and shaken over 0.4 m once a second.
    fn recorded() -> (Vec<Stamped<[f64; 6]>>, Vec<Stamped<Pose7>>) {
        let at = |k: i64| HostTime::from_nanos(1_700_000_000_000_000_000 + k * 10_000_000);
        (0..1_000)
            .map(|k| {
                let t = 0.01 * k as f64;
                let (sin, cos) = (0.6 * t).sin_cos();
                let force = [7.0 * sin, 0.0, -7.0 * cos + 2.0 * (6.3 * t).sin()];
                let wrench = Stamped {
                    at: at(k),
                    value: [
                        force[0],
                        force[1],
                        force[2],
                        0.05 * force[2],
                        0.0,
                        0.06 * force[0],
                    ],
                };
                let pose = Pose7 {
                    position: [0.2 * (6.3 * t).sin(), 1.0, 0.05 * t],
                    ..Pose7::IDENTITY
                };
                (
                    wrench,
                    Stamped {
                        at: at(k),
                        value: pose,
                    },
                )
            })
            .unzip()
    }

    #[test]
    fn stamps_of_1970_or_another_day_are_left_out_and_counted() {
        let (wrench, _) = recorded();
        let mut samples = wrench.clone();
        assert_eq!(leave_out_far(&mut samples), 0);
        let other = |at: i64| Stamped {
            at: HostTime::from_nanos(at),
            value: [0.0; 6],
        };
        samples.insert(0, other(0));
        samples.push(other(wrench[0].at.as_nanos() + 86_400_000_000_000));
        assert_eq!(leave_out_far(&mut samples), 2);
        assert_eq!(samples, wrench);
        // A clock that counts from its own begin is one, but for its 0.
        let mut samples = vec![other(0), other(1), other(2)];
        assert_eq!(leave_out_far(&mut samples), 1);
        assert_eq!(leave_out_far(&mut Vec::<Stamped<f64>>::new()), 0);
    }

    #[test]
    fn a_hand_with_a_tool_raises_no_doubt() {
        let (wrench, poses) = recorded();
        assert_eq!(of_wrench(&wrench), Vec::<String>::new());
        assert_eq!(of_poses(&poses), Vec::<String>::new());
        let near = Pose7 {
            position: [0.1, -0.2, 0.1],
            ..Pose7::IDENTITY
        };
        assert!(of_mounts([("a and b", &near), ("b and c", &near)]).is_empty());
    }

    #[test]
    fn other_units_are_doubted_each_by_its_name() {
        let (wrench, poses) = recorded();
        let scaled = |force: f64, torque: f64| {
            let mut wrench = wrench.clone();
            for sample in &mut wrench {
                let scale = [force, force, force, torque, torque, torque];
                sample.value = core::array::from_fn(|k| sample.value[k] * scale[k]);
            }
            of_wrench(&wrench).join("; ")
        };
        for (force, torque, expected) in [
            (1e3, 1e3, "are they in N?"),
            (1e-3, 1e-3, "is it in N"),
            (1.0, 100.0, "are they in N m?"),
            (1.0, 1e3, "are they in N m?"),
        ] {
            let text = scaled(force, torque);
            assert!(text.contains(expected), "{force} {torque}: {text}");
        }
        for scale in [100.0, 1000.0] {
            let mut poses = poses.clone();
            for sample in &mut poses {
                sample.value.position = sample.value.position.map(|p| p * scale);
            }
            let text = of_poses(&poses).join("; ");
            assert!(text.contains("and not in cm or mm?"), "{text}");
        }
        let far = Pose7 {
            position: [10.0, -20.0, 10.0],
            ..Pose7::IDENTITY
        };
        let text = of_mounts([("a and b", &Pose7::IDENTITY), ("b and c", &far)]);
        assert!(
            text.len() == 1 && text[0].starts_with("b and c are 24.49 m apart"),
            "{text:?}"
        );
    }
}
