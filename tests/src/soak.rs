//! Devices on pseudo-terminals for a long time, with faults, before the service's own drivers and link threads: what was sent is
//! held against what the ledger says.
//!
//! ```text
//! player (one thread per device) ─ pty ─ SerialLink, driver, LinkThread ─ queue ─ checker
//!   writes each frame's fate into the account ────────────────────────────────────► holds every sample against it
//! ```
//!
//! Every frame carries its own number in its values, so that the checker knows for each one what became of it: delivered,
//! spoiled or lost on the way, or sent while the driver was not streaming (around an unplugging or a silence).

mod account;
mod player;
mod process;

use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use ft_capture::channel::Channel;
use ft_capture::config::{Config, ConfigError, Device};
use ft_capture::item::Body;
use ft_capture::ledger::{StreamCounters, StreamLedger};
use ft_capture::open::{self, Connection};
use ft_capture::queues::{QueueEnds, queues};
use ft_capture::session::SessionError;
use ft_capture::session::link_loop::LinkThread;
use ft_drivers::priority::{Duty, prefer_this_thread};
use ft_drivers::{Clock as _, MonotonicClock};
use ft_wire::HostTime;

pub use account::Tally;
pub use player::{Kind, Played};
use player::{Orders, Player};

/// No device may be without a sample for longer: an unplugging, the longest back-off and a set-up take less.
const LONGEST_SILENCE: Duration = Duration::from_secs(12);
/// The last stretch is without an unplugging or a silence, so that every device streams at the end.
const CALM_END: Duration = Duration::from_secs(6);
/// From the last byte of a player to the stop of the link threads.
const RUN_OFF: Duration = Duration::from_millis(300);
/// Share of a core that a link thread may take for each 1000 samples per second.
const MOST_CPU: f64 = 0.05;
/// A thread that does not end within this is stuck.
const LONGEST_END: Duration = Duration::from_secs(5);

/// What is run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The devices and how many samples each sends per second.
    pub devices: Vec<(Kind, f64)>,
    /// How long.
    pub length: Duration,
    /// Whether frames are spoiled and devices unplugged.
    pub faults: bool,
    /// Seed of the faults.
    pub seed: u64,
}

impl Plan {
    /// Bota at 800 Hz, Robotous at 1 kHz, an encoder at 100 Hz and a tracker at 1 kHz, all `speed` times as fast, with faults.
    #[must_use]
    pub fn gripper(length: Duration, speed: f64, seed: u64) -> Self {
        let devices = [
            (Kind::Bota, 800.0),
            (Kind::Robotous, 1000.0),
            (Kind::Encoder, 100.0),
            (Kind::Pose, 1000.0),
        ];
        Self {
            devices: devices
                .map(|(kind, rate_hz)| (kind, speed * rate_hz))
                .to_vec(),
            length,
            faults: true,
            seed,
        }
    }

    /// Eight force-torque sensors at 1 kHz, nothing spoiled.
    #[must_use]
    pub fn eight(length: Duration) -> Self {
        Self {
            devices: [(Kind::Bota, 1000.0), (Kind::Robotous, 1000.0)].repeat(4),
            length,
            faults: false,
            seed: 0,
        }
    }
}

/// What came of one device.
#[derive(Clone, Debug)]
pub struct Stream {
    /// What it is.
    pub kind: Kind,
    /// Its name in the configuration.
    pub name: String,
    /// Samples per second that it sends.
    pub rate_hz: f64,
    /// What its player did.
    pub played: Played,
    /// What became of its frames.
    pub tally: Tally,
    /// What the service counted.
    pub ledger: StreamLedger,
    /// Share of one core that its link thread took; `None` when there was no such thread to be asked.
    pub cpu: Option<f64>,
}

/// What came of a run.
#[derive(Clone, Debug)]
pub struct Report {
    /// Each device.
    pub streams: Vec<Stream>,
    /// Resident memory of the process after the first fifth of the run, and the most from there on, kB.
    pub memory_kb: (u64, u64),
    /// Link threads that did not end when they were told to, and devices that were silent for too long.
    pub stuck: Vec<String>,
    /// Whether there were faults; without, every frame must be delivered.
    pub faulty: bool,
}

/// Why a run could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SoakError {
    /// The system refused a file or a terminal.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The devices' configuration was refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A device could not be opened.
    #[error(transparent)]
    Session(#[from] SessionError),
}

/// The number comes first: the kernel keeps 15 bytes of a thread's name.
fn name(index: usize, kind: Kind) -> String {
    format!("{index}_{}", kind.name())
}

struct Running {
    name: String,
    kind: Kind,
    rate_hz: f64,
    player: JoinHandle<Played>,
    link: JoinHandle<()>,
    counters: Arc<StreamCounters>,
}

