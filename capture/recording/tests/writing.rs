//! The writer keeps what it is given, under the name it promises, and says what is in the way.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fs;
use std::time::Duration;

use ft_recording::message::{Message, PoseStamped, Text, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::reader::{Record, RecordReader};
use ft_recording::writer::{
    Compression, MessageStamps, RecordingWriter, WriteError, WriterOptions, partial_path,
};
use ft_wire::HostTime;
use proptest::collection::vec;
use proptest::prelude::*;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{at, options, read_messages};

fn now(milliseconds: i64) -> MessageStamps {
    MessageStamps {
        log_time: at(milliseconds),
        publish_time: at(milliseconds),
    }
}

#[test]
fn the_file_has_its_name_only_when_it_is_finished() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    let channel = writer.add_raw_channel("/raw/x").unwrap();
    writer.write(channel, now(0), b"frame").unwrap();
    assert!(!path.exists() && partial_path(&path).exists());
    let finished = writer.finish().unwrap();
    assert!(path.exists() && !partial_path(&path).exists());
    assert_eq!(finished.bytes, fs::metadata(&path).unwrap().len());
    assert_eq!(
        finished.messages,
        BTreeMap::from([("/raw/x".to_owned(), 1)])
    );
    assert_eq!(finished.path, path);
}

#[test]
fn an_existing_file_is_replaced_only_when_asked_and_only_at_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(&path, "precious").unwrap();
    let refused = RecordingWriter::create(&path, &WriterOptions::default()).unwrap_err();
    assert!(matches!(refused, WriteError::Exists { .. }));
    assert!(
        refused
            .to_string()
            .ends_with("exists already: choose another name, or allow overwriting with --force")
    );
    let force = WriterOptions {
        overwrite: true,
        ..WriterOptions::default()
    };
    let writer = RecordingWriter::create(&path, &force).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"precious");
    writer.finish().unwrap();
    assert!(fs::read(&path).unwrap().starts_with(b"\x89MCAP0\r\n"));
}

#[test]
fn the_leftover_of_a_crash_is_not_overwritten_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(
        partial_path(&path),
        "leftover, and longer than what replaces it".repeat(1000),
    )
    .unwrap();
    let refused = RecordingWriter::create(&path, &WriterOptions::default()).unwrap_err();
    assert!(matches!(refused, WriteError::Leftover { .. }));
    assert!(
        refused.to_string().contains("ft-capture recover"),
        "{refused}"
    );
    let force = WriterOptions {
        overwrite: true,
        ..WriterOptions::default()
    };
    RecordingWriter::create(&path, &force)
        .unwrap()
        .finish()
        .unwrap();
    assert_eq!(
        read_messages(&fs::read(&path).unwrap()).1,
        Vec::<String>::new()
    );
}

#[test]
fn two_writers_of_one_recording_are_one_too_many() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let force = WriterOptions {
        overwrite: true,
        ..WriterOptions::default()
    };
    let first = RecordingWriter::create(&path, &force).unwrap();
    assert!(matches!(
        RecordingWriter::create(&path, &force),
        Err(WriteError::Busy { .. })
    ));
    first.finish().unwrap();
}

#[test]
fn a_name_taken_meanwhile_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    fs::write(&path, "precious").unwrap();
    assert!(matches!(writer.finish(), Err(WriteError::Exists { .. })));
    assert_eq!(fs::read(&path).unwrap(), b"precious");
    assert!(partial_path(&path).exists());
}

#[test]
fn a_folder_that_is_not_there_is_named() {
    let error =
        RecordingWriter::create("/no/such/folder/a.mcap".as_ref(), &WriterOptions::default())
            .unwrap_err();
    assert!(
        error
            .to_string()
            .starts_with("cannot create /no/such/folder/a.mcap.partial: No such file"),
        "{error}"
    );
}

#[test]
fn wrong_use_is_refused_and_harms_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    let mut other =
        RecordingWriter::create(&folder.path().join("b.mcap"), &WriterOptions::default()).unwrap();
    let channel = other.add_raw_channel("/raw/x").unwrap();
    let unknown = writer.write(channel, now(0), b"").unwrap_err();
    assert_eq!(
        unknown.to_string(),
        "channel 0 is not one of the 0 of this recording"
    );
    let channel = writer.add_channel::<Text>("/marks", Qos::RELIABLE).unwrap();
    let twice = writer
        .add_channel::<Text>("/marks", Qos::RELIABLE)
        .unwrap_err();
    assert_eq!(twice.to_string(), "topic /marks has a channel already");
    let ancient = MessageStamps {
        log_time: HostTime::from_nanos(-1),
        publish_time: HostTime::EPOCH,
    };
    assert!(matches!(
        writer.write(channel, ancient, b""),
        Err(WriteError::BeforeEpoch { nanos: -1 })
    ));
    writer
        .write(channel, now(0), &[0, 1, 0, 0, 1, 0, 0, 0, 0])
        .unwrap();
    assert_eq!(
        writer.finish().unwrap().messages,
        BTreeMap::from([("/marks".to_owned(), 1)])
    );
}

