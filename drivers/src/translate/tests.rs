use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;

use super::*;

mod counted;

const MS: i64 = 1_000_000;
const SECOND: i64 = 1_000 * MS;
/// Host clock when the simulated device clock is 0.
const BOOT: i64 = 1_700_000_000 * SECOND;

fn host(ns: i64) -> HostTime {
    HostTime::from_nanos(ns)
}

/// True host instant of a device instant, for a device whose clock runs `ppm` slow.
fn truth(device_ns: i64, ppm: f64) -> i64 {
    BOOT + device_ns + (device_ns as f64 * ppm * 1e-6).round() as i64
}

/// Errors `at - truth` in us of a 1 kHz stream of `seconds`, from second 10 on, and the spreads beside them.
fn errors_us(ppm: f64, seconds: i64, mut arrival: impl FnMut(i64) -> i64) -> Vec<(f64, f64)> {
    let mut translator = OneWay::new(OneWayConfig::default());
    let mut errors = Vec::new();
    for sample in 0..seconds * 1_000 {
        let device_ns = sample * MS;
        let true_ns = truth(device_ns, ppm);
        let translated = translator.observe(device_ns, host(arrival(true_ns)));
        if device_ns >= 10 * SECOND {
            let error = (translated.at.as_nanos() - true_ns) as f64 * 1e-3;
            errors.push((error, translated.spread.as_secs_f64() * 1e6));
        }
    }
    errors
}

fn worst(errors: &[(f64, f64)]) -> f64 {
    errors
        .iter()
        .map(|(error, _)| error.abs())
        .fold(0.0, f64::max)
}

/// Share of the errors that lie within two spreads.
fn covered(errors: &[(f64, f64)]) -> f64 {
    let within = errors
        .iter()
        .filter(|(error, spread)| error.abs() <= 2.0 * spread)
        .count();
    within as f64 / errors.len() as f64
}

fn exponential(random: &mut ChaCha8Rng, mean_ns: f64) -> i64 {
    let uniform: f64 = random.random_range(f64::EPSILON..1.0);
    (-uniform.ln() * mean_ns) as i64
}

#[test]
fn exponential_jitter_of_200_us_leaves_an_error_of_a_few_us() {
    for ppm in [-200.0, 0.0, 200.0] {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut last = 0;
        let errors = errors_us(ppm, 180, |true_ns| {
            last = last.max(true_ns + exponential(&mut random, 200e3));
            last
        });
        println!(
            "jitter 200 us, skew {ppm} ppm: worst {:.1} us",
            worst(&errors)
        );
        assert!(worst(&errors) < 20.0, "{ppm} ppm: {}", worst(&errors));
        assert!(covered(&errors) > 0.95, "{ppm} ppm: {}", covered(&errors));
    }
}

#[test]
fn bursts_of_16_ms_leave_an_error_below_the_sample_period() {
    for ppm in [-200.0, 0.0, 200.0] {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let mut last = 0;
        // The adapter hands over what it has every 16 ms of its own time, USB and scheduler add up to 0.3 ms.
        let errors = errors_us(ppm, 180, |true_ns| {
            let burst = (true_ns + 16 * MS - 1).div_euclid(16 * MS) * 16 * MS;
            last = last.max(burst + random.random_range(0..300_000));
            last
        });
        println!(
            "16 ms bursts, skew {ppm} ppm: worst {:.1} us",
            worst(&errors)
        );
        // Plain arrival stamps are wrong by up to 16 300 us.
        assert!(worst(&errors) < 1_000.0, "{ppm} ppm: {}", worst(&errors));
    }
}

#[test]
fn the_first_seconds_are_no_worse_than_the_skew_bound_allows() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut translator = OneWay::new(OneWayConfig::default());
    for sample in 0..10_000 {
        let (device_ns, true_ns) = (sample * MS, truth(sample * MS, 200.0));
        let arrival = true_ns + exponential(&mut random, 200e3);
        let error = translator.observe(device_ns, host(arrival)).at.as_nanos() - true_ns;
        if sample > 100 {
            assert!(
                (-600_000..200_000).contains(&error),
                "sample {sample}: {error} ns"
            );
        }
    }
}

