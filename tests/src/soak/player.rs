//! A device as its driver meets it: answers to the set-up, frames at an even pace, faults.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use ft_capture::item::Body;
use ft_drivers::priority::{Duty, prefer_this_thread};
use ft_drivers::{Clock as _, MonotonicClock};
use ft_wire::robotous_rft::{Command, FilterSetting, Outcome, Record, Response, Text};
use ft_wire::{
    Chunk, DecodeError, HostTime, Parsed, bota_serial, encoder_line, pose_stream, robotous_rft,
};

use super::account::{self, Account, Fate, Sent};
use crate::terminal::Terminal;

/// The devices that can be played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Bota force-torque sensor; its clock shows what is missing.
    Bota,
    /// Robotous force-torque sensor on a serial line; nothing shows a frame that is missing as a whole.
    Robotous,
    /// An encoder in our line format, with a clock.
    Encoder,
    /// A tracker in our format, with a clock.
    Pose,
}

const BOTA_SETTINGS: &str = "c,0,1,0,4";
const BOTA_FILTER: &str = "f,64,0,0,1";
const ROBOTOUS_RATE_HZ: u16 = 1000;
/// Robotous counts per N, the driver's default.
const COUNTS_PER_NEWTON: f64 = 50.0;

impl Kind {
    /// The driver's name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bota => "bota_serial",
            Self::Robotous => "robotous_uart",
            Self::Encoder => "encoder_line",
            Self::Pose => "pose_stream",
        }
    }

    /// Whether the device stamps its samples.
    #[must_use]
    pub const fn has_clock(self) -> bool {
        !matches!(self, Self::Robotous)
    }

    /// Whether the device sends from power-up and takes no commands.
    const fn sends_unasked(self) -> bool {
        matches!(self, Self::Encoder | Self::Pose)
    }

    pub(super) const fn settings(self) -> &'static str {
        match self {
            Self::Bota | Self::Pose => "",
            Self::Robotous => "rate_hz = 1000\nbaud_bps = 921600",
            Self::Encoder => "counts_per_turn = 4096",
        }
    }

    /// The frame that carries `number` in its values.
    fn frame(self, number: u64, stamp_ns: i64) -> Chunk {
        let [low, middle, high] = digits(number);
        let sum = low + middle + high;
        let of = |bytes: &[u8]| Chunk::take_from(bytes).0;
        let clock_us = (stamp_ns / 1000) as u32;
        match self {
            Self::Bota => of(&bota_serial::encode(&bota_serial::Sample {
                status: bota_serial::Status(0),
                force: [low, middle, high].map(f32::from),
                torque: [f32::from(sum), 0.25, -0.25],
                timestamp_us: clock_us,
                temperature_celsius: 25.0,
            })),
            Self::Robotous => of(&robotous_rft::encode_response(&Response::Stream(Record {
                force: [low, middle, high],
                torque: [sum, 1, -1],
                overload: 0,
            }))),
            Self::Encoder => encoder_line::encode(&encoder_line::Sample {
                time_us: clock_us,
                counts: number as i32,
            }),
            Self::Pose => of(&pose_stream::encode(&pose_stream::PoseSample {
                tracking_ns: stamp_ns,
                position: [low, middle, high].map(f64::from),
                quaternion: [0.0, 0.0, 0.6, 0.8],
                quality_score: 1.0,
            })),
        }
    }

    /// The number that a sample carries; `None` when its values were never sent.
    pub(super) fn number(self, body: &Body) -> Option<u64> {
        let sent = match (self, body) {
            (Self::Bota, Body::Wrench(reading)) => {
                let [x, y, z, sum, a, b] = reading.wrench.to_array();
                (sum == x + y + z && a == 0.25 && b == -0.25).then_some([x, y, z])
            }
            (Self::Robotous, Body::Wrench(reading)) => {
                let [x, y, z, sum, ..] = reading.wrench.to_array();
                let [x, y, z] = [x, y, z].map(|force| (force * COUNTS_PER_NEWTON).round());
                ((sum * 2000.0).round() == x + y + z).then_some([x, y, z])
            }
            (Self::Encoder, Body::Width(reading)) => return u64::try_from(reading.counts).ok(),
            (Self::Pose, Body::Pose(reading)) => Some(reading.pose.position),
            _ => None,
        };
        let whole = |digit: f64| (0.0..4096.0).contains(&digit) && digit.fract() == 0.0;
        let [low, middle, high] = sent.filter(|digits| digits.iter().all(|digit| whole(*digit)))?;
        Some(low as u64 | (middle as u64) << 12 | (high as u64) << 24)
    }

    /// Whether a spoiled frame and the one behind it hold a frame that was never sent: a check sum of 16 bits fits once in 65 536 times.
    fn takes_for_a_frame(self, frame: &[u8], fault: Fault, next: &[u8]) -> bool {
        if fault.fate() != Fate::Spoiled {
            return false;
        }
        let mut line = Vec::with_capacity(256);
        write(&mut line, frame, Some(fault));
        let spoiled = line.len();
        line.extend(next);
        (0..spoiled).any(|at| {
            let line = &line[at..];
            match self {
                Self::Bota => is_whole(bota_serial::decode(line)),
                Self::Robotous => is_whole(robotous_rft::decode_response(line)),
                Self::Encoder => is_whole(encoder_line::decode(line)),
                Self::Pose => is_whole(pose_stream::decode(line)),
            }
        })
    }

    /// What the device answers to what it has heard so far, and whether it sends from now on.
    fn answer(self, heard: &mut Vec<u8>) -> Option<(Vec<u8>, Option<bool>)> {
        match self {
            Self::Bota => answer_bota(heard),
            Self::Robotous => answer_robotous(heard),
            Self::Encoder | Self::Pose => None,
        }
    }
}

