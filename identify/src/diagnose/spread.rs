//! How well the sizes and the shapes of the named effects are known, together: a size that is known to a percent where its effect sits just there
//! and reaches just so far may be known to no more than half when neither is sure. A magnet's size is its pull at the closed end, and where that is is
//! known no better than the position sensor wanders.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::diagnosis::Diagnosis;
use super::model::{Columns, Found, RIGID};
use super::shapes::{Free, free_of, moves};
use crate::dynamics::{DynamicsError, EffortModel, covariance_of_columns};
use crate::effect::library::{Object, Scope};
use crate::effect::load::CATCH;
use crate::effect::{Effect, RigidBody};
use crate::least_squares::rms;
use crate::motion::{Motion, MotionError};
use crate::samples::JointSamples;

/// States the uncertainty of the diagnosis' model and of its effects' shapes, with each allowed for in that of the others.
///
/// # Errors
/// When an effect has no regressor on the motion.
pub(crate) fn state_spread(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let found = diagnosis.found();
    let object = Object::default();
    let scope = Scope::of(&diagnosis.motion, &object);
    let free = free_of(&scope, &found);
    let Some(spread) = spread(&diagnosis.motion, &found, &diagnosis.model, &free)? else {
        return Ok(());
    };
    let model = &mut diagnosis.model;
    let params = model.theta.len();
    for (j, term) in model.terms.iter_mut().enumerate() {
        term.std = term.std.map(|_| spread[(j, j)].max(0.0).sqrt());
    }
    model.covariance = spread.view((0, 0), (params, params)).into_owned();
    let wander = wander(&diagnosis.samples);
    let theta: Vec<f64> = model.theta.iter().copied().collect();
    let regressed = diagnosis.effects.iter_mut();
    let regressed = regressed.filter(|effect| !effect.found.taken_out());
    let mut at = RIGID;
    for (k, effect) in regressed.enumerate() {
        let found = &effect.found;
        let own = &theta[at..at + found.terms().count()];
        let terms = (at..at + own.len()).map(|j| Some((j, 1.0)));
        at += own.len();
        // Where a shape stands in the covariance, and what its steps are. Of one that the data do not show only its limits are known.
        let shapes = found.shape.iter().enumerate().map(|(shape, value)| {
            let is_it = |free: &Free| (free.effect, free.shape) == (k, shape);
            let place = free.iter().position(is_it)?;
            let (at, free) = (params + place, &free[place]);
            let is_shown = spread[(at, at)] < SHOWN_BELOW * free.reach().powi(2);
            is_shown.then(|| (at, free.per_step(*value)))
        });
        let places: Vec<Option<(usize, f64)>> = terms.chain(shapes).collect();
        effect.spread = DMatrix::from_fn(places.len(), places.len(), |i, j| {
            let both = places[i].zip(places[j]);
            both.map_or(0.0, |((i, a), (j, b))| spread[(i, j)] * a * b)
        });
        let moved = by_closed_end(found, own) * wander;
        effect.spread += &moved * moved.transpose();
    }
    Ok(())
}

/// Share of the variance that a search's limits leave from which on the data show a shape.
pub(super) const SHOWN_BELOW: f64 = 0.8;

/// How far the position sensor wanders, rms, in the unit of the coordinate; 0 where that is not known.
pub(super) fn wander(samples: &JointSamples) -> f64 {
    let squares = samples.noise_of_q.iter().map(|series| {
        let mean = series.iter().sum::<f64>() / series.len().max(1) as f64;
        let away: Vec<f64> = series.iter().map(|v| v - mean).collect();
        rms(&away).powi(2)
    });
    let count = samples.noise_of_q.len().max(1) as f64;
    (squares.sum::<f64>() / count).sqrt()
}

/// What the numbers of a magnet, with `terms`, change by when its closed end, which is the lowest place that was measured, is said to be a unit further on:
/// the effort elsewhere stays as it is.
pub(super) fn by_closed_end(found: &Found, terms: &[f64]) -> DVector<f64> {
    let mut out = DVector::zeros(terms.len() + found.shape.len());
    if let (true, [pull], [_, reach, inverse_square]) =
        (found.kind.is(&CATCH), terms, found.shape.as_slice())
    {
        let [falls, grows] = if *inverse_square > 0.5 {
            [2.0, 1.0]
        } else {
            [1.0, 0.0]
        };
        let numbers = [-falls * pull / reach, 1.0, grows, 0.0];
        out.copy_from_slice(&numbers);
    }
    out
}

/// Covariance of the terms of `model` and then of the `free` shapes in steps of theirs; nothing where the recording is too short to say.
fn spread(
    motion: &Motion,
    found: &[Found],
    model: &EffortModel,
    free: &[Free],
) -> Result<Option<DMatrix<f64>>, DynamicsError> {
    let columns_of = |effect: &dyn Effect| -> Result<Columns, MotionError> {
        let columns = effect.columns(motion)?.into_iter();
        Ok(Arc::new(columns.map(|column| column.values).collect()))
    };
    let own: Vec<Columns> = found
        .iter()
        .map(|found| columns_of(found))
        .collect::<Result<_, _>>()?;
    let rigid = columns_of(&RigidBody)?;
    let theta = &model.theta.as_slice()[rigid.len()..];
    let shaped = moves(motion, found, &own, theta, free)?;
    let linear = core::iter::once(&rigid).chain(&own);
    let mut columns: Vec<Vec<f64>> = linear.flat_map(|own| own.iter().cloned()).collect();
    columns.extend(shaped);
    let params = model.theta.len();
    let variance = model.rms.powi(2) * model.residual.len() as f64 / model.effective_samples;
    let within = |j: usize| Some(free[j.checked_sub(params)?].reach());
    let at_bound = |j: usize| j < params && model.theta[j] == 0.0;
    let residual = (model.residual.as_slice(), variance);
    Ok(covariance_of_columns(
        motion, &columns, residual, within, at_bound,
    ))
}