#[test]
fn status_tells_offset_skew_and_count() {
    let mut translator = OneWay::new(OneWayConfig::default());
    assert_eq!(translator.status(), None);
    for sample in 0..20_000 {
        translator.observe(sample * MS, host(truth(sample * MS, 120.0)));
    }
    let status = translator.status().unwrap();
    assert!((status.skew_ppm - 120.0).abs() < 0.1, "{status:?}");
    assert!(
        (status.offset_ns - (truth(19_999 * MS, 120.0) - 19_999 * MS)).abs() < 1_000,
        "{status:?}"
    );
    assert_eq!(status.observations, 20_000);
    assert!(status.spread_ns < 100_000);
}

#[test]
fn skew_is_bounded_and_a_bad_edge_still_gives_a_causal_answer() {
    let mut translator = OneWay::new(OneWayConfig {
        max_skew_ppm: 100.0,
        ..OneWayConfig::default()
    });
    for sample in 0..10_000 {
        let arrival = host(truth(sample * MS, 5_000.0));
        assert!(translator.observe(sample * MS, arrival).at <= arrival);
    }
    assert!((translator.status().unwrap().skew_ppm - 100.0).abs() < 1e-9);
}

#[test]
fn the_link_delay_is_subtracted() {
    let delay = Duration::from_micros(500);
    let mut translator = OneWay::new(OneWayConfig {
        link_delay: delay,
        ..OneWayConfig::default()
    });
    assert_eq!(translator.observe(0, host(BOOT)).at, host(BOOT - 500_000));
    assert_eq!(
        translator.status().map(|status| status.offset_ns),
        Some(BOOT - 500_000)
    );
}

#[test]
fn spread_shrinks_as_observations_come() {
    let mut translator = OneWay::new(OneWayConfig::default());
    let first = translator.observe(0, host(BOOT)).spread;
    let mut last = first;
    for sample in 1..30_000 {
        last = translator
            .observe(
                sample * MS,
                host(truth(sample * MS, 10.0) + sample % 7 * 1_000),
            )
            .spread;
    }
    assert!(
        first >= Duration::from_millis(1) && last < Duration::from_micros(20),
        "{first:?} {last:?}"
    );
}

#[test]
fn a_repeated_or_late_stamp_changes_nothing() {
    let mut translator = OneWay::new(OneWayConfig::default());
    for sample in 0..1_000 {
        translator.observe(sample * MS, host(BOOT + sample * MS));
    }
    let before = translator.status();
    let newest = translator.observe(999 * MS, host(BOOT + 1_000 * MS));
    assert_eq!(newest.at, host(BOOT + 999 * MS));
    assert_eq!(
        translator.observe(500 * MS, host(BOOT + 1_001 * MS)).at,
        host(BOOT + 500 * MS)
    );
    assert_eq!(translator.status(), before);
}

#[test]
fn a_device_clock_that_begins_anew_is_followed_at_once() {
    let mut translator = OneWay::new(OneWayConfig::default());
    for sample in 0..5_000 {
        translator.observe(sample * MS, host(BOOT + sample * MS));
    }
    let back = translator.observe(10 * MS, host(BOOT + 6_000 * MS));
    assert_eq!(back.at, host(BOOT + 6_000 * MS));
    assert_eq!(
        translator.status().map(|status| status.observations),
        Some(1)
    );
    let ahead = translator.observe(90_000 * MS, host(BOOT + 6_001 * MS));
    assert_eq!(ahead.at, host(BOOT + 6_001 * MS));
    assert_eq!(
        translator.status().map(|status| status.observations),
        Some(1)
    );
}

