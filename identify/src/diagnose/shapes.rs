//! Shapes of effects by nonlinear least squares: terms and shapes together, Levenberg and Marquardt's way, with the
//! derivatives of the filtered regressors taken numerically and the terms solved for at every trial.

use nalgebra::{DMatrix, DVector};

use super::model::{Columns, Found, Ground, signs_hold};
use super::score::{factor, gram};
use crate::effect::library::{Kind, LONGEST_DRIFT, SHORTEST_DRIFT, Scope, Search, Shape};
use crate::motion::{Motion, MotionError};
use crate::parallel::in_parallel;
use crate::products::{combine, dot, residual};

const ITERATIONS: usize = 40;
/// An iteration that lowers the squared error by less than this share is the last: on the way of a search, where shapes are polished time and
/// again, and at its end.
pub(super) const ENOUGH: f64 = 1e-3;
pub(super) const ENOUGH_AT_LAST: f64 = 1e-4;
/// What moves the object may leave so much more when it is as large as its term says: its shape was fitted to what it was.
const GROWN_BELOW: f64 = 1.02;
/// A shape that does next to nothing where it is, such as the end of a zone behind the range, is damped as one with this share of the curvature of the
/// most curved one: it has no reason to go far.
const FLAT: f64 = 1e-3;

/// A shape parameter of one of the effects, with a step of its own size and with limits.
#[derive(Clone, Copy)]
pub(super) struct Free {
    pub(super) effect: usize,
    pub(super) shape: usize,
    /// Steps are factors.
    by_factor: bool,
    /// What a step of one adds, when steps are not factors.
    unit: f64,
    limits: [f64; 2],
}

impl Free {
    fn of(
        effect: usize,
        shape: usize,
        search: Search,
        start: f64,
        scope: &Scope<'_>,
    ) -> Option<Self> {
        let range = scope.range();
        let (by_factor, unit, limits) = match search {
            Search::Fixed | Search::Form | Search::ByShare => return None,
            Search::Way(share) => (false, range, [start - share * range, start + share * range]),
            Search::Seconds(s) => (false, s, [start - s, start + s]),
            Search::Factor(f) => (true, 1.0, [start / (f * f), start * f * f]),
            Search::Below => {
                let fastest = scope.fastest();
                (true, 1.0, [0.12 * fastest, fastest])
            }
            Search::Between(low, high) => (true, 1.0, [low * range, high * range]),
            Search::Lasting(low, high) => (true, 1.0, [low, high]),
            Search::Drift => (true, 1.0, drift_limits(scope.duration())),
        };
        Some(Self {
            effect,
            shape,
            by_factor,
            unit,
            limits,
        })
    }

    /// The parameter `step` away from `at`, within the limits.
    pub(super) fn moved(&self, at: f64, step: f64) -> f64 {
        let there = if self.by_factor {
            at * step.clamp(-1.0, 1.0).exp()
        } else {
            at + step * self.unit
        };
        there.clamp(self.limits[0], self.limits[1])
    }

    /// Half of what the limits of a search from here leave, in steps of one.
    pub(super) fn reach(&self) -> f64 {
        let [low, high] = self.limits;
        0.5 * if self.by_factor {
            (high / low).ln()
        } else {
            (high - low) / self.unit
        }
    }

    /// What a step of one changes at `at`.
    pub(super) fn per_step(&self, at: f64) -> f64 {
        if self.by_factor { at } else { self.unit }
    }

    /// The step from `at` to `moved`.
    fn step_to(&self, at: f64, moved: f64) -> f64 {
        if self.by_factor {
            (moved / at).ln()
        } else {
            (moved - at) / self.unit
        }
    }

    /// How many steps lead from `at` to the limits of a search from there.
    pub(super) fn within(&self, at: f64) -> [f64; 2] {
        let most = if self.by_factor { 1.0 } else { f64::INFINITY };
        let [low, high] = self.limits.map(|limit| self.step_to(at, limit));
        [low.clamp(-most, 0.0), high.clamp(0.0, most)]
    }

    /// The parameter a small step from `at`: to the other side where `at` is at the limit, or as near to it or beyond as rounding takes it.
    fn nearby(&self, at: f64) -> f64 {
        let small = self.small();
        let moved = self.moved(at, small);
        if self.step_to(at, moved) < 0.5 * small {
            return self.moved(at, -small);
        }
        moved
    }

    /// A step that changes the regressors little.
    fn small(&self) -> f64 {
        if self.by_factor { 0.02 } else { 4e-3 }
    }
}

/// How long a drift takes in a recording of `whole` s: from so long that several strokes see it go to what is as good as a straight line, s.
fn drift_limits(whole: f64) -> [f64; 2] {
    [
        (SHORTEST_DRIFT * whole).min(FEW_STROKES_S),
        LONGEST_DRIFT * whole,
    ]
}

/// In a long recording several strokes see what takes this long, s.
const FEW_STROKES_S: f64 = 5.0;

