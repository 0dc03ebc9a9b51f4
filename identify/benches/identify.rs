//! Seconds per recorded minute: the whole identification of a recording in memory, and its search by the size of the library; and nanoseconds per effort of its twin,
//! beside what the memory itself takes for the same bytes.

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

use ft_identify::diagnose::diagnose_without;
use ft_identify::effect::library::LIBRARY;
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::{identify_loaded, joint_samples};
use ft_identify::twin::Evaluator;
use synthetic::Scene;

fn main() {
    divan::main();
}

#[divan::bench(args = [60, 120], sample_count = 5)]
fn identify(bencher: divan::Bencher, seconds: u32) {
    let recording = Scene {
        probing_s: f64::from(seconds) - 9.0,
        ..Scene::door()
    }
    .record();
    bencher.bench_local(|| {
        identify_loaded(&recording, &MotionSettings::default(), &mut |_| {})
            .map(|found| found.report.summary())
    });
}

/// The search for what the model lacks, with the first so many effects of the library.
#[divan::bench(args = [6, 12, 18, 24], sample_count = 5)]
fn diagnose(bencher: divan::Bencher, effects: usize) {
    let settings = MotionSettings::default();
    let samples = joint_samples(&Scene::door().record(), &settings);
    let samples = samples.unwrap_or_else(|error| panic!("{error}"));
    let barred: Vec<&str> = LIBRARY[effects..].iter().map(|kind| kind.name).collect();
    bencher.bench_local(|| match diagnose_without(&samples, &settings, &barred) {
        Ok(found) => found.effects.len(),
        Err(error) => panic!("{error}"),
    });
}

/// The evaluator of an identified twin, with its spline mechanism and without named effects.
fn evaluator() -> Evaluator {
    let recording = Scene::door().record();
    let found = identify_loaded(&recording, &MotionSettings::default(), &mut |_| {});
    let twin = found.ok().and_then(|found| found.twin);
    let mut twin = twin.unwrap_or_else(|| panic!("the scene has no twin"));
    twin.effects.clear();
    twin.evaluator()
}

/// States all over the domain: q, dq, ddq.
fn states(evaluator: &Evaluator, count: u32) -> [Vec<f64>; 3] {
    let [q, dq] = [evaluator.domain().q, evaluator.domain().dq];
    let within =
        |[low, high]: [f64; 2], share: u32| low + (high - low) * f64::from(share) / 65535.0;
    let at: Vec<u32> = (1..=count).map(|k| k.wrapping_mul(0x9e37_79b9)).collect();
    [
        at.iter().map(|at| within(q, at & 0xffff)).collect(),
        at.iter().map(|at| within(dq, at >> 16)).collect(),
        at.iter()
            .map(|at| within([-3.0, 3.0], at >> 8 & 0xffff))
            .collect(),
    ]
}

/// One effort after the other, each at another place.
#[divan::bench(sample_size = 10000)]
fn twin_effort(bencher: divan::Bencher) {
    let evaluator = evaluator();
    let [q, dq, ddq] = states(&evaluator, 65536);
    let mut at = 0;
    bencher.bench_local(|| {
        at = (at + 1) & 0xffff;
        evaluator.effort(q[at], dq[at], ddq[at])
    });
}

const MILLION: usize = 1_000_000;

/// States in the order of their time, as of a recording: strokes of three seconds over all of the domain, a thousand samples per second.
fn samples(evaluator: &Evaluator, count: u32) -> [Vec<f64>; 3] {
    let [low, high] = evaluator.domain().q;
    let (middle, reach, per_s) = (
        0.5 * (low + high),
        0.5 * (high - low),
        core::f64::consts::PI / 3.0,
    );
    let at: Vec<f64> = (0..count).map(|k| per_s * 1e-3 * f64::from(k)).collect();
    let series = |of: fn(f64) -> f64, size: f64| -> Vec<f64> {
        at.iter().map(|at| size * of(*at)).collect()
    };
    let q = series(f64::cos, -reach)
        .iter()
        .map(|q| middle + q)
        .collect();
    [
        q,
        series(f64::sin, reach * per_s),
        series(f64::cos, reach * per_s * per_s),
    ]
}

/// A million efforts in arrays that are there already, in the order of time; by so many threads.
#[divan::bench(args = [1, 2])]
fn twin_efforts_of_a_million(bencher: divan::Bencher, threads: usize) {
    efforts(bencher, threads, MILLION, samples);
}

/// The same in no order.
#[divan::bench(args = [1, 2])]
fn twin_efforts_of_a_million_in_no_order(bencher: divan::Bencher, threads: usize) {
    efforts(bencher, threads, MILLION, states);
}

/// The same bytes in and out with nothing computed but their sum: what the memory gives.
#[divan::bench(args = [1, 2])]
fn sums_of_a_million(bencher: divan::Bencher, threads: usize) {
    summed(bencher, threads, MILLION);
}

/// The same where no cache holds the arrays: a million after the other of 32 million states.
#[divan::bench(args = [1, 2], sample_count = 20)]
fn twin_efforts_from_memory(bencher: divan::Bencher, threads: usize) {
    efforts(bencher, threads, 32 * MILLION, samples);
}

/// The same in no order.
#[divan::bench(args = [1, 2], sample_count = 20)]
fn twin_efforts_from_memory_in_no_order(bencher: divan::Bencher, threads: usize) {
    efforts(bencher, threads, 32 * MILLION, states);
}

/// [`sums_of_a_million`] of as many as [`twin_efforts_from_memory`].
#[divan::bench(args = [1, 2], sample_count = 20)]
fn sums_from_memory(bencher: divan::Bencher, threads: usize) {
    summed(bencher, threads, 32 * MILLION);
}

fn efforts(
    bencher: divan::Bencher,
    threads: usize,
    count: usize,
    of: fn(&Evaluator, u32) -> [Vec<f64>; 3],
) {
    let evaluator = evaluator();
    let [q, dq, ddq] = of(&evaluator, count as u32);
    let mut out = vec![0.0; count];
    let bencher = bencher.counter(divan::counter::ItemsCount::new(count));
    bencher.bench_local(|| {
        evaluator
            .efforts_by(threads, &q, &dq, &ddq, &mut out)
            .is_ok()
    });
}

fn summed(bencher: divan::Bencher, threads: usize, count: usize) {
    let [q, dq, ddq] = [1.0, 2.0, 3.0].map(|value| vec![value; count]);
    let mut out = vec![0.0; count];
    let bencher = bencher.counter(divan::counter::ItemsCount::new(count));
    bencher.bench_local(|| sums(threads, [&q, &dq, &ddq], &mut out));
}

fn sum([q, dq, ddq]: [&[f64]; 3], out: &mut [f64]) {
    for (((out, q), dq), ddq) in out.iter_mut().zip(q).zip(dq).zip(ddq) {
        *out = q + dq + ddq;
    }
}

/// The sums by `threads`, the caller's among them.
fn sums(threads: usize, states: [&Vec<f64>; 3], out: &mut [f64]) {
    let share = out.len().div_ceil(threads);
    std::thread::scope(|scope| {
        let mut shares = out.chunks_mut(share).enumerate();
        let own = shares.next();
        for (i, out) in shares {
            let part = states.map(|all| &all[i * share..i * share + out.len()]);
            scope.spawn(move || sum(part, out));
        }
        if let Some((_, out)) = own {
            sum(states.map(|all| &all[..out.len()]), out);
        }
    });
}
