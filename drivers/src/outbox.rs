//! Bytes waiting to be sent to a byte-stream device, at once or one by one.

use core::time::Duration;

use ft_wire::{Chunk, HostTime};

/// Bytes of one command on their way out.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    waiting: Chunk,
    sent: usize,
    pace: Duration,
    next_at: HostTime,
}

impl Outbox {
    /// Queues `command` in place of what was waiting. With a `pace` it leaves byte by byte, else in one chunk.
    /// Returns when its last byte leaves.
    pub(crate) fn queue(&mut self, command: &[u8], pace: Duration, now: HostTime) -> HostTime {
        self.waiting = Chunk::take_from(command).0;
        (self.sent, self.pace, self.next_at) = (0, pace, now);
        let steps = u32::try_from(command.len().saturating_sub(1)).unwrap_or(u32::MAX);
        now + pace.saturating_mul(steps)
    }

    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }

    /// When the next byte may leave; `None` when nothing waits.
    pub(crate) fn due(&self) -> Option<HostTime> {
        (self.sent < self.waiting.as_slice().len()).then_some(self.next_at)
    }

    /// What may leave now.
    pub(crate) fn take(&mut self, now: HostTime) -> Option<Chunk> {
        if now < self.due()? {
            return None;
        }
        let rest = self.waiting.as_slice().get(self.sent..)?;
        let (chunk, taken) = if self.pace.is_zero() {
            Chunk::take_from(rest)
        } else {
            Chunk::take_from(rest.get(..1)?)
        };
        self.sent += taken;
        self.next_at = now + self.pace;
        Some(chunk)
    }
}
