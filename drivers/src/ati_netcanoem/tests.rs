use super::*;
use crate::reading::Quality;
use crate::test_support::Bench;

/// Element (axis, gauge) of the test's matrix.
fn element(axis: u8, gauge: u8) -> f32 {
    f32::from(axis) * 10.0 + f32::from(gauge)
}

fn reply(operation: u8, payload: &[u8]) -> CanFrame {
    CanFrame::standard(wire::id(wire::FACTORY_BASE, operation), payload).unwrap()
}

fn row(axis: u8) -> Vec<CanFrame> {
    (0..3)
        .map(|part| {
            let pair = [2 * part, 2 * part + 1].map(|gauge| element(axis, gauge).to_be_bytes());
            reply(2 + part, &pair.concat())
        })
        .collect()
}

fn halves(status: u16, gauges: [i16; 6]) -> [CanFrame; 2] {
    let [a, b, c, d, e, f] = gauges.map(i16::to_be_bytes);
    let even = [status.to_be_bytes(), a, c, e].concat();
    [reply(0, &even), reply(1, &[b, d, f].concat())]
}

fn expect(bench: &mut Bench<AtiNetcanoem>, request: Request) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    let sent: Vec<_> = bench.sent.drain(..).map(|(_, frame)| frame).collect();
    assert_eq!(
        sent,
        [wire::request_frame(wire::FACTORY_BASE, request)],
        "{request:?}"
    );
}

fn set_up(bench: &mut Bench<AtiNetcanoem>) {
    before_counts(bench, 8);
    expect(bench, Request::ReadCountsPerUnit);
    let counts = [100_u32, 1_000].map(u32::to_be_bytes).concat();
    bench.frame(&reply(7, &counts)).unwrap();
    expect(bench, Request::ReadUnits);
    // lbf, N mm.
    bench.frame(&reply(8, &[1, 4])).unwrap();
    matrix(bench);
    expect(bench, Request::ReadGauges);
}

/// Answers what is asked of the matrix, twice.
fn matrix(bench: &mut Bench<AtiNetcanoem>) {
    for axis in (0..6).chain(0..6) {
        expect(bench, Request::ReadMatrixRow(axis));
        for frame in row(axis) {
            bench.frame(&frame).unwrap();
        }
    }
}

/// Answers, as firmware 3 of this minor version, all up to the counts per unit, which are asked then.
fn before_counts(bench: &mut Bench<AtiNetcanoem>, minor: u8) {
    expect(bench, Request::ReadFirmware);
    bench.frame(&reply(0xF, &[3, minor, 0, 7])).unwrap();
    expect(bench, Request::ReadSerialNumber);
    bench.frame(&reply(5, b"FT012345")).unwrap();
    expect(bench, Request::SetCalibration(0));
    bench.frame(&reply(6, &[0])).unwrap();
}

#[test]
fn an_old_firmware_that_knows_no_counts_per_unit_has_a_million() {
    let mut bench = Bench::new(AtiNetcanoem::new(Config::default()));
    before_counts(&mut bench, 6);
    for _ in 0..3 {
        expect(&mut bench, Request::ReadCountsPerUnit);
    }
    expect(&mut bench, Request::ReadUnits);
    // N, N m.
    bench.frame(&reply(8, &[2, 3])).unwrap();
    matrix(&mut bench);
    expect(&mut bench, Request::ReadGauges);
    answer(&mut bench, 0);
    let force_x = bench.wrenches()[0].wrench.to_array()[0];
    let product: f32 = (0..6).map(|k| element(0, k) * f32::from(k + 1)).sum();
    assert!(
        (force_x - f64::from(product) * 1e-6).abs() < 1e-12,
        "{force_x}"
    );
}

#[test]
fn a_late_answer_does_not_shift_the_matrix() {
    let mut bench = Bench::new(AtiNetcanoem::new(Config::default()));
    before_counts(&mut bench, 8);
    expect(&mut bench, Request::ReadCountsPerUnit);
    let counts = [100_u32, 1_000].map(u32::to_be_bytes).concat();
    bench.frame(&reply(7, &counts)).unwrap();
    expect(&mut bench, Request::ReadUnits);
    bench.frame(&reply(8, &[1, 4])).unwrap();
    // Row 0 is asked twice before its first answer comes; each answer is one question late from then on.
    expect(&mut bench, Request::ReadMatrixRow(0));
    expect(&mut bench, Request::ReadMatrixRow(0));
    let answers = [0].into_iter().chain((0..6).chain(0..6));
    for axis in answers.take(12) {
        for frame in row(axis) {
            bench.frame(&frame).unwrap();
        }
        bench.sent.clear();
        bench.advance_ms(1);
        bench.sent.clear();
    }
    let events = bench.events();
    let lost = |event: &DeviceEvent| matches!(event, DeviceEvent::Lost { reason } if reason.contains("matrix"));
    assert!(events.iter().any(lost), "{events:?}");
}

