use ft_wire::dynamixel2::Params;

use super::*;
use crate::test_support::Bench;

fn status(error: u8, params: &[u8]) -> Vec<u8> {
    let params = Params::new(params).unwrap();
    wire::encode(&Packet::Status {
        id: 1,
        error: StatusError(error),
        params,
    })
    .as_slice()
    .to_vec()
}

fn present(position: i32, velocity: i32) -> Vec<u8> {
    status(
        0,
        &PresentState {
            current: 0,
            velocity,
            position,
        }
        .encode(),
    )
}

fn bench() -> Bench<Dynamixel> {
    Bench::new(Dynamixel::new(Config::default()))
}

fn expect(bench: &mut Bench<Dynamixel>, packet: Packet) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    assert_eq!(
        bench.take_sent(),
        wire::encode(&packet).as_slice(),
        "{packet:?}"
    );
}

fn read() -> Packet {
    Packet::read(1, 126, 10)
}

/// Takes a driver by the book to its first read.
fn reading() -> Bench<Dynamixel> {
    let mut bench = bench();
    expect(&mut bench, Packet::ping(1));
    bench.bytes(&status(0, &[0xFC, 0x03, 0x2D])).unwrap();
    expect(&mut bench, Packet::write(1, 64, &[0]).unwrap());
    bench.bytes(&status(0, &[])).unwrap();
    expect(&mut bench, read());
    bench
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let mut bench = reading();
    bench.advance_ms(6);
    bench.bytes(&present(2048, 5)).unwrap();
    let identity = Identity {
        model: "XM430-W350".to_owned(),
        serial_number: String::new(),
        firmware: "45".to_owned(),
    };
    let expected = [
        DeviceEvent::Starting,
        DeviceEvent::Identified(identity),
        DeviceEvent::Streaming,
    ];
    assert_eq!(bench.events(), expected);
    let [sample] = bench.widths()[..] else {
        panic!()
    };
    assert_eq!(
        (sample.counts, sample.at.arrival, sample.at.device_ns),
        (2048, bench.now, None)
    );
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn reads_keep_their_period_whenever_the_answers_come() {
    let mut bench = reading();
    let mut asked_at = Vec::new();
    for delay_ms in [6, 2, 8, 1, 7, 3] {
        bench.advance_ms(delay_ms);
        bench.bytes(&present(1_000, 0)).unwrap();
        bench.advance_until(|bench| !bench.sent.is_empty());
        asked_at.push(bench.sent.remove(0).0);
    }
    let steps: Vec<_> = asked_at
        .windows(2)
        .map(|pair| pair[1].saturating_since(pair[0]).as_millis())
        .collect();
    assert_eq!(steps, [10; 5]);
}

#[test]
fn an_unanswered_read_is_one_gap_and_overdue_reads_are_not_caught_up() {
    let mut bench = reading();
    bench.advance_ms(5);
    bench.bytes(&present(1_000, 0)).unwrap();
    expect(&mut bench, read());
    let asked = bench.now;
    expect(&mut bench, read());
    assert_eq!(bench.now.saturating_since(asked), Duration::from_millis(30));
    bench.bytes(&present(1_000, 0)).unwrap();
    let asked = bench.now;
    expect(&mut bench, read());
    assert_eq!(bench.now.saturating_since(asked), Duration::from_millis(10));
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 2,
            gaps: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn our_own_echo_is_passed_over() {
    let mut bench = reading();
    for _ in 0..5 {
        let mut bytes = wire::encode(&read()).as_slice().to_vec();
        bytes.extend(present(1_000, 0));
        bench.bytes(&bytes).unwrap();
        expect(&mut bench, read());
    }
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 5,
            ..Counts::default()
        }
    );
}

#[test]
fn a_broken_answer_is_refused_and_a_gap() {
    let mut bench = reading();
    bench.bytes(&present(1_000, 0)).unwrap();
    expect(&mut bench, read());
    let mut broken = present(1_001, 0);
    broken[12] ^= 8;
    assert!(matches!(
        bench.bytes(&broken),
        Err(DecodeError::Checksum { .. })
    ));
    expect(&mut bench, read());
    bench.bytes(&present(1_002, 0)).unwrap();
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused, counts.gaps), (2, 1, 1));
}

#[test]
fn an_answer_of_another_length_is_refused() {
    let mut bench = reading();
    let short = bench.bytes(&status(0, &[1, 2, 3]));
    assert_eq!(
        short,
        Err(DecodeError::Length {
            expected: 10,
            got: 3
        })
    );
    assert_eq!(bench.device.counts().refused, 1);
}