fn is_whole<T>(parsed: Result<Parsed<T>, DecodeError>) -> bool {
    matches!(parsed, Ok(Parsed::Complete { .. }))
}

/// Three digits of twelve bits.
fn digits(number: u64) -> [i16; 3] {
    [0, 12, 24].map(|shift| (number >> shift & 0xFFF) as i16)
}

fn answer_bota(heard: &mut Vec<u8>) -> Option<(Vec<u8>, Option<bool>)> {
    let (command, sends) = [
        ("C", Some(false)),
        (BOTA_SETTINGS, None),
        (BOTA_FILTER, None),
        ("R", Some(true)),
    ]
    .into_iter()
    .find(|(text, _)| heard.ends_with(text.as_bytes()))?;
    heard.clear();
    let mut answer = bota_serial::encode_ack(bota_serial::Ack {
        digit: 0,
        command: command.as_bytes()[0],
        return_code: 0,
    })
    .to_vec();
    answer.extend(b"\r\n");
    Some((answer, sends))
}

fn answer_robotous(heard: &mut Vec<u8>) -> Option<(Vec<u8>, Option<bool>)> {
    let Ok(Parsed::Complete { value, used }) = robotous_rft::decode_command(heard) else {
        return None;
    };
    heard.drain(..used);
    let text = |text| Text::new(text).unwrap_or(Text([0; 15]));
    let (response, sends) = match value {
        Command::ReadModel => (Some(Response::Model(text("RFT60-HA01"))), None),
        Command::ReadSerialNumber => (Some(Response::SerialNumber(text("SOAK"))), None),
        Command::ReadFirmware => (Some(Response::Firmware(text("1.0"))), None),
        Command::ReadRate => (
            robotous_rft::rate_code(ROBOTOUS_RATE_HZ).map(Response::Rate),
            None,
        ),
        Command::ReadFilter => (Some(Response::Filter(FilterSetting::NONE)), None),
        Command::SetRate(_) => (Some(Response::RateSet(Outcome::TAKEN)), None),
        Command::SetFilter(_) => (Some(Response::FilterSet(Outcome::TAKEN)), None),
        Command::Start => (None, Some(true)),
        Command::Stop => (None, Some(false)),
        _ => (None, None),
    };
    let answer = response.map_or_else(Vec::new, |response| {
        robotous_rft::encode_response(&response).to_vec()
    });
    Some((answer, sends))
}

