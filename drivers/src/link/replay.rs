//! Frames of a recording, delivered as a live link would.

use ft_wire::HostTime;

use crate::clock::SteppedClock;
use crate::link::{Link, LinkError, RxStamps};

/// Delivers recorded frames at their stamps, and moves a clock on as a wait would.
///
/// What a driver sends is counted and goes nowhere. After the last frame the link is gone.
#[derive(Debug)]
pub struct ReplayLink<I: Iterator> {
    clock: SteppedClock,
    frames: I,
    next: Option<I::Item>,
    sent: u64,
}

impl<F, I: Iterator<Item = (F, RxStamps)>> ReplayLink<I> {
    /// A link that delivers `frames`, which are in order of arrival, and moves `clock`, which begins at the first one.
    pub fn new(
        clock: SteppedClock,
        frames: impl IntoIterator<IntoIter = I, Item = (F, RxStamps)>,
    ) -> Self {
        let mut frames = frames.into_iter();
        let next = frames.next();
        if let Some((_, stamps)) = &next {
            clock.advance_to(stamps.arrival);
        }
        Self {
            clock,
            frames,
            next,
            sent: 0,
        }
    }

    /// When the next frame comes; `None` after the last one.
    pub fn next_arrival(&self) -> Option<HostTime> {
        self.next.as_ref().map(|(_, stamps)| stamps.arrival)
    }

    /// Frames that the driver sent into the void.
    pub const fn sent(&self) -> u64 {
        self.sent
    }
}

impl<F, I: Iterator<Item = (F, RxStamps)>> Link for ReplayLink<I> {
    type Frame = F;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(F, RxStamps)>, LinkError> {
        let Some((frame, stamps)) = self.next.take() else {
            return Err(LinkError::Gone {
                port: "replay".to_owned(),
            });
        };
        if stamps.arrival > deadline {
            self.next = Some((frame, stamps));
            self.clock.advance_to(deadline);
            return Ok(None);
        }
        self.clock.advance_to(stamps.arrival);
        self.next = self.frames.next();
        Ok(Some((frame, stamps)))
    }

    fn send(&mut self, _frame: &F) -> Result<(), LinkError> {
        self.sent += 1;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Clock;

    fn at(ns: i64) -> RxStamps {
        RxStamps {
            arrival: HostTime::from_nanos(ns),
        }
    }

    #[test]
    fn frames_come_at_their_stamps_and_move_the_clock() {
        let clock = SteppedClock::new(HostTime::EPOCH);
        let mut link = ReplayLink::new(clock.clone(), [('a', at(100)), ('b', at(300))]);
        assert_eq!(clock.now(), HostTime::from_nanos(100));
        assert_eq!(
            link.recv(HostTime::from_nanos(200)).unwrap(),
            Some(('a', at(100)))
        );
        assert_eq!(link.recv(HostTime::from_nanos(200)).unwrap(), None);
        assert_eq!(
            (clock.now(), link.next_arrival()),
            (HostTime::from_nanos(200), Some(HostTime::from_nanos(300)))
        );
        link.send(&'x').unwrap();
        assert_eq!(
            link.recv(HostTime::FAR_FUTURE).unwrap(),
            Some(('b', at(300)))
        );
        assert_eq!((clock.now(), link.sent()), (HostTime::from_nanos(300), 1));
        assert!(matches!(
            link.recv(HostTime::FAR_FUTURE),
            Err(LinkError::Gone { .. })
        ));
    }
}
