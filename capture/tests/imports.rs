//! Trees of the Hoi! dataset's layout and ROS 1 bags as people may have them: zipped at any level, incomplete, in other units, large.
//! Everything is made up here; the layout is written from its description, not by the importer's code.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeMap;
use std::io::{Seek as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use ft_capture::import::hoi::{HoiPart, HoiReport, import_part, parts};
use ft_recording::{Recording, TopicMap};

const EPOCH_NS: i64 = 1_716_200_000_000_000_000;

/// Files of a tree by their paths.
type Files = BTreeMap<String, Vec<u8>>;

/// How a tree is written.
#[derive(Clone, Copy)]
struct Style {
    seconds: i64,
    /// Metres to the unit of positions.
    scale: f64,
    /// The sensor is so far from its inertial unit, m.
    sensor_z: f64,
    /// The gyroscope is stamped so much too late.
    gyro_late_ms: i64,
}

const PLAIN: Style = Style {
    seconds: 12,
    scale: 1.0,
    sensor_z: 0.05,
    gyro_late_ms: 0,
};

fn angle(t: f64) -> f64 {
    0.4 * ((3.1 * t).sin() + 0.7 * (7.3 * t).cos())
}

fn matrix(z: f64) -> String {
    format!("[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, {z}], [0, 0, 0, 1]]")
}

/// One recording's files: wrench, temperature and gyroscope at 100 Hz, poses at 200 Hz, calibration.
fn recording(location: &str, span: &str, style: Style) -> Files {
    let base = format!("extracted/{location}/gripper");
    let bag = format!("{base}/gripper/{location}_{span}_gripper_bag");
    let vrs = format!("{base}/aria_gripper/{location}_{span}_gripper_vrs");
    let sensor = format!("{bag}/force_torque/ft_sensor0/ft_sensor_readings");
    let mut wrench = "timestamp,wrench.force.x,wrench.force.y,wrench.force.z,wrench.torque.x,wrench.torque.y,wrench.torque.z\n".to_owned();
    let mut temperature = "timestamp,temperature,variance\n".to_owned();
    let mut gyro =
        "timestamp,angular_velocity.x,angular_velocity.y,angular_velocity.z\n".to_owned();
    for k in 0..style.seconds * 100 {
        let (at, t) = (EPOCH_NS + k * 10_000_000, 0.01 * k as f64);
        let force = [3.0 * t.sin(), 1.0, -4.0 + t.cos()];
        let [x, y, z] = force;
        wrench += &format!(
            "{at},{x:.6},{y:.6},{z:.6},{:.6},{:.6},0.01\n",
            0.06 * y,
            -0.06 * x
        );
        temperature += &format!("{at},31.5,0\n");
        let rate = 0.4 * (3.1 * (3.1 * t).cos() - 5.11 * (7.3 * t).sin());
        gyro += &format!(
            "{},{:.6},0,{:.6}\n",
            at + style.gyro_late_ms * 1_000_000,
            0.6 * rate,
            0.8 * rate
        );
    }
    let mut poses = "graph_uid,timestamp,utc_timestamp_ns,tx_world_device,ty_world_device,tz_world_device,qx_world_device,qy_world_device,\
                     qz_world_device,qw_world_device,gravity_x_world,gravity_y_world,gravity_z_world,quality_score\n"
        .to_owned();
    for k in 0..style.seconds * 200 {
        let (at, t) = (EPOCH_NS + k * 5_000_000, 0.005 * k as f64);
        let (sin, cos) = (0.5 * angle(t)).sin_cos();
        let x = style.scale * 0.2 * (0.4 * t).sin();
        poses += &format!(
            "a,{at},-1,{x:.9},0,{:.9},0,0,{sin:.9},{cos:.9},0,0,-9.81,1\n",
            style.scale
        );
    }
    let chain: String = (0..3)
        .map(|k| format!("cam{k}:\n  T_cam_imu: {}\n", matrix(0.01 * f64::from(k))))
        .collect();
    let imu = format!(
        "imu0:\n  T_i_tool: {}\n  T_i_s: {}\n",
        matrix(0.1),
        matrix(style.sensor_z)
    );
    let device = format!(
        "{{\"NON_PINHOLE\": {{\"T_device_camera\": {}}}}}",
        matrix(0.02)
    );
    let files = [
        (format!("{sensor}/wrench/data.csv"), wrench),
        (format!("{sensor}/temperature/data.csv"), temperature),
        (format!("{sensor}/imu/data.csv"), gyro),
        (format!("{vrs}/slam/closed_loop_trajectory/data.csv"), poses),
        (format!("{bag}/calib/g-camchain.yaml"), chain),
        (format!("{bag}/calib/g-imu.yaml"), imu),
        (format!("{vrs}/calib/calib.json"), device),
        (format!("{bag}/images/0001.png"), "not a picture".to_owned()),
    ];
    files
        .into_iter()
        .map(|(path, text)| (path, text.into_bytes()))
        .collect()
}

/// Puts what is below `folder` into `folder.zip`, the entries' paths below it or with its own name before.
fn zip_up(files: &mut Files, folder: &str, with_name: bool) {
    let inside = format!("{folder}/");
    let names: Vec<String> = files
        .keys()
        .filter(|name| name.starts_with(&inside))
        .cloned()
        .collect();
    assert!(!names.is_empty(), "{folder}");
    let own = folder.rsplit('/').next().unwrap();
    let mut entries = Vec::new();
    for name in names {
        let data = files.remove(&name).unwrap();
        let below = &name[inside.len()..];
        let entry = if with_name {
            format!("{own}/{below}")
        } else {
            below.to_owned()
        };
        entries.push((entry, data));
    }
    files.insert(format!("{folder}.zip"), zipped(&entries));
}

/// A zip of stored entries, by PKWARE's APPNOTE.TXT.
fn zipped(entries: &[(String, Vec<u8>)]) -> Vec<u8> {
    let word = |n: usize| u32::try_from(n).unwrap().to_le_bytes();
    let (mut zip, mut directory) = (Vec::new(), Vec::new());
    for (name, data) in entries {
        let at = word(zip.len());
        let sizes = [
            crc32(data).to_le_bytes(),
            word(data.len()),
            word(data.len()),
        ]
        .concat();
        let length = &word(name.len())[..2];
        let about = [
            &[20, 0, 0, 0, 0, 0, 0, 0, 0, 0][..],
            &sizes,
            length,
            &[0, 0],
        ]
        .concat();
        zip.extend([b"PK\x03\x04", &about[..], name.as_bytes(), data].concat());
        directory.extend(
            [
                b"PK\x01\x02\x14\0",
                &about[..],
                &[0; 10],
                &at,
                name.as_bytes(),
            ]
            .concat(),
        );
    }
    let count = &word(entries.len())[..2];
    let end = [
        count,
        count,
        &word(directory.len()),
        &word(zip.len()),
        &[0, 0],
    ]
    .concat();
    [zip, directory, b"PK\x05\x06\0\0\0\0".to_vec(), end].concat()
}

/// Bit by bit, as the polynomial is written.
fn crc32(data: &[u8]) -> u32 {
    let step = |crc: u32| crc >> 1 ^ if crc & 1 == 1 { 0xedb8_8320 } else { 0 };
    let byte = |crc: u32, byte: &u8| (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc));
    !data.iter().fold(!0, byte)
}

