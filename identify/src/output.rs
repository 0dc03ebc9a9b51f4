//! Writes a result into a directory: `report.json`, `report.html`, `twin.json`, each whole or not at all.

use std::path::{Path, PathBuf};

use crate::error::IdentifyError;
use crate::page::page;
use crate::pipeline::Identified;

/// Names of the files.
pub const FILES: [&str; 3] = ["report.json", "report.html", "twin.json"];

/// Refuses to replace `files` of an earlier run unless `force`; meant to be asked before the work.
///
/// # Errors
/// [`IdentifyError::Exists`], with the first that is there.
pub fn refuse_existing(directory: &Path, files: &[&str], force: bool) -> Result<(), IdentifyError> {
    let there = files
        .iter()
        .map(|name| directory.join(name))
        .find(|path| path.exists());
    match there {
        Some(path) if !force => Err(IdentifyError::Exists { path }),
        _ => Ok(()),
    }
}

/// Writes the files; gives their paths. The directory is made when it is not there; files of an earlier run are replaced,
/// and a twin of an earlier run is removed when there is none now.
///
/// # Errors
/// [`IdentifyError::Write`].
pub fn write_to(directory: &Path, identified: &Identified) -> Result<Vec<PathBuf>, IdentifyError> {
    std::fs::create_dir_all(directory).map_err(|source| IdentifyError::Write {
        path: directory.to_owned(),
        source,
    })?;
    let json = |path: &str, text: Result<String, serde_json::Error>| {
        text.map_err(|error| IdentifyError::Write {
            path: directory.join(path),
            source: error.into(),
        })
    };
    let mut files = vec![
        (
            "report.json",
            json("report.json", identified.report.to_json())?,
        ),
        ("report.html", json("report.html", page(identified))?),
    ];
    let twin = directory.join("twin.json");
    match &identified.twin {
        Some(twin) => files.push(("twin.json", json("twin.json", twin.to_json())?)),
        None if twin.exists() => {
            std::fs::remove_file(&twin)
                .map_err(|source| IdentifyError::Write { path: twin, source })?;
        }
        None => {}
    }
    files
        .into_iter()
        .map(|(name, text)| {
            let path = directory.join(name);
            match replace(&path, text) {
                Ok(()) => Ok(path),
                Err(source) => Err(IdentifyError::Write { path, source }),
            }
        })
        .collect()
}

/// Writes a file that is there as a whole, the old or the new one, whenever this is broken off or the disk is full.
///
/// # Errors
/// It cannot be written; nothing of it is left.
pub fn replace(path: &Path, bytes: impl AsRef<[u8]>) -> std::io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    std::fs::write(&partial, bytes)
        .and_then(|()| std::fs::rename(&partial, path))
        .inspect_err(|_| {
            let _ = std::fs::remove_file(&partial);
        })
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

    use super::*;

    #[test]
    fn what_cannot_be_written_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        replace(&path, "old").unwrap();
        replace(&path, "new").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "new");
        let in_the_way = folder.path().join("b.json");
        std::fs::create_dir(&in_the_way).unwrap();
        assert!(replace(&in_the_way, "text").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
