//! Kunwei KWR75 on RS-422 or USB, 460 800 bit/s.
//!
//! Sample, 28 bytes: 48 (streamed) or 49 (asked), AA, 6 x f32 little-endian in kg and kg m, 0D 0A. No check sum. Commands: 48 AA 0D 0A
//! stream at 1 kHz, 49 AA 0D 0A one sample, 43 AA 0D 0A stop; the first 49 after power-up only starts the refresh.
//!
//! # Source
//! Manual KWR75-RS422, 4.3 and 4.4. Unconfirmed here: silent after power-up, one sample more after a stop.

use ft_wire::Chunk;

use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::scene::Scene;
use crate::wrench_sensor::WrenchSensor;

/// Line rate, bit/s.
pub(crate) const BAUD_BPS: u32 = 460_800;
/// The only rate, Hz.
pub(crate) const RATE_HZ: f64 = 1000.0;
const NEWTONS_PER_KG: f64 = 9.81;

#[derive(Debug)]
pub(crate) struct KunweiKwr75 {
    sensor: WrenchSensor,
    clock: DeviceClock,
    streaming: Option<Cadence>,
    refreshed: bool,
    inbox: Vec<u8>,
}

impl KunweiKwr75 {
    pub(crate) fn new(sensor: WrenchSensor, clock: DeviceClock, already_streaming: bool) -> Self {
        let mut device = Self {
            sensor,
            clock,
            streaming: None,
            refreshed: false,
            inbox: Vec::new(),
        };
        if already_streaming {
            device.stream(0);
        }
        device
    }

    fn stream(&mut self, at: SimNanos) {
        let first = at + self.clock.host_ns(1.0 / RATE_HZ) as SimNanos;
        self.streaming = Some(Cadence::starting(first, RATE_HZ, &self.clock));
    }

    fn sample(&mut self, head: u8, at: SimNanos, scene: &Scene) -> Vec<u8> {
        let t = seconds(at);
        let read = self.sensor.read(scene.felt(t), t);
        let mut frame = vec![head, 0xAA];
        for value in read {
            frame.extend(((value / NEWTONS_PER_KG) as f32).to_le_bytes());
        }
        frame.extend([0x0D, 0x0A]);
        frame
    }
}

impl Played<Chunk> for KunweiKwr75 {
    fn next_event(&self) -> Option<SimNanos> {
        self.streaming.map(|cadence| cadence.next())
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        if let Some(cadence) = &mut self.streaming {
            cadence.tick();
        }
        let frame = self.sample(0x48, at, scene);
        push_bytes(out, at, &frame);
    }

    fn receive(&mut self, at: SimNanos, frame: &Chunk, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.inbox.extend(frame.as_slice());
        while self.inbox.len() >= 4 {
            if self.inbox[1..4] != [0xAA, 0x0D, 0x0A] {
                self.inbox.remove(0);
                continue;
            }
            let code = self.inbox[0];
            self.inbox.drain(..4);
            match code {
                0x48 => self.stream(at),
                0x43 => self.streaming = None,
                0x49 if self.refreshed => {
                    let frame = self.sample(0x49, at, scene);
                    push_bytes(out, at + 500_000, &frame);
                }
                0x49 => self.refreshed = true,
                _ => {}
            }
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

    fn device() -> KunweiKwr75 {
        let spec = Scenario::builtin("drawer_light").unwrap().sensor;
        let gauges = WrenchSensor::new(&spec, Random::new(1, Stream::Sensor));
        KunweiKwr75::new(gauges, DeviceClock::new(&spec.clock, 0.0), false)
    }

    fn told(device: &mut KunweiKwr75, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut out = Vec::new();
        device.receive(1_000, &Chunk::new(bytes).unwrap(), &scene(), &mut out);
        out.iter()
            .map(|(_, chunk)| chunk.as_slice().to_vec())
            .collect()
    }

    #[test]
    fn it_streams_when_told_and_stops_when_told() {
        let mut device = device();
        assert_eq!(device.next_event(), None);
        told(&mut device, &[0x00, 0x48, 0xAA, 0x0D]);
        assert_eq!(device.next_event(), None, "the command is not whole");
        told(&mut device, &[0x0A]);
        assert!(device.next_event().is_some());
        let mut out = Vec::new();
        device.run(1_100_000, &scene(), &mut out);
        let frame = out[0].1.as_slice();
        assert_eq!(frame.len(), 28);
        assert_eq!(
            (&frame[..2], &frame[26..]),
            (&[0x48, 0xAA][..], &[0x0D, 0x0A][..])
        );
        told(&mut device, &[0x43, 0xAA, 0x0D, 0x0A]);
        assert_eq!(device.next_event(), None);
    }

    #[test]
    fn the_first_question_after_power_up_is_not_answered() {
        let mut device = device();
        let ask = [0x49, 0xAA, 0x0D, 0x0A];
        assert_eq!(told(&mut device, &ask).len(), 0);
        let answers = told(&mut device, &ask);
        assert_eq!((answers.len(), answers[0][0]), (1, 0x49));
    }
}
