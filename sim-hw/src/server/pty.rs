//! A serial device on a pseudo-terminal.
//!
//! Raw, never waiting: a full terminal loses bytes as a UART without flow control does, and they are counted. While no program
//! has it open nothing is written, so that the next one finds no old bytes. A program that sets another speed than the
//! device's hears and is heard as garbage.

use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use ft_wire::Chunk;
use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::fs::{Mode, OFlags};
use rustix::pty::OpenptFlags;
use rustix::termios::{self, OptionalActions, QueueSelector};

use super::ServeError;
use crate::bus::Bus;
use crate::simulation::Fitted;

#[derive(Debug)]
pub(super) struct Pty {
    master: OwnedFd,
    path: PathBuf,
    device_bps: u32,
    opened: bool,
    dropped: u64,
}

impl Pty {
    pub(super) fn open(fitted: &Fitted) -> Result<Self, ServeError> {
        let device_bps = match fitted.bus {
            Bus::Serial { baud_bps } => baud_bps,
            Bus::Can { bitrate_bps } => bitrate_bps,
        };
        let failed = |call| {
            let device = fitted.name.clone();
            move |source: rustix::io::Errno| ServeError::Pty {
                device,
                call,
                source: source.into(),
            }
        };
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = rustix::pty::openpt(flags).map_err(failed("openpt"))?;
        rustix::pty::grantpt(&master).map_err(failed("grantpt"))?;
        rustix::pty::unlockpt(&master).map_err(failed("unlockpt"))?;
        let name = rustix::pty::ptsname(&master, Vec::new()).map_err(failed("ptsname"))?;
        let path = PathBuf::from(name.to_string_lossy().into_owned());
        // Set the far end up once and close it: its settings stay, and from then on a hang-up says that nobody is there.
        let slave = rustix::fs::open(
            &path,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )
        .map_err(failed("open"))?;
        let mut settings = termios::tcgetattr(&slave).map_err(failed("tcgetattr"))?;
        settings.make_raw();
        settings
            .set_speed(device_bps)
            .map_err(failed("set_speed"))?;
        termios::tcsetattr(&slave, OptionalActions::Now, &settings).map_err(failed("tcsetattr"))?;
        let mode = rustix::fs::fcntl_getfl(&master).map_err(failed("fcntl"))?;
        rustix::fs::fcntl_setfl(&master, mode | OFlags::NONBLOCK).map_err(failed("fcntl"))?;
        Ok(Self {
            master,
            path,
            device_bps,
            opened: false,
            dropped: 0,
        })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes that no one took in time while the port was open.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped
    }

    fn is_open(&mut self) -> bool {
        let mut polled = [PollFd::new(&self.master, PollFlags::IN)];
        let asked = rustix::event::poll(
            &mut polled,
            Some(&Timespec {
                tv_sec: 0,
                tv_nsec: 0,
            }),
        );
        let open = asked.is_ok() && !polled[0].revents().contains(PollFlags::HUP);
        if self.opened && !open {
            // What the last program left unread is not for the next one.
            let _ = termios::tcflush(&self.master, QueueSelector::IOFlush);
        }
        self.opened = open;
        open
    }

    fn is_garbled(&self) -> bool {
        termios::tcgetattr(&self.master)
            .is_ok_and(|settings| settings.output_speed() != self.device_bps)
    }

    pub(super) fn read(&mut self, mut heard: impl FnMut(Chunk)) {
        if !self.is_open() {
            return;
        }
        let mut buffer = [0; Chunk::CAPACITY];
        while let Ok(count @ 1..) = rustix::io::read(&self.master, &mut buffer) {
            let bytes = if self.is_garbled() {
                garbled(&buffer[..count])
            } else {
                buffer[..count].to_vec()
            };
            Chunk::new(&bytes).into_iter().for_each(&mut heard);
        }
    }

    /// Writes what a device sends at `device_bps`.
    pub(super) fn write(&mut self, bytes: &[u8], device_bps: u32) {
        self.device_bps = device_bps;
        if !self.opened {
            return;
        }
        let sent = if self.is_garbled() {
            garbled(bytes)
        } else {
            bytes.to_vec()
        };
        let taken = rustix::io::write(&self.master, &sent).unwrap_or(0);
        self.dropped += (sent.len() - taken) as u64;
    }
}

/// What a UART at another rate makes of `bytes`: fewer, and none as it was.
fn garbled(bytes: &[u8]) -> Vec<u8> {
    let kept = bytes
        .iter()
        .enumerate()
        .filter(|(index, _)| index % 3 != 2 || bytes.len() < 3);
    kept.map(|(_, byte)| byte.rotate_left(3) ^ 0x5C).collect()
}