/// Writes the files below a folder.
fn lay(files: &Files, base: &Path) {
    for (name, data) in files {
        let path = base.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_sparse(&mut std::fs::File::create(path).unwrap(), data);
    }
}

/// Appends data, what is zero in it as a hole: large files of a test then take no room on the disk.
fn write_sparse(file: &mut std::fs::File, data: &[u8]) {
    for block in data.chunks(4096) {
        if block.iter().all(|byte| *byte == 0) {
            let length = i64::try_from(block.len()).unwrap();
            file.seek_relative(length).unwrap();
        } else {
            file.write_all(block).unwrap();
        }
    }
    let end = file.stream_position().unwrap();
    file.set_len(end).unwrap();
}

fn import(base: &Path, part: &HoiPart) -> (HoiReport, Recording) {
    let out = base.join("out.mcap");
    let report =
        import_part(part, &out, true).unwrap_or_else(|error| panic!("{}: {error}", part.name));
    (report, Recording::load(&out, &TopicMap::default()).unwrap())
}

/// The one recording of a tree of these files.
fn imported(files: &Files) -> (HoiReport, Recording) {
    let folder = tempfile::tempdir().unwrap();
    lay(files, folder.path());
    let found = parts(folder.path()).unwrap();
    assert_eq!((found.parts.len(), found.unreadable.len()), (1, 0));
    import(folder.path(), &found.parts[0])
}

