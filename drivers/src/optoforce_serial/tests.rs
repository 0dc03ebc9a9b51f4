use std::time::Duration;

use ft_wire::optoforce_hex::{Command, Packet, Sample, Settings, Status};

use super::*;
use crate::options::{Sign, Startup};
use crate::optoforce::Scale;
use crate::reading::{DeviceEvent, Identity, Quality};
use crate::test_support::Bench;

const SETTINGS: Settings = Settings {
    period_ms: 3,
    filter: 0,
    zero: 0,
};

fn config() -> Config {
    Config::new(Scale {
        counts_per_newton: [10.0, 20.0, 5.0],
        counts_per_newton_metre: [100.0, 200.0, 50.0],
    })
}

fn sample(counter: u16) -> Vec<u8> {
    with_status(counter, 0)
}

fn with_status(counter: u16, status: u16) -> Vec<u8> {
    let sample = Sample {
        counter,
        status: Status(status),
        force: [100, -200, 300],
        torque: Some([-50, 60, -70]),
    };
    wire::encode(&Packet::Sample(sample)).as_slice().to_vec()
}

fn bench(config: Config) -> Bench<OptoforceSerial> {
    Bench::new(OptoforceSerial::new(config))
}

fn listening() -> Bench<OptoforceSerial> {
    let mut bench = bench(Config {
        startup: Startup::Listen,
        ..config()
    });
    bench.advance_ms(1);
    bench
}

fn expect(bench: &mut Bench<OptoforceSerial>, command: Command) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    assert_eq!(bench.take_sent(), wire::encode_command(command).as_slice());
}

fn respond(bench: &mut Bench<OptoforceSerial>, packet: &Packet) {
    let bytes = wire::encode(packet);
    bench.bytes(bytes.as_slice()).unwrap();
}

fn stop() -> Command {
    Command::Configure(Settings {
        period_ms: 0,
        ..SETTINGS
    })
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let mut bench = bench(config());
    expect(&mut bench, stop());
    expect(&mut bench, Command::ReadSerialNumber);
    respond(&mut bench, &Packet::SerialNumber(*b"HEX12345"));
    expect(&mut bench, Command::Configure(SETTINGS));
    respond(&mut bench, &Packet::Configured { error: 0 });
    bench.bytes(&sample(7)).unwrap();
    let identity = Identity {
        model: "HEX".to_owned(),
        serial_number: "HEX12345".to_owned(),
        firmware: String::new(),
    };
    assert_eq!(
        bench.events(),
        [
            DeviceEvent::Starting,
            DeviceEvent::Identified(identity),
            DeviceEvent::Streaming
        ]
    );
    let [reading] = bench.wrenches()[..] else {
        panic!("one sample")
    };
    assert_eq!(
        reading.wrench.to_array(),
        [10.0, -10.0, 60.0, -0.5, 0.3, -1.4]
    );
    assert_eq!(reading.at.device_ns, Some(21_000_000));
}

#[test]
fn a_sensor_that_says_no_name_is_set_up_all_the_same() {
    let mut bench = bench(config());
    expect(&mut bench, stop());
    for _ in 0..3 {
        expect(&mut bench, Command::ReadSerialNumber);
    }
    expect(&mut bench, Command::Configure(SETTINGS));
    // The answer went astray; the samples show that it was taken.
    bench.bytes(&sample(1)).unwrap();
    assert_eq!(bench.wrenches().len(), 1);
    assert_eq!(bench.complaints(), [""; 0]);
}

#[test]
fn a_refused_configuration_is_named_and_tried_again() {
    let mut bench = bench(config());
    expect(&mut bench, stop());
    expect(&mut bench, Command::ReadSerialNumber);
    respond(&mut bench, &Packet::SerialNumber(*b"A       "));
    expect(&mut bench, Command::Configure(SETTINGS));
    respond(&mut bench, &Packet::Configured { error: 3 });
    assert!(
        bench.complaints()[0].contains("error 3"),
        "{:?}",
        bench.complaints()
    );
    bench.advance_ms(999);
    assert_eq!(bench.take_sent(), []);
    expect(&mut bench, stop());
}

