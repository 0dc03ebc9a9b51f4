//! The live topics, on Zenoh in rmw_zenoh's format: ROS 2 nodes and plain Zenoh programs see the same.
//!
//! The latest messages of each are kept for recorders that missed some ([`crate::remote::recorder`]). A message is dropped for
//! whoever is too slow to take it within a millisecond; what a recorder asks for again has a queue of its own
//! (`Priority::DataLow`), behind what is live.

use std::sync::Arc;
use std::time::Duration;

use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{Message, TFMessage};
use ft_wire::HostTime;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::Queryable;
use zenoh::sample::SourceInfo;

use super::SinkError;
use crate::config::Network;
use crate::encode::Topic;
use crate::recovery;
use crate::rmw::{self, NodeName};

mod kept;
mod recorders;

use kept::{Kept, wrapped_number};
use recorders::{About, Recorders, Shelf};

/// How often `/tf_static` is repeated: plain subscribers know of no cache.
const STATIC_PERIOD: Duration = Duration::from_secs(1);
/// How often a recorder hears the number of the latest message, so that it misses the last ones, too.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// The same while the end waits for it.
const LAST_HEARTBEAT: Duration = Duration::from_millis(100);

/// Publishes messages, and keeps the latest for recorders that missed some. To be used from a thread that may wait: a put can
/// take milliseconds.
#[derive(Debug)]
pub struct ZenohSink {
    endpoints: Vec<Endpoint>,
    static_transforms: Vec<u8>,
    static_due: HostTime,
    heartbeat_due: HostTime,
    recorders: Recorders,
    _node: LivelinessToken,
}

#[derive(Debug)]
struct Endpoint {
    publisher: Publisher<'static>,
    heartbeat: Publisher<'static>,
    shelf: Arc<Shelf>,
    _tokens: [LivelinessToken; 2],
    _queryables: Vec<Queryable<()>>,
}

impl ZenohSink {
    /// Declares the node, its publishers and their tokens.
    ///
    /// # Errors
    /// Zenoh refuses a declaration, or a thread cannot be started.
    pub fn declare(
        session: &zenoh::Session,
        node_name: &str,
        settings: &Network,
        static_transforms: &TFMessage,
        clock: MonotonicClock,
    ) -> Result<Self, SinkError> {
        let node = NodeName {
            domain_id: settings.domain_id,
            namespace: settings.namespace.clone(),
            zenoh_id: session.zid().to_string(),
            node: node_name.to_owned(),
        };
        let node_token = declare_token(session, node.token())?;
        let declared = Topic::ALL
            .into_iter()
            .map(|topic| Declared::new(session, topic, &node, settings))
            .collect::<Result<Vec<_>, _>>()?;
        let shelves = declared
            .iter()
            .map(|declared| Arc::clone(&declared.shelf))
            .collect();
        let recorders = Recorders::start(shelves, clock).map_err(|error| SinkError::Zenoh {
            what: "starting the thread that answers recorders",
            why: error.to_string(),
        })?;
        let endpoints = declared
            .into_iter()
            .enumerate()
            .map(|(index, declared)| declared.open(session, index, &recorders))
            .collect::<Result<Vec<_>, _>>()?;
        let mut bytes = Vec::new();
        static_transforms.encode(&mut bytes);
        Ok(Self {
            endpoints,
            static_transforms: bytes,
            static_due: HostTime::EPOCH,
            heartbeat_due: HostTime::EPOCH,
            recorders,
            _node: node_token,
        })
    }

    /// Publishes one message.
    ///
    /// # Errors
    /// Zenoh refuses it; it is kept all the same.
    pub fn put(&mut self, topic: Topic, payload: &[u8], at: HostTime) -> Result<(), SinkError> {
        match self.endpoints.get(topic.index()) {
            Some(endpoint) => endpoint.put(payload, at.as_nanos()),
            None => Ok(()),
        }
    }

    /// Time went by: repeats what late comers need.
    ///
    /// # Errors
    /// As for [`ZenohSink::put`].
    pub fn tick(&mut self, now: HostTime) -> Result<(), SinkError> {
        if now >= self.heartbeat_due {
            self.heartbeat_due = now + HEARTBEAT;
            self.beat()?;
        }
        if now < self.static_due {
            return Ok(());
        }
        self.static_due = now + STATIC_PERIOD;
        let endpoint = self.endpoints.get(Topic::TfStatic.index());
        endpoint.map_or(Ok(()), |endpoint| {
            endpoint.put(&self.static_transforms, now.as_nanos())
        })
    }

