//! The identification beside the paper's pipeline in Python: `cargo run --release -p ft-tests --bin speed -- --help`.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::{Duration, Instant};

use clap::Parser;
use ft_identify::dynamics::{fit_base, fit_with_mechanism};
use ft_identify::effect::RigidBody;
use ft_identify::motion::{Motion, MotionSettings};
use ft_identify::paper::network::Training;
use ft_identify::paper::{PaperSettings, identify};
use ft_identify::pipeline::{identify_recording, joint_samples};
use ft_recording::{Pose7, Recording, TopicMap, TrackedFrame};
use ft_sim_hw::Scenario;
use ft_tests::arguments::positive;
use ft_tests::truth::{Trial, try_record};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

type Failure = Box<dyn std::error::Error>;

/// How often the short parts of ours are timed: the median counts, because a machine's hiccup is as long as they are.
const SHORT: usize = 7;

/// The whole identification beside the paper's pipeline in Python (`tests/peers/paper_pipeline.py`) on the same simulated recording.
///
/// Both in one run: ratios, not times, carry over to other machines. The short parts of ours are medians of seven, all else, Python too,
/// runs once.
///
/// Both begin with the streams in memory, Python with arrays and ours with what was read of the MCAP file, whose reading has its own
/// line; all of `ft-identify` begins with the file. PyTorch on as many threads as it chooses and, where that is another number, on
/// all processors: on two that share a core it takes longer than on one. Debian's `python3-torch` and `python3-scipy` are needed.
#[derive(Parser)]
#[command(after_help = "Example:\n  speed 60 drawer_light")]
struct Arguments {
    /// Length of the recording, s
    #[arg(default_value_t = 71.0, value_parser = positive)]
    seconds: f64,
    /// A built-in scenario, or the file of another
    #[arg(default_value = "wood_door", value_parser = Scenario::load)]
    scenario: Scenario,
}

fn main() -> Result<(), Failure> {
    let Arguments { seconds, scenario } = Arguments::parse();
    let name = scenario.name.clone();
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("recording.mcap");
    let trial = Trial::plain(scenario);
    try_record(&trial, 1, Some(Duration::from_secs_f64(seconds)), &file)?;
    let (settings, map) = (MotionSettings::default(), TopicMap::default());

    let (recording, reading) = timed(SHORT, || Recording::load(&file, &map))?;
    let (samples, shared) = timed(SHORT, || joint_samples(&recording, &settings))?;
    let (_, splines) = timed(SHORT, || {
        let motion = Motion::prepare(&samples, &settings)?;
        fit_base(&motion)?;
        fit_with_mechanism(&motion, &[&RigidBody])
    })?;
    let mut lap = vec![
        ("ours, reading the file", reading),
        ("ours, I mu b and spline", shared + splines),
    ];
    let training = Training {
        patience: Training::default().epochs,
        ..Training::default()
    };
    let paper = PaperSettings {
        training: Some(training),
        ..PaperSettings::default()
    };
    let (fit, network) = timed(1, || identify(&samples, &paper))?;
    lap.push(("ours, the paper's estimator and network", shared + network));
    let (_, whole) = timed(1, || {
        identify_recording(&file, &map, &settings, &mut |_| {})
    })?;
    lap.push(("ours, all of ft-identify: effects, null, joint fit", whole));

    write_streams(folder.path(), &recording)?;
    let own = python(folder.path(), &training, None)?;
    let all = std::thread::available_parallelism()?.get();
    let mut peers = vec![own];
    if peers[0].threads != all {
        peers.push(python(folder.path(), &training, Some(all))?);
    }
    let epochs = fit.mechanism.as_ref().map_or(0, |m| m.epochs);
    println!(
        "simulated {name}, {seconds} s; {} samples, {epochs} epochs in ours, {} samples, {} epochs in Python\n",
        fit.samples, peers[0].samples, peers[0].epochs
    );
    let mut head = "| pipeline | s |".to_owned();
    let mut rule = "|---|---|".to_owned();
    for (peer, chosen) in peers.iter().zip(["its own choice", "all processors"]) {
        write!(head, " Python on {} ({chosen}) / it |", peer.threads)?;
        rule += "---|";
    }
    println!("{head}\n{rule}");
    let row = |name: &str, time: f64| {
        let ratios = peers
            .iter()
            .map(|peer| format!(" {:.1} |", peer.seconds / time));
        println!("| {name} | {time:.3} |{}", ratios.collect::<String>());
    };
    for peer in &peers {
        let name = format!("Python, PyTorch on {}: {}", peer.threads, peer.steps);
        row(&name, peer.seconds);
    }
    for (name, time) in lap {
        row(name, time.as_secs_f64());
    }
    Ok(())
}

