//! OptoForce / OnRobot HEX, 6 axes, on USB or UART (1 Mbit/s) and on CAN.
//!
//! Sample, 22 bytes, big-endian: AA 07 08 10 | u16 counter | u16 status | 6 x i16 counts | u16 sum of all bytes before. Status bits
//! 9..4 are overloads of Fx Fy Fz Tx Ty Tz. To the sensor: AA 00 32 03 speed filter zero, sum; AB 00 12 08, sum. From it: AA 00 50 01
//! error, sum; AA 00 12 08, 8 ASCII, sum. On CAN these bytes travel in payloads of 8.
//!
//! # Source
//! `alknemeyer/optoforce`, `shadow-robot/optoforce`, `RCPRG-ros-pkg/optoforce_can`. Sensitivities are those of one real report.
//! Unconfirmed here: 100 Hz after power-up, error 1 for a setting that there is not, rated loads, answers on CAN, answers in 2 ms.

use ft_wire::{CanFrame, Chunk};

use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::scene::Scene;
use crate::wrench_sensor::{LowPass, WrenchSensor};

/// Line rate of the UART, bit/s.
pub(crate) const BAUD_BPS: u32 = 1_000_000;
/// Bit rate on CAN, bit/s.
pub(crate) const BITRATE_BPS: u32 = 1_000_000;
/// Output rates, Hz, and the speed byte of each.
const SPEEDS: [(f64, u8); 5] = [
    (1000.0, 1),
    (333.0, 3),
    (100.0, 10),
    (30.0, 33),
    (10.0, 100),
];
/// Cut-offs of filter codes 1 to 6, Hz.
const CUT_OFFS_HZ: [f64; 6] = [500.0, 150.0, 50.0, 15.0, 5.0, 1.5];
/// Counts per N and per N m.
pub(crate) const COUNTS_PER_UNIT: [f64; 6] = [18.28, 18.41, 2.12, 278.72, 259.55, 448.47];
const RATED: [f64; 6] = [200.0, 200.0, 200.0, 10.0, 10.0, 6.5];

const DATA_ID: u16 = 0x100;
const COMMAND_ID: u32 = 0x101;

/// The rates that a sensor can be told, for people.
pub(crate) fn rates_text() -> String {
    SPEEDS.map(|(rate, _)| rate.to_string()).join(", ")
}

/// Whether the sensor has this rate.
pub(crate) fn has_rate(rate_hz: f64) -> bool {
    SPEEDS.iter().any(|(rate, _)| *rate == rate_hz)
}

/// What is the same on both buses: bytes in, packets out.
#[derive(Debug)]
pub(crate) struct Hex {
    sensor: WrenchSensor,
    clock: DeviceClock,
    streaming: Option<Cadence>,
    rate_hz: f64,
    filter: u8,
    low_pass: LowPass,
    zero: [f64; 6],
    counter: u16,
    inbox: Vec<u8>,
}

impl Hex {
    /// A sensor that has been on for a while; it streams from power-up.
    pub(crate) fn new(sensor: WrenchSensor, clock: DeviceClock) -> Self {
        let mut hex = Self {
            sensor,
            clock,
            streaming: None,
            rate_hz: 100.0,
            filter: 0,
            low_pass: LowPass::default(),
            zero: [0.0; 6],
            counter: 65_000,
            inbox: Vec::new(),
        };
        hex.stream(0, 10);
        hex
    }

    fn stream(&mut self, at: SimNanos, period_ms: u8) {
        self.rate_hz = 1000.0 / f64::from(period_ms);
        let first = at + self.clock.host_ns(1.0 / self.rate_hz) as SimNanos;
        self.streaming = Some(Cadence::starting(first, self.rate_hz, &self.clock));
    }

    fn next_sample(&self) -> Option<SimNanos> {
        self.streaming.map(|cadence| cadence.next())
    }

    fn gauges(&mut self, at: SimNanos, scene: &Scene) -> [f64; 6] {
        let t = seconds(at);
        let fresh = self.sensor.read(scene.felt(t), t);
        match CUT_OFFS_HZ.get(usize::from(self.filter).wrapping_sub(1)) {
            Some(cut_off) => self.low_pass.smooth(fresh, *cut_off, self.rate_hz),
            None => fresh,
        }
    }

