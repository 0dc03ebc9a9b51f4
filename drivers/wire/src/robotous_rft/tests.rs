use proptest::prelude::*;

use super::*;
use crate::can::CanFrame;
use crate::test_support::{assert_flipped_bits_refused, assert_prefixes_incomplete, hex};

// hardware.md 2.2, golden vectors: computed from the maker's manual.
const STREAM: &str = "55 0B 02 69 FF 06 FC 17 01 F4 FC 18 07 D0 00 00 00 6E AA";

const RECORD: Record = Record {
    force: [617, -250, -1001],
    torque: [500, -1000, 2000],
    overload: 0,
};

#[test]
fn golden_commands_decode_and_encode() {
    for (bytes, command) in [
        ("55 0B 00 00 00 00 00 00 00 0B AA", Command::Start),
        ("55 0C 00 00 00 00 00 00 00 0C AA", Command::Stop),
        ("55 0A 00 00 00 00 00 00 00 0A AA", Command::ReadOnce),
        ("55 11 01 00 00 00 00 00 00 12 AA", Command::SetBias(true)),
        ("55 11 00 00 00 00 00 00 00 11 AA", Command::SetBias(false)),
        ("55 0F 08 00 00 00 00 00 00 17 AA", Command::SetRate(8)),
        (
            "55 08 00 00 00 00 00 00 00 08 AA",
            Command::SetFilter(FilterSetting::NONE),
        ),
        (
            "55 08 01 05 00 00 00 00 00 0E AA",
            Command::SetFilter(FilterSetting { kind: 1, code: 5 }),
        ),
        ("55 10 00 00 00 00 00 00 00 10 AA", Command::ReadRate),
    ] {
        let bytes = hex(bytes);
        assert_eq!(
            decode_command(&bytes),
            Ok(Parsed::Complete {
                value: command,
                used: COMMAND_LEN
            })
        );
        assert_eq!(encode_command(command).as_slice(), bytes);
    }
}

#[test]
fn golden_responses_decode_and_encode() {
    let overload = Record {
        force: [10_000, 0, 0],
        torque: [0; 3],
        overload: 0x20,
    };
    let refused = Outcome {
        result: 0,
        error: 2,
    };
    for (bytes, response) in [
        (STREAM, Response::Stream(RECORD)),
        (
            "55 0B 27 10 00 00 00 00 00 00 00 00 00 00 20 00 00 62 AA",
            Response::Stream(overload),
        ),
        (
            "55 0F 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00 10 AA",
            Response::RateSet(Outcome::TAKEN),
        ),
        (
            "55 0F 00 02 00 00 00 00 00 00 00 00 00 00 00 00 00 11 AA",
            Response::RateSet(refused),
        ),
        (
            "55 01 52 46 54 36 34 2D 53 42 30 31 00 00 00 00 00 7A AA",
            Response::Model(Text::new("RFT64-SB01").unwrap()),
        ),
    ] {
        let bytes = hex(bytes);
        assert_eq!(
            decode_response(&bytes),
            Ok(Parsed::Complete {
                value: response,
                used: RESPONSE_LEN
            })
        );
        assert_eq!(encode_response(&response).as_slice(), bytes);
    }
    assert_eq!(refused.error_text(), "value out of range");
}

#[test]
fn golden_halves_decode_join_and_encode() {
    let ids = CanIds::default();
    let first = CanFrame::standard(0x001, &hex("0B 02 69 FF 06 FC 17 01")).unwrap();
    let second = CanFrame::standard(0x002, &hex("F4 FC 18 07 D0 00 00 00")).unwrap();
    let (Ok(Half::First(d1)), Ok(Half::Second(d9))) =
        (decode_half(ids, &first), decode_half(ids, &second))
    else {
        panic!("halves");
    };
    assert_eq!(join(d1, d9), Ok(Response::Stream(RECORD)));
    assert_eq!(
        response_frames(ids, &Response::Stream(RECORD)),
        [first, second]
    );
    let start = CanFrame::standard(0x064, &hex("0B 00 00 00 00 00 00 00")).unwrap();
    assert_eq!(command_frame(ids, Command::Start), start);
}

#[test]
fn halves_with_a_foreign_id_or_a_short_payload_are_refused() {
    let ids = CanIds::default();
    let decode = |frame: Option<CanFrame>| decode_half(ids, &frame.unwrap());
    let field = |name, value| Err(DecodeError::Field { name, value });
    assert_eq!(decode(CanFrame::standard(3, &[0; 8])), field("can_id", 3));
    assert_eq!(
        decode(CanFrame::extended(1, &[0; 8])),
        field("extended can_id", 1)
    );
    assert_eq!(
        decode(CanFrame::standard(1, &[0; 7])),
        Err(DecodeError::Length {
            expected: 8,
            got: 7
        })
    );
    assert_eq!(
        join([0x0E; 8], [0; 8]),
        Err(DecodeError::Field {
            name: "D1",
            value: 0x0E
        })
    );
}

