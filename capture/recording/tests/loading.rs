//! What identification gets from recordings, its own and other people's, and how each that cannot be used is refused.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use ft_recording::message::{
    Header, Imu, JointState, Message, PoseStamped, TFMessage, Text, WrenchStamped,
};
use ft_recording::qos::Qos;
use ft_recording::recording::{Recording, TopicMap, TrackedFrame};
use ft_recording::writer::{Compression, MessageStamps, RecordingWriter, WriterOptions};
use ft_recording::{Pose7, ReadError};
use mcap::records::MessageHeader;
use tempfile::TempDir;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{Numbers, at, calibration, gripper, pose, transforms, wrench, write_recording};

/// A recording under construction.
struct Draft {
    folder: TempDir,
    writer: RecordingWriter,
    channels: BTreeMap<String, ft_recording::ChannelId>,
}

impl Draft {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let writer =
            RecordingWriter::create(&folder.path().join("a.mcap"), &WriterOptions::default())
                .unwrap();
        Self {
            folder,
            writer,
            channels: BTreeMap::new(),
        }
    }

    fn write<M: Message>(&mut self, topic: &str, message: &M) -> &mut Self {
        let channel = *self
            .channels
            .entry(topic.to_owned())
            .or_insert_with(|| self.writer.add_channel::<M>(topic, Qos::SENSOR).unwrap());
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        let stamps = MessageStamps {
            log_time: at(0),
            publish_time: at(0),
        };
        self.writer.write(channel, stamps, &bytes).unwrap();
        self
    }

    /// One wrench and one pose, which is the least that can be used.
    fn least(&mut self) -> &mut Self {
        self.write("/ft/wrench", &wrench(0, &mut Numbers(1)))
            .write("/aria/pose", &pose(0, &mut Numbers(1)))
    }

    fn load(self, map: &[&str]) -> Result<Recording, ReadError> {
        let Self { folder, writer, .. } = self;
        let path = writer.finish().unwrap().path;
        let loaded = Recording::load(
            &path,
            &TopicMap::from_arguments(map.iter().copied()).unwrap(),
        );
        drop(folder);
        loaded
    }

    fn refusal(self, map: &[&str]) -> String {
        let message = self.load(map).unwrap_err().to_string();
        let start = message.find("a.mcap").unwrap();
        message[start..].to_owned()
    }
}

#[test]
fn a_recording_is_loaded_with_all_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, Compression::Zstd, 1000);
    let recording = Recording::load(&path, &TopicMap::default()).unwrap();
    let mut numbers = Numbers(7);
    for (millisecond, (wrench_sample, pose_sample)) in recording
        .wrench
        .iter()
        .zip(&recording.pose.samples)
        .enumerate()
    {
        let millisecond = millisecond as i64;
        assert_eq!(wrench_sample.at, at(millisecond));
        assert_eq!(
            wrench_sample.value,
            <[f64; 6]>::from(wrench(millisecond, &mut numbers).wrench)
        );
        let expected = pose(millisecond, &mut numbers).pose;
        assert_eq!(
            (pose_sample.at, pose_sample.value.position),
            (at(millisecond), expected.position.into())
        );
        let expected: [f64; 4] = expected.orientation.into();
        for (got, expected) in pose_sample.value.quaternion.iter().zip(expected) {
            assert!((got - expected).abs() < 1e-15);
        }
    }
    assert_eq!(
        (recording.wrench.len(), recording.pose.samples.len()),
        (1000, 1000)
    );
    assert_eq!(recording.pose.frame, TrackedFrame::AriaDevice);
    assert_eq!(
        (
            recording.gripper_width.len(),
            recording.gripper_width[3].value
        ),
        (100, 0.04)
    );
    assert_eq!(
        (recording.temperature.len(), recording.temperature[3].value),
        (10, 31.5)
    );
    assert_eq!(recording.aria_device_from_tcp.position, [0.0, 0.05, 0.3]);
    assert_eq!(recording.tcp_from_ft_sensor.position, [0.0, 0.0, -0.12]);
    assert_eq!(
        (recording.marks.len(), recording.marks[0].value.as_str()),
        (1, "free_air_begin")
    );
    assert_eq!(recording.marks[0].at, at(0));
    assert_eq!(recording.calibration, Some(calibration()));
    assert_eq!(recording.session["version"], "0.1.0");
    assert_eq!(recording.health.truncated, None);
    assert_eq!(recording.health.topics["/raw/ft_sensor"].messages, 1000);
}