/// When all players end.
#[derive(Clone, Debug)]
pub(super) struct Orders {
    /// No frame is due after this.
    pub(super) end: HostTime,
    /// No unplugging and no silence begins after this.
    calm: HostTime,
    let_go: Arc<AtomicBool>,
}

impl Orders {
    pub(super) fn new(end: HostTime, calm_end: Duration) -> Self {
        Self {
            end,
            calm: end - calm_end,
            let_go: Arc::default(),
        }
    }

    /// The terminals may go.
    pub(super) fn let_go(&self) {
        self.let_go.store(true, Ordering::Relaxed);
    }
}

/// What a player did.
#[derive(Clone, Debug, Default)]
pub struct Played {
    /// Frames, those that were spoiled or left out as well.
    pub sent: u64,
    /// Times that it was unplugged.
    pub unplugged: u64,
    /// Times that it fell silent for longer than a driver waits.
    pub silences: u64,
    /// Faults that were not done because the check sum fits by chance: no driver could see them.
    pub unseen: u64,
}

/// Between two looks at the terminal.
const TICK: Duration = Duration::from_millis(1);
/// Longer than any driver here waits for a sample.
const SILENCE: Duration = Duration::from_millis(1300);
/// A player that the system held up for so long falls silent on purpose: nobody could say which side of the driver's limit it was on.
const HELD_UP: Duration = Duration::from_millis(350);
/// Frames without a fault after each beginning and before each unplugging or silence: more than a terminal's buffer holds.
const CALM_FRAMES: u64 = 300;
/// Whole frames at least between two faults, so that each shows by itself.
const APART: u64 = 3;
/// One frame in so many meets a fault.
const FAULT_ONE_IN: u64 = 50;
/// Frames that may wait for room in the terminal.
const BACKLOG_BYTES: usize = 2048;

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// Not sending: not opened, or not told to.
    Waiting,
    /// Sending since its frame of this number.
    Sending(u64),
    /// Sends nothing until then.
    Silent(HostTime),
    /// Not there until then.
    Unplugged(HostTime),
}

#[derive(Debug)]
pub(super) struct Player {
    kind: Kind,
    period_ns: f64,
    clock: MonotonicClock,
    terminal: Terminal,
    account: Account,
    random: Option<Random>,
    state: State,
    stretch: u32,
    /// When the first frame of the stretch was due, and how many were since.
    due_from: HostTime,
    due_count: u64,
    whole_since_fault: u64,
    /// When it is unplugged or falls silent next, and the number of frames from which it is calm before that.
    next_event: Option<HostTime>,
    calm_from: Option<u64>,
    heard: Vec<u8>,
    to_write: Vec<u8>,
    played: Played,
}

impl Player {
    /// A device behind `port`, with faults of this seed.
    pub(super) fn new(
        kind: Kind,
        rate_hz: f64,
        seed: Option<u64>,
        port: &Path,
        clock: MonotonicClock,
    ) -> io::Result<Self> {
        Ok(Self {
            kind,
            period_ns: 1e9 / rate_hz,
            clock,
            terminal: Terminal::new(port)?,
            account: account::opened(),
            random: seed.map(Random),
            state: State::Waiting,
            stretch: 0,
            due_from: HostTime::EPOCH,
            due_count: 0,
            whole_since_fault: 0,
            next_event: None,
            calm_from: None,
            heard: Vec::new(),
            to_write: Vec::with_capacity(2 * BACKLOG_BYTES),
            played: Played::default(),
        })
    }

