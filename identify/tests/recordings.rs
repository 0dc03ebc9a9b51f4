//! Whole recordings with known truth: what is recovered, and what is refused.
#![allow(clippy::unwrap_used)]

mod synthetic;

use ft_identify::analysis::Verdict;
use ft_identify::error::IdentifyError;
use ft_identify::motion::MotionSettings;
use ft_identify::output::write_to;
use ft_identify::payload::PayloadSource;
use ft_identify::pipeline::{Identified, identify_loaded, joint_samples};
use ft_identify::screw::{JointKind, ScrewAxis, SelectError};
use ft_identify::tool::{AlignError, ToolSamples};
use ft_recording::Recording;
use synthetic::{BIAS, COM, INERTIA, MASS, Scene, calibration};

fn identify(recording: &Recording) -> Result<Identified, IdentifyError> {
    identify_loaded(recording, &MotionSettings::default(), &mut |_| {})
}

fn truth(scene: &Scene) -> ScrewAxis {
    let (direction, point) = scene.axis();
    let kind = if scene.revolute {
        JointKind::Revolute
    } else {
        JointKind::Prismatic
    };
    ScrewAxis {
        direction,
        point,
        kind,
    }
}

fn assert_near(name: &str, got: Option<f64>, truth: f64, share: f64) {
    let got = got.unwrap_or_else(|| panic!("{name} is null"));
    assert!(
        (got / truth - 1.0).abs() < share,
        "{name}: {got}, truth {truth}"
    );
}

#[test]
fn a_door_is_recovered_from_its_recording() {
    for seed in 0..3 {
        let scene = Scene {
            seed,
            ..Scene::door()
        };
        let found = identify(&scene.record()).unwrap();
        let axis = found.axis.unwrap();
        assert_eq!(axis.kind, JointKind::Revolute);
        let (angle, distance) = axis.separation(&truth(&scene));
        assert!(
            angle.to_degrees() < 0.5 && distance < 5e-3,
            "{} deg, {distance} m",
            angle.to_degrees()
        );
        assert!(
            axis.direction.dot(&truth(&scene).direction) > 0.0,
            "opening is positive"
        );
        let value = |name: &str| found.report.term(name).unwrap().value;
        assert_near("inertia", value("inertia"), scene.inertia, 0.03);
        assert_near("coulomb", value("coulomb"), scene.coulomb, 0.08);
        assert_near("viscous", value("viscous"), scene.viscous, 0.25);
        let twin = found.twin.unwrap();
        let evaluator = twin.evaluator();
        let load = |q: f64| evaluator.rest_band(q).iter().sum::<f64>() / 2.0;
        assert!(
            (load(0.9) - load(0.3) - 1.8).abs() < 0.3,
            "{seed}: {}",
            load(0.9) - load(0.3)
        );
        let floor = found.report.last.noise_floor_rms.unwrap();
        let held_out = found.report.last.held_out_rms.unwrap();
        assert!(
            held_out < 1.4 * floor && held_out > 0.5 * floor,
            "held out {held_out}, floor {floor}"
        );
    }
}

#[test]
fn a_drawer_is_recovered_with_a_calibration_instead_of_free_air() {
    let scene = Scene::drawer();
    let mut recording = scene.record();
    recording.calibration = Some(calibration());
    recording
        .wrench
        .retain(|sample| sample.at > synthetic::at(9.0));
    let found = identify(&recording).unwrap();
    let axis = found.axis.unwrap();
    assert_eq!(axis.kind, JointKind::Prismatic);
    assert!(axis.separation(&truth(&scene)).0.to_degrees() < 0.5);
    assert_eq!(
        found.report.payload.as_ref().unwrap().source,
        PayloadSource::Calibration
    );
    assert_near(
        "inertia",
        found.report.term("inertia").unwrap().value,
        scene.inertia,
        0.03,
    );
    assert_near(
        "coulomb",
        found.report.term("coulomb").unwrap().value,
        scene.coulomb,
        0.05,
    );
    assert_near(
        "viscous",
        found.report.term("viscous").unwrap().value,
        scene.viscous,
        0.2,
    );
}

