//! Joins a device and a link, one turn at a time.

use ft_wire::HostTime;

use crate::clock::Clock;
use crate::device::{Counted, Device};
use crate::link::{Link, LinkError, RxStamps};
use crate::reading::{Counts, DeviceEvent, Reading};

/// Where a pump puts what came.
pub trait Outlet<F> {
    /// A frame as the link delivered it, before the device sees it.
    fn frame(&mut self, frame: &F, stamps: RxStamps);
    /// What the device made of it.
    fn reading(&mut self, reading: Reading);
}

/// What a turn brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// A frame came.
    Frame,
    /// None came by the deadline, or by the device's own timeout.
    Idle,
}

/// A device and the link on which it is.
#[derive(Debug)]
pub struct Pump<D, L> {
    device: D,
    link: L,
}

impl<D, L> Pump<D, L> {
    /// Joins `device` and `link`; the device begins at the first turn.
    pub const fn new(device: D, link: L) -> Self {
        Self { device, link }
    }

    /// The device.
    pub const fn device(&self) -> &D {
        &self.device
    }

    /// The link.
    pub const fn link(&self) -> &L {
        &self.link
    }

    /// Takes device and link apart, to join the device with a reopened link.
    pub fn into_parts(self) -> (D, L) {
        (self.device, self.link)
    }
}

impl<D: Counted, L: Link> Pump<D, L> {
    /// What the device and its link counted.
    pub fn counts(&self) -> Counts {
        Counts {
            overflows: self.link.overflows(),
            ..self.device.counts()
        }
    }
}

impl<D, L> Pump<D, L>
where
    D: Device<Reading = Reading>,
    L: Link<Frame = D::Frame>,
{
    /// Sends what the device wants, takes at most one frame until `deadline` or the device's timeout, whichever is
    /// first, and hands the frame and then the readings to `outlet`.
    ///
    /// The device's timeout is looked at after every turn, whether a frame came or not, and is served once the link
    /// is known to have been read up to it: a thread that was held up reads what waits before it calls a device lost.
    /// What the link has to tell becomes a warning. A malformed frame is counted by the device and no error here. Allocates nothing per frame of its own.
    ///
    /// # Errors
    /// The link is unusable until it is opened again.
    pub fn turn<C: Clock>(
        &mut self,
        clock: &C,
        deadline: HostTime,
        outlet: &mut impl Outlet<D::Frame>,
    ) -> Result<Turn, LinkError> {
        self.transmit(clock.now())?;
        let until = self
            .device
            .poll_timeout()
            .map_or(deadline, |timeout| timeout.min(deadline));
        let (turn, read_up_to) = match self.link.recv(until)? {
            None => (Turn::Idle, until),
            Some((frame, stamps)) => {
                outlet.frame(&frame, stamps);
                // Counted by the device.
                let _ = self.device.handle_frame(&frame, stamps);
                self.drain(outlet);
                (Turn::Frame, stamps.arrival)
            }
        };
        let now = clock.now().max(read_up_to);
        if let Some(text) = self.link.take_notice() {
            let event = DeviceEvent::Warning { text };
            outlet.reading(Reading::Event { at: now, event });
        }
        if self
            .device
            .poll_timeout()
            .is_some_and(|timeout| timeout <= read_up_to)
        {
            self.device.handle_timeout(now);
            self.drain(outlet);
        }
        self.transmit(now)?;
        Ok(turn)
    }

    fn transmit(&mut self, now: HostTime) -> Result<(), LinkError> {
        while let Some(frame) = self.device.poll_transmit(now) {
            self.link.send(&frame)?;
        }
        Ok(())
    }

    fn drain(&mut self, outlet: &mut impl Outlet<D::Frame>) {
        while let Some(reading) = self.device.poll_reading() {
            outlet.reading(reading);
        }
    }
}

#[cfg(test)]
mod tests;
