//! Poses of glasses whose clock drifts against the wrench's, imported beside a recording with free air at both ends. Everything here is
//! simulated.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write as _;
use std::path::Path;

use ft_capture::calibrate::CalibrateOptions;
use ft_capture::config::{Frames, StaticPose};
use ft_capture::encode::static_transforms;
use ft_capture::import::aria::{AriaOptions, AriaReport, import_aria};
use ft_recording::message::{Header, Text, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{MessageStamps, Recording, TopicMap};
use ft_wire::HostTime;

#[path = "support/shake.rs"]
mod shake;
use shake::{Motion, Setup};

/// When something touches the tool, s after the first wrench.
const GRASP_S: f64 = 15.0;
const RELEASE_S: f64 = 40.0;

/// Poses 1.234 s off and `ppm` slow.
fn set_up(seed: u64, ppm: f64) -> Setup {
    Setup {
        offset_s: 1.234,
        skew: 1e-6 * ppm,
        pose_hz: 500.0,
        wrench_hz: 200.0,
        ..Setup::random(
            seed,
            Motion {
                duration_s: 55.0,
                ..Motion::SHAKE
            },
        )
    }
}

fn stamps(at: HostTime) -> MessageStamps {
    MessageStamps {
        log_time: at,
        publish_time: at,
    }
}

/// The wrench, where the frames stand, and the operator's marks, when there are any.
fn write_wrench(setup: &Setup, recording: &Recording, until_s: f64, marked: bool, path: &Path) {
    let mut rewrite = Rewrite::new();
    let wrenches = recording.wrench.iter().map(|sample| {
        let t = sample.at.seconds_since(shake::START);
        let mut value = sample.value;
        if (GRASP_S..until_s).contains(&t) {
            value[0] += 8.0 + 5.0 * (2.7 * t).sin();
            value[4] += 0.5;
        }
        let message = WrenchStamped {
            header: Header::new(sample.at, "ft_sensor"),
            wrench: value.into(),
        };
        (stamps(sample.at), message)
    });
    rewrite.add("/ft/wrench", Qos::SENSOR, wrenches);
    let frames = Frames {
        tcp_from_ft_sensor: StaticPose {
            position_m: setup.tcp_from_ft_sensor.position,
            quaternion_xyzw: setup.tcp_from_ft_sensor.quaternion,
        },
        ..Frames::default()
    };
    let transforms = static_transforms(&frames, shake::START);
    rewrite.add(
        "/tf_static",
        Qos::LATCHED,
        [(stamps(shake::START), transforms)],
    );
    if marked {
        let marks = [(GRASP_S, "grasp"), (RELEASE_S, "release")].map(|(at_s, data)| {
            let at = shake::START.as_nanos() + (1e9 * at_s) as i64;
            let data = data.to_owned();
            (stamps(HostTime::from_nanos(at)), Text { data })
        });
        rewrite.add("/marks", Qos::RELIABLE, marks);
    }
    rewrite.write(None, path, false).unwrap();
}

/// As MPS writes it, by a clock that began when the glasses did.
fn write_trajectory(recording: &Recording, path: &Path) {
    let mut text = "tracking_timestamp_us,tx_world_device,ty_world_device,tz_world_device,qx_world_device,qy_world_device,qz_world_device,\
                    qw_world_device\n"
        .to_owned();
    for sample in &recording.pose.samples {
        let us = 50_000_000.0 + 1e6 * sample.at.seconds_since(shake::START);
        let numbers = sample.value.position.iter().chain(&sample.value.quaternion);
        let numbers: Vec<String> = numbers.map(|number| format!("{number:.9}")).collect();
        writeln!(text, "{us:.0},{}", numbers.join(",")).unwrap();
    }
    std::fs::write(path, text).unwrap();
}

/// What was imported, and the largest error of its poses' stamps, ms.
fn imported(setup: &Setup, until_s: f64, marked: bool) -> (AriaReport, f64) {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let recording = setup.record();
    write_wrench(setup, &recording, until_s, marked, &path("wrench.mcap"));
    write_trajectory(&recording, &path("closed_loop_trajectory.csv"));
    let options = AriaOptions {
        // The true begin is 0 s.
        starts_at_s: Some(0.4),
        calibrate: CalibrateOptions {
            free_air: (!marked).then_some((0.0, GRASP_S)),
            search_s: 3.0,
            ..CalibrateOptions::default()
        },
        ..AriaOptions::default()
    };
    let out = path("out.mcap");
    let trajectory = path("closed_loop_trajectory.csv");
    let report = import_aria(&path("wrench.mcap"), &trajectory, &out, &options).unwrap();
    let written = Recording::load(&out, &TopicMap::default()).unwrap();
    let poses = written.pose.samples.iter().enumerate();
    let off = poses.map(|(k, pose)| {
        let true_s = k as f64 / setup.pose_hz;
        1e3 * (pose.at.seconds_since(shake::START) - true_s).abs()
    });
    (report, off.fold(0.0, f64::max))
}

#[test]
fn a_drift_that_free_air_at_both_ends_shows_is_taken_out() {
    for (seed, ppm, marked) in [
        (1, 60.0, false),
        (2, -60.0, true),
        (3, 20.0, false),
        (4, -20.0, true),
    ] {
        let setup = set_up(seed, ppm);
        let (report, worst_ms) = imported(&setup, RELEASE_S, marked);
        let text = report.to_string();
        println!("simulated: {ppm:+} ppm: stamps off by up to {worst_ms:.3} ms\n{text}");
        assert!(
            text.contains("by the free air, and that is taken out"),
            "{text}"
        );
        let [found, std] = report.alignment.unwrap().skew_ppm.unwrap();
        assert!((found - ppm).abs() < 3.0 * std, "{text}");
        // 60 ppm are 3.3 ms over the recording, 20 ppm 1.1 ms.
        assert!(worst_ms < 0.3, "{worst_ms} ms: {text}");
    }
}

#[test]
fn a_drift_that_nothing_shows_is_said_to_be_unknown() {
    let (report, _) = imported(&set_up(1, 20.0), 55.0, false);
    let text = report.to_string();
    assert!(
        text.contains("the drift between the clocks is unknown"),
        "{text}"
    );
    assert_eq!(report.alignment.unwrap().skew_ppm, None);
}
