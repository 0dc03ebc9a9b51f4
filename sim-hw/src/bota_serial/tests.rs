use super::*;
use crate::random::{Random, Stream};
use crate::scenario::Scenario;

fn scene() -> Scene {
    let mut scene = Scene::new(&Scenario::builtin("wood_door").unwrap(), 1, None).unwrap();
    scene.advance_to(0.1);
    scene
}

fn sensor() -> BotaSerial {
    let spec = Scenario::builtin("wood_door").unwrap().sensor;
    let clock = DeviceClock::new(&spec.clock, 0.0);
    BotaSerial::new(
        WrenchSensor::new(&spec, Random::new(1, Stream::Sensor)),
        clock,
        spec.rate_hz,
    )
}

fn said(out: &Outbox<Chunk>) -> Vec<u8> {
    out.iter()
        .flat_map(|(_, chunk)| chunk.as_slice().to_vec())
        .collect()
}

/// Sends `text` one character every 5 ms from `at` on; what the sensor says by itself is left out.
fn told(sensor: &mut BotaSerial, at: SimNanos, text: &str) -> String {
    let mut out = Vec::new();
    for (index, byte) in text.bytes().enumerate() {
        let at = at + 5_000_000 * index as i64;
        sensor.receive(at, &Chunk::new(&[byte]).unwrap(), &scene(), &mut out);
    }
    String::from_utf8(said(&out)).unwrap()
}

/// Lets the sensor do what it does by itself until `until`.
fn played(sensor: &mut BotaSerial, until: SimNanos) -> Vec<u8> {
    let (scene, mut out) = (scene(), Vec::new());
    while let Some(at) = sensor.next_event().filter(|at| *at <= until) {
        sensor.run(at, &scene, &mut out);
    }
    said(&out)
}

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

#[test]
fn the_golden_frames_come_out() {
    // Computed from the maker's layout; see the module's source.
    let frame = encode(0, [1.0, -2.0, 3.5, 0.1, -0.2, 0.3], 1_000_000_000, 25.0);
    let golden = "AA 00 00 00 00 80 3F 00 00 00 C0 00 00 60 40 CD CC CC 3D CD CC 4C BE 9A 99 99 3E 40 42 0F 00 00 00 C8 41 CB E7";
    assert_eq!(frame, bytes(golden));
    let wrapping = encode(
        2,
        [10.0, 20.0, -30.0, 0.5, -0.25, 0.125],
        4_294_967_295_999,
        31.5,
    );
    let golden = "AA 02 00 00 00 20 41 00 00 A0 41 00 00 F0 C1 00 00 00 3F 00 00 80 BE 00 00 00 3E FF FF FF FF 00 00 FC 41 E9 2B";
    assert_eq!(wrapping, bytes(golden));
    assert_eq!(encode(0, [0.0; 6], 0, 0.0)[35..], [0x6A, 0xE2]);
}

#[test]
fn the_timestamp_wraps_after_2_to_the_32_microseconds() {
    assert_eq!(
        encode(0, [0.0; 6], 4_294_967_296_000, 0.0)[27..31],
        [0, 0, 0, 0]
    );
    let mut sensor = sensor();
    // The default scenario reads 4280.967296 s at the start: 14 s before the wrap.
    let scene = scene();
    let mut stamps = Vec::new();
    while let Some(at) = sensor.next_event().filter(|at| *at < 15_000_000_000) {
        let mut out = Vec::new();
        sensor.run(at, &scene, &mut out);
        let frame = said(&out);
        stamps.push(u32::from_le_bytes([
            frame[27], frame[28], frame[29], frame[30],
        ]));
    }
    let wraps = stamps.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert_eq!(wraps, 1);
    assert!(
        stamps
            .windows(2)
            .all(|pair| (1249..=1251).contains(&pair[1].wrapping_sub(pair[0])))
    );
}

