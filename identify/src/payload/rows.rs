//! The filtered rows of the linear model of a tool in free air, and their fit.

use core::ops::Range;

use nalgebra::{SMatrix, SVector, Vector3};

use super::{Payload, PayloadSource};
use crate::filter::{FilterError, LowPass};
use crate::least_squares::{effective_count, rms};
use crate::tool::{ToolKinematics, ToolSamples};

const CUTOFF_HZ: f64 = 8.0;

type Normal = SMatrix<f64, 10, 10>;
type Parameters = SVector<f64, 10>;

/// Parameters and target of a row.
type Row = (Parameters, f64);

/// Free air, its rows filtered but for what the tool's inertia adds to the torque.
pub(super) struct FreeAir<'a> {
    kinematics: &'a ToolKinematics,
    filter: LowPass,
    step: usize,
    runs: Vec<Range<usize>>,
    /// Force and torque.
    blocks: [Vec<Row>; 2],
}

/// Filtered rows of the linear model: force rows and torque rows apart.
pub(super) struct Rows {
    blocks: [Vec<Row>; 2],
}

impl<'a> FreeAir<'a> {
    pub(super) fn of(
        tool: &ToolSamples,
        kinematics: &'a ToolKinematics,
        runs: &[Range<usize>],
    ) -> Result<Self, FilterError> {
        let rate_hz = 1.0 / tool.period;
        let filter = LowPass::butterworth(4, CUTOFF_HZ.min(0.15 * rate_hz), rate_hz)?;
        let step = ((rate_hz / (4.0 * CUTOFF_HZ)) as usize).max(1);
        let runs = runs.iter().cloned();
        let runs: Vec<_> = runs
            .filter(|run| run.len() > 2 * filter.edge_samples())
            .collect();
        let mut blocks = [Vec::new(), Vec::new()];
        for run in &runs {
            let models: Vec<[SMatrix<f64, 3, 4>; 2]> =
                run.clone().map(|i| model(kinematics, i)).collect();
            for axis in 0..6 {
                let (part, k) = (axis / 3, axis % 3);
                let measured = tool.wrench[run.clone()].iter().map(|wrench| wrench[axis]);
                let series: Vec<[f64; 5]> = models
                    .iter()
                    .map(|model| &model[part])
                    .zip(measured)
                    .map(|(m, measured)| [m[(k, 0)], m[(k, 1)], m[(k, 2)], m[(k, 3)], measured])
                    .collect();
                let filtered = filter.zero_phase_settled_each(&series)?;
                for [columns @ .., target] in filtered.iter().step_by(step) {
                    let mut row = Parameters::zeros();
                    row.fixed_rows_mut::<4>(0).copy_from_slice(columns);
                    row[4 + axis] = 1.0;
                    blocks[part].push((row, *target));
                }
            }
        }
        Ok(Self {
            kinematics,
            filter,
            step,
            runs,
            blocks,
        })
    }

    /// The rows, with the inertia of `payload` known.
    pub(super) fn rows(&self, payload: &Payload) -> Result<Rows, FilterError> {
        let inertia = payload.inertia_at_origin();
        let mut blocks = self.blocks.clone();
        let mut torque_rows = blocks[1].iter_mut();
        for run in &self.runs {
            let known = |i: usize| -> [f64; 3] {
                let (w, dw) = (self.kinematics.rate[i], self.kinematics.angular[i]);
                (-(inertia * dw) - w.cross(&(inertia * w))).into()
            };
            let known: Vec<[f64; 3]> = run.clone().map(known).collect();
            let known = self.filter.zero_phase_settled_each(&known)?;
            for k in 0..3 {
                let known = known.iter().step_by(self.step);
                for (known, (_, target)) in known.zip(&mut torque_rows) {
                    *target -= known[k];
                }
            }
        }
        Ok(Rows { blocks })
    }
}

