//! The filtered rows of the linear model of a tool in free air, and their fit.

use core::ops::Range;

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::{Payload, PayloadSource, TENSOR};
use crate::filter::{FilterError, LowPass};
use crate::least_squares::{effective_count, rms};
use crate::parallel::in_parallel;
use crate::tool::{ToolKinematics, ToolSamples};

/// Above it the tracker's noise in the accelerations would be taken for a tool that moves more than it weighs.
const CUTOFF_HZ: f64 = 5.0;
/// Rows per second of free air, in cut-offs.
const ROWS_PER_CUTOFF: f64 = 6.4;

/// Mass, first moment, bias, inertia about the sensor's origin.
const COUNT: usize = 16;
const BIAS: usize = 4;
const INERTIA: usize = 10;

type Normal = SMatrix<f64, COUNT, COUNT>;
type Parameters = SVector<f64, COUNT>;
/// A force tells of m and h, a torque of h and Jo.
const OF_FORCE: usize = 4;
const OF_TORQUE: usize = 9;
/// Columns of m, h, Jo for one axis of force or torque.
type Columns = SVector<f64, 10>;

/// A tool's radius of gyration, m, where no calibration says what its inertia is, and how sure that is of its square: a compact tool of 0.1 to 0.2 m.
const GYRATION_M: f64 = 0.05;
const GYRATION_SURE: f64 = 0.7;

/// A wrench that is late or early by more is another matter, s.
const LATEST_S: f64 = 0.12;
const EARLIEST_S: f64 = -0.05;
/// What is left below the cut-off changes over tens of milliseconds.
const COARSE_S: f64 = 1e-2;
const FINE_S: f64 = 2.5e-3;

/// Free air through one filter: of force and of torque.
pub(super) struct FreeAir {
    blocks: [Block; 2],
    /// Of each stretch all that was measured.
    measured: Vec<Vec<[f64; 6]>>,
    period: f64,
}

/// Rows of the linear model, which do not depend on how late the wrench is, axis by axis in the order of time, by which what residuals are worth is
/// counted.
struct Block {
    rows: Vec<Parameters>,
    places: Vec<Place>,
    /// Their products.
    normal: Normal,
}

/// Where the wrench of a row is: `axis` of the `at`-th sample of a stretch.
struct Place {
    stretch: usize,
    at: usize,
    axis: usize,
}

/// The model at one lateness of the wrench.
pub(super) struct Rows<'a> {
    parts: [Part<'a>; 2],
}

/// Its rows, and the wrench.
struct Part<'a> {
    block: &'a Block,
    targets: Vec<f64>,
    right: Parameters,
}

/// Solution with its covariance, and what each block leaves.
struct Solved {
    theta: Parameters,
    covariance: Normal,
    residuals: [Vec<f64>; 2],
}

impl FreeAir {
    pub(super) fn of(
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        runs: &[Range<usize>],
    ) -> Result<Self, FilterError> {
        let rate_hz = 1.0 / tool.period;
        let cutoff = CUTOFF_HZ.min(0.15 * rate_hz);
        let filter = LowPass::butterworth(4, cutoff, rate_hz)?;
        let step = ((rate_hz / (ROWS_PER_CUTOFF * CUTOFF_HZ)) as usize).max(1);
        let long = runs
            .iter()
            .filter(|run| run.len() > 2 * filter.edge_samples());
        let border = (LATEST_S / tool.period).ceil() as usize;
        let mut measured = Vec::new();
        let mut columns: [Vec<Vec<[f64; 10]>>; 6] = Default::default();
        for run in long {
            measured.push(filter.zero_phase_settled_each(&tool.wrench[run.clone()])?);
            let models: Vec<[Columns; 6]> = run.clone().map(|i| model(kinematics, i)).collect();
            for (axis, columns) in columns.iter_mut().enumerate() {
                columns.push(if axis < 3 {
                    filtered::<OF_FORCE>(&filter, &models, step, axis, 0)?
                } else {
                    filtered::<OF_TORQUE>(&filter, &models, step, axis, 10 - OF_TORQUE)?
                });
            }
        }
        let mut blocks = [Block::empty(), Block::empty()];
        for (axis, columns) in columns.iter().enumerate() {
            for (stretch, (columns, measured)) in columns.iter().zip(&measured).enumerate() {
                // None at the ends of a stretch, where differences and filter see one side only.
                let border = border.min(measured.len() / 4);
                let inside = border..measured.len().saturating_sub(border);
                for (k, columns) in columns.iter().enumerate() {
                    let at = k * step;
                    if inside.contains(&at) {
                        blocks[axis / 3].push(columns, Place { stretch, at, axis });
                    }
                }
            }
        }
        Ok(Self {
            blocks,
            measured,
            period: tool.period,
        })
    }

