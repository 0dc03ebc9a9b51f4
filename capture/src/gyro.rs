//! A check of the time between poses and wrench by a gyroscope that has the wrench's clock.
//!
//! The size of the angular rate is the same in all axes of a rigid tool, so that nothing need be known of how the gyroscope is turned:
//! its mean over 40 ms is compared with the angle that the poses turn by meanwhile, at shifts of up to half a second. It says nothing of
//! poses that are further off, or of a tool that hardly turned. Over 30 s or more, parts of the recording say how the clocks drift apart.

use std::fmt;
use std::ops::RangeInclusive;

use ft_recording::message::{Imu, Message};
use ft_recording::recording::fresh;
use ft_recording::{Pose7, Recording, Stamped, topic};
use ft_wire::HostTime;
use serde::Serialize;

mod drift;

/// Half of the time over which rates are taken, ns.
const HALF_NS: i64 = 20_000_000;
/// Rows and shifts stand this far apart, ns.
const STEP_NS: i64 = 5_000_000;
const STEP_MS: f64 = 1e-6 * STEP_NS as f64;
/// Shifts to either side.
const SHIFTS: i64 = 100;
/// Rows that a check needs: 5 s.
const MIN_ROWS: usize = 1_000;
/// Rows that it takes of a long recording, evenly.
const MAX_ROWS: usize = 20_000;
/// Rates must vary by so much, rad/s rms about their mean, ...
const MIN_MOTION: f64 = 0.1;
/// ... and the gyroscope must explain so much of what the poses turn.
const MIN_EXPLAINED: f64 = 0.8;
/// Beyond this a gyroscope contradicts the stamps, ms.
const AGREES_MS: f64 = 5.0;

/// What the gyroscope says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GyroCheck {
    /// To add to the poses' stamps, ms.
    pub offset_ms: f64,
    /// Share of the variance of the poses' angular rate that the gyroscope's explains at that shift.
    pub explained: f64,
    /// By how much the poses' clock is slow, ppm, and one standard deviation; none when the tool did not turn over 30 s or more.
    pub skew_ppm: Option<[f64; 2]>,
}

impl GyroCheck {
    /// Whether the stamps are right by the gyroscope, to 5 ms.
    #[must_use]
    pub fn agrees(&self) -> bool {
        self.offset_ms.abs() <= AGREES_MS
    }
}

impl fmt::Display for GyroCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let says = if self.agrees() {
            "agrees to"
        } else {
            "DISAGREES: the poses' stamps are off by"
        };
        let (offset, percent) = (self.offset_ms, 100.0 * self.explained);
        write!(f, "{says} {offset:+.1} ms ({percent:.0} % of the turns)")?;
        match self.skew_ppm {
            Some([ppm, std_ppm]) => write!(
                f,
                "; by it the poses' clock is slow by {ppm:+.1} +-{std_ppm:.1} ppm"
            ),
            None => Ok(()),
        }
    }
}

/// What the gyroscope of a recording says of its poses' stamps.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Gyroscope {
    /// They were compared.
    Compared(GyroCheck),
    /// They were not, and why.
    NotCompared(String),
}

impl Gyroscope {
    /// Compares `poses` with the gyroscope of `recording`; `None` when it has no inertial unit.
    #[must_use]
    pub fn of(recording: &Recording, poses: &[Stamped<Pose7>]) -> Option<Self> {
        if recording.angular_rate.is_empty() {
            let mut topics = recording.health.topics.iter();
            let (name, _) = topics.find(|(_, health)| health.kind == Imu::TYPE_NAME)?;
            return Some(Self::NotCompared(format!(
                "{name} is an inertial unit; if it has the wrench's clock, --map {name}={} compares its turns with the poses'",
                topic::IMU
            )));
        }
        let found = check(poses, &recording.angular_rate);
        Some(found.map_or_else(|| Self::NotCompared(NOT_SEEN.to_owned()), Self::Compared))
    }
}

impl fmt::Display for Gyroscope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Compared(check) => write!(f, "the gyroscope {check}"),
            Self::NotCompared(reason) => write!(f, "no check by a gyroscope: {reason}"),
        }
    }
}

/// Why there is no check although there is a gyroscope.
pub(crate) const NOT_SEEN: &str = "the gyroscope and the poses do not show the same turns within 0.5 s, or the tool hardly turned";