#[test]
fn a_flush_is_due_after_its_period_and_needs_no_new_message() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let period = WriterOptions {
        flush_period: Duration::from_millis(100),
        ..WriterOptions::default()
    };
    let mut writer = RecordingWriter::create(&path, &period).unwrap();
    let channel = writer.add_raw_channel("/raw/x").unwrap();
    writer.flush_if_due(at(0)).unwrap();
    writer.write(channel, now(0), b"frame").unwrap();
    let count = || {
        read_messages(&fs::read(partial_path(&path)).unwrap())
            .0
            .len()
    };
    writer.flush_if_due(at(99)).unwrap();
    assert_eq!(count(), 0);
    writer.flush_if_due(at(100)).unwrap();
    assert_eq!(count(), 1);
    let size = writer.bytes_written();
    writer.flush_if_due(at(300)).unwrap();
    assert_eq!(writer.bytes_written(), size);
    writer.write(channel, now(301), b"frame").unwrap();
    writer.flush_if_due(at(399)).unwrap();
    assert_eq!(count(), 1);
    writer.flush_if_due(at(400)).unwrap();
    assert_eq!(count(), 2);
    assert_eq!(
        writer.bytes_written(),
        fs::metadata(partial_path(&path)).unwrap().len()
    );
    writer.sync_handle().unwrap().sync_data().unwrap();
}

#[test]
fn a_writer_that_is_dropped_leaves_its_data() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    let channel = writer.add_raw_channel("/raw/x").unwrap();
    writer.write(channel, now(0), b"frame").unwrap();
    drop(writer);
    assert!(!path.exists());
    let (messages, damage) = read_messages(&fs::read(partial_path(&path)).unwrap());
    assert_eq!((messages.len(), damage), (1, Vec::new()));
}

#[test]
fn the_header_and_the_channels_say_what_ros_tools_want_to_know() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &options(Compression::None)).unwrap();
    writer
        .add_channel::<PoseStamped>("/aria/pose", Qos::SENSOR)
        .unwrap();
    writer.add_raw_channel("/raw/x").unwrap();
    writer.finish().unwrap();
    let mut reader = RecordReader::open(&path).unwrap();
    let mut seen = 0;
    while let Some(record) = reader.next_record().unwrap() {
        match record {
            Record::Header { profile, library } => {
                assert_eq!(profile, "ros2");
                assert!(library.starts_with("ft-capture "));
            }
            Record::Schema(schema) => {
                assert_eq!(
                    (schema.name.as_str(), schema.encoding.as_str()),
                    (PoseStamped::TYPE_NAME, "ros2msg")
                );
                assert_eq!(schema.data, PoseStamped::DEFINITION.as_bytes());
            }
            Record::Channel(channel) if channel.topic == "/aria/pose" => {
                assert_eq!(channel.message_encoding, "cdr");
                assert_eq!(channel.metadata["topic_type_hash"], PoseStamped::TYPE_HASH);
                let qos = &channel.metadata["offered_qos_profiles"];
                assert!(
                    qos.starts_with(
                        "- history: keep_last\n  depth: 10\n  reliability: best_effort\n"
                    ),
                    "{qos}"
                );
                seen += 1;
            }
            Record::Channel(channel) => {
                assert_eq!(
                    (channel.schema_id, channel.message_encoding.as_str()),
                    (0, "application/octet-stream")
                );
                seen += 1;
            }
            _ => {}
        }
    }
    assert_eq!(seen, 4, "each channel in the data and again in the summary");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn messages_come_back_in_the_order_they_were_given(
        messages in vec((0..3_usize, 0..2000_i64, -50..50_i64, vec(any::<u8>(), 0..300)), 0..200),
        packed in any::<bool>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        let compression = if packed { Compression::Zstd } else { Compression::None };
        let chunk_bytes = 5000;
        let how = WriterOptions { chunk_bytes, ..options(compression) };
        let mut writer = RecordingWriter::create(&path, &how).unwrap();
        let channels = [
            writer.add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR).unwrap(),
            writer.add_raw_channel("/raw/a").unwrap(),
            writer.add_raw_channel("/raw/b").unwrap(),
        ];
        let mut expected = Vec::new();
        let mut sequences = [0; 3];
        for (channel, log, before, payload) in &messages {
            let stamps = MessageStamps { log_time: at(*log), publish_time: at(log + before) };
            writer.write(channels[*channel], stamps, payload).unwrap();
            writer.flush_if_due(at(*log)).unwrap();
            sequences[*channel] += 1;
            expected.push((sequences[*channel], at(*log).as_nanos() as u64, payload.clone()));
        }
        writer.finish().unwrap();
        let (read, damage) = read_messages(&fs::read(&path).unwrap());
        prop_assert_eq!(damage, Vec::<String>::new());
        let read: Vec<_> = read.into_iter().map(|kept| (kept.sequence, kept.log_time, kept.data)).collect();
        prop_assert_eq!(read, expected);
    }
}
