//! Sends the raw frames of a recording through the drivers again, on the recording's own clock.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use ft_drivers::hid_axis::HidFrame;
use ft_drivers::link::record::RawFrame;
use ft_drivers::options::Startup;
use ft_drivers::{Link, LinkError, RxStamps};
use ft_recording::message::{Message, TFMessage, Text};
use ft_recording::reader::{Record, RecordReader};
use ft_recording::{Calibration, metadata, topic};
use ft_wire::{CanFrame, Chunk, HostTime};

use super::stepped::{Buffer, Listener, Stepping};
use super::{Plan, SessionError};
use crate::channel::Channel;
use crate::config::Config;
use crate::item::Body;
use crate::ledger::StreamCounters;
use crate::open::StepBuilder;
use crate::summary::Summary;

/// Makes a new recording `out` of the raw frames of `file`, with the configuration that `file` holds.
///
/// # Errors
/// `file` cannot be read or has no raw frames or no configuration; `out` exists, is `file`, or cannot be written.
pub fn replay(file: &Path, out: &Path, overwrite: bool) -> Result<Summary, SessionError> {
    if is_same(file, out) {
        return Err(SessionError::IsSource {
            path: out.to_owned(),
        });
    }
    let source = Source::read(file)?;
    play(file, source, Some((out, overwrite)), None)
}

