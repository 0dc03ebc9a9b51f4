//! What a search begins with, and which of several searches stays.

use super::confirm::shown;
use super::dampers::is_damper;
use super::diagnosis::{Diagnosis, NamedEffect, Refused};
use super::model::{Candidate, Found, is_known, is_smooth_load};
use super::search::{MOST_EFFECTS, RIVAL_BELOW, State};
use super::steps::Steps;
use crate::dynamics::DynamicsError;
use crate::effect::damping::ZONE;
use crate::effect::library::Kind;
use crate::effect::load::{CATCH, CONSTANT_LOAD, DETENT, SPRING};
use crate::effect::measurement::TIME_LAG;
use crate::motion::MotionSettings;
use crate::payload::is_seen;
use crate::samples::JointSamples;

/// In the place of a p-value: it was put there unasked.
pub(super) const UNASKED: f64 = f64::INFINITY;

/// Effects that have been found in the place of others.
const SUSPECTS: [&str; 3] = [TIME_LAG.name, DETENT.name, CATCH.name];

/// Looks for what the model lacks on `samples`.
///
/// # Errors
/// [`DynamicsError`].
pub fn diagnose(
    samples: &JointSamples,
    settings: &MotionSettings,
) -> Result<Diagnosis, DynamicsError> {
    diagnose_without(samples, settings, &[])
}

