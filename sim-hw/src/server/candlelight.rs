//! A CAN device behind a candleLight adapter, played on a FunctionFS: the host sees a USB device of its own.
//!
//! ```text
//! control, vendor to interface 0: 0 host format (0000BEEF) | 1 bit timing (5 words) | 2 mode (mode, flags) |
//!                                 4 limits (10 words) | 5 device (12 bytes) | 6 microseconds (1 word); anything else stalls
//! bulk in:  echo id (all ones: received), CAN id, DLC, channel, flags, 0, 8 bytes, microseconds where the mode asks
//! bulk out: the same without microseconds; the echo id comes back when the frame was acknowledged
//! ```
//!
//! All words are little endian. Where the host set another bit rate than the bus has, what comes are error frames, and the first
//! frame that it sends makes its controller go off the bus.
//!
//! # Source
//! `candle-usb/candleLight_fw: include/gs_usb.h, src/usbd_gs_can.c`; Linux `Documentation/usb/functionfs.rst`,
//! `include/uapi/linux/usb/functionfs.h`.

use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use ft_drivers::{Clock as _, MonotonicClock};
use ft_wire::{CanFrame, HostTime};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::io::{Errno, read, write};

use super::ServeError;

/// The controller's clock, Hz.
const CLOCK_HZ: u32 = 48_000_000;
/// Identifies itself, stamps, listens only.
const FEATURES: u32 = 0x31;
const STAMPS: u32 = 0x10;
/// The adapter's clock, us: it wraps after four seconds, and goes 60 ppm too fast.
const CLOCK_READS: u64 = 0xFFFF_FFFF - 4_000_000;
const CLOCK_RATE: f64 = 1.000_06;
/// Frames that wait for the host at most; candleLight's firmware has about as many.
const ROOM: usize = 64;

const RECEIVED: u32 = 0xFFFF_FFFF;
const LONG_ID: u32 = 0x8000_0000;
const ERROR: u32 = 0x2000_0000;
/// Error classes: a protocol error on the bus; off the bus.
const PROTOCOL: u32 = 0x88;
const BUS_OFF: u32 = 0x40;

/// What the host has set.
#[derive(Debug, Default)]
struct Setting {
    bitrate_bps: u32,
    running: bool,
    stamped: bool,
}

#[derive(Debug)]
struct Shared {
    setting: Mutex<Setting>,
    bus_bps: u32,
    stopped: AtomicBool,
    clock: MonotonicClock,
    began: HostTime,
}

impl Shared {
    fn setting(&self) -> MutexGuard<'_, Setting> {
        self.setting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    fn microseconds(&self) -> u32 {
        let gone = self.clock.now().seconds_since(self.began);
        let ticks = CLOCK_READS + (gone * CLOCK_RATE * 1e6) as u64;
        ticks as u32
    }
}

/// The adapter. Its threads end when it was dropped and the device unplugged; until then they may wait in the kernel.
#[derive(Debug)]
pub(super) struct CandleLight {
    shared: Arc<Shared>,
    to_host: Sender<Vec<u8>>,
    waiting: Arc<AtomicUsize>,
    from_host: Receiver<CanFrame>,
    dropped: u64,
}

impl CandleLight {
    /// Makes the device, on a bus of this bit rate, in the FunctionFS that is mounted at `folder`, ready to be bound to a controller.
    pub(super) fn open(
        folder: &Path,
        bus_bps: u32,
        clock: MonotonicClock,
    ) -> Result<Self, ServeError> {
        let failed = |source| ServeError::CandleLight {
            path: folder.to_owned(),
            source,
        };
        let control = file(&folder.join("ep0")).map_err(failed)?;
        write(&control, &descriptors()).map_err(|errno| failed(errno.into()))?;
        write(&control, &strings()).map_err(|errno| failed(errno.into()))?;
        let [to, from] = ["ep1", "ep2"].map(|name| endpoint(&folder.join(name)).map_err(failed));
        let (to, from) = (to?, from?);
        let shared = Arc::new(Shared {
            setting: Mutex::default(),
            bus_bps,
            stopped: AtomicBool::new(false),
            clock,
            began: clock.now(),
        });
        let waiting = Arc::new(AtomicUsize::new(0));
        let (to_host, outgoing) = mpsc::channel();
        let (incoming, from_host) = mpsc::channel();
        let start = |name: &str, work: Box<dyn FnOnce() + Send>| {
            let thread = thread::Builder::new().name(format!("candle-{name}"));
            thread.spawn(work).map(drop).map_err(ServeError::Thread)
        };
        let answers = shared.clone();
        start("control", Box::new(move || answer(&answers, &control)))?;
        let (giver, left) = (shared.clone(), waiting.clone());
        start("in", Box::new(move || give(&giver, &to, &outgoing, &left)))?;
        let (taker, echo, count) = (shared.clone(), to_host.clone(), waiting.clone());
        start(
            "out",
            Box::new(move || {
                take(&taker, &from, &incoming, |bytes| {
                    count.fetch_add(1, Ordering::Relaxed);
                    let _ = echo.send(bytes);
                });
            }),
        )?;
        Ok(Self {
            shared,
            to_host,
            waiting,
            from_host,
            dropped: 0,
        })
    }