#[test]
fn the_tool_is_weighed_in_free_air_within_its_stated_uncertainty() {
    let found = identify(&Scene::door().record()).unwrap();
    let payload = found.report.payload.unwrap();
    assert_eq!(payload.source, PayloadSource::FreeAir);
    assert!(
        payload.mass_std_kg < 0.01
            && (payload.mass_kg - MASS).abs() < 4.0 * payload.mass_std_kg.max(5e-4)
    );
    for (k, com) in COM.iter().enumerate() {
        assert!((payload.com_m[k] - com).abs() < 3e-3, "{:?}", payload.com_m);
    }
    for (k, bias) in BIAS.iter().enumerate() {
        let limit = if k < 3 { 0.05 } else { 0.01 };
        assert!((payload.bias[k] - bias).abs() < limit, "{:?}", payload.bias);
    }
}

#[test]
fn a_wrench_that_comes_late_is_seen_in_free_air_and_weighs_no_less() {
    let scene = Scene {
        late_s: 0.05,
        ..Scene::door()
    };
    let found = identify(&scene.record()).unwrap();
    let payload = found.report.payload.as_ref().unwrap();
    let (late, std) = payload.late_s.unwrap();
    assert!((late - 0.05).abs() < 1e-3 && std < 1e-3, "{late} {std}");
    assert!((payload.mass_kg - MASS).abs() < 4.0 * payload.mass_std_kg.max(5e-4));
    let lag = found.report.lag.unwrap();
    assert!(lag.applied && (lag.value_s - 0.05).abs() < 1e-3, "{lag:?}");
    assert!(found.report.effects.iter().any(|e| e.name == "time_lag"));
    let inertia = found.report.term("inertia").unwrap();
    assert_near("inertia", inertia.value, scene.inertia, 0.02);
}

#[test]
fn free_air_shows_the_inertia_of_the_tool_itself() {
    let found = identify(&Scene::door().record()).unwrap();
    let payload = found.report.payload.unwrap();
    let [xx, _, yy, _, _, zz] = payload.inertia_kgm2;
    for (found, truth) in [xx, yy, zz].into_iter().zip(INERTIA) {
        assert!((found - truth).abs() < 3e-4, "{:?}", payload.inertia_kgm2);
    }
}

#[test]
fn slow_poses_and_wrenches_in_bursts_are_read() {
    let scene = Scene::door();
    let mut recording = scene.record();
    recording.pose.samples = recording.pose.samples.into_iter().step_by(11).collect();
    // Four at a time, 1 us apart, stamped in their middle.
    for burst in recording.wrench.chunks_exact_mut(4) {
        let first = burst[0].at.offset_by_seconds(1.5 / 800.0);
        for (sample, k) in burst.iter_mut().zip(0..) {
            sample.at = first.offset_by_seconds(1e-6 * f64::from(k));
        }
    }
    let tool = ToolSamples::means_from_recording(&recording).unwrap();
    assert!((tool.period - 5e-3).abs() < 1e-5, "{} s", tool.period);
    assert_eq!(tool.runs.len(), 1);
    let found = identify(&recording).unwrap();
    let value = |name: &str| found.report.term(name).unwrap().value;
    assert_near("inertia", value("inertia"), scene.inertia, 0.03);
    assert_near("coulomb", value("coulomb"), scene.coulomb, 0.08);
}

#[test]
fn free_air_after_the_release_alone_contradicts_a_calibration_too() {
    let mut recording = Scene {
        free_after_s: 6.0,
        ..Scene::door()
    }
    .record();
    recording
        .marks
        .retain(|mark| mark.value != "free_air_begin");
    let begin = recording.marks[0].at.offset_by_seconds(-0.5);
    recording.wrench.retain(|sample| sample.at > begin);
    let mut wrong = calibration();
    wrong.payload_mass_kg.value += 0.3;
    recording.calibration = Some(wrong);
    let payload = identify(&recording).unwrap().report.payload.unwrap();
    assert!(payload.contradicted_kg.is_some(), "{payload:?}");
    assert!((payload.mass_kg - MASS).abs() < 0.02, "{payload:?}");
}

