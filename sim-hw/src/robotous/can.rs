//! RFT on CAN, 1 Mbit/s: commands on id 0x64, responses as a pair of frames on ids 0x01 and 0x02, eight bytes each.

use ft_wire::CanFrame;

use super::Rft;
use crate::clock::SimNanos;
use crate::device::{Outbox, Played};
use crate::scene::Scene;

/// The fixed bit rate.
pub(crate) const BITRATE_BPS: u32 = 1_000_000;

#[derive(Debug)]
pub(crate) struct RobotousCan {
    rft: Rft,
}

impl RobotousCan {
    pub(crate) fn new(rft: Rft) -> Self {
        Self { rft }
    }

    fn send(&self, at: SimNanos, response: [u8; 16], out: &mut Outbox<CanFrame>) {
        let [_, first, second] = self.rft.ids();
        let (low, high) = response.split_at(8);
        for (id, half) in [(first, low), (second, high)] {
            out.extend(CanFrame::standard(u16::from(id), half).map(|frame| (at, frame)));
        }
    }
}

impl Played<CanFrame> for RobotousCan {
    fn next_event(&self) -> Option<SimNanos> {
        self.rft.next_sample()
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<CanFrame>) {
        let record = self.rft.sample(at, scene);
        self.send(at, record, out);
    }

    fn receive(
        &mut self,
        at: SimNanos,
        frame: &CanFrame,
        scene: &Scene,
        out: &mut Outbox<CanFrame>,
    ) {
        let [host, ..] = self.rft.ids();
        let Ok(data) = <[u8; 8]>::try_from(frame.payload()) else {
            return;
        };
        if frame.is_extended() || frame.arbitration_id() != u32::from(host) {
            return;
        }
        if let Some(response) = self.rft.command(at, data, scene) {
            self.send(at + 120_000, response, out);
        }
    }
}
