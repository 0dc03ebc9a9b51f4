//! Calibration and alignment on simulated set-ups whose truth is known. All figures here are simulated.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a test fails by panicking"
)]

use std::path::Path;

use ft_capture::calibrate::{
    Alignment, CalibrateError, CalibrateOptions, Calibrated, Outputs, align_recording, calibrate,
    calibrate_file,
};
use ft_recording::message::{
    Header, PoseStamped, TFMessage, Temperature, TransformStamped, WrenchStamped,
};
use ft_recording::reader::{Record, RecordReader};
use ft_recording::rewrite::Rewrite;
use ft_recording::{
    Calibration, Message as _, MessageStamps, Pose7, Qos, Recording, Stamped, TopicMap,
};
use ft_wire::HostTime;
use nalgebra::{DMatrix, DVector};

#[path = "support/shake.rs"]
mod shake;
use shake::{Motion, MotionKind, Numbers, Setup};

fn aligned(setup: &Setup) -> Result<Alignment, CalibrateError> {
    align_recording(&setup.record(), 0.0, &CalibrateOptions::default())
}

fn calibrated(setup: &Setup) -> Calibrated {
    calibrate(&setup.record(), &CalibrateOptions::default())
        .unwrap_or_else(|error| panic!("seed {}: {error}", setup.seed))
}

