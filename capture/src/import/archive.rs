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

use miniz_oxide::inflate::{TINFLStatus, decompress_to_vec_with_limit};
use zip::{Archive, u16_at, u32_at};

/// Largest file that is unpacked into memory, bytes: a quarter of an hour of MPS poses at 1 kHz.
const LIMIT: usize = 1 << 28;
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
    if !is_gzip(&bytes) {
        return Ok(bytes);
    }
    let refused = |reason| ImportError::Content {
        path: path.to_owned(),
        reason,
    };
    match gunzip(&bytes) {
        Ok(unpacked) => Ok(unpacked),
        Err(Gunzip::TooLarge) => Err(refused(format!(
            "it is packed with gzip and unpacks to more than {} MiB; unpack it with `gunzip` first, if it is what it should be",
            LIMIT >> 20
        ))),
        Err(Gunzip::Damaged) => Err(refused(
            "it is packed with gzip and cut short or damaged; fetch it again".to_owned(),
        )),
    }
}

/// Why nothing comes out of gzip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gunzip {
    TooLarge,
    Damaged,
}

/// Whether a file that begins with `bytes` is packed with gzip.
pub(super) fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b])
}

fn gunzip(bytes: &[u8]) -> Result<Vec<u8>, Gunzip> {
    let (packed, crc) = gzip_parts(bytes).ok_or(Gunzip::Damaged)?;
    let unpacked = decompress_to_vec_with_limit(packed, LIMIT);
    let unpacked = unpacked.map_err(|error| match error.status {
        TINFLStatus::HasMoreOutput => Gunzip::TooLarge,
        _ => Gunzip::Damaged,
    })?;
    match crc32fast::hash(&unpacked) == crc {
        true => Ok(unpacked),
        false => Err(Gunzip::Damaged),
    }
}

/// What is packed, and its CRC-32.
fn gzip_parts(bytes: &[u8]) -> Option<(&[u8], u32)> {
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
    Some((bytes.get(at..end)?, u32_at(bytes, end)?))
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
        // `._x.yaml` is what macOS puts beside `x.yaml`.
        Some(end) => text.ends_with(end) && !text.starts_with('.'),
        None => text == name,
    }
}

#[cfg(test)]
mod tests;
