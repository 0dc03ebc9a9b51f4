//! The published recipe for the EMPS benchmark: inverse-dynamics identification by least squares (IDIM-LS).
//!
//! Low-pass the position (zero phase), differentiate twice by central differences, drop the first samples, decimate every
//! column and the effort through the same filter, then least squares on `[ddq, sgn(dq), dq]` and, when asked, a constant.
//! Edges, first sample and counting are those of the published MATLAB script: the result agrees to the last digit given
//! (95.1089 kg, 203.5034 N s/m, 20.3935 N, -3.1648 N, 4.0834 %). With scipy's edges the same recipe gives 4.139 %.
//!
//! # Source
//! A. Janot, M. Gautier, M. Brunot, *Data set and reference models of EMPS*, Workshop on Nonlinear System Identification
//! Benchmarks, 2019.

use core::ops::Range;

use super::TableError;
use crate::analysis::{Analysis, FitSeries, judge};
use crate::dynamics::{DynamicsError, Structure, fit_columns};
use crate::effect::Column;
use crate::error::IdentifyError;
use crate::filter::{LowPass, central_difference, decimate, every};
use crate::least_squares::{Bound, FitError, rms};
use crate::motion::{MotionSettings, strokes};
use crate::noise::NoiseFloor;
use crate::samples::JointSamples;

/// Settings of the recipe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recipe {
    /// Cut-off of the low-pass on the position, Hz.
    pub lowpass_hz: f64,
    /// Butterworth order of that low-pass in each of its two passes.
    pub lowpass_order: usize,
    /// Every so many-th sample is kept.
    pub decimate: usize,
    /// First sample kept before decimation, counted from 1; those before it are dropped, none is at the end.
    pub drop_border: usize,
    /// Whether a constant load is fitted too.
    pub offset: bool,
}

/// Runs the recipe: `base` without the constant, `full` with it when asked. No gates, no mechanism, no lag.
///
/// # Errors
/// Filter and fit errors.
pub fn identify_published(
    samples: &JointSamples,
    recipe: &Recipe,
) -> Result<Analysis, IdentifyError> {
    let rows = samples.runs.iter().map(Range::len).max().unwrap_or(0);
    if recipe.drop_border > rows {
        return Err(IdentifyError::Table(TableError::NothingLeft {
            drop_border: recipe.drop_border,
            rows,
        }));
    }
    let filter = LowPass::butterworth(recipe.lowpass_order, recipe.lowpass_hz, samples.rate_hz())?;
    let mut kept = FitSeries::default();
    let (mut acceleration, mut sign, mut constant, mut stroke) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (low, high) = samples.q_range();
    for run in &samples.runs {
        let q = filter.zero_phase_matlab(&samples.q[run.clone()])?;
        let dq = central_difference(&q, samples.period);
        let ddq = central_difference(&dq, samples.period);
        let signs: Vec<f64> = dq
            .iter()
            .map(|v| if *v == 0.0 { 0.0 } else { v.signum() })
            .collect();
        let number = stroke.last().map_or(0, |last| last + 1);
        let of_sample = strokes(&[0..q.len()], &q, 0.03 * (high - low));
        let inner = recipe.drop_border.saturating_sub(1).min(q.len())..q.len();
        let part = |series: &[f64]| decimate(&series[inner.clone()], recipe.decimate);
        acceleration.extend(part(&ddq)?);
        sign.extend(part(&signs)?);
        constant.extend(part(&vec![1.0; q.len()])?);
        kept.dq.extend(part(&dq)?);
        kept.tau.extend(part(&samples.tau[run.clone()])?);
        kept.q.extend(every(&q[inner.clone()], recipe.decimate));
        let time = &samples.time[run.clone()][inner.clone()];
        kept.time.extend(every(time, recipe.decimate));
        stroke.extend(every(&of_sample[inner], recipe.decimate).map(|s| s + number));
    }
    let kind = samples.kind;
    let column = |name, unit: &str, bound, values: &[f64]| Column {
        name,
        unit: unit.to_owned(),
        bound,
        values: values.to_vec(),
    };
    let mut columns = vec![
        column(
            "inertia",
            kind.inertia_unit(),
            Bound::NonNegative,
            &acceleration,
        ),
        column("coulomb", kind.effort_unit(), Bound::NonNegative, &sign),
        column("viscous", kind.viscous_unit(), Bound::NonNegative, &kept.dq),
    ];
    let count = (stroke.iter().max().map_or(0, |s| s / 2) + 1).clamp(1, 6);
    let folds = || {
        (
            stroke
                .iter()
                .map(|s| (s / 2) % count)
                .collect::<Vec<usize>>(),
            count,
        )
    };
    if kept.tau.is_empty() {
        return Err(DynamicsError::from(FitError::TooFewSamples {
            samples: 0,
            params: 3,
            needed: 19,
        })
        .into());
    }
    let base = fit_columns(columns.clone(), kept.tau.clone(), folds())?;
    if recipe.offset {
        columns.push(column("load", kind.effort_unit(), Bound::Free, &constant));
    }
    let full = fit_columns(columns, kept.tau.clone(), folds())?;
    // The recipe says nothing about noise; the part of the residual that changes from one sample to the next is taken.
    let steps: Vec<f64> = full
        .residual
        .windows(2)
        .map(|w| (w[1] - w[0]) / 2.0_f64.sqrt())
        .collect();
    let floor = NoiseFloor {
        rms: rms(&steps),
        wrench_rms: f64::NAN,
        position_rms: f64::NAN,
    };
    let (verdict, unexplained_fraction) = judge((&full, &[]), &[], floor.rms, rms(&kept.tau));
    Ok(Analysis {
        kind,
        q_range: [low, high],
        base,
        named: full.clone(),
        full,
        left_to_mechanism: false,
        jointly: None,
        diagnosis: None,
        evidence: Vec::new(),
        confirmed: Vec::new(),
        lag: None,
        floor,
        structure: Vec::<Structure>::new(),
        bursts: None,
        verdict,
        unexplained_fraction,
        settings: MotionSettings {
            cutoff_hz: recipe.lowpass_hz,
            order: recipe.lowpass_order,
            work_rate_hz: samples.rate_hz(),
            gives_way: false,
            turns_left_out: false,
        },
        cutoff_lowered: false,
        used: kept.tau.len(),
        gated: [(
            "border",
            recipe.drop_border.saturating_sub(1) * samples.runs.len(),
        )]
        .into(),
        probing: FitSeries {
            tau: Vec::new(),
            ..kept.clone()
        },
        series: kept,
    })
}
