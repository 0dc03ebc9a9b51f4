//! `cargo run -p ft-tests --bin latency-table -- [WINDOWS] [RATE_HZ]...`: from the link's last byte to a subscriber in another
//! process, beside bare Zenoh publishers of the same bytes.
//!
//! ```text
//! ours   link thread: reading, stamps -> queue -> publisher thread: CDR, kept for recorders -> Zenoh ─┐
//! bare   the same thread puts the same bytes at once ─────────── Zenoh with the settings of its makers ─┼─► one subscriber process
//! tuned  the same, with our settings of Zenoh (no waiting for more to share a batch) ────────── Zenoh ─┘
//! ```
//!
//! Each has a session of its own to the same subscriber process, over TCP on this host; all are fed by one thread with the priority
//! of an acquisition thread, in windows of 400 ms that alternate (ours bare tuned tuned bare ours ...), so that what the machine
//! does besides meets all alike. A window's p50 and p99 stand for it, the median over the windows for the rate. Default: 40 windows
//! of each at 1, 4 and 8 kHz, about three minutes.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use ft_capture::channel::Channel;
use ft_capture::config::Network;
use ft_capture::ledger::StreamCounters;
use ft_capture::queues::{Queues, queues};
use ft_capture::session::outlets::Outlets;
use ft_capture::sink::zenoh::ZenohSink;
use ft_capture::{network, rmw};
use ft_drivers::priority::{Duty, prefer_this_thread};
use ft_drivers::pump::Outlet;
use ft_drivers::reading::{Quality, Reading, SampleInstant, WrenchReading};
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{Header, Message, TFMessage, WrenchStamped};
use ft_wire::frames::Wrench;
use ft_wire::{Chunk, HostTime};
use zenoh::Wait;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

/// The length of a window.
const WINDOW: Duration = Duration::from_millis(400);
/// Where each listens.
const ENDPOINTS: [&str; KINDS] = [
    "tcp/127.0.0.1:17991",
    "tcp/127.0.0.1:17992",
    "tcp/127.0.0.1:17993",
];
const KINDS: usize = 3;
const NAMES: [&str; KINDS] = ["ours", "bare", "tuned"];
/// Which is fed in a window.
const TURNS: [usize; 2 * KINDS] = [0, 1, 2, 2, 1, 0];
const KEY: &str = "0/ft/wrench/**";
/// How many times bare the p50 and the p99 may be.
const BOUND: f64 = 1.3;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments
        .first()
        .is_some_and(|first| first == "--subscribe")
    {
        return subscribe();
    }
    let windows: usize = arguments.first().map_or(Ok(40), |text| text.parse())?;
    let mut rates = arguments
        .iter()
        .skip(1)
        .map(|text| text.parse())
        .collect::<Result<Vec<u64>, _>>()?;
    if rates.is_empty() {
        rates = vec![1000, 4000, 8000];
    }
    println!(
        "{windows} windows of {} ms each way, {} processors, load {}",
        WINDOW.as_millis(),
        std::thread::available_parallelism()?,
        std::fs::read_to_string("/proc/loadavg")?.trim_end(),
    );
    println!(
        "{:>8} {:>5} {:>9} {:>5} {:>8} {:>8}   {:>10} {:>10}",
        "rate/Hz", "", "sent", "lost", "p50/us", "p99/us", "ours/it p50", "p99"
    );
    for rate_hz in rates {
        let outcomes = measure(rate_hz, windows)?;
        let [ours, bare, _] = &outcomes;
        let ratios = |to: &Outcome| [ours.p50 / to.p50, ours.p99 / to.p99];
        for (name, of) in NAMES.iter().zip(&outcomes) {
            let [p50, p99] = ratios(of);
            println!(
                "{rate_hz:>8} {name:>5} {:>9} {:>5} {:>8.1} {:>8.1}   {p50:>10.2} {p99:>10.2}",
                of.sent, of.lost, of.p50, of.p99
            );
        }
        let holds = ratios(bare).iter().all(|ratio| *ratio <= BOUND) && ours.lost == 0;
        println!(
            "{:>8} {}",
            "",
            if holds { "holds" } else { "DOES NOT HOLD" }
        );
    }
    Ok(())
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

