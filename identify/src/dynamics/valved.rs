//! The fit with damping behind valves, which is not linear: Gauss and Newton's steps on the linearised design.
//!
//! 1. Straight valves: linear; the penalty of the damping is weighed anew with what was fitted, so that edges appear.
//! 2. For each direction, a bend where it gains most, as long as it gains more than chance would.
//! 3. Smoothing by the error on held-out strokes, linearised; then the steps until they end.
//!
//! The held-out error is that of fits that begin at the whole fit and take the same steps without the fold.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::design::Design;
use super::design::LEFT;
use crate::factor::Factor;
use crate::least_squares::{Bound, rms};
use crate::mechanism::{Bend, OnMotion, SplineMechanism};
use crate::motion::{Motion, SparseColumns};
use crate::parallel::in_parallel;
use crate::products::crossed;

/// Smoothing of load and damping to begin with, and what is tried.
const START: [f64; 2] = [0.01, 1e-3];
const LOADS: [f64; 3] = [1e-3, 0.01, 0.3];
const DAMPINGS: [f64; 2] = [1e-4, 1e-3];
/// Places over the efforts seen at which a bend is looked for.
const PLACES: usize = 16;
/// Steps after a new bend, at most.
const BEND_STEPS: usize = 12;
/// Bends of one valve.
const MOST_BENDS: usize = 2;
/// A bend must lower the logarithm of the squared residual, times the samples, by so much: two parameters and their choice.
const EVIDENCE: f64 = 40.0;
/// Relative change of slope that a bend must make.
const SLIGHT: f64 = 0.25;
/// Effort at which a valve may bend, over the residual.
const LEAST_BEND: f64 = 4.0;
/// Step of a bend's place and slope that the data must pay for, as a share of the effort.
const HOLD: [f64; 2] = [1e-4, 1e-4];

/// A mechanism behind valves, fitted.
#[derive(Clone)]
pub(super) struct Valved {
    /// Parameters, in the order of the design's.
    pub(super) theta: DVector<f64>,
    pub(super) mechanism: SplineMechanism,
    /// The mechanism's functions, which stay.
    on: Arc<OnMotion>,
    pub(super) smoothing: [f64; 2],
    pub(super) held_out_rms: f64,
}

/// A fit with bends, the design there, and its squared residual.
struct Bent {
    fit: Valved,
    design: Design,
    square: f64,
}

impl Valved {
    /// Fits a mechanism together with the parameters of `parametric`, a design without a mechanism, and gives the design at the
    /// fit, too; `surfaces` = a fit without valves.
    pub(super) fn fit(
        parametric: &Design,
        motion: &Motion,
        surfaces: &SplineMechanism,
    ) -> (Self, Design) {
        let mechanism = SplineMechanism::valved(motion);
        let mut fit = Self {
            theta: DVector::zeros(parametric.params),
            on: Arc::new(mechanism.on(motion)),
            mechanism,
            smoothing: START,
            held_out_rms: f64::INFINITY,
        };
        // Straight valves: the columns are the same at any coefficients.
        let mut design = fit.design(parametric, motion);
        for _ in 0..3 {
            design.weigh_as(&fit.mechanism);
            fit.step(&design);
        }
        let straight = fit.residual(parametric, motion).norm_squared();
        // A valve that was open most of the time hides how steep its line begins; slow strokes tell.
        let mut steep = fit.clone();
        steep.mechanism.damp_as_slow(surfaces, motion);
        let bent = in_parallel(&[&fit, &steep], |start| {
            start.bent(&design, parametric, motion, straight)
        });
        let bent = bent.into_iter().flatten();
        if let Some(best) = bent.min_by(|a, b| a.square.total_cmp(&b.square)) {
            (fit, design) = (best.fit, best.design);
        } else {
            design.weigh_as(&fit.mechanism);
        }
        let again = |fit: &mut Self, count| {
            let design = fit.design(parametric, motion);
            fit.steps(parametric, motion, design, count)
        };
        if fit.drop_slight_bends(parametric, motion) {
            design = again(&mut fit, 4);
        }
        (fit.smoothing, _) =
            design.choose_among(&design.fold_normals(), fit.smoothing, [&LOADS, &DAMPINGS]);
        design = fit.steps(parametric, motion, design, 2);
        if fit.drop_slight_bends(parametric, motion) {
            design = again(&mut fit, 2);
        }
        design = fit.steps(parametric, motion, design, 2);
        fit.held_out_rms = fit.held_out(&design, parametric, motion);
        (fit, design)
    }

    /// The design at the fit.
    fn design(&self, parametric: &Design, motion: &Motion) -> Design {
        parametric.near(
            &self.mechanism,
            &self.on,
            &self.mechanism.linearised(motion, &self.on),
        )
    }

