use ft_wire::robotous_rft::{Command, FilterSetting, Outcome, Record, Response, Text};

use super::*;
use crate::options::{Sign, Startup};
use crate::reading::{DeviceEvent, Identity, Quality};
use crate::robotous::{Filter, Scale};
use crate::test_support::Bench;

const RECORD: Record = Record {
    force: [617, -250, -1001],
    torque: [500, -1000, 2000],
    overload: 0,
};

fn config() -> Config {
    let mut config = Config::default();
    config.sensor.rate_hz = 1000;
    config
}

fn bench(config: Config) -> Bench<RobotousCan> {
    Bench::new(RobotousCan::new(config))
}

fn listening() -> Bench<RobotousCan> {
    let mut config = config();
    config.sensor.startup = Startup::Listen;
    let mut bench = bench(config);
    bench.advance_ms(1);
    bench
}

fn respond(bench: &mut Bench<RobotousCan>, response: Response) {
    for half in wire::response_frames(CanIds::default(), &response) {
        bench.frame(&half).unwrap();
    }
}

fn text(text: &str) -> Text {
    Text::new(text).unwrap()
}

/// Waits for exactly this command.
fn expect(bench: &mut Bench<RobotousCan>, command: Command) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    let sent: Vec<_> = bench.sent.drain(..).map(|(_, frame)| frame).collect();
    assert_eq!(
        sent,
        [wire::command_frame(CanIds::default(), command)],
        "{command:?}"
    );
}

fn identify(bench: &mut Bench<RobotousCan>, model: &str) {
    expect(bench, Command::Stop);
    expect(bench, Command::ReadModel);
    respond(bench, Response::Model(text(model)));
    expect(bench, Command::ReadSerialNumber);
    respond(bench, Response::SerialNumber(text("A123")));
    expect(bench, Command::ReadFirmware);
    respond(bench, Response::Firmware(text("1.82")));
}

/// Takes a driver by the book to where the stream is asked for, setting rate and filter on the way; each answer takes 5 ms.
fn started(config: Config) -> Bench<RobotousCan> {
    let mut bench = bench(config);
    identify(&mut bench, "RFT64-SB01");
    expect(&mut bench, Command::ReadRate);
    bench.advance_ms(5);
    respond(&mut bench, Response::Rate(0));
    expect(&mut bench, Command::SetRate(8));
    bench.advance_ms(5);
    respond(&mut bench, Response::RateSet(Outcome::TAKEN));
    expect(&mut bench, Command::ReadFilter);
    bench.advance_ms(5);
    respond(
        &mut bench,
        Response::Filter(FilterSetting { kind: 1, code: 5 }),
    );
    expect(&mut bench, Command::SetFilter(FilterSetting::NONE));
    bench.advance_ms(5);
    respond(&mut bench, Response::FilterSet(Outcome::TAKEN));
    expect(&mut bench, Command::Start);
    bench
}

