//! Look-alikes: what would do nearly as well in the place of an effect, and what a part of it may be.

use nalgebra::{Cholesky, DVector, Dyn};

use super::diagnosis::Ambiguity;
use super::model::Found;
use super::score::{factor, gram};
use super::search::State;
use crate::dynamics::DynamicsError;
use crate::effect::friction::ASYMMETRIC;
use crate::effect::library::Kind;
use crate::effect::load::{CONSTANT_LOAD, SPRING, STRUT};
use crate::least_squares::rms;
use crate::products::{dot, residual};

/// Kinds that only a tare tells apart: on moving samples their regressors agree.
const ALIAS: (&str, &str) = ("constant_load", "asymmetric_coulomb");
/// Play and a grasp that gives: how pads hit the handle behind their play is in no model, so that either may do for the other.
const CRUDE: (&str, &str) = ("grasp_compliance", "backlash");
/// The share of the gain that makes one of these a look-alike of the other: their forms are cruder than that.
const ALIAS_GAIN: f64 = 0.5;
/// Kinds that hold another one as a special case: no alternatives to it.
const CONTAIN: [(&str, &str); 8] = [
    ("spring", "constant_load"),
    ("spring", "asymmetric_coulomb"),
    ("sensor_drift", "constant_load"),
    ("sensor_drift", "asymmetric_coulomb"),
    ("gravity", "constant_load"),
    ("gravity", "asymmetric_coulomb"),
    (ZONE, "asymmetric_viscous"),
    ("backlash", "grasp_compliance"),
];
const ZONE: &str = "damping_zone";

/// Whether it is one of [`ALIAS`].
pub(super) fn is_constant(kind: &Kind) -> bool {
    kind.is(&CONSTANT_LOAD) || kind.is(&ASYMMETRIC)
}

fn are(pair: (&str, &str), a: &str, b: &str) -> bool {
    pair == (a, b) || pair == (b, a)
}

/// Whether they are play and a grasp that gives.
fn are_crude(a: &str, b: &str) -> bool {
    are(CRUDE, a, b)
}

/// Whether `alike` is play in the place of a grasp that gives, which is play without a gap.
pub(super) fn is_play_for_grasp(alike: &str, name: &str) -> bool {
    CRUDE == (name, alike)
}

/// Whether `found` holds `alike` as a special case that the search may have taken it for: play without a gap is a grasp that gives, a damper over the whole
/// range one way a damping by direction. A spring that is a constant load is rare, and its rate is looked for on purpose.
pub(super) fn is_more_than(found: &Found, alike: &Found) -> bool {
    let (name, other) = (found.kind.name, alike.kind.name);
    let same_way = || match (found.shape.as_slice(), alike.shape.as_slice()) {
        ([_, _, way, ..], [other, ..]) => way * other > 0.0,
        _ => false,
    };
    let damps_one_way = (name, other) == (ZONE, "asymmetric_viscous");
    is_play_for_grasp(name, other) || damps_one_way && same_way()
}

/// Whether no motion tells them apart, or one of them holds the other as a special case and is no cruder for it.
pub(super) fn are_of_one_class(a: &str, b: &str) -> bool {
    let contains = CONTAIN.iter().any(|pair| are(*pair, a, b));
    !are_crude(a, b) && (contains || are(ALIAS, a, b))
}

impl State {
    /// Whether effect `i` is a spring that is without force on its path or less than the length of that away: its rate alone makes the load, and
    /// for thrift no constant is said to be a part of it. A spring that is stretched far in advance has a preload that could be anything's.
    fn rests_near_its_path(&self, i: usize, theta: &[f64]) -> bool {
        let found = &self.effects[i].0;
        let beside_a_curve = !self.ground.curve.is_empty();
        if !found.kind.is(&SPRING) || found.used.contains(&false) || beside_a_curve {
            return false;
        }
        let own = self.first_term_of(i);
        let (stiffness, preload) = (theta[own], theta[own + 1]);
        let scope = self.ground.scope();
        let [low, high] = scope.q;
        let around = low - scope.range()..=high + scope.range();
        around.contains(&(-preload / stiffness))
    }

