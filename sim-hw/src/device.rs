//! The contract of a played device: what the host sends goes in, what the device sends comes out, at instants.

use std::fmt;

use ft_wire::Chunk;

use crate::clock::SimNanos;
use crate::scene::Scene;

/// What a device sends, and when it is ready to go on the line.
pub(crate) type Outbox<F> = Vec<(SimNanos, F)>;

pub(crate) trait Played<F>: fmt::Debug + Send {
    /// When the device does something by itself next.
    fn next_event(&self) -> Option<SimNanos>;

    /// Does what is due at `at`; the scene stands there.
    fn run(&mut self, at: SimNanos, scene: &Scene, out: &mut Outbox<F>);

    /// Takes a frame of the host that arrives whole at `at`.
    fn receive(&mut self, at: SimNanos, frame: &F, scene: &Scene, out: &mut Outbox<F>);

    /// The line rate when the device can change it, bit/s.
    fn line_rate(&self) -> Option<u32> {
        None
    }
}

/// Puts `bytes` into the box, in chunks.
pub(crate) fn push_bytes(out: &mut Outbox<Chunk>, ready: SimNanos, mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let (chunk, taken) = Chunk::take_from(bytes);
        out.push((ready, chunk));
        bytes = &bytes[taken..];
    }
}

pub(crate) fn seconds(at: SimNanos) -> f64 {
    at as f64 * 1e-9
}
