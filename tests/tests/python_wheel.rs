//! The Python wheel, built and tried in a fresh virtual environment.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
#![allow(clippy::disallowed_methods, reason = "a stopwatch")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Instant;

use ft_identify::twin::Twin;
use ft_tests::programs::Finished;
use ft_tests::{peers, programs, workspace_root};
use serde_json::Value;
use tempfile::{TempDir, tempdir};

/// A recording and a twin of a door, a twin of a drawer, and the Python of a fresh environment with the wheel in it.
struct Tried {
    folder: TempDir,
    python: PathBuf,
}

fn finish(command: &mut Command) -> Finished {
    let output = command.output().unwrap();
    Finished::new(&format!("{command:?}"), &output)
}

/// Builds the wheel and installs it, once for all tests of this file; `None` when there is no Python (one line was printed).
/// One test after the other: one of them has a stopwatch.
fn tried() -> Option<MutexGuard<'static, Tried>> {
    static TRIED: OnceLock<Option<Mutex<Tried>>> = OnceLock::new();
    let tried = TRIED.get_or_init(|| make().map(Mutex::new)).as_ref()?;
    Some(tried.lock().unwrap_or_else(PoisonError::into_inner))
}

fn make() -> Option<Tried> {
    let peers = peers::python("python_wheel")?;
    let maturin = peers::programs("python_wheel")?.join("maturin");
    let folder = tempdir().unwrap();
    let root = workspace_root();
    let wheels = folder.path().join("wheels");
    let began = Instant::now();
    finish(
        Command::new(maturin)
            .args(["build", "--profile", "dev", "--quiet"])
            .arg("--interpreter")
            .arg(peers)
            .arg("--out")
            .arg(&wheels)
            .current_dir(root.join("identify/python"))
            .env("CARGO_TARGET_DIR", root.join("target/python")),
    )
    .expect_code(0);
    println!("wheel built in {:.0} s", began.elapsed().as_secs_f64());
    let wheel = std::fs::read_dir(&wheels).unwrap().next().unwrap().unwrap();
    let environment = folder.path().join("fresh");
    finish(
        Command::new("python3")
            .args(["-m", "venv"])
            .arg(&environment),
    )
    .expect_code(0);
    let python = environment.join("bin/python");
    peers::pip_install(&python, &[wheel.path().as_os_str()]).unwrap();
    for (scenario, name) in [("wood_door", "door"), ("drawer_loaded", "drawer")] {
        let file = format!("{name}.mcap");
        let record = [
            "--sim", scenario, "--speed", "max", "--seed", "5", "-o", &file,
        ];
        programs::run("ft-capture", &record, folder.path()).expect_code(0);
        programs::run("ft-identify", &[&file, "-o", name], folder.path()).expect_code(0);
    }
    Some(Tried { folder, python })
}

impl Tried {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs a script with the fresh Python.
    fn script(&self, script: &Path) -> Command {
        let mut command = Command::new(&self.python);
        command.arg(script);
        command
    }

