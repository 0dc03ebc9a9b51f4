//! A recording is written anew with something added, left out or stamped otherwise.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use ft_recording::message::{Header, Message, PoseStamped, Text, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::writer::{MessageStamps, RecordingWriter, WriterOptions};
use ft_recording::{Recording, TopicMap, check, metadata};
use ft_wire::HostTime;

#[path = "support/recordings.rs"]
mod recordings;
use recordings::{Numbers, at, pose, wrench};

fn stamps(milliseconds: i64) -> MessageStamps {
    MessageStamps {
        log_time: at(milliseconds),
        publish_time: at(milliseconds),
    }
}

/// Wrench and marks of 100 ms, with numbers 1 to 100 on the wrench but for 50.
fn source(path: &std::path::Path) {
    let mut numbers = Numbers(1);
    let mut writer = RecordingWriter::create(path, &WriterOptions::default()).unwrap();
    let channel = writer
        .add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR)
        .unwrap();
    let marks = writer.add_channel::<Text>("/marks", Qos::RELIABLE).unwrap();
    let raw = writer.add_raw_channel("/raw/ft_sensor").unwrap();
    let mut bytes = Vec::new();
    for k in 0..100 {
        wrench(k, &mut numbers).encode(&mut bytes);
        writer.write(channel, stamps(k), &bytes).unwrap();
        writer.write(raw, stamps(k), &[1, 2, 3]).unwrap();
    }
    let text = Text {
        data: "grasp".to_owned(),
    };
    text.encode(&mut bytes);
    writer.write(marks, stamps(100), &bytes).unwrap();
    let entries = [("version".to_owned(), "1".to_owned())];
    writer
        .write_metadata(metadata::SESSION, &entries.into())
        .unwrap();
    writer.finish().unwrap();
}

fn poses() -> Vec<(MessageStamps, PoseStamped)> {
    let mut numbers = Numbers(2);
    (0..50)
        .map(|k| (stamps(2 * k), pose(2 * k, &mut numbers)))
        .collect()
}

#[test]
fn what_is_added_comes_in_between_and_the_rest_stays_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    source(&from);
    let before = std::fs::read(&from).unwrap();
    let mut rewrite = Rewrite::new();
    rewrite.add("/tcp/pose", Qos::SENSOR, poses());
    let finished = rewrite.write(Some(&from), &to, false).unwrap();
    assert_eq!(finished.messages["/ft/wrench"], 100);
    assert_eq!(finished.messages["/raw/ft_sensor"], 100);
    let report = check::check(&to).unwrap();
    assert!(!report.lost_data(), "{report}");
    assert_eq!(report.topics["/ft/wrench"].missing_sequences, 0);
    let recording = Recording::load(&to, &TopicMap::default()).unwrap();
    assert_eq!(recording.pose.samples.len(), 50);
    assert_eq!(recording.marks.len(), 1);
    assert_eq!(recording.session["version"], "1");
    assert_eq!(std::fs::read(&from).unwrap(), before);
}

#[test]
fn topics_are_left_out_and_metadata_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    source(&from);
    let mut rewrite = Rewrite::new();
    rewrite.leave_out("/marks").leave_out("/raw/ft_sensor");
    rewrite.metadata(
        metadata::SESSION,
        [("version".to_owned(), "2".to_owned())].into(),
    );
    rewrite.add("/tcp/pose", Qos::SENSOR, poses());
    let finished = rewrite.write(Some(&from), &to, false).unwrap();
    assert_eq!(
        finished.messages.keys().collect::<Vec<_>>(),
        ["/ft/wrench", "/tcp/pose"]
    );
    let recording = Recording::load(&to, &TopicMap::default()).unwrap();
    assert_eq!(recording.session["version"], "2");
}

#[test]
fn stamps_are_moved_in_the_message_and_beside_it_and_nothing_is_true_after_it_arrived() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    source(&from);
    let mut rewrite = Rewrite::new();
    rewrite.add("/tcp/pose", Qos::SENSOR, poses());
    rewrite.write(Some(&from), &to, false).unwrap();
    let later = folder.path().join("c.mcap");
    let mut rewrite = Rewrite::new();
    rewrite.restamp(|topic, stamp, arrival| {
        assert!(stamp <= arrival);
        match topic {
            "/tcp/pose" => HostTime::from_nanos(stamp.as_nanos() + 5_000_000),
            _ => stamp,
        }
    });
    rewrite.write(Some(&to), &later, false).unwrap();
    let recording = Recording::load(&later, &TopicMap::default()).unwrap();
    assert_eq!(recording.pose.samples[0].at, at(5));
    assert_eq!(recording.wrench[0].at, at(0));
    let report = check::check(&later).unwrap();
    assert_eq!(report.topics["/tcp/pose"].after_arrival, 0, "{report}");
}

#[test]
fn a_damaged_source_is_refused_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let (from, to) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    source(&from);
    let bytes = std::fs::read(&from).unwrap();
    std::fs::write(&from, &bytes[..bytes.len() / 2]).unwrap();
    let message = Rewrite::new()
        .write(Some(&from), &to, false)
        .unwrap_err()
        .to_string();
    assert!(message.contains("ft-capture recover"), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn the_source_is_never_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let from = folder.path().join("a.mcap");
    source(&from);
    let message = Rewrite::new()
        .write(Some(&from), &from, true)
        .unwrap_err()
        .to_string();
    assert!(message.contains("exists already"), "{message}");
    assert!(Recording::load_without_pose(&from, &TopicMap::default()).is_ok());
}

#[test]
fn a_recording_is_made_of_what_is_added_alone() {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("b.mcap");
    let mut rewrite = Rewrite::new();
    rewrite.add("/tcp/pose", Qos::SENSOR, poses());
    let message = |k: i64| WrenchStamped {
        header: Header::new(at(k), "ft_sensor"),
        ..WrenchStamped::default()
    };
    rewrite.add(
        "/ft/wrench",
        Qos::SENSOR,
        (0..10).map(|k| (stamps(k), message(k))),
    );
    rewrite.write(None, &to, false).unwrap();
    let recording = Recording::load(&to, &TopicMap::default()).unwrap();
    assert_eq!(
        (recording.wrench.len(), recording.pose.samples.len()),
        (10, 50)
    );
}
