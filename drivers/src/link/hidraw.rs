//! HID devices through Linux's hidraw: one report per read, the descriptor from sysfs. No library is needed.

use std::fs::File;
use std::io::{self, Read as _};
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ft_wire::HostTime;
use ft_wire::hid::{MAX_REPORT, Report};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags};
use rustix::io::Errno;

use crate::clock::{Clock, MonotonicClock};
use crate::hid_axis::HidFrame;
use crate::link::{Link, LinkError, RxStamps};

/// An open hidraw device. It delivers the report descriptor, then reports; nothing is ever sent to the device.
///
/// Several programs may read one hidraw device; a lock on its node keeps a second one of ours away.
#[derive(Debug)]
pub struct HidrawLink {
    file: File,
    name: String,
    clock: MonotonicClock,
    descriptor: Option<Box<[u8]>>,
    oversized: u64,
}

impl HidrawLink {
    /// Opens `path`, such as `/dev/hidraw0`, and reads its descriptor.
    ///
    /// # Errors
    /// It does not exist, is busy, is not permitted, or has no descriptor.
    pub fn open(path: &Path, clock: MonotonicClock) -> Result<Self, LinkError> {
        let port = path.display().to_string();
        let flags = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = rustix::fs::open(path, flags, Mode::empty())
            .map_err(|errno| open_error(&port, "open", errno))?;
        rustix::fs::flock(&file, FlockOperation::NonBlockingLockExclusive)
            .map_err(|errno| open_error(&port, "flock", errno))?;
        let descriptor_path = descriptor_path(path);
        let descriptor = std::fs::read(&descriptor_path).map_err(|source| LinkError::Io {
            call: "read report_descriptor",
            port: port.clone(),
            source,
        })?;
        Ok(Self::from_parts(file, port, descriptor.into(), clock))
    }

    fn from_parts(
        file: OwnedFd,
        name: String,
        descriptor: Box<[u8]>,
        clock: MonotonicClock,
    ) -> Self {
        Self {
            file: File::from(file),
            name,
            clock,
            descriptor: Some(descriptor),
            oversized: 0,
        }
    }

    /// Reports that were longer than any that is read here, dropped.
    #[must_use]
    pub const fn oversized(&self) -> u64 {
        self.oversized
    }

    fn error(&self, call: &'static str, source: io::Error) -> LinkError {
        let port = self.name.clone();
        match source.raw_os_error().map(Errno::from_raw_os_error) {
            Some(Errno::NODEV | Errno::IO | Errno::NXIO) => LinkError::Gone { port },
            _ => LinkError::Io { call, port, source },
        }
    }

    /// Waits until there is something to read, at most until `deadline`; whether the deadline has passed.
    fn is_over(&self, deadline: HostTime) -> Result<bool, LinkError> {
        let left = deadline.saturating_since(self.clock.now());
        if left.is_zero() {
            return Ok(true);
        }
        let timeout = Timespec::try_from(left.min(Duration::from_secs(1))).unwrap_or_default();
        let mut fds = [PollFd::new(&self.file, PollFlags::IN)];
        match poll(&mut fds, Some(&timeout)) {
            Ok(_) | Err(Errno::INTR) => Ok(false),
            Err(errno) => Err(self.error("poll", errno.into())),
        }
    }
}

/// Where sysfs keeps the descriptor of a node.
fn descriptor_path(node: &Path) -> PathBuf {
    let node = std::fs::canonicalize(node).unwrap_or_else(|_| node.to_owned());
    Path::new("/sys/class/hidraw")
        .join(node.file_name().unwrap_or_default())
        .join("device/report_descriptor")
}

fn open_error(port: &str, call: &'static str, errno: Errno) -> LinkError {
    let port = port.to_owned();
    match errno {
        Errno::NOENT => LinkError::NotFound { port },
        Errno::ACCESS | Errno::PERM => LinkError::Denied { port },
        Errno::WOULDBLOCK | Errno::BUSY => LinkError::Busy { port },
        Errno::NODEV | Errno::NXIO => LinkError::Gone { port },
        _ => LinkError::Io {
            call,
            port,
            source: errno.into(),
        },
    }
}

impl Link for HidrawLink {
    type Frame = HidFrame;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(HidFrame, RxStamps)>, LinkError> {
        let stamped = |frame, clock: &MonotonicClock| {
            let arrival = clock.now();
            Some((frame, RxStamps { arrival }))
        };
        if let Some(descriptor) = self.descriptor.take() {
            return Ok(stamped(HidFrame::Descriptor(descriptor), &self.clock));
        }
        let mut bytes = [0; MAX_REPORT + 1];
        loop {
            match self.file.read(&mut bytes) {
                Ok(0) => {
                    return Err(LinkError::Gone {
                        port: self.name.clone(),
                    });
                }
                Ok(len) => match Report::new(bytes.get(..len).unwrap_or_default()) {
                    Some(report) => return Ok(stamped(HidFrame::Report(report), &self.clock)),
                    None => self.oversized += 1,
                },
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    if self.is_over(deadline)? {
                        return Ok(None);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(self.error("read", error)),
            }
        }
    }

    fn send(&mut self, _frame: &HidFrame) -> Result<(), LinkError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixDatagram;

    use super::*;

    /// A socket that keeps reports apart, as hidraw does.
    fn pair() -> (UnixDatagram, HidrawLink) {
        let (device, host) = UnixDatagram::pair().unwrap();
        host.set_nonblocking(true).unwrap();
        let clock = MonotonicClock::anchored_now();
        let link = HidrawLink::from_parts(host.into(), "hidraw".to_owned(), [5, 1].into(), clock);
        (device, link)
    }

    #[test]
    fn the_descriptor_comes_first_and_then_report_by_report() {
        let (device, mut link) = pair();
        device.send(&[3, 1]).unwrap();
        device.send(&[3, 2, 3]).unwrap();
        let deadline = link.clock.now() + Duration::from_millis(200);
        let mut next = || link.recv(deadline).unwrap().unwrap().0;
        assert_eq!(next(), HidFrame::Descriptor([5, 1].into()));
        assert_eq!(next(), HidFrame::Report(Report::new(&[3, 1]).unwrap()));
        assert_eq!(next(), HidFrame::Report(Report::new(&[3, 2, 3]).unwrap()));
    }

    #[test]
    fn nothing_by_the_deadline_is_none_and_took_that_long() {
        let (_device, mut link) = pair();
        let began = link.clock.now();
        assert!(link.recv(began).unwrap().is_some());
        let deadline = began + Duration::from_millis(60);
        assert!(link.recv(deadline).unwrap().is_none());
        assert!(link.clock.now() >= deadline);
    }

    #[test]
    fn a_report_that_is_too_long_is_dropped_and_counted() {
        let (device, mut link) = pair();
        device.send(&[7; MAX_REPORT + 1]).unwrap();
        device.send(&[8]).unwrap();
        let deadline = link.clock.now() + Duration::from_millis(200);
        link.recv(deadline).unwrap();
        let (frame, _) = link.recv(deadline).unwrap().unwrap();
        assert_eq!(frame, HidFrame::Report(Report::new(&[8]).unwrap()));
        assert_eq!(link.oversized(), 1);
    }

    #[test]
    fn a_node_that_is_not_there_is_named() {
        let clock = MonotonicClock::anchored_now();
        let refused = HidrawLink::open(Path::new("/dev/hidraw_none"), clock);
        assert!(matches!(refused, Err(LinkError::NotFound { .. })));
    }
}
