//! The check looks at the numbers too: what is no number, no rotation, or no time is not fine.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use ft_recording::Message;
use ft_recording::check::{Report, Verdict, check};
use ft_recording::message::{DiagnosticArray, KeyValue, PoseStamped, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::writer::{MessageStamps, RecordingWriter, WriterOptions};
use ft_wire::HostTime;

#[path = "support/recordings.rs"]
mod recordings;

use recordings::{Numbers, at, diagnostics, pose, wrench};

/// What is said of a recording of wrench and poses at 1 kHz, each as `change` makes it of its number and of what is right.
fn judged(
    samples: i64,
    mut change: impl FnMut(i64, &mut WrenchStamped, &mut PoseStamped),
) -> Report {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let mut writer = RecordingWriter::create(&path, &WriterOptions::default()).unwrap();
    let [to_wrench, to_pose, to_diagnostics] = [
        writer.add_channel::<WrenchStamped>("/ft/wrench", Qos::SENSOR),
        writer.add_channel::<PoseStamped>("/tcp/pose", Qos::SENSOR),
        writer.add_channel::<DiagnosticArray>("/diagnostics", Qos::RELIABLE),
    ]
    .map(Result::unwrap);
    let (mut numbers, mut bytes) = (Numbers(3), Vec::new());
    for sample in 0..samples {
        let (mut wrench, mut pose) = (wrench(sample, &mut numbers), pose(sample, &mut numbers));
        change(sample, &mut wrench, &mut pose);
        let stamps = |publish_time| MessageStamps {
            log_time: at(sample),
            publish_time,
        };
        wrench.encode(&mut bytes);
        let stamp = HostTime::from(wrench.header.stamp);
        writer.write(to_wrench, stamps(stamp), &bytes).unwrap();
        pose.encode(&mut bytes);
        let stamp = HostTime::from(pose.header.stamp);
        writer.write(to_pose, stamps(stamp), &bytes).unwrap();
        if sample % 1000 == 0 {
            let mut array = diagnostics(sample);
            for (key, value) in [("clock_skew_ppm", "1.0"), ("clock_spread_ns", "58900")] {
                let (key, value) = (key.to_owned(), value.to_owned());
                array.status[0].values.push(KeyValue { key, value });
            }
            array.encode(&mut bytes);
            writer
                .write(to_diagnostics, stamps(at(sample)), &bytes)
                .unwrap();
        }
    }
    writer.finish().unwrap();
    check(&path).unwrap()
}

#[test]
fn numbers_that_are_none_are_counted_and_no_verdict_is_fine() {
    let right = judged(100, |_, _, _| {});
    assert_eq!((right.verdict, right.reasons), (Verdict::Fine, Vec::new()));
    let report = judged(100, |sample, wrench, pose| {
        match sample {
            10 => wrench.wrench.force.x = f64::NAN,
            11 | 12 => wrench.wrench.torque.z = f64::NEG_INFINITY,
            20 => pose.pose.position.y = f64::INFINITY,
            21 => pose.pose.orientation = [0.0; 4].into(),
            22 => pose.pose.orientation = [0.0, 0.0, 0.0, 1.002].into(),
            // Three digits.
            23 => pose.pose.orientation = [0.0, 0.0, 0.707, 0.707].into(),
            _ => {}
        }
    });
    assert_eq!(report.verdict, Verdict::Lossy);
    assert_eq!(
        report.reasons,
        [
            "/ft/wrench: 3 messages with numbers that are not finite",
            "/tcp/pose: 2 messages with numbers that are not finite or a quaternion that is no rotation",
            "/tcp/pose: 1 messages with a quaternion whose length is not 1",
        ]
    );
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["topics"]["/ft/wrench"]["invalid"], 3);
    assert_eq!(json["topics"]["/tcp/pose"]["invalid"], 2);
    assert_eq!(json["topics"]["/tcp/pose"]["not_unit"], 1);
}

