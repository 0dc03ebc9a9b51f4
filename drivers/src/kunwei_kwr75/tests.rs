use super::*;
use crate::reading::{DeviceEvent, Quality};
use crate::test_support::Bench;

fn sample(fx_kg: f32) -> Vec<u8> {
    let sample = Sample {
        asked: false,
        force_kg: [fx_kg, -0.5, 2.0],
        torque_kgm: [0.01, -0.02, 0.03],
    };
    wire::encode(&sample).to_vec()
}

fn listening() -> Bench<KunweiKwr75> {
    let mut bench = Bench::new(KunweiKwr75::new(Config {
        startup: Startup::Listen,
        ..Config::default()
    }));
    bench.advance_ms(1);
    bench
}

/// A bench with three samples of 1 kg delivered.
fn locked() -> Bench<KunweiKwr75> {
    let mut bench = listening();
    for _ in 0..3 {
        bench.advance_ms(1);
        bench.bytes(&sample(1.0)).unwrap();
    }
    assert_eq!(bench.wrenches().len(), 3);
    bench
}

fn expect(bench: &mut Bench<KunweiKwr75>, command: Command) {
    bench.advance_until(|bench| !bench.sent.is_empty());
    assert_eq!(bench.take_sent(), wire::encode_command(command));
}

fn qualities(bench: &Bench<KunweiKwr75>) -> Vec<Quality> {
    bench
        .wrenches()
        .iter()
        .map(|reading| reading.quality)
        .collect()
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let mut bench = Bench::new(KunweiKwr75::new(Config::default()));
    expect(&mut bench, Command::Stop);
    expect(&mut bench, Command::Start);
    for _ in 0..3 {
        bench.advance_ms(1);
        bench.bytes(&sample(1.0)).unwrap();
    }
    assert_eq!(
        bench.events(),
        [DeviceEvent::Starting, DeviceEvent::Streaming]
    );
    let wrench = bench.wrenches()[0].wrench.to_array();
    for (value, expected) in wrench
        .into_iter()
        .zip([9.81, -4.905, 19.62, 0.0981, -0.1962, 0.2943])
    {
        assert!((value - expected).abs() < 1e-6, "{wrench:?}");
    }
}

#[test]
fn a_head_with_a_flipped_bit_is_refused_and_told_as_missing() {
    let mut bench = locked();
    // The head of an answer to a question that nobody asked.
    let mut flipped = sample(1.0);
    flipped[0] ^= 1;
    for bytes in [flipped, sample(1.0), sample(1.0), sample(1.0)] {
        bench.advance_ms(1);
        // The error is the count.
        let _ = bench.bytes(&bytes);
    }
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused), (6, 1), "{counts:?}");
    let missing = bench.readings.iter().filter_map(|reading| match reading {
        Reading::Missing { samples } => Some(*samples),
        _ => None,
    });
    assert_eq!(missing.collect::<Vec<_>>(), [1]);
}

#[test]
fn a_stream_still_running_is_drained_and_not_delivered() {
    let mut bench = Bench::new(KunweiKwr75::new(Config::default()));
    expect(&mut bench, Command::Stop);
    for _ in 0..40 {
        bench.advance_ms(1);
        bench.bytes(&sample(1.0)).unwrap();
    }
    let began = bench.now;
    expect(&mut bench, Command::Start);
    assert_eq!(bench.now.saturating_since(began), Duration::from_millis(50));
    assert_eq!(bench.wrenches(), []);
}

#[test]
fn a_sensor_that_does_not_start_is_asked_three_times_and_lost() {
    let mut bench = Bench::new(KunweiKwr75::new(Config::default()));
    expect(&mut bench, Command::Stop);
    for _ in 0..3 {
        expect(&mut bench, Command::Start);
    }
    bench.advance_until(|bench| !bench.complaints().is_empty());
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("Start was not answered within 300ms, 3 times"),
        "{complaint}"
    );
}

