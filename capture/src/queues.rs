//! The bounded queues between the acquisition threads and the threads that may wait.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};

use crate::channel::Intake;
use crate::item::{Body, Item};
use crate::ledger::StreamCounters;

/// Items that the writer may be behind: over a second of eight streams at 1 kHz with their raw frames.
const WRITER_CAPACITY: usize = 16_384;
/// Items that the publisher may be behind: while a recorder fetches what it missed, it waits some tenths of a second.
const PUBLISHER_CAPACITY: usize = 32_768;
/// Events and clock reports that the health thread may be behind.
const HEALTH_CAPACITY: usize = 1_024;

/// The sending ends, one copy for each acquisition thread.
///
/// `try_send` on a bounded crossbeam channel allocates nothing; to wake a sleeping receiver it takes a lock for a moment.
#[derive(Clone, Debug)]
pub struct Queues {
    writer: Sender<Item>,
    recording: Arc<AtomicBool>,
    publisher: Option<Sender<Item>>,
    health: Sender<Item>,
}

/// The receiving ends.
#[derive(Debug)]
pub struct QueueEnds {
    /// For the writer thread of each recording in turn.
    pub writer: Receiver<Item>,
    /// For the publisher thread, when somebody may look on.
    pub publisher: Option<Receiver<Item>>,
    /// For the health thread.
    pub health: Receiver<Item>,
}

/// Queues for a session that publishes or not; nothing is recorded until [`Queues::set_recording`].
#[must_use]
pub fn queues(publish: bool) -> (Queues, QueueEnds) {
    let (writer, writer_end) = bounded(WRITER_CAPACITY);
    let (publisher, publisher_end) = publish.then(|| bounded(PUBLISHER_CAPACITY)).unzip();
    let (health, health_end) = bounded(HEALTH_CAPACITY);
    (
        Queues {
            writer,
            recording: Arc::new(AtomicBool::new(false)),
            publisher,
            health,
        },
        QueueEnds {
            writer: writer_end,
            publisher: publisher_end,
            health: health_end,
        },
    )
}

impl Queues {
    /// There is nobody to publish to after all.
    pub fn close_publisher(&mut self) {
        self.publisher = None;
    }

    /// Opens or closes the way to the writer for every copy of these queues.
    pub fn set_recording(&self, recording: bool) {
        self.recording.store(recording, Ordering::Release);
    }
}

impl Intake for Queues {
    fn put(&mut self, item: Item, counters: &StreamCounters) {
        if matches!(item.body, Body::Event(_) | Body::Clock(_)) {
            // A full health queue costs one line of /diagnostics, no sample.
            let _ = self.health.try_send(item);
            return;
        }
        let published = !matches!(item.body, Body::Raw(_));
        if published && let Some(publisher) = &self.publisher {
            send(publisher, item.clone(), || counters.add_view_drop());
        }
        if self.recording.load(Ordering::Acquire) {
            send(&self.writer, item, || counters.add_drop());
        }
    }
}

/// A receiver that is gone has reported its own error: what it did not take counts as dropped too.
fn send(to: &Sender<Item>, item: Item, dropped: impl FnOnce()) {
    match to.try_send(item) {
        Ok(()) => {}
        Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => dropped(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_wire::HostTime;

    fn mark() -> Item {
        let at = HostTime::EPOCH;
        Item {
            device: None,
            arrival: at,
            clock_epoch: 0,
            sample_time: at,
            body: Body::Mark("m".to_owned()),
        }
    }

    #[test]
    fn a_viewer_that_stands_still_costs_the_recording_nothing() {
        let (mut queues, ends) = queues(true);
        queues.set_recording(true);
        let counters = StreamCounters::default();
        for _ in 0..PUBLISHER_CAPACITY + 7 {
            queues.put(mark(), &counters);
            ends.writer.recv().unwrap();
        }
        let ledger = counters.snapshot();
        assert_eq!((ledger.drops, ledger.view_drops), (0, 7));
    }

    #[test]
    fn a_writer_that_stands_still_is_counted() {
        let (mut queues, _ends) = queues(false);
        queues.set_recording(true);
        let counters = StreamCounters::default();
        for _ in 0..WRITER_CAPACITY + 3 {
            queues.put(mark(), &counters);
        }
        assert_eq!(counters.snapshot().drops, 3);
    }

    #[test]
    fn nothing_reaches_the_writer_before_the_start_and_after_the_end() {
        let (mut queues, ends) = queues(false);
        let counters = StreamCounters::default();
        let mut of_a_link = queues.clone();
        for (recording, waiting) in [(false, 0), (true, 1), (false, 1)] {
            queues.set_recording(recording);
            of_a_link.put(mark(), &counters);
            assert_eq!(ends.writer.len(), waiting);
        }
        queues.put(mark(), &counters);
        assert_eq!((ends.writer.len(), counters.snapshot().drops), (1, 0));
    }
}
