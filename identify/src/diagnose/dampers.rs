//! Dampers that lie side by side: a closer has one for its sweep, one for its latching and one that checks the opening. They are found one after the
//! other, and what the first takes up of the next stands in its way.

use super::diagnosis::MUCH;
use super::gates::most_of;
use super::model::{Candidate, Found, candidates, is_smooth_load};
use super::scan::{LEVELS, WORSE};
use super::score::Problem;
use super::search::{RIVAL_BELOW, State};
use crate::analysis::EXPLAINED_BELOW;
use crate::dynamics::DynamicsError;
use crate::effect::damping::{ASYMMETRIC, EDGE, ZONE};
use crate::effect::library::{Kind, Search};
use crate::motion::MotionError;
use crate::parallel::in_parallel;

/// Whether it slows more at some places or one way.
pub(super) fn is_damper(kind: &Kind) -> bool {
    kind.is(&ZONE) || kind.is(&ASYMMETRIC)
}

/// What ends so near the end of the range, as a share of it, or within an edge more, counts as reaching it.
const NEAR_END: f64 = 0.05;

/// Shares of the greatest speed at which the valves of [`State::valved`] open.
const OPENS_AT: [f64; 2] = [0.4, 0.2];

impl State {
    /// Dampers of one way with a valve, which the library's grid does not have, up to an end of the range or over all of it: the valve of a strong
    /// closer opens in every quick stroke, and none of its dampers helps on held-out strokes without one. To be taken out again by [`Self::without_valves`].
    pub(super) fn valved(&self) -> Result<Vec<Candidate>, MotionError> {
        let scope = self.ground.scope();
        let ([low, high], range) = (scope.q, scope.range());
        let mut shapes = (ZONE.grid)(&scope);
        shapes.retain(|shape| shape[2] != 0.0 && (shape[0] < low || shape[1] > high));
        shapes.extend([-1.0, 1.0].map(|way| {
            let [from, to] = [low - range, high + range];
            vec![from, to, way, EDGE * range, scope.fastest()]
        }));
        let points: Vec<(&'static Kind, Vec<f64>)> = shapes
            .iter()
            .flat_map(|shape| {
                OPENS_AT.map(|share| {
                    let mut shape = shape.clone();
                    shape[4] *= share;
                    (&ZONE, shape)
                })
            })
            .collect();
        candidates(&self.ground, &points)
    }

    /// Takes what [`Self::valved`] made out of the bank.
    pub(super) fn without_valves(&mut self) {
        let fastest = self.ground.scope().fastest();
        let closed = |one: &Candidate| !one.kind.is(&ZONE) || one.shape[4] >= fastest;
        self.bank.retain(closed);
    }

    /// Lays dampers side by side, two at a time, where the model with the signs of physics then errs less: they were found one after the other,
    /// and the first took up what it could of the second.
    pub(super) fn part(&mut self) -> Result<(), DynamicsError> {
        for i in 0..self.effects.len() {
            for j in 0..self.effects.len() {
                let Some((first, second)) = self.side_by_side(i, j) else {
                    continue;
                };
                let (as_was, before) = (self.effects.clone(), self.error_with_signs()?);
                self.effects[i].0 = first;
                self.effects[j].0 = second;
                self.relieve()?;
                self.polish()?;
                if self.error_with_signs()? >= before {
                    self.effects = as_was;
                }
            }
        }
        Ok(())
    }

    /// Dampers `i` and `j` as two that lie side by side, where they may be. One within another of the same direction up to its end: the
    /// outer one ends where the inner one begins, because a valve that opens for both together is a valve of each only when they lie so; an inner
    /// one that acts both ways may do so for want of what the outer one hides, and is then of its direction. And one that ends where another
    /// begins that acts both ways: the first may go on and the other act against it only.
    fn side_by_side(&self, i: usize, j: usize) -> Option<(Found, Found)> {
        let (first, second) = (&self.effects[i].0, &self.effects[j].0);
        let zones = first.kind.is(&ZONE) && second.kind.is(&ZONE);
        if i == j || !zones {
            return None;
        }
        let [low, high] = self.ground.scope().q;
        let (mut parted, mut other) = (first.clone(), second.clone());
        let [from, to, way, edge] = [0, 1, 2, 3].map(|k| first.shape[k]);
        let [begin, end, its_way, its_edge] = [0, 1, 2, 3].map(|k| second.shape[k]);
        let both_ways = its_way == 0.0 && way != 0.0;
        if way == its_way || both_ways {
            let near = NEAR_END * (high - low) + its_edge;
            let (low, high) = (low + near, high - near);
            let inside = |q: f64| from.max(low) < q && q < to.min(high);
            (other.shape[2], parted.shape[3]) = (way, its_edge);
            if inside(begin) && end >= high && to >= high {
                parted.shape[1] = begin;
                return Some((parted, other));
            }
            if inside(end) && begin <= low && from <= low {
                parted.shape[0] = end;
                return Some((parted, other));
            }
        }
        if both_ways {
            let near = NEAR_END * (high - low) + edge + its_edge;
            (other.shape[2], parted.shape[3]) = (-way, edge);
            if (to - begin).abs() < near {
                parted.shape[1] = end;
                return Some((parted, other));
            }
            if (from - end).abs() < near {
                parted.shape[0] = begin;
                return Some((parted, other));
            }
        }
        None
    }

    /// Puts a damper of the same direction on the other side of one that was there `before` the choice came, in the place of the choice, where a
    /// load presses against them and the model then errs a twentieth less: the first has taken up what it could of the second with a wide edge, and
    /// what shows of the second is a notch where they meet. What chance gives was asked of the choice, which does less.
    pub(super) fn or_beyond(
        &mut self,
        before: &[(Found, f64)],
        (choice, p_value): (&Kind, f64),
    ) -> Result<(), DynamicsError> {
        let mut least = self.error_with_signs()?;
        let zones = before.iter().filter(|(f, _)| f.kind.is(&ZONE)).count();
        let loaded = before.iter().any(|(f, _)| is_smooth_load(f.kind));
        // Infinite where the motion does not show the terms apart.
        let far = least.is_finite() && least > MUCH * self.floor.rms;
        if !loaded || !far || zones >= most_of(&ZONE) || self.is_sure(choice) {
            return Ok(());
        }
        for i in 0..before.len() {
            for (parted, other) in self.beyond(&before[i].0) {
                let chosen = core::mem::replace(&mut self.effects, before.to_vec());
                self.effects[i].0 = parted;
                self.effects.push((other, p_value));
                self.refine_all()?;
                let error = self.error_with_signs()?;
                if error < RIVAL_BELOW * least && self.holds(before.len())? {
                    least = error;
                } else {
                    self.effects = chosen;
                }
            }
        }
        Ok(())
    }

    /// A damper with narrow edges, and one from each of its ends within the range to the end of that.
    fn beyond(&self, zone: &Found) -> Vec<(Found, Found)> {
        if !zone.kind.is(&ZONE) {
            return Vec::new();
        }
        let scope = self.ground.scope();
        let ([low, high], range) = (scope.q, scope.range());
        let within = low + NEAR_END * range..high - NEAR_END * range;
        let mut parted = zone.clone();
        parted.shape[3] = EDGE * range;
        let [from, to] = [0, 1].map(|k| zone.shape[k]);
        let sides = [(from, [low - range, from]), (to, [to, high + range])];
        let inside = sides.into_iter().filter(|(end, _)| within.contains(end));
        let other = |[from, to]: [f64; 2]| {
            let shape = vec![from, to, zone.shape[2], parted.shape[3], scope.fastest()];
            (
                parted.clone(),
                self.ground.found(&ZONE, shape, vec![true, false]),
            )
        };
        inside.map(|(_, side)| other(side)).collect()
    }

    /// Where something is left beside several dampers and two or more other effects, looks for the dampers anew beside these: the places
    /// of the first are chosen while what comes later is missing, and hold the others where they are. What is found so is taken when it
    /// errs a twentieth less, and not by a curve of no name. By the errors with the signs of physics: a damper of the wrong sign may
    /// reach the floor, and has hidden what is there.
    pub(super) fn search_dampers_again(&mut self) -> Result<(), DynamicsError> {
        let damps = |(found, _): &(Found, f64)| is_damper(found.kind);
        let dampers = self.effects.iter().filter(|effect| damps(effect)).count();
        // The load that everything began with is no news.
        if dampers < 2 || self.effects.len() < dampers + 2 {
            return Ok(());
        }
        let before = self.error_with_signs()?;
        if before < EXPLAINED_BELOW * self.floor.rms {
            return Ok(());
        }
        let (as_was, had_curve) = (self.as_is(), !self.ground.curve.is_empty());
        self.effects.retain(|effect| !damps(effect));
        self.refused.clear();
        // A lag would change the samples, which stay as they are.
        let is_lag = |candidate: &mut Candidate| candidate.kind.name == "time_lag";
        let lag: Vec<Candidate> = self.bank.extract_if(.., is_lag).collect();
        // Twice: what seems superfluous while dampers are missing may come back beside them.
        let mut came = false;
        for _ in 0..2 {
            self.given_up.clear();
            self.search()?;
            came = had_curve == self.ground.curve.is_empty();
            if came || self.given_up.is_empty() {
                break;
            }
        }
        self.bank.extend(lag);
        if came || self.error_with_signs()? > RIVAL_BELOW * before {
            self.put_back(as_was);
        }
        Ok(())
    }

    /// Gives dampers a relief valve, or takes it away, as the fit to all blocks asks for at the price of two more numbers. By
    /// that fit, because one fast stroke alone may show a valve, so that no other block can confirm it.
    pub(super) fn relieve(&mut self) -> Result<(), DynamicsError> {
        for i in 0..self.effects.len() {
            let found = self.effects[i].0.clone();
            let Some(relief) = found.kind.shape.iter().position(|s| s.2 == Search::Below) else {
                continue;
            };
            let x = self.without(i)?;
            let efforts = [self.ground.y.clone()];
            let problem = Problem::new(&x, &efforts, &self.ground.folds);
            let fastest = self.ground.scope().fastest();
            let mut plain = found.clone();
            plain.used = vec![true, false];
            plain.shape[relief] = fastest;
            // What came since may let the valve open elsewhere.
            let at = |level: f64| {
                let mut with = found.clone();
                with.shape[relief] = level * fastest;
                with.used.fill(true);
                with
            };
            let mut tried: Vec<Found> = LEVELS.map(at).into();
            tried.extend(found.used[1].then(|| found.clone()));
            let Some(without) = self.outcome(&problem, &plain) else {
                continue;
            };
            let price = (2.0 * problem.independent().ln() / problem.independent()).exp();
            let fits = in_parallel(&tried, |with| {
                let outcome = self.outcome(&problem, with)?;
                let fits = price * outcome.fit < without.fit && outcome.mse < WORSE * without.mse;
                fits.then_some(outcome.fit)
            });
            let best = fits
                .into_iter()
                .zip(tried)
                .filter_map(|(fit, with)| Some((fit?, with)))
                .min_by(|a, b| a.0.total_cmp(&b.0));
            self.effects[i].0 = best.map_or(plain, |(_, with)| with);
        }
        Ok(())
    }

    /// Takes dampers that act one way over all of the range for what they are.
    pub(super) fn simplify(&mut self) -> Result<(), DynamicsError> {
        let simple = &ASYMMETRIC;
        for i in 0..self.effects.len() {
            let zone = self.effects[i].0.clone();
            if !zone.kind.is(&ZONE) || zone.shape[2] == 0.0 {
                continue;
            }
            let same_way = |f: &Found| f.kind.name == zone.kind.name && f.shape[2] == zone.shape[2];
            let alone = self.effects.iter().filter(|(f, _)| same_way(f)).count() == 1;
            let there = self.effects.iter().any(|(f, _)| f.kind.name == simple.name);
            if there || !alone {
                continue;
            }
            let x = self.without(i)?;
            let efforts = [self.ground.y.clone()];
            let problem = Problem::new(&x, &efforts, &self.ground.folds);
            let plain = self.ground.found(simple, vec![zone.shape[2]], vec![true]);
            let (own, other) = (
                self.own_mse(&problem, &zone),
                self.own_mse(&problem, &plain),
            );
            let spared = (zone.kind.freedom_of(&zone.used) - plain.kind.freedom()) as f64;
            let price = (spared * problem.independent().ln() / problem.independent()).exp();
            if let (Some(own), Some(other)) = (own, other)
                && other < price * own
            {
                self.effects[i].0 = plain;
            }
        }
        Ok(())
    }
}
