//! Leptrino CFS or PFS on USB (CDC).
//!
//! Frame: 10 02, body with every 10 doubled, 10 03, XOR of body and 03. Command body: length FF number 00; response: length FF number
//! result data. 2A product (16 + 8 + 4 ASCII), 2B limits (6 x f32), 30 one sample, 32 start, 33 stop; sample: 6 x i16 with 10 000 =
//! rated, 2 undefined bytes, status, 00. A wrong check is answered 10 15. Start is answered with its own bytes. Little-endian.
//!
//! # Source
//! The maker's protocol 1.13. Unconfirmed here: answers in 1 ms, result 4 for a start while streaming.

use ft_wire::Chunk;

use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::scene::Scene;
use crate::wrench_sensor::WrenchSensor;

/// Line rate, bit/s.
pub(crate) const BAUD_BPS: u32 = 460_800;
/// The fastest that the series sends, Hz.
pub(crate) const MAX_RATE_HZ: f64 = 1200.0;
const LIMITS: [f32; 6] = [500.0, 500.0, 1000.0, 10.0, 10.0, 10.0];
const ANSWER_NS: SimNanos = 1_000_000;

#[derive(Debug)]
pub(crate) struct Leptrino {
    sensor: WrenchSensor,
    clock: DeviceClock,
    rate_hz: f64,
    streaming: Option<Cadence>,
    inbox: Vec<u8>,
}

impl Leptrino {
    pub(crate) fn new(
        sensor: WrenchSensor,
        clock: DeviceClock,
        rate_hz: f64,
        already_streaming: bool,
    ) -> Self {
        let mut device = Self {
            sensor,
            clock,
            rate_hz,
            streaming: None,
            inbox: Vec::new(),
        };
        if already_streaming {
            device.stream(0);
        }
        device
    }

    fn stream(&mut self, at: SimNanos) {
        let first = at + self.clock.host_ns(1.0 / self.rate_hz) as SimNanos;
        self.streaming = Some(Cadence::starting(first, self.rate_hz, &self.clock));
    }

    fn sample(&mut self, number: u8, at: SimNanos, scene: &Scene) -> Vec<u8> {
        let t = seconds(at);
        let read = self.sensor.read(scene.felt(t), t);
        let mut data = Vec::new();
        let mut status = 0;
        for (axis, value) in read.iter().enumerate() {
            let counts = (value / f64::from(LIMITS[axis]) * 10_000.0).round();
            if counts.abs() > 10_000.0 {
                status |= 4;
            }
            data.extend((counts.clamp(-32_000.0, 32_000.0) as i16).to_le_bytes());
        }
        data.extend([0x10, 0x03, status, 0]);
        response(number, 0, &data)
    }

    fn command(&mut self, at: SimNanos, body: &[u8], scene: &Scene) -> Vec<u8> {
        let &[length, 0xFF, number, 0] = body else {
            return response(body.get(2).copied().unwrap_or(0), 1, &[]);
        };
        if length != 4 {
            return response(number, 1, &[]);
        }
        match number {
            0x2A => response(number, 0, b"PFS055YA251U6\0\0\0SN0004171.13"),
            0x2B => {
                let limits: Vec<u8> = LIMITS
                    .iter()
                    .flat_map(|limit| limit.to_le_bytes())
                    .collect();
                response(number, 0, &limits)
            }
            0x30 => self.sample(number, at, scene),
            0x32 if self.streaming.is_some() => response(number, 4, &[]),
            0x32 => {
                self.stream(at + ANSWER_NS);
                response(number, 0, &[])
            }
            0x33 => {
                self.streaming = None;
                response(number, 0, &[])
            }
            _ => response(number, 2, &[]),
        }
    }
}

fn response(number: u8, result: u8, data: &[u8]) -> Vec<u8> {
    let mut body = vec![4 + data.len() as u8, 0xFF, number, result];
    body.extend(data);
    let mut frame = vec![0x10, 0x02];
    let mut check = 0x03;
    for byte in body {
        check ^= byte;
        frame.push(byte);
        if byte == 0x10 {
            frame.push(0x10);
        }
    }
    frame.extend([0x10, 0x03, check]);
    frame
}

