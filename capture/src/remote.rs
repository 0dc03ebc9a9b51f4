//! A capture on another machine: its topics into a hub, its commands over Zenoh.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;
use serde_json::Value;
use zenoh::Wait;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample as ZenohSample;

use crate::live::{Hub, Sample};
use crate::rmw;
use crate::session::control::{Command, refusal};
use crate::sink::SinkError;
use crate::web::Operator;

mod asking;
mod file;
mod ledger;
mod missing;
pub mod recorder;
mod sources;

/// How long an answer to a command may be on its way, besides what the capture takes.
const ON_ITS_WAY: Duration = Duration::from_secs(1);
/// How long an answer to `status` may take; it is asked twice a second.
const STATUS_WITHIN: Duration = Duration::from_secs(2);

/// A capture that has not answered for this long is gone.
const FORGOTTEN: Duration = Duration::from_secs(10);
/// Captures that may answer in one domain and namespace.
const MOST_CAPTURES: usize = 256;

/// Which capture is looked at.
#[derive(Clone, Debug, Default)]
pub struct Which {
    /// `ROS_DOMAIN_ID`.
    pub domain_id: u32,
    /// Its topics' namespace, without slashes; empty = none.
    pub namespace: String,
    /// Its id; `None` = the first that answers in this domain and namespace.
    pub id: Option<String>,
}

impl Which {
    /// What to subscribe to.
    #[must_use]
    pub fn key_expr(&self) -> String {
        match self.namespace.as_str() {
            "" => format!("{}/**", self.domain_id),
            namespace => format!("{}/{namespace}/**", self.domain_id),
        }
    }

    /// Topic without the namespace, and type, of a key `<domain>/[<namespace>/]<topic>/<type>/<hash>`.
    #[must_use]
    pub fn split_key(&self, key: &str) -> Option<(String, String)> {
        let (rest, _hash) = key.rsplit_once('/')?;
        let (rest, dds_type) = rest.rsplit_once('/')?;
        let (_domain, topic) = rest.split_once('/')?;
        let topic = match self.namespace.as_str() {
            "" => topic,
            namespace => topic.strip_prefix(namespace)?.strip_prefix('/')?,
        };
        Some((format!("/{topic}"), rmw::ros_type(dds_type)?))
    }

    fn answers(&self, status: &Value) -> bool {
        let wanted = self
            .id
            .as_ref()
            .is_none_or(|id| status["id"] == id.as_str());
        wanted
            && status["domain_id"] == self.domain_id
            && status["namespace"] == self.namespace.as_str()
    }
}

/// The connection to a capture.
#[derive(Debug)]
pub struct Remote {
    session: zenoh::Session,
    which: Which,
    hub: Arc<Hub>,
    clock: MonotonicClock,
    /// When every capture last answered.
    known: Arc<Mutex<BTreeMap<String, HostTime>>>,
    _subscriber: Subscriber<()>,
}

impl Remote {
    /// Subscribes to `which` and feeds `hub`.
    ///
    /// # Errors
    /// Zenoh refuses the subscription.
    pub fn watch(
        session: zenoh::Session,
        which: Which,
        hub: Arc<Hub>,
        clock: MonotonicClock,
    ) -> Result<Self, SinkError> {
        let (to, reader) = (Arc::clone(&hub), which.clone());
        let subscriber = session
            .declare_subscriber(which.key_expr())
            .callback(move |sample| feed(&to, &reader, &sample))
            .wait()
            .map_err(|error| SinkError::Zenoh {
                what: "subscribing",
                why: crate::network::plainly(&error.to_string()),
            })?;
        Ok(Self {
            session,
            which,
            hub,
            clock,
            known: Arc::default(),
            _subscriber: subscriber,
        })
    }