/// The same, to its first sample.
fn streaming(config: Config) -> Bench<RobotousCan> {
    let mut bench = started(config);
    respond(&mut bench, Response::Stream(RECORD));
    bench
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let bench = streaming(config());
    let identity = Identity {
        model: "RFT64-SB01".to_owned(),
        serial_number: "A123".to_owned(),
        firmware: "1.82".to_owned(),
    };
    let expected = [
        DeviceEvent::Starting,
        DeviceEvent::Identified(identity),
        DeviceEvent::Streaming,
    ];
    assert_eq!(bench.events(), expected);
    let [reading] = bench.wrenches()[..] else {
        panic!()
    };
    assert_eq!(
        reading.wrench.to_array(),
        [12.34, -5.0, -20.02, 0.25, -0.5, 1.0]
    );
    assert_eq!(
        (reading.at.arrival, reading.at.device_ns),
        (bench.now, None)
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
fn settings_that_are_right_already_are_not_written_again() {
    let mut config = config();
    config.sensor.filter = Filter::LowPass { cut_off_hz: 100 };
    let mut bench = bench(config);
    identify(&mut bench, "RFT64-SB01");
    expect(&mut bench, Command::ReadRate);
    respond(&mut bench, Response::Rate(8));
    expect(&mut bench, Command::ReadFilter);
    respond(
        &mut bench,
        Response::Filter(FilterSetting { kind: 1, code: 5 }),
    );
    expect(&mut bench, Command::Start);
    // The sources do not agree on what a code means: both are told.
    let scale = DeviceEvent::Scale(vec![
        ("filter_code", "5".to_owned()),
        ("low_pass_hz_by_the_manual", "100".to_owned()),
    ]);
    assert!(bench.events().contains(&scale), "{:?}", bench.events());
}

#[test]
fn a_stream_still_running_is_stopped_and_drained_and_not_delivered() {
    let mut bench = bench(config());
    expect(&mut bench, Command::Stop);
    for _ in 0..30 {
        bench.advance_ms(1);
        respond(&mut bench, Response::Stream(RECORD));
    }
    let start = bench.now;
    expect(&mut bench, Command::ReadModel);
    assert_eq!(bench.now.saturating_since(start), Duration::from_millis(50));
    assert_eq!(bench.wrenches(), []);
    assert_eq!(bench.device.counts(), Counts::default());
}

#[test]
fn a_stream_that_does_not_stop_is_stopped_again_and_then_lost() {
    let mut bench = bench(config());
    for _ in 0..1_600 {
        bench.advance_ms(1);
        respond(&mut bench, Response::Stream(RECORD));
    }
    let stops = bench
        .sent
        .iter()
        .map(|(_, frame)| *frame)
        .collect::<Vec<_>>();
    assert_eq!(
        stops,
        [wire::command_frame(CanIds::default(), Command::Stop); 3]
    );
    assert!(
        bench.complaints()[0].contains("frames still come"),
        "{:?}",
        bench.complaints()
    );
}

#[test]
fn an_unanswered_question_is_asked_three_times_then_lost_then_tried_again() {
    let mut bench = bench(config());
    expect(&mut bench, Command::Stop);
    let lost = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(bench.sent.len(), 3);
    assert!((945..=955).contains(&lost.as_millis()), "{lost:?}");
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("ReadModel was not answered within 300ms, 3 times"),
        "{complaint}"
    );
    assert!(
        complaint.contains("check bit rate (1 Mbit/s), termination, power"),
        "{complaint}"
    );
    bench.sent.clear();
    bench.advance_ms(1_000);
    assert_eq!(bench.sent.len(), 1);
}

#[test]
fn a_refused_setting_is_named() {
    let mut bench = bench(config());
    identify(&mut bench, "RFT64-SB01");
    expect(&mut bench, Command::ReadRate);
    respond(&mut bench, Response::Rate(5));
    expect(&mut bench, Command::SetRate(8));
    respond(
        &mut bench,
        Response::RateSet(Outcome {
            result: 0,
            error: 2,
        }),
    );
    assert_eq!(
        bench.complaints(),
        ["the sensor refused SetRate(8): value out of range"]
    );
}

#[test]
fn an_answer_to_another_setting_is_no_answer() {
    let mut bench = bench(config());
    identify(&mut bench, "RFT64-SB01");
    expect(&mut bench, Command::ReadRate);
    respond(&mut bench, Response::Rate(5));
    expect(&mut bench, Command::SetRate(8));
    respond(&mut bench, Response::FilterSet(Outcome::TAKEN));
    let refused = Outcome {
        result: 0,
        error: 3,
    };
    respond(&mut bench, Response::FilterSet(refused));
    assert_eq!(bench.complaints(), [""; 0]);
    // Only when its time is over is it asked again.
    assert_eq!(bench.sent, []);
    expect(&mut bench, Command::SetRate(8));
    respond(&mut bench, Response::RateSet(Outcome::TAKEN));
    expect(&mut bench, Command::ReadFilter);
}

#[test]
fn a_rate_or_filter_that_the_sensor_has_not_is_named() {
    let mut odd_rate = config();
    odd_rate.sensor.rate_hz = 123;
    let mut bench_rate = bench(odd_rate);
    identify(&mut bench_rate, "RFT64-SB01");
    respond(&mut bench_rate, Response::Rate(5));
    assert_eq!(
        bench_rate.complaints(),
        ["rate_hz = 123 is none of the sensor's rates"]
    );

    let mut odd_filter = config();
    odd_filter.sensor.filter = Filter::LowPass { cut_off_hz: 123 };
    let mut bench_filter = bench(odd_filter);
    identify(&mut bench_filter, "RFT64-SB01");
    respond(&mut bench_filter, Response::Rate(8));
    respond(&mut bench_filter, Response::Filter(FilterSetting::NONE));
    assert!(bench_filter.complaints()[0].contains("is none of the sensor's filters"));
}

#[test]
fn a_model_with_another_scale_is_a_warning_with_both() {
    let mut bench_known = bench(config());
    identify(&mut bench_known, "RFT64-6A01");
    let complaint = &bench_known.complaints()[0];
    assert!(
        complaint.contains("RFT64-6A01 has 50 counts/N and 1000 counts/(N m)"),
        "{complaint}"
    );
    assert!(
        complaint.contains("configured are 50 and 2000"),
        "{complaint}"
    );
    let mut bench_unknown = bench(config());
    identify(&mut bench_unknown, "RFT99");
    assert!(bench_unknown.complaints()[0].contains("\"RFT99\" is not in the manual's table"));
}

#[test]
fn the_configured_scale_and_sign_are_used() {
    let mut config = config();
    config.sensor.scale = Scale::of_model("RFT80-6A03").unwrap();
    config.sensor.sign = Sign::ToolOnEnvironment;
    let bench = streaming(config);
    assert_eq!(
        bench.wrenches()[0].wrench.to_array(),
        [-24.68, 10.0, 40.04, -1.0, 2.0, -4.0]
    );
}

#[test]
fn halves_of_different_samples_never_join() {
    let mut bench = listening();
    respond(&mut bench, Response::Stream(RECORD));
    let other = Record {
        force: [1, 1, 1],
        torque: [1, 1, 1],
        overload: 0,
    };
    let [first, _] = wire::response_frames(CanIds::default(), &Response::Stream(RECORD));
    let [_, second] = wire::response_frames(CanIds::default(), &Response::Stream(other));
    bench.frame(&first).unwrap();
    // The second half of `first` was lost; the next sample comes 6 ms later, its first half lost too.
    bench.advance_ms(6);
    bench.frame(&second).unwrap();
    assert_eq!(bench.wrenches().len(), 1);
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 1,
            gaps: 1,
            refused: 1,
            skipped: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn second_halves_that_wait_for_nobody_are_expected_for_less_than_a_period() {
    // The second half of 1 is lost: 1 and 2 are refused, and that of 2 waits for nobody. The first half of 3 is lost: a gap, also when
    // that of 2 was late.
    for after in [800, 1_000] {
        let mut bench = at_1_khz();
        let before = bench.device.counts();
        let halves = [
            numbered(1)[0],
            numbered(2)[0],
            numbered(2)[1],
            numbered(3)[1],
        ];
        for (micros, half) in [0, 1_000, 130, after].into_iter().zip(halves) {
            bench.advance(Duration::from_micros(micros));
            bench.frame(&half).unwrap();
        }
        let counts = bench.device.counts();
        let lost = (counts.refused - before.refused, counts.gaps - before.gaps);
        assert_eq!(lost, (2, 1), "{after} us");
    }
}

#[test]
fn a_lost_first_half_is_a_gap_and_a_second_half_twice_is_none() {
    let mut bench = at_1_khz();
    let [_, second] = numbered(1);
    // Its first half was lost.
    bench.frame(&second).unwrap();
    bench.advance(Duration::from_micros(870));
    for half in [numbered(2)[0], numbered(2)[1], numbered(2)[1]] {
        bench.advance(Duration::from_micros(130));
        bench.frame(&half).unwrap();
    }
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 11,
            gaps: 1,
            skipped: 2,
            ..Counts::default()
        }
    );
    // The clock that counts samples hears of it where it happened.
    let wanted = |reading: &&Reading| !matches!(reading, Reading::Event { .. });
    let tail: Vec<_> = bench.readings.iter().filter(wanted).skip(10).collect();
    assert!(
        matches!(
            tail[..],
            [Reading::Missing { samples: 1 }, Reading::Wrench(_)]
        ),
        "{tail:?}"
    );
}

