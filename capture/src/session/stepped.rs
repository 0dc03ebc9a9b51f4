//! Sessions on a clock that goes in steps: the same drivers, channels and sinks, in one thread, as fast as it goes.
//!
//! Simulations and replays run here. The same seed, or the same recording, gives the same file.

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

use ft_drivers::SteppedClock;
use ft_wire::HostTime;

use super::{Baseline, FileSummary, Plan, SessionError, health, ledger_metadata, summarize};
use crate::channel::Intake;
use crate::health::Health;
use crate::item::{Body, Item};
use crate::ledger::{StreamCounters, StreamLedger};
use crate::merge::Merge;
use crate::open::SteppedLink;
use crate::sink::Sink;
use crate::sink::mcap::McapSink;
use crate::summary::Summary;

/// Items arrive in order within a step; the hold covers a step of a simulation.
const MERGE_HOLD: Duration = Duration::from_millis(2);

/// Collects what the channels deliver within a step.
#[derive(Clone, Debug, Default)]
pub struct Buffer(Rc<RefCell<Vec<Item>>>);

impl Intake for Buffer {
    fn put(&mut self, item: Item, _counters: &StreamCounters) {
        self.0.borrow_mut().push(item);
    }
}

/// A session between its begin and its end.
pub struct Stepping {
    links: Vec<Box<dyn SteppedLink>>,
    buffer: Buffer,
    clock: SteppedClock,
    start: HostTime,
    now: HostTime,
    health: Health,
    merge: Merge,
    sink: Option<McapSink>,
    listener: Option<Listener>,
}

/// Hears of every item as it comes out of its channel.
pub type Listener = Box<dyn FnMut(&Item)>;

impl Stepping {
    /// Begins at `start`; `clock_name` goes into the recording.
    ///
    /// # Errors
    /// The recording cannot be created.
    pub fn begin(
        plan: &Plan,
        links: Vec<Box<dyn SteppedLink>>,
        counters: &[Arc<StreamCounters>],
        buffer: Buffer,
        start: HostTime,
        clock_name: &str,
    ) -> Result<Self, SessionError> {
        let sink = match &plan.record {
            Some(path) => Some(McapSink::create(
                path,
                &plan.writer_options(),
                &plan.preamble(start, start, clock_name)?,
            )?),
            None => None,
        };
        Ok(Self {
            links,
            buffer,
            clock: SteppedClock::new(start),
            start,
            now: start,
            health: health(plan, counters),
            merge: Merge::new(MERGE_HOLD),
            sink,
            listener: None,
        })
    }

    /// Tells `listener` of every item from now on.
    pub fn listen(&mut self, listener: Listener) {
        self.listener = Some(listener);
    }

    /// The clock.
    #[must_use]
    pub const fn clock(&self) -> &SteppedClock {
        &self.clock
    }

    /// Moves on to `now` and takes what has arrived by then.
    ///
    /// # Errors
    /// A link or the recording fails. What was recorded is kept.
    pub fn step(&mut self, now: HostTime) -> Result<(), SessionError> {
        self.clock.advance_to(now);
        self.now = now;
        for link in &mut self.links {
            link.turn_until_idle(&self.clock, now)?;
        }
        for item in self.buffer.0.borrow_mut().drain(..) {
            if let Some(listener) = &mut self.listener {
                listener(&item);
            }
            match item.body {
                Body::Event(_) | Body::Clock(_) => drop(self.health.take(&item)),
                _ if self.sink.is_some() => self.merge.push(item),
                _ => {}
            }
        }
        if let Some(array) = self.health.poll(now) {
            self.own(now, Body::Diagnostics(Box::new(array)));
        }
        if let Some(sink) = &mut self.sink {
            while let Some(item) = self.merge.pop_due(now) {
                sink.take(&item)?;
            }
            sink.tick(now)?;
        }
        Ok(())
    }

    /// Takes what no device said.
    pub fn own(&mut self, at: HostTime, body: Body) {
        if self.sink.is_none() {
            return;
        }
        self.merge.push(Item {
            device: None,
            arrival: at,
            clock_epoch: 0,
            sample_time: at,
            body,
        });
    }

    /// Finishes the recording.
    ///
    /// # Errors
    /// The recording fails; what was flushed is kept.
    pub fn finish(mut self) -> Result<Summary, SessionError> {
        let mut files = Vec::new();
        if let Some(mut sink) = self.sink.take() {
            while let Some(item) = self.merge.pop_any() {
                sink.take(&item)?;
            }
            let done = sink.finish(&ledger_metadata(
                &self.health,
                StreamLedger::default(),
                &Baseline::default(),
            ))?;
            files.push(FileSummary {
                path: done.path,
                duration_s: self.now.seconds_since(self.start),
                bytes: done.bytes,
                messages: done.messages,
            });
        }
        Ok(summarize(
            &self.health,
            StreamLedger::default(),
            self.start,
            self.now,
            files,
        ))
    }
}

impl std::fmt::Debug for Stepping {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Stepping")
            .field("now", &self.now)
            .field("devices", &self.links.len())
            .finish_non_exhaustive()
    }
}
