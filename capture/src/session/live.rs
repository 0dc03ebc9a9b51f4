//! A session in real time: one thread for each link, one for the recording, one for the network.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::Receiver;
use ft_drivers::priority::SharedProcessor;
use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;
use serde_json::{Value, json};

use super::control::{Command, Commands, Request, refusal};
use super::publisher::Publisher;
use super::recorder::{Begun, Recorder, Source};
use super::{Baseline, FileSummary, Plan, SessionError, health, ledger_metadata, summarize};
use crate::channel::{Channel, Intake};
use crate::health::Health;
use crate::item::{Body, Item};
use crate::ledger::StreamCounters;
use crate::open::{self, Connection};
use crate::queues::{Queues, queues};
use crate::session::link_loop::LinkThread;
use crate::summary::Summary;
use crate::zenoh_link;

/// The operator's loop: marks, commands, diagnostics.
const OPERATOR_PERIOD: Duration = Duration::from_millis(20);
/// How often this program's own viewers hear how it stands.
const STATUS_PERIOD: Duration = Duration::from_millis(250);

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
/// No device can be opened at the start, or one is there and will not open (a missing permission, a name that is not written as one),
/// or the recording or the network fails. A name of nothing, be it mistyped, is tried on and told. What was recorded is kept.
pub fn run(
    plan: &Plan,
    clock: MonotonicClock,
    connections: Vec<Connection>,
    surroundings: &mut impl Surroundings,
) -> Result<Summary, SessionError> {
    let start = clock.now();
    let (mut queues, ends) = queues(plan.publish);
    let counters: Vec<_> = plan
        .config
        .devices
        .iter()
        .map(|_| Arc::new(StreamCounters::default()))
        .collect();
    let health = health(plan, &counters);
    let stop = Arc::new(AtomicBool::new(false));
    let (commands, requests) = Commands::new();

    let publisher = Publisher::start(
        plan,
        clock,
        ends.publisher,
        &commands,
        &mut queues,
        surroundings,
    )?;
    // What devices say at their set-up waits in the queue until the file is there.
    queues.set_recording(plan.record.is_some());
    let connections = through_network(plan, connections, publisher.session())?;
    let shared = publisher.processor();
    let links = open_links(plan, clock, connections, &queues, &counters, &stop, shared)?;
    let mut operator = Operator {
        plan,
        clock,
        start,
        queues,
        items: ends.writer,
        own: Arc::new(StreamCounters::default()),
        health,
        health_items: ends.health,
        requests,
        recorder: None,
        files: Vec::new(),
        failed: None,
    };
    let attended = operator.attend(&links, &publisher, surroundings);

    stop.store(true, Ordering::Relaxed);
    let panicked = links
        .into_iter()
        .filter_map(|link| link.join().err())
        .count();
    let summary = attended.and_then(|()| operator.end(surroundings));
    publisher.finish(clock, surroundings);
    if panicked > 0 {
        return Err(SessionError::Panicked("link"));
    }
    summary
}

/// Devices whose port is a key come through the session.
fn through_network(
    plan: &Plan,
    connections: Vec<Connection>,
    network: Option<&zenoh::Session>,
) -> Result<Vec<Connection>, SessionError> {
    let named = plan.config.devices.iter().zip(connections);
    named
        .map(|(device, connection)| match (&connection, network) {
            (Connection::Configured, _) if !device.port.starts_with(zenoh_link::PREFIX) => {
                Ok(connection)
            }
            (Connection::Configured, Some(session)) => Ok(Connection::Network(session.clone())),
            (Connection::Configured, None) => Err(SessionError::NoNetwork {
                device: device.name.clone(),
                port: device.port.clone(),
            }),
            _ => Ok(connection),
        })
        .collect()
}

fn open_links(
    plan: &Plan,
    clock: MonotonicClock,
    connections: Vec<Connection>,
    queues: &Queues,
    counters: &[Arc<StreamCounters>],
    stop: &Arc<AtomicBool>,
    processor: Option<&SharedProcessor>,
) -> Result<Vec<JoinHandle<()>>, SessionError> {
    let (mut threads, mut closed) = (Vec::new(), Vec::new());
    let stopped = |threads: Vec<JoinHandle<()>>, error| {
        stop.store(true, Ordering::Relaxed);
        for started in threads {
            let _ = started.join();
        }
        Err(error)
    };
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
            channel: Channel::new(index, queues.clone(), Arc::clone(counters), link_delay)
                .sampling_evenly(device.driver.samples_evenly()),
            counters: Arc::clone(counters),
            stop: Arc::clone(stop),
            processor: processor.cloned(),
        };
        match open::spawn(device, connection, clock, thread) {
            Ok(started) => {
                threads.push(started.thread);
                closed.extend(started.closed.map(|why| format!("{}: {why}", device.name)));
            }
            Err(error) => return stopped(threads, error),
        }
    }
    if closed.len() == threads.len() {
        let reasons = closed.join("; ");
        return stopped(threads, SessionError::NoDevice { reasons });
    }
    Ok(threads)
}

