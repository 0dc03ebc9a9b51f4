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
use crate::motion::Motion;

/// States the uncertainty of the diagnosis' model and of its effects' shapes, with each allowed for in that of the others.
///
/// # Errors
/// When an effect has no regressor on the motion.
pub(crate) fn state_spread(diagnosis: &mut Diagnosis) -> Result<(), DynamicsError> {
    let found = diagnosis.found();
    if found.is_empty() {
        return Ok(());
    }
    let scope = Scope::of(&diagnosis.motion, found[0].rigid);
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
    let mut regressed: Vec<_> = regressed.filter(|e| !e.found.taken_out()).collect();
    for (k, parameter) in free.iter().enumerate() {
        let effect = &mut regressed[parameter.effect];
        let unit = parameter.per_step(effect.found.shape[parameter.shape]);
        effect.shape_std.resize(effect.found.shape.len(), None);
        let std = spread[(params + k, params + k)].max(0.0).sqrt();
        effect.shape_std[parameter.shape] = Some(std.min(parameter.reach()) * unit.abs());
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
    let mut columns: Vec<Vec<f64>> = RigidBody
        .columns(motion)?
        .into_iter()
        .map(|column| column.values)
        .collect();
    let mut own: Vec<Columns> = Vec::new();
    for found in found {
        let values = Effect::columns(found, motion)?
            .into_iter()
            .map(|c| c.values);
        own.push(Arc::new(values.collect()));
    }
    columns.extend(own.iter().flat_map(|own| own.iter().cloned()));
    let theta = &model.theta.as_slice()[3..];
    columns.extend(moves(motion, found, &own, theta, free)?);
    let params = model.theta.len();
    let variance = model.rms.powi(2) * model.residual.len() as f64 / model.effective_samples;
    // A shape is somewhere within the limits of its search, whatever the data say.
    let reaches = free.iter().map(|free| variance / free.reach().powi(2));
    let known: Vec<f64> = core::iter::repeat_n(0.0, params).chain(reaches).collect();
    let at_bound = |j: usize| j < params && model.theta[j] == 0.0;
    let residual = &model.residual;
    Ok(covariance_of_columns(
        motion, &columns, &known, residual, at_bound,
    ))
}