impl Rows {
    pub(super) fn fit(
        &self,
        before: &Payload,
        prior: Option<&Payload>,
        noise: [f64; 2],
    ) -> (Payload, [f64; 2]) {
        let mut normal = Normal::zeros();
        let mut right = Parameters::zeros();
        for (block, noise) in self.blocks.iter().zip(noise) {
            let weight = 1.0 / (noise * noise);
            for (row, target) in block {
                normal += row * row.transpose() * weight;
                right += row * (target * weight);
            }
        }
        if let Some(prior) = prior {
            let h = Vector3::from(prior.com_m) * prior.mass_kg;
            let mut add = |k: usize, value: f64, std: f64| {
                let weight = 1.0 / (std * std);
                normal[(k, k)] += weight;
                right[k] += weight * value;
            };
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
                add(4 + k, prior.bias[k], prior.bias_std[k]);
            }
        }
        for k in 0..10 {
            normal[(k, k)] += 1e-9;
        }
        let covariance = normal
            .try_inverse()
            .unwrap_or_else(|| Normal::identity() * 1e6);
        let theta = covariance * right;
        let residual = |part: usize| -> Vec<f64> {
            self.blocks[part]
                .iter()
                .map(|(row, target)| target - row.dot(&theta))
                .collect()
        };
        let residuals = [residual(0), residual(1)];
        let rms = [rms(&residuals[0]), rms(&residuals[1])];
        // A row counts by what its residual is worth: correlated residuals are spread over fewer.
        let worth = residuals
            .each_ref()
            .map(|r| effective_count(r) / r.len().max(1) as f64);
        let noise = [0, 1].map(|p| rms[p].max(1e-6) / worth[p].max(1e-3).sqrt());
        let mass = theta[0].max(1e-6);
        let std = |k: usize| covariance[(k, k)].max(0.0).sqrt();
        let payload = Payload {
            source: if prior.is_some() {
                PayloadSource::Both
            } else {
                PayloadSource::FreeAir
            },
            mass_kg: mass,
            mass_std_kg: std(0),
            com_m: core::array::from_fn(|k| theta[1 + k] / mass),
            com_std_m: core::array::from_fn(|k| std(1 + k) / mass),
            bias: core::array::from_fn(|k| theta[4 + k]),
            bias_std: core::array::from_fn(|k| std(4 + k)),
            free_air_rms: Some(rms),
            ..before.clone()
        };
        (payload, noise)
    }

    /// Mean residual per axis and its standard deviation.
    pub(super) fn mean_residual(&self, payload: &Payload) -> ([f64; 6], [f64; 6]) {
        let h = Vector3::from(payload.com_m) * payload.mass_kg;
        let mut theta = Parameters::zeros();
        theta[0] = payload.mass_kg;
        theta.fixed_rows_mut::<3>(1).copy_from(&h);
        theta
            .fixed_rows_mut::<6>(4)
            .copy_from(&SVector::<f64, 6>::from(payload.bias));
        let (mut mean, mut std) = ([0.0; 6], [0.0; 6]);
        for axis in 0..6 {
            let left: Vec<f64> = self.blocks[axis / 3]
                .iter()
                .filter(|(row, _)| row[4 + axis] == 1.0)
                .map(|(row, target)| target - row.dot(&theta))
                .collect();
            let n = left.len().max(1) as f64;
            mean[axis] = left.iter().sum::<f64>() / n;
            let spread = left.iter().map(|v| (v - mean[axis]).powi(2)).sum::<f64>() / n;
            std[axis] = (spread / effective_count(&left).max(1.0)).sqrt();
        }
        (mean, std)
    }
}

/// Columns of m, h of force and torque.
fn model(kinematics: &ToolKinematics, i: usize) -> [SMatrix<f64, 3, 4>; 2] {
    let (s, w, dw) = (
        kinematics.specific[i],
        kinematics.rate[i],
        kinematics.angular[i],
    );
    let (ws, dws) = (w.cross_matrix(), dw.cross_matrix());
    let mut force = SMatrix::<f64, 3, 4>::zeros();
    force.set_column(0, &s);
    force.fixed_columns_mut::<3>(1).copy_from(&-(dws + ws * ws));
    let mut torque = SMatrix::<f64, 3, 4>::zeros();
    torque
        .fixed_columns_mut::<3>(1)
        .copy_from(&-s.cross_matrix());
    [force, torque]
}