#[test]
fn a_tree_that_is_zipped_at_any_level_is_the_same_recordings() {
    let two = || {
        let other = Style {
            sensor_z: 0.08,
            ..PLAIN
        };
        let mut files = recording("kitchen", "1-3", PLAIN);
        files.extend(recording("kitchen", "4-4", other));
        files
    };
    let base = "extracted/kitchen/gripper";
    let [bag, calib] =
        ["", "/calib"].map(|below| format!("{base}/gripper/kitchen_1-3_gripper_bag{below}"));
    let (gripper, glasses) = (format!("{base}/gripper"), format!("{base}/aria_gripper"));
    let mut whole: Option<Vec<(HoiReport, Recording)>> = None;
    for (level, zips) in [
        vec![],
        vec![gripper.as_str()],
        vec![&calib, &gripper, &glasses],
        vec![&bag, &gripper, &glasses],
        vec![base],
        vec![&bag, &gripper, base],
        vec!["extracted/kitchen"],
        vec![&calib, &bag, &gripper, "extracted"],
    ]
    .into_iter()
    .enumerate()
    {
        for with_name in [false, true] {
            let mut files = two();
            for folder in &zips {
                zip_up(&mut files, folder, with_name);
            }
            let folder = tempfile::tempdir().unwrap();
            lay(&files, folder.path());
            let found = parts(folder.path()).unwrap();
            let names: Vec<_> = found.parts.iter().map(|part| part.name.as_str()).collect();
            assert_eq!(names, ["kitchen_1-3", "kitchen_4-4"], "{level} {with_name}");
            let read: Vec<_> = found
                .parts
                .iter()
                .map(|part| import(folder.path(), part))
                .collect();
            let known = whole.get_or_insert_with(|| read.clone());
            for ((report, recording), (plain, of_plain)) in read.iter().zip(known) {
                assert_eq!(report.missing, plain.missing, "{level} {with_name}");
                assert_eq!(recording.wrench, of_plain.wrench);
                assert_eq!(recording.pose, of_plain.pose);
                assert_eq!(recording.tcp_from_ft_sensor, of_plain.tcp_from_ft_sensor);
            }
            // Each has its own calibration, not the other's.
            let sensor = |k: usize| read[k].1.tcp_from_ft_sensor.position[2];
            assert!((sensor(0) + 0.05).abs() < 1e-9 && (sensor(1) + 0.02).abs() < 1e-9);
        }
    }
}

#[test]
fn what_other_systems_put_beside_the_files_and_links_in_a_circle_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = recording("kitchen", "1-3", PLAIN);
    let base = "extracted/kitchen/gripper";
    let bag = format!("{base}/gripper/kitchen_1-3_gripper_bag");
    for beside in [
        format!("{bag}/calib/._g-imu.yaml"),
        format!("{bag}/calib/._g-camchain.yaml"),
        format!("{base}/gripper/._kitchen_1-3_gripper_bag"),
        format!("{base}/gripper/._kitchen_4-4_gripper_bag.zip"),
        format!("{base}/gripper/kitchen_5-5_gripper_bag.zip.part"),
        "extracted/.DS_Store".to_owned(),
        "extracted/kitchen/hand/kitchen_1-3_hand/data.csv".to_owned(),
    ] {
        files.insert(beside, b"\0\x05\x16\x07not what it is called".to_vec());
    }
    lay(&files, folder.path());
    std::os::unix::fs::symlink("..", folder.path().join("extracted/back")).unwrap();
    let found = parts(folder.path()).unwrap();
    let names: Vec<_> = found.parts.iter().map(|part| part.name.as_str()).collect();
    assert_eq!((names, found.unreadable.len()), (vec!["kitchen_1-3"], 0));
    let (plain, of_plain) = import(folder.path(), &found.parts[0]);
    // The same within an archive.
    zip_up(&mut files, &format!("{bag}/calib"), false);
    zip_up(&mut files, base, true);
    let folder = tempfile::tempdir().unwrap();
    lay(&files, folder.path());
    let found = parts(folder.path()).unwrap();
    assert_eq!(found.parts.len(), 1, "{found:?}");
    let (report, recording) = import(folder.path(), &found.parts[0]);
    assert_eq!(report.missing, plain.missing);
    assert_eq!(recording.tcp_from_ft_sensor, of_plain.tcp_from_ft_sensor);
    assert_eq!(recording.angular_rate.len(), 1_200);
}