#[test]
fn a_stalled_link_is_no_restart_but_a_clock_that_stood_still_is() {
    let mut translator = OneWay::new(OneWayConfig::default());
    for sample in 0..5_000 {
        translator.observe(sample * MS, host(BOOT + sample * MS));
    }
    // 3 s of samples arrive at once: their instants are still right.
    for sample in 5_000..8_000 {
        let at = translator.observe(sample * MS, host(BOOT + 8_000 * MS)).at;
        assert_eq!(at, host(BOOT + sample * MS));
    }
    // The device slept 20 s, clock and all.
    for sample in 8_000..10_000 {
        translator.observe(sample * MS, host(BOOT + (20_000 + sample) * MS));
    }
    let at = translator.observe(10_000 * MS, host(BOOT + 30_000 * MS)).at;
    assert_eq!(at, host(BOOT + 30_000 * MS));
}

#[test]
fn a_clock_set_back_by_less_than_a_second_is_followed_within_half_a_second() {
    // A clock that goes on behind where it was: 8 samples until it shows. One that stood still: 500 ms.
    for (set_back, stood_still, samples) in [
        (300 * MS, 0, 8),
        (950 * MS, 0, 8),
        (0, 300 * MS, 502),
        (0, 10 * MS, 502),
    ] {
        let mut random = ChaCha8Rng::seed_from_u64(17);
        let mut translator = OneWay::new(OneWayConfig::default());
        let mut wrong = 0;
        for sample in 0..30_000_i64 {
            let true_ns = BOOT + sample * MS;
            let changed = sample >= 10_000;
            let device_ns = sample * MS - if changed { set_back + stood_still } else { 0 };
            // What stood still says nothing meanwhile.
            if changed && sample * MS < 10_000 * MS + stood_still {
                continue;
            }
            let arrival = true_ns + exponential(&mut random, 100e3);
            let error = translator.observe(device_ns, host(arrival)).at.as_nanos() - true_ns;
            wrong += i64::from(sample > 1_000 && error.abs() > MS);
        }
        assert!(wrong <= samples, "{set_back} {stood_still}: {wrong}");
    }
}

#[test]
fn a_link_that_is_slow_for_a_while_is_no_restart() {
    let mut translator = OneWay::new(OneWayConfig::default());
    for sample in 0..10_000 {
        // 200 ms of every second come 30 ms late.
        let late = if sample % 1_000 < 200 { 30 * MS } else { 0 };
        translator.observe(sample * MS, host(BOOT + sample * MS + late));
    }
    assert_eq!(
        translator.status().map(|status| status.observations),
        Some(10_000)
    );
}

#[test]
fn a_skew_that_changes_is_followed_within_two_windows() {
    let config = OneWayConfig {
        window: Duration::from_secs(10),
        ..OneWayConfig::default()
    };
    let mut translator = OneWay::new(config);
    let mut true_ns = BOOT;
    let mut error = 0;
    for sample in 0..60_000_i64 {
        let ppm = if sample < 30_000 { 100.0 } else { -100.0 };
        true_ns += MS + (ppm * 1.0) as i64;
        error = translator
            .observe(sample * MS, host(true_ns + sample % 11 * 10_000))
            .at
            .as_nanos()
            - true_ns;
    }
    assert!(error.abs() < 5_000, "{error} ns");
    assert!((translator.status().unwrap().skew_ppm + 100.0).abs() < 1.0);
}

