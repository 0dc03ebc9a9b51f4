//! Bota Systems Rokubi, SensONE, MiniONE on a serial line (USB or RS-422).
//!
//! ```text
//! Stop ('C', acknowledged) -> Drain (quiet) -> CommSetup -> Filter -> Run -> Streaming
//!      any step unanswered, or a stream that falls silent -> Lost -> wait -> Stop
//! ```
//!
//! The line must be open at [`Config::baud`]; the sensor is told the same rate again, nothing is saved in it. Characters
//! leave 5 ms apart, as the maker's driver sends them. Who the sensor is comes from its boot text only, which it prints
//! when it is powered; a sensor that was on already stays nameless.
//!
//! **Sign**: the maker's documents at hand do not say on which side the wrench acts. The driver takes it as environment
//! on tool and flips nothing; [`Config::sign`] changes that. Unconfirmed on hardware: hang a known weight on the tool,
//! its pull must show as the weight's own direction.
//!
//! **Stamps**: every frame that a chunk completes gets the chunk's arrival, so the earlier of several frames look late by
//! up to the chunk's length; the sensor's microsecond clock in `device_ns` has no such error.
//!
//! # Source
//! hardware.md 2.1, see [`ft_wire::bota_serial`].

mod boot_text;
mod config;

use std::collections::VecDeque;
use std::time::Duration;

use ft_wire::bota_serial::{self as wire, Ack, Command, Sample, Status};
pub use ft_wire::bota_serial::{BaudRate, Filter};
use ft_wire::{Chunk, DecodeError, HostTime, Parsed, Unwrapper, Wrench};

use boot_text::BootText;
pub use config::{Config, GAUGE_RATE_HZ};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::options::Startup;
use crate::outbox::Outbox;
use crate::reading::{Counts, DeviceEvent, Quality, Reading, SampleInstant, WrenchReading};
use crate::sequence::{Seen, Sequence};

/// Silence that ends the draining of a stopped stream.
const QUIET: Duration = Duration::from_millis(30);
/// Longest draining: a sensor that streams on after its acknowledgement did not stop.
const DRAIN_LIMIT: Duration = Duration::from_secs(1);
const PACE: Duration = Duration::from_micros(wire::COMMAND_PACE_US);

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// Made, not begun.
    Idle,
    /// A command is out; its acknowledgement must come by the deadline.
    Asking(Command, HostTime),
    /// Stopped; what is still under way runs off.
    Draining {
        quiet_at: HostTime,
        give_up_at: HostTime,
    },
    /// Sends nothing, waits for a first sample.
    Listening(HostTime),
    /// Samples flow; the next must come by the deadline.
    Streaming(HostTime),
    /// Lost; the next attempt.
    Waiting(HostTime),
}

/// The driver.
#[derive(Debug)]
pub struct BotaSerial {
    config: Config,
    state: State,
    framer: Framer,
    text: BootText,
    outbox: Outbox,
    ticks: Unwrapper,
    sequence: Sequence,
    warned: u16,
    unread_bytes: u64,
    received: u64,
    duplicated: u64,
    readings: VecDeque<Reading>,
}

enum Message {
    Sample(Sample),
    Ack(Ack),
}

/// Reads the message at the start of `bytes`. A sensor that acknowledges `C` falls silent, maybe in the middle of a frame: what seems to begin one has the
/// acknowledgement within, and nothing after it, so that it would be waited for in vain.
fn decode(bytes: &[u8]) -> Result<Parsed<Message>, DecodeError> {
    if bytes.first() == Some(&b'r') {
        return Ok(match wire::decode_ack(bytes)? {
            Parsed::Complete { value, used } => Parsed::Complete {
                value: Message::Ack(value),
                used,
            },
            Parsed::Incomplete => Parsed::Incomplete,
        });
    }
    Ok(match wire::decode(bytes)? {
        Parsed::Complete { value, used } => Parsed::Complete {
            value: Message::Sample(value),
            used,
        },
        Parsed::Incomplete if holds_ack(bytes) => {
            return Err(DecodeError::Field {
                name: "header",
                value: u32::from(wire::HEADER),
            });
        }
        Parsed::Incomplete => Parsed::Incomplete,
    })
}

fn holds_ack(bytes: &[u8]) -> bool {
    let is_ack = |piece| matches!(wire::decode_ack(piece), Ok(Parsed::Complete { .. }));
    bytes.windows(wire::ACK_LEN).any(is_ack)
}

