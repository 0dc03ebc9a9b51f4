use std::time::Duration;

use ft_wire::robotous_rft::{Command, FilterSetting, Record, Response, Text};

use super::*;
use crate::options::Startup;
use crate::test_support::Bench;

const RECORD: Record = Record {
    force: [617, -250, -1001],
    torque: [500, -1000, 2000],
    overload: 0,
};

fn stream(index: i16) -> [u8; wire::RESPONSE_LEN] {
    wire::encode_response(&Response::Stream(Record {
        force: [index, 0x5555, 0x55AA],
        ..RECORD
    }))
}

fn listening() -> Bench<RobotousUart> {
    let mut config = Config::default();
    config.sensor.startup = Startup::Listen;
    let mut bench = Bench::new(RobotousUart::new(config));
    bench.advance_ms(1);
    bench
}

fn expect(bench: &mut Bench<RobotousUart>, command: Command) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    assert_eq!(
        bench.take_sent(),
        wire::encode_command(command),
        "{command:?}"
    );
}

fn respond(bench: &mut Bench<RobotousUart>, response: Response) {
    bench.bytes(&wire::encode_response(&response)).unwrap();
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let mut bench = Bench::new(RobotousUart::new(Config::default()));
    expect(&mut bench, Command::Stop);
    // The end of a stream, half a packet included.
    bench.advance_ms(3);
    bench
        .bytes(&[&stream(1)[..], &stream(2)[..9]].concat())
        .unwrap();
    expect(&mut bench, Command::ReadModel);
    respond(
        &mut bench,
        Response::Model(Text::new("RFT60-HA01").unwrap()),
    );
    expect(&mut bench, Command::ReadSerialNumber);
    respond(&mut bench, Response::SerialNumber(Text::new("1").unwrap()));
    expect(&mut bench, Command::ReadFirmware);
    respond(&mut bench, Response::Firmware(Text::new("2").unwrap()));
    expect(&mut bench, Command::ReadRate);
    // 200 Hz has two codes.
    respond(&mut bench, Response::Rate(0));
    expect(&mut bench, Command::ReadFilter);
    respond(
        &mut bench,
        Response::Filter(FilterSetting { kind: 0, code: 7 }),
    );
    expect(&mut bench, Command::Start);
    respond(&mut bench, Response::Stream(RECORD));
    assert_eq!(
        bench.wrenches()[0].wrench.to_array(),
        [12.34, -5.0, -20.02, 0.25, -0.5, 1.0]
    );
    assert_eq!(bench.complaints(), Vec::<String>::new());
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn chunks_cut_anywhere_give_the_same_samples() {
    let bytes: Vec<_> = (0..60).flat_map(stream).collect();
    for size in [1, 5, 18, 19, 20, 256] {
        let mut bench = listening();
        for chunk in bytes.chunks(size) {
            bench.bytes(chunk).unwrap();
        }
        let first: Vec<_> = bench
            .wrenches()
            .iter()
            .map(|reading| reading.wrench.force[0])
            .collect();
        assert_eq!(
            first,
            (0..60)
                .map(|index| f64::from(index) / 50.0)
                .collect::<Vec<_>>(),
            "chunks of {size}"
        );
        assert_eq!(
            bench.device.counts(),
            Counts {
                received: 60,
                ..Counts::default()
            }
        );
    }
}

#[test]
fn a_broken_packet_is_refused_once_and_the_next_one_found() {
    let mut bench = listening();
    bench.bytes(&stream(1)).unwrap();
    let mut broken = stream(2);
    broken[5] ^= 1;
    assert!(matches!(
        bench.bytes(&broken),
        Err(DecodeError::Checksum { .. })
    ));
    let _ = bench.bytes(&stream(3));
    let _ = bench.bytes(&stream(4));
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.refused, counts.skipped),
        (3, 1, 19)
    );
}

#[test]
fn a_rate_beyond_the_bit_rate_is_a_warning_with_both() {
    let start = |baud_bps, rate_hz| {
        let mut config = Config {
            baud_bps,
            ..Config::default()
        };
        config.sensor.rate_hz = rate_hz;
        let mut bench = Bench::new(RobotousUart::new(config));
        bench.advance_ms(1);
        bench.complaints()
    };
    assert_eq!(
        start(115_200, 1000),
        ["rate_hz = 1000 is more than the 333 Hz that the manual allows at 115200 bit/s"]
    );
    assert_eq!(
        start(9_600, 10),
        ["baud_bps = 9600 is none of the sensor's bit rates"]
    );
    assert_eq!(start(921_600, 1000), Vec::<String>::new());
}

#[test]
fn a_wrong_bit_rate_is_lost_with_what_came() {
    let mut bench = Bench::new(RobotousUart::new(Config::default()));
    bench.advance_ms(60);
    for _ in 0..9 {
        bench.advance_ms(100);
        bench.bytes(&[0xFE, 0x00, 0x80]).unwrap();
    }
    bench.advance(Duration::from_secs(1));
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("pieces came that mean nothing: check bit rate"),
        "{complaint}"
    );
}