#[test]
fn a_drift_between_two_free_air_parts_is_taken_off() {
    let scene = Scene {
        free_after_s: 6.0,
        drift_n_per_s: 0.02,
        ..Scene::door()
    };
    let found = identify(&scene.record()).unwrap();
    let rate = found.report.payload.as_ref().unwrap().bias_rate;
    for (k, rate) in rate.iter().enumerate().take(3) {
        assert!((rate - 0.02).abs() < 0.003, "axis {k}: {rate} N/s");
    }
    assert!(
        found
            .report
            .notes
            .iter()
            .any(|note| note.contains("drifted"))
    );
}

#[test]
fn a_usual_drift_is_seen_in_a_short_free_air_after_the_release() {
    let scene = Scene {
        free_after_s: 1.0,
        drift_n_per_s: 6e-4,
        ..Scene::drawer()
    };
    let found = identify(&scene.record()).unwrap();
    let rate = found.report.payload.as_ref().unwrap().bias_rate;
    for (k, rate) in rate.iter().enumerate().take(3) {
        assert!((rate - 6e-4).abs() < 4e-4, "axis {k}: {rate} N/s");
    }
    assert!(found.report.effects.is_empty());
}

/// Root mean square relative error of the friction of a light drawer over some seeds.
fn friction_error(scene: &Scene) -> f64 {
    let square = |seed| {
        let scene = Scene {
            seed,
            inertia: 0.5,
            coulomb: 0.8,
            viscous: 0.8,
            ..scene.clone()
        };
        let found = identify(&scene.record()).unwrap();
        let coulomb = found.report.term("coulomb").unwrap().value.unwrap();
        (coulomb / scene.coulomb - 1.0).powi(2)
    };
    ((1..4).map(square).sum::<f64>() / 3.0).sqrt()
}

#[test]
fn a_tool_that_a_tracker_turns_wrongly_pushes_no_harder() {
    let error = friction_error(&Scene {
        wander: [1.5e-3, 2e-3],
        ..Scene::drawer()
    });
    assert!(error < 0.004, "{error}");
}

#[test]
fn a_tool_that_turns_in_the_grasp_is_where_the_tracker_has_it() {
    let error = friction_error(&Scene {
        turned_in_grasp: 0.15,
        ..Scene::drawer()
    });
    assert!(error < 0.02, "{error}");
}

#[test]
fn free_air_that_contradicts_the_calibration_is_believed() {
    let mut recording = Scene::door().record();
    let mut wrong = calibration();
    wrong.payload_mass_kg.value += 0.15;
    recording.calibration = Some(wrong);
    let found = identify(&recording).unwrap();
    let payload = found.report.payload.as_ref().unwrap();
    assert!((payload.mass_kg - MASS).abs() < 0.005, "{payload:?}");
    assert!((payload.contradicted_kg.unwrap() - MASS - 0.15).abs() < 1e-9);
    let notes = &found.report.notes;
    assert!(
        notes
            .iter()
            .any(|note| note.contains("free air was believed"))
    );
    let right = identify(&Scene::door().record()).unwrap().report;
    assert_eq!(right.payload.unwrap().contradicted_kg, None);
}

#[test]
fn without_marks_a_calibrated_tool_finds_the_grasp_by_itself() {
    let mut recording = Scene {
        free_after_s: 3.0,
        ..Scene::door()
    }
    .record();
    recording.calibration = Some(calibration());
    recording.marks.clear();
    let found = identify(&recording).unwrap();
    assert_eq!(found.report.input.grasp.as_deref(), Some("wrench"));
    assert_eq!(
        found.report.payload.as_ref().unwrap().source,
        PayloadSource::Both
    );
    assert_near(
        "inertia",
        found.report.term("inertia").unwrap().value,
        4.0,
        0.05,
    );
}

