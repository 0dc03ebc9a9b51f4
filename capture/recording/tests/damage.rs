//! Cut and corrupted files: what was before the damage is given back, nothing panics or hangs, nothing is invented.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::io::Cursor;
use std::os::unix::fs::FileExt;

use ft_recording::recording::{Recording, TopicMap};
use ft_recording::writer::Compression;
use ft_recording::{ReadError, check, recover};
use mcap::records::MessageHeader;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{Kept, Numbers, read_messages, write_recording};

fn ours(compression: Compression) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, compression, 1000);
    fs::read(path).unwrap()
}

/// Messages as another program writes them with the bare `mcap` crate.
fn foreign(options: mcap::WriteOptions) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = options.compression_threads(0).create(&mut bytes).unwrap();
    fill_foreign(&mut writer, 2000);
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

fn fill_foreign<W: std::io::Write + std::io::Seek>(writer: &mut mcap::Writer<W>, messages: u32) {
    let channel_id = writer
        .add_channel(0, "/numbers", "text/plain", &BTreeMap::new())
        .unwrap();
    for sequence in 0..messages {
        let time = u64::from(sequence) * 1_000_000;
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        writer
            .write_to_known_channel(&header, format!("message number {sequence}").as_bytes())
            .unwrap();
    }
}

fn mcap_options() -> mcap::WriteOptions {
    mcap::WriteOptions::new().chunk_size(Some(10_000))
}

/// Every kind of file: (name, bytes, whether each message is under a CRC).
fn files() -> Vec<(&'static str, Vec<u8>, bool)> {
    vec![
        ("ours, zstd", ours(Compression::Zstd), true),
        ("ours, not packed", ours(Compression::None), true),
        (
            "lz4",
            foreign(mcap_options().compression(Some(mcap::Compression::Lz4))),
            true,
        ),
        (
            "no chunks",
            foreign(mcap_options().use_chunks(false)),
            false,
        ),
    ]
}

fn assert_starts_with(found: &[Kept], expected: &[Kept], what: &str) {
    assert!(
        found.len() >= expected.len(),
        "{what}: {} of {} messages",
        found.len(),
        expected.len()
    );
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!(
            (found.channel_id, found.sequence),
            (expected.channel_id, expected.sequence),
            "{what}"
        );
        assert_eq!(
            (&found.data, found.log_time),
            (&expected.data, expected.log_time),
            "{what}"
        );
    }
}

fn before(whole: &[Kept], end: u64) -> Vec<Kept> {
    whole
        .iter()
        .take_while(|message| message.ends_at <= end)
        .cloned()
        .collect()
}

#[test]
fn a_file_cut_anywhere_gives_all_before_the_cut_and_says_so() {
    let mut numbers = Numbers(1);
    for (name, bytes, _) in files() {
        let (whole, damage) = read_messages(&bytes);
        assert_eq!(damage, Vec::<String>::new(), "{name}");
        for _ in 0..300 {
            let cut = 8 + numbers.below(bytes.len() as u64 - 8) as usize;
            let (found, damage) = read_messages(&bytes[..cut]);
            let what = format!("{name} cut at {cut} of {}", bytes.len());
            assert_starts_with(&found, &before(&whole, cut as u64), &what);
            assert!(found.len() <= whole.len(), "{what}");
            assert_starts_with(&whole, &found, &what);
            assert_eq!(damage.len(), 1, "{what}: {damage:?}");
            assert!(damage[0].contains("the file ends"), "{what}: {damage:?}");
        }
    }
}

