//! The model so far on a motion: base columns and those of the effects found, and the bank of candidates beside it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use super::score::{Folds, solve};
use super::shapes::{Free, free_of};
use crate::effect::axis::FARTHEST;
use crate::effect::damping::is_everywhere;
use crate::effect::library::{Kind, LIBRARY, Object, OfState, Scope, Unit};
use crate::effect::measurement::PAYLOAD_SWITCH;
use crate::effect::{Column, Effect, RigidBody};
use crate::least_squares::{Bound, rms};
use crate::motion::{Motion, MotionError};
use crate::noise::Slopes;
use crate::parallel::in_parallel;
use crate::spline::Basis;

/// An effect of the library with its shape.
#[derive(Clone, Debug)]
pub struct Found {
    /// Which.
    pub kind: &'static Kind,
    /// Shape parameters, in the order of the kind's.
    pub shape: Vec<f64>,
    /// Which of the kind's terms are used; a constant that another effect has already is left out.
    pub used: Vec<bool>,
    /// The object with which its regressors are made.
    pub object: Arc<Object>,
    /// What the coordinate lacks to that in which the shape is stated.
    pub datum: f64,
}

/// Inertia and friction, and these beside them.
pub(crate) fn beside_rigid<'a>(found: impl IntoIterator<Item = &'a Found>) -> Vec<&'a dyn Effect> {
    let rigid: &dyn Effect = &RigidBody;
    let found = found.into_iter().map(|found| found as &dyn Effect);
    core::iter::once(rigid).chain(found).collect()
}

impl Found {
    /// The unfiltered regressors of the used terms on a motion.
    #[must_use]
    pub fn series(&self, motion: &Motion) -> Vec<Vec<f64>> {
        if self.taken_out() {
            return Vec::new();
        }
        let mut scope = Scope::of(motion, &self.object);
        scope.datum = self.datum;
        let all = (self.kind.series)(&scope, &self.shape);
        let used = all.into_iter().zip(&self.used);
        used.filter(|(_, used)| **used).map(|(s, _)| s).collect()
    }

    /// Whether it was taken out of the samples and has no regressor: a lag, a mass on the tool, a drift that free air showed.
    #[must_use]
    pub fn taken_out(&self) -> bool {
        self.used.iter().all(|used| !used)
    }

    /// Whether it has the same regressors.
    fn is_same(&self, other: &Self) -> bool {
        self.kind.is(other.kind)
            && self.shape == other.shape
            && self.used == other.used
            && Arc::ptr_eq(&self.object, &other.object)
            && self.datum == other.datum
    }

    /// Whether its effort goes with the acceleration.
    pub(super) fn is_inertia(&self) -> bool {
        self.kind.is(&PAYLOAD_SWITCH)
    }

    /// What its effort grows by per unit of the acceleration at each sample of a motion, with `theta` for the used terms.
    fn inertia(&self, motion: &Motion, theta: &[f64]) -> Vec<f64> {
        let (true, Some(more)) = (self.is_inertia(), theta.first()) else {
            return vec![0.0; motion.q.len()];
        };
        let since = |t: &f64| if *t >= self.shape[0] { *more } else { 0.0 };
        motion.time.iter().map(since).collect()
    }