impl BotaSerial {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config: config.patient(),
            state: State::Idle,
            framer: Framer::new(),
            text: BootText::new(),
            outbox: Outbox::default(),
            ticks: Unwrapper::new(32),
            sequence: Sequence::new(),
            warned: 0,
            unread_bytes: 0,
            received: 0,
            duplicated: 0,
            readings: VecDeque::with_capacity(32),
        }
    }

    fn start(&mut self, now: HostTime) {
        self.tell(DeviceEvent::Starting, now);
        self.framer.clear();
        self.ticks.reset();
        self.sequence.forget();
        (self.warned, self.unread_bytes) = (0, 0);
        if let Some(text) = self.config.too_fast() {
            self.tell(DeviceEvent::Warning { text }, now);
        }
        match self.config.startup {
            Startup::Configure => self.ask(Command::Config, now),
            Startup::Listen => self.state = State::Listening(now + self.config.ack_timeout),
        }
    }

    fn ask(&mut self, command: Command, now: HostTime) {
        let sent_at = self.outbox.queue(command.text().as_bytes(), PACE, now);
        self.state = State::Asking(command, sent_at + self.config.ack_timeout);
    }

    fn lose(&mut self, reason: String, now: HostTime) {
        self.tell(DeviceEvent::Lost { reason }, now);
        self.outbox.clear();
        self.framer.clear();
        self.state = match self.config.startup {
            Startup::Configure => State::Waiting(now + self.config.retry_after),
            Startup::Listen => State::Listening(HostTime::FAR_FUTURE),
        };
    }

    fn on_ack(&mut self, ack: Ack, now: HostTime) {
        if self.config.startup == Startup::Listen && matches!(ack.command, b'C' | b'R') {
            // Whoever set the sensor up paused its stream: no gap.
            self.sequence.forget();
            self.state = State::Listening(now + self.config.ack_timeout);
            return;
        }
        let State::Asking(command, _) = self.state else {
            return;
        };
        if command.ack_letter() != Some(ack.command) {
            return;
        }
        if ack.return_code != 0 {
            let text = String::from_utf8_lossy(command.text().as_bytes()).into_owned();
            return self.lose(
                format!("the sensor refused `{text}` with code {}", ack.return_code),
                now,
            );
        }
        match command {
            Command::Config => {
                self.state = State::Draining {
                    quiet_at: now + QUIET,
                    give_up_at: now + DRAIN_LIMIT,
                };
            }
            Command::CommSetup { .. } => self.ask(Command::Filter(self.config.filter), now),
            Command::Filter(_) => self.ask(Command::Run, now),
            // The first sample shows that it runs.
            _ => {}
        }
    }

    fn on_sample(&mut self, sample: &Sample, stamps: RxStamps) {
        let arrival = stamps.arrival;
        match self.state {
            State::Streaming(_) => {}
            State::Asking(Command::Run, _) | State::Listening(_) => {
                self.tell(DeviceEvent::Streaming, arrival);
                self.framer.begin_counting();
            }
            // A stream that is being stopped.
            _ => return,
        }
        self.state = State::Streaming(arrival + self.config.silence_timeout);
        let Some(device_ns) = self.place(sample.timestamp_us, arrival) else {
            return;
        };
        self.warn_of(sample.status, arrival);
        let wrench = Wrench::new(sample.force.map(f64::from), sample.torque.map(f64::from));
        self.received += 1;
        self.readings.push_back(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: Some(device_ns),
            },
            wrench: self.config.sign.apply(wrench),
            temperature_celsius: Some(sample.temperature_celsius)
                .filter(|celsius| celsius.is_finite()),
            quality: quality(sample.status),
            status_bits: sample.status.0.into(),
        }));
    }

    /// The sample's instant on the sensor's unwrapped clock, ns; `None` for a duplicate.
    fn place(&mut self, timestamp_us: u32, arrival: HostTime) -> Option<i64> {
        let device_ns = self.ticks.unwrap(timestamp_us) * 1_000;
        match self.sequence.observe(device_ns, arrival) {
            Seen::New | Seen::Late => Some(device_ns),
            Seen::Duplicate => {
                self.duplicated += 1;
                None
            }
            Seen::Restarted { was_ns } => {
                self.ticks.reset();
                self.sequence.forget();
                let device_ns = self.ticks.unwrap(timestamp_us) * 1_000;
                self.sequence.observe(device_ns, arrival);
                let text = format!(
                    "the sensor's clock went from {} us to {timestamp_us} us: it restarted, its filter may be the saved one",
                    was_ns / 1_000
                );
                self.tell(DeviceEvent::Warning { text }, arrival);
                Some(device_ns)
            }
        }
    }

    /// Each bad bit once per stream.
    fn warn_of(&mut self, status: Status, at: HostTime) {
        let fresh = status.0 & !self.warned;
        if fresh == 0 {
            return;
        }
        self.warned |= status.0;
        for (bit, text) in [
            (
                Status::APP_TOOK_TOO_LONG,
                "the sensor skipped samples: raise the sinc length",
            ),
            (
                Status::OVERRANGE,
                "a component is beyond the sensor's range",
            ),
            (
                Status::INVALID_MEASUREMENTS,
                "invalid measurements (saturated, short or open gauge): unload the sensor, it may be damaged",
            ),
            (
                Status::RAW_MEASUREMENTS,
                "gauge values instead of N and N m: the calibration matrix is off",
            ),
        ] {
            if fresh & bit != 0 {
                let text = format!("status {:#06x}: {text}", status.0);
                self.tell(DeviceEvent::Warning { text }, at);
            }
        }
    }

    fn tell(&mut self, event: DeviceEvent, at: HostTime) {
        self.readings.push_back(Reading::Event { at, event });
    }

    fn on_boot_text(&mut self, now: HostTime) {
        if let Some(identity) = self.text.identity.take() {
            self.tell(DeviceEvent::Identified(identity), now);
        }
        if core::mem::take(&mut self.text.booted) && matches!(self.state, State::Streaming(_)) {
            self.lose(
                "the sensor restarted (boot text in the stream): check its supply".to_owned(),
                now,
            );
        }
    }

    fn lost_reason(&self, command: Command) -> String {
        let text = String::from_utf8_lossy(command.text().as_bytes()).into_owned();
        let (baud, timeout) = (self.config.baud.bps(), self.config.ack_timeout);
        let awaited = match command {
            Command::Run => "no sample".to_owned(),
            _ => format!("no answer to `{text}`"),
        };
        match self.unread_bytes {
            0 => format!(
                "{awaited} within {timeout:?}, no bytes at all: check power, cable and port"
            ),
            bytes => format!(
                "{awaited} within {timeout:?}, {bytes} bytes that mean nothing: check the bit rate \
                 (open at {baud} bit/s, the factory's is 230400)"
            ),
        }
    }
}

