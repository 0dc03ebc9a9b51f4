//! The report in words.

use std::fmt::Write as _;

use super::Report;
use super::effects::EffectEntry;
use crate::analysis::Verdict;
use crate::digits::{figure, with_std};
use crate::dynamics::{Bursts, Term, not_white};
use crate::screw::JointKind;

impl Report {
    /// A few lines for a terminal.
    #[must_use]
    pub fn summary(&self) -> String {
        let mut out = String::new();
        let joint = &self.joint;
        let _ = writeln!(out, "joint      {}", self.joint_line());
        if let (Some(direction), Some(point)) = (joint.axis_direction, joint.axis_point) {
            let [dx, dy, dz] = direction;
            let [px, py, pz] = point;
            let _ = writeln!(
                out,
                "axis       direction [{dx:.4} {dy:.4} {dz:.4}] ± {:.2} deg",
                joint.std.direction_deg.unwrap_or(f64::NAN)
            );
            let std = joint
                .std
                .position_m
                .map_or_else(String::new, |std| format!(" ± {:.1} mm", std * 1e3));
            let _ = writeln!(out, "           point [{px:.4} {py:.4} {pz:.4}] m{std}");
        }
        for term in &self.last.terms {
            let value = match (term.value, term.std) {
                (Some(value), Some(std)) => format!("{} {}", with_std(value, std), term.unit),
                _ => format!(
                    "not identified: {}",
                    self.not_identified
                        .get(&term.name)
                        .map_or("", String::as_str)
                ),
            };
            let _ = writeln!(out, "{:<10} {value}", term.name);
        }
        let unit = joint.kind.effort_unit();
        // Named effects that leave nothing but noise have said it all.
        let said = !self.effects.is_empty() && self.last.verdict == Verdict::Explained;
        if let Some(mechanism) = self.mechanism.as_ref().filter(|_| !said) {
            let [low, high] = mechanism.load_range.map(|load| rounded(load, 2));
            let besides = if self.effects.is_empty() {
                ""
            } else {
                mechanism.beside()
            };
            let _ = writeln!(
                out,
                "mechanism  load from {low:.2} to {high:.2} {unit} over the range{besides}"
            );
        }
        if let (Some(base), Some(last), Some(floor)) = (
            self.base.held_out_rms,
            self.last.held_out_rms,
            self.last.noise_floor_rms,
        ) {
            // What effects were named against has their own samples, and stands in their lines.
            let before = if self.effects.is_empty() {
                format!("I, mu, b alone {}; ", figure(base))
            } else {
                String::new()
            };
            let _ = writeln!(
                out,
                "error      {} {unit} on held-out strokes; the fit leaves {:.1} % of the effort; {before}noise floor {}",
                figure(last),
                100.0 * self.last.relative_error.unwrap_or(f64::NAN),
                figure(floor)
            );
        }
        if let Some(joint) = &self.joint_fit {
            let terms = in_a_row(&joint.terms);
            let stands = if terms.is_empty() {
                "no parameters"
            } else if joint.stands {
                ", which stands above"
            } else {
                ", a second opinion"
            };
            let _ = writeln!(
                out,
                "jointly    {terms}{stands}; error {} {unit} on held-out strokes, whose motion the wrench informs",
                figure(joint.held_out_rms)
            );
        }
        if let Some(paper) = &self.paper {
            let terms = paper.terms.iter().map(|term| {
                let value = term.value.unwrap_or(f64::NAN);
                format!("{} {} {}", term.name, figure(value), term.unit)
            });
            let terms: Vec<String> = terms.collect();
            let network = paper.mechanism_rms.map_or_else(String::new, |rms| {
                format!(", {} with its network", figure(rms))
            });
            let _ = writeln!(
                out,
                "paper      {}; error in the fit {} {unit}{network}",
                terms.join(", "),
                figure(paper.rms)
            );
        }
        let _ = write!(out, "{}", self.effect_lines());
        let _ = writeln!(out, "verdict    {}", self.verdict_line());
        if let Some(lag) = self.lag.filter(|lag| lag.applied) {
            let _ = writeln!(
                out,
                "lag        the {} is {:.1} ms {}; taken out",
                if joint.axis_direction.is_some() {
                    "wrench"
                } else {
                    "effort"
                },
                1e3 * lag.value_s.abs(),
                if lag.value_s < 0.0 { "early" } else { "late" }
            );
        }
        for (what, why) in self
            .not_identified
            .iter()
            .filter(|(what, _)| self.term(what).is_none())
        {
            let _ = writeln!(out, "unknown    {what}: {why}");
        }
        for note in &self.notes {
            let _ = writeln!(out, "note       {note}");
        }
        out
    }

