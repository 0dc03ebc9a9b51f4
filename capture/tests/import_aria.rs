//! Measured trajectories of Project Aria (its own sample files) are imported; nothing here is simulated but the wrench that
//! they are put beside.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test fails by panicking"
)]

use std::path::{Path, PathBuf};

use ft_capture::config::{Frames, SaidFrames, StaticPose};
use ft_capture::import::aria::{AriaOptions, AriaReport, import_aria};
use ft_capture::import::mps::{Trajectory, TrajectoryKind};
use ft_recording::message::{Header, PoseStamped, TFMessage, TransformStamped, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{MessageStamps, Recording, TopicMap, check};
use ft_wire::HostTime;

/// The measured files; a line that says so when they are not there.
fn measured() -> Option<PathBuf> {
    let root = std::env::var_os("FT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let folder = root.join("aria_mps");
    if folder.is_dir() {
        return Some(folder);
    }
    println!(
        "skipped: no measured data in {} (set FT_DATA)",
        folder.display()
    );
    None
}

/// A still wrench of 30 s from `start` on.
fn wrench_recording(path: &Path, start: HostTime) {
    wrench_on("/ft/wrench", path, start, 30);
}

fn wrench_on(topic: &str, path: &Path, start: HostTime, seconds: i64) {
    let messages = (0..1000 * seconds).map(|k| {
        let at = HostTime::from_nanos(start.as_nanos() + k * 1_000_000);
        let stamps = MessageStamps {
            log_time: at,
            publish_time: at,
        };
        let message = WrenchStamped {
            header: Header::new(at, "ft_sensor"),
            wrench: [0.0, 0.0, -5.0, 0.0, 0.0, 0.0].into(),
        };
        (stamps, message)
    });
    let mut rewrite = Rewrite::new();
    rewrite.add(topic, Qos::SENSOR, messages);
    rewrite.write(None, path, true).unwrap();
}

fn frames() -> Frames {
    Frames {
        aria_device_from_tcp: StaticPose {
            position_m: [0.0, 0.1, -0.2],
            ..StaticPose::default()
        },
        ..Frames::default()
    }
}

/// Imports `mps` beside a wrench that begins at `start`, without alignment.
fn import(mps: &Path, start: HostTime, starts_at_s: Option<f64>) -> (AriaReport, Recording) {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    wrench_recording(&source, start);
    let options = AriaOptions {
        frames: Some(frames().into()),
        starts_at_s,
        align: false,
        ..AriaOptions::default()
    };
    let report = import_aria(&source, mps, &out, &options).unwrap();
    let checked = check::check(&out).unwrap();
    assert!(!checked.lost_data(), "{checked}");
    assert_eq!(checked.topics["/aria/pose"].messages, report.poses);
    (report, Recording::load(&out, &TopicMap::default()).unwrap())
}

#[test]
fn the_closed_loop_staircase_gives_the_map_of_the_open_loop_file() {
    let Some(folder) = measured() else { return };
    let closed = Trajectory::open(&folder.join("closed_loop_trajectory.csv"), 0.0).unwrap();
    let open = Trajectory::open(&folder.join("open_loop_trajectory.csv"), 0.0).unwrap();
    assert_eq!(
        (closed.kind, open.kind),
        (TrajectoryKind::ClosedLoop, TrajectoryKind::OpenLoop)
    );
    assert_eq!((closed.poses.len(), open.poses.len()), (11_517, 11_517));
    let (by_stairs, by_rows) = (closed.utc_map().unwrap(), open.utc_map().unwrap());
    assert!(by_stairs.used < 120, "{by_stairs:?}");
    let apart = closed
        .poses
        .iter()
        .map(|pose| (by_stairs.at(pose.device_ns) - by_rows.at(pose.device_ns)).abs())
        .max()
        .unwrap();
    println!(
        "measured: the two maps are at most {:.4} ms apart",
        1e-6 * apart as f64
    );
    assert!(apart <= 1_000_000, "{apart} ns");
    // The staircase taken at its word is up to 100 ms off.
    let naive = closed
        .poses
        .iter()
        .map(|pose| (pose.utc_ns.unwrap() - by_rows.at(pose.device_ns)).abs())
        .max()
        .unwrap();
    assert!(naive > 90_000_000, "{naive} ns");
}

#[test]
fn both_trajectories_are_imported_at_their_utc() {
    let Some(folder) = measured() else { return };
    let begin = HostTime::from_nanos(1_686_767_222_002_923_694);
    let start = HostTime::from_nanos(begin.as_nanos() - 2_000_000_000);
    for (file, quality) in [
        ("closed_loop_trajectory.csv", 0.5),
        ("open_loop_trajectory.csv", 0.5),
    ] {
        let (report, recording) = import(&folder.join(file), start, None);
        assert_eq!(report.poses, 11_517, "{file}");
        assert_eq!(report.counts.least_quality, quality);
        assert!(
            (report.begins_s - 2.0).abs() < 1e-3,
            "{file}: {}",
            report.begins_s
        );
        assert_eq!(recording.pose.samples.len(), 11_517);
        let first = recording.pose.samples[0].at;
        assert!(
            first.as_nanos().abs_diff(begin.as_nanos()) < 1_000_000,
            "{first}"
        );
        assert_eq!(report.sources.len(), 2);
        assert!(
            report
                .sources
                .iter()
                .all(|source| source.sha256.len() == 64)
        );
    }
}

#[test]
fn the_folder_is_imported_with_the_time_offsets_of_its_inertial_sensors() {
    let Some(folder) = measured() else { return };
    let start = HostTime::from_nanos(1_686_767_222_002_923_694);
    let (report, recording) = import(&folder, start, None);
    assert_eq!(report.kind, TrajectoryKind::ClosedLoop);
    let [least, most] = report.imu_offsets_ms["imu-left gyroscope"];
    assert!(0.3 < least && least <= most && most < 4.5, "{least} {most}");
    let own = report.own_rate.unwrap();
    println!("measured: the trajectory's own angular rate {own}");
    assert!(own.agrees() && own.explained > 0.95, "{own:?}");
    let text = report.to_string();
    assert!(
        text.contains("imu-left gyroscope 0.") && text.contains("are not moved"),
        "{text}"
    );
    assert_eq!(report.gyroscope, None);
    // The path between the pads: the device's, and the 0.22 m arm that turns with it.
    assert_eq!(recording.pose.samples.len(), 11_517);
    let length = |points: &[[f64; 3]]| -> f64 {
        let step = |w: &[[f64; 3]]| {
            (0..3)
                .map(|k| (w[1][k] - w[0][k]).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        points.windows(2).map(step).sum()
    };
    let device = Trajectory::open(&folder.join("closed_loop_trajectory.csv"), 0.0).unwrap();
    let path = length(
        &device
            .poses
            .iter()
            .map(|p| p.pose.position)
            .collect::<Vec<_>>(),
    );
    assert!((path - 7.67).abs() < 0.02, "measured path {path} m");
}

#[test]
fn poses_of_low_quality_are_left_out_when_asked() {
    let Some(folder) = measured() else { return };
    let file = folder.join("closed_loop_trajectory.csv");
    let trajectory = Trajectory::open(&file, 0.9).unwrap();
    assert_eq!(trajectory.counts.low_quality, 101);
    assert_eq!(trajectory.poses.len(), 11_517 - 101);
}

#[test]
fn an_old_file_without_utc_and_with_y_up_is_imported_when_its_start_is_given() {
    let Some(folder) = measured() else { return };
    let file = folder.join("adt_aria_trajectory.csv");
    let start = HostTime::from_nanos(1_700_000_000_000_000_000);
    let scratch = tempfile::tempdir().unwrap();
    let source = scratch.path().join("a.mcap");
    wrench_recording(&source, start);
    let out = scratch.path().join("b.mcap");
    let options = AriaOptions {
        align: false,
        ..AriaOptions::default()
    };
    let message = import_aria(&source, &file, &out, &options)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("no utc") && message.contains("--starts-at"),
        "{message}"
    );
    assert!(!out.exists());

    let trajectory = Trajectory::open(&file, 0.0).unwrap();
    assert!((trajectory.counts.turned_deg - 90.0).abs() < 1e-6);
    let (report, recording) = import(&file, start, Some(1.5));
    assert_eq!(report.poses as usize, trajectory.poses.len());
    assert_eq!(report.counts.without_utc, report.counts.rows);
    assert_eq!(
        recording.pose.samples[0].at.as_nanos(),
        start.as_nanos() + 1_500_000_000
    );
}

#[test]
fn the_geographic_columns_do_no_harm() {
    // 49 rows behind the header.
    let Some(folder) = measured() else { return };
    let file = folder.join("closed_loop_trajectory_geo_available.first50.csv");
    assert_eq!(Trajectory::open(&file, 0.0).unwrap().poses.len(), 49);
}

#[test]
fn a_trajectory_of_another_day_is_not_put_beside_the_wrench() {
    let Some(folder) = measured() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let source = scratch.path().join("a.mcap");
    wrench_recording(&source, HostTime::from_nanos(1_700_000_000_000_000_000));
    let options = AriaOptions {
        frames: Some(frames().into()),
        ..AriaOptions::default()
    };
    let error = import_aria(&source, &folder, &scratch.path().join("b.mcap"), &options);
    let message = error.unwrap_err().to_string();
    assert!(
        message.contains("do not overlap") && message.contains("--starts-at"),
        "{message}"
    );
}

#[test]
fn a_still_wrench_is_not_aligned_with_moving_glasses() {
    let Some(folder) = measured() else { return };
    let scratch = tempfile::tempdir().unwrap();
    let source = scratch.path().join("a.mcap");
    wrench_recording(&source, HostTime::from_nanos(1_686_767_222_002_923_694));
    let options = AriaOptions {
        frames: Some(frames().into()),
        ..AriaOptions::default()
    };
    let error = import_aria(&source, &folder, &scratch.path().join("b.mcap"), &options);
    let message = error.unwrap_err().to_string();
    assert!(
        message.contains("cannot be aligned") && message.contains("--no-align"),
        "{message}"
    );
}

/// A made-up trajectory of 5 s at 100 Hz, one of its columns left out.
fn made_up(without: &str) -> String {
    let columns = [
        "graph_uid",
        "tracking_timestamp_us",
        "utc_timestamp_ns",
        "tx_world_device",
        "ty_world_device",
        "tz_world_device",
        "qx_world_device",
        "qy_world_device",
        "qz_world_device",
        "qw_world_device",
        "quality_score",
    ];
    let row = |k: i64| -> Vec<(&str, String)> {
        let values = [
            "a".to_owned(),
            (7_000_000 + 10_000 * k).to_string(),
            "-1".to_owned(),
            format!("{}", 1e-3 * k as f64),
            "0".to_owned(),
            "0".to_owned(),
            "0".to_owned(),
            "0".to_owned(),
            "0".to_owned(),
            "1".to_owned(),
            if k < 100 { "0.2" } else { "1.0" }.to_owned(),
        ];
        columns.into_iter().zip(values).collect()
    };
    let kept = |row: Vec<(&str, String)>| {
        let kept = row.into_iter().filter(|(name, _)| *name != without);
        kept.map(|(_, value)| value).collect::<Vec<_>>().join(",")
    };
    let header = columns.map(|name| (name, name.to_owned())).to_vec();
    let rows = (0..500).map(|k| kept(row(k)));
    let lines: Vec<String> = std::iter::once(kept(header)).chain(rows).collect();
    lines.join("\r\n")
}

#[test]
fn what_an_mps_folder_lacks_or_has_wrong_is_named() {
    let scratch = tempfile::tempdir().unwrap();
    let (source, out) = (scratch.path().join("a.mcap"), scratch.path().join("b.mcap"));
    wrench_recording(&source, HostTime::from_nanos(1_700_000_000_000_000_000));
    let slam = scratch.path().join("mps/slam");
    std::fs::create_dir_all(&slam).unwrap();
    let options = AriaOptions {
        align: false,
        starts_at_s: Some(1.0),
        overwrite: true,
        ..AriaOptions::default()
    };
    let import =
        |options: &AriaOptions| import_aria(&source, slam.parent().unwrap(), &out, options);
    let refusal = |wanted: &str| {
        let text = import(&options).unwrap_err().to_string();
        assert!(text.contains(wanted), "{text}");
    };
    refusal("neither closed_loop_trajectory.csv nor open_loop_trajectory.csv");
    let file = slam.join("closed_loop_trajectory.csv");
    for (text, wanted) in [
        (String::new(), "closed_loop_trajectory.csv: it is empty"),
        (
            made_up("").lines().take(1).collect(),
            "0 of 0 rows are usable",
        ),
        (made_up("qw_world_device"), "no column qw_world_device"),
        (
            made_up("tracking_timestamp_us"),
            "no column tracking_timestamp_us",
        ),
        (
            made_up("").replace("0.25,0", "what,0"),
            "tx_world_device is \"what\"",
        ),
    ] {
        std::fs::write(&file, text).unwrap();
        refusal(wanted);
    }
    // Columns that say more than where the glasses were may be missing, and what is only reported may be wrong.
    for without in ["quality_score", "graph_uid", "utc_timestamp_ns"] {
        std::fs::write(&file, made_up(without)).unwrap();
        assert_eq!(import(&options).unwrap().poses, 500, "{without}");
    }
    std::fs::write(
        slam.join("online_calibration.jsonl"),
        "{\"ImuCalibrations\": []}\n{oh",
    )
    .unwrap();
    std::fs::write(&file, made_up("")).unwrap();
    let report = import(&options).unwrap();
    assert!(
        report.not_read.as_ref().unwrap().contains("line 2"),
        "{report}"
    );
    assert_eq!((report.poses, report.counts.doubtful), (500, 100));
    assert!(
        report
            .to_string()
            .contains("100 poses of a quality below 0.5 kept"),
        "{report}"
    );
    let strict = AriaOptions {
        min_quality: 0.5,
        ..options.clone()
    };
    let report = import(&strict).unwrap();
    assert_eq!(
        (
            report.poses,
            report.counts.low_quality,
            report.counts.doubtful
        ),
        (400, 100, 0)
    );
}

#[test]
fn glasses_of_which_most_poses_are_left_out_are_data_lost() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name);
    let start = HostTime::from_nanos(1_700_000_000_000_000_000);
    wrench_on("/ft/wrench", &path("a.mcap"), start, 7);
    let text = made_up("");
    let import = |rows: &dyn Fn(usize, &str) -> String| {
        let lines: Vec<String> = text
            .lines()
            .enumerate()
            .map(|(k, line)| rows(k, line))
            .collect();
        std::fs::write(path("closed_loop_trajectory.csv"), lines.join("\n")).unwrap();
        let done = std::process::Command::new(env!("CARGO_BIN_EXE_ft-capture"))
            .args([
                "import-aria",
                "a.mcap",
                "--mps",
                "closed_loop_trajectory.csv",
            ])
            .args(["--no-align", "--starts-at", "1", "-o", "b.mcap", "--force"])
            .current_dir(scratch.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&done.stdout).into_owned();
        (done.status.code(), said)
    };
    // One digit too many in one row of 500, then no rotation in 300 of them.
    let (code, said) =
        import(&|k, line| line.replacen("a,8", if k == 105 { "a,80" } else { "a,8" }, 1));
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("1 rows stamped at another time"), "{said}");
    let no_turn = |k: usize, line: &str| match k {
        0..=200 => line.to_owned(),
        _ => line.replace(",0,0,0,1,", ",0,0,0,0,"),
    };
    let (code, said) = import(&no_turn);
    assert_eq!(code, Some(3), "{said}");
    assert!(said.contains("MORE THAN HALF"), "{said}");
    // Five seconds of poses beside thirty of the wrench.
    wrench_recording(&path("a.mcap"), start);
    let (code, said) = import(&|_, line| line.to_owned());
    assert_eq!(code, Some(3), "{said}");
    assert!(
        said.contains("NO POSES beside the wrenches from 6.0 to 30.0 s"),
        "{said}"
    );
}

