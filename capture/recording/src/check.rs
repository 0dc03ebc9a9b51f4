//! Says what a recording is worth: rates, gaps, coverage, losses, and one line of verdict.
//!
//! Stamps are `header.stamp` where the type has one, else the publish time.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use ft_wire::HostTime;
use serde::Serialize;

use crate::calibration::Calibration;
pub use crate::error::ReadError;
use crate::error::TopicList;
use crate::reader::{Channel, RawMessage, Record, RecordReader, Schema, UnknownChannels};
use crate::recording::TopicMap;
use crate::recover::loss_before_recovery;
use crate::{metadata, topic};

mod clocks;
mod judge;
mod look;
mod stream;
mod text;

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
    /// Who each device is (`model`, `serial_number`, `firmware`) and how it is set (`settings.*`, `scale.*`), as `/diagnostics` last
    /// said.
    pub devices: BTreeMap<String, BTreeMap<String, String>>,
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
        devices: survey.clocks.devices,
        ledger: survey.ledger,
        calibration: survey.calibration,
        session: survey.session,
        is_complete: reader.is_complete(),
        damage,
        verdict: Verdict::Fine,
        reasons: Vec::new(),
    };
    judge::judge(&mut report);
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
