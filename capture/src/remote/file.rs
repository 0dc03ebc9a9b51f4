//! The file of a remote recording and the thread that writes it: it also asks for what did not come.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{
    DiagnosticArray, JointState, Message, PoseStamped, TFMessage, Temperature, Text, WrenchStamped,
};
use ft_recording::writer::{ChannelId, Finished, MessageStamps, RecordingWriter};
use ft_recording::{Qos, WriteError, metadata, topic};
use ft_wire::HostTime;
use serde_json::Value;
use zenoh::sample::Sample;

use super::asking::Asking;
use super::ledger::RemoteLedger;
use super::sources::{Arrived, Due, Gid, Place, Sources};
use super::{Remote, Which};
use crate::recovery;
use crate::rmw;

/// How long the writer sleeps when nothing comes.
const QUIET: Duration = Duration::from_millis(20);
/// How often the file is forced to the disk.
const SYNC_PERIOD: Duration = Duration::from_secs(1);
/// How long what is still being asked for is waited for at the end.
const LAST_WORDS: Duration = Duration::from_secs(10);
/// How long what comes is still taken at the end, as long as a publisher that ends waits for its recorders.
const LONGEST_END: Duration = Duration::from_secs(120);
/// Keys of which account is kept.
const MOST_KEYS: usize = 1024;
/// Messages that are taken before the clock is looked at again.
const PORTION: usize = 1000;

/// What the network brings.
#[derive(Debug)]
pub(super) enum Heard {
    /// A message that came by itself.
    Live(Sample),
    /// A message that was asked for.
    Again(Sample),
    /// An answer is complete.
    Answered(Gid),
    /// The latest number of a publisher, by [`recovery::publisher`].
    Heartbeat(String, u32),
    /// The oldest number that a publisher has.
    Oldest(Gid, u32),
    /// The capture's words about itself.
    Metadata(Value),
}

/// What was written.
#[derive(Debug)]
pub(super) struct Written {
    pub(super) finished: Finished,
    pub(super) topics: BTreeMap<String, RemoteLedger>,
}

/// The file and the account of what is in it.
pub(super) struct File {
    writer: RecordingWriter,
    remote: Arc<Remote>,
    clock: MonotonicClock,
    asking: Asking,
    /// By key.
    channels: HashMap<String, Channel>,
    topics: BTreeMap<Arc<str>, RemoteLedger>,
    sources: Sources,
    has_metadata: bool,
    metadata_due: HostTime,
    bytes: Arc<AtomicU64>,
}

#[derive(Clone, Debug)]
struct Channel {
    topic: Arc<str>,
    type_name: Arc<str>,
    /// `None` for a type that is not known, or not the one that the topic has in the file.
    id: Option<ChannelId>,
}

impl File {
    pub(super) fn new(
        writer: RecordingWriter,
        remote: &Arc<Remote>,
        clock: MonotonicClock,
        answers: Sender<Heard>,
        bytes: Arc<AtomicU64>,
    ) -> Self {
        Self {
            writer,
            remote: Arc::clone(remote),
            clock,
            asking: Asking::new(remote.session(), answers),
            channels: HashMap::new(),
            topics: BTreeMap::new(),
            sources: Sources::default(),
            has_metadata: false,
            metadata_due: clock.now(),
            bytes,
        }
    }

