//! The live topics, on Zenoh in rmw_zenoh's format: ROS 2 nodes and plain Zenoh programs see the same.

use std::time::Duration;

use ft_recording::message::{Message, TFMessage};
use ft_wire::HostTime;
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

use super::{Sink, SinkError};
use crate::encode::{Encoder, Topic};
use crate::item::Item;
use crate::rmw::{self, NodeName, Profile};

/// How often `/tf_static` is repeated: plain publishers have no cache for those who come late.
const STATIC_PERIOD: Duration = Duration::from_secs(1);

/// Publishes items. To be used from a thread that may wait: a put can take milliseconds.
#[derive(Debug)]
pub struct ZenohSink {
    endpoints: Vec<Endpoint>,
    encoder: Encoder,
    static_transforms: Vec<u8>,
    static_due: HostTime,
    _node: LivelinessToken,
}

#[derive(Debug)]
struct Endpoint {
    publisher: Publisher<'static>,
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
        domain_id: u32,
        profile: Profile,
        static_transforms: &TFMessage,
    ) -> Result<Self, SinkError> {
        let node = NodeName {
            domain_id,
            zenoh_id: session.zid().to_string(),
            node: node_name.to_owned(),
        };
        let node_token = declare_token(session, node.token())?;
        let mut endpoints = Vec::with_capacity(Topic::ALL.len());
        for topic in Topic::ALL {
            let (type_name, type_hash) = topic.message_type();
            let named = rmw::Topic::new(topic.name(), type_name, type_hash, profile);
            let token = named.token(&node, topic.index() + 1, topic.offer());
            let publisher = session
                .declare_publisher(named.key_expr(domain_id))
                .congestion_control(CongestionControl::Drop)
                .express(true)
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
            encoder: Encoder::default(),
            static_transforms: bytes,
            static_due: HostTime::EPOCH,
            _node: node_token,
        })
    }
}

impl Sink for ZenohSink {
    fn take(&mut self, item: &Item) -> Result<(), SinkError> {
        let endpoints = &mut self.endpoints;
        let source_ns = item.sample_time.as_nanos();
        self.encoder.encode(item, |topic, payload| {
            match endpoints.get_mut(topic.index()) {
                Some(endpoint) => endpoint.put(payload, source_ns),
                None => Ok(()),
            }
        })
    }

    fn tick(&mut self, now: HostTime) -> Result<(), SinkError> {
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