#[test]
fn a_clock_that_was_set_back_is_cut_there_and_not_where_the_link_stalled() {
    let mut random = ChaCha8Rng::seed_from_u64(23);
    let observations: Vec<_> = (0..60_000_i64)
        .map(|sample| {
            let true_ns = BOOT + sample * MS;
            // Half a second after the clock stood still for 40 ms the link stalls for 200 ms.
            let device_ns = sample * MS - if sample >= 30_000 { 40 * MS } else { 0 };
            let stall = (29_700..29_900).contains(&sample) || (30_200..30_400).contains(&sample);
            let until = if stall {
                (sample / 100 + 2) * 100 * MS + BOOT
            } else {
                0
            };
            (
                device_ns,
                host((true_ns + exponential(&mut random, 100e3)).max(until)),
            )
        })
        .collect();
    let smoothed = smooth(&observations, &OneWayConfig::default());
    let wrong = smoothed
        .iter()
        .enumerate()
        .filter(|(sample, at)| (at.as_nanos() - BOOT - *sample as i64 * MS).abs() > MS)
        .count();
    assert!(wrong <= 2, "{wrong} of 60000 stamps are more than 1 ms off");
}

#[test]
fn a_device_that_restarts_after_its_first_sample_is_cut_there() {
    let observations: Vec<_> = (0..20_000_i64)
        .map(|sample| {
            let ran = if sample == 0 { 1_000 * SECOND } else { 0 };
            (ran + sample * MS, host(BOOT + sample * MS))
        })
        .collect();
    let smoothed = smooth(&observations, &OneWayConfig::default());
    let off = |(at, (_, arrival)): (&HostTime, &(i64, HostTime))| arrival.saturating_since(*at);
    let worst = smoothed.iter().zip(&observations).map(off).max();
    assert!(worst < Some(Duration::from_millis(1)), "{worst:?}");
}

proptest! {
    /// Stamps of any size, in any order: the smoother answers all, none later than its arrival.
    #[test]
    fn the_smoother_takes_any_stamps(
        stamps in proptest::collection::vec((any::<i64>(), any::<i64>()), 0..60),
        near in proptest::collection::vec((0_i64..1_000, 0_i64..1_000), 0..60),
    ) {
        // Far apart, and at both ends of what a number holds.
        let ends = near.iter().map(|(a, b)| (i64::MAX - a, i64::MAX - b));
        let other = near.iter().map(|(a, b)| (i64::MIN + a, i64::MIN + b));
        for list in [stamps, ends.collect(), other.collect()] {
            let observations: Vec<_> = list.into_iter().map(|(x, y)| (x, host(y))).collect();
            let smoothed = smooth(&observations, &OneWayConfig::default());
            prop_assert_eq!(smoothed.len(), observations.len());
            for (at, (_, arrival)) in smoothed.iter().zip(&observations) {
                prop_assert!(at <= arrival);
            }
        }
    }

    /// Any device clock, any delays: never later than the arrival, never going back.
    #[test]
    fn no_answer_is_later_than_its_arrival_or_earlier_than_the_one_before(
        steps in proptest::collection::vec((1_i64..50 * MS, 0_i64..60 * MS), 1..600),
    ) {
        let mut translator = OneWay::new(OneWayConfig { window: Duration::from_secs(2), ..OneWayConfig::default() });
        let (mut device_ns, mut arrival, mut last) = (0, BOOT, host(0));
        for (device_step, host_step) in steps {
            device_ns += device_step;
            arrival += host_step;
            let before = translator.status().map_or(0, |status| status.observations);
            let translated = translator.observe(device_ns, host(arrival));
            prop_assert!(translated.at <= host(arrival));
            let reset = translator.status().is_some_and(|status| status.observations <= before);
            prop_assert!(reset || translated.at >= last, "{} < {}", translated.at, last);
            last = translated.at;
        }
    }

    /// Stamps in any order, also backwards and far apart: an answer, no panic, never later than the arrival.
    #[test]
    fn stamps_in_any_order_are_answered_causally(
        stamps in proptest::collection::vec((any::<i64>(), any::<i64>()), 1..200),
    ) {
        let mut translator = OneWay::new(OneWayConfig::default());
        for (device_ns, arrival) in stamps {
            prop_assert!(translator.observe(device_ns, host(arrival)).at <= host(arrival));
        }
    }
}