/// As [`diagnose`], without the effects named in `barred`: those that other recordings have refused.
///
/// The search adds one effect after the other, and what came first may have taken the place of others: a lag changes the samples for good, and a
/// grasp that gives looks like one; before the load and the dampers of a closer are there, a notch seems to be. Where one of these is named and much
/// more than noise is left, the search is made without it, too, and that which leaves less stays; a lag that explains too little does not, whatever is
/// left. Wherever much more than noise is left
/// and no closer came by itself, it is also made with a load and its dampers first: a damper may have taken the place of the load, or a ripple that of a
/// damper.
///
/// # Errors
/// [`DynamicsError`].
pub fn diagnose_without(
    samples: &JointSamples,
    settings: &MotionSettings,
    barred: &[&'static str],
) -> Result<Diagnosis, DynamicsError> {
    diagnose_while(samples, settings, barred, &Steps::default())
}

/// The same with no other search once there have been enough `steps`.
pub(super) fn diagnose_while(
    samples: &JointSamples,
    settings: &MotionSettings,
    barred: &[&'static str],
    steps: &Steps,
) -> Result<Diagnosis, DynamicsError> {
    let mut first = First::Any;
    let mut best = searched(samples, settings, barred, first, steps)?;
    let loaded = |found: &Diagnosis| found.effects.iter().any(|e| is_a_load(&e.found));
    if best.is_far() && !has_a_closer(&best) && !steps.are_enough() {
        let other = with_a_load(samples, settings, barred, &best.came_to, steps);
        let other = shown(other)?.flatten();
        if let Some(other) = other
            && loaded(&other)
            && other.model.held_out_rms < RIVAL_BELOW * best.model.held_out_rms
        {
            (best, first) = (other, First::Load);
        }
    }
    let mut barred = barred.to_vec();
    let mut stood_in = Vec::new();
    for suspect in SUSPECTS {
        let is_suspect = |effect: &NamedEffect| effect.found.kind.name == suspect;
        let named =
            best.effects.iter().any(is_suspect) || suspect == TIME_LAG.name && best.lag_s.is_some();
        if !named || !best.is_far() || steps.are_enough() {
            continue;
        }
        barred.push(suspect);
        let Some(without) = shown(searched(samples, settings, &barred, first, steps))? else {
            barred.pop();
            continue;
        };
        let [left, less] = [&best, &without].map(|found| found.model.held_out_rms);
        if less > RIVAL_BELOW * left {
            barred.pop();
            continue;
        }
        best = without;
        stood_in.push(Refused {
            name: suspect,
            reason: "without it others leave less".to_owned(),
            held_out_rms: [less, left],
        });
    }
    best.refused.extend(stood_in);
    Ok(best)
}

/// The model that a search has come to, before it is looked over.
#[derive(Clone, Debug)]
pub(super) struct CameTo {
    names: Vec<&'static str>,
    curved: bool,
    error: f64,
}

impl CameTo {
    /// Whether it is the same but for shapes that are hardly better.
    fn is_no_better_than(&self, other: &Self) -> bool {
        let same = self.names == other.names && self.curved == other.curved;
        same && self.error > HARDLY * other.error
    }
}

/// An error of so many times another one is hardly less.
const HARDLY: f64 = 0.98;

/// What a search begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum First {
    Any,
    /// A load over the whole range and the dampers that it presses against.
    Load,
}

fn searched(
    samples: &JointSamples,
    settings: &MotionSettings,
    barred: &[&'static str],
    first: First,
    steps: &Steps,
) -> Result<Diagnosis, DynamicsError> {
    let mut state = begun(samples, settings, barred, steps)?;
    if first == First::Load {
        state.begin_with_a_load()?;
    }
    let found = state.complete()?;
    without_doubted(found, barred, |barred| {
        searched(samples, settings, barred, first, steps)
    })
}

/// What was found, or, where a lag is in it that explains too little or a switch of an inertia that is not known, what is found without: beside
/// either, others took a wrong place.
fn without_doubted(
    found: Diagnosis,
    barred: &[&'static str],
    again: impl FnOnce(&[&'static str]) -> Result<Diagnosis, DynamicsError>,
) -> Result<Diagnosis, DynamicsError> {
    let Some(doubt) = found.doubted.clone() else {
        return Ok(found);
    };
    let Some(mut without) = shown(again(&[barred, &[doubt.name]].concat()))? else {
        return Ok(found);
    };
    without.refused.push(doubt);
    Ok(without)
}

/// As [`searched`] from a load; nothing where none stands beside its dampers: what is then left are those dampers, and a search from anything has
/// been through such a state or a better one. Nor where it comes to what that search has come to: from there it would go on as that did.
fn with_a_load(
    samples: &JointSamples,
    settings: &MotionSettings,
    barred: &[&'static str],
    other: &CameTo,
    steps: &Steps,
) -> Result<Option<Diagnosis>, DynamicsError> {
    let mut state = begun(samples, settings, barred, steps)?;
    if !state.bank.iter().any(|one| is_smooth_load(one.kind)) {
        return Ok(None);
    }
    state.begin_with_a_load()?;
    if !state.effects.iter().any(|(found, _)| is_a_load(found)) {
        return Ok(None);
    }
    state.search()?;
    if state.came_to()?.is_no_better_than(other) {
        return Ok(None);
    }
    let found = state.go_on()?;
    let again = |barred: &[&'static str]| searched(samples, settings, barred, First::Load, steps);
    without_doubted(found, barred, again).map(Some)
}

/// Whether a load presses against several dampers: a search that begins with one finds the same.
fn has_a_closer(found: &Diagnosis) -> bool {
    let kinds = || found.effects.iter().map(|effect| effect.found.kind);
    let presses = |kind: &Kind| kind.is(&SPRING) || kind.is(&CONSTANT_LOAD);
    kinds().any(presses) && kinds().filter(|kind| is_damper(kind)).count() > 1
}

/// Whether it is a load over the whole range that the effort showed.
fn is_a_load(found: &Found) -> bool {
    is_smooth_load(found.kind) && !is_known(found)
}

fn begun(
    samples: &JointSamples,
    settings: &MotionSettings,
    barred: &[&'static str],
    steps: &Steps,
) -> Result<State, DynamicsError> {
    // What free air shows of a lag needs no search.
    let late = samples.aside.late.filter(is_seen);
    let late = late.filter(|_| !barred.contains(&TIME_LAG.name));
    let mut samples = samples.clone();
    if let Some((late, _)) = late {
        samples = samples.with_effort_earlier(late);
    }
    let mut state = State::new(samples, *settings, steps.clone())?;
    state.lag = late.map(|(late, _)| (late, 0.0));
    state
        .bank
        .retain(|candidate| !barred.contains(&candidate.kind.name));
    Ok(state)
}

impl State {
    fn complete(mut self) -> Result<Diagnosis, DynamicsError> {
        self.search()?;
        self.go_on()
    }

    /// What comes after the search.
    fn go_on(mut self) -> Result<Diagnosis, DynamicsError> {
        let came_to = self.came_to()?;
        self.latch()?;
        self.search_dampers_again()?;
        self.ask()?;
        self.finish(came_to)
    }

    fn came_to(&self) -> Result<CameTo, DynamicsError> {
        let mut names = self.names();
        names.extend(self.lag.map(|_| TIME_LAG.name));
        names.sort_unstable();
        Ok(CameTo {
            names,
            curved: !self.ground.curve.is_empty(),
            error: self.error_with_signs()?,
        })
    }

    /// Begins with a load over the whole range, the best that passes or a spring, which must stand beside what comes after it, and with the dampers
    /// that it presses against, some with a valve that is open in quick strokes: before they are there a notch seems to be where the damper of a
    /// closer ends. What chance gives is asked of these kinds alone.
    fn begin_with_a_load(&mut self) -> Result<(), DynamicsError> {
        let other = |candidate: &mut Candidate| !is_smooth_load(candidate.kind);
        let mut others: Vec<Candidate> = self.bank.extract_if(.., other).collect();
        self.add_named()?;
        // Beside dampers that few strokes show, one explains nothing alone.
        let may_be = self.bank.iter().any(|one| one.kind.is(&SPRING));
        if self.effects.is_empty() && may_be {
            let used = vec![true; SPRING.terms.len()];
            let spring = self.ground.found(&SPRING, Vec::new(), used);
            self.effects.push((spring, UNASKED));
        }
        let damper = |candidate: &mut Candidate| is_damper(candidate.kind);
        self.bank.extend(others.extract_if(.., damper));
        if self.bank.iter().any(|one| one.kind.is(&ZONE)) {
            let valved = self.valved()?;
            self.bank.extend(valved);
        }
        for _ in 0..MOST_EFFECTS {
            if self.effects.len() >= MOST_EFFECTS || !self.add_named()? {
                break;
            }
        }
        self.without_valves();
        // Beside others they may come again.
        self.given_up.clear();
        self.refused.clear();
        self.bank.extend(others);
        Ok(())
    }

    /// Holds what was put there unasked to what holds for all others, beside these; what does not stand is taken out.
    fn ask(&mut self) -> Result<(), DynamicsError> {
        let Some(i) = self.effects.iter().position(|(_, p)| *p == UNASKED) else {
            return Ok(());
        };
        let as_is = self.as_is();
        let (effect, _) = self.effects.remove(i);
        // A curve over the coordinate is any load.
        self.ground.curve.clear();
        let seen = self.survey()?;
        let own = seen.and_then(|(_, seen)| self.passing(effect.kind, &seen));
        self.put_back(as_is);
        match own {
            Some((_, p_value)) => self.effects[i].1 = p_value,
            None => {
                self.effects.remove(i);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::CameTo;

    #[test]
    fn a_search_goes_on_where_it_came_elsewhere_or_nearer() {
        let came_to = |names: &[&'static str], curved, error| CameTo {
            names: names.to_vec(),
            curved,
            error,
        };
        let other = came_to(&["damping_zone", "spring"], false, 1.0);
        for (names, curved, error, ends) in [
            (&["damping_zone", "spring"][..], false, 0.99, true),
            (&["damping_zone", "spring"], false, f64::INFINITY, true),
            (&["damping_zone", "spring"], false, 0.9, false),
            (&["damping_zone", "spring"], true, 1.0, false),
            (&["damping_zone", "spring", "time_lag"], false, 1.0, false),
        ] {
            let one = came_to(names, curved, error);
            assert_eq!(one.is_no_better_than(&other), ends, "{one:?}");
        }
    }
}
