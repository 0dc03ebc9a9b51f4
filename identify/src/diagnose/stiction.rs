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
/// Of the speeds of a fall those that the smoothed motion does not show apart from none, and those beyond which the fits of the motion show it.
const TOO_SLOW: usize = 1;
const SLOW: usize = 4;

impl Breakaway {
    /// What it took to leave rest, told from `all` recordings together: what it surely falls as says, and otherwise the least of what may be. A fall that
    /// is taken for gone at once looks two or three times as large.
    fn excess(&self, all: &Self) -> Median {
        let falls = || self.falls.iter().zip(&all.falls);
        if let Some(surely) = all.surely_falls() {
            let mut own = falls().filter(|(_, fall)| **fall == surely);
            return own.next().map_or(self.at_once, |(own, _)| own.excess);
        }
        let may_be = falls().take(SLOW).filter(|(_, all)| all.may_be());
        let excesses = may_be.map(|(own, _)| own.excess);
        excesses.fold(self.at_once, |least, one| {
            if one.value < least.value { one } else { least }
        })
    }

    /// The fall that surely tells better of the motion than none: of those about as good as the best the fastest, which the motion shows best.
    fn surely_falls(&self) -> Option<Fall> {
        let gain = |fall: &&Fall| fall.gain.value;
        let by_gain = |a: &&Fall, b: &&Fall| gain(a).total_cmp(&gain(b));
        let best = self.falls.iter().max_by(by_gain)?;
        let as_good = best.gain.value - best.gain.std;
        let mut fastest = self.falls.iter().rev();
        let fall = fastest.find(|fall| fall.gain.value >= as_good)?;
        (best.gain.value > SURELY * best.gain.std).then_some(*fall)
    }

    /// Whether it may fall as a Stribeck friction does, of those that the motion shows apart from none.
    fn may_fall(&self) -> bool {
        self.falls.iter().skip(TOO_SLOW).any(Fall::may_be)
    }
}

impl Fall {
    /// Whether the motion does not rule it out.
    fn may_be(&self) -> bool {
        self.gain.value > -SURELY * self.gain.std
    }
}

/// What it takes to leave rest beyond sliding, and to slide: N m or N.
#[derive(Clone, Copy, Debug)]
struct Held {
    excess: Median,
    sliding: f64,
}

impl Held {
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
        if count < LEAST_COUNT {
            return format!(
                "it left rest {count} times away from the ends, and {LEAST_COUNT} are needed; start from rest more often, and slowly"
            );
        }
        format!(
            "it takes {value:.3} ± {std:.3} more to leave rest than to slide ({count} times away from the ends): not surely more than \
             half of the {sliding:.3} that sliding takes, which dry contacts have; start from rest more often, and slowly"
        )
    }

    /// Whether it may be one of several recordings that show it surely: beyond what dry contacts have and beyond chance, each alone.
    fn confirms(&self) -> bool {
        let Median { value, std, count } = self.excess;
        count >= LEAST_COUNT && self.is_unusual() && value > SURELY * std
    }
}