#[test]
fn a_first_half_twice_is_skipped_once() {
    let mut bench = listening();
    respond(&mut bench, Response::Stream(RECORD));
    let [first, second] = wire::response_frames(CanIds::default(), &Response::Stream(RECORD));
    for half in [first, first, second] {
        bench.frame(&half).unwrap();
    }
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 2,
            skipped: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn a_second_half_that_was_overtaken_never_joins_the_wrong_first() {
    let mut bench = listening();
    let halves = |fx| {
        let record = Record {
            force: [fx, 0, 0],
            ..RECORD
        };
        wire::response_frames(CanIds::default(), &Response::Stream(record))
    };
    let ([a1, a2], [b1, b2], [c1, c2]) = (halves(1), halves(2), halves(3));
    respond(&mut bench, Response::Stream(RECORD));
    for half in [a1, b1, a2, b2, c1, c2] {
        bench.frame(&half).unwrap();
    }
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 2,
            refused: 2,
            skipped: 2,
            ..Counts::default()
        }
    );
    assert_eq!(bench.wrenches()[1].wrench.force[0], 3.0 / 50.0);
}

/// Ten samples at 1 kHz, halves 0.13 ms apart; then it is the first half of the next one.
fn at_1_khz() -> Bench<RobotousCan> {
    let mut bench = listening();
    for _ in 0..10 {
        let [first, second] = wire::response_frames(CanIds::default(), &Response::Stream(RECORD));
        bench.frame(&first).unwrap();
        bench.advance(Duration::from_micros(130));
        bench.frame(&second).unwrap();
        bench.advance(Duration::from_micros(870));
    }
    bench
}

