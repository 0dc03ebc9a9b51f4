//! What a recorder asks over Zenoh; the answers go to its writer. Nothing waits here for an answer.

use std::time::Duration;

use crossbeam_channel::Sender;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget, Reply, ReplyKeyExpr};

use super::answer;
use super::file::Heard;
use super::sources::{ANSWER_WITHIN, Gid};
use crate::recovery;
use crate::session::control::Command;

/// How long an answer about the capture itself may take.
const METADATA_WITHIN: Duration = Duration::from_secs(3);

/// See the module.
#[derive(Debug)]
pub(super) struct Asking {
    session: zenoh::Session,
    answers: Sender<Heard>,
    name: String,
}

/// Tells when it is dropped: Zenoh drops a callback when the answer is complete, or is not in time.
struct TellsWhenDropped(Option<Gid>, Sender<Heard>);

impl Drop for TellsWhenDropped {
    fn drop(&mut self) {
        if let Some(gid) = self.0 {
            let _ = self.1.try_send(Heard::Answered(gid));
        }
    }
}

impl Asking {
    pub(super) fn new(session: &zenoh::Session, answers: Sender<Heard>) -> Self {
        Self {
            session: session.clone(),
            answers,
            name: session.zid().to_string(),
        }
    }

    /// Asks for the messages `first..=last`. What has no room in the queue is asked for again, as is what finds no network.
    pub(super) fn messages(&self, gid: Option<Gid>, publisher: &str, first: u32, last: u32) {
        let key = recovery::messages(publisher);
        let done = TellsWhenDropped(gid, self.answers.clone());
        self.get(
            format!("{key}?_sn={first}..{last}"),
            ANSWER_WITHIN,
            move |reply| {
                if let Ok(sample) = reply.into_result() {
                    let _ = done.1.try_send(Heard::Again(sample));
                }
            },
        );
    }

    /// Tells the publisher before which number nothing is needed, and hears which is the oldest that it has.
    pub(super) fn report(&self, gid: Gid, publisher: &str, before: Option<u32>) {
        let (key, by) = (recovery::have(publisher), &self.name);
        let (by_key, before_key) = (recovery::BY, recovery::BEFORE);
        let before = before.map_or_else(String::new, |number| format!(";{before_key}={number}"));
        let answers = self.answers.clone();
        self.get(
            format!("{key}?{by_key}={by}{before}"),
            ANSWER_WITHIN,
            move |reply| {
                let oldest = reply
                    .result()
                    .ok()
                    .and_then(|sample| recovery::number(&sample.payload().to_bytes()));
                if let Some(oldest) = oldest {
                    let _ = answers.try_send(Heard::Oldest(gid, oldest));
                }
            },
        );
    }

    /// Asks the capture `id` what a recording would say of itself.
    pub(super) fn metadata(&self, id: &str) {
        let (name, argument) = Command::Metadata.name_and_argument();
        let answers = self.answers.clone();
        // Without a connection there is no answer; then it is asked again.
        let _ = self
            .session
            .get(format!("ft_capture/{id}/{name}"))
            .payload(argument)
            .timeout(METADATA_WITHIN)
            .callback(move |reply| {
                if let Some(said) = answer(&reply) {
                    let _ = answers.try_send(Heard::Metadata(said));
                }
            })
            .wait();
    }

    fn get(
        &self,
        selector: String,
        within: Duration,
        take: impl Fn(Reply) + Send + Sync + 'static,
    ) {
        // Without a connection there is no answer; then it is asked again.
        let _ = self
            .session
            .get(selector)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .accept_replies(ReplyKeyExpr::Any)
            .congestion_control(CongestionControl::Block)
            .priority(Priority::DataLow)
            .timeout(within)
            .callback(take)
            .wait();
    }
}
