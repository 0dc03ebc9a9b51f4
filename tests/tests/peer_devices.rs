//! `ft-sim-hw serve`: a program of other people's making reads each simulated device from its maker's table.
//!
//! The scripts use pyserial and nothing of this project. Devices on CAN are not read here: that wants a kernel with `vcan`.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, ChildStdout, Stdio};
use std::sync::{Mutex, PoisonError};

use ft_tests::{peers, programs};
use serde_json::Value;
use tempfile::tempdir;

const TEST: &str = "peer_devices";
const WEIGHT_N: f64 = 0.49 * 9.80665;
/// What the script listens; the gripper is turned in free air for longer.
const SECONDS: &str = "1.5";

/// The program that plays the devices, and its output, which must stay open; ended with the test.
struct Served {
    child: Child,
    _output: BufReader<ChildStdout>,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Plays a door with this sensor and this encoder, and gives the port of `device`.
fn serve(sensor: &str, gripper: &str, device: &str, folder: &Path) -> (Served, String) {
    let arguments = [
        "serve",
        "wood_door",
        "--sensor",
        sensor,
        "--gripper",
        gripper,
        "--duration",
        "60",
        "--truth",
        "truth.json",
    ];
    let mut command = programs::command("ft-sim-hw", &arguments, folder);
    let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
    let mut output = BufReader::new(child.stdout.take().unwrap());
    let port = output
        .by_ref()
        .lines()
        .map_while(Result::ok)
        .find_map(|line| {
            let words: Vec<_> = line.split_whitespace().collect();
            (words.get(1) == Some(&device)).then(|| words[2].to_owned())
        })
        .unwrap();
    let served = Served {
        child,
        _output: output,
    };
    (served, port)
}

/// What the script says of `device`; `None` without Python.
fn read(sensor: &str, gripper: &str, device: &str) -> Option<(Value, Value)> {
    // One at a time: each is a real-time affair of two programs.
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    peers::python(TEST)?;
    let folder = tempdir().unwrap();
    let (_served, port) = serve(sensor, gripper, device, folder.path());
    let finished = peers::run(TEST, "read_device.py", &[device, &port, SECONDS])?;
    assert_eq!(finished.code, Some(0), "{device}: {}", finished.stderr);
    let truth = std::fs::read_to_string(folder.path().join("truth.json")).unwrap();
    let read: Value = serde_json::from_str(&finished.stdout).unwrap();
    // A machine that keeps the reader waiting costs bytes, and each hole spoils a frame.
    let (bad, good) = (read["bad"].as_u64().unwrap(), samples(&read).len() as u64);
    assert!(
        bad * 50 <= good,
        "{device}: {bad} wrong checks among {good}"
    );
    Some((read, serde_json::from_str(&truth).unwrap()))
}

fn numbers(value: &Value) -> Vec<f64> {
    let all = value.as_array().unwrap().iter();
    all.map(|number| number.as_f64().unwrap()).collect()
}

fn samples(read: &Value) -> Vec<Vec<f64>> {
    read["samples"]
        .as_array()
        .unwrap()
        .iter()
        .map(numbers)
        .collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

#[test]
fn every_serial_sensor_reads_the_tools_weight_to_a_strangers_program() {
    for (sensor, rate_hz) in [
        ("bota_serial", 800.0),
        ("robotous_uart", 1000.0),
        ("optoforce_serial", 1000.0),
        ("kunwei_kwr75", 1000.0),
        ("leptrino", 1200.0),
    ] {
        let Some((read, truth)) = read(sensor, "dynamixel", sensor) else {
            return;
        };
        let bias = numbers(&truth["sensor_errors"]["bias"]);
        let force = |sample: &Vec<f64>| {
            let square = |axis: usize| (sample[axis] - bias[axis]).powi(2);
            (0..3).map(square).sum::<f64>().sqrt()
        };
        let samples = samples(&read);
        let weight = median(samples.iter().map(force).collect());
        assert!((weight - WEIGHT_N).abs() < 0.1, "{sensor}: {weight} N");
        // Wide, because a busy machine may keep the reader waiting.
        let expected = 1.5 * rate_hz;
        let count = samples.len() as f64;
        assert!(
            (0.7 * expected..1.3 * expected).contains(&count),
            "{sensor}: {count}"
        );
    }
}

#[test]
fn every_encoder_reads_the_same_jaw_to_a_strangers_program() {
    let mut angles = Vec::new();
    for gripper in ["dynamixel", "amt21", "encoder_line"] {
        let Some((read, _)) = read("bota_serial", gripper, gripper) else {
            return;
        };
        let samples = samples(&read);
        assert!(samples.len() > 30, "{gripper}: {}", samples.len());
        angles.push(median(samples.iter().map(|sample| sample[0]).collect()));
    }
    // A count of a Dynamixel is 0.09 degrees.
    assert!(
        angles.iter().all(|angle| (angle - angles[0]).abs() < 0.2),
        "{angles:?}"
    );
}

#[test]
fn the_tracker_sends_unit_quaternions_to_a_strangers_program() {
    let Some((read, _)) = read("bota_serial", "dynamixel", "pose_stream") else {
        return;
    };
    let samples = samples(&read);
    assert!(samples.len() > 500, "{}", samples.len());
    for sample in samples {
        let norm = sample[3..].iter().map(|part| part * part).sum::<f64>();
        assert!((norm - 1.0).abs() < 1e-6, "{sample:?}");
    }
}
