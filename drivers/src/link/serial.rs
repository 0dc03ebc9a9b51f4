//! Serial ports and ptys, opened for us alone.

use std::fmt;
use std::io::{self, Read as _, Write as _};
use std::path::Path;
use std::time::Duration;

use ft_wire::{Chunk, HostTime};
use serialport::{ErrorKind, SerialPort as _, TTYPort};

use crate::clock::{Clock, MonotonicClock};
use crate::discover;
use crate::link::{Link, LinkError, RxStamps};

/// Longest wait in one call of the system.
const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// Longest wait for room in the port's output buffer; commands are a few bytes.
const SEND_TIMEOUT: Duration = Duration::from_millis(200);

/// An open serial port, 8N1 without flow control.
///
/// A chunk is what one read delivered; its arrival is our clock after the read, the stamp of its last byte. Bytes
/// that the kernel or a USB converter had held back look late by that time, see [`SerialLink::latency_timer_ms`].
pub struct SerialLink {
    port: TTYPort,
    name: String,
    clock: MonotonicClock,
    latency_timer_ms: Option<u32>,
    /// Whether the latency timer was told.
    told: bool,
}

impl fmt::Debug for SerialLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SerialLink")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

impl SerialLink {
    /// Opens the port at `path`, for this program alone (TIOCEXCL and flock), and drops what it had received before.
    /// On a pty the bit rate means nothing and any is taken.
    ///
    /// # Errors
    /// It does not exist, is busy, is not permitted, or the system refuses it or its bit rate.
    pub fn open(path: &Path, baud_bps: u32, clock: MonotonicClock) -> Result<Self, LinkError> {
        let name = path.display().to_string();
        let open = || {
            let port = serialport::new(name.as_str(), baud_bps)
                .timeout(LONGEST_WAIT)
                .open_native()?;
            port.clear(serialport::ClearBuffer::Input)?;
            Ok(port)
        };
        let port = open().map_err(|error: serialport::Error| open_error(&name, error))?;
        Ok(Self {
            port,
            latency_timer_ms: discover::latency_timer_ms(path),
            name,
            clock,
            told: false,
        })
    }

    /// The port as it was opened.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The converter's latency timer, ms, when it is above 1: samples come in bursts, warn the operator. `None` is fine.
    #[must_use]
    pub fn latency_timer_ms(&self) -> Option<u32> {
        self.latency_timer_ms.filter(|ms| *ms > 1)
    }

    fn wait_for(&mut self, timeout: Duration) -> Result<(), LinkError> {
        self.port
            .set_timeout(timeout)
            .map_err(|error| self.io_error("set timeout", error.into()))
    }

    fn gone(&self) -> LinkError {
        LinkError::Gone {
            port: self.name.clone(),
        }
    }

    fn io_error(&self, call: &'static str, source: io::Error) -> LinkError {
        let unplugged =
            source.kind() == io::ErrorKind::BrokenPipe || !Path::new(&self.name).exists();
        if unplugged {
            self.gone()
        } else {
            LinkError::Io {
                call,
                port: self.name.clone(),
                source,
            }
        }
    }
}

fn open_error(name: &str, error: serialport::Error) -> LinkError {
    let port = name.to_owned();
    match error.kind() {
        // What serialport makes of EBUSY and of a lock that another holds.
        ErrorKind::NoDevice => LinkError::Busy { port },
        ErrorKind::Io(io::ErrorKind::NotFound) => LinkError::NotFound { port },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => LinkError::Denied { port },
        _ => LinkError::Io {
            call: "open",
            port,
            source: error.into(),
        },
    }
}

impl Link for SerialLink {
    type Frame = Chunk;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(Chunk, RxStamps)>, LinkError> {
        let mut bytes = [0; Chunk::CAPACITY];
        loop {
            let left = deadline.saturating_since(self.clock.now());
            self.wait_for(left.min(LONGEST_WAIT))?;
            match self.port.read(&mut bytes) {
                Ok(0) => return Err(self.gone()),
                Ok(len) => {
                    let stamps = RxStamps {
                        arrival: self.clock.now(),
                    };
                    let (chunk, _) = Chunk::take_from(bytes.get(..len).unwrap_or_default());
                    return Ok(Some((chunk, stamps)));
                }
                Err(error) if error.kind() == io::ErrorKind::TimedOut => {
                    if left <= LONGEST_WAIT {
                        return Ok(None);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(self.io_error("read", error)),
            }
        }
    }

    fn send(&mut self, chunk: &Chunk) -> Result<(), LinkError> {
        self.wait_for(SEND_TIMEOUT)?;
        self.port
            .write_all(chunk.as_slice())
            .map_err(|error| self.io_error("write", error))
    }

    fn take_notice(&mut self) -> Option<String> {
        if core::mem::replace(&mut self.told, true) {
            return None;
        }
        self.latency_timer_ms()
            .map(|ms| latency_text(&self.name, ms))
    }
}

fn latency_text(port: &str, ms: u32) -> String {
    format!(
        "{port}: the converter's latency timer is {ms} ms, so samples come in bursts and look late by up to that: install \
         the rules of udev/, which set 1 ms"
    )
}

#[cfg(test)]
mod tests;
