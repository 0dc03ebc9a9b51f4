//! How well the sizes and the shapes of the named effects are known, together: a size that is known to a percent where its effect sits just there
//! and reaches just so far may be known to no more than half when neither is sure.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::model::{Columns, Found};
use super::search::Diagnosis;
use super::shapes::{Free, free_of, moves};
use crate::dynamics::{DynamicsError, EffortModel, covariance_of_columns};
use crate::effect::library::Scope;
use crate::effect::{Effect, RigidBody};
use crate::motion::{Motion, MotionError};

/// States the uncertainty of the diagnosis' model and of its effects' shapes, with each allowed for in that of the others.
///
/// # Errors
/// When an effect has no regressor on the motion.
pub(crate) fn state_spread(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let found = diagnosis.found();
    let scope = Scope::of(&diagnosis.motion, [0.0; 3]);
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
    let regressed = diagnosis.effects.iter_mut();
    let regressed = regressed.filter(|effect| !effect.found.taken_out());
    let mut at = 3;
    for (k, effect) in regressed.enumerate() {
        let found = &effect.found;
        let terms = (at..at + found.terms().count()).map(|j| Some((j, 1.0)));
        at += terms.len();
        // Where a shape stands in the covariance, and what its steps are.
        let shapes = found.shape.iter().enumerate().map(|(shape, value)| {
            let is_it = |free: &Free| (free.effect, free.shape) == (k, shape);
            let place = free.iter().position(is_it)?;
            Some((params + place, free[place].per_step(*value)))
        });
        let places: Vec<Option<(usize, f64)>> = terms.chain(shapes).collect();
        effect.spread = DMatrix::from_fn(places.len(), places.len(), |i, j| {
            let both = places[i].zip(places[j]);
            both.map_or(0.0, |((i, a), (j, b))| spread[(i, j)] * a * b)
        });
    }
    Ok(())
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
