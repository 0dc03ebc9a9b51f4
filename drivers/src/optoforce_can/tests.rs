use ft_wire::optoforce_hex::{Command, Sample, Settings, Status};

use super::*;
use crate::options::Startup;
use crate::optoforce::Scale;
use crate::test_support::Bench;

fn config(startup: Startup) -> Config {
    let scale = Scale {
        counts_per_newton: [10.0; 3],
        counts_per_newton_metre: [100.0; 3],
    };
    Config::new(optoforce::Config {
        startup,
        ..optoforce::Config::new(scale)
    })
}

fn listening() -> Bench<OptoforceCan> {
    let mut bench = Bench::new(OptoforceCan::new(config(Startup::Listen)));
    bench.advance_ms(1);
    for frame in sample(0) {
        bench.frame(&frame).unwrap();
    }
    bench.advance_ms(3);
    bench
}

fn frames(packet: &Packet) -> Vec<CanFrame> {
    wire::encode(packet)
        .as_slice()
        .chunks(8)
        .map(|payload| CanFrame::standard(0x100, payload).unwrap())
        .collect()
}

fn sample(counter: u16) -> Vec<CanFrame> {
    let sample = Sample {
        counter,
        status: Status(0),
        force: [100, -200, 300],
        torque: Some([-50, 60, -70]),
    };
    frames(&Packet::Sample(sample))
}

fn counts(bench: &Bench<OptoforceCan>) -> (u64, u64, u64) {
    let counts = bench.device.counts();
    (counts.received, counts.refused, counts.skipped)
}

#[test]
fn the_golden_payloads_join_to_the_golden_sample() {
    // hardware.md 2.3.
    let golden = [
        &[0xAA, 0x07, 0x08, 0x10, 0x01, 0x02, 0x00, 0x00][..],
        &[0x00, 0x64, 0xFF, 0x38, 0x01, 0x2C, 0xFF, 0xCE],
        &[0x00, 0x3C, 0xFF, 0xBA, 0x06, 0x56],
    ];
    let mut bench = Bench::new(OptoforceCan::new(config(Startup::Listen)));
    bench.advance_ms(1);
    for payload in golden {
        bench
            .frame(&CanFrame::standard(0x100, payload).unwrap())
            .unwrap();
    }
    assert_eq!(
        bench.wrenches()[0].wrench.to_array(),
        [10.0, -20.0, 30.0, -0.5, 0.6, -0.7]
    );
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let mut bench = Bench::new(OptoforceCan::new(config(Startup::Configure)));
    let settings = |period_ms| {
        Command::Configure(Settings {
            period_ms,
            filter: 0,
            zero: 0,
        })
    };
    let mut expect = |command: Command, answer: Option<Packet>| {
        bench.advance_until(|bench| !bench.sent.is_empty());
        let mut padded = wire::encode_command(command).as_slice().to_vec();
        padded.resize(padded.len().next_multiple_of(8), 0);
        let sent: Vec<u8> = bench
            .sent
            .drain(..)
            .inspect(|(_, frame)| assert_eq!(frame.arbitration_id(), 0x101))
            .flat_map(|(_, frame)| frame.payload().to_vec())
            .collect();
        assert_eq!(sent, padded, "{command:?}");
        for frame in answer.iter().flat_map(frames) {
            bench.frame(&frame).unwrap();
        }
    };
    expect(settings(0), None);
    expect(
        Command::ReadSerialNumber,
        Some(Packet::SerialNumber(*b"HEX00001")),
    );
    expect(settings(3), Some(Packet::Configured { error: 0 }));
    for frame in sample(1) {
        bench.frame(&frame).unwrap();
    }
    assert_eq!(counts(&bench), (1, 0, 0));
}

#[test]
fn an_answer_padded_to_eight_bytes_is_read_too() {
    let mut bench = listening();
    let padded = [0xAA, 0x00, 0x50, 0x01, 0x00, 0x00, 0xFB, 0x00];
    bench
        .frame(&CanFrame::standard(0x100, &padded).unwrap())
        .unwrap();
    assert_eq!(counts(&bench), (1, 0, 0));
}

#[test]
fn a_lost_payload_costs_its_packet_and_no_other() {
    for lost in 0..3 {
        let mut bench = listening();
        let mut broken = sample(1);
        broken.remove(lost);
        for frame in broken.into_iter().chain(sample(2)) {
            let _ = bench.frame(&frame);
        }
        let (received, refused, skipped) = counts(&bench);
        assert_eq!(received, 2, "payload {lost}");
        assert_eq!(refused + skipped, if lost == 0 { 2 } else { 1 });
        assert_eq!(bench.wrenches()[0].wrench, bench.wrenches()[1].wrench);
    }
}

#[test]
fn a_payload_twice_or_out_of_order_never_makes_a_sample() {
    for order in [[0, 1, 1, 2], [1, 0, 2, 2], [0, 2, 1, 1], [2, 0, 1, 1]] {
        let mut bench = listening();
        let payloads = sample(1);
        for index in order {
            let _ = bench.frame(&payloads[index]);
        }
        for frame in sample(2) {
            bench.frame(&frame).unwrap();
        }
        assert_eq!(bench.wrenches().len(), 2, "{order:?}");
        assert!(bench.device.counts().refused >= 1, "{order:?}");
    }
}

#[test]
fn payloads_of_different_packets_never_join() {
    let mut bench = listening();
    let (first, second) = (sample(1), sample(2));
    bench.frame(&first[0]).unwrap();
    bench.advance_ms(6);
    for frame in &second[1..] {
        let _ = bench.frame(frame);
    }
    assert_eq!(counts(&bench), (1, 1, 2));
}

#[test]
fn a_foreign_id_is_skipped_and_a_packet_cut_off_is_refused_with_the_stream() {
    let mut bench = listening();
    bench
        .frame(&CanFrame::standard(0x123, &[0; 8]).unwrap())
        .unwrap();
    bench.frame(&sample(1)[0]).unwrap();
    bench.advance_ms(600);
    assert_eq!(counts(&bench), (1, 1, 1));
}
