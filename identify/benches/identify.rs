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