    /// Predicted effort at the kept samples: exact, not linearised.
    pub(super) fn predicted(&self, design: &Design, parametric: &Design) -> DVector<f64> {
        &design.y * self.solution() + &parametric.tau - &design.tau
    }

    fn solution(&self) -> DVector<f64> {
        let mechanism = self.mechanism.coefficients();
        DVector::from_iterator(
            self.theta.len() + mechanism.len(),
            self.theta.iter().copied().chain(mechanism),
        )
    }

    /// What the fit leaves of the effort at the kept samples: exact, not linearised.
    fn residual(&self, parametric: &Design, motion: &Motion) -> DVector<f64> {
        let damping = self.mechanism.damping_efforts(motion, &self.on);
        let load = &self.mechanism.load_coefficients;
        let predicted =
            &parametric.y * &self.theta + &self.on.load * DVector::from_column_slice(load);
        // It is refused for another length than the motion's only.
        let damping = motion.regressor(&damping).unwrap_or_default();
        &parametric.tau - predicted - DVector::from_vec(damping)
    }

    /// Takes `count` steps with the penalties of `design`, which is that at the fit, and gives the design at the new one.
    fn steps(
        &mut self,
        parametric: &Design,
        motion: &Motion,
        mut design: Design,
        count: usize,
    ) -> Design {
        for left in (0..count).rev() {
            self.step(&design);
            let penalties = design.penalties;
            design = self.design(parametric, motion);
            if left > 0 {
                design.penalties = penalties;
            }
        }
        design
    }

    /// One step.
    fn step(&mut self, design: &Design) {
        self.step_by(design, (design.gram.clone(), design.right.clone()), 1.0);
    }

    /// One step by normal equations of a `share` of the design's samples.
    fn step_by(
        &mut self,
        design: &Design,
        (mut gram, mut right): (DMatrix<f64>, DVector<f64>),
        share: f64,
    ) {
        let first = design.params + self.mechanism.first_bend();
        let now = self.solution();
        let size = share * design.tau.norm_squared();
        for j in first..now.len() {
            let place = (j - first).is_multiple_of(2);
            let weight = if place {
                HOLD[0] * size / now[j].max(f64::MIN_POSITIVE).powi(2)
            } else {
                HOLD[1] * size
            };
            gram[(j, j)] += weight;
            right[j] += weight * now[j];
        }
        let h = design.penalized(&gram, &self.smoothing, share);
        let warm: Vec<bool> = now.iter().map(|v| *v != 0.0).collect();
        let mut x = design.minimum(&h, &right, share, Some(&warm));
        // The whole step is as long as its bends may move: shortening theirs alone would leave the rest without its reason.
        let length = (first..now.len()).step_by(2).fold(1.0_f64, |length, j| {
            let change = x[j] - now[j];
            let most = if change > 0.0 { 0.5 } else { 0.33 } * now[j];
            length.min(most / change.abs().max(f64::MIN_POSITIVE))
        });
        x = &now + (x - &now) * length;
        self.theta = x.rows(0, design.params).into_owned();
        self.mechanism.set(&x.as_slice()[design.params..]);
    }

    /// The fit with all bends that are worth it; `square` = the squared residual of straight valves, which this fit has, and
    /// `straight` = their design. Nothing when there is no such bend.
    fn bent(
        &self,
        straight: &Design,
        parametric: &Design,
        motion: &Motion,
        square: f64,
    ) -> Option<Bent> {
        let mut best = Bent {
            fit: self.clone(),
            design: straight.clone(),
            square,
        };
        best.design.weigh_as(&self.mechanism);
        let mut bends = None;
        let mut room = [MOST_BENDS; 2];
        while room != [0, 0] {
            let bends_now = *bends.get_or_insert_with(|| best.fit.best_bends(&best.design, motion));
            let found = bends_now.into_iter().enumerate();
            let Some((direction, (_, bend))) = found
                .filter(|(direction, _)| room[*direction] > 0)
                .filter_map(|(direction, bend)| Some((direction, bend?)))
                .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
            else {
                break;
            };
            let bent = best.fit.with_bend(parametric, motion, direction, bend);
            let samples = best.design.tau.len() as f64;
            let gain = samples * (best.square / bent.square.max(f64::MIN_POSITIVE)).ln();
            if gain < EVIDENCE {
                room[direction] = 0;
                continue;
            }
            room[direction] -= 1;
            (best, bends) = (bent, None);
        }
        (!best.fit.is_straight()).then_some(best)
    }