    fn sample(&mut self, at: SimNanos, scene: &Scene) -> Vec<u8> {
        if let Some(cadence) = &mut self.streaming {
            cadence.tick();
        }
        let loaded = self.gauges(at, scene);
        let mut status = 0_u16;
        let mut body = vec![0xAA, 0x07, 0x08, 0x10];
        self.counter = self.counter.wrapping_add(1);
        body.extend(self.counter.to_be_bytes());
        for (axis, value) in loaded.iter().enumerate() {
            if value.abs() > RATED[axis] {
                status |= 0x200 >> axis;
            }
        }
        body.extend(status.to_be_bytes());
        for axis in 0..6 {
            let counts = ((loaded[axis] - self.zero[axis]) * COUNTS_PER_UNIT[axis]).round() as i16;
            body.extend(counts.to_be_bytes());
        }
        summed(body)
    }

    /// Takes bytes of the host and gives the packets that answer.
    fn receive(&mut self, at: SimNanos, bytes: &[u8], scene: &Scene) -> Vec<Vec<u8>> {
        self.inbox.extend(bytes);
        let mut answers = Vec::new();
        while self.inbox.len() >= 6 {
            let len = match self.inbox[..4] {
                [0xAA, 0x00, 0x32, 0x03] => 9,
                [0xAB, 0x00, 0x12, 0x08] => 6,
                _ => 0,
            };
            if len > self.inbox.len() {
                break;
            }
            let (content, check) = self.inbox[..len].split_at(len.saturating_sub(2));
            if len == 0 || sum(content).to_be_bytes() != check {
                self.inbox.remove(0);
                continue;
            }
            let packet: Vec<u8> = self.inbox.drain(..len).collect();
            answers.push(if len == 6 {
                summed([&[0xAA, 0x00, 0x12, 0x08], &b"HEXE0042"[..]].concat())
            } else {
                let error = self.configure(at, [packet[4], packet[5], packet[6]], scene);
                summed(vec![0xAA, 0x00, 0x50, 0x01, error])
            });
        }
        answers
    }

    fn configure(&mut self, at: SimNanos, settings: [u8; 3], scene: &Scene) -> u8 {
        let [speed, filter, zero] = settings;
        let known = speed == 0 || SPEEDS.iter().any(|(_, code)| *code == speed);
        if !known || usize::from(filter) > CUT_OFFS_HZ.len() || !matches!(zero, 0 | 255) {
            return 1;
        }
        self.filter = filter;
        self.low_pass = LowPass::default();
        self.zero = if zero == 0 {
            [0.0; 6]
        } else {
            self.gauges(at, scene)
        };
        match speed {
            0 => self.streaming = None,
            _ => self.stream(at, speed),
        }
        0
    }
}

fn sum(bytes: &[u8]) -> u16 {
    bytes
        .iter()
        .fold(0, |sum: u16, byte| sum.wrapping_add(u16::from(*byte)))
}

fn summed(mut packet: Vec<u8>) -> Vec<u8> {
    let check = sum(&packet);
    packet.extend(check.to_be_bytes());
    packet
}

/// How long the sensor takes to answer, ns.
const ANSWER_NS: SimNanos = 2_000_000;

/// On USB or UART.
#[derive(Debug)]
pub(crate) struct OptoforceSerial(pub(crate) Hex);

impl Played<Chunk> for OptoforceSerial {
    fn next_event(&self) -> Option<SimNanos> {
        self.0.next_sample()
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        push_bytes(out, at, &self.0.sample(at, scene));
    }

    fn receive(&mut self, at: SimNanos, frame: &Chunk, scene: &Scene, out: &mut Outbox<Chunk>) {
        for answer in self.0.receive(at, frame.as_slice(), scene) {
            push_bytes(out, at + ANSWER_NS, &answer);
        }
    }
}

/// On CAN.
#[derive(Debug)]
pub(crate) struct OptoforceCan(pub(crate) Hex);

fn push_payloads(out: &mut Outbox<CanFrame>, ready: SimNanos, packet: &[u8]) {
    for payload in packet.chunks(8) {
        out.extend(CanFrame::standard(DATA_ID, payload).map(|frame| (ready, frame)));
    }
}

impl Played<CanFrame> for OptoforceCan {
    fn next_event(&self) -> Option<SimNanos> {
        self.0.next_sample()
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<CanFrame>) {
        push_payloads(out, at, &self.0.sample(at, scene));
    }