    /// One line per added effect: error before and after.
    fn effect_lines(&self) -> String {
        let unit = self.joint.kind.effort_unit();
        let mut out = String::new();
        for effect in &self.effects {
            let [before, after] = effect.held_out_rms.map(figure);
            let [share_before, share_after] = effect.relative.map(|share| 100.0 * share);
            let _ = write!(
                out,
                "lacked     {}{}: {before} -> {after} {unit} ({share_before:.1} -> {share_after:.1} %)",
                effect.name,
                shape_of(effect, self.joint.kind, self.joint.q_range)
            );
            for pair in &effect.confirm_rms {
                let _ = write!(out, ", {}", confirmation(*pair));
            }
            let mut alike = effect.ambiguous_with.clone();
            alike.dedup();
            if !alike.is_empty() {
                let _ = write!(out, "; or {}", alike.join(", "));
            }
            out.push('\n');
        }
        let named = self.last.named.as_ref();
        let named = named.filter(|_| self.beside_mechanism());
        let alone = named.map_or_else(String::new, |named| in_a_row(&named.terms));
        if !alone.is_empty() {
            let _ = writeln!(out, "           with these alone: {alone}");
        }
        let nothing = match self.last.named {
            Some(_) => "nothing that the library has a name for",
            None => "not looked for: a recipe is fitted as it was published",
        };
        if self.effects.is_empty() && self.base.held_out_rms.is_some() {
            let _ = writeln!(out, "lacked     {nothing}");
        }
        let is_named = |name: &str| self.effects.iter().any(|effect| effect.name == name);
        let mut names: Vec<&str> = self.refused.iter().map(|refused| refused.name).collect();
        names.retain(|name| !is_named(name));
        names.sort_unstable();
        names.dedup();
        if !names.is_empty() {
            let _ = writeln!(out, "refused    {}: the report says why", names.join(", "));
        }
        out
    }

    /// Whether the numbers that stand above are those beside a mechanism of no name that says more than the named effects.
    fn beside_mechanism(&self) -> bool {
        let explained = self.last.verdict == Verdict::Explained;
        !self.effects.is_empty() && self.mechanism.is_some() && !explained
    }

    fn joint_line(&self) -> String {
        let [low, high] = self.joint.q_range;
        match self.joint.kind {
            JointKind::Revolute => {
                let radius = self
                    .joint
                    .radius_m
                    .map_or_else(String::new, |r| format!(", held {r:.3} m from the axis"));
                format!(
                    "revolute, probed from {:.1} to {:.1} deg{radius}",
                    rounded(low.to_degrees(), 1),
                    rounded(high.to_degrees(), 1)
                )
            }
            JointKind::Prismatic => {
                // A travel of parts of a millimetre needs more digits.
                let digits = if high - low < 0.01 { 6 } else { 3 };
                let [low, high] = [low, high].map(|q| rounded(q, digits));
                format!("prismatic, probed from {low:.digits$} to {high:.digits$} m")
            }
        }
    }

    /// The verdict in words.
    #[must_use]
    pub fn verdict_line(&self) -> String {
        match self.last.verdict {
            Verdict::Explained if self.effects.is_empty() => {
                "explained: I, mu, b leave the noise floor; nothing is missing that these data show"
                    .to_owned()
            }
            Verdict::Explained => {
                "explained: what the named effects leave is at the noise floor".to_owned()
            }
            Verdict::NotIdentifiable => "not identifiable: the data cannot tell".to_owned(),
            Verdict::Unexplained => {
                let share = 100.0 * self.last.unexplained_fraction.unwrap_or(f64::NAN);
                let beside = match (&self.last.named, &self.mechanism) {
                    // Without any the line of the error has said it.
                    (Some(named), Some(mechanism)) if !self.effects.is_empty() => format!(
                        "; named effects leave {}, with a mechanism of no name {}",
                        figure(named.held_out_rms),
                        figure(mechanism.held_out_rms)
                    ),
                    _ => String::new(),
                };
                // All of the acceleration may be by errors, as far as a table shows.
                let asked = self.last.structure.iter().filter(|s| s.chance < 1.0);
                let variables: Vec<&str> = asked.map(|s| s.variable.in_words()).collect();
                let against = match not_white(&self.last.structure) {
                    Some(s) => format!(
                        "; it depends on {} ({:.0} % of it)",
                        s.variable.in_words(),
                        100.0 * s.share
                    ),
                    None if variables.is_empty() => String::new(),
                    None => format!("; it depends on none of {} by itself", variables.join(", ")),
                };
                format!(
                    "unexplained: {share:.1} % of the effort is neither named nor noise{against}{beside}"
                )
            }
        }
    }
}

