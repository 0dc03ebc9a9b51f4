//! From the link's last byte to a subscriber in another process, beside a bare Zenoh publisher of the same bytes in one run.
//!
//! ```text
//! cargo bench -p ft-capture --bench live_latency              1, 4 and 8 kHz, three rounds of each
//! ```
//!
//! Ours: link thread (reading, stamps) -> queue -> publisher thread (encoding) -> cache -> Zenoh. Bare: the thread that
//! would read puts at once. Both wake by the same timer and go through TCP on this host.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError};
use ft_capture::channel::Channel;
use ft_capture::config::Network;
use ft_capture::encode::Encoder;
use ft_capture::item::Item;
use ft_capture::ledger::StreamCounters;
use ft_capture::queues::queues;
use ft_capture::sink::zenoh::ZenohSink;
use ft_capture::{network, rmw};
use ft_drivers::pump::Outlet;
use ft_drivers::reading::{Quality, Reading, SampleInstant, WrenchReading};
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::message::{Header, Message, TFMessage, WrenchStamped};
use ft_wire::frames::Wrench;
use ft_wire::{Chunk, HostTime};
use zenoh::Wait;
use zenoh::qos::CongestionControl;

/// How long each publishes in a round.
const SECONDS: u64 = 4;
const ROUNDS: usize = 3;
const OURS: &str = "tcp/127.0.0.1:17991";
const BARE: &str = "tcp/127.0.0.1:17992";
const KEY: &str = "0/ft/wrench/**";

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<_> = std::env::args().collect();
    if let Some(place) = arguments
        .iter()
        .position(|argument| argument == "--subscribe")
    {
        let endpoint = arguments.get(place + 1).ok_or("no endpoint")?;
        return subscribe(endpoint);
    }
    println!(
        "{:<6} {:>7} {:>9} {:>6} {:>9} {:>9} {:>9}",
        "kind", "rate/Hz", "received", "lost", "p50/us", "p99/us", "max/us"
    );
    for rate_hz in [1000, 4000, 8000] {
        let mut quantiles = [Vec::new(), Vec::new()];
        for _ in 0..ROUNDS {
            for (kind, publish) in [
                ("bare", bare as fn(u64) -> Result<(), Failure>),
                ("ours", ours),
            ] {
                let said = round(kind, rate_hz, publish)?;
                println!("{kind:<6} {rate_hz:>7} {said}");
                let numbers: Vec<f64> = said
                    .split_whitespace()
                    .filter_map(|text| text.parse().ok())
                    .collect();
                if let [_, _, p50, p99, _] = numbers[..] {
                    quantiles[usize::from(kind == "ours")].push((p50, p99));
                }
            }
        }
        let [bare, ours] = quantiles.map(|rounds| {
            (
                median(rounds.iter().map(|round| round.0)),
                median(rounds.iter().map(|round| round.1)),
            )
        });
        println!(
            "ours / bare at {rate_hz} Hz, medians: p50 {:.2}, p99 {:.2}\n",
            ours.0 / bare.0,
            ours.1 / bare.1
        );
    }
    Ok(())
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<_> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// One subscriber in another process, one publisher here.
fn round(
    kind: &str,
    rate_hz: u64,
    publish: fn(u64) -> Result<(), Failure>,
) -> Result<String, Failure> {
    let endpoint = if kind == "ours" { OURS } else { BARE };
    let child: Child = Command::new(std::env::current_exe()?)
        .args(["--subscribe", endpoint])
        .stdout(Stdio::piped())
        .spawn()?;
    publish(rate_hz)?;
    let mut line = String::new();
    if let Some(output) = child.stdout {
        BufReader::new(output).read_line(&mut line)?;
    }
    Ok(line.trim_end().to_owned())
}