#[test]
fn an_error_without_a_name_is_no_good_sample() {
    let mut bench = polling();
    answer(&mut bench, Status::ANY);
    assert_eq!(bench.wrenches()[0].quality, Quality::Invalid);
    let warned = |event: &DeviceEvent| matches!(event, DeviceEvent::Warning { .. });
    assert!(bench.events().iter().any(warned));
}

fn polling() -> Bench<AtiNetcanoem> {
    let mut bench = Bench::new(AtiNetcanoem::new(Config::default()));
    set_up(&mut bench);
    bench
}

fn answer(bench: &mut Bench<AtiNetcanoem>, status: u16) {
    for half in halves(status, [1, 2, 3, 4, 5, 6]) {
        bench.frame(&half).unwrap();
    }
}

#[test]
fn set_up_by_the_book_ends_in_samples_in_si() {
    let mut bench = polling();
    answer(&mut bench, 0);
    let identity = Identity {
        model: "NETCANOEM".to_owned(),
        serial_number: "FT012345".to_owned(),
        firmware: "3.8.7".to_owned(),
    };
    let row = |axis| (0..6).map(move |gauge| element(axis, gauge).to_string());
    let rows = (0..6).map(|axis| row(axis).collect::<Vec<_>>().join(" "));
    let scale = vec![
        ("calibration", "0".to_owned()),
        (
            "newtons_per_count",
            (4.448_221_615_260_5_f64 / 100.0).to_string(),
        ),
        ("newton_metres_per_count", (1e-3_f64 / 1_000.0).to_string()),
        (
            "matrix_counts_per_gauge",
            rows.collect::<Vec<_>>().join("; "),
        ),
    ];
    assert_eq!(
        bench.events(),
        [
            DeviceEvent::Starting,
            DeviceEvent::Identified(identity),
            DeviceEvent::Scale(scale),
            DeviceEvent::Streaming
        ]
    );
    let wrench = bench.wrenches()[0].wrench.to_array();
    for (axis, value) in (0..6).zip(wrench) {
        let product: f32 = (0..6)
            .map(|gauge| element(axis, gauge) * f32::from(gauge + 1))
            .sum();
        let si = if axis < 3 {
            4.448_221_615_260_5 / 100.0
        } else {
            1e-3 / 1_000.0
        };
        let expected = f64::from(product) * si;
        assert!(
            (value - expected).abs() < 1e-9 * expected.abs().max(1.0),
            "{axis}: {value} {expected}"
        );
    }
    expect(&mut bench, Request::ReadGauges);
}

#[test]
fn polls_keep_their_period_and_an_unanswered_one_is_a_gap() {
    let mut bench = polling();
    answer(&mut bench, 0);
    expect(&mut bench, Request::ReadGauges);
    answer(&mut bench, 0);
    let began = bench.now;
    expect(&mut bench, Request::ReadGauges);
    assert_eq!(bench.now.saturating_since(began), Duration::from_millis(4));
    expect(&mut bench, Request::ReadGauges);
    answer(&mut bench, 0);
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.gaps, counts.refused), (3, 1, 0));
}

#[test]
fn a_board_that_falls_silent_is_lost_after_ten_polls() {
    let mut bench = polling();
    answer(&mut bench, 0);
    bench.advance_until(|bench| !bench.complaints().is_empty());
    let complaint = &bench.complaints()[0];
    assert!(complaint.contains("10 questions in a row"), "{complaint}");
    bench.sent.clear();
    set_up(&mut bench);
}

#[test]
fn halves_of_different_samples_never_join() {
    let mut bench = polling();
    answer(&mut bench, 0);
    expect(&mut bench, Request::ReadGauges);
    let [even, odd] = halves(0, [9; 6]);
    bench.frame(&even).unwrap();
    // Its second half is lost; of the next answer the first half is.
    expect(&mut bench, Request::ReadGauges);
    bench.frame(&odd).unwrap();
    assert_eq!(bench.wrenches().len(), 1);
    let counts = bench.device.counts();
    assert_eq!((counts.refused, counts.skipped, counts.gaps), (1, 1, 1));
}

#[test]
fn a_half_twice_is_refused_and_an_answer_twice_is_skipped() {
    let mut bench = polling();
    answer(&mut bench, 0);
    expect(&mut bench, Request::ReadGauges);
    let [even, odd] = halves(0, [9; 6]);
    for half in [even, even, odd, even, odd] {
        bench.frame(&half).unwrap();
    }
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused, counts.skipped), (2, 1, 1));
}

