//! What stamps are worth: poses of glasses whose clock is their own (written as MPS writes them, with a utc that is 1.7 s off), the effect
//! of stamps and tool mass on the parameters, and device clocks smoothed afterwards. All figures here are simulated.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use ft_capture::calibrate::{CalibrateOptions, calibrate};
use ft_capture::import::aria::{AriaOptions, import_aria};
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::identify_recording;
use ft_recording::reader::{Record, RecordReader};
use ft_recording::rewrite::Rewrite;
use ft_recording::{Pose7, Recording, Stamped, TopicMap, TrackedFrame};
use ft_sim_hw::Scenario;
use ft_sim_hw::scenario::SensorSpec;
use ft_tests::stamps::{Treatment, effect};
use ft_tests::truth::{record, record_scenario};
use ft_tests::{peers, programs};
use ft_wire::HostTime;

fn load(path: &Path) -> Recording {
    Recording::load(path, &TopicMap::default()).unwrap()
}

/// The glasses' clock began 149 s before the recording and is 30 ppm slow.
fn device_us(at: HostTime, start: HostTime) -> i64 {
    (149e6 + 1e6 * at.seconds_since(start) * (1.0 - 30e-6)).round() as i64
}

/// `closed_loop_trajectory.csv` with a utc that is 1.7 s ahead and steps by 100 ms.
fn write_mps(poses: &[Stamped<Pose7>], start: HostTime, folder: &Path) {
    let mut text = String::from(
        "graph_uid,tracking_timestamp_us,utc_timestamp_ns,tx_world_device,ty_world_device,tz_world_device,qx_world_device,\
         qy_world_device,qz_world_device,qw_world_device,gravity_x_world,gravity_y_world,gravity_z_world,quality_score\n",
    );
    let (mut step, mut utc) = (i64::MIN, 0);
    for sample in poses {
        let us = device_us(sample.at, start);
        if us / 100_000 != step {
            step = us / 100_000;
            utc = sample.at.as_nanos() + 1_700_000_000;
        }
        let numbers = sample.value.position.iter().chain(&sample.value.quaternion);
        let numbers: Vec<_> = numbers.map(|value| format!("{value:.9}")).collect();
        writeln!(text, "a,{us},{utc},{},0,0,-9.81,1.0", numbers.join(",")).unwrap();
    }
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join("closed_loop_trajectory.csv"), text).unwrap();
}

/// Inertia, Coulomb and viscous friction of a recording; nothing where it cannot be identified.
fn terms(path: &Path) -> Option<[f64; 3]> {
    let settings = MotionSettings::default();
    let found = identify_recording(path, &TopicMap::default(), &settings, &mut |_| {}).ok()?;
    let term = |name| found.report.term(name).and_then(|term| term.value);
    Some([term("inertia")?, term("coulomb")?, term("viscous")?])
}

