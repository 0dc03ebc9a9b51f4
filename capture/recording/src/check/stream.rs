//! What is counted about one topic.

use std::collections::BTreeMap;

use ft_wire::HostTime;
use serde::Serialize;

use super::header_stamp;
use crate::reader::RawMessage;
use crate::sequences::Sequences;

/// One topic of a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TopicReport {
    /// ROS 2 type; empty when there is none.
    pub kind: String,
    /// Message encoding, `cdr`.
    pub encoding: String,
    /// Messages.
    pub messages: u64,
    /// Messages that are not of the topic's type.
    pub undecodable: u64,
    /// Earliest stamp, ns since the Unix epoch.
    pub first_ns: Option<i64>,
    /// Latest stamp, ns since the Unix epoch.
    pub last_ns: Option<i64>,
    /// Messages per second between the first and the last stamp.
    pub rate_hz: Option<f64>,
    /// Median of the time between neighbouring stamps, s.
    pub interval_median_s: Option<f64>,
    /// 99th percentile of the time between neighbouring stamps, s.
    pub interval_p99_s: Option<f64>,
    /// Sequence numbers that did not come; 0 when the writer does not count.
    pub missing_sequences: u64,
    /// Times between neighbouring stamps of more than three medians.
    pub holes: u64,
    /// The longest time between neighbouring stamps, s.
    pub longest_interval_s: Option<f64>,
    /// Messages that repeat stamp and content of another.
    pub duplicates: u64,
    /// Messages stamped before one that stands earlier in the file.
    pub out_of_order: u64,
    /// Messages stamped after they arrived, which no clock translation should give.
    pub after_arrival: u64,
    /// Seconds by which the topic starts after the recording.
    pub starts_after_s: Option<f64>,
    /// Seconds by which the topic ends before the recording.
    pub ends_before_s: Option<f64>,
}

#[derive(Debug)]
pub(super) struct Stream {
    kind: String,
    encoding: String,
    /// Stamp and CRC-32 of the content.
    messages: Vec<(HostTime, u32)>,
    latest: Option<HostTime>,
    sequences: BTreeMap<u16, Sequences>,
    undecodable: u64,
    out_of_order: u64,
    after_arrival: u64,
}

/// A hole is longer than this many median intervals.
const HOLE_INTERVALS: f64 = 3.0;

impl Stream {
    pub(super) fn new(kind: &str, encoding: &str) -> Self {
        Self {
            kind: kind.to_owned(),
            encoding: encoding.to_owned(),
            messages: Vec::new(),
            latest: None,
            sequences: BTreeMap::new(),
            undecodable: 0,
            out_of_order: 0,
            after_arrival: 0,
        }
    }

    pub(super) fn add_channel(&mut self, id: u16, counts_from_one: bool) {
        self.sequences
            .insert(id, Sequences::starting_at(u32::from(counts_from_one)));
    }

    pub(super) fn add(&mut self, message: RawMessage<'_>) {
        if let Some(sequences) = self.sequences.get_mut(&message.channel_id) {
            sequences.add(message.sequence);
        }
        let time = |nanos| i64::try_from(nanos).map_or(HostTime::FAR_FUTURE, HostTime::from_nanos);
        let decoded = if self.encoding == "cdr" {
            header_stamp(&self.kind, message.data)
        } else {
            None
        };
        let at = match decoded {
            Some(Ok(stamp)) => stamp,
            Some(Err(_)) => {
                self.undecodable += 1;
                time(message.publish_time)
            }
            None => time(message.publish_time),
        };
        self.out_of_order += u64::from(self.latest.is_some_and(|latest| at < latest));
        self.after_arrival += u64::from(at > time(message.log_time));
        self.latest = self.latest.max(Some(at));
        self.messages.push((at, crc32fast::hash(message.data)));
    }

    /// First and last stamp.
    pub(super) fn span(&self) -> Option<(HostTime, HostTime)> {
        let first = self.messages.iter().map(|(at, _)| *at).min()?;
        Some((first, self.latest?))
    }

    pub(super) fn report(mut self, whole: Option<(HostTime, HostTime)>) -> TopicReport {
        let span = self.span();
        self.messages.sort_unstable();
        let neighbours = || self.messages.iter().zip(self.messages.iter().skip(1));
        let duplicates = neighbours().filter(|(a, b)| a == b).count() as u64;
        let mut intervals: Vec<f64> = neighbours().map(|(a, b)| b.0.seconds_since(a.0)).collect();
        intervals.sort_unstable_by(f64::total_cmp);
        let median = percentile(&intervals, 50);
        let hole = median
            .map(|median| HOLE_INTERVALS * median)
            .filter(|hole| *hole > 0.0);
        let holes = hole.map_or(0, |hole| {
            intervals
                .iter()
                .filter(|interval| **interval > hole)
                .count() as u64
        });
        let covered = span
            .map(|(first, last)| last.seconds_since(first))
            .filter(|covered| *covered > 0.0);
        TopicReport {
            kind: self.kind,
            encoding: self.encoding,
            messages: self.messages.len() as u64,
            undecodable: self.undecodable,
            first_ns: span.map(|(first, _)| first.as_nanos()),
            last_ns: span.map(|(_, last)| last.as_nanos()),
            rate_hz: covered.map(|covered| (self.messages.len() - 1) as f64 / covered),
            interval_median_s: median,
            interval_p99_s: percentile(&intervals, 99),
            missing_sequences: self.sequences.values().map(Sequences::missing).sum(),
            holes,
            longest_interval_s: intervals.last().copied(),
            duplicates,
            out_of_order: self.out_of_order,
            after_arrival: self.after_arrival,
            starts_after_s: span
                .zip(whole)
                .map(|(span, whole)| span.0.seconds_since(whole.0)),
            ends_before_s: span
                .zip(whole)
                .map(|(span, whole)| whole.1.seconds_since(span.1)),
        }
    }
}

/// The value below which `percent` of the sorted values lie; `None` when there are none.
fn percentile(sorted: &[f64], percent: usize) -> Option<f64> {
    sorted
        .get((sorted.len() * percent / 100).min(sorted.len().saturating_sub(1)))
        .copied()
}