/// Halves of samples number 1, 2, ...
fn numbered(number: i16) -> [CanFrame; 2] {
    let record = Record {
        force: [number; 3],
        torque: [number; 3],
        overload: 0,
    };
    wire::response_frames(CanIds::default(), &Response::Stream(record))
}

#[test]
fn two_frames_lost_in_a_row_never_join_what_is_left_of_two_samples() {
    let mut bench = at_1_khz();
    loses_two_in_a_row(&mut bench);
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (14, 2), "{counts:?}");
    assert_eq!(forces(&bench)[10..], [0.06, 0.08, 0.1, 0.12]);
}

/// However long the answers of the set-up were in coming.
#[test]
fn nor_do_they_among_the_first_samples_of_a_stream() {
    let mut bench = streaming(config());
    bench.advance_ms(1);
    loses_two_in_a_row(&mut bench);
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (5, 2), "{counts:?}");
    assert_eq!(forces(&bench)[1..], [0.06, 0.08, 0.1, 0.12]);
    // The very first one is lost before samples flow.
    let mut bench = started(config());
    loses_two_in_a_row(&mut bench);
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (4, 0), "{counts:?}");
    assert_eq!(forces(&bench), [0.06, 0.08, 0.1, 0.12]);
}

/// The second half of sample 1 and the first one of sample 2 are lost, at 1 kHz; samples 3 to 6 are whole.
fn loses_two_in_a_row(bench: &mut Bench<RobotousCan>) {
    let ([a, _], [_, b]) = (numbered(1), numbered(2));
    bench.frame(&a).unwrap();
    bench.advance(Duration::from_micros(1_130));
    bench.frame(&b).unwrap();
    for number in 3..=6 {
        let [first, second] = numbered(number);
        bench.advance(Duration::from_micros(870));
        bench.frame(&first).unwrap();
        bench.advance(Duration::from_micros(130));
        bench.frame(&second).unwrap();
    }
}

/// Along x, N.
fn forces(bench: &Bench<RobotousCan>) -> Vec<f64> {
    let wrenches = bench.wrenches();
    wrenches
        .iter()
        .map(|reading| reading.wrench.force[0])
        .collect()
}

#[test]
fn a_second_half_that_is_stamped_a_period_late_still_joins() {
    let mut bench = at_1_khz();
    let ([a1, a2], [b1, b2], [c1, c2]) = (numbered(1), numbered(2), numbered(3));
    bench.frame(&a1).unwrap();
    bench.advance(Duration::from_micros(1_200));
    let late = bench.now;
    // What waited behind it comes at once.
    for half in [a2, b1, b2] {
        bench.frame(&half).unwrap();
    }
    bench.advance(Duration::from_micros(800));
    for half in [c1, c2] {
        bench.frame(&half).unwrap();
    }
    let counts = bench.device.counts();
    assert_eq!(
        counts,
        Counts {
            received: 13,
            ..Counts::default()
        }
    );
    let wrenches = &bench.wrenches()[10..];
    let first = wrenches.iter().map(|reading| reading.wrench.force[0]);
    assert_eq!(first.collect::<Vec<_>>(), [0.02, 0.04, 0.06]);
    assert_eq!(wrenches[0].at.arrival, late);
}

#[test]
fn a_second_half_that_is_later_still_joins_when_the_next_sample_is_right_behind_it() {
    let mut bench = at_1_khz();
    let ([a1, a2], [b1, b2]) = (numbered(1), numbered(2));
    bench.frame(&a1).unwrap();
    bench.advance(Duration::from_micros(1_700));
    for half in [a2, b1, b2] {
        bench.frame(&half).unwrap();
    }
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (12, 0), "{counts:?}");
}

