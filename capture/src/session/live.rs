//! A session in real time: one thread for each link, one for the recording, one for the network.

use std::collections::BTreeMap;
use std::fs::File;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::writer::Finished;
use ft_wire::HostTime;
use serde_json::{Value, json};

use super::control::{Command, Control, Request};
use super::{FileSummary, Plan, SessionError, health, ledger_metadata, summarize};
use crate::channel::{Channel, Intake};
use crate::encode::static_transforms;
use crate::health::Health;
use crate::item::{Body, Item};
use crate::ledger::StreamCounters;
use crate::merge::Merge;
use crate::network;
use crate::open::{self, Connection};
use crate::queues::{Queues, queues};
use crate::session::link_loop::LinkThread;
use crate::sink::Sink;
use crate::sink::mcap::McapSink;
use crate::sink::zenoh::ZenohSink;
use crate::summary::Summary;

/// The operator's loop: marks, commands, diagnostics.
const OPERATOR_PERIOD: Duration = Duration::from_millis(20);
/// How long a sink sleeps when nothing comes.
const SINK_PERIOD: Duration = Duration::from_millis(20);
/// How long the writer waits for a slower link thread before it writes in order of arrival.
const MERGE_HOLD: Duration = Duration::from_millis(30);

/// What the session asks its surroundings, about 50 times a second.
pub trait Surroundings {
    /// Whether to end: Ctrl-C, SIGTERM, or a simulation that is over.
    fn wants_end(&mut self) -> bool;
    /// Operator's marks since the last call.
    fn marks(&mut self) -> Vec<(HostTime, String)>;
    /// Something happened that the operator may see.
    fn log(&mut self, line: &str);
    /// How it stands: time since the start, health, bytes in the file.
    fn progress(&mut self, elapsed: Duration, health: &Health, bytes: u64);
}

/// Runs a session until its surroundings end it, its duration is over, or a sink fails.
///
/// # Errors
/// A device cannot be opened at the start, or the recording or the network fails. What was recorded is kept.
pub fn run(
    plan: &Plan,
    clock: MonotonicClock,
    connections: Vec<Connection>,
    surroundings: &mut impl Surroundings,
) -> Result<Summary, SessionError> {
    let start = clock.now();
    let (queues, ends) = queues(plan.record.is_some(), plan.publish);
    let counters: Vec<_> = plan
        .config
        .devices
        .iter()
        .map(|_| Arc::new(StreamCounters::default()))
        .collect();
    let health = health(plan, &counters);
    let stop = Arc::new(AtomicBool::new(false));

    let network = plan
        .publish
        .then(|| Network::start(plan, clock, ends.publisher, surroundings))
        .transpose()?;
    let recorder = match (&plan.record, ends.writer) {
        (Some(path), Some(items)) => {
            let sink = McapSink::create(
                path,
                &plan.writer_options(),
                &plan.preamble(start, "monotonic, anchored once")?,
            )?;
            Some(Recorder::start(
                sink,
                items,
                clock,
                Duration::from_millis(plan.config.recording.sync_period_ms),
            )?)
        }
        _ => None,
    };
    let links = open_links(plan, clock, connections, &queues, &counters, &stop);
    let links = match links {
        Ok(links) => links,
        Err(error) => {
            stop.store(true, Ordering::Relaxed);
            drop(queues);
            return Err(abandon(plan, recorder, error));
        }
    };

    let mut operator = Operator {
        clock,
        start,
        queues,
        own: Arc::new(StreamCounters::default()),
        health,
        health_items: ends.health,
    };
    operator.attend(plan, network.as_ref(), recorder.as_ref(), surroundings);

    stop.store(true, Ordering::Relaxed);
    for link in links {
        link.join().map_err(|_| SessionError::Panicked("link"))?;
    }
    operator.take_health(surroundings);
    let Operator {
        health,
        own,
        queues,
        ..
    } = operator;
    drop(queues);
    let end = clock.now();
    let finished = recorder
        .map(|recorder| recorder.finish(&ledger_metadata(&health)))
        .transpose()?;
    if let Some(network) = network {
        network.finish()?;
    }
    let file = finished.map(|done| FileSummary {
        path: done.path,
        bytes: done.bytes,
        messages: done.messages,
    });
    Ok(summarize(&health, own.snapshot(), start, end, file))
}

/// The session could not begin: the empty partial file is of no use to anyone.
fn abandon(plan: &Plan, recorder: Option<Recorder>, error: SessionError) -> SessionError {
    if let (Some(recorder), Some(path)) = (recorder, &plan.record) {
        recorder.discard();
        let _ = std::fs::remove_file(ft_recording::writer::partial_path(path));
    }
    error
}