#[test]
fn a_wrench_of_another_name_is_taken_by_a_map() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name);
    let start = HostTime::from_nanos(1_700_000_000_000_000_000);
    wrench_on("/their/wrench", &path("theirs.mcap"), start, 30);
    std::fs::write(path("closed_loop_trajectory.csv"), made_up("")).unwrap();
    let map = TopicMap::from_arguments(["/their/wrench=/ft/wrench"]).unwrap();
    let options = AriaOptions {
        align: false,
        starts_at_s: Some(0.5),
        frames: Some(frames().into()),
        map: map.clone(),
        ..AriaOptions::default()
    };
    let trajectory = path("closed_loop_trajectory.csv");
    import_aria(&path("theirs.mcap"), &trajectory, &path("b.mcap"), &options).unwrap();
    assert_eq!(
        Recording::load(&path("b.mcap"), &map).unwrap().wrench.len(),
        30_000
    );
    // `check` reads it by the same map, and says what the map names in vain.
    let plain = check::check(&path("b.mcap")).unwrap();
    assert_eq!(plain.verdict, check::Verdict::Unusable, "{plain}");
    let mapped = check::check_mapped(&path("b.mcap"), &map).unwrap();
    assert_eq!(mapped.topics["/ft/wrench"].messages, 30_000, "{mapped}");
    let vain = TopicMap::from_arguments(["/no/such=/ft/wrench"]).unwrap();
    let text = check::check_mapped(&path("b.mcap"), &vain)
        .unwrap_err()
        .to_string();
    assert!(
        text.contains("/no/such") && text.contains("/their/wrench"),
        "{text}"
    );
}

