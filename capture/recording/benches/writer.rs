//! Messages per second of our writer against the bare `mcap` crate, in one run: `cargo bench -p ft-recording`.
//!
//! Each writes the same 76-byte wrenches, 1 ms apart, to a file in the temporary folder.
#![allow(clippy::expect_used, reason = "a benchmark fails by panicking")]

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;

use divan::Bencher;
use divan::counter::ItemsCount;
use ft_recording::message::{Header, Message, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::recording::{Recording, TopicMap};
use ft_recording::writer::{Compression, MessageStamps, RecordingWriter, WriterOptions};
use ft_wire::HostTime;
use mcap::records::MessageHeader;
use tempfile::TempDir;

const MESSAGES: i64 = 100_000;

fn main() {
    divan::main();
}

fn payload(step: i64) -> WrenchStamped {
    let phase = step as f64 * 1e-3;
    let wrench = [phase.sin(), phase.cos(), 1.0, 0.1 * phase.sin(), 0.0, 0.2];
    WrenchStamped {
        header: Header::new(HostTime::from_nanos(step * 1_000_000), "ft_sensor"),
        wrench: wrench.into(),
    }
}

fn payloads() -> Vec<Vec<u8>> {
    let encode = |step| {
        let mut bytes = Vec::new();
        payload(step).encode(&mut bytes);
        bytes
    };
    (0..MESSAGES).map(encode).collect()
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

#[divan::bench(args = [Compression::None, Compression::Zstd], sample_count = 10)]
fn ours(bencher: Bencher, compression: Compression) {
    let payloads = payloads();
    bencher
        .counter(ItemsCount::new(payloads.len()))
        .with_inputs(folder)
        .bench_refs(|folder| {
            let options = WriterOptions {
                compression,
                ..WriterOptions::default()
            };
            let mut writer = RecordingWriter::create(&folder.path().join("a.mcap"), &options)
                .expect("a new file");
            let channel = writer
                .add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR)
                .expect("a channel");
            for (step, payload) in (0..).zip(&payloads) {
                let now = HostTime::from_nanos(step * 1_000_000);
                writer
                    .write(
                        channel,
                        MessageStamps {
                            log_time: now,
                            publish_time: now,
                        },
                        payload,
                    )
                    .expect("a message");
                writer.flush_if_due(now).expect("a flush");
            }
            writer.finish().expect("a recording")
        });
}

/// Defaults of the crate but for the threads: 1 MiB chunks, never flushed, so a crash takes the last chunk.
#[divan::bench(args = [Compression::None, Compression::Zstd], sample_count = 10)]
fn bare_mcap(bencher: Bencher, compression: Compression) {
    let payloads = payloads();
    bencher
        .counter(ItemsCount::new(payloads.len()))
        .with_inputs(folder)
        .bench_refs(|folder| {
            let compression = match compression {
                Compression::None => None,
                Compression::Zstd => Some(mcap::Compression::Zstd),
            };
            let file =
                BufWriter::new(File::create(folder.path().join("a.mcap")).expect("a new file"));
            let options = mcap::WriteOptions::new()
                .compression(compression)
                .compression_threads(0);
            let mut writer = options.create(file).expect("a writer");
            let definition = WrenchStamped::DEFINITION.as_bytes();
            let schema = writer
                .add_schema(WrenchStamped::TYPE_NAME, "ros2msg", definition)
                .expect("a schema");
            let channel_id = writer
                .add_channel(schema, "/ft/wrench", "cdr", &BTreeMap::new())
                .expect("a channel");
            for (sequence, payload) in (0..).zip(&payloads) {
                let time = u64::from(sequence) * 1_000_000;
                let header = MessageHeader {
                    channel_id,
                    sequence,
                    log_time: time,
                    publish_time: time,
                };
                writer
                    .write_to_known_channel(&header, payload)
                    .expect("a message");
            }
            writer.finish().expect("a recording");
            writer
                .into_inner()
                .into_inner()
                .expect("flushed")
                .sync_all()
                .expect("synced");
        });
}

#[divan::bench]
fn encode_wrench(bencher: Bencher) {
    let message = payload(1);
    let mut buffer = Vec::new();
    bencher.bench_local(|| message.encode(divan::black_box(&mut buffer)));
}

#[divan::bench]
fn decode_wrench(bencher: Bencher) {
    let mut buffer = Vec::new();
    payload(1).encode(&mut buffer);
    bencher.bench_local(|| WrenchStamped::decode(divan::black_box(&buffer)));
}

/// A minute of wrench and pose at 1 kHz, packed, from the page cache; items are messages.
#[divan::bench(sample_count = 10)]
fn load_a_minute(bencher: Bencher) {
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).expect("a new file");
    let wrench = writer
        .add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR)
        .expect("a channel");
    let pose = writer
        .add_channel::<ft_recording::message::PoseStamped>("/tcp/pose", Qos::SENSOR)
        .expect("a channel");
    let mut buffer = Vec::new();
    for step in 0..60_000 {
        let now = HostTime::from_nanos(step * 1_000_000);
        let stamps = MessageStamps {
            log_time: now,
            publish_time: now,
        };
        payload(step).encode(&mut buffer);
        writer.write(wrench, stamps, &buffer).expect("a message");
        let mut message = ft_recording::message::PoseStamped {
            header: Header::new(now, "world"),
            ..Default::default()
        };
        message.pose.orientation.w = 1.0;
        message.pose.position.x = step as f64 * 1e-5;
        message.encode(&mut buffer);
        writer.write(pose, stamps, &buffer).expect("a message");
        writer.flush_if_due(now).expect("a flush");
    }
    writer.finish().expect("a recording");
    bencher
        .counter(ItemsCount::new(120_000_usize))
        .bench(|| Recording::load(&path, &TopicMap::default()).expect("a recording"));
}