    pub(super) const fn dropped(&self) -> u64 {
        self.dropped
    }

    pub(super) fn read(&self, mut heard: impl FnMut(CanFrame)) {
        while let Ok(frame) = self.from_host.try_recv() {
            heard(frame);
        }
    }

    pub(super) fn write(&mut self, frame: &CanFrame) {
        let setting = self.shared.setting();
        if !setting.running {
            return;
        }
        let id = frame.arbitration_id() | if frame.is_extended() { LONG_ID } else { 0 };
        let bytes = if setting.bitrate_bps == self.shared.bus_bps {
            packed(RECEIVED, id, frame.payload())
        } else {
            packed(RECEIVED, ERROR | PROTOCOL, &[0; 8])
        };
        let bytes = stamped(bytes, &setting, &self.shared);
        drop(setting);
        if self.waiting.load(Ordering::Relaxed) >= ROOM {
            self.dropped += 1;
            return;
        }
        self.waiting.fetch_add(1, Ordering::Relaxed);
        let _ = self.to_host.send(bytes);
    }
}

impl Drop for CandleLight {
    fn drop(&mut self) {
        self.shared.stopped.store(true, Ordering::Relaxed);
    }
}

fn file(path: &PathBuf) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::CLOEXEC;
    Ok(rustix::fs::open(path, flags, Mode::empty())?)
}

/// An endpoint's file: without a host nothing waits there.
fn endpoint(path: &PathBuf) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::CLOEXEC | OFlags::NONBLOCK;
    Ok(rustix::fs::open(path, flags, Mode::empty())?)
}

/// A frame of 20 bytes.
fn packed(echo: u32, id: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(24);
    bytes.extend(echo.to_le_bytes());
    bytes.extend(id.to_le_bytes());
    bytes.extend([payload.len() as u8, 0, 0, 0]);
    bytes.extend(payload);
    bytes.resize(20, 0);
    bytes
}

fn stamped(mut bytes: Vec<u8>, setting: &Setting, shared: &Shared) -> Vec<u8> {
    if setting.stamped {
        bytes.extend(shared.microseconds().to_le_bytes());
    }
    bytes
}

/// Vendor interface with a bulk endpoint each way, at full and at high speed.
fn descriptors() -> Vec<u8> {
    const MAGIC: u32 = 3;
    const FULL_AND_HIGH: u32 = 1 | 2;
    const COUNT: u32 = 3;
    let mut bytes = Vec::new();
    for word in [MAGIC, 20 + 2 * 23, FULL_AND_HIGH, COUNT, COUNT] {
        bytes.extend(word.to_le_bytes());
    }
    for packet in [64_u16, 512] {
        let [low, high] = packet.to_le_bytes();
        bytes.extend([9, 4, 0, 0, 2, 0xFF, 0xFF, 0xFF, 0]);
        bytes.extend([7, 5, 0x81, 2, low, high, 0]);
        bytes.extend([7, 5, 0x02, 2, low, high, 0]);
    }
    bytes
}

