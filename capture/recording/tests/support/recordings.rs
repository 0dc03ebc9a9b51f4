//! Recordings for tests: small, the same every time.
#![allow(dead_code, reason = "each test file uses a part of it")]
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use ft_recording::message::{
    DiagnosticArray, DiagnosticStatus, Header, JointState, KeyValue, Message, Pose, PoseStamped,
    TFMessage, Temperature, Text, TransformStamped, WrenchStamped,
};
use ft_recording::qos::Qos;
use ft_recording::reader::{Record, RecordReader};
use ft_recording::writer::{Compression, MessageStamps, RecordingWriter, WriterOptions};
use ft_recording::{Calibration, Estimate};
use ft_wire::HostTime;

/// The first stamp of every recording made here.
pub(crate) const START: HostTime = HostTime::from_nanos(1_700_000_000_000_000_000);
const MILLISECOND: i64 = 1_000_000;

/// A generator of numbers that look random (splitmix64); the same for the same seed.
pub(crate) struct Numbers(pub(crate) u64);

impl Numbers {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In 0..end.
    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    /// In -1..1.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

pub(crate) fn at(milliseconds: i64) -> HostTime {
    HostTime::from_nanos(START.as_nanos() + milliseconds * MILLISECOND)
}

pub(crate) fn wrench(milliseconds: i64, numbers: &mut Numbers) -> WrenchStamped {
    let components = [(); 6].map(|()| (numbers.unit() * 1e4).round() / 1e3);
    WrenchStamped {
        header: Header::new(at(milliseconds), "ft_sensor"),
        wrench: components.into(),
    }
}

pub(crate) fn pose(milliseconds: i64, numbers: &mut Numbers) -> PoseStamped {
    let position = [(); 3].map(|()| numbers.unit());
    let [x, y, z, w] = [(); 4].map(|()| numbers.unit());
    let length = (x * x + y * y + z * z + w * w).sqrt();
    let orientation = [x, y, z, w].map(|component| component / length);
    PoseStamped {
        header: Header::new(at(milliseconds), "world"),
        pose: Pose {
            position: position.into(),
            orientation: orientation.into(),
        },
    }
}

pub(crate) fn gripper(milliseconds: i64, width: f64) -> JointState {
    JointState {
        header: Header::new(at(milliseconds), ""),
        name: vec!["gripper_width".to_owned()],
        position: vec![width],
        velocity: vec![0.0],
        effort: Vec::new(),
    }
}

pub(crate) fn transforms() -> TFMessage {
    let transform = |parent: &str, child: &str, translation: [f64; 3]| {
        let mut transform = TransformStamped {
            header: Header::new(START, parent),
            child_frame_id: child.to_owned(),
            ..TransformStamped::default()
        };
        transform.transform.translation = translation.into();
        transform.transform.rotation = [0.0, 0.0, 0.0, 1.0].into();
        transform
    };
    TFMessage {
        transforms: vec![
            transform("aria_device", "tcp", [0.0, 0.05, 0.3]),
            transform("tcp", "ft_sensor", [0.0, 0.0, -0.12]),
        ],
    }
}

pub(crate) fn diagnostics(milliseconds: i64) -> DiagnosticArray {
    DiagnosticArray {
        header: Header::new(at(milliseconds), ""),
        status: vec![DiagnosticStatus {
            level: DiagnosticStatus::OK,
            name: "ft_sensor".to_owned(),
            message: "streaming".to_owned(),
            hardware_id: "0001".to_owned(),
            values: vec![KeyValue {
                key: "gaps".to_owned(),
                value: "0".to_owned(),
            }],
        }],
    }
}

pub(crate) fn calibration() -> Calibration {
    Calibration {
        payload_mass_kg: Estimate {
            value: 0.49,
            std: 0.005,
        },
        payload_com_m: Estimate {
            value: [0.021, 0.020, 0.059],
            std: [0.001; 3],
        },
        payload_inertia_kgm2: Estimate {
            value: [1e-3, 0.0, 1e-3, 0.0, 0.0, 5e-4],
            std: [1e-4; 6],
        },
        wrench_bias: None,
        covariance: None,
    }
}

pub(crate) fn options(compression: Compression) -> WriterOptions {
    WriterOptions {
        compression,
        ..WriterOptions::default()
    }
}

/// Writes a recording of every topic, `milliseconds` long, wrench and pose at 1 kHz.
pub(crate) fn write_recording(path: &Path, compression: Compression, milliseconds: i64) {
    let mut writer = RecordingWriter::create(path, &options(compression)).unwrap();
    fill(&mut writer, milliseconds);
    let ledger = r#"{"received":1000,"gaps":0,"drops":0,"refused":0,"duplicated":0}"#;
    writer
        .write_metadata(
            "ft.ledger",
            &BTreeMap::from([("ft_sensor".to_owned(), ledger.to_owned())]),
        )
        .unwrap();
    writer.finish().unwrap();
}

/// The content of [`write_recording`] but for the ledger.
pub(crate) fn fill(writer: &mut RecordingWriter, milliseconds: i64) {
    let mut numbers = Numbers(7);
    let session = BTreeMap::from([("version".to_owned(), "0.1.0".to_owned())]);
    writer.write_metadata("ft.session", &session).unwrap();
    writer
        .write_metadata("ft.calibration", &calibration().to_metadata().unwrap())
        .unwrap();
    let wrench_channel = writer
        .add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR)
        .unwrap();
    let pose_channel = writer
        .add_channel::<PoseStamped>("/aria/pose", Qos::SENSOR)
        .unwrap();
    let gripper_channel = writer
        .add_channel::<JointState>("/gripper/joint_states", Qos::SENSOR)
        .unwrap();
    let temperature_channel = writer
        .add_channel::<Temperature>("/ft/temperature", Qos::SENSOR)
        .unwrap();
    let tf_channel = writer
        .add_channel::<TFMessage>("/tf_static", Qos::LATCHED)
        .unwrap();
    let marks_channel = writer.add_channel::<Text>("/marks", Qos::RELIABLE).unwrap();
    let diagnostics_channel = writer
        .add_channel::<DiagnosticArray>("/diagnostics", Qos::RELIABLE)
        .unwrap();
    let raw_channel = writer.add_raw_channel("/raw/ft_sensor").unwrap();
    let mut buffer = Vec::new();
    for millisecond in 0..milliseconds {
        let publish_time = at(millisecond);
        let stamps = MessageStamps {
            log_time: HostTime::from_nanos(publish_time.as_nanos() + 400_000),
            publish_time,
        };
        let mut write = |channel, bytes: &[u8]| writer.write(channel, stamps, bytes).unwrap();
        if millisecond == 0 {
            transforms().encode(&mut buffer);
            write(tf_channel, &buffer);
            Text {
                data: "free_air_begin".to_owned(),
            }
            .encode(&mut buffer);
            write(marks_channel, &buffer);
        }
        wrench(millisecond, &mut numbers).encode(&mut buffer);
        write(raw_channel, &buffer[4..20]);
        write(wrench_channel, &buffer);
        pose(millisecond, &mut numbers).encode(&mut buffer);
        write(pose_channel, &buffer);
        if millisecond % 10 == 0 {
            gripper(millisecond, 0.04).encode(&mut buffer);
            write(gripper_channel, &buffer);
        }
        if millisecond % 100 == 0 {
            let header = Header::new(publish_time, "ft_sensor");
            Temperature {
                header,
                temperature: 31.5,
                variance: 0.0,
            }
            .encode(&mut buffer);
            write(temperature_channel, &buffer);
            diagnostics(millisecond).encode(&mut buffer);
            write(diagnostics_channel, &buffer);
        }
        writer.flush_if_due(stamps.log_time).unwrap();
    }
}