/// The rows of [`made_up`], each as `change` makes it of its number (0 for the header) and text.
fn made_up_as(change: impl Fn(usize, &str) -> String) -> String {
    let text = made_up("");
    let lines: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(k, line)| change(k, line))
        .collect();
    lines.join("\n")
}

#[test]
fn poses_by_a_clock_that_was_set_back_are_not_mixed_with_the_others() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name);
    let start = HostTime::from_nanos(1_700_000_000_000_000_000);
    wrench_recording(&path("a.mcap"), start);
    let options = AriaOptions {
        align: false,
        starts_at_s: Some(0.5),
        ..AriaOptions::default()
    };
    // From the 300th pose on the glasses' clock is 1.7 s behind.
    let text = made_up_as(|k, line| {
        let stamp = 7_000_000 + 10_000 * (k as i64 - 1);
        match k {
            301.. => line.replacen(&stamp.to_string(), &(stamp - 1_700_000).to_string(), 1),
            _ => line.to_owned(),
        }
    });
    let trajectory = path("closed_loop_trajectory.csv");
    std::fs::write(&trajectory, text).unwrap();
    let report = import_aria(&path("a.mcap"), &trajectory, &path("b.mcap"), &options).unwrap();
    assert_eq!((report.poses, report.counts.set_back), (300, 200));
    assert!(report.lost_data() && !report.to_string().contains("MORE THAN HALF"));
    assert_eq!(report.counts.moved, 0);
    assert!(
        report
            .to_string()
            .contains("200 rows left out by a clock that was set back"),
        "{report}"
    );
    let recording = Recording::load(&path("b.mcap"), &TopicMap::default()).unwrap();
    let x: Vec<f64> = recording
        .pose
        .samples
        .iter()
        .map(|s| s.value.position[0])
        .collect();
    assert!(
        x.windows(2).all(|pair| pair[1] > pair[0]),
        "two times are mixed"
    );
}

