//! Translated stamps against the true sample times, over an accelerated hour of each kind of link, with a reset of the device
//! in its middle and a counter that wraps; beside them the arrival and a linear regression. All of it simulated.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::time::Duration;

use ft_drivers::translate::{Counted, Handover, OneWay, OneWayConfig, smooth};
use ft_wire::HostTime;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

const US: i64 = 1_000;
const MS: i64 = 1_000 * US;
const SECOND: i64 = 1_000 * MS;
const BOOT: i64 = 1_700_000_000 * SECOND;
const HOUR_S: i64 = 3_600;
/// The device loses power then, for half a second.
const RESET_S: i64 = 1_800;
/// What follows the start and the reset is left out for so long.
const SETTLE_S: i64 = 10;

/// How frames come.
#[derive(Clone, Copy, Debug)]
enum Bus {
    /// Interrupt at the end of the frame: exponential tail of 100 us.
    Can,
    /// A USB port polled every 1 ms of the host's time, exponential tail of 150 us, and up to three polls missed.
    Serial,
    /// An FTDI adapter at its latency timer of 16 ms, which counts the host's USB frames; exponential tail of 100 us.
    Ftdi,
    /// The same, the timer on the adapter's own crystal, which is 35 ppm slow.
    FtdiCrystal,
    /// The same, the timer in step with the sensor's own clock, each burst 0.9 ms after every 16th sample: a
    /// constant delay, which no one-way method can see; the configuration says it (or alignment by the tool's weight finds it).
    FtdiInStep,
}

/// A burst of [`Bus::FtdiInStep`] after its last sample.
const IN_STEP_NS: i64 = 900 * US;

fn exponential(random: &mut ChaCha8Rng, mean_ns: f64) -> i64 {
    let uniform: f64 = random.random_range(f64::EPSILON..1.0);
    (-uniform.ln() * mean_ns) as i64
}

fn next_multiple(at: i64, period: i64) -> i64 {
    (at + period - 1).div_euclid(period) * period
}

impl Bus {
    /// When `sample` comes, whose instants are `true_at`.
    fn arrival(self, sample: i64, true_at: impl Fn(i64) -> i64, random: &mut ChaCha8Rng) -> i64 {
        let true_ns = true_at(sample);
        let busy = if random.random_range(0..2_000) == 0 {
            exponential(random, 3e6)
        } else {
            0
        };
        busy + match self {
            Self::Can => true_ns + exponential(random, 100e3),
            Self::Serial => {
                next_multiple(true_ns, MS)
                    + random.random_range(0..4) * MS
                    + exponential(random, 150e3)
            }
            Self::Ftdi => next_multiple(true_ns, 16 * MS) + exponential(random, 100e3),
            Self::FtdiCrystal => {
                let burst = next_multiple(true_ns - BOOT, 16 * MS + 560);
                BOOT + burst + exponential(random, 100e3)
            }
            Self::FtdiInStep => {
                true_at(next_multiple(sample, 16)) + IN_STEP_NS + exponential(random, 100e3)
            }
        }
    }
}

/// Errors against the truth, us: absolute 99th percentiles.
struct Quality {
    arrival: f64,
    regression: f64,
    envelope: f64,
    /// The smoother over the whole hour, the first seconds included.
    smoothed: f64,
    later_than_arrival: u64,
}

/// A causal line through the last minute of arrivals, as simple recorders do it.
#[derive(Default)]
struct Regression {
    points: std::collections::VecDeque<(f64, f64)>,
    sums: [f64; 4],
}

impl Regression {
    fn observe(&mut self, x: f64, y: f64) -> f64 {
        self.points.push_back((x, y));
        self.add(x, y, 1.0);
        while self
            .points
            .front()
            .is_some_and(|(first, _)| x - first > 60.0)
        {
            let (x, y) = self.points.pop_front().unwrap();
            self.add(x, y, -1.0);
        }
        let n = self.points.len() as f64;
        let [sx, sy, sxx, sxy] = self.sums;
        let spread = sxx - sx * sx / n;
        let slope = if spread > 1e-3 {
            (sxy - sx * sy / n) / spread
        } else {
            0.0
        };
        sy / n + slope * (x - sx / n)
    }

    fn add(&mut self, x: f64, y: f64, sign: f64) {
        for (sum, value) in self.sums.iter_mut().zip([x, y, x * x, x * y]) {
            *sum += sign * value;
        }
    }
}

/// A 32-bit counter made one that only grows.
#[derive(Default)]
struct Counter {
    last: Option<u32>,
    high: i64,
}

