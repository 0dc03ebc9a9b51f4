//! The study's tables.

use ft_identify::screw::JointKind;

use super::{Attempt, SOURCES, Trial, WHOLE};

/// Published, measured on two real robots: means of `Complete` and `Track` over nine pairs, %.
const PUBLISHED: [[f64; 2]; 3] = [[87.3, 22.2], [59.7, 49.8], [56.9, 51.5]];

/// The table of the study as Markdown, in the order in which objects and robots first appear.
#[must_use]
pub fn markdown(all: &[Attempt]) -> String {
    let mut pairs: Vec<(&str, &str)> = Vec::new();
    for one in all {
        if !pairs.contains(&(one.robot, &one.object)) {
            pairs.push((one.robot, &one.object));
        }
    }
    pairs.sort_by_key(|(robot, _)| all.iter().position(|one| one.robot == *robot));
    let mut out = String::from(
        "Simulated. `Complete` and `Track` in %, mean ± sample sd over recordings; \"needs\" is the twin's, before the attempt.\n\n\
         | robot | object | goal | needs, has N | identified: complete, track | prior | kinematics only |\n|---|---|---|---|---|---|---|\n",
    );
    let mut within: Vec<[[f64; 2]; 3]> = Vec::new();
    for (robot, object) in pairs {
        let of: Vec<&Attempt> = all
            .iter()
            .filter(|one| one.robot == robot && one.object == object)
            .collect();
        let Some(first) = of.first() else { continue };
        let needs = spread(of.iter().map(|one| one.needs_n), 1.0);
        let refused = of.iter().filter(|one| one.exceeds_at.is_some()).count();
        let cell = |source: usize| {
            let trial =
                |f: fn(&Trial) -> f64| spread(of.iter().map(|one| f(&one.trials[source])), 100.0);
            format!("{}, {}", trial(|t| t.complete), trial(|t| t.track))
        };
        let cells = if refused == of.len() {
            let at = mean(of.iter().filter_map(|one| one.exceeds_at));
            let got = spread(of.iter().map(|one| one.trials[0].complete), 100.0);
            format!(
                "not attempted: exceeds the arm from {} on (tried all the same: {got} complete) | | ",
                place(first.kind, at)
            )
        } else {
            within.push([0, 1, 2].map(|source| {
                let of = |f: fn(&Trial) -> f64| {
                    100.0 * mean(of.iter().map(|one| f(&one.trials[source])))
                };
                [of(|t| t.complete), of(|t| t.track)]
            }));
            [0, 1, 2].map(cell).join(" | ")
        };
        out += &format!(
            "| {robot} | {object} | {} | {needs}, {:.0} | {cells} |\n",
            place(first.kind, first.goal),
            first.has_n
        );
    }
    let overall = |source: usize| {
        [0, 1].map(|what| format!("{:.1}", mean(within.iter().map(|pair| pair[source][what]))))
    };
    out += &format!(
        "| mean of {} pairs within the limits | | | | {} |\n",
        within.len(),
        [0, 1, 2]
            .map(|source| overall(source).join(", "))
            .join(" | ")
    );
    out += &format!(
        "| published, measured (9 pairs) | | | | {} |\n",
        PUBLISHED
            .map(|[complete, track]| format!("{complete:.1}, {track:.1}"))
            .join(" | ")
    );
    out + &stalls(all)
}

/// Who stalls where.
fn stalls(all: &[Attempt]) -> String {
    let mut out = String::from("\n");
    for (index, source) in SOURCES.iter().enumerate() {
        let mut places: Vec<String> = Vec::new();
        let mut seen: Vec<(&str, &str)> = Vec::new();
        for one in all {
            if seen.contains(&(one.robot, &one.object)) {
                continue;
            }
            seen.push((one.robot, &one.object));
            let of = all
                .iter()
                .filter(|other| other.robot == one.robot && other.object == one.object);
            let stalled: Vec<f64> = of
                .map(|one| one.trials[index])
                .filter(|trial| trial.complete < WHOLE)
                .map(|trial| trial.furthest)
                .collect();
            if !stalled.is_empty() {
                places.push(format!(
                    "{} on {} at {} ({} times)",
                    one.robot,
                    one.object,
                    place(one.kind, mean(stalled.iter().copied())),
                    stalled.len()
                ));
            }
        }
        let places = if places.is_empty() {
            "nowhere".to_owned()
        } else {
            places.join("; ")
        };
        out += &format!("{source:?} stays below 98 %: {places}.\n");
    }
    out
}

fn place(kind: JointKind, q: f64) -> String {
    match kind {
        JointKind::Revolute => format!("{:.1} deg", q.to_degrees()),
        JointKind::Prismatic => format!("{q:.3} m"),
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0, 0.0), |(count, sum), value| (count + 1, sum + value));
    sum / f64::from(count)
}

fn spread(values: impl Iterator<Item = f64> + Clone, scale: f64) -> String {
    let middle = mean(values.clone());
    let count = values.clone().count();
    let squares: f64 = values.map(|value| (value - middle).powi(2)).sum();
    if count < 2 {
        return format!("{:.1}", scale * middle);
    }
    let sd = (squares / (count - 1) as f64).sqrt();
    format!("{:.1} ± {:.1}", scale * middle, scale * sd)
}
