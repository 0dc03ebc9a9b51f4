//! What a session says at its end, for people and as JSON.

use std::fmt;
use std::path::PathBuf;

use serde::Serialize;

use crate::health::StreamSummary;

/// The end of a session.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// How long it ran.
    pub duration_s: f64,
    /// The devices.
    pub streams: Vec<StreamSummary>,
    /// Marks and diagnostics that the writer missed.
    pub own_drops: u64,
    /// Marks and diagnostics that viewers missed.
    pub own_view_drops: u64,
    /// What is wrong with the recording that was replayed, one line each.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub source_damage: Vec<String>,
    /// The recordings, in the order in which they were finished.
    pub files: Vec<FileSummary>,
}

/// A finished recording.
#[derive(Clone, Debug, Serialize)]
pub struct FileSummary {
    /// Where it is.
    pub path: PathBuf,
    /// From its start to its end.
    pub duration_s: f64,
    /// Its size.
    pub bytes: u64,
    /// Messages by topic.
    pub messages: std::collections::BTreeMap<String, u64>,
}

impl Summary {
    /// Whether anything that was measured is missing, or a device never delivered.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        self.own_drops > 0
            || !self.source_damage.is_empty()
            || self
                .streams
                .iter()
                .any(|stream| stream.ledger.lost_data() || stream.ledger.received == 0)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:<10} {:<14} {:>9} {:>8} {:>5} {:>5} {:>7} {:>10} {:>9} {:>10}",
            "stream",
            "driver",
            "samples",
            "rate/Hz",
            "gaps",
            "drops",
            "refused",
            "overrange",
            "skew/ppm",
            "spread/us"
        )?;
        for stream in &self.streams {
            let (skew, spread) = stream.clock.map_or_else(
                || ("-".to_owned(), "-".to_owned()),
                |clock| {
                    (
                        format!("{:.1}", clock.skew_ppm),
                        format!("{:.0}", clock.spread_us),
                    )
                },
            );
            let ledger = &stream.ledger;
            writeln!(
                f,
                "{:<10} {:<14} {:>9} {:>8.1} {:>5} {:>5} {:>7} {:>10} {:>9} {:>10}",
                stream.name,
                stream.driver,
                ledger.received,
                stream.rate_hz,
                ledger.gaps,
                ledger.drops,
                ledger.refused,
                ledger.overrange,
                skew,
                spread
            )?;
            let more = [
                ("invalid", ledger.invalid),
                ("interruptions", ledger.interruptions),
                ("duplicated", ledger.duplicated),
                ("missed by viewers", ledger.view_drops),
                ("without room in the system", ledger.overflows),
            ];
            if more.iter().any(|(_, count)| *count > 0) {
                let more = more.map(|(name, count)| format!("{name} {count}"));
                writeln!(f, "{:<10} {}", "", more.join(", "))?;
            }
            for warning in &stream.warnings {
                writeln!(f, "{:<10} warning: {warning}", "")?;
            }
            if ledger.received == 0 {
                writeln!(f, "{:<10} never delivered a sample ({})", "", stream.state)?;
            }
        }
        for line in &self.source_damage {
            writeln!(f, "the replayed recording is damaged: {line}")?;
        }
        for file in &self.files {
            writeln!(
                f,
                "recorded {} ({:.1} MB, {:.1} s)",
                file.path.display(),
                file.bytes as f64 * 1e-6,
                file.duration_s
            )?;
        }
        let verdict = if self.lost_data() {
            "DATA WAS LOST: see the counts above"
        } else {
            "nothing was lost"
        };
        write!(f, "{verdict}")
    }
}
