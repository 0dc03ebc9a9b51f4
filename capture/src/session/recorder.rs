//! The recording of a session: a thread that writes and one that forces to the disk.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;

use super::{Baseline, FileSummary, Plan, SessionError, spawn};
use crate::item::Item;
use crate::merge::Merge;
use crate::queues::Queues;
use crate::sink::mcap::McapSink;
use crate::sink::{Sink, SinkError};

/// How long the writer sleeps when nothing comes; also how long it must be quiet after the end.
const QUIET: Duration = Duration::from_millis(20);
/// How long the writer waits for a slower link thread before it writes in order of arrival.
const MERGE_HOLD: Duration = Duration::from_millis(30);

/// What ended when the recording ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Begun {
    /// By the command line: its end is the session's end.
    WithTheSession,
    /// By the command `start`: the session goes on without it.
    ByCommand,
}

/// A recording that is being written.
#[derive(Debug)]
pub(super) struct Recorder {
    /// The file as it will be named.
    pub(super) path: PathBuf,
    /// How it came about.
    pub(super) begun: Begun,
    /// When.
    pub(super) since: HostTime,
    /// What had been counted before.
    pub(super) before: Baseline,
    thread: JoinHandle<(McapSink, Result<(), SinkError>)>,
    syncer: JoinHandle<std::io::Result<()>>,
    end_sync: Sender<()>,
    ending: Arc<AtomicBool>,
    bytes: Arc<AtomicU64>,
}

/// What a recording needs of its session.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source<'a> {
    pub(super) plan: &'a Plan,
    pub(super) clock: MonotonicClock,
    pub(super) queues: &'a Queues,
    pub(super) items: &'a Receiver<Item>,
}

impl Recorder {
    /// Creates the file and opens the way to it.
    pub(super) fn begin(
        source: Source<'_>,
        path: &Path,
        since: HostTime,
        begun: Begun,
        before: Baseline,
    ) -> Result<Self, SessionError> {
        let Source { plan, clock, .. } = source;
        let preamble = plan.preamble(since, clock.anchor(), "monotonic, anchored once")?;
        let mut sink = McapSink::create(path, &plan.writer_options(), &preamble)?;
        let file = sink.sync_handle()?;
        let sync_period = Duration::from_millis(plan.config.recording.sync_period_ms);
        let (bytes, ending) = (
            Arc::new(AtomicU64::new(0)),
            Arc::new(AtomicBool::new(false)),
        );
        let (end_sync, ended) = bounded(1);
        let syncer = spawn("ft-sync", move || {
            sync_until_ended(&file, &ended, sync_period)
        })?;
        // What a link thread was still putting when the last recording ended belongs to none.
        if begun == Begun::ByCommand {
            source.items.try_iter().for_each(drop);
        }
        source.queues.set_recording(true);
        let (items, shown, end) = (
            source.items.clone(),
            Arc::clone(&bytes),
            Arc::clone(&ending),
        );
        let thread = spawn("ft-writer", move || {
            let result = write_until_ended(&mut sink, &items, clock, &shown, &end);
            (sink, result)
        })?;
        Ok(Self {
            path: path.to_owned(),
            begun,
            since,
            before,
            thread,
            syncer,
            end_sync,
            ending,
            bytes,
        })
    }

    /// Bytes in the file so far.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// Whether the writer gave up: [`Recorder::finish`] says why.
    pub(super) fn has_failed(&self) -> bool {
        self.thread.is_finished()
    }

    /// Closes the way to the file, waits for the queue to run empty, writes the ledger and the index.
    pub(super) fn finish(
        self,
        queues: &Queues,
        ended: HostTime,
        ledger: &BTreeMap<String, String>,
    ) -> Result<FileSummary, SessionError> {
        queues.set_recording(false);
        self.ending.store(true, Ordering::Release);
        let (sink, result) = self
            .thread
            .join()
            .map_err(|_| SessionError::Panicked("writer"))?;
        let _ = self.end_sync.try_send(());
        let synced = self
            .syncer
            .join()
            .map_err(|_| SessionError::Panicked("sync"))?;
        result?;
        let done = sink.finish(ledger)?;
        synced.map_err(SessionError::Sync)?;
        Ok(FileSummary {
            path: done.path,
            duration_s: ended.seconds_since(self.since),
            bytes: done.bytes,
            messages: done.messages,
        })
    }
}

fn write_until_ended(
    sink: &mut McapSink,
    items: &Receiver<Item>,
    clock: MonotonicClock,
    bytes: &AtomicU64,
    ending: &AtomicBool,
) -> Result<(), SinkError> {
    let mut merge = Merge::new(MERGE_HOLD);
    loop {
        // Read before the queue: what was put before the end is then found in it.
        let ending = ending.load(Ordering::Acquire);
        let over = match items.recv_timeout(QUIET) {
            Ok(item) => {
                merge.push(item);
                items.try_iter().for_each(|item| merge.push(item));
                false
            }
            Err(RecvTimeoutError::Timeout) => ending,
            Err(RecvTimeoutError::Disconnected) => true,
        };
        let now = clock.now();
        while let Some(item) = if over {
            merge.pop_any()
        } else {
            merge.pop_due(now)
        } {
            sink.take(&item)?;
        }
        sink.tick(now)?;
        bytes.store(sink.bytes_written(), Ordering::Relaxed);
        if over {
            return Ok(());
        }
    }
}

/// The first failure is kept: the system reports a lost write once, and here it would be the one to hear of it.
fn sync_until_ended(file: &File, ended: &Receiver<()>, period: Duration) -> std::io::Result<()> {
    let mut first = Ok(());
    while ended.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
        first = first.and(file.sync_data());
    }
    first
}
