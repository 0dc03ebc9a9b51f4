//! Sends the raw frames of a recording through the drivers again, on the recording's own clock.

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use ft_drivers::link::record::RawFrame;
use ft_drivers::options::Startup;
use ft_drivers::{Link, LinkError, RxStamps};
use ft_recording::message::{Message, Text};
use ft_recording::reader::{Record, RecordReader};
use ft_wire::{CanFrame, Chunk, HostTime};

use super::stepped::{Buffer, Stepping};
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
/// `file` cannot be read or has no raw frames or no configuration; `out` exists or cannot be written.
pub fn replay(file: &Path, out: &Path, overwrite: bool) -> Result<Summary, SessionError> {
    let (config, start) = configuration(file)?;
    let plan = Plan { config, record: Some(out.to_owned()), overwrite, duration: None, publish: false };
    let buffer = Buffer::default();
    let counters: Vec<_> = plan.config.devices.iter().map(|_| Arc::new(StreamCounters::default())).collect();
    let mut feeds = Vec::new();
    let mut links = Vec::new();
    for (index, (device, counters)) in plan.config.devices.iter().zip(&counters).enumerate() {
        let link_delay = Duration::from_secs_f64(device.latency_us * 1e-6);
        let feed = Feed::default();
        let builder = StepBuilder {
            device,
            channel: Channel::new(index, buffer.clone(), Arc::clone(counters), link_delay),
            counters: Arc::clone(counters),
            serial: || Some(FedLink::<Chunk>::new(&feed)),
            can: || Some(FedLink::<CanFrame>::new(&feed)),
        };
        links.push(builder.build(Startup::Listen)?);
        feeds.push(feed);
    }
    let mut stepping = Stepping::begin(&plan, links, &counters, buffer, start, "replayed")?;
    feed_all(file, &plan.config, &feeds, &mut stepping)?;
    stepping.finish()
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
        Self { feed: Rc::clone(feed), frames: std::marker::PhantomData }
    }
}

impl<F: RawFrame> Link for FedLink<F> {
    type Frame = F;

    fn recv(&mut self, _deadline: HostTime) -> Result<Option<(F, RxStamps)>, LinkError> {
        let Some((bytes, arrival)) = self.feed.borrow_mut().pop_front() else { return Ok(None) };
        Ok(F::from_raw(&bytes).map(|frame| (frame, RxStamps { arrival })))
    }

    /// A recording answers nothing.
    fn send(&mut self, _frame: &F) -> Result<(), LinkError> {
        Ok(())
    }
}

fn feed_all(file: &Path, config: &Config, feeds: &[Feed], stepping: &mut Stepping) -> Result<(), SessionError> {
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
                let device = topic.strip_prefix("/raw/").and_then(|name| config.devices.iter().position(|device| device.name == name));
                if let Some(feed) = device.and_then(|index| feeds.get(index)) {
                    feed.borrow_mut().push_back((message.data.to_vec(), now));
                    stepping.step(now)?;
                } else if topic == "/marks"
                    && let Ok(mark) = Text::decode(message.data)
                {
                    stepping.own(now, Body::Mark(mark.data));
                }
            }
            _ => {}
        }
    }
    Ok(())
}

/// The configuration of a recording, and when it began.
fn configuration(file: &Path) -> Result<(Config, HostTime), SessionError> {
    let not = |what| SessionError::NotReplayable { path: file.display().to_string(), what };
    let mut reader = RecordReader::open(file)?;
    let (mut session, mut start, mut raw) = (None, None, false);
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Metadata { name, entries } if name == "ft.session" => session = Some(entries),
            Record::Message(message) if start.is_none() => start = Some(message.log_time),
            Record::Channel(channel) => raw |= channel.topic.starts_with("/raw/"),
            _ => {}
        }
        if raw && start.is_some() && session.is_some() {
            break;
        }
    }
    if !raw {
        return Err(not("there is no /raw/<device> topic: only recordings of ft-capture hold the raw frames"));
    }
    let text = session
        .and_then(|mut entries| entries.remove("config"))
        .ok_or_else(|| not("the metadata ft.session with the configuration is missing: the drivers are unknown"))?;
    let config = Config::from_toml(&text, file)?;
    let start = start.and_then(|nanos| i64::try_from(nanos).ok()).unwrap_or_default();
    Ok((config, HostTime::from_nanos(start)))
}

