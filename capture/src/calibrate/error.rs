//! Why there is no calibration.

use ft_recording::ReadError;

use super::series::SeriesError;

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// The recording cannot be read or written.
    #[error(transparent)]
    Recording(#[from] ReadError),
    /// The streams cannot be brought onto a grid.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// Pose and wrench have too little free air in common.
    #[error(
        "{free_air_s:.1} s of free air have both pose and wrench, need {needed_s:.0} s; record the tool in free air for longer, \
         or name its part with --free-air 3..20"
    )]
    FreeAirShort {
        /// There, s.
        free_air_s: f64,
        /// Needed, s.
        needed_s: f64,
    },
    /// The free air that was named is not in the recording.
    #[error(
        "no free air of 1 s or more: {named}, and the wrench lasts from {from_s:.1} to {until_s:.1} s; name its part with --free-air 3..20, \
         or by the marks free_air_begin and grasp"
    )]
    NoFreeAir {
        /// Where it was looked for.
        named: String,
        /// First instant that can be used, s after the first wrench.
        from_s: f64,
        /// Last one, s.
        until_s: f64,
    },
    /// The wrench's stamps are years apart.
    #[error(
        "the wrench's samples last {covered_s:.0} s, but are spread over {span_s:.0} s: some are stamped at another time; leave these out"
    )]
    Scattered {
        /// What the samples last, s.
        covered_s: f64,
        /// From the first to the last, s.
        span_s: f64,
    },
    /// The wrench does not follow the motion at any shift.
    #[error(
        "the tool's motion explains {:.0} % of the wrench at best (need 90 %): the tool touched something, the motion was too small, or pose and wrench \
         are of different times; shake the tool in free air, turning it about every axis, and name that part with --free-air or the marks \
         free_air_begin and grasp", 100.0 * explained
    )]
    Unrelated {
        /// Share of the wrench's variance, 0 to 1.
        explained: f64,
    },
    /// The wrench follows the motion of a tool of a mass below 0.
    #[error(
        "the wrench follows the tool's motion to {:.0} %, with its signs reversed: force and torque must be what the environment does to the tool, and \
         the poses' z must point up; turn the signs of all six round (import-csv does by --negate), or set the poses upright", 100.0 * explained
    )]
    Reversed {
        /// Share of the wrench's variance, 0 to 1.
        explained: f64,
    },
    /// The tool was hardly moved.
    #[error(
        "the tool was turned and shaken by {motion:.2} m/s^2 only (need {needed} m/s^2): shake it and turn it about every axis, for 10 s, in free air"
    )]
    TooStill {
        /// Gravity minus acceleration about its mean, m/s^2 rms.
        motion: f64,
        /// Needed, m/s^2.
        needed: f64,
    },
    /// The best shift is the farthest that was tried.
    #[error(
        "the best offset, {offset_s:.2} s, is at the end of the +-{search_s:.0} s searched; search wider with --search, or check that both are of one recording"
    )]
    AtTheEnd {
        /// s.
        offset_s: f64,
        /// s.
        search_s: f64,
    },
    /// Two shifts fit as well as each other.
    #[error(
        "two offsets fit alike, {first_s:.2} s and {second_s:.2} s: the shake repeats itself; shake again, irregularly, with pauses and turns"
    )]
    Ambiguous {
        /// The better, s.
        first_s: f64,
        /// The other, s.
        second_s: f64,
    },
    /// The offset is known too badly.
    #[error(
        "the offset between pose and wrench shows only to +-{std_ms:.1} ms (need {needed_ms:.0} ms): shake faster and turn the tool about every axis, \
         for 10 s, in free air"
    )]
    OffsetUnknown {
        /// One standard deviation, ms.
        std_ms: f64,
        /// Needed, ms.
        needed_ms: f64,
    },
    /// The mass and the bias cannot be told apart.
    #[error(
        "the tool's mass shows only as {mass_kg:.3} +-{std_kg:.3} kg (need 3 %): turn the tool over in free air, still for 2 s in at least \
         four orientations (pads down, up, left, right), then shake it"
    )]
    MassUnknown {
        /// Best estimate, kg.
        mass_kg: f64,
        /// One standard deviation, kg.
        std_kg: f64,
    },
    /// The bias cannot be told from the tool's weight.
    #[error(
        "the sensor's bias shows only to +-{std_n:.2} N and {std_nm:.4} N m (need 0.1 N, 0.005 N m): turn the tool over in free air, still for 2 s in \
         at least four orientations (pads down, up, left, right), then shake it"
    )]
    BiasUnknown {
        /// Largest standard deviation of the force, N.
        std_n: f64,
        /// Largest standard deviation of the torque, N m.
        std_nm: f64,
    },
    /// The centre of mass cannot be told from the bias.
    #[error(
        "the tool's centre of mass shows only to +-{:.1} mm (need 5 mm): turn the tool about all three axes in free air, still for 2 s in each orientation",
        1e3 * std_m
    )]
    ComUnknown {
        /// Largest standard deviation, m.
        std_m: f64,
    },
    /// The force does not follow the poses by a rotation.
    #[error(
        "the force follows the poses by a map that squeezes one axis to {squeezed:.2} of the longest or mirrors it (need 0.6 and no mirror): turn the \
         tool about all three axes in free air, and check the signs and axes of sensor and tracker"
    )]
    NoRotation {
        /// Shortest over longest axis.
        squeezed: f64,
    },
    /// The sensor's rotation is known too badly.
    #[error(
        "the sensor's rotation on the tool shows only to +-{std_deg:.2} deg (need {needed_deg:.1} deg): turn the tool over about all three axes in free \
         air, still for 2 s in each orientation"
    )]
    RotationUnknown {
        /// Largest standard deviation, deg.
        std_deg: f64,
        /// Needed, deg.
        needed_deg: f64,
    },
    /// The estimate is no calibration.
    #[error("the estimate is no body: {0}")]
    NoBody(#[from] ft_recording::CalibrationError),
    /// The calibration cannot be put into TOML.
    #[error("the calibration cannot be written as TOML: {0}")]
    Toml(#[from] toml::ser::Error),
    /// The result cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// The file.
        path: std::path::PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A file that would be written is there already.
    #[error("{path} exists already: choose another name, or allow overwriting with --force")]
    Exists {
        /// The file.
        path: std::path::PathBuf,
    },
    /// A name is given twice.
    #[error("{path} is the recording that is read, or another output: name another file for it")]
    Twice {
        /// The file.
        path: std::path::PathBuf,
    },
    /// The numbers do not determine a solution.
    #[error(
        "the motion determines nothing: the tool did not move, or the poses are all the same; move it in free air"
    )]
    Singular,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_that_is_not_found_is_told_without_holes_in_the_text() {
        for error in [
            CalibrateError::NoRotation { squeezed: 0.2 },
            CalibrateError::RotationUnknown {
                std_deg: 3.0,
                needed_deg: 0.5,
            },
        ] {
            let text = error.to_string();
            assert!(!text.contains("  "), "{text}");
        }
    }
}