    /// Asks how the capture stands; the answer reaches the hub when it comes. To be called about twice a second.
    pub fn ask_status(&self) {
        let (known, hub, which, clock) = (
            Arc::clone(&self.known),
            Arc::clone(&self.hub),
            self.which.clone(),
            self.clock,
        );
        let id = self.which.id.as_deref().unwrap_or("*");
        // Without a connection there is no answer, and the page says so.
        let _ = self
            .session
            .get(format!("ft_capture/{id}/status"))
            .timeout(STATUS_WITHIN)
            .callback(move |reply| {
                let Some(status) = answer(&reply).filter(|status| which.answers(status)) else {
                    return;
                };
                let now = clock.now();
                let mut known = known.lock().unwrap_or_else(PoisonError::into_inner);
                known.retain(|_, then| now.saturating_since(*then) < FORGOTTEN);
                let id = status["id"].as_str().unwrap_or_default().to_owned();
                if known.len() < MOST_CAPTURES {
                    known.insert(id.clone(), now);
                }
                if known.keys().next() == Some(&id) {
                    hub.set_status(status, now);
                }
            })
            .wait();
    }

    /// The ids of the captures that answered, sorted; the first is looked at.
    #[must_use]
    pub fn ids(&self) -> Vec<String> {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.keys().cloned().collect()
    }

    /// What is looked at.
    #[must_use]
    pub const fn which(&self) -> &Which {
        &self.which
    }

    /// The session.
    #[must_use]
    pub const fn session(&self) -> &zenoh::Session {
        &self.session
    }
}

impl Operator for Remote {
    fn ask(&self, command: Command) -> Value {
        let Some(id) = self.ids().into_iter().next() else {
            return refusal(
                "no capture answers: is it running, and is this viewer allowed to ask?",
            );
        };
        ask(&self.session, &id, &command)
    }
}

/// Sends `command` to the capture `id` and waits for its answer.
#[must_use]
pub fn ask(session: &zenoh::Session, id: &str, command: &Command) -> Value {
    let (name, argument) = command.name_and_argument();
    let wait = command.answer_within() + ON_ITS_WAY;
    let asked = session
        .get(format!("ft_capture/{id}/{name}"))
        .payload(argument)
        .timeout(wait)
        .wait();
    match asked {
        Ok(replies) => replies
            .recv_timeout(wait)
            .ok()
            .flatten()
            .and_then(|reply| answer(&reply))
            .unwrap_or_else(|| refusal("no answer: this viewer may not be allowed to command")),
        Err(error) => refusal(&error.to_string()),
    }
}

fn answer(reply: &zenoh::query::Reply) -> Option<Value> {
    serde_json::from_slice(&reply.result().ok()?.payload().to_bytes()).ok()
}

fn feed(hub: &Hub, which: &Which, sample: &ZenohSample) {
    let Some((topic, type_name)) = which.split_key(sample.key_expr().as_str()) else {
        return;
    };
    let attachment = sample
        .attachment()
        .and_then(|bytes| rmw::read_attachment(&bytes.to_bytes()));
    let Some(attachment) = attachment else { return };
    hub.take(&Sample {
        topic: &topic,
        type_name: &type_name,
        payload: &sample.payload().to_bytes(),
        at: HostTime::from_nanos(attachment.source_ns),
        numbered: Some((attachment.gid, attachment.sequence)),
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "0/ft/wrench/geometry_msgs::msg::dds_::WrenchStamped_/RIHS01_8d";

    #[test]
    fn topic_and_type_come_out_of_the_key() {
        let which = Which::default();
        assert_eq!(
            which.split_key(KEY),
            Some((
                "/ft/wrench".to_owned(),
                "geometry_msgs/msg/WrenchStamped".to_owned()
            ))
        );
        assert_eq!(which.split_key("0/ft/wrench"), None);
    }

    #[test]
    fn of_several_grippers_one_is_looked_at_by_its_namespace() {
        let which = Which {
            namespace: "blue".to_owned(),
            ..Which::default()
        };
        assert_eq!(which.key_expr(), "0/blue/**");
        let key = KEY.replace("0/ft", "0/blue/ft");
        assert_eq!(which.split_key(&key).unwrap().0, "/ft/wrench");
        assert_eq!(which.split_key(KEY), None);
        let status = |namespace: &str| serde_json::json!({"id": "a", "domain_id": 0, "namespace": namespace});
        assert!(which.answers(&status("blue")) && !which.answers(&status("")));
    }
}
