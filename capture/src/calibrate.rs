//! The tool's mass, centre of mass and inertia, the sensor's bias, and the time between pose and wrench, from a recording
//! of the tool in free air.

use std::path::Path;

use ft_recording::rewrite::Rewrite;
use ft_recording::{Calibration, Estimate, Pose7, Recording, TopicMap, metadata, topic};
use ft_wire::HostTime;
use ft_wire::frames::{Frame as _, FtSensor, Tcp};
use nalgebra::{Matrix3, SymmetricEigen, Vector3};
use serde::Serialize;

use crate::config::{Frames, StaticPose};

mod align;
mod dense;
mod error;
mod fit;
mod plot;
mod series;
mod text;
mod turn;

pub use align::Alignment;
pub use error::CalibrateError;
use fit::{BIAS, Delay, Extras, Fit, Problem};
use series::{PoseSide, WrenchSide};
pub use turn::SensorRotation;

/// Free air over which the bias may be seen to drift, s.
const DRIFT_NEEDS_S: f64 = 15.0;
/// A temperature that moved by more than this is looked at, K.
const TEMPERATURE_MOVED_K: f64 = 2.0;
/// Time left out around a grasp and a release, s.
const MARGIN_S: f64 = 0.3;

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
    /// Root mean square of what is left of the wrench in free air, below 8 Hz: N, N m.
    pub residual_rms: [f64; 2],
    /// The same before the tool's own wrench and the bias were taken off, about the mean.
    pub before_rms: [f64; 2],
    /// Free air used, s.
    pub free_air_s: f64,
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
        let start = recording
            .wrench
            .first()
            .map_or(HostTime::EPOCH, |first| first.at);
        let wrench = WrenchSide::of(recording, start)?;
        let span = wrench.span().unwrap_or((0.0, 0.0));
        let windows = free_air(recording, start, options);
        Ok(Self {
            pose: PoseSide::of(recording, start)?,
            turned: None,
            wrench,
            windows: windows
                .into_iter()
                .map(|(from, to)| (from.max(span.0), to.min(span.1)))
                .filter(|(from, to)| to > from)
                .collect(),
        })
    }
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
        // Still poses need no alignment.
        Err(error) => (None, Some(error.to_string())),
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
    let (calibration, inertia_made_possible) = body(&fit)?;
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
        residual_rms: fit.rms,
        before_rms: spread(&series),
        free_air_s: fit.residuals.len() as f64 * fit::ROW_STEP_S,
        inertia_made_possible,
        series,
    })
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

/// Mass, centre of mass and inertia about it, and whether the inertia had to be made one of a body.
fn body(fit: &Fit) -> Result<(Calibration, bool), CalibrateError> {
    let (mass, std_kg) = (fit.theta[0], fit.std(0));
    if !(mass > 0.0 && std_kg < 0.03 * mass) {
        return Err(CalibrateError::MassUnknown {
            mass_kg: mass,
            std_kg,
        });
    }
    let com = Vector3::new(fit.theta[1], fit.theta[2], fit.theta[3]) / mass;
    let com_std: [f64; 3] = core::array::from_fn(|k| {
        // c = h / m with their covariance.
        let (hh, hm, mm) = (
            fit.covariance[(1 + k, 1 + k)],
            fit.covariance[(1 + k, 0)],
            fit.covariance[(0, 0)],
        );
        (hh - 2.0 * com[k] * hm + com[k] * com[k] * mm)
            .max(0.0)
            .sqrt()
            / mass
    });
    let worst = com_std.iter().copied().fold(0.0, f64::max);
    if worst >= 0.005 {
        return Err(CalibrateError::ComUnknown { std_m: worst });
    }
    let bias = six(fit, BIAS);
    let largest = |part: &[f64]| part.iter().copied().fold(0.0, f64::max);
    let (std_n, std_nm) = (largest(&bias.std[..3]), largest(&bias.std[3..]));
    if !(std_n < 0.1 && std_nm < 0.005) {
        return Err(CalibrateError::BiasUnknown { std_n, std_nm });
    }
    let j = |k: usize| fit.theta[4 + k];
    let about_origin = Matrix3::new(j(0), j(1), j(3), j(1), j(2), j(4), j(3), j(4), j(5));
    let shift = (Matrix3::identity() * com.norm_squared() - com * com.transpose()) * mass;
    let measured = about_origin - shift;
    let (inertia, made_possible) = possible(&measured);
    let entries = |m: &Matrix3<f64>| [m.m11, m.m12, m.m22, m.m13, m.m23, m.m33];
    let (value, raw) = (entries(&inertia), entries(&measured));
    Ok((
        Calibration {
            payload_mass_kg: Estimate {
                value: mass,
                std: std_kg,
            },
            payload_com_m: Estimate {
                value: com.into(),
                std: com_std,
            },
            payload_inertia_kgm2: Estimate {
                value,
                std: core::array::from_fn(|k| fit.std(4 + k).hypot(value[k] - raw[k])),
            },
            wrench_bias: Some(bias),
        },
        made_possible,
    ))
}