fn quality(status: Status) -> Quality {
    if status.has(Status::INVALID_MEASUREMENTS | Status::RAW_MEASUREMENTS) {
        Quality::Invalid
    } else if status.has(Status::OVERRANGE) {
        Quality::Overrange
    } else {
        Quality::Good
    }
}

impl Device for BotaSerial {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        if let State::Draining { quiet_at, .. } = &mut self.state {
            *quiet_at = stamps.arrival + QUIET;
        }
        self.framer.push(chunk);
        loop {
            let (text, unread) = (&mut self.text, &mut self.unread_bytes);
            let found = self.framer.next(decode, |byte| {
                *unread += 1;
                text.push(byte);
            });
            match found {
                Found::Frame(Message::Sample(sample)) => self.on_sample(&sample, stamps),
                Found::Frame(Message::Ack(ack)) => {
                    // A line end follows.
                    self.framer.unlock();
                    self.on_ack(ack, stamps.arrival);
                }
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => break,
            }
        }
        self.on_boot_text(stamps.arrival);
        first_error
    }

    fn handle_timeout(&mut self, now: HostTime) {
        let Config {
            baud,
            temperature_compensation,
            silence_timeout,
            ..
        } = self.config;
        match self.state {
            State::Idle => self.start(now),
            State::Waiting(until) if now >= until => self.start(now),
            State::Asking(command, deadline) if now >= deadline => {
                self.lose(self.lost_reason(command), now);
            }
            State::Draining { give_up_at, .. } if now >= give_up_at => {
                let reason = "the sensor acknowledged `C` but streams on: power it off and on";
                self.lose(reason.to_owned(), now);
            }
            State::Draining { quiet_at, .. } if now >= quiet_at => {
                self.framer.clear();
                self.unread_bytes = 0;
                self.ask(
                    Command::CommSetup {
                        temperature_compensation,
                        calibration: true,
                        baud,
                    },
                    now,
                );
            }
            State::Listening(deadline) if now >= deadline => {
                let timeout = self.config.ack_timeout;
                self.lose(
                    format!("no sample within {timeout:?}: is the sensor set up and running?"),
                    now,
                );
            }
            State::Streaming(deadline) if now >= deadline => {
                self.lose(
                    format!("no sample for {silence_timeout:?}: check power and cable"),
                    now,
                );
            }
            _ => {}
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        let state = match self.state {
            State::Idle => HostTime::EPOCH,
            State::Draining {
                quiet_at,
                give_up_at,
            } => quiet_at.min(give_up_at),
            State::Asking(_, at)
            | State::Listening(at)
            | State::Streaming(at)
            | State::Waiting(at) => at,
        };
        Some(self.outbox.due().map_or(state, |due| due.min(state)))
    }

    fn poll_transmit(&mut self, now: HostTime) -> Option<Chunk> {
        self.outbox.take(now)
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.readings.pop_front()
    }
}

impl Counted for BotaSerial {
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
