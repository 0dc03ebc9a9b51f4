//! `cargo run --release -p ft-tests --bin latency-table -- --help`: from the link's last byte to a subscriber in another process, beside a bare Zenoh publisher of the same bytes.
//!
//! ```text
//! a device's thread ─► pty ─► ours: link thread: driver, stamps -> queue -> publisher thread: CDR, kept for recorders -> Zenoh ─┐
//!                  └─► pty ─► bare: a thread that reads the frames and puts as many bytes at once ──────────────────── Zenoh ─┴─► one subscriber
//! ```
//!
//! Both have a session of their own to the same subscriber process, over TCP on this host, with the same settings, and a
//! pseudo-terminal of their own, read with the priority of an acquisition thread. One thread plays the device, in windows of
//! 400 ms that alternate (ours bare bare ours ...), so that what the machine does besides meets both alike. A sample's number is
//! its force, and its age counts from just before its frame is written, so the terminal's way (the kernel hands it to a worker) is
//! in both. A window's p50 and p99 stand for it, the median over the windows for the rate. Default: 40 windows of each at 1, 4 and 8 kHz, about
//! two minutes.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use clap::Parser;
use ft_capture::channel::Channel;
use ft_capture::config::Network;
use ft_capture::ledger::StreamCounters;
use ft_capture::queues::queues;
use ft_capture::session::link_loop::LinkThread;
use ft_capture::session::outlets::Outlets;
use ft_capture::sink::zenoh::ZenohSink;
use ft_capture::{network, rmw};
use ft_drivers::bota_serial::{BotaSerial, Config};
use ft_drivers::link::serial::SerialLink;
use ft_drivers::options::Startup;
use ft_drivers::priority::{Duty, SharedProcessor, prefer_this_thread};
use ft_drivers::pump::Pump;
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{Header, Message, TFMessage, WrenchStamped};
use ft_tests::terminal::Terminal;
use ft_wire::HostTime;
use ft_wire::bota_serial::{FRAME_LEN, HEADER, Sample, Status, encode};
use rustix::fs::{Mode, OFlags};
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

/// The length of a window.
const WINDOW: Duration = Duration::from_millis(400);
/// Where ours and the bare publisher listen.
const ENDPOINTS: [&str; 2] = ["tcp/127.0.0.1:17991", "tcp/127.0.0.1:17992"];
const KEY: &str = "0/ft/wrench/**";
/// How many times bare the p50 and the p99 may be.
const BOUND: f64 = 1.3;
/// A force is this number at most: what a frame's f32 holds exactly.
const NUMBERS: usize = 1 << 24;
/// The device is silent while it plays to the other.
const LONGEST_SILENCE: Duration = Duration::from_secs(60);
/// Ends the bare reader.
const END: f32 = -1.0;

type Failure = Box<dyn std::error::Error>;

/// From the link's last byte to a subscriber in another process, beside a bare Zenoh publisher of the same bytes.
///
/// As it stands, about two minutes.
#[derive(Parser)]
#[command(after_help = "Example:\n  latency-table 16 1000 8000")]
struct Arguments {
    /// Windows of 400 ms, ours and bare each
    #[arg(default_value_t = 40, value_parser = clap::value_parser!(u16).range(1..))]
    windows: u16,
    /// Samples a second
    #[arg(value_name = "RATE_HZ", default_values_t = [1000, 4000, 8000], value_parser = clap::value_parser!(u64).range(100..))]
    rates: Vec<u64>,
    /// Runs as the subscriber
    #[arg(long, hide = true)]
    subscribe: bool,
}

fn main() -> Result<(), Failure> {
    let Arguments {
        windows,
        rates,
        subscribe: subscribes,
    } = Arguments::parse();
    if subscribes {
        return subscribe();
    }
    let windows = usize::from(windows);
    println!(
        "{windows} windows of {} ms each way, {} processors, load {}",
        WINDOW.as_millis(),
        std::thread::available_parallelism()?,
        std::fs::read_to_string("/proc/loadavg")?.trim_end(),
    );
    println!(
        "{:>8} {:>5} {:>9} {:>5} {:>8} {:>8}   {:>10} {:>10}",
        "rate/Hz", "", "sent", "lost", "p50/us", "p99/us", "p50 ratio", "p99 ratio"
    );
    for rate_hz in rates {
        let [ours, bare] = measure(rate_hz, windows)?;
        let ratio = (ours.p50 / bare.p50, ours.p99 / bare.p99);
        for (name, of) in [("bare", &bare), ("ours", &ours)] {
            let said = match name {
                "ours" => format!("{:>10.2} {:>10.2}", ratio.0, ratio.1),
                _ => String::new(),
            };
            println!(
                "{rate_hz:>8} {name:>5} {:>9} {:>5} {:>8.1} {:>8.1}   {said}",
                of.sent, of.lost, of.p50, of.p99
            );
        }
        let holds = ratio.0 <= BOUND && ratio.1 <= BOUND && ours.lost == 0;
        println!(
            "{:>8} {}",
            "",
            if holds { "holds" } else { "DOES NOT HOLD" }
        );
    }
    Ok(())
}

