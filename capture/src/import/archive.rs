//! Files of a tree whose folders may be zipped, also twice.
//!
//! Archives are read where something is looked for, by seeking: neither they nor what they hold stand in memory, save the one file
//! that is asked for. An archive that is packed within another goes through a file without a name in the system's temporary folder
//! (`TMPDIR`), unless it is stored as it is.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::{ImportError, io};

mod zip;

use zip::{Archive, u16_at, u32_at};

/// Largest file that is unpacked into memory, bytes.
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

/// Archives that were looked into, so that each is opened once.
#[derive(Debug, Default)]
pub struct Tree {
    opened: BTreeMap<PathBuf, Rc<Archive>>,
}

impl Tree {
    /// Finds `parts` below `folder`, in folders or in archives `<part>.zip`; `folder` itself may lie in such an archive. In the last
    /// part a leading `*` stands for anything.
    ///
    /// # Errors
    /// A file or an archive on the way cannot be read.
    pub fn find(&mut self, folder: &Path, parts: &[&str]) -> Result<Option<Found>, ImportError> {
        if !folder.is_dir()
            && let (Some(parent), Some(last)) = (folder.parent(), folder.file_name())
        {
            let last = last.to_string_lossy();
            let parts: Vec<_> = std::iter::once(&*last)
                .chain(parts.iter().copied())
                .collect();
            return self.find(parent, &parts);
        }
        let Some((first, rest)) = parts.split_first() else {
            return Ok(None);
        };
        if rest.is_empty() {
            let Some(path) = in_folder(folder, first)? else {
                return Ok(None);
            };
            let bytes = read(&path)?;
            return Ok(Some(Found { path, bytes }));
        }
        let below = folder.join(first);
        if below.is_dir()
            && let Some(found) = self.find(&below, rest)?
        {
            return Ok(Some(found));
        }
        let zip = folder.join(format!("{first}.zip"));
        if zip.is_file() {
            return self.find_in_zip(&zip, None, rest, DEPTH);
        }
        Ok(None)
    }

    /// Names of the files of an archive that an import may need, and of those of archives in it when nothing of it fits `wanted`: of
    /// those that are stored as they are, that are named after it, or `group`; others may be of any size. The folder that an archive is
    /// named after is not named.
    ///
    /// # Errors
    /// The archive cannot be read.
    pub fn names(
        &mut self,
        zip: &Path,
        group: &str,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<Vec<String>, ImportError> {
        let archive = self.open(zip, None)?;
        self.names_of(&archive, group, wanted, DEPTH)
    }

    fn names_of(
        &mut self,
        archive: &Rc<Archive>,
        group: &str,
        wanted: &dyn Fn(&str) -> bool,
        depth: usize,
    ) -> Result<Vec<String>, ImportError> {
        let own = archive.path.file_stem().unwrap_or_default();
        let opens = depth > 0 && !archive.names().any(wanted);
        let mut names = Vec::new();
        for name in archive.names() {
            let below = name.strip_suffix(".zip").filter(|_| opens);
            let is_opened = |below: &&str| {
                let stem = below.rsplit('/').next().unwrap_or(below);
                *own == *stem || stem == group || archive.is_stored(name)
            };
            let Some(below) = below.filter(is_opened) else {
                names.push(name.to_owned());
                continue;
            };
            let inner = self.open(&archive.path.join(name), Some((archive, name)))?;
            let inside = self.names_of(&inner, group, wanted, depth - 1)?;
            names.extend(inside.iter().map(|inside| format!("{below}/{inside}")));
        }
        // An archive mostly holds the folder that it is named after.
        let prefix = format!("{}/", own.to_string_lossy());
        if names.iter().all(|name| name.starts_with(&prefix)) {
            for name in &mut names {
                name.drain(..prefix.len());
            }
        }
        Ok(names)
    }

    /// The archive at `path`, or the entry of that name of another.
    fn open(
        &mut self,
        path: &Path,
        within: Option<(&Rc<Archive>, &str)>,
    ) -> Result<Rc<Archive>, ImportError> {
        if let Some(known) = self.opened.get(path) {
            return Ok(Rc::clone(known));
        }
        let archive = Rc::new(match within {
            Some((outer, name)) => outer.inner(name)?,
            None => Archive::open(path)?,
        });
        self.opened.insert(path.to_owned(), Rc::clone(&archive));
        Ok(archive)
    }

    /// An entry fits when its path ends with `parts`; the archive of the archive is looked into too.
    fn find_in_zip(
        &mut self,
        path: &Path,
        within: Option<(&Rc<Archive>, &str)>,
        parts: &[&str],
        depth: usize,
    ) -> Result<Option<Found>, ImportError> {
        let archive = self.open(path, within)?;
        if let Some(name) = archive.names().find(|name| ends(name, parts)) {
            return Ok(Some(Found {
                path: archive.path.join(name),
                bytes: archive.unpack(name)?,
            }));
        }
        if depth == 0 {
            return Ok(None);
        }
        let zips: Vec<&str> = archive.names().filter(|n| n.ends_with(".zip")).collect();
        for name in &zips {
            // A zip of another stream, or of another recording, is not what is looked for.
            let mut folders: Vec<_> = name.trim_end_matches(".zip").split('/').collect();
            let stem = folders.pop().unwrap_or_default();
            let leads = |place: &usize| {
                let above = parts.get(..*place).unwrap_or_default();
                parts.get(*place) == Some(&stem)
                    && folders
                        .iter()
                        .rev()
                        .zip(above.iter().rev())
                        .all(|(a, b)| a == b)
            };
            let mut from: Vec<_> = (0..parts.len())
                .filter(leads)
                .map(|place| place + 1)
                .collect();
            let same = archive.path.file_stem().is_some_and(|own| *own == *stem);
            if from.is_empty() && (zips.len() == 1 || same) {
                from.push(0);
            }
            for from in from {
                let inner = archive.path.join(name);
                let rest = parts.get(from..).unwrap_or_default();
                let found = self.find_in_zip(&inner, Some((&archive, name)), rest, depth - 1)?;
                if found.is_some() {
                    return Ok(found);
                }
            }
        }
        Ok(None)
    }
}

/// Whether the path of an entry ends with `parts`.
fn ends(name: &str, parts: &[&str]) -> bool {
    let names: Vec<_> = name.split('/').collect();
    !parts.is_empty()
        && names.len() >= parts.len()
        && names
            .iter()
            .rev()
            .zip(parts.iter().rev())
            .all(|(text, part)| fits(text, part))
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

#[cfg(test)]
mod tests {
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
            let [size, packed_size, offset] =
                [data.len(), packed.len(), zip.len()].map(|n| n as u64);
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
                let [a, b] =
                    [b"of a", b"of b"].map(|data| zipped(&[("calib/x.yaml", data)], inner));
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
}
