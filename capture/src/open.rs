//! Opens what the configuration names: a driver, its link, and the thread or the step that turns them.

use std::path::Path;
use std::sync::Arc;
use std::thread::JoinHandle;

use ft_drivers::device::Counted;
use ft_drivers::discover::RememberedPort;
use ft_drivers::hid_axis::HidFrame;
use ft_drivers::link::can_port::CanName;
use ft_drivers::link::hidraw::HidrawLink;
use ft_drivers::link::record::RawFrame;
use ft_drivers::link::serial::SerialLink;
use ft_drivers::options::Startup;
use ft_drivers::pump::{Pump, Turn};
use ft_drivers::reading::{Counts, Reading};
use ft_drivers::{Device as Protocol, Link, LinkError, MonotonicClock, SteppedClock};
use ft_wire::{CanFrame, Chunk, HostTime};

use crate::channel::{Channel, Intake};
use crate::config::Device;
use crate::ledger::StreamCounters;
use crate::queues::Queues;
use crate::session::SessionError;
use crate::session::link_loop::{LinkThread, with_cause};
use crate::settings::{DriverUser, with_driver};
use crate::zenoh_link::{self, ZenohLink};

/// How a device is reached.
#[derive(Debug)]
pub enum Connection {
    /// By the port of the configuration.
    Configured,
    /// By a key on the network.
    Network(zenoh::Session),
    /// By a simulated CAN bus in this process, where the kernel has none.
    #[cfg(feature = "sim")]
    Simulated(ft_sim_hw::SimCanLink),
}

/// A device's thread.
#[derive(Debug)]
pub struct Started {
    /// Runs until it is told to stop.
    pub thread: JoinHandle<()>,
    /// Why the port is not open yet, and what to check; the thread tries on. `None` when it is open.
    pub closed: Option<String>,
}

/// Opens `device` and starts its thread; what is not plugged in yet is opened when it is there.
///
/// # Errors
/// The settings make no sense, or the port will not open ([`LinkError::may_pass`]).
pub fn spawn(
    device: &Device,
    connection: Connection,
    clock: MonotonicClock,
    thread: LinkThread<Queues>,
) -> Result<Started, SessionError> {
    with_driver(
        device,
        Startup::Configure,
        Spawn {
            device,
            connection,
            clock,
            thread,
        },
    )?
}

struct Spawn<'a> {
    device: &'a Device,
    connection: Connection,
    clock: MonotonicClock,
    thread: LinkThread<Queues>,
}

impl Spawn<'_> {
    fn start<D, L>(
        device: &Device,
        thread: LinkThread<Queues>,
        make: impl Fn() -> D + Send + 'static,
        mut open: impl FnMut() -> Result<L, LinkError> + Send + 'static,
    ) -> Result<Started, SessionError>
    where
        D: Protocol<Reading = Reading> + Counted + Send + 'static,
        D::Frame: RawFrame,
        L: Link<Frame = D::Frame> + Send + 'static,
    {
        let mut open = move || Ok(Pump::new(make(), open()?));
        let first: Result<_, LinkError> = open();
        let closed = match &first {
            Err(error) if error.may_pass() => Some(with_cause(error)),
            _ => None,
        };
        let first = match first {
            Err(source) if closed.is_none() => return Err(wont_open(device, source)),
            first => first,
        };
        let thread = std::thread::Builder::new()
            .name(format!("ft-{}", device.name))
            .spawn(move || thread.run(first, open))
            .map_err(SessionError::Thread)?;
        Ok(Started { thread, closed })
    }
}

fn wont_open(device: &Device, source: LinkError) -> SessionError {
    let device = device.name.clone();
    SessionError::Link { device, source }
}

