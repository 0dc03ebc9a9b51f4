//! Says what a recording is worth: rates, gaps, coverage, losses, and one line of verdict.
//!
//! Stamps are `header.stamp` where the type has one, else the publish time.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};

use ft_wire::HostTime;
use serde::Serialize;

use crate::calibration::Calibration;
pub use crate::error::ReadError;
use crate::error::TopicList;
use crate::message::{Imu, JointState, Message, PoseStamped, Temperature, WrenchStamped};
use crate::reader::{Channel, RawMessage, Record, RecordReader, Schema, UnknownChannels};
use crate::recording::TopicMap;
use crate::recover::loss_before_recovery;
use crate::{metadata, topic};

mod clocks;
mod stream;

pub use clocks::ClockReport;
use clocks::Clocks;
use stream::Stream;
pub use stream::TopicReport;

/// Topics that are sampled at a rate, so that a hole in them is a loss.
const SAMPLED: [&str; 6] = [
    topic::WRENCH,
    topic::TCP_POSE,
    topic::ARIA_POSE,
    topic::GRIPPER,
    topic::TEMPERATURE,
    topic::IMU,
];

/// A recording's state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The file.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// Conventions that it says it keeps; `ros2` for ours.
    pub profile: String,
    /// What wrote it.
    pub library: String,
    /// Earliest stamp of a sampled topic (of any, when there is none), ns since the Unix epoch.
    pub start_ns: Option<i64>,
    /// Seconds from there to the latest such stamp.
    pub duration_s: f64,
    /// By topic.
    pub topics: BTreeMap<String, TopicReport>,
    /// Device clocks by what `/diagnostics` last said of them.
    pub clocks: BTreeMap<String, ClockReport>,
    /// What the operator was warned of, by device, as `/diagnostics` last said.
    pub warnings: BTreeMap<String, String>,
    /// Account of every stream at the end (metadata `ft.ledger`), as written; empty when absent.
    pub ledger: BTreeMap<String, String>,
    /// Whether a calibration of the tool is there and right.
    pub calibration: Presence,
    /// Whether the session's metadata is there.
    pub session: Presence,
    /// Whether the file was finished.
    pub is_complete: bool,
    /// What is wrong with the file, one line each.
    pub damage: Vec<String>,
    /// What the recording is good for.
    pub verdict: Verdict,
    /// Why, one line each; and what is to be known of a recording that is fine.
    pub reasons: Vec<String>,
}

/// Whether a metadata record is there.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Presence {
    /// It is not.
    Absent,
    /// It is.
    Present,
    /// It is, and cannot be used.
    Wrong {
        /// What is wrong.
        reason: String,
    },
}

/// What a recording is good for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Nothing is known to be missing.
    Fine,
    /// It can be used, and something is missing or wrong.
    Lossy,
    /// Identification needs topics that are not there.
    Unusable,
}

impl Report {
    /// Whether something is missing or wrong.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        self.verdict != Verdict::Fine
    }
}

/// Reads a whole recording and judges it.
///
/// # Errors
/// When the file cannot be read or is no MCAP. Damage is not an error but part of the report.
pub fn check(path: &Path) -> Result<Report, ReadError> {
    check_mapped(path, &TopicMap::default())
}

/// As [`check`], for a recording whose topics have other names; the report has the names of the contract.
///
/// # Errors
/// As [`check`], and when `map` names a topic that is not there.
pub fn check_mapped(path: &Path, map: &TopicMap) -> Result<Report, ReadError> {
    let mut reader = RecordReader::open(path)?;
    let mut survey = Survey::new(map);
    while let Some(record) = reader.next_record()? {
        survey.take(record);
    }
    let damage = survey
        .unknown
        .behind(reader.damage())
        .chain(survey.recovered)
        .collect();
    let span = span(&survey.streams);
    // What was made of another's recording has that one's numbers.
    let counts_from_one =
        survey.library.starts_with("ft-capture ") && survey.session == Presence::Present;
    let topics: BTreeMap<_, _> = survey
        .streams
        .into_iter()
        .map(|(topic, stream)| (topic, stream.report(span, counts_from_one)))
        .collect();
    if let Some(topic) = map.sources().find(|from| !survey.seen.contains(*from)) {
        let topics = topics
            .iter()
            .map(|(topic, report)| (topic.clone(), report.kind.clone(), report.messages));
        return Err(ReadError::MapFrom {
            path: path.to_owned(),
            topic: topic.to_owned(),
            topics: TopicList {
                topics: topics.collect(),
                damage: None,
            },
        });
    }
    let mut report = Report {
        path: path.to_owned(),
        bytes: reader.length(),
        profile: survey.profile,
        library: survey.library,
        start_ns: span.map(|(start, _)| start.as_nanos()),
        duration_s: span.map_or(0.0, |(start, end)| end.seconds_since(start)),
        topics,
        clocks: survey.clocks.clocks,
        warnings: survey.clocks.warnings,
        ledger: survey.ledger,
        calibration: survey.calibration,
        session: survey.session,
        is_complete: reader.is_complete(),
        damage,
        verdict: Verdict::Fine,
        reasons: Vec::new(),
    };
    judge(&mut report);
    Ok(report)
}

/// From the earliest to the latest stamp of the sampled topics, or of all when there are none.
fn span(streams: &BTreeMap<String, Stream>) -> Option<(HostTime, HostTime)> {
    let over = |all: bool| {
        let spans = streams
            .iter()
            .filter(|(topic, _)| all || SAMPLED.contains(&topic.as_str()))
            .filter_map(|(_, stream)| stream.span());
        spans.reduce(|(start, end), (first, last)| (start.min(first), end.max(last)))
    };
    over(false).or_else(|| over(true))
}

