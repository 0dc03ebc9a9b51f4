//! One zip archive, read by seeking.
//!
//! The central directory at the end names the entries; each is stored or deflated, and checked by its CRC-32. Sizes beyond 4 GiB are
//! read; encrypted and split archives are refused.
//!
//! # Source
//! PKWARE, APPNOTE.TXT 6.3.10, sections 4.3.7, 4.3.12, 4.3.14 to 4.3.16, 4.5.3.

use std::fs::File;
use std::io::Write as _;
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use miniz_oxide::inflate::stream::{InflateState, inflate};
use miniz_oxide::{DataFormat, MZError, MZFlush, MZStatus};

use super::LIMIT;
use crate::import::ImportError;

const END: u32 = 0x0605_4b50;
const END_64: u32 = 0x0606_4b50;
const LOCATOR_64: u32 = 0x0706_4b50;
const CENTRAL: u32 = 0x0201_4b50;
const LOCAL: u32 = 0x0403_4b50;
/// Largest directory that is read: a million files.
const MOST_DIRECTORY: u64 = 1 << 28;
/// An archive in an archive is not packed to a smaller part.
const MOST_PACKED: u64 = 100;
/// What is read and unpacked at a time, bytes.
const PIECE: usize = 1 << 16;

/// Why an archive gives nothing.
enum ZipError {
    Io(std::io::Error),
    Broken(String),
    /// What is, and what to do.
    TooLarge(String),
}

impl From<std::io::Error> for ZipError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

impl ZipError {
    fn of(self, path: &Path) -> ImportError {
        match self {
            Self::Io(source) => super::io("read", path)(source),
            Self::TooLarge(reason) => ImportError::Content {
                path: path.to_owned(),
                reason,
            },
            Self::Broken(reason) => ImportError::Content {
                path: path.to_owned(),
                reason: format!("{reason}; fetch the archive again or unpack it with `unzip`"),
            },
        }
    }
}

fn cut() -> ZipError {
    ZipError::Broken("it is no zip archive, or was cut short".to_owned())
}

/// A stretch of a file.
#[derive(Clone, Debug)]
struct Window {
    file: Arc<File>,
    start: u64,
    length: u64,
}

impl Window {
    fn read(&self, at: u64, length: u64) -> Result<Vec<u8>, ZipError> {
        let end = at.checked_add(length).ok_or_else(cut)?;
        let size = usize::try_from(length).map_err(|_| cut())?;
        if end > self.length {
            return Err(cut());
        }
        let mut bytes = vec![0; size];
        self.file.read_exact_at(&mut bytes, self.start + at)?;
        Ok(bytes)
    }
}

/// An archive whose directory was read.
#[derive(Debug)]
pub(super) struct Archive {
    /// Where it is; an archive in an archive is below the path of that.
    pub(super) path: PathBuf,
    window: Window,
    /// Of the files that an import may need, by name.
    entries: Vec<Entry>,
}

impl Archive {
    pub(super) fn open(path: &Path) -> Result<Self, ImportError> {
        let open = || -> Result<Self, ZipError> {
            let file = File::open(path)?;
            let length = file.metadata()?.len();
            Self::of(file, length, path.to_owned())
        };
        open().map_err(|error| error.of(path))
    }

    fn of(file: File, length: u64, path: PathBuf) -> Result<Self, ZipError> {
        let window = Window {
            file: Arc::new(file),
            start: 0,
            length,
        };
        let entries = entries(&window)?;
        Ok(Self {
            path,
            window,
            entries,
        })
    }