/// The terms that are known, with their standard deviations.
fn in_a_row(terms: &[Term]) -> String {
    let known = terms.iter().filter_map(|term| {
        let (value, std) = (term.value?, term.std?);
        Some(format!(
            "{} {} {}",
            term.name,
            with_std(value, std),
            term.unit
        ))
    });
    known.collect::<Vec<String>>().join(", ")
}

/// To so many digits, and zero without a sign.
fn rounded(value: f64, digits: usize) -> f64 {
    let unit = 0.1_f64.powi(digits as i32);
    (value / unit).round() * unit + 0.0
}

/// From one coordinate to another.
fn stretch([from, to]: [f64; 2], kind: JointKind) -> String {
    match kind {
        JointKind::Revolute => {
            let [from, to] = [from, to].map(|q| rounded(q.to_degrees(), 1));
            format!("{from:.1} to {to:.1} deg")
        }
        JointKind::Prismatic => {
            let [from, to] = [from, to].map(|q| rounded(q, 3));
            format!("{from:.3} to {to:.3} m")
        }
    }
}

/// Where a residual that comes in bursts has them.
pub(super) fn bursts(bursts: &Bursts, kind: JointKind) -> String {
    let at = if bursts.at_a_place {
        format!(
            "most of them from {} as q {} ({:.0} % of the sum of r^4, {:.1} % of the samples): something acts there at times, as a seal or a latch does",
            stretch(bursts.q, kind),
            if bursts.forward { "grows" } else { "falls" },
            100.0 * bursts.share,
            100.0 * bursts.samples
        )
    } else {
        "not stroke after stroke at one place: something acts at times, or the sensors' noise is not normal"
            .to_owned()
    };
    let kurtosis = bursts.kurtosis;
    format!("what is left comes in bursts (kurtosis {kurtosis:.1}, where normal noise has 3), {at}")
}

/// In brackets what tells an effect from others of its name: its size, where it is in the `range` of the joint coordinate, how
/// often it comes back, and which way.
fn shape_of(effect: &EffectEntry, kind: JointKind, range: [f64; 2]) -> String {
    let value = |name: &str| {
        let term = effect.terms.iter().find(|term| term.name == name);
        term.and_then(|term| term.value)
    };
    let mut said = sizes_of(effect);
    if let (Some(from), Some(to)) = (value("from"), value("to")) {
        let [from, to] = [from.min(to), from.max(to)].map(|q| q.clamp(range[0], range[1]));
        said.push(stretch([from, to], kind));
    }
    // Of a notch or friction at a place, a magnet, a wave, a drift, and a change.
    for (name, word) in [
        ("centre", "at"),
        ("reach", "reaching"),
        ("pitch", "every"),
        ("time", "in"),
        ("at", "from"),
    ] {
        let term = effect.terms.iter().find(|term| term.name == name);
        let Some((term, length)) = term.and_then(|term| Some((term, term.value?))) else {
            continue;
        };
        let std = term.std;
        let (per_unit, unit, digits) = match kind {
            _ if term.unit == "s" => (1.0, "s", 1),
            JointKind::Revolute => (1_f64.to_degrees(), "deg", 2),
            JointKind::Prismatic => (1e3, "mm", 1),
        };
        let length = per_unit * length;
        let said_as = match std.filter(|std| *std > 0.0) {
            Some(std) => with_std(length, per_unit * std),
            None => format!("{length:.digits$}"),
        };
        said.push(format!("{word} {said_as} {unit}"));
    }
    match value("direction") {
        Some(way) if way > 0.0 => said.push("as q grows".to_owned()),
        Some(way) if way < 0.0 => said.push("as q falls".to_owned()),
        _ => {}
    }
    if said.is_empty() {
        String::new()
    } else {
        format!(" ({})", said.join(", "))
    }
}