fn open_links(
    plan: &Plan,
    clock: MonotonicClock,
    connections: Vec<Connection>,
    queues: &Queues,
    counters: &[Arc<StreamCounters>],
    stop: &Arc<AtomicBool>,
) -> Result<Vec<JoinHandle<()>>, SessionError> {
    let mut threads = Vec::new();
    for (index, ((device, connection), counters)) in plan
        .config
        .devices
        .iter()
        .zip(connections)
        .zip(counters)
        .enumerate()
    {
        let link_delay = Duration::from_secs_f64(device.latency_us * 1e-6);
        let thread = LinkThread {
            clock,
            channel: Channel::new(index, queues.clone(), Arc::clone(counters), link_delay),
            counters: Arc::clone(counters),
            stop: Arc::clone(stop),
        };
        match open::spawn(device, connection, clock, thread) {
            Ok(handle) => threads.push(handle),
            Err(error) => {
                stop.store(true, Ordering::Relaxed);
                for started in threads {
                    let _ = started.join();
                }
                return Err(error);
            }
        }
    }
    Ok(threads)
}

/// What the main thread does while the others work.
struct Operator {
    clock: MonotonicClock,
    start: HostTime,
    queues: Queues,
    own: Arc<StreamCounters>,
    health: Health,
    health_items: Receiver<Item>,
}

impl Operator {
    fn attend(
        &mut self,
        plan: &Plan,
        network: Option<&Network>,
        recorder: Option<&Recorder>,
        surroundings: &mut impl Surroundings,
    ) {
        loop {
            let now = self.clock.now();
            let elapsed = now.saturating_since(self.start);
            let bytes = recorder.map_or(0, |recorder| recorder.bytes.load(Ordering::Relaxed));
            for (at, text) in surroundings.marks() {
                self.put(at, Body::Mark(text));
            }
            self.take_health(surroundings);
            if let Some(array) = self.health.poll(now) {
                self.put(now, Body::Diagnostics(Box::new(array)));
            }
            let mut stop = false;
            while let Some(request) = network.and_then(|network| network.control.poll()) {
                stop |= self.obey(request, elapsed, bytes, plan);
            }
            surroundings.progress(elapsed, &self.health, bytes);
            let over = plan.duration.is_some_and(|duration| elapsed >= duration);
            let failed = recorder.is_some_and(|recorder| recorder.thread.is_finished());
            if stop || over || failed || surroundings.wants_end() {
                return;
            }
            self.clock.wait_until(now + OPERATOR_PERIOD);
        }
    }

    fn put(&mut self, at: HostTime, body: Body) {
        self.queues.put(
            Item {
                device: None,
                arrival: at,
                sample_time: at,
                body,
            },
            &self.own,
        );
    }

    fn take_health(&mut self, surroundings: &mut impl Surroundings) {
        while let Ok(item) = self.health_items.try_recv() {
            if let Some(line) = self.health.take(&item) {
                surroundings.log(&line);
            }
        }
    }

    /// Carries a command out and answers; true when the session is to end.
    fn obey(&mut self, request: Request, elapsed: Duration, bytes: u64, plan: &Plan) -> bool {
        let now = self.clock.now();
        let mut marked = |text: String| {
            let reply = json!({"ok": true, "mark": text, "at_unix_ns": now.as_nanos()});
            self.put(now, Body::Mark(text));
            reply
        };
        let (reply, stop) = match request.command {
            Command::Status => (self.status(elapsed, bytes, plan), false),
            Command::Tare => (marked("tare".to_owned()), false),
            Command::Mark(text) => (marked(text), false),
            Command::Stop => (json!({"ok": true, "file": plan.record}), true),
        };
        // The asker may have given up.
        let _ = request.answer.try_send(reply);
        stop
    }

    fn status(&self, elapsed: Duration, bytes: u64, plan: &Plan) -> Value {
        json!({
            "ok": true,
            "id": plan.config.id,
            "recording": plan.record,
            "bytes": bytes,
            "elapsed_s": elapsed.as_secs_f64(),
            "streams": self.health.summary(),
        })
    }
}

/// The recording's two threads: one writes, one forces to the disk.
#[derive(Debug)]
struct Recorder {
    thread: JoinHandle<(McapSink, Result<(), crate::sink::SinkError>)>,
    syncer: JoinHandle<()>,
    end_sync: Sender<()>,
    bytes: Arc<AtomicU64>,
}

