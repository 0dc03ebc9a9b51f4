//! ATI NETCANOEM on CAN: gauges when asked for, and the matrix that makes a wrench of them.
//!
//! Id = base << 4 | operation, base 0x20. 0 gauges: id 0 u16 status, i16 sg0 sg2 sg4; id 1 i16 sg1 sg3 sg5. 2 matrix row: ids 2, 3, 4
//! with two f32 each. 5 serial number, 6 set calibration, 7 counts per unit, 8 units, C reset, F firmware. Big-endian.
//!
//! # Source
//! ATI 9610-05-1030, section 7. The matrix is of our own making. Unconfirmed here: answers in 0.2 ms, silent for 100 ms after a reset.

use ft_wire::CanFrame;
use nalgebra::{Matrix6, Vector6};

use crate::clock::SimNanos;
use crate::device::{Outbox, Played, seconds};
use crate::scene::Scene;
use crate::wrench_sensor::WrenchSensor;

/// The factory's bit rate, bit/s.
pub(crate) const BITRATE_BPS: u32 = 250_000;
const BASE: u32 = 0x20;
const COUNTS_PER_UNIT: u32 = 1_000_000;
const RESET_NS: SimNanos = 100_000_000;
const ANSWER_NS: SimNanos = 200_000;

#[derive(Debug)]
pub(crate) struct AtiNetcanoem {
    sensor: WrenchSensor,
    matrix: Matrix6<f32>,
    gauges_of: Matrix6<f64>,
    calibration: u8,
    silent_until: SimNanos,
}

/// Rows of force about 0.01 N, of torque about 0.0005 N m per count, with a tenth of cross-talk.
fn matrix() -> Matrix6<f32> {
    Matrix6::from_fn(|row, column| {
        let size = if row < 3 { 0.01 } else { 5e-4 } * f64::from(COUNTS_PER_UNIT);
        let own = if row == column { 1.0 } else { 0.0 };
        (size * (own + 0.1 * ((3 * row + 5 * column) as f64).cos())) as f32
    })
}

impl AtiNetcanoem {
    pub(crate) fn new(sensor: WrenchSensor) -> Self {
        let matrix = matrix();
        // A tenth of cross-talk leaves it far from singular.
        let gauges_of = matrix.map(f64::from).try_inverse().unwrap_or_default();
        Self {
            sensor,
            matrix,
            gauges_of: gauges_of * f64::from(COUNTS_PER_UNIT),
            calibration: 0,
            silent_until: 0,
        }
    }

    fn gauges(&mut self, at: SimNanos, scene: &Scene) -> (u16, [i16; 6]) {
        let t = seconds(at);
        let wrench = Vector6::from(self.sensor.read(scene.felt(t), t));
        let exact: [f64; 6] = (self.gauges_of * wrench).into();
        let mut status = 0;
        for gauge in exact {
            if gauge > f64::from(i16::MAX) {
                status |= 0x8002;
            } else if gauge < f64::from(i16::MIN) {
                status |= 0x8004;
            }
        }
        (status, exact.map(|gauge| gauge.round() as i16))
    }

    /// The frames that answer: operation and payload.
    fn answer(
        &mut self,
        at: SimNanos,
        operation: u8,
        payload: &[u8],
        scene: &Scene,
    ) -> Vec<(u8, Vec<u8>)> {
        match (operation, payload) {
            (0x0, []) => {
                let (status, [sg0, sg1, sg2, sg3, sg4, sg5]) = self.gauges(at, scene);
                let bytes = |gauges: [i16; 3]| gauges.map(i16::to_be_bytes).concat();
                let mut even = status.to_be_bytes().to_vec();
                even.extend(bytes([sg0, sg2, sg4]));
                vec![(0x0, even), (0x1, bytes([sg1, sg3, sg5]))]
            }
            (0x2, [axis @ 0..=5]) => (0..3)
                .map(|part| {
                    let row = usize::from(*axis);
                    let pair = [2 * part, 2 * part + 1].map(|column| self.matrix[(row, column)]);
                    (2 + part as u8, pair.map(f32::to_be_bytes).concat())
                })
                .collect(),
            (0x5, []) => vec![(0x5, b"FT04170\0".to_vec())],
            (0x6, [index @ 0..=15]) => {
                self.calibration = *index;
                vec![(0x6, vec![*index])]
            }
            (0x7, []) => vec![(0x7, [COUNTS_PER_UNIT; 2].map(u32::to_be_bytes).concat())],
            (0x8, []) => vec![(0x8, vec![2, 3])],
            (0xF, []) => vec![(0xF, vec![3, 8, 0, 12])],
            (0xC, []) => {
                self.calibration = 0;
                self.silent_until = at + RESET_NS;
                Vec::new()
            }
            _ => Vec::new(),
        }
    }
}

