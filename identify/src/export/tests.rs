use super::*;
use nalgebra::{Isometry3, Point3, Vector3};

/// A door of 3 kg m^2 with a closer: spring, dry friction, one-way damping.
fn door() -> Twin {
    let surface = |c: f64| {
        serde_json::json!({"interval_q": [0.0, 1.5], "interval_sqrt_speed": [0.0, 1.5], "pieces": [1, 1],
                           "degree": [1, 1], "coefficients": [c, c, c, c]})
    };
    serde_json::from_value(serde_json::json!({
        "schema": "ft-identify/twin/1",
        "joint": {"frame": "world", "kind": "revolute", "axis_direction": [0, 0, 1], "axis_point": [1, 2, 0],
                  "tool_position": [1.8, 2, 1.1], "q_range": [0.0, 1.5], "coordinate": {"sign": 1.0, "offset": 0.0}},
        "beta": {"names": ["inertia", "coulomb", "viscous"], "units": ["kg m^2", "N m", "N m s/rad"],
                 "values": [3.0, 0.5, 0.4], "covariance": []},
        "effects": [], "domain": {"q": [0.0, 1.5], "dq": [-2.0, 2.0]},
        "mechanism": {"kind": "spline",
            "load": {"interval": [0.0, 1.5], "pieces": 1, "degree": 1, "coefficients": [6.0, 9.0]},
            "damping": [surface(0.0), surface(2.0)]},
        "provenance": {"recordings": [], "version": "test", "calibration": null, "held_out_rms": null}
    }))
    .unwrap()
}

#[test]
fn attributes_that_can_hold_a_twin_do() {
    // The same damping both ways: spring, damper and friction are all there is.
    let mut twin = door();
    let mechanism = twin.mechanism.as_mut().unwrap();
    mechanism.damping[0] = mechanism.damping[1].clone();
    let evaluator = twin.evaluator();
    for native in [
        Native::spring(&evaluator).unwrap(),
        Native::polynomial(&evaluator).unwrap(),
    ] {
        assert!(native.relative_error.unwrap() < 1e-6, "{native:?}");
        assert!(
            (native.friction - 0.5).abs() < 1e-6 && (native.damping[0] - 2.4).abs() < 1e-5,
            "{native:?}"
        );
        assert!(
            (native.stiffness[0] - 2.0).abs() < 1e-5 && (native.reference + 3.0).abs() < 1e-4,
            "{native:?}"
        );
    }
    assert!(
        Native::friction(&evaluator)
            .unwrap()
            .relative_error
            .unwrap()
            > 0.5,
        "URDF has no spring"
    );
}

#[test]
fn a_load_without_a_root_is_still_held() {
    let mut twin = door();
    let mechanism = twin.mechanism.as_mut().unwrap();
    mechanism.load.coefficients = vec![7.0, 7.0];
    mechanism.damping[0] = mechanism.damping[1].clone();
    let native = Native::spring(&twin.evaluator()).unwrap();
    assert!(native.relative_error.unwrap() < 1e-4, "{native:?}");
    assert!((native.effort(0.7, 0.0) - 7.0).abs() < 1e-3, "{native:?}");
}

#[test]
fn a_table_holds_what_attributes_cannot() {
    let evaluator = door().evaluator();
    let native = Native::polynomial(&evaluator).unwrap();
    let table = Table::of(&evaluator);
    assert!(
        native.relative_error.unwrap() > 0.05,
        "one-way damping is no polynomial: {native:?}"
    );
    assert!(table.error(&evaluator) < 1e-3);
    let (q, dq) = (0.81, -0.63);
    assert!((table.effort(q, dq) - evaluator.effort(q, dq, 0.0)).abs() < 0.01);
}

#[test]
fn a_panel_hangs_between_axis_and_handle_in_any_frame() {
    let twin = door();
    let scene = Scene::of(&twin);
    assert!((scene.origin - Point3::new(1.0, 2.0, 1.1)).norm() < 1e-12);
    assert!((scene.handle - Vector3::new(0.8, 0.0, 0.0)).norm() < 1e-12);
    assert!(
        (scene.inertia[0] - 3.0).abs() < 1e-12
            && scene.inertia[0] <= scene.inertia[1] + scene.inertia[2]
    );
    let motion = Isometry3::new(Vector3::new(3.0, 1.0, -2.0), Vector3::new(0.5, -1.0, 0.2));
    let moved = Scene::of(&twin.in_frame("room", &motion).in_coordinate(true, 0.4));
    // The tool stands where it stood, 0.4 rad further back in the reversed sense.
    let turned = moved.axis.cross(&moved.handle);
    let here = moved.origin + moved.handle * 0.4_f64.cos() + turned * 0.4_f64.sin();
    assert!((here - motion * Point3::new(1.8, 2.0, 1.1)).norm() < 1e-9);
}

/// What the table is off; the attributes of each format can be fitted.
fn table_error(twin: &Twin) -> f64 {
    let evaluator = twin.evaluator();
    for native in [
        Native::polynomial(&evaluator),
        Native::spring(&evaluator),
        Native::friction(&evaluator),
    ] {
        assert!(native.unwrap().relative_error.unwrap().is_finite());
    }
    Table::of(&evaluator).error(&evaluator)
}

