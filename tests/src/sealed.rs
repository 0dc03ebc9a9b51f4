//! Judgement of an identification that has not seen the truth of its sealed draw, and the tables over many draws.

mod floor;
mod table;

use core::fmt;

use ft_identify::analysis::Verdict;
use ft_identify::pipeline::Identified;
use ft_identify::report::Report;
use ft_sim_hw::sealed::{SealedEffect, SealedTruth};

pub use floor::simulated_floor;
pub use table::tables;

/// Effects that move the effort (rms over the recording) by this many noise floors must be named; smaller ones may be.
pub const LARGE: f64 = 2.0;

/// Where the true effects ended up among those that were named and are not the object's own mechanism.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Named, and the strongest.
    First,
    /// In the ambiguous set of the strongest, or of what of the object's own mechanism is stronger.
    Among,
    /// Named or in an ambiguous set, after another one.
    Later,
    /// Nowhere.
    Missed,
}

/// A name with its ambiguous set.
pub type Named = (&'static str, Vec<&'static str>);

/// One draw.
#[derive(Clone, Debug)]
pub struct Judged {
    /// Seed of the draw.
    pub seed: u64,
    /// The built-in that the object began as.
    pub object: String,
    /// Names of the true effects.
    pub truth: Vec<&'static str>,
    /// Whether the library's vocabulary has them all.
    pub in_vocabulary: bool,
    /// What the smallest of them moves, in noise floors: the effort, and what inertia, friction and a constant leave of it.
    pub moved: [f64; 2],
    /// Names given, with their ambiguous sets.
    pub named: Vec<Named>,
    /// The first of them that is not the object's own mechanism, or of this what looks like the truth before any other does.
    pub first: Option<Named>,
    /// Whether that is the object's own.
    pub first_is_own: bool,
    /// Best place of a true effect.
    pub place: Place,
    /// How many of the true effects are named or in an ambiguous set.
    pub found: usize,
    /// Names that are neither true nor the object's own mechanism, nor have either in their ambiguous sets.
    pub wrong: Vec<&'static str>,
    /// The same without the confirming recording, of draws without any effect.
    pub wrong_alone: Option<Vec<&'static str>>,
    /// The verdict.
    pub verdict: Verdict,
    /// Noise floor by the data, and by the simulator: N m or N.
    pub floors: [f64; 2],
    /// Held-out error of the base and of the named model, N m or N.
    pub errors: [f64; 2],
    /// Seconds that the identification took.
    pub seconds: f64,
}

impl Judged {
    /// Compares an identification with the truth; `floor` = what the true model would leave, if known, and `seconds` what the
    /// identification took.
    #[must_use]
    pub fn of(truth: &SealedTruth, found: &Identified, floor: Option<f64>, seconds: f64) -> Self {
        let report = &found.report;
        let estimated = report.last.noise_floor_rms.unwrap_or(f64::NAN);
        let floor = floor.unwrap_or(estimated);
        let expected: Vec<&'static str> = truth.effects.iter().map(|effect| effect.name).collect();
        let named = names(report);
        let right = |entry: &&Named| expected.iter().any(|name| holds(entry, name));
        // The object's own mechanism is no false effect, and may well be the stronger one; what was added to it may look like it.
        let own = |entry: &&Named| {
            truth.mechanism_effects.contains(&entry.0) && !expected.contains(&entry.0)
        };
        let others: Vec<&Named> = named.iter().filter(|entry| !own(entry)).collect();
        let first = others.first().copied();
        let strongest = named.iter().find(|entry| !own(entry) || right(entry));
        let like_own = strongest.filter(own);
        let (place, first) = match others.iter().position(right) {
            Some(0) if expected.contains(&others[0].0) => (Place::First, first),
            Some(0) => (Place::Among, first),
            _ if like_own.is_some() => (Place::Among, like_own),
            Some(_) => (Place::Later, first),
            None if named.iter().any(|entry| right(&entry)) => (Place::Later, first),
            None => (Place::Missed, first),
        };
        let smallest = |of: &dyn Fn(&SealedEffect) -> f64| {
            truth.effects.iter().map(of).fold(f64::INFINITY, f64::min) / floor
        };
        Self {
            seed: truth.seed,
            object: truth.object.clone(),
            in_vocabulary: truth.effects.iter().all(|effect| effect.in_vocabulary),
            moved: [
                smallest(&|effect| effect.alone.main.moved_rms),
                smallest(&|effect| effect.alone.main.unabsorbed_rms),
            ],
            first_is_own: first.as_ref().is_some_and(own),
            first: first.cloned(),
            place,
            found: expected
                .iter()
                .filter(|name| named.iter().any(|entry| holds(entry, name)))
                .count(),
            wrong: wrong(truth, &named),
            wrong_alone: None,
            verdict: report.last.verdict,
            floors: [estimated, floor],
            errors: [
                report.base.held_out_rms.unwrap_or(f64::NAN),
                report
                    .last
                    .named
                    .as_ref()
                    .map_or(f64::NAN, |model| model.held_out_rms),
            ],
            truth: expected,
            named,
            seconds,
        }
    }