#[test]
fn the_glasses_poses_come_back_to_their_time_and_the_joint_to_its_parameters() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let truth = record("drawer_loaded", 51, &path("original.mcap"));
    let original = load(&path("original.mcap"));
    assert_eq!(original.pose.frame, TrackedFrame::AriaDevice);
    let start = original.wrench[0].at;
    write_mps(&original.pose.samples, start, &path("mps"));
    let mut bare = Rewrite::new();
    bare.leave_out("/aria/pose").leave_out("/tcp/pose");
    bare.write(Some(&path("original.mcap")), &path("bare.mcap"), false)
        .unwrap();

    let import = |out: &str, align: bool| {
        let options = AriaOptions {
            align,
            ..AriaOptions::default()
        };
        import_aria(&path("bare.mcap"), &path("mps"), &path(out), &options).unwrap()
    };
    let report = import("aligned.mcap", true);
    println!("{report}");
    let worst_ms = |out: &str| {
        // The stamps as the importer gave them, against those of the original.
        let imported = load(&path(out)).pose.samples;
        assert_eq!(imported.len(), original.pose.samples.len());
        let errors = imported.iter().zip(&original.pose.samples);
        errors.fold(0.0_f64, |worst, (a, b)| {
            worst.max(1e3 * a.at.seconds_since(b.at).abs())
        })
    };
    let aligned_ms = worst_ms("aligned.mcap");
    assert!(aligned_ms < 1.0, "{aligned_ms} ms");
    import("utc.mcap", false);
    assert!((worst_ms("utc.mcap") - 1_700.0).abs() < 1.0);

    let mut arrivals = Rewrite::new();
    arrivals.restamp(|_, _, arrival| arrival);
    arrivals
        .write(Some(&path("original.mcap")), &path("arrivals.mcap"), false)
        .unwrap();

    println!("simulated, drawer_loaded seed 51; errors of inertia, Coulomb and viscous friction");
    let wanted = [
        truth.object.inertia,
        truth.object.coulomb,
        truth.object.viscous,
    ];
    let error = |file: &str, name: &str| {
        let errors = terms(&path(file)).map(|found| {
            std::array::from_fn::<f64, 3, _>(|k| 100.0 * (found[k] / wanted[k] - 1.0))
        });
        match errors {
            Some([i, c, v]) => println!("{name:<34} {i:+8.2} % {c:+8.2} % {v:+8.2} %"),
            None => println!("{name:<34} not identified"),
        }
        errors
    };
    let translated = error("original.mcap", "translated stamps").unwrap();
    error("arrivals.mcap", "arrival stamps");
    error("utc.mcap", "glasses afterwards, by utc alone");
    let aligned = error("aligned.mcap", "glasses afterwards, aligned").unwrap();
    for k in 0..3 {
        assert!(
            (aligned[k] - translated[k]).abs() < 2.0,
            "{aligned:?} {translated:?}"
        );
    }
}

#[test]
fn better_stamps_and_a_calibrated_tool_bring_the_parameters_nearer_to_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let of = |name: &str, seed: u64| {
        effect(&Scenario::load(name).unwrap(), seed, folder.path()).unwrap()
    };
    // No mechanism stands in the way of plain least squares here.
    let door = of("sliding_door", 53);
    let light = of("drawer_light", 54);
    println!(
        "simulated, errors by {:?}",
        Treatment::ALL.map(Treatment::name)
    );
    for found in [&door, &light] {
        println!("{found:#?}");
        assert!((found.mass_kg[1] / found.mass_kg[0] - 1.0).abs() < 0.01);
        // The filter's 6 ms, and up to a sample period that bursts hide.
        assert!((5.5..8.0).contains(&found.offset_ms), "{}", found.offset_ms);
    }
    let [arrival, translated, aligned, _] = door.errors.map(|errors| errors.plain);
    let size =
        |errors: [Option<f64>; 3]| errors.map(|error| error.unwrap().abs()).iter().sum::<f64>();
    assert!(size(aligned) < 0.5 * size(translated), "{door:?}");
    assert!(size(translated) < size(arrival), "{door:?}");
    let [_, _, calibrated, nominal] = light.errors.map(|errors| errors.ours[0].unwrap());
    // What the tool weighs more looks like inertia of the drawer: 0.098 of 3 kg.
    assert!(
        (nominal - calibrated - 0.098 / 3.0).abs() < 0.01,
        "{light:?}"
    );
    assert!(calibrated.abs() < 0.5 * nominal.abs(), "{light:?}");
}

#[test]
fn a_simulated_gripper_is_calibrated_from_its_own_free_air() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    let _ = record("wood_door", 52, &file);
    let recording = load(&file);
    let found = calibrate(&recording, &CalibrateOptions::default()).unwrap();
    println!("simulated: {found}");
    let offset_ms = 1e3 * found.alignment.unwrap().offset_s;
    assert!(offset_ms.abs() < 1.0, "{offset_ms} ms");
    assert!(
        (found.calibration.payload_mass_kg.value / 0.49 - 1.0).abs() < 0.02,
        "{found}"
    );
}