#[test]
fn a_sticky_bus_error_resets_the_board_and_reads_the_matrix_again() {
    let mut bench = polling();
    answer(&mut bench, 0);
    expect(&mut bench, Request::ReadGauges);
    answer(&mut bench, Status::ANY | Status::BUS_ERROR);
    assert_eq!(bench.wrenches().len(), 1);
    assert!(bench.complaints()[0].contains("bus error"));
    expect(&mut bench, Request::Reset);
    set_up(&mut bench);
    answer(&mut bench, 0);
    assert_eq!(bench.wrenches().len(), 2);
}

#[test]
fn a_part_of_a_row_that_is_lost_makes_the_row_be_asked_again() {
    let mut bench = Bench::new(AtiNetcanoem::new(Config::default()));
    expect(&mut bench, Request::ReadFirmware);
    bench.frame(&reply(0xF, &[3, 8, 0, 7])).unwrap();
    bench.frame(&reply(5, b"FT012345")).unwrap();
    bench.frame(&reply(6, &[0])).unwrap();
    bench.frame(&reply(7, &[0, 0, 0, 1, 0, 0, 0, 1])).unwrap();
    bench.frame(&reply(8, &[2, 3])).unwrap();
    bench.sent.clear();
    let parts = row(0);
    bench.frame(&parts[0]).unwrap();
    bench.frame(&parts[2]).unwrap();
    expect(&mut bench, Request::ReadMatrixRow(0));
    for part in &parts {
        bench.frame(part).unwrap();
    }
    expect(&mut bench, Request::ReadMatrixRow(1));
}

#[test]
fn another_calibration_than_asked_for_is_named() {
    let mut bench = Bench::new(AtiNetcanoem::new(Config {
        calibration: 3,
        ..Config::default()
    }));
    expect(&mut bench, Request::ReadFirmware);
    bench.frame(&reply(0xF, &[3, 8, 0, 7])).unwrap();
    bench.frame(&reply(5, b"FT012345")).unwrap();
    bench.frame(&reply(6, &[0])).unwrap();
    assert_eq!(
        bench.complaints(),
        ["calibration 3 was asked for, 0 is active"]
    );
}

#[test]
fn status_bits_set_the_quality_and_warn_once() {
    let mut bench = polling();
    for status in [0, 0x8002, 0x8002, 0x8800] {
        answer(&mut bench, status);
        expect(&mut bench, Request::ReadGauges);
    }
    let qualities: Vec<_> = bench
        .wrenches()
        .iter()
        .map(|reading| reading.quality)
        .collect();
    use Quality::{Good, Invalid, Overrange};
    assert_eq!(qualities, [Good, Overrange, Overrange, Invalid]);
    let complaints = bench.complaints();
    assert_eq!(complaints.len(), 2, "{complaints:?}");
    assert!(complaints[1].contains("temperature too high"));
}

#[test]
fn a_listener_takes_matrix_and_samples_that_pass_by() {
    let mut bench = Bench::new(AtiNetcanoem::new(Config {
        startup: Startup::Listen,
        ..Config::default()
    }));
    bench.advance_ms(1);
    answer(&mut bench, 0);
    bench.frame(&reply(7, &[0, 0, 0, 1, 0, 0, 0, 1])).unwrap();
    bench.frame(&reply(8, &[2, 3])).unwrap();
    for frame in (0..6).flat_map(row) {
        bench.frame(&frame).unwrap();
    }
    answer(&mut bench, 0);
    assert_eq!(bench.wrenches().len(), 1);
    assert_eq!(bench.sent, []);
}

#[test]
fn frames_that_are_short_or_foreign_are_told_apart() {
    let mut bench = polling();
    answer(&mut bench, 0);
    expect(&mut bench, Request::ReadGauges);
    bench
        .frame(&CanFrame::standard(0x123, &[0; 8]).unwrap())
        .unwrap();
    let short = bench.frame(&reply(0, &[0; 7]));
    assert!(short.is_err());
    let counts = bench.device.counts();
    assert_eq!((counts.refused, counts.skipped), (1, 1));
}

#[test]
fn a_bus_that_is_never_quiet_is_told_without_a_stop_that_was_not_sent() {
    let mut bench = Bench::new(AtiNetcanoem::new(Config::default()));
    for _ in 0..40 {
        bench.advance_ms(100);
        answer(&mut bench, 0);
    }
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("nothing was asked for 3s and frames still come, from another program"),
        "{complaint}"
    );
    assert_eq!(bench.sent, []);
}
