//! The wires between devices and host: time on the line, jitter, order, and the links that a driver opens.

use std::collections::VecDeque;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ft_drivers::{Clock, Link, LinkError, MonotonicClock, RxStamps, SteppedClock};
use ft_wire::{CanFrame, Chunk, HostTime};

use crate::clock::SimNanos;
use crate::random::Random;
use crate::scenario::LinkSpec;

/// What a device hangs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bus {
    /// 8N1, no flow control.
    Serial {
        /// Line rate, bit/s.
        baud_bps: u32,
    },
    /// Classic CAN.
    Can {
        /// Bit rate, bit/s.
        bitrate_bps: u32,
    },
}

impl Bus {
    /// Its rate, bit/s.
    #[must_use]
    pub const fn bits_per_second(self) -> u32 {
        match self {
            Self::Serial { baud_bps } => baud_bps,
            Self::Can { bitrate_bps } => bitrate_bps,
        }
    }
}

/// What a bus carries, and how many bits that takes.
pub trait Carried: Copy + Send + fmt::Debug + 'static {
    /// Bits on the wire.
    fn bits(&self) -> u32;
}

impl Carried for Chunk {
    fn bits(&self) -> u32 {
        // Start, eight data, stop.
        10 * self.as_slice().len() as u32
    }
}

impl Carried for CanFrame {
    fn bits(&self) -> u32 {
        let overhead = if self.is_extended() { 67 } else { 47 };
        let plain = overhead + 8 * self.payload().len() as u32;
        // About one stuff bit in ten.
        plain + plain / 10
    }
}

/// Mean delay of adapter and host behind the line, ns.
const JITTER_MEAN_NS: f64 = 100e3;

/// One direction, device to host: a frame starts when the line is free, and none overtakes another.
#[derive(Debug)]
pub(crate) struct Line {
    bits_per_second: f64,
    free_at: SimNanos,
    last_arrival: SimNanos,
    burst: SimNanos,
    delay: SimNanos,
    random: Random,
}

impl Line {
    pub(crate) fn new(bits_per_second: u32, random: Random) -> Self {
        Self {
            bits_per_second: f64::from(bits_per_second),
            free_at: 0,
            last_arrival: 0,
            burst: 0,
            delay: 0,
            random,
        }
    }

    /// Puts a device's delay before the line and an adapter behind it.
    pub(crate) fn set_link(&mut self, link: &LinkSpec) {
        let nanos = |ms: f64| (1e6 * ms).round() as SimNanos;
        (self.burst, self.delay) = (nanos(link.burst_ms), nanos(link.delay_ms));
    }

    /// When a frame that is ready at `ready` has arrived whole.
    pub(crate) fn carry(&mut self, ready: SimNanos, bits: u32) -> SimNanos {
        self.free_at = self.free_at.max(ready + self.delay) + self.nanos(bits);
        let handed_over = match self.burst {
            0 => self.free_at,
            burst => (self.free_at + burst - 1).div_euclid(burst) * burst,
        };
        let delayed = handed_over + self.random.waiting(JITTER_MEAN_NS) as SimNanos;
        self.last_arrival = self.last_arrival.max(delayed);
        self.last_arrival
    }

    pub(crate) fn set_rate(&mut self, bits_per_second: u32) {
        self.bits_per_second = f64::from(bits_per_second);
    }

    pub(crate) fn nanos(&self, bits: u32) -> SimNanos {
        (f64::from(bits) * 1e9 / self.bits_per_second).round() as SimNanos
    }

    /// A seeded cut of `length` bytes in two, seldom.
    pub(crate) fn cut(&mut self, length: usize) -> Option<usize> {
        let draw = self.random.uniform(0.0, 1.0);
        (draw < 0.05 && length > 1).then(|| 1 + (draw / 0.05 * (length - 1) as f64) as usize)
    }
}

#[derive(Clone, Debug)]
pub(crate) enum TimeSource {
    Stepped(SteppedClock),
    Live(MonotonicClock),
}

impl TimeSource {
    pub(crate) fn now(&self) -> HostTime {
        match self {
            Self::Stepped(clock) => clock.now(),
            Self::Live(clock) => clock.now(),
        }
    }
}

