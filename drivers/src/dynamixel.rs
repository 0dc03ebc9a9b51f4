//! A Dynamixel actuator (protocol 2.0) as the encoder of a gripper: polled, its torque off.
//!
//! ```text
//! Drain (quiet) -> ping -> torque off -> Streaming: read current, velocity, position every period
//!      a question unanswered three times, or too many unanswered reads in a row -> Lost -> wait -> Drain
//! ```
//!
//! The actuator sends nothing by itself, so there is no stream to stop. A read that is not answered in time, or whose answer
//! is malformed, is one gap. Half-duplex adapters without direction control hand back what was sent: own packets are passed
//! over. Nothing is written to the actuator's EEPROM; a return delay time of 0 (factory: 0.5 ms) is set with the maker's tool.
//!
//! The line is opened at 57 600 bit/s from the factory; a read and its answer are 35 bytes, 6.1 ms at that rate. With an FTDI
//! latency timer of 16 ms the loop falls to about 50 Hz.
//!
//! # Source
//! hardware.md 3.1, see [`ft_wire::dynamixel2`]; linkage of the Hoi! gripper: hardware.md 1.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::time::Duration;

use ft_wire::dynamixel2::{
    self as wire, COUNTS_PER_TURN, Packet, PresentState, StatusError, VELOCITY_UNIT_RPM, address,
};
use ft_wire::{Chunk, DecodeError, HostTime};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::linkage::Linkage;
use crate::options::Startup;
use crate::reading::{Counts, DeviceEvent, Identity, Reading, SampleInstant, WidthReading};

/// Silence before the first question.
const QUIET: Duration = Duration::from_millis(20);
/// Bytes that nobody asked for may come for so long.
const DRAIN_LIMIT: Duration = Duration::from_millis(500);
/// How often a question is asked during set-up.
const ATTEMPTS: u8 = 3;

/// How to poll the actuator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// The actuator's id. Default 1, the factory's.
    pub id: u8,
    /// Time between two reads. Default 10 ms.
    pub period: Duration,
    /// Angle to jaw opening. Default the Hoi! gripper's.
    pub linkage: Linkage,
    /// Ask, or only listen to a line on which another program asks. Default ask.
    pub startup: Startup,
    /// Longest wait for an answer. Default 30 ms, which an FTDI latency timer of 16 ms needs.
    pub answer_timeout: Duration,
    /// Unanswered reads in a row after which the actuator counts as lost. Default 10.
    pub lost_after: u32,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            id: 1,
            period: Duration::from_millis(10),
            linkage: Linkage::HOI,
            startup: Startup::default(),
            answer_timeout: Duration::from_millis(30),
            lost_after: 10,
            retry_after: Duration::from_secs(1),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Question {
    Ping,
    TorqueOff,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Idle,
    /// Until it is quiet, or has not been for too long.
    Draining {
        quiet_at: HostTime,
        give_up_at: HostTime,
    },
    Asking {
        question: Question,
        attempt: u8,
        deadline: HostTime,
    },
    /// Between two reads.
    Pausing {
        next: HostTime,
    },
    /// A read is out; the one after it is due at `next`.
    Reading {
        deadline: HostTime,
        next: HostTime,
    },
    Listening,
    Waiting(HostTime),
}

/// The driver.
#[derive(Debug)]
pub struct Dynamixel {
    config: Config,
    state: State,
    framer: Framer,
    outgoing: Option<Packet>,
    streaming: bool,
    unanswered: u32,
    warned: Option<StatusError>,
    received: u64,
    gaps: u64,
    /// Answers that nobody waited for.
    unasked: u64,
    readings: VecDeque<Reading>,
}

