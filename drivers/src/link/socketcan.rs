//! CAN interfaces of the kernel.

use std::io;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use ft_wire::{CanFrame, HostTime};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use socketcan::timestamp::{
    SOF_TIMESTAMPING_OPT_CMSG, SOF_TIMESTAMPING_RX_SOFTWARE, SOF_TIMESTAMPING_SOFTWARE,
};
use socketcan::{
    CanDataFrame, CanFilter, CanFrame as KernelFrame, CanSocket, EmbeddedFrame as _, ExtendedId,
    Id, Socket as _, SocketOptions as _, StandardId,
};

use crate::clock::{Clock, MonotonicClock};
use crate::link::can_errors::{CanErrors, ErrorWatch};
use crate::link::{Link, LinkError, RxStamps};

mod stamps;

use stamps::{BothClocks, KernelStamps};

/// Bits of `linux/can.h` and `linux/can/error.h`.
mod bits {
    pub(super) const STANDARD_MASK: u32 = 0x7FF;
    pub(super) const EXTENDED: u32 = 0x8000_0000;
    pub(super) const REMOTE: u32 = 0x4000_0000;
    pub(super) const ALL_ERRORS: u32 = 0x1FFF_FFFF;
}

/// Of `asm-generic/socket.h`.
mod socket_level {
    pub(super) const SOL_SOCKET: i32 = 1;
    pub(super) const SO_ERROR: i32 = 4;
}

/// `SO_MEMINFO` of `asm-generic/socket.h`: nine words about a socket's memory, of which the last one (`SK_MEMINFO_DROPS` of
/// `linux/sock_diag.h`) counts frames for which its receive queue had no room. `SO_RXQ_OVFL` reports the same counter beside frames.
mod memory {
    pub(super) const SO_MEMINFO: i32 = 55;
    pub(super) const WORDS: usize = 9;
}
/// How often the kernel is asked whether there is something to tell of it.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// An open CAN interface.
///
/// Arrivals are the kernel's software receive stamps, put onto the [`MonotonicClock`]. A frame that waits to be read while the
/// system's clock is stepped by more than 1 ms may get an arrival as late as its read, never an earlier one than its own. Error
/// frames are counted; bus-off ends the link.
#[derive(Debug)]
pub struct SocketCanLink {
    socket: CanSocket,
    interface: String,
    clock: MonotonicClock,
    watch: ErrorWatch,
    foreign: u64,
    overflow_told: bool,
    look_again_at: HostTime,
    stamps: KernelStamps,
}

impl SocketCanLink {
    /// Opens `interface` and takes frames with these 11-bit ids only; with no ids, all frames.
    ///
    /// # Errors
    /// There is no such interface, it is down, or the system refuses a call (a kernel without CAN, for one).
    pub fn open(
        interface: &str,
        standard_ids: &[u16],
        clock: MonotonicClock,
    ) -> Result<Self, LinkError> {
        let failed = |call| move |source| link_error(interface, call, source);
        let socket = CanSocket::open(interface).map_err(failed("open"))?;
        // An interface that is down opens, and the socket holds the error.
        let mut pending = [0; 4];
        socket
            .get_socket_option_bytes(
                socket_level::SOL_SOCKET,
                socket_level::SO_ERROR,
                &mut pending,
            )
            .map_err(failed("ask for errors"))?;
        match i32::from_ne_bytes(pending) {
            0 => {}
            code => return Err(failed("open")(io::Error::from_raw_os_error(code))),
        }
        if !standard_ids.is_empty() {
            let mask = bits::STANDARD_MASK | bits::EXTENDED | bits::REMOTE;
            let filters: Vec<_> = standard_ids
                .iter()
                .map(|id| CanFilter::new(u32::from(*id), mask))
                .collect();
            socket
                .set_filters(&filters)
                .map_err(failed("set filters"))?;
        }
        socket
            .set_error_filter(bits::ALL_ERRORS)
            .map_err(failed("set error filter"))?;
        let stamps =
            SOF_TIMESTAMPING_RX_SOFTWARE | SOF_TIMESTAMPING_SOFTWARE | SOF_TIMESTAMPING_OPT_CMSG;
        socket
            .set_timestamping(stamps)
            .map_err(failed("set timestamping"))?;
        socket
            .set_nonblocking(true)
            .map_err(failed("set non-blocking"))?;
        Ok(Self {
            socket,
            interface: interface.to_owned(),
            clock,
            watch: ErrorWatch::new(),
            foreign: 0,
            overflow_told: false,
            look_again_at: HostTime::EPOCH,
            stamps: KernelStamps::new(both_clocks(&clock)),
        })
    }

    /// Error frames so far.
    #[must_use]
    pub const fn errors(&self) -> CanErrors {
        self.watch.errors
    }

    /// Remote frames so far, which no device here uses.
    #[must_use]
    pub const fn foreign(&self) -> u64 {
        self.foreign
    }

    /// Frames for which the receive queue had no room so far; a kernel before 4.12 does not say.
    fn ask_for_overflows(&self) -> Option<u64> {
        let mut words = [0; 4 * memory::WORDS];
        let asked = self.socket.get_socket_option_bytes(
            socket_level::SOL_SOCKET,
            memory::SO_MEMINFO,
            &mut words,
        );
        let last = words
            .last_chunk()
            .filter(|_| asked.ok() == Some(words.len()))?;
        Some(u32::from_ne_bytes(*last).into())
    }

