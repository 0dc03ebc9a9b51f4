//! A recording made on another machine that loses nothing: what the network lost is asked for again, and what cannot be
//! had any more is counted.
//!
//! The publisher keeps its latest samples (`[network] cache_samples`) and numbers them; a hole in the numbers, or the
//! publisher's heartbeat, makes the subscriber ask for what is missing (zenoh-ext, advanced publisher and subscriber). So
//! the file also begins with what the publisher still has from before. A second, plain subscriber counts what came by
//! itself: the difference was recovered.
//!
//! `log_time` is the source's `sample_time`, not this machine's: time is translated once, at the source.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{
    DiagnosticArray, JointState, Message, PoseStamped, TFMessage, Temperature, Text, WrenchStamped,
};
use ft_recording::writer::{ChannelId, Finished, MessageStamps, RecordingWriter, WriterOptions};
use ft_recording::{Qos, WriteError, metadata, topic};
use ft_wire::HostTime;
use serde::Serialize;
use serde_json::Value;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;
use zenoh_ext::{
    AdvancedSubscriber, AdvancedSubscriberBuilderExt as _, HistoryConfig, RecoveryConfig,
};

use super::holes::Holes;
use super::{Remote, Which, ask};
use crate::rmw::{self, Attachment};
use crate::session::control::Command;
use crate::sink::SinkError;

/// Samples that the file may be behind.
const CAPACITY: usize = 65_536;
/// How long the network waits for the file before a sample is given up; Zenoh holds what comes meanwhile back.
const PATIENCE: Duration = Duration::from_secs(2);
/// How long the writer sleeps when nothing comes.
const QUIET: Duration = Duration::from_millis(20);
/// How often the file is forced to the disk.
const SYNC_PERIOD: Duration = Duration::from_secs(1);
/// How long what is still being asked for is waited for at the end.
const LAST_WORDS: Duration = Duration::from_millis(1500);
/// How often what is still missing is asked for.
const ASK_PERIOD: Duration = Duration::from_secs(1);
/// How long Zenoh's own recovery may hold back what came after a hole; what it did not get by then is asked for again.
const ANSWER_WITHIN: Duration = Duration::from_secs(3);
/// How often it is asked for at the end, and how long each answer is waited for.
const LAST_ASKS: (u32, Duration) = (4, Duration::from_millis(700));
/// Publishers of which account is kept.
const MOST_SOURCES: usize = 1024;

/// The account of one topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RemoteLedger {
    /// Messages in the file.
    pub received: u64,
    /// Of these, those that did not come by themselves: asked for again, or from before the recording.
    pub recovered: u64,
    /// Messages that the publisher numbered after the first in the file, and that are not in the file.
    pub gaps: u64,
    /// Messages that the publishers numbered before their first in the file: published before the recording, or lost then.
    pub earlier: u64,
    /// Messages that came twice; one was kept.
    pub duplicated: u64,
    /// Messages that came and that the file did not take in time.
    pub drops: u64,
    /// Messages of a type that this recorder does not know, or without rmw_zenoh's attachment.
    pub refused: u64,
}

impl RemoteLedger {
    /// Whether anything that was published since the first message is missing.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.gaps + self.drops + self.refused > 0
    }
}

/// The end of a remote recording.
#[derive(Clone, Debug, Serialize)]
pub struct RemoteSummary {
    /// Where it is.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// By topic.
    pub topics: BTreeMap<String, RemoteLedger>,
}

impl RemoteSummary {
    /// Whether anything is missing.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        self.topics.values().any(RemoteLedger::lost_data)
    }
}

impl std::fmt::Display for RemoteSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "{:<27} {:>9} {:>9} {:>7} {:>8} {:>7} {:>7} {:>7}",
            "topic", "received", "recovered", "missing", "earlier", "doubled", "drops", "refused"
        )?;
        for (topic, ledger) in &self.topics {
            writeln!(
                f,
                "{topic:<27} {:>9} {:>9} {:>7} {:>8} {:>7} {:>7} {:>7}",
                ledger.received,
                ledger.recovered,
                ledger.gaps,
                ledger.earlier,
                ledger.duplicated,
                ledger.drops,
                ledger.refused
            )?;
        }
        writeln!(
            f,
            "recorded {} ({:.1} MB)",
            self.path.display(),
            self.bytes as f64 * 1e-6
        )?;
        write!(
            f,
            "{}",
            if self.lost_data() {
                "DATA WAS LOST: see the counts above"
            } else {
                "nothing was lost"
            }
        )
    }
}

/// A recording of what a remote capture publishes.
#[derive(Debug)]
pub struct Recorder {
    subscriber: AdvancedSubscriber<()>,
    direct: Subscriber<()>,
    counts: Arc<Mutex<Direct>>,
    bytes: Arc<AtomicU64>,
    ending: Arc<AtomicBool>,
    clock: MonotonicClock,
    thread: JoinHandle<Result<Written, WriteError>>,
}

