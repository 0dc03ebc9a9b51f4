//! An encoder behind a microcontroller that prints `$ENC,<us>,<counts>*<check>`, 4096 counts per turn.
//!
//! The check is the exclusive or of what stands between `$` and `*`, in two hexadecimal digits.

use ft_wire::Chunk;

use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::jaw;
use crate::random::Random;
use crate::scene::Scene;

/// Line rate, bit/s.
pub(crate) const BAUD_BPS: u32 = 115_200;
pub(crate) const COUNTS_PER_TURN: f64 = 4096.0;

#[derive(Debug)]
pub(crate) struct EncoderLine {
    clock: DeviceClock,
    cadence: Cadence,
    jitter_m: f64,
    random: Random,
}

impl EncoderLine {
    pub(crate) fn new(clock: DeviceClock, rate_hz: f64, jitter_m: f64, random: Random) -> Self {
        Self {
            cadence: Cadence::starting(700_000, rate_hz, &clock),
            clock,
            jitter_m,
            random,
        }
    }
}

fn line(microseconds: u32, counts: i32) -> String {
    let content = format!("ENC,{microseconds},{counts}");
    let check = content.bytes().fold(0, |check, byte| check ^ byte);
    format!("${content}*{check:02X}\r\n")
}

impl Played<Chunk> for EncoderLine {
    fn next_event(&self) -> Option<SimNanos> {
        Some(self.cadence.next())
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.cadence.tick();
        let (width, _) = scene.jaw(seconds(at));
        let shaft = jaw::shaft_degrees(width + self.jitter_m * self.random.normal());
        let counts = (shaft / 360.0 * COUNTS_PER_TURN).round() as i32;
        let microseconds = (self.clock.reading_ns(at) / 1000) as u32;
        push_bytes(out, at, line(microseconds, counts).as_bytes());
    }

    fn receive(&mut self, _at: SimNanos, _frame: &Chunk, _scene: &Scene, _out: &mut Outbox<Chunk>) {
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_ends_with_the_exclusive_or_of_its_content() {
        assert_eq!(line(0, 0), "$ENC,0,0*48\r\n");
        assert_eq!(line(1_000_000, 2048), "$ENC,1000000,2048*77\r\n");
    }
}