/// The nearest inertia that a body can have: its second moments `tr(J)/2 - J` are not negative.
fn possible(inertia: &Matrix3<f64>) -> (Matrix3<f64>, bool) {
    let moments = Matrix3::identity() * (0.5 * inertia.trace()) - inertia;
    let mut eigen = SymmetricEigen::new(moments);
    let least = 1e-9;
    if eigen.eigenvalues.iter().all(|value| *value >= least) {
        return (*inertia, false);
    }
    eigen.eigenvalues.apply(|value| *value = value.max(least));
    let moments = eigen.recompose();
    (Matrix3::identity() * moments.trace() - moments, true)
}

/// Calibrates `file` and writes what was asked for: a new recording with `ft.calibration`, its poses shifted by the
/// alignment when `shift` is set; a `calibration.toml`; a page with the residuals.
///
/// # Errors
/// [`CalibrateError`].
pub fn calibrate_file(
    file: &Path,
    map: &TopicMap,
    options: &CalibrateOptions,
    outputs: &Outputs<'_>,
) -> Result<Calibrated, CalibrateError> {
    let there = [outputs.toml, outputs.plot].into_iter().flatten();
    if let Some(path) = there
        .filter(|path| path.exists())
        .find(|_| !outputs.overwrite)
    {
        return Err(CalibrateError::Exists {
            path: path.to_owned(),
        });
    }
    let recording = Recording::load(file, map)?;
    let found = calibrate(&recording, options)?;
    if let Some(out) = outputs.recording {
        let mut rewrite = Rewrite::new();
        rewrite.metadata(metadata::CALIBRATION, found.calibration.to_metadata()?);
        rewrite.metadata(
            metadata::CALIBRATED,
            found.details(&recording, outputs.shift && found.alignment.is_some()),
        );
        let start = recording.wrench.first().map_or(HostTime::EPOCH, |w| w.at);
        if let Some(frames) = found.frames(&recording) {
            let sensor = &frames.tcp_from_ft_sensor;
            let pose = Pose7 {
                position: sensor.position_m,
                quaternion: sensor.quaternion_xyzw,
            };
            rewrite.set_frame(Tcp::NAME, FtSensor::NAME, pose, map, start);
        }
        if let (true, Some(alignment)) = (outputs.shift, found.alignment) {
            let map = map.clone();
            rewrite.restamp(move |name, stamp, _| match map.resolve(name) {
                Some(topic::ARIA_POSE | topic::TCP_POSE) => alignment.shifted(stamp, start),
                _ => stamp,
            });
        }
        rewrite.write(Some(file), out, outputs.overwrite)?;
    }
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).map_err(|source| CalibrateError::Write {
            path: path.to_owned(),
            source,
        })
    };
    if let Some(path) = outputs.toml {
        write(path, found.to_toml(&recording)?)?;
    }
    if let Some(path) = outputs.plot {
        write(path, plot::page(&recording, &found))?;
    }
    Ok(found)
}

/// What [`calibrate_file`] writes.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outputs<'a> {
    /// The new recording.
    pub recording: Option<&'a Path>,
    /// The `[calibration]` of later recordings.
    pub toml: Option<&'a Path>,
    /// The residuals as a page.
    pub plot: Option<&'a Path>,
    /// Shift the new recording's poses by the alignment.
    pub shift: bool,
    /// Replace existing files.
    pub overwrite: bool,
}

impl Calibrated {
    /// The frames with the rotation that was found.
    fn frames(&self, recording: &Recording) -> Option<Frames> {
        let pose = |pose: &Pose7| StaticPose {
            position_m: pose.position,
            quaternion_xyzw: pose.quaternion,
        };
        Some(Frames {
            aria_device_from_tcp: pose(&recording.aria_device_from_tcp),
            tcp_from_ft_sensor: StaticPose {
                position_m: recording.tcp_from_ft_sensor.position,
                quaternion_xyzw: self.rotation?.quaternion_xyzw,
            },
        })
    }
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
