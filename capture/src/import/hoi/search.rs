//! The recordings of the dataset below a folder, by the names of their bags' folders or archives.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::{BAG, VRS};
use crate::import::archive::Tree;
use crate::import::{ImportError, io};

/// Folders below the one that is given.
const DEPTH: usize = 6;

/// One recording of the dataset.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct HoiPart {
    /// `<location>_<range>`.
    pub name: String,
    /// The folder with `gripper/` and `aria_gripper/`; where an archive `a.zip` leads to it, it is named as a folder `a`.
    pub base: PathBuf,
}

/// The recordings below a folder.
#[derive(Debug, Default)]
pub struct HoiParts {
    /// By name and folder.
    pub parts: Vec<HoiPart>,
    /// Archives and folders that could not be looked into.
    pub unreadable: Vec<ImportError>,
}

impl HoiParts {
    /// Where each part's recording goes below the folder of all: `<name>.mcap`, and for parts of one name in several folders of the
    /// dataset below these folders' names.
    #[must_use]
    pub fn outputs(&self) -> Vec<PathBuf> {
        let above = self.parts.first().map_or(Path::new(""), |first| {
            let holds_all =
                |folder: &&Path| self.parts.iter().all(|part| part.base.starts_with(folder));
            first
                .base
                .ancestors()
                .find(holds_all)
                .unwrap_or(Path::new(""))
        });
        let output = |part: &HoiPart| {
            let file = format!("{}.mcap", part.name);
            let alike = self.parts.iter().filter(|other| other.name == part.name);
            if alike.count() < 2 {
                return PathBuf::from(file);
            }
            part.base
                .strip_prefix(above)
                .unwrap_or(Path::new(""))
                .join(file)
        };
        self.parts.iter().map(output).collect()
    }
}

/// The recordings below a folder: their bags' folders or archives, also within archives.
///
/// # Errors
/// The folder cannot be listed, or there is none.
pub fn parts(folder: &Path) -> Result<HoiParts, ImportError> {
    // `.` has no parent by name.
    let folder = &folder.canonicalize().map_err(io("find", folder))?;
    let mut search = Search::default();
    search.visit(folder, DEPTH)?;
    let Search {
        found, unreadable, ..
    } = search;
    if found.is_empty() {
        let unreadable: Vec<_> = unreadable.iter().map(|e| format!(" ({e})")).collect();
        return Err(ImportError::Missing {
            path: folder.to_owned(),
            missing: format!("no folder or zip *{BAG}{}", unreadable.concat()),
            hint: "give <base>/extracted/<location>/gripper, or a folder above it; the raw layout (.bag, MPS folders) is read in \
                   steps: see `ft-capture import-bag --help`",
        });
    }
    Ok(HoiParts {
        parts: found.into_iter().collect(),
        unreadable,
    })
}

#[derive(Default)]
struct Search {
    tree: Tree,
    found: BTreeSet<HoiPart>,
    unreadable: Vec<ImportError>,
    /// Folders by their own names: a link may lead back to one.
    visited: BTreeSet<PathBuf>,
}

impl Search {
    fn visit(&mut self, path: &Path, depth: usize) -> Result<(), ImportError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if bag_name(&name).is_some() {
            self.add(path);
        } else if name.trim_end_matches(".zip").ends_with(VRS) {
            // Nothing but a trajectory is in it.
        } else if path.is_dir() {
            let own = path.canonicalize().map_err(io("find", path))?;
            if depth == 0 || !self.visited.insert(own) {
                return Ok(());
            }
            for entry in std::fs::read_dir(path).map_err(io("list", path))? {
                let visited = entry.map_err(io("list", path)).and_then(|entry| {
                    // What other systems put beside files.
                    if entry.file_name().to_string_lossy().starts_with('.') {
                        return Ok(());
                    }
                    self.visit(&entry.path(), depth - 1)
                });
                self.unreadable.extend(visited.err());
            }
        } else if name.ends_with(".zip")
            && let Err(error) = self.look_into(path)
        {
            self.unreadable.push(error);
        }
        Ok(())
    }

    /// Bags within an archive, by the names of its files.
    fn look_into(&mut self, zip: &Path) -> Result<(), ImportError> {
        let is_wanted = |name: &str| name.split('/').any(|part| bag_name(part).is_some());
        let names = self.tree.names(zip, "gripper", &is_wanted)?;
        let root = zip.with_extension("");
        for name in names.iter().filter(|name| is_wanted(name)) {
            let mut path = root.join(name);
            // Down to the bag itself.
            while path
                .file_name()
                .is_some_and(|last| bag_name(&last.to_string_lossy()).is_none())
            {
                path.pop();
            }
            self.add(&path);
        }
        Ok(())
    }

    /// Takes in the bag at `path`.
    fn add(&mut self, path: &Path) {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let base = path.parent().and_then(Path::parent);
        if let (Some(name), Some(base)) = (bag_name(&name), base) {
            self.found.insert(HoiPart {
                name: name.to_owned(),
                base: base.to_owned(),
            });
        }
    }
}

/// The recording's name, of its bag's.
fn bag_name(name: &str) -> Option<&str> {
    let bag = name.strip_suffix(".zip").unwrap_or(name).strip_suffix(BAG);
    bag.filter(|bag| !bag.starts_with('.'))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

    use std::os::fd::AsRawFd as _;

    use super::*;

    #[test]
    fn a_folder_that_cannot_be_entered_stops_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("x/gripper/kitchen_1-3_gripper_bag");
        std::fs::create_dir_all(&bag).unwrap();
        // A folder that is there but has no name any more, which also root cannot find.
        let gone = tempfile::tempdir().unwrap();
        let open = std::fs::File::open(gone.path()).unwrap();
        gone.close().unwrap();
        for name in ["a", "z"] {
            let link = folder.path().join(name);
            std::os::unix::fs::symlink(format!("/proc/self/fd/{}", open.as_raw_fd()), link)
                .unwrap();
        }
        let found = parts(folder.path()).unwrap();
        assert_eq!(found.parts.len(), 1);
        assert_eq!(found.unreadable.len(), 2, "{:?}", found.unreadable);
    }
}
