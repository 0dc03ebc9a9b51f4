//! Look-alikes told apart by the other recordings of the same object: what did nearly as well in the place of an effect on the
//! first recording must do so on these, too.

use std::sync::Arc;

use super::confirm::{objects, with_columns};
use super::diagnosis::{Ambiguity, Diagnosis, NamedEffect, Refused, fit_found};
use super::elsewhere::{datum, error_on, regripped};
use super::finish::{are_of_one_class, is_play_for_grasp};
use super::gates::gives;
use super::model::{Found, Ground};
use crate::dynamics::DynamicsError;

/// A look-alike is none when, in the place of the effect, it errs more on every confirming recording, and its squared error is so many times that of the
/// effect in their mean. The first recording has had its say: it chose.
const APART: f64 = 1.03;
/// Play is a grasp that gives with a gap besides. Over all recordings, the first one too, it must err less than that in the (geometric) mean, with pads that
/// each grip has anew as the grasp has them; else nothing speaks for a gap.
const EVEN: f64 = 1.0;

/// Takes back the look-alikes of the effects of `diagnosis` that the confirming recordings `grounds` tell apart from them, and play that they show to
/// be a grasp that gives; this is then refused, and what looks again without it finds a better shape.
///
/// The terms of the model with the look-alike are those that confirm an effect: of the first recording, but for what belongs to each. What no
/// motion tells apart (a constant and a friction of two sizes), what holds the other as a special case, and what only a part of an
/// effect may be stays.
pub(super) fn tell_apart<'a>(
    diagnosis: &mut Diagnosis,
    grounds: impl Iterator<Item = &'a Ground> + Clone,
) -> Result<(), DynamicsError> {
    let mut found = objects(diagnosis);
    let are_alike = |effect: &NamedEffect| effect.ambiguous_with.iter().any(|a| a.rival.is_some());
    if grounds.clone().next().is_none() || !diagnosis.effects.iter().any(are_alike) {
        return Ok(());
    }
    let mut own = errors(diagnosis, &found, grounds.clone())?;
    for i in 0..diagnosis.effects.len() {
        let Some(place) = with_columns(diagnosis, i) else {
            continue;
        };
        let mut alike = Vec::new();
        for one in core::mem::take(&mut diagnosis.effects[i].ambiguous_with) {
            let Some(rival) = &one.rival else {
                alike.push(one);
                continue;
            };
            let mut with = found.clone();
            with[place] = rival.clone();
            if gives(rival.kind) && gives(found[place].kind) {
                with[place].object = Arc::clone(&found[place].object);
            }
            // One that another effect holds leaves no fit: nothing tells it apart.
            let Ok(its) = errors(diagnosis, &with, grounds.clone()) else {
                alike.push(one);
                continue;
            };
            let ratios: Vec<f64> = its
                .iter()
                .zip(&own)
                .map(|(its, own)| (its / own).powi(2))
                .collect();
            let name = found[place].kind.name;
            if is_play_for_grasp(name, one.name) && geometric_mean(&ratios) <= EVEN {
                diagnosis.refused.retain(|refused| refused.name != one.name);
                diagnosis.refused.push(Refused {
                    name,
                    reason: "a grasp that gives errs no more in the mean over all recordings"
                        .to_owned(),
                    held_out_rms: [its[0], own[0]],
                });
                diagnosis.effects[i].found = with[place].clone();
                (found, own) = (with, its);
            } else if !is_apart(&one, name, &ratios) {
                alike.push(one);
            }
        }
        diagnosis.effects[i].ambiguous_with = alike;
    }
    Ok(())
}

/// Whether the squared errors of the model with a look-alike over those with the effect `name`, of the first recording and of the confirming ones, tell
/// the two apart.
fn is_apart(alike: &Ambiguity, name: &'static str, ratios: &[f64]) -> bool {
    if are_of_one_class(alike.name, name) {
        return false;
    }
    if is_play_for_grasp(alike.name, name) {
        return geometric_mean(ratios) > EVEN;
    }
    let others = &ratios[1..];
    let mean = others.iter().sum::<f64>() / others.len() as f64;
    others.iter().all(|&ratio| ratio > 1.0) && mean > APART
}

/// The same whichever of the two was named.
fn geometric_mean(of: &[f64]) -> f64 {
    (of.iter().map(|ratio| ratio.ln()).sum::<f64>() / of.len() as f64).exp()
}

/// Errors of a model of the first recording: there, on held-out strokes, and on the others.
fn errors<'a>(
    diagnosis: &Diagnosis,
    found: &[Found],
    grounds: impl Iterator<Item = &'a Ground>,
) -> Result<Vec<f64>, DynamicsError> {
    let model = fit_found(&diagnosis.motion, found)?;
    let theta = model.theta.as_slice();
    let mut out = vec![model.held_out_rms];
    for ground in grounds {
        let datum = datum(diagnosis, found, theta, ground)?;
        let there = regripped(found, theta, ground, datum)?;
        out.push(error_on(&there, theta, ground, datum)?.0);
    }
    Ok(out)
}
