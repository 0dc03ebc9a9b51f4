//! The simulated devices in real time: serial devices on pseudo-terminals or USB gadgets, CAN on a `vcan` interface, behind
//! a candleLight adapter on a FunctionFS, or in the process.

mod candlelight;
mod gadget;
mod pty;
mod vcan;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use ft_drivers::{Clock, MonotonicClock};
use ft_wire::{CanFrame, Chunk, HostTime};

use self::candlelight::CandleLight;
use self::gadget::Gadget;
use self::pty::Pty;
use self::vcan::Vcan;
use crate::bus::Port as LinkPort;
use crate::bus::SimCanLink;
use crate::scenario::{Scenario, ScenarioError};
use crate::simulation::slot::SlotKind;
use crate::simulation::{Fitted, KnownSetup, Simulation};
use crate::truth::Truth;

/// How the devices are served.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServeOptions {
    /// An existing CAN interface (`vcan0`) for devices on CAN; without it they are reachable in this process only.
    pub vcan: Option<String>,
    /// The device's side of a USB gadget (`/dev/ttyGS0`) for the serial devices named; the others get pseudo-terminals.
    pub gadgets: BTreeMap<String, PathBuf>,
    /// A mounted FunctionFS for the devices on CAN named: they are behind a candleLight adapter of their own.
    pub candlelights: BTreeMap<String, PathBuf>,
}

/// Where a device can be opened.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Port {
    /// A serial device, to be opened like any other.
    Pty(PathBuf),
    /// The host's side of the USB gadget whose device's side this is.
    Gadget(PathBuf),
    /// The candleLight adapter that the host sees once the gadget of this FunctionFS is bound.
    CandleLight(PathBuf),
    /// A CAN interface.
    SocketCan(String),
    /// [`Server::can_link`].
    InProcess,
}

/// A device and where it can be opened.
#[derive(Clone, Debug, PartialEq)]
pub struct ServedPort {
    /// The device.
    pub fitted: Fitted,
    /// Where.
    pub port: Port,
}

/// What a device is connected to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bus {
    /// A serial line.
    Serial,
    /// CAN.
    Can,
}

impl std::fmt::Display for Bus {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Serial => "a serial line",
            Self::Can => "CAN",
        })
    }
}