#[test]
fn the_hash_is_the_files_sha256() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, Compression::None, 10);
    let recording = Recording::load(&path, &TopicMap::default()).unwrap();
    let sha256sum = std::process::Command::new("sha256sum").arg(&path).output();
    let Ok(output) = sha256sum else {
        let _ = writeln!(std::io::stderr(), "skipped: no sha256sum here");
        return;
    };
    assert!(
        String::from_utf8(output.stdout)
            .unwrap()
            .starts_with(&recording.sha256)
    );
    assert_eq!(recording.sha256.len(), 64);
}

#[test]
fn late_repeated_and_unusable_messages_are_sorted_out_and_counted() {
    let mut draft = Draft::new();
    let mut numbers = Numbers(5);
    let samples: Vec<_> = (0..5)
        .map(|millisecond| wrench(millisecond, &mut numbers))
        .collect();
    for index in [0, 1, 3, 2, 2, 4] {
        draft.write("/ft/wrench", &samples[index]);
    }
    let mut not_finite = samples[4].clone();
    not_finite.wrench.torque.z = f64::NAN;
    draft.write("/ft/wrench", &not_finite);
    let mut no_rotation = pose(1, &mut numbers);
    no_rotation.pose.orientation = [0.0; 4].into();
    draft
        .write("/tcp/pose", &pose(0, &mut numbers))
        .write("/tcp/pose", &no_rotation);
    let recording = draft.load(&[]).unwrap();
    let stamps: Vec<_> = recording.wrench.iter().map(|sample| sample.at).collect();
    assert_eq!(stamps, [at(0), at(1), at(2), at(3), at(4)]);
    let health = &recording.health.topics["/ft/wrench"];
    assert_eq!(
        (health.messages, health.out_of_order, health.duplicates),
        (7, 2, 1)
    );
    assert_eq!(
        (
            health.non_finite,
            health.undecodable,
            health.repeated_stamps
        ),
        (1, 0, 0)
    );
    assert_eq!(recording.health.topics["/tcp/pose"].non_finite, 1);
    assert_eq!(recording.pose.samples.len(), 1);
}

#[test]
fn a_tracked_tcp_is_preferred_to_the_glasses() {
    let mut draft = Draft::new();
    draft.least().write("/tcp/pose", &pose(5, &mut Numbers(2)));
    let recording = draft.load(&[]).unwrap();
    assert_eq!(
        (recording.pose.frame, recording.pose.samples[0].at),
        (TrackedFrame::Tcp, at(5))
    );
}

#[test]
fn frames_coincide_when_nothing_is_said_about_them() {
    let mut draft = Draft::new();
    draft.least();
    let recording = draft.load(&[]).unwrap();
    assert_eq!(recording.aria_device_from_tcp, Pose7::IDENTITY);
    assert_eq!(recording.tcp_from_ft_sensor, Pose7::IDENTITY);
    assert_eq!((recording.calibration, recording.marks.len()), (None, 0));
}

#[test]
fn a_transform_given_the_other_way_round_is_turned_round() {
    let mut draft = Draft::new();
    let mut transform = transforms().transforms.remove(1);
    transform.header.frame_id = "ft_sensor".to_owned();
    transform.child_frame_id = "tcp".to_owned();
    draft.least().write(
        "/tf_static",
        &TFMessage {
            transforms: vec![transform],
        },
    );
    assert_eq!(
        draft.load(&[]).unwrap().tcp_from_ft_sensor.position,
        [0.0, 0.0, 0.12]
    );
}

#[test]
fn other_names_are_mapped() {
    let mut draft = Draft::new();
    draft
        .write("/wrist/ft", &wrench(0, &mut Numbers(1)))
        .write("/vive/gripper", &pose(0, &mut Numbers(1)));
    let mut jaw = gripper(0, 0.03);
    jaw.name = vec!["jaw".to_owned()];
    draft.write("/jaw", &jaw);
    let map = [
        "/wrist/ft=/ft/wrench",
        "/vive/gripper=/tcp/pose",
        "/jaw=/gripper/joint_states",
    ];
    let recording = draft.load(&map).unwrap();
    assert_eq!(
        (recording.wrench.len(), recording.pose.frame),
        (1, TrackedFrame::Tcp)
    );
    assert_eq!(recording.gripper_width[0].value, 0.03);
}