#[test]
fn it_streams_from_the_start_and_stops_for_config_mode() {
    let mut sensor = sensor();
    assert_eq!(played(&mut sensor, 10_000_000).len() % FRAME_LENGTH, 0);
    assert_eq!(told(&mut sensor, 11_000_000, "C"), "r,0,C,0\r\n");
    assert!(played(&mut sensor, 100_000_000).is_empty());
    assert_eq!(told(&mut sensor, 101_000_000, "f,256,0,0,1"), "r,0,f,0\r\n");
    assert_eq!(told(&mut sensor, 201_000_000, "R"), "r,0,R,0\r\n");
    let a_second = played(&mut sensor, 1_201_000_000).len() / FRAME_LENGTH;
    assert!(
        (199..=201).contains(&a_second),
        "sinc 256 is 200 Hz: {a_second}"
    );
}

#[test]
fn while_frames_flow_config_commands_are_not_heard() {
    let mut sensor = sensor();
    assert_eq!(told(&mut sensor, 1_000_000, "f,512,0,0,1"), "");
    assert_eq!(sensor.settings.sinc, 64);
    assert_eq!(told(&mut sensor, 900_000_000, "C"), "r,0,C,0\r\n");
    assert_eq!(
        told(&mut sensor, 901_000_000, "f,20,0,0,1"),
        "r,0,f,1\r\n",
        "sinc below 51"
    );
    assert_eq!(
        told(&mut sensor, 990_000_000, "c,0,1,1,4"),
        "r,0,c,1\r\n",
        "CSV is not played"
    );
}

#[test]
fn a_reset_prints_who_it_is_and_comes_back_as_it_was_saved() {
    let mut sensor = sensor();
    told(&mut sensor, 0, "C");
    told(&mut sensor, 10_000_000, "f,512,0,0,1");
    assert_eq!(told(&mut sensor, 90_000_000, "#"), "", "no ack");
    let text = String::from_utf8(played(&mut sensor, 690_000_000)).unwrap();
    assert_eq!(
        text,
        "c,0,1,0,4\r\nApp Init\r\nname: BFT-SENS-SER-M8\r\nS/N: 000417\r\nFW version: 2.1.4\r\n"
    );
    assert_eq!(
        (sensor.mode, sensor.settings.sinc),
        (Mode::Run, 64),
        "512 was not saved"
    );
    told(&mut sensor, 700_000_000, "C");
    told(&mut sensor, 710_000_000, "c,0,1,0,3");
    assert_eq!(told(&mut sensor, 790_000_000, "s"), "r,0,s,0\r\n");
    assert_eq!(sensor.line_rate(), Some(460_800), "until the reset");
    told(&mut sensor, 800_000_000, "#");
    played(&mut sensor, 1_500_000_000);
    assert_eq!(sensor.line_rate(), Some(230_400));
}

#[test]
fn a_line_that_is_too_slow_skips_samples_and_says_so() {
    let mut sensor = sensor();
    sensor.baud_code = 3;
    let frames = played(&mut sensor, 1_000_000_000);
    let count = frames.len() / FRAME_LENGTH;
    assert!(
        (395..=405).contains(&count),
        "37 bytes take 1.6 ms at 230400, two periods of 1.25 ms: {count}"
    );
    let late = frames
        .chunks(FRAME_LENGTH)
        .filter(|frame| frame[1] & 1 == 1)
        .count();
    assert!(late > 390, "{late}");
}

#[test]
fn beyond_its_range_the_status_says_so() {
    let mut spec = Scenario::builtin("wood_door").unwrap().sensor;
    spec.force_bias_n = 5000.0;
    let gauges = WrenchSensor::new(&spec, Random::new(1, Stream::Sensor));
    let mut sensor = BotaSerial::new(gauges, DeviceClock::new(&spec.clock, 0.0), 800.0);
    assert_eq!(played(&mut sensor, 2_000_000)[1], 2);
}

#[test]
fn an_unfinished_command_is_forgotten_after_a_second() {
    let mut sensor = sensor();
    told(&mut sensor, 0, "C");
    assert_eq!(told(&mut sensor, 10_000_000, "f,25"), "");
    assert_eq!(
        told(&mut sensor, 1_500_000_000, "f,128,0,0,1"),
        "r,0,f,0\r\n"
    );
    assert_eq!(sensor.settings.sinc, 128);
}
