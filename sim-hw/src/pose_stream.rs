//! The tracker's stream, our own documented format.
//!
//! 74 bytes, little-endian: 0 u8 0xA5 | 1 u8 0x5A | 2 u8 version = 1 | 3 u8 length = 74 | 4 u64 timestamp, ns, tracker's clock |
//! 12 3 x f64 position, m | 36 4 x f64 quaternion x y z w | 68 f32 quality score 0..1 | 72 u16 CRC-16/X-25 over bytes 2..72.
//! It carries `world_from_aria_device` and streams from power-up; nothing the host sends is heard.

use ft_wire::Chunk;

use crate::clock::{Cadence, DeviceClock, SimNanos};
use crate::crc;
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::pose_tracker::PoseTracker;
use crate::scene::Scene;

/// Line rate of the stream, bit/s.
pub(crate) const BAUD_BPS: u32 = 2_000_000;

#[derive(Debug)]
pub(crate) struct PoseStream {
    tracker: PoseTracker,
    clock: DeviceClock,
    cadence: Cadence,
}

impl PoseStream {
    pub(crate) fn new(tracker: PoseTracker, clock: DeviceClock, rate_hz: f64) -> Self {
        Self {
            tracker,
            clock,
            cadence: Cadence::starting(417_000, rate_hz, &clock),
        }
    }
}

impl Played<Chunk> for PoseStream {
    fn next_event(&self) -> Option<SimNanos> {
        Some(self.cadence.next())
    }

    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.cadence.tick();
        let (position, quaternion) = self.tracker.read(&scene.seen(seconds(at)).tcp, seconds(at));
        push_bytes(
            out,
            at,
            &encode(self.clock.reading_ns(at), position, quaternion, 0.97),
        );
    }

    fn receive(&mut self, _at: SimNanos, _frame: &Chunk, _scene: &Scene, _out: &mut Outbox<Chunk>) {
    }
}

fn encode(timestamp_ns: u64, position: [f64; 3], quaternion: [f64; 4], quality: f32) -> Vec<u8> {
    let mut frame = vec![0xA5, 0x5A, 1, 74];
    frame.extend(timestamp_ns.to_le_bytes());
    frame.extend(
        position
            .iter()
            .chain(&quaternion)
            .flat_map(|number| number.to_le_bytes()),
    );
    frame.extend(quality.to_le_bytes());
    let check = crc::x25(&frame[2..]);
    frame.extend(check.to_le_bytes());
    frame
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_its_fields_where_the_table_says() {
        let frame = encode(
            0x0102_0304_0506_0708,
            [1.0, -2.0, 0.5],
            [0.0, 0.0, 0.6, 0.8],
            0.5,
        );
        assert_eq!(frame.len(), 74);
        assert_eq!(frame[..12], [0xA5, 0x5A, 1, 74, 8, 7, 6, 5, 4, 3, 2, 1]);
        assert_eq!(frame[20..28], (-2.0_f64).to_le_bytes());
        assert_eq!(frame[60..68], 0.8_f64.to_le_bytes());
        assert_eq!(frame[68..72], 0.5_f32.to_le_bytes());
        assert_eq!(frame[72..], crc::x25(&frame[2..72]).to_le_bytes());
    }
}
