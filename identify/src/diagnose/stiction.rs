//! Names stiction: much more to leave rest than to slide, and no more to slide slowly than fast.

use std::sync::Arc;

use nalgebra::DMatrix;

use super::breakaway::{Breakaway, Fall, Median};
use super::confirm::{Confirmation, shown};
use super::diagnosis::{Ambiguity, Diagnosis, NamedEffect, Refused, fit_found};
use super::gates::gives;
use super::model::Found;
use crate::dynamics::{DynamicsError, EffortModel};
use crate::effect::friction::{STICTION, STRIBECK};
use crate::effect::slip;
use crate::motion::{Motion, MotionSettings};
use crate::samples::JointSamples;

/// Break-aways that it takes to tell.
const LEAST_COUNT: usize = 6;
/// Static friction up to one and a half times the sliding one is what dry contacts have.
const UNUSUAL: f64 = 0.5;
/// So many standard deviations are no chance.
const SURELY: f64 = 2.0;
/// Of the speeds of a fall those that the smoothed motion does not show apart from none.
const TOO_SLOW: usize = 1;

impl Breakaway {
    /// Whether that is more than dry contacts have as a rule.
    fn is_stiction(&self) -> bool {
        let Median { value, std, count } = self.excess;
        count >= LEAST_COUNT && value - SURELY * std > UNUSUAL * self.sliding
    }

    fn is_unusual(&self) -> bool {
        self.excess.value > UNUSUAL * self.sliding
    }

    /// Why it is no stiction for sure.
    fn doubt(&self) -> String {
        let Median { value, std, count } = self.excess;
        let sliding = self.sliding;
        format!(
            "it takes {value:.3} ± {std:.3} more to leave rest than to slide ({count} times away from the ends, {LEAST_COUNT} are needed): not surely more than \
             half of the {sliding:.3} that sliding takes, which dry contacts have; start from rest more often, and slowly"
        )
    }

    /// Whether it may be one of several recordings that show it surely: beyond what dry contacts have and beyond chance, each alone.
    fn confirms(&self) -> bool {
        let Median { value, std, count } = self.excess;
        count >= LEAST_COUNT && self.is_unusual() && value > SURELY * std
    }

    /// The fall by which it is surely told better than without one: of those about as good as the best the fastest, which the motion shows best.
    fn surely_falls(&self) -> Option<Fall> {
        let gain = |fall: &&Fall| fall.gain.value;
        let best = self
            .falls
            .iter()
            .max_by(|a, b| gain(a).total_cmp(&gain(b)))?;
        let as_good = best.gain.value - best.gain.std;
        let mut fastest = self.falls.iter().rev();
        let fall = fastest.find(|fall| fall.gain.value >= as_good)?;
        (best.gain.value > SURELY * best.gain.std).then_some(*fall)
    }

    /// Whether it may fall as a Stribeck friction does, of those that the motion shows apart from none.
    fn may_fall(&self) -> bool {
        let mut falls = self.falls.iter().skip(TOO_SLOW);
        falls.any(|fall| fall.gain.value > -SURELY * fall.gain.std)
    }
}

/// Another recording, and how its joint leaves rest.
struct Other<'a> {
    file: &'a str,
    motion: Motion,
    /// Nothing where it does not show the effects apart.
    there: Option<Seen>,
}

struct Seen {
    breakaway: Option<Breakaway>,
    /// See [`errors`].
    rms: [f64; 2],
}