#[test]
fn an_answer_cut_in_two_is_one_sample_at_its_last_byte() {
    let mut bench = reading();
    let answer = present(1_000, 0);
    bench.bytes(&answer[..9]).unwrap();
    bench.advance_ms(3);
    bench.bytes(&answer[9..]).unwrap();
    assert_eq!(bench.widths()[0].at.arrival, bench.now);
}

#[test]
fn another_actuator_on_the_line_is_not_listened_to() {
    let mut bench = reading();
    let params = Params::new(&[0; 10]).unwrap();
    let foreign = wire::encode(&Packet::Status {
        id: 2,
        error: StatusError(0),
        params,
    });
    bench.bytes(foreign.as_slice()).unwrap();
    assert_eq!(bench.widths(), []);
}

#[test]
fn a_missing_actuator_is_asked_three_times_then_lost_then_tried_again() {
    let mut bench = bench();
    let lost = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert!((108..=112).contains(&lost.as_millis()), "{lost:?}");
    assert_eq!(bench.sent.len(), 3);
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("id 1 left Ping unanswered for 30ms, 3 times"),
        "{complaint}"
    );
    bench.sent.clear();
    bench.advance_ms(1_000);
    expect(&mut bench, Packet::ping(1));
}

#[test]
fn ten_unanswered_reads_in_a_row_are_lost() {
    let mut bench = reading();
    bench.bytes(&present(1_000, 0)).unwrap();
    bench.advance_until(|bench| !bench.complaints().is_empty());
    assert!(
        bench.complaints()[0].contains("left 10 reads in a row unanswered"),
        "{:?}",
        bench.complaints()
    );
    assert_eq!(bench.device.counts().gaps, 10);
    bench.sent.clear();
    bench.advance_ms(1_000);
    expect(&mut bench, Packet::ping(1));
}

#[test]
fn a_refused_torque_off_is_lost() {
    let mut bench = bench();
    expect(&mut bench, Packet::ping(1));
    bench.bytes(&status(0, &[0x04, 0x04, 0x26])).unwrap();
    bench.bytes(&status(7, &[])).unwrap();
    assert_eq!(bench.complaints(), ["id 1 refused TorqueOff with error 7"]);
}

#[test]
fn a_hardware_alert_warns_once() {
    let mut bench = reading();
    for _ in 0..3 {
        let block = PresentState {
            current: 0,
            velocity: 0,
            position: 1,
        }
        .encode();
        bench.bytes(&status(0x80, &block)).unwrap();
        expect(&mut bench, read());
    }
    assert_eq!(bench.widths().len(), 3);
    assert_eq!(bench.complaints().len(), 1);
    assert!(bench.complaints()[0].contains("hardware alert"));
}

#[test]
fn a_listener_reads_along_and_sends_nothing() {
    let config = Config {
        startup: Startup::Listen,
        ..Config::default()
    };
    let mut bench = Bench::new(Dynamixel::new(config));
    bench.advance_ms(100);
    for bytes in [
        status(0, &[0xFC, 0x03, 0x2D]),
        status(0, &[]),
        present(1_000, 0),
    ] {
        bench.bytes(&bytes).unwrap();
    }
    assert_eq!(
        (
            bench.widths().len(),
            bench.sent.len(),
            bench.device.counts().refused
        ),
        (1, 0, 0)
    );
}

#[test]
fn the_linkage_gives_the_hoi_grippers_widths() {
    // Computed with an independent script from the formula of the gripper's own tools.
    for (degrees, width_m) in [(106.0_f64, 0.129275), (151.5, 0.049363), (197.0, 0.017421)] {
        let width = Linkage::HOI.width_m(degrees.to_radians());
        assert!((width - width_m).abs() < 1e-6, "{degrees} deg: {width}");
    }
}

#[test]
fn the_width_rate_is_the_slope_of_the_width() {
    for degrees in [90.0_f64, 106.0, 140.0, 197.0] {
        let (angle, step) = (degrees.to_radians(), 1e-6);
        let numeric = (Linkage::HOI.width_m(angle + step) - Linkage::HOI.width_m(angle - step))
            / (2.0 * step);
        let slope = Linkage::HOI.width_slope_m_per_rad(angle);
        assert!(
            (slope - numeric).abs() < 1e-8,
            "{degrees} deg: {slope} {numeric}"
        );
    }
}

#[test]
fn a_port_where_something_streams_is_given_up_and_told() {
    let mut bench = bench();
    bench.advance_ms(1);
    for _ in 0..100 {
        bench.bytes(&[0x55; 8]).unwrap();
        bench.advance_ms(10);
    }
    assert!(bench.take_sent().is_empty());
    let events = bench.events();
    let told = |event: &DeviceEvent| matches!(event, DeviceEvent::Lost { reason } if reason.contains("another device"));
    assert!(events.iter().any(told), "{events:?}");
}
