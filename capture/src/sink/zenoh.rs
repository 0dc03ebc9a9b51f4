//! The live topics, on Zenoh in rmw_zenoh's format: ROS 2 nodes and plain Zenoh programs see the same.

use std::time::Duration;

use ft_recording::message::{Message, TFMessage};
use ft_wire::HostTime;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt as _, CacheConfig, MissDetectionConfig,
};

use super::SinkError;
use crate::config::Network;
use crate::encode::Topic;
use crate::rmw::{self, NodeName};

/// How often `/tf_static` is repeated: plain publishers have no cache for those who come late.
const STATIC_PERIOD: Duration = Duration::from_secs(1);

/// How often a recorder hears the number of the latest message, so that it misses the last ones, too.
const HEARTBEAT: Duration = Duration::from_millis(500);

/// Publishes messages, and keeps the latest for recorders that missed some. To be used from a thread that may wait: a put can take milliseconds.
#[derive(Debug)]
pub struct ZenohSink {
    endpoints: Vec<Endpoint>,
    static_transforms: Vec<u8>,
    static_due: HostTime,
    _node: LivelinessToken,
}

#[derive(Debug)]
struct Endpoint {
    publisher: AdvancedPublisher<'static>,
    gid: [u8; 16],
    sequence: i64,
    _token: LivelinessToken,
}

impl ZenohSink {
    /// Declares the node, its publishers and their tokens.
    ///
    /// # Errors
    /// Zenoh refuses a declaration.
    pub fn declare(
        session: &zenoh::Session,
        node_name: &str,
        settings: &Network,
        static_transforms: &TFMessage,
    ) -> Result<Self, SinkError> {
        let node = NodeName {
            domain_id: settings.domain_id,
            namespace: settings.namespace.clone(),
            zenoh_id: session.zid().to_string(),
            node: node_name.to_owned(),
        };
        let node_token = declare_token(session, node.token())?;
        let mut endpoints = Vec::with_capacity(Topic::ALL.len());
        for topic in Topic::ALL {
            let (type_name, type_hash) = topic.message_type();
            let name = settings.topic(topic.name());
            let named = rmw::Topic::new(&name, type_name, type_hash, settings.profile);
            let token = named.token(&node, topic.index() + 1, topic.offer());
            let publisher = session
                .declare_publisher(named.key_expr(settings.domain_id))
                .congestion_control(CongestionControl::Drop)
                .express(true)
                .cache(CacheConfig::default().max_samples(settings.cached(topic)))
                .sample_miss_detection(MissDetectionConfig::default().heartbeat(HEARTBEAT))
                .publisher_detection()
                .wait()
                .map_err(|error| refused("declaring a publisher", &error))?;
            let gid = rmw::gid(&token);
            endpoints.push(Endpoint {
                publisher,
                gid,
                sequence: 0,
                _token: declare_token(session, token)?,
            });
        }
        let mut bytes = Vec::new();
        static_transforms.encode(&mut bytes);
        Ok(Self {
            endpoints,
            static_transforms: bytes,
            static_due: HostTime::EPOCH,
            _node: node_token,
        })
    }
}

impl ZenohSink {
    /// Publishes one message.
    ///
    /// # Errors
    /// Zenoh refuses it.
    pub fn put(&mut self, topic: Topic, payload: &[u8], at: HostTime) -> Result<(), SinkError> {
        match self.endpoints.get_mut(topic.index()) {
            Some(endpoint) => endpoint.put(payload, at.as_nanos()),
            None => Ok(()),
        }
    }

    /// Time went by: repeats what late comers need.
    ///
    /// # Errors
    /// As for [`ZenohSink::put`].
    pub fn tick(&mut self, now: HostTime) -> Result<(), SinkError> {
        if now < self.static_due {
            return Ok(());
        }
        self.static_due = now + STATIC_PERIOD;
        match self.endpoints.get_mut(Topic::TfStatic.index()) {
            Some(endpoint) => endpoint.put(&self.static_transforms, now.as_nanos()),
            None => Ok(()),
        }
    }
}

impl Endpoint {
    fn put(&mut self, payload: &[u8], source_ns: i64) -> Result<(), SinkError> {
        self.sequence += 1;
        let attachment = rmw::attachment(self.sequence, source_ns, self.gid);
        self.publisher
            .put(payload)
            .attachment(attachment.as_slice())
            .wait()
            .map_err(|error| refused("publishing", &error))
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
        why: error.to_string(),
    }
}
