//! A serial device on the device's side of a USB gadget (`/dev/ttyGS0`); the host's side is a `/dev/ttyACM0`.
//!
//! Line rates mean nothing there. The gadget keeps what no host has taken, so that the next program finds old bytes, as behind
//! a real USB device that was left streaming; what does not fit is gone. An unplugged gadget is opened again once it is back.

use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use ft_wire::Chunk;
use rustix::fs::{Mode, OFlags};
use rustix::termios::{self, OptionalActions};

use super::ServeError;

#[derive(Debug)]
pub(super) struct Gadget {
    path: PathBuf,
    terminal: Option<OwnedFd>,
}

impl Gadget {
    pub(super) fn open(path: &Path) -> Result<Self, ServeError> {
        let terminal = open(path).map_err(|source| ServeError::Gadget {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            path: path.to_owned(),
            terminal: Some(terminal),
        })
    }

    fn terminal(&mut self) -> Option<&OwnedFd> {
        if self.terminal.is_none() {
            self.terminal = open(&self.path).ok();
        }
        self.terminal.as_ref()
    }

    pub(super) fn read(&mut self, mut heard: impl FnMut(Chunk)) {
        let mut buffer = [0; Chunk::CAPACITY];
        while let Some(terminal) = self.terminal() {
            match rustix::io::read(terminal, &mut buffer) {
                Ok(count @ 1..) => Chunk::new(&buffer[..count])
                    .into_iter()
                    .for_each(&mut heard),
                Err(rustix::io::Errno::AGAIN) => return,
                // Hung up: the gadget was unplugged.
                _ => {
                    self.terminal = None;
                    return;
                }
            }
        }
    }

    pub(super) fn write(&mut self, bytes: &[u8]) {
        if let Some(terminal) = self.terminal() {
            // Nobody can tell whether a host listens, so bytes that find no room are no loss of anybody's.
            let _ = rustix::io::write(terminal, bytes);
        }
    }
}

fn open(path: &Path) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC | OFlags::NONBLOCK;
    let terminal = rustix::fs::open(path, flags, Mode::empty())?;
    let mut settings = termios::tcgetattr(&terminal)?;
    settings.make_raw();
    termios::tcsetattr(&terminal, OptionalActions::Now, &settings)?;
    Ok(terminal)
}
