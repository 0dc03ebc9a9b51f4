//! The stages that drivers share; what they ask is their own.
//!
//! ```text
//! stop -> drain (quiet) -> the device's questions, one after another -> stream
//!      a question unanswered three times, or a stream that falls silent -> Lost -> wait -> stop
//! ```
//!
//! A polled device asks one more question every period instead of streaming; a poll without an answer is one gap, and too many
//! in a row are a loss.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use ft_wire::HostTime;

use crate::options::Startup;
use crate::reading::{DeviceEvent, Quality, Reading};

/// How often a question is asked before the device counts as lost.
const ATTEMPTS: u8 = 3;
/// Room for readings, so that a stream allocates nothing.
const READINGS: usize = 32;

/// How long the stages wait.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Timing {
    pub(crate) startup: Startup,
    /// Silence that ends the draining of a stopped stream.
    pub(crate) quiet: Duration,
    /// A stream that goes on after a stop is stopped again after this.
    pub(crate) drain_limit: Duration,
    pub(crate) answer_timeout: Duration,
    pub(crate) silence_timeout: Duration,
    pub(crate) retry_after: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State<Q> {
    Idle,
    Draining {
        quiet_at: HostTime,
        give_up_at: HostTime,
    },
    Asking {
        question: Q,
        attempt: u8,
        deadline: HostTime,
    },
    Listening(HostTime),
    Streaming(HostTime),
    /// Between two polls.
    Pausing {
        next: HostTime,
    },
    /// A poll is out; the one after it is due at `next`.
    Polling {
        deadline: HostTime,
        next: HostTime,
    },
    Waiting(HostTime),
}

/// How a device is polled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Polling<Q> {
    pub(crate) question: Q,
    pub(crate) period: Duration,
    /// Longest wait for an answer; longer than the longest delay of the line, or answers are taken for the next poll's.
    pub(crate) timeout: Duration,
    /// Unanswered polls in a row after which the device is lost.
    pub(crate) lost_after: u32,
}

/// What a timeout brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Due<Q> {
    /// Nothing for the device to do.
    Nothing,
    /// A new attempt began: forget the stream before.
    Began,
    /// The line is quiet: ask.
    Drained,
    /// A question stayed unanswered that need not be answered.
    Unanswered(Q),
    /// A poll goes out: forget what is left of the answer before.
    Polled,
    /// The device was called lost.
    Lost,
}

/// Where a device stands, and what goes out: questions `Q` to the line, readings to the caller.
#[derive(Debug)]
pub(crate) struct Stages<Q> {
    timing: Timing,
    /// What to look at when nothing answers.
    checks: &'static str,
    stop: Option<Q>,
    optional: Option<Q>,
    polling: Option<Polling<Q>>,
    polled: bool,
    unanswered: u32,
    missed: u64,
    state: State<Q>,
    outgoing: Option<Q>,
    stops: u8,
    unread: u64,
    warned: u32,
    received: u64,
    readings: VecDeque<Reading>,
}

impl<Q: Copy + PartialEq + fmt::Debug> Stages<Q> {
    pub(crate) fn new(timing: Timing, stop: Option<Q>, checks: &'static str) -> Self {
        Self {
            timing,
            checks,
            stop,
            optional: None,
            polling: None,
            polled: false,
            unanswered: 0,
            missed: 0,
            state: State::Idle,
            outgoing: None,
            stops: 0,
            unread: 0,
            warned: 0,
            received: 0,
            readings: VecDeque::with_capacity(READINGS),
        }
    }

    /// A question whose answer may be missing: after the attempts it is [`Due::Unanswered`].
    pub(crate) fn with_optional(mut self, question: Q) -> Self {
        self.optional = Some(question);
        self
    }

    /// The device is polled once it is set up.
    pub(crate) fn with_polling(mut self, polling: Polling<Q>) -> Self {
        self.polling = Some(polling);
        self
    }

    /// What is sent first at the next attempt; `None` for a device that has nothing to stop.
    pub(crate) fn set_stop(&mut self, stop: Option<Q>) {
        self.stop = stop;
    }

    pub(crate) const fn is_streaming(&self) -> bool {
        match self.state {
            State::Streaming(_) => true,
            State::Pausing { .. } | State::Polling { .. } => self.polled,
            _ => false,
        }
    }

    /// Whether an answer to a poll is awaited.
    pub(crate) const fn is_polling(&self) -> bool {
        matches!(self.state, State::Polling { .. })
    }

    /// Polls without an answer.
    pub(crate) const fn missed(&self) -> u64 {
        self.missed
    }

    pub(crate) const fn received(&self) -> u64 {
        self.received
    }