    /// What its effort grows by per unit of the coordinate at each sample of a motion, with `theta` for the used terms; nothing
    /// for effects that are no function of the state.
    #[must_use]
    pub fn slope(&self, motion: &Motion, theta: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; motion.q.len()];
        if self.kind.at.is_none() {
            return out;
        }
        let step = SLOPE_STEP * Scope::of(motion, &self.object).range();
        for side in [1.0, -1.0] {
            let moved = Self {
                datum: self.datum + side * step,
                ..self.clone()
            };
            for (series, theta) in moved.series(motion).iter().zip(theta) {
                for (out, value) in out.iter_mut().zip(series) {
                    *out += side * theta * value / (2.0 * step);
                }
            }
        }
        out
    }

    /// What its effort grows by per unit of the velocity at each sample of a motion, with `theta` for the used terms; nothing
    /// for effects that are no function of the state.
    #[must_use]
    pub fn damping(&self, motion: &Motion, theta: &[f64]) -> Vec<f64> {
        let Some(at) = self.kind.at else {
            return vec![0.0; motion.q.len()];
        };
        let step = SLOPE_STEP * Scope::of(motion, &self.object).fastest();
        let effort = |q: f64, dq: f64| -> f64 {
            let terms = at(&self.shape, q, dq);
            let used = terms.iter().zip(&self.used).filter(|(_, used)| **used);
            used.zip(theta)
                .map(|((value, _), theta)| value * theta)
                .sum()
        };
        let states = motion.q.iter().zip(&motion.dq);
        states
            .map(|(q, dq)| per_velocity(*dq, step, |dq| effort(q + self.datum, dq)))
            .collect()
    }

    /// The free numbers of its shape where it is a function of the state.
    fn free_on(&self, motion: &Motion) -> Vec<Free> {
        if self.kind.at.is_none() {
            return Vec::new();
        }
        free_of(
            &Scope::of(motion, &self.object),
            core::slice::from_ref(self),
        )
    }

    /// Where these numbers stand in the shape, and what a step changes of them.
    pub(super) fn steps_on(&self, motion: &Motion) -> Vec<(usize, f64)> {
        let free = self.free_on(motion).into_iter();
        free.map(|free| (free.shape, free.per_step(self.shape[free.shape])))
            .collect()
    }

    /// It with these numbers moved by so many steps.
    pub(super) fn with_steps(&self, motion: &Motion, steps: &[f64]) -> Self {
        let mut out = self.clone();
        for (free, step) in self.free_on(motion).iter().zip(steps) {
            out.shape[free.shape] = free.moved(self.shape[free.shape], *step);
        }
        out
    }

    /// Makes the ways by which it moves the object so many times as large.
    pub(super) fn grow(&mut self, times: f64) {
        for (of, value) in self.kind.shape.iter().zip(&mut self.shape) {
            if matches!(of.1, Unit::Position | Unit::Compliance) {
                *value *= times;
            }
        }
    }

    /// The used terms.
    pub fn terms(&self) -> impl Iterator<Item = &'static crate::effect::library::TermOf> {
        let terms = self.kind.terms.iter().zip(&self.used);
        terms.filter(|(_, used)| **used).map(|(term, _)| term)
    }
}

/// Inertia, Coulomb and viscous friction stand before the effects in a model's parameters.
pub(super) const RIGID: usize = 3;
/// Half the way over which a slope is taken, as a share of the range.
const SLOPE_STEP: f64 = 2e-3;

/// Slope by the velocity, of two efforts on the same side of rest.
pub(crate) fn per_velocity(dq: f64, step: f64, effort: impl Fn(f64) -> f64) -> f64 {
    let (slow, fast) = ((dq.abs() - step).max(0.1 * step), dq.abs() + step);
    let side = if dq < 0.0 { -1.0 } else { 1.0 };
    side * (effort(side * fast) - effort(side * slow)) / (fast - slow)
}

/// The object with the effects `found`, whose terms stand in `theta` behind inertia and friction.
pub(super) fn object_of(found: &[Found], theta: &[f64]) -> Object {
    let mut theta = theta.iter().copied();
    let rigid = core::array::from_fn(|_| theta.next().unwrap_or(0.0).max(0.0));
    let mut effects = Vec::new();
    for found in found {
        let mut own = [0.0; 2];
        for (own, _) in own.iter_mut().zip(&found.used).filter(|(_, used)| **used) {
            *own = theta.next().unwrap_or(0.0);
        }
        effects.extend(found.kind.at.map(|at| OfState {
            at,
            shape: found.shape.clone(),
            theta: own,
        }));
    }
    Object { rigid, effects }
}

/// Slope by acceleration, coordinate and velocity of all of `found`, whose terms stand in `theta` behind inertia and friction.
pub(crate) fn slopes_of(motion: &Motion, found: &[Found], theta: &[f64]) -> Slopes {
    let mut out = Slopes::none(motion.q.len());
    let mut at = RIGID;
    for found in found {
        let terms = found.terms().count();
        let own = theta.get(at..at + terms).unwrap_or(&[]);
        let each = [
            found.inertia(motion, own),
            found.slope(motion, own),
            found.damping(motion, own),
        ];
        let to = [&mut out.inertia, &mut out.load, &mut out.damping];
        for (out, slope) in to.into_iter().zip(each) {
            for (out, slope) in out.iter_mut().zip(slope) {
                *out += slope;
            }
        }
        at += terms;
    }
    out
}

