//! CUI AMT21 on RS-485, 2 Mbit/s: one byte asks, two answer.
//!
//! Answer: u16 little-endian, bit 15 = not(xor of the odd bits of the position), bit 14 = not(xor of the even bits), 14 bits position.
//!
//! # Source
//! `cuidevices/AMT21_RS485_Sample_Code_Mega`, datasheet. Reset and zero (address + 2) are not played.

use ft_wire::Chunk;

use crate::clock::SimNanos;
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::jaw;
use crate::random::Random;
use crate::scene::Scene;

/// Line rate, bit/s.
pub(crate) const BAUD_BPS: u32 = 2_000_000;
const ADDRESS: u8 = 0x54;
const ANSWER_NS: SimNanos = 3_000;

#[derive(Debug)]
pub(crate) struct Amt21 {
    jitter_m: f64,
    random: Random,
}

impl Amt21 {
    pub(crate) fn new(jitter_m: f64, random: Random) -> Self {
        Self { jitter_m, random }
    }
}

fn answer(position: u16) -> [u8; 2] {
    let mut word = position & 0x3FFF;
    // K1 over bits 13, 11, .. 1 and K0 over bits 12, 10, .. 0, bit by bit.
    for (first, check) in [(1, 15), (0, 14)] {
        let ones = (0..7).filter(|pair| position >> (first + 2 * pair) & 1 == 1);
        if ones.count() % 2 == 0 {
            word |= 1 << check;
        }
    }
    word.to_le_bytes()
}

impl Played<Chunk> for Amt21 {
    fn next_event(&self) -> Option<SimNanos> {
        None
    }

    fn run(&mut self, _at: SimNanos, _scene: &Scene, _out: &mut Outbox<Chunk>) {}

    fn receive(&mut self, at: SimNanos, frame: &Chunk, scene: &Scene, out: &mut Outbox<Chunk>) {
        for _ in frame.as_slice().iter().filter(|byte| **byte == ADDRESS) {
            let (width, _) = scene.jaw(seconds(at));
            let shaft = jaw::shaft_degrees(width + self.jitter_m * self.random.normal());
            let position = (shaft / 360.0 * 16_384.0).round().rem_euclid(16_384.0);
            push_bytes(out, at + ANSWER_NS, &answer(position as u16));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_are_those_of_the_datasheet() {
        // 8619 = 0x21AB is answered AB 61 there.
        assert_eq!(answer(0x21AB), [0xAB, 0x61]);
        assert_eq!(answer(0), [0x00, 0xC0]);
        assert_eq!(answer(0x3FFF), [0xFF, 0x3F]);
    }
}
