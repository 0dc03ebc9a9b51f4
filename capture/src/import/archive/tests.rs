use super::*;

/// How the archives of the tests are written.
#[derive(Clone, Copy, PartialEq)]
enum Style {
    Stored,
    Deflated,
    /// Sizes and places in fields of 64 bits.
    Long,
}

/// An archive, by APPNOTE.TXT and not by the reader's constants.
fn zipped(files: &[(&str, &[u8])], style: Style) -> Vec<u8> {
    let (mut zip, mut directory) = (Vec::new(), Vec::new());
    let is_long = style == Style::Long;
    for (name, data) in files {
        let packed = match style {
            Style::Deflated => miniz_oxide::deflate::compress_to_vec(data, 6),
            _ => data.to_vec(),
        };
        let method = if style == Style::Deflated { 8 } else { 0 };
        let crc = crc32fast::hash(data).to_le_bytes();
        let [size, packed_size, offset] = [data.len(), packed.len(), zip.len()].map(|n| n as u64);
        let short = |n: u64| {
            if is_long {
                [0xff; 4]
            } else {
                (n as u32).to_le_bytes()
            }
        };
        let name_length = (name.len() as u16).to_le_bytes();
        // A field of another kind stands before the long one.
        let mut extra = vec![0xfe, 0xca, 1, 0, 7];
        if is_long {
            extra.extend([1, 0, 24, 0]);
            extra.extend([size, packed_size, offset].map(u64::to_le_bytes).concat());
        }
        let extra_length = (extra.len() as u16).to_le_bytes();
        let sizes = [crc, short(packed_size), short(size)].concat();
        zip.extend(*b"PK\x03\x04");
        zip.extend([45, 0, 0, 0, method, 0, 0, 0, 0, 0]);
        zip.extend([&sizes[..], &name_length, &[0, 0], name.as_bytes(), &packed].concat());
        directory.extend(*b"PK\x01\x02");
        directory.extend([45, 0, 45, 0, 0, 0, method, 0, 0, 0, 0, 0]);
        directory.extend([&sizes[..], &name_length, &extra_length, &[0; 10]].concat());
        directory.extend([&short(offset)[..], name.as_bytes(), &extra].concat());
    }
    let (start, length, count) = (zip.len() as u64, directory.len() as u64, files.len() as u64);
    zip.extend(directory);
    if is_long {
        let end = zip.len() as u64;
        zip.extend(*b"PK\x06\x06");
        zip.extend(44_u64.to_le_bytes());
        zip.extend([45, 0, 45, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        zip.extend([count, count, length, start].map(u64::to_le_bytes).concat());
        zip.extend(*b"PK\x06\x07\0\0\0\0");
        zip.extend(end.to_le_bytes());
        zip.extend([1, 0, 0, 0]);
    }
    zip.extend(*b"PK\x05\x06\0\0\0\0");
    let (count, long) = ((count as u16).to_le_bytes(), [0xff; 4]);
    zip.extend([count, count].concat());
    zip.extend(if is_long {
        long
    } else {
        (length as u32).to_le_bytes()
    });
    zip.extend(if is_long {
        long
    } else {
        (start as u32).to_le_bytes()
    });
    zip.extend([0, 0]);
    zip
}

fn stored(name: &str, data: &[u8]) -> Vec<u8> {
    zipped(&[(name, data)], Style::Stored)
}

#[test]
fn archives_in_archives_are_read_however_they_are_packed() {
    let folder = tempfile::tempdir().unwrap();
    let parts = ["gripper", "b_bag", "calib", "x.yaml"];
    for outer in [Style::Stored, Style::Deflated, Style::Long] {
        for inner in [Style::Stored, Style::Deflated, Style::Long] {
            // The like-named archive of another recording stands before.
            let [a, b] = [b"of a", b"of b"].map(|data| zipped(&[("calib/x.yaml", data)], inner));
            let files: [(&str, &[u8]); 3] = [
                ("gripper/a_bag/calib.zip", &a),
                ("gripper/b_bag/calib.zip", &b),
                ("gripper/b_bag/image.png", b"not looked at"),
            ];
            std::fs::write(folder.path().join("gripper.zip"), zipped(&files, outer)).unwrap();
            let found = Tree::default()
                .find(folder.path(), &parts)
                .unwrap()
                .unwrap();
            assert_eq!(found.bytes, b"of b");
            assert!(
                found
                    .path
                    .ends_with("gripper.zip/gripper/b_bag/calib.zip/calib/x.yaml")
            );
            // The folder that is asked for may itself be in the archive.
            let below = folder.path().join("gripper/a_bag");
            let found = Tree::default().find(&below, &["calib", "x.yaml"]).unwrap();
            assert_eq!(found.unwrap().bytes, b"of a");
        }
    }
}

#[test]
fn a_file_is_found_in_folders_in_a_zip_and_in_a_zip_in_a_zip() {
    let folder = tempfile::tempdir().unwrap();
    let parts = ["force", "wrench", "data.csv"];
    assert!(
        Tree::default()
            .find(folder.path(), &parts)
            .unwrap()
            .is_none()
    );
    let once = stored("wrench/data.csv", b"zip");
    let twice = stored("wrench.zip", &once);
    std::fs::create_dir_all(folder.path().join("force")).unwrap();
    std::fs::write(folder.path().join("force/wrench.zip"), &twice).unwrap();
    assert_eq!(
        Tree::default()
            .find(folder.path(), &parts)
            .unwrap()
            .unwrap()
            .bytes,
        b"zip"
    );
    std::fs::write(folder.path().join("force/wrench.zip"), &once).unwrap();
    assert_eq!(
        Tree::default()
            .find(folder.path(), &parts)
            .unwrap()
            .unwrap()
            .bytes,
        b"zip"
    );
    std::fs::create_dir_all(folder.path().join("force/wrench")).unwrap();
    std::fs::write(folder.path().join("force/wrench/data.csv"), b"plain").unwrap();
    assert_eq!(
        Tree::default()
            .find(folder.path(), &parts)
            .unwrap()
            .unwrap()
            .bytes,
        b"plain"
    );
    let any = Tree::default()
        .find(folder.path(), &["force", "wrench", "*ta.csv"])
        .unwrap();
    assert_eq!(any.unwrap().bytes, b"plain");
}

/// A gzip file with a name and a comment.
fn gzipped(data: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0x1f, 0x8b, 8, 8 | 16, 0, 0, 0, 0, 0, 3];
    bytes.extend(b"data.csv\0a comment\0");
    bytes.extend(miniz_oxide::deflate::compress_to_vec(data, 6));
    bytes.extend(crc32fast::hash(data).to_le_bytes());
    bytes.extend((data.len() as u32).to_le_bytes());
    bytes
}

#[test]
fn a_file_packed_with_gzip_is_unpacked_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv.gz");
    let (data, whole) = (b"a,b\n1,2\n".repeat(40), gzipped(&b"a,b\n1,2\n".repeat(40)));
    std::fs::write(&path, &whole).unwrap();
    assert_eq!(read(&path).unwrap(), data);
    // The first two bytes make it one.
    for cut in 2..whole.len() {
        std::fs::write(&path, &whole[..cut]).unwrap();
        assert!(read(&path).is_err(), "{cut}");
    }
    for at in 2..whole.len() {
        let mut wrong = whole.clone();
        wrong[at] ^= 0x55;
        std::fs::write(&path, &wrong).unwrap();
        assert!(read(&path).is_err() || read(&path).unwrap() == data, "{at}");
    }
}

