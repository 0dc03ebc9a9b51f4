//! Commands from the network: `ft_capture/<id>/{status,tare,mark,stop}`, answered in JSON.

use crossbeam_channel::{Receiver, Sender, bounded};
use serde_json::{Value, json};
use zenoh::Wait;
use zenoh::query::{Query, Queryable};

use crate::sink::SinkError;

/// How many commands may wait.
const CAPACITY: usize = 64;
/// The longest mark, bytes.
const LONGEST_MARK: usize = 1024;
/// How long an answer may take.
const ANSWER_WITHIN: std::time::Duration = std::time::Duration::from_secs(2);

/// What was asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// How does it stand?
    Status,
    /// Note that the operator zeroes now; the raw values stay.
    Tare,
    /// Note this text at this instant.
    Mark(String),
    /// Finish the recording and end.
    Stop,
}

/// A command and where its answer goes.
#[derive(Debug)]
pub struct Request {
    /// What was asked.
    pub command: Command,
    /// Takes the answer.
    pub answer: Sender<Value>,
}

/// The declared queryables; dropping them ends the control.
#[derive(Debug)]
pub struct Control {
    requests: Receiver<Request>,
    _queryables: Vec<Queryable<()>>,
}

impl Control {
    /// Declares the queryables of the gripper `id`.
    ///
    /// # Errors
    /// Zenoh refuses a declaration.
    pub fn declare(session: &zenoh::Session, id: &str) -> Result<Self, SinkError> {
        let (sender, requests) = bounded(CAPACITY);
        let mut queryables = Vec::new();
        for name in ["status", "tare", "mark", "stop"] {
            let sender = sender.clone();
            let queryable = session
                .declare_queryable(format!("ft_capture/{id}/{name}"))
                .callback(move |query| answer(&query, name, &sender))
                .wait()
                .map_err(|error| SinkError::Zenoh {
                    what: "declaring a command",
                    why: error.to_string(),
                })?;
            queryables.push(queryable);
        }
        Ok(Self {
            requests,
            _queryables: queryables,
        })
    }

    /// The next request, if there is one.
    #[must_use]
    pub fn poll(&self) -> Option<Request> {
        self.requests.try_recv().ok()
    }
}

/// Runs in a thread of Zenoh's: hands the command over and waits for the answer.
fn answer(query: &Query, name: &str, sender: &Sender<Request>) {
    let text = query
        .payload()
        .and_then(|payload| payload.try_to_string().ok().map(|text| text.into_owned()));
    let reply = match parse(name, text) {
        Ok(command) => ask(command, sender),
        Err(error) => json!({"ok": false, "error": error}),
    };
    // The asker may be gone: then there is nobody to tell.
    let _ = query
        .reply(query.key_expr().clone(), reply.to_string())
        .wait();
}

fn parse(name: &str, text: Option<String>) -> Result<Command, String> {
    match name {
        "status" => Ok(Command::Status),
        "tare" => Ok(Command::Tare),
        "stop" => Ok(Command::Stop),
        _ => match text {
            Some(text) if text.is_empty() || text.len() > LONGEST_MARK => Err(format!(
                "the mark has {} bytes: 1 to {LONGEST_MARK}",
                text.len()
            )),
            Some(text) => Ok(Command::Mark(text)),
            None => Err("send the mark's text as the query's payload".to_owned()),
        },
    }
}

fn ask(command: Command, sender: &Sender<Request>) -> Value {
    let (answer, answered) = bounded(1);
    if sender.try_send(Request { command, answer }).is_err() {
        return json!({"ok": false, "error": "busy or ending: try again"});
    }
    answered.recv_timeout(ANSWER_WITHIN).unwrap_or_else(
        |_| json!({"ok": false, "error": "no answer within 2 s: the service is ending"}),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_needs_its_text() {
        assert_eq!(
            parse("mark", Some("grasp".to_owned())),
            Ok(Command::Mark("grasp".to_owned()))
        );
        assert!(parse("mark", None).is_err());
        assert!(parse("mark", Some(String::new())).is_err());
        assert!(parse("mark", Some("x".repeat(LONGEST_MARK + 1))).is_err());
        assert_eq!(parse("tare", None), Ok(Command::Tare));
    }
}
