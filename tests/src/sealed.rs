//! Judgement of an identification that has not seen the truth of its sealed draw, and the table over many draws.

use core::fmt;
use std::collections::BTreeMap;
use std::fmt::Write as _;

use ft_identify::analysis::Verdict;
use ft_identify::report::Report;
use ft_sim_hw::sealed::SealedTruth;

/// Effects that move the effort (rms over the recording) by this many noise floors must be named; smaller ones may be.
const LARGE: f64 = 2.0;

/// Where the true effects ended up among those that were named and are not the object's own mechanism.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Named, and the strongest.
    First,
    /// In the ambiguous set of the strongest.
    Among,
    /// Named or in an ambiguous set, after another one.
    Later,
    /// Nowhere.
    Missed,
}

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
    pub named: Vec<(&'static str, Vec<&'static str>)>,
    /// Best place of a true effect.
    pub place: Place,
    /// How many of the true effects are named or in an ambiguous set.
    pub found: usize,
    /// Names that are neither true nor the object's own mechanism nor ambiguous with the truth.
    pub wrong: Vec<&'static str>,
    /// The verdict.
    pub verdict: Verdict,
    /// Held-out error of the base and of the named model, over the noise floor.
    pub errors: [f64; 2],
    /// Seconds that the identification took.
    pub seconds: f64,
}

impl Judged {
    /// Compares a report with the truth; `seconds` is what making it took.
    #[must_use]
    pub fn of(truth: &SealedTruth, report: &Report, seconds: f64) -> Self {
        let floor = report.last.noise_floor_rms.unwrap_or(f64::INFINITY);
        let expected: Vec<&'static str> = truth.effects.iter().map(|effect| effect.name).collect();
        let named: Vec<(&'static str, Vec<&'static str>)> = report
            .effects
            .iter()
            .map(|effect| (effect.name, effect.ambiguous_with.clone()))
            .collect();
        let holds = |(name, alike): &(&'static str, Vec<&'static str>), of: &&'static str| {
            name == of || alike.contains(of)
        };
        let right = |entry: &&(&'static str, Vec<&'static str>)| {
            expected.iter().any(|name| holds(entry, name))
        };
        // The object's own mechanism is no false effect, and may well be the stronger one.
        let others: Vec<_> = named
            .iter()
            .filter(|entry| right(entry) || !truth.mechanism_effects.contains(&entry.0))
            .collect();
        let place = match others.iter().position(right) {
            Some(0) if expected.contains(&others[0].0) => Place::First,
            Some(0) => Place::Among,
            Some(_) => Place::Later,
            None => Place::Missed,
        };
        let smallest = |of: &dyn Fn(&ft_sim_hw::sealed::SealedEffect) -> f64| {
            truth.effects.iter().map(of).fold(f64::INFINITY, f64::min) / floor
        };
        let error = |rms: Option<f64>| rms.unwrap_or(f64::NAN) / floor;
        Self {
            seed: truth.seed,
            object: truth.object.clone(),
            in_vocabulary: truth.effects.iter().all(|effect| effect.in_vocabulary),
            moved: [
                smallest(&|effect| effect.alone.main.moved_rms),
                smallest(&|effect| effect.alone.main.unabsorbed_rms),
            ],
            place,
            found: expected
                .iter()
                .filter(|name| named.iter().any(|entry| holds(entry, name)))
                .count(),
            wrong: others
                .iter()
                .filter(|entry| !right(entry))
                .map(|entry| entry.0)
                .collect(),
            verdict: report.last.verdict,
            errors: [
                error(report.base.held_out_rms),
                error(report.last.named.as_ref().map(|model| model.held_out_rms)),
            ],
            truth: expected,
            named,
            seconds,
        }
    }

    /// The row of the table that the draw belongs to.
    fn group(&self) -> &'static str {
        match (self.truth.as_slice(), self.in_vocabulary) {
            ([], _) => "(none)",
            ([_], false) => "(outside the library)",
            ([_], true) if self.moved[0] < LARGE => "(small)",
            ([name], true) => name,
            _ if self.moved[0] < LARGE => "(two, one small)",
            _ => "(two)",
        }
    }
}

impl fmt::Display for Judged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {} {:?} ({:.1}, {:.1} floors): {:?}, {:?}, {:.1} -> {:.2} floors, {:.1} s, named",
            self.seed,
            self.object,
            self.truth,
            self.moved[0],
            self.moved[1],
            self.place,
            self.verdict,
            self.errors[0],
            self.errors[1],
            self.seconds
        )?;
        for (name, alike) in &self.named {
            write!(f, " {name}")?;
            if !alike.is_empty() {
                write!(f, "{alike:?}")?;
            }
        }
        Ok(())
    }
}

#[derive(Default)]
struct Row {
    draws: usize,
    first: usize,
    among: usize,
    later: usize,
    missed: usize,
    all_found: usize,
    with_wrong: usize,
    explained: usize,
    too_high: usize,
    before: Vec<f64>,
    after: Vec<f64>,
    seconds: Vec<f64>,
}

impl Row {
    fn add(&mut self, judged: &Judged) {
        self.draws += 1;
        match judged.place {
            Place::First => self.first += 1,
            Place::Among => self.among += 1,
            Place::Later => self.later += 1,
            Place::Missed => self.missed += 1,
        }
        self.all_found += usize::from(judged.found == judged.truth.len());
        self.with_wrong += usize::from(!judged.wrong.is_empty());
        let explained = judged.verdict == Verdict::Explained;
        self.explained += usize::from(explained);
        self.too_high += usize::from(explained && judged.errors[1] > 1.15);
        self.before.push(judged.errors[0]);
        self.after.push(judged.errors[1]);
        self.seconds.push(judged.seconds);
    }

    fn write(&self, name: &str, out: &mut String) {
        let _ = writeln!(
            out,
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.1} | {:.2} | {:.1} |",
            self.draws,
            self.first,
            self.among,
            self.later,
            self.missed,
            self.all_found,
            self.with_wrong,
            self.explained,
            self.too_high,
            median(&self.before),
            median(&self.after),
            median(&self.seconds)
        );
    }
}

/// The table, by effect and over all that must be named.
#[must_use]
pub fn table(judged: &[Judged]) -> String {
    let mut out = "| effect | draws | first | among look-alikes | later | missed | all found | with a wrong name | explained \
                   | explained above 1.15 floors | before / floor | after / floor | s |\n\
                   |---|---|---|---|---|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let mut rows: BTreeMap<&'static str, Row> = BTreeMap::new();
    let (mut large, mut visible) = (Row::default(), Row::default());
    for judged in judged {
        rows.entry(judged.group()).or_default().add(judged);
        if judged.truth.len() == 1 && judged.in_vocabulary && judged.moved[0] >= LARGE {
            large.add(judged);
            if judged.moved[1] >= LARGE {
                visible.add(judged);
            }
        }
    }
    for (name, row) in &rows {
        row.write(name, &mut out);
    }
    large.write("one effect, at least 2 floors", &mut out);
    visible.write(
        "one effect, 2 floors beyond inertia, friction and a constant",
        &mut out,
    );
    out
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