#[test]
fn wrenches_stamped_in_other_units_are_refused_with_the_right_one() {
    for (unit_ns, digits) in [(1e9, 9), (1e6, 6), (1e3, 3)] {
        let mut files = recording("kitchen", "1-3", PLAIN);
        let (_, data) = files
            .iter_mut()
            .find(|(name, _)| name.ends_with("wrench/data.csv"))
            .unwrap();
        let text = String::from_utf8(data.clone()).unwrap();
        let restamped = text
            .lines()
            .enumerate()
            .map(|(row, line)| match line.split_once(',') {
                Some((stamp, rest)) if row > 0 => {
                    format!(
                        "{:.digits$},{rest}",
                        stamp.parse::<f64>().unwrap() / unit_ns
                    )
                }
                _ => line.to_owned(),
            });
        *data = restamped.collect::<Vec<_>>().join("\n").into_bytes();
        let folder = tempfile::tempdir().unwrap();
        lay(&files, folder.path());
        let found = parts(folder.path()).unwrap();
        let error = import_part(&found.parts[0], &folder.path().join("out.mcap"), true);
        let text = error.unwrap_err().to_string();
        assert!(
            text.contains("wrench/data.csv") && text.contains("must be in ns"),
            "{unit_ns}: {text}"
        );
    }
}

#[test]
fn a_stamp_of_1970_a_row_cut_short_and_a_jaw_that_is_not_read_are_told() {
    let mut files = recording("bath", "2-3", PLAIN);
    let (name, data) = files
        .iter_mut()
        .find(|(name, _)| name.ends_with("wrench/data.csv"))
        .unwrap();
    let text = String::from_utf8(data.clone()).unwrap();
    let mut lines: Vec<_> = text.lines().map(str::to_owned).collect();
    for (row, stamp) in [(7, 0), (9, EPOCH_NS + 86_400_000_000_000)] {
        let (_, rest) = lines[row].split_once(',').unwrap();
        lines[row] = format!("{stamp},{rest}");
    }
    *data = (lines.join("\n") + &format!("\n{EPOCH_NS},1.0")).into_bytes();
    let (bag, _) = name.split_once("/force_torque").unwrap();
    let jaw = format!("{bag}/dynamixel_workbench/joint_states/data.csv");
    files.insert(jaw, b"timestamp,position\n".to_vec());
    let (report, recording) = imported(&files);
    let text = report.to_string();
    assert_eq!((report.left_out, report.samples[0]), (3, 1_198), "{text}");
    assert!(text.contains("or at another time"), "{text}");
    let (first, last) = (&recording.wrench[0], &recording.wrench[1_197]);
    assert_eq!(first.at.as_nanos(), EPOCH_NS);
    assert!(last.at.seconds_since(first.at) < 13.0);
    assert!(
        text.contains("not used: dynamixel_workbench/joint_states"),
        "{text}"
    );
    assert!(!text.contains("no jaw width"), "{text}");
}

