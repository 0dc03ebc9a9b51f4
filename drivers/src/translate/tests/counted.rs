//! The clock made of the number of samples.

use super::*;

/// Samples of `period_ns` behind `bus`, of which those in `lost` (from, to) do not come: errors in us from 12 s on, and how often the period was
/// mended.
fn counted_errors_us(
    period_ns: i64,
    lost: &[(i64, i64)],
    late: &mut dyn FnMut(i64) -> i64,
) -> (Vec<f64>, u32) {
    let mut counted = Counted::new(OneWayConfig::default(), Handover::Polled);
    let mut errors = Vec::new();
    for sample in 0..40 * SECOND / period_ns {
        if lost.iter().any(|(from, to)| (*from..*to).contains(&sample)) {
            continue;
        }
        let true_ns = BOOT + sample * period_ns;
        let arrival = host(late(true_ns));
        let at = counted
            .observe(arrival)
            .map_or(arrival, |instant| instant.translated.at);
        assert!(at <= arrival);
        if sample * period_ns >= 12 * SECOND {
            errors.push((at.as_nanos() - true_ns) as f64 * 1e-3);
        }
    }
    (errors, counted.mended())
}

#[test]
fn samples_lost_while_the_period_is_learned_leave_no_stream_on_its_arrivals() {
    // 100 Hz, 1 kHz and 4 kHz; a loss early, in the middle, at the end of the two seconds, many, and half of them.
    for (period_ms, lost) in [
        (10.0, vec![(20, 21)]),
        (10.0, vec![(99, 103)]),
        (10.0, vec![(150, 151), (190, 195)]),
        (1.0, vec![(500, 540)]),
        (1.0, (0..60).map(|k| (33 * k + 3, 33 * k + 5)).collect()),
        (0.25, vec![(10, 900), (4_000, 4_400)]),
    ] {
        let period_ns = (period_ms * MS as f64) as i64;
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut last = 0;
        // 16 ms bursts: arrivals are wrong by up to 16 000 us.
        let mut late = |true_ns: i64| {
            let burst = (true_ns + 16 * MS - 1).div_euclid(16 * MS) * 16 * MS;
            last = last.max(burst + random.random_range(0..300_000));
            last
        };
        let (errors, mended) = counted_errors_us(period_ns, &lost, &mut late);
        let worst = errors.iter().map(|error| error.abs()).fold(0.0, f64::max);
        println!(
            "{period_ms} ms, {} losses: worst {worst:.0} us, mended {mended} times",
            lost.len()
        );
        assert!(
            worst < 1_000.0,
            "{period_ms} ms {lost:?}: {worst} us, mended {mended}"
        );
    }
    // A stream without losses needs no mending.
    let mut late = |true_ns: i64| true_ns + 50_000;
    assert_eq!(counted_errors_us(MS, &[], &mut late).1, 0);
}

/// A stream of 1 kHz on a line with 100 us of jitter, of which `lost` do not come; the driver `knows` of them or not. Errors and
/// spreads, us, from the end of the first two seconds on, by sample.
fn counted_with_losses(
    (handover, seconds): (Handover, i64),
    knows: bool,
    lost: impl Fn(i64) -> bool,
    mut late: impl FnMut(i64) -> i64,
) -> Vec<(i64, f64, f64)> {
    let mut counted = Counted::new(OneWayConfig::default(), handover);
    let mut out = Vec::new();
    for sample in 0..1_000 * seconds {
        if lost(sample) {
            counted.pass(u64::from(knows));
            continue;
        }
        let true_ns = truth(sample * MS, 30.0);
        if let Some(instant) = counted.observe(host(late(true_ns))) {
            let error = (instant.translated.at.as_nanos() - true_ns) as f64 * 1e-3;
            let spread = instant.translated.spread.as_secs_f64() * 1e6;
            out.push((sample, error, spread));
        }
    }
    assert_eq!(counted.mended(), 0);
    out
}

/// Errors of the samples after the first 5 s that are not within `spared` samples after a loss.
fn worst_away_from_losses(
    errors: &[(i64, f64, f64)],
    lost: impl Fn(i64) -> bool,
    spared: i64,
) -> f64 {
    let near = |sample: i64| (sample - spared..sample).any(&lost);
    let far = errors
        .iter()
        .filter(|(sample, ..)| *sample >= 5_000 && !near(*sample));
    far.map(|(_, error, _)| error.abs()).fold(0.0, f64::max)
}

