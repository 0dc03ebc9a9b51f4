//! Bota Systems force-torque sensor, serial "gen0".
//!
//! Frame, 37 bytes, little-endian: 0 u8 0xAA | 1 u16 status | 3 6 x f32 force N, torque N m | 27 u32 timestamp, us, wraps |
//! 31 f32 temperature, deg C | 35 u16 CRC-16/X-25 over bytes 1..35. Status: 0 `app_took_too_long`, 1 `overrange`,
//! 2 `invalid_measurements`, 3 `raw_measurements`.
//!
//! # Source
//! `BOTAsys/matlab: bota_serial/`, the ROS drivers of the maker. Unconfirmed here: that frames flow after power-up, the digit
//! and the line end of an ack, the spacing of the boot text, rated loads, and 51200 / sinc as the rate.

mod command;

use std::collections::VecDeque;

use ft_wire::Chunk;

use self::command::{Command, Scanned};
use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::crc;
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::scene::Scene;
use crate::wrench_sensor::WrenchSensor;

/// Rates of baud codes 0 to 4, bit/s.
const BAUDS: [u32; 5] = [9600, 57_600, 115_200, 230_400, 460_800];
/// Line rate of a sensor that a maker's driver has set up, bit/s.
pub(crate) const BAUD_BPS: u32 = 460_800;
const FRAME_LENGTH: usize = 37;
const RATED_N: f64 = 500.0;
const RATED_NM: f64 = 15.0;

const TOOK_TOO_LONG: u16 = 1;
const OVERRANGE: u16 = 1 << 1;
const RAW: u16 = 1 << 3;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mode {
    Boot,
    Run,
    Config,
    Init,
}

/// What `s` saves and a reset loads.
#[derive(Clone, Copy, Debug)]
struct Settings {
    sinc: u16,
    filter_flags: [u8; 3],
    temperature_compensation: u8,
    calibrated: u8,
    baud_code: u8,
    offset: [f64; 6],
}

#[derive(Debug)]
pub(crate) struct BotaSerial {
    sensor: WrenchSensor,
    clock: DeviceClock,
    mode: Mode,
    settings: Settings,
    saved: Settings,
    /// The rate in force; a new one counts from the next reset.
    baud_code: u8,
    cadence: Cadence,
    inbox: Vec<u8>,
    last_byte: SimNanos,
    line_free: SimNanos,
    late: bool,
    script: VecDeque<(SimNanos, String)>,
}

impl BotaSerial {
    /// A sensor that an operator has set up for `rate_hz` at 460800 bit/s, and that has been on for a while.
    pub(crate) fn new(sensor: WrenchSensor, clock: DeviceClock, rate_hz: f64) -> Self {
        let settings = Settings {
            sinc: ((51_200.0 / rate_hz).round() as u16).clamp(51, 4096),
            filter_flags: [0, 0, 1],
            temperature_compensation: 0,
            calibrated: 1,
            baud_code: 4,
            offset: [0.0; 6],
        };
        let cadence = Cadence::starting(230_000, 51_200.0 / f64::from(settings.sinc), &clock);
        Self {
            sensor,
            clock,
            mode: Mode::Run,
            settings,
            saved: settings,
            baud_code: settings.baud_code,
            cadence,
            inbox: Vec::new(),
            last_byte: 0,
            line_free: 0,
            late: false,
            script: VecDeque::new(),
        }
    }

    fn baud(&self) -> u32 {
        BAUDS[usize::from(self.baud_code).min(4)]
    }

    fn run_from(&mut self, at: SimNanos) {
        self.mode = Mode::Run;
        self.cadence = Cadence::starting(
            at + 400_000,
            51_200.0 / f64::from(self.settings.sinc),
            &self.clock,
        );
    }

    fn sample(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.cadence.tick();
        if at < self.line_free {
            // The frame before is still on the line: this sample is skipped, and the next one says so.
            self.late = true;
            return;
        }
        let t = seconds(at);
        let read = self.sensor.read(scene.felt(t), t);
        let mut status = if self.late { TOOK_TOO_LONG } else { 0 };
        self.late = false;
        let over = |axis: usize| read[axis].abs() > if axis < 3 { RATED_N } else { RATED_NM };
        if (0..6).any(over) {
            status |= OVERRANGE;
        }
        let mut values: [f32; 6] =
            std::array::from_fn(|axis| (read[axis] + self.settings.offset[axis]) as f32);
        if self.settings.calibrated == 0 {
            status |= RAW;
            // Gauge units of our own choosing; nobody takes them for newtons.
            values = values.map(|value| value * 1234.5);
        }
        let frame = encode(
            status,
            values,
            self.clock.reading_ns(at),
            self.sensor.temperature(t) as f32,
        );
        self.line_free = at + FRAME_LENGTH as i64 * 10_000_000_000 / i64::from(self.baud());
        push_bytes(out, at, &frame);
    }

