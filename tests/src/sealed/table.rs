//! Three tables: what is asked of the diagnosis, each effect's fate, and what was said instead.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use ft_identify::analysis::{EXPLAINED_BELOW, Verdict};

use super::{Judged, LARGE, Place};

/// The tables over `judged`, as Markdown.
#[must_use]
pub fn tables(judged: &[Judged]) -> String {
    let mut out = String::new();
    asked(judged, &mut out);
    out.push('\n');
    fates(judged, &mut out);
    out.push('\n');
    confusion(judged, &mut out);
    out
}

/// A share of some draws.
fn line(out: &mut String, what: &str, draws: &[&Judged], holds: impl Fn(&Judged) -> bool) {
    let count = draws.iter().filter(|judged| holds(judged)).count();
    let share = 100.0 * count as f64 / draws.len().max(1) as f64;
    let _ = writeln!(
        out,
        "| {what} | {count} of {} | {share:.1} % |",
        draws.len()
    );
}

fn asked(judged: &[Judged], out: &mut String) {
    let of = |keep: &dyn Fn(&Judged) -> bool| -> Vec<&Judged> {
        judged.iter().filter(|judged| keep(judged)).collect()
    };
    let single = |judged: &Judged| judged.truth.len() == 1 && judged.in_vocabulary;
    let large = of(&|j| single(j) && j.moved[0] >= LARGE);
    let visible = of(&|j| single(j) && j.moved[1] >= LARGE);
    let small = of(&|j| single(j) && j.moved[0] < LARGE);
    let clean = of(&|j| j.truth.is_empty());
    let outside = of(&|j| j.truth.len() == 1 && !j.in_vocabulary);
    let two = of(&|j| j.truth.len() == 2);
    let two_large = of(&|j| j.truth.len() == 2 && j.moved[0] >= LARGE);
    let explained = of(&|j| j.verdict == Verdict::Explained);
    let first = |j: &Judged| j.place == Place::First;
    let first_or_among = |j: &Judged| first(j) || j.place == Place::Among;
    let by_itself = |j: &Judged| first(j) && j.first.as_ref().is_some_and(|e| e.1.is_empty());
    out.push_str("| asked | draws | share |\n|---|---|---|\n");
    for (what, draws) in [
        ("one effect of 2 floors", &large),
        (
            "one effect of 2 floors beyond inertia, friction and a constant",
            &visible,
        ),
    ] {
        line(
            out,
            &format!("{what}: first or look-alike of the first"),
            draws,
            first_or_among,
        );
        line(out, &format!("{what}: first"), draws, first);
        line(
            out,
            &format!("{what}: first, with no look-alike"),
            draws,
            by_itself,
        );
        line(
            out,
            &format!("{what}: first, with {CLASS} as one class"),
            draws,
            |j| first_of_class(j).is_some(),
        );
        line(
            out,
            &format!("{what}: first, with no look-alike, with {CLASS} as one class"),
            draws,
            |j| first_of_class(j).is_some_and(|alike| alike.is_empty()),
        );
        line(out, &format!("{what}: a wrong name too"), draws, |j| {
            !j.wrong.is_empty()
        });
    }
    line(out, "smaller effect: a wrong name", &small, |j| {
        !j.wrong.is_empty()
    });
    line(out, "two effects: both found", &two, |j| j.found == 2);
    line(
        out,
        "two effects of 2 floors: both found",
        &two_large,
        |j| j.found == 2,
    );
    line(out, "clean: false effect with confirmation", &clean, |j| {
        !j.wrong.is_empty()
    });
    line(
        out,
        "clean: false effect without confirmation",
        &clean,
        |j| {
            j.wrong_alone
                .as_ref()
                .is_some_and(|wrong| !wrong.is_empty())
        },
    );
    line(out, "clean: explained", &clean, |j| {
        j.verdict == Verdict::Explained
    });
    line(out, "outside the library: unexplained", &outside, |j| {
        j.verdict == Verdict::Unexplained
    });
    line(
        out,
        "outside the library: unexplained and no wrong name",
        &outside,
        |j| j.verdict == Verdict::Unexplained && j.wrong.is_empty(),
    );
    line(
        out,
        "explained: above 1.15 simulated floors",
        &explained,
        |j| j.after() > EXPLAINED_BELOW,
    );
    let ratios: Vec<f64> = judged.iter().map(|j| j.floors[0] / j.floors[1]).collect();
    let seconds: Vec<f64> = judged.iter().map(|j| j.seconds).collect();
    let [low, middle, high] = [0.1, 0.5, 0.9].map(|share| quantile(&ratios, share));
    let _ = writeln!(
        out,
        "\nFloor by the data over floor by the simulator: 10 % {low:.2}, median {middle:.2}, 90 % {high:.2}. Identification with \
         confirmation: median {:.1} s, longest {:.1} s.",
        quantile(&seconds, 0.5),
        quantile(&seconds, 1.0)
    );
}