impl Recorder {
    fn start(
        mut sink: McapSink,
        items: Receiver<Item>,
        clock: MonotonicClock,
        sync_period: Duration,
    ) -> Result<Self, SessionError> {
        let file = sink.sync_handle()?;
        let bytes = Arc::new(AtomicU64::new(0));
        let shown = Arc::clone(&bytes);
        let (end_sync, ended) = bounded(1);
        let syncer = spawn("ft-sync", move || {
            sync_until_ended(&file, &ended, sync_period)
        })?;
        let thread = spawn("ft-writer", move || {
            let result = write_until_closed(&mut sink, &items, clock, &shown);
            (sink, result)
        })?;
        Ok(Self {
            thread,
            syncer,
            end_sync,
            bytes,
        })
    }

    /// Waits for the queue to run empty, writes the ledger and the index.
    fn finish(self, ledger: &BTreeMap<String, String>) -> Result<Finished, SessionError> {
        let (sink, result) = self
            .thread
            .join()
            .map_err(|_| SessionError::Panicked("writer"))?;
        let _ = self.end_sync.try_send(());
        self.syncer
            .join()
            .map_err(|_| SessionError::Panicked("sync"))?;
        result?;
        Ok(sink.finish(ledger)?)
    }

    fn discard(self) {
        let _ = self.end_sync.try_send(());
        let _ = self.thread.join();
        let _ = self.syncer.join();
    }
}

fn write_until_closed(
    sink: &mut McapSink,
    items: &Receiver<Item>,
    clock: MonotonicClock,
    bytes: &AtomicU64,
) -> Result<(), crate::sink::SinkError> {
    let mut merge = Merge::new(MERGE_HOLD);
    loop {
        let closed = match items.recv_timeout(SINK_PERIOD) {
            Ok(item) => {
                merge.push(item);
                items.try_iter().for_each(|item| merge.push(item));
                false
            }
            Err(RecvTimeoutError::Timeout) => false,
            Err(RecvTimeoutError::Disconnected) => true,
        };
        let now = clock.now();
        while let Some(item) = if closed {
            merge.pop_any()
        } else {
            merge.pop_due(now)
        } {
            sink.take(&item)?;
        }
        sink.tick(now)?;
        bytes.store(sink.bytes_written(), Ordering::Relaxed);
        if closed {
            return Ok(());
        }
    }
}

/// A failed sync is not reported here: the writer meets the same disk.
fn sync_until_ended(file: &File, ended: &Receiver<()>, period: Duration) {
    while ended.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
        let _ = file.sync_data();
    }
}

/// The network side: a thread that publishes, and the commands.
#[derive(Debug)]
struct Network {
    session: zenoh::Session,
    control: Control,
    publisher: JoinHandle<Result<(), crate::sink::SinkError>>,
}

impl Network {
    fn start(
        plan: &Plan,
        clock: MonotonicClock,
        items: Option<Receiver<Item>>,
        surroundings: &mut impl Surroundings,
    ) -> Result<Self, SessionError> {
        let opened = network::open(&plan.config.network)?;
        surroundings.log(&opened.how);
        let settings = &plan.config.network;
        let transforms = static_transforms(&plan.config.frames, clock.now());
        let node = format!("ft_capture_{}", plan.config.id.replace('-', "_"));
        let sink = ZenohSink::declare(
            &opened.session,
            &node,
            settings.domain_id,
            settings.profile,
            &transforms,
        )?;
        let control = Control::declare(&opened.session, &plan.config.id)?;
        let items = items.unwrap_or_else(crossbeam_channel::never);
        let publisher = spawn("ft-publisher", move || {
            publish_until_closed(sink, &items, clock)
        })?;
        Ok(Self {
            session: opened.session,
            control,
            publisher,
        })
    }

    fn finish(self) -> Result<(), SessionError> {
        use zenoh::Wait;
        self.publisher
            .join()
            .map_err(|_| SessionError::Panicked("publisher"))??;
        drop(self.control);
        // Closing only tells the others; a failure leaves nothing behind here.
        let _ = self.session.close().wait();
        Ok(())
    }
}

fn publish_until_closed(
    mut sink: ZenohSink,
    items: &Receiver<Item>,
    clock: MonotonicClock,
) -> Result<(), crate::sink::SinkError> {
    loop {
        match items.recv_timeout(SINK_PERIOD) {
            Ok(item) => sink.take(&item)?,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        sink.tick(clock.now())?;
    }
}

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, SessionError> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(work)
        .map_err(SessionError::Thread)
}