/// A whole frame at the start of `inbox`: its body, or `None` when its check is wrong, and how many bytes it took.
fn scan(inbox: &[u8]) -> Option<(Option<Vec<u8>>, usize)> {
    let mut body = Vec::new();
    let mut at = 2;
    loop {
        match (inbox.get(at)?, inbox.get(at + 1)) {
            (0x10, None) => return None,
            (0x10, Some(0x03)) => break,
            (0x10, Some(_)) => {
                body.push(0x10);
                at += 2;
            }
            (byte, _) => {
                body.push(*byte);
                at += 1;
            }
        }
    }
    let carried = *inbox.get(at + 2)?;
    let check = body.iter().fold(0x03, |check, byte| check ^ byte);
    Some(((check == carried).then_some(body), at + 3))
}

impl Played<Chunk> for Leptrino {
    fn next_event(&self) -> Option<SimNanos> {
        self.streaming.map(|cadence| cadence.next())
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        if let Some(cadence) = &mut self.streaming {
            cadence.tick();
        }
        let frame = self.sample(0x32, at, scene);
        push_bytes(out, at, &frame);
    }

    fn receive(&mut self, at: SimNanos, frame: &Chunk, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.inbox.extend(frame.as_slice());
        while !self.inbox.is_empty() {
            if !self.inbox.starts_with(&[0x10, 0x02]) && self.inbox != [0x10] {
                self.inbox.remove(0);
                continue;
            }
            let Some((body, used)) = scan(&self.inbox) else {
                return;
            };
            self.inbox.drain(..used);
            let answer = match body {
                Some(body) => self.command(at, &body, scene),
                None => vec![0x10, 0x15],
            };
            push_bytes(out, at + ANSWER_NS, &answer);
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

    fn device() -> Leptrino {
        let spec = Scenario::builtin("drawer_light").unwrap().sensor;
        let gauges = WrenchSensor::new(&spec, Random::new(1, Stream::Sensor));
        Leptrino::new(gauges, DeviceClock::new(&spec.clock, 0.0), 1200.0, false)
    }

    fn told(device: &mut Leptrino, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        device.receive(1_000, &Chunk::new(bytes).unwrap(), &scene(), &mut out);
        out.iter()
            .flat_map(|(_, chunk)| chunk.as_slice().to_vec())
            .collect()
    }

    const START: [u8; 9] = [0x10, 0x02, 0x04, 0xFF, 0x32, 0x00, 0x10, 0x03, 0xCA];

    #[test]
    fn the_answer_to_start_is_start_itself() {
        let mut device = device();
        assert!(told(&mut device, &START[..5]).is_empty());
        assert_eq!(told(&mut device, &START[5..]), START);
        assert!(device.next_event().is_some());
        assert_eq!(told(&mut device, &START)[5], 4, "it runs already");
    }

    #[test]
    fn limits_are_those_of_the_makers_example() {
        let asked = [0x10, 0x02, 0x04, 0xFF, 0x2B, 0x00, 0x10, 0x03, 0xD3];
        let answer = told(&mut device(), &asked);
        assert_eq!(
            answer[..9],
            [0x10, 0x02, 0x1C, 0xFF, 0x2B, 0x00, 0x00, 0x00, 0xFA]
        );
        assert_eq!(answer.last(), Some(&0x94));
    }

    #[test]
    fn a_wrong_check_is_answered_with_a_refusal() {
        let mut broken = START;
        broken[8] = 0;
        assert_eq!(told(&mut device(), &broken), [0x10, 0x15]);
    }

    #[test]
    fn a_ten_in_a_sample_is_sent_twice() {
        // The undefined bytes of a sample hold 10 03 here, which must not end the frame.
        let frame = device().sample(0x32, 100_000_000, &scene());
        let (body, used) = scan(&frame).unwrap();
        assert_eq!((body.unwrap().len(), used), (20, frame.len()));
    }
}
