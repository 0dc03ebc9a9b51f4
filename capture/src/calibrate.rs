//! The tool's mass, centre of mass and inertia, the sensor's bias, and the time between pose and wrench, from a recording
//! of the tool in free air.

use ft_recording::recording::fresh;
use ft_recording::{Calibration, Estimate, Recording, Stamped};
use ft_wire::HostTime;
use serde::Serialize;

use crate::gyro::Gyroscope;

mod align;
mod body;
mod dense;
mod error;
mod file;
mod fit;
mod plot;
mod series;
mod text;
mod turn;

pub use align::Alignment;
use body::body;
pub use error::CalibrateError;
pub use file::{Outputs, calibrate_file};
use fit::{Delay, Extras, Fit, Problem};
use series::{PoseSide, WrenchSide};
pub use turn::SensorRotation;

/// 95 % of a normal distribution lie within so many standard deviations.
pub(crate) const NORMAL_95: f64 = 1.959_964;
/// Free air over which the bias may be seen to drift, s.
const DRIFT_NEEDS_S: f64 = 15.0;
/// A temperature that moved by more than this is looked at, K.
const TEMPERATURE_MOVED_K: f64 = 2.0;
/// Time left out around a grasp and a release, s.
const MARGIN_S: f64 = 0.3;
/// The wrench may be spread over so many times what its samples last.
const MOST_HOLES: f64 = 100.0;

/// What to calibrate from.
#[derive(Clone, Debug)]
pub struct CalibrateOptions {
    /// Free air, s after the first wrench; else from the marks, else the whole recording.
    pub free_air: Option<(f64, f64)>,
    /// Where the offset is looked for, s to either side.
    pub search_s: f64,
    /// The sensor's rotation on the tool is not known: find it too, whatever the recording says of it.
    pub find_rotation: bool,
}

impl Default for CalibrateOptions {
    fn default() -> Self {
        Self {
            free_air: None,
            search_s: 10.0,
            find_rotation: false,
        }
    }
}

/// What a calibration found.
#[derive(Clone, Debug, Serialize)]
pub struct Calibrated {
    /// Tool and bias; the bias holds in the middle of the free air.
    pub calibration: Calibration,
    /// Drift of the bias, N/s and N m/s, with one standard deviation; none in a short free air.
    pub bias_rate: Option<Estimate<[f64; 6]>>,
    /// Bias per kelvin, N/K and N m/K; none when the temperature stayed.
    pub bias_per_kelvin: Option<Estimate<[f64; 6]>>,
    /// How the sensor is turned on the tool, when that was asked.
    pub rotation: Option<SensorRotation>,
    /// How far pose and wrench are apart; none when the motion does not show it.
    pub alignment: Option<Alignment>,
    /// Why there is no alignment.
    pub not_aligned: Option<String>,
    /// What a gyroscope of the wrench's clock says of the poses' stamps, moved by the alignment; none when the recording has no
    /// inertial unit.
    pub gyroscope: Option<Gyroscope>,
    /// Root mean square of what is left of the wrench in free air, below 8 Hz: N, N m.
    pub residual_rms: [f64; 2],
    /// The same before the tool's own wrench and the bias were taken off, about the mean.
    pub before_rms: [f64; 2],
    /// Free air used, s.
    pub free_air_s: f64,
    /// Wrenches and poses of the recording that only repeat the one before under a new stamp: left out.
    pub repeats: [u64; 2],
    /// What is missing or damaged in the recording's file; none when it is whole.
    pub damage: Option<String>,
    /// Whether the inertia had to be moved to one that a body can have.
    pub inertia_made_possible: bool,
    /// For the plot.
    #[serde(skip)]
    pub series: Vec<FreeAirSample>,
}

/// The wrench at one instant of the free air, below 8 Hz: N, N m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeAirSample {
    /// s after the first wrench.
    pub time_s: f64,
    /// As measured.
    pub measured: [f64; 6],
    /// What the tool and the bias leave.
    pub left: [f64; 6],
}

/// Free air by the options, the marks, or all there is; s after the first wrench.
fn free_air(recording: &Recording, start: HostTime, options: &CalibrateOptions) -> Vec<(f64, f64)> {
    if let Some(window) = options.free_air {
        return vec![window];
    }
    let named = |name: &str| -> Vec<f64> {
        let is_named = |text: &str| text.trim().eq_ignore_ascii_case(name);
        let marks = recording.marks.iter().filter(|mark| is_named(&mark.value));
        marks.map(|mark| mark.at.seconds_since(start)).collect()
    };
    let (begins, grasps, releases) = (named("free_air_begin"), named("grasp"), named("release"));
    let end = recording
        .wrench
        .last()
        .map_or(0.0, |last| last.at.seconds_since(start));
    let mut windows = Vec::new();
    let mut free_from = Some(begins.first().copied().unwrap_or(0.0));
    let mut events: Vec<(f64, bool)> = grasps.iter().map(|t| (*t, true)).collect();
    events.extend(releases.iter().map(|t| (*t, false)));
    events.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (t, is_grasp) in events {
        if is_grasp {
            windows.extend(free_from.take().map(|from| (from, t - MARGIN_S)));
        } else {
            free_from = Some(t + MARGIN_S);
        }
    }
    windows.extend(free_from.map(|from| (from, end)));
    windows.retain(|(from, to)| to - from > 1.0);
    windows
}