    /// As [`Self::script`], other people's libraries from the shared environment beside what the fresh one has.
    fn beside_peers(&self, script: &Path) -> Command {
        let peers = peers::programs("python_wheel").unwrap();
        let site = std::fs::read_dir(peers.parent().unwrap().join("lib"))
            .unwrap()
            .filter_map(Result::ok)
            .map(|entry| entry.path().join("site-packages"))
            .find(|path| path.is_dir())
            .unwrap();
        let mut command = self.script(script);
        command.env("PYTHONPATH", site);
        command
    }
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

/// Nanoseconds per effort over a million states in Rust, the best of several runs, without named effects.
fn rust_nanoseconds(path: &Path) -> f64 {
    let mut twin = Twin::from_json(&std::fs::read_to_string(path).unwrap()).unwrap();
    twin.effects.clear();
    let evaluator = twin.evaluator();
    let domain = evaluator.domain();
    let mut seed = 1_u64;
    let mut within = |[low, high]: [f64; 2]| -> Vec<f64> {
        let mut next = || {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            low + (high - low) * (seed >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..1_000_000).map(|_| next()).collect()
    };
    let [q, dq, ddq] = [within(domain.q), within(domain.dq), within([-3.0, 3.0])];
    let mut efforts = vec![0.0; q.len()];
    (0..60)
        .map(|_| {
            let began = Instant::now();
            evaluator.efforts(&q, &dq, &ddq, &mut efforts).unwrap();
            let taken = began.elapsed().as_secs_f64();
            assert!(efforts.iter().all(|effort| effort.is_finite()));
            1e9 * taken / q.len() as f64
        })
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn the_wheel_gives_what_the_library_gives() {
    let Some(tried) = tried() else { return };
    let twin = tried.path("door/twin.json");
    let script = workspace_root().join("tests/peers/wheel.py");
    let mut command = tried.script(&script);
    let found = finish(command.arg(tried.path("door.mcap")).arg(&twin))
        .expect_code(0)
        .json();
    println!("{found:#}");
    for error in [
        "array_error",
        "strided_error",
        "scalar_and_array_error",
        "list_error",
        "terms_error",
        "moved_error",
        "out_error",
        "identified_effort_error",
    ] {
        assert!(number(&found[error]) < 1e-9, "{error}: {}", found[error]);
    }
    assert!(number(&found["quaternion_norm_error"]) < 1e-6);
    assert_eq!(found["stub_differs"], serde_json::json!([]));
    for (refused, says) in [
        (
            "shapes_refused",
            "ValueError: `q` has shape [3], `dq` has [4]",
        ),
        ("out_refused", "ValueError: `out` has shape [7], the states"),
        ("out_is_input_refused", "ValueError: `out` is unfit"),
        ("missing_refused", "FileNotFoundError: no/such/twin.json"),
        ("bad_refused", "ValueError: not a twin"),
        ("transform_refused", "ValueError: name_from_old is no rigid"),
        ("unread", "no/such/file.mcap"),
        ("topics_refused", "/ft/wrench"),
    ] {
        let said = found[refused].as_str().unwrap();
        assert!(said.contains(says), "{refused}: {said}");
    }
    let json = std::fs::read_to_string(&twin).unwrap();
    let inertia = Twin::from_json(&json).unwrap().evaluator().inertia();
    assert_eq!(found["kind"], "revolute");
    assert!((number(&found["inertia"]) - inertia).abs() < 1e-12);
    assert!((number(&found["gradient_ddq"]) - inertia).abs() < 1e-12);
    assert_eq!(
        found["outside"],
        serde_json::json!([null, "coordinate", "velocity"])
    );
    // A thousandth of a newton metre is too little from the start on, however slowly.
    let twin = Twin::from_json(&json).unwrap();
    assert_eq!(
        found["demand"],
        serde_json::json!([twin.joint.q_range[0], null, 0.0])
    );
    assert_eq!(found["swing"][0], "arrived");
    let rows = &found["samples"][0][0];
    assert_eq!(
        found["samples"],
        serde_json::json!([[rows], [rows, 3], [rows, 4], [rows, 6]])
    );
    assert!(rows.as_u64().unwrap() > 10_000);
    let report: Value =
        serde_json::from_str(&std::fs::read_to_string(tried.path("door/report.json")).unwrap())
            .unwrap();
    assert_eq!(found["report"][0], report["schema"]);
    assert_eq!(found["report"][1], report["final"]["verdict"]);
    assert_eq!(found["samples_of_joint"], true);
}

/// Debian's Python, when it has PyTorch; else the fresh one.
fn with_torch(tried: &Tried) -> PathBuf {
    let system = Path::new("/usr/bin/python3");
    let has = Command::new(system)
        .args(["-c", "import torch, numpy"])
        .output();
    if has.is_ok_and(|output| output.status.success()) {
        return system.to_owned();
    }
    eprintln!("skipped: python_wheel: the PyTorch half (apt install python3-torch)");
    tried.python.clone()
}

#[test]
fn numpy_and_torch_evaluate_the_same_model_slower() {
    let Some(tried) = tried() else { return };
    let twin = tried.path("door/twin.json");
    // Unpacked for a Python that it was not installed into.
    let unpacked = tried.path("unpacked");
    let wheels = std::fs::read_dir(tried.path("wheels")).unwrap();
    let wheel = wheels.filter_map(Result::ok).next().unwrap().path();
    finish(
        Command::new(&tried.python)
            .args(["-m", "zipfile", "-e"])
            .arg(wheel)
            .arg(&unpacked),
    )
    .expect_code(0);
    let export = [
        "export",
        "door/twin.json",
        "--to",
        "usd",
        "--name",
        "door",
        "-o",
        "assets",
    ];
    programs::run("ft-identify", &export, tried.folder.path()).expect_code(0);
    let (root, python) = (workspace_root(), with_torch(&tried));
    // Other programs run meanwhile: the fastest of up to four rounds of both.
    let mut rust = f64::INFINITY;
    let mut fastest = [f64::INFINITY; 2];
    let names = ["python, out given", "python, a new array each time"];
    let mut found = Value::Null;
    for _ in 0..4 {
        rust = rust.min(rust_nanoseconds(&twin));
        let mut command = Command::new(&python);
        command
            .env("PYTHONPATH", &unpacked)
            .arg(root.join("tests/peers/evaluations.py"))
            .arg(&twin)
            .arg(rust.to_string())
            .arg(tried.path("assets/door.usda.mechanism.json"))
            .arg(root.join("identify/python/examples/torch_environments.py"));
        found = finish(&mut command).expect_code(0).json();
        for (best, name) in fastest.iter_mut().zip(names) {
            *best = best.min(number(&found["ns_per_state"][name]));
        }
        if fastest.iter().all(|best| *best < 1.5 * rust) {
            break;
        }
    }
    println!("{found:#}");
    assert!(number(&found["numpy_error"]) < 1e-9);
    assert!(
        fastest.iter().all(|best| *best < 1.5 * rust),
        "Python {fastest:?} ns, Rust {rust} ns"
    );
    if !found["torch"].is_null() {
        assert!(number(&found["torch_error"]) < 1e-9);
        assert!(number(&found["torch_example_error"]) < 0.01);
        assert!(number(&found["torch_example_error_beyond"]) < 0.02);
    }
}

#[test]
fn the_readme_s_python_runs() {
    let Some(tried) = tried() else { return };
    let folder = tried.path("readme");
    std::fs::create_dir_all(folder.join("twin")).unwrap();
    std::fs::copy(tried.path("door/twin.json"), folder.join("twin/twin.json")).unwrap();
    std::fs::copy(tried.path("door.mcap"), folder.join("door.mcap")).unwrap();
    let readme = std::fs::read_to_string(workspace_root().join("README.md")).unwrap();
    // The section's own command for the assets.
    let export = readme
        .lines()
        .find(|line| line.starts_with("ft-identify export twin/"))
        .unwrap();
    let arguments: Vec<&str> = export.split_whitespace().skip(1).collect();
    programs::run("ft-identify", &arguments, &folder).expect_code(0);
    let script = workspace_root().join("tests/peers/readme.py");
    let found = finish(
        tried
            .beside_peers(&script)
            .arg(workspace_root().join("README.md"))
            .current_dir(&folder),
    )
    .expect_code(0)
    .json();
    println!("{found}");
    assert_eq!(found["blocks"], 4);
    assert_eq!(found["callback_installed"], true);
    assert!(number(&found["onnx_off"]) < 0.01, "{found}");
    assert!(number(&found["force_off"]) < 1e-9, "{found}");
    assert_eq!(found["report"], "ft-identify/report/1");
}

#[test]
fn mujoco_swings_with_the_twin_in_its_loop() {
    let Some(tried) = tried() else { return };
    let example = workspace_root().join("identify/python/examples/mujoco_step.py");
    let said = finish(
        tried
            .beside_peers(&example)
            .arg(tried.path("door/twin.json"))
            .arg("0.8"),
    )
    .expect_code(0)
    .stdout;
    println!("{said}");
    // "MuJoCo 2.700 s at 0.000; twin 2.701 s at 0.000, arrived"
    let times: Vec<f64> = said
        .split(" s at")
        .filter_map(|part| part.rsplit(' ').next()?.parse().ok())
        .collect();
    assert!(said.contains("arrived") && times.len() == 2, "{said}");
    assert!((times[0] / times[1] - 1.0).abs() < 0.02, "{said}");
}

#[test]
fn twins_attach_to_joints_of_assets() {
    let Some(tried) = tried() else { return };
    let script = workspace_root().join("tests/peers/attach.py");
    let found = finish(
        tried
            .beside_peers(&script)
            .arg(tried.path("door/twin.json"))
            .arg(tried.path("drawer/twin.json"))
            .arg(tried.folder.path()),
    )
    .expect_code(0)
    .json();
    println!("{found:#}");
    for part in ["door", "lower"] {
        let of = &found[part];
        let joint = format!("{part}_joint");
        assert_eq!(
            of["joints"],
            serde_json::json!({"mjcf": joint, "urdf": joint, "usd": format!("/cabinet/{joint}")})
        );
        assert!(number(&of["axis_deg"]) < 0.01 && number(&of["tool_m"]) < 1e-3);
        assert!(number(&of["mujoco_error"]) < 0.02, "{of}");
        let off = number(&of["usd_error"]) - number(&of["usd_announced"]);
        assert!(off.abs() < 0.05, "{of}");
        for inertia in ["mujoco_inertia", "urdf_inertia", "usd_inertia"] {
            let (got, wanted) = (number(&of[inertia]), number(&of["inertia"]));
            assert!(
                (got / wanted - 1.0).abs() < 1e-5,
                "{inertia}: {got}, {wanted}"
            );
        }
        assert_eq!(of["urdf_dynamics"], serde_json::json!([0.0, 0.0]));
        assert_eq!(of["usd_problems"], serde_json::json!([]));
        assert_eq!(of["usd_geometry_kept"], true);
    }
    let said = found["askew"].as_str().unwrap();
    assert!(
        said.contains("no revolute joint within 20 deg") && said.contains("registration"),
        "{said}"
    );
    let said = found["aside"].as_str().unwrap();
    assert!(
        said.contains("beside the twin's") && said.contains("registration"),
        "{said}"
    );
    for (format, said) in found["onto"].as_object().unwrap() {
        let said = said.as_str().unwrap();
        assert!(said.contains("the asset itself"), "{format}: {said}");
    }
    assert_eq!(found["untouched"], true);
}