/// What `work` gives, and the median time of so many `times`.
#[allow(clippy::disallowed_methods, reason = "a stopwatch")]
fn timed<T, E>(times: usize, work: impl Fn() -> Result<T, E>) -> Result<(T, Duration), E> {
    let mut each = Vec::new();
    loop {
        let started = Instant::now();
        let done = work()?;
        each.push(started.elapsed());
        if each.len() >= times {
            each.sort();
            return Ok((done, each[each.len() / 2]));
        }
    }
}

/// A run of the pipeline in Python.
struct Peer {
    /// PyTorch's.
    threads: usize,
    samples: u64,
    epochs: u64,
    /// Of all steps but reading.
    seconds: f64,
    /// The seconds of each.
    steps: String,
}

/// Runs it on the streams in a folder; PyTorch on so many `threads`, or as many as it chooses.
fn python(folder: &Path, training: &Training, threads: Option<usize>) -> Result<Peer, Failure> {
    let script = ft_tests::workspace_root().join("tests/peers/paper_pipeline.py");
    let mut command = std::process::Command::new("/usr/bin/python3");
    command.arg(script).arg(folder);
    command.args(["--patience", &training.epochs.to_string()]);
    if let Some(threads) = threads {
        command.args(["--threads", &threads.to_string()]);
    }
    let output = command.output()?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        return Err(format!(
            "the Python pipeline failed (apt install python3-scipy python3-torch):\n{text}"
        )
        .into());
    }
    let said: serde_json::Value = serde_json::from_slice(&output.stdout)?;
    let count = |name: &str| said[name].as_u64().ok_or("a number is missing from Python");
    let steps = said["seconds"].as_object().ok_or("no times from Python")?;
    Ok(Peer {
        threads: usize::try_from(count("threads")?)?,
        samples: count("samples")?,
        epochs: count("epochs")?,
        seconds: steps
            .iter()
            .filter(|(name, _)| *name != "read")
            .filter_map(|(_, value)| value.as_f64())
            .sum(),
        steps: join(steps),
    })
}

fn join(steps: &serde_json::Map<String, serde_json::Value>) -> String {
    let text = |(name, value): (&String, &serde_json::Value)| {
        format!("{name} {:.2}", value.as_f64().unwrap_or(f64::NAN))
    };
    steps.iter().map(text).collect::<Vec<_>>().join(", ")
}

fn isometry(pose: &Pose7) -> Isometry3<f64> {
    let [x, y, z, w] = pose.quaternion;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(pose.position), turn)
}

/// What the Python pipeline reads.
fn write_streams(folder: &Path, recording: &Recording) -> Result<(), Failure> {
    let tracked_from_tcp = match recording.pose.frame {
        TrackedFrame::Tcp => Isometry3::identity(),
        TrackedFrame::AriaDevice => isometry(&recording.aria_device_from_tcp),
    };
    let start = recording.wrench.first().ok_or("no wrench")?.at;
    let mut wrench = std::io::BufWriter::new(std::fs::File::create(folder.join("wrench.f64"))?);
    for sample in &recording.wrench {
        for value in std::iter::once(sample.at.seconds_since(start)).chain(sample.value) {
            wrench.write_all(&value.to_le_bytes())?;
        }
    }
    let mut pose = std::io::BufWriter::new(std::fs::File::create(folder.join("pose.f64"))?);
    for sample in &recording.pose.samples {
        let tcp = isometry(&sample.value) * tracked_from_tcp;
        let position: [f64; 3] = tcp.translation.vector.into();
        let values = position
            .into_iter()
            .chain(tcp.rotation.coords.iter().copied());
        for value in std::iter::once(sample.at.seconds_since(start)).chain(values) {
            pose.write_all(&value.to_le_bytes())?;
        }
    }
    let marks: Vec<(f64, &str)> = recording
        .marks
        .iter()
        .map(|mark| (mark.at.seconds_since(start), mark.value.as_str()))
        .collect();
    let mounted = recording.tcp_from_ft_sensor;
    let place: Vec<f64> = mounted
        .position
        .into_iter()
        .chain(mounted.quaternion)
        .collect();
    let meta = serde_json::json!({"marks": marks, "tcp_from_ft_sensor": place});
    std::fs::write(folder.join("meta.json"), meta.to_string())?;
    Ok(())
}
