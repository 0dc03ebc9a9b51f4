//! Files of a tree whose folders may be zipped, also twice.
//!
//! ZIP: the central directory at the end names the entries; each is stored or deflated, and checked by its CRC-32. Encrypted,
//! split and 64-bit archives are refused.
//!
//! # Source
//! PKWARE, APPNOTE.TXT 6.3.10, sections 4.3.7, 4.3.12, 4.3.16.

use std::path::{Path, PathBuf};

use super::{ImportError, io};

/// Largest file that is unpacked, bytes.
const LIMIT: usize = 1 << 30;
/// Zips within zips.
const DEPTH: usize = 3;

/// A file of a tree.
#[derive(Clone, Debug)]
pub struct Found {
    /// Where it was, for messages.
    pub path: PathBuf,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// The bytes of a file, unpacked when it is packed with gzip.
///
/// # Errors
/// It cannot be read, or what it holds is cut short or changed.
///
/// # Source
/// RFC 1952, section 2.3.
pub fn read(path: &Path) -> Result<Vec<u8>, ImportError> {
    let bytes = std::fs::read(path).map_err(io("read", path))?;
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(bytes);
    }
    gunzip(&bytes).ok_or_else(|| ImportError::Content {
        path: path.to_owned(),
        reason: "it is packed with gzip and cut short or damaged; fetch it again".to_owned(),
    })
}

fn gunzip(bytes: &[u8]) -> Option<Vec<u8>> {
    let flags = *bytes.get(3)?;
    if bytes.get(2) != Some(&8) {
        return None;
    }
    let mut at = 10;
    if flags & 4 != 0 {
        at += 2 + usize::from(u16_at(bytes, at)?);
    }
    // The file's name and a comment, each ended by a zero.
    for flag in [8, 16] {
        if flags & flag != 0 {
            at += bytes.get(at..)?.iter().position(|byte| *byte == 0)? + 1;
        }
    }
    if flags & 2 != 0 {
        at += 2;
    }
    let end = bytes.len().checked_sub(8)?;
    let unpacked =
        miniz_oxide::inflate::decompress_to_vec_with_limit(bytes.get(at..end)?, LIMIT).ok()?;
    (u32_at(bytes, end)? == crc32fast::hash(&unpacked)).then_some(unpacked)
}

/// Finds `parts` below `folder`, in folders or in archives `<part>.zip`. In the last part a leading `*` stands for anything.
///
/// # Errors
/// A file or an archive on the way cannot be read.
pub fn find(folder: &Path, parts: &[&str]) -> Result<Option<Found>, ImportError> {
    let Some((first, rest)) = parts.split_first() else {
        return Ok(None);
    };
    if rest.is_empty() {
        if let Some(path) = in_folder(folder, first)? {
            let bytes = read(&path)?;
            return Ok(Some(Found { path, bytes }));
        }
        return Ok(None);
    }
    let below = folder.join(first);
    if below.is_dir()
        && let Some(found) = find(&below, rest)?
    {
        return Ok(Some(found));
    }
    let zip = folder.join(format!("{first}.zip"));
    if zip.is_file() {
        let bytes = std::fs::read(&zip).map_err(io("read", &zip))?;
        return find_in_zip(&zip, &bytes, rest, DEPTH);
    }
    Ok(None)
}

/// The first file of a folder that `name` fits.
fn in_folder(folder: &Path, name: &str) -> Result<Option<PathBuf>, ImportError> {
    if !name.starts_with('*') {
        let path = folder.join(name);
        return Ok(path.is_file().then_some(path));
    }
    if !folder.is_dir() {
        return Ok(None);
    }
    let mut fitting = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io("list", folder))? {
        let path = entry.map_err(io("list", folder))?.path();
        let text = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_file() && fits(&text, name) {
            fitting.push(path);
        }
    }
    fitting.sort();
    Ok(fitting.into_iter().next())
}

fn fits(text: &str, name: &str) -> bool {
    match name.strip_prefix('*') {
        Some(end) => text.ends_with(end),
        None => text == name,
    }
}