/// The free shapes of effects.
pub(super) fn free_of(scope: &Scope<'_>, effects: &[Found]) -> Vec<Free> {
    let each = effects.iter().enumerate().flat_map(|(effect, found)| {
        // A relief that no term asks for stays where it is.
        let unused = found.used.iter().any(|used| !used);
        let shapes = found.kind.shape.iter().zip(&found.shape).enumerate();
        shapes
            .filter(move |(_, (of, _))| !(of.2 == Search::Below && unused))
            .filter_map(move |(shape, (of, start))| Free::of(effect, shape, of.2, *start, scope))
    });
    each.collect()
}

/// The shape with its moment, where it has one, on a grid about where it is: the error has many minima over it, one in each stroke and
/// rest, between which no polish steps.
pub(super) fn moments(kind: &Kind, shape: &[f64]) -> Vec<Vec<f64>> {
    let moment = kind.shape.iter().enumerate().find_map(|(k, of)| {
        let Search::Seconds(within) = of.2 else {
            return None;
        };
        Some((k, within))
    });
    let Some((k, within)) = moment else {
        return Vec::new();
    };
    let steps = (-MOMENTS..=MOMENTS).map(|step| f64::from(step) / f64::from(MOMENTS) * within);
    let moved = steps.map(|step| {
        let mut shape = shape.to_vec();
        shape[k] += step;
        shape
    });
    moved.collect()
}

/// Moments on either side.
const MOMENTS: i32 = 16;

/// The columns beside the effects and the effort, with what they have in common.
struct Beside<'a> {
    x: &'a [Vec<f64>],
    y: &'a [f64],
    gram: DMatrix<f64>,
    right: Vec<f64>,
}

impl<'a> Beside<'a> {
    fn new(x: &'a [Vec<f64>], y: &'a [f64]) -> Self {
        Self {
            x,
            y,
            gram: gram(x),
            right: x.iter().map(|column| dot(column, y)).collect(),
        }
    }
}

/// A trial: the effects' columns, all terms, and the sum of squares they leave.
struct Trial {
    effects: Vec<Found>,
    columns: Vec<Columns>,
    /// Of the columns beside the effects and those of the effects.
    gram: DMatrix<f64>,
    theta: Vec<f64>,
    residual: Vec<f64>,
    square: f64,
}

impl Trial {
    fn with(ground: &Ground, beside: &Beside<'_>, effects: Vec<Found>) -> Option<Self> {
        let columns = ground.each_with(&effects).ok()?;
        Self::of(beside, effects, columns)
    }

    fn of(beside: &Beside<'_>, effects: Vec<Found>, columns: Vec<Columns>) -> Option<Self> {
        let all: Vec<&Vec<f64>> = beside
            .x
            .iter()
            .chain(columns.iter().flat_map(|own| own.iter()))
            .collect();
        let own = &all[beside.x.len()..];
        let gram = bordered(&beside.gram, &all);
        let of_own = own.iter().map(|column| dot(column, beside.y));
        let right = beside.right.iter().copied().chain(of_own);
        let right = DVector::from_iterator(all.len(), right);
        let theta = factor(&gram)?.solve(&right).as_slice().to_vec();
        let mut at = beside.x.len();
        for found in &effects {
            let count = found.terms().count();
            if !signs_hold(found.kind, &found.used, &theta[at..at + count]) {
                return None;
            }
            at += count;
        }
        let residual = residual(beside.y, all.iter().copied(), &theta);
        let square = residual.iter().map(|r| r * r).sum();
        Some(Self {
            effects,
            columns,
            gram,
            theta,
            residual,
            square,
        })
    }
}

/// The normal matrix of `columns`, of which that of the first ones is known.
fn bordered(known: &DMatrix<f64>, columns: &[&Vec<f64>]) -> DMatrix<f64> {
    let mut out = known.clone().resize(columns.len(), columns.len(), 0.0);
    for i in known.nrows()..columns.len() {
        for j in 0..=i {
            out[(i, j)] = dot(columns[i], columns[j]);
            out[(j, i)] = out[(i, j)];
        }
    }
    out
}

/// The effects with the shapes near theirs that leave the least of `y` beside the columns `x`; as they are when their terms
/// have the wrong signs or nothing is better.
pub(super) fn polished(
    ground: &Ground,
    x: &[Vec<f64>],
    y: &[f64],
    effects: Vec<Found>,
    enough: f64,
) -> Vec<Found> {
    let free = free_of(&ground.scope(), &effects);
    if free.is_empty() {
        return effects;
    }
    let beside = Beside::new(x, y);
    let Some(mut best) = Trial::with(ground, &beside, effects.clone()) else {
        return effects;
    };
    let mut damping = 1e-2;
    for _ in 0..ITERATIONS {
        let Some(jacobian) = jacobian(ground, x, &best, &free) else {
            break;
        };
        let normal = Normal::of(&beside, &best, &jacobian);
        let before = best.square;
        for _ in 0..6 {
            let next = stepped(ground, &beside, &best, &free, &normal, damping);
            match next {
                Some(next) if next.square < best.square => {
                    best = next;
                    damping = (0.2 * damping).max(1e-6);
                    break;
                }
                _ => damping *= 8.0,
            }
        }
        if best.square > (1.0 - enough) * before {
            break;
        }
    }
    match grown(ground, &beside, &best) {
        Some(grown) if grown.square < GROWN_BELOW * best.square => grown.effects,
        _ => best.effects,
    }
}