#[test]
fn a_damaged_recording_is_said_to_be_one() {
    let mut recording = Setup::random(1, Motion::SHAKE).record();
    recording.health.truncated = Some("it was not finished".to_owned());
    let found = calibrate(&recording, &CalibrateOptions::default()).unwrap();
    assert!(found.damage.is_some());
    assert!(found.to_string().contains("it was not finished"), "{found}");
    let turned = CalibrateOptions {
        find_rotation: true,
        ..CalibrateOptions::default()
    };
    assert!(calibrate(&recording, &turned).unwrap().damage.is_some());
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// Other set-ups than those of the tests, `FT_SEED` further, for whoever wants figures of seeds that nobody has seen.
fn shifted(seeds: std::ops::Range<u64>) -> std::ops::Range<u64> {
    let by = std::env::var("FT_SEED").map_or(0, |text| text.parse().unwrap());
    seeds.start + by..seeds.end + by
}

/// Aligns shakes of `seeds`; errors, ms, and whether the interval holds the truth.
fn errors_ms(seeds: std::ops::Range<u64>, pose_hz: f64) -> Vec<(f64, bool)> {
    shifted(seeds)
        .map(|seed| {
            let setup = Setup {
                pose_hz,
                ..Setup::random(seed, Motion::SHAKE)
            };
            let found = aligned(&setup).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            let [low, high] = found.interval_s;
            let error = found.offset_s - setup.offset_s;
            (1e3 * error, (low..=high).contains(&setup.offset_s))
        })
        .collect()
}

#[test]
fn ten_seconds_of_shaking_show_the_offset_with_an_honest_interval() {
    let mut inside = Vec::new();
    for (pose_hz, seeds, limit_ms) in [(1000.0, 25_000..25_120, 0.5), (100.0, 26_000..26_120, 1.0)]
    {
        let found = errors_ms(seeds, pose_hz);
        let sigma_ms = rms(&found.iter().map(|(error, _)| *error).collect::<Vec<_>>());
        println!("simulated, poses at {pose_hz} Hz: offset error {sigma_ms:.4} ms (1 sigma)");
        assert!(sigma_ms <= limit_ms, "{sigma_ms} ms");
        inside.extend(found.into_iter().map(|(_, inside)| inside));
    }
    let share = inside.iter().filter(|inside| **inside).count() as f64 / inside.len() as f64;
    println!(
        "simulated: {:.1} % of the 95 % intervals hold the truth",
        100.0 * share
    );
    assert!((0.90..=0.98).contains(&share), "{share}");
}

#[test]
fn a_tracker_that_starts_forty_seconds_late_is_aligned() {
    let motion = Motion {
        duration_s: 60.0,
        ..Motion::SHAKE
    };
    let setup = Setup {
        pose_late_s: 40.0,
        offset_s: -7.25,
        ..Setup::random(71, motion)
    };
    let found = aligned(&setup).unwrap();
    assert!((found.offset_s + 7.25).abs() < 5e-4, "{found:?}");
}

#[test]
fn a_long_free_air_shows_the_skew_too() {
    let motion = Motion {
        duration_s: 120.0,
        ..Motion::SHAKE
    };
    for (seed, ppm) in [(81, 100.0), (82, -200.0)] {
        let setup = Setup {
            skew: 1e-6 * ppm,
            offset_s: 1.5,
            pose_hz: 200.0,
            ..Setup::random(seed, motion)
        };
        let found = aligned(&setup).unwrap();
        let [skew, std] = found.skew_ppm.unwrap();
        assert!((skew - ppm).abs() < 4.0 * std && std < 5.0, "{found:?}");
        let at_start = found.offset_s - 1e-6 * skew * found.at_s;
        assert!((at_start - 1.5).abs() < 5e-4, "{found:?}");
    }
}

/// The same poses published at 1 kHz by a program that knows nothing of the tracker's stamps: each again and again until the next.
fn published_again(recording: &mut Recording, late_s: f64) {
    let samples = &recording.pose.samples;
    let (first, last) = (samples[0].at, samples[samples.len() - 1].at);
    let mut from = 0;
    let every_ms = (0..)
        .map(|k| first.offset_by_seconds(late_s + 1e-3 * f64::from(k)))
        .take_while(|at| *at < last);
    let again = every_ms.map(|at| {
        while samples[from + 1].at <= at {
            from += 1;
        }
        let value = samples[from].value;
        Stamped { at, value }
    });
    recording.pose.samples = again.collect();
}

#[test]
fn poses_that_are_repeated_under_new_stamps_do_not_move_the_offset() {
    let (mut errors_ms, mut inside) = (Vec::new(), 0);
    for seed in shifted(26_500..26_520) {
        let setup = Setup {
            pose_hz: 100.0,
            ..Setup::random(seed, Motion::SHAKE)
        };
        let mut recording = setup.record();
        published_again(&mut recording, 0.0);
        let found = calibrate(&recording, &CalibrateOptions::default()).unwrap();
        let [wrenches, poses] = found.repeats;
        let share = poses as f64 / recording.pose.samples.len() as f64;
        assert!(wrenches == 0 && (share - 0.9).abs() < 0.01, "{share}");
        let said = format!("{poses} poses only repeat the one before");
        assert!(found.to_string().contains(&said), "{found}");
        let alignment = found.alignment.unwrap();
        let [low, high] = alignment.interval_s;
        errors_ms.push(1e3 * (alignment.offset_s - setup.offset_s));
        inside += usize::from((low..=high).contains(&setup.offset_s));
        assert!((found.calibration.payload_mass_kg.value / setup.mass - 1.0).abs() < 0.01);
    }
    let sigma_ms = rms(&errors_ms);
    println!(
        "simulated, poses of 100 Hz published at 1 kHz: offset error {sigma_ms:.4} ms (1 sigma), {inside} of {} within their intervals",
        errors_ms.len()
    );
    assert!(sigma_ms <= 0.1 && 10 * inside >= 8 * errors_ms.len());

    // A wrench that is held, too. Sensor and publisher are not in step: up to 1 ms of delay is no error of the alignment.
    let setup = Setup {
        pose_hz: 100.0,
        wrench_hz: 250.0,
        ..Setup::random(26_520, Motion::SHAKE)
    };
    let mut recording = setup.record();
    published_again(&mut recording, 3e-4);
    let wrench = recording.wrench.iter().flat_map(|sample| {
        (0..4).map(|k| Stamped {
            at: sample.at.offset_by_seconds(1e-3 * f64::from(k)),
            value: sample.value,
        })
    });
    recording.wrench = wrench.collect();
    let found = align_recording(&recording, 0.0, &CalibrateOptions::default()).unwrap();
    let late_ms = 1e3 * (setup.offset_s - found.offset_s);
    assert!((0.0..1.0).contains(&late_ms), "{late_ms} ms");
}

#[test]
fn a_wrench_with_its_signs_reversed_is_told_as_that() {
    for motion in [Motion::SHAKE, Motion::STILLS] {
        let setup = Setup {
            offset_s: 0.0,
            ..Setup::random(26_600, motion)
        };
        let mut recording = setup.record();
        for sample in &mut recording.wrench {
            sample.value = sample.value.map(|value| -value);
        }
        let error = calibrate(&recording, &CalibrateOptions::default());
        let text = error.expect_err("refused").to_string();
        assert!(text.contains("with its signs reversed"), "{text}");
    }
}

/// Says why it is refused.
fn refusal(setup: &Setup) -> String {
    aligned(setup).expect_err("refused").to_string()
}

#[test]
fn a_lazy_shake_is_refused_with_what_to_do() {
    let motion = Motion {
        turns_rad: 0.001,
        strokes_m: 0.000_02,
        to_hz: 0.5,
        ..Motion::SHAKE
    };
    for seed in 91..96 {
        let text = refusal(&Setup::random(seed, motion));
        assert!(
            text.contains("shake") && text.contains("about every axis"),
            "{text}"
        );
    }
}

#[test]
fn a_shake_that_is_just_enough_is_right_or_refused() {
    let mut accepted = 0;
    for seed in 201..221 {
        let size = 0.005 * 1.3_f64.powi((seed - 201) as i32);
        let motion = Motion {
            turns_rad: size,
            strokes_m: 0.02 * size,
            to_hz: 0.5,
            ..Motion::SHAKE
        };
        let setup = Setup::random(seed, motion);
        if let Ok(found) = aligned(&setup) {
            let error = (found.offset_s - setup.offset_s).abs();
            assert!(
                error < 4.0 * found.std_s || error < 0.0005,
                "{seed}: {error} {found:?}"
            );
            accepted += 1;
        }
    }
    assert!((5..20).contains(&accepted), "{accepted}");
}

#[test]
fn the_poses_of_another_shake_are_refused() {
    for seed in 101..106 {
        let mut recording = Setup::random(seed, Motion::SHAKE).record();
        recording.pose = Setup::random(seed + 1_000, Motion::SHAKE).record().pose;
        let error = align_recording(&recording, 0.0, &CalibrateOptions::default());
        let text = error.expect_err("refused").to_string();
        assert!(text.contains("% of the wrench at best"), "{text}");
    }
}

#[test]
fn a_swing_that_repeats_itself_is_refused() {
    let motion = Motion {
        to_hz: 1.0,
        kind: MotionKind::Swing,
        ..Motion::SHAKE
    };
    for seed in 111..114 {
        let text = refusal(&Setup::random(seed, motion));
        assert!(text.contains("repeats itself"), "{text}");
        // Nor is a tool weighed by poses that may be a swing off.
        for offset_s in [0.05, 0.0] {
            let setup = Setup {
                offset_s,
                ..Setup::random(seed, motion)
            };
            let error = calibrate(&setup.record(), &CalibrateOptions::default());
            let text = error.expect_err("refused").to_string();
            assert!(text.contains("repeats itself"), "{text}");
        }
    }
}

#[test]
fn a_shake_too_short_to_align_weighs_nothing_that_it_does_not_explain() {
    let motion = Motion {
        duration_s: 4.4,
        ..Motion::SHAKE
    };
    let setup = Setup {
        offset_s: 0.0,
        ..Setup::random(115, motion)
    };
    let weigh = |setup: &Setup| calibrate(&setup.record(), &CalibrateOptions::default());
    let found = weigh(&setup).unwrap();
    assert!(found.alignment.is_none(), "{found}");
    assert!((found.calibration.payload_mass_kg.value / setup.mass - 1.0).abs() < 0.02);
    // A tool that is all but a point at the sensor, and a torque that is mostly something else.
    let other = Setup {
        com: nalgebra::Vector3::new(0.0, 0.0, 5e-4),
        inertia: nalgebra::Matrix3::identity() * 1e-6,
        torque_noise: 0.02,
        ..setup
    };
    let text = weigh(&other).expect_err("refused").to_string();
    assert!(text.contains("% of the wrench at best"), "{text}");
}

#[test]
fn a_wrench_with_stamps_of_another_day_is_refused_before_its_rows_are_counted() {
    let mut recording = Setup::random(116, Motion::SHAKE).record();
    let a_day = 86_400_000_000_000;
    let early = recording.wrench.iter().take(500).map(|sample| Stamped {
        at: HostTime::from_nanos(sample.at.as_nanos() - a_day),
        value: sample.value,
    });
    recording.wrench = early.chain(recording.wrench.clone()).collect();
    for error in [
        align_recording(&recording, 0.0, &CalibrateOptions::default()).unwrap_err(),
        calibrate(&recording, &CalibrateOptions::default()).unwrap_err(),
    ] {
        let text = error.to_string();
        assert!(text.contains("stamped at another time"), "{text}");
    }
}

#[test]
fn an_offset_beyond_the_search_is_not_invented() {
    let setup = Setup {
        offset_s: 14.0,
        ..Setup::random(
            121,
            Motion {
                duration_s: 40.0,
                ..Motion::SHAKE
            },
        )
    };
    let text = refusal(&setup);
    assert!(
        text.contains("% of the wrench at best") || text.contains("at the end of"),
        "{text}"
    );
}

/// What is left of each recorded wrench when that of a tool and a bias as found, moved as the tool was, is taken off it: rms over
/// the sensor's own noise, force and torque.
fn compensated_over_noise(setup: &Setup, found: &Calibration) -> [f64; 2] {
    let [xx, xy, yy, xz, yz, zz] = found.payload_inertia_kgm2.value;
    let as_found = Setup {
        mass: found.payload_mass_kg.value,
        com: found.payload_com_m.value.into(),
        inertia: nalgebra::Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        bias: found.wrench_bias.unwrap().value,
        force_noise: 0.0,
        torque_noise: 0.0,
        ..setup.clone()
    };
    let (measured, predicted) = (setup.record().wrench, as_found.record().wrench);
    let left = |axes: std::ops::Range<usize>| {
        let pairs = measured.iter().zip(&predicted);
        let of_pair = |(a, b): (&Stamped<[f64; 6]>, &Stamped<[f64; 6]>)| {
            assert_eq!(a.at, b.at);
            axes.clone()
                .map(move |k| a.value[k] - b.value[k])
                .collect::<Vec<_>>()
        };
        rms(&pairs.flat_map(of_pair).collect::<Vec<_>>())
    };
    [
        left(0..3) / setup.force_noise,
        left(3..6) / setup.torque_noise,
    ]
}

/// Weighs tools from good shakes of 20 s; free air after compensation over the sensor's own noise, force and torque, by set-up.
fn weighed(seeds: std::ops::Range<u64>, pose_hz: f64) -> Vec<[f64; 2]> {
    let motion = Motion {
        duration_s: 20.0,
        ..Motion::SHAKE
    };
    let mut worst = [0.0_f64; 4];
    let mut within_two = (0, 0);
    let mut distances = Vec::new();
    let mut over_noise = Vec::new();
    for seed in shifted(seeds) {
        let setup = Setup {
            pose_hz,
            ..Setup::random(seed, motion)
        };
        let found = calibrated(&setup);
        let c = &found.calibration;
        let bias = c.wrench_bias.unwrap();
        let j = setup.inertia;
        let truth = [setup.mass]
            .into_iter()
            .chain(setup.com.iter().copied())
            .chain([j.m11, j.m12, j.m22, j.m13, j.m23, j.m33])
            .chain(setup.bias);
        let value = [c.payload_mass_kg.value]
            .into_iter()
            .chain(c.payload_com_m.value)
            .chain(c.payload_inertia_kgm2.value)
            .chain(bias.value);
        let std = [c.payload_mass_kg.std]
            .into_iter()
            .chain(c.payload_com_m.std)
            .chain(c.payload_inertia_kgm2.std)
            .chain(bias.std);
        let (value, truth): (Vec<_>, Vec<_>) = (value.collect(), truth.collect());
        let error = DVector::from_fn(16, |k, _| value[k] - truth[k]);
        let covariance = c.covariance.as_ref().unwrap();
        let covariance = DMatrix::from_fn(16, 16, |i, j| covariance[i][j]);
        let inverse = covariance.cholesky().unwrap().inverse();
        distances.push(error.dot(&(inverse * &error)));
        for (index, ((value, truth), std)) in value.into_iter().zip(truth).zip(std).enumerate() {
            let error = (value - truth).abs();
            within_two.0 += u32::from(error <= 2.0 * std);
            within_two.1 += 1;
            match index {
                0 => worst[0] = worst[0].max(error / setup.mass),
                1..4 => worst[1] = worst[1].max(error),
                10..13 => worst[2] = worst[2].max(error),
                13.. => worst[3] = worst[3].max(error),
                _ => {}
            }
        }
        over_noise.push(compensated_over_noise(&setup, c));
    }
    let within_two = f64::from(within_two.0) / f64::from(within_two.1);
    println!(
        "simulated, poses at {pose_hz} Hz: worst mass error {:.3} %, centre {:.3} mm, bias {:.4} N, {:.5} N m; {:.1} % of errors within 2 std",
        100.0 * worst[0],
        1e3 * worst[1],
        worst[2],
        worst[3],
        100.0 * within_two
    );
    assert!(
        worst[0] <= 0.01 && worst[1] <= 0.001 && worst[2] <= 0.05 && worst[3] <= 0.002,
        "{worst:?}"
    );
    // All 16 parameters at once: chi-squared of 16 degrees has a mean of 16.
    distances.sort_unstable_by(f64::total_cmp);
    let (median, most) = (
        distances[distances.len() / 2],
        distances[distances.len() * 95 / 100],
    );
    println!(
        "simulated: errors by their covariance, squared: median {median:.1}, 95 % {most:.1} (of a chi-squared of 16: 15.3, 26.3)"
    );
    // Three times what the quantiles of so many draws scatter by: sqrt(p (1 - p) / n) over the density there, 0.0725 and 0.0131.
    let scatter = 3.0 / (distances.len() as f64).sqrt();
    assert!((median - 15.3).abs() < scatter * 0.5 / 0.0725, "{median}");
    assert!((most - 26.3).abs() < scatter * 0.218 / 0.0131, "{most}");
    // 95.4 % of a normal distribution lie within two standard deviations.
    assert!((0.90..=0.98).contains(&within_two), "{within_two}");
    over_noise
}

#[test]
fn fifty_tools_are_weighed() {
    let over_noise = weighed(27_000..27_050, 1000.0);
    for ratios in &over_noise {
        assert!(ratios.iter().all(|ratio| *ratio < 1.15), "{ratios:?}");
    }
    let [force, torque] = [0, 1].map(|part| {
        let ratios: Vec<f64> = over_noise.iter().map(|ratios| ratios[part]).collect();
        rms(&ratios)
    });
    println!(
        "simulated, 50 tools: compensated samples at {force:.3} (force) and {torque:.3} (torque) of the sensor's noise"
    );
    assert!(force < 1.05 && torque < 1.05, "{force} {torque}");
}

#[test]
fn a_slow_tracker_weighs_as_honestly() {
    weighed(27_100..27_130, 100.0);
}

#[test]
fn still_poses_alone_weigh_the_tool() {
    for seed in 131..136 {
        let setup = Setup {
            offset_s: 0.0,
            ..Setup::random(seed, Motion::STILLS)
        };
        let found = calibrated(&setup);
        let mass = found.calibration.payload_mass_kg.value;
        assert!((mass / setup.mass - 1.0).abs() < 0.01, "{found}");
        for (value, truth) in found
            .calibration
            .payload_com_m
            .value
            .iter()
            .zip(setup.com.iter())
        {
            assert!((value - truth).abs() < 1e-3, "{found}");
        }
    }
}

#[test]
fn a_tool_that_is_never_turned_is_refused_with_what_to_do() {
    let motion = Motion {
        turns_rad: 0.005,
        strokes_m: 0.0,
        to_hz: 0.4,
        duration_s: 20.0,
        kind: MotionKind::Shake,
    };
    let setup = Setup {
        offset_s: 0.0,
        ..Setup::random(141, motion)
    };
    match calibrate(&setup.record(), &CalibrateOptions::default()) {
        Ok(found) => panic!("not refused: {found}"),
        Err(error) => assert!(error.to_string().contains("orientation"), "{error}"),
    }
}

#[test]
fn a_bias_that_drifts_is_followed() {
    let motion = Motion {
        duration_s: 60.0,
        ..Motion::SHAKE
    };
    let mut numbers = Numbers(5);
    let setup = Setup {
        bias_rate: std::array::from_fn(|k| {
            numbers.within(0.5, 1.0) * if k < 3 { 0.01 } else { 0.0005 }
        }),
        ..Setup::random(151, motion)
    };
    let found = calibrated(&setup);
    let rate = found.bias_rate.unwrap();
    for k in 0..6 {
        let error = (rate.value[k] - setup.bias_rate[k]).abs();
        assert!(
            error < 0.05 * setup.bias_rate[k],
            "{k}: {rate:?} {:?}",
            setup.bias_rate
        );
    }
    assert!((found.calibration.payload_mass_kg.value / setup.mass - 1.0).abs() < 1e-3);
}

#[test]
fn a_bias_that_follows_the_temperature_is_told_from_a_drift() {
    let motion = Motion {
        duration_s: 60.0,
        ..Motion::SHAKE
    };
    let sizes: [f64; 6] = [0.08, -0.05, 0.12, 0.003, 0.004, -0.002];
    for seed in 28_000..28_003 {
        let cold = Setup {
            bias_per_kelvin: sizes,
            bias_rate: [0.004, 0.0, -0.003, 0.0, 1e-4, 0.0],
            ..Setup::random(seed, motion)
        };
        let warm = Setup {
            warms_k: 6.0,
            ..cold.clone()
        };
        let found = calibrated(&warm);
        let (rate, slope) = (found.bias_rate.unwrap(), found.bias_per_kelvin.unwrap());
        for (k, size) in sizes.iter().enumerate() {
            let error = (slope.value[k] - size).abs();
            assert!(
                error < 0.05 * size.abs() && error < 4.0 * slope.std[k],
                "{k}: {found}"
            );
            let error = (rate.value[k] - warm.bias_rate[k]).abs();
            assert!(
                error < 4.0 * rate.std[k],
                "{k}: {rate:?} {:?}",
                warm.bias_rate
            );
        }
        assert!(
            (found.calibration.payload_mass_kg.value / warm.mass - 1.0).abs() < 2e-3,
            "{found}"
        );
        // A temperature that stays says nothing, and a sensor without a thermometer neither.
        assert!(calibrated(&cold).bias_per_kelvin.is_none());
        let still = Setup {
            warms_k: 1.0,
            ..warm
        };
        assert!(calibrated(&still).bias_per_kelvin.is_none());
    }
}

#[test]
fn the_sensors_rotation_is_found_when_nobody_knows_it() {
    let options = CalibrateOptions {
        find_rotation: true,
        ..CalibrateOptions::default()
    };
    let (mut worst_deg, mut within_two, mut axes) = (0.0_f64, 0, 0);
    for seed in 31_000..31_012 {
        let motion = match seed % 3 {
            0 => Motion::STILLS,
            _ => Motion {
                duration_s: 20.0,
                ..Motion::SHAKE
            },
        };
        let mut setup = Setup::random(seed, motion);
        if motion.kind == MotionKind::Stills {
            setup.offset_s = 0.0;
        }
        let mut recording = setup.record();
        recording.tcp_from_ft_sensor.quaternion = [0.0, 0.0, 0.0, 1.0];
        let found =
            calibrate(&recording, &options).unwrap_or_else(|error| panic!("{seed}: {error}"));
        let rotation = found.rotation.unwrap();
        let error_deg = rotation.angle_deg(setup.tcp_from_ft_sensor.quaternion);
        let std_deg = rotation
            .std_deg
            .iter()
            .map(|std| std * std)
            .sum::<f64>()
            .sqrt();
        worst_deg = worst_deg.max(error_deg);
        within_two += usize::from(error_deg <= 2.0 * std_deg);
        axes += 1;
        assert!(
            (found.calibration.payload_mass_kg.value / setup.mass - 1.0).abs() < 0.01,
            "{found}"
        );
        for (value, truth) in found
            .calibration
            .payload_com_m
            .value
            .iter()
            .zip(setup.com.iter())
        {
            assert!((value - truth).abs() < 1e-3, "{seed}: {found}");
        }
    }
    println!("simulated: rotation worst {worst_deg:.4} deg; {within_two} of {axes} within 2 std");
    assert!(worst_deg < 0.2, "{worst_deg} deg");
    assert!(within_two + 2 >= axes, "{within_two} of {axes}");
}

#[test]
fn a_rotation_is_not_made_up_from_a_tool_that_only_turns_about_one_axis_or_from_another_shake() {
    let options = CalibrateOptions {
        find_rotation: true,
        ..CalibrateOptions::default()
    };
    let still = Motion {
        turns_rad: 0.005,
        strokes_m: 0.0,
        to_hz: 0.4,
        duration_s: 20.0,
        kind: MotionKind::Shake,
    };
    let lazy = Setup {
        offset_s: 0.0,
        ..Setup::random(29_101, still)
    };
    let text = calibrate(&lazy.record(), &options).unwrap_err().to_string();
    assert!(text.contains("turn") && text.contains("free air"), "{text}");
    let mut other = Setup::random(29_102, Motion::SHAKE).record();
    other.pose = Setup::random(29_103, Motion::SHAKE).record().pose;
    let text = calibrate(&other, &options).unwrap_err().to_string();
    assert!(text.contains("% of the wrench at best"), "{text}");
    // A tracker with a left-handed world.
    let mut mirrored = Setup::random(29_104, Motion::SHAKE).record();
    for sample in &mut mirrored.wrench {
        sample.value[0] = -sample.value[0];
    }
    let text = calibrate(&mirrored, &options).unwrap_err().to_string();
    assert!(text.contains("mirror"), "{text}");
}

#[test]
fn what_is_written_for_later_recordings_has_the_whole_covariance_and_is_read_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let setup = Setup {
        offset_s: 0.0,
        ..Setup::random(34_001, Motion::SHAKE)
    };
    let frames = [transform("tcp", "ft_sensor", &setup.tcp_from_ft_sensor)];
    write_theirs(&setup.record(), &frames, &path("a.mcap"));
    let map = TopicMap::from_arguments([
        "/their/wrench=/ft/wrench",
        "/their/pose=/tcp/pose",
        "/their/frames=/tf_static",
    ]);
    let (toml, out) = (path("calibration.toml"), path("b.mcap"));
    let outputs = Outputs {
        toml: Some(&toml),
        recording: Some(&out),
        ..Outputs::default()
    };
    let options = CalibrateOptions::default();
    let map = map.unwrap();
    let found = calibrate_file(&path("a.mcap"), &map, &options, &outputs).unwrap();
    let covariance = found.calibration.covariance.as_ref().unwrap();
    let com = &found.calibration.payload_com_m;
    assert!((covariance[1][1].sqrt() / com.std[0] - 1.0).abs() < 1e-9);
    // What a tool weighs more is less bias.
    assert!((0..16).any(|k| covariance[0][k] != 0.0 && k != 0));

    // A number that was written as text may differ in its last digit.
    let is_same = |read: &Calibration| {
        let (a, b) = (read.covariance.as_ref().unwrap(), covariance);
        let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-12 * b.abs();
        a.as_flattened().iter().zip(b.as_flattened()).all(near)
            && near((
                &read.payload_mass_kg.value,
                &found.calibration.payload_mass_kg.value,
            ))
    };
    let read = Recording::load(&out, &map).unwrap().calibration;
    assert!(is_same(&read.unwrap()));
    let text = std::fs::read_to_string(&toml).unwrap();
    assert!(text.contains("# Of mass, centre x y z"), "{text}");
    let device = "[[device]]\nname = \"a\"\ndriver = \"pose_stream\"\nport = \"none\"\n";
    std::fs::write(&toml, format!("id = \"a\"\n{device}{text}")).unwrap();
    let config = ft_capture::config::Config::load(&toml).unwrap();
    assert!(is_same(&config.calibration.unwrap()));
}