/// What came by itself, by topic; and what the file did not take.
#[derive(Debug, Default)]
struct Direct {
    came: HashMap<String, u64>,
    drops: HashMap<String, u64>,
}

#[derive(Debug)]
struct Written {
    finished: Finished,
    topics: BTreeMap<String, RemoteLedger>,
}

impl Recorder {
    /// Begins a recording of `which` in `path`, which is `path` with `.partial` behind until it is finished.
    ///
    /// # Errors
    /// The file cannot be created, or Zenoh refuses a subscription.
    pub fn begin(
        remote: &Arc<Remote>,
        which: &Which,
        path: &Path,
        overwrite: bool,
        clock: MonotonicClock,
    ) -> Result<Self, SinkError> {
        let options = WriterOptions {
            overwrite,
            flush_period: Duration::from_millis(100),
            ..WriterOptions::default()
        };
        let writer = RecordingWriter::create(path, &options)?;
        let (sender, samples) = bounded(CAPACITY);
        let counts = Arc::new(Mutex::new(Direct::default()));
        let bytes = Arc::new(AtomicU64::new(0));
        let ending = Arc::new(AtomicBool::new(false));
        let file = File {
            writer,
            remote: Arc::clone(remote),
            clock,
            channels: HashMap::new(),
            topics: BTreeMap::new(),
            sources: HashMap::new(),
            holes: Holes::default(),
            answers: sender.clone(),
            has_metadata: false,
            metadata_due: clock.now(),
            bytes: Arc::clone(&bytes),
        };
        let over = Arc::clone(&ending);
        let counted = Arc::clone(&counts);
        let thread = std::thread::Builder::new()
            .name("ft-writer".to_owned())
            .spawn(move || file.write_until_over(&samples, &over, &counted))
            .map_err(|source| SinkError::Zenoh {
                what: "starting the writer",
                why: source.to_string(),
            })?;
        let (subscriber, direct) = subscribe(remote.session(), which, &sender, &counts)?;
        Ok(Self {
            subscriber,
            direct,
            counts,
            bytes,
            ending,
            clock,
            thread,
        })
    }

    /// Bytes in the file so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Whether the file could not be written on: [`Recorder::finish`] says why.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.thread.is_finished()
    }

    /// Waits for what is still being asked for, and finishes the file.
    ///
    /// # Errors
    /// The disk refuses; what was flushed stays in the partial file.
    pub fn finish(self) -> Result<RemoteSummary, SinkError> {
        // No more comes by itself; what was lost last is still asked for.
        drop(self.direct);
        self.clock.wait_until(self.clock.now() + LAST_WORDS);
        drop(self.subscriber);
        self.ending.store(true, Ordering::Release);
        let written = self.thread.join().map_err(|_| SinkError::Zenoh {
            what: "writing",
            why:
                "the writer panicked: please report this; what was flushed is in the .partial file"
                    .to_owned(),
        })??;
        drop(self.counts);
        Ok(RemoteSummary {
            path: written.finished.path,
            bytes: written.finished.bytes,
            topics: written.topics,
        })
    }
}

fn subscribe(
    session: &zenoh::Session,
    which: &Which,
    sender: &Sender<Sample>,
    counts: &Arc<Mutex<Direct>>,
) -> Result<(AdvancedSubscriber<()>, Subscriber<()>), SinkError> {
    let refused = |error: zenoh::Error| SinkError::Zenoh {
        what: "subscribing",
        why: error.to_string(),
    };
    let (counted, reader) = (Arc::clone(counts), which.clone());
    let direct = session
        .declare_subscriber(which.key_expr())
        .callback(move |sample| count(&counted, &reader, &sample, |direct| &mut direct.came))
        .wait()
        .map_err(refused)?;
    let (sender, counted, reader) = (sender.clone(), Arc::clone(counts), which.clone());
    let subscriber = session
        .declare_subscriber(which.key_expr())
        .callback(move |sample| {
            if let Err(error) = sender.send_timeout(sample, PATIENCE) {
                let sample = error.into_inner();
                count(&counted, &reader, &sample, |direct| &mut direct.drops);
            }
        })
        .history(HistoryConfig::default().detect_late_publishers())
        .recovery(RecoveryConfig::default().heartbeat())
        .query_timeout(ANSWER_WITHIN)
        .wait()
        .map_err(refused)?;
    Ok((subscriber, direct))
}

