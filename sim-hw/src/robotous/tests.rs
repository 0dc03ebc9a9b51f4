use ft_wire::{CanFrame, Chunk};

use super::can::RobotousCan;
use super::uart::{RobotousUart, packet};
use super::*;
use crate::device::Played;
use crate::random::{Random, Stream};
use crate::scenario::Scenario;

fn scene() -> Scene {
    let mut scene = Scene::new(&Scenario::builtin("drawer_light").unwrap(), 1, None).unwrap();
    scene.advance_to(0.1);
    scene
}

fn rft(interface: Interface) -> Rft {
    let mut spec = Scenario::builtin("drawer_light").unwrap().sensor;
    spec.force_bias_n = 60.0;
    let gauges = WrenchSensor::new(&spec, Random::new(1, Stream::Sensor));
    Rft::new(
        Model::named("RFT64-SB01").unwrap(),
        gauges,
        DeviceClock::new(&spec.clock, 0.0),
        interface,
    )
}

/// What a UART sensor answers to `bytes`.
fn asked(sensor: &mut RobotousUart, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    sensor.receive(100_000_000, &Chunk::new(bytes).unwrap(), &scene(), &mut out);
    out.iter()
        .flat_map(|(_, chunk)| chunk.as_slice().to_vec())
        .collect()
}

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace()
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

fn uart(baud_code: u8) -> RobotousUart {
    RobotousUart::new(rft(Interface::Uart { baud_code }))
}

#[test]
fn a_record_is_packed_as_the_manual_packs_it() {
    // Manual 1.82: raw F = (617, -250, -1001), T = (500, -1000, 2000).
    let mut record = [0; 16];
    record[0] = START;
    for (axis, counts) in [617_i16, -250, -1001, 500, -1000, 2000]
        .into_iter()
        .enumerate()
    {
        record[1 + 2 * axis..3 + 2 * axis].copy_from_slice(&counts.to_be_bytes());
    }
    let golden = "55 0B 02 69 FF 06 FC 17 01 F4 FC 18 07 D0 00 00 00 6E AA";
    assert_eq!(packet(&record).to_vec(), bytes(golden));
}

#[test]
fn the_golden_answers_of_the_manual_come_out() {
    let mut sensor = uart(1);
    let set_rate_1000 = bytes("55 0F 08 00 00 00 00 00 00 17 AA");
    let done = bytes("55 0F 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00 10 AA");
    assert_eq!(asked(&mut sensor, &set_rate_1000), done);
    let out_of_range = bytes("55 0F 00 02 00 00 00 00 00 00 00 00 00 00 00 00 00 11 AA");
    assert_eq!(
        asked(&mut uart(0), &set_rate_1000),
        out_of_range,
        "115200 does not carry 1000 Hz"
    );
    let model = bytes("55 01 00 00 00 00 00 00 00 01 AA");
    let golden = bytes("55 01 52 46 54 36 34 2D 53 42 30 31 00 00 00 00 00 7A AA");
    assert_eq!(asked(&mut sensor, &model), golden);
    let read_rate = bytes("55 10 00 00 00 00 00 00 00 10 AA");
    assert_eq!(asked(&mut sensor, &read_rate)[1..3], [0x10, 8]);
}

#[test]
fn every_uart_rate_carries_what_the_manual_allows() {
    for (baud_code, most) in [(1, 8), (2, 7), (3, 7), (4, 6), (0, 6), (5, 5)] {
        for code in 0..=9_u8 {
            let mut command = vec![0x55, SET_RATE, code, 0, 0, 0, 0, 0, 0];
            command.extend([SET_RATE.wrapping_add(code), 0xAA]);
            let answer = asked(&mut uart(baud_code), &command);
            assert_eq!(
                answer[2] == 1,
                code <= most,
                "baud code {baud_code}, rate code {code}"
            );
        }
    }
}

#[test]
fn while_streaming_only_stop_and_bias_are_executed() {
    let mut sensor = uart(1);
    assert!(asked(&mut sensor, &bytes("55 0B 00 00 00 00 00 00 00 0B AA")).is_empty());
    assert!(sensor.next_event().is_some());
    for command in [
        "55 01 00 00 00 00 00 00 00 01 AA",
        "55 0F 08 00 00 00 00 00 00 17 AA",
        "55 0A 00 00 00 00 00 00 00 0A AA",
    ] {
        assert!(asked(&mut sensor, &bytes(command)).is_empty(), "{command}");
    }
    assert!(asked(&mut sensor, &bytes("55 11 01 00 00 00 00 00 00 12 AA")).is_empty());
    assert!(asked(&mut sensor, &bytes("55 0C 00 00 00 00 00 00 00 0C AA")).is_empty());
    assert!(sensor.next_event().is_none(), "stopped");
    let rate = asked(&mut sensor, &bytes("55 10 00 00 00 00 00 00 00 10 AA"));
    assert_eq!(rate[2], 0, "the rate was not changed while it streamed");
}

