//! Pose and wrench on uniform grids, each by its own stamps, through one low-pass.
//!
//! The pose side holds the columns of the linear model of a tool in free air (design 2, written at the sensor's origin)
//!
//! ```text
//! force  = m s - (dw x h) - w x (w x h)       + bias
//! torque = h x s - (Jo dw + w x Jo w)         + bias
//! ```
//!
//! with `s` = gravity minus acceleration, `w`, `dw` the angular rate and acceleration, in `ft_sensor`.

use core::ops::Range;

use ft_identify::filter::{FilterError, LowPass};
use ft_identify::tool::{AlignError, ToolKinematics, ToolSamples};
use ft_recording::recording::fresh;
use ft_recording::{Pose7, PoseTrack, Recording, Stamped};
use ft_wire::HostTime;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::dense::dense;

/// Cut-off of the low-pass over both sides, Hz; that of the payload's fit in identification.
pub(super) const CUTOFF_HZ: f64 = 8.0;
/// Step of the grid on which poses are differentiated, ns: differences over 5 ms take a thousandth off what a fast shake shows,
/// which is more than it leaves unknown.
const GRID_NS: i64 = 2_000_000;
/// What the filters do at the ends of a run reaches so far, s; nothing is read there.
const EDGE_S: f64 = 2.5 / CUTOFF_HZ;
/// Parameters of the tool: m, h xyz, Jo xx xy yy xz yz zz.
pub(super) const TOOL: usize = 10;

/// Columns of force and torque at an instant: (6, 10).
pub(super) type Columns = SMatrix<f64, 6, TOOL>;

/// Values on a uniform grid with gaps, read anywhere by cubic interpolation.
#[derive(Clone, Debug)]
struct Grid<const N: usize> {
    period: f64,
    /// Start of each run, s, and its values.
    runs: Vec<(f64, Vec<[f64; N]>)>,
}

impl<const N: usize> Grid<N> {
    /// The series through `filter`; runs too short for it are left out.
    fn filtered(
        period: f64,
        runs: Vec<(f64, Vec<[f64; N]>)>,
        filter: &LowPass,
    ) -> Result<Self, FilterError> {
        let mut out = Vec::new();
        for (start, mut values) in runs {
            if values.len() <= 2 * filter.edge_samples() {
                continue;
            }
            for k in 0..N {
                let series: Vec<f64> = values.iter().map(|value| value[k]).collect();
                let smooth = filter.zero_phase_settled(&series)?;
                for (value, smooth) in values.iter_mut().zip(smooth) {
                    value[k] = smooth;
                }
            }
            out.push((start, values));
        }
        Ok(Self { period, runs: out })
    }

    /// The value at `t` s by the cubic through four neighbours; `None` outside the runs and at their ends.
    fn at(&self, t: f64) -> Option<[f64; N]> {
        let after = self.runs.partition_point(|(start, _)| *start <= t);
        let (start, values) = self.runs.get(after.checked_sub(1)?)?;
        let end = start + (values.len() - 1) as f64 * self.period;
        if t < start + EDGE_S || t > end - EDGE_S {
            return None;
        }
        let place = (t - start) / self.period;
        let i = place.floor() as usize;
        let (i0, u) = (i.checked_sub(1)?, place - place.floor());
        let [a, b, c, d] = values.get(i0..i0 + 4)? else {
            return None;
        };
        let weights = [
            -u * (u - 1.0) * (u - 2.0) / 6.0,
            (u + 1.0) * (u - 1.0) * (u - 2.0) / 2.0,
            -(u + 1.0) * u * (u - 2.0) / 2.0,
            (u + 1.0) * u * (u - 1.0) / 6.0,
        ];
        Some(core::array::from_fn(|k| {
            weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k] + weights[3] * d[k]
        }))
    }

    /// What the runs last together, s.
    fn covered(&self) -> f64 {
        let values = self.runs.iter().map(|(_, values)| values.len());
        values.sum::<usize>() as f64 * self.period
    }

    fn span(&self) -> Option<(f64, f64)> {
        let (first, _) = self.runs.first()?;
        let (last, values) = self.runs.last()?;
        Some((*first, last + (values.len() - 1) as f64 * self.period))
    }
}

/// What the poses of a recording say about the tool's own wrench, by the poses' own stamps.
#[derive(Clone, Debug)]
pub(super) struct PoseSide {
    grid: Grid<30>,
}

impl PoseSide {
    /// From the poses of `recording`, times in s after `start`.
    pub(super) fn of(recording: &Recording, start: HostTime) -> Result<Self, SeriesError> {
        let tool = ToolSamples::from_recording(&with_steady_wrench(recording))?;
        let kinematics = ToolKinematics::of(&tool)?;
        let shift = tool.start.seconds_since(start);
        let run = |run: &Range<usize>| {
            let values = run.clone().map(|i| columns(&kinematics, i)).collect();
            (tool.time[run.start] + shift, values)
        };
        let runs = tool.runs.iter().map(run).collect();
        let filter = LowPass::butterworth(4, CUTOFF_HZ, 1.0 / tool.period)?;
        Ok(Self {
            grid: Grid::filtered(tool.period, runs, &filter)?,
        })
    }

    /// The model's columns at `t` s.
    pub(super) fn at(&self, t: f64) -> Option<Columns> {
        let v = self.grid.at(t)?;
        let s = Vector3::new(v[0], v[1], v[2]);
        let mut out = Columns::zeros();
        out.fixed_view_mut::<3, 1>(0, 0).copy_from(&s);
        out.fixed_view_mut::<3, 3>(0, 1)
            .copy_from(&Matrix3::from_column_slice(&v[3..12]));
        out.fixed_view_mut::<3, 3>(3, 1)
            .copy_from(&-s.cross_matrix());
        out.fixed_view_mut::<3, 6>(3, 4)
            .copy_from(&SMatrix::<f64, 3, 6>::from_column_slice(&v[12..30]));
        Some(out)
    }

