//! A report in words.

use std::collections::BTreeMap;
use std::fmt;

use super::{Presence, Report, Verdict};

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("absent"),
            Self::Present => f.write_str("present"),
            Self::Wrong { reason } => write!(f, "wrong ({reason})"),
        }
    }
}

/// A ledger's entry in words: what was received, then what is not 0; as it stands where it is no object of counts.
fn account(text: &str) -> String {
    let Ok(counts) = serde_json::from_str::<BTreeMap<String, u64>>(text) else {
        return text.to_owned();
    };
    let received = counts.get("received").map(|n| format!("{n} received"));
    let others = (counts.iter())
        .filter(|(name, n)| **n > 0 && *name != "received")
        .map(|(name, n)| format!("{n} {name}"));
    let said: Vec<String> = received.into_iter().chain(others).collect();
    if said.is_empty() {
        "all 0".to_owned()
    } else if said.len() < counts.len() {
        said.join(", ") + ", all else 0"
    } else {
        said.join(", ")
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            path,
            bytes,
            profile,
            library,
            duration_s,
            ..
        } = self;
        let path = path.display();
        writeln!(
            f,
            "{path}: {duration_s:.3} s, {bytes} bytes, profile \"{profile}\", by \"{library}\""
        )?;
        let width = self
            .topics
            .keys()
            .map(String::len)
            .max()
            .unwrap_or(0)
            .max(5);
        writeln!(
            f,
            "  {:width$} {:>8} {:>9} {:>9} {:>9} {:>9} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>9} {:>9}",
            "topic",
            "messages",
            "rate Hz",
            "median ms",
            "p99 ms",
            "jitter ms",
            "gaps",
            "holes",
            "dupl.",
            "late",
            "same",
            "cover%",
            "starts s",
            "ends s"
        )?;
        for (name, topic) in &self.topics {
            let number = |value: Option<f64>, scale: f64| {
                value.map_or("-".to_owned(), |v| format!("{:.3}", v * scale))
            };
            writeln!(
                f,
                "  {name:width$} {:>8} {:>9} {:>9} {:>9} {:>9} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>9} {:>9}",
                topic.messages,
                number(topic.rate_hz, 1.0),
                number(topic.interval_median_s, 1e3),
                number(topic.interval_p99_s, 1e3),
                number(topic.jitter_s, 1e3),
                topic.missing_sequences,
                topic.holes,
                topic.duplicates,
                topic.out_of_order,
                topic.repeated_values,
                topic
                    .coverage
                    .map_or("-".to_owned(), |part| format!("{:.1}", 100.0 * part)),
                number(topic.starts_after_s, 1.0),
                number(topic.ends_before_s, 1.0),
            )?;
        }
        writeln!(
            f,
            "  calibration {}, session {}",
            self.calibration, self.session
        )?;
        for (name, topic) in self.topics.iter().filter(|(_, topic)| topic.at_extreme > 0) {
            let count = topic.at_extreme;
            writeln!(
                f,
                "  {name}: {count} samples stay at the end of their range: saturated, or a coarse or still sensor"
            )?;
        }
        for (device, about) in &self.devices {
            let about: Vec<_> = about
                .iter()
                .map(|(key, value)| format!("{key} = {value}"))
                .collect();
            writeln!(f, "  {device}: {}", about.join(", "))?;
        }
        for (device, clock) in &self.clocks {
            write!(
                f,
                "  clock of {device}: skew {:+.1} ppm, stamps known to {:.1} us",
                clock.skew_ppm, clock.spread_us
            )?;
            if clock.largest_spread_us > 0.0 {
                let largest_us = clock.largest_spread_us;
                write!(f, " (at worst {largest_us:.1} us after 10 s)")?;
            }
            writeln!(f)?;
        }
        for (device, text) in &self.warnings {
            writeln!(f, "  warning of {device}: {text}")?;
        }
        for (stream, counts) in &self.ledger {
            writeln!(f, "  ledger of {stream}: {}", account(counts))?;
        }
        match self.verdict {
            Verdict::Fine => {
                f.write_str("fine: complete, and nothing is known to be missing")?;
                match self.reasons.as_slice() {
                    [] => Ok(()),
                    told => write!(f, ", but {}", told.join("; ")),
                }
            }
            Verdict::Lossy => write!(f, "usable, but not whole: {}", self.reasons.join("; ")),
            Verdict::Unusable => write!(
                f,
                "not usable for identification: {}",
                self.reasons.join("; ")
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::account;

    #[test]
    fn a_ledger_is_said_in_words() {
        for (text, said) in [
            (
                r#"{"received":7,"gaps":0,"drops":2}"#,
                "7 received, 2 drops, all else 0",
            ),
            (r#"{"drops":0}"#, "all 0"),
            (r#"{"drops":3}"#, "3 drops"),
            ("17 frames, none lost", "17 frames, none lost"),
        ] {
            assert_eq!(account(text), said);
        }
    }
}
