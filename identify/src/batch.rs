//! Many recordings, in parallel, each into its own directory, with one table over all.
//!
//! What became of a recording is kept beside its report (`batch.json`, by the recording's hash, the settings and the
//! version), so that a run that was stopped goes on where it was; what the system refused (a disk that is full, a file that cannot be
//! read) is tried again. A recording that cannot be identified, or that makes the
//! identification panic, is a row of the table and stops nothing.

use std::fmt::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use ft_recording::TopicMap;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use sha2::{Digest, Sha256};

use crate::error::IdentifyError;
use crate::motion::MotionSettings;
use crate::output::{replace, write_to};
use crate::pipeline::{DAMAGED, identify_recording};

/// What became of one recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BatchRow {
    /// The recording's path below the batch's directory, without `.mcap`; also its output's.
    pub name: String,
    /// SHA-256 of the recording with settings and version.
    pub key: String,
    /// `identified`, `not_identifiable` (the joint is known, its dynamics are not) or `failed`.
    pub outcome: Outcome,
    /// Why, when not identified.
    pub reason: Option<String>,
    /// `revolute`, `prismatic`, ...
    pub kind: Option<String>,
    /// Range of the joint coordinate, rad or m.
    pub range: Option<f64>,
    /// Inertia and its standard deviation, kg m^2 or kg.
    pub inertia: Option<[f64; 2]>,
    /// Coulomb friction and its standard deviation, N m or N.
    pub coulomb: Option<[f64; 2]>,
    /// Viscous friction and its standard deviation.
    pub viscous: Option<[f64; 2]>,
    /// Names of the effects that were added.
    pub effects: Vec<String>,
    /// Held-out RMS of the full model, N m or N.
    pub held_out_rms: Option<f64>,
    /// The report's verdict.
    pub verdict: Option<String>,
    /// What is wrong with the file, when only a part of it was used.
    #[serde(default)]
    pub damage: Option<String>,
}

/// How an identification of a batch ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// Joint and dynamics are known.
    Identified,
    /// The joint is known, the dynamics cannot be told from the data.
    NotIdentifiable,
    /// There is no result.
    Failed,
}

/// What to run.
#[derive(Clone, Debug)]
pub struct BatchOptions {
    /// Recordings at a time.
    pub jobs: usize,
    /// Identify also what an earlier run did.
    pub again: bool,
    /// Names of topics.
    pub map: TopicMap,
    /// Settings of each identification.
    pub settings: MotionSettings,
}

/// Recordings (`*.mcap`, and `*.mcap.partial`, which was never finished) below `directory`, by name, but for those in folders below it that cannot be listed.
///
/// # Errors
/// The directory cannot be listed.
pub fn recordings(directory: &Path) -> Result<Vec<PathBuf>, IdentifyError> {
    search(directory).map(|(found, _)| found)
}

/// A folder that cannot be listed, and why.
type Unlisted = (PathBuf, std::io::Error);

/// Recordings below `directory`, and the folders below it that cannot be listed.
fn search(directory: &Path) -> Result<(Vec<PathBuf>, Vec<Unlisted>), IdentifyError> {
    let (mut found, mut unlisted) = (Vec::new(), Vec::new());
    let mut folders = Vec::new();
    list(directory, &mut found, &mut folders).map_err(|source| IdentifyError::List {
        path: directory.to_owned(),
        source,
    })?;
    while let Some(folder) = folders.pop() {
        if let Err(error) = list(&folder, &mut found, &mut folders) {
            unlisted.push((folder, error));
        }
    }
    found.sort();
    Ok((found, unlisted))
}

/// Puts what is in `folder` to the recordings found and to the folders to look into.
fn list(
    folder: &Path,
    found: &mut Vec<PathBuf>,
    folders: &mut Vec<PathBuf>,
) -> std::io::Result<()> {
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let path = entry.path();
        // A link to a folder may lead round in a circle.
        if entry.file_type()?.is_dir() {
            folders.push(path);
        } else if is_recording(&path) {
            found.push(path);
        }
    }
    Ok(())
}

fn is_recording(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.ends_with(".mcap") || name.ends_with(UNFINISHED)
}