impl Counter {
    fn unwrapped(&mut self, count: u32) -> i64 {
        if self.last.is_some_and(|last| count < last) {
            self.high += 1 << 32;
        }
        self.last = Some(count);
        self.high + i64::from(count)
    }
}

fn p99(mut errors: Vec<f64>) -> f64 {
    let place = errors.len() * 99 / 100;
    *errors.select_nth_unstable_by(place, f64::total_cmp).1
}

fn run(bus: Bus, ppm: f64, seed: u64) -> Quality {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let config = OneWayConfig {
        link_delay: match bus {
            Bus::FtdiInStep => Duration::from_nanos(IN_STEP_NS.unsigned_abs()),
            _ => Duration::ZERO,
        },
        ..OneWayConfig::default()
    };
    let mut translator = OneWay::new(config);
    let mut regression = Regression::default();
    let mut errors: [Vec<f64>; 3] = Default::default();
    let (mut observations, mut truths) = (Vec::new(), Vec::new());
    let (mut later, mut last) = (0, BOOT);
    // A 32-bit counter of microseconds that wraps after 12 min, and begins anew at the reset.
    let mut counter = Counter::default();
    let (mut device_us, mut since_reset) = (u32::MAX - 720_000_000, 0_i64);
    let mut settled_from = SETTLE_S * SECOND;
    let mut was_reset = false;
    // The crystal, and a warm-up that bends it.
    let true_at = |sample: i64| {
        let warm = 1.2e6 * (sample as f64 / 600e3).sin();
        BOOT + sample * MS + (1e-6 * ppm * (sample * MS) as f64 + warm) as i64
    };
    for sample in 0..HOUR_S * 1_000 {
        let true_ns = true_at(sample);
        let true_since = true_ns - BOOT;
        if (RESET_S * SECOND..RESET_S * SECOND + SECOND / 2).contains(&true_since) {
            continue;
        }
        if true_since >= RESET_S * SECOND && !was_reset {
            was_reset = true;
            (device_us, since_reset) = (0, sample);
            counter = Counter::default();
            regression = Regression::default();
            settled_from = true_since + SETTLE_S * SECOND;
        }
        let ticks = u32::try_from((sample - since_reset) * 1_000).unwrap();
        let device_ns = counter.unwrapped(device_us.wrapping_add(ticks)) * US;
        let arrival = bus.arrival(sample, true_at, &mut random).max(last);
        last = arrival;
        let at = translator
            .observe(device_ns, HostTime::from_nanos(arrival))
            .at;
        later += u64::from(at > HostTime::from_nanos(arrival));
        observations.push((device_ns, HostTime::from_nanos(arrival)));
        truths.push(true_ns);
        let offset = (arrival - device_ns) as f64;
        let x = device_ns as f64 * 1e-9;
        let line = regression.observe(x, offset - (BOOT as f64));
        if true_since >= settled_from {
            let by_line = line + BOOT as f64 + device_ns as f64;
            let us = |ns: f64| (ns - true_ns as f64).abs() * 1e-3;
            errors[0].push(us(arrival as f64));
            errors[1].push(us(by_line));
            errors[2].push((at.as_nanos() - true_ns).abs() as f64 * 1e-3);
        }
    }
    assert!(was_reset);
    let smoothed = smooth(&observations, &config);
    assert_eq!(smoothed.len(), truths.len());
    let arrivals = observations.iter().map(|(_, arrival)| arrival);
    later += smoothed
        .iter()
        .zip(arrivals)
        .filter(|(at, arrival)| at > arrival)
        .count() as u64;
    let smoothed = smoothed.iter().zip(&truths);
    let smoothed = smoothed.map(|(at, truth)| (at.as_nanos() - truth).abs() as f64 * 1e-3);
    let smoothed = p99(smoothed.collect());
    let [arrival, regression, envelope] = errors.map(p99);
    Quality {
        arrival,
        regression,
        envelope,
        smoothed,
        later_than_arrival: later,
    }
}

