//! A byte stream that comes over the network: what others put on a Zenoh key, as if it came from a serial port.
//!
//! For trackers whose poses a program computes elsewhere: the device's `port` is `zenoh:<key>`. Each sample's payload is a piece of
//! the stream, stamped when it arrives here. Nothing is sent back.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};
use ft_drivers::{Clock, Link, LinkError, MonotonicClock, RxStamps};
use ft_wire::{Chunk, HostTime};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;

/// What a device's `port` begins with when it comes over the network.
pub const PREFIX: &str = "zenoh:";
/// Samples that may wait; a stream at 1 kHz fills it in four seconds.
const CAPACITY: usize = 4096;
/// The longest sample, bytes; one of a pose is shorter than 100.
const LONGEST: usize = 16 * 1024;

/// A sample's payload, how much of it was taken, and when it came.
type Arrived = (Vec<u8>, usize, HostTime);

/// The host's end.
#[derive(Debug)]
pub struct ZenohLink {
    arrived: Receiver<Arrived>,
    /// What is left of the sample before.
    rest: Option<Arrived>,
    /// Samples that were too long or had no room.
    lost: Arc<AtomicU64>,
    clock: MonotonicClock,
    port: String,
    _subscriber: Subscriber<()>,
}

impl ZenohLink {
    /// Listens to `key`.
    ///
    /// # Errors
    /// The key is malformed, or the session is closed.
    pub fn open(
        session: &zenoh::Session,
        key: &str,
        clock: MonotonicClock,
    ) -> Result<Self, LinkError> {
        let port = format!("{PREFIX}{key}");
        let (sender, arrived) = bounded(CAPACITY);
        let lost = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&lost);
        let subscriber = session
            .declare_subscriber(key.to_owned())
            .callback(move |sample| {
                if !queue(&sender, &sample.payload().to_bytes(), clock.now()) {
                    counted.fetch_add(1, Ordering::Relaxed);
                }
            })
            .wait()
            .map_err(|error| LinkError::Io {
                call: "subscribing",
                port: port.clone(),
                source: std::io::Error::other(crate::network::plainly(&error.to_string())),
            })?;
        Ok(Self {
            arrived,
            rest: None,
            lost,
            clock,
            port,
            _subscriber: subscriber,
        })
    }
}

/// False for a sample that is too long, and when nobody reads the stream.
fn queue(to: &Sender<Arrived>, payload: &[u8], at: HostTime) -> bool {
    payload.len() <= LONGEST && to.try_send((payload.to_owned(), 0, at)).is_ok()
}

impl Link for ZenohLink {
    type Frame = Chunk;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(Chunk, RxStamps)>, LinkError> {
        let (bytes, taken, arrival) = match self.rest.take() {
            Some(rest) => rest,
            None => {
                let wait = deadline.saturating_since(self.clock.now());
                match self.arrived.recv_timeout(wait.min(Duration::from_secs(1))) {
                    Ok(sample) => sample,
                    Err(RecvTimeoutError::Timeout) => return Ok(None),
                    Err(RecvTimeoutError::Disconnected) => {
                        return Err(LinkError::Gone {
                            port: self.port.clone(),
                        });
                    }
                }
            }
        };
        let (chunk, more) = Chunk::take_from(bytes.get(taken..).unwrap_or_default());
        let taken = taken + more;
        if taken < bytes.len() {
            self.rest = Some((bytes, taken, arrival));
        }
        Ok(Some((chunk, RxStamps { arrival })))
    }

    /// There is nobody to hear it.
    fn send(&mut self, _frame: &Chunk) -> Result<(), LinkError> {
        Ok(())
    }

    fn overflows(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_too_long_or_has_no_room_is_not_queued() {
        let (sender, arrived) = bounded(1);
        let at = HostTime::EPOCH;
        assert!(!queue(&sender, &[0; LONGEST + 1], at));
        assert!(queue(&sender, &[0; LONGEST], at));
        assert!(!queue(&sender, &[0], at));
        assert_eq!(arrived.len(), 1);
    }
}
