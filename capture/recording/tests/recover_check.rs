//! Recovery gives back all that is there and says what is not; the check says what a recording is worth.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fs;

use ft_recording::check::{Presence, Verdict, check};
use ft_recording::message::{PoseStamped, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::reader::{Record, RecordReader};
use ft_recording::recover::recover;
use ft_recording::writer::{
    Compression, MessageStamps, RecordingWriter, WriterOptions, partial_path,
};
use ft_recording::{Message, ReadError, WriteError};
use ft_recording::{Recording, TopicMap};
use mcap::records::MessageHeader;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{Numbers, at, fill, options, read_messages, wrench, write_recording};

/// A recording whose writer was killed after `milliseconds`: the partial file without what finishing adds.
fn leftover(path: &std::path::Path, milliseconds: i64) {
    let other = path.with_file_name("other.mcap");
    let mut writer = RecordingWriter::create(&other, &options(Compression::Zstd)).unwrap();
    fill(&mut writer, milliseconds);
    fs::copy(partial_path(&other), path).unwrap();
    writer.finish().unwrap();
}

#[test]
fn a_leftover_becomes_a_complete_recording() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (
        folder.path().join("a.mcap.partial"),
        folder.path().join("a.mcap"),
    );
    leftover(&source, 1050);
    let recovered = recover(&source, &out, false).unwrap();
    assert!(recovered.lost_data() && !recovered.was_complete);
    assert_eq!(recovered.damage.len(), 1);
    assert!(
        recovered.damage[0].ends_with("the file ends without its summary (it was not finished)")
    );
    assert_eq!(recovered.unread_bytes, 0);
    let wrench = &recovered.topics["/ft/wrench"];
    assert_eq!((wrench.messages, wrench.missing_sequences), (1001, 0));
    assert_eq!(
        (wrench.first_ns, wrench.last_ns),
        (Some(at(0).as_nanos()), Some(at(1000).as_nanos()))
    );
    let last = recovered.last_message.clone().unwrap();
    assert_eq!(last.log_time_ns, at(1000).as_nanos() + 400_000);
    let (before, _) = read_messages(&fs::read(&source).unwrap());
    let (after, damage) = read_messages(&fs::read(&out).unwrap());
    assert_eq!(damage, Vec::<String>::new());
    let bare = |messages: Vec<recordings::Kept>| -> Vec<_> {
        messages
            .into_iter()
            .map(|kept| (kept.channel_id, kept.sequence, kept.log_time, kept.data))
            .collect()
    };
    assert_eq!(bare(after), bare(before));
    let report = check(&out).unwrap();
    assert!(report.is_complete && report.profile == "ros2");
    let expected = "recovered from a.mcap.partial, which was not whole: at byte ";
    assert!(
        report.lost_data() && report.damage[0].starts_with(expected),
        "{:?}",
        report.damage
    );
    let loaded = Recording::load(&out, &TopicMap::default()).unwrap();
    assert!(loaded.health.truncated.unwrap().starts_with(expected));
    assert!(
        report
            .library
            .contains("(recovered; written by ft-capture "),
        "{}",
        report.library
    );
    assert_eq!(
        (report.calibration, report.session),
        (Presence::Present, Presence::Present)
    );
    assert!(source.exists(), "the source stays");
}