#[derive(Debug)]
struct Queues<F> {
    to_host: VecDeque<(HostTime, F)>,
    to_device: VecDeque<(HostTime, F)>,
    host_line_free: HostTime,
    bits_per_second: f64,
}

/// Both directions between one device and the host.
#[derive(Debug)]
pub(crate) struct Port<F> {
    name: String,
    time: TimeSource,
    queues: Mutex<Queues<F>>,
    arrived: Condvar,
    closed: AtomicBool,
    line_rate: AtomicU32,
}

impl<F: Carried> Port<F> {
    pub(crate) fn new(name: &str, bits_per_second: u32, time: TimeSource) -> Self {
        let queues = Queues {
            to_host: VecDeque::new(),
            to_device: VecDeque::new(),
            host_line_free: HostTime::from_nanos(i64::MIN),
            bits_per_second: f64::from(bits_per_second),
        };
        Self {
            name: name.to_owned(),
            time,
            queues: Mutex::new(queues),
            arrived: Condvar::new(),
            closed: AtomicBool::new(false),
            line_rate: AtomicU32::new(bits_per_second),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Queues<F>> {
        self.queues.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn deliver(&self, arrival: HostTime, frame: F) {
        self.lock().to_host.push_back((arrival, frame));
        self.arrived.notify_one();
    }

    /// When the next frame of the host reaches the device.
    pub(crate) fn next_to_device(&self) -> Option<HostTime> {
        self.lock().to_device.front().map(|(at, _)| *at)
    }

    pub(crate) fn take_to_device(&self) -> Option<(HostTime, F)> {
        self.lock().to_device.pop_front()
    }

    /// The next frame for the host that has arrived by `now`.
    pub(crate) fn take_to_host(&self, now: HostTime) -> Option<(HostTime, F)> {
        let mut queues = self.lock();
        if queues.to_host.front()?.0 > now {
            return None;
        }
        queues.to_host.pop_front()
    }

    /// When the next frame arrives at the host.
    pub(crate) fn next_to_host(&self) -> Option<HostTime> {
        self.lock().to_host.front().map(|(at, _)| *at)
    }

    pub(crate) fn send(&self, frame: F) {
        let now = self.time.now();
        let mut queues = self.lock();
        let bits = f64::from(frame.bits());
        let there = queues
            .host_line_free
            .max(now)
            .offset_by_seconds(bits / queues.bits_per_second);
        queues.host_line_free = there;
        queues.to_device.push_back((there, frame));
    }

    /// The rate at which the device speaks now, bit/s.
    pub(crate) fn line_rate(&self) -> u32 {
        self.line_rate.load(Ordering::Relaxed)
    }

    pub(crate) fn set_line_rate(&self, bits_per_second: u32) {
        self.line_rate.store(bits_per_second, Ordering::Relaxed);
        self.lock().bits_per_second = f64::from(bits_per_second);
    }

    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::Relaxed);
        self.arrived.notify_all();
    }

    fn recv(&self, deadline: HostTime) -> Result<Option<(F, RxStamps)>, LinkError> {
        let mut queues = self.lock();
        loop {
            if self.closed.load(Ordering::Relaxed) {
                return Err(LinkError::Gone {
                    port: self.name.clone(),
                });
            }
            let first = queues
                .to_host
                .front()
                .map(|(arrival, _)| *arrival)
                .filter(|arrival| *arrival <= deadline);
            let TimeSource::Live(clock) = &self.time else {
                let Some(arrival) = first else {
                    return Ok(None);
                };
                return Ok(queues
                    .to_host
                    .pop_front()
                    .map(|(_, frame)| (frame, RxStamps { arrival })));
            };
            let now = clock.now();
            match first {
                Some(arrival) if arrival <= now => {
                    return Ok(queues
                        .to_host
                        .pop_front()
                        .map(|(_, frame)| (frame, RxStamps { arrival })));
                }
                None if now >= deadline => return Ok(None),
                _ => {
                    let wake = first.unwrap_or(deadline).min(deadline);
                    let wait = wake
                        .saturating_since(now)
                        .clamp(Duration::from_micros(20), Duration::from_millis(50));
                    queues = self
                        .arrived
                        .wait_timeout(queues, wait)
                        .unwrap_or_else(PoisonError::into_inner)
                        .0;
                }
            }
        }
    }
}

/// The host's end of a simulated bus.
///
/// Stepped: `recv` gives what arrives by the deadline and never waits; what is sent carries the simulation's present time.
/// Live (from [`crate::Server`]): `recv` waits until the deadline.
#[derive(Debug)]
pub struct SimLink<F> {
    port: Arc<Port<F>>,
}

/// The host's end of a simulated serial line.
pub type SimSerialLink = SimLink<Chunk>;
/// The host's end of a simulated CAN bus.
pub type SimCanLink = SimLink<CanFrame>;

impl<F: Carried> SimLink<F> {
    pub(crate) fn new(port: Arc<Port<F>>) -> Self {
        Self { port }
    }
}

impl<F: Carried> Link for SimLink<F> {
    type Frame = F;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(F, RxStamps)>, LinkError> {
        self.port.recv(deadline)
    }