#[test]
fn rows_that_say_nothing_are_left_out_one_by_one_and_told() {
    let mut files = recording("bath", "2-2", PLAIN);
    let mut edit = |end: &str, change: &dyn Fn(&mut Vec<String>)| {
        let (_, data) = files
            .iter_mut()
            .find(|(name, _)| name.ends_with(end))
            .unwrap();
        let text = String::from_utf8(data.clone()).unwrap();
        let mut lines: Vec<_> = text.lines().map(str::to_owned).collect();
        change(&mut lines);
        *data = (lines.join("\r\n") + "\r\n").into_bytes();
    };
    edit("wrench/data.csv", &|lines| {
        for (row, force) in [(5, ""), (17, "nan"), (29, "null"), (31, "inf")] {
            let fields: Vec<_> = lines[row].split(',').map(str::to_owned).collect();
            lines[row] = [&fields[..1], &[force.to_owned()], &fields[2..]]
                .concat()
                .join(",");
        }
        for (row, stamp) in [(41, ""), (43, "nan"), (47, "9.2e18"), (53, "-5")] {
            let (_, rest) = lines[row].split_once(',').unwrap();
            lines[row] = format!("{stamp},{rest}");
        }
        // Once more, and out of order.
        lines.push(lines[60].clone());
        lines.swap(100, 700);
    });
    edit("closed_loop_trajectory/data.csv", &|lines| {
        lines[7] = lines[7].replace("a,", "b,");
        let mut fields: Vec<_> = lines[9].split(',').collect();
        fields[9] = "";
        lines[9] = fields.join(",");
        lines[11] = lines[11].replacen(&lines[11].split(',').nth(1).unwrap().to_owned(), "NaN", 1);
        lines.insert(20, lines[19].clone());
    });
    edit("temperature/data.csv", &|lines| {
        lines[3] = format!("{},nan,0", EPOCH_NS + 20_000_000);
        lines[4] = format!("{},,0", EPOCH_NS + 30_000_000);
        lines.swap(10, 300);
    });
    let (report, recording) = imported(&files);
    let text = report.to_string();
    assert_eq!(
        (report.left_out, report.samples[0]),
        (9, 1_200 - 8),
        "{text}"
    );
    assert!(text.contains("9 wrenches left out"), "{text}");
    for wanted in [
        "1 poses left out: of other worlds",
        "1 poses left out: not later than the one before",
        "1 poses left out: without a stamp",
        "1 poses left out: without a rotation, or with an empty field",
    ] {
        assert!(text.contains(wanted), "{wanted}: {text}");
    }
    assert_eq!(report.counts.rows, 2_401);
    assert_eq!(recording.wrench.len(), 1_192);
    // The temperature is sorted, and has no hole that says a number.
    assert_eq!(recording.temperature.len(), 1_198);
    assert!(
        recording
            .temperature
            .windows(2)
            .all(|pair| pair[0].at < pair[1].at)
    );
    assert!(
        recording
            .temperature
            .iter()
            .all(|sample| sample.value.is_finite())
    );
}

/// Changes the rows of the trajectory, without the header.
fn with_trajectory(files: &Files, change: impl FnOnce(&mut Vec<String>)) -> Files {
    let mut files = files.clone();
    let (_, data) = files
        .iter_mut()
        .find(|(name, _)| name.ends_with("closed_loop_trajectory/data.csv"))
        .unwrap();
    let text = String::from_utf8(data.clone()).unwrap();
    let mut lines: Vec<_> = text.lines().map(str::to_owned).collect();
    let header = lines.remove(0);
    change(&mut lines);
    *data = format!("{header}\n{}\n", lines.join("\n")).into_bytes();
    files
}

#[test]
fn a_wrong_stamp_or_another_order_does_not_cost_the_rest_of_a_trajectory() {
    let files = recording("bath", "2-4", PLAIN);
    let (_, whole) = imported(&files);
    let stamp = |k: i64| (EPOCH_NS + k * 5_000_000).to_string();
    // 10 min ahead, and one digit too many.
    for (wrong, told) in [
        (
            stamp(100 + 120_000),
            "1 poses left out: stamped at another time",
        ),
        (stamp(100) + "0", "1 poses left out: without a stamp"),
    ] {
        let files = with_trajectory(&files, |rows| {
            rows[100] = rows[100].replacen(&stamp(100), &wrong, 1);
        });
        let (report, recording) = imported(&files);
        assert!(report.to_string().contains(told), "{report}");
        assert_eq!(recording.pose.samples.len(), 2_399);
    }
    let shuffled = with_trajectory(&files, |rows| {
        let mut state = 5;
        for k in (1..rows.len()).rev() {
            rows.swap(k, random(&mut state) as usize % (k + 1));
        }
    });
    let (report, recording) = imported(&shuffled);
    assert!(
        report.to_string().contains("poses put in order"),
        "{report}"
    );
    assert!(!report.lost_data());
    assert_eq!(recording.pose, whole.pose);
}