    fn receive(
        &mut self,
        at: SimNanos,
        frame: &CanFrame,
        scene: &Scene,
        out: &mut Outbox<CanFrame>,
    ) {
        if frame.is_extended() || frame.arbitration_id() != COMMAND_ID {
            return;
        }
        for answer in self.0.receive(at, frame.payload(), scene) {
            push_payloads(out, at + ANSWER_NS, &answer);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Random, Stream};
    use crate::scenario::Scenario;

    fn scene() -> Scene {
        let mut scene = Scene::new(&Scenario::builtin("drawer_light").unwrap(), 1, None).unwrap();
        scene.advance_to(0.1);
        scene
    }

    fn hex(bias_n: f64) -> Hex {
        let mut spec = Scenario::builtin("drawer_light").unwrap().sensor;
        spec.force_bias_n = bias_n;
        let gauges = WrenchSensor::new(&spec, Random::new(1, Stream::Sensor));
        Hex::new(gauges, DeviceClock::new(&spec.clock, 0.0))
    }

    const STOP: [u8; 9] = [0xAA, 0x00, 0x32, 0x03, 0, 0, 0, 0x00, 0xDF];

    #[test]
    fn a_packet_ends_with_the_sum_of_the_captured_ones() {
        let captured = [
            0xAA, 0x07, 0x08, 0x0A, 0x2D, 0x6A, 0, 0, 0xFF, 0xF7, 0xFF, 0xFB, 0, 7,
        ];
        assert_eq!(summed(captured.to_vec())[14..], [0x05, 0x51]);
    }

    #[test]
    fn it_streams_from_power_up_stops_and_says_its_name() {
        let mut serial = OptoforceSerial(hex(1.0));
        assert_eq!(serial.next_event().map(|at| at / 1_000_000), Some(9));
        let mut out = Vec::new();
        // In two pieces, behind a stray byte.
        for piece in [&[0x17][..], &STOP[..5], &STOP[5..]] {
            serial.receive(1_000, &Chunk::new(piece).unwrap(), &scene(), &mut out);
        }
        assert_eq!(serial.next_event(), None);
        assert_eq!(out[0].1.as_slice(), [0xAA, 0x00, 0x50, 0x01, 0, 0, 0xFB]);
        let asks = Chunk::new(&[0xAB, 0x00, 0x12, 0x08, 0x00, 0xC5]).unwrap();
        serial.receive(2_000, &asks, &scene(), &mut out);
        assert_eq!(&out[1].1.as_slice()[..12], b"\xAA\x00\x12\x08HEXE0042");
    }

    #[test]
    fn what_it_has_not_is_refused_and_a_wrong_sum_is_not_answered() {
        let scene = scene();
        let mut hex = hex(1.0);
        let odd = summed(vec![0xAA, 0x00, 0x32, 0x03, 2, 0, 0]);
        assert_eq!(hex.receive(0, &odd, &scene)[0][4], 1);
        let mut broken = STOP;
        broken[8] ^= 1;
        assert_eq!(hex.receive(0, &broken, &scene), Vec::<Vec<u8>>::new());
    }

    #[test]
    fn overload_shows_in_the_axis_bits_and_zero_takes_the_load_away() {
        let scene = scene();
        let mut heavy = hex(3000.0);
        let packet = heavy.sample(100_000_000, &scene);
        let status = u16::from_be_bytes([packet[6], packet[7]]);
        assert_eq!(status & 0x380, 0x380, "{status:#06x}");
        let mut light = hex(50.0);
        let set = summed(vec![0xAA, 0x00, 0x32, 0x03, 1, 0, 255]);
        light.receive(100_000_000, &set, &scene);
        let packet = light.sample(101_000_000, &scene);
        let fx = i16::from_be_bytes([packet[8], packet[9]]);
        assert!(f64::from(fx).abs() < 20.0, "{fx} counts, zeroed");
    }

    #[test]
    fn on_can_a_packet_is_cut_in_eights_and_a_padded_command_is_heard() {
        let scene = scene();
        let mut can = OptoforceCan(hex(1.0));
        let mut out = Vec::new();
        can.run(10_000_000, &scene, &mut out);
        let lengths: Vec<_> = out.iter().map(|(_, frame)| frame.payload().len()).collect();
        assert_eq!(lengths, [8, 8, 6]);
        assert!(
            out.iter()
                .all(|(_, frame)| frame.arbitration_id() == u32::from(DATA_ID))
        );
        let mut rest = [0; 8];
        rest[0] = STOP[8];
        for payload in [&STOP[..8], &rest] {
            let frame = CanFrame::standard(0x101, payload).unwrap();
            can.receive(0, &frame, &scene, &mut out);
        }
        assert_eq!(can.next_event(), None);
        assert_eq!(
            out.len(),
            4,
            "three payloads of the sample, one of the answer"
        );
    }
}
