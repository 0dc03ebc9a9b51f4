//! The drift between the clocks of poses and wrench, from the free air before the grasp and that after the release.

use std::fmt;

use ft_recording::Recording;
use serde::Serialize;

use super::free_air::free_air;
use crate::calibrate::{Alignment, NORMAL_95};
use crate::gyro;

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
        /// By how much the poses' clock is slow by the sensor's gyroscope, ppm, and one standard deviation; none where it shows nothing.
        gyroscope_ppm: Option<[f64; 2]>,
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
                gyroscope_ppm: gyro::check(&recording.pose.samples, &recording.angular_rate)
                    .and_then(|check| check.skew_ppm),
            };
            (first, drift)
        }
    }
}

/// Moves the poses' stamps as an alignment says.
pub(super) fn move_by(recording: &mut Recording, alignment: &Alignment) {
    let Some(start) = recording.wrench.first().map(|first| first.at) else {
        return;
    };
    for sample in &mut recording.pose.samples {
        sample.at = alignment.shifted(sample.at, start);
    }
}

/// As [`with_drift`], of a recording whose poses were moved by `found`, which is over all of `parts` in free air; a drift that is taken
/// out moves them once more.
pub(super) fn of_aligned(
    recording: &mut Recording,
    found: Alignment,
    parts: &[(f64, f64)],
) -> (Alignment, Drift) {
    if let Some([ppm, std_ppm]) = found.skew_ppm {
        return (found, Drift::Taken { ppm, std_ppm });
    }
    let until_s = parts.first().map_or(found.at_s, |part| part.1);
    let left = Alignment {
        offset_s: 0.0,
        ..found
    };
    // What is over several parts is true in none of them.
    let first = match parts {
        [(from_s, to_s), _, ..] => free_air(recording, *from_s, *to_s)
            .ok()
            .and_then(|found| found.alignment),
        _ => None,
    };
    let (rest, drift) = with_drift(recording, first.unwrap_or(left), until_s);
    if !matches!(drift, Drift::Taken { .. }) {
        return (found, drift);
    }
    move_by(recording, &rest);
    let offset_s = found.offset_s + rest.offset_s;
    let reach = NORMAL_95 * rest.std_s;
    let alignment = Alignment {
        offset_s,
        interval_s: [offset_s - reach, offset_s + reach],
        std_s: rest.std_s,
        skew_ppm: rest.skew_ppm,
        at_s: rest.at_s,
        ..found
    };
    (alignment, drift)
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
                    "the drift between the clocks is unknown, because no second stretch of free air, after a release, shows it: {USUAL_PPM:.0} ppm would be \
                     {:.1} ms at the end, {after_s:.0} s after the free air",
                    1e-3 * USUAL_PPM * after_s
                )?;
                match gyroscope_ppm {
                    Some([ppm, std_ppm]) => write!(
                        f,
                        "; by the gyroscope it is {ppm:+.1} +-{std_ppm:.1} ppm, which is not taken out"
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