    /// Names of its files, sorted; those of which nothing is read are left out.
    pub(super) fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.iter().map(|entry| entry.name.as_str())
    }

    /// Whether a file can be read where it stands.
    pub(super) fn is_stored(&self, name: &str) -> bool {
        self.entry(name).is_ok_and(|entry| entry.method == 0)
    }

    fn entry(&self, name: &str) -> Result<&Entry, ZipError> {
        let found = self.entries.iter().find(|entry| entry.name == name);
        found.ok_or_else(|| ZipError::Broken(format!("{name} is not in it")))
    }

    /// A file's bytes.
    pub(super) fn unpack(&self, name: &str) -> Result<Vec<u8>, ImportError> {
        let unpack = || {
            let entry = self.entry(name)?;
            if entry.size > LIMIT as u64 {
                return Err(ZipError::TooLarge(format!(
                    "{name} unpacks to {} MiB, at most {} are unpacked into memory; unpack the archive with `unzip` first, if it is what it should be",
                    entry.size >> 20,
                    LIMIT >> 20
                )));
            }
            let mut bytes = Vec::new();
            entry.copy(&self.window, &mut |piece| {
                bytes.extend_from_slice(piece);
                Ok(())
            })?;
            Ok(bytes)
        };
        unpack().map_err(|error: ZipError| error.of(&self.path))
    }

    /// The archive that a file of this one is.
    pub(super) fn inner(&self, name: &str) -> Result<Self, ImportError> {
        let path = self.path.join(name);
        let inner = || {
            let entry = self.entry(name)?;
            if entry.method == 0 {
                let start = entry.start(&self.window)?;
                let end = start.checked_add(entry.size);
                if end.is_none_or(|end| end > self.window.length) {
                    return Err(entry.cut());
                }
                let window = Window {
                    file: Arc::clone(&self.window.file),
                    start: self.window.start + start,
                    length: entry.size,
                };
                return Ok(Self {
                    entries: entries(&window)?,
                    path: path.clone(),
                    window,
                });
            }
            // What an archive holds is packed already: no more than some per cent are gained by packing it once more.
            if entry.size > LIMIT as u64 && entry.size / MOST_PACKED > entry.packed {
                return Err(ZipError::TooLarge(format!(
                    "it unpacks to {} MiB, more than a hundred times what it is packed to, as no archive does; unpack it with `unzip` first, \
                     if it is what it should be",
                    entry.size >> 20
                )));
            }
            let mut file = tempfile::tempfile()?;
            entry.copy(&self.window, &mut |piece| file.write_all(piece))?;
            Self::of(file, entry.size, path.clone())
        };
        inner().map_err(|error: ZipError| error.of(&path))
    }
}

/// An entry of the central directory.
#[derive(Debug)]
struct Entry {
    name: String,
    method: u16,
    crc: u32,
    packed: u64,
    size: u64,
    offset: u64,
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    let field = bytes.get(at..at.checked_add(2)?)?.try_into().ok()?;
    Some(u16::from_le_bytes(field))
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let field = bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
    Some(u32::from_le_bytes(field))
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    let field = bytes.get(at..at.checked_add(8)?)?.try_into().ok()?;
    Some(u64::from_le_bytes(field))
}

/// Where the central directory stands, its length and its entries.
fn directory(window: &Window) -> Result<(u64, u64, u64), ZipError> {
    // The end record is 22 bytes and a comment of up to 64 KiB.
    let tail_length = window.length.min(22 + 65_535);
    let tail_at = window.length - tail_length;
    let tail = window.read(tail_at, tail_length)?;
    let end = (0..tail.len().saturating_sub(21))
        .rev()
        .find(|at| u32_at(&tail, *at) == Some(END))
        .ok_or_else(cut)?;
    let count = u16_at(&tail, end + 10).ok_or_else(cut)?;
    let length = u32_at(&tail, end + 12).ok_or_else(cut)?;
    let start = u32_at(&tail, end + 16).ok_or_else(cut)?;
    if count != u16::MAX && start != u32::MAX && length != u32::MAX {
        return Ok((start.into(), length.into(), count.into()));
    }
    let locator = end
        .checked_sub(20)
        .filter(|at| u32_at(&tail, *at) == Some(LOCATOR_64));
    let at = locator.and_then(|at| u64_at(&tail, at + 8));
    let record = window.read(at.ok_or_else(cut)?, 56)?;
    if u32_at(&record, 0) != Some(END_64) {
        return Err(cut());
    }
    let field = |at| u64_at(&record, at).ok_or_else(cut);
    Ok((field(48)?, field(40)?, field(32)?))
}

fn entries(window: &Window) -> Result<Vec<Entry>, ZipError> {
    let (start, length, count) = directory(window)?;
    if length > MOST_DIRECTORY {
        return Err(ZipError::Broken(format!(
            "its directory has {length} bytes, at most {MOST_DIRECTORY} are read"
        )));
    }
    let bytes = window.read(start, length)?;
    let mut at = 0;
    let mut entries = Vec::new();
    for _ in 0..count {
        if u32_at(&bytes, at) != Some(CENTRAL) {
            return Err(cut());
        }
        let short = |offset| u16_at(&bytes, at + offset).ok_or_else(cut);
        let long = |offset| u32_at(&bytes, at + offset).map(u64::from).ok_or_else(cut);
        let [name_length, extra_length, comment] =
            [short(28)?, short(30)?, short(32)?].map(usize::from);
        let name = bytes.get(at + 46..at + 46 + name_length).ok_or_else(cut)?;
        let name = String::from_utf8_lossy(name).replace('\\', "/");
        let extra = at + 46 + name_length;
        let extra = bytes.get(extra..extra + extra_length).ok_or_else(cut)?;
        let mut long_fields = Extra64::of(extra);
        // In this order, each only where the short field is full.
        let size = long_fields.or(long(24)?).ok_or_else(cut)?;
        let packed = long_fields.or(long(20)?).ok_or_else(cut)?;
        let offset = long_fields.or(long(42)?).ok_or_else(cut)?;
        if is_of_use(&name) {
            if short(8)? & 1 != 0 {
                return Err(ZipError::Broken(format!("{name} is encrypted")));
            }
            entries.push(Entry {
                name,
                method: short(10)?,
                crc: u32_at(&bytes, at + 16).ok_or_else(cut)?,
                packed,
                size,
                offset,
            });
        }
        at += 46 + name_length + extra_length + comment;
    }
    entries.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(entries)
}