#[test]
fn an_open_loop_file_of_another_session_says_nothing_of_utc() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name);
    let start = 1_700_000_000_000_000_000_i64;
    wrench_recording(&path("a.mcap"), HostTime::from_nanos(start));
    let utc = |late_s: i64| {
        move |k: usize, line: &str| {
            let at = start + late_s * 1_000_000_000 + 10_000_000 * k as i64;
            line.replacen(",-1,", &format!(",{at},"), 1)
        }
    };
    let odometry = |text: String| text.replace("_world_device", "_odometry_device");
    let options = AriaOptions {
        align: false,
        overwrite: true,
        ..AriaOptions::default()
    };
    let import = |closed: String, open: String| {
        std::fs::write(path("closed_loop_trajectory.csv"), closed).unwrap();
        std::fs::write(path("open_loop_trajectory.csv"), odometry(open)).unwrap();
        import_aria(&path("a.mcap"), scratch.path(), &path("b.mcap"), &options)
    };
    // Of one session, its utc is taken, be the closed-loop file's there or not.
    for closed in [made_up_as(utc(0)), made_up("")] {
        let report = import(closed, made_up_as(utc(0))).unwrap();
        assert!((report.begins_s - 0.01).abs() < 1e-6, "{report}");
        assert_eq!(report.not_read, None);
    }
    let of_another = |report: &AriaReport, why: &str| {
        let told = report.not_read.clone().unwrap_or_default();
        assert!(
            told.contains("of another session") && told.contains(why),
            "{report}"
        );
        assert!(
            (report.begins_s - 0.01).abs() < 1e-6,
            "{} s: {report}",
            report.begins_s
        );
    };
    // The same stretch of the glasses' clock, another utc; and another stretch.
    let report = import(made_up_as(utc(0)), made_up_as(utc(4))).unwrap();
    of_another(&report, "their utc differs by 4.0 s");
    let later = made_up_as(|k, line| {
        let stamp = 7_000_000 + 10_000 * (k as i64 - 1);
        utc(0)(
            k,
            &line.replacen(&stamp.to_string(), &(stamp + 10_000_000).to_string(), 1),
        )
    });
    let report = import(made_up_as(utc(0)), later).unwrap();
    of_another(&report, "by the glasses' clock it is from");
    // Without utc of its own, no instant of the glasses' clock in common: nothing says when it was.
    let between = made_up_as(|k, line| {
        let stamp = 7_000_000 + 10_000 * (k as i64 - 1);
        utc(0)(
            k,
            &line.replacen(&stamp.to_string(), &(stamp + 3_333).to_string(), 1),
        )
    });
    let text = import(made_up(""), between).unwrap_err().to_string();
    assert!(
        text.contains("no utc in") && text.contains("--starts-at"),
        "{text}"
    );
}