/// Median of values; `None` when there are none.
fn median(values: &[f64]) -> Option<f64> {
    let mut values = values.to_vec();
    if values.is_empty() {
        return None;
    }
    let middle = values.len() / 2;
    let (_, value, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    Some(*value)
}

impl Problem {
    fn of(recording: &Recording, options: &CalibrateOptions) -> Result<Self, CalibrateError> {
        let start = start_of(recording);
        let wrench = WrenchSide::of(recording, start)?;
        let span = wrench.span().unwrap_or((0.0, 0.0));
        // A stamp that is years off would ask for years of rows.
        let (covered_s, span_s) = (wrench.covered(), span.1 - span.0);
        if span_s > MOST_HOLES * covered_s {
            return Err(CalibrateError::Scattered { covered_s, span_s });
        }
        let named = free_air(recording, start, options);
        let windows: Vec<_> = named
            .iter()
            .map(|(from, to)| (from.max(span.0), to.min(span.1)))
            .filter(|(from, to)| to > from)
            .collect();
        if windows.is_empty() {
            let named: Vec<_> = named
                .iter()
                .map(|(from, to)| format!("{from:.1} to {to:.1} s"))
                .collect();
            return Err(CalibrateError::NoFreeAir {
                named: match (named.as_slice(), options.free_air) {
                    ([], _) => "the marks leave none".to_owned(),
                    (_, Some(_)) => format!("--free-air says {}", named.join(", ")),
                    (_, None) => format!("it would be {}", named.join(", ")),
                },
                from_s: span.0,
                until_s: span.1,
            });
        }
        Ok(Self {
            pose: PoseSide::of(recording, start)?,
            turned: None,
            wrench,
            windows,
        })
    }
}

/// Parts of a recording in free air by the options, the marks, or all there is; s after the first wrench.
pub(crate) fn free_air_parts(recording: &Recording, options: &CalibrateOptions) -> Vec<(f64, f64)> {
    free_air(recording, start_of(recording), options)
}

/// How far pose and wrench of a recording are apart: within `options.search_s` of `around_s`, s to add to the pose's stamps.
///
/// # Errors
/// [`CalibrateError`], when the data cannot tell; it says what to do.
pub fn align_recording(
    recording: &Recording,
    around_s: f64,
    options: &CalibrateOptions,
) -> Result<Alignment, CalibrateError> {
    let problem = Problem::of(recording, options)?;
    align::align(&problem, around_s, options.search_s).map(|(alignment, _)| alignment)
}

/// Calibrates from a recording. Pose and wrench may be apart by what `options.search_s` allows when a shake shows it.
///
/// # Errors
/// [`CalibrateError`], when the data cannot tell; it says what to do.
pub fn calibrate(
    recording: &Recording,
    options: &CalibrateOptions,
) -> Result<Calibrated, CalibrateError> {
    if options.find_rotation {
        let (rotation, recording) = turn::find(recording, options)?;
        let options = CalibrateOptions {
            find_rotation: false,
            ..options.clone()
        };
        return Ok(Calibrated {
            rotation: Some(rotation),
            ..calibrate(&recording, &options)?
        });
    }
    let problem = Problem::of(recording, options)?;
    let (alignment, not_aligned) = match align::align(&problem, 0.0, options.search_s) {
        Ok((alignment, _)) => (Some(alignment), None),
        // Where little moves, poses that are late change little. Any other refusal says that these may be of another time.
        Err(error @ (CalibrateError::TooStill { .. } | CalibrateError::FreeAirShort { .. })) => {
            (None, Some(error.to_string()))
        }
        Err(error) => return Err(error),
    };
    let span =
        problem.windows.last().map_or(0.0, |w| w.1) - problem.windows.first().map_or(0.0, |w| w.0);
    let extras = Extras {
        drift: span >= DRIFT_NEEDS_S,
        temperature: temperature(recording, &problem),
        turn: false,
        delay: alignment.is_some(),
        skew: alignment.is_some_and(|alignment| alignment.skew_ppm.is_some()),
    };
    let start = Delay {
        offset_s: alignment.map_or(0.0, |alignment| alignment.offset_s),
        skew: alignment
            .and_then(|a| a.skew_ppm)
            .map_or(0.0, |skew| 1e-6 * skew[0]),
        middle_s: problem.middle_s(),
    };
    let fit = problem
        .fit(start, &extras)
        .ok_or(CalibrateError::Singular)?;
    let explained = fit.explained(&problem);
    if fit.is_reversed() && explained >= align::MIN_EXPLAINED {
        return Err(CalibrateError::Reversed { explained });
    }
    let (calibration, inertia_made_possible) = body(&fit)?;
    if alignment.is_none() && explained < align::MIN_EXPLAINED {
        return Err(CalibrateError::Unrelated { explained });
    }
    let series: Vec<_> = fit
        .residuals
        .iter()
        .filter_map(|(t, left)| {
            Some(FreeAirSample {
                time_s: *t,
                measured: problem.wrench.at(*t)?.into(),
                left: *left,
            })
        })
        .collect();
    Ok(Calibrated {
        bias_rate: fit.drift_at.map(|at| six(&fit, at)),
        bias_per_kelvin: fit.temperature_at.map(|at| six(&fit, at)),
        calibration,
        rotation: None,
        alignment,
        not_aligned,
        gyroscope: gyroscope(recording, alignment),
        residual_rms: fit.rms,
        before_rms: spread(&series),
        free_air_s: fit.residuals.len() as f64 * fit::ROW_STEP_S,
        repeats: [repeats(&recording.wrench), repeats(&recording.pose.samples)],
        damage: recording.health.truncated.clone(),
        inertia_made_possible,
        series,
    })
}

fn repeats<T: Clone + PartialEq>(samples: &[Stamped<T>]) -> u64 {
    (samples.len() - fresh(samples).len()) as u64
}

/// First wrench's stamp.
fn start_of(recording: &Recording) -> HostTime {
    recording
        .wrench
        .first()
        .map_or(HostTime::EPOCH, |first| first.at)
}

/// What the recording's gyroscope says of the poses' stamps, moved by the alignment.
fn gyroscope(recording: &Recording, alignment: Option<Alignment>) -> Option<Gyroscope> {
    if recording.angular_rate.is_empty() {
        return Gyroscope::of(recording, &[]);
    }
    let start = start_of(recording);
    let moved = |at| alignment.map_or(at, |alignment| alignment.shifted(at, start));
    let poses = recording.pose.samples.iter().map(|pose| Stamped {
        at: moved(pose.at),
        value: pose.value,
    });
    Gyroscope::of(recording, &poses.collect::<Vec<_>>())
}

fn six(fit: &Fit, at: usize) -> Estimate<[f64; 6]> {
    Estimate {
        value: core::array::from_fn(|k| fit.theta[at + k]),
        std: core::array::from_fn(|k| fit.std(at + k)),
    }
}

/// Kelvin above the mean, when the sensor's temperature moved.
fn temperature(recording: &Recording, problem: &Problem) -> Option<Vec<(f64, f64)>> {
    let start = recording.wrench.first()?.at;
    let (from, to) = (problem.windows.first()?.0, problem.windows.last()?.1);
    let mut inside: Vec<(f64, f64)> = recording
        .temperature
        .iter()
        .map(|sample| (sample.at.seconds_since(start), sample.value))
        .filter(|(t, value)| (from..=to).contains(t) && value.is_finite())
        .collect();
    inside.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mean = inside.iter().map(|(_, value)| value).sum::<f64>() / inside.len().max(1) as f64;
    let values = || inside.iter().map(|(_, value)| *value);
    let range = values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min);
    (range > TEMPERATURE_MOVED_K)
        .then(|| inside.iter().map(|(t, value)| (*t, value - mean)).collect())
}

/// Root mean square about the mean, of force and torque.
fn spread(series: &[FreeAirSample]) -> [f64; 2] {
    let n = series.len().max(1) as f64;
    let mut out = [0.0; 2];
    for axis in 0..6 {
        let mean = series.iter().map(|s| s.measured[axis]).sum::<f64>() / n;
        out[axis / 3] += series
            .iter()
            .map(|s| (s.measured[axis] - mean).powi(2))
            .sum::<f64>()
            / n;
    }
    out.map(|power| (power / 3.0).sqrt())
}

impl Alignment {
    /// The stamp that a pose stamped `stamp` should have; `start` is the first wrench's stamp.
    #[must_use]
    pub fn shifted(&self, stamp: HostTime, start: HostTime) -> HostTime {
        let since = stamp.seconds_since(start) + self.offset_s - self.at_s;
        let skew = self.skew_ppm.map_or(0.0, |skew| 1e-6 * skew[0]);
        crate::import::shifted(stamp, self.offset_s + skew * since)
    }
}