struct Survey<'a> {
    map: &'a TopicMap,
    /// Topics as the file calls them.
    seen: BTreeSet<String>,
    profile: String,
    library: String,
    schemas: BTreeMap<u16, Schema>,
    topics: BTreeMap<u16, String>,
    streams: BTreeMap<String, Stream>,
    unknown: UnknownChannels,
    clocks: Clocks,
    ledger: BTreeMap<String, String>,
    calibration: Presence,
    session: Presence,
    recovered: Option<String>,
}

impl<'a> Survey<'a> {
    fn new(map: &'a TopicMap) -> Self {
        Self {
            map,
            seen: BTreeSet::new(),
            profile: String::new(),
            library: String::new(),
            schemas: BTreeMap::new(),
            topics: BTreeMap::new(),
            streams: BTreeMap::new(),
            unknown: UnknownChannels::default(),
            clocks: Clocks::default(),
            ledger: BTreeMap::new(),
            calibration: Presence::Absent,
            session: Presence::Absent,
            recovered: None,
        }
    }
}

impl Survey<'_> {
    fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Header { profile, library } => {
                (self.profile, self.library) = (profile, library)
            }
            Record::Schema(schema) => {
                self.schemas.entry(schema.id).or_insert(schema);
            }
            Record::Channel(channel) if !self.topics.contains_key(&channel.id) => {
                self.add_channel(channel)
            }
            Record::Message(message) => self.add_message(message),
            Record::Metadata { name, entries } => match name.as_str() {
                metadata::LEDGER => self.ledger = entries,
                metadata::RECOVERED => {
                    self.recovered = self.recovered.take().or(loss_before_recovery(&entries));
                }
                metadata::SESSION => self.session = Presence::Present,
                metadata::CALIBRATION => {
                    self.calibration = match Calibration::from_metadata(&entries) {
                        Ok(_) => Presence::Present,
                        Err(error) => Presence::Wrong {
                            reason: error.to_string(),
                        },
                    };
                }
                _ => {}
            },
            _ => {}
        }
    }

    fn add_channel(&mut self, channel: Channel) {
        let kind = self
            .schemas
            .get(&channel.schema_id)
            .map_or("", |schema| schema.name.as_str());
        let topic = match self.map.resolve(&channel.topic) {
            Some(topic) => topic.to_owned(),
            // Another topic takes its place.
            None => format!("{} (not taken)", channel.topic),
        };
        let stream = self.streams.entry(topic.clone());
        stream
            .or_insert_with(|| Stream::new(kind, &channel.message_encoding))
            .add_channel(channel.id);
        self.topics.insert(channel.id, topic);
        self.seen.insert(channel.topic);
    }

    fn add_message(&mut self, message: RawMessage<'_>) {
        let topic = self.topics.get(&message.channel_id);
        match topic.and_then(|topic| self.streams.get_mut(topic)) {
            Some(stream) => {
                if topic.is_some_and(|topic| topic == topic::DIAGNOSTICS) {
                    self.clocks.take(&message);
                }
                stream.add(message);
            }
            None => self.unknown.add(message.channel_id),
        }
    }
}

/// `header.stamp` of the stamped types; `None` when the type has none.
fn header_stamp(kind: &str, data: &[u8]) -> Option<Result<HostTime, crate::CdrError>> {
    let stamp = match kind {
        WrenchStamped::TYPE_NAME => WrenchStamped::decode(data).map(|message| message.header.stamp),
        PoseStamped::TYPE_NAME => PoseStamped::decode(data).map(|message| message.header.stamp),
        JointState::TYPE_NAME => JointState::decode(data).map(|message| message.header.stamp),
        Temperature::TYPE_NAME => Temperature::decode(data).map(|message| message.header.stamp),
        Imu::TYPE_NAME => Imu::decode(data).map(|message| message.header.stamp),
        _ => return None,
    };
    Some(stamp.map(HostTime::from))
}

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

fn judge(report: &mut Report) {
    let has = |name: &str, kind| {
        report
            .topics
            .get(name)
            .is_some_and(|topic| topic.kind == kind && topic.messages > topic.undecodable)
    };
    let mut missing = Vec::new();
    if !has(topic::WRENCH, WrenchStamped::TYPE_NAME) {
        missing.push("no /ft/wrench".to_owned());
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
            Some(shared) => told.extend(shared.little()),
            None => {}
        }
    }
    let accounted = ledger_losses(&report.ledger);
    // Where stamps are arrivals, a busy host makes pauses without a loss: a ledger that lost nothing knows better.
    let holes_tell = report.ledger.is_empty() || !accounted.is_empty();
    for (name, topic) in &report.topics {
        let sampled = SAMPLED.contains(&name.as_str());
        let counts = [
            (topic.missing_sequences, "messages missing by their numbers"),
            (topic.undecodable, "undecodable messages"),
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
        for name in ["gaps", "drops", "refused", "invalid", "interruptions"] {
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

impl fmt::Display for Presence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("absent"),
            Self::Present => f.write_str("present"),
            Self::Wrong { reason } => write!(f, "wrong ({reason})"),
        }
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
        for (device, clock) in &self.clocks {
            writeln!(
                f,
                "  clock of {device}: skew {:+.1} ppm, stamps known to {:.1} us (at worst {:.1} us after 10 s)",
                clock.skew_ppm, clock.spread_us, clock.largest_spread_us
            )?;
        }
        for (device, text) in &self.warnings {
            writeln!(f, "  warning of {device}: {text}")?;
        }
        for (stream, counts) in &self.ledger {
            writeln!(f, "  ledger of {stream}: {counts}")?;
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
