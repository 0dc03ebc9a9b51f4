//! Pins what version 1 of a recording is made of. If this fails the code is wrong, not the test.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;

use ft_recording::reader::{Record, RecordReader};
use ft_recording::writer::Compression;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::write_recording;

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// One line per record of the data section but the text of the schemas, which the type hashes pin.
fn describe(record: Record<'_>) -> Option<String> {
    Some(match record {
        Record::Header { profile, .. } => format!("header {profile}"),
        Record::Schema(schema) => {
            format!("schema {} {} {}", schema.id, schema.name, schema.encoding)
        }
        Record::Channel(channel) => {
            let hash = channel
                .metadata
                .get("topic_type_hash")
                .map_or("-", String::as_str);
            let encoding = channel.message_encoding;
            format!(
                "channel {} {} {} {encoding} {hash}",
                channel.id, channel.schema_id, channel.topic
            )
        }
        Record::Message(message) => format!(
            "message {} {} {} {} {}",
            message.channel_id,
            message.sequence,
            message.log_time,
            message.publish_time,
            hex(message.data)
        ),
        Record::Metadata { name, entries } => format!("metadata {name} {entries:?}"),
        _ => return None,
    })
}

#[test]
fn a_recording_of_two_milliseconds_is_this() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, Compression::Zstd, 2);
    let mut reader = RecordReader::open(&path).unwrap();
    let mut lines = Vec::new();
    while let Some(record) = reader.next_record().unwrap() {
        if matches!(record, Record::DataEnd { .. }) {
            break;
        }
        lines.extend(describe(record));
    }
    let expected =
        fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/formats_v1.txt")).unwrap();
    assert_eq!(lines.join("\n"), expected.trim_end());
}