fn transform(parent: &str, child: &str, pose: &Pose7) -> TransformStamped {
    let mut out = TransformStamped {
        header: Header {
            frame_id: parent.to_owned(),
            ..Header::default()
        },
        child_frame_id: child.to_owned(),
        ..TransformStamped::default()
    };
    out.transform.translation = pose.position.into();
    out.transform.rotation = pose.quaternion.into();
    out
}

/// Writes a recording under other people's names of topics: `/their/wrench`, `/their/pose`, `/their/frames`.
fn write_theirs(recording: &Recording, transforms: &[TransformStamped], path: &Path) {
    let stamps = |at| MessageStamps {
        log_time: at,
        publish_time: at,
    };
    let mut rewrite = Rewrite::new();
    let wrench = recording.wrench.iter().map(|sample| {
        let (header, wrench) = (Header::new(sample.at, "ft_sensor"), sample.value.into());
        (stamps(sample.at), WrenchStamped { header, wrench })
    });
    rewrite.add("/their/wrench", Qos::SENSOR, wrench);
    let poses = recording.pose.samples.iter().map(|sample| {
        let mut message = PoseStamped {
            header: Header::new(sample.at, "world"),
            ..PoseStamped::default()
        };
        message.pose.position = sample.value.position.into();
        message.pose.orientation = sample.value.quaternion.into();
        (stamps(sample.at), message)
    });
    rewrite.add("/their/pose", Qos::SENSOR, poses);
    // Said twice, as latched topics of others are.
    let start = recording.wrench[0].at;
    let message = TFMessage {
        transforms: transforms.to_vec(),
    };
    let later = HostTime::from_nanos(start.as_nanos() + 1_000_000_000);
    let messages = [start, later].map(|at| (stamps(at), message.clone()));
    rewrite.add("/their/frames", Qos::LATCHED, messages);
    let warmth = [(f64::NAN, 0), (31.0, 1), (31.0, 2)].map(|(temperature, second)| {
        let at = HostTime::from_nanos(start.as_nanos() + second * 1_000_000_000);
        let header = Header::new(at, "ft_sensor");
        let message = Temperature {
            header,
            temperature,
            variance: 0.0,
        };
        (stamps(at), message)
    });
    rewrite.add("/ft/temperature", Qos::SENSOR, warmth);
    rewrite.write(None, path, true).unwrap();
}

