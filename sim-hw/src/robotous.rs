//! Robotous RFT: what is the same on every interface.
//!
//! # Source
//! RFT Series manual 1.82, sections 3.4-3.7: eight command bytes D1..D8 in, sixteen response bytes D1..D16 out. Idle after
//! power-up. While it streams it executes only Stop and Set Bias, which have no response. Output rate, filter, baud and ids
//! are kept over a reboot; streaming and bias are not. The padding of the ASCII fields is not in the manual: NUL here.

pub(crate) mod can;
pub(crate) mod model;
pub(crate) mod uart;

pub(crate) use model::Model;

use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::device::seconds;
use crate::scene::Scene;
use crate::wrench_sensor::{LowPass, WrenchSensor};

const MODEL_NAME: u8 = 0x01;
const SERIAL_NUMBER: u8 = 0x02;
const FIRMWARE: u8 = 0x03;
const SET_IDS: u8 = 0x04;
const READ_IDS: u8 = 0x05;
const SET_BAUD: u8 = 0x06;
const READ_BAUD: u8 = 0x07;
const SET_FILTER: u8 = 0x08;
const READ_FILTER: u8 = 0x09;
const ONCE: u8 = 0x0A;
const START: u8 = 0x0B;
const STOP: u8 = 0x0C;
const SET_RATE: u8 = 0x0F;
const READ_RATE: u8 = 0x10;
const SET_BIAS: u8 = 0x11;
const OVERLOADS: u8 = 0x12;

/// Output rates of codes 0 to 8, Hz.
const RATES_HZ: [f64; 9] = [200.0, 10.0, 20.0, 50.0, 100.0, 200.0, 333.0, 500.0, 1000.0];
/// Cut-off of filter codes 1 to 14, Hz, as manual 1.82 has them.
const CUT_OFFS_HZ: [f64; 14] = [
    500.0, 300.0, 200.0, 150.0, 100.0, 50.0, 40.0, 30.0, 20.0, 10.0, 5.0, 3.0, 2.0, 1.0,
];
/// UART rates of codes 0 to 5, bit/s, and the highest output rate code that each carries.
const BAUDS: [(u32, u8); 6] = [
    (115_200, 6),
    (921_600, 8),
    (460_800, 7),
    (230_400, 7),
    (115_200, 6),
    (57_600, 5),
];

/// Where the sensor is wired.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interface {
    Can,
    Uart { baud_code: u8 },
}

/// Kept over a reboot.
#[derive(Clone, Copy, Debug)]
struct Stored {
    rate_code: u8,
    filter: [u8; 2],
    baud_code: u8,
    ids: [u8; 3],
}

#[derive(Debug)]
pub(crate) struct Rft {
    model: Model,
    sensor: WrenchSensor,
    clock: DeviceClock,
    interface: Interface,
    stored: Stored,
    ids_now: [u8; 3],
    streaming: Option<Cadence>,
    bias: [f64; 6],
    overloads: [u8; 6],
    low_pass: LowPass,
}

impl Rft {
    pub(crate) fn new(
        model: Model,
        sensor: WrenchSensor,
        clock: DeviceClock,
        interface: Interface,
    ) -> Self {
        let baud_code = match interface {
            Interface::Can => 0,
            Interface::Uart { baud_code } => baud_code,
        };
        let ids = [0x64, 0x01, 0x02];
        Self {
            model,
            sensor,
            clock,
            interface,
            stored: Stored {
                rate_code: 0,
                filter: [0, 0],
                baud_code,
                ids,
            },
            ids_now: ids,
            streaming: None,
            bias: [0.0; 6],
            overloads: [0; 6],
            low_pass: LowPass::default(),
        }
    }

    /// Left streaming by a host that crashed, at the rate that it had set.
    pub(crate) fn left_streaming(mut self, rate_hz: f64) -> Self {
        self.stored.rate_code = self.model.rate_code(rate_hz).unwrap_or(0);
        self.start(0);
        self
    }

    pub(crate) fn next_sample(&self) -> Option<SimNanos> {
        self.streaming.map(|cadence| cadence.next())
    }

    fn start(&mut self, at: SimNanos) {
        let rate = self.rate_hz();
        let first = at + self.clock.host_ns(1.0 / rate) as SimNanos;
        self.low_pass = LowPass::default();
        self.streaming = Some(Cadence::starting(first, rate, &self.clock));
    }

    fn rate_hz(&self) -> f64 {
        RATES_HZ[usize::from(self.stored.rate_code).min(8)]
    }

    /// The record of the sample that is due at `at`.
    pub(crate) fn sample(&mut self, at: SimNanos, scene: &Scene) -> [u8; 16] {
        if let Some(cadence) = &mut self.streaming {
            cadence.tick();
        }
        self.record(START, at, scene)
    }

    fn record(&mut self, kind: u8, at: SimNanos, scene: &Scene) -> [u8; 16] {
        let loaded = self.gauges(at, scene);
        let mut overload = 0;
        for (axis, value) in loaded.iter().enumerate() {
            if value.abs() > 1.2 * self.model.rated(axis) {
                overload |= 0x20 >> axis;
                self.overloads[axis] = self.overloads[axis].saturating_add(1);
            }
        }
        let mut response = [0; 16];
        response[0] = kind;
        for axis in 0..6 {
            let counts =
                ((loaded[axis] - self.bias[axis]) * self.model.counts_per_unit(axis)).round();
            response[1 + 2 * axis..3 + 2 * axis].copy_from_slice(&(counts as i16).to_be_bytes());
        }
        response[13] = overload;
        response
    }