impl DriverUser for Spawn<'_> {
    type Output = Result<Started, SessionError>;

    fn serial<D>(self, make: impl Fn() -> D + Send + 'static, baud_bps: u32) -> Self::Output
    where
        D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static,
    {
        let clock = self.clock;
        if let (Connection::Network(session), Some(key)) = (
            &self.connection,
            self.device.port.strip_prefix(zenoh_link::PREFIX),
        ) {
            let (session, key) = (session.clone(), key.to_owned());
            return Self::start(self.device, self.thread, make, move || {
                ZenohLink::open(&session, &key, clock)
            });
        }
        let mut port = RememberedPort::serial(Path::new(&self.device.port));
        Self::start(self.device, self.thread, make, move || {
            port.open(|path| SerialLink::open(path, baud_bps, clock))
        })
    }

    fn can<D>(
        self,
        make: impl Fn() -> D + Send + 'static,
        ids: Vec<u16>,
        usual_bps: u32,
    ) -> Self::Output
    where
        D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static,
    {
        let (port, clock) = (self.device.port.clone(), self.clock);
        match self.connection {
            Connection::Configured | Connection::Network(_) => {
                let mut bus =
                    CanName::parse(&port).map_err(|error| wont_open(self.device, error))?;
                Self::start(self.device, self.thread, make, move || {
                    bus.open(&ids, usual_bps, clock)
                })
            }
            #[cfg(feature = "sim")]
            Connection::Simulated(link) => {
                let mut link = Some(link);
                Self::start(self.device, self.thread, make, move || {
                    link.take()
                        .ok_or_else(|| LinkError::Gone { port: port.clone() })
                })
            }
        }
    }

    fn hid<D>(self, make: impl Fn() -> D + Send + 'static) -> Self::Output
    where
        D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static,
    {
        let clock = self.clock;
        let mut port = RememberedPort::hid(Path::new(&self.device.port));
        Self::start(self.device, self.thread, make, move || {
            port.open(|path| HidrawLink::open(path, clock))
        })
    }
}

/// A device on a clock that goes in steps.
pub trait SteppedLink {
    /// Turns the pump until nothing more has arrived by `now`.
    ///
    /// # Errors
    /// The link is unusable.
    fn turn_until_idle(&mut self, clock: &SteppedClock, now: HostTime) -> Result<(), SessionError>;
}

struct Stepped<D, L, I> {
    name: String,
    pump: Pump<D, L>,
    channel: Channel<I>,
    counters: Arc<StreamCounters>,
}

impl<D, L, I> SteppedLink for Stepped<D, L, I>
where
    D: Protocol<Reading = Reading> + Counted,
    D::Frame: RawFrame,
    L: Link<Frame = D::Frame>,
    I: Intake,
{
    fn turn_until_idle(&mut self, clock: &SteppedClock, now: HostTime) -> Result<(), SessionError> {
        let lost = |source| SessionError::Link {
            device: self.name.clone(),
            source,
        };
        while self
            .pump
            .turn(clock, now, &mut self.channel)
            .map_err(lost)?
            == Turn::Frame
        {}
        self.counters
            .set_driver_counts(Counts::default(), self.pump.counts());
        Ok(())
    }
}

/// Joins drivers with links that never wait.
#[allow(missing_debug_implementations, reason = "holds closures")]
pub struct StepBuilder<'a, I, S, C, H> {
    /// The device.
    pub device: &'a Device,
    /// Where its readings go.
    pub channel: Channel<I>,
    /// Its account.
    pub counters: Arc<StreamCounters>,
    /// Makes its link, should it be serial.
    pub serial: S,
    /// Makes its link, should it be on CAN.
    pub can: C,
    /// Makes its link, should it be a HID device.
    pub hid: H,
}

impl<I, S, C, H, LS, LC, LH> StepBuilder<'_, I, S, C, H>
where
    I: Intake + 'static,
    S: FnOnce() -> Option<LS>,
    C: FnOnce() -> Option<LC>,
    H: FnOnce() -> Option<LH>,
    LS: Link<Frame = Chunk> + 'static,
    LC: Link<Frame = CanFrame> + 'static,
    LH: Link<Frame = HidFrame> + 'static,
{
    /// The device, ready to be turned.
    ///
    /// # Errors
    /// The settings make no sense, or there is no such link.
    pub fn build(self, startup: Startup) -> Result<Box<dyn SteppedLink>, SessionError> {
        with_driver(self.device, startup, self)?
    }

    fn join<D, L>(
        device: &Device,
        channel: Channel<I>,
        counters: Arc<StreamCounters>,
        driver: D,
        link: Option<L>,
    ) -> Result<Box<dyn SteppedLink>, SessionError>
    where
        D: Protocol<Reading = Reading> + Counted + 'static,
        D::Frame: RawFrame,
        L: Link<Frame = D::Frame> + 'static,
    {
        let link = link.ok_or_else(|| SessionError::NoSuchLink {
            device: device.name.clone(),
        })?;
        Ok(Box::new(Stepped {
            name: device.name.clone(),
            pump: Pump::new(driver, link),
            channel,
            counters,
        }))
    }
}

impl<I, S, C, H, LS, LC, LH> DriverUser for StepBuilder<'_, I, S, C, H>
where
    I: Intake + 'static,
    S: FnOnce() -> Option<LS>,
    C: FnOnce() -> Option<LC>,
    H: FnOnce() -> Option<LH>,
    LS: Link<Frame = Chunk> + 'static,
    LC: Link<Frame = CanFrame> + 'static,
    LH: Link<Frame = HidFrame> + 'static,
{
    type Output = Result<Box<dyn SteppedLink>, SessionError>;

    fn serial<D>(self, make: impl Fn() -> D + Send + 'static, _baud_bps: u32) -> Self::Output
    where
        D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static,
    {
        Self::join(
            self.device,
            self.channel,
            self.counters,
            make(),
            (self.serial)(),
        )
    }

    fn can<D>(
        self,
        make: impl Fn() -> D + Send + 'static,
        _ids: Vec<u16>,
        _usual_bps: u32,
    ) -> Self::Output
    where
        D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static,
    {
        Self::join(
            self.device,
            self.channel,
            self.counters,
            make(),
            (self.can)(),
        )
    }

    fn hid<D>(self, make: impl Fn() -> D + Send + 'static) -> Self::Output
    where
        D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static,
    {
        Self::join(
            self.device,
            self.channel,
            self.counters,
            make(),
            (self.hid)(),
        )
    }
}