#[test]
fn channels_schemas_metadata_and_attachments_are_carried_over() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let mut writer = mcap::WriteOptions::new()
        .profile("mine")
        .library("other 1.0")
        .compression(Some(mcap::Compression::Lz4))
        .create(fs::File::create(&source).unwrap())
        .unwrap();
    let metadata = BTreeMap::from([("a".to_owned(), "b".to_owned())]);
    writer
        .add_schema_with_id(77, "Thing", "jsonschema", b"{}")
        .unwrap();
    writer
        .add_channel_with_id(3, 77, "/thing", "json", &metadata)
        .unwrap();
    writer
        .add_channel_with_id(9, 0, "/silent", "json", &metadata)
        .unwrap();
    for sequence in [5, 6, 8] {
        let header = MessageHeader {
            channel_id: 3,
            sequence,
            log_time: 10,
            publish_time: 9,
        };
        writer
            .write_to_known_channel(&header, b"{\"x\": 1}")
            .unwrap();
    }
    let attachment = mcap::Attachment {
        log_time: 1,
        create_time: 2,
        name: "photo.jpg".to_owned(),
        media_type: "image/jpeg".to_owned(),
        data: vec![1, 2, 3].into(),
    };
    writer.attach(&attachment).unwrap();
    writer
        .write_metadata(&mcap::records::Metadata {
            name: "note".to_owned(),
            metadata: metadata.clone(),
        })
        .unwrap();
    writer.finish().unwrap();
    drop(writer);
    let recovered = recover(&source, &out, false).unwrap();
    assert!(recovered.was_complete && !recovered.lost_data());
    assert_eq!(recovered.topics["/thing"].missing_sequences, 1);
    assert_eq!(
        (recovered.topics["/silent"].messages, recovered.attachments),
        (0, 1)
    );

    let records = |path| {
        let mut reader = RecordReader::open(path).unwrap();
        let mut kept = Vec::new();
        while let Some(record) = reader.next_record().unwrap() {
            match record {
                Record::Schema(_)
                | Record::Channel(_)
                | Record::Message(_)
                | Record::Attachment(_) => {
                    kept.push(format!("{record:?}"));
                }
                Record::Metadata { ref name, .. } if name == "note" => {
                    kept.push(format!("{record:?}"))
                }
                _ => {}
            }
        }
        kept
    };
    assert_eq!(records(&out), records(&source));
    let mut reader = RecordReader::open(&out).unwrap();
    assert_eq!(
        reader.next_record().unwrap(),
        Some(Record::Header {
            profile: "mine".to_owned(),
            library: concat!(
                "ft-capture ",
                env!("CARGO_PKG_VERSION"),
                " (recovered; written by other 1.0)"
            )
            .to_owned()
        })
    );
}

#[test]
fn recovery_overwrites_nothing_unasked_and_leaves_no_litter() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (
        folder.path().join("a.mcap.partial"),
        folder.path().join("a.mcap"),
    );
    leftover(&source, 200);
    fs::write(&out, "precious").unwrap();
    let refused = recover(&source, &out, false).unwrap_err();
    assert!(matches!(
        refused,
        ReadError::Write(WriteError::Exists { .. })
    ));
    assert_eq!(fs::read(&out).unwrap(), b"precious");
    recover(&source, &out, true).unwrap();
    assert!(check(&out).unwrap().is_complete);
    fs::write(&source, "no recording").unwrap();
    assert!(matches!(
        recover(&source, &out, true),
        Err(ReadError::NotMcap { .. })
    ));
    assert!(check(&out).unwrap().is_complete, "the earlier result stays");
    let mut names: Vec<_> = fs::read_dir(folder.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    names.sort();
    assert_eq!(names, ["a.mcap", "a.mcap.partial", "other.mcap"]);
}

#[test]
fn a_recording_that_is_being_written_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    let error = recover(&partial_path(&path), &folder.path().join("b.mcap"), false).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("is still being written: stop the recording first"),
        "{error}"
    );
    writer.finish().unwrap();
}

#[test]
fn the_summary_of_a_recovery_says_how_much_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (
        folder.path().join("a.mcap.partial"),
        folder.path().join("a.mcap"),
    );
    leftover(&source, 1050);
    let bytes = fs::read(&source).unwrap();
    let mut damaged = bytes[..bytes.len() - 100].to_vec();
    let (messages, _) = read_messages(&bytes);
    damaged[messages[messages.len() / 2].ends_at as usize - 40] ^= 0xff;
    fs::write(&source, damaged).unwrap();
    let recovered = recover(&source, &out, false).unwrap();
    assert!(recovered.topics["/ft/wrench"].missing_sequences >= 99);
    assert!(recovered.unread_bytes > 0);
    let text = recovered.to_string();
    assert!(text.contains("MISSING inside"), "{text}");
    assert!(text.contains("last message: /"), "{text}");
    assert!(text.contains("nothing is known after it"), "{text}");
    assert!(
        serde_json::to_string(&recovered)
            .unwrap()
            .contains("\"missing_sequences\":")
    );
}

