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

/// A CAN bus of the configuration. An adapter that is named without its serial number is from then on the one that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CanName {
    /// An interface of the kernel.
    Kernel(String),
    /// A candleLight adapter in user space.
    Adapter(Address),
}

impl CanName {
    /// Reads a port of the configuration: one that begins with [`gs_usb::PREFIX`] is an [`Address`], any other one an interface of
    /// the kernel.
    ///
    /// # Errors
    /// An address that is not written as one.
    pub fn parse(port: &str) -> Result<Self, LinkError> {
        if port.starts_with(gs_usb::PREFIX) {
            Address::parse(port).map(Self::Adapter)
        } else {
            Ok(Self::Kernel(port.to_owned()))
        }
    }

    /// Opens the bus and takes frames with these 11-bit ids only; with no ids, all frames. An adapter without a bit rate in its
    /// name gets `usual_bps`; the bit rate of the kernel's interfaces is the administrator's.
    ///
    /// # Errors
    /// See [`SocketCanLink::open`] and [`GsUsbLink::open`].
    pub fn open(
        &mut self,
        standard_ids: &[u16],
        usual_bps: u32,
        clock: MonotonicClock,
    ) -> Result<CanPort, LinkError> {
        match self {
            Self::Kernel(interface) => {
                SocketCanLink::open(interface, standard_ids, clock).map(CanPort::Kernel)
            }
            Self::Adapter(address) => {
                let link = GsUsbLink::open(address, standard_ids, usual_bps, clock)?;
                address.remember(link.serial_number());
                Ok(CanPort::Adapter(Box::new(link)))
            }
        }
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

    fn overflows(&self) -> u64 {
        match self {
            Self::Kernel(link) => link.overflows(),
            Self::Adapter(link) => link.overflows(),
        }
    }

    fn take_notice(&mut self) -> Option<String> {
        match self {
            Self::Kernel(link) => link.take_notice(),
            Self::Adapter(link) => link.take_notice(),
        }
    }
}