    pub(crate) fn awaits(&self, wanted: Q) -> bool {
        matches!(self.state, State::Asking { question, .. } if question == wanted)
    }

    /// The question that is out.
    pub(crate) const fn asked(&self) -> Option<Q> {
        match self.state {
            State::Asking { question, .. } => Some(question),
            _ => None,
        }
    }

    /// Something came, whatever it was.
    pub(crate) fn on_traffic(&mut self, at: HostTime) {
        self.unread += 1;
        if let State::Draining { quiet_at, .. } = &mut self.state {
            *quiet_at = at + self.timing.quiet;
        }
    }

    pub(crate) fn ask(&mut self, question: Q, now: HostTime) {
        self.unread = 0;
        self.attempt(question, 1, now);
    }

    fn attempt(&mut self, question: Q, attempt: u8, now: HostTime) {
        self.outgoing = Some(question);
        self.state = State::Asking {
            question,
            attempt,
            deadline: now + self.timing.answer_timeout,
        };
    }

    /// Whether a sample that came is one of the stream; the first one after `start` was asked begins it.
    pub(crate) fn admits_sample(&mut self, start: Option<Q>, at: HostTime) -> bool {
        match self.state {
            State::Streaming(_) => {}
            State::Asking { question, .. } if Some(question) == start => self.begin(at),
            State::Listening(_) => self.begin(at),
            // A stream that is being stopped.
            _ => return false,
        }
        self.state = State::Streaming(at + self.timing.silence_timeout);
        true
    }

    /// The questions are answered: polls begin.
    pub(crate) fn begin_polling(&mut self, now: HostTime) {
        (self.polled, self.unanswered) = (false, 0);
        self.state = State::Pausing { next: now };
    }

    /// Whether the answer to a poll that came is one; a listener takes all.
    pub(crate) fn admits_answer(&mut self, at: HostTime) -> bool {
        let State::Polling { next, .. } = self.state else {
            return self.timing.startup == Startup::Listen && self.admits_sample(None, at);
        };
        self.unanswered = 0;
        if !core::mem::replace(&mut self.polled, true) {
            self.begin(at);
        }
        self.state = State::Pausing { next };
        true
    }

    fn poll(&mut self, polling: Polling<Q>, due: HostTime, now: HostTime) -> Due<Q> {
        self.outgoing = Some(polling.question);
        // Polls that are overdue are left out, not caught up.
        let on_time = due + polling.period;
        let next = if on_time > now {
            on_time
        } else {
            now + polling.period
        };
        self.state = State::Polling {
            deadline: now + polling.timeout,
            next,
        };
        Due::Polled
    }

    fn miss(&mut self, polling: Polling<Q>, next: HostTime, now: HostTime) -> Due<Q> {
        self.missed += u64::from(self.polled);
        self.unanswered += 1;
        if self.unanswered < polling.lost_after {
            self.state = State::Pausing { next };
            return Due::Nothing;
        }
        let (count, timeout, checks) = (self.unanswered, polling.timeout, self.checks);
        self.lost(
            format!(
                "{count} questions in a row were left unanswered for {timeout:?} each: {checks}"
            ),
            now,
        )
    }

    fn begin(&mut self, at: HostTime) {
        self.outgoing = None;
        self.tell(DeviceEvent::Streaming, at);
    }

    /// The questions are answered; the first sample is awaited.
    pub(crate) fn await_sample(&mut self, now: HostTime) {
        self.state = State::Listening(now + self.timing.silence_timeout);
    }

    /// So many samples of the stream will not come.
    pub(crate) fn tell_missing(&mut self, samples: u64) {
        if samples > 0 && self.is_streaming() {
            self.readings.push_back(Reading::Missing { samples });
        }
    }

    pub(crate) fn deliver(&mut self, reading: Reading) {
        self.received += 1;
        self.readings.push_back(reading);
    }

    /// Each bad bit once per stream: the bits of `status` that were not seen before.
    pub(crate) fn fresh_bits(&mut self, status: u32) -> u32 {
        let fresh = status & !self.warned;
        self.warned |= status;
        fresh
    }

    /// Warns of overloaded axes, 0x20 Fx to 0x01 Tz, each once per stream.
    pub(crate) fn warn_of_overload(&mut self, overload: u32, at: HostTime) {
        let fresh = self.fresh_bits(overload);
        if fresh != 0 {
            let names = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"];
            let over: Vec<_> = (0..6)
                .zip(names)
                .filter(|(axis, _)| fresh & (0x20 >> axis) != 0)
                .map(|(_, name)| name)
                .collect();
            let text = format!(
                "{} beyond the rated load: unload the sensor",
                over.join(" ")
            );
            self.warn(text, at);
        }
    }