    fn send(&mut self, frame: &F) -> Result<(), LinkError> {
        if self.port.closed.load(Ordering::Relaxed) {
            return Err(LinkError::Gone {
                port: self.port.name.clone(),
            });
        }
        self.port.send(*frame);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    #[test]
    fn frames_take_their_time_on_the_line_and_keep_their_order() {
        let mut line = Line::new(460_800, Random::new(1, Stream::SensorLine));
        let mut last = 0;
        for sample in 0..2000_i64 {
            let ready = sample * 1_250_000;
            let arrival = line.carry(ready, 370);
            assert!(arrival >= ready + 802_083, "37 bytes take 0.8 ms");
            assert!(arrival >= last);
            last = arrival;
        }
    }

    #[test]
    fn an_adapter_hands_over_in_bursts_and_a_delay_comes_before_the_line() {
        let mut line = Line::new(460_800, Random::new(1, Stream::SensorLine));
        line.set_link(&LinkSpec {
            burst_ms: 16.0,
            delay_ms: 3.0,
        });
        let mut bursts = std::collections::BTreeSet::new();
        for sample in 0..800_i64 {
            let ready = sample * 1_250_000;
            let arrival = line.carry(ready, 370);
            let late = arrival - (ready + 3_000_000 + 802_083);
            assert!((0..18_000_000).contains(&late), "{late}");
            bursts.insert(arrival / 16_000_000);
        }
        assert!((60..=64).contains(&bursts.len()), "{}", bursts.len());
    }

    #[test]
    fn a_line_that_is_asked_too_much_falls_behind() {
        let mut line = Line::new(115_200, Random::new(1, Stream::SensorLine));
        for _ in 0..100 {
            line.carry(0, 370);
        }
        assert_eq!(line.free_at, 100 * 3_211_806);
    }

    #[test]
    fn a_stepped_link_gives_what_arrives_by_the_deadline() {
        let clock = SteppedClock::new(HostTime::from_nanos(1000));
        let port = Arc::new(Port::<CanFrame>::new(
            "can",
            1_000_000,
            TimeSource::Stepped(clock),
        ));
        let mut link = SimLink::new(port.clone());
        let frame = CanFrame::standard(1, &[1, 2]).unwrap();
        port.deliver(HostTime::from_nanos(5000), frame);
        assert_eq!(link.recv(HostTime::from_nanos(4999)).unwrap(), None);
        let stamps = RxStamps {
            arrival: HostTime::from_nanos(5000),
        };
        assert_eq!(
            link.recv(HostTime::from_nanos(5000)).unwrap(),
            Some((frame, stamps))
        );
        link.send(&frame).unwrap();
        assert_eq!(
            port.next_to_device(),
            Some(HostTime::from_nanos(1000 + 69_000))
        );
        port.close();
        assert!(matches!(
            link.recv(HostTime::FAR_FUTURE),
            Err(LinkError::Gone { .. })
        ));
    }
}