#[test]
fn a_wrong_byte_anywhere_loses_nothing_before_it_and_invents_nothing() {
    let mut numbers = Numbers(2);
    for (name, bytes, checked) in files() {
        let (whole, _) = read_messages(&bytes);
        let known: HashSet<_> = whole
            .iter()
            .map(|kept| (kept.channel_id, kept.sequence, kept.data.clone()))
            .collect();
        let mut noticed = 0;
        for _ in 0..2_500 {
            let place = 8 + numbers.below(bytes.len() as u64 - 8) as usize;
            let mut corrupted = bytes.clone();
            corrupted[place] ^= 1 + numbers.below(255) as u8;
            let what = format!("{name}, byte {place} of {} wrong", bytes.len());
            let (found, damage) = read_messages(&corrupted);
            assert_starts_with(&found, &before(&whole, place as u64), &what);
            if checked {
                let invented = found.iter().find(|kept| {
                    kept.channel_id < 100
                        && !known.contains(&(kept.channel_id, kept.sequence, kept.data.clone()))
                });
                assert_eq!(invented, None, "{what}");
            }
            if found.len() < whole.len() {
                assert!(
                    !damage.is_empty(),
                    "{what}: {} messages lost in silence",
                    whole.len() - found.len()
                );
            }
            noticed += u32::from(!damage.is_empty());
        }
        assert!(
            noticed > 300,
            "{name}: {noticed} of 500 wrong bytes noticed"
        );
    }
}

#[test]
fn one_wrong_byte_in_a_chunk_costs_that_chunk_only() {
    let bytes = ours(Compression::None);
    let (whole, _) = read_messages(&bytes);
    let middle = whole[whole.len() / 2].ends_at;
    let chunk: Vec<_> = whole
        .iter()
        .filter(|message| message.ends_at == middle)
        .collect();
    let mut corrupted = bytes.clone();
    corrupted[middle as usize - 40] ^= 1;
    let (found, damage) = read_messages(&corrupted);
    assert_eq!(found.len(), whole.len() - chunk.len());
    assert!(
        chunk.len() < 330,
        "a chunk holds 100 ms of 3.1 messages each"
    );
    assert_eq!(damage.len(), 2, "{damage:?}");
    assert!(damage[0].contains("chunk content has CRC"), "{damage:?}");
    assert!(damage[1].contains("it was altered"), "{damage:?}");
}

#[test]
fn a_wrong_length_costs_one_chunk_only() {
    let bytes = foreign(mcap_options().compression(None));
    let (whole, _) = read_messages(&bytes);
    let header = bytes
        .windows(9)
        .position(|window| window[0] == 6 && window[1..9] > [0; 8][..])
        .unwrap();
    for value in [0, 1, 0x7f, 0xff] {
        let mut corrupted = bytes.clone();
        corrupted[header + 6] = value;
        let (found, _) = read_messages(&corrupted);
        assert_eq!(
            found.len(),
            whole.len(),
            "a chunk's own sizes are believed more than its record length"
        );
    }
    let mut corrupted = bytes.clone();
    corrupted[header] = 0;
    let (found, damage) = read_messages(&corrupted);
    let first_chunk = whole
        .iter()
        .filter(|message| message.ends_at == whole[0].ends_at)
        .count();
    assert_eq!(found.len(), whole.len() - first_chunk);
    assert!(damage[0].contains("are no records"), "{damage:?}");
}

#[test]
fn damage_in_the_last_chunk_leaves_the_account_behind_it() {
    for compression in [Compression::Zstd, Compression::None] {
        let bytes = ours(compression);
        let (whole, _) = read_messages(&bytes);
        let last = whole.last().unwrap().ends_at as usize;
        let in_last = whole.iter().filter(|kept| kept.ends_at as usize == last);
        let others = whole.len() - in_last.count();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.mcap");
        // The chunk that ends there: its length fits its place.
        let begin = (0..last - 9).rev().find(|at| {
            let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
            bytes[*at] == 6 && (*at as u64).checked_add(9 + length) == Some(last as u64)
        });
        let begin = begin.unwrap();
        // Its opcode, its length, times, sizes and the name of its compression, and packed bytes.
        let places = (begin..begin + 60).chain((begin + 60..last).step_by(997));
        for place in places {
            for wrong in [0x01, 0x80, 0xff] {
                let mut corrupted = bytes.clone();
                corrupted[place] ^= wrong;
                let what = format!("{compression:?}, byte {} of the last chunk", place - begin);
                let (found, _) = read_messages(&corrupted);
                assert!(found.len() >= others, "{what}: {} of {others}", found.len());
                fs::write(&path, &corrupted).unwrap();
                let report = check::check(&path).unwrap();
                assert!(report.ledger.contains_key("ft_sensor"), "{what}: {report}");
                assert!(report.is_complete, "{what}: {report}");
            }
        }
        // A stretch of it is something else altogether.
        let mut torn = bytes.clone();
        torn[begin..last].fill(0x5a);
        fs::write(&path, &torn).unwrap();
        let report = check::check(&path).unwrap();
        assert!(report.ledger.contains_key("ft_sensor"), "{report}");
        assert!(report.lost_data());
    }
}