impl Dynamixel {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            state: State::Idle,
            framer: Framer::new(),
            outgoing: None,
            streaming: false,
            unanswered: 0,
            warned: None,
            received: 0,
            gaps: 0,
            unasked: 0,
            readings: VecDeque::with_capacity(32),
        }
    }

    fn start(&mut self, now: HostTime) {
        self.tell(DeviceEvent::Starting, now);
        (self.streaming, self.unanswered, self.warned) = (false, 0, None);
        self.framer.clear();
        self.state = match self.config.startup {
            Startup::Configure => State::Draining {
                quiet_at: now + QUIET,
                give_up_at: now + DRAIN_LIMIT,
            },
            Startup::Listen => State::Listening,
        };
    }

    fn ask(&mut self, question: Question, attempt: u8, now: HostTime) {
        let id = self.config.id;
        self.outgoing = match question {
            Question::Ping => Some(Packet::ping(id)),
            Question::TorqueOff => Packet::write(id, address::TORQUE_ENABLE, &[0]),
        };
        self.state = State::Asking {
            question,
            attempt,
            deadline: now + self.config.answer_timeout,
        };
    }

    fn read(&mut self, due: HostTime, now: HostTime) {
        self.framer.discard();
        self.outgoing = Some(Packet::read(
            self.config.id,
            address::PRESENT_STATE,
            wire::PRESENT_STATE_LEN,
        ));
        // Reads that are overdue are left out, not caught up.
        let on_time = due + self.config.period;
        let next = if on_time > now {
            on_time
        } else {
            now + self.config.period
        };
        self.state = State::Reading {
            deadline: now + self.config.answer_timeout,
            next,
        };
    }

    fn on_status(
        &mut self,
        error: StatusError,
        params: &[u8],
        at: HostTime,
    ) -> Result<(), DecodeError> {
        match self.state {
            State::Asking { question, .. } => {
                self.on_answer(question, error, params, at);
                Ok(())
            }
            State::Reading { next, .. } => {
                self.on_state(error, params, at)?;
                self.unanswered = 0;
                self.state = State::Pausing { next };
                Ok(())
            }
            // Answers to what others ask have other lengths.
            State::Listening if params.len() == usize::from(wire::PRESENT_STATE_LEN) => {
                self.on_state(error, params, at)
            }
            // An answer twice, or after its time: then its sample was counted as a gap.
            _ => {
                self.unasked += u64::from(self.streaming);
                Ok(())
            }
        }
    }

    fn on_answer(&mut self, question: Question, error: StatusError, params: &[u8], at: HostTime) {
        if error.code() != 0 {
            let reason = format!(
                "id {} refused {question:?} with error {}",
                self.config.id,
                error.code()
            );
            return self.lose(reason, at);
        }
        match (question, params) {
            (Question::Ping, [low, high, firmware]) => {
                let model = u16::from_le_bytes([*low, *high]);
                let identity = Identity {
                    model: model_name(model),
                    serial_number: String::new(),
                    firmware: firmware.to_string(),
                };
                self.tell(DeviceEvent::Identified(identity), at);
                self.ask(Question::TorqueOff, 1, at);
            }
            (Question::TorqueOff, []) => self.state = State::Pausing { next: at },
            // An answer to something else.
            _ => {}
        }
    }

    fn on_state(
        &mut self,
        error: StatusError,
        params: &[u8],
        arrival: HostTime,
    ) -> Result<(), DecodeError> {
        let state = PresentState::decode(params)?;
        if error != StatusError(0) && self.warned != Some(error) {
            self.warned = Some(error);
            let alert = if error.hardware_alert() {
                ", hardware alert (address 70 says which)"
            } else {
                ""
            };
            let text = format!(
                "id {} answers with error {}{alert}",
                self.config.id,
                error.code()
            );
            self.tell(DeviceEvent::Warning { text }, arrival);
        }
        if !core::mem::replace(&mut self.streaming, true) {
            self.framer.begin_counting();
            self.tell(DeviceEvent::Streaming, arrival);
        }
        let linkage = self.config.linkage;
        let angle_rad = f64::from(state.position) * TAU / COUNTS_PER_TURN;
        let rate_rad_s = f64::from(state.velocity) * VELOCITY_UNIT_RPM * TAU / 60.0;
        self.received += 1;
        self.readings.push_back(Reading::Width(WidthReading {
            at: SampleInstant {
                arrival,
                device_ns: None,
            },
            width_m: linkage.width_m(angle_rad),
            width_rate_m_s: linkage.width_slope_m_per_rad(angle_rad) * rate_rad_s,
            counts: state.position,
        }));
        Ok(())
    }

    fn on_unanswered_read(&mut self, next: HostTime, now: HostTime) {
        self.gaps += u64::from(self.streaming);
        self.unanswered += 1;
        if self.unanswered < self.config.lost_after {
            self.state = State::Pausing { next };
            return;
        }
        let Config {
            id, answer_timeout, ..
        } = self.config;
        let unanswered = self.unanswered;
        self.lose(
            format!(
                "id {id} left {unanswered} reads in a row unanswered for {answer_timeout:?} each: check power and cable"
            ),
            now,
        );
    }

    fn lose(&mut self, reason: String, now: HostTime) {
        self.tell(DeviceEvent::Lost { reason }, now);
        self.outgoing = None;
        self.state = State::Waiting(now + self.config.retry_after);
    }

    fn tell(&mut self, event: DeviceEvent, at: HostTime) {
        self.readings.push_back(Reading::Event { at, event });
    }
}