    /// The fit with one more bend.
    fn with_bend(
        &self,
        parametric: &Design,
        motion: &Motion,
        direction: usize,
        bend: Bend,
    ) -> Bent {
        let mut fit = self.clone();
        let bends = &mut fit.mechanism.valves[direction].bends;
        bends.push(bend);
        bends.sort_by(|a, b| a.at.total_cmp(&b.at));
        let mut best = Bent {
            design: fit.design(parametric, motion),
            fit,
            square: f64::INFINITY,
        };
        for _ in 0..BEND_STEPS {
            let mut fit = best.fit.clone();
            fit.step(&best.design);
            let mut design = fit.design(parametric, motion);
            // Exact where it was linearised.
            let mut square = (&design.tau - &design.y * fit.solution()).norm_squared();
            for _ in 1..4 {
                if square < best.square {
                    break;
                }
                fit.back_to(&best.fit);
                square = fit.residual(parametric, motion).norm_squared();
                if square < best.square {
                    design = fit.design(parametric, motion);
                }
            }
            let slight = square > 0.997 * best.square;
            if square < best.square {
                best = Bent {
                    fit,
                    design,
                    square,
                };
            }
            if slight {
                break;
            }
        }
        best
    }

    /// Goes two thirds of the way back to `other`.
    fn back_to(&mut self, other: &Self) {
        let (now, before) = (self.solution(), other.solution());
        let x = &before + (now - &before) / 3.0;
        self.theta = x.rows(0, self.theta.len()).into_owned();
        self.mechanism.set(&x.as_slice()[self.theta.len()..]);
    }

    /// Drops bends that change the slope by less than a quarter, which stand in for another that was not found yet, and bends
    /// in the noise, where a valve would be dry friction by another name.
    fn drop_slight_bends(&mut self, parametric: &Design, motion: &Motion) -> bool {
        if self.is_straight() {
            return false;
        }
        let mut dropped = false;
        let least = LEAST_BEND * rms(self.residual(parametric, motion).as_slice());
        for valve in &mut self.mechanism.valves {
            let mut before = 1.0;
            valve.bends.retain(|bend| {
                let bends = bend.at > least
                    && (bend.slope - before).abs() > SLIGHT * before.max(bend.slope);
                if bends {
                    before = bend.slope;
                }
                dropped |= !bends;
                bends
            });
        }
        dropped
    }

    /// For each direction the place and slope of a further bend with the largest gain, everything else refitted in one step,
    /// and that gain.
    fn best_bends(&self, design: &Design, motion: &Motion) -> [Option<(f64, Bend)>; 2] {
        let h = design.penalized(&design.gram, &self.smoothing, 1.0);
        let now = self.solution();
        let free: Vec<usize> = (0..now.len())
            .filter(|&j| design.bounds[j] == Bound::Free || now[j] > 0.0)
            .collect();
        let part = DMatrix::from_fn(free.len(), free.len(), |i, j| h[(free[i], free[j])]);
        let Some(factor) = Factor::of(&part) else {
            return [None, None];
        };
        let mut x = DVector::zeros(now.len());
        let mut solved: Vec<f64> = free.iter().map(|&j| design.right[j]).collect();
        factor.solve_in_place(&mut solved);
        for (&j, value) in free.iter().zip(solved) {
            x[j] = value;
        }
        let residual = &design.tau - &design.y * x;
        let square = residual.norm_squared();
        let asked = design.y.tr_mul(&residual).select_rows(&free);
        let least = LEAST_BEND * (square / residual.len() as f64).sqrt();
        let (places, columns) = self.beyond_places(motion, least);
        let firsts = [0, places[0].len()];
        [0, 1].map(|direction| {
            let valve = &self.mechanism.valves[direction];
            let places = &places[direction];
            let columns = columns.columns(firsts[direction], places.len());
            let columns = columns.into_owned();
            let products = crossed(&design.y, &columns).select_rows(&free);
            let explained = factor.solve(products.clone());
            let gains = places.iter().enumerate().filter_map(|(k, &at)| {
                let column = columns.column(k);
                // Of the part of the column that nothing else explains.
                let size = column.norm_squared() - products.column(k).dot(&explained.column(k));
                if size <= 1e-9 * column.norm_squared() {
                    return None;
                }
                let change = (column.dot(&residual) - asked.dot(&explained.column(k))) / size;
                let slope = (valve.slope(at) + change).clamp(0.05, 3.0);
                Some((change * change * size, Bend { at, slope }))
            });
            let best = gains.max_by(|a, b| a.0.total_cmp(&b.0))?;
            // Later steps gain more than the first, but not from nothing.
            let left = (1.0 - best.0 / square).max(1e-3);
            (-(residual.len() as f64) * left.ln() > 0.5 * EVIDENCE).then_some(best)
        })
    }

    fn is_straight(&self) -> bool {
        let mut valves = self.mechanism.valves.iter();
        valves.all(|valve| valve.is_straight())
    }