    /// Nothing is published any more: waits until every recorder has what was. Not for recorders of which nothing was heard
    /// for some seconds, at most for `patience` while none of them gets any further, and never longer than `longest`.
    pub fn settle(&mut self, clock: MonotonicClock, patience: Duration, longest: Duration) {
        let over = clock.now() + longest;
        let (mut progress, mut give_up) = (self.recorders.progress(), clock.now() + patience);
        while clock.now() < over.min(give_up) && self.is_waited_for(clock.now()) {
            // Without a network nobody hears it, and they are gone soon.
            let _ = self.beat();
            clock.wait_until(clock.now() + LAST_HEARTBEAT);
            let now_at = self.recorders.progress();
            if now_at > progress {
                (progress, give_up) = (now_at, clock.now() + patience);
            }
        }
    }

    fn is_waited_for(&self, now: HostTime) -> bool {
        self.endpoints.iter().enumerate().any(|(index, endpoint)| {
            let latest = endpoint.shelf.with(|kept| kept.latest());
            self.recorders.wait_for(index, latest, now)
        })
    }

    fn beat(&self) -> Result<(), SinkError> {
        for endpoint in &self.endpoints {
            let latest = endpoint.shelf.with(|kept| kept.latest());
            if latest > 0 {
                endpoint
                    .heartbeat
                    .put(wrapped_number(latest).to_le_bytes().as_slice())
                    .wait()
                    .map_err(|error| refused("publishing", &error))?;
            }
        }
        Ok(())
    }
}

/// A publisher whose messages nobody can ask for yet.
struct Declared {
    publisher: Publisher<'static>,
    shelf: Arc<Shelf>,
    token: LivelinessToken,
}

impl Declared {
    fn new(
        session: &zenoh::Session,
        topic: Topic,
        node: &NodeName,
        settings: &Network,
    ) -> Result<Self, SinkError> {
        let (type_name, type_hash) = topic.message_type();
        let name = settings.topic(topic.name());
        let named = rmw::Topic::new(&name, type_name, type_hash, settings.profile);
        let token = named.token(node, topic.index() + 1, topic.offer());
        let key = named.key_expr(settings.domain_id);
        let publisher = session
            .declare_publisher(key.clone())
            .congestion_control(CongestionControl::Drop)
            .priority(priority(topic))
            .wait()
            .map_err(|error| refused("declaring a publisher", &error))?;
        let shelf = Shelf {
            key,
            id: publisher.id(),
            gid: rmw::gid(&token),
            kept: Kept::new(settings.cached(topic)).into(),
        };
        Ok(Self {
            publisher,
            shelf: Arc::new(shelf),
            token: declare_token(session, token)?,
        })
    }

    fn open(
        self,
        session: &zenoh::Session,
        index: usize,
        recorders: &Recorders,
    ) -> Result<Endpoint, SinkError> {
        let own = recovery::publisher(&self.shelf.key, self.shelf.id);
        let messages = recovery::messages(&own);
        let queryables = [
            (messages.clone(), About::Messages),
            (recovery::have(&own), About::Have),
        ];
        let queryables = queryables
            .into_iter()
            .map(|(key, about)| {
                session
                    .declare_queryable(key)
                    .callback(recorders.desk(index, about))
                    .wait()
                    .map_err(|error| refused("declaring what recorders ask", &error))
            })
            .collect::<Result<_, _>>()?;
        let heartbeat = session
            .declare_publisher(messages.clone())
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(|error| refused("declaring a publisher", &error))?;
        Ok(Endpoint {
            publisher: self.publisher,
            heartbeat,
            shelf: self.shelf,
            _tokens: [self.token, declare_token(session, messages)?],
            _queryables: queryables,
        })
    }
}

impl Endpoint {
    fn put(&self, payload: &[u8], source_ns: i64) -> Result<(), SinkError> {
        let payload = ZBytes::from(payload);
        let number = self
            .shelf
            .with(|kept| kept.push(source_ns, payload.clone()));
        let attachment = rmw::attachment(number, source_ns, self.shelf.gid);
        self.publisher
            .put(payload)
            .attachment(attachment.as_slice())
            .source_info(SourceInfo::new(self.shelf.id, wrapped_number(number)))
            .wait()
            .map_err(|error| refused("publishing", &error))
    }
}

/// What comes once a second or less has a queue of its own, so that it is not lost for being behind a thousand samples.
const fn priority(topic: Topic) -> Priority {
    match topic {
        Topic::Wrench | Topic::JointStates | Topic::AriaPose => Priority::Data,
        Topic::Temperature | Topic::TfStatic | Topic::Marks | Topic::Diagnostics => {
            Priority::DataHigh
        }
    }
}

fn declare_token(session: &zenoh::Session, token: String) -> Result<LivelinessToken, SinkError> {
    session
        .liveliness()
        .declare_token(token)
        .wait()
        .map_err(|error| refused("declaring a liveliness token", &error))
}

fn refused(what: &'static str, error: &zenoh::Error) -> SinkError {
    SinkError::Zenoh {
        what,
        why: crate::network::plainly(&error.to_string()),
    }
}
