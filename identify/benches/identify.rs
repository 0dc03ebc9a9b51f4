//! Seconds per recorded minute: the whole identification of a recording in memory, and its parts.

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::identify_loaded;
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

/// One effort of a twin with a spline mechanism, states all over its domain.
#[divan::bench(sample_size = 10000)]
fn twin_effort(bencher: divan::Bencher) {
    let recording = Scene::door().record();
    let found = identify_loaded(&recording, &MotionSettings::default(), &mut |_| {});
    let Some(mut twin) = found.ok().and_then(|found| found.twin) else {
        return;
    };
    twin.effects.clear();
    let evaluator = twin.evaluator();
    let [[low, high], [slowest, fastest]] = [evaluator.domain().q, evaluator.domain().dq];
    let mut at = 0_u32;
    bencher.bench_local(|| {
        at = at.wrapping_add(0x9e37_79b9);
        let (u, v) = (
            f64::from(at & 0xffff) / 65535.0,
            f64::from(at >> 16) / 65535.0,
        );
        evaluator.effort(
            low + u * (high - low),
            slowest + v * (fastest - slowest),
            0.3,
        )
    });
}
