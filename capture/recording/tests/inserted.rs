//! One byte too many or too few shifts all that follows: what lies behind the damaged chunk comes back.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::HashSet;
use std::fs;
use std::time::{Duration, Instant};

use ft_recording::recover;
use ft_recording::writer::Compression;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{Kept, Numbers, read_messages, write_recording};

fn recording(compression: Compression) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    write_recording(&path, compression, 1000);
    fs::read(path).unwrap()
}

fn key(kept: &Kept) -> (u16, u32, Vec<u8>) {
    (kept.channel_id, kept.sequence, kept.data.clone())
}

/// The messages of all chunks but the one that ends first behind `place`, or lies there.
fn elsewhere(whole: &[Kept], place: u64) -> Vec<&Kept> {
    let hit = whole.iter().map(|kept| kept.ends_at);
    let hit = hit.filter(|end| *end > place).min();
    whole
        .iter()
        .filter(|kept| Some(kept.ends_at) != hit)
        .collect()
}

fn assert_only_one_chunk_is_lost(whole: &[Kept], shifted: &[u8], place: usize, what: &str) {
    let (found, damage) = read_messages(shifted);
    let keys: HashSet<_> = found.iter().map(key).collect();
    assert_eq!(keys.len(), found.len(), "{what}: twice the same");
    let expected = elsewhere(whole, place as u64);
    let missing = expected.iter().filter(|kept| !keys.contains(&key(kept)));
    assert_eq!(missing.count(), 0, "{what}: {damage:?}");
    let known: HashSet<_> = whole.iter().map(key).collect();
    assert!(keys.is_subset(&known), "{what}: invented");
    if found.len() < whole.len() {
        assert!(!damage.is_empty(), "{what}: lost in silence");
    }
}

/// Places in the chunks' part of the file, of each kind: in content, headers and indexes.
fn places(bytes: &[u8], whole: &[Kept], numbers: &mut Numbers, count: usize) -> Vec<usize> {
    let first = whole.iter().map(|kept| kept.ends_at).min().unwrap();
    let last = whole.iter().map(|kept| kept.ends_at).max().unwrap();
    assert!(last < bytes.len() as u64);
    // All that lies between two chunks, and the second one's header.
    let between = first as usize..first as usize + 500;
    let anywhere = (0..count).map(|_| (first + numbers.below(last - first)) as usize);
    between.chain(anywhere).collect()
}

#[test]
fn one_byte_too_many_costs_one_chunk() {
    let mut numbers = Numbers(11);
    for compression in [Compression::Zstd, Compression::None] {
        let bytes = recording(compression);
        let (whole, _) = read_messages(&bytes);
        for place in places(&bytes, &whole, &mut numbers, 700) {
            let value = numbers.below(256) as u8;
            let mut shifted = bytes.clone();
            shifted.insert(place, value);
            let what = format!("{compression:?}: {value:#04x} put in at byte {place}");
            assert_only_one_chunk_is_lost(&whole, &shifted, place, &what);
        }
    }
}

#[test]
fn one_byte_too_few_costs_one_chunk() {
    let mut numbers = Numbers(12);
    for compression in [Compression::Zstd, Compression::None] {
        let bytes = recording(compression);
        let (whole, _) = read_messages(&bytes);
        for place in places(&bytes, &whole, &mut numbers, 700) {
            let mut shifted = bytes.clone();
            shifted.remove(place);
            let what = format!("{compression:?}: byte {place} left out");
            assert_only_one_chunk_is_lost(&whole, &shifted, place, &what);
        }
    }
}

#[test]
fn recovery_gives_back_what_lies_behind() {
    let folder = tempfile::tempdir().unwrap();
    let [source, out] = ["torn.mcap", "saved.mcap"].map(|name| folder.path().join(name));
    let bytes = recording(Compression::Zstd);
    let (whole, _) = read_messages(&bytes);
    let place = bytes.len() / 3;
    let mut shifted = bytes.clone();
    shifted.insert(place, 0x5a);
    fs::write(&source, &shifted).unwrap();
    let recovered = recover::recover(&source, &out, false).unwrap();
    let messages: u64 = recovered.topics.values().map(|topic| topic.messages).sum();
    assert!(messages >= elsewhere(&whole, place as u64).len() as u64);
    assert!(recovered.lost_data());
}

/// Headers of chunks that reach to the end of the file, one inside the other: each could be read again and again.
#[test]
fn a_file_of_false_chunks_takes_no_longer_than_a_few_readings() {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    let (length, header) = (4_000_000_u64, 9 + 40);
    while (bytes.len() as u64) < length {
        let left = length + 8 - bytes.len() as u64;
        let packed = left.saturating_sub(header);
        bytes.push(6);
        bytes.extend((packed + 40).to_le_bytes());
        bytes.extend([0; 16]);
        bytes.extend(packed.to_le_bytes());
        bytes.extend([1; 4]);
        bytes.extend([0; 4]);
        bytes.extend(packed.to_le_bytes());
    }
    #[allow(clippy::disallowed_methods, reason = "the time it takes is tested")]
    let begun = Instant::now();
    let (messages, damage) = read_messages(&bytes);
    assert_eq!(messages.len(), 0);
    assert!(!damage.is_empty());
    assert!(begun.elapsed() < Duration::from_secs(20));
}
