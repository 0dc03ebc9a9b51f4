//! The 416 files of the MCAP conformance suite are read record by record as their listings say.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fs;
use std::path::Path;

use ft_recording::reader::Record;
use mcap::records::{self, Record as Other};
use serde_json::{Map, Value, json};

#[path = "support/recordings.rs"]
mod recordings;

#[test]
fn every_conformance_file_is_read_as_its_listing_says() {
    let Some(directory) = recordings::data_directory("mcap_conformance") else {
        return;
    };
    let mut files = 0;
    for folder in fs::read_dir(directory)
        .unwrap()
        .map(|entry| entry.unwrap().path())
    {
        if !folder.is_dir() {
            continue;
        }
        for file in fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
        {
            if file
                .extension()
                .is_some_and(|extension| extension == "mcap")
            {
                assert_eq!(
                    read(&file),
                    listed(&file.with_extension("json")),
                    "{}",
                    file.display()
                );
                files += 1;
            }
        }
    }
    assert_eq!(files, 416);
}

/// (type, fields by name) of each record of a listing.
fn listed(path: &Path) -> Vec<Value> {
    let listing: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    let record = |record: &Value| {
        let fields = record["fields"].as_array().unwrap().iter();
        let fields = fields.map(|field| (field[0].as_str().unwrap().to_owned(), field[1].clone()));
        json!([record["type"], fields.collect::<Map<_, _>>()])
    };
    listing["records"]
        .as_array()
        .unwrap()
        .iter()
        .map(record)
        .collect()
}

fn read(path: &Path) -> Vec<Value> {
    let bytes = fs::read(path).unwrap();
    let mut reader = recordings::reader(&bytes);
    let mut records = Vec::new();
    while let Some(record) = reader.next_record().unwrap() {
        records.extend(describe(record));
    }
    assert_eq!(reader.damage(), [], "{}", path.display());
    assert!(reader.is_complete());
    records
}

fn numbers(bytes: &[u8]) -> Vec<String> {
    bytes.iter().map(u8::to_string).collect()
}

/// As the listings have it; they leave out message indexes.
fn describe(record: Record<'_>) -> Option<Value> {
    Some(match record {
        Record::Header { profile, library } => {
            json!(["Header", {"profile": profile, "library": library}])
        }
        Record::Schema(schema) => json!(["Schema", {
            "id": schema.id.to_string(), "name": schema.name, "encoding": schema.encoding,
            "data": numbers(&schema.data)
        }]),
        Record::Channel(channel) => json!(["Channel", {
            "id": channel.id.to_string(), "schema_id": channel.schema_id.to_string(), "topic": channel.topic,
            "message_encoding": channel.message_encoding, "metadata": channel.metadata
        }]),
        Record::Message(message) => json!(["Message", {
            "channel_id": message.channel_id.to_string(), "sequence": message.sequence.to_string(),
            "log_time": message.log_time.to_string(), "publish_time": message.publish_time.to_string(),
            "data": numbers(message.data)
        }]),
        Record::Attachment(attachment) => json!(["Attachment", {
            "create_time": attachment.create_time.to_string(), "log_time": attachment.log_time.to_string(),
            "name": attachment.name, "media_type": attachment.media_type, "data": numbers(attachment.data)
        }]),
        Record::Metadata { name, entries } => {
            json!(["Metadata", {"name": name, "metadata": entries}])
        }
        Record::DataEnd { data_section_crc } => {
            json!(["DataEnd", {"data_section_crc": data_section_crc.to_string()}])
        }
        Record::Footer {
            summary_start,
            summary_offset_start,
            summary_crc,
        } => json!(["Footer", {
            "summary_start": summary_start.to_string(), "summary_crc": summary_crc.to_string(),
            "summary_offset_start": summary_offset_start.to_string()
        }]),
        Record::Other { opcode, body } => {
            return describe_index(mcap::parse_record(opcode, body).unwrap());
        }
        Record::Unreadable { opcode } => panic!("record {opcode:#04x} is unreadable"),
    })
}

fn describe_index(record: Other<'_>) -> Option<Value> {
    Some(match record {
        Other::MessageIndex(_) => return None,
        Other::ChunkIndex(index) => json!(["ChunkIndex", {
            "chunk_length": index.chunk_length.to_string(),
            "chunk_start_offset": index.chunk_start_offset.to_string(),
            "compressed_size": index.compressed_size.to_string(), "compression": index.compression,
            "message_end_time": index.message_end_time.to_string(),
            "message_index_length": index.message_index_length.to_string(),
            "message_index_offsets": by_number(index.message_index_offsets),
            "message_start_time": index.message_start_time.to_string(),
            "uncompressed_size": index.uncompressed_size.to_string()
        }]),
        Other::AttachmentIndex(index) => json!(["AttachmentIndex", {
            "create_time": index.create_time.to_string(), "data_size": index.data_size.to_string(),
            "length": index.length.to_string(), "log_time": index.log_time.to_string(),
            "media_type": index.media_type, "name": index.name, "offset": index.offset.to_string()
        }]),
        Other::MetadataIndex(index) => json!(["MetadataIndex", {
            "length": index.length.to_string(), "name": index.name, "offset": index.offset.to_string()
        }]),
        Other::SummaryOffset(offset) => json!(["SummaryOffset", {
            "group_length": offset.group_length.to_string(), "group_opcode": offset.group_opcode.to_string(),
            "group_start": offset.group_start.to_string()
        }]),
        Other::Statistics(statistics) => describe_statistics(statistics),
        other => panic!("{other:?}"),
    })
}

fn describe_statistics(statistics: records::Statistics) -> Value {
    json!(["Statistics", {
        "attachment_count": statistics.attachment_count.to_string(),
        "channel_count": statistics.channel_count.to_string(),
        "channel_message_counts": by_number(statistics.channel_message_counts),
        "chunk_count": statistics.chunk_count.to_string(),
        "message_count": statistics.message_count.to_string(),
        "message_end_time": statistics.message_end_time.to_string(),
        "message_start_time": statistics.message_start_time.to_string(),
        "metadata_count": statistics.metadata_count.to_string(),
        "schema_count": statistics.schema_count.to_string()
    }])
}

fn by_number(map: impl IntoIterator<Item = (u16, u64)>) -> Map<String, Value> {
    map.into_iter()
        .map(|(key, value)| (key.to_string(), json!(value.to_string())))
        .collect()
}