#[test]
fn beyond_all_that_was_probed_the_table_goes_on_as_the_evaluator_does() {
    let mut bent = door();
    let bend = |at, slope| crate::mechanism::Bend { at, slope };
    bent.mechanism.as_mut().unwrap().damping[1].valve.bends = vec![bend(1.0, 0.3)];
    for twin in [door(), bent.clone(), bent.in_coordinate(true, 0.3)] {
        let evaluator = twin.evaluator();
        let (table, fastest) = (Table::of(&evaluator), evaluator.fastest());
        let [low, high] = evaluator.domain().q;
        for share in [0.03, 0.5, 0.97] {
            for times in [-30.0, -3.0, -2.1, -1.9, 1.2, 1.9, 2.1, 4.0, 30.0] {
                let (q, dq) = (low + share * (high - low), times * fastest);
                let (here, there) = (evaluator.effort(q, dq, 0.0), table.effort(q, dq));
                assert!(
                    (here - there).abs() < 2e-3 * here.abs().max(1.0),
                    "{times}: {here} {there}"
                );
            }
        }
    }
}

#[test]
fn drag_goes_on_straight_in_the_twin_as_in_the_table() {
    let mut twin = door();
    twin.effects = serde_json::from_value(serde_json::json!([
        {"name": "quadratic_drag", "memoryless": true, "shape": [], "terms": [{"name": "drag", "value": 3.0, "unit": ""}]}
    ]))
    .unwrap();
    let evaluator = twin.evaluator();
    let table = Table::of(&evaluator);
    for dq in [-40.0, -4.1, 4.0, 4.1, 40.0] {
        let (here, there) = (evaluator.effort(0.7, dq, 0.0), table.effort(0.7, dq));
        assert!((here / there - 1.0).abs() < 1e-6, "{dq}: {here} {there}");
    }
}

#[test]
fn the_table_covers_the_range_of_the_joint() {
    let mut twin = door();
    twin.joint.q_range = [-0.1, 1.7];
    let table = Table::of(&twin.evaluator());
    assert_eq!(table.q, [-0.1, 1.7]);
}

#[test]
fn a_twin_without_a_mechanism_keeps_friction_and_damping() {
    let mut twin = door();
    twin.mechanism = None;
    for native in [
        Native::polynomial(&twin.evaluator()),
        Native::friction(&twin.evaluator()),
    ] {
        let native = native.unwrap();
        assert!(
            (native.friction - 0.5).abs() < 1e-6 && (native.damping[0] - 0.4).abs() < 1e-6,
            "{native:?}"
        );
    }
    assert!(table_error(&twin) < 1e-3);
}

#[test]
fn one_probed_direction_makes_no_load_pass_for_friction() {
    let mut twin = door();
    twin.domain.dq = [0.0, 1.3];
    let mechanism = twin.mechanism.as_mut().unwrap();
    mechanism.damping[1] = mechanism.damping[0].clone();
    let native = Native::friction(&twin.evaluator()).unwrap();
    assert!((native.friction - 0.5).abs() < 1e-6, "{native:?}");
    assert!(table_error(&twin) < 1e-3);
}

#[test]
fn a_load_that_is_zero_nowhere_near_keeps_its_numbers_small() {
    let mut twin = door();
    let mechanism = twin.mechanism.as_mut().unwrap();
    // Nearly 10 + 3 (q - 0.75)^2: three nodes of a quadratic spline.
    mechanism.load.degree = 2;
    mechanism.load.coefficients = vec![11.7, 8.3, 11.7];
    mechanism.damping[0] = mechanism.damping[1].clone();
    let native = Native::polynomial(&twin.evaluator()).unwrap();
    assert!(
        native.stiffness.iter().all(|k| k.abs() < 100.0),
        "{native:?}"
    );
    assert!(native.relative_error.unwrap() < 0.1, "{native:?}");
    assert!(table_error(&twin) < 1e-3);
}

#[test]
fn a_reversed_twin_exports_the_same_efforts_reversed() {
    let twin = door();
    let reversed = twin.in_coordinate(true, 0.3);
    let [one, other] = [&twin, &reversed].map(|twin| Table::of(&twin.evaluator()));
    for (q, dq) in [(0.2, 0.7), (0.9, -1.1), (1.3, 0.05)] {
        let (here, there) = (one.effort(q, dq), other.effort(0.3 - q, -dq));
        assert!((here + there).abs() < 0.02, "{here} {there}");
    }
}

#[test]
fn nothing_is_written_when_one_file_is_there_and_a_twin_without_inertia_has_no_body() {
    const ALL: [Target; 4] = [Target::Mjcf, Target::Urdf, Target::Usd, Target::Onnx];
    let folder = tempfile::tempdir().unwrap();
    let twin = door();
    export(&twin, &[Target::Urdf], folder.path(), "door", false).unwrap();
    let again = export(&twin, &ALL, folder.path(), "door", false).unwrap_err();
    assert!(again.to_string().contains("door.urdf exists"), "{again}");
    assert!(!folder.path().join("door.xml").exists());
    for done in export(&twin, &ALL, folder.path(), "door", true).unwrap() {
        assert!(done.files.iter().all(|file| file.exists()) && done.table_error < 1e-3);
    }
    assert!(matches!(
        export(&twin, &ALL, folder.path(), "world", true),
        Err(ExportError::Name { .. })
    ));
    let mut light = door();
    light.beta.values[0] = None;
    assert!(matches!(
        export(&light, &[Target::Usd], folder.path(), "light", false),
        Err(ExportError::NoInertia)
    ));
    assert!(export(&light, &[Target::Onnx], folder.path(), "light", false).is_ok());
}