/// Of each kind.
fn measure(rate_hz: u64, windows: usize) -> Result<[Outcome; KINDS], Failure> {
    let clock = MonotonicClock::anchored_now();
    let mut feeds = Feeds::open(clock)?;
    let mut child = Command::new(std::env::current_exe()?)
        .arg("--subscribe")
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()?;
    let mut said = BufReader::new(child.stdout.take().ok_or("no output")?).lines();
    said.next().ok_or("the subscriber ended")??;
    // As an acquisition thread: what was started before it keeps its own priority.
    let begins = std::thread::scope(|scope| {
        let feeding = scope.spawn(|| {
            let _ = prefer_this_thread(Duty::Acquisition);
            feeds.alternate(rate_hz, windows, clock)
        });
        feeding.join().map_err(|_| "the feeding thread panicked")
    })??;
    clock.wait_until(clock.now() + Duration::from_millis(300));
    child.stdin.take().ok_or("no input")?.write_all(b"end\n")?;
    let mut ages: [BTreeMap<i64, f64>; KINDS] = Default::default();
    for line in said {
        let line = line?;
        let mut fields = line.split(' ');
        let mut field = || fields.next().ok_or("a short line");
        let (kind, number): (usize, i64) = (field()?.parse()?, field()?.parse()?);
        ages[kind].insert(number, field()?.parse::<f64>()? * 1e-3);
    }
    child.wait()?;
    let next = feeds.close()?;
    Ok(std::array::from_fn(|kind| {
        outcome(&begins[kind], next[kind], &ages[kind])
    }))
}