    fn reset(&mut self, at: SimNanos) {
        self.settings = self.saved;
        self.mode = Mode::Boot;
        self.inbox.clear();
        let Settings {
            temperature_compensation,
            calibrated,
            baud_code,
            ..
        } = self.saved;
        let millis = |after: i64| at + after * 1_000_000;
        self.script = VecDeque::from([
            (
                millis(120),
                format!("c,{temperature_compensation},{calibrated},0,{baud_code}\r\n"),
            ),
            (millis(350), "App Init\r\n".to_owned()),
            (
                millis(360),
                "name: BFT-SENS-SER-M8\r\nS/N: 000417\r\nFW version: 2.1.4\r\n".to_owned(),
            ),
            (millis(600), String::new()),
        ]);
    }

    fn execute(&mut self, at: SimNanos, command: Command, out: &mut Outbox<Chunk>) {
        let letter = command.letter();
        let configuring = self.mode == Mode::Config;
        let done = match command {
            Command::ConfigMode => {
                self.mode = Mode::Config;
                true
            }
            Command::InitMode => {
                self.mode = Mode::Init;
                true
            }
            Command::RunMode => {
                push_bytes(out, at, ack(letter, true).as_bytes());
                self.run_from(at);
                return;
            }
            Command::Communication([compensation, calibrated, format, baud]) if configuring => {
                // Only the binary format is played.
                let good = compensation <= 1 && calibrated <= 1 && format == 0 && baud <= 4;
                if good {
                    self.settings.temperature_compensation = compensation;
                    self.settings.calibrated = calibrated;
                    self.settings.baud_code = baud;
                }
                good
            }
            Command::Filter(sinc, flags) if configuring => {
                let good = (51..=4096).contains(&sinc) && flags.iter().all(|flag| *flag <= 1);
                if good {
                    self.settings.sinc = sinc;
                    self.settings.filter_flags = flags;
                }
                good
            }
            Command::Offset(offset) if configuring => {
                self.settings.offset = offset;
                true
            }
            Command::CalibrationRow(row) if configuring => row < 6,
            Command::Save if configuring => {
                self.saved = self.settings;
                true
            }
            Command::Load if configuring => {
                self.settings = self.saved;
                true
            }
            Command::Print if configuring => {
                push_bytes(out, at, self.printed().as_bytes());
                true
            }
            _ => false,
        };
        push_bytes(out, at, ack(letter, done).as_bytes());
    }

    fn printed(&self) -> String {
        let Settings {
            sinc,
            filter_flags: [chop, fast, fir],
            temperature_compensation,
            calibrated,
            baud_code,
            ..
        } = self.settings;
        format!(
            "c,{temperature_compensation},{calibrated},0,{baud_code}\r\nf,{sinc},{chop},{fast},{fir}\r\n"
        )
    }
}

impl Played<Chunk> for BotaSerial {
    fn next_event(&self) -> Option<SimNanos> {
        match self.mode {
            Mode::Boot => self.script.front().map(|(at, _)| *at),
            Mode::Run => Some(self.cadence.next()),
            Mode::Config | Mode::Init => None,
        }
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        match self.mode {
            Mode::Run => self.sample(at, scene, out),
            Mode::Boot => {
                let Some((_, text)) = self.script.pop_front() else {
                    return;
                };
                push_bytes(out, at, text.as_bytes());
                if text.starts_with("App Init") {
                    // The first line comes at the factory rate on a real sensor; here all text comes at one rate.
                    self.baud_code = self.saved.baud_code;
                }
                if self.script.is_empty() {
                    self.run_from(at);
                }
            }
            Mode::Config | Mode::Init => {}
        }
    }

    fn receive(&mut self, at: SimNanos, frame: &Chunk, _scene: &Scene, out: &mut Outbox<Chunk>) {
        if at - self.last_byte > 1_000_000_000 {
            self.inbox.clear();
        }
        self.last_byte = at;
        for byte in frame.as_slice() {
            if *byte == b'#' {
                self.reset(at);
                continue;
            }
            match self.mode {
                Mode::Boot => continue,
                // While frames flow only a change of mode is heard.
                Mode::Run if !matches!(byte, b'C' | b'I') => continue,
                _ => self.inbox.push(*byte),
            }
            match command::scan(&self.inbox) {
                Scanned::More => {}
                Scanned::Whole(command) => {
                    self.inbox.clear();
                    self.execute(at, command, out);
                }
                Scanned::Never => {
                    let letter = char::from(self.inbox[0]);
                    self.inbox.clear();
                    if letter.is_ascii_graphic() {
                        push_bytes(out, at, ack(letter, false).as_bytes());
                    }
                }
            }
        }
    }

    fn line_rate(&self) -> Option<u32> {
        Some(self.baud())
    }
}

fn ack(letter: char, done: bool) -> String {
    format!("r,0,{letter},{}\r\n", u8::from(!done))
}

fn encode(status: u16, values: [f32; 6], device_ns: u64, temperature: f32) -> Vec<u8> {
    // Microseconds, and the counter wraps at 2^32.
    let microseconds = (device_ns / 1000) as u32;
    let mut frame = vec![0xAA];
    frame.extend(status.to_le_bytes());
    frame.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    frame.extend(microseconds.to_le_bytes());
    frame.extend(temperature.to_le_bytes());
    let check = crc::x25(&frame[1..]);
    frame.extend(check.to_le_bytes());
    frame
}

#[cfg(test)]
mod tests;
