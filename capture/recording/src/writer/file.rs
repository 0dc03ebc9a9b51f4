//! The file under a recording, and what its errors mean.

use std::ffi::OsString;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use mcap::McapError;

use crate::error::WriteError;

/// The name of a recording while it is written: `path` with `.partial` behind.
#[must_use]
pub fn partial_path(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".partial");
    PathBuf::from(name)
}

pub(super) fn open(partial: &Path, overwrite: bool) -> Result<File, WriteError> {
    let mut how = OpenOptions::new();
    how.write(true);
    if overwrite {
        how.create(true)
    } else {
        how.create_new(true)
    };
    let file = how.open(partial).map_err(|source| match source.kind() {
        io::ErrorKind::AlreadyExists => WriteError::Leftover {
            partial: partial.to_owned(),
        },
        _ => io_error("create", partial, source),
    })?;
    // File systems without locks are no reason not to record.
    if let Err(TryLockError::WouldBlock) = file.try_lock() {
        return Err(WriteError::Busy {
            partial: partial.to_owned(),
        });
    }
    file.set_len(0)
        .map_err(|source| io_error("empty", partial, source))?;
    Ok(file)
}

/// Makes the new name last through a power loss; not all file systems can, and the data are safe without.
pub(super) fn sync_directory(path: &Path) {
    let directory = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let _ = File::open(directory).and_then(|directory| directory.sync_all());
}

pub(crate) fn io_error(call: &'static str, path: &Path, source: io::Error) -> WriteError {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge => {
            WriteError::NoSpace {
                path: path.to_owned(),
            }
        }
        _ => WriteError::Io {
            call,
            path: path.to_owned(),
            source,
        },
    }
}

impl WriteError {
    /// The error of a recording of which nothing is kept, which is to be `path`.
    pub(crate) fn of_nothing(self, path: &Path) -> Self {
        match self {
            Self::NoSpace { .. } => Self::NoRoom {
                path: path.to_owned(),
            },
            error => error,
        }
    }
}

pub(crate) fn format_error(error: McapError, path: &Path) -> WriteError {
    match error {
        McapError::Io(source) => io_error("write to", path, source),
        source => WriteError::Format {
            path: path.to_owned(),
            source,
        },
    }
}

/// A file that counts what it took.
pub(super) struct Counted {
    pub(super) file: File,
    pub(super) bytes: Arc<AtomicU64>,
}

impl Write for Counted {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        let written = self.file.write(buffer)?;
        self.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}