#[test]
fn a_shaken_tool_seems_to_push_by_the_noise_of_its_poses_and_has_grasped_nothing() {
    let mut recording = Scene {
        pose_noise_m: 2e-3,
        ..Scene::door()
    }
    .record();
    recording.calibration = Some(calibration());
    recording.marks.clear();
    let found = identify(&recording).unwrap();
    assert_eq!(found.report.input.grasp.as_deref(), Some("wrench"));
    let inertia = found.report.term("inertia").unwrap();
    assert_near("inertia", inertia.value, 4.0, 0.05);
}

#[test]
fn an_unknown_tool_leaves_the_joint_known_and_the_dynamics_null() {
    let mut recording = Scene::door().record();
    recording
        .wrench
        .retain(|sample| sample.at > synthetic::at(9.0));
    let found = identify(&recording).unwrap();
    assert_eq!(found.axis.unwrap().kind, JointKind::Revolute);
    assert!(found.twin.is_none());
    assert_eq!(found.report.last.verdict, Verdict::NotIdentifiable);
    assert_eq!(found.report.term("inertia").unwrap().value, None);
    assert!(found.report.not_identified["inertia"].contains("move the tool in free air"));
    // And it confirms nothing.
    let refused = joint_samples(&recording, &MotionSettings::default()).unwrap_err();
    assert!(
        refused.to_string().contains("own weight is unknown"),
        "{refused}"
    );
}

#[test]
fn free_air_without_motion_weighs_nothing() {
    let scene = Scene::door();
    let mut recording = scene.record();
    let still = recording
        .pose
        .samples
        .iter()
        .find(|s| s.at >= synthetic::at(9.0))
        .unwrap()
        .value;
    for sample in recording
        .pose
        .samples
        .iter_mut()
        .filter(|s| s.at < synthetic::at(9.0))
    {
        sample.value = still;
    }
    let held = recording
        .wrench
        .iter()
        .find(|s| s.at >= synthetic::at(8.99))
        .unwrap()
        .value;
    for (i, sample) in recording
        .wrench
        .iter_mut()
        .enumerate()
        .take_while(|(_, s)| s.at < synthetic::at(9.0))
    {
        sample.value = held.map(|v| v + 0.01 * (i as f64 * 1.7).sin());
    }
    let found = identify(&recording).unwrap();
    assert!(
        found.report.not_identified["inertia"].contains("turn the tool over"),
        "{:?}",
        found.report.not_identified
    );
}

#[test]
fn holes_split_the_motion_and_are_counted() {
    let mut recording = Scene::door().record();
    recording
        .pose
        .samples
        .retain(|s| !(s.at > synthetic::at(20.0) && s.at < synthetic::at(20.4)));
    recording
        .wrench
        .retain(|s| !(s.at > synthetic::at(31.0) && s.at < synthetic::at(31.1)));
    let found = identify(&recording).unwrap();
    assert_eq!(found.report.input.gaps, 2);
    // The longest one, to the samples about it.
    let longest = found.report.input.longest_gap_s.unwrap();
    for (at, cut) in longest.iter().zip([20.0, 20.4]) {
        assert!((at - cut).abs() < 0.02, "{longest:?}");
    }
    assert!(
        found
            .report
            .notes
            .iter()
            .any(|note| note.contains("2 gaps"))
    );
    assert_near(
        "inertia",
        found.report.term("inertia").unwrap().value,
        4.0,
        0.05,
    );
}

#[test]
fn strokes_of_one_slow_pace_leave_the_inertia_null_with_what_to_do() {
    let slow = Scene {
        pace: 0.15,
        inertia: 0.4,
        load: |_| 0.0,
        ..Scene::door()
    };
    let found = identify(&slow.record()).unwrap();
    assert_eq!(found.axis.unwrap().kind, JointKind::Revolute);
    assert_eq!(found.report.term("inertia").unwrap().value, None);
    let reason = &found.report.not_identified["inertia"];
    assert!(reason.contains("fast strokes"), "{reason}");
    assert_near(
        "coulomb",
        found.report.term("coulomb").unwrap().value,
        1.5,
        0.15,
    );
}