/// What was said of stiction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stiction {
    /// It, or a Stribeck friction read off the same rests.
    Named,
    /// It would be, were there not more that is missing.
    BesideMore,
    /// There is none that is sure.
    NotNamed,
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
/// It is a Stribeck friction where it surely falls with the speed and helps, though no search shows it when it is gone within the first centimetres
/// per second, unless that is among the `unconfirmed`; and stiction, as large as it is here, otherwise.
///
/// # Errors
/// [`DynamicsError`].
pub(crate) fn add_stiction(
    diagnosis: &mut Diagnosis,
    confirmed: &mut [Confirmation],
    others: &[(String, JointSamples)],
    settings: &MotionSettings,
    unconfirmed: &[&'static str],
) -> Result<Stiction, DynamicsError> {
    let found = diagnosis.found();
    let slow_speed = diagnosis.motion.slow_speed;
    let of = |motion: &Motion, model: &EffortModel| {
        Breakaway::of(motion, &found, model.theta.as_slice(), slow_speed)
    };
    let Some(here) = of(&diagnosis.motion, &diagnosis.model) else {
        return Ok(Stiction::NotNamed);
    };
    let held = |excess, of: &Breakaway| Held {
        excess,
        sliding: of.sliding,
    };
    if !held(here.at_once, &here).is_unusual() {
        return Ok(Stiction::NotNamed);
    }
    let mut elsewhere = Vec::new();
    for ((file, samples), confirmed) in others.iter().zip(&*confirmed) {
        let samples = samples.with_effort_earlier(confirmed.lag_s);
        let motion = Motion::prepare(&samples, settings)?;
        let model = shown(fit_found(&motion, &found))?;
        let there = match (model, shown(errors(&motion, &found, settings))?) {
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
    let held = |of: &Breakaway| held(of.excess(&all), of);
    let excess = held(&here).excess.value;
    // Beside a friction of next to nothing half of it is nothing.
    if !held(&here).is_unusual() || excess < diagnosis.floor_of_all() {
        return Ok(Stiction::NotNamed);
    }
    if let Some(reason) = why_not(&found, &held(&here), &held(&all)) {
        return refuse(diagnosis, settings, reason, Stiction::NotNamed);
    }
    for other in &elsewhere {
        let Some(there) = &other.there else {
            let file = other.file;
            let reason = format!("not confirmed on {file}: it does not show the effects apart");
            return refuse(diagnosis, settings, reason, Stiction::NotNamed);
        };
        let Some(there) = there.breakaway.as_ref().map(held) else {
            let file = other.file;
            let reason =
                format!("not confirmed on {file}: there it leaves no rest away from the ends");
            return refuse(diagnosis, settings, reason, Stiction::NotNamed);
        };
        if !there.confirms() {
            let reason = format!(
                "not confirmed on {}: there it takes {:.3} more to leave rest than to slide, here {excess:.3}",
                other.file, there.excess.value
            );
            return refuse(diagnosis, settings, reason, Stiction::NotNamed);
        }
    }
    let is_there = found.iter().any(|found| found.kind.name == STRIBECK.name);
    if !is_there
        && !unconfirmed.contains(&STRIBECK.name)
        && let Some(fall) = all.surely_falls()
        && add_stribeck(diagnosis, confirmed, &elsewhere, fall)?
    {
        return Ok(Stiction::Named);
    }
    let left = left_between_turns(&diagnosis.motion, &found)?;
    let floors = left.min(diagnosis.model.held_out_rms) / diagnosis.floor_of_all();
    if floors > MOST_LEFT {
        let reason = format!(
            "it takes {excess:.3} more to leave rest than to slide, but {floors:.1} noise floors are left while it slides: something else is missing"
        );
        return refuse(diagnosis, settings, reason, Stiction::BesideMore);
    }
    let pairs = elsewhere.iter().filter_map(|other| other.there.as_ref());
    for (confirmed, there) in confirmed.iter_mut().zip(pairs) {
        confirmed.rms.push(there.rms);
    }
    let or_stribeck = Ambiguity {
        name: STRIBECK.name,
        told_apart_by: STRIBECK.separate,
        rival: None,
    };
    let falls = all.may_fall() || all.surely_falls().is_some();
    let held_out_rms = errors(&diagnosis.motion, &found, settings)?;
    diagnosis.effects.push(NamedEffect {
        found: Found {
            kind: &STICTION,
            // A fall that the motion does not show apart from none counts as none.
            shape: vec![if falls { excess } else { here.at_once.value }],
            used: Vec::new(),
            object: Arc::default(),
            datum: 0.0,
        },
        held_out_rms,
        p_value: 0.0,
        ambiguous_with: (falls && !is_there)
            .then_some(or_stribeck)
            .into_iter()
            .collect(),
        spread: DMatrix::zeros(0, 0),
    });
    Ok(Stiction::Named)
}

/// Why what is held `here`, and on `all` recordings together, is no stiction.
fn why_not(found: &[Found], here: &Held, all: &Held) -> Option<String> {
    if !here.confirms() || !here.is_stiction() && !all.is_stiction() {
        return Some(here.doubt());
    }
    let gives = found.iter().find(|found| gives(found.kind))?;
    Some(format!(
        "it takes {:.3} more to leave rest than to slide, but with {} the tool moves before the object does",
        here.excess.value, gives.kind.name
    ))
}

fn refuse(
    diagnosis: &mut Diagnosis,
    settings: &MotionSettings,
    reason: String,
    so: Stiction,
) -> Result<Stiction, DynamicsError> {
    let held_out_rms = errors(&diagnosis.motion, &diagnosis.found(), settings)?;
    diagnosis.refused.push(Refused {
        name: STICTION.name,
        reason,
        held_out_rms,
    });
    Ok(so)
}

/// Adds a Stribeck friction of that speed where it lowers the error on held-out strokes here and on all others; whether it does.
fn add_stribeck(
    diagnosis: &mut Diagnosis,
    confirmed: &mut [Confirmation],
    elsewhere: &[Other<'_>],
    fall: Fall,
) -> Result<bool, DynamicsError> {
    let found = diagnosis.found();
    let stribeck = Found {
        kind: &STRIBECK,
        shape: vec![fall.speed],
        used: vec![true],
        object: Arc::default(),
        datum: 0.0,
    };
    let with = [found.as_slice(), core::slice::from_ref(&stribeck)].concat();
    // Errors without and with it, where it helps.
    let helps = |motion: &Motion| -> Result<Option<[f64; 2]>, DynamicsError> {
        let Some(model) = shown(fit_found(motion, &with))? else {
            return Ok(None);
        };
        let pair = [fit_found(motion, &found)?.held_out_rms, model.held_out_rms];
        Ok((pair[1] < HELPS_BELOW * pair[0]).then_some(pair))
    };
    let Some(held_out_rms) = helps(&diagnosis.motion)? else {
        return Ok(false);
    };
    if held_out_rms[1] > MOST_LEFT * diagnosis.floor_of_all() {
        return Ok(false);
    }
    let mut pairs = Vec::new();
    for other in elsewhere {
        let Some(pair) = helps(&other.motion)? else {
            return Ok(false);
        };
        pairs.push(pair);
    }
    for (confirmed, pair) in confirmed.iter_mut().zip(pairs) {
        confirmed.rms.push(pair);
        confirmed.relative_error *= pair[1] / pair[0];
    }
    diagnosis
        .refused
        .retain(|refused| refused.name != STRIBECK.name);
    diagnosis.effects.push(NamedEffect {
        found: stribeck,
        held_out_rms,
        p_value: 0.0,
        ambiguous_with: Vec::new(),
        spread: DMatrix::zeros(0, 0),
    });
    diagnosis.refit()?;
    Ok(true)
}

/// What rests show must lower the error while it slides to so many times what it was.
const HELPS_BELOW: f64 = 0.995;

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
fn errors(
    motion: &Motion,
    found: &[Found],
    settings: &MotionSettings,
) -> Result<[f64; 2], DynamicsError> {
    let mut sliding = motion.clone();
    for (slides, t) in sliding.slides.iter_mut().zip(&motion.time) {
        *slides = !slip::slides(&motion.slips, *t);
    }
    if settings.turns_left_out {
        sliding.leave_out_turns();
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

    /// A hand that is a spring goes from place to place in `move_s` each and rests; it drags 3 kg with a friction of 4 N, and so much more to leave
    /// rest, of which by the speed `falls` half is gone, or all of it at once.
    fn dragged(extra: f64, falls: Option<f64>, move_s: f64) -> JointSamples {
        let (stiffness, damping, mass) = (2000.0, 60.0, 3.0);
        let steps = 25;
        let h = 1.0 / (RATE * f64::from(steps));
        let (mut q, mut tau) = (Vec::new(), Vec::new());
        let (mut at, mut dq) = (0.0_f64, 0.0_f64);
        for pair in PLACES.windows(2) {
            let way = pair[1] - pair[0];
            for i in 0..((0.6 + move_s) * RATE) as usize {
                let mut pull = 0.0;
                for k in 0..steps {
                    let t = (i as f64 / RATE + f64::from(k) * h).min(move_s);
                    let w = PI / move_s;
                    let hand = pair[0] + 0.5 * way * (1.0 - (w * t).cos());
                    let goes = 0.5 * way * w * (w * t).sin();
                    pull = stiffness * (hand - at) + damping * (goes - dq);
                    if dq == 0.0 && pull.abs() <= 4.0 + extra {
                        continue;
                    }
                    let sign = if dq == 0.0 {
                        pull.signum()
                    } else {
                        dq.signum()
                    };
                    let left = falls.map_or(0.0, |speed| extra * falling(speed, dq));
                    let next = dq + h * (pull - (4.0 + left) * sign - 2.0 * dq) / mass;
                    dq = if next * sign < 0.0 { 0.0 } else { next };
                    at += h * dq;
                }
                q.push(at);
                tau.push(pull);
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

    fn measured(extra: f64, falls: Option<f64>, move_s: f64) -> (Breakaway, f64) {
        let samples = dragged(extra, falls, move_s);
        let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
        let model = fit_found(&motion, &[]).unwrap();
        let found = Breakaway::of(&motion, &[], model.theta.as_slice(), motion.slow_speed);
        (found.unwrap(), model.theta[1])
    }

    fn held(breakaway: &Breakaway) -> Held {
        Held {
            excess: breakaway.excess(breakaway),
            sliding: breakaway.sliding,
        }
    }

    fn median(value: f64, std: f64, count: usize) -> Median {
        Median { value, std, count }
    }

    #[test]
    fn less_confirms_it_than_it_takes_to_find_it() {
        let like = |value, sliding| Held {
            excess: median(value, 0.3, LEAST_COUNT),
            sliding,
        };
        assert!(like(2.7, 4.0).is_stiction() && like(2.7, 4.0).confirms());
        assert!(!like(2.3, 4.0).is_stiction() && like(2.3, 4.0).confirms());
        assert!(!like(1.9, 4.0).confirms());
        assert!(!like(0.5, 0.5).confirms());
    }

    #[test]
    fn recordings_together_are_surer_than_each_and_count_by_how_often_the_joint_left_rest() {
        let like = |value, count| Breakaway {
            at_once: median(value, 0.3, count),
            sliding: 4.0,
            falls: vec![Fall {
                speed: 0.01,
                excess: median(value, 0.3, count),
                gain: median(-0.3, 0.2, count),
            }],
        };
        let near = like(2.5, 6);
        assert!(!held(&near).is_stiction() && near.falls[0].may_be());
        let twice = near.with([&near].into_iter());
        assert!(held(&twice).is_stiction() && !twice.falls[0].may_be());
        let few = near.with([&like(2.1, 3)].into_iter()).at_once;
        let many = near.with([&like(2.1, 18)].into_iter()).at_once;
        assert!((few.value - 2.3667).abs() < 1e-3 && (few.std - 0.2236).abs() < 1e-3);
        assert!((many.value - 2.2).abs() < 1e-9 && (many.std - 0.2372).abs() < 1e-3);
        assert_eq!(many.count, 24);
    }

    #[test]
    fn more_effort_to_leave_rest_than_to_slide_is_seen_and_inertia_is_not_taken_for_it() {
        for move_s in [0.4, 0.7, 1.2] {
            let (none, coulomb) = measured(0.0, None, move_s);
            assert!(
                held(&none).excess.value.abs() < 0.15 * 4.0 && !held(&none).is_unusual(),
                "{move_s} s: {none:?}"
            );
            assert!((coulomb - 4.0).abs() < 0.2, "{coulomb}");
            let (much, coulomb) = measured(5.0, None, move_s);
            assert!(
                (much.at_once.value - 5.0).abs() < 0.1 * 5.0 && held(&much).is_stiction(),
                "{move_s} s: {much:?}"
            );
            // Friction at rest is no sliding friction.
            assert!((coulomb - 4.0).abs() < 0.2, "{coulomb}");
        }
    }

    #[test]
    fn what_falls_while_it_slides_is_told_from_what_is_gone_at_once() {
        let (at_once, _) = measured(5.0, None, 0.7);
        assert!(
            at_once.surely_falls().is_none() && !at_once.may_fall(),
            "{at_once:?}"
        );
        let (falls, _) = measured(5.0, Some(0.02), 0.7);
        let fall = falls.surely_falls().unwrap();
        assert!((0.5..2.0).contains(&(fall.speed / 0.02)), "{falls:?}");
        // The speeds are 1.4 apart; taken for gone at once it would be 8.9 N.
        let excess = held(&falls).excess.value;
        assert!((excess - 5.0).abs() < 0.25 * 5.0, "{excess} {falls:?}");
    }

    /// Gone at once it would have to be more than half of what sliding takes.
    #[test]
    fn what_falls_is_not_taken_for_more_than_it_is() {
        for move_s in [0.5, 1.0] {
            let (falls, _) = measured(1.5, Some(0.02), move_s);
            assert!(!held(&falls).is_stiction(), "{move_s} s: {falls:?}");
        }
    }
}
