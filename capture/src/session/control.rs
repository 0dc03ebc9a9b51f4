//! Commands to a session: `status`, `tare`, `mark`, `start` and `stop`, answered in JSON, whoever sends them.
//!
//! Over Zenoh they are queries on `ft_capture/<id>/<command>`; the argument, where there is one, is the payload.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use serde_json::{Value, json};
use zenoh::Wait;
use zenoh::query::{Query, Queryable};

use crate::sink::SinkError;

/// How many commands may wait.
const CAPACITY: usize = 64;
/// The longest argument, bytes.
const LONGEST: usize = 1024;
/// How long an answer may take.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);
/// How long an answer to `stop` may take, which comes when the file is on the disk.
const STOPPED_WITHIN: Duration = Duration::from_secs(15);

/// The names of the commands, as they stand in keys and addresses.
pub const NAMES: [&str; 5] = ["status", "tare", "mark", "start", "stop"];

/// What was asked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// How does it stand?
    Status,
    /// How does it stand, and what would a recording say of itself?
    Metadata,
    /// Note that the operator zeroes now; the raw values stay.
    Tare,
    /// Note this text at this instant.
    Mark(String),
    /// Begin a recording, in a file of this name beside where the session writes; `None` names it after the time.
    Start(Option<String>),
    /// Finish the recording; one that the command line began ends the session too.
    Stop,
}

impl Command {
    /// The command `name` with its argument.
    ///
    /// # Errors
    /// A line that says what is wanted instead.
    pub fn parse(name: &str, argument: Option<&str>) -> Result<Self, String> {
        let argument = argument.filter(|text| !text.is_empty());
        if let Some(text) = argument.filter(|text| text.len() > LONGEST) {
            return Err(format!(
                "the argument has {} bytes: at most {LONGEST}",
                text.len()
            ));
        }
        match (name, argument) {
            ("status", Some("metadata")) => Ok(Self::Metadata),
            ("status", _) => Ok(Self::Status),
            ("tare", _) => Ok(Self::Tare),
            ("mark", Some(text)) => Ok(Self::Mark(text.to_owned())),
            ("mark", None) => Err("send the mark's text as the payload".to_owned()),
            ("start", Some(name)) => file_name(name).map(|name| Self::Start(Some(name))),
            ("start", None) => Ok(Self::Start(None)),
            ("stop", _) => Ok(Self::Stop),
            _ => Err(format!("no such command: one of {}", NAMES.join(", "))),
        }
    }
}

impl Command {
    /// How long its answer may take, here; whoever asks from elsewhere waits longer.
    #[must_use]
    pub const fn answer_within(&self) -> Duration {
        match self {
            Self::Stop => STOPPED_WITHIN,
            _ => ANSWER_WITHIN,
        }
    }

    /// As it is sent.
    #[must_use]
    pub fn name_and_argument(&self) -> (&'static str, &str) {
        match self {
            Self::Status => ("status", ""),
            Self::Metadata => ("status", "metadata"),
            Self::Tare => ("tare", ""),
            Self::Mark(text) => ("mark", text),
            Self::Start(name) => ("start", name.as_deref().unwrap_or_default()),
            Self::Stop => ("stop", ""),
        }
    }
}