    fn gauges(&mut self, at: SimNanos, scene: &Scene) -> [f64; 6] {
        let fresh = self.sensor.read(scene.felt(seconds(at)), seconds(at));
        let [kind, code] = self.stored.filter;
        let Some(cut_off) = CUT_OFFS_HZ
            .get(usize::from(code).wrapping_sub(1))
            .filter(|_| kind == 1)
        else {
            return fresh;
        };
        self.low_pass.smooth(fresh, *cut_off, self.rate_hz())
    }

    /// Executes a command; the response, where the manual gives one.
    pub(crate) fn command(
        &mut self,
        at: SimNanos,
        data: [u8; 8],
        scene: &Scene,
    ) -> Option<[u8; 16]> {
        let [code, first, second, third, ..] = data;
        match code {
            STOP => {
                self.streaming = None;
                return None;
            }
            SET_BIAS => {
                self.bias = if first == 0 {
                    [0.0; 6]
                } else {
                    self.gauges(at, scene)
                };
                return None;
            }
            _ if self.streaming.is_some() => return None,
            _ => {}
        }
        let mut response = [0; 16];
        response[0] = code;
        match code {
            MODEL_NAME => put_text(&mut response, self.model.name),
            SERIAL_NUMBER => put_text(&mut response, "RFT-2309117"),
            FIRMWARE => put_text(&mut response, "v1.82"),
            SET_IDS => put_result(&mut response, self.set_ids([first, second, third])),
            READ_IDS => {
                response[1..4].copy_from_slice(&self.ids_now);
                response[4..7].copy_from_slice(&self.stored.ids);
            }
            SET_BAUD => put_result(&mut response, self.set_baud(first)),
            READ_BAUD => response[1..3].copy_from_slice(&[self.baud_now(), self.stored.baud_code]),
            SET_FILTER => put_result(&mut response, self.set_filter([first, second])),
            READ_FILTER => response[1..3].copy_from_slice(&self.stored.filter),
            ONCE => return Some(self.record(ONCE, at, scene)),
            START => {
                self.start(at);
                return None;
            }
            SET_RATE => put_result(&mut response, self.set_rate(first)),
            READ_RATE => response[1] = self.stored.rate_code,
            OVERLOADS => response[1..7].copy_from_slice(&self.overloads),
            _ => put_result(&mut response, Err(Refusal::Unsupported)),
        }
        Some(response)
    }

    fn baud_now(&self) -> u8 {
        match self.interface {
            Interface::Can => 0,
            Interface::Uart { baud_code } => baud_code,
        }
    }

    fn set_ids(&mut self, ids: [u8; 3]) -> Result<(), Refusal> {
        let [receive, first, second] = ids;
        if self.interface != Interface::Can {
            return Err(Refusal::Unsupported);
        }
        if ids.contains(&0) || receive == first || first == second || second == receive {
            return Err(Refusal::OutOfRange);
        }
        self.stored.ids = ids;
        Ok(())
    }

    fn set_baud(&mut self, code: u8) -> Result<(), Refusal> {
        if self.interface == Interface::Can {
            return Err(Refusal::Unsupported);
        }
        if usize::from(code) >= BAUDS.len() {
            return Err(Refusal::OutOfRange);
        }
        self.stored.baud_code = code;
        Ok(())
    }

    fn set_filter(&mut self, [kind, code]: [u8; 2]) -> Result<(), Refusal> {
        if kind > 1 || usize::from(code) > CUT_OFFS_HZ.len() {
            return Err(Refusal::OutOfRange);
        }
        self.stored.filter = [kind, code];
        Ok(())
    }

    fn set_rate(&mut self, code: u8) -> Result<(), Refusal> {
        let by_line = match self.interface {
            Interface::Can => 8,
            Interface::Uart { baud_code } => BAUDS[usize::from(baud_code).min(5)].1,
        };
        if code > by_line || RATES_HZ[usize::from(code)] > self.model.max_rate_hz {
            return Err(Refusal::OutOfRange);
        }
        self.stored.rate_code = code;
        Ok(())
    }

    /// The ids in force: host to sensor, then both halves of the sensor.
    pub(crate) fn ids(&self) -> [u8; 3] {
        self.ids_now
    }
}

#[derive(Clone, Copy, Debug)]
enum Refusal {
    Unsupported = 1,
    OutOfRange = 2,
}

fn put_result(response: &mut [u8; 16], result: Result<(), Refusal>) {
    match result {
        Ok(()) => response[1..3].copy_from_slice(&[1, 0]),
        Err(refusal) => response[1..3].copy_from_slice(&[0, refusal as u8]),
    }
}

fn put_text(response: &mut [u8; 16], text: &str) {
    for (slot, byte) in response[1..].iter_mut().zip(text.bytes()) {
        *slot = byte;
    }
}

/// The baud code that stands for `baud_bps`.
pub(crate) fn baud_code(baud_bps: u32) -> Option<u8> {
    BAUDS
        .iter()
        .position(|(baud, _)| *baud == baud_bps)
        .map(|code| code as u8)
}

/// The slowest UART rate that carries output rate `code`.
pub(crate) fn baud_for(code: u8) -> u32 {
    let fits = BAUDS
        .iter()
        .filter(|(_, most)| code <= *most)
        .map(|(baud, _)| *baud)
        .filter(|baud| *baud >= 115_200);
    fits.min().unwrap_or(921_600)
}

#[cfg(test)]
mod tests;
