//! The contract of a link: it carries frames and says when they came.

pub mod can_errors;
pub mod can_port;
pub mod faults;
pub mod gs_usb;
pub mod hidraw;
pub mod record;
pub mod replay;
pub mod serial;
pub mod socketcan;

use ft_wire::HostTime;

use crate::discover::bring_up;

/// When a frame came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RxStamps {
    /// Earliest host stamp of the frame's last byte: the kernel's where it gives one, else ours after the read.
    pub arrival: HostTime,
}

/// SocketCAN, gs_usb, hidraw, serial, replay, faults and sim-hw alike. A malformed frame is not a link error.
pub trait Link {
    /// What is carried: [`ft_wire::Chunk`], [`ft_wire::CanFrame`] or [`crate::hid_axis::HidFrame`].
    type Frame;

    /// The next frame, or `None` when none came by `deadline`.
    ///
    /// # Errors
    /// The link is unusable until it is opened again.
    fn recv(&mut self, deadline: HostTime) -> Result<Option<(Self::Frame, RxStamps)>, LinkError>;

    /// Sends one frame, without waiting for the other side.
    ///
    /// # Errors
    /// The link is unusable until it is opened again.
    fn send(&mut self, frame: &Self::Frame) -> Result<(), LinkError>;

    /// Frames that never came because the kernel or the adapter had no room for them, or that came as no frame at all, since the
    /// link was opened. What the back end cannot know is not in it.
    fn overflows(&self) -> u64 {
        0
    }

    /// Something about the link that the operator must know, said once: a converter that collects bytes, errors on the bus.
    fn take_notice(&mut self) -> Option<String> {
        None
    }
}

/// Why a link is unusable. Reopening is the answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// Unplugged, or the other end closed.
    #[error("{port} is gone: unplugged, or closed by the other end")]
    Gone {
        /// The port as it was opened.
        port: String,
    },
    /// Another program holds it.
    #[error("{port} is busy: another program has it open")]
    Busy {
        /// The port as it was opened.
        port: String,
    },
    /// The permission is missing.
    #[error(
        "{port} may not be opened by this user: install the rules of udev/ or join the group that owns it"
    )]
    Denied {
        /// The port as it was opened.
        port: String,
    },
    /// There is no such port.
    #[error(
        "{port} does not exist: check the cable and the name (`ft-capture devices` lists what is there)"
    )]
    NotFound {
        /// The port as it was opened.
        port: String,
    },
    /// Another device of the same make is where it was.
    #[error(
        "{port}: the device there has serial number {there}, the one that was there had {wanted}: plug that one in"
    )]
    Other {
        /// The port as it was configured.
        port: String,
        /// Serial number of the device there.
        there: String,
        /// Serial number of the one that was there before.
        wanted: String,
    },
    /// A name that cannot be read.
    #[error("{port} is no name of a port: write {form}")]
    Name {
        /// The port of the configuration.
        port: String,
        /// How it is to be written.
        form: &'static str,
    },
    /// The adapter has no such channel.
    #[error("{port}: the adapter has no channel {channel}: write one that it has, the first is 0")]
    Channel {
        /// The port of the configuration.
        port: String,
        /// Its number, the first is 0.
        channel: u8,
    },
    /// One name for several devices.
    #[error(
        "{port} stands for {count} adapters: name one by its serial number, `ft-capture devices` lists them"
    )]
    Ambiguous {
        /// The port of the configuration.
        port: String,
        /// How many there are.
        count: usize,
    },
    /// The network interface is not up.
    #[error(
        "{port} is down: {}", bring_up(.port)
    )]
    Down {
        /// The interface.
        port: String,
    },
    /// The CAN controller went off the bus after too many errors.
    #[error(
        "{port} went bus-off: check bit rate, termination and wiring; without restart-ms it stays off"
    )]
    BusOff {
        /// The interface.
        port: String,
    },
    /// Frames pile up because nobody on the bus acknowledges them.
    #[error("nobody acknowledges on {port}: check bit rate, termination, power")]
    NoAcknowledge {
        /// The interface.
        port: String,
    },
    /// The system refused a call.
    #[error("{call} on {port} failed")]
    Io {
        /// The call that failed.
        call: &'static str,
        /// The port as it was opened.
        port: String,
        /// What the system said.
        source: std::io::Error,
    },
}

impl LinkError {
    /// Whether the port may open later though nobody changes a configuration or a permission: it is not plugged in or not up
    /// yet, or another program has it still. A name of nothing that will ever be there looks the same.
    #[must_use]
    pub const fn may_pass(&self) -> bool {
        matches!(
            self,
            Self::NotFound { .. } | Self::Gone { .. } | Self::Busy { .. } | Self::Down { .. }
        )
    }
}
