//! Harness of the whole-system tests: the built programs, the measured data, other people's tools.

use std::io::Write as _;
pub mod arguments;
pub mod bias;
pub mod control;
pub mod lab;
pub mod mechanisms;
pub mod peers;
pub mod programs;
pub mod sealed;
pub mod soak;
pub mod stamps;
pub mod study;
pub mod swing;
pub mod terminal;
pub mod truth;

use std::path::{Path, PathBuf};

/// The checkout's top folder.
#[must_use]
pub fn workspace_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .map_or_else(PathBuf::new, Path::to_path_buf)
}

/// A folder of the measured data (`$FT_DATA`, else `../shared/data` beside the checkout), or `None` after printing
/// one line that says what `test` skips without it.
#[must_use]
pub fn measured_data(folder: &str, test: &str) -> Option<PathBuf> {
    let base = std::env::var_os("FT_DATA")
        .map_or_else(|| workspace_root().join("../shared/data"), PathBuf::from);
    let path = base.join(folder);
    if path.is_dir() {
        return Some(path);
    }
    let _ = writeln!(
        std::io::stderr(),
        "skipped: {test}: no measured data at {} (set FT_DATA)",
        path.display()
    );
    None
}
