//! A measured hand-held recording of others (KTH's instrumented baton: wrench and motion capture at 120 Hz) as a recording of
//! ours: `check` finds that the motion capture repeats poses, and nothing else wrong.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::Path;

use ft_recording::message::{Header, PoseStamped, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{MessageStamps, Recording, TopicMap, check};
use ft_wire::HostTime;

#[path = "support/recordings.rs"]
mod recordings;
use recordings::START;

/// Rows of numbers behind a header.
fn rows(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let numbers = |line: &str| {
        line.split(',')
            .map(|field| field.trim().parse().unwrap())
            .collect()
    };
    text.lines().skip(1).map(numbers).collect()
}

fn at(row: usize) -> MessageStamps {
    let nanos = START.as_nanos() + i64::try_from(row).unwrap() * 1_000_000_000 / 120;
    let at = HostTime::from_nanos(nanos);
    MessageStamps {
        log_time: at,
        publish_time: at,
    }
}

#[test]
fn the_handover_baton_converts_and_its_repeated_poses_are_found() {
    let Some(folder) = recordings::data_directory("kth_handover_baton") else {
        return;
    };
    let wrenches = rows(&folder.join("Wrench_interaction_saved.csv"));
    let poses = rows(&folder.join("baton_pose_saved.csv"));
    assert_eq!((wrenches.len(), poses.len()), (801, 801));
    let repeated = poses.windows(2).filter(|w| w[0] == w[1]).count() as u64;
    let scratch = tempfile::tempdir().unwrap();
    let out = scratch.path().join("baton.mcap");
    let mut rewrite = Rewrite::new();
    rewrite.add(
        "/ft/wrench",
        Qos::SENSOR,
        wrenches.iter().enumerate().map(|(row, values)| {
            let wrench: [f64; 6] = values[..6].try_into().unwrap();
            let message = WrenchStamped {
                header: Header::new(at(row).publish_time, "ft_sensor"),
                wrench: wrench.into(),
            };
            (at(row), message)
        }),
    );
    rewrite.add(
        "/tcp/pose",
        Qos::SENSOR,
        poses.iter().enumerate().map(|(row, values)| {
            let mut message = PoseStamped {
                header: Header::new(at(row).publish_time, "world"),
                ..PoseStamped::default()
            };
            let position: [f64; 3] = values[..3].try_into().unwrap();
            let turn: [f64; 4] = values[3..7].try_into().unwrap();
            message.pose.position = position.into();
            message.pose.orientation = turn.into();
            (at(row), message)
        }),
    );
    rewrite.write(None, &out, false).unwrap();
    let report = check::check(&out).unwrap();
    println!("measured: {report}");
    let pose = &report.topics["/tcp/pose"];
    assert_eq!((pose.messages, pose.repeated_values), (801, repeated));
    let share = 100.0 * repeated as f64 / 800.0;
    assert!((share - 9.5).abs() < 0.2, "{share} %");
    assert!((pose.rate_hz.unwrap() - 120.0).abs() < 0.01);
    assert_eq!((pose.holes, pose.out_of_order, pose.duplicates), (0, 0, 0));
    assert!(report.topics["/ft/wrench"].repeated_values < 10, "{report}");
    assert!(!report.lost_data(), "{report}");
    assert!(report.to_string().contains("same"), "{report}");
    let recording = Recording::load(&out, &TopicMap::default()).unwrap();
    assert_eq!(recording.pose.samples.len(), 801);
}
