//! Exports of an identified twin, opened and evaluated by other people's libraries.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::fmt::Write as _;
use std::path::Path;

use ft_identify::export::{Target, export};
use ft_identify::simulate::{End, Release, release};
use ft_identify::twin::Twin;
use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

/// Records and identifies a scenario, exports its twin, and gives the twin and what the libraries say of it.
fn exported(scenario: &str, release: &str, folder: &Path) -> Option<(Twin, Value, Value)> {
    peers::python("exports")?;
    let run = |program: &str, arguments: &[&str]| {
        programs::run(program, arguments, folder).expect_code(0)
    };
    run(
        "ft-capture",
        &[
            "--sim", scenario, "--speed", "max", "--seed", "3", "-o", "a.mcap",
        ],
    );
    run("ft-identify", &["a.mcap", "-o", "twin"]);
    run(
        "ft-identify",
        &[
            "export",
            "twin/twin.json",
            "--to",
            "mjcf,urdf,usd,onnx",
            "-o",
            "out",
        ],
    );
    run(
        "ft-identify",
        &[
            "simulate",
            "twin/twin.json",
            "--release",
            release,
            "-o",
            "swing",
        ],
    );
    let twin =
        Twin::from_json(&std::fs::read_to_string(folder.join("twin/twin.json")).unwrap()).unwrap();
    let evaluator = twin.evaluator();
    let domain = evaluator.domain().clone();
    let mut states = String::new();
    // The states of the announced errors: both directions, even in the root of the speed.
    for i in 0..60 {
        for j in 0..60 {
            let part = |k: u32| (f64::from(k) + 0.5) / 60.0;
            let q = domain.q[0] + part(i) * (domain.q[1] - domain.q[0]);
            for dq in [1.0, -1.0].map(|way| way * part(j).powi(2) * evaluator.fastest()) {
                writeln!(states, "{q},{dq},{}", evaluator.effort(q, dq, 0.0)).unwrap();
            }
        }
    }
    std::fs::write(folder.join("states.csv"), states).unwrap();
    let path = |name: &str| folder.join(name).display().to_string();
    let arguments = [
        path("out"),
        "object".to_owned(),
        path("states.csv"),
        path("swing/swing.json"),
        path("twin/twin.json"),
    ];
    let found = peers::run("exports", "exports.py", &arguments)?
        .expect_code(0)
        .json();
    let swing: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("swing/swing.json")).unwrap())
            .unwrap();
    println!("{scenario}: {found}");
    Some((twin, found, swing))
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

/// What holds for any twin.
fn agrees(twin: &Twin, found: &Value, kind: [&str; 2]) {
    let inertia = twin.beta.values[0].unwrap();
    let near = |value: &Value, expected: f64, what: &str| {
        let got = number(value);
        assert!(
            (got - expected).abs() < 1e-5 * expected.abs().max(1.0),
            "{what}: {got}, {expected}"
        );
    };
    near(&found["mujoco_inertia"], inertia, "MuJoCo's inertia");
    near(&found["usd"]["inertia"], inertia, "USD's inertia");
    let of_urdf = if kind[0] == "revolute" {
        "inertia_about_axis"
    } else {
        "mass"
    };
    near(&found["urdf"][of_urdf], inertia, "URDF's inertia");
    for of in ["urdf", "usd"] {
        for (i, end) in twin.joint.q_range.iter().enumerate() {
            near(&found[of]["range"][i], *end, of);
        }
    }
    for (what, off) in [
        ("MuJoCo's handle", &found["mujoco_handle_m"]),
        ("URDF's handle", &found["urdf"]["handle_m"]),
        ("USD's handle", &found["usd"]["handle_m"]),
        ("USD's joint", &found["usd"]["joint_meets_part_m"]),
        ("USD's axes", &found["usd"]["axis_off"]),
    ] {
        // Floats of USD and the tilt of a tool that was not quite where the fit has it.
        assert!(number(off) < 2e-3, "{what} is {off} m off");
    }
    assert_eq!(found["mujoco_callback_of_one_model"], true, "{found}");
    assert_eq!(found["urdf"]["valid"], true, "{found}");
    assert_eq!(found["urdf"]["type"], kind[0]);
    assert_eq!(found["usd"]["kind"], kind[1]);
    assert_eq!(found["usd"]["default_prim"], "object");
    assert_eq!(
        found["usd_problems"].as_array().map(Vec::len),
        Some(0),
        "{}",
        found["usd_problems"]
    );
    for error in ["mujoco_error", "onnx_error"] {
        assert!(number(&found[error]) < 0.02, "{error}: {found}");
    }
    assert_eq!(number(&found["onnx_batch_error"]), 0.0);
    for (error, announced) in [
        (
            &found["mujoco_native_error"],
            &found["mujoco_announced_error"],
        ),
        (&found["usd"]["error"], &found["usd"]["announced_error"]),
    ] {
        let (error, announced) = (number(error), number(announced));
        assert!(
            (error - announced).abs() < 1e-3,
            "{error}, announced {announced}: {found}"
        );
    }
}