/// Images, which are most of such archives, are not even remembered, and what macOS puts beside each file is none.
fn is_of_use(name: &str) -> bool {
    let kinds = [".csv", ".yaml", ".yml", ".json", ".jsonl", ".zip"];
    let is_hidden = name
        .rsplit('/')
        .next()
        .is_some_and(|last| last.starts_with('.'));
    kinds.iter().any(|kind| name.ends_with(kind)) && !name.starts_with("__MACOSX/") && !is_hidden
}

/// The extra field 1 of an entry: its numbers of 64 bits.
struct Extra64<'a>(&'a [u8]);

impl<'a> Extra64<'a> {
    fn of(mut extra: &'a [u8]) -> Self {
        while let (Some(kind), Some(length)) = (u16_at(extra, 0), u16_at(extra, 2)) {
            let end = 4 + usize::from(length);
            if kind == 1 {
                return Self(extra.get(4..end).unwrap_or_default());
            }
            extra = extra.get(end..).unwrap_or_default();
        }
        Self(&[])
    }

    /// The field, or the next of these when it is full.
    fn or(&mut self, field: u64) -> Option<u64> {
        if field != u64::from(u32::MAX) {
            return Some(field);
        }
        let long = u64_at(self.0, 0)?;
        self.0 = self.0.get(8..)?;
        Some(long)
    }
}

impl Entry {
    /// Where its bytes begin.
    fn start(&self, window: &Window) -> Result<u64, ZipError> {
        let local = window.read(self.offset, 30)?;
        if u32_at(&local, 0) != Some(LOCAL) {
            return Err(self.cut());
        }
        let skip = |at| u16_at(&local, at).map(u64::from).ok_or_else(cut);
        Ok(self.offset + 30 + skip(26)? + skip(28)?)
    }

    fn cut(&self) -> ZipError {
        ZipError::Broken(format!("{} is cut short", self.name))
    }

    /// Gives its bytes to `sink`, piece by piece.
    fn copy(
        &self,
        window: &Window,
        sink: &mut dyn FnMut(&[u8]) -> std::io::Result<()>,
    ) -> Result<(), ZipError> {
        let start = self.start(window)?;
        let (mut crc, mut size) = (crc32fast::Hasher::new(), 0_u64);
        let mut take = |piece: &[u8]| -> Result<(), ZipError> {
            size += piece.len() as u64;
            if size > self.size {
                return Err(ZipError::Broken(format!(
                    "{} is longer than the {} bytes it says",
                    self.name, self.size
                )));
            }
            crc.update(piece);
            Ok(sink(piece)?)
        };
        let mut at = 0;
        let mut next = || {
            let length = (self.packed - at).min(PIECE as u64);
            let piece = window.read(start + at, length)?;
            at += length;
            Ok::<_, ZipError>(piece)
        };
        match self.method {
            0 => loop {
                let piece = next()?;
                if piece.is_empty() {
                    break;
                }
                take(&piece)?;
            },
            8 => self.inflate(&mut next, &mut take)?,
            method => {
                return Err(ZipError::Broken(format!(
                    "{} is packed by method {method}, only 0 and 8 are read",
                    self.name
                )));
            }
        }
        let crc = crc.finalize();
        if crc != self.crc || size != self.size {
            return Err(ZipError::Broken(format!(
                "{}: CRC-32 is {crc:08x}, expected {:08x}",
                self.name, self.crc
            )));
        }
        Ok(())
    }

    fn inflate(
        &self,
        next: &mut dyn FnMut() -> Result<Vec<u8>, ZipError>,
        take: &mut dyn FnMut(&[u8]) -> Result<(), ZipError>,
    ) -> Result<(), ZipError> {
        let mut state = InflateState::new_boxed(DataFormat::Raw);
        let mut out = vec![0; PIECE];
        let (mut input, mut used) = (Vec::new(), 0);
        loop {
            if used == input.len() {
                (input, used) = (next()?, 0);
            }
            let rest = input.get(used..).unwrap_or_default();
            let result = inflate(&mut state, rest, &mut out, MZFlush::None);
            used += result.bytes_consumed;
            take(out.get(..result.bytes_written).unwrap_or_default())?;
            match result.status {
                Ok(MZStatus::StreamEnd) => return Ok(()),
                Ok(_) | Err(MZError::Buf) if !input.is_empty() => {}
                Ok(_) | Err(MZError::Buf) => return Err(self.cut()),
                Err(error) => {
                    return Err(ZipError::Broken(format!("{}: {error:?}", self.name)));
                }
            }
        }
    }
}