    /// Effects that would do nearly as well in place of effect `i`; `theta` are the terms of the model.
    pub(super) fn look_alikes(
        &self,
        i: usize,
        theta: &[f64],
    ) -> Result<Vec<Ambiguity>, DynamicsError> {
        let (seen, own) = self.in_place_of(i, f64::INFINITY)?;
        let Some(seen) = seen else {
            return Ok(Vec::new());
        };
        let found = &self.effects[i].0;
        let name = found.kind.name;
        let gain = (seen.mse - own).max(0.0);
        // Beside other dampers, what slows over the whole range may be one more of them.
        let damps = self.effects.iter().any(|(f, _)| f.kind.name == ZONE);
        let contains =
            |kind: &Kind| CONTAIN.contains(&(kind.name, name)) && !(damps && kind.name == ZONE);
        let mut alike: Vec<Ambiguity> = seen
            .ranked
            .iter()
            .filter(|entry| entry.kind.name != name && self.too_heavy(entry).is_none())
            .filter(|entry| {
                let alias = are(ALIAS, entry.kind.name, name) || are_crude(entry.kind.name, name);
                let least = if alias { ALIAS_GAIN } else { 0.85 };
                seen.mse - entry.mse >= least * gain && (alias || entry.mse <= 1.15 * own)
            })
            .filter(|entry| {
                let crude = is_play_for_grasp(entry.kind.name, name);
                !contains(entry.kind) || crude || entry.mse < 0.95 * own
            })
            .map(|entry| ambiguity(entry.kind, Some(entry.found(&self.ground))))
            .collect();
        // A strut whose rate cannot be seen apart from the weight.
        let rate_is_hidden = |f: &Found| f.kind.is(&STRUT) && !f.used[0];
        if name == "gravity" && self.effects.iter().any(|(f, _)| rate_is_hidden(f)) {
            alike.retain(|a| a.name != STRUT.name);
            alike.push(ambiguity(&STRUT, None));
        }
        let needs_none = self.rests_near_its_path(i, theta);
        for hidden in self.hidden_in(i)? {
            if needs_none && is_constant(hidden) {
                continue;
            }
            if !contains(hidden) && alike.iter().all(|a| a.name != hidden.name) {
                alike.push(ambiguity(hidden, None));
            }
        }
        Ok(alike)
    }

    /// Effects of the state that are not in the model, but of which a part of effect `i` may be: what its columns leave of theirs is too little to be
    /// seen, in half of their shapes or more. A very wide magnet in a door's weight is no reason to look for a magnet.
    fn hidden_in(&self, i: usize) -> Result<Vec<&'static Kind>, DynamicsError> {
        let mut others = self.found();
        let all = self.ground.plain_columns(&others)?;
        others.remove(i);
        let without = self.ground.plain_columns(&others)?;
        let base = self.ground.plain_columns(&[])?;
        let [all, without, base] = [all, without, base].map(|x| (factor(&gram(&x)), x));
        let own = |(factor, x): &(Option<Cholesky<f64, Dyn>>, Vec<Vec<f64>>), column: &[f64]| {
            let right = DVector::from_fn(x.len(), |i, _| dot(&x[i], column));
            let theta = factor.as_ref().map(|factor| factor.solve(&right));
            let theta = theta.as_ref().map_or(&[][..], DVector::as_slice);
            rms(&residual(column, x, theta))
        };
        // Of each kind, of how many shapes that is so, and of how many it is not.
        let mut tally: Vec<(&'static Kind, [usize; 2])> = Vec::new();
        for candidate in &self.bank {
            let kind = candidate.kind;
            let there = self.effects.iter().any(|(f, _)| f.kind.name == kind.name);
            if kind.at.is_none() || there {
                continue;
            }
            let columns = candidate.columns();
            let Some(column) = columns.first() else {
                continue;
            };
            let beside_all = own(&all, column);
            let hides = beside_all < HIDDEN * own(&base, column)
                && own(&without, column) > 2.0 * beside_all;
            let at = tally.iter().position(|(k, _)| k.name == kind.name);
            let at = at.unwrap_or_else(|| {
                tally.push((kind, [0, 0]));
                tally.len() - 1
            });
            tally[at].1[usize::from(!hides)] += 1;
        }
        tally.retain(|(_, [hidden, seen])| hidden >= seen);
        Ok(tally.into_iter().map(|(kind, _)| kind).collect())
    }
}

/// Share of a column that must stay its own to be seen.
const HIDDEN: f64 = 0.3;

fn ambiguity(kind: &Kind, rival: Option<Found>) -> Ambiguity {
    Ambiguity {
        name: kind.name,
        told_apart_by: kind.separate,
        rival,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::effect::damping;
    use crate::effect::memory::BACKLASH;

    #[test]
    fn a_zone_is_more_than_a_damping_by_its_own_direction() {
        let found = |kind, shape: &[f64]| Found {
            kind,
            shape: shape.to_vec(),
            used: vec![true],
            object: Arc::default(),
            datum: 0.0,
        };
        let zone = |way| found(&damping::ZONE, &[0.0, 0.4, way, 0.02, 1.0]);
        let falls = found(&damping::ASYMMETRIC, &[-1.0]);
        assert!(is_more_than(&zone(-1.0), &falls));
        for other in [zone(0.0), zone(1.0), found(&BACKLASH, &[1e-3, 1e-5, 3e-3])] {
            assert!(!is_more_than(&other, &falls) && !is_more_than(&falls, &other));
        }
    }
}
