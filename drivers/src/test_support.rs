//! Plays link and clock for a device under test: no link, no sleep, hand-made frames and instants.

use std::time::Duration;

use ft_wire::{Chunk, DecodeError, HostTime};

use crate::device::Device;
use crate::link::RxStamps;
use crate::reading::{DeviceEvent, PoseReading, Reading, WidthReading, WrenchReading};

/// A device, the simulated present, and everything that came out.
pub(crate) struct Bench<D: Device> {
    pub(crate) device: D,
    pub(crate) now: HostTime,
    pub(crate) sent: Vec<(HostTime, D::Frame)>,
    pub(crate) readings: Vec<Reading>,
}

impl<D: Device<Reading = Reading>> Bench<D> {
    /// A bench at second 1000 of the host clock.
    pub(crate) fn new(device: D) -> Self {
        let now = HostTime::from_nanos(1_000_000_000_000);
        Self {
            device,
            now,
            sent: Vec::new(),
            readings: Vec::new(),
        }
    }

    fn collect(&mut self) {
        while let Some(frame) = self.device.poll_transmit(self.now) {
            self.sent.push((self.now, frame));
        }
        while let Some(reading) = self.device.poll_reading() {
            self.readings.push(reading);
        }
    }

    /// Lets time pass, serving every timeout at its instant.
    pub(crate) fn advance(&mut self, step: Duration) {
        let end = self.now + step;
        for _ in 0..1_000_000 {
            match self.device.poll_timeout() {
                Some(timeout) if timeout <= end => {
                    self.now = self.now.max(timeout);
                    self.device.handle_timeout(self.now);
                    self.collect();
                }
                _ => {
                    self.now = end;
                    return;
                }
            }
        }
        panic!("the device asks for the same timeout again and again");
    }

    pub(crate) fn advance_ms(&mut self, ms: u64) {
        self.advance(Duration::from_millis(ms));
    }

    /// Advances in steps of 1 ms until `done`, at most a minute, and says how long it took.
    pub(crate) fn advance_until(&mut self, done: impl Fn(&Self) -> bool) -> Duration {
        let start = self.now;
        while !done(self) {
            assert!(
                self.now.saturating_since(start) < Duration::from_secs(60),
                "it never happens"
            );
            self.advance_ms(1);
        }
        self.now.saturating_since(start)
    }

    /// A frame arrives now.
    pub(crate) fn frame(&mut self, frame: &D::Frame) -> Result<(), DecodeError> {
        let result = self
            .device
            .handle_frame(frame, RxStamps { arrival: self.now });
        self.collect();
        result
    }

    pub(crate) fn events(&self) -> Vec<DeviceEvent> {
        let event = |reading: &Reading| match reading {
            Reading::Event { event, .. } => Some(event.clone()),
            _ => None,
        };
        self.readings.iter().filter_map(event).collect()
    }

    /// Reasons of losses and texts of warnings.
    pub(crate) fn complaints(&self) -> Vec<String> {
        let text = |event| match event {
            DeviceEvent::Lost { reason } => Some(reason),
            DeviceEvent::Warning { text } => Some(text),
            _ => None,
        };
        self.events().into_iter().filter_map(text).collect()
    }

    pub(crate) fn wrenches(&self) -> Vec<WrenchReading> {
        let wrench = |reading: &Reading| match reading {
            Reading::Wrench(wrench) => Some(*wrench),
            _ => None,
        };
        self.readings.iter().filter_map(wrench).collect()
    }

    pub(crate) fn widths(&self) -> Vec<WidthReading> {
        let width = |reading: &Reading| match reading {
            Reading::Width(width) => Some(*width),
            _ => None,
        };
        self.readings.iter().filter_map(width).collect()
    }

    pub(crate) fn poses(&self) -> Vec<PoseReading> {
        let pose = |reading: &Reading| match reading {
            Reading::Pose(pose) => Some(*pose),
            _ => None,
        };
        self.readings.iter().filter_map(pose).collect()
    }
}

impl<D: Device<Frame = Chunk, Reading = Reading>> Bench<D> {
    /// Bytes arrive now, in one chunk.
    pub(crate) fn bytes(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        self.frame(&Chunk::new(bytes).unwrap())
    }

    /// Everything sent since the last call, joined.
    pub(crate) fn take_sent(&mut self) -> Vec<u8> {
        self.sent
            .drain(..)
            .flat_map(|(_, chunk)| chunk.as_slice().to_vec())
            .collect()
    }
}
