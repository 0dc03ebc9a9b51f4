//! What the publisher thread does: encodes each item once, for the network and for this program's own viewers.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::Receiver;
use ft_drivers::priority::{Duty, SharedProcessor, prefer_this_thread};
use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;

use crate::encode::{Encoder, Topic};
use crate::item::Item;
use crate::live::{Hub, Sample};
use crate::sink::SinkError;
use crate::sink::zenoh::ZenohSink;

/// Where items go.
#[derive(Debug)]
pub struct Outlets {
    encoder: Encoder,
    zenoh: Option<ZenohSink>,
    hub: Option<Arc<Hub>>,
}

impl Outlets {
    /// To the network and to viewers, as far as there are any.
    #[must_use]
    pub fn new(zenoh: Option<ZenohSink>, hub: Option<Arc<Hub>>) -> Self {
        Self {
            encoder: Encoder::default(),
            zenoh,
            hub,
        }
    }

    /// Publishes what comes, `/diagnostics` once a second at least, until nobody sends any more; the calling thread is preferred to
    /// ordinary ones, and on the `processor` of those that read. The messages that were refused, and the outlets: what they keep may still be asked for.
    #[must_use]
    pub fn publish_until_closed(
        mut self,
        items: &Receiver<Item>,
        clock: MonotonicClock,
        processor: &SharedProcessor,
    ) -> (u64, Self) {
        let _ = prefer_this_thread(Duty::Publishing);
        processor.join();
        let mut refused = 0;
        // No time-out: to set a timer for each message takes longer than to encode it.
        for item in items {
            refused += u64::from(self.take(&item).is_err());
            refused += u64::from(self.tick(clock.now()).is_err());
        }
        (refused, self)
    }

    /// Waits for recorders: [`ZenohSink::settle`].
    pub(super) fn settle(&mut self, clock: MonotonicClock, patience: Duration, longest: Duration) {
        if let Some(sink) = &mut self.zenoh {
            sink.settle(clock, patience, longest);
        }
    }

    fn take(&mut self, item: &Item) -> Result<(), SinkError> {
        let Self {
            encoder,
            zenoh,
            hub,
        } = self;
        encoder.encode(item, |topic, payload| {
            let put = zenoh
                .as_mut()
                .map_or(Ok(()), |sink| sink.put(topic, payload, item.sample_time));
            if let Some(hub) = hub {
                hub.take(&sample(topic, payload, item.sample_time));
            }
            put
        })
    }

    fn tick(&mut self, now: HostTime) -> Result<(), SinkError> {
        if let Some(hub) = &self.hub {
            hub.tick(now);
        }
        self.zenoh.as_mut().map_or(Ok(()), |sink| sink.tick(now))
    }
}

pub(super) fn sample(topic: Topic, payload: &[u8], at: HostTime) -> Sample<'_> {
    Sample {
        topic: topic.name(),
        type_name: topic.message_type().0,
        payload,
        at,
        numbered: None,
    }
}
