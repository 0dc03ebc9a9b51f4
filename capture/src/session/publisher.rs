//! The live side of a session: a thread that publishes to Zenoh and to the hub of this program's own viewers, and the
//! commands that come back.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::Receiver;
use ft_drivers::priority::SharedProcessor;
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{Message, TFMessage};
use ft_wire::HostTime;
use serde_json::Value;
use zenoh::Wait;
use zenoh::query::Queryable;

use super::control::{self, Commands};
use super::live::Surroundings;
use super::outlets::{self, Outlets};
use super::{Plan, SessionError, spawn};
use crate::encode::{Topic, static_transforms};
use crate::foxglove;
use crate::item::Item;
use crate::live::Hub;
use crate::network;
use crate::queues::Queues;
use crate::sink::SinkError;
use crate::sink::zenoh::ZenohSink;
use crate::web::{self, Server};

/// How long recorders on other machines may ask for what they missed without getting any further.
const PATIENCE: Duration = Duration::from_secs(10);
/// How long they may ask in all.
const LONGEST: Duration = Duration::from_secs(120);

/// What looks on.
#[derive(Debug)]
pub(super) struct Publisher {
    hub: Option<Arc<Hub>>,
    servers: Vec<Server>,
    zenoh: Option<(zenoh::Session, Vec<Queryable<()>>)>,
    /// Gives the number of messages that Zenoh refused, and the publishers with what they keep.
    thread: Option<JoinHandle<(u64, Outlets)>>,
    processor: SharedProcessor,
}

impl Publisher {
    /// Opens what was asked for; without any viewer and without Zenoh nothing is published.
    pub(super) fn start(
        plan: &Plan,
        clock: MonotonicClock,
        items: Option<Receiver<Item>>,
        commands: &Commands,
        queues: &mut Queues,
        surroundings: &mut impl Surroundings,
    ) -> Result<Self, SessionError> {
        let mut publisher = Self {
            hub: None,
            servers: Vec::new(),
            zenoh: None,
            thread: None,
            processor: SharedProcessor::default(),
        };
        let Some(items) = items else {
            return Ok(publisher);
        };
        let transforms = static_transforms(&plan.config.frames, clock.now());
        let sink = match publisher.open_zenoh(plan, clock, &transforms, commands, surroundings) {
            Ok(sink) => Some(sink),
            // Without a network that was asked for there is no session; without the one that nobody asked for there is.
            Err(error) if plan.config.network.asks_for_nothing() => {
                surroundings.log(&format!("no live topics: {error}"));
                None
            }
            Err(error) => return Err(error.into()),
        };
        publisher.serve(plan, clock, &transforms, commands, surroundings)?;
        if sink.is_none() && publisher.hub.is_none() {
            queues.close_publisher();
            return Ok(publisher);
        }
        let outlets = Outlets::new(sink, publisher.hub.clone());
        let processor = publisher.processor.clone();
        publisher.thread = Some(spawn("ft-publisher", move || {
            outlets.publish_until_closed(&items, clock, &processor)
        })?);
        Ok(publisher)
    }

    /// Shared by the thread that publishes, where there is one.
    pub(super) fn processor(&self) -> Option<&SharedProcessor> {
        self.thread.as_ref().map(|_| &self.processor)
    }

    /// The network, when there is one.
    pub(super) fn session(&self) -> Option<&zenoh::Session> {
        self.zenoh.as_ref().map(|(session, _)| session)
    }

    fn open_zenoh(
        &mut self,
        plan: &Plan,
        clock: MonotonicClock,
        transforms: &TFMessage,
        commands: &Commands,
        surroundings: &mut impl Surroundings,
    ) -> Result<ZenohSink, SinkError> {
        let settings = &plan.config.network;
        let opened = network::open(settings)?;
        let node = format!("ft_capture_{}", plan.config.id.replace('-', "_"));
        let sink = ZenohSink::declare(&opened.session, &node, settings, transforms, clock)?;
        let queryables = control::declare(&opened.session, &plan.config.id, commands)?;
        surroundings.log(&opened.how);
        self.zenoh = Some((opened.session, queryables));
        Ok(sink)
    }

    /// Serves this program's own viewers, when they were asked for.
    fn serve(
        &mut self,
        plan: &Plan,
        clock: MonotonicClock,
        transforms: &TFMessage,
        commands: &Commands,
        surroundings: &mut impl Surroundings,
    ) -> Result<(), SessionError> {
        let settings = &plan.config.network;
        if settings.view.is_none() && settings.foxglove.is_none() {
            return Ok(());
        }
        let hub = Arc::new(Hub::new("this program"));
        let mut payload = Vec::new();
        transforms.encode(&mut payload);
        hub.take(&outlets::sample(Topic::TfStatic, &payload, clock.now()));
        if let Some(address) = settings.view {
            let (hub, operator) = (Arc::clone(&hub), Arc::new(commands.clone()));
            let server = web::serve_page(hub, operator, address, settings.token.clone())?;
            surroundings.log(&format!("live page: {}", server.url()));
            self.servers.push(server);
        }
        if let Some(address) = settings.foxglove {
            let server = foxglove::serve(Arc::clone(&hub), address)?;
            surroundings.log(&format!("foxglove: ws://{}", server.address));
            self.servers.push(server);
        }
        self.hub = Some(hub);
        Ok(())
    }

    /// Whether this program's viewers want to know how the session stands.
    pub(super) const fn has_viewers(&self) -> bool {
        self.hub.is_some()
    }

    /// Time went by for this program's viewers, whether a message came or not.
    pub(super) fn tick(&self, now: HostTime) {
        if let Some(hub) = &self.hub {
            hub.tick(now);
        }
    }

    /// How the session stands, for this program's viewers.
    pub(super) fn set_status(&self, status: Value, now: HostTime) {
        if let Some(hub) = &self.hub {
            hub.set_status(status, now);
        }
    }

    /// What went wrong on the network is told; the recording has nothing to do with it.
    pub(super) fn finish(self, clock: MonotonicClock, surroundings: &mut impl Surroundings) {
        match self.thread.map(JoinHandle::join) {
            None => {}
            Some(Ok((refused, mut outlets))) => {
                if refused > 0 {
                    surroundings.log(&format!("{refused} messages could not be published"));
                }
                outlets.settle(clock, PATIENCE, LONGEST);
            }
            Some(Err(_)) => surroundings.log("the publisher thread panicked: please report this"),
        }
        drop(self.servers);
        if let Some((session, queryables)) = self.zenoh {
            drop(queryables);
            // Closing only tells the others; a failure leaves nothing behind here.
            let _ = session.close().wait();
        }
    }
}