fn count(
    counts: &Mutex<Direct>,
    which: &Which,
    sample: &Sample,
    of: impl FnOnce(&mut Direct) -> &mut HashMap<String, u64>,
) {
    let Some((topic, _)) = which.split_key(sample.key_expr().as_str()) else {
        return;
    };
    let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
    let counts = of(&mut counts);
    if counts.len() < MOST_SOURCES || counts.contains_key(&topic) {
        *counts.entry(topic).or_default() += 1;
    }
}

/// The file and the account of what is in it.
struct File {
    writer: RecordingWriter,
    remote: Arc<Remote>,
    clock: MonotonicClock,
    /// By topic; `None` for a type that is not known.
    channels: HashMap<String, Option<ChannelId>>,
    topics: BTreeMap<String, RemoteLedger>,
    /// The last number of each publisher.
    sources: HashMap<[u8; 16], i64>,
    holes: Holes,
    /// Where the answers to what is asked for again go.
    answers: Sender<Sample>,
    has_metadata: bool,
    metadata_due: HostTime,
    bytes: Arc<AtomicU64>,
}

impl File {
    fn write_until_over(
        mut self,
        samples: &Receiver<Sample>,
        ending: &AtomicBool,
        counts: &Mutex<Direct>,
    ) -> Result<Written, WriteError> {
        let handle = self.writer.sync_handle()?;
        let mut sync_due = self.clock.now();
        let mut ask_due = sync_due + ASK_PERIOD;
        let mut last_asks = 0;
        loop {
            let over = ending.load(Ordering::Acquire);
            let quiet = if last_asks > 0 { LAST_ASKS.1 } else { QUIET };
            match samples.recv_timeout(quiet) {
                Ok(sample) => {
                    self.take(&sample)?;
                    for sample in samples.try_iter().take(1000) {
                        self.take(&sample)?;
                    }
                }
                Err(RecvTimeoutError::Disconnected) => break,
                Err(RecvTimeoutError::Timeout) if over => {
                    if !self.holes.are_open() || last_asks == LAST_ASKS.0 {
                        break;
                    }
                    last_asks += 1;
                    self.ask_again();
                }
                Err(RecvTimeoutError::Timeout) => {}
            }
            let now = self.clock.now();
            self.writer.flush_if_due(now)?;
            self.bytes
                .store(self.writer.bytes_written(), Ordering::Relaxed);
            if now >= ask_due {
                ask_due = now + ASK_PERIOD;
                self.ask_again();
            }
            if now >= sync_due {
                sync_due = now + SYNC_PERIOD;
                // A disk that refuses to sync refuses to finish, too, and is heard then.
                let _ = handle.sync_data();
            }
            if !self.has_metadata && now >= self.metadata_due {
                self.metadata_due = now + SYNC_PERIOD;
                self.write_metadata()?;
            }
        }
        self.settle(counts);
        let ledger = self
            .topics
            .iter()
            .map(|(topic, ledger)| {
                let text = serde_json::to_string(ledger).unwrap_or_default();
                (topic.clone(), text)
            })
            .collect();
        self.writer.write_metadata(metadata::LEDGER, &ledger)?;
        Ok(Written {
            finished: self.writer.finish()?,
            topics: self.topics,
        })
    }

    fn ask_again(&mut self) {
        let answers = self.answers.clone();
        self.holes.ask(self.remote.session(), &move |sample| {
            // What does not fit is asked for again.
            let _ = answers.send_timeout(sample, PATIENCE);
        });
    }

    /// What did not come by itself was recovered.
    fn settle(&mut self, counts: &Mutex<Direct>) {
        let counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
        for (topic, ledger) in &mut self.topics {
            let of = |counts: &HashMap<String, u64>| counts.get(topic).copied().unwrap_or(0);
            ledger.drops = of(&counts.drops);
            // A drop leaves a hole in the numbers, which is not counted twice.
            ledger.gaps = ledger.gaps.saturating_sub(ledger.drops);
            ledger.recovered = ledger.received.saturating_sub(of(&counts.came));
        }
    }

    /// What the capture says of itself: `ft.session`, and `ft.calibration` when there is one.
    fn write_metadata(&mut self) -> Result<(), WriteError> {
        let Some(id) = self.remote.ids().into_iter().next() else {
            return Ok(());
        };
        let said = ask(self.remote.session(), &id, &Command::Metadata);
        for (name, entries) in [
            (metadata::SESSION, &said["session"]),
            (metadata::CALIBRATION, &said["calibration"]),
        ] {
            let entries = texts(entries);
            if !entries.is_empty() {
                self.writer.write_metadata(name, &entries)?;
                self.has_metadata = true;
            }
        }
        Ok(())
    }