/// The maker's name of a model number, or the number.
fn model_name(number: u16) -> String {
    // Unconfirmed here: from memory of the maker's control tables. Only shown.
    match number {
        1020 => "XM430-W350".to_owned(),
        1030 => "XM430-W210".to_owned(),
        1060 => "XL430-W250".to_owned(),
        1190 => "XL330-M077".to_owned(),
        1200 => "XL330-M288".to_owned(),
        other => format!("model {other}"),
    }
}

impl Device for Dynamixel {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        if let State::Draining { quiet_at, .. } = &mut self.state {
            *quiet_at = stamps.arrival + QUIET;
            return Ok(());
        }
        self.framer.push(chunk);
        loop {
            match self.framer.next(wire::decode, |_| ()) {
                Found::Frame(Packet::Status { id, error, params }) if id == self.config.id => {
                    let handled = self.on_status(error, params.as_slice(), stamps.arrival);
                    self.framer.refused += u64::from(handled.is_err());
                    first_error = first_error.and(handled);
                }
                // Our own echo, or another device on the line.
                Found::Frame(_) => {}
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => return first_error,
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        match self.state {
            State::Idle => self.start(now),
            State::Waiting(until) if now >= until => self.start(now),
            State::Draining { quiet_at, .. } if now >= quiet_at => {
                self.ask(Question::Ping, 1, now)
            }
            State::Draining { give_up_at, .. } if now >= give_up_at => self.lose(
                format!(
                    "bytes came for {DRAIN_LIMIT:?} although nothing was asked: another device is on this port, or the bit rate is wrong"
                ),
                now,
            ),
            State::Asking {
                question,
                attempt,
                deadline,
            } if now >= deadline => {
                if attempt < ATTEMPTS {
                    self.framer.clear();
                    return self.ask(question, attempt + 1, now);
                }
                let Config {
                    id, answer_timeout, ..
                } = self.config;
                self.lose(
                    format!(
                        "id {id} left {question:?} unanswered for {answer_timeout:?}, {ATTEMPTS} times: check power, \
                         id and bit rate (the factory's is 57600)"
                    ),
                    now,
                );
            }
            State::Pausing { next } if now >= next => self.read(next, now),
            State::Reading { deadline, next } if now >= deadline => {
                self.on_unanswered_read(next, now)
            }
            _ => {}
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        match self.state {
            State::Idle => Some(HostTime::EPOCH),
            State::Draining {
                quiet_at,
                give_up_at,
            } => Some(quiet_at.min(give_up_at)),
            State::Waiting(at) => Some(at),
            State::Asking { deadline, .. } | State::Reading { deadline, .. } => Some(deadline),
            State::Pausing { next } => Some(next),
            State::Listening => None,
        }
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        let packet = self.outgoing.take()?;
        Some(Chunk::take_from(wire::encode(&packet).as_slice()).0)
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.readings.pop_front()
    }
}

impl Counted for Dynamixel {
    fn counts(&self) -> Counts {
        Counts {
            received: self.received,
            gaps: self.gaps,
            refused: self.framer.refused,
            skipped: self.framer.skipped + self.unasked,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