#[test]
fn a_recording_without_any_number_is_of_no_use() {
    let report = judged(100, |_, wrench, _| wrench.wrench.force.z = f64::NAN);
    assert_eq!(report.verdict, Verdict::Unusable);
    let expected = "none of the 100 messages of /ft/wrench can be used";
    assert_eq!(report.reasons[0], expected);
    let report = judged(100, |_, _, pose| {
        pose.pose.orientation = [0.0; 4].into();
    });
    assert_eq!(report.verdict, Verdict::Unusable);
    assert_eq!(report.reasons[0], "neither /tcp/pose nor /aria/pose");
}

#[test]
fn one_instant_is_not_fine() {
    let report = judged(100, |_, wrench, _| wrench.header.stamp = at(0).into());
    assert_eq!(report.verdict, Verdict::Unusable);
    let expected = "all 100 messages of /ft/wrench have the same stamp";
    assert_eq!(report.reasons[0], expected);
    let report = judged(1, |_, _, _| {});
    assert_eq!(report.verdict, Verdict::Unusable);
    assert_eq!(report.reasons[0], "/ft/wrench has one message only");
    assert_eq!(report.reasons[1], "/tcp/pose has one message only");
}

#[test]
fn poses_that_come_again_under_new_stamps_are_said_in_the_verdict() {
    let with_repeats = |every: i64| {
        let mut before = None;
        judged(1_000, |sample, _, pose| {
            if sample % every == every - 1 {
                pose.pose = before.unwrap();
            }
            before = Some(pose.pose);
        })
    };
    let report = with_repeats(10);
    let said = "/tcp/pose: 100 of 1000 messages only repeat the one before under a new stamp";
    assert_eq!(
        (report.verdict, &report.reasons[..]),
        (Verdict::Fine, &[said.to_owned()][..])
    );
    let text = report.to_string();
    assert!(text.ends_with(&format!("missing, but {said}")), "{text}");
    // Some may be chance.
    assert!(with_repeats(200).reasons.is_empty());
}

#[test]
fn what_nothing_is_known_of_after_ten_seconds_is_not_said() {
    let clock = "clock of ft_sensor: skew +1.0 ppm, stamps known to 58.9 us";
    let said = |samples| {
        let text = judged(samples, |_, _, _| {}).to_string();
        let mut lines = text.lines().map(str::trim);
        let line = lines.find(|line| line.starts_with("clock"));
        line.unwrap().to_owned()
    };
    assert_eq!(said(1001), clock);
    assert_eq!(
        said(10_001),
        format!("{clock} (at worst 58.9 us after 10 s)")
    );
}

/// A tracker that delivers when it has something: its stamps are moved as `stamp_ms` makes them of their number.
fn tracked(stamp_ms: &mut dyn FnMut(i64) -> f64) -> Report {
    judged(3_000, |sample, _, pose| {
        let at_ns = at(0).as_nanos() + (1e6 * stamp_ms(sample)).round() as i64;
        pose.header.stamp = HostTime::from_nanos(at_ns).into();
    })
}

#[test]
fn jitter_is_no_hole_and_a_hole_in_a_jittery_stream_is_one() {
    let mut state = 9_u64;
    // Intervals by chance, 1 ms in the mean: 0.02 to 8 ms.
    let mut interval = move || {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        let part = ((state >> 11) as f64 + 1.0) / (1_u64 << 53) as f64;
        -part.ln().max(-8.0)
    };
    let stamps: Vec<f64> = (0..3_000)
        .scan(0.0, |at, _| {
            *at += interval();
            Some(*at)
        })
        .collect();
    let report = tracked(&mut |sample| stamps[sample as usize]);
    let pose = &report.topics["/tcp/pose"];
    assert_eq!(pose.holes, 0, "{report}");
    assert!((pose.coverage.unwrap() - 1.0).abs() < 1e-9, "{report}");
    // Two pauses of 60 ms.
    let report = tracked(&mut |sample| {
        let pauses = [1_000, 2_000]
            .iter()
            .filter(|from| sample >= **from)
            .count();
        stamps[sample as usize] + 60.0 * pauses as f64
    });
    assert_eq!(report.topics["/tcp/pose"].holes, 2, "{report}");
    // In an even stream a hole of four periods is one, however many there are.
    let report = tracked(&mut |sample| (sample + 3 * (sample / 5)) as f64);
    assert_eq!(report.topics["/tcp/pose"].holes, 599, "{report}");
}