/// An entry fits when its path ends with `parts`; the archive of the archive is looked into too.
fn find_in_zip(
    archive: &Path,
    bytes: &[u8],
    parts: &[&str],
    depth: usize,
) -> Result<Option<Found>, ImportError> {
    let entries = entries(bytes).map_err(|reason| broken(archive, &reason))?;
    let ends = |name: &str| {
        let names: Vec<_> = name.split('/').collect();
        names.len() >= parts.len()
            && names
                .iter()
                .rev()
                .zip(parts.iter().rev())
                .all(|(text, part)| fits(text, part))
    };
    let mut names: Vec<_> = entries.iter().collect();
    names.sort_by(|a, b| a.name.cmp(&b.name));
    let hidden = |name: &str| name.starts_with("__MACOSX/");
    if let Some(entry) = names
        .iter()
        .find(|entry| ends(&entry.name) && !hidden(&entry.name))
    {
        let inside = entry
            .unpack(bytes)
            .map_err(|reason| broken(archive, &reason))?;
        return Ok(Some(Found {
            path: archive.join(&entry.name),
            bytes: inside,
        }));
    }
    if depth == 0 {
        return Ok(None);
    }
    let is_zip = |name: &str| name.ends_with(".zip") && !hidden(name);
    let zips = names.iter().filter(|entry| is_zip(&entry.name)).count();
    for entry in names.iter().filter(|entry| is_zip(&entry.name)) {
        // A zip of another stream is not what is looked for.
        let stem = entry.name.trim_end_matches(".zip");
        let stem = stem.rsplit('/').next().unwrap_or(stem);
        let archive_stem = archive.file_stem().unwrap_or_default().to_string_lossy();
        let from = match parts.iter().position(|part| *part == stem) {
            Some(place) => place + 1,
            None if zips == 1 || stem == archive_stem => 0,
            None => continue,
        };
        let inside = entry
            .unpack(bytes)
            .map_err(|reason| broken(archive, &reason))?;
        let path = archive.join(&entry.name);
        if let Some(found) = find_in_zip(&path, &inside, &parts[from..], depth - 1)? {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

fn broken(archive: &Path, reason: &str) -> ImportError {
    ImportError::Content {
        path: archive.to_owned(),
        reason: format!("{reason}; fetch the archive again or unpack it with `unzip`"),
    }
}

/// An entry of the central directory.
struct Entry {
    name: String,
    method: u16,
    crc: u32,
    packed: usize,
    size: usize,
    offset: usize,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    bytes
        .get(at..at + 2)?
        .try_into()
        .ok()
        .map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    bytes
        .get(at..at + 4)?
        .try_into()
        .ok()
        .map(u32::from_le_bytes)
}

const END: u32 = 0x0605_4b50;
const CENTRAL: u32 = 0x0201_4b50;
const LOCAL: u32 = 0x0403_4b50;

fn entries(bytes: &[u8]) -> Result<Vec<Entry>, String> {
    let cut = || "it is no zip archive, or was cut short".to_owned();
    // The end record is 22 bytes and a comment of up to 64 KiB.
    let first = bytes.len().saturating_sub(22 + 65_535);
    let end = (first..bytes.len().saturating_sub(21))
        .rev()
        .find(|at| u32_at(bytes, *at) == Some(END))
        .ok_or_else(cut)?;
    let count = u16_at(bytes, end + 10).ok_or_else(cut)?;
    let start = u32_at(bytes, end + 16).ok_or_else(cut)?;
    if count == u16::MAX || start == u32::MAX {
        return Err("it is a 64-bit zip, which is not read".to_owned());
    }
    let mut at = start as usize;
    let mut entries = Vec::new();
    for _ in 0..count {
        if u32_at(bytes, at) != Some(CENTRAL) {
            return Err(cut());
        }
        let short = |offset| u16_at(bytes, at + offset).ok_or_else(cut);
        let long = |offset| u32_at(bytes, at + offset).ok_or_else(cut);
        let (flags, name_length) = (short(8)?, usize::from(short(28)?));
        let name = bytes.get(at + 46..at + 46 + name_length).ok_or_else(cut)?;
        let name = String::from_utf8_lossy(name).replace('\\', "/");
        if flags & 1 != 0 {
            return Err(format!("{name} is encrypted"));
        }
        entries.push(Entry {
            name,
            method: short(10)?,
            crc: long(16)?,
            packed: long(20)? as usize,
            size: long(24)? as usize,
            offset: long(42)? as usize,
        });
        at += 46 + name_length + usize::from(short(30)?) + usize::from(short(32)?);
    }
    Ok(entries)
}

impl Entry {
    fn unpack(&self, archive: &[u8]) -> Result<Vec<u8>, String> {
        let cut = || format!("{} is cut short", self.name);
        if self.size > LIMIT {
            return Err(format!(
                "{} has {} bytes, at most {LIMIT} are unpacked",
                self.name, self.size
            ));
        }
        if u32_at(archive, self.offset) != Some(LOCAL) {
            return Err(cut());
        }
        let skip = |at| {
            u16_at(archive, self.offset + at)
                .map(usize::from)
                .ok_or_else(cut)
        };
        let start = self.offset + 30 + skip(26)? + skip(28)?;
        let packed = archive
            .get(start..start.saturating_add(self.packed))
            .ok_or_else(cut)?;
        let bytes = match self.method {
            0 => packed.to_vec(),
            8 => miniz_oxide::inflate::decompress_to_vec_with_limit(packed, self.size)
                .map_err(|error| format!("{}: {error}", self.name))?,
            method => {
                return Err(format!(
                    "{} is packed by method {method}, only 0 and 8 are read",
                    self.name
                ));
            }
        };
        let crc = crc32fast::hash(&bytes);
        if crc != self.crc || bytes.len() != self.size {
            return Err(format!(
                "{}: CRC-32 is {crc:08x}, expected {:08x}",
                self.name, self.crc
            ));
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An archive of one stored entry.
    fn stored(name: &str, data: &[u8]) -> Vec<u8> {
        let crc = crc32fast::hash(data).to_le_bytes();
        let size = (data.len() as u32).to_le_bytes();
        let length = (name.len() as u16).to_le_bytes();
        let mut zip = Vec::new();
        zip.extend(LOCAL.to_le_bytes());
        zip.extend([20, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        zip.extend(
            crc.iter()
                .chain(&size)
                .chain(&size)
                .chain(&length)
                .chain(&[0, 0]),
        );
        zip.extend(name.as_bytes());
        zip.extend(data);
        let central = zip.len() as u32;
        zip.extend(CENTRAL.to_le_bytes());
        zip.extend([20, 0, 20, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        zip.extend(crc.iter().chain(&size).chain(&size).chain(&length));
        zip.extend([0; 16]);
        zip.extend(name.as_bytes());
        let directory = zip.len() as u32 - central;
        zip.extend(END.to_le_bytes());
        zip.extend([0, 0, 0, 0, 1, 0, 1, 0]);
        zip.extend(directory.to_le_bytes().iter().chain(&central.to_le_bytes()));
        zip.extend([0, 0]);
        zip
    }

    #[test]
    fn a_file_is_found_in_folders_in_a_zip_and_in_a_zip_in_a_zip() {
        let folder = tempfile::tempdir().unwrap();
        let parts = ["force", "wrench", "data.csv"];
        assert!(find(folder.path(), &parts).unwrap().is_none());
        let once = stored("wrench/data.csv", b"zip");
        let twice = stored("wrench.zip", &once);
        std::fs::create_dir_all(folder.path().join("force")).unwrap();
        std::fs::write(folder.path().join("force/wrench.zip"), &twice).unwrap();
        assert_eq!(find(folder.path(), &parts).unwrap().unwrap().bytes, b"zip");
        std::fs::write(folder.path().join("force/wrench.zip"), &once).unwrap();
        assert_eq!(find(folder.path(), &parts).unwrap().unwrap().bytes, b"zip");
        std::fs::create_dir_all(folder.path().join("force/wrench")).unwrap();
        std::fs::write(folder.path().join("force/wrench/data.csv"), b"plain").unwrap();
        assert_eq!(
            find(folder.path(), &parts).unwrap().unwrap().bytes,
            b"plain"
        );
        let any = find(folder.path(), &["force", "wrench", "*ta.csv"]).unwrap();
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
            assert!(find(folder.path(), &["a", "data.csv"]).is_err(), "{cut}");
        }
        for at in 0..whole.len() {
            let mut wrong = whole.clone();
            wrong[at] ^= 0x55;
            std::fs::write(&path, &wrong).unwrap();
            if let Ok(Some(found)) = find(folder.path(), &["a", "data.csv"]) {
                assert_eq!(found.bytes, b"0123456789", "{at}");
            }
        }
    }
}
