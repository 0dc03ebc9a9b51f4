//! A magnet or roller behind a damper: over the last degrees of the travel a damper that ends a little early looks like a pull.

use super::gates::most_of;
use super::model::Found;
use super::search::State;
use crate::dynamics::DynamicsError;
use crate::effect::library::{Kind, Scope, kind};

/// A damper's edge this close to an end of the travel, as a share of the range, may be what a catch does there.
const NEAR_END: f64 = 0.15;
/// The model with a catch must err so much less than the one with the edge, which has as many numbers.
const LATCHED_BELOW: f64 = 0.98;
/// A notch with its centre this close to the closed end, as a share of the range, may be a catch.
const NEAR_SHUT: f64 = 0.05;
/// What a catch in place of such a notch may leave more: it has a number less.
const SHUT_BELOW: f64 = 1.005;

impl State {
    /// Lets dampers that end near an end of the travel reach it, and a catch take the rest, or what a notch there had, where that errs
    /// less. A search that adds one effect after the other cannot come to it: the edge is there before the catch, and leaves it too little.
    pub(super) fn latch(&mut self) -> Result<(), DynamicsError> {
        let Some(catch) = kind("catch") else {
            return Ok(());
        };
        let catches = self
            .found()
            .iter()
            .filter(|f| f.kind.name == catch.name)
            .count();
        if catches >= most_of(catch) || self.bank.iter().all(|c| c.kind.name != catch.name) {
            return Ok(());
        }
        let scope = self.ground.scope();
        let wider = |i: usize| Some((i, to_the_end(&self.effects[i].0, &scope)?));
        let mut trials: Vec<_> = (0..self.effects.len())
            .filter_map(wider)
            .map(Some)
            .collect();
        // A notch at the closed end may be all that stands in a catch's place.
        if self.effects.iter().any(|(f, _)| is_shut(f, &scope)) {
            trials.push(None);
        }
        for wider in trials {
            // One that reaches the end may be the same as another one: then there is no fit, and nothing is gained.
            if self.tried(|state| state.latched(wider, catch))? {
                self.given_up.clear();
                return self.search();
            }
        }
        Ok(())
    }

    /// Puts `wider` in the place of its effect, and a catch beside it, for a notch at the closed end where there is one, when it passes
    /// every gate; whether that errs less.
    fn latched(
        &mut self,
        wider: Option<(usize, Found)>,
        catch: &'static Kind,
    ) -> Result<bool, DynamicsError> {
        let before = self.error()?;
        if let Some((i, wider)) = wider {
            self.effects[i].0 = wider;
        }
        let count = self.effects.len();
        let scope = self.ground.scope();
        self.effects.retain(|(found, _)| !is_shut(found, &scope));
        let below = if self.effects.len() < count {
            SHUT_BELOW
        } else {
            LATCHED_BELOW
        };
        self.refine_all()?;
        let seen = self.survey()?.map(|(_, seen)| seen);
        let choice = seen.and_then(|seen| self.passing(catch, &seen));
        let Some((choice, p_value)) = choice else {
            return Ok(false);
        };
        self.effects.push((choice.found(&self.ground), p_value));
        self.refine_all()?;
        Ok(self.error()? < below * before)
    }
}

/// Whether it is a notch at the closed end: on the far side of its centre nothing moves.
fn is_shut(found: &Found, scope: &Scope<'_>) -> bool {
    found.kind.name == "detent" && found.shape[0] < scope.q[0] + NEAR_SHUT * scope.range()
}

/// The damper with the edge that lies near an end of the travel behind that end; nothing when it has none.
fn to_the_end(damper: &Found, scope: &Scope<'_>) -> Option<Found> {
    if damper.kind.name != "damping_zone" {
        return None;
    }
    let ([low, high], near) = (scope.q, NEAR_END * scope.range());
    let mut wider = damper.clone();
    if (low..low + near).contains(&damper.shape[0]) {
        wider.shape[0] = low - scope.range();
    } else if (high - near..high).contains(&damper.shape[1]) {
        wider.shape[1] = high + scope.range();
    } else {
        return None;
    }
    Some(wider)
}
