//! Look-alikes told apart by the other recordings of the same object: what did nearly as well in the place of an effect on the
//! first recording must do so on these, too.

use std::sync::Arc;

use super::alike::{are_of_one_class, is_more_than, is_play_for_grasp};
use super::confirm::{objects, with_columns};
use super::diagnosis::{Diagnosis, NamedEffect, Refused, fit_found};
use super::elsewhere::{datum, error_on, regripped};
use super::finish::make_anew;
use super::gates::{gives, most_of};
use super::model::{Found, Ground};
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::DynamicsError;

/// A look-alike is none when, in the place of the effect, it errs more on every confirming recording, and its squared error is so many times that of the
/// effect in their mean. The first recording has had its say: it chose.
const APART: f64 = 1.03;
/// Nor is it one that errs more on every recording, its squared error so many times that of the effect in the confirming ones' mean (a zero of the coordinate
/// that is found for the one and not for the other makes 1 %),
const LEAST_APART: f64 = 1.01;
/// and as likely to by chance as once in so many times on the confirming ones,
const ODDS: f64 = 10.0;
/// and on all together.
const ODDS_OF_ALL: f64 = 100.0;
/// What holds another effect as a special case (play is a grasp that gives with a gap besides, a damper's zone may be the whole range) has more free numbers:
/// its squared error must be less than so many times that of the special case in the (geometric) mean over all recordings, the first one too, where pads are
/// as each grip has them. Else it is no look-alike of it, and a zone, which has four numbers more, goes. Play that was named goes where it is no better at all:
/// the search, which prefers fewer numbers, saw its gap, and how pads hit the handle behind that is in no model. Simulated grasps that give had 0.968 and more,
/// plays 0.974 and less.
const WORTH_MORE: f64 = 0.96;

/// Takes back the look-alikes of the effects of `diagnosis` that the confirming recordings `grounds` tell apart from them, and play and zones that they show to
/// be no more than a special case; these are then refused, and what looks again without them finds a better shape.
///
/// The terms of the model with the look-alike are those that confirm an effect: of the first recording, but for what belongs to each. A look-alike stays
/// where no motion tells it apart (a constant and a friction of two sizes), where one holds the other as a special case, but for play, and where only a part of
/// an effect may be it.
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
            let pairs = its.rms.iter().zip(&own.rms);
            let ratios: Vec<f64> = pairs.map(|(its, own)| (its / own).powi(2)).collect();
            let kind = found[place].kind;
            let is_no_more = is_more_than(&found[place], rival)
                && if most_of(kind) == 1 {
                    geometric_mean(&ratios) <= 1.0
                } else {
                    // Of what there may be several of another one may be missing.
                    let beside = with.iter().any(|found| found.kind.is(kind));
                    !beside
                        && its.rms[0] < EXPLAINED_BELOW * diagnosis.floor_of_all()
                        && WORTH_MORE * geometric_mean(&ratios) <= 1.0
                };
            if is_no_more {
                diagnosis.refused.retain(|refused| refused.name != one.name);
                diagnosis.refused.push(Refused {
                    name: kind.name,
                    reason: format!(
                        "{}, which has fewer numbers, errs hardly more in the mean over all recordings",
                        one.name
                    ),
                    held_out_rms: [its.rms[0], own.rms[0]],
                });
                diagnosis.effects[i].found = with[place].clone();
                (found, own) = (with, its);
                // What it moved has been made with the effect that is gone.
                if rival.kind.at.is_some() && found.iter().any(|found| gives(found.kind)) {
                    let model = fit_found(&diagnosis.motion, &found)?;
                    make_anew(&mut diagnosis.effects, &found, &model);
                    found = objects(diagnosis);
                    own = errors(diagnosis, &found, grounds.clone())?;
                }
            } else if !is_apart(one.name, kind.name, &ratios, &own.independent) {
                alike.push(one);
            }
        }
        diagnosis.effects[i].ambiguous_with = alike;
    }
    Ok(())
}