    /// Places for a further bend of each direction's valve, above `least`, and for each of them what the valve is given beyond
    /// it, filtered: those of opening come first. They ascend.
    fn beyond_places(&self, motion: &Motion, least: f64) -> ([Vec<f64>; 2], DMatrix<f64>) {
        let efforts = self.mechanism.proportional_efforts(motion, &self.on);
        let direction_at = |i: usize| usize::from(motion.dq[i] < 0.0);
        let mut most = [0.0_f64; 2];
        for &i in &motion.kept {
            most[direction_at(i)] = most[direction_at(i)].max(efforts[i]);
        }
        let places = [0, 1].map(|direction| {
            let bends = &self.mechanism.valves[direction].bends;
            let taken = |at: f64| bends.iter().any(|b| (b.at - at).abs() < 0.15 * b.at);
            let all = (1..PLACES).map(|k| most[direction] * k as f64 / PLACES as f64);
            all.filter(|&at| at > least && !taken(at))
                .collect::<Vec<f64>>()
        });
        let mut entries = SparseColumns::with_capacity(efforts.len(), PLACES);
        for (i, &u) in efforts.iter().enumerate() {
            let (first, sign) = [(0, 1.0), (places[0].len(), -1.0)][direction_at(i)];
            let passed = places[direction_at(i)].iter().take_while(|at| u > **at);
            entries.push((first..).zip(passed.map(|at| sign * (u - at))));
        }
        let count = places[0].len() + places[1].len();
        (places, motion.sparse_regressor(&entries, count))
    }

    /// Error on strokes that were left out. The steps without them begin at the whole fit and keep its columns: they are short.
    fn held_out(&self, whole: &Design, parametric: &Design, motion: &Motion) -> f64 {
        const STEPS: usize = 3;
        let (fold_of, count) = &parametric.folds;
        let folds: Vec<usize> = (0..*count).collect();
        let errors = in_parallel(&folds, |&fold| {
            let rows: Vec<usize> = (0..fold_of.len()).filter(|&i| fold_of[i] == fold).collect();
            if rows.is_empty() || rows.len() == fold_of.len() {
                return (0.0, 0);
            }
            let share = 1.0 - rows.len() as f64 / fold_of.len() as f64;
            let gram = &whole.gram - whole.part(&rows).gram * (1.0 - LEFT);
            let mut fit = self.clone();
            let mut tau = whole.tau.clone();
            for step in 0..if self.is_straight() { 1 } else { STEPS } {
                if step > 0 {
                    tau = fit.residual(parametric, motion) + &whole.y * fit.solution();
                }
                for &i in &rows {
                    tau[i] *= LEFT;
                }
                fit.step_by(whole, (gram.clone(), whole.y.tr_mul(&tau)), share);
            }
            let residual = fit.residual(parametric, motion);
            let scored = rows.into_iter().filter(|&i| parametric.scored[i]);
            scored.fold((0.0, 0), |(square, samples), i| {
                (square + residual[i] * residual[i], samples + 1)
            })
        });
        let (square, samples) = errors
            .into_iter()
            .fold((0.0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1));
        (square / f64::from(samples.max(1))).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mechanism::tests::motion;

    #[test]
    fn what_lies_beyond_a_place_is_filtered_like_any_regressor() {
        let motion = motion();
        let mechanism = SplineMechanism::valved(&motion);
        let mut fit = Valved {
            theta: DVector::zeros(0),
            on: Arc::new(mechanism.on(&motion)),
            mechanism,
            smoothing: START,
            held_out_rms: 0.0,
        };
        for dampings in [[3.0, 7.0], [0.0, 7.0], [3.0, 0.0]] {
            for (own, damping) in fit.mechanism.damping_coefficients.iter_mut().zip(dampings) {
                own.fill(damping);
            }
            let (places, columns) = fit.beyond_places(&motion, 0.1);
            assert_eq!(
                dampings.map(|c| c == 0.0),
                places.each_ref().map(Vec::is_empty)
            );
            let all = [(&places[0], 1.0), (&places[1], -1.0)];
            let mut columns = columns.column_iter();
            for ((places, sign), damping) in all.into_iter().zip(dampings) {
                for at in places {
                    let beyond = |dq: &f64| match sign * dq {
                        ahead if ahead > 0.0 => sign * (damping * ahead - at).max(0.0),
                        _ => 0.0,
                    };
                    let series: Vec<f64> = motion.dq.iter().map(beyond).collect();
                    let direct = DVector::from_vec(motion.regressor(&series).unwrap());
                    assert!((columns.next().unwrap() - direct).amax() < 1e-12);
                }
            }
            assert!(columns.next().is_none());
        }
    }
}
