//! The bounded queues between the acquisition threads and the threads that may wait.

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};

use crate::channel::Intake;
use crate::item::{Body, Item};
use crate::ledger::StreamCounters;

/// Items that the writer may be behind: over a second of eight streams at 1 kHz with their raw frames.
const WRITER_CAPACITY: usize = 16_384;
/// Items that the publisher may be behind.
const PUBLISHER_CAPACITY: usize = 8_192;
/// Events and clock reports that the health thread may be behind.
const HEALTH_CAPACITY: usize = 1_024;

/// The sending ends, one copy for each acquisition thread.
///
/// `try_send` on a bounded crossbeam channel allocates nothing; to wake a sleeping receiver it takes a lock for a moment.
#[derive(Clone, Debug)]
pub struct Queues {
    writer: Option<Sender<Item>>,
    publisher: Option<Sender<Item>>,
    health: Sender<Item>,
}

/// The receiving ends.
#[derive(Debug)]
pub struct QueueEnds {
    /// For the writer thread, when there is a recording.
    pub writer: Option<Receiver<Item>>,
    /// For the publisher thread, when there is a network side.
    pub publisher: Option<Receiver<Item>>,
    /// For the health thread.
    pub health: Receiver<Item>,
}

/// Queues for a session that records or not, publishes or not.
#[must_use]
pub fn queues(record: bool, publish: bool) -> (Queues, QueueEnds) {
    let open = |wanted: bool, capacity| wanted.then(|| bounded(capacity)).unzip();
    let (writer, writer_end) = open(record, WRITER_CAPACITY);
    let (publisher, publisher_end) = open(publish, PUBLISHER_CAPACITY);
    let (health, health_end) = bounded(HEALTH_CAPACITY);
    (
        Queues {
            writer,
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
    /// There is no network side after all.
    pub fn close_publisher(&mut self) {
        self.publisher = None;
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
        if let Some(writer) = &self.writer {
            send(writer, item, || counters.add_drop());
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
            sample_time: at,
            body: Body::Mark("m".to_owned()),
        }
    }

    #[test]
    fn a_viewer_that_stands_still_costs_the_recording_nothing() {
        let (mut queues, ends) = queues(true, true);
        let counters = StreamCounters::default();
        let writer = ends.writer.as_ref().unwrap();
        for _ in 0..PUBLISHER_CAPACITY + 7 {
            queues.put(mark(), &counters);
            writer.recv().unwrap();
        }
        let ledger = counters.snapshot();
        assert_eq!((ledger.drops, ledger.view_drops), (0, 7));
    }

    #[test]
    fn a_writer_that_stands_still_is_counted() {
        let (mut queues, _ends) = queues(true, false);
        let counters = StreamCounters::default();
        for _ in 0..WRITER_CAPACITY + 3 {
            queues.put(mark(), &counters);
        }
        assert_eq!(counters.snapshot().drops, 3);
    }
}