impl Effect for Found {
    fn name(&self) -> &'static str {
        self.kind.name
    }

    fn columns(&self, motion: &Motion) -> Result<Vec<Column>, MotionError> {
        let series = self.series(motion);
        self.terms()
            .zip(&series)
            .map(|(term, series)| {
                Ok(Column {
                    name: term.0,
                    unit: term.1.text(motion.kind),
                    bound: term.2,
                    values: motion.regressor(series)?,
                })
            })
            .collect()
    }

    fn series(&self, motion: &Motion) -> Result<Vec<Vec<f64>>, MotionError> {
        Ok(Self::series(self, motion))
    }

    fn shape_limits(&self, motion: &Motion) -> Vec<[f64; 2]> {
        let free = self.free_on(motion).into_iter();
        free.map(|free| free.within(self.shape[free.shape]))
            .collect()
    }

    fn moved(&self, motion: &Motion, steps: &[f64]) -> Option<Box<dyn Effect>> {
        (!steps.is_empty()).then(|| -> Box<dyn Effect> { Box::new(self.with_steps(motion, steps)) })
    }
}

/// A motion with its effort at the fit's samples.
pub(super) struct Ground {
    pub(super) motion: Motion,
    pub(super) y: Vec<f64>,
    pub(super) folds: Folds,
    pub(super) base: Vec<Vec<f64>>,
    /// The object as far as it is known.
    pub(super) object: Arc<Object>,
    /// Which of the base columns a search uses: inertia and viscous friction only while their estimates are positive.
    pub(super) active: [bool; 3],
    /// A load over the coordinate that no effect of the library explains, beside which the search goes on; empty at first.
    pub(super) curve: Vec<Vec<f64>>,
    made: Made,
}

/// Filtered columns of the effects that were made last.
#[derive(Default)]
struct Made(Mutex<VecDeque<(Found, Columns)>>);

/// Columns that are shared, not copied.
pub(super) type Columns = Arc<Vec<Vec<f64>>>;

/// As many as the trials of a search go back to.
const MOST_MADE: usize = 32;

impl Made {
    fn get(&self, found: &Found) -> Option<Columns> {
        let made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let same = made.iter().find(|(old, _)| old.is_same(found));
        same.map(|(_, columns)| Arc::clone(columns))
    }

    fn put(&self, found: &Found, columns: &Columns) {
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        made.truncate(MOST_MADE - 1);
        made.push_front((found.clone(), Arc::clone(columns)));
    }
}

/// Pieces of the curve: as smooth as springs, struts and weights are, so that notches and magnets are not in it.
const CURVE_PIECES: usize = 6;

impl Ground {
    pub(super) fn of(motion: Motion) -> Result<Self, MotionError> {
        let base: Vec<Vec<f64>> = RigidBody
            .columns(&motion)?
            .into_iter()
            .map(|column| column.values)
            .collect();
        let y = motion.regressor(&motion.tau)?;
        let theta = solve(&base, &y).unwrap_or_else(|| vec![0.0; 3]);
        Ok(Self {
            y,
            folds: blocks(&motion),
            motion,
            base,
            object: Arc::new(object_of(&[], &theta)),
            active: [true; 3],
            curve: Vec::new(),
            made: Made::default(),
        })
    }

    /// Columns of a smooth load of any shape over the coordinate.
    pub(super) fn smooth_load(&self) -> Result<Vec<Vec<f64>>, MotionError> {
        let [low, high] = self.scope().q;
        let basis = Basis::new(low, high, CURVE_PIECES, 3);
        let mut series = vec![vec![0.0; self.motion.q.len()]; basis.len()];
        for (i, q) in self.motion.q.iter().enumerate() {
            let (first, values) = basis.evaluate(*q);
            for (series, value) in series[first..].iter_mut().zip(&values[..=basis.degree()]) {
                series[i] = *value;
            }
        }
        series
            .iter()
            .map(|series| self.motion.regressor(series))
            .collect()
    }

    /// Active columns of the base, those of `effects`, and the curve.
    pub(super) fn columns(&self, effects: &[Found]) -> Result<Vec<Vec<f64>>, MotionError> {
        let mut out = self.plain_columns(effects)?;
        out.extend(self.curve.iter().cloned());
        Ok(out)
    }

    /// Active columns of the base, and those of `effects`.
    pub(super) fn plain_columns(&self, effects: &[Found]) -> Result<Vec<Vec<f64>>, MotionError> {
        let all = self.all_columns(effects)?;
        let used = |j: usize| self.active.get(j).copied().unwrap_or(true);
        let numbered = all.into_iter().enumerate();
        Ok(numbered.filter(|(j, _)| used(*j)).map(|(_, c)| c).collect())
    }

    /// Columns of the base and of `effects`, in the order of a model's parameters.
    pub(super) fn all_columns(&self, effects: &[Found]) -> Result<Vec<Vec<f64>>, MotionError> {
        let mut out = self.base.clone();
        for own in self.each_with(effects)? {
            out.extend(own.iter().cloned());
        }
        Ok(out)
    }