    /// First and last instant, s.
    pub(super) fn span(&self) -> Option<(f64, f64)> {
        self.grid.span()
    }
}

/// Poses farther apart stand in different stretches, s; no tracker is so slow.
const STRETCH_HOLE_S: f64 = 5.0;

/// The same poses, densely, under a wrench of nothing every [`GRID_NS`], which makes the grid.
fn with_steady_wrench(recording: &Recording) -> Recording {
    let samples = fresh(&recording.pose.samples);
    let mut wrench = Vec::new();
    // No row where no pose is near: one wild stamp must not ask for years of them.
    let near = |a: &Stamped<Pose7>, b: &Stamped<Pose7>| b.at.seconds_since(a.at) <= STRETCH_HOLE_S;
    for stretch in samples.chunk_by(near) {
        if let [first, .., last] = stretch {
            let count = last.at.as_nanos().saturating_sub(first.at.as_nanos()) / GRID_NS;
            wrench.extend((0..=count).map(|k| Stamped {
                at: HostTime::from_nanos(first.at.as_nanos() + k * GRID_NS),
                value: [0.0; 6],
            }));
        }
    }
    Recording {
        wrench,
        pose: PoseTrack {
            frame: recording.pose.frame,
            samples: dense(&samples, GRID_NS),
        },
        gripper_width: Vec::new(),
        ..recording.clone()
    }
}

/// s (3), columns of h in the force (9), columns of Jo in the torque (18).
fn columns(kinematics: &ToolKinematics, i: usize) -> [f64; 30] {
    let (s, w, dw) = (
        kinematics.specific[i],
        kinematics.rate[i],
        kinematics.angular[i],
    );
    let ws = w.cross_matrix();
    let force = -(dw.cross_matrix() + ws * ws);
    let torque = -(product(&dw) + ws * product(&w));
    let mut out = [0.0; 30];
    out[..3].copy_from_slice(s.as_slice());
    out[3..12].copy_from_slice(force.as_slice());
    out[12..].copy_from_slice(torque.as_slice());
    out
}

/// `J v` as a matrix times xx xy yy xz yz zz.
fn product(v: &Vector3<f64>) -> SMatrix<f64, 3, 6> {
    let (x, y, z) = (v.x, v.y, v.z);
    SMatrix::<f64, 3, 6>::new(
        x, y, 0.0, z, 0.0, 0.0, //
        0.0, x, y, 0.0, z, 0.0, //
        0.0, 0.0, 0.0, x, y, z,
    )
}

/// The recorded wrench, by its own stamps.
#[derive(Clone, Debug)]
pub(super) struct WrenchSide {
    grid: Grid<6>,
}

/// A hole is longer than this, s, and than three periods.
const HOLE_S: f64 = 0.020;

impl WrenchSide {
    /// From the wrench of `recording`, times in s after `start`.
    pub(super) fn of(recording: &Recording, start: HostTime) -> Result<Self, SeriesError> {
        let samples: Vec<(f64, [f64; 6])> = fresh(&recording.wrench)
            .iter()
            .map(|sample| (sample.at.seconds_since(start), sample.value))
            .collect();
        let steps: Vec<f64> = samples.windows(2).map(|w| w[1].0 - w[0].0).collect();
        let period = super::median(&steps).filter(|period| *period > 0.0);
        let Some(period) = period else {
            return Err(SeriesError::Align(AlignError::TooFewSamples {
                stream: "wrench",
                samples: samples.len(),
                needed: 2,
            }));
        };
        let filter = LowPass::butterworth(4, CUTOFF_HZ.min(0.2 / period), 1.0 / period)?;
        Ok(Self {
            grid: Grid::filtered(period, uniform(&samples, period), &filter)?,
        })
    }

    /// The wrench at `t` s.
    pub(super) fn at(&self, t: f64) -> Option<SVector<f64, 6>> {
        self.grid.at(t).map(SVector::<f64, 6>::from)
    }

    /// First and last instant, s.
    pub(super) fn span(&self) -> Option<(f64, f64)> {
        self.grid.span()
    }

    /// What its samples last, without the holes, s.
    pub(super) fn covered(&self) -> f64 {
        self.grid.covered()
    }
}

/// Linear interpolation on a grid of `period` within each stretch without a hole.
fn uniform(samples: &[(f64, [f64; 6])], period: f64) -> Vec<(f64, Vec<[f64; 6]>)> {
    let hole = HOLE_S.max(3.0 * period);
    let mut runs = Vec::new();
    for stretch in samples.chunk_by(|a, b| b.0 - a.0 <= hole) {
        let (first, last) = (stretch[0].0, stretch[stretch.len() - 1].0);
        let count = ((last - first) / period).floor() as usize + 1;
        let mut values = Vec::with_capacity(count);
        let mut i = 0;
        for k in 0..count {
            let t = first + k as f64 * period;
            while i + 2 < stretch.len() && stretch[i + 1].0 <= t {
                i += 1;
            }
            let Some([(ta, a), (tb, b)]) = stretch.get(i..i + 2) else {
                break;
            };
            let u = if tb > ta { (t - ta) / (tb - ta) } else { 0.0 };
            values.push(core::array::from_fn(|k| a[k] + (b[k] - a[k]) * u));
        }
        runs.push((first, values));
    }
    runs
}

/// Why there are no series.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SeriesError {
    /// Too few samples, or too many gaps.
    #[error(transparent)]
    Align(#[from] AlignError),
    /// A rate is too low to be filtered.
    #[error(transparent)]
    Filter(#[from] FilterError),
}