/// All transforms of a topic, as they stand in the file.
fn transforms_of(path: &Path, topic: &str) -> Vec<Vec<TransformStamped>> {
    let mut reader = RecordReader::open(path).unwrap();
    let (mut channel, mut found) = (None, Vec::new());
    while let Some(record) = reader.next_record().unwrap() {
        match record {
            Record::Channel(one) if one.topic == topic => channel = Some(one.id),
            Record::Message(message) if Some(message.channel_id) == channel => {
                found.push(TFMessage::decode(message.data).unwrap().transforms);
            }
            _ => {}
        }
    }
    found
}

#[test]
fn a_mapped_recording_is_shifted_and_keeps_the_transforms_that_do_not_concern_it() {
    let folder = tempfile::tempdir().unwrap();
    let (source, out) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    let setup = Setup::random(33_001, Motion::SHAKE);
    let recording = setup.record();
    // The sensor hangs below a flange, which is written upside down; and there are frames of others.
    let flange = Pose7 {
        position: [0.0, 0.02, 0.03],
        quaternion: [0.6, 0.0, 0.0, 0.8],
    };
    let wrong = Pose7 {
        quaternion: [0.0, 0.0, 0.0, 1.0],
        ..setup.tcp_from_ft_sensor
    };
    let camera = transform("tcp", "camera", &flange);
    let theirs = [
        camera.clone(),
        transform("flange", "tcp", &flange.inverse()),
        transform(
            "ft_sensor",
            "flange",
            &flange.inverse().then(&wrong).inverse(),
        ),
    ];
    write_theirs(&recording, &theirs, &source);
    let names = [
        "/their/wrench=/ft/wrench",
        "/their/pose=/tcp/pose",
        "/their/frames=/tf_static",
    ];
    let map = TopicMap::from_arguments(names).unwrap();
    let options = CalibrateOptions {
        find_rotation: true,
        ..CalibrateOptions::default()
    };
    let outputs = Outputs {
        recording: Some(&out),
        shift: true,
        ..Outputs::default()
    };
    let found = calibrate_file(&source, &map, &options, &outputs).unwrap();
    let offset_s = found.alignment.unwrap().offset_s;
    assert!((offset_s - setup.offset_s).abs() < 1e-3, "{found}");

    let [before, after] = [&source, &out].map(|path| Recording::load(path, &map).unwrap());
    assert_eq!(before.wrench, after.wrench);
    for (a, b) in before.pose.samples.iter().zip(&after.pose.samples) {
        assert!(
            (b.at.seconds_since(a.at) - offset_s).abs() < 1e-6,
            "{a:?} {b:?}"
        );
        assert_eq!(a.value, b.value);
    }
    let turned = found.rotation.unwrap();
    assert!(
        turned.angle_deg(setup.tcp_from_ft_sensor.quaternion) < 0.2,
        "{found}"
    );
    assert!(turned.angle_deg(after.tcp_from_ft_sensor.quaternion) < 1e-6);
    let apart =
        |k: usize| after.tcp_from_ft_sensor.position[k] - setup.tcp_from_ft_sensor.position[k];
    assert!(
        (0..3).all(|k| apart(k).abs() < 1e-9),
        "{:?}",
        after.tcp_from_ft_sensor
    );

    // Both messages have the new transform of the sensor, in its direction; the others are as they were.
    let said = transforms_of(&out, "/their/frames");
    assert_eq!(said.len(), 2);
    for transforms in said {
        assert_eq!(transforms[..2], theirs[..2]);
        assert_eq!(transforms[2].header.frame_id, "ft_sensor");
        assert_ne!(transforms[2].transform, theirs[2].transform);
        assert_eq!(transforms.len(), 3);
    }
    assert!(transforms_of(&out, "/tf_static").is_empty());
}

