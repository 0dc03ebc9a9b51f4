//! Free air of a Hoi! tree: clocks that drift apart between the grasp and the release, and wrenches that do not follow. Everything here is simulated.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write as _;
use std::path::Path;

use ft_capture::import::hoi::{Drift, HoiReport, import_part, parts};
use ft_recording::{Pose7, Recording, TopicMap};

#[path = "support/shake.rs"]
mod shake;
use shake::{Motion, Setup};

/// When something touches the tool, s after the first wrench.
const TOUCHED_S: core::ops::Range<f64> = 15.0..40.0;

/// A tool in free air before and after it is touched, the wrench at 100 Hz, and poses 5 ms late and `ppm` slow.
fn set_up(seed: u64, ppm: f64) -> Setup {
    Setup {
        offset_s: -0.005,
        skew: 1e-6 * ppm,
        pose_hz: 500.0,
        wrench_hz: 100.0,
        ..Setup::random(
            seed,
            Motion {
                duration_s: 55.0,
                ..Motion::SHAKE
            },
        )
    }
}

fn matrix(pose: &Pose7) -> String {
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| pose.rotate(axis));
    let rows: Vec<String> = (0..3)
        .map(|k| {
            let [a, b, c] = columns.map(|column| column[k]);
            format!("[{a}, {b}, {c}, {}]", pose.position[k])
        })
        .collect();
    format!("[{}, [0, 0, 0, 1]]", rows.join(", "))
}

fn lay(base: &Path, setup: &Setup, touched_until_s: f64) {
    let recording = setup.record();
    let put = |path: String, text: String| {
        let path = base.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    let bag = "extracted/lab/gripper/gripper/lab_1-2_gripper_bag";
    let vrs = "extracted/lab/gripper/aria_gripper/lab_1-2_gripper_vrs";
    let mut wrench = "timestamp,wrench.force.x,wrench.force.y,wrench.force.z,wrench.torque.x,wrench.torque.y,wrench.torque.z\n".to_owned();
    for sample in &recording.wrench {
        let t = sample.at.seconds_since(shake::START);
        let mut value = sample.value;
        if (TOUCHED_S.start..touched_until_s).contains(&t) {
            value[0] += 8.0 + 5.0 * (2.7 * t).sin();
            value[4] += 0.5;
        }
        let values = value.map(|value| format!("{value:.6}")).join(",");
        writeln!(wrench, "{},{values}", sample.at.as_nanos()).unwrap();
    }
    put(
        format!("{bag}/force_torque/ft_sensor0/ft_sensor_readings/wrench/data.csv"),
        wrench,
    );
    let mut poses = "timestamp,tx_world_device,ty_world_device,tz_world_device,qx_world_device,qy_world_device,qz_world_device,\
                     qw_world_device\n"
        .to_owned();
    for sample in &recording.pose.samples {
        let numbers = sample.value.position.iter().chain(&sample.value.quaternion);
        let numbers: Vec<String> = numbers.map(|number| format!("{number:.9}")).collect();
        writeln!(poses, "{},{}", sample.at.as_nanos(), numbers.join(",")).unwrap();
    }
    put(format!("{vrs}/slam/closed_loop_trajectory/data.csv"), poses);
    let identity = matrix(&Pose7::IDENTITY);
    let sensor = matrix(&setup.tcp_from_ft_sensor);
    put(
        format!("{bag}/calib/g-camchain.yaml"),
        format!("cam2:\n  T_cam_imu: {identity}\n"),
    );
    put(
        format!("{bag}/calib/g-imu.yaml"),
        format!("imu0:\n  T_i_tool: {identity}\n  T_i_s: {sensor}\n"),
    );
    put(
        format!("{vrs}/calib/calib.json"),
        format!("{{\"NON_PINHOLE\": {{\"T_device_camera\": {identity}}}}}"),
    );
}

fn imported(setup: &Setup, touched_until_s: f64) -> (HoiReport, Recording) {
    let folder = tempfile::tempdir().unwrap();
    lay(folder.path(), setup, touched_until_s);
    let out = folder.path().join("out.mcap");
    let report = import_part(&parts(folder.path()).unwrap().parts[0], &out, false).unwrap();
    (report, Recording::load(&out, &TopicMap::default()).unwrap())
}

/// Largest error of the poses' stamps, ms.
fn worst_ms(setup: &Setup, recording: &Recording) -> f64 {
    let poses = recording.pose.samples.iter().enumerate();
    let off = poses.map(|(k, pose)| {
        let true_s = k as f64 / setup.pose_hz;
        1e3 * (pose.at.seconds_since(shake::START) - true_s).abs()
    });
    off.fold(0.0, f64::max)
}

#[test]
fn a_drift_that_free_air_at_both_ends_shows_is_taken_out() {
    for (seed, ppm) in [(1, 20.0), (2, -20.0), (3, 60.0), (4, -60.0)] {
        let setup = set_up(seed, ppm);
        let (report, recording) = imported(&setup, TOUCHED_S.end);
        let Some(
            Drift::Taken {
                ppm: found,
                std_ppm,
            }
            | Drift::NotSeen {
                ppm: found,
                std_ppm,
            },
        ) = report.drift
        else {
            panic!("{report}");
        };
        let worst = worst_ms(&setup, &recording);
        println!(
            "simulated: {ppm:+} ppm: found {found:+.1} +-{std_ppm:.1} ppm, stamps off by up to {worst:.3} ms"
        );
        assert!((found - ppm).abs() < 3.0 * std_ppm, "{report}");
        if ppm.abs() > 3.0 * std_ppm {
            assert!(
                matches!(report.drift, Some(Drift::Taken { .. })),
                "{report}"
            );
            assert!(worst < 0.5, "{worst} ms: {report}");
        }
    }
}

#[test]
fn a_drift_that_nothing_shows_is_said_to_be_unknown() {
    let (report, _) = imported(&set_up(1, 20.0), 55.0);
    assert!(
        matches!(report.drift, Some(Drift::Unknown { .. })),
        "{report}"
    );
    assert!(
        report
            .to_string()
            .contains("drift between the clocks is unknown"),
        "{report}"
    );
}

#[test]
fn free_air_that_the_wrench_does_not_follow_is_told() {
    let setup = set_up(1, 0.0);
    let told = |scale: f64| {
        let mut other = setup.clone();
        // The wrench is linear in these.
        other.mass *= scale;
        other.inertia *= scale;
        other.bias = other.bias.map(|bias| scale * bias);
        let (report, _) = imported(&other, TOUCHED_S.end);
        report.to_string()
    };
    assert!(!told(1.0).contains("not weighed"));
    let text = told(-1.0);
    assert!(
        text.contains("not weighed") && text.contains("its sign turned"),
        "{text}"
    );
    let text = told(1000.0);
    assert!(
        text.contains("not weighed") && text.contains("are forces in N?"),
        "{text}"
    );
    // Poses of another time.
    let late = Setup {
        offset_s: -3.0,
        ..setup.clone()
    };
    let (report, _) = imported(&late, TOUCHED_S.end);
    let text = report.to_string();
    assert!(text.contains("follows the poses to only"), "{text}");
}