#[test]
fn a_missing_wrench_names_what_is_there_and_how_to_map_it() {
    let mut draft = Draft::new();
    draft
        .write("/wrist/ft", &wrench(0, &mut Numbers(1)))
        .write("/aria/pose", &pose(0, &mut Numbers(1)));
    assert_eq!(
        draft.refusal(&[]),
        "a.mcap has no /ft/wrench (geometry_msgs/msg/WrenchStamped); it has /aria/pose \
         (geometry_msgs/msg/PoseStamped, 1 messages), /wrist/ft (geometry_msgs/msg/WrenchStamped, 1 messages). \
         If one of them carries it under another name, pass --map /its/name=/ft/wrench"
    );
}

#[test]
fn a_missing_pose_is_said_to_be_missing() {
    let mut draft = Draft::new();
    draft.write("/ft/wrench", &wrench(0, &mut Numbers(1)));
    let message = draft.refusal(&[]);
    assert!(
        message.starts_with(
            "a.mcap has no /tcp/pose and no /aria/pose (geometry_msgs/msg/PoseStamped);"
        )
    );
    assert!(message.ends_with("--map /its/name=/tcp/pose"), "{message}");
}

#[test]
fn a_mapped_topic_that_is_not_there_is_named() {
    let mut draft = Draft::new();
    draft.least();
    let message = draft.refusal(&["/wrist/ft=/ft/wrench"]);
    assert!(
        message.starts_with("a.mcap has no /wrist/ft, which --map names; it has /aria/pose"),
        "{message}"
    );
}

#[test]
fn a_topic_of_another_type_is_refused_with_both_types() {
    let mut draft = Draft::new();
    draft
        .write(
            "/ft/wrench",
            &Text {
                data: "heavy".to_owned(),
            },
        )
        .write("/aria/pose", &pose(0, &mut Numbers(1)));
    assert_eq!(
        draft.refusal(&[]),
        "a.mcap: /ft/wrench is of type std_msgs/msg/String, expected geometry_msgs/msg/WrenchStamped"
    );
}

#[test]
fn a_wrench_without_a_single_number_is_refused() {
    let mut draft = Draft::new();
    let not_a_number = WrenchStamped {
        header: Header::new(at(0), ""),
        wrench: [f64::NAN; 6].into(),
    };
    draft
        .write("/ft/wrench", &not_a_number)
        .write("/aria/pose", &pose(0, &mut Numbers(1)));
    assert_eq!(
        draft.refusal(&[]),
        "a.mcap: none of the 1 messages on /ft/wrench can be used (0 undecodable, 1 not finite)"
    );
}

#[test]
fn a_wrong_calibration_is_refused_with_its_reason() {
    let mut draft = Draft::new();
    draft.least();
    let entries = BTreeMap::from([("json".to_owned(), "{\"mass\": 1}".to_owned())]);
    draft
        .writer
        .write_metadata("ft.calibration", &entries)
        .unwrap();
    let message = draft.refusal(&[]);
    assert!(
        message
            .starts_with("a.mcap: metadata ft.calibration: unknown field `mass`, expected one of"),
        "{message}"
    );
}

/// A file of the bare `mcap` crate with one channel.
fn foreign(folder: &Path, topic: &str, encoding: &str, schema: &str, payload: &[u8]) -> PathBuf {
    let path = folder.join("a.mcap");
    let mut writer = mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    let schema = writer.add_schema(schema, "any", b"any").unwrap();
    let channel_id = writer
        .add_channel(schema, topic, encoding, &BTreeMap::new())
        .unwrap();
    let header = MessageHeader {
        channel_id,
        sequence: 0,
        log_time: 0,
        publish_time: 0,
    };
    writer.write_to_known_channel(&header, payload).unwrap();
    writer.finish().unwrap();
    path
}

#[test]
fn foreign_encodings_are_named() {
    let folder = tempfile::tempdir().unwrap();
    for encoding in ["ros1", "json", "protobuf"] {
        let path = foreign(
            folder.path(),
            "/ft/wrench",
            encoding,
            "geometry_msgs/WrenchStamped",
            b"{}",
        );
        let message = Recording::load(&path, &TopicMap::default())
            .unwrap_err()
            .to_string();
        let expected = format!(
            "/ft/wrench is encoded as \"{encoding}\", only \"cdr\" (ROS 2) is read: convert the recording first"
        );
        assert!(message.ends_with(&expected), "{message}");
    }
}

