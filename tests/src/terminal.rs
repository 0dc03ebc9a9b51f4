//! The device's end of a pseudo-terminal that can be unplugged: its name is a link that goes with it.

use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use rustix::event::{PollFd, PollFlags, Timespec};
use rustix::fs::{Mode, OFlags};
use rustix::pty::OpenptFlags;
use rustix::termios::{self, OptionalActions};

/// The device's end.
#[derive(Debug)]
pub struct Terminal {
    master: Option<OwnedFd>,
    name: PathBuf,
}

impl Terminal {
    /// A terminal that is known as `name`, plugged in.
    pub fn new(name: &Path) -> io::Result<Self> {
        let mut terminal = Self {
            master: None,
            name: name.to_owned(),
        };
        terminal.plug_in()?;
        Ok(terminal)
    }

    /// Its name leads to a new terminal.
    pub fn plug_in(&mut self) -> io::Result<()> {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = rustix::pty::openpt(flags)?;
        rustix::pty::grantpt(&master)?;
        rustix::pty::unlockpt(&master)?;
        let far_end = rustix::pty::ptsname(&master, Vec::new())?;
        // Opened and closed once: from then on a hang-up says that nobody has it open.
        let slave = rustix::fs::open(
            &*far_end,
            OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        let mut settings = termios::tcgetattr(&slave)?;
        settings.make_raw();
        termios::tcsetattr(&slave, OptionalActions::Now, &settings)?;
        drop(slave);
        let mode = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, mode | OFlags::NONBLOCK)?;
        rustix::fs::symlink(&*far_end, &self.name)?;
        self.master = Some(master);
        Ok(())
    }

    /// Whoever has the far end open sees it gone.
    pub fn unplug(&mut self) {
        let _ = std::fs::remove_file(&self.name);
        self.master = None;
    }

    /// Whether a program has the far end open.
    pub fn is_open(&self) -> bool {
        let Some(master) = &self.master else {
            return false;
        };
        let mut polled = [PollFd::new(master, PollFlags::IN)];
        let at_once = Timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        rustix::event::poll(&mut polled, Some(&at_once)).is_ok()
            && !polled[0].revents().contains(PollFlags::HUP)
    }

    /// What the program sent.
    pub fn read<'a>(&self, buffer: &'a mut [u8]) -> &'a [u8] {
        let count = self
            .master
            .as_ref()
            .and_then(|master| rustix::io::read(master, &mut *buffer).ok());
        &buffer[..count.unwrap_or(0)]
    }

    /// How many of `bytes` there was room for.
    pub fn write(&self, bytes: &[u8]) -> usize {
        self.master
            .as_ref()
            .and_then(|master| rustix::io::write(master, bytes).ok())
            .unwrap_or(0)
    }
}