    pub(super) fn account(&self) -> Account {
        Arc::clone(&self.account)
    }

    pub(super) fn start(mut self, orders: Orders) -> io::Result<JoinHandle<Played>> {
        std::thread::Builder::new()
            .name(format!("play-{}", self.kind.name()))
            .spawn(move || {
                let _ = prefer_this_thread(Duty::Acquisition);
                while !orders.let_go.load(Ordering::Relaxed) {
                    let now = self.clock.now();
                    self.turn(now, &orders);
                    self.clock.wait_until(now + TICK);
                }
                self.played
            })
    }

    fn turn(&mut self, now: HostTime, orders: &Orders) {
        match self.state {
            State::Unplugged(until) if now < until => return,
            State::Unplugged(_) => {
                if self.terminal.plug_in().is_ok() {
                    self.state = State::Waiting;
                }
                return;
            }
            State::Silent(until) if now < until => {}
            State::Silent(_) => self.begin(now),
            State::Waiting if self.kind.sends_unasked() && self.terminal.is_open() => {
                self.begin(now);
            }
            State::Waiting | State::Sending(_) => {}
        }
        self.listen(now);
        if let State::Sending(since) = self.state {
            self.send(now, since, orders);
        }
        let taken = self.terminal.write(&self.to_write);
        self.to_write.drain(..taken);
    }

    /// The first frame of a stretch is due now.
    fn begin(&mut self, now: HostTime) {
        self.stretch += 1;
        (self.due_from, self.due_count, self.calm_from) = (now, 0, None);
        self.state = State::Sending(self.played.sent);
        if let Some(random) = &mut self.random {
            self.next_event = Some(now + Duration::from_millis(2_000 + random.below(6_000)));
        }
    }

    fn listen(&mut self, now: HostTime) {
        let mut buffer = [0; 256];
        let heard = self.terminal.read(&mut buffer);
        self.heard.extend(heard);
        while let Some((answer, sends)) = self.kind.answer(&mut self.heard) {
            self.to_write.extend(answer);
            match sends {
                Some(true) => self.begin(now),
                Some(false) => self.state = State::Waiting,
                None => {}
            }
        }
    }

    fn send(&mut self, now: HostTime, since: u64, orders: &Orders) {
        let until = now.min(orders.end);
        let next_due = self.due(self.due_count);
        if until.saturating_since(next_due) > HELD_UP {
            // Whatever it had yet to do in this stretch.
            return self.fall_silent(now);
        }
        if self.event_is_due(now, orders) {
            return self.interrupt(now);
        }
        let calm = self.played.sent < since + CALM_FRAMES
            || self.calm_from.is_some()
            || now > orders.end - Duration::from_secs(2);
        while self.due(self.due_count) <= until && self.to_write.len() < BACKLOG_BYTES {
            self.send_one(calm);
        }
    }

    fn due(&self, count: u64) -> HostTime {
        self.due_from + Duration::from_nanos((count as f64 * self.period_ns) as u64)
    }

    /// Whether it is time for an unplugging or a silence, after enough frames without a fault.
    fn event_is_due(&mut self, now: HostTime, orders: &Orders) -> bool {
        if now > orders.calm || self.next_event.is_none_or(|at| now < at) {
            return false;
        }
        let from = *self.calm_from.get_or_insert(self.played.sent);
        self.played.sent >= from + CALM_FRAMES
    }

    fn interrupt(&mut self, now: HostTime) {
        let Some(random) = &mut self.random else {
            return;
        };
        if random.below(2) == 0 {
            return self.fall_silent(now);
        }
        let away = Duration::from_millis(200 + random.below(1_300));
        self.terminal.unplug();
        self.to_write.clear();
        self.heard.clear();
        self.played.unplugged += 1;
        self.state = State::Unplugged(now + away);
    }