#[test]
fn a_thermometer_that_fails_or_speaks_out_of_order_does_no_harm() {
    let motion = Motion {
        duration_s: 60.0,
        ..Motion::SHAKE
    };
    let warm = Setup {
        bias_per_kelvin: [0.08, -0.05, 0.12, 0.003, 0.004, -0.002],
        warms_k: 6.0,
        pose_hz: 200.0,
        ..Setup::random(28_100, motion)
    };
    let good = warm.record();
    let known = calibrate(&good, &CalibrateOptions::default()).unwrap();
    let mut bad = good.clone();
    let failed = |k: usize| Stamped {
        at: bad.temperature[k].at,
        value: f64::NAN,
    };
    let failures: Vec<_> = (0..bad.temperature.len()).step_by(7).map(failed).collect();
    bad.temperature.reverse();
    bad.temperature.extend(failures);
    let found = calibrate(&bad, &CalibrateOptions::default()).unwrap();
    let (a, b) = (
        known.bias_per_kelvin.unwrap(),
        found.bias_per_kelvin.unwrap(),
    );
    for k in 0..6 {
        assert!((a.value[k] - b.value[k]).abs() < 1e-9, "{known}\n{found}");
    }
    // One that only fails is none.
    for sample in &mut bad.temperature {
        sample.value = f64::NAN;
    }
    let found = calibrate(&bad, &CalibrateOptions::default()).unwrap();
    assert!(found.bias_per_kelvin.is_none(), "{found}");
}