#[test]
fn every_prefix_is_incomplete() {
    assert_prefixes_incomplete(&hex(STREAM), decode_response);
    assert_prefixes_incomplete(&encode_command(Command::ReadModel), decode_command);
}

#[test]
fn every_flipped_bit_is_refused() {
    assert_flipped_bits_refused(&hex(STREAM), decode_response);
    assert_flipped_bits_refused(&encode_command(Command::SetRate(8)), decode_command);
}

#[test]
fn a_sum_does_not_see_bytes_that_change_places() {
    let mut swapped = hex(STREAM);
    swapped.swap(2, 4);
    assert!(matches!(
        decode_response(&swapped),
        Ok(Parsed::Complete { .. })
    ));
}

#[test]
fn each_broken_part_of_a_packet_is_named() {
    let field = |name, value| Err(DecodeError::Field { name, value });
    let broken = |at: usize, byte: u8| {
        let mut bytes = hex(STREAM);
        bytes[at] = byte;
        bytes
    };
    assert_eq!(
        decode_response(&broken(0, 0x56)),
        field("start of packet", 0x56)
    );
    assert_eq!(decode_response(&broken(18, 0)), field("end of packet", 0));
    assert_eq!(
        decode_response(&broken(17, 0)),
        Err(DecodeError::Checksum {
            computed: 0x6E,
            carried: 0
        })
    );
    let mut unknown = [0; 8];
    unknown[0] = 0x13;
    assert_eq!(
        Command::from_data(unknown),
        Err(DecodeError::Field {
            name: "D1",
            value: 0x13
        })
    );
    let bias_of_two = [0x11, 2, 0, 0, 0, 0, 0, 0];
    assert_eq!(
        Command::from_data(bias_of_two),
        Err(DecodeError::Field {
            name: "bias",
            value: 2
        })
    );
}

#[test]
fn codes_follow_the_manual() {
    assert_eq!(
        (1..=8).filter_map(rate_hz).collect::<Vec<_>>(),
        [10, 20, 50, 100, 200, 333, 500, 1000]
    );
    assert_eq!((rate_hz(0), rate_hz(9)), (Some(200), None));
    assert_eq!(
        (rate_code(200), rate_code(1000), rate_code(123)),
        (Some(5), Some(8), None)
    );
    assert_eq!(
        FilterSetting::low_pass(100),
        Some(FilterSetting { kind: 1, code: 5 })
    );
    assert_eq!(
        FilterSetting::low_pass(1).and_then(FilterSetting::cut_off_hz),
        Some(1)
    );
    assert_eq!(FilterSetting::NONE.cut_off_hz(), None);
    assert_eq!(max_rate_hz_at(115_200), Some(333));
    assert_eq!(max_rate_hz_at(9_600), None);
}

#[test]
fn a_model_is_found_by_the_name_it_gives() {
    let padded = Text(*b"RFT80-6A03     ");
    assert_eq!(
        padded
            .as_str()
            .and_then(model_named)
            .map(|model| (model.df, model.dt)),
        Some((25.0, 500.0))
    );
    assert_eq!(
        model_named("RFT64-6A01").map(|model| model.dt),
        Some(1000.0)
    );
    assert_eq!(model_named("RFT99"), None);
    assert_eq!(Text([0xFF; 15]).as_str(), None);
    assert_eq!(Text::new("sixteen letters!"), None);
}

fn any_response() -> impl Strategy<Value = Response> {
    let text = any::<[u8; 15]>().prop_map(Text);
    let outcome = any::<[u8; 2]>().prop_map(|[result, error]| Outcome { result, error });
    let record = (any::<[i16; 3]>(), any::<[i16; 3]>(), any::<u8>()).prop_map(
        |(force, torque, overload)| Record {
            force,
            torque,
            overload,
        },
    );
    prop_oneof![
        text.clone().prop_map(Response::Model),
        text.clone().prop_map(Response::SerialNumber),
        text.prop_map(Response::Firmware),
        outcome.clone().prop_map(Response::FilterSet),
        outcome.prop_map(Response::RateSet),
        any::<[u8; 2]>().prop_map(|[kind, code]| Response::Filter(FilterSetting { kind, code })),
        record.clone().prop_map(Response::Once),
        record.prop_map(Response::Stream),
        any::<u8>().prop_map(Response::Rate),
        any::<[u8; 6]>().prop_map(Response::OverloadCounters),
    ]
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
        let _ = decode_response(&bytes);
        let _ = decode_command(&bytes);
    }

    #[test]
    fn what_is_encoded_decodes_to_itself(response in any_response()) {
        let bytes = encode_response(&response);
        prop_assert_eq!(decode_response(&bytes), Ok(Parsed::Complete { value: response, used: RESPONSE_LEN }));
        let ids = CanIds { command: 9, first: 7, second: 8 };
        let halves = response_frames(ids, &response).map(|frame| decode_half(ids, &frame));
        let [Ok(Half::First(first)), Ok(Half::Second(second))] = halves else { panic!("halves") };
        prop_assert_eq!(join(first, second), Ok(response));
    }
}