/// RMS about the best line of stamps that are even in truth, us.
fn unevenness_us(stamps: &[HostTime]) -> f64 {
    let n = stamps.len() as f64;
    let y: Vec<f64> = stamps
        .iter()
        .map(|at| at.seconds_since(stamps[0]))
        .collect();
    let (mx, my) = (0.5 * (n - 1.0), y.iter().sum::<f64>() / n);
    let sxx: f64 = (0..y.len()).map(|k| (k as f64 - mx).powi(2)).sum();
    let sxy: f64 = y
        .iter()
        .enumerate()
        .map(|(k, y)| (k as f64 - mx) * (y - my))
        .sum();
    let slope = sxy / sxx;
    let left = y
        .iter()
        .enumerate()
        .map(|(k, y)| (y - my - slope * (k as f64 - mx)).powi(2));
    1e6 * (left.sum::<f64>() / n).sqrt()
}

/// A metadata record of a recording.
fn metadata_of(path: &Path, wanted: &str) -> BTreeMap<String, String> {
    let mut reader = RecordReader::open(path).unwrap();
    while let Some(record) = reader.next_record().unwrap() {
        if let Record::Metadata { name, entries } = record
            && name == wanted
        {
            return entries;
        }
    }
    panic!("no {wanted}");
}

#[test]
fn clocks_smoothed_afterwards_give_evener_stamps_in_a_new_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut scenario = Scenario::load("drawer_loaded").unwrap();
    scenario.sensor.link.burst_ms = 16.0;
    let _ = record_scenario(&scenario, 55, &path("a.mcap"));
    let before = load(&path("a.mcap"));
    let retime = |arguments: &[&str]| programs::run("ft-capture", arguments, folder.path());
    let done = retime(&["check", "a.mcap", "--retime", "b.mcap", "--json"])
        .expect_code(0)
        .json();
    println!("simulated: {}", done["retimed"]);
    assert_eq!(done["check"]["verdict"], "fine", "{done}");
    for topic in ["/ft/wrench", "/aria/pose"] {
        assert_eq!(done["retimed"]["topics"][topic]["kept"], 0, "{done}");
    }
    let after = load(&path("b.mcap"));
    assert_eq!(
        load(&path("a.mcap")).sha256,
        before.sha256,
        "the source was written to"
    );
    let stamps = |recording: &Recording| {
        let wrench: Vec<_> = recording.wrench.iter().map(|sample| sample.at).collect();
        let pose: Vec<_> = recording
            .pose
            .samples
            .iter()
            .map(|sample| sample.at)
            .collect();
        [wrench, pose]
    };
    for (name, before, after) in [
        ("wrench", &stamps(&before)[0], &stamps(&after)[0]),
        ("pose", &stamps(&before)[1], &stamps(&after)[1]),
    ] {
        assert_eq!(before.len(), after.len());
        let (causal, smooth) = (unevenness_us(before), unevenness_us(after));
        println!("simulated: {name} stamps are {causal:.1} us off a line, smoothed {smooth:.1} us");
        assert!(
            smooth < 0.7 * causal,
            "{name}: {causal} us, smoothed {smooth} us"
        );
    }
    // Values stay, sample by sample.
    let values = |recording: &Recording| {
        recording
            .wrench
            .iter()
            .map(|one| one.value)
            .collect::<Vec<_>>()
    };
    assert_eq!(values(&before), values(&after));

    retime(&["check", "a.mcap", "--retime", "b.mcap"])
        .expect_code(1)
        .complains(&["exists"]);
    retime(&["check", "a.mcap", "--retime", "a.mcap", "--force"])
        .expect_code(1)
        .complains(&["a.mcap"]);
    assert_eq!(
        load(&path("a.mcap")).sha256,
        before.sha256,
        "the source was written over"
    );
    retime(&["check", "b.mcap", "--retime", "c.mcap"])
        .expect_code(1)
        .complains(&["ft.retimed"]);
    assert!(!path("c.mcap").exists());

    // Poses that another translator stamped stay, and the new recording says how many.
    let mut other = Rewrite::new();
    other.restamp(|name, stamp, _| match name {
        "/aria/pose" => HostTime::from_nanos(stamp.as_nanos() / 100_000 * 100_000),
        _ => stamp,
    });
    other
        .write(Some(&path("a.mcap")), &path("other.mcap"), false)
        .unwrap();
    let done = retime(&["check", "other.mcap", "--retime", "d.mcap", "--json"])
        .expect_code(0)
        .json();
    let topics = &done["retimed"]["topics"];
    let kept = topics["/aria/pose"]["kept"].as_u64().unwrap();
    assert!(2 * kept > before.pose.samples.len() as u64, "{topics}");
    assert_eq!(topics["/ft/wrench"]["kept"], 0, "{topics}");
    let written = metadata_of(&path("d.mcap"), "ft.retimed").remove("json");
    let written: serde_json::Value = serde_json::from_str(&written.unwrap()).unwrap();
    assert_eq!(&written, topics);
    let mut bare = Rewrite::new();
    bare.leave_out("/raw/ft_sensor")
        .leave_out("/raw/aria")
        .leave_out("/raw/gripper");
    bare.write(Some(&path("a.mcap")), &path("bare.mcap"), false)
        .unwrap();
    retime(&["check", "bare.mcap", "--retime", "c.mcap"])
        .expect_code(1)
        .complains(&["/raw/"]);
    assert!(!path("c.mcap").exists());
}