#[test]
fn rows_by_a_clock_that_was_set_back_are_left_out_and_told() {
    let files = recording("bath", "2-6", PLAIN);
    let back = |row: &String, ns: i64| {
        let at = row.split(',').position(|field| field.len() == 19).unwrap();
        let mut fields: Vec<String> = row.split(',').map(str::to_owned).collect();
        fields[at] = (fields[at].parse::<i64>().unwrap() - ns).to_string();
        fields.join(",")
    };
    let poses = with_trajectory(&files, |rows| {
        for row in &mut rows[1_500..] {
            *row = back(row, 2_500_000_000);
        }
    });
    let (report, recording) = imported(&poses);
    assert!(
        report
            .to_string()
            .contains("900 poses left out: by a clock that was set back"),
        "{report}"
    );
    assert_eq!(recording.pose.samples.len(), 1_500);
    assert!(report.lost_data() && !report.to_string().contains("MORE THAN HALF"));
    // The wrench, of which the later part is the longer.
    let mut wrenches = files;
    let (_, data) = wrenches
        .iter_mut()
        .find(|(path, _)| path.ends_with("wrench/data.csv"))
        .unwrap();
    let text = String::from_utf8(data.clone()).unwrap();
    let rows = text.lines().enumerate().map(|(k, row)| match k {
        501.. => back(&row.to_owned(), 123_456_789),
        _ => row.to_owned(),
    });
    *data = rows.collect::<Vec<_>>().join("\n").into_bytes();
    let (report, recording) = imported(&wrenches);
    assert_eq!(
        (recording.wrench.len(), report.left_out, report.set_back),
        (700, 500, 500)
    );
    assert!(
        report
            .to_string()
            .contains("500 of these are by a clock that was set back"),
        "{report}"
    );
}

#[test]
fn a_trajectory_of_which_most_is_left_out_is_data_lost() {
    let files = recording("bath", "2-5", PLAIN);
    let files = with_trajectory(&files, |rows| {
        for row in &mut rows[1_100..] {
            let (head, rest) = row.split_once(',').unwrap();
            let (_, rest) = rest.split_once(',').unwrap();
            *row = format!("{head},0,{rest}");
        }
    });
    let folder = tempfile::tempdir().unwrap();
    lay(&files, folder.path());
    let (code, text) = capture(&["import-hoi", ".", "-o", "out"], folder.path());
    assert_eq!(code, Some(3), "{text}");
    assert!(text.contains("MORE THAN HALF"), "{text}");
}

#[test]
fn other_units_and_a_gyroscope_that_disagrees_are_told() {
    let (plain, _) = imported(&recording("hall", "1-1", PLAIN));
    assert!(plain.doubts.is_empty(), "{plain}");
    assert!(
        plain
            .to_string()
            .contains("the sensor's gyroscope agrees to"),
        "{plain}"
    );
    let centimetres = Style {
        scale: 100.0,
        sensor_z: 5.0,
        ..PLAIN
    };
    let (report, _) = imported(&recording("hall", "1-1", centimetres));
    let text = report.to_string();
    assert!(
        text.contains("doubtful: positions reach over") && text.contains("in cm or mm?"),
        "{text}"
    );
    assert!(
        text.contains("doubtful: tool and sensor are 4.90 m apart"),
        "{text}"
    );
    let late = Style {
        gyro_late_ms: 37,
        ..PLAIN
    };
    let (report, _) = imported(&recording("hall", "1-1", late));
    let text = report.to_string();
    assert!(
        text.contains("gyroscope DISAGREES: the poses' stamps are off by +37"),
        "{text}"
    );
}

fn capture(arguments: &[&str], folder: &Path) -> (Option<i32>, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_ft-capture"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].concat();
    (
        output.status.code(),
        String::from_utf8_lossy(&text).into_owned(),
    )
}