#[test]
fn a_bad_open_loop_file_does_not_stop_a_good_closed_loop_one() {
    let scratch = tempfile::tempdir().unwrap();
    let (source, out) = (scratch.path().join("a.mcap"), scratch.path().join("b.mcap"));
    let start = 1_700_000_000_000_000_000_i64;
    wrench_recording(&source, HostTime::from_nanos(start));
    // The closed-loop file has utc of its own.
    let with_utc: Vec<String> = made_up("")
        .lines()
        .enumerate()
        .map(|(k, line)| line.replacen(",-1,", &format!(",{},", start + 10_000_000 * k as i64), 1))
        .collect();
    let options = AriaOptions {
        align: false,
        overwrite: true,
        ..AriaOptions::default()
    };
    for bad in [
        "",
        "what is this",
        "tracking_timestamp_us,utc_timestamp_ns\n1,2\n",
    ] {
        std::fs::write(
            scratch.path().join("closed_loop_trajectory.csv"),
            with_utc.join("\n"),
        )
        .unwrap();
        std::fs::write(scratch.path().join("open_loop_trajectory.csv"), bad).unwrap();
        let report = import_aria(&source, scratch.path(), &out, &options).unwrap();
        assert_eq!(
            (report.kind, report.poses),
            (TrajectoryKind::ClosedLoop, 500)
        );
        assert!((report.begins_s - 0.01).abs() < 1e-6, "{report}");
        let text = report.to_string();
        assert!(
            text.contains("not read:") && text.contains("open_loop_trajectory.csv"),
            "{text}"
        );
    }
}