#[test]
fn a_whole_recording_is_fine() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, Compression::Zstd, 2000);
    let report = check(&path).unwrap();
    assert_eq!(
        (report.verdict, report.reasons.clone()),
        (Verdict::Fine, Vec::new())
    );
    assert_eq!(
        (report.duration_s, report.start_ns),
        (1.999, Some(at(0).as_nanos()))
    );
    let wrench = &report.topics["/ft/wrench"];
    assert_eq!((wrench.messages, wrench.rate_hz), (2000, Some(1000.0)));
    assert_eq!(
        (wrench.interval_median_s, wrench.interval_p99_s),
        (Some(0.001), Some(0.001))
    );
    assert_eq!(
        (wrench.holes, wrench.duplicates, wrench.missing_sequences),
        (0, 0, 0)
    );
    assert_eq!(
        (wrench.starts_after_s, wrench.ends_before_s),
        (Some(0.0), Some(0.0))
    );
    let gripper = &report.topics["/gripper/joint_states"];
    assert!((gripper.ends_before_s.unwrap() - 0.009).abs() < 1e-9);
    assert!(report.ledger.contains_key("ft_sensor"));
    let text = report.to_string();
    assert!(
        text.ends_with("fine: complete, and nothing is known to be missing"),
        "{text}"
    );
    let json: serde_json::Value = serde_json::to_value(&report).unwrap();
    assert_eq!(json["verdict"], "fine");
    assert_eq!(json["topics"]["/ft/wrench"]["rate_hz"], 1000.0);
}

#[test]
fn losses_are_found_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    let channel = writer
        .add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR)
        .unwrap();
    let mut numbers = Numbers(1);
    let mut bytes = Vec::new();
    let samples: Vec<_> = (0..40)
        .map(|millisecond| wrench(millisecond, &mut numbers))
        .collect();
    // 10..20 never came, 25 came twice, 31 after 32, 35 before it was true.
    let order = (0..10)
        .chain(20..26)
        .chain([25])
        .chain(26..31)
        .chain([32, 31])
        .chain(33..40);
    for millisecond in order {
        samples[millisecond as usize].encode(&mut bytes);
        let log_time = at(if millisecond == 35 { 34 } else { millisecond });
        writer
            .write(
                channel,
                MessageStamps {
                    log_time,
                    publish_time: at(millisecond),
                },
                &bytes,
            )
            .unwrap();
    }
    let counts = r#"{"received":30,"gaps":10,"drops":0,"duplicated":1}"#;
    writer
        .write_metadata(
            "ft.ledger",
            &BTreeMap::from([("ft".to_owned(), counts.to_owned())]),
        )
        .unwrap();
    writer
        .write_metadata("ft.calibration", &BTreeMap::new())
        .unwrap();
    writer.finish().unwrap();
    let report = check(&path).unwrap();
    let wrench = &report.topics["/ft/wrench"];
    assert_eq!(
        (
            wrench.holes,
            wrench.duplicates,
            wrench.out_of_order,
            wrench.after_arrival
        ),
        (1, 1, 1, 1)
    );
    assert!((wrench.longest_interval_s.unwrap() - 0.011).abs() < 1e-12);
    assert_eq!(report.verdict, Verdict::Unusable);
    assert_eq!(
        report.reasons,
        [
            "neither /tcp/pose nor /aria/pose",
            "/ft/wrench: 1 duplicated messages",
            "/ft/wrench: 1 messages stamped after their arrival",
            "/ft/wrench: 1 holes in its stamps",
            "ledger of ft: 10 gaps",
            "ft.calibration: has no key \"json\"",
        ]
    );
    assert!(
        report
            .to_string()
            .contains("not usable for identification: neither /tcp/pose nor /aria/pose; ")
    );
}

#[test]
fn a_cut_recording_is_usable_but_not_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, Compression::Zstd, 500);
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    let report = check(&path).unwrap();
    assert!(!report.is_complete && report.lost_data());
    assert_eq!((report.verdict, report.damage.len()), (Verdict::Lossy, 1));
    assert!(
        report
            .to_string()
            .contains("usable, but not whole: at byte "),
        "{report}"
    );
}