/// ns since the Unix epoch, by the clock that both processes have.
#[allow(clippy::disallowed_methods, reason = "that clock")]
fn now_ns() -> i64 {
    let since = SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

/// What came of one kind at one rate; medians over the windows.
struct Outcome {
    sent: usize,
    lost: usize,
    /// us
    p50: f64,
    /// us
    p99: f64,
}

/// Ours and bare.
fn measure(rate_hz: u64, windows: usize) -> Result<[Outcome; 2], Failure> {
    let clock = MonotonicClock::anchored_now();
    let folder = tempfile::tempdir()?;
    let mut device = Device::new(folder.path(), clock)?;
    let [ours, bare] = &device.ports;
    let (ours, bare) = (Ours::open(ours, clock)?, Bare::open(bare)?);
    device.wait_for_readers()?;
    let mut child = Command::new(std::env::current_exe()?)
        .arg("--subscribe")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut said = BufReader::new(child.stdout.take().ok_or("no output")?).lines();
    said.next().ok_or("the subscriber ended")??;
    // Of no ordinary priority either: what was started before it keeps its own.
    let begins = std::thread::scope(|scope| {
        let playing = scope.spawn(|| {
            let _ = prefer_this_thread(Duty::Acquisition);
            device.alternate(rate_hz, windows)
        });
        playing.join().map_err(|_| "the device's thread panicked")
    })??;
    clock.wait_until(clock.now() + Duration::from_millis(300));
    child.stdin.take().ok_or("no input")?.write_all(b"end\n")?;
    let mut ages: [BTreeMap<usize, f64>; 2] = Default::default();
    for line in said {
        let line = line?;
        let mut fields = line.split(' ');
        let mut field = || fields.next().ok_or("a short line");
        let (kind, number): (usize, usize) = (field()?.parse()?, field()?.parse()?);
        let sent = device.sent[kind].get(number).ok_or("never sent")?;
        ages[kind].insert(number, (field()?.parse::<i64>()? - sent) as f64 * 1e-3);
    }
    child.wait()?;
    ours.close()?;
    while device.write(1, END).is_none() && !bare.thread.is_finished() {
        clock.wait_until(clock.now() + Duration::from_millis(1));
    }
    bare.close()?;
    let outcome = |kind: usize| outcome(&begins[kind], device.sent[kind].len(), &ages[kind]);
    Ok([outcome(0), outcome(1)])
}

fn outcome(begins: &[usize], next: usize, ages: &BTreeMap<usize, f64>) -> Outcome {
    let first = begins.get(1).copied().unwrap_or(next);
    let ends = begins.iter().skip(2).chain([&next]);
    let (mut p50, mut p99) = (Vec::new(), Vec::new());
    for (begin, end) in begins.iter().skip(1).zip(ends) {
        let mut of_window: Vec<f64> = ages.range(begin..end).map(|(_, age)| *age).collect();
        p50.push(quantile(&mut of_window, 0.5));
        p99.push(quantile(&mut of_window, 0.99));
    }
    let sent = next - first;
    Outcome {
        sent,
        lost: sent - ages.range(first..next).count(),
        p50: quantile(&mut p50, 0.5),
        p99: quantile(&mut p99, 0.5),
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a place in the list"
)]
fn quantile(values: &mut [f64], of: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (values.len().saturating_sub(1)) as f64 * of;
    values
        .get(place.round() as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

/// A Bota sensor before both ways.
struct Device {
    ports: [PathBuf; 2],
    terminals: [Terminal; 2],
    clock: MonotonicClock,
    /// When each frame was about to be written, by its number, as [`now_ns`].
    sent: [Vec<i64>; 2],
    /// The sensor's time of the last frame, us.
    stamp_us: i64,
}

impl Device {
    fn new(folder: &std::path::Path, clock: MonotonicClock) -> Result<Self, Failure> {
        let ports = ["ours", "bare"].map(|name| folder.join(name));
        let [ours, bare] = &ports;
        let terminals = [Terminal::new(ours)?, Terminal::new(bare)?];
        Ok(Self {
            ports,
            terminals,
            clock,
            sent: Default::default(),
            stamp_us: 0,
        })
    }

    /// Plays to one, then to the other; the numbers of the first frame of each window. The first window of each is not measured:
    /// everything is warm after it.
    fn alternate(&mut self, rate_hz: u64, windows: usize) -> Result<[Vec<usize>; 2], &'static str> {
        let mut begins: [Vec<usize>; 2] = Default::default();
        let count = rate_hz * u64::try_from(WINDOW.as_millis()).unwrap_or(0) / 1000;
        for window in 0..=2 * windows + 1 {
            let kind = usize::from(matches!(window % 4, 1 | 2));
            begins[kind].push(self.sent[kind].len());
            let begin = self.clock.now();
            for index in 0..count {
                self.clock
                    .wait_until(begin + Duration::from_nanos(index * 1_000_000_000 / rate_hz));
                self.send(kind)?;
            }
            // What is under way arrives.
            self.clock
                .wait_until(self.clock.now() + Duration::from_millis(20));
        }
        Ok(begins)
    }

    /// The next frame.
    fn send(&mut self, kind: usize) -> Result<(), &'static str> {
        let number = self.sent[kind].len();
        if number >= NUMBERS {
            return Err("too many frames: take fewer windows");
        }
        let at = self.write(kind, number as f32);
        self.sent[kind].push(at.ok_or("a port is full: its reader stands still")?);
        Ok(())
    }

    /// A frame with that force; the time before. Nothing where the port has no room for it.
    fn write(&mut self, kind: usize, force: f32) -> Option<i64> {
        let frame = encode(&Sample {
            status: Status(0),
            force: [force, 2.0, 3.0],
            torque: [0.1, 0.2, 0.3],
            timestamp_us: self.next_stamp_us(),
            temperature_celsius: 25.0,
        });
        let at = now_ns();
        (self.terminals[kind].write(&frame) == FRAME_LEN).then_some(at)
    }

    /// The sensor's own time of a frame. No two have the same: of what catches up two may come within a microsecond, and a driver takes the second
    /// for the first, sent twice.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the sensor's clock wraps"
    )]
    fn next_stamp_us(&mut self) -> u32 {
        self.stamp_us = (now_ns() / 1000).max(self.stamp_us + 1);
        self.stamp_us as u32
    }

    /// Waits until both ports are read.
    fn wait_for_readers(&self) -> Result<(), &'static str> {
        let most = self.clock.now() + Duration::from_secs(5);
        while !self.terminals.iter().all(Terminal::is_open) {
            if self.clock.now() > most {
                return Err("a port was not opened");
            }
            self.clock
                .wait_until(self.clock.now() + Duration::from_millis(10));
        }
        Ok(())
    }
}

