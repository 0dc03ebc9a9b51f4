//! HID devices by the `hidapi` crate, which on Linux reads hidraw without any library: one report per read.

use std::ffi::CString;
use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;
use std::time::Duration;

use ft_wire::HostTime;
use ft_wire::hid::{MAX_REPORT, Report};
use hidapi::{HidApi, HidDevice, HidError, MAX_REPORT_DESCRIPTOR_SIZE};
use rustix::io::Errno;

use crate::clock::{Clock, MonotonicClock};
use crate::discover;
use crate::hid_axis::HidFrame;
use crate::link::{Link, LinkError, RxStamps};

/// Longest wait in one call of the system.
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// An open HID device. It delivers the report descriptor, then reports; nothing is ever sent to the device.
///
/// Several programs may read one hidraw device; a lock on its node keeps a second one of ours away.
#[derive(Debug)]
pub struct HidrawLink {
    device: HidDevice,
    _lock: File,
    name: String,
    clock: MonotonicClock,
    descriptor: Option<Box<[u8]>>,
    oversized: u64,
    /// Whether that was told.
    told: bool,
}

impl HidrawLink {
    /// Opens `path`, such as `/dev/hidraw0`, for reading and writing, and reads its descriptor.
    ///
    /// # Errors
    /// It does not exist, is busy, is not permitted, or is no HID device.
    pub fn open(path: &Path, clock: MonotonicClock) -> Result<Self, LinkError> {
        let port = path.display().to_string();
        let lock = locked(path, &port)?;
        if !discover::is_permitted(path) {
            return Err(LinkError::Denied { port });
        }
        let failed = |call| {
            let port = port.clone();
            move |error| hid_error(call, port, error)
        };
        // hidapi wants text.
        let node = path.to_str().and_then(|path| CString::new(path).ok());
        let node = node.ok_or_else(|| LinkError::NotFound { port: port.clone() })?;
        let api = HidApi::new().map_err(failed("list HID devices"))?;
        let device = api.open_path(&node).map_err(failed("open"))?;
        let mut descriptor = [0; MAX_REPORT_DESCRIPTOR_SIZE];
        let length = device
            .get_report_descriptor(&mut descriptor)
            .map_err(failed("read the report descriptor"))?;
        Ok(Self {
            device,
            _lock: lock,
            name: port,
            clock,
            descriptor: descriptor.get(..length).map(Into::into),
            oversized: 0,
            told: false,
        })
    }

    fn stamped(&self, frame: HidFrame) -> (HidFrame, RxStamps) {
        let arrival = self.clock.now();
        (frame, RxStamps { arrival })
    }

    fn read_error(&self, error: HidError) -> LinkError {
        match error {
            // What hidapi makes of a poll that hung up: it has no other errors of its own here.
            HidError::HidApiError { .. } => LinkError::Gone {
                port: self.name.clone(),
            },
            error => hid_error("read", self.name.clone(), error),
        }
    }
}

/// The node, locked against another link of ours.
fn locked(path: &Path, port: &str) -> Result<File, LinkError> {
    let port = port.to_owned();
    let file = match File::open(path) {
        Ok(file) => file,
        Err(source) => return Err(io_error("open", port, source)),
    };
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(LinkError::Busy { port }),
        Err(TryLockError::Error(source)) => Err(io_error("lock", port, source)),
    }
}

fn io_error(call: &'static str, port: String, source: io::Error) -> LinkError {
    match source.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::NOENT) => LinkError::NotFound { port },
        Some(Errno::ACCESS | Errno::PERM) => LinkError::Denied { port },
        Some(Errno::BUSY) => LinkError::Busy { port },
        Some(Errno::NODEV | Errno::NXIO | Errno::IO) => LinkError::Gone { port },
        _ => LinkError::Io { call, port, source },
    }
}

fn hid_error(call: &'static str, port: String, error: HidError) -> LinkError {
    let source = match error {
        HidError::IoError { error } => error,
        error => io::Error::other(error),
    };
    io_error(call, port, source)
}

/// Whole milliseconds until `deadline`, rounded up, at most [`LONGEST_WAIT`].
fn wait_ms(left: Duration) -> i32 {
    let left = left.min(LONGEST_WAIT).as_micros().div_ceil(1_000);
    i32::try_from(left).unwrap_or(i32::MAX)
}

impl Link for HidrawLink {
    type Frame = HidFrame;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(HidFrame, RxStamps)>, LinkError> {
        if let Some(descriptor) = self.descriptor.take() {
            return Ok(Some(self.stamped(HidFrame::Descriptor(descriptor))));
        }
        let mut bytes = [0; MAX_REPORT + 1];
        loop {
            let left = deadline.saturating_since(self.clock.now());
            match self.device.read_timeout(&mut bytes, wait_ms(left)) {
                Ok(0) if left <= LONGEST_WAIT => return Ok(None),
                Ok(0) => {}
                Ok(length) => match Report::new(bytes.get(..length).unwrap_or_default()) {
                    Some(report) => return Ok(Some(self.stamped(HidFrame::Report(report)))),
                    None => self.oversized += 1,
                },
                Err(HidError::IoError { error }) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(self.read_error(error)),
            }
        }
    }

    fn send(&mut self, _frame: &HidFrame) -> Result<(), LinkError> {
        Ok(())
    }

    fn overflows(&self) -> u64 {
        self.oversized
    }

    fn take_notice(&mut self) -> Option<String> {
        if self.oversized == 0 || core::mem::replace(&mut self.told, true) {
            return None;
        }
        Some(format!(
            "{}: reports longer than {MAX_REPORT} bytes come and are dropped",
            self.name
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(path: &str) -> Result<HidrawLink, LinkError> {
        HidrawLink::open(Path::new(path), MonotonicClock::anchored_now())
    }

    #[test]
    fn a_node_that_is_not_there_is_named() {
        let refused = open("/dev/hidraw_none");
        assert!(matches!(refused, Err(LinkError::NotFound { .. })));
    }

    #[test]
    fn a_node_that_is_no_hid_device_is_refused() {
        let refused = open("/dev/null").unwrap_err();
        assert!(
            matches!(&refused, LinkError::Io { call: "open", .. }),
            "{refused:?}"
        );
    }

    #[test]
    fn waits_are_never_shorter_than_asked_for() {
        let waits =
            [0, 1, 999, 1_000, 1_001, 5_000_000].map(|us| wait_ms(Duration::from_micros(us)));
        assert_eq!(waits, [0, 1, 1, 1, 2, 1_000]);
    }
}