    pub(crate) fn tell(&mut self, event: DeviceEvent, at: HostTime) {
        self.readings.push_back(Reading::Event { at, event });
    }

    pub(crate) fn warn(&mut self, text: String, at: HostTime) {
        self.tell(DeviceEvent::Warning { text }, at);
    }

    pub(crate) fn lose(&mut self, reason: String, now: HostTime) {
        self.tell(DeviceEvent::Lost { reason }, now);
        self.outgoing = None;
        self.state = match self.timing.startup {
            Startup::Configure => State::Waiting(now + self.timing.retry_after),
            Startup::Listen => State::Listening(HostTime::FAR_FUTURE),
        };
    }

    pub(crate) fn handle_timeout(&mut self, now: HostTime) -> Due<Q> {
        match self.state {
            State::Idle => self.start(now),
            State::Waiting(until) if now >= until => self.start(now),
            State::Draining { give_up_at, .. } if now >= give_up_at => {
                if self.stops < ATTEMPTS {
                    self.send_stop(now);
                    return Due::Nothing;
                }
                let (limit, checks) = (self.timing.drain_limit * ATTEMPTS.into(), self.checks);
                let reason = match self.stop {
                    Some(_) => {
                        format!("stop was sent {ATTEMPTS} times, frames still come: {checks}")
                    }
                    None => format!(
                        "nothing was asked for {limit:?} and frames still come, from another program or device: {checks}"
                    ),
                };
                self.lost(reason, now)
            }
            State::Draining { quiet_at, .. } if now >= quiet_at => Due::Drained,
            State::Asking {
                question,
                attempt,
                deadline,
            } if now >= deadline => self.not_answered(question, attempt, now),
            State::Listening(deadline) | State::Streaming(deadline) if now >= deadline => {
                let (silence, checks) = (self.timing.silence_timeout, self.checks);
                self.lost(format!("no sample for {silence:?}: {checks}"), now)
            }
            State::Pausing { next } if now >= next => match self.polling {
                Some(polling) => self.poll(polling, next, now),
                None => Due::Nothing,
            },
            State::Polling { deadline, next } if now >= deadline => match self.polling {
                Some(polling) => self.miss(polling, next, now),
                None => Due::Nothing,
            },
            _ => Due::Nothing,
        }
    }

    fn not_answered(&mut self, question: Q, attempt: u8, now: HostTime) -> Due<Q> {
        if attempt < ATTEMPTS {
            self.attempt(question, attempt + 1, now);
            return Due::Nothing;
        }
        if self.optional == Some(question) {
            return Due::Unanswered(question);
        }
        let (timeout, unread, checks) = (self.timing.answer_timeout, self.unread, self.checks);
        self.lost(
            format!(
                "{question:?} was not answered within {timeout:?}, {ATTEMPTS} times, while {unread} pieces came that \
                 mean nothing: {checks}"
            ),
            now,
        )
    }

    fn lost(&mut self, reason: String, now: HostTime) -> Due<Q> {
        self.lose(reason, now);
        Due::Lost
    }

    fn start(&mut self, now: HostTime) -> Due<Q> {
        self.tell(DeviceEvent::Starting, now);
        (self.stops, self.warned, self.unread) = (0, 0, 0);
        match self.timing.startup {
            Startup::Configure => self.send_stop(now),
            Startup::Listen => self.await_sample(now),
        }
        Due::Began
    }

    fn send_stop(&mut self, now: HostTime) {
        self.stops += 1;
        self.outgoing = self.stop;
        self.state = State::Draining {
            quiet_at: now + self.timing.quiet,
            give_up_at: now + self.timing.drain_limit,
        };
    }

    pub(crate) fn poll_timeout(&self) -> HostTime {
        match self.state {
            State::Idle => HostTime::EPOCH,
            State::Draining {
                quiet_at,
                give_up_at,
            } => quiet_at.min(give_up_at),
            State::Asking { deadline, .. } | State::Polling { deadline, .. } => deadline,
            State::Pausing { next } => next,
            State::Listening(at) | State::Streaming(at) | State::Waiting(at) => at,
        }
    }

    pub(crate) fn poll_transmit(&mut self) -> Option<Q> {
        self.outgoing.take()
    }

    pub(crate) fn poll_reading(&mut self) -> Option<Reading> {
        self.readings.pop_front()
    }
}

/// Quality by what a status says.
pub(crate) const fn quality(invalid: bool, overrange: bool) -> Quality {
    match (invalid, overrange) {
        (true, _) => Quality::Invalid,
        (false, true) => Quality::Overrange,
        (false, false) => Quality::Good,
    }
}