#[test]
fn bytes_that_are_no_wrench_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = foreign(
        folder.path(),
        "/ft/wrench",
        "cdr",
        WrenchStamped::TYPE_NAME,
        b"\0\x01\0\0short",
    );
    let message = Recording::load(&path, &TopicMap::default())
        .unwrap_err()
        .to_string();
    assert!(message.ends_with(
        "none of the 1 messages on /ft/wrench can be used (1 undecodable, 0 not finite)"
    ));
}

#[test]
fn files_that_are_no_recordings_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    for (bytes, expected) in [
        (&b""[..], "nothing (it is empty)"),
        (b"#ROSBAG V2.0\n", "a ROS 1 bag"),
        (b"SQLite format 3\0...", "a rosbag2 SQLite file"),
        (
            b"version https://git-lfs.github.com/spec/v1",
            "a Git LFS pointer",
        ),
        (
            b"time,force\n",
            "it begins with \"time,force\\n\", not with",
        ),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = Recording::load(&path, &TopicMap::default()).unwrap_err();
        assert!(matches!(error, ReadError::NotMcap { .. }));
        assert!(error.to_string().contains(expected), "{error}");
    }
    let error = Recording::load(&folder.path().join("b.mcap"), &TopicMap::default()).unwrap_err();
    assert!(error.to_string().starts_with("cannot open "), "{error}");
}

#[test]
fn a_file_that_was_cut_before_its_first_message_says_that_it_was_cut() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, Compression::Zstd, 10);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..200]).unwrap();
    let message = Recording::load(&path, &TopicMap::default())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("it has no topics at all (the file is damaged: at byte "),
        "{message}"
    );
}

#[test]
fn a_joint_state_without_the_gripper_is_no_width() {
    let mut draft = Draft::new();
    let names = vec!["left".to_owned(), "right".to_owned()];
    let two = JointState {
        name: names,
        position: vec![1.0, 2.0],
        ..JointState::default()
    };
    draft
        .least()
        .write("/gripper/joint_states", &two)
        .write("/gripper/joint_states", &gripper(0, 0.05));
    let recording = draft.load(&[]).unwrap();
    assert_eq!(recording.gripper_width.len(), 1);
    assert_eq!(
        recording.health.topics["/gripper/joint_states"].non_finite,
        1
    );
}

#[test]
fn an_unused_topic_of_any_kind_does_no_harm() {
    let mut draft = Draft::new();
    draft
        .least()
        .write("/marks", &PoseStamped::default())
        .write("/whatever", &Text::default());
    let recording = draft.load(&[]).unwrap();
    assert_eq!(
        (
            recording.marks.len(),
            recording.health.topics["/marks"].messages
        ),
        (0, 1)
    );
}

#[test]
fn angular_rates_are_read_by_a_map_where_they_are_measured() {
    let imu = |milliseconds: i64, rate: f64| {
        Imu::of_rate(Header::new(at(milliseconds), "imu"), [rate, 0.0, -1.0])
    };
    let mut silent = imu(5, 1.0);
    silent.angular_velocity_covariance[0] = -1.0;
    let mut draft = Draft::new();
    draft
        .least()
        .write("/imu/data", &imu(20, 2.0))
        .write("/imu/data", &imu(10, 1.0))
        .write("/imu/data", &imu(30, f64::NAN))
        .write("/imu/data", &silent);
    let recording = draft.load(&["/imu/data=/ft/imu"]).unwrap();
    let rates: Vec<_> = recording
        .angular_rate
        .iter()
        .map(|sample| (sample.at, sample.value))
        .collect();
    assert_eq!(
        rates,
        [(at(10), [1.0, 0.0, -1.0]), (at(20), [2.0, 0.0, -1.0])]
    );
    assert_eq!(recording.health.topics["/imu/data"].non_finite, 2);

    let mut draft = Draft::new();
    draft.least().write("/imu/data", &imu(20, 2.0));
    assert!(draft.load(&[]).unwrap().angular_rate.is_empty());
}