/// None.
fn strings() -> [u8; 16] {
    [2, 0, 0, 0, 16, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
}

/// Serves the control endpoint.
fn answer(shared: &Shared, control: &OwnedFd) {
    const DISABLE: u8 = 3;
    const SETUP: u8 = 4;
    let mut events = [0_u8; 12 * 4];
    let look = Timespec {
        tv_sec: 0,
        tv_nsec: 100_000_000,
    };
    while !shared.is_stopped() {
        let mut fds = [PollFd::new(control, PollFlags::IN)];
        if !poll(&mut fds, Some(&look)).is_ok_and(|ready| ready > 0) {
            continue;
        }
        let length = match read(control, &mut events) {
            Ok(length) => length,
            Err(Errno::INTR | Errno::AGAIN | Errno::IDRM) => continue,
            Err(_) => return,
        };
        for event in events[..length].chunks_exact(12) {
            match event[8] {
                DISABLE => *shared.setting() = Setting::default(),
                SETUP => setup(shared, control, event),
                _ => {}
            }
        }
    }
}

fn setup(shared: &Shared, control: &OwnedFd, request: &[u8]) {
    let [kind, number, _, _, _, _, low, high] = request[..8] else {
        return;
    };
    let length = usize::from(u16::from_le_bytes([low, high]));
    if kind & 0x80 != 0 {
        let reply = match number {
            4 => words(&[FEATURES, CLOCK_HZ, 1, 16, 1, 8, 4, 1, 1024, 1]),
            5 => words(&[0, 2, 1]),
            6 => words(&[shared.microseconds()]),
            _ => {
                // The other way round stalls it.
                let _ = read(control, &mut [0; 1]);
                return;
            }
        };
        let _ = write(control, &reply[..length.min(reply.len())]);
        return;
    }
    let mut data = vec![0; length];
    let expected = [(0, 4), (1, 20), (2, 8)];
    if !expected.contains(&(number, length)) {
        let _ = write(control, &[]);
        return;
    }
    if read(control, &mut data).is_err() {
        return;
    }
    let word = |at: usize| u32::from_le_bytes([data[at], data[at + 1], data[at + 2], data[at + 3]]);
    let mut setting = shared.setting();
    match number {
        1 => {
            let quanta = 1 + word(0) + word(4) + word(8);
            setting.bitrate_bps = CLOCK_HZ / quanta.saturating_mul(word(16)).max(1);
        }
        2 => {
            setting.running = word(0) == 1;
            setting.stamped = word(4) & STAMPS != 0;
        }
        _ => {}
    }
}

fn words(words: &[u32]) -> Vec<u8> {
    words.iter().flat_map(|word| word.to_le_bytes()).collect()
}

/// Waits until there is something to be done with an endpoint again.
fn nap(shared: &Shared) {
    shared
        .clock
        .wait_until(shared.clock.now() + Duration::from_millis(5));
}

/// Hands frames to the host.
fn give(shared: &Shared, endpoint: &OwnedFd, outgoing: &Receiver<Vec<u8>>, waiting: &AtomicUsize) {
    while !shared.is_stopped() {
        match outgoing.recv_timeout(Duration::from_millis(100)) {
            Ok(bytes) => {
                waiting.fetch_sub(1, Ordering::Relaxed);
                // Unplugged: it is for nobody.
                let _ = write(endpoint, &bytes);
            }
            Err(mpsc::RecvTimeoutError::Timeout) => {}
            Err(mpsc::RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Takes the host's frames onto the bus, and gives their tags back.
fn take(shared: &Shared, endpoint: &OwnedFd, incoming: &Sender<CanFrame>, echo: impl Fn(Vec<u8>)) {
    let mut bytes = [0; 512];
    while !shared.is_stopped() {
        let Ok(length @ 20..) = read(endpoint, &mut bytes) else {
            nap(shared);
            continue;
        };
        let setting = shared.setting();
        if !setting.running {
            continue;
        }
        if setting.bitrate_bps != shared.bus_bps {
            echo(stamped(
                packed(RECEIVED, ERROR | BUS_OFF, &[0; 8]),
                &setting,
                shared,
            ));
            continue;
        }
        let id = u32::from_le_bytes([bytes[4], bytes[5], bytes[6], bytes[7]]);
        let payload = &bytes[12..12 + usize::from(bytes[8].min(8))];
        let frame = if id & LONG_ID != 0 {
            CanFrame::extended(id & !LONG_ID, payload)
        } else {
            CanFrame::standard(id as u16, payload)
        };
        echo(stamped(bytes[..length.min(20)].to_vec(), &setting, shared));
        drop(setting);
        if let Some(frame) = frame {
            let _ = incoming.send(frame);
        }
    }
}
