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
        .map(|(name, text)| replace(&directory.join(name), &text))
        .collect()
}

/// Writes beside the target and renames.
fn replace(path: &Path, text: &str) -> Result<PathBuf, IdentifyError> {
    let failed = |source| IdentifyError::Write {
        path: path.to_owned(),
        source,
    };
    let partial = path.with_extension("partial");
    std::fs::write(&partial, text).map_err(failed)?;
    std::fs::rename(&partial, path).map_err(failed)?;
    Ok(path.to_owned())
}
