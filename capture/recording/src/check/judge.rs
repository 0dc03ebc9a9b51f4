//! What a recording is good for, and why.

use std::collections::BTreeMap;

use ft_wire::HostTime;

use super::{Presence, Report, SAMPLED, TopicReport, Verdict};
use crate::message::{Message as _, PoseStamped, WrenchStamped};
use crate::topic;

/// The time that the wrench and the poses have in common.
struct Shared<'a> {
    /// Topic of the poses that share most.
    pose: &'a str,
    /// s; below 0 what lies between them.
    s: f64,
    /// What the wrench and these poses last, s.
    last_s: [f64; 2],
}

/// Less of a stream beside the other is told.
const MIN_SHARED: f64 = 0.9;

impl Shared<'_> {
    /// A line for each of the two that lasts no time: nothing moves in one instant.
    fn instants(&self, report: &Report) -> Vec<String> {
        let both = [topic::WRENCH, self.pose].into_iter().zip(self.last_s);
        both.filter(|(_, last_s)| *last_s <= 0.0)
            .map(
                |(name, _)| match report.topics.get(name).map_or(0, |topic| topic.messages) {
                    1 => format!("{name} has one message only"),
                    many => format!("all {many} messages of {name} have the same stamp"),
                },
            )
            .collect()
    }

    /// A line for each of the two that covers too little of the other.
    fn little(&self) -> impl Iterator<Item = String> {
        let [wrench_s, pose_s] = self.last_s;
        [
            (topic::WRENCH, self.pose, pose_s),
            (self.pose, topic::WRENCH, wrench_s),
        ]
        .into_iter()
        .filter(|(.., last_s)| self.s < MIN_SHARED * last_s)
        .map(|(one, other, last_s)| {
            let percent = 100.0 * self.s / last_s;
            format!("{one} covers {percent:.0} % of the time of {other}")
        })
    }
}

/// `None` when one of the two is not there.
fn shared(report: &Report) -> Option<Shared<'_>> {
    let span = |name: &str| {
        let topic = report.topics.get(name)?;
        let at = HostTime::from_nanos;
        Some((at(topic.first_ns?), at(topic.last_ns?)))
    };
    let wrench = span(topic::WRENCH)?;
    let with = |pose| {
        let (first, last) = span(pose)?;
        Some(Shared {
            pose,
            s: last.min(wrench.1).seconds_since(first.max(wrench.0)),
            last_s: [(wrench.0, wrench.1), (first, last)].map(|(from, to)| to.seconds_since(from)),
        })
    };
    let poses = [topic::TCP_POSE, topic::ARIA_POSE];
    poses
        .into_iter()
        .filter_map(with)
        .max_by(|a, b| a.s.total_cmp(&b.s))
}

/// Messages that identification can take.
fn usable(topic: &TopicReport) -> u64 {
    topic
        .messages
        .saturating_sub(topic.undecodable + topic.invalid)
}

/// A smaller share of values that repeat may be chance.
const MIN_REPEATS: f64 = 0.01;

/// A line on wrenches or poses that come again under a new stamp: they were true at the first.
fn repeats(name: &str, about: &TopicReport) -> Option<String> {
    let (count, of) = (about.repeated_values, about.messages);
    let is_measured = [topic::WRENCH, topic::TCP_POSE, topic::ARIA_POSE].contains(&name);
    (is_measured && count as f64 > MIN_REPEATS * of as f64).then(|| {
        format!("{name}: {count} of {of} messages only repeat the one before under a new stamp")
    })
}

/// Fills in the verdict and its reasons.
pub(super) fn judge(report: &mut Report) {
    let has = |name: &str, kind| {
        report
            .topics
            .get(name)
            .is_some_and(|topic| topic.kind == kind && usable(topic) > 0)
    };
    let mut missing = Vec::new();
    if !has(topic::WRENCH, WrenchStamped::TYPE_NAME) {
        missing.push(match report.topics.get(topic::WRENCH) {
            Some(wrench) if wrench.kind == WrenchStamped::TYPE_NAME && wrench.messages > 0 => {
                let count = wrench.messages;
                format!("none of the {count} messages of /ft/wrench can be used")
            }
            _ => "no /ft/wrench".to_owned(),
        });
    }
    if !has(topic::TCP_POSE, PoseStamped::TYPE_NAME)
        && !has(topic::ARIA_POSE, PoseStamped::TYPE_NAME)
    {
        missing.push("neither /tcp/pose nor /aria/pose".to_owned());
    }
    let mut losses = report.damage.clone();
    let mut told = Vec::new();
    if missing.is_empty() {
        match shared(report) {
            Some(shared) if shared.s < 0.0 => missing.push(format!(
                "{} and {} do not overlap: {:.1} s lie between them",
                topic::WRENCH,
                shared.pose,
                -shared.s
            )),
            // What one device recorded before the other is no loss.
            Some(shared) => {
                missing.extend(shared.instants(report));
                told.extend(shared.little());
            }
            None => {}
        }
    }
    let accounted = ledger_losses(&report.ledger);
    // Where stamps are arrivals, a busy host makes pauses without a loss: a ledger that lost nothing knows better.
    let holes_tell = report.ledger.is_empty() || !accounted.is_empty();
    for (name, topic) in &report.topics {
        told.extend(repeats(name, topic));
        let sampled = SAMPLED.contains(&name.as_str());
        let not_finite = match topic.kind.as_str() {
            PoseStamped::TYPE_NAME => {
                "messages with numbers that are not finite or a quaternion that is no rotation"
            }
            _ => "messages with numbers that are not finite",
        };
        let counts = [
            (topic.missing_sequences, "messages missing by their numbers"),
            (topic.undecodable, "undecodable messages"),
            (topic.invalid, not_finite),
            (
                topic.not_unit,
                "messages with a quaternion whose length is not 1",
            ),
            (topic.duplicates, "duplicated messages"),
            (topic.after_arrival, "messages stamped after their arrival"),
            (
                if holes_tell && sampled {
                    topic.holes
                } else {
                    0
                },
                "holes in its stamps",
            ),
        ];
        for (count, what) in counts.into_iter().filter(|(count, _)| *count > 0) {
            losses.push(format!("{name}: {count} {what}"));
        }
    }
    losses.extend(accounted);
    if let Presence::Wrong { reason } = &report.calibration {
        losses.push(format!("ft.calibration: {reason}"));
    }
    report.verdict = match (missing.is_empty(), losses.is_empty()) {
        (true, true) => Verdict::Fine,
        (true, false) => Verdict::Lossy,
        (false, _) => Verdict::Unusable,
    };
    report.reasons = [missing, losses, told].concat();
}

/// Counts of the ledger that stand for lost samples, when its entries are JSON objects of counts.
fn ledger_losses(ledger: &BTreeMap<String, String>) -> Vec<String> {
    let mut losses = Vec::new();
    for (stream, text) in ledger {
        let Ok(counts) = serde_json::from_str::<BTreeMap<String, serde_json::Value>>(text) else {
            continue;
        };
        if counts.get("received").and_then(serde_json::Value::as_u64) == Some(0) {
            losses.push(format!("ledger of {stream}: nothing was received"));
        }
        for name in [
            "gaps",
            "drops",
            "refused",
            "overflows",
            "invalid",
            "interruptions",
        ] {
            if let Some(count) = counts
                .get(name)
                .and_then(serde_json::Value::as_u64)
                .filter(|count| *count > 0)
            {
                losses.push(format!("ledger of {stream}: {count} {name}"));
            }
        }
    }
    losses
}