#[test]
fn a_damaged_archive_is_named_and_never_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.zip");
    let whole = stored("a/data.csv", b"0123456789");
    for cut in 0..whole.len() {
        std::fs::write(&path, &whole[..cut]).unwrap();
        assert!(
            Tree::default()
                .find(folder.path(), &["a", "data.csv"])
                .is_err(),
            "{cut}"
        );
    }
    for at in 0..whole.len() {
        let mut wrong = whole.clone();
        wrong[at] ^= 0x55;
        std::fs::write(&path, &wrong).unwrap();
        if let Ok(Some(found)) = Tree::default().find(folder.path(), &["a", "data.csv"]) {
            assert_eq!(found.bytes, b"0123456789", "{at}");
        }
    }
}

#[test]
fn an_inner_archive_that_says_it_is_longer_than_the_outer_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let inner = zipped(&[("wrench/data.csv", b"a")], Style::Stored);
    let outer = zipped(&[("wrench.zip", &inner)], Style::Long);
    // The long field of its size, in the directory.
    let at = outer
        .windows(12)
        .position(|bytes| {
            bytes[..4] == [1, 0, 24, 0] && bytes[4..] == (inner.len() as u64).to_le_bytes()
        })
        .unwrap();
    for size in [u64::MAX, u64::MAX / 2, outer.len() as u64] {
        let mut wrong = outer.clone();
        wrong[at + 4..at + 12].copy_from_slice(&size.to_le_bytes());
        std::fs::write(folder.path().join("force.zip"), &wrong).unwrap();
        let found = Tree::default().find(folder.path(), &["force", "wrench", "data.csv"]);
        let message = found.unwrap_err().to_string();
        assert!(
            message.contains("wrench.zip is cut short"),
            "{size}: {message}"
        );
    }
}

#[test]
fn what_unpacks_to_more_than_memory_should_hold_is_refused_before_it_does() {
    let folder = tempfile::tempdir().unwrap();
    let rows = b"0,0,0,0,0,0,0\n".repeat((LIMIT + 1_000_000) / 14 + 1);
    let path = folder.path().join("a.csv.gz");
    let packed = gzipped(&rows);
    assert!(packed.len() < 4_000_000);
    std::fs::write(&path, packed).unwrap();
    let text = read(&path).unwrap_err().to_string();
    assert!(
        text.contains("unpacks to more than 256 MiB") && text.contains("gunzip"),
        "{text}"
    );
    let zip = zipped(&[("wrench/data.csv", &rows)], Style::Deflated);
    drop(rows);
    assert!(zip.len() < 4_000_000);
    let path = folder.path().join("wrench.zip");
    std::fs::write(&path, &zip).unwrap();
    let find = || Tree::default().find(folder.path(), &["wrench", "data.csv"]);
    let text = find().unwrap_err().to_string();
    assert!(
        text.contains("wrench/data.csv unpacks to 256 MiB") && text.contains("unzip"),
        "{text}"
    );
    // One that says it is small ends where it said.
    let mut lies = zip;
    let central = lies
        .windows(4)
        .rposition(|four| four == b"PK\x01\x02")
        .unwrap();
    lies[central + 24..central + 28].copy_from_slice(&1_000_u32.to_le_bytes());
    std::fs::write(&path, &lies).unwrap();
    let text = find().unwrap_err().to_string();
    assert!(
        text.contains("longer than the 1000 bytes it says"),
        "{text}"
    );
    // An archive within one, which would fill the disk.
    let inner = zipped(
        &[("wrench/data.csv", &vec![0; LIMIT + 1_000_000])],
        Style::Stored,
    );
    std::fs::write(&path, zipped(&[("wrench.zip", &inner)], Style::Deflated)).unwrap();
    drop(inner);
    let text = find().unwrap_err().to_string();
    assert!(text.contains("more than a hundred times"), "{text}");
}