#[test]
fn a_door_with_a_closer_opens_and_swings_in_other_simulators() {
    let folder = tempdir().unwrap();
    let Some((twin, found, swing)) = exported("wood_door", "45deg", folder.path()) else {
        return;
    };
    agrees(&twin, &found, ["revolute", "angular"]);
    let (ours, theirs) = (
        number(&swing["end"]["time"]),
        number(&found["mujoco_swing_s"]),
    );
    assert_eq!(swing["end"]["how"], "arrived");
    assert!(
        (theirs / ours - 1.0).abs() < 0.02,
        "MuJoCo {theirs} s, ours {ours} s"
    );
}

#[test]
fn a_drawer_opens_in_other_simulators() {
    let folder = tempdir().unwrap();
    let Some((twin, found, _)) = exported("drawer_loaded", "0.2m", folder.path()) else {
        return;
    };
    agrees(&twin, &found, ["prismatic", "linear"]);
}

/// A door that a spring, a damper and dry friction are: what the USD's joint attributes hold whole.
fn springy() -> Twin {
    let damping = serde_json::json!({"interval_q": [0.0, 1.5], "interval_sqrt_speed": [0.0, 1.5], "pieces": [1, 1],
                                     "degree": [1, 1], "coefficients": [2.0, 2.0, 2.0, 2.0]});
    let twin = serde_json::json!({
        "schema": "ft-identify/twin/1",
        "joint": {"frame": "world", "kind": "revolute", "axis_direction": [0, 0, 1], "axis_point": [1, 2, 0],
                  "tool_position": [1.8, 2, 1.1], "q_range": [0.0, 1.5], "coordinate": {"sign": 1.0, "offset": 0.0}},
        "beta": {"names": ["inertia", "coulomb", "viscous"], "units": ["kg m^2", "N m", "N m s/rad"],
                 "values": [3.0, 0.5, 0.4], "covariance": []},
        "effects": [], "domain": {"q": [0.0, 1.5], "dq": [-2.0, 2.0]},
        "mechanism": {"kind": "spline", "damping": [damping, damping],
            "load": {"interval": [0.0, 1.5], "pieces": 1, "degree": 1, "coefficients": [6.0, 9.0]}},
        "provenance": {"recordings": [], "version": "test", "calibration": null, "held_out_rms": null}
    });
    Twin::from_json(&twin.to_string()).unwrap()
}

#[test]
fn newton_swings_the_exported_usd_as_the_twin() {
    let Some(python) = peers::newton("newton_swings_the_exported_usd_as_the_twin") else {
        return;
    };
    let folder = tempdir().unwrap();
    let twin = springy();
    export(&twin, &[Target::Usd], folder.path(), "door", false).unwrap();
    let how = Release {
        from: 0.8,
        until: 0.0,
        step: 1e-4,
        longest: 30.0,
    };
    let ours = release(&twin.evaluator(), twin.joint.q_range, &how).unwrap();
    let End::Arrived { time, .. } = ours.end else {
        panic!("{:?}", ours.end)
    };
    let output = std::process::Command::new(python)
        .arg(ft_tests::workspace_root().join("tests/peers/newton_swing.py"))
        .arg(folder.path().join("door.usda"))
        .args(["0.8", "0.0"])
        .output()
        .unwrap();
    let said = programs::Finished::new("newton_swing.py", &output).expect_code(0);
    let found: Value = serde_json::from_str(said.stdout.lines().last().unwrap()).unwrap();
    println!("{found}, ours {time} s");
    assert!((number(&found["swing_s"]) / time - 1.0).abs() < 0.02);
    assert!(number(&found["effort_error"]) < 0.02);
    assert!((number(&found["inertia"]) - 3.0).abs() < 1e-4);
}
