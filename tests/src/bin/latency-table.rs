//! `cargo run -p ft-tests --bin latency-table -- [WINDOWS] [RATE_HZ]...`: from the link's last byte to a subscriber in another
//! process, beside a bare Zenoh publisher of the same bytes.
//!
//! ```text
//! ours   link thread: reading, stamps -> queue -> publisher thread: CDR, kept for recorders -> Zenoh ─┐
//! bare   the same thread puts the same bytes at once ──────────────────────────────────────── Zenoh ─┴─► one subscriber process
//! ```
//!
//! Both have a session of their own to the same subscriber process, over TCP on this host, with the same settings; both are
//! fed by one thread with the priority of an acquisition thread, in windows of 400 ms that alternate (ours bare bare ours ...),
//! so that what the machine does besides meets both alike. A window's p50 and p99 stand for it, the median over the windows
//! for the rate. Default: 40 windows of each at 1, 4 and 8 kHz, about two minutes.

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
/// Where ours and the bare publisher listen.
const ENDPOINTS: [&str; 2] = ["tcp/127.0.0.1:17991", "tcp/127.0.0.1:17992"];
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
    let mut ages: [BTreeMap<i64, f64>; 2] = Default::default();
    for line in said {
        let line = line?;
        let mut fields = line.split(' ');
        let mut field = || fields.next().ok_or("a short line");
        let (kind, number): (usize, i64) = (field()?.parse()?, field()?.parse()?);
        ages[kind].insert(number, field()?.parse::<f64>()? * 1e-3);
    }
    child.wait()?;
    let next = feeds.close()?;
    let outcome = |kind: usize| outcome(&begins[kind], next[kind], &ages[kind]);
    Ok([outcome(0), outcome(1)])
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
    bare: Publisher<'static>,
    payload: Vec<u8>,
    /// The number of the next message, of ours and of bare.
    next: [i64; 2],
}

impl Feeds {
    fn open(clock: MonotonicClock) -> Result<Self, Failure> {
        let settings = |endpoint: &str| Network {
            listen: vec![endpoint.to_owned()],
            ..Network::default()
        };
        let [ours, bare] = ENDPOINTS.map(settings);
        let (ours_session, bare_session) =
            (network::open(&ours)?.session, network::open(&bare)?.session);
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
        let bare = bare_session
            .declare_publisher(key)
            .congestion_control(CongestionControl::Drop)
            .wait()
            .map_err(|error| error.to_string())?;
        let mut payload = Vec::new();
        WrenchStamped {
            header: Header::new(HostTime::EPOCH, "ft_sensor"),
            ..WrenchStamped::default()
        }
        .encode(&mut payload);
        Ok(Self {
            sessions: vec![ours_session, bare_session],
            channel: Channel::new(0, to, Arc::new(StreamCounters::default()), Duration::ZERO),
            publisher,
            bare,
            payload,
            next: [1, 1],
        })
    }

    /// Feeds one, then the other; the numbers of the first message of each window. The first window of each is not measured:
    /// everything is warm after it.
    fn alternate(
        &mut self,
        rate_hz: u64,
        windows: usize,
        clock: MonotonicClock,
    ) -> Result<[Vec<i64>; 2], String> {
        let mut begins: [Vec<i64>; 2] = Default::default();
        let count = rate_hz * u64::try_from(WINDOW.as_millis()).unwrap_or(0) / 1000;
        for window in 0..=2 * windows + 1 {
            let kind = usize::from(matches!(window % 4, 1 | 2));
            begins[kind].push(self.next[kind]);
            let begin = clock.now();
            for index in 0..count {
                let due = begin + Duration::from_nanos(index * 1_000_000_000 / rate_hz);
                // The link does not wait for the thread: what comes while the thread is busy came when it was due.
                let busy = clock.now() >= due;
                clock.wait_until(due);
                self.feed(kind, if busy { due } else { clock.now() })?;
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
        if kind == 1 {
            let attachment = rmw::attachment(number, at.as_nanos(), [7; 16]);
            return self
                .bare
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
    fn close(self) -> Result<[i64; 2], Failure> {
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