/// Runs `plan`.
///
/// # Errors
/// The system refuses a terminal or a thread.
pub fn run(plan: &Plan) -> Result<Report, SoakError> {
    let folder = tempfile::tempdir()?;
    let clock = MonotonicClock::anchored_now();
    let (queues, ends) = queues(false);
    queues.set_recording(true);
    let stop = Arc::new(AtomicBool::new(false));
    let orders = Orders::new(clock.now() + plan.length, CALM_END);
    let mut running = Vec::new();
    let mut accounts = Vec::new();
    for (index, (kind, rate_hz)) in plan.devices.iter().enumerate() {
        let name = name(index, *kind);
        let port = folder.path().join(&name);
        let seed = plan.seed.wrapping_mul(1000).wrapping_add(index as u64);
        let player = Player::new(*kind, *rate_hz, plan.faults.then_some(seed), &port, clock)?;
        accounts.push(account::Checker::new(*kind, player.account()));
        let player = player.start(orders.clone())?;
        let counters = Arc::new(StreamCounters::default());
        let thread = LinkThread {
            processor: None,
            clock,
            channel: Channel::new(index, queues.clone(), Arc::clone(&counters), Duration::ZERO),
            counters: Arc::clone(&counters),
            stop: Arc::clone(&stop),
        };
        let device = device(*kind, &name, &port)?;
        let link = open::spawn(&device, Connection::Configured, clock, thread)?.thread;
        running.push(Running {
            name,
            kind: *kind,
            rate_hz: *rate_hz,
            player,
            link,
            counters,
        });
    }
    let mut watch = Watch::new(clock, plan, running.len());
    while clock.now() < orders.end {
        watch.take(&ends, &mut accounts);
        watch.look();
    }
    finish(running, accounts, watch, &ends, &orders, &stop)
}

fn finish(
    running: Vec<Running>,
    mut accounts: Vec<account::Checker>,
    mut watch: Watch,
    ends: &QueueEnds,
    orders: &Orders,
    stop: &AtomicBool,
) -> Result<Report, SoakError> {
    let clock = watch.clock;
    // The players hold their ends of the terminals until the link threads are gone.
    watch.take_until(clock.now() + RUN_OFF, ends, &mut accounts);
    let seconds = clock.now().seconds_since(watch.begun);
    let cpu: Vec<_> = running
        .iter()
        .map(|one| process::thread_cpu_s(&format!("ft-{}", one.name)).map(|took| took / seconds))
        .collect();
    stop.store(true, Ordering::Relaxed);
    let limit = clock.now() + LONGEST_END;
    let mut streams = Vec::new();
    for (one, cpu) in running.into_iter().zip(cpu) {
        while !one.link.is_finished() && clock.now() < limit {
            watch.take(ends, &mut accounts);
        }
        if !one.link.is_finished() || one.link.join().is_err() {
            watch.stuck.push(format!("{}: its link thread", one.name));
        }
        let device = (one.kind, one.name, one.rate_hz);
        streams.push((device, one.player, one.counters, cpu));
    }
    watch.take_until(clock.now() + RUN_OFF, ends, &mut accounts);
    orders.let_go();
    let streams = streams
        .into_iter()
        .zip(accounts)
        .map(|((device, player, counters, cpu), account)| {
            let played = player.join().unwrap_or_default();
            let (kind, name, rate_hz) = device;
            Stream {
                kind,
                name,
                rate_hz,
                played,
                tally: account.close(),
                ledger: counters.snapshot(),
                cpu,
            }
        })
        .collect();
    Ok(Report {
        streams,
        memory_kb: (watch.memory_before, watch.memory_most),
        stuck: watch.stuck,
        faulty: watch.faulty,
    })
}

/// The configuration's device, as the service would have read it.
fn device(kind: Kind, name: &str, port: &Path) -> Result<Device, ConfigError> {
    let text = format!(
        "[[device]]\nname = {name:?}\ndriver = {:?}\nport = {port:?}\n[device.settings]\n{}",
        kind.name(),
        kind.settings()
    );
    let config = Config::from_toml(&text, &PathBuf::from("soak.toml"))?;
    // `from_toml` refuses a configuration without a device.
    config.devices.into_iter().next().ok_or(ConfigError::Value {
        path: port.to_owned(),
        what: "no device".to_owned(),
    })
}

/// Takes what the link threads deliver, and looks at the process once a second.
struct Watch {
    clock: MonotonicClock,
    begun: HostTime,
    settled: HostTime,
    next_look: HostTime,
    last_sample: Vec<HostTime>,
    memory_before: u64,
    memory_most: u64,
    stuck: Vec<String>,
    names: Vec<String>,
    faulty: bool,
}

impl Watch {
    fn new(clock: MonotonicClock, plan: &Plan, devices: usize) -> Self {
        // The checker must not be behind by more than the queue holds, about a second.
        let _ = prefer_this_thread(Duty::Acquisition);
        let begun = clock.now();
        let named = plan.devices.iter().enumerate();
        Self {
            clock,
            begun,
            settled: begun + plan.length / 5,
            next_look: begun,
            last_sample: vec![begun; devices],
            memory_before: 0,
            memory_most: 0,
            stuck: Vec::new(),
            names: named.map(|(index, (kind, _))| name(index, *kind)).collect(),
            faulty: plan.faults,
        }
    }