/// Nobody on the network chooses a folder.
fn file_name(name: &str) -> Result<String, String> {
    let plain = name
        .chars()
        .all(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_'));
    if !plain || name.starts_with('.') || name.len() > 128 {
        return Err(format!(
            "{name:?}: letters, digits, - _ and . make a file's name, at most 128 of them, without a folder"
        ));
    }
    Ok(match name.strip_suffix(".mcap") {
        Some(_) => name.to_owned(),
        None => format!("{name}.mcap"),
    })
}

/// A command and where its answer goes.
#[derive(Debug)]
pub struct Request {
    /// What was asked.
    pub command: Command,
    /// Takes the answer.
    pub answer: Sender<Value>,
}

/// Who may ask the session.
#[derive(Clone, Debug)]
pub struct Commands(Sender<Request>);

impl Commands {
    /// A way to ask, and where the session finds what was asked.
    #[must_use]
    pub fn new() -> (Self, Receiver<Request>) {
        let (sender, requests) = bounded(CAPACITY);
        (Self(sender), requests)
    }

    /// Asks and waits for the answer, as long as [`Command::answer_within`] says: an object with `ok`, and `error` when that is false.
    #[must_use]
    pub fn ask(&self, command: Command) -> Value {
        let (answer, answered) = bounded(1);
        let wait = command.answer_within();
        if self.0.try_send(Request { command, answer }).is_err() {
            return refusal("busy or ending: try again");
        }
        answered
            .recv_timeout(wait)
            .unwrap_or_else(|error| match error {
                RecvTimeoutError::Timeout => refusal(&format!(
                    "no answer within {} s: it may still be carried out",
                    wait.as_secs()
                )),
                RecvTimeoutError::Disconnected => refusal("the service is ending"),
            })
    }
}

/// The answer to a command that was not carried out.
#[must_use]
pub fn refusal(error: &str) -> Value {
    json!({"ok": false, "error": error})
}

/// Declares the queryables of the gripper `id` and starts the thread that carries commands out; dropping them ends the control.
///
/// # Errors
/// Zenoh refuses a declaration.
pub fn declare(
    session: &zenoh::Session,
    id: &str,
    commands: &Commands,
) -> Result<Vec<Queryable<()>>, SinkError> {
    let (sender, queries) = bounded::<(Query, &str)>(CAPACITY);
    let commands = commands.clone();
    std::thread::Builder::new()
        .name("ft-commands".to_owned())
        .spawn(move || {
            while let Ok((query, name)) = queries.recv() {
                answer(&query, name, &commands);
            }
        })
        .map_err(|error| SinkError::Zenoh {
            what: "starting the thread of the commands",
            why: error.to_string(),
        })?;
    NAMES
        .into_iter()
        .map(|name| {
            let sender = sender.clone();
            session
                .declare_queryable(format!("ft_capture/{id}/{name}"))
                .callback(move |query| {
                    // Zenoh's own threads do not wait: who floods gets no answer.
                    let _ = sender.try_send((query, name));
                })
                .wait()
                .map_err(|error| SinkError::Zenoh {
                    what: "declaring a command",
                    why: crate::network::plainly(&error.to_string()),
                })
        })
        .collect()
}

/// Hands the command over and waits for the answer.
fn answer(query: &Query, name: &str, commands: &Commands) {
    let text = query.payload().map(|payload| payload.try_to_string());
    let reply = match text.transpose() {
        Ok(text) => match Command::parse(name, text.as_deref()) {
            Ok(command) => commands.ask(command),
            Err(error) => refusal(&error),
        },
        Err(_) => refusal("the payload is no UTF-8 text"),
    };
    // The asker may be gone: then there is nobody to tell.
    let _ = query
        .reply(query.key_expr().clone(), reply.to_string())
        .wait();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_needs_its_text() {
        assert_eq!(
            Command::parse("mark", Some("grasp")),
            Ok(Command::Mark("grasp".to_owned()))
        );
        assert!(Command::parse("mark", None).is_err());
        assert!(Command::parse("mark", Some("")).is_err());
        assert!(Command::parse("mark", Some(&"x".repeat(LONGEST + 1))).is_err());
        assert_eq!(Command::parse("tare", None), Ok(Command::Tare));
        assert!(Command::parse("format", None).is_err());
    }

    #[test]
    fn nobody_on_the_network_chooses_a_folder() {
        assert_eq!(
            Command::parse("start", Some("door-2")),
            Ok(Command::Start(Some("door-2.mcap".to_owned())))
        );
        assert_eq!(Command::parse("start", None), Ok(Command::Start(None)));
        for name in ["../door", "/tmp/door", ".door", "a b", "door\0", "~root"] {
            assert!(Command::parse("start", Some(name)).is_err(), "{name}");
        }
    }

    #[test]
    fn a_slow_disk_may_take_longer_to_stop_than_a_status() {
        let (commands, requests) = Commands::new();
        let session = std::thread::spawn(move || {
            let request: Request = requests.recv().unwrap();
            #[allow(clippy::disallowed_methods, reason = "a disk takes its time")]
            std::thread::sleep(ANSWER_WITHIN + Duration::from_millis(200));
            request.answer.send(json!({"ok": true})).unwrap();
        });
        assert_eq!(commands.ask(Command::Stop)["ok"], true);
        session.join().unwrap();
    }

    #[test]
    fn who_asks_a_session_that_is_over_is_told() {
        let (commands, requests) = Commands::new();
        drop(requests);
        assert_eq!(commands.ask(Command::Status)["ok"], false);
    }
}