/// How the name of a recording ends that is being written, or whose writer was ended by force.
const UNFINISHED: &str = ".mcap.partial";

/// Identifies every recording below `directory` into `output`; gives a row for each, in order of their names, and then one for each folder
/// that cannot be listed. `done` hears of each row and whether it is of an earlier run. The table is written anew with each row, so that it
/// is there whenever the run is ended.
///
/// # Errors
/// The directory cannot be listed or has no recordings, or the table cannot be written.
pub fn run(
    directory: &Path,
    output: &Path,
    options: &BatchOptions,
    done: &(dyn Fn(&BatchRow, bool) + Sync),
) -> Result<Vec<BatchRow>, IdentifyError> {
    let (files, unlisted) = search(directory)?;
    if files.is_empty() && unlisted.is_empty() {
        let path = directory.to_owned();
        return Err(IdentifyError::NoRecordings { path });
    }
    let next = AtomicUsize::new(0);
    let rows = Mutex::new(vec![None; files.len()]);
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(file) = files.get(index) else { break };
            let (row, is_old) = one(directory, file, output, options);
            done(&row, is_old);
            if let Ok(mut rows) = rows.lock() {
                rows[index] = Some(row);
                let so_far: Vec<BatchRow> = rows.iter().flatten().cloned().collect();
                // The last time counts.
                let _ = write_table(output, &so_far);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..options.jobs.clamp(1, files.len().max(1)) {
            scope.spawn(work);
        }
    });
    let rows = rows.into_inner().unwrap_or_default();
    let mut rows: Vec<_> = rows.into_iter().flatten().collect();
    for (folder, error) in unlisted {
        let below = folder.strip_prefix(directory).unwrap_or(&folder);
        let reason = format!("the folder cannot be listed: {error}");
        let row = BatchRow::failed(below.display().to_string(), String::new(), reason);
        done(&row, false);
        rows.push(row);
    }
    write_table(output, &rows)?;
    Ok(rows)
}

/// `summary.csv` and `summary.json` in `output`.
fn write_table(output: &Path, rows: &[BatchRow]) -> Result<(), IdentifyError> {
    let write = |name: &str, text: String| {
        let path = output.join(name);
        std::fs::create_dir_all(output)
            .and_then(|()| replace(&path, &text))
            .map_err(|source| IdentifyError::Write { path, source })
    };
    write("summary.csv", csv(rows))?;
    write(
        "summary.json",
        serde_json::to_string_pretty(rows).unwrap_or_default(),
    )
}

fn csv(rows: &[BatchRow]) -> String {
    let mut text = String::from(
        "name,outcome,kind,range,inertia,inertia_std,coulomb,coulomb_std,viscous,viscous_std,effects,held_out_rms,verdict,reason,damage\n",
    );
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    for row in rows {
        let number =
            |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.6e}"));
        let pair = |pair: Option<[f64; 2]>| {
            format!(
                "{},{}",
                number(pair.map(|p| p[0])),
                number(pair.map(|p| p[1]))
            )
        };
        let _ = writeln!(
            text,
            "{},{},{},{},{},{},{},{},{},{},{},{}",
            quoted(&row.name),
            row.outcome.name(),
            row.kind.as_deref().unwrap_or(""),
            number(row.range),
            pair(row.inertia),
            pair(row.coulomb),
            pair(row.viscous),
            quoted(&row.effects.join(" ")),
            number(row.held_out_rms),
            row.verdict.as_deref().unwrap_or(""),
            quoted(row.reason.as_deref().unwrap_or("")),
            quoted(row.damage.as_deref().unwrap_or("")),
        );
    }
    text
}

impl Outcome {
    /// As in the table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Identified => "identified",
            Self::NotIdentifiable => "not_identifiable",
            Self::Failed => "failed",
        }
    }
}