#[test]
fn a_frame_alone_is_not_believed_even_if_it_looks_right() {
    let mut bench = listening();
    // A payload that holds what looks like a frame, then silence.
    bench.bytes(&sample(1.0)).unwrap();
    bench.advance_ms(1);
    bench.bytes(&sample(1.0)).unwrap();
    assert_eq!(bench.wrenches(), []);
    // Two more at another spacing: the lock must begin there.
    bench.bytes(&[0x48]).unwrap();
    for _ in 0..3 {
        bench.bytes(&sample(1.0)).unwrap();
    }
    assert_eq!(bench.wrenches().len(), 3);
}

#[test]
fn a_frame_that_is_not_where_it_must_be_is_one_refused_and_the_search_begins() {
    let mut bench = locked();
    let mut broken = sample(1.0);
    broken[27] = 0;
    assert!(bench.bytes(&broken).is_err());
    for _ in 0..3 {
        bench.bytes(&sample(1.0)).unwrap();
    }
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.refused, counts.skipped),
        (6, 1, 28)
    );
}

#[test]
fn a_spike_is_marked_and_the_samples_around_it_are_not() {
    let mut bench = locked();
    for kg in [1.0, 4.0, 1.0, 1.0] {
        bench.advance_ms(1);
        bench.bytes(&sample(kg)).unwrap();
    }
    use Quality::{Good, Invalid};
    assert_eq!(qualities(&bench)[3..], [Good, Invalid, Good, Good]);
    assert_eq!(bench.wrenches()[4].status_bits, 1);
    assert_eq!(bench.complaints().len(), 1);
}

#[test]
fn a_first_sample_that_the_next_two_contradict_is_marked_and_the_second_is_not() {
    let mut bench = listening();
    for kg in [4.0, 1.0, 1.0, 1.0, 1.0] {
        bench.advance_ms(1);
        bench.bytes(&sample(kg)).unwrap();
    }
    use Quality::{Good, Invalid};
    assert_eq!(qualities(&bench), [Invalid, Good, Good, Good, Good]);
    assert_eq!(bench.complaints().len(), 1);
    let counts = bench.device.counts();
    assert_eq!((counts.received, counts.refused, counts.skipped), (5, 0, 0));
}

#[test]
fn a_first_sample_is_believed_by_either_of_the_two_behind_it() {
    let mut bench = listening();
    for kg in [1.0, 4.0, 1.0, 1.0] {
        bench.advance_ms(1);
        bench.bytes(&sample(kg)).unwrap();
    }
    use Quality::{Good, Invalid};
    assert_eq!(qualities(&bench), [Good, Invalid, Good, Good]);
}

#[test]
fn a_blow_is_believed_from_its_second_sample_on() {
    let mut bench = locked();
    for kg in [5.0, 5.5, 6.0] {
        bench.advance_ms(1);
        bench.bytes(&sample(kg)).unwrap();
    }
    use Quality::{Good, Invalid};
    assert_eq!(qualities(&bench)[3..], [Invalid, Good, Good]);
}

#[test]
fn after_a_pause_a_larger_step_is_believed() {
    let mut bench = locked();
    bench.advance_ms(100);
    bench.bytes(&sample(20.0)).unwrap();
    assert_eq!(qualities(&bench)[3..], [Quality::Good]);
}

#[test]
fn numbers_that_cannot_be_never_come_out() {
    let mut bench = locked();
    for value in [f32::NAN, 1e20] {
        let _ = bench.bytes(&sample(value));
        for _ in 0..3 {
            let _ = bench.bytes(&sample(1.0));
        }
    }
    let finite =
        |reading: &WrenchReading| reading.wrench.to_array().iter().all(|x| x.abs() < 100.0);
    assert!(bench.wrenches().iter().all(finite));
    assert_eq!(bench.device.counts().refused, 2);
}

#[test]
fn a_stream_that_falls_silent_is_lost_after_500_ms() {
    let mut bench = locked();
    let silent = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(silent, Duration::from_millis(500));
}