    /// Takes what there is, for at most a tenth of a second.
    fn take(&mut self, ends: &QueueEnds, accounts: &mut [account::Checker]) {
        let until = self.clock.now() + Duration::from_millis(100);
        while ends.health.try_recv().is_ok() {}
        while self.clock.now() < until {
            let Ok(item) = ends.writer.recv_timeout(Duration::from_millis(20)) else {
                continue;
            };
            let Some(index) = item.device else { continue };
            if !matches!(item.body, Body::Raw(_))
                && let (Some(account), Some(last)) =
                    (accounts.get_mut(index), self.last_sample.get_mut(index))
            {
                account.sample(&item.body);
                *last = item.arrival;
            }
        }
    }

    fn take_until(&mut self, until: HostTime, ends: &QueueEnds, accounts: &mut [account::Checker]) {
        while self.clock.now() < until {
            self.take(ends, accounts);
        }
    }

    fn look(&mut self) {
        let now = self.clock.now();
        if now < self.next_look {
            return;
        }
        self.next_look = now + Duration::from_secs(1);
        let memory = process::resident_kb();
        if now < self.settled {
            self.memory_before = memory;
        }
        self.memory_most = memory.max(self.memory_most);
        for (last, name) in self.last_sample.iter_mut().zip(&self.names) {
            if now.saturating_since(*last) > LONGEST_SILENCE {
                self.stuck
                    .push(format!("{name}: no sample for {LONGEST_SILENCE:?}"));
                *last = now;
            }
        }
    }
}

impl Report {
    /// What does not hold; empty when memory is flat, nothing is stuck, and every frame is accounted for.
    #[must_use]
    pub fn faults(&self) -> Vec<String> {
        let mut faults = self.stuck.clone();
        let (before, most) = self.memory_kb;
        // A page more for a thread's stack now and then is no leak.
        if most > before + 512 {
            faults.push(format!("memory grew from {before} to {most} kB"));
        }
        for stream in &self.streams {
            faults.extend(stream.faults());
            let most = MOST_CPU * (stream.rate_hz / 1000.0).max(1.0);
            let name = &stream.name;
            match stream.cpu {
                Some(took) if took <= most => {}
                Some(took) => faults.push(format!(
                    "{name}: its thread took {took:.3} of a core, more than {most}"
                )),
                None => faults.push(format!("{name}: what its thread took is not known")),
            }
        }
        let mut streams = self.streams.iter();
        if !self.faulty && streams.any(|stream| stream.tally.delivered != stream.played.sent) {
            faults.push("a sample was not delivered though there were no faults".to_owned());
        }
        faults
    }
}

impl Stream {
    fn faults(&self) -> Vec<String> {
        let Self {
            tally,
            ledger,
            played,
            ..
        } = self;
        let gaps = if self.kind.has_clock() {
            tally.spoiled + tally.lost
        } else {
            0
        };
        let explained =
            tally.delivered + tally.spoiled + tally.lost + tally.interrupted + tally.missing;
        [
            ("whole frames are missing", tally.missing, 0),
            ("samples were never sent so", tally.wrong, 0),
            ("sent and what became of it", played.sent, explained),
            (
                "received and what was delivered",
                ledger.received,
                tally.delivered,
            ),
            ("gaps and what was spoiled or lost", ledger.gaps, gaps),
            (
                "refused and what was spoiled or noise",
                ledger.refused,
                tally.spoiled + tally.noise,
            ),
            (
                "duplicated and what was sent twice",
                ledger.duplicated,
                tally.twice,
            ),
            (
                "interruptions and what was unplugged or silent",
                ledger.interruptions,
                played.unplugged + played.silences,
            ),
            ("dropped before the recording", ledger.drops, 0),
            (
                "faults that no check sum can see, beyond chance",
                played.unseen.saturating_sub(2 + tally.spoiled / 10_000),
                0,
            ),
        ]
        .into_iter()
        .filter(|(_, got, wanted)| got != wanted)
        .map(|(what, got, wanted)| {
            let wrong = tally.wrong_sample.as_deref().unwrap_or_default();
            format!("{}: {what}: {got}, not {wanted} {wrong}", self.name)
        })
        .collect()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:>16} {:>9} {:>9} {:>8} {:>7} {:>7} {:>7} {:>9} {:>8} {:>11} {:>6}",
            "device",
            "sent",
            "delivered",
            "spoiled",
            "lost",
            "noise",
            "twice",
            "unplugged",
            "silences",
            "interrupted",
            "CPU %"
        )?;
        for stream in &self.streams {
            let (played, tally) = (&stream.played, &stream.tally);
            writeln!(
                f,
                "{:>16} {:>9} {:>9} {:>8} {:>7} {:>7} {:>7} {:>9} {:>8} {:>11} {:>6.1}",
                stream.name,
                played.sent,
                tally.delivered,
                tally.spoiled,
                tally.lost,
                tally.noise,
                tally.twice,
                played.unplugged,
                played.silences,
                tally.interrupted,
                100.0 * stream.cpu.unwrap_or(f64::NAN)
            )?;
        }
        let unseen: u64 = self.streams.iter().map(|stream| stream.played.unseen).sum();
        let (before, most) = self.memory_kb;
        write!(
            f,
            "memory {before} -> {most} kB; {unseen} faults were left out that a check sum cannot see"
        )
    }
}