/// A quarter of the usual pace is between: some recordings show the inertia once they are smoothed further, and others do not.
#[test]
fn slow_strokes_that_show_the_inertia_show_the_true_one() {
    let mut shown = 0;
    for seed in 1..5 {
        let slow = Scene {
            pace: 0.25,
            inertia: 0.4,
            load: |_| 0.0,
            seed,
            ..Scene::door()
        };
        let found = identify(&slow.record()).unwrap();
        let term = found.report.term("inertia").unwrap();
        if let (Some(value), Some(std)) = (term.value, term.std) {
            shown += 1;
            assert!((value - 0.4).abs() < 3.0 * std, "{value} +- {std}");
        }
    }
    assert!(shown > 0, "none of four was smoothed far enough");
}

#[test]
fn a_tool_that_slips_along_the_handle_is_refused_and_a_little_slip_is_not() {
    let slipped = |by_m: f64| {
        let mut recording = Scene::door().record();
        for sample in &mut recording.pose.samples {
            let t = sample.at.seconds_since(synthetic::at(0.0));
            sample.value.position[2] -= by_m * ((t - 25.0) / 2.0).clamp(0.0, 1.0);
        }
        identify(&recording)
    };
    let error = slipped(0.08).map(|_| ()).unwrap_err();
    assert!(
        matches!(error, IdentifyError::NeitherJoint { .. }),
        "{error}"
    );
    let text = error.to_string();
    assert!(
        text.contains("slid along the handle") && text.contains("grasp firmly"),
        "{text}"
    );
    let found = slipped(0.005).unwrap();
    assert_near(
        "inertia",
        found.report.term("inertia").unwrap().value,
        4.0,
        0.05,
    );
}

#[test]
fn each_refusal_says_what_and_what_to_do() {
    let refused = |change: &dyn Fn(&mut Recording)| {
        let mut recording = Scene::door().record();
        change(&mut recording);
        identify(&recording).map(|_| ()).unwrap_err()
    };
    let error = refused(&|r| r.pose.samples.truncate(10));
    assert!(
        matches!(
            error,
            IdentifyError::Align(AlignError::TooFewSamples {
                stream: "pose",
                samples: 10,
                ..
            })
        ),
        "{error}"
    );
    let error = refused(&|r| {
        r.wrench
            .iter_mut()
            .for_each(|s| s.at = s.at.offset_by_seconds(1000.0))
    });
    assert!(
        matches!(error, IdentifyError::Align(AlignError::NoOverlap { .. })),
        "{error}"
    );
    let error = refused(&|r| {
        r.pose
            .samples
            .retain(|s| (s.at.as_nanos() / 100_000_000) % 5 != 0);
    });
    assert!(
        matches!(error, IdentifyError::Align(AlignError::Gaps { .. })),
        "{error}"
    );
    let error = refused(&|r| {
        r.marks
            .iter_mut()
            .filter(|m| m.value == "release")
            .for_each(|m| m.at = synthetic::at(11.0))
    });
    assert!(
        matches!(error, IdentifyError::HeldTooShort { .. }),
        "{error}"
    );
    let error = identify(
        &Scene {
            range: 0.005,
            ..Scene::door()
        }
        .record(),
    )
    .map(|_| ())
    .unwrap_err();
    assert!(
        matches!(error, IdentifyError::Select(SelectError::NeverMoves { .. })),
        "{error}"
    );
    let error = refused(&|r| {
        let most = r
            .wrench
            .iter()
            .map(|s| s.value[1].abs())
            .fold(0.0, f64::max);
        for sample in &mut r.wrench {
            sample.value[1] = sample.value[1].clamp(-0.6 * most, 0.6 * most);
        }
    });
    assert!(matches!(error, IdentifyError::Saturated { .. }), "{error}");
    // Blows of 15 ms, each to the end of the range.
    let error = refused(&|r| {
        let most = r.wrench.iter().map(|s| s.value[1]).fold(0.0, f64::max);
        for blow in r.wrench[8000..24_000].chunks_mut(400) {
            for sample in &mut blow[..12] {
                sample.value[1] = 1.05 * most;
            }
        }
    });
    assert!(matches!(error, IdentifyError::Saturated { .. }), "{error}");
    let error = refused(&|r| {
        for sample in &mut r.pose.samples {
            let t = sample.at.seconds_since(synthetic::at(0.0));
            sample.value.position[2] += 0.1 * (0.9 * t).sin();
        }
    });
    assert!(
        matches!(error, IdentifyError::NeitherJoint { .. }),
        "{error}"
    );
    let nothing = Scene {
        inertia: 0.0,
        coulomb: 0.0,
        viscous: 0.0,
        load: |_| 0.0,
        ..Scene::door()
    };
    let mut free = nothing.record();
    free.marks.retain(|m| m.value != "grasp");
    free.marks.push(ft_recording::Stamped {
        at: synthetic::at(3.0),
        value: "grasp".into(),
    });
    free.marks
        .iter_mut()
        .filter(|m| m.value == "release")
        .for_each(|m| m.at = synthetic::at(8.9));
    free.calibration = Some(calibration());
    let error = identify(&free).map(|_| ()).unwrap_err();
    assert!(matches!(error, IdentifyError::NoContact { .. }), "{error}");
}