#[test]
fn recordings_of_one_name_do_not_hide_each_other_and_broken_archives_are_told() {
    let folder = tempfile::tempdir().unwrap();
    for (copy, seconds) in [("monday", 12), ("friday", 13)] {
        let style = Style { seconds, ..PLAIN };
        lay(
            &recording("kitchen", "1-3", style),
            &folder.path().join(copy),
        );
    }
    lay(
        &recording("bath", "1-1", PLAIN),
        &folder.path().join("monday"),
    );
    let (code, text) = capture(&["import-hoi", ".", "-o", "out"], folder.path());
    assert_eq!(code, Some(0), "{text}");
    let wrenches = |name: &str| {
        let path = folder.path().join("out").join(name);
        Recording::load(&path, &TopicMap::default())
            .unwrap()
            .wrench
            .len()
    };
    assert_eq!(
        wrenches("monday/extracted/kitchen/gripper/kitchen_1-3.mcap"),
        1_200
    );
    assert_eq!(
        wrenches("friday/extracted/kitchen/gripper/kitchen_1-3.mcap"),
        1_300
    );
    assert_eq!(wrenches("bath_1-1.mcap"), 1_200);
    // Once more: nothing is done twice. An archive that was cut short is named, and the others are imported all the same.
    let mut files = recording("garage", "1-1", PLAIN);
    zip_up(&mut files, "extracted/garage/gripper/gripper", true);
    let zip = files
        .get_mut("extracted/garage/gripper/gripper.zip")
        .unwrap();
    zip.truncate(zip.len() / 2);
    lay(&files, &folder.path().join("monday"));
    let (code, text) = capture(&["import-hoi", ".", "-o", "out"], folder.path());
    assert_eq!(code, Some(3), "{text}");
    assert!(
        text.contains("gripper.zip") && text.contains("was cut short"),
        "{text}"
    );
    assert!(text.matches("is there already").count() == 3, "{text}");
}

#[test]
fn a_wrench_that_is_cut_in_the_middle_is_data_lost() {
    let style = Style {
        seconds: 30,
        ..PLAIN
    };
    let mut files = recording("bath", "2-6", style);
    let (_, wrench) = files
        .iter_mut()
        .find(|(name, _)| name.ends_with("wrench/data.csv"))
        .unwrap();
    wrench.truncate(wrench.len() / 2);
    let folder = tempfile::tempdir().unwrap();
    lay(&files, folder.path());
    let (code, text) = capture(&["import-hoi", ".", "-o", "out"], folder.path());
    assert_eq!(code, Some(3), "{text}");
    let said = "NO WRENCH beside the poses from 1";
    assert!(text.contains(said) && text.contains(" to 30.0 s"), "{text}");
}

/// Splitmix64: seeded, for what is changed where.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[test]
fn a_tree_that_is_damaged_anywhere_is_refused_or_read_and_never_crashes() {
    let style = Style {
        seconds: 7,
        ..PLAIN
    };
    let mut zipped = recording("loft", "1-1", style);
    zip_up(&mut zipped, "extracted/loft/gripper", true);
    let mut state = 20_261;
    let (mut refused, mut read) = (0, 0);
    for files in [recording("loft", "1-1", style), zipped] {
        for _ in 0..60 {
            let mut files = files.clone();
            let names: Vec<_> = files.keys().cloned().collect();
            let name = &names[random(&mut state) as usize % names.len()];
            let data = files.get_mut(name).unwrap();
            match random(&mut state) % 3 {
                0 => data.truncate(random(&mut state) as usize % data.len()),
                1 => {
                    for _ in 0..20 {
                        let at = random(&mut state) as usize % data.len();
                        data[at] = random(&mut state) as u8;
                    }
                }
                _ => {
                    files.remove(name);
                }
            }
            let folder = tempfile::tempdir().unwrap();
            lay(&files, folder.path());
            let out = folder.path().join("out.mcap");
            let result =
                parts(folder.path()).and_then(|found| import_part(&found.parts[0], &out, false));
            match result {
                Ok(report) => {
                    read += 1;
                    assert!(report.samples.iter().all(|count| *count >= 2) && out.exists());
                }
                Err(error) => {
                    refused += 1;
                    let text = error.to_string();
                    assert!(text.len() > 20 && !out.exists(), "{text}");
                }
            }
        }
    }
    println!("{refused} refused, {read} read");
    assert!(refused > 20 && read > 20, "{refused} {read}");
}