/// Names what the joint surely took more than usual to break away with, here or here and on all of `others` (file name, samples) together, and more than
/// usual on each of these, when nothing else is missing that could be taken for it: a seal that peels off resists on the way behind its place, too.
/// It is a Stribeck friction where it surely falls with the speed, which no fit of the motion shows when it is gone within the first centimetres
/// per second, and stiction, as large as it is here, otherwise.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn add_stiction(
    diagnosis: &mut Diagnosis,
    confirmed: &mut [Confirmation],
    others: &[(String, JointSamples)],
    settings: &MotionSettings,
) -> Result<(), DynamicsError> {
    let found = diagnosis.found();
    let slow_speed = diagnosis.motion.slow_speed;
    let of = |motion: &Motion, model: &EffortModel| {
        Breakaway::of(motion, &found, model.theta.as_slice(), slow_speed)
    };
    let Some(here) = of(&diagnosis.motion, &diagnosis.model) else {
        return Ok(());
    };
    let floor = diagnosis.floor.rms.max(diagnosis.simulated_rms);
    let held_out_rms = errors(&diagnosis.motion, &found)?;
    let more = format!(
        "it takes {:.3} more to leave rest than to slide",
        here.excess.value
    );
    let mut refuse = |reason| {
        diagnosis.refused.push(Refused {
            name: STICTION.name,
            reason,
            held_out_rms,
        });
    };
    if !here.confirms() {
        if here.is_unusual() {
            refuse(here.doubt());
        }
        return Ok(());
    }
    let mut elsewhere = Vec::new();
    for (file, samples) in others {
        let motion = Motion::prepare(samples, settings)?;
        let there = match (
            shown(fit_found(&motion, &found))?,
            shown(errors(&motion, &found))?,
        ) {
            (Some(model), Some(rms)) => Some(Seen {
                breakaway: of(&motion, &model),
                rms,
            }),
            _ => None,
        };
        elsewhere.push(Other {
            file,
            motion,
            there,
        });
    }
    let seen = elsewhere.iter().filter_map(|other| other.there.as_ref());
    let all = here.with(seen.filter_map(|there| there.breakaway.as_ref()));
    if !here.is_stiction() && !all.is_stiction() {
        refuse(here.doubt());
        return Ok(());
    }
    if let Some(gives) = found.iter().find(|found| gives(found.kind)) {
        refuse(format!(
            "{more}, but with {} the tool moves before the object does",
            gives.kind.name
        ));
        return Ok(());
    }
    for other in &elsewhere {
        let Some(there) = &other.there else {
            refuse(format!(
                "not confirmed on {}: it does not show the effects apart",
                other.file
            ));
            return Ok(());
        };
        if !there.breakaway.as_ref().is_some_and(Breakaway::confirms) {
            let excess = there
                .breakaway
                .as_ref()
                .map_or(f64::NAN, |b| b.excess.value);
            refuse(format!(
                "not confirmed on {}: there it takes {excess:.3} more to leave rest than to slide, here {:.3}",
                other.file, here.excess.value
            ));
            return Ok(());
        }
    }
    let is_there = found.iter().any(|found| found.kind.name == STRIBECK.name);
    if !is_there
        && let Some(fall) = all.surely_falls()
        && add_stribeck(diagnosis, confirmed, &elsewhere, fall)?
    {
        return Ok(());
    }
    let left = left_between_turns(&diagnosis.motion, &found)?;
    let left = left.min(diagnosis.model.held_out_rms);
    if left > MOST_LEFT * floor {
        diagnosis.refused.push(Refused {
            name: STICTION.name,
            reason: format!(
                "{more}, but {:.1} noise floors are left while it slides: something else is missing",
                left / floor
            ),
            held_out_rms,
        });
        return Ok(());
    }
    for (confirmed, other) in confirmed.iter_mut().zip(&elsewhere) {
        confirmed
            .rms
            .extend(other.there.as_ref().map(|there| there.rms));
    }
    let or_stribeck = Ambiguity {
        name: STRIBECK.name,
        told_apart_by: STRIBECK.separate,
        rival: None,
    };
    let may_fall = !is_there && all.may_fall();
    diagnosis.effects.push(NamedEffect {
        found: Found {
            kind: &STICTION,
            shape: vec![here.excess.value],
            used: Vec::new(),
            object: Arc::default(),
            datum: 0.0,
        },
        held_out_rms,
        p_value: 0.0,
        ambiguous_with: may_fall.then_some(or_stribeck).into_iter().collect(),
        spread: DMatrix::zeros(0, 0),
    });
    Ok(())
}