    /// The rows with the wrench read `late_s` later: of the same samples however late it is.
    pub(super) fn rows(&self, late_s: f64) -> Rows<'_> {
        let late = late_s / self.period;
        let parts = self.blocks.each_ref().map(|block| {
            let mut right = Parameters::zeros();
            let mut targets = Vec::with_capacity(block.rows.len());
            for (place, row) in block.places.iter().zip(&block.rows) {
                // Of a stretch that is longer than the filter's edges.
                let measured = &self.measured[place.stretch];
                let at = (place.at as f64 + late).clamp(0.0, (measured.len() - 2) as f64);
                let low = at as usize;
                let [a, b] = [low, low + 1].map(|i| measured[i][place.axis]);
                let target = a + (b - a) * (at - low as f64);
                right += row * target;
                targets.push(target);
            }
            Part {
                block,
                targets,
                right,
            }
        });
        Rows { parts }
    }

    /// How much later than the pose the wrench comes, s, and the standard deviation; nothing when free air does not show it.
    pub(super) fn late(
        &self,
        payload: &Payload,
        prior: Option<&Payload>,
        noise: [f64; 2],
    ) -> Option<(f64, f64)> {
        let cost = |late: f64| -> (f64, f64) {
            let solved = self.rows(late).solve(payload, prior, noise);
            let worth: f64 = solved.residuals.iter().map(|r| effective_count(r)).sum();
            let each = solved.residuals.iter().zip(noise);
            let squares: f64 = each
                .map(|(r, noise)| r.iter().map(|v| (v / noise).powi(2)).sum::<f64>())
                .sum();
            let count: usize = solved.residuals.iter().map(Vec::len).sum();
            (squares / count.max(1) as f64, worth)
        };
        let least = |from: f64, to: f64, step: f64| {
            let count = ((to - from) / step).round() as usize;
            let lates: Vec<f64> = (0..=count).map(|k| from + k as f64 * step).collect();
            let tried = in_parallel(&lates, |late| (*late, cost(*late)));
            let best = (0..tried.len()).min_by(|&a, &b| tried[a].1.0.total_cmp(&tried[b].1.0))?;
            (best > 0 && best < count).then(|| [tried[best - 1], tried[best], tried[best + 1]])
        };
        let [_, (coarse, _), _] = least(EARLIEST_S, LATEST_S - FINE_S, COARSE_S)?;
        let around = least(coarse - COARSE_S, (coarse + COARSE_S).min(LATEST_S), FINE_S)?;
        let [(_, (a, _)), (at, (b, worth)), (_, (c, _))] = around;
        let bend = a - 2.0 * b + c;
        if bend <= 0.0 || b <= 0.0 {
            return None;
        }
        // Squares over what is left of them at best, times what they are worth, are the usual chi-square.
        let std = FINE_S * (2.0 * b / (bend * worth.max(1.0))).sqrt();
        Some((at + 0.5 * FINE_S * (a - c) / bend, std))
    }
}

impl Block {
    fn empty() -> Self {
        Self {
            rows: Vec::new(),
            places: Vec::new(),
            normal: Normal::zeros(),
        }
    }

    fn push(&mut self, columns: &[f64; 10], place: Place) {
        let mut row = Parameters::zeros();
        row.as_mut_slice()[..BIAS].copy_from_slice(&columns[..BIAS]);
        row.as_mut_slice()[INERTIA..].copy_from_slice(&columns[BIAS..]);
        row[BIAS + place.axis] = 1.0;
        self.normal += row * row.transpose();
        self.rows.push(row);
        self.places.push(place);
    }
}