fn one(directory: &Path, file: &Path, output: &Path, options: &BatchOptions) -> (BatchRow, bool) {
    let below = file.strip_prefix(directory).unwrap_or(file);
    if file.to_string_lossy().ends_with(UNFINISHED) {
        let (name, reason) = (
            below.display().to_string(),
            "it was never finished: `ft-capture recover` it first",
        );
        return (
            BatchRow::failed(name, String::new(), reason.to_owned()),
            false,
        );
    }
    let name = below.with_extension("").display().to_string();
    if !file.is_file() {
        return (
            BatchRow::failed(name, String::new(), "it is no regular file".to_owned()),
            false,
        );
    }
    let folder = output.join(below.with_extension(""));
    let note = folder.join("batch.json");
    let key = match key(file, options) {
        Ok(key) => key,
        Err(error) => return (BatchRow::failed(name, String::new(), error), false),
    };
    let old = std::fs::read_to_string(&note)
        .ok()
        .and_then(|text| serde_json::from_str::<BatchRow>(&text).ok());
    if let Some(row) = old.filter(|row| row.key == key && !options.again) {
        return (row, true);
    }
    let identified = catch_unwind(AssertUnwindSafe(|| {
        let identified = identify_recording(file, &options.map, &options.settings, &mut |_| {})?;
        write_to(&folder, &identified)?;
        identified
            .report
            .to_json()
            .map_err(|error| IdentifyError::Write {
                path: folder.clone(),
                source: error.into(),
            })
    }));
    let row = match identified {
        Ok(Ok(report)) => BatchRow::of(name, key, &report),
        // What the system refuses now it may give later: tried again by the next run.
        Ok(Err(error)) if error.is_transient() => {
            return (BatchRow::failed(name, key, error.to_string()), false);
        }
        Ok(Err(error)) => BatchRow::failed(name, key, error.to_string()),
        Err(_) => BatchRow::failed(name, key, "the identification broke off (panic)".to_owned()),
    };
    // A note that cannot be written costs a repetition, no more.
    let _ = std::fs::create_dir_all(&folder)
        .and_then(|()| replace(&note, serde_json::to_string(&row).unwrap_or_default()));
    (row, false)
}