/// What no motion tells apart: on moving samples their regressors agree.
const ONE_CLASS: [&str; 2] = ["constant_load", "asymmetric_coulomb"];
const CLASS: &str = "constant_load and asymmetric_coulomb";

/// The look-alikes beside the first name of a draw with one effect, when that name is the true one; members of the class are one name.
fn first_of_class(judged: &Judged) -> Option<Vec<&'static str>> {
    let class = |name: &'static str| {
        if ONE_CLASS.contains(&name) {
            ONE_CLASS[0]
        } else {
            name
        }
    };
    let (first, alike) = judged.first.as_ref()?;
    let others = alike.iter().filter(|name| class(name) != class(first));
    let named = !judged.first_is_own && class(first) == class(judged.truth.first()?);
    named.then(|| others.copied().collect())
}

/// The row that a draw belongs to.
fn group(judged: &Judged) -> String {
    match (judged.truth.as_slice(), judged.in_vocabulary) {
        ([], _) => "(none)".to_owned(),
        ([name], false) => format!("(outside) {name}"),
        ([_], true) if judged.moved[0] < LARGE => "(one, small)".to_owned(),
        ([name], true) => (*name).to_owned(),
        _ if judged.moved[0] < LARGE => "(two, one small)".to_owned(),
        _ => "(two)".to_owned(),
    }
}

fn grouped(judged: &[Judged]) -> BTreeMap<String, Vec<&Judged>> {
    let mut rows: BTreeMap<String, Vec<&Judged>> = BTreeMap::new();
    for judged in judged {
        rows.entry(group(judged)).or_default().push(judged);
    }
    rows
}

fn fates(judged: &[Judged], out: &mut String) {
    out.push_str(
        "| effect | draws | first | look-alike | later | missed | all found | with a wrong name | explained | before / floor \
         | after / floor | s |\n|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, draws) in grouped(judged) {
        let count =
            |holds: &dyn Fn(&Judged) -> bool| draws.iter().filter(|judged| holds(judged)).count();
        let median = |of: &dyn Fn(&Judged) -> f64| {
            quantile(&draws.iter().map(|j| of(j)).collect::<Vec<f64>>(), 0.5)
        };
        let _ = writeln!(
            out,
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {} | {:.1} | {:.2} | {:.1} |",
            draws.len(),
            count(&|j| j.place == Place::First),
            count(&|j| j.place == Place::Among),
            count(&|j| j.place == Place::Later),
            count(&|j| j.place == Place::Missed),
            count(&|j| j.found == j.truth.len()),
            count(&|j| !j.wrong.is_empty()),
            count(&|j| j.verdict == Verdict::Explained),
            median(&|j| j.errors[0] / j.floors[1]),
            median(&Judged::after),
            median(&|j| j.seconds)
        );
    }
}

fn confusion(judged: &[Judged], out: &mut String) {
    out.push_str("| effect | named first, and how often |\n|---|---|\n");
    for (name, draws) in grouped(judged) {
        let mut said: BTreeMap<String, usize> = BTreeMap::new();
        for judged in draws {
            let first = judged.first.as_ref();
            let name = first.map_or("nothing", |(name, _)| name).to_owned();
            *said.entry(name).or_default() += 1;
        }
        let mut said: Vec<_> = said.into_iter().collect();
        said.sort_by_key(|(_, count)| core::cmp::Reverse(*count));
        let list: Vec<String> = said.iter().map(|(said, n)| format!("{said} {n}")).collect();
        let _ = writeln!(out, "| {name} | {} |", list.join(", "));
    }
}

/// Of the values that are there: a draw whose identification failed has none.
fn quantile(values: &[f64], share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    let at = (share * last as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(f64::NAN)
}