/// The trial with what moves the object as large as its term says, which is near 1 then; nothing where nothing does.
fn grown(ground: &Ground, beside: &Beside<'_>, trial: &Trial) -> Option<Trial> {
    let mut effects = trial.effects.clone();
    let (mut at, mut any) = (beside.x.len(), false);
    for found in &mut effects {
        let by_share = |shape: &Shape| shape.2 == Search::ByShare;
        if found.kind.shape.iter().any(by_share) {
            found.grow(trial.theta[at]);
            any = true;
        }
        at += found.terms().count();
    }
    any.then(|| Trial::with(ground, beside, effects)).flatten()
}

/// What a unit step of each free shape of a trial does to the effort.
fn jacobian(
    ground: &Ground,
    x: &[Vec<f64>],
    trial: &Trial,
    free: &[Free],
) -> Option<Vec<Vec<f64>>> {
    let theta = &trial.theta[x.len()..];
    moves(&ground.motion, &trial.effects, &trial.columns, theta, free).ok()
}

/// What a unit step of each free shape does to the effort, in the order of the kept samples, where the effects have these filtered columns and
/// `theta` for their terms.
pub(super) fn moves(
    motion: &Motion,
    effects: &[Found],
    columns: &[Columns],
    theta: &[f64],
    free: &[Free],
) -> Result<Vec<Vec<f64>>, MotionError> {
    let starts: Vec<usize> = effects
        .iter()
        .scan(0, |at, found| {
            let start = *at;
            *at += found.terms().count();
            Some(start)
        })
        .collect();
    let each = in_parallel(free, |parameter| {
        let mut found = effects[parameter.effect].clone();
        let at = found.shape[parameter.shape];
        let moved = parameter.nearby(at);
        let step = parameter.step_to(at, moved);
        found.shape[parameter.shape] = moved;
        let terms = &theta[starts[parameter.effect]..];
        // The filter is linear, so once is enough.
        let mut out = motion.regressor(&combine(&found.series(motion), terms))?;
        let here = combine(&columns[parameter.effect], terms);
        for (out, here) in out.iter_mut().zip(here) {
            *out = (*out - here) / step;
        }
        Ok(out)
    });
    each.into_iter().collect()
}

/// The normal equations of a step of all terms and shapes.
struct Normal {
    gram: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    fn of(beside: &Beside<'_>, trial: &Trial, jacobian: &[Vec<f64>]) -> Self {
        let linear = beside
            .x
            .iter()
            .chain(trial.columns.iter().flat_map(|own| own.iter()));
        let columns: Vec<&Vec<f64>> = linear.chain(jacobian).collect();
        let right = columns.iter().map(|column| dot(column, &trial.residual));
        Self {
            gram: bordered(&trial.gram, &columns),
            right: DVector::from_iterator(columns.len(), right),
        }
    }
}

/// The trial after one damped step of all shapes.
fn stepped(
    ground: &Ground,
    beside: &Beside<'_>,
    trial: &Trial,
    free: &[Free],
    normal: &Normal,
    damping: f64,
) -> Option<Trial> {
    let mut gram = normal.gram.clone();
    let linear = trial.gram.nrows();
    let most = (linear..gram.nrows())
        .map(|i| gram[(i, i)])
        .fold(0.0, f64::max);
    for i in 0..gram.nrows() {
        let own = gram[(i, i)];
        let damped = damping * own.max(FLAT * most);
        gram[(i, i)] += 1e-9 * own + 1e-12 + if i >= linear { damped } else { 0.0 };
    }
    let step = gram.cholesky()?.solve(&normal.right);
    let mut effects = trial.effects.clone();
    for (k, parameter) in free.iter().enumerate() {
        let shape = &mut effects[parameter.effect].shape[parameter.shape];
        *shape = parameter.moved(*shape, step[linear + k]);
    }
    Trial::with(ground, beside, effects)
}

#[cfg(test)]
mod tests {
    use super::Free;

    #[test]
    fn a_slope_is_taken_over_a_whole_step_at_a_limit_too() {
        let [low, high] = [4.2, 600.0_f64];
        let free = Free {
            effect: 0,
            shape: 0,
            by_factor: true,
            unit: 1.0,
            limits: [low, high],
        };
        for at in [
            low,
            high,
            high.next_up(),
            high.next_down(),
            3.0 * high,
            60.0,
        ] {
            let step = free.step_to(at, free.nearby(at)).abs();
            assert!(step > 0.5 * free.small(), "{at}: {step}");
        }
    }
}
