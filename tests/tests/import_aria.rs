//! The glasses' poses are taken out of a simulated recording, written as MPS writes them, by a clock of their own and with a utc
//! that is 1.7 s off, and imported again. All figures here are simulated.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::fmt::Write as _;
use std::path::Path;

use ft_capture::calibrate::{CalibrateOptions, calibrate};
use ft_capture::import::aria::{AriaOptions, import_aria};
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::identify_recording;
use ft_recording::rewrite::Rewrite;
use ft_recording::{Pose7, Recording, Stamped, TopicMap, TrackedFrame};
use ft_tests::truth::record;
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
