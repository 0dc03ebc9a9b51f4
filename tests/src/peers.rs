//! Other people's tools, from the Python package index, in a virtual environment under `target/`.

use std::ffi::OsStr;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::Duration;

use crate::programs::Finished;
use crate::workspace_root;

/// The environment's Python, or `None` after printing one line that says what `test` skips without it.
///
/// # Panics
/// `FT_REQUIRE_PEERS` is set and the environment cannot be made: then nothing may be skipped.
#[must_use]
pub fn python(test: &str) -> Option<&'static Path> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    of_environment(test, &PYTHON, "peers", "requirements.txt")
}

/// The Python of an environment with Newton, which asks for an older MuJoCo than the other one has.
///
/// # Panics
/// As [`python`].
#[must_use]
pub fn newton(test: &str) -> Option<&'static Path> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    of_environment(test, &PYTHON, "newton", "newton.txt")
}

/// The Python of a small environment with python-can, for the lab's guest.
///
/// # Panics
/// As [`python`].
#[must_use]
pub fn can(test: &str) -> Option<&'static Path> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    of_environment(test, &PYTHON, "python-can", "can.txt")
}

fn of_environment(
    test: &str,
    python: &'static OnceLock<Result<PathBuf, String>>,
    name: &str,
    requirements: &str,
) -> Option<&'static Path> {
    match python.get_or_init(|| make_environment(name, requirements)) {
        Ok(python) => Some(python),
        Err(why) => {
            assert!(
                std::env::var_os("FT_REQUIRE_PEERS").is_none(),
                "{test}: {why}"
            );
            let why = why.lines().last().unwrap_or_default();
            let _ = writeln!(std::io::stderr(), "skipped: {test}: {why}");
            None
        }
    }
}

/// Runs `tests/peers/<script>` with `arguments`; `None` when there is no Python (one line was printed).
///
/// # Panics
/// The script cannot be started.
#[must_use]
pub fn run<A: AsRef<OsStr>>(test: &str, script: &str, arguments: &[A]) -> Option<Finished> {
    let output = command(test, script, arguments)?.output();
    match output {
        Ok(output) => Some(Finished::new(script, &output)),
        Err(error) => panic!("{script} cannot be started: {error}"),
    }
}

/// The command for `tests/peers/<script>`; `None` when there is no Python (one line was printed).
#[must_use]
pub fn command<A: AsRef<OsStr>>(test: &str, script: &str, arguments: &[A]) -> Option<Command> {
    let mut command = Command::new(python(test)?);
    command
        .arg(workspace_root().join("tests/peers").join(script))
        .args(arguments);
    Some(command)
}

/// The folder of the environment's own programs, such as `rerun`.
#[must_use]
pub fn programs(test: &str) -> Option<&'static Path> {
    python(test)?.parent()
}

/// A Chromium: `$FT_CHROMIUM`, one on the path, or where tests may not be skipped and apt may install one, that one.
/// `None` after printing one line that says what `test` skips without it.
///
/// # Panics
/// `FT_REQUIRE_PEERS` is set and there is none.
#[must_use]
pub fn chromium(test: &str) -> Option<PathBuf> {
    static CHROMIUM: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let required = std::env::var_os("FT_REQUIRE_PEERS").is_some();
    match CHROMIUM.get_or_init(|| find_chromium(required)) {
        Ok(program) => Some(program.clone()),
        Err(why) => {
            assert!(!required, "{test}: {why}");
            let _ = writeln!(std::io::stderr(), "skipped: {test}: {why}");
            None
        }
    }
}

fn find_chromium(may_install: bool) -> Result<PathBuf, String> {
    if let Some(named) = std::env::var_os("FT_CHROMIUM") {
        return Ok(PathBuf::from(named));
    }
    let names = ["chromium", "chromium-browser", "google-chrome"];
    if let Some(found) = on_path(&names) {
        return Ok(found);
    }
    if !may_install {
        return Err(
            "there is no Chromium (apt-get install chromium, or name one in FT_CHROMIUM)"
                .to_owned(),
        );
    }
    install(&["chromium"])?;
    on_path(&names).ok_or_else(|| "apt installed no Chromium".to_owned())
}

/// The command for `tests/peers/node/<script>`, with the packages of `tests/peers/node/package.json` from the npm registry in
/// `target/node`; `None` after printing one line that says what `test` skips without them.
///
/// # Panics
/// `FT_REQUIRE_PEERS` is set and there is no Node.
#[must_use]
pub fn node(test: &str, script: &str, arguments: &[&str]) -> Option<Command> {
    static PACKAGES: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let required = std::env::var_os("FT_REQUIRE_PEERS").is_some();
    match PACKAGES.get_or_init(|| node_packages(required)) {
        Ok(folder) => {
            let mut command = Command::new("node");
            command
                .arg(workspace_root().join("tests/peers/node").join(script))
                .args(arguments)
                .current_dir(folder);
            Some(command)
        }
        Err(why) => {
            assert!(!required, "{test}: {why}");
            let _ = writeln!(std::io::stderr(), "skipped: {test}: {why}");
            None
        }
    }
}