/// The chunk that was open when another recorder was killed: its header is a placeholder.
#[test]
fn an_open_chunk_of_another_recorder_is_read_as_far_as_it_goes() {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap_options()
        .compression(None)
        .chunk_size(None)
        .create(&mut file)
        .unwrap();
    fill_foreign(&mut writer, 100);
    writer.flush().unwrap();
    let channel_id = 1;
    for sequence in 100..200 {
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: 0,
            publish_time: 0,
        };
        writer.write_to_known_channel(&header, b"open").unwrap();
    }
    let bytes = writer.into_inner().get_ref().clone();
    assert!(
        bytes.windows(8).any(|window| window == [0xff; 8]),
        "the header must be a placeholder"
    );
    let (found, damage) = read_messages(&bytes);
    assert_eq!(found.len(), 200);
    assert_eq!(damage.len(), 1);
    assert!(
        damage[0].contains("100 whole messages in them"),
        "{damage:?}"
    );
    let (found, _) = read_messages(&bytes[..bytes.len() - 1]);
    assert_eq!(found.len(), 199);
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

fn message(channel_id: u16) -> Vec<u8> {
    record(
        5,
        &[&channel_id.to_le_bytes()[..], &[0; 20], b"payload"].concat(),
    )
}

fn chunk(compression: &str, uncompressed_size: u64, packed: &[u8]) -> Vec<u8> {
    let name_length = (compression.len() as u32).to_le_bytes();
    let size = (packed.len() as u64).to_le_bytes();
    let crc = [0; 4];
    let times = [0; 16];
    let header = [
        &times[..],
        &uncompressed_size.to_le_bytes(),
        &crc,
        &name_length,
        compression.as_bytes(),
        &size,
    ];
    record(6, &[&header.concat()[..], packed].concat())
}

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
const CHANNEL_1: &[u8] = b"\x04\x16\0\0\0\0\0\0\0\x01\0\0\0\x02\0\0\0/x\x04\0\0\0text\0\0\0\0";

/// A finished file of these records.
fn file(records: &[Vec<u8>]) -> Vec<u8> {
    let header = record(1, &[0; 8]);
    let end = [record(15, &[0; 4]), record(2, &[0; 20])].concat();
    [MAGIC, &header, CHANNEL_1, &records.concat(), &end, MAGIC].concat()
}

#[test]
fn a_chunk_that_cannot_be_unpacked_costs_itself_only() {
    for (bad, expected) in [
        (
            chunk("brotli", 30, b"?"),
            "packed with \"brotli\", only zstd, lz4 and none are read",
        ),
        (
            chunk("zstd", 30, b"?"),
            "chunk (\"zstd\") unpacks to 0 bytes, expected 30",
        ),
        (
            chunk("", 30, &message(1)),
            "chunk (\"\") unpacks to 38 bytes, expected 30",
        ),
        (
            chunk("", 1 << 40, &message(1)),
            "chunk record of 1099511627776 bytes is left out, the limit is 1 GiB",
        ),
    ] {
        let (messages, damage) = read_messages(&file(&[message(1), bad, message(1)]));
        assert_eq!(messages.len(), 2, "{expected}");
        assert_eq!(damage.len(), 1);
        assert!(damage[0].contains(expected), "{damage:?}");
    }
}