#[test]
fn an_hour_of_each_link_is_translated_to_the_tables_bounds() {
    println!(
        "simulated, 1 h at 1 kHz, reset at 30 min, 99th percentile of |error| in us from 10 s on (smoothed: of all)"
    );
    println!("link         skew ppm   arrival  regression  envelope  smoothed");
    for (bus, bound_us, seed) in [
        (Bus::Can, 50.0, 41),
        (Bus::Serial, 300.0, 42),
        (Bus::Ftdi, 1_000.0, 43),
        (Bus::FtdiCrystal, 1_000.0, 44),
        (Bus::FtdiInStep, 1_000.0, 45),
    ] {
        for ppm in [-200.0, 200.0] {
            let quality = run(bus, ppm, seed);
            println!(
                "{:<12} {ppm:>8} {:>9.1} {:>11.1} {:>9.1} {:>9.1}",
                format!("{bus:?}"),
                quality.arrival,
                quality.regression,
                quality.envelope,
                quality.smoothed
            );
            // Afterwards the first ten seconds are no worse than the rest.
            assert!(
                quality.smoothed <= bound_us,
                "{bus:?}: {} us",
                quality.smoothed
            );
            assert!(
                quality.smoothed <= 1.05 * quality.envelope,
                "{bus:?}: {} us",
                quality.smoothed
            );
            assert_eq!(quality.later_than_arrival, 0);
            assert!(
                quality.envelope <= bound_us,
                "{bus:?}: {} us",
                quality.envelope
            );
            assert!(
                10.0 * quality.envelope <= quality.arrival,
                "{bus:?}: {} us",
                quality.envelope
            );
            assert!(
                quality.envelope < quality.regression && quality.regression < quality.arrival,
                "{bus:?}: {} us by regression",
                quality.regression
            );
        }
    }
}

/// Samples without clock or counter, some of them lost: 99th percentiles of arrival and translation from 10 s on, us.
fn run_counted(bus: Bus, ppm: f64, lost: &[(i64, i64)], seed: u64) -> (f64, f64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let handover = match bus {
        Bus::Can => Handover::Prompt,
        _ => Handover::Polled,
    };
    let mut translator = Counted::new(OneWayConfig::default(), handover);
    let mut errors: [Vec<f64>; 2] = Default::default();
    let (mut last, mut settled_from, mut was_reset) = (BOOT, SETTLE_S * SECOND, false);
    let true_at = |sample: i64| BOOT + sample * MS + (1e-6 * ppm * (sample * MS) as f64) as i64;
    for sample in 0..HOUR_S * 1_000 {
        let true_ns = true_at(sample);
        let true_since = true_ns - BOOT;
        let off = (RESET_S * SECOND..RESET_S * SECOND + SECOND / 2).contains(&true_since);
        if off
            || lost
                .iter()
                .any(|(from, count)| (*from..from + count).contains(&sample))
        {
            continue;
        }
        if true_since >= RESET_S * SECOND && !was_reset {
            was_reset = true;
            // Its driver says that it streams anew.
            translator.reset();
            settled_from = true_since + SETTLE_S * SECOND;
        }
        let arrival = bus.arrival(sample, true_at, &mut random).max(last);
        last = arrival;
        let at = translator
            .observe(HostTime::from_nanos(arrival))
            .map_or(arrival, |instant| instant.translated.at.as_nanos());
        assert!(at <= arrival);
        if true_since >= settled_from {
            errors[0].push((arrival - true_ns) as f64 * 1e-3);
            errors[1].push((at - true_ns).abs() as f64 * 1e-3);
        }
    }
    let [arrival, counted] = errors.map(p99);
    (arrival, counted)
}

#[test]
fn sensors_without_clock_or_counter_are_translated_by_the_number_of_samples() {
    // One or a few samples every five minutes, and once more than a hundred.
    let mut lost: Vec<(i64, i64)> = (1..12).map(|k| (k * 300_000 + 777, 1 + k % 3)).collect();
    lost.push((2_950_000, 137));
    println!(
        "simulated, 1 h at 1 kHz by count, {} losses, reset at 30 min, 99th percentile of |error| in us from 10 s on",
        lost.len()
    );
    println!("link         skew ppm   arrival   counted");
    for (bus, ppm, bound_us, seed) in [
        (Bus::Can, -200.0, 50.0, 51),
        (Bus::Can, 200.0, 50.0, 52),
        (Bus::Serial, 200.0, 300.0, 53),
        (Bus::Ftdi, -200.0, 1_000.0, 54),
        (Bus::FtdiCrystal, 200.0, 1_000.0, 55),
    ] {
        let (arrival, counted) = run_counted(bus, ppm, &lost, seed);
        println!(
            "{:<12} {ppm:>8} {arrival:>9.1} {counted:>9.1}",
            format!("{bus:?}")
        );
        assert!(counted <= bound_us, "{bus:?}: {counted} us");
        assert!(10.0 * counted <= arrival, "{bus:?}: {counted} us");
    }
}