    /// Filtered columns of an effect, which will be asked for again.
    pub(super) fn columns_with(&self, found: &Found) -> Result<Columns, MotionError> {
        if let Some(columns) = self.made.get(found) {
            return Ok(columns);
        }
        let columns = Arc::new(self.filtered(found)?);
        self.made.put(found, &columns);
        Ok(columns)
    }

    /// As [`Self::columns_with`] of each effect. No thread is started for what has been made.
    pub(super) fn each_with(&self, effects: &[Found]) -> Result<Vec<Columns>, MotionError> {
        let mut all: Vec<Option<Columns>> = effects.iter().map(|f| self.made.get(f)).collect();
        let missing: Vec<usize> = (0..all.len()).filter(|&i| all[i].is_none()).collect();
        let made = in_parallel(&missing, |&i| self.columns_with(&effects[i]));
        for (i, made) in missing.into_iter().zip(made) {
            all[i] = Some(made?);
        }
        Ok(all.into_iter().flatten().collect())
    }

    /// Filtered columns of an effect.
    pub(super) fn filtered(&self, found: &Found) -> Result<Vec<Vec<f64>>, MotionError> {
        let series = found.series(&self.motion);
        let columns = series.iter().map(|series| self.motion.regressor(series));
        columns.collect()
    }

    pub(super) fn scope(&self) -> Scope<'_> {
        Scope::of(&self.motion, &self.object)
    }

    /// Filtered columns of a kind with a shape.
    pub(super) fn columns_of(
        &self,
        kind: &Kind,
        shape: &[f64],
    ) -> Result<Vec<Vec<f64>>, MotionError> {
        (kind.series)(&self.scope(), shape)
            .iter()
            .map(|series| self.motion.regressor(series))
            .collect()
    }

    pub(super) fn found(&self, kind: &'static Kind, shape: Vec<f64>, used: Vec<bool>) -> Found {
        Found {
            kind,
            shape,
            used,
            object: Arc::clone(&self.object),
            datum: 0.0,
        }
    }
}

/// Samples in a row that are held out together: six periods of the cut-off, many times what the filter remembers.
const BLOCK: usize = 24;

/// Fold of each kept sample, and their number: pieces of strokes take turns. What one stroke alone shows (the only one that
/// is fast enough to open a valve) can then be learned from one half of it and tested on the other. Motions of few strokes
/// have the folds of [`Motion::folds`].
pub(super) fn blocks(motion: &Motion) -> Folds {
    let strokes: Vec<usize> = motion.kept.iter().map(|&i| motion.stroke[i]).collect();
    if strokes.last().is_none_or(|last| last / 2 + 1 < 3) {
        return motion.folds();
    }
    let (mut block, mut begun) = (0, 0);
    let mut folds = Vec::with_capacity(strokes.len());
    for (k, stroke) in strokes.iter().enumerate() {
        if k > 0 && (*stroke != strokes[k - 1] || k - begun >= BLOCK) {
            block += 1;
            begun = k;
        }
        folds.push(block % FOLDS);
    }
    (folds, FOLDS)
}

const FOLDS: usize = 6;

/// One point of a kind's grid, with its filtered columns. Single precision: hundreds of them are held at once, and the best is made
/// anew before it is added.
#[derive(Clone)]
pub(super) struct Candidate {
    pub(super) kind: &'static Kind,
    pub(super) shape: Vec<f64>,
    columns: Vec<Vec<f32>>,
}

impl Candidate {
    pub(super) fn columns(&self) -> Vec<Vec<f64>> {
        let column = |column: &Vec<f32>| column.iter().map(|value| f64::from(*value)).collect();
        self.columns.iter().map(column).collect()
    }
}

/// What changes in the course of a recording: it needs a motion that comes to the same places again.
pub(super) fn is_of_time(kind: &Kind) -> bool {
    OF_TIME.contains(&kind.name)
}

const OF_TIME: [&str; 3] = ["sensor_drift", "friction_drift", "payload_switch"];

/// All grid points of the library on a motion that may show them.
pub(super) fn bank(ground: &Ground) -> Result<Vec<Candidate>, MotionError> {
    grid_points(ground, |_| true)
}