fn share_within_three_spreads(errors: &[(i64, f64, f64)]) -> f64 {
    let within = |(_, error, spread): &&(i64, f64, f64)| error.abs() <= 3.0 * spread;
    errors.iter().filter(within).count() as f64 / errors.len() as f64
}

#[test]
fn samples_that_are_known_to_be_lost_move_no_stamp() {
    let early_and_heavy = |sample: i64| sample > 2_500 && sample % 150 == 0;
    let while_it_is_learned = |sample: i64| sample > 0 && sample % 170 == 0;
    let light = |sample: i64| sample > 15_000 && sample % 1_000 == 0;
    let many_at_once = |sample: i64| (7_000..7_090).contains(&sample);
    let kinds: [&dyn Fn(i64) -> bool; 4] = [
        &early_and_heavy,
        &while_it_is_learned,
        &light,
        &many_at_once,
    ];
    for (kind, lost) in kinds.into_iter().enumerate() {
        let mut random = ChaCha8Rng::seed_from_u64(31);
        let errors = counted_with_losses((Handover::Polled, 40), true, lost, |at| {
            at + exponential(&mut random, 100e3)
        });
        let (worst, within) = (
            worst_away_from_losses(&errors, lost, 0),
            share_within_three_spreads(&errors),
        );
        println!("kind {kind}: worst {worst:.1} us, {within:.4} within three spreads");
        assert!(worst < 60.0, "kind {kind}: {worst} us");
        assert!(within > 0.97, "kind {kind}: {within}");
    }
    // Bursts hide a period or so.
    let mut last = 0;
    let errors = counted_with_losses((Handover::Polled, 40), true, early_and_heavy, |at| {
        last = last.max((at + 16 * MS - 1).div_euclid(16 * MS) * 16 * MS);
        last
    });
    let worst = worst_away_from_losses(&errors, early_and_heavy, 0);
    assert!(worst < 1_000.0, "bursts: {worst} us");
}

#[test]
fn samples_lost_without_a_trace_are_covered_by_the_spread() {
    for every in [1_000, 2_700, 7_001] {
        let lost = |sample: i64| sample > 6_000 && sample % every == 0;
        let mut random = ChaCha8Rng::seed_from_u64(32);
        let errors = counted_with_losses((Handover::Polled, 40), false, lost, |at| {
            at + exponential(&mut random, 50e3)
        });
        // The line is trusted from 12 s on.
        let trusted: Vec<_> = errors
            .iter()
            .copied()
            .filter(|(sample, ..)| *sample > 14_000)
            .collect();
        let worst = worst_away_from_losses(&trusted, lost, 420);
        let within = share_within_three_spreads(&errors);
        println!(
            "one in {every}: worst {worst:.1} us away from losses, {within:.4} within three spreads"
        );
        // Half a second after each; a period more than is found.
        assert!(worst < 2_500.0, "one in {every}: {worst} us");
        assert!(within > 0.97, "one in {every}: {within}");
    }
}

#[test]
fn samples_lost_without_a_trace_on_a_prompt_link_are_put_on() {
    for (every, from) in [(2_700, 15_000), (20_011, 15_000), (60_013, 100_000)] {
        let lost = |sample: i64| sample > from && sample % every == 0;
        let mut random = ChaCha8Rng::seed_from_u64(35);
        let late = |at: i64| at + exponential(&mut random, 50e3);
        let errors = counted_with_losses((Handover::Prompt, 240), false, lost, late);
        let settled: Vec<_> = errors
            .into_iter()
            .filter(|(sample, ..)| *sample > 15_000)
            .collect();
        let worst = worst_away_from_losses(&settled, lost, 420);
        let within = share_within_three_spreads(&settled);
        let widest = settled.iter().map(|(.., spread)| *spread);
        let widest = widest.fold(0.0, f64::max);
        println!(
            "one in {every}: worst {worst:.1} us away from losses, {within:.4} within three spreads of {widest:.0} us at most"
        );
        assert!(worst < 150.0, "one in {every}: {worst} us");
        assert!(
            within > 0.97 && widest < 2_500.0,
            "one in {every}: {within} {widest}"
        );
    }
}

