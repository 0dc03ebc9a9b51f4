//! A CAN bus by the name that the configuration gives it: an interface of the kernel or an adapter in user space.

use ft_wire::{CanFrame, HostTime};

use crate::clock::MonotonicClock;
use crate::link::gs_usb::{self, Address, GsUsbLink};
use crate::link::socketcan::SocketCanLink;
use crate::link::{Link, LinkError, RxStamps};

/// An open CAN bus.
#[derive(Debug)]
pub enum CanPort {
    /// An interface of the kernel.
    Kernel(SocketCanLink),
    /// A candleLight adapter in user space.
    Adapter(Box<GsUsbLink>),
}

impl CanPort {
    /// Opens `port` and takes frames with these 11-bit ids only; with no ids, all frames. A name that begins with
    /// [`gs_usb::PREFIX`] is an [`Address`], any other one an interface of the kernel.
    ///
    /// # Errors
    /// See [`SocketCanLink::open`] and [`GsUsbLink::open`].
    pub fn open(
        port: &str,
        standard_ids: &[u16],
        clock: MonotonicClock,
    ) -> Result<Self, LinkError> {
        if port.starts_with(gs_usb::PREFIX) {
            let link = GsUsbLink::open(&Address::parse(port)?, standard_ids, clock)?;
            return Ok(Self::Adapter(Box::new(link)));
        }
        SocketCanLink::open(port, standard_ids, clock).map(Self::Kernel)
    }
}

impl Link for CanPort {
    type Frame = CanFrame;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(CanFrame, RxStamps)>, LinkError> {
        match self {
            Self::Kernel(link) => link.recv(deadline),
            Self::Adapter(link) => link.recv(deadline),
        }
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), LinkError> {
        match self {
            Self::Kernel(link) => link.send(frame),
            Self::Adapter(link) => link.send(frame),
        }
    }

    fn take_notice(&mut self) -> Option<String> {
        match self {
            Self::Kernel(link) => link.take_notice(),
            Self::Adapter(link) => link.take_notice(),
        }
    }
}
