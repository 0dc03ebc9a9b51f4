//! What is left when the recording process is killed or the disk is full.
//!
//! This program starts itself again as the recorder: `FT_CRASH_CHILD` says which, `FT_CRASH_PATH` where to.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]
#![allow(
    clippy::disallowed_methods,
    reason = "the recorder that is killed runs in real time"
)]

use std::env;
use std::fs::{self, File};
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use ft_recording::message::{JointState, PoseStamped, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::recover::recover;
use ft_recording::writer::{
    ChannelId, Compression, MessageStamps, RecordingWriter, WriteError, WriterOptions, partial_path,
};
use ft_recording::{Message, check};
use ft_wire::HostTime;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{Numbers, gripper, pose, wrench};

const TOPICS: [&str; 3] = ["/ft/wrench", "/aria/pose", "/gripper/joint_states"];
/// The most that a kill may cost of any stream.
const LOSS_LIMIT: f64 = 0.25;
const KILLS: u64 = 6;

fn main() {
    if let Ok(role) = env::var("FT_CRASH_CHILD") {
        let path = env::var_os("FT_CRASH_PATH").unwrap();
        match role.as_str() {
            "real_time" => record_in_real_time(Path::new(&path)),
            _ => record_until_the_disk_is_full(Path::new(&path)),
        }
        return;
    }
    let filter = env::args()
        .skip(1)
        .find(|argument| !argument.starts_with('-'))
        .unwrap_or_default();
    let tests: [(&str, fn()); 2] = [
        (
            "a_kill_costs_at_most_a_quarter_of_a_second",
            a_kill_costs_at_most_a_quarter_of_a_second,
        ),
        (
            "a_full_disk_stops_the_recording_and_keeps_it",
            a_full_disk_stops_the_recording_and_keeps_it,
        ),
    ];
    for (name, test) in tests.into_iter().filter(|(name, _)| name.contains(&filter)) {
        if env::args().any(|argument| argument == "--list") {
            println!("{name}: test");
            continue;
        }
        test();
        println!("test {name} ... ok");
    }
}

fn unix_now() -> HostTime {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    HostTime::from_nanos(i64::try_from(since.as_nanos()).unwrap())
}

fn child(command: &mut Command, role: &str, path: &Path) -> Child {
    command
        .env("FT_CRASH_CHILD", role)
        .env("FT_CRASH_PATH", path)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Three streams, wrench and pose at 1 kHz. The last number and time of each stream stand in the file `progress`.
struct Recorder {
    writer: RecordingWriter,
    channels: [ChannelId; 3],
    numbers: Numbers,
    progress: File,
    buffer: Vec<u8>,
}

impl Recorder {
    fn new(path: &Path, options: &WriterOptions) -> Self {
        let mut writer = RecordingWriter::create(path, options).unwrap();
        let channels = [
            writer
                .add_channel::<WrenchStamped>(TOPICS[0], Qos::SENSOR)
                .unwrap(),
            writer
                .add_channel::<PoseStamped>(TOPICS[1], Qos::SENSOR)
                .unwrap(),
            writer
                .add_channel::<JointState>(TOPICS[2], Qos::SENSOR)
                .unwrap(),
        ];
        let progress = File::create(path.with_extension("progress")).unwrap();
        Self {
            writer,
            channels,
            numbers: Numbers(1),
            progress,
            buffer: Vec::new(),
        }
    }

    fn step(&mut self, step: i64, now: HostTime) -> Result<(), WriteError> {
        let stamps = MessageStamps {
            log_time: now,
            publish_time: now,
        };
        for (index, channel) in self.channels.into_iter().enumerate() {
            match index {
                0 => wrench(step, &mut self.numbers).encode(&mut self.buffer),
                1 => pose(step, &mut self.numbers).encode(&mut self.buffer),
                _ if step % 10 != 0 => continue,
                _ => gripper(step, 0.04).encode(&mut self.buffer),
            }
            self.writer.write(channel, stamps, &self.buffer)?;
            self.progress
                .write_all_at(&now.as_nanos().to_le_bytes(), index as u64 * 8)
                .unwrap();
        }
        self.writer.flush_if_due(now)
    }
}

fn record_in_real_time(path: &Path) {
    let compression = if path.ends_with("packed.mcap") {
        Compression::Zstd
    } else {
        Compression::None
    };
    let mut recorder = Recorder::new(
        path,
        &WriterOptions {
            compression,
            ..WriterOptions::default()
        },
    );
    let start = Instant::now();
    for step in 0.. {
        let due = Duration::from_millis(step);
        sleep(due.saturating_sub(start.elapsed()));
        recorder.step(step as i64, unix_now()).unwrap();
    }
}

fn a_kill_costs_at_most_a_quarter_of_a_second() {
    let folder = tempfile::tempdir().unwrap();
    let mut numbers = Numbers(unix_now().as_nanos() as u64);
    println!("seed {:#x}", numbers.0);
    for round in 0..KILLS {
        let name = if round % 2 == 0 {
            "packed.mcap"
        } else {
            "plain.mcap"
        };
        let path = folder.path().join(name);
        let mut recorder = child(
            &mut Command::new(env::current_exe().unwrap()),
            "real_time",
            &path,
        );
        let lifetime = Duration::from_millis(700 + numbers.below(1300));
        sleep(lifetime);
        recorder.kill().unwrap();
        recorder.wait().unwrap();

        let out = folder.path().join("recovered.mcap");
        let recovered = recover(&partial_path(&path), &out, true).unwrap();
        let progress = fs::read(path.with_extension("progress")).unwrap();
        println!("killed after {} ms:\n{recovered}", lifetime.as_millis());
        for (topic, bytes) in TOPICS.into_iter().zip(progress.chunks(8)) {
            let written = i64::from_le_bytes(bytes.try_into().unwrap());
            let found = &recovered.topics[topic];
            let lost = (written - found.last_ns.unwrap()) as f64 * 1e-9;
            println!("  {topic}: the last {:.0} ms are lost", lost * 1e3);
            assert!(
                (0.0..=LOSS_LIMIT).contains(&lost),
                "more than {LOSS_LIMIT} s"
            );
            assert_eq!(found.missing_sequences, 0, "{topic}");
            assert!(found.messages > 10, "{topic}");
        }
        let report = check::check(&out).unwrap();
        assert!(report.is_complete && report.damage.len() == 1);
        fs::remove_file(partial_path(&path)).unwrap();
    }
}

fn record_until_the_disk_is_full(path: &Path) {
    let mut recorder = Recorder::new(path, &WriterOptions::default());
    let mut flushed = 0;
    for step in 0.. {
        let before = recorder.writer.bytes_written();
        match recorder.step(step, recordings::at(step)) {
            Ok(()) if recorder.writer.bytes_written() > before => flushed = step + 1,
            Ok(()) => {}
            Err(error) => {
                assert!(matches!(error, WriteError::NoSpace { .. }), "{error:?}");
                let again = recorder.step(step, recordings::at(step)).unwrap_err();
                assert!(matches!(again, WriteError::Stopped { .. }), "{again:?}");
                assert!(matches!(
                    recorder.writer.finish(),
                    Err(WriteError::Stopped { .. })
                ));
                println!("{flushed} {error}");
                return;
            }
        }
    }
}

/// The limit of a process's file size stands in for a full disk: the system writes what still fits and then refuses.
fn a_full_disk_stops_the_recording_and_keeps_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut shell = Command::new("sh");
    shell
        .arg("-c")
        .arg("trap '' XFSZ; ulimit -f 150; exec \"$0\"")
        .arg(env::current_exe().unwrap());
    let mut recorder = child(&mut shell, "full_disk", &path);
    let mut said = String::new();
    recorder
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut said)
        .unwrap();
    assert!(recorder.wait().unwrap().success());
    let (flushed, error) = said.trim().split_once(' ').unwrap();
    assert!(
        error.starts_with("no space left while writing ") && error.contains("ft-capture recover"),
        "{error}"
    );
    assert!(!path.exists());
    let recovered = recover(&partial_path(&path), &path, false).unwrap();
    let found = &recovered.topics[TOPICS[0]];
    assert!(
        found.messages >= flushed.parse().unwrap(),
        "{} of {flushed}",
        found.messages
    );
    assert!(found.messages >= 100);
    assert_eq!(found.missing_sequences, 0);
}
