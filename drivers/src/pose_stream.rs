//! A pose tracker that sends our own pose stream, `world_from_aria_device`.
//!
//! The tracker sends by itself and takes no commands: the driver listens. A tracker that falls silent is reported as lost
//! once, and picked up again when it goes on. Gaps, duplicates and restarts show by the tracker's own clock.
//!
//! Every frame that a chunk completes gets the chunk's arrival; `device_ns` has no such error.
//!
//! # Source
//! [`ft_wire::pose_stream`] defines the format.

use std::collections::VecDeque;
use std::time::Duration;

use ft_wire::pose_stream::{self as wire, PoseSample};
use ft_wire::{Chunk, DecodeError, HostTime, Pose};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::reading::{Counts, DeviceEvent, PoseReading, Reading, SampleInstant};
use crate::sequence::{Seen, Sequence};

/// What to expect of the tracker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Silence after which the tracker counts as lost. Default 1 s.
    pub silence_timeout: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            silence_timeout: Duration::from_secs(1),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Idle,
    Listening(HostTime),
    Streaming(HostTime),
    Lost,
}

/// The driver.
#[derive(Debug)]
pub struct PoseStream {
    config: Config,
    state: State,
    framer: Framer,
    sequence: Sequence,
    unread_bytes: u64,
    received: u64,
    duplicated: u64,
    readings: VecDeque<Reading>,
}

impl PoseStream {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            state: State::Idle,
            framer: Framer::new(),
            sequence: Sequence::new(),
            unread_bytes: 0,
            received: 0,
            duplicated: 0,
            readings: VecDeque::with_capacity(32),
        }
    }

    fn on_sample(&mut self, sample: &PoseSample, stamps: RxStamps) {
        let arrival = stamps.arrival;
        if !matches!(self.state, State::Streaming(_)) {
            self.framer.begin_counting();
            self.sequence.forget();
            self.tell(DeviceEvent::Streaming, arrival);
        }
        self.state = State::Streaming(arrival + self.config.silence_timeout);
        match self.sequence.observe(sample.tracking_ns, arrival) {
            Seen::New | Seen::Late => {}
            Seen::Duplicate => {
                self.duplicated += 1;
                return;
            }
            Seen::Restarted { was_ns } => {
                let text = format!(
                    "the tracker's clock went from {was_ns} ns to {} ns: it restarted",
                    sample.tracking_ns
                );
                self.tell(DeviceEvent::Warning { text }, arrival);
            }
        }
        self.received += 1;
        self.readings.push_back(Reading::Pose(PoseReading {
            at: SampleInstant {
                arrival,
                device_ns: Some(sample.tracking_ns),
            },
            pose: Pose::new(sample.position, sample.quaternion),
            quality_score: sample.quality_score,
        }));
    }

    fn lose(&mut self, now: HostTime) {
        let (silence, unread) = (self.config.silence_timeout, self.unread_bytes);
        let reason = if unread == 0 {
            format!("no pose for {silence:?}, no bytes at all: is the tracker's program running?")
        } else {
            format!(
                "no pose for {silence:?}, {unread} bytes that are no pose: is it the right port and bit rate?"
            )
        };
        self.tell(DeviceEvent::Lost { reason }, now);
        self.framer.clear();
        self.unread_bytes = 0;
        self.state = State::Lost;
    }

    fn tell(&mut self, event: DeviceEvent, at: HostTime) {
        self.readings.push_back(Reading::Event { at, event });
    }
}

impl Device for PoseStream {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        self.framer.push(chunk);
        loop {
            let unread = &mut self.unread_bytes;
            match self.framer.next(wire::decode, |_| *unread += 1) {
                Found::Frame(sample) => {
                    self.unread_bytes = 0;
                    self.on_sample(&sample, stamps);
                }
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => return first_error,
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        match self.state {
            State::Idle => {
                self.tell(DeviceEvent::Starting, now);
                self.state = State::Listening(now + self.config.silence_timeout);
            }
            State::Listening(deadline) | State::Streaming(deadline) if now >= deadline => {
                self.lose(now)
            }
            _ => {}
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        match self.state {
            State::Idle => Some(HostTime::EPOCH),
            State::Listening(at) | State::Streaming(at) => Some(at),
            State::Lost => None,
        }
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        None
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.readings.pop_front()
    }
}

impl Counted for PoseStream {
    fn counts(&self) -> Counts {
        Counts {
            received: self.received,
            gaps: self.sequence.gaps(),
            refused: self.framer.refused,
            duplicated: self.duplicated,
            skipped: self.framer.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