/// Why the devices cannot be served.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// The scenario cannot be played.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The system gave no pseudo-terminal.
    #[error("cannot make a pseudo-terminal for {device}: {call} failed")]
    Pty {
        /// The device.
        device: String,
        /// The call that failed.
        call: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// The device's side of a USB gadget cannot be opened.
    #[error(
        "cannot open the gadget's side {path}: load usb_f_acm and make a gadget with an acm function"
    )]
    Gadget {
        /// The terminal.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A candleLight cannot be made of a FunctionFS.
    #[error(
        "cannot make a candleLight of {path}: load usb_f_fs, make a gadget with an ffs function and mount it there, not bound yet"
    )]
    CandleLight {
        /// The mounted FunctionFS.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A USB gadget or candleLight is meant for a device that cannot be behind it.
    #[error("{device} is no device on {bus} of this scenario: there is {there}")]
    Misplaced {
        /// The device.
        device: String,
        /// What it would have to be on.
        bus: Bus,
        /// The devices that are.
        there: String,
    },
    /// The CAN interface cannot be opened.
    #[error(
        "cannot open the CAN interface {interface}: make it with `ip link add dev {interface} type vcan` and set it up"
    )]
    Can {
        /// The interface.
        interface: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system gave no thread.
    #[error("cannot start the thread that serves the devices")]
    Thread(#[source] std::io::Error),
}

#[derive(Debug)]
struct Shared {
    simulation: Mutex<Simulation>,
    stopped: AtomicBool,
}

impl Shared {
    fn simulation(&self) -> MutexGuard<'_, Simulation> {
        self.simulation
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

/// A simulation that runs in real time on a thread of its own until [`Server::stop`] or its end is long past.
#[derive(Debug)]
pub struct Server {
    shared: Arc<Shared>,
    ports: Vec<ServedPort>,
    known: KnownSetup,
    truth: Truth,
    end: HostTime,
    clock: MonotonicClock,
    thread: Option<JoinHandle<()>>,
    dropped: Receiver<u64>,
}

enum Outlet {
    Pty {
        pty: Pty,
        port: Arc<LinkPort<Chunk>>,
    },
    Gadget {
        gadget: Gadget,
        port: Arc<LinkPort<Chunk>>,
    },
    CandleLight {
        adapter: CandleLight,
        port: Arc<LinkPort<CanFrame>>,
    },
    Vcan {
        bus: Vcan,
        port: Arc<LinkPort<CanFrame>>,
    },
}

/// Fails unless all `wanted` are devices on `bus`.
fn is_there<'a>(
    simulation: &Simulation,
    bus: Bus,
    mut wanted: impl Iterator<Item = &'a String>,
) -> Result<(), ServeError> {
    let on_bus = |kind: &SlotKind| matches!(kind, SlotKind::Can(_)) == (bus == Bus::Can);
    let slots = simulation.slots().iter().filter(|slot| on_bus(&slot.kind));
    let there: Vec<_> = slots.map(|slot| slot.fitted.name.as_str()).collect();
    match wanted.find(|device| !there.contains(&device.as_str())) {
        None => Ok(()),
        Some(device) => Err(ServeError::Misplaced {
            device: device.clone(),
            bus,
            there: if there.is_empty() {
                "none".to_owned()
            } else {
                there.join(", ")
            },
        }),
    }
}

impl Server {
    /// Starts playing `scenario` now, on `clock`.
    ///
    /// # Errors
    /// The scenario cannot be played, or the system gives no pseudo-terminal, CAN interface or thread.
    pub fn start(
        scenario: &Scenario,
        seed: u64,
        duration: Option<Duration>,
        clock: MonotonicClock,
        options: ServeOptions,
    ) -> Result<Self, ServeError> {
        let simulation = Simulation::live(scenario, seed, duration, clock)?;
        is_there(&simulation, Bus::Serial, options.gadgets.keys())?;
        is_there(&simulation, Bus::Can, options.candlelights.keys())?;
        let mut ports = Vec::new();
        let mut outlets = Vec::new();
        for slot in simulation.slots() {
            let fitted = slot.fitted.clone();
            let port = match (&slot.kind, &options.vcan) {
                (SlotKind::Serial(wired), _) if options.gadgets.contains_key(&fitted.name) => {
                    let path = &options.gadgets[&fitted.name];
                    outlets.push(Outlet::Gadget {
                        gadget: Gadget::open(path)?,
                        port: wired.port.clone(),
                    });
                    Port::Gadget(path.clone())
                }
                (SlotKind::Serial(wired), _) => {
                    let pty = Pty::open(&fitted)?;
                    let path = pty.path().to_owned();
                    outlets.push(Outlet::Pty {
                        pty,
                        port: wired.port.clone(),
                    });
                    Port::Pty(path)
                }
                (SlotKind::Can(wired), _) if options.candlelights.contains_key(&fitted.name) => {
                    let path = &options.candlelights[&fitted.name];
                    outlets.push(Outlet::CandleLight {
                        adapter: CandleLight::open(path, fitted.bus.bits_per_second(), clock)?,
                        port: wired.port.clone(),
                    });
                    Port::CandleLight(path.clone())
                }
                (SlotKind::Can(wired), Some(interface)) => {
                    outlets.push(Outlet::Vcan {
                        bus: Vcan::open(interface)?,
                        port: wired.port.clone(),
                    });
                    Port::SocketCan(interface.clone())
                }
                (SlotKind::Can(_), None) => Port::InProcess,
            };
            ports.push(ServedPort { fitted, port });
        }
        let (known, truth, end) = (
            simulation.known_setup(),
            simulation.truth(),
            simulation.end(),
        );
        let shared = Arc::new(Shared {
            simulation: Mutex::new(simulation),
            stopped: AtomicBool::new(false),
        });
        let (report, dropped) = mpsc::channel();
        let serving = shared.clone();
        let thread = std::thread::Builder::new()
            .name("sim-hw".to_owned())
            .spawn(move || {
                // Devices do not wait for a busy host; without CAP_SYS_NICE they have to.
                let _ = ft_drivers::priority::prefer_this_thread(
                    ft_drivers::priority::Duty::Acquisition,
                );
                let dropped = serve(&serving, &clock, &mut outlets);
                // The receiver is gone when nobody asks.
                let _ = report.send(dropped);
            })
            .map_err(ServeError::Thread)?;
        Ok(Self {
            shared,
            ports,
            known,
            truth,
            end,
            clock,
            thread: Some(thread),
            dropped,
        })
    }

    /// The devices and where they can be opened.
    #[must_use]
    pub fn ports(&self) -> Vec<ServedPort> {
        self.ports.clone()
    }

    /// What an operator's calibration says.
    #[must_use]
    pub fn known_setup(&self) -> KnownSetup {
        self.known.clone()
    }

    /// The host's end of the CAN bus of device `name`; its `recv` waits. `None` when it is on a CAN interface or no such
    /// device is on CAN.
    #[must_use]
    pub fn can_link(&self, name: &str) -> Option<SimCanLink> {
        let inside = self
            .ports
            .iter()
            .any(|served| served.fitted.name == name && served.port == Port::InProcess);
        inside
            .then(|| self.shared.simulation().can_link(name))
            .flatten()
    }

    /// The operator's marks since the last call, in order.
    pub fn drain_marks(&mut self) -> Vec<(HostTime, String)> {
        self.shared.simulation().drain_marks()
    }

    /// When the recording is over.
    #[must_use]
    pub fn end(&self) -> HostTime {
        self.end
    }

    /// Whether the end has been reached; the devices go on until [`Server::stop`].
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.clock.now() >= self.end
    }

    /// All that is so.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.truth.clone()
    }

    /// Stops playing; every port is gone afterwards. Returns how many bytes and frames no one took in time.
    pub fn stop(mut self) -> u64 {
        self.halt();
        self.dropped.try_recv().unwrap_or(0)
    }

    fn halt(&mut self) {
        self.shared.stopped.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic in the thread has been printed; there is nothing left to stop.
            let _ = thread.join();
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.halt();
    }
}