/// The service's own parts, from the port to the network.
struct Ours {
    session: zenoh::Session,
    link: JoinHandle<()>,
    publisher: JoinHandle<(u64, Outlets)>,
    stop: Arc<AtomicBool>,
}

fn listening(endpoint: &str) -> Network {
    Network {
        listen: vec![endpoint.to_owned()],
        ..Network::default()
    }
}

impl Ours {
    fn open(port: &std::path::Path, clock: MonotonicClock) -> Result<Self, Failure> {
        let settings = listening(ENDPOINTS[0]);
        let session = network::open(&settings)?.session;
        let sink =
            ZenohSink::declare(&session, "latency", &settings, &TFMessage::default(), clock)?;
        let (to, ends) = queues(true);
        let items = ends.publisher.ok_or("no queue")?;
        let outlets = Outlets::new(Some(sink), None);
        let processor = SharedProcessor::default();
        let shared = processor.clone();
        let publisher =
            std::thread::spawn(move || outlets.publish_until_closed(&items, clock, &shared));
        let port = port.to_owned();
        let open = move || {
            let config = Config {
                startup: Startup::Listen,
                ack_timeout: LONGEST_SILENCE,
                silence_timeout: LONGEST_SILENCE,
                ..Config::default()
            };
            let link = SerialLink::open(&port, config.baud.bps(), clock)?;
            Ok(Pump::new(BotaSerial::new(config), link))
        };
        let counters = Arc::new(StreamCounters::default());
        let stop = Arc::<AtomicBool>::default();
        let thread = LinkThread {
            clock,
            channel: Channel::new(0, to, Arc::clone(&counters), Duration::ZERO),
            counters,
            stop: Arc::clone(&stop),
            processor: Some(processor),
        };
        let link = std::thread::spawn(move || thread.run(open(), open));
        Ok(Self {
            session,
            link,
            publisher,
            stop,
        })
    }

