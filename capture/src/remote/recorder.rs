//! A recording made on another machine that loses nothing: what the network lost is asked for again, and what cannot be
//! had any more is counted.
//!
//! The publisher keeps its latest messages (`[network] cache_samples`) and numbers them ([`crate::recovery`]); a hole in the
//! numbers, or the publisher's heartbeat, makes the recorder ask for what is missing, until it has it or the publisher has it
//! no longer. So the file also begins with what the publisher still has from before, and a publisher that ends waits until its
//! recorders have everything.
//!
//! `log_time` is the source's `sample_time`, not this machine's: time is translated once, at the source.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Sender, bounded};
use ft_drivers::MonotonicClock;
use ft_recording::WriteError;
use ft_recording::writer::{RecordingWriter, WriterOptions};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;

use super::Remote;
use super::file::{File, Heard, Written};
pub use super::ledger::{RemoteLedger, RemoteSummary};
use crate::recovery;
use crate::sink::SinkError;

/// Messages that the file may be behind. What has no room is a hole like any other: it is asked for again.
const CAPACITY: usize = 65_536;

/// A recording of what a remote capture publishes.
#[derive(Debug)]
pub struct Recorder {
    subscribers: [Subscriber<()>; 2],
    bytes: Arc<AtomicU64>,
    ending: Arc<AtomicBool>,
    thread: JoinHandle<Result<Written, WriteError>>,
}

impl Recorder {
    /// Begins a recording of what `remote` watches in `path`, which is `path` with `.partial` behind until it is finished.
    ///
    /// # Errors
    /// The file cannot be created, or Zenoh refuses a subscription.
    pub fn begin(
        remote: &Arc<Remote>,
        path: &Path,
        overwrite: bool,
        clock: MonotonicClock,
    ) -> Result<Self, SinkError> {
        let options = WriterOptions {
            overwrite,
            flush_period: Duration::from_millis(100),
            ..WriterOptions::default()
        };
        let writer = RecordingWriter::create(path, &options)?;
        let (sender, heard) = bounded(CAPACITY);
        let bytes = Arc::new(AtomicU64::new(0));
        let ending = Arc::new(AtomicBool::new(false));
        let file = File::new(writer, remote, clock, sender.clone(), Arc::clone(&bytes));
        let over = Arc::clone(&ending);
        let thread = std::thread::Builder::new()
            .name("ft-writer".to_owned())
            .spawn(move || file.write_until_over(&heard, &over))
            .map_err(|source| SinkError::Zenoh {
                what: "starting the writer",
                why: source.to_string(),
            })?;
        Ok(Self {
            subscribers: subscribe(remote, &sender)?,
            bytes,
            ending,
            thread,
        })
    }

    /// Bytes in the file so far.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Whether the file could not be written on: [`Recorder::finish`] says why.
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.thread.is_finished()
    }

    /// Waits for what is still being asked for, and finishes the file.
    ///
    /// # Errors
    /// The disk refuses; what was flushed stays in the partial file.
    pub fn finish(self) -> Result<RemoteSummary, SinkError> {
        // No more comes by itself; what was lost last is still asked for.
        drop(self.subscribers);
        self.ending.store(true, Ordering::Release);
        let written = self.thread.join().map_err(|_| SinkError::Zenoh {
            what: "writing",
            why:
                "the writer panicked: please report this; what was flushed is in the .partial file"
                    .to_owned(),
        })??;
        Ok(RemoteSummary {
            path: written.finished.path,
            bytes: written.finished.bytes,
            topics: written.topics,
        })
    }
}

/// To the messages, and to the heartbeats of their publishers. Zenoh's threads never wait here.
fn subscribe(remote: &Remote, to: &Sender<Heard>) -> Result<[Subscriber<()>; 2], SinkError> {
    let key = remote.which().key_expr();
    let refused = |error: zenoh::Error| SinkError::Zenoh {
        what: "subscribing",
        why: crate::network::plainly(&error.to_string()),
    };
    let sender = to.clone();
    let messages = remote
        .session()
        .declare_subscriber(key.clone())
        .callback(move |sample| {
            let _ = sender.try_send(Heard::Live(sample));
        })
        .wait()
        .map_err(refused)?;
    let sender = to.clone();
    let heartbeats = remote
        .session()
        .declare_subscriber(recovery::heartbeats(&key))
        .callback(move |sample| {
            let publisher = recovery::of_heartbeat(sample.key_expr().as_str());
            let latest = recovery::number(&sample.payload().to_bytes());
            if let (Some(publisher), Some(latest)) = (publisher, latest) {
                let _ = sender.try_send(Heard::Heartbeat(publisher.to_owned(), latest));
            }
        })
        .wait()
        .map_err(refused)?;
    Ok([messages, heartbeats])
}