#[test]
fn poses_and_transforms_that_the_recording_has_are_told_or_kept() {
    let scratch = tempfile::tempdir().unwrap();
    let path = |name: &str| scratch.path().join(name);
    let start = HostTime::from_nanos(1_700_000_000_000_000_000);
    wrench_recording(&path("wrench.mcap"), start);
    let stamps = MessageStamps {
        log_time: start,
        publish_time: start,
    };
    let transform = |parent: &str, child: &str, x: f64| {
        let mut out = TransformStamped {
            header: Header::new(start, parent),
            child_frame_id: child.to_owned(),
            ..TransformStamped::default()
        };
        out.transform.translation.x = x;
        out.transform.rotation.w = 1.0;
        out
    };
    let transforms = vec![
        transform("base", "camera", 3.0),
        transform("tcp", "ft_sensor", 0.4),
    ];
    let mut rewrite = Rewrite::new();
    rewrite.add(
        ft_recording::topic::TF_STATIC,
        Qos::LATCHED,
        [(stamps, TFMessage { transforms })],
    );
    let poses = (0..7).map(|_| {
        let mut message = PoseStamped {
            header: Header::new(start, "world"),
            ..PoseStamped::default()
        };
        message.pose.orientation.w = 1.0;
        (stamps, message)
    });
    rewrite.add("/tcp/pose", Qos::SENSOR, poses);
    rewrite
        .write(Some(&path("wrench.mcap")), &path("a.mcap"), true)
        .unwrap();
    std::fs::write(path("closed_loop_trajectory.csv"), made_up("")).unwrap();
    let trajectory = path("closed_loop_trajectory.csv");
    let options = AriaOptions {
        align: false,
        starts_at_s: Some(0.5),
        ..AriaOptions::default()
    };
    // Nothing is said of where the tool is: the transforms stay as they are, and no frame is made up.
    let report = import_aria(&path("a.mcap"), &trajectory, &path("b.mcap"), &options).unwrap();
    let text = report.to_string();
    assert!(
        text.contains("the recording's own /tcp/pose (7 poses) is not in the new one"),
        "{text}"
    );
    assert!(
        text.contains("no /tcp/pose: nothing says where the tool is"),
        "{text}"
    );
    let (_, known) = Recording::load_without_pose(&path("b.mcap"), &TopicMap::default()).unwrap();
    assert_eq!(known.aria_device_from_tcp, None);
    assert_eq!(known.tcp_from_ft_sensor.unwrap().position, [0.4, 0.0, 0.0]);
    // With frames, these two are as they say.
    let options = AriaOptions {
        frames: Some(frames().into()),
        ..options
    };
    import_aria(&path("a.mcap"), &trajectory, &path("c.mcap"), &options).unwrap();
    let (_, known) = Recording::load_without_pose(&path("c.mcap"), &TopicMap::default()).unwrap();
    assert_eq!(
        known.aria_device_from_tcp.unwrap().position,
        [0.0, 0.1, -0.2]
    );
    assert_eq!(known.tcp_from_ft_sensor.unwrap().position, [0.0; 3]);
    let report = check::check(&path("c.mcap")).unwrap();
    assert_eq!(report.topics["/tf_static"].messages, 1);
    assert_eq!(report.topics["/tcp/pose"].messages, 500);
    // Of those that are not said, the recording's own are taken.
    let one = SaidFrames {
        tcp_from_ft_sensor: None,
        ..frames().into()
    };
    let options = AriaOptions {
        frames: Some(one),
        ..options
    };
    import_aria(&path("a.mcap"), &trajectory, &path("d.mcap"), &options).unwrap();
    let (_, known) = Recording::load_without_pose(&path("d.mcap"), &TopicMap::default()).unwrap();
    assert_eq!(
        known.aria_device_from_tcp.unwrap().position,
        [0.0, 0.1, -0.2]
    );
    assert_eq!(known.tcp_from_ft_sensor.unwrap().position, [0.4, 0.0, 0.0]);
    // One that nobody says is asked for.
    let error = import_aria(&path("wrench.mcap"), &trajectory, &path("e.mcap"), &options);
    let text = error.unwrap_err().to_string();
    assert!(text.contains("no [frames.tcp_from_ft_sensor]"), "{text}");
}