/// Whether the squared errors of the model with the look-alike over those with the effect `name`, of the first recording and of the confirming ones, tell
/// the two apart; `independent` = samples that each recording's residual is worth.
fn is_apart(alike: &str, name: &str, ratios: &[f64], independent: &[f64]) -> bool {
    if are_of_one_class(alike, name) {
        return false;
    }
    if is_play_for_grasp(alike, name) {
        return geometric_mean(ratios) >= WORTH_MORE;
    }
    let others = &ratios[1..];
    if others.iter().any(|&ratio| ratio <= 1.0) {
        return false;
    }
    let mean = others.iter().sum::<f64>() / others.len() as f64;
    // Of normal noise.
    let log_odds: Vec<f64> = ratios
        .iter()
        .zip(independent)
        .map(|(ratio, independent)| 0.5 * independent * ratio.ln())
        .collect();
    let is_no_chance = ratios[0] > 1.0
        && mean > LEAST_APART
        && log_odds[1..].iter().sum::<f64>() > ODDS.ln()
        && log_odds.iter().sum::<f64>() > ODDS_OF_ALL.ln();
    mean > APART || is_no_chance
}

/// The same whichever of the two was named.
fn geometric_mean(of: &[f64]) -> f64 {
    (of.iter().map(|ratio| ratio.ln()).sum::<f64>() / of.len() as f64).exp()
}

/// Of a model of the first recording: there, and on each of the others.
struct Errors {
    /// There on held-out strokes.
    rms: Vec<f64>,
    /// Samples that the residual is worth; on the others as many of theirs as there.
    independent: Vec<f64>,
}

fn errors<'a>(
    diagnosis: &Diagnosis,
    found: &[Found],
    grounds: impl Iterator<Item = &'a Ground>,
) -> Result<Errors, DynamicsError> {
    let model = fit_found(&diagnosis.motion, found)?;
    let theta = model.theta.as_slice();
    let mut out = Errors {
        rms: vec![model.held_out_rms],
        independent: vec![model.effective_samples],
    };
    let share = model.effective_samples / model.residual.len() as f64;
    for ground in grounds {
        let datum = datum(diagnosis, found, theta, ground)?;
        let there = regripped(found, theta, ground, datum)?;
        out.rms.push(error_on(&there, theta, ground, datum)?.0);
        out.independent.push(share * ground.y.len() as f64);
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::is_apart;

    fn is_apart_by(alike: &str, name: &str, ratios: &[f64]) -> bool {
        is_apart(alike, name, ratios, &vec![500.0; ratios.len()])
    }

    #[test]
    fn a_gap_must_be_worth_its_number() {
        let play = |ratios: &[f64]| is_apart_by("backlash", "grasp_compliance", ratios);
        assert!(play(&[0.99, 0.97]) && play(&[1.02, 0.93]));
        assert!(!play(&[0.94, 0.93]));
    }

    #[test]
    fn the_other_recordings_tell_apart_and_what_no_motion_does_stays() {
        let notch = |ratios: &[f64]| is_apart_by("detent", "catch", ratios);
        assert!(notch(&[1.0, 1.05]) && notch(&[0.99, 1.02, 1.06]));
        // The first one chose.
        assert!(!notch(&[1.5, 1.009]) && !notch(&[0.99, 1.02]));
        assert!(!notch(&[1.0, 0.99, 1.5]));
        assert!(!is_apart_by(
            "constant_load",
            "asymmetric_coulomb",
            &[1.5, 1.5]
        ));
    }

    #[test]
    fn little_tells_apart_where_it_is_no_chance() {
        let notch =
            |ratios: &[f64], independent: &[f64]| is_apart("detent", "catch", ratios, independent);
        assert!(notch(&[1.01, 1.015], &[500.0, 500.0]));
        assert!(!notch(&[1.005, 1.011], &[500.0, 500.0]));
        // A short recording hardly says anything.
        assert!(!notch(&[1.01, 1.015], &[1000.0, 130.0]));
    }
}