impl Part<'_> {
    fn residuals(&self, theta: &Parameters) -> Vec<f64> {
        let rows = self.block.rows.iter().zip(&self.targets);
        rows.map(|(row, target)| target - row.dot(theta)).collect()
    }
}

impl Rows<'_> {
    pub(super) fn fit(
        &self,
        before: &Payload,
        prior: Option<&Payload>,
        noise: [f64; 2],
    ) -> (Payload, [f64; 2]) {
        let Solved {
            theta,
            covariance,
            residuals,
        } = self.solve(before, prior, noise);
        let rms = [rms(&residuals[0]), rms(&residuals[1])];
        // A row counts by what its residual is worth: correlated residuals are spread over fewer.
        let worth = residuals
            .each_ref()
            .map(|r| effective_count(r) / r.len().max(1) as f64);
        let noise = [0, 1].map(|p| rms[p].max(1e-6) / worth[p].max(1e-3).sqrt());
        let mass = theta[0].max(1e-6);
        let std = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        let com: [f64; 3] = core::array::from_fn(|k| theta[1 + k] / mass);
        let own = tensor(theta.fixed_rows::<6>(INERTIA).into()) - of_a_point(mass, com);
        let payload = Payload {
            source: if prior.is_some() {
                PayloadSource::Both
            } else {
                PayloadSource::FreeAir
            },
            mass_kg: mass,
            mass_std_kg: std(0),
            com_m: com,
            com_std_m: core::array::from_fn(|k| std(1 + k) / mass),
            inertia_kgm2: TENSOR.map(|(i, j)| own[(i, j)]),
            bias: core::array::from_fn(|k| theta[BIAS + k]),
            bias_std: core::array::from_fn(|k| std(BIAS + k)),
            free_air_rms: Some(rms),
            covariance: Some(Box::new(body_of(&covariance))),
            ..before.clone()
        };
        (payload, noise)
    }

    fn solve(&self, before: &Payload, prior: Option<&Payload>, noise: [f64; 2]) -> Solved {
        let mut normal = Normal::zeros();
        let mut right = Parameters::zeros();
        for (part, noise) in self.parts.iter().zip(noise) {
            let weight = 1.0 / (noise * noise);
            normal += part.block.normal * weight;
            right += part.right * weight;
        }
        let mut add = |k: usize, value: f64, std: f64| {
            let weight = 1.0 / (std * std);
            normal[(k, k)] += weight;
            right[k] += weight * value;
        };
        if let Some(prior) = prior {
            let h = Vector3::from(prior.com_m) * prior.mass_kg;
            add(0, prior.mass_kg, prior.mass_std_kg.max(1e-4));
            for k in 0..3 {
                add(
                    1 + k,
                    h[k],
                    (prior.com_std_m[k] * prior.mass_kg)
                        .hypot(prior.com_m[k] * prior.mass_std_kg)
                        .max(1e-5),
                );
            }
            for k in 0..6 {
                add(BIAS + k, prior.bias[k], prior.bias_std[k]);
            }
        }
        let (own, std) = prior.map_or_else(
            || of_a_tool(before.mass_kg.max(0.1)),
            |prior| {
                (
                    prior.inertia_kgm2,
                    prior.inertia_std.map(|std| std.max(1e-6)),
                )
            },
        );
        let point = of_a_point(before.mass_kg, before.com_m);
        for (k, (i, j)) in TENSOR.into_iter().enumerate() {
            add(INERTIA + k, own[k] + point[(i, j)], std[k]);
        }
        for k in 0..COUNT {
            normal[(k, k)] += 1e-9;
        }
        let covariance = normal
            .try_inverse()
            .unwrap_or_else(|| Normal::identity() * 1e6);
        let theta = covariance * right;
        Solved {
            theta,
            covariance,
            residuals: self.parts.each_ref().map(|part| part.residuals(&theta)),
        }
    }

    /// Mean residual per axis and its standard deviation.
    pub(super) fn mean_residual(&self, payload: &Payload) -> ([f64; 6], [f64; 6]) {
        let h = Vector3::from(payload.com_m) * payload.mass_kg;
        let inertia = payload.inertia_at_origin();
        let mut theta = Parameters::zeros();
        theta[0] = payload.mass_kg;
        theta.fixed_rows_mut::<3>(1).copy_from(&h);
        theta
            .fixed_rows_mut::<6>(BIAS)
            .copy_from(&SVector::<f64, 6>::from(payload.bias));
        for (k, (i, j)) in TENSOR.into_iter().enumerate() {
            theta[INERTIA + k] = inertia[(i, j)];
        }
        let (mut mean, mut std) = ([0.0; 6], [0.0; 6]);
        let residuals = self.parts.each_ref().map(|part| part.residuals(&theta));
        for axis in 0..6 {
            let places = &self.parts[axis / 3].block.places;
            let left: Vec<f64> = residuals[axis / 3]
                .iter()
                .zip(places)
                .filter(|(_, place)| place.axis == axis)
                .map(|(left, _)| *left)
                .collect();
            let n = left.len().max(1) as f64;
            mean[axis] = left.iter().sum::<f64>() / n;
            let spread = left.iter().map(|v| (v - mean[axis]).powi(2)).sum::<f64>() / n;
            std[axis] = (spread / effective_count(&left).max(1.0)).sqrt();
        }
        (mean, std)
    }
}

