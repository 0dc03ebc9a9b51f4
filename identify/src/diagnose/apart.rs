//! Look-alikes told apart by the other recordings of the same object: what did nearly as well in the place of an effect on the
//! first recording must do so on these, too.

use super::confirm::{objects, with_columns};
use super::elsewhere::{datum, error_on};
use super::finish::are_of_one_class;
use super::model::{Found, Ground};
use super::search::{Ambiguity, Diagnosis, NamedEffect, fit_found};
use crate::dynamics::DynamicsError;

/// A look-alike is none when, in the place of the effect, it errs more on every confirming recording, and its squared error is so many times that of the
/// effect in their mean. The first recording has had its say: it chose.
const APART: f64 = 1.03;

/// Takes back the look-alikes of the effects of `diagnosis` that the confirming recordings `grounds` tell apart from them.
///
/// The terms of the model with the look-alike are those that confirm an effect: of the first recording, but for what belongs to each. What no
/// motion tells apart (a constant and a friction of two sizes), what holds the other as a special case, and what only a part of an
/// effect may be stays.
pub(super) fn tell_apart<'a>(
    diagnosis: &mut Diagnosis,
    grounds: impl Iterator<Item = &'a Ground> + Clone,
) -> Result<(), DynamicsError> {
    let found = objects(diagnosis);
    let are_alike = |effect: &NamedEffect| effect.ambiguous_with.iter().any(|a| a.rival.is_some());
    if grounds.clone().next().is_none() || !diagnosis.effects.iter().any(are_alike) {
        return Ok(());
    }
    let own = errors(diagnosis, &found, grounds.clone())?;
    for i in 0..diagnosis.effects.len() {
        let Some(place) = with_columns(diagnosis, i) else {
            continue;
        };
        let mut alike = Vec::new();
        for one in core::mem::take(&mut diagnosis.effects[i].ambiguous_with) {
            let stays = match &one.rival {
                Some(rival) => {
                    let mut with = found.clone();
                    with[place] = rival.clone();
                    // One that another effect holds leaves no fit: nothing tells it apart.
                    let its = errors(diagnosis, &with, grounds.clone());
                    !its.is_ok_and(|its| is_apart(&one, found[place].kind.name, &own, &its))
                }
                None => true,
            };
            if stays {
                alike.push(one);
            }
        }
        diagnosis.effects[i].ambiguous_with = alike;
    }
    Ok(())
}

/// Whether the errors of the model with a look-alike on the confirming recordings tell it from the effect `name`.
fn is_apart(alike: &Ambiguity, name: &'static str, own: &[f64], its: &[f64]) -> bool {
    if are_of_one_class(alike.name, name) {
        return false;
    }
    let ratios = || its.iter().zip(own).map(|(its, own)| (its / own).powi(2));
    let mean = ratios().sum::<f64>() / own.len() as f64;
    ratios().all(|ratio| ratio > 1.0) && mean > APART
}

/// Errors of a model of the first recording on the others.
fn errors<'a>(
    diagnosis: &Diagnosis,
    found: &[Found],
    grounds: impl Iterator<Item = &'a Ground>,
) -> Result<Vec<f64>, DynamicsError> {
    let model = fit_found(&diagnosis.motion, found)?;
    let theta = model.theta.as_slice();
    let mut out = Vec::new();
    for ground in grounds {
        let datum = datum(diagnosis, found, theta, ground)?;
        out.push(error_on(found, theta, ground, datum)?.0);
    }
    Ok(out)
}