#[test]
fn the_report_keeps_its_schema_and_the_page_needs_no_network() {
    let found = identify(&Scene::door().record()).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let target = directory.path().join("new/place");
    let files = write_to(&target, &found).unwrap();
    assert_eq!(files.len(), 3);
    let report: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(target.join("report.json")).unwrap())
            .unwrap();
    assert_eq!(report["schema"], "ft-identify/report/1");
    let keys = |at: &str, names: &[&str]| {
        for name in names {
            assert!(
                report.pointer(&format!("{at}/{name}")).is_some(),
                "{at}/{name} is missing"
            );
        }
    };
    keys(
        "",
        &[
            "input",
            "joint",
            "base",
            "effects",
            "refused",
            "final",
            "mechanism",
        ],
    );
    keys(
        "/input",
        &[
            "files",
            "confirm",
            "duration_s",
            "samples_used",
            "samples_gated",
        ],
    );
    keys(
        "/joint",
        &[
            "kind",
            "axis_direction",
            "axis_point",
            "std",
            "q_range",
            "position_rms_m",
            "bic",
        ],
    );
    keys("/joint/std", &["direction_deg", "position_m"]);
    keys("/joint/bic", &["revolute", "prismatic"]);
    keys("/base", &["terms", "rms", "relative_error", "held_out_rms"]);
    keys("/base/terms/0", &["name", "value", "std", "unit"]);
    keys(
        "/final",
        &[
            "terms",
            "rms",
            "relative_error",
            "held_out_rms",
            "confirm_relative_error",
            "noise_floor_rms",
            "unexplained_fraction",
            "verdict",
        ],
    );
    keys("/mechanism", &["kind", "held_out_rms"]);
    let names: Vec<&str> = report["base"]["terms"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|t| t["name"].as_str())
        .collect();
    assert_eq!(names, ["inertia", "coulomb", "viscous"]);
    let page = std::fs::read_to_string(target.join("report.html")).unwrap();
    assert!(page.len() < 3_000_000 && !page.contains("/*DATA*/null"));
    let addresses = page.matches("http").count();
    assert_eq!(
        addresses,
        page.matches("http://www.w3.org/2000/svg").count(),
        "nothing is fetched"
    );
    let twin: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(target.join("twin.json")).unwrap()).unwrap();
    assert_eq!(twin["schema"], "ft-identify/twin/1");
    assert_eq!(
        twin["provenance"]["recordings"][0]["sha256"],
        "0".repeat(64)
    );
    write_to(&target, &found).unwrap();
    assert!(!target.join("report.partial").exists());
}

#[test]
fn a_stamp_that_is_years_off_is_refused_at_once() {
    let mut recording = Scene::door().record();
    let years = -1.5e9;
    recording.wrench[0].at = recording.wrench[0].at.offset_by_seconds(years);
    recording.pose.samples[0].at = recording.pose.samples[0].at.offset_by_seconds(years);
    let error = identify(&recording).map(|_| ()).unwrap_err();
    assert!(
        matches!(error, IdentifyError::Align(AlignError::Gaps { .. })),
        "{error}"
    );
}
