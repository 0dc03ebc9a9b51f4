//! What is counted about one topic.

use std::collections::BTreeMap;

use ft_wire::HostTime;
use ft_wire::pace::longest_by_jitter;
use serde::Serialize;

use super::look::{Look, Numbers};
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
    /// Messages with a number that is not finite or a quaternion that is no rotation, which identification leaves out.
    pub invalid: u64,
    /// Messages whose quaternion has another length than 1, by more than 0.001.
    pub not_unit: u64,
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
    /// Times between neighbouring stamps of more than three medians, and longer than the stream's own jitter explains.
    pub holes: u64,
    /// The longest time between neighbouring stamps, s.
    pub longest_interval_s: Option<f64>,
    /// Standard deviation of the times between neighbouring stamps that are no holes, s.
    pub jitter_s: Option<f64>,
    /// Part of the time from the first to the last stamp that is in no hole, 0 to 1.
    pub coverage: Option<f64>,
    /// Messages with a stamp of their own whose content is that of the message before: a tracker that lost sight, a sensor
    /// read faster than it measures.
    pub repeated_values: u64,
    /// Wrenches of which an axis stays at the end of its range in this recording through five samples or more.
    pub at_extreme: u64,
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
    invalid: u64,
    not_unit: u64,
    out_of_order: u64,
    after_arrival: u64,
    repeated: Repeated,
    extremes: [Extreme; 12],
}

/// Messages that repeat the content of the one before.
#[derive(Debug, Default)]
struct Repeated {
    last: Option<(HostTime, u32)>,
    count: u64,
}

impl Repeated {
    /// Takes a message whose content begins with its 8 bytes of stamp.
    fn add(&mut self, at: HostTime, data: &[u8]) {
        let content = crc32fast::hash(data.get(12..).unwrap_or_default());
        self.count += u64::from(
            self.last
                .is_some_and(|(before, same)| same == content && before != at),
        );
        self.last = Some((at, content));
    }
}

/// Samples that stay at the largest value seen.
#[derive(Clone, Copy, Debug)]
struct Extreme {
    value: f64,
    run: u64,
    count: u64,
    /// Whether any smaller value was seen.
    moved: bool,
}

/// So many samples in a row at an end of the range are no coincidence.
const AT_EXTREME: u64 = 5;

impl Extreme {
    const NEW: Self = Self {
        value: f64::NEG_INFINITY,
        run: 0,
        count: 0,
        moved: false,
    };

    fn add(&mut self, value: f64) {
        if value > self.value {
            let moved = self.value.is_finite();
            (self.value, self.run, self.count, self.moved) = (value, 1, 0, moved);
        } else if value == self.value {
            self.run += 1;
            self.count += match self.run {
                AT_EXTREME => AT_EXTREME,
                more => u64::from(more > AT_EXTREME),
            };
        } else {
            (self.run, self.moved) = (0, true);
        }
    }

    const fn found(&self) -> u64 {
        if self.moved { self.count } else { 0 }
    }
}

/// A hole is longer than this many median intervals, however even the stream is.
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
            invalid: 0,
            not_unit: 0,
            out_of_order: 0,
            after_arrival: 0,
            repeated: Repeated::default(),
            extremes: [Extreme::NEW; 12],
        }
    }

    pub(super) fn add_channel(&mut self, id: u16) {
        self.sequences.insert(id, Sequences::default());
    }

    pub(super) fn add(&mut self, message: RawMessage<'_>) {
        if let Some(sequences) = self.sequences.get_mut(&message.channel_id) {
            sequences.add(message.sequence);
        }
        let time = |nanos| i64::try_from(nanos).map_or(HostTime::FAR_FUTURE, HostTime::from_nanos);
        let decoded = if self.encoding == "cdr" {
            Look::at(&self.kind, message.data)
        } else {
            None
        };
        let at = match decoded {
            Some(Ok(look)) => {
                self.repeated.add(look.stamp, message.data);
                self.invalid += u64::from(look.numbers == Numbers::Invalid);
                self.not_unit += u64::from(look.numbers == Numbers::NotUnit);
                if let Some(wrench) = look.wrench {
                    self.look_for_extremes(wrench);
                }
                look.stamp
            }
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

    fn look_for_extremes(&mut self, wrench: [f64; 6]) {
        let both = wrench.iter().flat_map(|value| [*value, -value]);
        for (extreme, value) in self.extremes.iter_mut().zip(both) {
            extreme.add(value);
        }
    }

    /// First and last stamp.
    pub(super) fn span(&self) -> Option<(HostTime, HostTime)> {
        let first = self.messages.iter().map(|(at, _)| *at).min()?;
        Some((first, self.latest?))
    }

    pub(super) fn report(
        mut self,
        whole: Option<(HostTime, HostTime)>,
        counts_from_one: bool,
    ) -> TopicReport {
        let missing = |sequences: &Sequences| sequences.missing(u32::from(counts_from_one));
        let span = self.span();
        self.messages.sort_unstable();
        let neighbours = || self.messages.iter().zip(self.messages.iter().skip(1));
        let duplicates = neighbours().filter(|(a, b)| a == b).count() as u64;
        let mut intervals: Vec<f64> = neighbours().map(|(a, b)| b.0.seconds_since(a.0)).collect();
        intervals.sort_unstable_by(f64::total_cmp);
        let median = percentile(&intervals, 50);
        let hole = median
            .map(|median| (HOLE_INTERVALS * median).max(longest_by_jitter(&intervals, median)))
            .filter(|hole| *hole > 0.0);
        let holes = hole.map_or(0, |hole| {
            intervals
                .iter()
                .filter(|interval| **interval > hole)
                .count() as u64
        });
        let is_whole = |interval: &&f64| hole.is_none_or(|hole| **interval <= hole);
        let whole_intervals: Vec<f64> = intervals.iter().filter(is_whole).copied().collect();
        let in_no_hole: f64 = whole_intervals.iter().sum();
        let covered = span
            .map(|(first, last)| last.seconds_since(first))
            .filter(|covered| *covered > 0.0);
        TopicReport {
            kind: self.kind,
            encoding: self.encoding,
            messages: self.messages.len() as u64,
            undecodable: self.undecodable,
            invalid: self.invalid,
            not_unit: self.not_unit,
            first_ns: span.map(|(first, _)| first.as_nanos()),
            last_ns: span.map(|(_, last)| last.as_nanos()),
            rate_hz: covered.map(|covered| (self.messages.len() - 1) as f64 / covered),
            interval_median_s: median,
            interval_p99_s: percentile(&intervals, 99),
            jitter_s: standard_deviation(&whole_intervals),
            coverage: covered.map(|covered| in_no_hole / covered),
            repeated_values: self.repeated.count,
            at_extreme: self.extremes.iter().map(Extreme::found).sum(),
            missing_sequences: self.sequences.values().map(missing).sum(),
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

fn standard_deviation(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let power = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>()
        / n;
    (!values.is_empty()).then(|| power.sqrt())
}

/// The value below which `percent` of the sorted values lie; `None` when there are none.
fn percentile(sorted: &[f64], percent: usize) -> Option<f64> {
    sorted
        .get((sorted.len() * percent / 100).min(sorted.len().saturating_sub(1)))
        .copied()
}