impl Played<CanFrame> for AtiNetcanoem {
    fn next_event(&self) -> Option<SimNanos> {
        None
    }

    fn run(&mut self, _at: SimNanos, _scene: &Scene, _out: &mut Outbox<CanFrame>) {}

    fn receive(
        &mut self,
        at: SimNanos,
        frame: &CanFrame,
        scene: &Scene,
        out: &mut Outbox<CanFrame>,
    ) {
        let id = frame.arbitration_id();
        if frame.is_extended() || id >> 4 != BASE || at < self.silent_until {
            return;
        }
        for (operation, payload) in self.answer(at, (id & 0xF) as u8, frame.payload(), scene) {
            let id = (BASE << 4) as u16 | u16::from(operation);
            out.extend(CanFrame::standard(id, &payload).map(|frame| (at + ANSWER_NS, frame)));
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

    fn device() -> AtiNetcanoem {
        let spec = Scenario::builtin("drawer_light").unwrap().sensor;
        AtiNetcanoem::new(WrenchSensor::new(&spec, Random::new(1, Stream::Sensor)))
    }

    fn asked(device: &mut AtiNetcanoem, at: SimNanos, id: u16, payload: &[u8]) -> Vec<CanFrame> {
        let mut out = Vec::new();
        let frame = CanFrame::standard(id, payload).unwrap();
        device.receive(at, &frame, &scene(), &mut out);
        out.into_iter().map(|(_, frame)| frame).collect()
    }

    fn floats(frame: &CanFrame) -> [f64; 2] {
        [0, 4].map(|at| {
            let bytes = frame.payload()[at..at + 4].try_into().unwrap();
            f64::from(f32::from_be_bytes(bytes))
        })
    }

    #[test]
    fn matrix_times_gauges_is_what_the_sensor_feels() {
        let mut device = device();
        let mut rows = Vec::new();
        for axis in 0..6 {
            let parts = asked(&mut device, 0, 0x202, &[axis]);
            let ids: Vec<_> = parts.iter().map(CanFrame::arbitration_id).collect();
            assert_eq!(ids, [0x202, 0x203, 0x204]);
            rows.push(parts.iter().flat_map(floats).collect::<Vec<f64>>());
        }
        let halves = asked(&mut device, 100_000_000, 0x200, &[]);
        let int = |frame: &CanFrame, at: usize| {
            f64::from(i16::from_be_bytes(
                frame.payload()[at..at + 2].try_into().unwrap(),
            ))
        };
        let (even, odd) = (&halves[0], &halves[1]);
        let gauges = [
            int(even, 2),
            int(odd, 0),
            int(even, 4),
            int(odd, 2),
            int(even, 6),
            int(odd, 4),
        ];
        let force: f64 = (0..3)
            .map(|axis| {
                let sum: f64 = rows[axis].iter().zip(gauges).map(|(a, b)| a * b).sum();
                (sum / 1e6).powi(2)
            })
            .sum::<f64>()
            .sqrt();
        // A weight of 4.8 N, and a bias within 1.5 N of each axis.
        assert!((1.0..8.0).contains(&force), "{force}");
    }

    #[test]
    fn a_reset_is_not_answered_and_takes_its_time() {
        let mut device = device();
        assert_eq!(asked(&mut device, 0, 0x206, &[7])[0].payload(), [7]);
        assert_eq!(asked(&mut device, 0, 0x20C, &[]), []);
        assert_eq!(asked(&mut device, 50_000_000, 0x20F, &[]), []);
        assert_eq!(device.calibration, 0);
        assert_eq!(asked(&mut device, 150_000_000, 0x20F, &[]).len(), 1);
    }

    #[test]
    fn what_is_not_in_the_document_is_not_answered() {
        let mut device = device();
        for (id, payload) in [(0x202, &[6][..]), (0x20A, &[]), (0x210, &[]), (0x200, &[1])] {
            assert_eq!(asked(&mut device, 0, id, payload), []);
        }
    }
}
