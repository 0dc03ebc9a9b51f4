use super::*;
use crate::test_support::Bench;

const MS: i64 = 1_000_000;

fn sample(ms: i64) -> PoseSample {
    PoseSample {
        tracking_ns: ms * MS,
        position: [1.0, 2.0, 3.0],
        quaternion: [0.0, 0.0, 0.0, 1.0],
        quality_score: 0.9,
    }
}

fn bench() -> Bench<PoseStream> {
    let mut bench = Bench::new(PoseStream::new(Config::default()));
    bench.advance_ms(1);
    bench
}

fn feed(bench: &mut Bench<PoseStream>, stamps_ms: impl IntoIterator<Item = i64>) {
    for ms in stamps_ms {
        bench.advance_ms(1);
        bench.bytes(&wire::encode(&sample(ms))).unwrap();
    }
}

#[test]
fn poses_come_with_the_trackers_stamps() {
    let mut bench = bench();
    feed(&mut bench, 5_000..5_010);
    assert_eq!(
        bench.events(),
        [DeviceEvent::Starting, DeviceEvent::Streaming]
    );
    let last = *bench.poses().last().unwrap();
    assert_eq!(
        last.at,
        SampleInstant {
            arrival: bench.now,
            device_ns: Some(5_009 * MS)
        }
    );
    assert_eq!(
        (last.pose.position, last.quality_score),
        ([1.0, 2.0, 3.0], 0.9)
    );
    assert_eq!(bench.sent, []);
}

#[test]
fn missing_and_repeated_poses_are_counted() {
    let mut bench = bench();
    feed(&mut bench, (0..100).filter(|ms| ms % 10 != 5));
    feed(&mut bench, [99, 99]);
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 90,
            gaps: 10,
            duplicated: 2,
            ..Counts::default()
        }
    );
}

#[test]
fn silence_is_told_once_and_the_stream_picked_up_again() {
    let mut bench = bench();
    feed(&mut bench, 0..50);
    let silent = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(silent, Duration::from_secs(1));
    bench.advance_ms(10_000);
    assert_eq!(bench.complaints().len(), 1);
    feed(&mut bench, 11_000..11_050);
    assert_eq!(bench.events().last(), Some(&DeviceEvent::Streaming));
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 100,
            ..Counts::default()
        }
    );
}

#[test]
fn nothing_at_all_and_something_else_are_told_apart() {
    let mut silent = bench();
    silent.advance_ms(1_000);
    assert!(
        silent.complaints()[0].contains("no bytes at all"),
        "{:?}",
        silent.complaints()
    );
    let mut foreign = bench();
    foreign.bytes(b"$GPGGA,123519,4807.038,N").unwrap();
    foreign.advance_ms(1_000);
    assert!(
        foreign.complaints()[0].contains("24 bytes that are no pose"),
        "{:?}",
        foreign.complaints()
    );
}

#[test]
fn a_tracker_that_restarts_is_told_and_followed() {
    let mut bench = bench();
    feed(&mut bench, 90_000..90_100);
    feed(&mut bench, 5..50);
    assert!(bench.complaints()[0].contains("it restarted"));
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 145,
            ..Counts::default()
        }
    );
}

#[test]
fn a_broken_frame_is_refused_and_a_gap() {
    let mut bench = bench();
    feed(&mut bench, 0..50);
    let mut broken = wire::encode(&sample(50));
    broken[20] ^= 1;
    bench.advance_ms(1);
    assert!(matches!(
        bench.bytes(&broken),
        Err(DecodeError::Checksum { .. })
    ));
    feed(&mut bench, 51..60);
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.refused, counts.gaps, counts.skipped),
        (59, 1, 1, 74)
    );
}
