use super::*;
use crate::reading::Quality;
use crate::test_support::Bench;

fn sample(status: u8) -> Message {
    Message::Sample(Sample {
        streamed: true,
        raw: [16, -1000, 4112, 0, 5000, -10_000],
        status: Status(status),
    })
}

const PRODUCT: Message = Message::Product {
    model: *b"PFS055YA251U6\0\0\0",
    serial_number: *b"SN123456",
    firmware: *b"1.13",
};
const LIMITS: Message = Message::Limits([500.0, 500.0, 1000.0, 10.0, 10.0, 10.0]);

fn respond(bench: &mut Bench<Leptrino>, message: &Message) {
    let bytes = wire::encode(message);
    bench.bytes(bytes.as_slice()).unwrap();
}

fn expect(bench: &mut Bench<Leptrino>, command: Command) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    assert_eq!(bench.take_sent(), wire::encode_command(command).as_slice());
}

fn starting() -> Bench<Leptrino> {
    let mut bench = Bench::new(Leptrino::new(Config::default()));
    expect(&mut bench, Command::Stop);
    expect(&mut bench, Command::ReadProduct);
    respond(&mut bench, &PRODUCT);
    expect(&mut bench, Command::ReadLimits);
    respond(&mut bench, &LIMITS);
    expect(&mut bench, Command::Start);
    bench
}

fn streaming() -> Bench<Leptrino> {
    let mut bench = starting();
    respond(
        &mut bench,
        &Message::Done {
            number: 0x32,
            result: 0,
        },
    );
    respond(&mut bench, &sample(0));
    bench
}

#[test]
fn set_up_by_the_book_ends_in_samples_of_the_sensors_own_scale() {
    let bench = streaming();
    let identity = Identity {
        model: "PFS055YA251U6".to_owned(),
        serial_number: "SN123456".to_owned(),
        firmware: "1.13".to_owned(),
    };
    assert_eq!(
        bench.events(),
        [
            DeviceEvent::Starting,
            DeviceEvent::Identified(identity),
            DeviceEvent::Scale(vec![
                ("rated_force_n", "500 500 1000".to_owned()),
                ("rated_torque_nm", "10 10 10".to_owned()),
            ]),
            DeviceEvent::Streaming
        ]
    );
    let wrench = bench.wrenches()[0].wrench.to_array();
    assert_eq!(wrench, [0.8, -50.0, 411.2, 0.0, 5.0, -10.0]);
}

#[test]
fn the_answer_to_start_makes_no_stream() {
    let mut bench = starting();
    for _ in 0..3 {
        // The very bytes that were sent, as an echo would bring them.
        let echo = wire::encode_command(Command::Start);
        bench.bytes(echo.as_slice()).unwrap();
        bench.advance_ms(299);
    }
    assert!(!bench.events().contains(&DeviceEvent::Streaming));
    bench.advance_ms(100);
    assert!(bench.complaints()[0].contains("Start was not answered"));
}

#[test]
fn a_stream_still_running_is_drained_with_the_stops_answer() {
    let mut bench = Bench::new(Leptrino::new(Config::default()));
    expect(&mut bench, Command::Stop);
    for _ in 0..20 {
        bench.advance_ms(1);
        respond(&mut bench, &sample(0));
    }
    respond(
        &mut bench,
        &Message::Done {
            number: 0x33,
            result: 0,
        },
    );
    let began = bench.now;
    expect(&mut bench, Command::ReadProduct);
    assert_eq!(bench.now.saturating_since(began), Duration::from_millis(50));
    assert_eq!(bench.wrenches(), []);
}

#[test]
fn a_frame_that_the_sensor_refuses_is_said_again() {
    let mut bench = Bench::new(Leptrino::new(Config::default()));
    expect(&mut bench, Command::Stop);
    expect(&mut bench, Command::ReadProduct);
    respond(&mut bench, &Message::Refused);
    expect(&mut bench, Command::ReadProduct);
}

#[test]
fn a_command_that_fails_is_named() {
    let mut bench = starting();
    respond(
        &mut bench,
        &Message::Done {
            number: 0x32,
            result: 4,
        },
    );
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("refused Start: not in this state (4)"),
        "{complaint}"
    );
}

#[test]
fn status_bits_set_the_quality_and_warn_once() {
    let mut bench = streaming();
    for status in [4, 4, 6, 1] {
        respond(&mut bench, &sample(status));
    }
    let qualities: Vec<_> = bench
        .wrenches()
        .iter()
        .map(|reading| reading.quality)
        .collect();
    use Quality::{Good, Invalid, Overrange};
    assert_eq!(qualities, [Good, Overrange, Overrange, Invalid, Invalid]);
    assert_eq!(bench.complaints().len(), 3);
}

#[test]
fn a_broken_sample_is_one_refused_and_never_delivered() {
    let mut bench = streaming();
    let mut broken = wire::encode(&sample(0)).as_slice().to_vec();
    broken[9] ^= 1;
    assert!(bench.bytes(&broken).is_err());
    respond(&mut bench, &sample(0));
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (2, 1));
    assert_eq!(counts.skipped as usize, broken.len());
}

#[test]
fn a_listener_takes_the_limits_that_pass_by_and_none_gives_no_sample() {
    let listen = Config {
        startup: Startup::Listen,
        ..Config::default()
    };
    let mut bench = Bench::new(Leptrino::new(listen));
    bench.advance_ms(1);
    respond(&mut bench, &sample(0));
    assert_eq!(bench.wrenches(), []);
    respond(&mut bench, &LIMITS);
    respond(&mut bench, &sample(0));
    assert_eq!(bench.wrenches().len(), 1);
}

#[test]
fn a_stream_that_falls_silent_is_lost_after_500_ms() {
    let mut bench = streaming();
    let silent = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(silent, Duration::from_millis(500));
}