#[test]
fn a_sensor_without_clock_or_counter_is_stamped_by_the_number_of_its_samples() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    let mut scenario = Scenario::load("drawer_loaded").unwrap();
    scenario.sensor = SensorSpec::of("robotous_uart").unwrap();
    scenario.sensor.link.burst_ms = 16.0;
    let _ = record_scenario(&scenario, 56, &file);
    let arrived = folder.path().join("arrival.mcap");
    let mut rewrite = Rewrite::new();
    rewrite.restamp(|_, _, arrival| arrival);
    rewrite.write(Some(&file), &arrived, false).unwrap();
    // Each as far as it can be known after ten seconds.
    let [counted, arrival] = [&file, &arrived].map(|path| {
        let wrench = load(path).wrench;
        let stamps: Vec<_> = wrench.iter().map(|sample| sample.at).collect();
        let from = stamps.partition_point(|at| at.seconds_since(stamps[0]) < 10.0);
        unevenness_us(&stamps[from..])
    });
    println!("simulated: by count {counted:.1} us off a line, arrival {arrival:.1} us");
    assert!(
        counted < 1_000.0 && 5.0 * counted < arrival,
        "{counted} {arrival}"
    );
}

/// Angular rate around `at`, rad/s in device axes, from what the poses turn by in 20 ms; none where there are no poses.
fn rate(poses: &[Stamped<Pose7>], at: HostTime) -> [f64; 3] {
    let near = |seconds: f64| {
        let at = at.offset_by_seconds(seconds);
        poses.get(poses.partition_point(|pose| pose.at < at))
    };
    let (Some(a), Some(b)) = (near(-0.01), near(0.01)) else {
        return [0.0; 3];
    };
    let time = b.at.seconds_since(a.at);
    let turned = a.value.inverse().then(&b.value).quaternion;
    core::array::from_fn(|k| 2.0 * turned[k] * turned[3].signum() / time.max(1e-3))
}