fn subscribe(endpoint: &str) -> Result<(), Failure> {
    let clock = MonotonicClock::anchored_now();
    let session = loop {
        match network::connect(&[endpoint.to_owned()], None) {
            Ok(session) => break session,
            Err(_) => clock.wait_until(clock.now() + Duration::from_millis(50)),
        }
    };
    let (sender, ages) = crossbeam_channel::bounded(1 << 20);
    let _subscriber = session
        .declare_subscriber(KEY)
        .callback(move |sample| {
            let now = clock.now();
            let said = sample
                .attachment()
                .and_then(|bytes| rmw::read_attachment(&bytes.to_bytes()));
            if let Some(said) = said {
                let _ = sender.try_send((said.sequence, now.as_nanos() - said.source_ns));
            }
        })
        .wait()
        .map_err(|error| error.to_string())?;
    let mut seen = Vec::new();
    seen.push(ages.recv_timeout(Duration::from_secs(20))?);
    while let Ok(one) = ages.recv_timeout(Duration::from_millis(700)) {
        seen.push(one);
    }
    let (first, last) = (
        seen.iter().map(|one| one.0).min(),
        seen.iter().map(|one| one.0).max(),
    );
    let lost = last.unwrap_or(0) - first.unwrap_or(0) + 1 - i64::try_from(seen.len())?;
    let mut ages: Vec<_> = seen.iter().map(|one| one.1).collect();
    ages.sort_unstable();
    let quantile = |of: f64| ages[((ages.len() - 1) as f64 * of) as usize] as f64 * 1e-3;
    println!(
        "{:>9} {lost:>6} {:>9.0} {:>9.0} {:>9.0}",
        seen.len(),
        quantile(0.5),
        quantile(0.99),
        quantile(1.0)
    );
    Ok(())
}

/// Calls `act` at the rate, with the instant at which a last byte would have come.
fn tick(clock: MonotonicClock, rate_hz: u64, mut act: impl FnMut(HostTime)) {
    // The subscriber connects meanwhile.
    clock.wait_until(clock.now() + Duration::from_secs(2));
    let begin = clock.now();
    for index in 0..rate_hz * SECONDS {
        clock.wait_until(begin + Duration::from_nanos(index * 1_000_000_000 / rate_hz));
        act(clock.now());
    }
    clock.wait_until(clock.now() + Duration::from_millis(300));
}

fn bare(rate_hz: u64) -> Result<(), Failure> {
    let clock = MonotonicClock::anchored_now();
    let opened = network::open(&Network {
        listen: vec![BARE.to_owned()],
        ..Network::default()
    })?;
    let named = rmw::Topic::new(
        "/ft/wrench",
        WrenchStamped::TYPE_NAME,
        WrenchStamped::TYPE_HASH,
        rmw::Profile::Jazzy,
    );
    let publisher = opened
        .session
        .declare_publisher(named.key_expr(0))
        .congestion_control(CongestionControl::Drop)
        .express(true)
        .wait()
        .map_err(|error| error.to_string())?;
    let mut payload = Vec::new();
    let message = WrenchStamped {
        header: Header::new(HostTime::EPOCH, "ft_sensor"),
        ..WrenchStamped::default()
    };
    message.encode(&mut payload);
    let mut sequence = 0;
    tick(clock, rate_hz, |at| {
        sequence += 1;
        let attachment = rmw::attachment(sequence, at.as_nanos(), [7; 16]);
        let _ = publisher
            .put(payload.as_slice())
            .attachment(attachment.as_slice())
            .wait();
    });
    opened
        .session
        .close()
        .wait()
        .map_err(|error| error.to_string())?;
    Ok(())
}

fn ours(rate_hz: u64) -> Result<(), Failure> {
    let clock = MonotonicClock::anchored_now();
    let settings = Network {
        listen: vec![OURS.to_owned()],
        ..Network::default()
    };
    let opened = network::open(&settings)?;
    let sink = ZenohSink::declare(
        &opened.session,
        "bench",
        &settings,
        &TFMessage::default(),
        clock,
    )?;
    let (to, ends) = queues(true);
    let items = ends.publisher.ok_or("no queue")?;
    let publisher = std::thread::spawn(move || publish(sink, &items, clock));
    let mut channel = Channel::new(0, to, Arc::new(StreamCounters::default()), Duration::ZERO);
    tick(clock, rate_hz, |arrival| {
        let reading = WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: None,
            },
            wrench: Wrench::new([1.0, 2.0, 3.0], [0.1, 0.2, 0.3]),
            temperature_celsius: None,
            quality: Quality::Good,
            status_bits: 0,
        };
        Outlet::<Chunk>::reading(&mut channel, Reading::Wrench(reading));
    });
    drop(channel);
    publisher.join().map_err(|_| "the publisher panicked")?;
    opened
        .session
        .close()
        .wait()
        .map_err(|error| error.to_string())?;
    Ok(())
}

/// As the session's publisher thread does.
fn publish(mut sink: ZenohSink, items: &Receiver<Item>, clock: MonotonicClock) {
    let mut encoder = Encoder::default();
    loop {
        match items.recv_timeout(Duration::from_millis(20)) {
            Ok(item) => {
                let _ = encoder.encode(&item, |topic, payload| {
                    sink.put(topic, payload, item.sample_time)
                });
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        let _ = sink.tick(clock.now());
    }
}