/// Compares the poses' angular rate with the gyroscope's, rad/s; both by time. `None` when there is too little of either, they move too
/// little, or do not belong to each other.
#[must_use]
pub fn check(poses: &[Stamped<Pose7>], gyro: &[Stamped<[f64; 3]>]) -> Option<GyroCheck> {
    let poses = &fresh(poses)[..];
    let (first, last) = (poses.first()?.at.as_nanos(), poses.last()?.at.as_nanos());
    let sums = sums(gyro);
    let every = (last.saturating_sub(first) / STEP_NS / MAX_ROWS as i64).max(0) + 1;
    let turned: Vec<(i64, f64)> = (1..)
        .map(|k| first + HALF_NS + k * every * STEP_NS)
        .take_while(|at| *at < last - HALF_NS)
        .filter_map(|at| turn(poses, at))
        .collect();
    let best = best(&turned, &sums, -SHIFTS..=SHIFTS, MIN_ROWS)?;
    let explained = 1.0 - best.left;
    (best.shift.abs() < SHIFTS as f64 && explained >= MIN_EXPLAINED).then(|| GyroCheck {
        offset_ms: best.shift * STEP_MS,
        explained,
        skew_ppm: drift::skew_ppm(&turned, &sums, best.shift),
    })
}

/// The shift that leaves least of the poses' turns.
struct Best {
    /// Steps of [`STEP_NS`] to add to the poses' stamps.
    shift: f64,
    /// Share of the variance that it leaves.
    left: f64,
    /// How fast that grows beside it, per step squared: its second difference.
    bend: f64,
    /// Rows that were compared.
    rows: usize,
}

/// Of so many rows at least; `None` when there are fewer, they show too little motion, or only the end of `shifts` was reached.
fn best(
    turned: &[(i64, f64)],
    sums: &[(HostTime, f64)],
    shifts: RangeInclusive<i64>,
    least_rows: usize,
) -> Option<Best> {
    let left = |shift: i64| -> Option<(f64, usize)> {
        let rows: Vec<(f64, f64)> = turned
            .iter()
            .filter_map(|(at, rate)| Some((*rate, mean(sums, at + shift * STEP_NS)?)))
            .collect();
        let n = rows.len() as f64;
        if rows.len() < least_rows {
            return None;
        }
        let centre = rows.iter().map(|row| row.0).sum::<f64>() / n;
        let whole = rows.iter().map(|row| (row.0 - centre).powi(2)).sum::<f64>() / n;
        let apart = rows.iter().map(|row| (row.0 - row.1).powi(2)).sum::<f64>() / n;
        (whole.sqrt() > MIN_MOTION).then_some((apart / whole, rows.len()))
    };
    let found: Vec<(i64, f64, usize)> = shifts
        .filter_map(|shift| left(shift).map(|(left, rows)| (shift, left, rows)))
        .collect();
    let best =
        (1..found.len().saturating_sub(1)).min_by(|a, b| found[*a].1.total_cmp(&found[*b].1))?;
    let ((_, a, _), (shift, b, rows), (_, c, _)) = (found[best - 1], found[best], found[best + 1]);
    // The parabola through the three best.
    let bend = a - 2.0 * b + c;
    let part = if bend > 0.0 {
        0.5 * (a - c) / bend
    } else {
        0.0
    };
    Some(Best {
        shift: shift as f64 + part,
        left: b,
        bend,
        rows,
    })
}

/// Mean angular rate of the poses around `at`, rad/s, between the poses next to the ends of that time, and the middle between these, ns.
fn turn(poses: &[Stamped<Pose7>], at: i64) -> Option<(i64, f64)> {
    let near = |at: i64| {
        let after = poses.partition_point(|pose| pose.at.as_nanos() < at);
        poses.get(after)
    };
    let (a, b) = (near(at - HALF_NS)?, near(at + HALF_NS)?);
    let time = b.at.seconds_since(a.at);
    let dot: f64 = (0..4)
        .map(|k| a.value.quaternion[k] * b.value.quaternion[k])
        .sum();
    let middle = a.at.as_nanos().midpoint(b.at.as_nanos());
    (time > 0.0 && time < 0.1).then(|| (middle, 2.0 * dot.abs().min(1.0).acos() / time))
}

/// The integral of the size of the rate from the first sample to each, rad.
fn sums(gyro: &[Stamped<[f64; 3]>]) -> Vec<(HostTime, f64)> {
    let size = |rate: &[f64; 3]| rate.iter().map(|value| value * value).sum::<f64>().sqrt();
    let mut sum = 0.0;
    let mut before: Option<&Stamped<[f64; 3]>> = None;
    let mut out = Vec::with_capacity(gyro.len());
    for sample in gyro {
        if let Some(before) = before {
            let time = sample.at.seconds_since(before.at);
            sum += 0.5 * (size(&before.value) + size(&sample.value)) * time;
        }
        out.push((sample.at, sum));
        before = Some(sample);
    }
    out
}