/// The sizes of an effect: what is fitted; of what has no such size that was searched for, of a slip its length.
fn sizes_of(effect: &EffectEntry) -> Vec<String> {
    let terms = &effect.terms;
    let name = |i: usize| terms[i].name.as_str();
    let with_unit = |i: &usize| terms[*i].unit != "1" && terms[*i].value.is_some();
    let fitted: Vec<usize> = (0..effect.fitted).filter(with_unit).take(2).collect();
    let value = |i: usize| terms[i].value.unwrap_or(f64::NAN);
    let size = |value: f64, std: Option<f64>, unit: &str| match std {
        Some(std) if std > 0.0 => format!("{} {unit}", with_std(value, std)),
        _ => format!("{} {unit}", figure(value)),
    };
    match *fitted.as_slice() {
        // Two halves of one wave or of one direction.
        [a, b]
            if ["sine", "first"].contains(&name(a)) && ["cosine", "second"].contains(&name(b)) =>
        {
            let length = value(a).hypot(value(b));
            let std = effect.std_of(&[(a, value(a) / length), (b, value(b) / length)]);
            vec![size(length, std, &terms[a].unit)]
        }
        [] => {
            // Of a play and a grasp that gives the share that the fit asks for.
            let share = (0..effect.fitted).find(|i| name(*i) == "share");
            let searched = (effect.fitted..terms.len()).find(with_unit);
            let said = searched.map(|i| {
                let (own, std, share) = match share {
                    Some(of) => {
                        let slopes = [(i, value(of)), (of, value(i))];
                        (value(i), effect.std_of(&slopes), value(of))
                    }
                    None => (value(i), terms[i].std, 1.0),
                };
                format!("{} {}", name(i), size(share * own, std, &terms[i].unit))
            });
            said.into_iter().collect()
        }
        _ => fitted
            .iter()
            .map(|&i| {
                let alike = fitted.iter().filter(|&&j| terms[j].unit == terms[i].unit);
                let largest = alike.map(|&j| value(j).abs()).fold(0.0, f64::max);
                let at_random = value(i).abs() < largest
                    && terms[i].std.is_some_and(|std| std > AT_RANDOM * largest);
                let text = if at_random {
                    "unknown".to_owned()
                } else {
                    size(value(i), terms[i].std, &terms[i].unit)
                };
                format!("{} {text}", name(i))
            })
            .collect(),
    }
}

/// A size that is uncertain by so many times the effect's largest of its unit is none: that of a damper at speeds at which it never was.
const AT_RANDOM: f64 = 100.0;

/// The sizes of an effect where none of them is told from nothing: all less than twice as large as uncertain.
pub(super) fn undecided(effect: &EffectEntry) -> Option<String> {
    let mut sizes = (effect.terms.iter().enumerate())
        .take(effect.fitted)
        .filter(|(_, term)| term.value.is_some())
        .peekable();
    sizes.peek()?;
    let is_open = |(i, term): (usize, &Term)| {
        let std = effect.std_of(&[(i, 1.0)]).or(term.std);
        let value = term.value.map_or(0.0, f64::abs);
        std.is_some_and(|std| value < TOLD_FROM_NOTHING * std)
    };
    sizes.all(is_open).then(|| sizes_of(effect).join(", "))
}

/// So many standard deviations tell a size from nothing.
const TOLD_FROM_NOTHING: f64 = 2.0;

/// An error on a confirming recording that falls by less says nothing for an effect.
const LEAST_FALL: f64 = 0.01;