    fn fall_silent(&mut self, now: HostTime) {
        self.played.silences += 1;
        self.state = State::Silent(now + SILENCE);
    }

    fn send_one(&mut self, calm: bool) {
        let number = self.played.sent;
        let stamp_ns = self.due(self.due_count).as_nanos();
        self.due_count += 1;
        self.played.sent += 1;
        let frame = self.kind.frame(number, stamp_ns);
        self.whole_since_fault += 1;
        let spared = calm || self.whole_since_fault <= APART;
        let fault = self.random.as_mut().and_then(|random| {
            let hit = !spared && random.below(FAULT_ONE_IN) == 0;
            hit.then(|| Fault::draw(random, self.kind, frame.as_slice().len()))
        });
        let fault = fault.filter(|fault| {
            let next = self
                .kind
                .frame(number + 1, self.due(self.due_count).as_nanos());
            let unseen = self
                .kind
                .takes_for_a_frame(frame.as_slice(), *fault, next.as_slice());
            self.played.unseen += u64::from(unseen);
            !unseen
        });
        if fault.is_some() {
            self.whole_since_fault = 0;
        }
        let entry = Sent {
            number,
            stretch: self.stretch,
            fate: fault.map_or(Fate::Whole, Fault::fate),
            noise: matches!(fault, Some(Fault::Noise(_))),
        };
        self.account
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push_back(entry);
        write(&mut self.to_write, frame.as_slice(), fault);
    }
}

/// What befalls a frame.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// This bit is flipped.
    Flipped(usize),
    /// This byte is left out.
    ByteLost(usize),
    /// All from this byte on is left out.
    Cut(usize),
    Twice,
    /// So many bytes of nobody's go before it.
    Noise(u8),
}

impl Fault {
    fn draw(random: &mut Random, kind: Kind, length: usize) -> Self {
        let below = |random: &mut Random, bound: usize| random.below(bound as u64) as usize;
        // The last two bytes are never lost alone: a line's carriage return may be missing, and a last byte that is the same as the
        // next frame's first could be either's.
        let length = length - 2;
        match random.below(5) {
            0 => Self::Flipped(below(random, 8 * length)),
            1 => Self::ByteLost(below(random, length)),
            2 => Self::Noise(1 + random.below(8) as u8),
            // Nothing shows what a device without a clock lost as a whole, or sent twice.
            3 if kind.has_clock() => Self::Twice,
            4 if kind.has_clock() => Self::Cut(below(random, length)),
            _ => Self::Cut(1 + below(random, length - 1)),
        }
    }

    const fn fate(self) -> Fate {
        match self {
            Self::Flipped(_) | Self::ByteLost(_) => Fate::Spoiled,
            Self::Cut(0) => Fate::Lost,
            Self::Cut(_) => Fate::Spoiled,
            Self::Twice => Fate::Twice,
            Self::Noise(_) => Fate::Whole,
        }
    }
}

/// Appends the frame as the line carries it.
fn write(line: &mut Vec<u8>, frame: &[u8], fault: Option<Fault>) {
    match fault {
        None => line.extend(frame),
        Some(Fault::Twice) => line.extend(frame.iter().chain(frame)),
        Some(Fault::Cut(at)) => line.extend(&frame[..at]),
        Some(Fault::ByteLost(at)) => {
            line.extend(frame[..at].iter().chain(&frame[at + 1..]));
        }
        Some(Fault::Flipped(bit)) => {
            let begin = line.len();
            line.extend(frame);
            line[begin + bit / 8] ^= 1 << (bit % 8);
        }
        Some(Fault::Noise(count)) => {
            // A line that floats reads as zeros and ones.
            line.extend((0..count).map(|at| if at % 2 == 0 { 0x00 } else { 0xFF }));
            line.extend(frame);
        }
    }
}

/// The splitmix64 generator.
#[derive(Debug)]
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (mixed ^ (mixed >> 31)) % bound
    }
}
