//! The drift between the clocks, from the free air before the grasp and that after the release.

use std::fmt;

use ft_recording::{Pose7, Recording, Stamped};
use serde::Serialize;

use super::weigh::free_air;
use crate::calibrate::Alignment;
use crate::gyro;

/// 95 % of a normal distribution lie within so many standard deviations.
const NORMAL_95: f64 = 1.959_964;
/// What two crystals may well differ by, ppm.
const USUAL_PPM: f64 = 20.0;

/// Stretches longer than this are not tried when no shorter one is free air, s.
const MAX_VAIN_S: f64 = 15.0;

/// What is known of the drift of the poses' clock against the wrench's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Drift {
    /// It is larger than its interval, and taken out.
    Taken {
        /// ppm.
        ppm: f64,
        /// One standard deviation, ppm.
        std_ppm: f64,
    },
    /// It is within its interval, and nothing is taken out.
    NotSeen {
        /// ppm.
        ppm: f64,
        /// One standard deviation, ppm.
        std_ppm: f64,
    },
    /// Only one stretch of free air shows the offset.
    Unknown {
        /// From the middle of that to the end of the recording, s.
        after_s: f64,
        /// What the two halves of the recording differ by when the sensor's gyroscope is held against the poses, ppm; none where it shows
        /// nothing.
        gyroscope_ppm: Option<f64>,
    },
}

/// Looks for free air after `until_s` as well, and gives the alignment with what that says of the drift.
pub(super) fn with_drift(
    recording: &Recording,
    first: Alignment,
    until_s: f64,
) -> (Alignment, Drift) {
    if let Some([ppm, std_ppm]) = first.skew_ppm {
        return (first, Drift::Taken { ppm, std_ppm });
    }
    let end_s = match (recording.wrench.first(), recording.wrench.last()) {
        (Some(first), Some(last)) => last.at.seconds_since(first.at),
        _ => 0.0,
    };
    match late_free_air(recording, until_s, end_s) {
        Some(later) => between(first, later),
        None => {
            let drift = Drift::Unknown {
                after_s: end_s - first.at_s,
                gyroscope_ppm: by_halves(recording),
            };
            (first, drift)
        }
    }
}

/// The offset in the longest free air at the end that begins after `until_s`; the tool may be laid down before the end.
fn late_free_air(recording: &Recording, until_s: f64, end_s: f64) -> Option<Alignment> {
    for before_end_s in [0.0, 5.0, 10.0, 20.0] {
        let to_s = end_s - before_end_s;
        let mut best: Option<Alignment> = None;
        let mut from_s = to_s - 6.0;
        while from_s > until_s {
            match free_air(recording, from_s, to_s).ok() {
                Some(found) => best = found.alignment.or(best),
                None if best.is_some() || to_s - from_s > MAX_VAIN_S => break,
                None => {}
            }
            from_s -= 3.0;
        }
        if best.is_some() {
            return best;
        }
    }
    None
}

/// The line through both offsets, when they differ by more than chance.
fn between(first: Alignment, later: Alignment) -> (Alignment, Drift) {
    let time_s = later.at_s - first.at_s;
    let ppm = 1e6 * (later.offset_s - first.offset_s) / time_s;
    let std_ppm = 1e6 * first.std_s.hypot(later.std_s) / time_s;
    if ppm.abs() <= NORMAL_95 * std_ppm {
        return (first, Drift::NotSeen { ppm, std_ppm });
    }
    let aligned = Alignment {
        skew_ppm: Some([ppm, std_ppm]),
        ..first
    };
    (aligned, Drift::Taken { ppm, std_ppm })
}

/// What the gyroscope says of the first half of the poses and of the second.
fn by_halves(recording: &Recording) -> Option<f64> {
    let poses = &recording.pose.samples;
    let (early, late) = poses.split_at(poses.len() / 2);
    let offset_ms = |half: &[Stamped<Pose7>]| {
        let check = gyro::check(half, &recording.angular_rate)?;
        Some(check.offset_ms)
    };
    let time_s = late.first()?.at.seconds_since(early.first()?.at);
    let apart_ms = offset_ms(late)? - offset_ms(early)?;
    (time_s > 0.0).then(|| 1e3 * apart_ms / time_s)
}

impl fmt::Display for Drift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Taken { ppm, std_ppm } => write!(
                f,
                "the poses' clock is slow by {ppm:+.1} +-{std_ppm:.1} ppm by the free air, and that is taken out"
            ),
            Self::NotSeen { ppm, std_ppm } => write!(
                f,
                "no drift between the clocks is seen from one free air to the other: {ppm:+.1} +-{std_ppm:.1} ppm"
            ),
            Self::Unknown {
                after_s,
                gyroscope_ppm,
            } => {
                write!(
                    f,
                    "the drift between the clocks is unknown, because no free air after the release shows it: {USUAL_PPM:.0} ppm would be \
                     {:.1} ms at the end, {after_s:.0} s after the free air",
                    1e-3 * USUAL_PPM * after_s
                )?;
                match gyroscope_ppm {
                    Some(ppm) => write!(
                        f,
                        "; by the sensor's gyroscope in both halves it is about {ppm:+.0} ppm, which is not taken out"
                    ),
                    None => Ok(()),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(at_s: f64, offset_ms: f64) -> Alignment {
        Alignment {
            offset_s: 1e-3 * offset_ms,
            std_s: 1e-4,
            interval_s: [0.0; 2],
            skew_ppm: None,
            at_s,
            explained: 0.99,
            free_air_s: 10.0,
        }
    }

    #[test]
    fn a_drift_within_its_interval_is_told_and_not_taken_out() {
        let (aligned, drift) = between(at(10.0, 3.0), at(60.0, 4.0));
        let Drift::Taken { ppm, std_ppm } = drift else {
            panic!("{drift}");
        };
        assert!((ppm - 20.0).abs() < 1e-9 && (std_ppm - 2.83).abs() < 0.01);
        assert_eq!(aligned.skew_ppm, Some([ppm, std_ppm]));
        let (aligned, drift) = between(at(10.0, 3.0), at(60.0, 3.2));
        assert!(matches!(drift, Drift::NotSeen { .. }), "{drift}");
        assert_eq!(aligned, at(10.0, 3.0));
        let unknown = Drift::Unknown {
            after_s: 61.0,
            gyroscope_ppm: None,
        };
        assert!(
            unknown
                .to_string()
                .contains("20 ppm would be 1.2 ms at the end")
        );
    }
}
