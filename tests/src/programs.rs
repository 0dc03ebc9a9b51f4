//! The programs as a user runs them.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;

/// The folder of the built programs: `cargo test --workspace` builds them before it runs any test.
///
/// # Panics
/// They are not there.
#[must_use]
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        // .../target/<profile>/deps/<test>-<hash>
        let test = std::env::current_exe().unwrap_or_default();
        let folder = test
            .ancestors()
            .nth(2)
            .map_or_else(PathBuf::new, Path::to_path_buf);
        for program in ["ft-capture", "ft-view", "ft-identify", "ft-sim-hw"] {
            let path = folder.join(program);
            assert!(
                path.exists(),
                "{}: run `cargo build --workspace --bins` first",
                path.display()
            );
        }
        folder
    })
}

/// `name` with `arguments`, in the folder `cwd`; nothing read from standard input.
#[must_use]
pub fn command<A: AsRef<std::ffi::OsStr>>(name: &str, arguments: &[A], cwd: &Path) -> Command {
    let mut command = Command::new(folder().join(name));
    command
        .args(arguments)
        .current_dir(cwd)
        .stdin(Stdio::null());
    command
}

/// Runs `name` to its end.
///
/// # Panics
/// The program cannot be started.
#[must_use]
pub fn run<A: AsRef<std::ffi::OsStr>>(name: &str, arguments: &[A], cwd: &Path) -> Finished {
    match command(name, arguments, cwd).output() {
        Ok(output) => Finished::new(name, &output),
        Err(error) => panic!("{name} cannot be started: {error}"),
    }
}

/// How a program ended, and what it said.
#[derive(Clone, Debug)]
pub struct Finished {
    /// Its name.
    pub name: String,
    /// Its exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
}

/// Sends a running program a signal: `-STOP`, `-KILL` and so on.
///
/// # Panics
/// The program has ended.
pub fn signal(child: &Child, signal: &str) {
    let sent = Command::new("kill")
        .args([signal, &child.id().to_string()])
        .status();
    assert!(sent.is_ok_and(|status| status.success()), "kill {signal}");
}

/// Ends a running program as Ctrl-C does, and gives what it left.
///
/// # Panics
/// As [`signal`], or its output cannot be read.
#[must_use]
pub fn end(name: &str, child: Child) -> Finished {
    signal(&child, "-INT");
    let output = child.wait_with_output();
    Finished::new(
        name,
        &output.unwrap_or_else(|error| panic!("{name}: {error}")),
    )
}

impl Finished {
    /// From what [`Command::output`] gave.
    #[must_use]
    pub fn new(name: &str, output: &Output) -> Self {
        Self {
            name: name.to_owned(),
            code: output.status.code(),
            stdout: String::from_utf8_lossy(&output.stdout).into_owned(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Asserts the exit code.
    ///
    /// # Panics
    /// It is another one; the message holds what the program said.
    #[track_caller]
    pub fn expect_code(self, code: i32) -> Self {
        assert_eq!(
            self.code,
            Some(code),
            "{}\nstdout: {}\nstderr: {}",
            self.name,
            self.stdout,
            self.stderr
        );
        self
    }

    /// Its standard output as JSON.
    ///
    /// # Panics
    /// It is none.
    #[must_use]
    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        match serde_json::from_str(&self.stdout) {
            Ok(value) => value,
            Err(error) => panic!("{}: no JSON: {error}\n{}", self.name, self.stdout),
        }
    }

    /// Asserts that standard error says all of `wanted`.
    ///
    /// # Panics
    /// It does not.
    #[track_caller]
    pub fn complains(&self, wanted: &[&str]) {
        for text in wanted {
            assert!(
                self.stderr.contains(text),
                "{}: no {text:?} in: {}",
                self.name,
                self.stderr
            );
        }
    }
}