    fn take(&mut self, sample: &Sample) -> Result<(), WriteError> {
        let which = self.remote.which();
        let Some((topic, type_name)) = which.split_key(sample.key_expr().as_str()) else {
            return Ok(());
        };
        if !self.channels.contains_key(&topic) {
            if self.channels.len() == MOST_SOURCES {
                return Ok(());
            }
            let channel = add_channel(&mut self.writer, &topic, &type_name)?;
            self.channels.insert(topic.clone(), channel);
        }
        let attachment = sample
            .attachment()
            .and_then(|bytes| rmw::read_attachment(&bytes.to_bytes()));
        let ledger = self.topics.entry(topic.clone()).or_default();
        let (Some(attachment), Some(Some(channel))) = (attachment, self.channels.get(&topic))
        else {
            ledger.refused += 1;
            return Ok(());
        };
        match number(&mut self.sources, attachment) {
            Number::Next => {}
            Number::First => {
                ledger.earlier += u64::try_from(attachment.sequence - 1).unwrap_or(0);
            }
            Number::Skips(from) => {
                ledger.gaps += u64::try_from(attachment.sequence - from).unwrap_or(0);
                self.holes.add(sample, attachment, from);
            }
            Number::Before if self.holes.fill(attachment) => ledger.gaps -= 1,
            Number::Before => {
                ledger.duplicated += 1;
                return Ok(());
            }
        }
        let at = HostTime::from_nanos(attachment.source_ns);
        let stamps = MessageStamps {
            log_time: at,
            publish_time: at,
        };
        self.writer
            .write(*channel, stamps, &sample.payload().to_bytes())?;
        ledger.received += 1;
        Ok(())
    }
}

/// Where a message stands among its publisher's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Number {
    /// The first of this publisher.
    First,
    /// The one after the last.
    Next,
    /// After a hole that begins at this number.
    Skips(i64),
    /// Before the last: it fills a hole, or came twice.
    Before,
}

fn number(sources: &mut HashMap<[u8; 16], i64>, attachment: Attachment) -> Number {
    let Attachment { gid, sequence, .. } = attachment;
    let Some(last) = sources.get_mut(&gid) else {
        if sources.len() < MOST_SOURCES {
            sources.insert(gid, sequence);
        }
        return Number::First;
    };
    if sequence <= *last {
        return Number::Before;
    }
    let expected = std::mem::replace(last, sequence) + 1;
    if sequence == expected {
        Number::Next
    } else {
        Number::Skips(expected)
    }
}

fn add_channel(
    writer: &mut RecordingWriter,
    name: &str,
    type_name: &str,
) -> Result<Option<ChannelId>, WriteError> {
    let (stream, event) = (Qos::SENSOR, Qos::RELIABLE);
    let channel = match type_name {
        WrenchStamped::TYPE_NAME => writer.add_channel::<WrenchStamped>(name, stream),
        Temperature::TYPE_NAME => writer.add_channel::<Temperature>(name, stream),
        JointState::TYPE_NAME => writer.add_channel::<JointState>(name, stream),
        PoseStamped::TYPE_NAME => writer.add_channel::<PoseStamped>(name, stream),
        TFMessage::TYPE_NAME if name.ends_with(topic::TF_STATIC) => {
            writer.add_channel::<TFMessage>(name, Qos::LATCHED)
        }
        TFMessage::TYPE_NAME => writer.add_channel::<TFMessage>(name, stream),
        Text::TYPE_NAME => writer.add_channel::<Text>(name, event),
        DiagnosticArray::TYPE_NAME => writer.add_channel::<DiagnosticArray>(name, event),
        _ => return Ok(None),
    };
    channel.map(Some)
}

fn texts(entries: &Value) -> BTreeMap<String, String> {
    entries
        .as_object()
        .into_iter()
        .flatten()
        .filter_map(|(key, value)| Some((key.clone(), value.as_str()?.to_owned())))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_tell_holes_and_doubles_of_each_publisher() {
        use Number::{Before, First, Next, Skips};
        let mut sources = HashMap::new();
        // The second publisher is the first after its restart.
        for (source, sequence, expected) in [
            (1, 5, First),
            (1, 6, Next),
            (1, 6, Before),
            (1, 9, Skips(7)),
            (1, 8, Before),
            (2, 1, First),
            (2, 2, Next),
        ] {
            let attachment = Attachment {
                sequence,
                source_ns: 0,
                gid: [source; 16],
            };
            assert_eq!(
                number(&mut sources, attachment),
                expected,
                "{source} {sequence}"
            );
        }
    }

    #[test]
    fn a_hole_is_a_loss_and_what_was_before_the_recording_is_none() {
        let before = RemoteLedger {
            earlier: 9,
            recovered: 9,
            duplicated: 9,
            ..RemoteLedger::default()
        };
        assert!(!before.lost_data());
        assert!(RemoteLedger { gaps: 1, ..before }.lost_data());
    }
}
