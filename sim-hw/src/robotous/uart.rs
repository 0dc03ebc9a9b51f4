//! RFT on UART or USB: `0x55, D1..D8, sum, 0xAA` in, `0x55, D1..D16, sum, 0xAA` out; the sum is over the data bytes, mod 256.

use ft_wire::Chunk;

use super::Rft;
use crate::clock::SimNanos;
use crate::device::{Outbox, Played, push_bytes};
use crate::scene::Scene;

const COMMAND_LENGTH: usize = 11;

#[derive(Debug)]
pub(crate) struct RobotousUart {
    rft: Rft,
    inbox: Vec<u8>,
}

impl RobotousUart {
    pub(crate) fn new(rft: Rft) -> Self {
        Self {
            rft,
            inbox: Vec::new(),
        }
    }
}

/// A response as it goes on the line.
pub(crate) fn packet(response: &[u8; 16]) -> [u8; 19] {
    let mut packet = [0; 19];
    packet[0] = 0x55;
    packet[1..17].copy_from_slice(response);
    packet[17] = sum(response);
    packet[18] = 0xAA;
    packet
}

fn sum(data: &[u8]) -> u8 {
    data.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte))
}

/// The next whole command of `inbox`, which loses it and what stood before it.
fn take_command(inbox: &mut Vec<u8>) -> Option<[u8; 8]> {
    loop {
        let start = inbox
            .iter()
            .position(|byte| *byte == 0x55)
            .unwrap_or(inbox.len());
        inbox.drain(..start);
        if inbox.len() < COMMAND_LENGTH {
            return None;
        }
        let data = <[u8; 8]>::try_from(&inbox[1..9]).ok()?;
        if inbox[9] == sum(&data) && inbox[10] == 0xAA {
            inbox.drain(..COMMAND_LENGTH);
            return Some(data);
        }
        inbox.remove(0);
    }
}

impl Played<Chunk> for RobotousUart {
    fn next_event(&self) -> Option<SimNanos> {
        self.rft.next_sample()
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        let record = self.rft.sample(at, scene);
        push_bytes(out, at, &packet(&record));
    }

    fn receive(&mut self, at: SimNanos, frame: &Chunk, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.inbox.extend(frame.as_slice());
        while let Some(data) = take_command(&mut self.inbox) {
            if let Some(response) = self.rft.command(at, data, scene) {
                push_bytes(out, at + 120_000, &packet(&response));
            }
        }
    }
}
