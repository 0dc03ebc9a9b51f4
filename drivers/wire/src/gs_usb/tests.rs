//! Golden bytes are put together by hand from the table of hardware.md 4.4; the limits and timings are those that `ip -details
//! link show` prints for a candleLight on Linux (48 MHz: 1 Mbit/s `prop-seg 5 phase-seg1 6 phase-seg2 4`, 500 kbit/s
//! `prop-seg 6 phase-seg1 7 phase-seg2 2`).

use proptest::prelude::*;

use super::*;

/// A Robotous command's answer on 0x001, channel 0, at 0x11223344 us.
const RECEIVED_FRAME: [u8; 24] = [
    0xFF, 0xFF, 0xFF, 0xFF, 0x01, 0x00, 0x00, 0x00, 0x08, 0x00, 0x00, 0x00, 0x0B, 1, 2, 3, 4, 5, 6,
    7, 0x44, 0x33, 0x22, 0x11,
];

fn decoded(change: impl Fn(&mut [u8; 24])) -> Result<HostFrame, DecodeError> {
    let mut bytes = RECEIVED_FRAME;
    change(&mut bytes);
    HostFrame::decode(&bytes, Stamps::Carried)
}

#[test]
fn a_received_frame_is_read() {
    let expected = HostFrame {
        channel: 0,
        content: Content::Data(CanFrame::standard(1, &[0x0B, 1, 2, 3, 4, 5, 6, 7]).unwrap()),
        lost_before: false,
        time_us: Some(0x1122_3344),
    };
    assert_eq!(
        HostFrame::decode(&RECEIVED_FRAME, Stamps::Carried),
        Ok(expected)
    );
    let unstamped = HostFrame::decode(&RECEIVED_FRAME[..20], Stamps::Absent).unwrap();
    assert_eq!(unstamped.time_us, None);
    assert_eq!(unstamped.content, expected.content);
}

#[test]
fn what_is_no_data_is_told_apart() {
    let content = |change: &dyn Fn(&mut [u8; 24])| decoded(change).unwrap().content;
    assert_eq!(content(&|bytes| bytes[..4].fill(0)), Content::Sent(0));
    assert_eq!(content(&|bytes| bytes[7] = 0x40), Content::Remote);
    // Error frame: bus-off and not acknowledged.
    let error = |bytes: &mut [u8; 24]| bytes[4..8].copy_from_slice(&[0x60, 0, 0, 0x20]);
    assert_eq!(content(&error), Content::Errors(0x60));
    let extended = |bytes: &mut [u8; 24]| bytes[4..8].copy_from_slice(&[0x78, 0x56, 0x34, 0x92]);
    let frame = CanFrame::extended(0x1234_5678, &[0x0B, 1, 2, 3, 4, 5, 6, 7]).unwrap();
    assert_eq!(content(&extended), Content::Data(frame));
    let second = decoded(|bytes| (bytes[9], bytes[10]) = (1, 1)).unwrap();
    assert_eq!((second.channel, second.lost_before), (1, true));
}

#[test]
fn a_short_dlc_cuts_the_payload_and_one_beyond_eight_means_eight() {
    let length = |dlc| match decoded(|bytes| bytes[8] = dlc).unwrap().content {
        Content::Data(frame) => frame.payload().len(),
        other => panic!("{other:?}"),
    };
    assert_eq!([0, 3, 8, 15].map(length), [0, 3, 8, 8]);
}

#[test]
fn what_the_table_does_not_allow_is_refused() {
    let refused = |name, value| Err(DecodeError::Field { name, value });
    assert_eq!(decoded(|bytes| bytes[8] = 16), refused("can_dlc", 16));
    assert_eq!(decoded(|bytes| bytes[10] = 2), refused("flags", 2));
    assert_eq!(decoded(|bytes| bytes[5] = 8), refused("can_id", 0x801));
    for len in 0..24 {
        let length = DecodeError::Length {
            expected: 24,
            got: len,
        };
        assert_eq!(
            HostFrame::decode(&RECEIVED_FRAME[..len], Stamps::Carried),
            Err(length)
        );
    }
}

#[test]
fn frames_to_be_sent_have_the_bytes_of_the_table() {
    let stop = CanFrame::standard(0x64, &[0x0C, 0, 0]).unwrap();
    assert_eq!(
        encode(7, 1, &stop),
        [
            7, 0, 0, 0, 0x64, 0, 0, 0, 3, 1, 0, 0, 0x0C, 0, 0, 0, 0, 0, 0, 0
        ]
    );
    let long = CanFrame::extended(0x1234_5678, &[9; 8]).unwrap();
    assert_eq!(
        encode(0, 0, &long)[4..12],
        [0x78, 0x56, 0x34, 0x92, 8, 0, 0, 0]
    );
}