fn outcome(begins: &[i64], next: i64, ages: &BTreeMap<i64, f64>) -> Outcome {
    let first = begins.get(1).copied().unwrap_or(next);
    let ends = begins.iter().skip(2).chain([&next]);
    let (mut p50, mut p99) = (Vec::new(), Vec::new());
    for (begin, end) in begins.iter().skip(1).zip(ends) {
        let mut of_window: Vec<f64> = ages.range(begin..end).map(|(_, age)| *age).collect();
        p50.push(quantile(&mut of_window, 0.5));
        p99.push(quantile(&mut of_window, 0.99));
    }
    let sent = usize::try_from(next - first).unwrap_or(0);
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

/// Both ways, ready to be fed.
struct Feeds {
    sessions: Vec<zenoh::Session>,
    channel: Channel<Queues>,
    publisher: std::thread::JoinHandle<(u64, Outlets)>,
    /// Of kinds 1 and 2.
    bare: [Publisher<'static>; 2],
    payload: Vec<u8>,
    /// The number of the next message of each kind.
    next: [i64; KINDS],
}

impl Feeds {
    fn open(clock: MonotonicClock) -> Result<Self, Failure> {
        let settings = |endpoint: &str| Network {
            listen: vec![endpoint.to_owned()],
            ..Network::default()
        };
        let [ours, _, tuned] = ENDPOINTS.map(settings);
        let (ours_session, tuned_session) = (
            network::open(&ours)?.session,
            network::open(&tuned)?.session,
        );
        let bare_session = as_its_makers_set_it(ENDPOINTS[1])?;
        let sink = ZenohSink::declare(
            &ours_session,
            "latency",
            &ours,
            &TFMessage::default(),
            clock,
        )?;
        let (to, ends) = queues(true);
        let items = ends.publisher.ok_or("no queue")?;
        let outlets = Outlets::new(Some(sink), None);
        let publisher = std::thread::spawn(move || outlets.publish_until_closed(&items, clock));
        let key = rmw::Topic::new(
            "/ft/wrench",
            WrenchStamped::TYPE_NAME,
            WrenchStamped::TYPE_HASH,
            rmw::Profile::Jazzy,
        )
        .key_expr(0);
        let bare = |session: &zenoh::Session| {
            session
                .declare_publisher(key.clone())
                .congestion_control(CongestionControl::Drop)
                .wait()
                .map_err(|error| error.to_string())
        };
        let bare = [bare(&bare_session)?, bare(&tuned_session)?];
        let mut payload = Vec::new();
        WrenchStamped {
            header: Header::new(HostTime::EPOCH, "ft_sensor"),
            ..WrenchStamped::default()
        }
        .encode(&mut payload);
        Ok(Self {
            sessions: vec![ours_session, bare_session, tuned_session],
            channel: Channel::new(0, to, Arc::new(StreamCounters::default()), Duration::ZERO),
            publisher,
            bare,
            payload,
            next: [1; KINDS],
        })
    }

    /// Feeds one, then the other; the numbers of the first message of each window. The first window of each is not measured:
    /// everything is warm after it.
    fn alternate(
        &mut self,
        rate_hz: u64,
        windows: usize,
        clock: MonotonicClock,
    ) -> Result<[Vec<i64>; KINDS], String> {
        let mut begins: [Vec<i64>; KINDS] = Default::default();
        let count = rate_hz * u64::try_from(WINDOW.as_millis()).unwrap_or(0) / 1000;
        for kind in TURNS.into_iter().cycle().take(KINDS * (windows + 1)) {
            begins[kind].push(self.next[kind]);
            let begin = clock.now();
            for index in 0..count {
                clock.wait_until(begin + Duration::from_nanos(index * 1_000_000_000 / rate_hz));
                self.feed(kind, clock.now())?;
            }
            // What is under way arrives.
            clock.wait_until(clock.now() + Duration::from_millis(20));
        }
        Ok(begins)
    }

    /// A last byte came `at`.
    fn feed(&mut self, kind: usize, at: HostTime) -> Result<(), String> {
        let number = self.next[kind];
        self.next[kind] += 1;
        if let Some(bare) = kind.checked_sub(1).map(|bare| &self.bare[bare]) {
            let attachment = rmw::attachment(number, at.as_nanos(), [7; 16]);
            return bare
                .put(self.payload.as_slice())
                .attachment(attachment.as_slice())
                .wait()
                .map_err(|error| error.to_string());
        }
        let reading = WrenchReading {
            at: SampleInstant {
                arrival: at,
                device_ns: None,
            },
            wrench: Wrench::new([1.0, 2.0, 3.0], [0.1, 0.2, 0.3]),
            temperature_celsius: None,
            quality: Quality::Good,
            status_bits: 0,
        };
        Outlet::<Chunk>::reading(&mut self.channel, Reading::Wrench(reading));
        Ok(())
    }

    /// The numbers after the last.
    fn close(self) -> Result<[i64; KINDS], Failure> {
        drop(self.channel);
        let (refused, outlets) = self
            .publisher
            .join()
            .map_err(|_| "the publisher panicked")?;
        drop((outlets, self.bare));
        for session in self.sessions {
            session.close().wait().map_err(|error| error.to_string())?;
        }
        match refused {
            0 => Ok(self.next),
            refused => Err(format!("{refused} messages were refused").into()),
        }
    }
}

/// A session that listens, with nothing else set but that it looks for nobody.
fn as_its_makers_set_it(endpoint: &str) -> Result<zenoh::Session, String> {
    let mut config = zenoh::Config::default();
    let listen = format!("[\"{endpoint}\"]");
    for (key, value) in [
        ("scouting/multicast/enabled", "false"),
        ("listen/endpoints", &listen),
    ] {
        config
            .insert_json5(key, value)
            .map_err(|error| error.to_string())?;
    }
    zenoh::open(config)
        .wait()
        .map_err(|error| error.to_string())
}

/// The other process: a line `KIND NUMBER AGE_NS` for each message, after the end of its input.
fn subscribe() -> Result<(), Failure> {
    let clock = MonotonicClock::anchored_now();
    let (sender, ages) = crossbeam_channel::bounded(1 << 22);
    let mut open = Vec::new();
    for (kind, endpoint) in ENDPOINTS.into_iter().enumerate() {
        let session = network::connect(&[endpoint.to_owned()], None)?;
        let sender = sender.clone();
        let subscriber = session
            .declare_subscriber(KEY)
            .callback(move |sample| {
                let now = clock.now();
                let attachment = sample.attachment();
                let said = attachment.and_then(|bytes| rmw::read_attachment(&bytes.to_bytes()));
                if let Some(said) = said {
                    let age = now.as_nanos() - said.source_ns;
                    let _ = sender.try_send((kind, said.sequence, age));
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
    for (kind, number, age) in ages.try_iter() {
        writeln!(out, "{kind} {number} {age}")?;
    }
    out.flush()?;
    Ok(())
}