/// The raw form of the Hoi! dataset: a ROS 1 bag, written by other people's library, and MPS results of another clock.
#[test]
fn a_ros_1_bag_and_glasses_of_another_clock_become_a_recording_in_three_commands() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let truth = record("drawer_loaded", 56, &path("original.mcap"));
    let original = load(&path("original.mcap"));
    let start = original.wrench[0].at;
    let mps = "aria_gripper/mps_kitchen_1-3_gripper_vrs/slam";
    write_mps(&original.pose.samples, start, &path(mps));
    let mut wrench = String::new();
    for sample in &original.wrench {
        let rate = rate(&original.pose.samples, sample.at);
        let values = sample.value.iter().chain(&rate);
        let values: Vec<_> = values.map(f64::to_string).collect();
        writeln!(wrench, "{} {}", sample.at.as_nanos(), values.join(" ")).unwrap();
    }
    std::fs::write(path("wrench.txt"), wrench).unwrap();
    for (bag, packed) in [("kitchen_1-3.bag", "none"), ("packed.bag", "bz2")] {
        let arguments = [path("wrench.txt"), path(bag), packed.into()];
        let Some(written) = peers::run("a ROS 1 bag", "write_bag.py", &arguments) else {
            return;
        };
        let _ = written.expect_code(0);
    }
    let pose = |name: &str, pose: &Pose7| {
        format!(
            "[frames.{name}]\nposition_m = {:?}\nquaternion_xyzw = {:?}\n",
            pose.position, pose.quaternion
        )
    };
    let device = "[[device]]\nname = \"a\"\ndriver = \"pose_stream\"\nport = \"none\"\n";
    let frames = pose("aria_device_from_tcp", &original.aria_device_from_tcp)
        + &pose("tcp_from_ft_sensor", &original.tcp_from_ft_sensor);
    std::fs::write(
        path("capture.toml"),
        format!("id = \"hoi\"\n{device}{frames}"),
    )
    .unwrap();
    let grasp = original
        .marks
        .iter()
        .find(|mark| mark.value == "grasp")
        .unwrap();
    let free_air = format!("0..{:.1}", grasp.at.seconds_since(start) - 0.3);

    let run = |arguments: &[&str]| programs::run("ft-capture", arguments, folder.path());
    run(&["import-bag", "packed.bag", "-o", "no.mcap"])
        .expect_code(1)
        .complains(&["bz2", "rosbag decompress"]);
    run(&[
        "import-bag",
        "kitchen_1-3.bag",
        "--wrench",
        "/w",
        "-o",
        "no.mcap",
    ])
    .expect_code(1)
    .complains(&["ft_sensor_readings/wrench (geometry_msgs/WrenchStamped)"]);
    let said = run(&["import-bag", "kitchen_1-3.bag", "-o", "wrench.mcap"]).expect_code(0);
    assert!(
        said.stdout
            .contains(&format!("{} wrenches", original.wrench.len())),
        "{said:?}"
    );
    let mps = "aria_gripper/mps_kitchen_1-3_gripper_vrs";
    let import = [
        "import-aria",
        "wrench.mcap",
        "--mps",
        mps,
        "--frames",
        "capture.toml",
        "--free-air",
        &free_air,
        "-o",
        "a.mcap",
    ];
    // The bag has the sensor's gyroscope: it says that the alignment by the tool's own weight is right.
    let said = run(&import).expect_code(0);
    assert!(said.stdout.contains("the gyroscope agrees to"), "{said:?}");
    run(&[
        "calibrate",
        "a.mcap",
        "--free-air",
        &free_air,
        "-o",
        "kitchen.mcap",
    ])
    .expect_code(0);

    let checked = run(&["check", "kitchen.mcap", "--json"])
        .expect_code(0)
        .json();
    let off_ms = checked["gyroscope"]["compared"]["offset_ms"]
        .as_f64()
        .unwrap();
    assert!(off_ms.abs() < 2.0, "{checked}");
    println!("simulated: the gyroscope's poses are {off_ms:+.2} ms off");

    let imported = load(&path("kitchen.mcap"));
    assert_eq!(imported.wrench, original.wrench);
    assert!(imported.calibration.is_some() && imported.temperature.len() > 500);
    let shifts = imported.pose.samples.iter().zip(&original.pose.samples);
    let worst_ms = shifts.fold(0.0_f64, |worst, (a, b)| {
        worst.max(1e3 * a.at.seconds_since(b.at).abs())
    });
    assert!(worst_ms < 1.0, "{worst_ms} ms");
    let [inertia, ..] = terms(&path("kitchen.mcap")).unwrap();
    println!(
        "simulated: poses {worst_ms:.3} ms off, inertia {inertia:.3} (true {})",
        truth.object.inertia
    );
    assert!(
        (inertia / truth.object.inertia - 1.0).abs() < 0.03,
        "{inertia}"
    );
}