/// Mean rate around `at`, rad/s.
fn mean(sums: &[(HostTime, f64)], at: i64) -> Option<f64> {
    let value = |at: i64| {
        let after = sums.partition_point(|(t, _)| t.as_nanos() <= at);
        let ((t0, a), (t1, b)) = (sums.get(after.checked_sub(1)?)?, sums.get(after)?);
        let step = t1.seconds_since(*t0);
        let part = 1e-9 * (at - t0.as_nanos()) as f64 / step.max(1e-9);
        (step < 0.1).then(|| a + (b - a) * part)
    };
    Some((value(at + HALF_NS)? - value(at - HALF_NS)?) / (2e-9 * HALF_NS as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: i64 = 1_700_000_000_000_000_000;

    /// Turns about z by a sum of sines; poses at 1 kHz stamped `late_ns` too late, a gyroscope turned otherwise at 100 Hz.
    fn recorded(late_ns: i64, size: f64) -> (Vec<Stamped<Pose7>>, Vec<Stamped<[f64; 3]>>) {
        drifting(12, late_ns, size, 0.0)
    }

    /// As [`recorded`], of so many seconds, by a clock of the poses that is slow by `ppm`; the gyroscope is as noisy as one of a sensor.
    fn drifting(
        seconds: i64,
        late_ns: i64,
        size: f64,
        ppm: f64,
    ) -> (Vec<Stamped<Pose7>>, Vec<Stamped<[f64; 3]>>) {
        let angle = |t: f64| size * ((3.1 * t).sin() + 0.7 * (7.3 * t).cos());
        let rate = |t: f64| size * (3.1 * (3.1 * t).cos() - 5.11 * (7.3 * t).sin());
        let slow = |k: i64| (1e-6 * ppm * 1e6 * k as f64).round() as i64;
        let mut state = 1_u64;
        let mut noise = move |size: f64| {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
            size * ((state >> 40) as f64 / (1_u64 << 23) as f64 - 1.0)
        };
        let poses = (0..1_000 * seconds).map(|k| {
            let (sin, cos) = (0.5 * angle(1e-3 * k as f64)).sin_cos();
            Stamped {
                at: HostTime::from_nanos(START + k * 1_000_000 + late_ns - slow(k)),
                value: Pose7 {
                    position: [0.0; 3],
                    quaternion: [0.0, 0.0, sin, cos],
                },
            }
        });
        let gyro = (0..100 * seconds).map(|k| {
            let w = rate(0.01 * k as f64) + noise(0.02);
            Stamped {
                at: HostTime::from_nanos(START + k * 10_000_000),
                value: [0.6 * w, 0.0, -0.8 * w],
            }
        });
        (poses.collect(), gyro.collect())
    }

    #[test]
    fn the_gyroscope_says_how_late_the_poses_are_stamped() {
        for late_ms in [0.0, 3.2, -41.7, 260.0] {
            let (poses, gyro) = recorded((late_ms * 1e6) as i64, 0.4);
            let found = check(&poses, &gyro).unwrap();
            assert!(
                (found.offset_ms + late_ms).abs() < 0.5,
                "{late_ms}: {found:?}"
            );
            assert!(found.explained > 0.95, "{found:?}");
        }
    }

    #[test]
    fn a_drift_between_the_clocks_is_found_over_a_long_recording() {
        for ppm in [20.0, -20.0, 0.0, 150.0] {
            let (poses, gyro) = drifting(60, 3_200_000, 0.4, ppm);
            let found = check(&poses, &gyro).unwrap();
            let [skew, std] = found.skew_ppm.unwrap();
            println!("simulated: {ppm:+} ppm: found {skew:+.2} +-{std:.2} ppm");
            assert!((skew - ppm).abs() < 3.0 * std, "{ppm}: {found:?}");
            assert!(std < 8.0, "{found:?}");
        }
        // Too short, and still but for its begin.
        let (poses, gyro) = drifting(12, 0, 0.4, 20.0);
        assert_eq!(check(&poses, &gyro).unwrap().skew_ppm, None);
        let (mut poses, mut gyro) = drifting(60, 0, 0.4, 20.0);
        let still = poses[15_000].value;
        poses[15_000..]
            .iter_mut()
            .for_each(|pose| pose.value = still);
        gyro[1_500..]
            .iter_mut()
            .for_each(|rate| rate.value = [0.0; 3]);
        assert_eq!(check(&poses, &gyro).unwrap().skew_ppm, None);
    }

    #[test]
    fn what_shows_nothing_is_not_compared() {
        let (poses, gyro) = recorded(0, 0.4);
        assert_eq!(check(&poses, &[]), None);
        assert_eq!(check(&[], &gyro), None);
        assert_eq!(check(&poses[..2_000], &gyro), None);
        // Nearly still, another motion, and further off than is looked.
        let (still, of_still) = recorded(0, 0.01);
        assert_eq!(check(&still, &of_still), None);
        assert_eq!(check(&poses, &of_still), None);
        let (late, gyro) = recorded(5_000_000_000, 0.4);
        assert!(check(&late, &gyro).is_none_or(|found| found.explained < 0.95));
    }
}