#[test]
fn a_link_that_polls_as_often_as_the_sensor_samples_loses_nothing() {
    for (ppm, lost_every) in [
        (-60.0, None),
        (-20.0, None),
        (20.0, None),
        (60.0, None),
        (-60.0, Some(5_000)),
    ] {
        let mut random = ChaCha8Rng::seed_from_u64(34);
        let mut counted = Counted::new(OneWayConfig::default(), Handover::Polled);
        let mut count_ns = None;
        for sample in 0..120_000 {
            if lost_every.is_some_and(|every| sample % every == 7) {
                counted.pass(1);
                continue;
            }
            let true_ns = truth(sample * MS, ppm);
            let polled = (true_ns.div_euclid(MS) + 1) * MS;
            let Some(instant) = counted.observe(host(polled + exponential(&mut random, 20e3)))
            else {
                continue;
            };
            // None was put on or taken back.
            let of = sample - lost_every.map_or(0, |every| i64::from(sample % every == 8));
            let step =
                instant.device_ns - count_ns.unwrap_or(instant.device_ns) - (sample - of) * MS;
            assert!(
                step < 3 * MS / 2 && (step > MS / 2 || count_ns.is_none()),
                "{ppm} ppm, {sample}: {step} ns"
            );
            count_ns = Some(instant.device_ns);
            // Where in the period the polls are, nobody knows.
            let late_ns = instant.translated.at.as_nanos() - true_ns;
            assert!(
                (-MS..5 * MS / 4).contains(&late_ns),
                "{ppm} ppm, {sample}: {late_ns} ns"
            );
        }
    }
}

#[test]
fn a_link_that_is_late_for_a_while_or_a_driver_that_counts_too_many_is_found_out() {
    // A slow host: so late for 600 ms of every five seconds, or once.
    for (late_ms, once) in [(3, false), (12, false), (12, true)] {
        let mut random = ChaCha8Rng::seed_from_u64(33);
        let errors = counted_with_losses(
            (Handover::Polled, 60),
            true,
            |_| false,
            |at| {
                let after = at - BOOT - 15 * SECOND;
                let since = if once {
                    after
                } else {
                    after.rem_euclid(5 * SECOND)
                };
                let slow = (0..600 * MS).contains(&since);
                at + exponential(&mut random, 50e3) + if slow { late_ms * MS } else { 0 }
            },
        );
        let settled: Vec<_> = errors
            .iter()
            .filter(|(sample, ..)| *sample >= 10_000)
            .copied()
            .collect();
        let off = settled
            .iter()
            .filter(|(_, error, _)| error.abs() > 500.0)
            .count();
        let within = share_within_three_spreads(&settled);
        println!(
            "{late_ms} ms late: {off} of {} are off by half a period, {within:.4} within three spreads",
            settled.len()
        );
        // What was slow may be stamped so; the rest not.
        assert!(off as f64 <= 0.14 * settled.len() as f64, "{off}");
        assert!(within > 0.97, "{late_ms} ms: {within}");
        let last = settled.last().unwrap();
        assert!(last.1.abs() < 100.0 && last.2 < 300.0, "{last:?}");
        if once {
            // A second after it nothing is left of it.
            let after: Vec<_> = settled
                .iter()
                .filter(|(sample, ..)| *sample > 16_600)
                .collect();
            let widest = after.iter().map(|(.., spread)| *spread).fold(0.0, f64::max);

            assert!(widest < 150.0, "{widest} us");
        }
    }

    let mut counted = Counted::new(OneWayConfig::default(), Handover::Polled);
    let mut worst = 0.0_f64;
    for sample in 0..30_000 {
        if sample == 20_000 {
            counted.pass(2);
        }
        let true_ns = BOOT + sample * MS;
        let at = counted.observe(host(true_ns + sample % 7 * 10_000));
        if let Some(at) = at.filter(|_| sample > 10_000) {
            worst = worst.max((at.translated.at.as_nanos() - true_ns).abs() as f64 * 1e-3);
        }
    }
    assert!(worst < 100.0, "{worst} us");
}

#[test]
fn a_link_that_becomes_faster_by_a_part_of_a_period_takes_no_known_loss_back() {
    let lost = |sample: i64| sample > 2_500 && sample % 150 == 0;
    let errors = counted_with_losses((Handover::Polled, 40), true, lost, |at| {
        at + if at < BOOT + 20 * SECOND {
            600_000
        } else {
            200_000
        }
    });
    let earliest = errors.iter().map(|(_, error, _)| *error);
    let earliest = earliest.fold(f64::INFINITY, f64::min);
    // The line turns a little before it follows.
    assert!(earliest > -300.0, "{earliest} us");
}
