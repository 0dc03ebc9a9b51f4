//! Frames of ours for which the adapter had no room yet.

use std::collections::VecDeque;
use std::time::Duration;

use ft_wire::HostTime;
use ft_wire::gs_usb::FRAME;

/// As many as [`super::echoes::Echoes`] lets out, so that none is ever added beyond the room for them.
const MOST: usize = 10;
/// An adapter that takes nothing for so long is stuck, or nobody acknowledges on its bus.
const PATIENCE: Duration = Duration::from_secs(1);
/// Between two tries: a try may take [`super::ROOM`], in which nobody reads.
const RETRY_AFTER: Duration = Duration::from_millis(50);

/// The frames, the oldest first.
#[derive(Debug)]
pub(super) struct Waiting {
    frames: VecDeque<[u8; FRAME]>,
    /// When there was no room for the first of them, and when it is tried again.
    refused: Option<(HostTime, HostTime)>,
}

impl Waiting {
    pub(super) fn new() -> Self {
        Self {
            frames: VecDeque::with_capacity(MOST),
            refused: None,
        }
    }

    pub(super) fn push(&mut self, frame: [u8; FRAME]) {
        self.frames.push_back(frame);
    }

    /// Hands frames to `write`, which says whether there was room, unless there was none a moment ago; false when there was none
    /// for too long.
    pub(super) fn flush<E>(
        &mut self,
        now: HostTime,
        mut write: impl FnMut(&[u8]) -> Result<bool, E>,
    ) -> Result<bool, E> {
        if self.refused.is_some_and(|(_, again)| now < again) {
            return Ok(true);
        }
        while let Some(frame) = self.frames.front() {
            if !write(frame)? {
                let since = self.refused.map_or(now, |(since, _)| since);
                self.refused = Some((since, (now + RETRY_AFTER).min(since + PATIENCE)));
                return Ok(now.saturating_since(since) < PATIENCE);
            }
            self.frames.pop_front();
            self.refused = None;
        }
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_wait_in_order_and_not_for_ever() {
        let mut waiting = Waiting::new();
        let at = |ms: i64| HostTime::from_nanos(ms * 1_000_000);
        let full = |_: &[u8]| Ok::<_, ()>(false);
        assert_eq!(waiting.flush(at(0), full), Ok(true), "nothing waits");
        for number in [1, 2, 3] {
            waiting.push([number; FRAME]);
        }
        let mut taken: Vec<u8> = Vec::new();
        let mut room_for_one = |frame: &[u8]| {
            let room = taken.is_empty();
            taken.extend(frame.first().filter(|_| room));
            Ok::<_, ()>(room)
        };
        assert_eq!(waiting.flush(at(1), &mut room_for_one), Ok(true));
        assert_eq!(taken, [1]);
        assert_eq!(waiting.flush(at(999), full), Ok(true));
        assert_eq!(waiting.flush(at(1_001), full), Ok(false));
        let mut rest: Vec<u8> = Vec::new();
        let mut room = |frame: &[u8]| {
            rest.extend(frame.first());
            Ok::<_, ()>(true)
        };
        assert_eq!(waiting.flush(at(1_002), &mut room), Ok(true));
        assert_eq!(rest, [2, 3]);
    }

    /// The room for 64 frames that candleLight's smallest adapters have lasts while one of ours finds none: frames of a sensor at
    /// 1 kHz come all 0.5 ms, and a read takes 0.125 ms.
    #[test]
    fn frames_are_read_as_fast_as_they_come_while_one_of_ours_waits() {
        const KEPT: i64 = 64;
        let mut waiting = Waiting::new();
        waiting.push([1; FRAME]);
        let (mut at_us, mut read, mut tries) = (0_i64, 0_i64, 0);
        while at_us < 900_000 {
            let now = HostTime::from_nanos(at_us * 1_000);
            let full = |_: &[u8]| {
                at_us += i64::try_from(super::super::ROOM.as_micros()).unwrap();
                tries += 1;
                Ok::<_, ()>(false)
            };
            assert_eq!(waiting.flush(now, full), Ok(true));
            let kept = at_us / 500 - read;
            assert!(kept <= KEPT, "{kept} frames wait after {at_us} us");
            read += kept.min(1);
            at_us += 125;
        }
        assert!(tries > 10, "{tries}");
    }
}
