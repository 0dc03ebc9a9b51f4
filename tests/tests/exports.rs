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

/// Records and identifies a scenario.
fn identified(scenario: &str, folder: &Path) -> Twin {
    let run = |program: &str, arguments: &[&str]| {
        programs::run(program, arguments, folder).expect_code(0)
    };
    let record = [
        "--sim", scenario, "--speed", "max", "--seed", "3", "-o", "a.mcap",
    ];
    run("ft-capture", &record);
    run("ft-identify", &["a.mcap", "-o", "twin"]);
    Twin::from_json(&std::fs::read_to_string(folder.join("twin/twin.json")).unwrap()).unwrap()
}

/// Exports a twin and lets it go, and gives what the libraries say of it, and the swing; `None` without them.
fn judged(twin: &Twin, released: &str, folder: &Path) -> Option<(Value, Value)> {
    peers::python("exports")?;
    std::fs::create_dir_all(folder.join("twin")).unwrap();
    std::fs::write(folder.join("twin/twin.json"), twin.to_json().unwrap()).unwrap();
    for arguments in [
        [
            "export",
            "twin/twin.json",
            "--to",
            "mjcf,urdf,usd,onnx",
            "-o",
            "out",
        ]
        .as_slice(),
        &[
            "simulate",
            "twin/twin.json",
            "--release",
            released,
            "-o",
            "swing",
        ],
    ] {
        programs::run("ft-identify", arguments, folder).expect_code(0);
    }
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
    let mut beyond = String::new();
    for (share, times) in [
        (0.1, -4.0),
        (0.5, -2.5),
        (0.9, -9.0),
        (0.1, 3.0),
        (0.5, 9.0),
        (0.9, 2.1),
    ] {
        let q = domain.q[0] + share * (domain.q[1] - domain.q[0]);
        let dq = times * evaluator.fastest();
        writeln!(beyond, "{q},{dq},{}", evaluator.effort(q, dq, 0.0)).unwrap();
    }
    std::fs::write(folder.join("beyond.csv"), beyond).unwrap();
    let path = |name: &str| folder.join(name).display().to_string();
    let arguments = [
        path("out"),
        "object".to_owned(),
        path("states.csv"),
        path("beyond.csv"),
        path("swing/swing.json"),
        path("twin/twin.json"),
    ];
    let found = peers::run("exports", "exports.py", &arguments)?
        .expect_code(0)
        .json();
    let swing: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("swing/swing.json")).unwrap())
            .unwrap();
    println!("{found}");
    Some((found, swing))
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
    // Where the attributes are all of the twin the callback adds nothing to any model.
    let adds = number(&found["mujoco_announced_error"]) > 1e-6;
    assert_eq!(found["mujoco_callback_of_one_model"], adds, "{found}");
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
        let (error, announced) = (
            number(&found[error]),
            number(&found["table_announced_error"]),
        );
        assert!(
            (error - announced).abs() < 1e-3 && error < 0.02,
            "{error}, announced {announced}: {found}"
        );
    }
    // Faster than anything that was probed, too.
    for error in ["mujoco_error_beyond", "onnx_error_beyond"] {
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
    if peers::python("exports").is_none() {
        return;
    }
    let twin = identified("wood_door", folder.path());
    let Some((found, swing)) = judged(&twin, "45deg", folder.path()) else {
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
    if peers::python("exports").is_none() {
        return;
    }
    let twin = identified("drawer_loaded", folder.path());
    let Some((found, _)) = judged(&twin, "0.2m", folder.path()) else {
        return;
    };
    agrees(&twin, &found, ["prismatic", "linear"]);
}

/// A twin with one effect of every kind, terms of `size` (N m or N) and shapes that fit the range.
fn with_every_effect(kind: &str, range: [f64; 2], inertia: f64, size: f64) -> Twin {
    let [low, high] = range;
    let way = high - low;
    let number =
        |(name, value): (&str, f64)| serde_json::json!({"name": name, "value": value, "unit": ""});
    let effect = |name: &str, terms: &[(&str, f64)], shape: &[(&str, f64)], memoryless: bool| {
        serde_json::json!({"name": name, "memoryless": memoryless,
            "terms": terms.iter().copied().map(number).collect::<Vec<_>>(),
            "shape": shape.iter().copied().map(number).collect::<Vec<_>>()})
    };
    let mut effects = vec![
        effect(
            "spring",
            &[("stiffness", size / way), ("preload", 3.0 * size)],
            &[],
            true,
        ),
        effect(
            "detent",
            &[("hold", size)],
            &[
                ("centre", low + 0.6 * way),
                ("width", 0.05 * way),
                ("round", 0.0),
            ],
            true,
        ),
        effect(
            "catch",
            &[("pull", 2.0 * size)],
            &[
                ("closed", low),
                ("reach", 0.04 * way),
                ("inverse_square", 0.0),
            ],
            true,
        ),
        effect(
            "ripple",
            &[("sine", 0.3 * size), ("cosine", 0.1 * size)],
            &[("pitch", way / 12.0)],
            true,
        ),
        effect(
            "damping_zone",
            &[("damping", size), ("beyond", 0.2 * size)],
            &[
                ("from", low),
                ("to", low + 0.3 * way),
                ("direction", -1.0),
                ("edge", 0.05 * way),
                ("relief", 0.7),
            ],
            true,
        ),
        effect(
            "asymmetric_viscous",
            &[("damping", 0.5 * size)],
            &[("direction", 1.0)],
            true,
        ),
        effect("quadratic_drag", &[("drag", 0.1 * size)], &[], true),
        effect(
            "asymmetric_coulomb",
            &[("coulomb", 0.4 * size)],
            &[("direction", -1.0)],
            true,
        ),
        effect(
            "stribeck",
            &[("extra", 0.3 * size)],
            &[("speed", 0.1)],
            true,
        ),
        effect(
            "stribeck",
            &[("extra", 0.1 * size)],
            &[("speed", 0.2), ("power", 2.0)],
            true,
        ),
        effect(
            "position_dependent_friction",
            &[("growth", 0.3 * size)],
            &[("power", 2.0), ("from", low), ("range", way)],
            true,
        ),
        effect(
            "position_dependent_friction",
            &[("growth", 0.2 * size)],
            &[("centre", low + 0.5 * way), ("width", 0.1 * way)],
            true,
        ),
        effect(
            "presliding",
            &[("coulomb", size)],
            &[("length", 0.02 * way), ("stiff", 0.0)],
            false,
        ),
        effect("stiction", &[], &[("extra", size)], false),
    ];
    if kind == "revolute" {
        effects.push(effect(
            "gravity",
            &[("sine", size), ("cosine", size)],
            &[("lowest", 0.2)],
            true,
        ));
    }
    let units = match kind {
        "revolute" => ["kg m^2", "N m", "N m s/rad"],
        _ => ["kg", "N", "N s/m"],
    };
    let twin = serde_json::json!({
        "schema": "ft-identify/twin/1",
        "joint": {"frame": "world", "kind": kind, "axis_direction": [0.6, 0.0, 0.8], "axis_point": [1, 2, 0],
                  "tool_position": [1.8, 2.3, 1.1], "q_range": range, "coordinate": {"sign": 1.0, "offset": 0.0}},
        "beta": {"names": ["inertia", "coulomb", "viscous"], "units": units,
                 "values": [inertia, 0.2 * size, null], "covariance": []},
        "effects": effects, "domain": {"q": range, "dq": [-1.5, 1.5]}, "mechanism": null,
        "provenance": {"recordings": [], "version": "test", "calibration": null, "held_out_rms": null}
    });
    Twin::from_json(&twin.to_string()).unwrap()
}

#[test]
fn named_effects_light_joints_and_negative_ranges_are_what_the_export_announced() {
    // A very light lid that counts backward from its grasp; a drawer with the same, and one with nothing but friction.
    let lid = with_every_effect("revolute", [-1.4, -0.1], 0.02, 0.3);
    let drawer = with_every_effect("prismatic", [-0.1, 0.35], 8.0, 10.0).in_coordinate(true, 0.4);
    let mut plain = with_every_effect("prismatic", [-0.1, 0.35], 8.0, 10.0);
    plain.effects.clear();
    for (twin, released, kind) in [
        (lid, "-1rad", ["revolute", "angular"]),
        (drawer, "0.3m", ["prismatic", "linear"]),
        (plain, "0.3m", ["prismatic", "linear"]),
    ] {
        let folder = tempdir().unwrap();
        let Some((found, swing)) = judged(&twin, released, folder.path()) else {
            return;
        };
        agrees(&twin, &found, kind);
        let left_out: Vec<&str> = twin.left_out().collect();
        assert_eq!(found["left_out"], serde_json::json!(left_out));
        assert_eq!(found["not_identified"], serde_json::json!(["viscous"]));
        assert_eq!(found["left_out_in_text"], !left_out.is_empty(), "{found}");
        if swing["end"]["how"] == "arrived" {
            let (ours, theirs) = (
                number(&swing["end"]["time"]),
                number(&found["mujoco_swing_s"]),
            );
            assert!(
                (theirs / ours - 1.0).abs() < 0.02,
                "MuJoCo {theirs} s, ours {ours} s"
            );
        }
    }
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