/// A message with where in the file its chunk (or itself, outside of chunks) ends.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Kept {
    pub(crate) channel_id: u16,
    pub(crate) sequence: u32,
    pub(crate) log_time: u64,
    pub(crate) data: Vec<u8>,
    pub(crate) ends_at: u64,
}

pub(crate) fn reader(bytes: &[u8]) -> RecordReader<Cursor<&[u8]>> {
    RecordReader::new(
        Cursor::new(bytes),
        bytes.len() as u64,
        Path::new("memory.mcap"),
    )
    .unwrap()
}

/// All messages that can be read of a file in memory, and what is wrong with it.
pub(crate) fn read_messages(bytes: &[u8]) -> (Vec<Kept>, Vec<String>) {
    let mut reader = reader(bytes);
    let mut messages = Vec::new();
    loop {
        let message = match reader.next_record().unwrap() {
            None => break,
            Some(Record::Message(message)) => Kept {
                channel_id: message.channel_id,
                sequence: message.sequence,
                log_time: message.log_time,
                data: message.data.to_vec(),
                ends_at: 0,
            },
            Some(_) => continue,
        };
        messages.push(Kept {
            ends_at: reader.good_end(),
            ..message
        });
    }
    (
        messages,
        reader.damage().iter().map(ToString::to_string).collect(),
    )
}

/// Where real data lie, `$FT_DATA` or beside the checkout.
pub(crate) fn data_directory(name: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let directory = std::env::var_os("FT_DATA")
        .map_or_else(beside, PathBuf::from)
        .join(name);
    if directory.is_dir() {
        return Some(directory);
    }
    println!(
        "skipped: {} is not there (set FT_DATA)",
        directory.display()
    );
    None
}