#[test]
fn a_rate_that_the_sensor_has_not_is_named() {
    let mut bench = bench(Config {
        rate_hz: 200,
        ..config()
    });
    expect(&mut bench, stop());
    expect(&mut bench, Command::ReadSerialNumber);
    respond(&mut bench, &Packet::SerialNumber(*b"A       "));
    assert!(
        bench.complaints()[0].contains("rate_hz = 200"),
        "{:?}",
        bench.complaints()
    );
}

#[test]
fn a_stream_still_running_is_drained_and_not_delivered() {
    let mut bench = bench(config());
    expect(&mut bench, stop());
    for counter in 0..20 {
        bench.advance_ms(3);
        bench.bytes(&sample(counter)).unwrap();
    }
    let began = bench.now;
    expect(&mut bench, Command::ReadSerialNumber);
    assert_eq!(
        bench.now.saturating_since(began),
        Duration::from_millis(120)
    );
    assert_eq!(bench.wrenches(), []);
    assert_eq!(bench.device.counts(), Counts::default());
}

#[test]
fn the_counter_shows_gaps_duplicates_and_its_wrap() {
    let mut bench = listening();
    let kept = (0..40_u16).filter(|index| ![25, 26, 30].contains(index));
    for index in kept.chain([39]) {
        bench.advance_ms(3);
        bench
            .bytes(&sample(65_520_u16.wrapping_add(index)))
            .unwrap();
    }
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.gaps, counts.duplicated),
        (37, 3, 1)
    );
    let stamps: Vec<_> = bench
        .wrenches()
        .iter()
        .filter_map(|reading| reading.at.device_ns)
        .collect();
    assert!(stamps.windows(2).all(|pair| pair[0] < pair[1]));
}

#[test]
fn a_counter_that_begins_anew_is_a_warning_and_no_gap() {
    let mut bench = listening();
    for counter in (30_000..30_030).chain(0..30) {
        bench.advance_ms(3);
        bench.bytes(&sample(counter)).unwrap();
    }
    assert_eq!(bench.device.counts().gaps, 0);
    assert_eq!(bench.complaints().len(), 1);
    assert!(bench.complaints()[0].contains("began anew"));
}

#[test]
fn overload_and_trouble_set_the_quality_and_warn_once() {
    let mut bench = listening();
    for (counter, status) in [(0, 0), (1, 0x0200), (2, 0x0200), (3, 0x0400), (4, 0x2000)] {
        bench.advance_ms(3);
        bench.bytes(&with_status(counter, status)).unwrap();
    }
    let qualities: Vec<_> = bench
        .wrenches()
        .iter()
        .map(|reading| reading.quality)
        .collect();
    assert_eq!(
        qualities,
        [
            Quality::Good,
            Quality::Overrange,
            Quality::Overrange,
            Quality::Invalid,
            Quality::Invalid
        ]
    );
    let complaints = bench.complaints();
    assert_eq!(complaints.len(), 3, "{complaints:?}");
    assert!(complaints[0].starts_with("Fx beyond"), "{complaints:?}");
}

#[test]
fn three_axes_make_no_wrench() {
    let mut bench = listening();
    let sample = Sample {
        counter: 1,
        status: Status(0),
        force: [1, 2, 3],
        torque: None,
    };
    for _ in 0..3 {
        respond(&mut bench, &Packet::Sample(sample));
    }
    assert_eq!(bench.wrenches(), []);
    let complaints = bench.complaints();
    assert_eq!(complaints.len(), 1, "{complaints:?}");
    assert!(complaints[0].contains("three axes"));
}

#[test]
fn a_broken_sample_is_one_refused_and_never_delivered() {
    let mut bench = listening();
    bench.bytes(&sample(0)).unwrap();
    let mut broken = sample(1);
    broken[9] ^= 4;
    bench.advance_ms(3);
    assert!(bench.bytes(&broken).is_err());
    bench.advance_ms(3);
    bench.bytes(&sample(2)).unwrap();
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.refused, counts.skipped),
        (2, 1, 22)
    );
}

#[test]
fn a_stream_that_falls_silent_is_lost_after_500_ms_and_the_sign_can_be_turned() {
    let mut bench = bench(Config {
        startup: Startup::Listen,
        sign: Sign::ToolOnEnvironment,
        ..config()
    });
    bench.advance_ms(1);
    bench.bytes(&sample(0)).unwrap();
    assert_eq!(bench.wrenches()[0].wrench.force, [-10.0, 10.0, -60.0]);
    let silent = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(silent, Duration::from_millis(500));
}