/// What the main thread does while the others work.
struct Operator<'a> {
    plan: &'a Plan,
    clock: MonotonicClock,
    start: HostTime,
    queues: Queues,
    items: Receiver<Item>,
    own: Arc<StreamCounters>,
    health: Health,
    health_items: Receiver<Item>,
    requests: Receiver<Request>,
    recorder: Option<Recorder>,
    files: Vec<FileSummary>,
    failed: Option<SessionError>,
}

impl Operator<'_> {
    /// Runs until something ends the session; an error only when the command line's recording cannot begin.
    fn attend(
        &mut self,
        links: &[JoinHandle<()>],
        publisher: &Publisher,
        surroundings: &mut impl Surroundings,
    ) -> Result<(), SessionError> {
        let mut status_due = self.start;
        if let Some(path) = self.plan.record.clone() {
            self.begin(
                &path,
                self.start,
                Begun::WithTheSession,
                Baseline::default(),
            )?;
            surroundings.log(&format!("recording {}", path.display()));
        }
        loop {
            let now = self.clock.now();
            let elapsed = now.saturating_since(self.start);
            for (at, text) in surroundings.marks() {
                self.put(at, Body::Mark(text));
            }
            self.take_health(surroundings);
            if let Some(array) = self.health.poll(now) {
                self.put(now, Body::Diagnostics(Box::new(array)));
                if let Some(processor) = publisher.processor() {
                    processor.look();
                }
            }
            let mut stop = false;
            while let Ok(request) = self.requests.try_recv() {
                stop |= self.obey(request, surroundings);
            }
            if now >= status_due && publisher.has_viewers() {
                status_due = now + STATUS_PERIOD;
                publisher.set_status(self.status(), now);
            }
            publisher.tick(now);
            surroundings.progress(elapsed, &self.health, self.bytes());
            let over = self
                .plan
                .duration
                .is_some_and(|duration| elapsed >= duration);
            let failed =
                self.take_failure(surroundings) || links.iter().any(JoinHandle::is_finished);
            if stop || over || failed || surroundings.wants_end() {
                return Ok(());
            }
            self.clock.wait_until(now + OPERATOR_PERIOD);
        }
    }

    /// The link threads have ended: what they left is taken, the recording finished.
    fn end(mut self, surroundings: &mut impl Surroundings) -> Result<Summary, SessionError> {
        self.take_health(surroundings);
        let end = self.clock.now();
        if let Err(error) = self.finish() {
            self.failed.get_or_insert(error);
        }
        match self.failed {
            Some(error) => Err(error),
            None => {
                let own = self.own.snapshot();
                Ok(summarize(&self.health, own, self.start, end, self.files))
            }
        }
    }

    fn begin(
        &mut self,
        path: &Path,
        since: HostTime,
        begun: Begun,
        before: Baseline,
    ) -> Result<(), SessionError> {
        let source = Source {
            plan: self.plan,
            clock: self.clock,
            queues: &self.queues,
            items: &self.items,
        };
        self.recorder = Some(Recorder::begin(source, path, since, begun, before)?);
        Ok(())
    }

    /// Finishes the recording, if there is one.
    fn finish(&mut self) -> Result<Option<&FileSummary>, SessionError> {
        let Some(recorder) = self.recorder.take() else {
            return Ok(None);
        };
        let ledger = ledger_metadata(&self.health, self.own.snapshot(), &recorder.before);
        let file = recorder.finish(&self.queues, self.clock.now(), &ledger)?;
        self.files.push(file);
        Ok(self.files.last())
    }

    /// A recording that failed ends the session that it began with; one begun by command only itself. Either is an
    /// error at the end.
    fn take_failure(&mut self, surroundings: &mut impl Surroundings) -> bool {
        let Some(begun) = self
            .recorder
            .as_ref()
            .filter(|recorder| recorder.has_failed())
            .map(|recorder| recorder.begun)
        else {
            return false;
        };
        if let Err(error) = self.finish() {
            surroundings.log(&format!("the recording failed: {error}"));
            self.failed.get_or_insert(error);
        }
        begun == Begun::WithTheSession
    }

    fn put(&mut self, at: HostTime, body: Body) {
        self.queues.put(
            Item {
                device: None,
                arrival: at,
                clock_epoch: 0,
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
    fn obey(&mut self, request: Request, surroundings: &mut impl Surroundings) -> bool {
        let mut end = false;
        let reply = match request.command {
            Command::Status => self.status(),
            Command::Metadata => self.metadata(),
            Command::Tare => self.mark("tare"),
            Command::Mark(text) => self.mark(&text),
            Command::Start(name) => self.start(name, surroundings),
            Command::Stop => {
                end = self
                    .recorder
                    .as_ref()
                    .is_some_and(|recorder| recorder.begun == Begun::WithTheSession);
                self.stop(end, surroundings)
            }
        };
        // The asker may have given up.
        let _ = request.answer.try_send(reply);
        end
    }

    fn mark(&mut self, text: &str) -> Value {
        let now = self.clock.now();
        self.put(now, Body::Mark(text.to_owned()));
        json!({"ok": true, "mark": text, "at_unix_ns": now.as_nanos()})
    }

    fn start(&mut self, name: Option<String>, surroundings: &mut impl Surroundings) -> Value {
        if let Some(recorder) = &self.recorder {
            return refusal(&format!(
                "{} is being recorded: stop first",
                recorder.path.display()
            ));
        }
        let now = self.clock.now();
        let name = name.unwrap_or_else(|| {
            let seconds = now.as_nanos() / 1_000_000_000;
            format!("{}-{seconds}.mcap", self.plan.config.id)
        });
        let path = self.folder().join(name);
        let before = Baseline {
            streams: self.health.ledgers(),
            own: self.own.snapshot(),
        };
        match self.begin(&path, now, Begun::ByCommand, before) {
            Ok(()) => {
                surroundings.log(&format!("recording {}", path.display()));
                json!({"ok": true, "file": path})
            }
            Err(error) => refusal(&error.to_string()),
        }
    }

    fn stop(&mut self, ends_session: bool, surroundings: &mut impl Surroundings) -> Value {
        if ends_session {
            // The links' last bytes are still to be written.
            return json!({"ok": true, "file": self.plan.record, "ends_session": true});
        }
        match self.finish() {
            Ok(Some(file)) => {
                let said = json!({
                    "ok": true,
                    "file": file.path,
                    "bytes": file.bytes,
                    "duration_s": file.duration_s,
                    "messages": file.messages,
                    "ends_session": false,
                });
                surroundings.log(&format!("recorded {}", said["file"]));
                said
            }
            Ok(None) => refusal("nothing is being recorded: start first"),
            Err(error) => {
                let said = refusal(&error.to_string());
                surroundings.log(&format!("the recording failed: {error}"));
                self.failed.get_or_insert(error);
                said
            }
        }
    }

    /// Recordings of the command `start` lie beside the command line's.
    fn folder(&self) -> PathBuf {
        let record = self.plan.record.as_deref();
        record
            .and_then(Path::parent)
            .map_or_else(PathBuf::new, Path::to_owned)
    }

    fn bytes(&self) -> u64 {
        self.recorder.as_ref().map_or(0, Recorder::bytes)
    }

    fn status(&self) -> Value {
        let now = self.clock.now();
        let recorder = self.recorder.as_ref();
        json!({
            "ok": true,
            "id": self.plan.config.id,
            "domain_id": self.plan.config.network.domain_id,
            "namespace": self.plan.config.network.namespace,
            "recording": recorder.map(|recorder| &recorder.path),
            "bytes": self.bytes(),
            "recording_s": recorder.map(|recorder| now.seconds_since(recorder.since)),
            "stop_ends_session": recorder.map(|recorder| recorder.begun == Begun::WithTheSession),
            "finished": self.files.iter().map(|file| &file.path).collect::<Vec<_>>(),
            "elapsed_s": now.seconds_since(self.start),
            "streams": self.health.summary(),
        })
    }

    /// What a recorder on another machine writes into its own file.
    fn metadata(&self) -> Value {
        let now = self.clock.now();
        match self
            .plan
            .preamble(now, self.clock.anchor(), "monotonic, anchored once")
        {
            Ok(preamble) => json!({
                "ok": true,
                "id": self.plan.config.id,
                "domain_id": self.plan.config.network.domain_id,
                "namespace": self.plan.config.network.namespace,
                "session": preamble.session,
                "calibration": preamble.calibration,
            }),
            Err(error) => refusal(&error.to_string()),
        }
    }
}