#[test]
fn records_of_later_versions_and_of_others_are_passed_over() {
    let records = [
        record(0x33, b"later"),
        message(1),
        record(0xf0, b"private"),
        chunk("", 38, &message(1)),
    ];
    let (messages, damage) = read_messages(&file(&records));
    assert_eq!((messages.len(), damage), (2, Vec::new()));
}

#[test]
fn a_record_that_contradicts_itself_is_left_out() {
    let lying = record(3, b"\x01\0\xff\xff\xff\xff");
    let (messages, damage) = read_messages(&file(&[lying, message(1)]));
    assert_eq!(messages.len(), 1);
    assert!(
        damage[0].contains("schema record contradicts itself"),
        "{damage:?}"
    );
}

#[test]
fn what_follows_the_end_of_the_file_is_named() {
    let (messages, damage) = read_messages(&[&file(&[message(1)])[..], b"more"].concat());
    assert_eq!(messages.len(), 1);
    assert!(damage[0].ends_with("4 bytes are no records"), "{damage:?}");
}

#[test]
fn messages_of_a_channel_that_is_not_described_are_left_out_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(&path, file(&[message(1), message(2), message(2)])).unwrap();
    let expected = ["2 messages of channel 2, which is not described, are left out"];
    assert_eq!(check::check(&path).unwrap().damage, expected);
    let recovered = recover::recover(&path, &folder.path().join("b.mcap"), false).unwrap();
    assert_eq!(recovered.damage, expected);
    assert_eq!(recovered.topics["/x"].messages, 1);
}

/// The file is sparse: its big record takes no room.
#[test]
fn a_record_of_more_than_a_gibibyte_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let whole = file(&[message(1)]);
    let start = MAGIC.len() + 17 + CHANNEL_1.len();
    let length = (1_u64 << 30) + 1;
    let out = fs::File::create(&path).unwrap();
    out.write_all_at(&whole[..start], 0).unwrap();
    out.write_all_at(&[&[0x80][..], &length.to_le_bytes()].concat(), start as u64)
        .unwrap();
    out.write_all_at(&whole[start..], start as u64 + 9 + length)
        .unwrap();
    let report = check::check(&path).unwrap();
    assert_eq!(report.topics["/x"].messages, 1);
    assert!(report.is_complete);
    assert!(
        report.damage[0]
            .ends_with("private record of 1073741825 bytes is left out, the limit is 1 GiB")
    );
}

#[test]
fn the_whole_pipeline_survives_damaged_files() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (
        folder.path().join("a.mcap.partial"),
        folder.path().join("a.mcap"),
    );
    let bytes = ours(Compression::Zstd);
    let mut numbers = Numbers(3);
    let mut loaded = 0;
    for _ in 0..40 {
        let mut damaged = bytes.clone();
        for _ in 0..3 {
            let place = numbers.below(bytes.len() as u64) as usize;
            damaged[place] = numbers.below(256) as u8;
        }
        damaged.truncate(1000 + numbers.below(bytes.len() as u64 - 1000) as usize);
        fs::write(&path, &damaged).unwrap();
        match Recording::load(&path, &TopicMap::default()) {
            Ok(recording) => {
                loaded += 1;
                assert!(recording.health.truncated.is_some());
            }
            Err(ReadError::Io { .. } | ReadError::Write(_)) => {
                panic!("a damaged file is no I/O error")
            }
            Err(_) => {}
        }
        let Ok(report) = check::check(&path) else {
            continue;
        };
        assert!(report.lost_data());
        let recovered = recover::recover(&path, &out, true).unwrap();
        assert!(recovered.lost_data());
        let again = check::check(&out).unwrap();
        assert_eq!(again.damage.len(), 1);
        assert!(
            again.damage[0].starts_with("recovered from "),
            "{:?}",
            again.damage
        );
        let count = |report: &check::Report| {
            report
                .topics
                .values()
                .map(|topic| topic.messages)
                .sum::<u64>()
        };
        assert_eq!(count(&again), count(&report));
    }
    assert!(loaded > 20, "{loaded} of 40 could be loaded");
}