/// Whether both names lead to one file, which is then never written to.
#[must_use]
pub fn is_same(file: &Path, out: &Path) -> bool {
    matches!((file.canonicalize(), out.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Sends what `file` holds through the drivers, into `out` (and whether it may be replaced) and past `listener`.
pub(super) fn play(
    file: &Path,
    source: Source,
    out: Option<(&Path, bool)>,
    listener: Option<Listener>,
) -> Result<Summary, SessionError> {
    let Source {
        config,
        start,
        first_samples,
        is_retimed: _,
    } = source;
    let plan = Plan {
        config,
        record: out.map(|(path, _)| path.to_owned()),
        overwrite: out.is_some_and(|(_, overwrite)| overwrite),
        duration: None,
        publish: false,
    };
    let buffer = Buffer::default();
    let counters: Vec<_> = plan
        .config
        .devices
        .iter()
        .map(|_| Arc::new(StreamCounters::default()))
        .collect();
    let mut feeds = Vec::new();
    let mut links = Vec::new();
    for (index, (device, counters)) in plan.config.devices.iter().zip(&counters).enumerate() {
        let link_delay = Duration::from_secs_f64(device.latency_us * 1e-6);
        let feed = Feed::default();
        let builder = StepBuilder {
            device,
            channel: Channel::new(index, buffer.clone(), Arc::clone(counters), link_delay)
                .sampling_evenly(device.driver.samples_evenly()),
            counters: Arc::clone(counters),
            serial: || Some(FedLink::<Chunk>::new(&feed)),
            can: || Some(FedLink::<CanFrame>::new(&feed)),
            hid: || Some(FedLink::<HidFrame>::new(&feed)),
        };
        links.push(builder.build(Startup::Listen)?);
        feeds.push(feed);
    }
    let mut stepping = Stepping::begin(&plan, links, &counters, buffer, start, "replayed")?;
    if let Some(listener) = listener {
        stepping.listen(listener);
    }
    let damage = feed_all(file, &plan.config, &first_samples, &feeds, &mut stepping)?;
    let mut summary = stepping.finish()?;
    summary.source_damage = damage;
    Ok(summary)
}

/// Frames on their way to a driver.
type Feed = Rc<RefCell<VecDeque<(Vec<u8>, HostTime)>>>;

/// A link that delivers what was fed.
#[derive(Debug)]
struct FedLink<F> {
    feed: Feed,
    frames: std::marker::PhantomData<F>,
}

impl<F> FedLink<F> {
    fn new(feed: &Feed) -> Self {
        Self {
            feed: Rc::clone(feed),
            frames: std::marker::PhantomData,
        }
    }
}

impl<F: RawFrame> Link for FedLink<F> {
    type Frame = F;

    fn recv(&mut self, _deadline: HostTime) -> Result<Option<(F, RxStamps)>, LinkError> {
        let Some((bytes, arrival)) = self.feed.borrow_mut().pop_front() else {
            return Ok(None);
        };
        Ok(F::from_raw(&bytes).map(|frame| (frame, RxStamps { arrival })))
    }

    /// A recording answers nothing.
    fn send(&mut self, _frame: &F) -> Result<(), LinkError> {
        Ok(())
    }
}

/// How long before its first sample a device's frames are fed: the first sample's frame may have come in two pieces.
const LEAD: Duration = Duration::from_millis(1);

/// Frames of the set-up are left out: here nobody asks, so their answers answer nothing. Only drivers that learn the scale from
/// the device hear them.
fn feed_all(
    file: &Path,
    config: &Config,
    first_samples: &BTreeMap<String, HostTime>,
    feeds: &[Feed],
    stepping: &mut Stepping,
) -> Result<Vec<String>, SessionError> {
    let mut reader = RecordReader::open(file)?;
    let mut topics = BTreeMap::new();
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message(message) => {
                let now = HostTime::from_nanos(i64::try_from(message.log_time).unwrap_or(i64::MAX));
                let topic = topics.get(&message.channel_id).map_or("", String::as_str);
                let name = topic.strip_prefix("/raw/");
                let found = config
                    .devices
                    .iter()
                    .zip(feeds)
                    .find(|(device, _)| Some(device.name.as_str()) == name);
                if let Some((device, feed)) = found {
                    let first = first_samples.get(device.driver.topic());
                    let streaming = first.is_some_and(|first| now + LEAD >= *first);
                    if streaming || device.driver.learns_scale() {
                        feed.borrow_mut().push_back((message.data.to_vec(), now));
                        stepping.step(now)?;
                    }
                } else if topic == "/marks"
                    && let Ok(mark) = Text::decode(message.data)
                {
                    stepping.own(now, Body::Mark(mark.data));
                }
            }
            _ => {}
        }
    }
    let mut damage: Vec<String> = reader.damage().iter().map(ToString::to_string).collect();
    if damage.is_empty() && !reader.is_complete() {
        damage.push("it was not finished".to_owned());
    }
    Ok(damage)
}

/// What a first pass over the recording finds.
pub(super) struct Source {
    pub(super) config: Config,
    /// When it began.
    start: HostTime,
    /// Arrival of the first message of each topic.
    first_samples: BTreeMap<String, HostTime>,
    /// Whether its stamps were smoothed already.
    pub(super) is_retimed: bool,
}

impl Source {
    pub(super) fn read(file: &Path) -> Result<Self, SessionError> {
        let not = |what| SessionError::NotReplayable {
            path: file.display().to_string(),
            what,
        };
        let mut reader = RecordReader::open(file)?;
        let (mut session, mut topics, mut first_samples) = (None, BTreeMap::new(), BTreeMap::new());
        let (mut calibration, mut static_channels) = (None, BTreeSet::new());
        let mut transforms = Vec::new();
        let mut is_retimed = false;
        while let Some(record) = reader.next_record()? {
            match record {
                Record::Metadata { name, entries } if name == "ft.session" => {
                    session = Some(entries)
                }
                Record::Metadata { name, entries } if name == metadata::CALIBRATION => {
                    calibration = Some(entries);
                }
                Record::Metadata { name, .. } if name == metadata::RETIMED => is_retimed = true,
                Record::Channel(channel) => {
                    if channel.topic == topic::TF_STATIC {
                        static_channels.insert(channel.id);
                    }
                    topics.insert(channel.id, channel.topic);
                }
                Record::Message(message) => {
                    if static_channels.contains(&message.channel_id)
                        && let Ok(message) = TFMessage::decode(message.data)
                    {
                        transforms.extend(message.transforms);
                    }
                    if let Some(topic) = topics.remove(&message.channel_id) {
                        let at = HostTime::from_nanos(
                            i64::try_from(message.log_time).unwrap_or(i64::MAX),
                        );
                        first_samples.entry(topic).or_insert(at);
                    }
                }
                _ => {}
            }
        }
        if !first_samples.keys().any(|topic| topic.starts_with("/raw/")) {
            return Err(not(
                "there is no /raw/<device> topic: only recordings of ft-capture hold the raw frames",
            ));
        }
        let text = session
            .and_then(|mut entries| entries.remove("config"))
            .ok_or_else(|| not("the metadata ft.session with the configuration is missing: the drivers are unknown"))?;
        let mut config = Config::from_toml(&text, file)?;
        // What `calibrate` and imports found later stands in the recording, not in its configuration.
        if let Some(entries) = calibration {
            let calibration = Calibration::from_metadata(&entries);
            config.calibration = Some(calibration.map_err(|_| {
                not("its metadata ft.calibration is no calibration: `ft-capture calibrate` writes one")
            })?);
        }
        transforms
            .iter()
            .for_each(|transform| config.frames.take(transform));
        let start = first_samples.values().min().copied().unwrap_or_default();
        Ok(Self {
            config,
            start,
            first_samples,
            is_retimed,
        })
    }
}