/// Adds a Stribeck friction of that speed where it lowers the error on held-out strokes here and on all others; whether it does.
fn add_stribeck(
    diagnosis: &mut Diagnosis,
    confirmed: &mut [Confirmation],
    elsewhere: &[Other<'_>],
    fall: Fall,
) -> Result<bool, DynamicsError> {
    let found = diagnosis.found();
    let mut with = found.clone();
    with.push(Found {
        kind: &STRIBECK,
        shape: vec![fall.speed],
        used: vec![true],
        object: Arc::default(),
        datum: 0.0,
    });
    let helps = |motion: &Motion| -> Result<Option<[f64; 2]>, DynamicsError> {
        let Some(model) = shown(fit_found(motion, &with))? else {
            return Ok(None);
        };
        let pair = [fit_found(motion, &found)?.held_out_rms, model.held_out_rms];
        Ok((pair[1] < pair[0]).then_some(pair))
    };
    let Some(held_out_rms) = helps(&diagnosis.motion)? else {
        return Ok(false);
    };
    let mut pairs = Vec::new();
    for other in elsewhere {
        let Some(pair) = helps(&other.motion)? else {
            return Ok(false);
        };
        pairs.push(pair);
    }
    for (confirmed, pair) in confirmed.iter_mut().zip(pairs) {
        confirmed.rms.push(pair);
    }
    diagnosis
        .effects
        .extend(with.pop().map(|found| NamedEffect {
            found,
            held_out_rms,
            p_value: 0.0,
            ambiguous_with: Vec::new(),
            spread: DMatrix::zeros(0, 0),
        }));
    diagnosis.refit()?;
    Ok(true)
}

/// While more noise floors than this are left, what holds the joint at rest has no sure name.
const MOST_LEFT: f64 = 1.3;

/// Error on held-out strokes away from where the joint turns: there what holds it at rest is felt, too.
fn left_between_turns(motion: &Motion, found: &[Found]) -> Result<f64, DynamicsError> {
    let mut between = motion.clone();
    between.leave_out_turns();
    let model = shown(fit_found(&between, found))?;
    Ok(model.map_or(f64::INFINITY, |model| model.held_out_rms))
}

/// Errors on held-out strokes of a model that takes rest for sliding, and of one that lets friction take up what the hand gives.
fn errors(motion: &Motion, found: &[Found]) -> Result<[f64; 2], DynamicsError> {
    let mut sliding = motion.clone();
    for (slides, t) in sliding.slides.iter_mut().zip(&motion.time) {
        *slides = !slip::slides(&motion.slips, *t);
    }
    Ok([
        fit_found(&sliding, found)?.held_out_rms,
        fit_found(motion, found)?.held_out_rms,
    ])
}

#[cfg(test)]
mod tests {
    use core::f64::consts::PI;

    use super::*;
    use crate::effect::friction::falling;
    use crate::samples::Aside;
    use crate::screw::JointKind;

    const RATE: f64 = 400.0;
    const PLACES: [f64; 16] = [
        0.0, 0.4, 0.2, 0.3, 0.1, 0.25, 0.15, 0.3, 0.1, 0.2, 0.3, 0.12, 0.28, 0.1, 0.2, 0.0,
    ];

    /// Pulls from place to place: 0.8 s of pulling harder and harder at rest, up to `extra` above the sliding friction of 4 N, then
    /// 0.7 s of 3 kg on the way, where by the speed `falls` half of that is gone, or all of it at once.
    fn pulled(extra: f64, falls: Option<f64>) -> JointSamples {
        let (mut q, mut tau) = (Vec::new(), Vec::new());
        for pair in PLACES.windows(2) {
            let way = pair[1] - pair[0];
            let (rest, moves) = ((0.8 * RATE) as usize, (0.7 * RATE) as usize);
            for i in 0..rest {
                q.push(pair[0]);
                tau.push(way.signum() * (4.0 + extra) * i as f64 / rest as f64);
            }
            for i in 0..moves {
                let (w, u) = (PI / 0.7, PI * i as f64 / moves as f64);
                q.push(pair[0] + 0.5 * way * (1.0 - u.cos()));
                let (dq, ddq) = (0.5 * way * w * u.sin(), 0.5 * way * w * w * u.cos());
                let left = falls.map_or(0.0, |speed| extra * falling(speed, dq));
                tau.push(3.0 * ddq + (4.0 + left) * way.signum() + 2.0 * dq);
            }
        }
        JointSamples {
            kind: JointKind::Prismatic,
            period: 1.0 / RATE,
            runs: vec![0..q.len()],
            time: (0..q.len()).map(|i| i as f64 / RATE).collect(),
            q,
            tau,
            noise_of_q: Vec::new(),
            aside: Aside::default(),
        }
    }

    fn measured(extra: f64, falls: Option<f64>) -> (Breakaway, f64) {
        let motion = Motion::prepare(&pulled(extra, falls), &MotionSettings::default()).unwrap();
        let model = fit_found(&motion, &[]).unwrap();
        let found = Breakaway::of(&motion, &[], model.theta.as_slice(), motion.slow_speed);
        (found.unwrap(), model.theta[1])
    }

    fn like(value: f64, sliding: f64, count: usize) -> Breakaway {
        Breakaway {
            excess: Median {
                value,
                std: 0.3,
                count,
            },
            sliding,
            falls: Vec::new(),
        }
    }

    #[test]
    fn less_confirms_it_than_it_takes_to_find_it() {
        let like = |value, sliding| like(value, sliding, LEAST_COUNT);
        assert!(like(2.7, 4.0).is_stiction() && like(2.7, 4.0).confirms());
        assert!(!like(2.3, 4.0).is_stiction() && like(2.3, 4.0).confirms());
        assert!(!like(1.9, 4.0).confirms());
        assert!(!like(0.5, 0.5).confirms());
    }

    #[test]
    fn recordings_together_are_surer_than_each_and_count_by_how_often_the_joint_left_rest() {
        let near = like(2.5, 4.0, 6);
        assert!(!near.is_stiction() && near.with([&near].into_iter()).is_stiction());
        let few = near.with([&like(2.1, 4.0, 3)].into_iter()).excess;
        let many = near.with([&like(2.1, 4.0, 18)].into_iter()).excess;
        assert!((few.value - 2.3667).abs() < 1e-3 && (few.std - 0.2236).abs() < 1e-3);
        assert!((many.value - 2.2).abs() < 1e-9 && (many.std - 0.2372).abs() < 1e-3);
        assert_eq!(many.count, 24);
    }

    #[test]
    fn more_effort_to_leave_rest_than_to_slide_is_seen_and_inertia_is_not_taken_for_it() {
        let (none, coulomb) = measured(0.0, None);
        assert!(
            none.excess.value.abs() < 0.1 * 4.0 && !none.is_stiction(),
            "{none:?}"
        );
        assert!((coulomb - 4.0).abs() < 0.2, "{coulomb}");
        let (much, coulomb) = measured(5.0, None);
        assert!(
            (much.excess.value - 5.0).abs() < 0.1 * 5.0 && much.is_stiction(),
            "{much:?}"
        );
        // Friction at rest is no sliding friction.
        assert!((coulomb - 4.0).abs() < 0.2, "{coulomb}");
    }

    #[test]
    fn what_falls_while_it_slides_is_told_from_what_is_gone_at_once() {
        let (at_once, _) = measured(5.0, None);
        assert!(
            at_once.surely_falls().is_none() && !at_once.may_fall(),
            "{at_once:?}"
        );
        let (falls, _) = measured(5.0, Some(0.02));
        let fall = falls.surely_falls().unwrap();
        assert!((0.5..2.0).contains(&(fall.speed / 0.02)), "{falls:?}");
    }
}