#[test]
fn bias_zeroes_the_output_until_it_is_taken_back() {
    let mut sensor = uart(1);
    let once = bytes("55 0A 00 00 00 00 00 00 00 0A AA");
    let force = |record: &[u8]| i16::from_be_bytes([record[6], record[7]]);
    let before = force(&asked(&mut sensor, &once));
    asked(&mut sensor, &bytes("55 11 01 00 00 00 00 00 00 12 AA"));
    let zeroed = force(&asked(&mut sensor, &once));
    asked(&mut sensor, &bytes("55 11 00 00 00 00 00 00 00 11 AA"));
    let after = force(&asked(&mut sensor, &once));
    // Five standard deviations of two samples.
    let scatter = 5.0 * 1.5 * 0.08 * 50.0;
    assert!(
        f64::from(zeroed).abs() < scatter && (f64::from(before) - f64::from(after)).abs() < scatter
    );
    assert!(f64::from(before).abs() > scatter, "{before}");
}

#[test]
fn an_overload_shows_its_axis_and_is_counted() {
    let mut spec = Scenario::builtin("drawer_light").unwrap().sensor;
    spec.force_bias_n = 5000.0;
    let gauges = WrenchSensor::new(&spec, Random::new(1, Stream::Sensor));
    let clock = DeviceClock::new(&spec.clock, 0.0);
    let mut rft = Rft::new(
        Model::named("RFT64-6A01").unwrap(),
        gauges,
        clock,
        Interface::Can,
    );
    let record = rft.record(ONCE, 100_000_000, &scene());
    assert_eq!(record[13] & 0b11_1000, 0b11_1000, "{:#b}", record[13]);
    assert_eq!(
        i16::from_be_bytes([record[1], record[2]]).unsigned_abs(),
        if record[1] & 0x80 == 0 {
            32_767
        } else {
            32_768
        }
    );
    let counters = rft
        .command(0, [OVERLOADS, 0, 0, 0, 0, 0, 0, 0], &scene())
        .unwrap();
    assert_eq!(counters[1..4], [1, 1, 1]);
}

#[test]
fn on_can_a_record_is_a_pair_of_frames_and_foreign_frames_are_not_heard() {
    let mut sensor = RobotousCan::new(rft(Interface::Can));
    let mut out = Vec::new();
    let start = CanFrame::standard(0x64, &[0x0B, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    for foreign in [
        CanFrame::extended(0x64, &[0x0B, 0, 0, 0, 0, 0, 0, 0]),
        CanFrame::standard(0x65, &[0x0B, 0, 0, 0, 0, 0, 0, 0]),
        CanFrame::standard(0x64, &[0x0B]),
    ] {
        sensor.receive(100_000_000, &foreign.unwrap(), &scene(), &mut out);
        assert!(sensor.next_event().is_none());
    }
    sensor.receive(100_000_000, &start, &scene(), &mut out);
    assert!(out.is_empty(), "start has no answer but the stream");
    let due = sensor.next_event().unwrap();
    assert!(
        (due - 105_000_000).abs() < 2000,
        "200 Hz after power-up: {due}"
    );
    sensor.run(due, &scene(), &mut out);
    let ids: Vec<u32> = out
        .iter()
        .map(|(_, frame)| frame.arbitration_id())
        .collect();
    assert_eq!(ids, [1, 2]);
    assert!(out.iter().all(|(_, frame)| frame.payload().len() == 8));
    assert_eq!(out[0].1.payload()[0], 0x0B);
}

#[test]
fn a_broken_command_is_not_executed_and_the_next_one_is() {
    let mut sensor = uart(1);
    let mut stream = bytes("55 0B 00 00 00 00 00 00 00 0C AA 13 55");
    stream.extend(bytes("55 10 00 00 00 00 00 00 00 10 AA"));
    assert_eq!(asked(&mut sensor, &stream)[1], 0x10);
    assert!(sensor.next_event().is_none());
}

#[test]
fn an_rft40_does_not_reach_a_thousand_hertz() {
    let model = Model::named("RFT40-SA01").unwrap();
    assert_eq!(model.rate_code(1000.0), None);
    assert_eq!(model.rates_text(), "10, 20, 50, 100, 200");
}
