//! Cut and corrupted files: what was before the damage is given back, nothing panics or hangs, nothing is invented.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::io::Cursor;

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
    let channel_id = writer.add_channel(0, "/numbers", "text/plain", &BTreeMap::new()).unwrap();
    for sequence in 0..messages {
        let time = u64::from(sequence) * 1_000_000;
        let header = MessageHeader { channel_id, sequence, log_time: time, publish_time: time };
        writer.write_to_known_channel(&header, format!("message number {sequence}").as_bytes()).unwrap();
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
        ("lz4", foreign(mcap_options().compression(Some(mcap::Compression::Lz4))), true),
        ("no chunks", foreign(mcap_options().use_chunks(false)), false),
    ]
}

fn assert_starts_with(found: &[Kept], expected: &[Kept], what: &str) {
    assert!(found.len() >= expected.len(), "{what}: {} of {} messages", found.len(), expected.len());
    for (found, expected) in found.iter().zip(expected) {
        assert_eq!((found.channel_id, found.sequence), (expected.channel_id, expected.sequence), "{what}");
        assert_eq!((&found.data, found.log_time), (&expected.data, expected.log_time), "{what}");
    }
}

fn before(whole: &[Kept], end: u64) -> Vec<Kept> {
    whole.iter().take_while(|message| message.ends_at <= end).cloned().collect()
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
        let known: HashSet<_> =
            whole.iter().map(|kept| (kept.channel_id, kept.sequence, kept.data.clone())).collect();
        let mut noticed = 0;
        for _ in 0..500 {
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
                assert!(!damage.is_empty(), "{what}: {} messages lost in silence", whole.len() - found.len());
            }
            noticed += u32::from(!damage.is_empty());
        }
        assert!(noticed > 300, "{name}: {noticed} of 500 wrong bytes noticed");
    }
}

#[test]
fn one_wrong_byte_in_a_chunk_costs_that_chunk_only() {
    let bytes = ours(Compression::None);
    let (whole, _) = read_messages(&bytes);
    let middle = whole[whole.len() / 2].ends_at;
    let chunk: Vec<_> = whole.iter().filter(|message| message.ends_at == middle).collect();
    let mut corrupted = bytes.clone();
    corrupted[middle as usize - 40] ^= 1;
    let (found, damage) = read_messages(&corrupted);
    assert_eq!(found.len(), whole.len() - chunk.len());
    assert!(chunk.len() < 330, "a chunk holds 100 ms of 3.1 messages each");
    assert_eq!(damage.len(), 2, "{damage:?}");
    assert!(damage[0].contains("chunk content has CRC"), "{damage:?}");
    assert!(damage[1].contains("it was altered"), "{damage:?}");
}

#[test]
fn a_wrong_length_costs_one_chunk_only() {
    let bytes = foreign(mcap_options().compression(None));
    let (whole, _) = read_messages(&bytes);
    let header = bytes.windows(9).position(|window| window[0] == 6 && window[1..9] > [0; 8][..]).unwrap();
    for value in [0, 1, 0x7f, 0xff] {
        let mut corrupted = bytes.clone();
        corrupted[header + 6] = value;
        let (found, _) = read_messages(&corrupted);
        assert_eq!(found.len(), whole.len(), "a chunk's own sizes are believed more than its record length");
    }
    let mut corrupted = bytes.clone();
    corrupted[header] = 0;
    let (found, damage) = read_messages(&corrupted);
    let first_chunk = whole.iter().filter(|message| message.ends_at == whole[0].ends_at).count();
    assert_eq!(found.len(), whole.len() - first_chunk);
    assert!(damage[0].contains("are no records"), "{damage:?}");
}

/// The chunk that was open when another recorder was killed: its header is a placeholder.
#[test]
fn an_open_chunk_of_another_recorder_is_read_as_far_as_it_goes() {
    let mut file = Cursor::new(Vec::new());
    let mut writer = mcap_options().compression(None).chunk_size(None).create(&mut file).unwrap();
    fill_foreign(&mut writer, 100);
    writer.flush().unwrap();
    let channel_id = 1;
    for sequence in 100..200 {
        let header = MessageHeader { channel_id, sequence, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, b"open").unwrap();
    }
    let bytes = writer.into_inner().get_ref().clone();
    assert!(bytes.windows(8).any(|window| window == [0xff; 8]), "the header must be a placeholder");
    let (found, damage) = read_messages(&bytes);
    assert_eq!(found.len(), 200);
    assert_eq!(damage.len(), 1);
    assert!(damage[0].contains("100 whole messages in them"), "{damage:?}");
    let (found, _) = read_messages(&bytes[..bytes.len() - 1]);
    assert_eq!(found.len(), 199);
}

#[test]
fn the_whole_pipeline_survives_damaged_files() {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("a.mcap.partial"), folder.path().join("a.mcap"));
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
            Err(ReadError::Io { .. } | ReadError::Write(_)) => panic!("a damaged file is no I/O error"),
            Err(_) => {}
        }
        let Ok(report) = check::check(&path) else { continue };
        assert!(report.lost_data());
        let recovered = recover::recover(&path, &out, true).unwrap();
        assert!(recovered.lost_data());
        let again = check::check(&out).unwrap();
        assert_eq!(again.damage, Vec::<String>::new());
        let count = |report: &check::Report| report.topics.values().map(|topic| topic.messages).sum::<u64>();
        assert_eq!(count(&again), count(&report));
    }
    assert!(loaded > 20, "{loaded} of 40 could be loaded");
}
