//! One look through the library: every candidate beside the current model, the best refined, with what chance would give.

use super::gates::limit;
use super::model::{Candidate, Found, Ground, Keeps, signs_hold};
use super::score::Problem;
use super::shapes::{ENOUGH, moments, polished};
use crate::effect::library::{Belongs, Kind, Search, Shape};
use crate::least_squares::rms;
use crate::motion::MotionError;
use crate::parallel::in_parallel;

/// The best of one kind beside the current model.
#[derive(Clone, Debug)]
pub(super) struct Ranked {
    pub(super) kind: &'static Kind,
    pub(super) shape: Vec<f64>,
    pub(super) used: Vec<bool>,
    /// Evidence: half the independent samples times the logarithm of the errors' ratio, less the price of its freedom.
    pub(super) score: f64,
    /// Mean square error on held-out blocks with it.
    pub(super) mse: f64,
    /// Share of the blocks in which it helps.
    pub(super) helps: f64,
    /// Estimates of the used terms.
    pub(super) theta: Vec<f64>,
}

/// What one look finds.
pub(super) struct Look {
    /// Mean square error on held-out blocks of the current model.
    pub(super) mse: f64,
    /// One entry per kind that helps at all, the best first.
    pub(super) ranked: Vec<Ranked>,
    /// Best score that chance gave, by replicate.
    pub(super) chance: Vec<f64>,
}

impl Look {
    /// The least error on held-out blocks, rms, of the current model and of the object's effects that help more than chance does: one that belongs to
    /// the recording may help by what noise there is.
    pub(super) fn least_beyond_chance(&self) -> f64 {
        let most = limit(&self.chance);
        let sure = |entry: &&Ranked| entry.score > most && entry.kind.belongs == Belongs::Object;
        let sure = self.ranked.iter().filter(sure);
        sure.map(|entry| entry.mse).fold(self.mse, f64::min).sqrt()
    }
}

/// Kinds that are refined, from the best.
const REFINED: usize = 7;

/// Looks through `bank` beside the columns `x` of the current model; `efforts` = the measured one and replicates. What leaves more than
/// `most_mse` is not refined, but for valves and moments that the grid does not have.
pub(super) fn look(
    ground: &Ground,
    bank: &[Candidate],
    x: &[Vec<f64>],
    efforts: &[Vec<f64>],
    most_mse: f64,
) -> Result<Option<Look>, MotionError> {
    let problem = Problem::new(x, efforts, &ground.folds);
    let Some(alone) = problem.alone() else {
        return Ok(None);
    };
    let before: Vec<f64> = alone.iter().map(|outcome| outcome.mse).collect();
    let scored = in_parallel(bank, |candidate| {
        score_all(ground, &problem, candidate, &before, &alone[0].blocks)
    });
    let mut chance = vec![0.0_f64; efforts.len().saturating_sub(1)];
    let mut ranked: Vec<Ranked> = Vec::new();
    for (own, others) in scored.into_iter().flatten() {
        for (best, score) in chance.iter_mut().zip(others) {
            *best = best.max(score);
        }
        let Some(own) = own else { continue };
        match ranked.iter_mut().find(|old| old.kind.is(own.kind)) {
            Some(old) if own.score > old.score => *old = own,
            Some(_) => {}
            None => ranked.push(own),
        }
    }
    sort(&mut ranked);
    ranked.retain(|entry| entry.score > 0.0);
    let top: Vec<Ranked> = ranked.iter().take(REFINED).cloned().collect();
    let better: Vec<Result<Ranked, MotionError>> = in_parallel(&top, |entry| {
        let more = |of: &Shape| matches!(of.2, Search::Below | Search::Seconds(_));
        if entry.mse > most_mse && !entry.kind.shape.iter().any(more) {
            return Ok(entry.clone());
        }
        refine(ground, &problem, entry, before[0], &alone[0].blocks)
    });
    for (old, new) in ranked.iter_mut().zip(better) {
        *old = new?;
    }
    sort(&mut ranked);
    Ok(Some(Look {
        mse: before[0],
        ranked,
        chance,
    }))
}

fn sort(ranked: &mut [Ranked]) {
    ranked.sort_by(|a, b| b.score.total_cmp(&a.score));
}

type Scored = Option<(Option<Ranked>, Vec<f64>)>;

/// A candidate on the measured effort and on the replicates.
fn score_all(
    ground: &Ground,
    problem: &Problem<'_>,
    candidate: &Candidate,
    before: &[f64],
    blocks: &[f64],
) -> Scored {
    let (used, outcomes) = outcomes(problem, candidate.kind, &candidate.columns(), before.len())?;
    let keeps = Keeps::of(ground, candidate.kind, &candidate.shape);
    let scored = |k: usize| {
        let (theta, rest) = (&outcomes[k].theta, &outcomes[k].rest);
        let holds = signs_hold(candidate.kind, &used, theta) && keeps.hold(theta, rest);
        let score = evidence(problem, candidate.kind, &used, before[k], outcomes[k].mse);
        if holds { score } else { 0.0 }
    };
    let others = (1..before.len()).map(scored).collect();
    let own = &outcomes[0];
    let helps = share_helped(blocks, &own.blocks);
    let score = scored(0);
    let own = Ranked {
        kind: candidate.kind,
        shape: candidate.shape.clone(),
        mse: own.mse,
        theta: own.theta.clone(),
        helps,
        score,
        used,
    };
    Some(((score > 0.0).then_some(own), others))
}