#[test]
fn requests_have_the_bytes_of_the_table() {
    assert_eq!(start(FEATURE_TIME_STAMPS), [1, 0, 0, 0, 0x10, 0, 0, 0]);
    assert_eq!(reset(), [0; 8]);
    assert_eq!(channels(&[0, 0, 0, 1, 2, 0, 0, 0, 1, 0, 0, 0]), Ok(2));
    assert_eq!(
        channels(&[0; 11]),
        Err(DecodeError::Length {
            expected: 12,
            got: 11
        })
    );
    let timing = BitTiming {
        propagation: 5,
        phase_1: 6,
        phase_2: 4,
        jump: 2,
        divisor: 3,
    };
    assert_eq!(
        timing.encode(),
        [5, 0, 0, 0, 6, 0, 0, 0, 4, 0, 0, 0, 2, 0, 0, 0, 3, 0, 0, 0]
    );
}

/// An STM32F042 at 48 MHz, with time stamps.
const CANDLE: [u8; 40] = [
    0x13, 0, 0, 0, 0x00, 0x6C, 0xDC, 0x02, 1, 0, 0, 0, 16, 0, 0, 0, 1, 0, 0, 0, 8, 0, 0, 0, 4, 0,
    0, 0, 1, 0, 0, 0, 0, 4, 0, 0, 1, 0, 0, 0,
];

#[test]
fn a_candlelight_is_timed_as_linux_times_it() {
    let limits = Limits::decode(&CANDLE).unwrap();
    assert_eq!((limits.clock_hz, limits.features), (48_000_000, 0x13));
    let parts = |rate| {
        let timing = limits.timing(rate).unwrap();
        (
            timing.propagation,
            timing.phase_1,
            timing.phase_2,
            timing.divisor,
        )
    };
    assert_eq!(parts(1_000_000), (5, 6, 4, 3));
    assert_eq!(parts(500_000), (6, 7, 2, 6));
    assert_eq!(parts(250_000), (6, 7, 2, 12));
}

#[test]
fn a_rate_that_the_clock_does_not_give_is_refused() {
    let limits = Limits::decode(&CANDLE).unwrap();
    assert_eq!(limits.timing(0), None);
    assert_eq!(limits.timing(7_000_000), None, "48 MHz is no multiple");
    assert_eq!(limits.timing(1_000), None, "the divisor ends at 1024");
    assert!(Limits::decode(&CANDLE[..39]).is_err());
}

proptest! {
    #[test]
    fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
        for stamps in [Stamps::Carried, Stamps::Absent] {
            let _ = HostFrame::decode(&bytes, stamps);
        }
    }

    #[test]
    fn a_frame_that_is_sent_comes_back_the_same(id in 0_u32..=0x1FFF_FFFF, payload in proptest::collection::vec(any::<u8>(), 0..=8)) {
        let standard = CanFrame::standard(u16::try_from(id & 0x7FF).unwrap(), &payload).unwrap();
        let extended = CanFrame::extended(id, &payload).unwrap();
        for frame in [standard, extended] {
            let bytes = encode(RECEIVED, 0, &frame);
            let back = HostFrame::decode(&bytes, Stamps::Absent).unwrap();
            prop_assert_eq!(back.content, Content::Data(frame));
        }
    }

    #[test]
    fn timings_keep_their_limits(words in proptest::collection::vec(any::<u32>(), 10), small in proptest::collection::vec(0_u32..300, 8), rate in any::<u32>()) {
        for words in [words.clone(), [&words[..1], &[80_000_000], &small].concat()] {
            let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
            let limits = Limits::decode(&bytes).unwrap();
            for rate in [rate, 1_000_000, 500_000, 125_000] {
                if let Some(timing) = limits.timing(rate) {
                    let before = timing.propagation + timing.phase_1;
                    prop_assert!((limits.before.0..=limits.before.1).contains(&before));
                    prop_assert!((limits.behind.0..=limits.behind.1).contains(&timing.phase_2));
                    prop_assert!(timing.divisor >= limits.divisor.0 && timing.divisor <= limits.divisor.1);
                    let real = f64::from(limits.clock_hz) / f64::from(timing.divisor * (1 + before + timing.phase_2));
                    prop_assert!((real / f64::from(rate) - 1.0).abs() < 2e-3);
                }
            }
        }
    }
}