    /// Writes until `ending`, and then until nothing is worth waiting for any more.
    pub(super) fn write_until_over(
        mut self,
        heard: &Receiver<Heard>,
        ending: &AtomicBool,
    ) -> Result<Written, WriteError> {
        let handle = self.writer.sync_handle()?;
        let mut sync_due = self.clock.now();
        let mut ended = None;
        loop {
            let is_quiet = match heard.recv_timeout(QUIET) {
                Ok(first) => {
                    self.take(first)?;
                    for heard in heard.try_iter().take(PORTION) {
                        self.take(heard)?;
                    }
                    false
                }
                Err(RecvTimeoutError::Timeout) => true,
                Err(RecvTimeoutError::Disconnected) => break,
            };
            let now = self.clock.now();
            self.do_what_is_due(now);
            self.writer.flush_if_due(now)?;
            self.bytes
                .store(self.writer.bytes_written(), Ordering::Relaxed);
            if now >= sync_due {
                sync_due = now + SYNC_PERIOD;
                // A disk that refuses to sync refuses to finish, too, and is heard then.
                let _ = handle.sync_data();
            }
            if ending.load(Ordering::Acquire) {
                let since = *ended.get_or_insert(now);
                let waited = now.saturating_since(since);
                if is_over(waited, is_quiet, self.sources.are_open(now)) {
                    break;
                }
            }
        }
        self.finish()
    }

    fn finish(mut self) -> Result<Written, WriteError> {
        let topics: BTreeMap<_, _> = self
            .topics
            .into_iter()
            .map(|(topic, ledger)| (topic.to_string(), ledger))
            .collect();
        let ledger = topics
            .iter()
            .map(|(topic, ledger)| {
                let text = serde_json::to_string(ledger).unwrap_or_default();
                (topic.clone(), text)
            })
            .collect();
        self.writer.write_metadata(metadata::LEDGER, &ledger)?;
        Ok(Written {
            finished: self.writer.finish()?,
            topics,
        })
    }

    fn do_what_is_due(&mut self, now: HostTime) {
        for due in self.sources.due(now) {
            match due {
                Due::Lost(topic, count) => {
                    let ledger = self.topics.entry(topic).or_default();
                    ledger.gaps = ledger.gaps.saturating_add(count);
                }
                Due::Ask(gid, publisher, first, last) => {
                    self.asking.messages(gid, &publisher, first, last);
                }
                Due::Report(gid, publisher, before) => {
                    self.asking.report(gid, &publisher, before);
                }
            }
        }
        if !self.has_metadata && now >= self.metadata_due {
            self.metadata_due = now + SYNC_PERIOD;
            if let Some(id) = self.remote.ids().first() {
                self.asking.metadata(id);
            }
        }
    }

    fn take(&mut self, heard: Heard) -> Result<(), WriteError> {
        let now = self.clock.now();
        match heard {
            Heard::Live(sample) => self.take_sample(&sample, false, now)?,
            Heard::Again(sample) => self.take_sample(&sample, true, now)?,
            Heard::Answered(gid) => self.sources.answered(gid, now),
            Heard::Heartbeat(publisher, latest) => {
                self.sources.heartbeat(&publisher, latest, now);
            }
            Heard::Oldest(gid, oldest) => self.sources.oldest(gid, oldest, now),
            Heard::Metadata(said) if !self.has_metadata => self.write_metadata(&said)?,
            Heard::Metadata(_) => {}
        }
        Ok(())
    }