    /// A draw whose identification failed: nothing is named. Without a floor its effects count as large.
    #[must_use]
    pub fn failed(truth: &SealedTruth, seconds: f64) -> Self {
        Self {
            seed: truth.seed,
            object: truth.object.clone(),
            in_vocabulary: truth.effects.iter().all(|effect| effect.in_vocabulary),
            moved: [f64::INFINITY; 2],
            first_is_own: false,
            first: None,
            place: Place::Missed,
            found: 0,
            wrong: Vec::new(),
            wrong_alone: None,
            verdict: Verdict::NotIdentifiable,
            floors: [f64::NAN; 2],
            errors: [f64::NAN; 2],
            truth: truth.effects.iter().map(|effect| effect.name).collect(),
            named: Vec::new(),
            seconds,
        }
    }

    /// Adds what an identification without the confirming recording named.
    #[must_use]
    pub fn with_alone(mut self, truth: &SealedTruth, report: &Report) -> Self {
        self.wrong_alone = Some(wrong(truth, &names(report)));
        self
    }

    /// Error of the named model over the simulator's floor.
    #[must_use]
    pub fn after(&self) -> f64 {
        self.errors[1] / self.floors[1]
    }
}

fn holds((name, alike): &Named, of: &str) -> bool {
    *name == of || alike.contains(&of)
}

fn names(report: &Report) -> Vec<Named> {
    report
        .effects
        .iter()
        .map(|effect| (effect.name, effect.ambiguous_with.clone()))
        .collect()
}

fn wrong(truth: &SealedTruth, named: &[Named]) -> Vec<&'static str> {
    let so = |entry: &&Named| {
        let mut there = truth.effects.iter().map(|effect| effect.name);
        let mut own = truth.mechanism_effects.iter();
        there.any(|name| holds(entry, name)) || own.any(|name| holds(entry, name))
    };
    named
        .iter()
        .filter(|entry| !so(entry))
        .map(|entry| entry.0)
        .collect()
}

impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {} {:?} ({:.1}, {:.1} floors): {:?}, {:?}, {:.1} -> {:.2} floors (estimated {:.2}), {:.1} s, named",
            self.seed,
            self.object,
            self.truth,
            self.moved[0],
            self.moved[1],
            self.place,
            self.verdict,
            self.errors[0] / self.floors[1],
            self.after(),
            self.floors[0] / self.floors[1],
            self.seconds
        )?;
        for (name, alike) in &self.named {
            write!(f, " {name}")?;
            if !alike.is_empty() {
                write!(f, "{alike:?}")?;
            }
        }
        if !self.wrong.is_empty() {
            write!(f, ", wrong {:?}", self.wrong)?;
        }
        if let Some(wrong) = self.wrong_alone.as_ref().filter(|wrong| !wrong.is_empty()) {
            write!(f, ", wrong without confirmation {wrong:?}")?;
        }
        Ok(())
    }
}