    fn close(self) -> Result<(), Failure> {
        self.stop.store(true, Ordering::Relaxed);
        self.link.join().map_err(|_| "the link thread panicked")?;
        let (refused, outlets) = self
            .publisher
            .join()
            .map_err(|_| "the publisher panicked")?;
        drop(outlets);
        self.session
            .close()
            .wait()
            .map_err(|error| error.to_string())?;
        match refused {
            0 => Ok(()),
            refused => Err(format!("{refused} messages were refused").into()),
        }
    }
}

/// A thread that knows nothing but where a frame ends and where in a message its force is.
struct Bare {
    session: zenoh::Session,
    thread: JoinHandle<Result<(), String>>,
}

impl Bare {
    fn open(port: &std::path::Path) -> Result<Self, Failure> {
        let session = network::open(&listening(ENDPOINTS[1]))?.session;
        let key = rmw::Topic::new(
            "/ft/wrench",
            WrenchStamped::TYPE_NAME,
            WrenchStamped::TYPE_HASH,
            rmw::Profile::Jazzy,
        )
        .key_expr(0);
        let publisher = session
            .declare_publisher(key)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(|error| error.to_string())?;
        // Not to be taken for this program's own terminal.
        let flags = OFlags::RDONLY | OFlags::NOCTTY | OFlags::CLOEXEC;
        let port = File::from(rustix::fs::open(port, flags, Mode::empty())?);
        let thread = std::thread::spawn(move || read(port, &publisher));
        Ok(Self { session, thread })
    }

    fn close(self) -> Result<(), Failure> {
        self.thread
            .join()
            .map_err(|_| "the bare reader panicked")??;
        Ok(self
            .session
            .close()
            .wait()
            .map_err(|error| error.to_string())?)
    }
}

/// Puts a message for each frame until one has the force [`END`].
fn read(mut port: File, publisher: &Publisher<'_>) -> Result<(), String> {
    let _ = prefer_this_thread(Duty::Acquisition);
    let mut payload = Vec::new();
    WrenchStamped {
        header: Header::new(HostTime::EPOCH, "ft_sensor"),
        ..WrenchStamped::default()
    }
    .encode(&mut payload);
    // The wrench is what a message ends with.
    let at = payload.len() - 6 * size_of::<f64>();
    let (mut buffer, mut filled) = ([0; 4096], 0);
    let mut number = 0;
    loop {
        filled += port
            .read(&mut buffer[filled..])
            .map_err(|error| error.to_string())?;
        let frames = buffer[..filled].chunks_exact(FRAME_LEN);
        let rest = frames.remainder().len();
        for frame in frames {
            let force = f32::from_le_bytes([frame[3], frame[4], frame[5], frame[6]]);
            if frame[0] != HEADER || force == END {
                return if force == END {
                    Ok(())
                } else {
                    Err("no frame".to_owned())
                };
            }
            payload[at..at + 8].copy_from_slice(&f64::from(force).to_le_bytes());
            number += 1;
            publisher
                .put(payload.as_slice())
                .attachment(rmw::attachment(number, 0, [7; 16]).as_slice())
                .wait()
                .map_err(|error| error.to_string())?;
        }
        buffer.copy_within(filled - rest..filled, 0);
        filled = rest;
    }
}

/// The other process: a line `KIND NUMBER RECEIVED_NS` for each message, after the end of its input.
fn subscribe() -> Result<(), Failure> {
    let clock = MonotonicClock::anchored_now();
    let (sender, received) = crossbeam_channel::bounded(1 << 22);
    let mut open = Vec::new();
    for (kind, endpoint) in ENDPOINTS.into_iter().enumerate() {
        let session = network::connect(&[endpoint.to_owned()], None)?;
        let sender = sender.clone();
        let subscriber = session
            .declare_subscriber(KEY)
            .callback(move |sample| {
                let now = now_ns();
                if let Ok(message) = WrenchStamped::decode(&sample.payload().to_bytes()) {
                    let _ = sender.try_send((kind, message.wrench.force.x, now));
                }
            })
            .wait()
            .map_err(|error| error.to_string())?;
        open.push((session, subscriber));
    }
    // The publishers hear of the subscriptions meanwhile.
    clock.wait_until(clock.now() + Duration::from_millis(700));
    println!("ready");
    std::io::stdin().read_line(&mut String::new())?;
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    for (kind, number, at) in received.try_iter() {
        writeln!(out, "{kind} {number} {at}")?;
    }
    out.flush()?;
    Ok(())
}
