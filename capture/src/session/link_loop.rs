//! A device's acquisition thread: turns its pump until it is told to stop, and opens a link that is not there yet or was lost.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ft_drivers::device::Counted;
use ft_drivers::link::record::RawFrame;
use ft_drivers::priority::{Duty, SharedProcessor, prefer_this_thread};
use ft_drivers::pump::{Outlet, Pump};
use ft_drivers::reading::{Counts, DeviceEvent, Reading};
use ft_drivers::{Clock, Device, Link, LinkError, MonotonicClock};

use crate::channel::{Channel, Intake};
use crate::ledger::StreamCounters;

/// The longest time without a look at the stop flag.
const TURN: Duration = Duration::from_millis(20);
/// First and longest wait between two tries to reopen a link.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(200), Duration::from_secs(2));

/// What a link thread needs besides its pump.
#[derive(Debug)]
pub struct LinkThread<I> {
    /// The host clock.
    pub clock: MonotonicClock,
    /// Where readings go.
    pub channel: Channel<I>,
    /// The device's account.
    pub counters: Arc<StreamCounters>,
    /// Set to end the thread.
    pub stop: Arc<AtomicBool>,
    /// Shared with the thread that publishes what this one reads; nothing where none does.
    pub processor: Option<SharedProcessor>,
}

impl<I: Intake> LinkThread<I> {
    /// Runs until the stop flag is set; `reopen` makes a new pump after the link was lost, or where there is no `first` one yet.
    pub fn run<D, L>(
        mut self,
        first: Result<Pump<D, L>, LinkError>,
        mut reopen: impl FnMut() -> Result<Pump<D, L>, LinkError>,
    ) where
        D: Device<Reading = Reading> + Counted,
        D::Frame: RawFrame,
        L: Link<Frame = D::Frame>,
    {
        // Not granted without CAP_SYS_NICE: then a busy machine may cost samples, and the ledger says so.
        let _ = prefer_this_thread(Duty::Acquisition);
        if let Some(processor) = &self.processor {
            processor.join();
        }
        let mut before = Counts::default();
        let mut back_off = BACK_OFF.0;
        let opened = match first {
            Ok(pump) => Some(pump),
            Err(error) => {
                self.tell(closed(&error));
                self.reopen_until_stopped(&mut reopen, &mut back_off, closed, with_cause(&error))
            }
        };
        let Some(mut pump) = opened else {
            return;
        };
        loop {
            let Err(error) = self.turn_until_stopped(&mut pump, before) else {
                return;
            };
            // A link that opens and fails at once is tried as seldom as one that does not open.
            if pump.counts().received > 0 {
                back_off = BACK_OFF.0;
            }
            before = before + pump.counts();
            // A dead port that is still open keeps its name from the device that comes back.
            drop(pump);
            self.tell(lost(&error));
            let reopened =
                self.reopen_until_stopped(&mut reopen, &mut back_off, lost, String::new());
            let Some(reopened) = reopened else {
                return;
            };
            pump = reopened;
            self.channel.restart_clock();
        }
    }

    fn turn_until_stopped<D, L>(
        &mut self,
        pump: &mut Pump<D, L>,
        before: Counts,
    ) -> Result<(), LinkError>
    where
        D: Device<Reading = Reading> + Counted,
        D::Frame: RawFrame,
        L: Link<Frame = D::Frame>,
    {
        while !self.stop.load(Ordering::Relaxed) {
            let deadline = self.clock.now() + TURN;
            let turned = pump.turn(&self.clock, deadline, &mut self.channel);
            self.counters.set_driver_counts(before, pump.counts());
            turned?;
        }
        Ok(())
    }

    /// Says why it does not open, once, unless it is just not there yet; `told` was said already.
    fn reopen_until_stopped<P>(
        &mut self,
        reopen: &mut impl FnMut() -> Result<P, LinkError>,
        back_off: &mut Duration,
        event: fn(&LinkError) -> DeviceEvent,
        mut told: String,
    ) -> Option<P> {
        loop {
            let until = self.clock.now() + *back_off;
            while self.clock.now() < until {
                if self.stop.load(Ordering::Relaxed) {
                    return None;
                }
                self.clock.wait_until(until.min(self.clock.now() + TURN));
            }
            *back_off = (*back_off * 2).min(BACK_OFF.1);
            match reopen() {
                Ok(pump) => return Some(pump),
                Err(LinkError::Gone { .. } | LinkError::NotFound { .. }) => {}
                Err(error) => {
                    let text = with_cause(&error);
                    if text != told {
                        self.tell(event(&error));
                        told = text;
                    }
                }
            }
        }
    }

    fn tell(&mut self, event: DeviceEvent) {
        let at = self.clock.now();
        Outlet::<ft_wire::Chunk>::reading(&mut self.channel, Reading::Event { at, event });
    }
}

fn lost(error: &LinkError) -> DeviceEvent {
    let reason = with_cause(error);
    DeviceEvent::Lost { reason }
}

fn closed(error: &LinkError) -> DeviceEvent {
    let reason = with_cause(error);
    DeviceEvent::Closed { reason }
}

/// The error and what the system said.
pub(crate) fn with_cause(error: &LinkError) -> String {
    match std::error::Error::source(error) {
        Some(cause) => format!("{error}: {cause}"),
        None => error.to_string(),
    }
}

#[cfg(test)]
mod tests;
