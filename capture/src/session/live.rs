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
    let (mut queues, ends) = queues(plan.record.is_some(), plan.publish);
    let counters: Vec<_> = plan
        .config
        .devices
        .iter()
        .map(|_| Arc::new(StreamCounters::default()))
        .collect();
    let health = health(plan, &counters);
    let stop = Arc::new(AtomicBool::new(false));

    let network = start_network(plan, clock, ends.publisher, &mut queues, surroundings)?;
    let links = open_links(plan, clock, connections, &queues, &counters, &stop)?;
    let recorder = match start_recorder(plan, clock, start, ends.writer) {
        Ok(recorder) => recorder,
        Err(error) => {
            stop.store(true, Ordering::Relaxed);
            links.into_iter().for_each(|link| drop(link.join()));
            return Err(error);
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
    operator.attend(
        plan,
        network.as_ref(),
        recorder.as_ref(),
        &links,
        surroundings,
    );

    stop.store(true, Ordering::Relaxed);
    let panicked = links
        .into_iter()
        .filter_map(|link| link.join().err())
        .count();
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
        .map(|recorder| recorder.finish(&ledger_metadata(&health, own.snapshot())))
        .transpose()?;
    if let Some(network) = network {
        network.finish(surroundings);
    }
    if panicked > 0 {
        return Err(SessionError::Panicked("link"));
    }
    let file = finished.map(|done| FileSummary {
        path: done.path,
        bytes: done.bytes,
        messages: done.messages,
    });
    Ok(summarize(&health, own.snapshot(), start, end, file))
}

/// Without a network that was asked for there is no session; without the one that nobody asked for there is.
fn start_network(
    plan: &Plan,
    clock: MonotonicClock,
    items: Option<Receiver<Item>>,
    queues: &mut Queues,
    surroundings: &mut impl Surroundings,
) -> Result<Option<Network>, SessionError> {
    let Some(items) = items else { return Ok(None) };
    match Network::start(plan, clock, items, surroundings) {
        Ok(network) => Ok(Some(network)),
        Err(error) if plan.config.network.asks_for_nothing() => {
            surroundings.log(&format!("no live topics: {error}"));
            queues.close_publisher();
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

fn start_recorder(
    plan: &Plan,
    clock: MonotonicClock,
    start: HostTime,
    items: Option<Receiver<Item>>,
) -> Result<Option<Recorder>, SessionError> {
    let (Some(path), Some(items)) = (&plan.record, items) else {
        return Ok(None);
    };
    let preamble = plan.preamble(start, clock.anchor(), "monotonic, anchored once")?;
    let sink = McapSink::create(path, &plan.writer_options(), &preamble)?;
    let sync_period = Duration::from_millis(plan.config.recording.sync_period_ms);
    Recorder::start(sink, items, clock, sync_period).map(Some)
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
        links: &[JoinHandle<()>],
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
            let failed = recorder.is_some_and(|recorder| recorder.thread.is_finished())
                || links.iter().any(JoinHandle::is_finished);
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
    syncer: JoinHandle<std::io::Result<()>>,
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
        let synced = self
            .syncer
            .join()
            .map_err(|_| SessionError::Panicked("sync"))?;
        result?;
        let finished = sink.finish(ledger)?;
        synced.map_err(SessionError::Sync)?;
        Ok(finished)
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

/// The first failure is kept: the system reports a lost write once, and here it would be the one to hear of it.
fn sync_until_ended(file: &File, ended: &Receiver<()>, period: Duration) -> std::io::Result<()> {
    let mut first = Ok(());
    while ended.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
        first = first.and(file.sync_data());
    }
    first
}

/// The network side: a thread that publishes, and the commands.
#[derive(Debug)]
struct Network {
    session: zenoh::Session,
    control: Control,
    /// Gives the number of messages that Zenoh refused.
    publisher: JoinHandle<u64>,
}

impl Network {
    fn start(
        plan: &Plan,
        clock: MonotonicClock,
        items: Receiver<Item>,
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
        let publisher = spawn("ft-publisher", move || {
            publish_until_closed(sink, &items, clock)
        })?;
        Ok(Self {
            session: opened.session,
            control,
            publisher,
        })
    }

    /// What went wrong on the network is told; the recording has nothing to do with it.
    fn finish(self, surroundings: &mut impl Surroundings) {
        use zenoh::Wait;
        match self.publisher.join() {
            Ok(0) => {}
            Ok(refused) => surroundings.log(&format!("{refused} messages could not be published")),
            Err(_) => surroundings.log("the publisher thread panicked: please report this"),
        }
        drop(self.control);
        // Closing only tells the others; a failure leaves nothing behind here.
        let _ = self.session.close().wait();
    }
}

fn publish_until_closed(mut sink: ZenohSink, items: &Receiver<Item>, clock: MonotonicClock) -> u64 {
    let mut refused = 0;
    loop {
        let taken = match items.recv_timeout(SINK_PERIOD) {
            Ok(item) => sink.take(&item),
            Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => return refused,
        };
        refused += u64::from(taken.is_err()) + u64::from(sink.tick(clock.now()).is_err());
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