#[test]
fn a_late_second_half_still_joins_when_the_next_sample_is_late_too_and_the_one_after_it_is_not() {
    let mut bench = at_1_khz();
    let begin = bench.now;
    let [a, b, c] = [1, 2, 3].map(numbered);
    let stamps = [0, 1_023, 1_892, 1_893, 2_050, 2_180];
    for (half, stamp) in [a, b, c].into_iter().flatten().zip(stamps) {
        let at = begin + Duration::from_micros(stamp);
        bench.advance(at.saturating_since(bench.now));
        bench.frame(&half).unwrap();
    }
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (13, 0), "{counts:?}");
    assert_eq!(forces(&bench)[10..], [0.02, 0.04, 0.06]);
}

#[test]
fn a_first_half_twice_bears_nothing_out() {
    let mut bench = at_1_khz();
    let ([a, _], [_, b], [c1, c2]) = (numbered(1), numbered(2), numbered(3));
    for (half, us) in [(a, 0), (b, 1_130), (c1, 870), (c1, 100), (c2, 30)] {
        bench.advance(Duration::from_micros(us));
        bench.frame(&half).unwrap();
    }
    assert_eq!(bench.device.counts().received, 10);
    bench.advance_ms(600);
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.refused, counts.skipped),
        (10, 3, 1)
    );
}

#[test]
fn what_is_in_doubt_when_the_stream_falls_silent_is_refused() {
    let mut bench = at_1_khz();
    let ([a, _], [_, b]) = (numbered(1), numbered(2));
    bench.frame(&a).unwrap();
    bench.advance(Duration::from_micros(1_130));
    bench.frame(&b).unwrap();
    bench.advance_ms(600);
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (10, 2), "{counts:?}");
}

#[test]
fn a_first_half_left_alone_is_refused_when_the_stream_is_lost() {
    let mut bench = listening();
    respond(&mut bench, Response::Stream(RECORD));
    let [first, _] = wire::response_frames(CanIds::default(), &Response::Stream(RECORD));
    bench.frame(&first).unwrap();
    bench.advance_ms(499);
    assert_eq!(bench.device.counts().refused, 0);
    bench.advance_ms(1);
    assert_eq!(bench.device.counts().refused, 1);
}

#[test]
fn halves_that_are_read_late_join_by_their_stamps() {
    let mut bench = listening();
    respond(&mut bench, Response::Stream(RECORD));
    let [first, second] = wire::response_frames(CanIds::default(), &Response::Stream(RECORD));
    bench.frame(&first).unwrap();
    let stamps = RxStamps {
        arrival: bench.now + Duration::from_micros(130),
    };
    bench.advance_ms(40);
    bench.device.handle_frame(&second, stamps).unwrap();
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 2,
            ..Counts::default()
        }
    );
}

#[test]
fn frames_that_are_short_unknown_or_foreign_are_told_apart() {
    let mut bench = listening();
    respond(&mut bench, Response::Stream(RECORD));
    let standard = |id, payload: &[u8]| CanFrame::standard(id, payload).unwrap();
    let short = bench.frame(&standard(1, &[0x0B; 7]));
    assert_eq!(
        short,
        Err(DecodeError::Length {
            expected: 8,
            got: 7
        })
    );
    bench.frame(&standard(0x123, &[0; 8])).unwrap();
    bench.frame(&standard(1, &[0x0E; 8])).unwrap();
    let unknown = bench.frame(&standard(2, &[0; 8]));
    assert_eq!(
        unknown,
        Err(DecodeError::Field {
            name: "D1",
            value: 0x0E
        })
    );
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 1,
            refused: 2,
            skipped: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn overload_sets_the_quality_and_warns_once_per_axis() {
    let mut bench = listening();
    for overload in [0, 0x20, 0x20, 0x21] {
        bench.advance_ms(1);
        respond(&mut bench, Response::Stream(Record { overload, ..RECORD }));
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
            Quality::Overrange
        ]
    );
    let complaints = bench.complaints();
    assert_eq!(complaints.len(), 2, "{complaints:?}");
    assert!(complaints[0].starts_with("Fx beyond") && complaints[1].starts_with("Tz beyond"));
}

#[test]
fn a_stream_that_falls_silent_is_lost_after_500_ms() {
    let mut bench = streaming(config());
    let silent = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(silent, Duration::from_millis(500));
    bench.advance_ms(999);
    assert_eq!(bench.sent, []);
    expect(&mut bench, Command::Stop);
}