/// With all terms, or with one left out that the model has already; of what has a valve none is, as one without what lies beyond it would open at a
/// speed that nothing pays for.
fn outcomes(
    problem: &Problem<'_>,
    kind: &Kind,
    columns: &[Vec<f64>],
    efforts: usize,
) -> Option<(Vec<bool>, Vec<super::score::Outcome>)> {
    let there: Vec<bool> = columns.iter().map(|column| rms(column) > 1e-12).collect();
    // A moment after the last sample.
    if !there.contains(&true) {
        return None;
    }
    let try_with = |used: Vec<bool>| {
        let some = columns.iter().zip(&used).filter(|(_, used)| **used);
        let some: Vec<&[f64]> = some.map(|(column, _)| column.as_slice()).collect();
        Some((used, problem.with(&some, efforts)?))
    };
    try_with(there.clone()).or_else(|| {
        let valve = kind.shape.iter().any(|of| of.2 == Search::Below);
        let several = !valve && there.iter().filter(|there| **there).count() > 1;
        (0..there.len())
            .rev()
            .filter(|&out| several && there[out])
            .find_map(|out| {
                let mut used = there.clone();
                used[out] = false;
                try_with(used)
            })
    })
}

/// Half the number of independent samples times the log ratio of the errors, less half a log of it for each free number.
pub(super) fn evidence(
    problem: &Problem<'_>,
    kind: &Kind,
    used: &[bool],
    before: f64,
    after: f64,
) -> f64 {
    let independent = problem.independent();
    let freedom = kind.freedom_of(used) as f64;
    0.5 * independent * (before / after.max(1e-300)).ln() - 0.5 * freedom * independent.ln()
}

/// Share of the blocks that get better, of those in which the candidate has a say: a catch acts where few strokes begin and end.
fn share_helped(before: &[f64], after: &[f64]) -> f64 {
    let usual = before.iter().sum::<f64>() / before.len().max(1) as f64;
    let changes = || before.iter().zip(after).map(|(b, a)| b - a);
    let counted = changes().filter(|change| change.abs() > HAS_A_SAY * usual);
    let helped = changes().filter(|change| *change > HAS_A_SAY * usual);
    helped.count() as f64 / counted.count().max(1) as f64
}

/// A candidate that changes a block's squared error by less than this share of a usual block's has no say in it.
const HAS_A_SAY: f64 = 0.02;

/// A better fit may be so much worse on held-out blocks.
pub(super) const WORSE: f64 = 1.1;

/// Shares of the greatest speed at which a relief valve is tried.
pub(super) const LEVELS: [f64; 6] = [0.75, 0.55, 0.4, 0.28, 0.2, 0.13];

/// The entry with its shape where the least is left nearby, as long as that helps on held-out blocks too.
fn refine(
    ground: &Ground,
    problem: &Problem<'_>,
    start: &Ranked,
    before: f64,
    blocks: &[f64],
) -> Result<Ranked, MotionError> {
    let kind = start.kind;
    let mut best = start.clone();
    // By the fit to all blocks: what one fast stroke alone shows (that a valve opens) no other block can confirm.
    let mut least = f64::NEG_INFINITY;
    let mut consider = |best: &mut Ranked, shape: Vec<f64>| -> Result<(), MotionError> {
        let columns = ground.columns_of(kind, &shape)?;
        let Some((used, outcomes)) = outcomes(problem, kind, &columns, 1) else {
            return Ok(());
        };
        let own = &outcomes[0];
        let within = evidence(problem, kind, &used, before, own.fit);
        let holds = signs_hold(kind, &used, &own.theta)
            && Keeps::of(ground, kind, &shape).hold(&own.theta, &own.rest);
        if holds && within > least && own.mse < WORSE * start.mse {
            least = within;
            *best = Ranked {
                kind,
                shape,
                score: evidence(problem, kind, &used, before, own.mse),
                mse: own.mse,
                helps: share_helped(blocks, &own.blocks),
                theta: own.theta.clone(),
                used,
            };
        }
        Ok(())
    };
    consider(&mut best, start.shape.clone())?;
    for (k, _) in kind
        .shape
        .iter()
        .enumerate()
        .filter(|(_, s)| s.2 == Search::Below)
    {
        for level in LEVELS {
            let mut shape = start.shape.clone();
            shape[k] = level * ground.scope().fastest();
            consider(&mut best, shape)?;
        }
    }
    for shape in moments(kind, &start.shape) {
        consider(&mut best, shape)?;
    }
    let polished = polished(
        ground,
        problem.columns(),
        problem.effort(),
        vec![best.found(ground)],
        ENOUGH,
    );
    for found in polished {
        consider(&mut best, found.shape)?;
    }
    Ok(best)
}

impl Ranked {
    pub(super) fn found(&self, ground: &Ground) -> Found {
        ground.found(self.kind, self.shape.clone(), self.used.clone())
    }
}