/// Runs to the end; the most memory that the program held, bytes.
#[allow(clippy::disallowed_methods, reason = "another process is watched")]
fn peak_memory(arguments: &[&str], folder: &Path) -> u64 {
    let mut program = Command::new(env!("CARGO_BIN_EXE_ft-capture"));
    let mut running = program
        .args(arguments)
        .current_dir(folder)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let status = PathBuf::from(format!("/proc/{}/status", running.id()));
    let mut peak = 0;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
        peak = peak.max(kilobytes.unwrap_or(0) * 1024);
        if let Some(code) = running.try_wait().unwrap() {
            assert!(code.success(), "{arguments:?}: {code}");
            return peak;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
}

/// `name=value` fields, and a record of a ROS 1 bag (wiki.ros.org/Bags/Format/2.0).
fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let sized = |bytes: &[u8]| [&u32::try_from(bytes.len()).unwrap().to_le_bytes(), bytes].concat();
    let field = |(name, value): &(&str, &[u8])| sized(&[name.as_bytes(), b"=", value].concat());
    let header: Vec<u8> = fields.iter().flat_map(field).collect();
    [sized(&header), sized(data)].concat()
}

#[test]
fn a_bag_and_an_archive_of_hundreds_of_megabytes_need_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let topic = "/force_torque/ft_sensor0/ft_sensor_readings/wrench";
    // 60 s of wrenches at 100 Hz among images: one chunk a second.
    let bag = folder.path().join("big.bag");
    let mut file = std::fs::File::create(&bag).unwrap();
    file.write_all(b"#ROSBAG V2.0\n").unwrap();
    let connection = |id: u32, topic: &str, kind: &str| {
        let inner = record(
            &[("topic", topic.as_bytes()), ("type", kind.as_bytes())],
            b"",
        );
        let data = &inner[4..inner.len() - 4];
        record(
            &[
                ("op", &[7]),
                ("conn", &id.to_le_bytes()),
                ("topic", topic.as_bytes()),
            ],
            data,
        )
    };
    let message = |id: u32, data: &[u8]| {
        record(
            &[("op", &[2]), ("conn", &id.to_le_bytes()), ("time", &[0; 8])],
            data,
        )
    };
    let picture = vec![0; 5_000_000];
    for second in 0..60_u32 {
        let mut chunk = [
            connection(1, topic, "geometry_msgs/WrenchStamped"),
            connection(2, "/camera", "sensor_msgs/Image"),
            message(2, &picture),
        ]
        .concat();
        for k in 0..100_u32 {
            let mut data = [0, 1_700_000_000 + second, k * 10_000_000, 0]
                .map(u32::to_le_bytes)
                .concat();
            let turn = f64::from(second) + 0.01 * f64::from(k);
            data.extend(
                [turn.sin(), 0.0, turn.cos(), 0.0, 0.0, 0.0]
                    .map(f64::to_le_bytes)
                    .concat(),
            );
            chunk.extend(message(1, &data));
        }
        let fields: [(&str, &[u8]); 3] =
            [("op", &[5]), ("compression", b"none"), ("size", &[0; 4])];
        write_sparse(&mut file, &record(&fields, &chunk));
    }
    let size = std::fs::metadata(&bag).unwrap().len();
    let peak = peak_memory(&["import-bag", "big.bag", "-o", "a.mcap"], folder.path());
    println!(
        "bag of {} MB: {} MB at most",
        size / 1_000_000,
        peak / 1_000_000
    );
    assert!(
        size > 300_000_000 && peak > 1_000_000 && peak < 60_000_000,
        "{size} {peak}"
    );
    let (_, text) = capture(&["check", "a.mcap"], folder.path());
    assert!(text.contains("6000"), "{text}");
    std::fs::remove_file(&bag).unwrap();

    // The same of an archive with an archive in it.
    let mut files = recording("kitchen", "1-3", PLAIN);
    let pictures = "extracted/kitchen/gripper/gripper/kitchen_1-3_gripper_bag/images";
    files.insert(format!("{pictures}/big.png"), vec![0; 150_000_000]);
    files.insert(format!("{pictures}/other.csv"), vec![0; 50_000_000]);
    zip_up(
        &mut files,
        "extracted/kitchen/gripper/gripper/kitchen_1-3_gripper_bag",
        true,
    );
    zip_up(&mut files, "extracted/kitchen/gripper/gripper", true);
    lay(&files, folder.path());
    drop(files);
    let peak = peak_memory(&["import-hoi", "extracted", "-o", "out"], folder.path());
    println!("archive of 200 MB: {} MB at most", peak / 1_000_000);
    assert!(peak > 1_000_000 && peak < 60_000_000, "{peak}");
    assert!(folder.path().join("out/kitchen_1-3.mcap").is_file());
}