/// Recording, settings and version in one hash.
fn key(file: &Path, options: &BatchOptions) -> Result<String, String> {
    let said = |error: std::io::Error| format!("cannot read {}: {error}", file.display());
    let mut hasher = Sha256::new();
    let mut reader = std::fs::File::open(file).map_err(said)?;
    let mut buffer = vec![0; 1 << 16];
    loop {
        let read = std::io::Read::read(&mut reader, &mut buffer).map_err(said)?;
        if read == 0 {
            break;
        }
        hasher.update(&buffer[..read]);
    }
    hasher.update(format!("{:?} {:?}", options.settings, options.map));
    hasher.update(env!("CARGO_PKG_VERSION"));
    let digest = hasher.finalize();
    Ok(digest.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl BatchRow {
    fn failed(name: String, key: String, reason: String) -> Self {
        Self {
            name,
            key,
            outcome: Outcome::Failed,
            reason: Some(reason),
            kind: None,
            range: None,
            inertia: None,
            coulomb: None,
            viscous: None,
            effects: Vec::new(),
            held_out_rms: None,
            verdict: None,
            damage: None,
        }
    }

    /// From the text of a `report.json`.
    fn of(name: String, key: String, report: &str) -> Self {
        let report: Value = serde_json::from_str(report).unwrap_or_default();
        let text = |pointer: &str| report.pointer(pointer)?.as_str().map(str::to_owned);
        let terms = report.pointer("/final/terms").and_then(Value::as_array);
        let term = |name: &str| {
            let term = terms?.iter().find(|term| term["name"] == name)?;
            Some([
                term["value"].as_f64()?,
                term["std"].as_f64().unwrap_or(f64::NAN),
            ])
        };
        let ends = |k: usize| report.pointer(&format!("/joint/q_range/{k}"))?.as_f64();
        let verdict = text("/final/verdict");
        let inertia = term("inertia");
        let known = inertia.is_some() && verdict.as_deref() != Some("not_identifiable");
        let reason = report
            .pointer("/not_identified")
            .and_then(Value::as_object)
            .and_then(|reasons| reasons.values().next()?.as_str().map(str::to_owned));
        let effects = report["effects"].as_array().into_iter().flatten();
        let notes = report["notes"].as_array().into_iter().flatten();
        let damage = notes
            .filter_map(Value::as_str)
            .find(|note| note.starts_with(DAMAGED));
        Self {
            name,
            key,
            outcome: if known {
                Outcome::Identified
            } else {
                Outcome::NotIdentifiable
            },
            reason: if known { None } else { reason },
            kind: text("/joint/kind"),
            range: ends(1).zip(ends(0)).map(|(high, low)| high - low),
            inertia,
            coulomb: term("coulomb"),
            viscous: term("viscous"),
            effects: effects
                .filter_map(|effect| effect["name"].as_str().map(str::to_owned))
                .collect(),
            held_out_rms: report
                .pointer("/final/held_out_rms")
                .and_then(Value::as_f64),
            verdict,
            damage: damage.map(str::to_owned),
        }
    }

    /// One line for a terminal.
    #[must_use]
    pub fn line(&self) -> String {
        let number = |pair: Option<[f64; 2]>| {
            pair.map_or_else(|| "-".to_owned(), |[value, _]| format!("{value:.4}"))
        };
        format!(
            "{:<28} {:<16} {:<10} {:>9} {:>9} {:>9}  {}",
            self.name,
            self.outcome.name(),
            self.kind.as_deref().unwrap_or("-"),
            number(self.inertia),
            number(self.coulomb),
            number(self.viscous),
            [self
                .reason
                .clone()
                .unwrap_or_else(|| self.effects.join(" "))]
            .into_iter()
            .chain(self.damage.clone())
            .collect::<Vec<_>>()
            .join("; ")
        )
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

    use super::*;

    /// Folders in each other until the path is too long, which root cannot list either.
    fn too_deep(folder: &Path) {
        let name = "d".repeat(250);
        let mut path = folder.to_owned();
        while path.as_os_str().len() < 3_800 {
            path.push(&name);
        }
        std::fs::create_dir_all(&path).unwrap();
        // The last ones are made below and put where their names are too long together.
        let lower = folder.join("l").join(&name).join(&name);
        std::fs::create_dir_all(&lower).unwrap();
        std::fs::rename(folder.join("l"), path.join("l")).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_listed_is_a_row_and_stops_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let input = folder.path().join("in");
        std::fs::create_dir_all(input.join("sub")).unwrap();
        for name in ["a.mcap", "sub/b.mcap"] {
            std::fs::write(input.join(name), b"no recording").unwrap();
        }
        too_deep(&input);
        assert_eq!(recordings(&input).unwrap().len(), 2);
        let options = BatchOptions {
            jobs: 1,
            again: false,
            map: TopicMap::default(),
            settings: MotionSettings::default(),
        };
        let heard = AtomicUsize::new(0);
        let hear = |_: &BatchRow, _| {
            heard.fetch_add(1, Ordering::Relaxed);
        };
        let rows = run(&input, &folder.path().join("out"), &options, &hear).unwrap();
        let last = rows.last().unwrap();
        assert_eq!((rows.len(), heard.into_inner()), (3, 3));
        assert_eq!(last.outcome, Outcome::Failed);
        let reason = last.reason.as_deref().unwrap();
        assert!(
            reason.starts_with("the folder cannot be listed: "),
            "{reason}"
        );
        assert!(recordings(&input.join("none")).is_err());
    }

    #[test]
    fn what_is_no_finished_recording_is_a_row_and_no_recordings_are_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let [input, output] = ["in", "out"].map(|name| folder.path().join(name));
        std::fs::create_dir_all(&input).unwrap();
        let options = BatchOptions {
            jobs: 1,
            again: false,
            map: TopicMap::default(),
            settings: MotionSettings::default(),
        };
        let none = run(&input, &output, &options, &|_, _| {}).unwrap_err();
        assert!(matches!(none, IdentifyError::NoRecordings { .. }), "{none}");
        std::fs::write(input.join("a.mcap.partial"), b"begun").unwrap();
        std::os::unix::fs::symlink(folder.path(), input.join("b.mcap")).unwrap();
        let rows = run(&input, &output, &options, &|_, _| {}).unwrap();
        let reasons = rows.iter().map(|row| row.reason.as_deref().unwrap());
        let [partial, folder] = reasons.collect::<Vec<_>>()[..] else {
            panic!("{rows:?}");
        };
        assert!(partial.contains("recover"), "{partial}");
        assert!(folder.contains("no regular file"), "{folder}");
    }
}