    /// What the capture says of itself: `ft.session`, and `ft.calibration` when there is one.
    fn write_metadata(&mut self, said: &Value) -> Result<(), WriteError> {
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

    fn take_sample(
        &mut self,
        sample: &Sample,
        was_asked_for: bool,
        now: HostTime,
    ) -> Result<(), WriteError> {
        let Some(Channel { topic, id, .. }) = self.channel(sample.key_expr().as_str())? else {
            return Ok(());
        };
        let attachment = sample
            .attachment()
            .and_then(|bytes| rmw::read_attachment(&bytes.to_bytes()));
        let ledger = self.topics.entry(Arc::clone(&topic)).or_default();
        let Some(id) = id else {
            ledger.others += 1;
            return Ok(());
        };
        let Some(attachment) = attachment else {
            ledger.refused += 1;
            return Ok(());
        };
        let info = sample.source_info();
        let arrived = Arrived {
            gid: attachment.gid,
            number: attachment.sequence,
            wrapped: info.map(|info| info.source_sn()),
        };
        let publisher =
            || info.map(|info| recovery::publisher(sample.key_expr(), *info.source_id()));
        match self.sources.take(arrived, &topic, publisher, now) {
            Place::Next => {}
            Place::Unknown => ledger.unfollowed += 1,
            Place::First => {
                let before = u64::try_from(attachment.sequence - 1).unwrap_or(0);
                ledger.earlier = ledger.earlier.saturating_add(before);
            }
            Place::Skips(lost) => ledger.gaps = ledger.gaps.saturating_add(lost),
            Place::Fills => ledger.gaps = ledger.gaps.saturating_sub(1),
            Place::Earlier => ledger.earlier = ledger.earlier.saturating_sub(1),
            Place::Twice => {
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
            .write(id, stamps, &sample.payload().to_bytes())?;
        ledger.received += 1;
        ledger.recovered += u64::from(was_asked_for);
        Ok(())
    }

    /// The channel of a key; `None` for one that is no topic's, and when there are too many.
    fn channel(&mut self, key: &str) -> Result<Option<Channel>, WriteError> {
        if let Some(channel) = self.channels.get(key) {
            return Ok(Some(channel.clone()));
        }
        let which: &Which = self.remote.which();
        let Some((topic, type_name)) = which.split_key(key) else {
            return Ok(None);
        };
        if self.channels.len() == MOST_KEYS {
            return Ok(None);
        }
        let channel = new_channel(&mut self.writer, &self.channels, &topic, &type_name)?;
        self.channels.insert(key.to_owned(), channel.clone());
        Ok(Some(channel))
    }
}

/// Whether the recording is over, so long after its end: nothing comes or is worth waiting for, or it has been enough.
fn is_over(waited: Duration, is_quiet: bool, is_open: bool) -> bool {
    (is_quiet && !(waited < LAST_WORDS && is_open)) || waited >= LONGEST_END
}

/// The channel of a new key. A topic that other keys have already, too, with another type or another hash of the type, has one
/// channel in the file.
fn new_channel(
    writer: &mut RecordingWriter,
    known: &HashMap<String, Channel>,
    topic: &str,
    type_name: &str,
) -> Result<Channel, WriteError> {
    let same = known
        .values()
        .find(|other| *other.topic == *topic && other.id.is_some());
    let id = match same {
        Some(same) => same.id.filter(|_| *same.type_name == *type_name),
        None => add_channel(writer, topic, type_name)?,
    };
    Ok(Channel {
        topic: topic.into(),
        type_name: type_name.into(),
        id,
    })
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
    use ft_recording::writer::WriterOptions;

    #[test]
    fn what_comes_for_ever_does_not_keep_the_file_open_for_ever() {
        let seconds = Duration::from_secs;
        assert!(is_over(seconds(0), true, false));
        assert!(!is_over(seconds(9), true, true));
        assert!(is_over(seconds(10), true, true));
        assert!(!is_over(seconds(119), false, true));
        assert!(is_over(seconds(120), false, true));
    }

    #[test]
    fn a_second_publisher_of_a_topic_does_not_end_the_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
        let mut known = HashMap::new();
        let mut add = |key: &str, topic: &str, type_name: &str| {
            let channel = new_channel(&mut writer, &known, topic, type_name).unwrap();
            known.insert(key.to_owned(), channel.clone());
            channel.id
        };
        assert_eq!(add("nobody's", "/t", "my_msgs/msg/Mine"), None);
        let first = add("first", "/t", WrenchStamped::TYPE_NAME);
        assert!(first.is_some());
        assert_eq!(add("other hash", "/t", WrenchStamped::TYPE_NAME), first);
        assert_eq!(add("other type", "/t", PoseStamped::TYPE_NAME), None);
        assert_eq!(add("again", "/t", WrenchStamped::TYPE_NAME), first);
        assert_ne!(add("other topic", "/u", PoseStamped::TYPE_NAME), first);
    }
}