/// What a confirming recording says of an effect by its error there before and after. Where that hardly falls, the effect was kept because
/// it helps beside those that were added after it, or because it can hardly be seen there.
fn confirmation([before, after]: [f64; 2]) -> String {
    if after <= (1.0 - LEAST_FALL) * before {
        format!("confirmed {} -> {}", figure(before), figure(after))
    } else {
        format!(
            "elsewhere {} -> {}, which does not confirm it by itself",
            figure(before),
            figure(after)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dynamics::Term;
    use nalgebra::{DMatrix, DVector};

    /// An effect of these terms, of which the first `fitted` are terms of the fit; they are uncertain each by itself.
    fn effect(of: &[(&str, f64, Option<f64>, &str)], fitted: usize) -> EffectEntry {
        let each = of.iter().map(|(name, value, std, unit)| Term {
            name: (*name).to_owned(),
            value: Some(*value),
            std: *std,
            unit: (*unit).to_owned(),
        });
        let variances = of.iter().map(|(_, _, std, _)| std.unwrap_or(0.0).powi(2));
        EffectEntry {
            terms: each.collect(),
            fitted,
            spread: DMatrix::from_diagonal(&DVector::from_iterator(of.len(), variances)),
            ..EffectEntry::default()
        }
    }

    #[test]
    fn a_size_is_as_uncertain_as_its_parts_together() {
        let play = [
            ("share", 0.5, Some(0.1), "1"),
            ("gap", 0.02, Some(0.004), "m"),
        ];
        let mut play = effect(&play, 1);
        let line = |play: &EffectEntry| shape_of(play, JointKind::Prismatic, [0.0, 0.4]);
        assert_eq!(line(&play), " (gap 0.0100 ± 0.0028 m)");
        // The larger the one the smaller the other: their product is known.
        play.spread[(0, 1)] = -0.1 * 0.004 * 0.99;
        play.spread[(1, 0)] = play.spread[(0, 1)];
        assert_eq!(line(&play), " (gap 0.01000 ± 0.00028 m)");
    }

    #[test]
    fn a_size_is_told_from_nothing_or_not() {
        let zone = |damping: f64, beyond: f64| {
            effect(
                &[
                    ("damping", damping, Some(2.0), "N s/m"),
                    ("beyond", beyond, Some(3.0), "N s/m"),
                    ("from", 0.1, Some(0.01), "m"),
                ],
                2,
            )
        };
        let open = undecided(&zone(3.9, -5.9));
        assert_eq!(
            open.as_deref(),
            Some("damping 3.9 ± 2.0 N s/m, beyond -5.9 ± 3.0 N s/m")
        );
        assert_eq!(undecided(&zone(3.9, -6.1)), None);
        assert_eq!(undecided(&zone(-4.1, 0.0)), None);
        let mut never_there = zone(3.9, 0.02);
        assert_eq!(sizes_of(&never_there)[1], "beyond 0.0 ± 3.0 N s/m");
        never_there.terms[1].std = Some(1.2e4);
        assert_eq!(
            sizes_of(&never_there),
            ["damping 3.9 ± 2.0 N s/m", "beyond unknown"]
        );
        // A slip has no size that was fitted.
        assert_eq!(undecided(&effect(&[("length", 0.002, None, "m")], 0)), None);
    }

    #[test]
    fn an_effect_is_told_by_its_size_and_place() {
        let line =
            |of: &[_], fitted| shape_of(&effect(of, fitted), JointKind::Prismatic, [0.0, 0.4]);
        let ripple = [
            ("sine", 3.0, Some(0.1), "N"),
            ("cosine", -4.0, Some(0.2), "N"),
            ("pitch", 0.0215, Some(0.001), "m"),
        ];
        // sqrt(0.3^2 + 0.8^2) / 5
        assert_eq!(line(&ripple, 2), " (5.00 ± 0.17 N, every 21.5 ± 1.0 mm)");
        let detent = [
            ("hold", 2.0, Some(0.1), "N"),
            ("centre", 0.2, Some(0.001), "m"),
            ("round", 1.0, None, "1"),
        ];
        assert_eq!(line(&detent, 1), " (hold 2.00 ± 0.10 N, at 200.0 ± 1.0 mm)");
        let zone = [
            ("damping", 7.0, Some(0.3), "N s/m"),
            ("from", 0.35, None, "m"),
            ("to", 0.7, None, "m"),
            ("direction", -1.0, None, "1"),
        ];
        let said = " (damping 7.00 ± 0.30 N s/m, 0.350 to 0.400 m, as q falls)";
        assert_eq!(line(&zone, 1), said);
        let slip = [("length", 0.002, None, "m")];
        assert_eq!(line(&slip, 0), " (length 0.00200 m)");
        let play = [
            ("share", 0.9, Some(0.0), "1"),
            ("gap", 0.002, Some(0.0001), "m"),
        ];
        assert_eq!(line(&play, 1), " (gap 0.001800 ± 0.000090 m)");
        let drift = [
            ("extra", 2.0, Some(0.1), "N"),
            ("time", 20.0, Some(0.5), "s"),
        ];
        let said = " (extra 2.00 ± 0.10 N, in 20.00 ± 0.50 s)";
        assert_eq!(line(&drift, 1), said);
        let switch = [("inertia", 2.0, Some(0.1), "kg"), ("at", 23.3, None, "s")];
        assert_eq!(line(&switch, 1), " (inertia 2.00 ± 0.10 kg, from 23.3 s)");
        assert_eq!(line(&[], 0), "");
        let catch = [
            ("pull", 1.0, Some(0.1), "N m"),
            ("reach", 0.1, Some(0.02), "rad"),
        ];
        let said = shape_of(&effect(&catch, 1), JointKind::Revolute, [0.0, 1.5]);
        assert_eq!(said, " (pull 1.00 ± 0.10 N m, reaching 5.7 ± 1.1 deg)");
    }

    #[test]
    fn an_error_that_does_not_fall_confirms_nothing() {
        assert_eq!(confirmation([18.1, 9.0]), "confirmed 18.100 -> 9.000");
        for after in [18.4, 18.1, 18.05] {
            let said = confirmation([18.1, after]);
            assert!(!said.contains("confirmed"), "{said}");
            assert!(said.contains("does not confirm it by itself"), "{said}");
        }
    }
}