    fn error(&self, call: &'static str, source: io::Error) -> LinkError {
        link_error(&self.interface, call, source)
    }

    /// Waits until there is something to read, at most until `deadline`.
    fn wait(&self, deadline: HostTime) -> Result<bool, LinkError> {
        let left = deadline
            .saturating_since(self.clock.now())
            .min(Duration::from_secs(1));
        let timeout = Timespec::try_from(left).unwrap_or_default();
        let mut fds = [PollFd::new(&self.socket, PollFlags::IN)];
        match poll(&mut fds, Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(false),
            Err(errno) => Err(self.error("poll", errno.into())),
        }
    }

    /// The data frame, or `None` for what is only counted.
    fn sort(&mut self, frame: KernelFrame) -> Result<Option<CanFrame>, LinkError> {
        match frame {
            KernelFrame::Data(data) => Ok(from_kernel(&data)),
            KernelFrame::Remote(_) => {
                self.foreign += 1;
                Ok(None)
            }
            KernelFrame::Error(error) => {
                self.watch.count(error.error_bits(), &self.interface)?;
                Ok(None)
            }
        }
    }
}

/// The two clocks are read within so much time of each other, or so often.
const APART: Duration = Duration::from_micros(100);
const MOST_READS: u32 = 5;

#[allow(
    clippy::disallowed_methods,
    reason = "the kernel's stamps are on the system's clock"
)]
fn both_clocks(clock: &MonotonicClock) -> BothClocks {
    let read = || {
        let before = clock.now();
        let system_ns = since_epoch_ns(SystemTime::now());
        let host = clock.now();
        (
            host.saturating_since(before),
            BothClocks { system_ns, host },
        )
    };
    // A thread that was held up between the two would look like a step of the system's clock.
    let mut best = read();
    for _ in 1..MOST_READS {
        if best.0 < APART {
            break;
        }
        let again = read();
        if again.0 < best.0 {
            best = again;
        }
    }
    best.1
}

/// ns since the Unix epoch; 0 before it.
fn since_epoch_ns(at: SystemTime) -> i64 {
    let since = at.duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

fn link_error(interface: &str, call: &'static str, source: io::Error) -> LinkError {
    let port = interface.to_owned();
    match source.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::NODEV | Errno::NXIO) if call == "open" => LinkError::NotFound { port },
        Some(Errno::NODEV | Errno::NXIO) => LinkError::Gone { port },
        Some(Errno::NETDOWN) => LinkError::Down { port },
        Some(Errno::NOBUFS) => LinkError::NoAcknowledge { port },
        Some(Errno::ACCESS | Errno::PERM) => LinkError::Denied { port },
        _ => LinkError::Io { call, port, source },
    }
}

fn from_kernel(frame: &CanDataFrame) -> Option<CanFrame> {
    match frame.id() {
        Id::Standard(id) => CanFrame::standard(id.as_raw(), frame.data()),
        Id::Extended(id) => CanFrame::extended(id.as_raw(), frame.data()),
    }
}

fn to_kernel(frame: &CanFrame) -> Option<CanDataFrame> {
    let id = if frame.is_extended() {
        Id::Extended(ExtendedId::new(frame.arbitration_id())?)
    } else {
        Id::Standard(StandardId::new(
            u16::try_from(frame.arbitration_id()).ok()?,
        )?)
    };
    CanDataFrame::new(id, frame.payload())
}

impl Link for SocketCanLink {
    type Frame = CanFrame;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(CanFrame, RxStamps)>, LinkError> {
        loop {
            match self.socket.read_frame_with_timestamps() {
                Ok((frame, stamps)) => {
                    let clocks = both_clocks(&self.clock);
                    let arrival = self.stamps.arrival(stamps.sw.map(since_epoch_ns), clocks);
                    if let Some(frame) = self.sort(frame)? {
                        return Ok(Some((frame, RxStamps { arrival })));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    self.stamps.nothing_waits(both_clocks(&self.clock));
                    if !self.wait(deadline)? && self.clock.now() >= deadline {
                        return Ok(None);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(self.error("read", error)),
            }
        }
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), LinkError> {
        let Some(frame) = to_kernel(frame) else {
            return Ok(());
        };
        self.socket
            .write_frame(&frame)
            .map_err(|error| self.error("write", error))
    }

    fn overflows(&self) -> u64 {
        self.ask_for_overflows().unwrap_or_default()
    }

    fn take_notice(&mut self) -> Option<String> {
        let now = self.clock.now();
        if !self.overflow_told && now >= self.look_again_at {
            self.look_again_at = now + LOOK_EVERY;
            let overflows = self.overflows();
            if overflows > 0 {
                self.overflow_told = true;
                return Some(format!(
                    "{}: frames are lost ({overflows} found no room in the kernel's queue): this machine is too busy",
                    self.interface
                ));
            }
        }
        self.watch.notice(now, &self.interface)
    }
}

#[cfg(test)]
mod tests;