/// Inertia of a compact tool about its centre of mass and how sure it is, in the order of [`TENSOR`].
pub(super) fn of_a_tool(mass: f64) -> ([f64; 6], [f64; 6]) {
    let size = mass * GYRATION_M * GYRATION_M;
    let is_moment = TENSOR.map(|(i, j)| i == j);
    (
        is_moment.map(|moment| if moment { size } else { 0.0 }),
        is_moment.map(|moment| GYRATION_SURE * size * if moment { 1.0 } else { 0.5 }),
    )
}

/// Inertia about the origin of a mass at a point.
pub(super) fn of_a_point(mass: f64, com: [f64; 3]) -> Matrix3<f64> {
    let c = Vector3::from(com);
    (Matrix3::identity() * c.norm_squared() - c * c.transpose()) * mass
}

/// The matrix of [`TENSOR`].
pub(super) fn tensor(of: [f64; 6]) -> Matrix3<f64> {
    let [xx, xy, yy, xz, yz, zz] = of;
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// The covariance of m, h, Jo.
fn body_of(all: &Normal) -> SMatrix<f64, 10, 10> {
    let place = |k: usize| if k < BIAS { k } else { INERTIA + k - BIAS };
    SMatrix::from_fn(|i, j| all[(place(i), place(j))])
}

/// `N` columns of one axis from the `first` on, filtered, of every `step`-th sample; the others are zero.
fn filtered<const N: usize>(
    filter: &LowPass,
    models: &[[Columns; 6]],
    step: usize,
    axis: usize,
    first: usize,
) -> Result<Vec<[f64; 10]>, FilterError> {
    let of = |model: &[Columns; 6]| core::array::from_fn(|k| model[axis][first + k]);
    let series: Vec<[f64; N]> = models.iter().map(of).collect();
    let filtered = filter.zero_phase_settled_each(&series)?;
    let widened = filtered.iter().step_by(step).map(|some| {
        let mut all = [0.0; 10];
        all[first..first + N].copy_from_slice(some);
        all
    });
    Ok(widened.collect())
}

/// Columns of m, h and Jo: of force x y z, torque x y z.
fn model(kinematics: &ToolKinematics, i: usize) -> [Columns; 6] {
    let [s, w, dw] = kinematics.at(i);
    let (ws, dws) = (w.cross_matrix(), dw.cross_matrix());
    let (of_h, to_h) = (-(dws + ws * ws), -s.cross_matrix());
    let of_inertia = TENSOR.map(|(i, j)| {
        let mut unit = Matrix3::zeros();
        (unit[(i, j)], unit[(j, i)]) = (1.0, 1.0);
        -(unit * dw) - w.cross(&(unit * w))
    });
    core::array::from_fn(|axis| {
        let k = axis % 3;
        let mut out = Columns::zeros();
        if axis < 3 {
            out[0] = s[k];
            out.fixed_rows_mut::<3>(1)
                .copy_from(&of_h.row(k).transpose());
        } else {
            out.fixed_rows_mut::<3>(1)
                .copy_from(&to_h.row(k).transpose());
            for (column, of) in out.iter_mut().skip(BIAS).zip(&of_inertia) {
                *column = of[k];
            }
        }
        out
    })
}