#[test]
fn a_loss_is_remembered_through_a_second_recovery() {
    let folder = tempfile::tempdir().unwrap();
    let (source, once, twice) = (
        folder.path().join("a.mcap.partial"),
        folder.path().join("a.mcap"),
        folder.path().join("b.mcap"),
    );
    leftover(&source, 300);
    recover(&source, &once, false).unwrap();
    assert!(!recover(&once, &twice, false).unwrap().lost_data());
    let report = check(&twice).unwrap();
    assert!(
        report.damage[0].starts_with("recovered from a.mcap.partial"),
        "{report}"
    );
}

/// A recording of wrench and poses at 1 kHz over these milliseconds.
fn two_streams(
    path: &std::path::Path,
    wrenches: std::ops::Range<i64>,
    poses: std::ops::Range<i64>,
) {
    let mut writer = RecordingWriter::create(path, &WriterOptions::default()).unwrap();
    let [to_wrench, to_pose] = [
        writer.add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR),
        writer.add_channel::<PoseStamped>("/tcp/pose", Qos::SENSOR),
    ]
    .map(Result::unwrap);
    let (mut numbers, mut bytes) = (Numbers(3), Vec::new());
    let stamps = |millisecond| MessageStamps {
        log_time: at(millisecond),
        publish_time: at(millisecond),
    };
    for millisecond in wrenches {
        wrench(millisecond, &mut numbers).encode(&mut bytes);
        writer
            .write(to_wrench, stamps(millisecond), &bytes)
            .unwrap();
    }
    for millisecond in poses {
        recordings::pose(millisecond, &mut numbers).encode(&mut bytes);
        writer.write(to_pose, stamps(millisecond), &bytes).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn streams_that_do_not_meet_are_of_no_use_and_a_part_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let judged = |wrenches, poses| {
        two_streams(&path, wrenches, poses);
        let report = check(&path).unwrap();
        fs::remove_file(&path).unwrap();
        (report.verdict, report.reasons)
    };
    assert_eq!(judged(0..1000, 20..1000), (Verdict::Fine, Vec::new()));
    let apart = "/ft/wrench and /tcp/pose do not overlap: 0.6 s lie between them";
    assert_eq!(
        judged(0..400, 1000..1400),
        (Verdict::Unusable, vec![apart.to_owned()])
    );
    let little = "/tcp/pose covers 60 % of the time of /ft/wrench";
    assert_eq!(
        judged(0..1001, 400..1001),
        (Verdict::Fine, vec![little.to_owned()])
    );
    let both = [
        "/ft/wrench covers 50 % of the time of /tcp/pose".to_owned(),
        "/tcp/pose covers 50 % of the time of /ft/wrench".to_owned(),
    ];
    assert_eq!(judged(0..1001, 500..1501), (Verdict::Fine, both.to_vec()));
}

#[test]
fn what_is_made_of_a_foreign_recording_has_lost_nothing_before_its_first_number() {
    let folder = tempfile::tempdir().unwrap();
    let [theirs, ours, again] = ["a.mcap", "b.mcap", "c.mcap"].map(|name| folder.path().join(name));
    let mut writer = mcap::WriteOptions::new()
        .library("theirs 1.0")
        .create(fs::File::create(&theirs).unwrap())
        .unwrap();
    let schema = writer
        .add_schema("geometry_msgs/msg/WrenchStamped", "ros2msg", b"")
        .unwrap();
    let channel = writer
        .add_channel(schema, "/ft/wrench", "cdr", &BTreeMap::new())
        .unwrap();
    let (mut numbers, mut bytes) = (Numbers(4), Vec::new());
    // One of theirs is missing.
    for number in (1001..1101).filter(|number| *number != 1050) {
        let time = u64::try_from(at(i64::from(number)).as_nanos()).unwrap();
        wrench(i64::from(number), &mut numbers).encode(&mut bytes);
        let header = MessageHeader {
            channel_id: channel,
            sequence: number,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header, &bytes).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    ft_recording::rewrite::Rewrite::new()
        .write(Some(&theirs), &ours, false)
        .unwrap();
    let report = check(&ours).unwrap();
    assert!(report.library.starts_with("ft-capture "), "{report}");
    assert_eq!(report.topics["/ft/wrench"].missing_sequences, 1);
    let recovered = recover(&ours, &again, false).unwrap();
    assert_eq!(recovered.topics["/ft/wrench"].missing_sequences, 1);
    let report = check(&again).unwrap();
    assert_eq!(report.topics["/ft/wrench"].missing_sequences, 1);
}