/// The longest nap between two looks at the ports.
const NAP: Duration = Duration::from_micros(1000);
/// The shortest, so that a burst does not make the thread spin.
const LEAST_NAP: Duration = Duration::from_micros(250);

fn serve(shared: &Shared, clock: &MonotonicClock, outlets: &mut [Outlet]) -> u64 {
    while !shared.stopped.load(Ordering::Relaxed) {
        for outlet in outlets.iter_mut() {
            outlet.take_from_host();
        }
        let now = clock.now();
        shared.simulation().advance_to(now);
        for outlet in outlets.iter_mut() {
            outlet.give_to_host(now);
        }
        let next = outlets
            .iter()
            .filter_map(Outlet::next_to_host)
            .min()
            .unwrap_or(HostTime::FAR_FUTURE);
        clock.wait_until(next.max(now + LEAST_NAP).min(now + NAP));
    }
    for slot in shared.simulation().slots() {
        match &slot.kind {
            SlotKind::Serial(wired) => wired.port.close(),
            SlotKind::Can(wired) => wired.port.close(),
        }
    }
    outlets.iter().map(Outlet::dropped).sum()
}

impl Outlet {
    fn take_from_host(&mut self) {
        match self {
            Self::Pty { pty, port } => pty.read(|chunk| port.send(chunk)),
            Self::Gadget { gadget, port } => gadget.read(|chunk| port.send(chunk)),
            Self::CandleLight { adapter, port } => adapter.read(|frame| port.send(frame)),
            Self::Vcan { bus, port } => bus.read(|frame| port.send(frame)),
        }
    }

    fn give_to_host(&mut self, now: HostTime) {
        match self {
            Self::Pty { pty, port } => {
                while let Some((_, chunk)) = port.take_to_host(now) {
                    pty.write(chunk.as_slice(), port.line_rate());
                }
            }
            Self::Gadget { gadget, port } => {
                while let Some((_, chunk)) = port.take_to_host(now) {
                    gadget.write(chunk.as_slice());
                }
            }
            Self::CandleLight { adapter, port } => {
                while let Some((_, frame)) = port.take_to_host(now) {
                    adapter.write(&frame);
                }
            }
            Self::Vcan { bus, port } => {
                while let Some((_, frame)) = port.take_to_host(now) {
                    bus.write(&frame);
                }
            }
        }
    }

    fn next_to_host(&self) -> Option<HostTime> {
        match self {
            Self::Pty { port, .. } | Self::Gadget { port, .. } => port.next_to_host(),
            Self::CandleLight { port, .. } | Self::Vcan { port, .. } => port.next_to_host(),
        }
    }

    fn dropped(&self) -> u64 {
        match self {
            Self::Pty { pty, .. } => pty.dropped(),
            Self::Gadget { .. } => 0,
            Self::CandleLight { adapter, .. } => adapter.dropped(),
            Self::Vcan { bus, .. } => bus.dropped(),
        }
    }
}
