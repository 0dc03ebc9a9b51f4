//! A byte stream that comes over the network: what others put on a Zenoh key, as if it came from a serial port.
//!
//! For trackers whose poses a program computes elsewhere: the device's `port` is `zenoh:<key>`. Each sample's payload is a piece of
//! the stream, stamped when it arrives here. Nothing is sent back.

use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, bounded};
use ft_drivers::{Clock, Link, LinkError, MonotonicClock, RxStamps};
use ft_wire::{Chunk, HostTime};
use zenoh::Wait;
use zenoh::pubsub::Subscriber;

/// What a device's `port` begins with when it comes over the network.
pub const PREFIX: &str = "zenoh:";
/// Samples that may wait; a stream at 1 kHz fills it in four seconds.
const CAPACITY: usize = 4096;

/// The host's end.
#[derive(Debug)]
pub struct ZenohLink {
    arrived: Receiver<(Vec<u8>, HostTime)>,
    /// What is left of the sample before.
    rest: Option<(Vec<u8>, HostTime)>,
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
        let subscriber = session
            .declare_subscriber(key.to_owned())
            .callback(move |sample| {
                // A stream that nobody reads overflows; the device's own numbers show the gap.
                let _ = sender.try_send((sample.payload().to_bytes().into_owned(), clock.now()));
            })
            .wait()
            .map_err(|error| LinkError::Io {
                call: "subscribing",
                port: port.clone(),
                source: std::io::Error::other(error.to_string()),
            })?;
        Ok(Self {
            arrived,
            rest: None,
            clock,
            port,
            _subscriber: subscriber,
        })
    }
}

impl Link for ZenohLink {
    type Frame = Chunk;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(Chunk, RxStamps)>, LinkError> {
        let (mut bytes, arrival) = match self.rest.take() {
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
        let (chunk, taken) = Chunk::take_from(&bytes);
        if taken < bytes.len() {
            bytes.drain(..taken);
            self.rest = Some((bytes, arrival));
        }
        Ok(Some((chunk, RxStamps { arrival })))
    }

    /// There is nobody to hear it.
    fn send(&mut self, _frame: &Chunk) -> Result<(), LinkError> {
        Ok(())
    }
}