fn node_packages(may_install: bool) -> Result<PathBuf, String> {
    if on_path(&["npm"]).is_none() {
        if !may_install {
            return Err("there is no npm (apt-get install nodejs npm)".to_owned());
        }
        install(&["nodejs", "npm"])?;
    }
    let (from, folder) = (
        workspace_root().join("tests/peers/node"),
        workspace_root().join("target/node"),
    );
    std::fs::create_dir_all(&folder).map_err(|error| error.to_string())?;
    for name in ["package.json", "package-lock.json"] {
        std::fs::copy(from.join(name), folder.join(name)).map_err(|error| error.to_string())?;
    }
    fetch(
        Command::new("npm")
            .args(["ci", "--silent", "--no-audit", "--ignore-scripts"])
            .current_dir(&folder),
    )?;
    Ok(folder)
}

/// Installs packages of the system with apt, one test program at a time.
pub(crate) fn install(packages: &[&str]) -> Result<(), String> {
    let lock = std::fs::File::create(workspace_root().join("target/apt.lock"))
        .map_err(|error| error.to_string())?;
    lock.lock().map_err(|error| error.to_string())?;
    let mut install = vec!["install", "-qq", "-y", "--no-install-recommends"];
    install.extend(packages);
    for arguments in [vec!["update", "-qq"], install] {
        fetch(
            Command::new("apt-get")
                .args(arguments)
                .env("DEBIAN_FRONTEND", "noninteractive"),
        )?;
    }
    Ok(())
}

fn on_path(names: &[&str]) -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .flat_map(|folder| names.iter().map(move |name| folder.join(name)))
        .find(|program| program.is_file())
}

/// Several test programs may come here at once: each makes the environment under a lock file's protection.
fn make_environment(name: &str, requirements: &str) -> Result<PathBuf, String> {
    let root = workspace_root();
    let folder = root.join("target").join(name);
    let requirements = root.join("tests/peers").join(requirements);
    let wanted = std::fs::read_to_string(&requirements)
        .map_err(|error| format!("{}: {error}", requirements.display()))?;
    let python = folder.join("bin/python");
    let stamp = folder.join("installed.txt");
    std::fs::create_dir_all(root.join("target")).map_err(|error| error.to_string())?;
    let lock = std::fs::File::create(root.join(format!("target/{name}.lock")))
        .map_err(|error| error.to_string())?;
    lock.lock().map_err(|error| error.to_string())?;
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    eprintln!(
        "installing the Python packages of {} into {}",
        requirements.display(),
        folder.display()
    );
    succeed(
        Command::new("python3")
            .args(["-m", "venv", "--clear"])
            .arg(&folder),
    )?;
    pip_install(&python, &["-r".as_ref(), requirements.as_os_str()])?;
    std::fs::write(&stamp, wanted).map_err(|error| error.to_string())?;
    Ok(python)
}

/// Runs `pip install` of `python`'s environment. Without pip's cache, which would be a second copy of gigabytes.
///
/// # Errors
/// What pip said last, when it failed three times.
pub fn pip_install(python: &Path, what: &[&OsStr]) -> Result<(), String> {
    let arguments = [
        "-m",
        "pip",
        "install",
        "--no-cache-dir",
        // What is imported is compiled then; all would be 240 MB.
        "--no-compile",
        "--quiet",
        "--disable-pip-version-check",
    ];
    fetch(Command::new(python).args(arguments).args(what))
}

/// Runs a program that fetches from a registry, up to three times: large downloads get cut off at times.
#[allow(clippy::disallowed_methods, reason = "no device's time")]
fn fetch(command: &mut Command) -> Result<(), String> {
    for pause in [5, 20] {
        match succeed(command) {
            Ok(()) => return Ok(()),
            Err(why) => eprintln!("again in {pause} s: {why}"),
        }
        std::thread::sleep(Duration::from_secs(pause));
    }
    succeed(command)
}

fn succeed(command: &mut Command) -> Result<(), String> {
    let output = command
        .output()
        .map_err(|error| format!("{command:?}: {error}"))?;
    if output.status.success() {
        return Ok(());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    let said: Vec<&str> = said
        .lines()
        .filter(|line| !line.trim().is_empty())
        .collect();
    Err(format!(
        "{command:?}: {}: {}",
        output.status,
        said[said.len().saturating_sub(8)..].join("\n")
    ))
}