/// Those of some kinds.
pub(super) fn grid_points(
    ground: &Ground,
    of: impl Fn(&Kind) -> bool,
) -> Result<Vec<Candidate>, MotionError> {
    let scope = ground.scope();
    let shows_time = ground.motion.shows_time();
    let points: Vec<(&'static Kind, Vec<f64>)> = LIBRARY
        .into_iter()
        .filter(|kind| of(kind) && (shows_time || !is_of_time(kind)))
        .flat_map(|kind| {
            (kind.grid)(&scope)
                .into_iter()
                .map(move |shape| (kind, shape))
        })
        .collect();
    candidates(ground, &points)
}

/// Kinds of these shapes, with their filtered columns; what does nothing on the motion is left out.
pub(super) fn candidates(
    ground: &Ground,
    points: &[(&'static Kind, Vec<f64>)],
) -> Result<Vec<Candidate>, MotionError> {
    let made = in_parallel(points, |(kind, shape)| {
        let columns = ground.columns_of(kind, shape)?;
        let all_finite = columns.iter().flatten().all(|v| v.is_finite());
        let moves = columns.first().is_some_and(|column| rms(column) > 1e-12);
        let single = |column: &Vec<f64>| column.iter().map(|value| *value as f32).collect();
        Ok((all_finite && moves).then(|| Candidate {
            kind,
            shape: shape.clone(),
            columns: columns.iter().map(single).collect(),
        }))
    });
    made.into_iter().filter_map(Result::transpose).collect()
}

/// Whether it is sure from elsewhere than the effort: weight about an axis that is seen to lean.
pub(super) fn is_known(found: &Found) -> bool {
    found.kind.name == "gravity" && found.used.last() == Some(&false)
}

/// Loads without a place of their own: a curve over the coordinate holds them, notches and magnets that have a place it does not.
pub(crate) fn is_smooth_load(kind: &Kind) -> bool {
    SMOOTH_LOADS.contains(&kind.name)
}

const SMOOTH_LOADS: [&str; 4] = ["constant_load", "asymmetric_coulomb", "spring", "gravity"];

/// Loads over the coordinate: what a curve over it may stand in for.
pub(super) fn is_load(kind: &Kind) -> bool {
    LOADS.contains(&kind.name)
}

const LOADS: [&str; 6] = [
    "constant_load",
    "spring",
    "gravity",
    "detent",
    "catch",
    "ripple",
];

/// Whether the estimates keep the signs that physics allows.
pub(super) fn signs_hold(kind: &Kind, used: &[bool], theta: &[f64]) -> bool {
    let terms = kind.terms.iter().zip(used).filter(|(_, used)| **used);
    terms
        .zip(theta)
        .all(|((term, _), value)| match (term.1, term.0) {
            (Unit::Length, _) => value.abs() < FARTHEST,
            // What an effect does through the object as it is known cannot be a fraction of it.
            (Unit::One, _) => SHARE.contains(value),
            // Oil through an open valve and a gap resists no more than through the gap.
            (_, "beyond") => (-0.1 * theta[0]..theta[0]).contains(value),
            _ => term.2 == Bound::Free || *value > 0.0,
        })
}

/// What the model's own estimates keep beside a candidate, by its first term.
pub(super) enum Keeps {
    Nothing,
    /// What moves after a change of the inertia still has one; the place of the inertia among the model's columns.
    Inertia(Option<usize>),
    /// The friction at this place of the model's columns keeps its sign: what resists one way only must not be made up of a friction that drives the
    /// other way.
    Friction(usize),
}

impl Keeps {
    pub(super) fn of(ground: &Ground, kind: &Kind, shape: &[f64]) -> Self {
        let [inertia, _, viscous] = ground.active;
        let coulomb = usize::from(inertia);
        match kind.name {
            "payload_switch" => Self::Inertia(inertia.then_some(0)),
            "asymmetric_coulomb" => Self::Friction(coulomb),
            "asymmetric_viscous" if viscous => Self::Friction(coulomb + 1),
            "damping_zone" if viscous && is_everywhere(shape, &ground.scope()) => {
                Self::Friction(coulomb + 1)
            }
            _ => Self::Nothing,
        }
    }

    /// Whether that holds; `theta` = estimates of the candidate, `rest` = of the current model's columns.
    pub(super) fn hold(&self, theta: &[f64], rest: &[f64]) -> bool {
        match self {
            Self::Nothing => true,
            Self::Inertia(at) => at.and_then(|at| rest.get(at)).unwrap_or(&0.0) + theta[0] > 0.0,
            Self::Friction(at) => {
                let friction = rest.get(*at);
                friction.is_none_or(|friction| *friction > -0.1 * theta[0])
            }
        }
    }
}

/// Terms without a unit scale a regressor that is complete by itself.
const SHARE: core::ops::Range<f64> = 0.35..2.8;
