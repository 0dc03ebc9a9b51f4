use proptest::prelude::*;

use super::*;
use crate::test_support::hex;

// hardware.md 3.6, `NicoHood/HID: SingleGamepad.cpp`: no report id; 32 buttons, X Y Rx Ry of 16 bits, Z Rz of 8, two hats.
const GAMEPAD: &str = "05 01 09 04 A1 01 05 09 19 01 29 20 15 00 25 01 75 01 95 20 81 02 05 01 A1 00 09 30 09 31 \
                       09 33 09 34 16 00 80 26 FF 7F 75 10 95 04 81 02 09 32 09 35 15 80 25 7F 75 08 95 02 81 02 C0 \
                       05 01 09 39 09 39 15 01 25 08 95 02 75 04 81 02 C0";
// `NicoHood/HID: SurfaceDial.cpp`: a button bit, a dial of 15 bits, relative, 0.1 degree.
const DIAL: &str = "05 01 09 0E A1 01 05 0D 09 21 A1 00 05 09 09 01 95 01 75 01 15 00 25 01 81 02 05 01 09 37 95 01 \
                    75 0F 55 0F 65 14 36 F0 F1 46 10 0E 16 F0 F1 26 10 0E 81 06 C0 C0";
// The layout of `MHeironimus/ArduinoJoystickLibrary`: report id 3, 32 buttons, two hats, X and Y of 16 bits without sign.
const JOYSTICK: &str = "05 01 09 04 A1 01 85 03 05 09 19 01 29 20 15 00 25 01 75 01 95 20 55 00 65 00 81 02 \
                        05 01 09 39 15 00 25 07 35 00 46 3B 01 65 14 75 04 95 01 81 02 09 39 81 02 \
                        65 00 35 00 45 00 09 01 15 00 27 FF FF 00 00 75 10 95 02 A1 00 09 30 09 31 81 02 C0 C0";

fn found(descriptor: &str) -> Vec<Axis> {
    axes(&hex(descriptor)).unwrap()
}

fn axis(axes: &[Axis], usage: Usage) -> Axis {
    *axes.iter().find(|axis| axis.usage == usage).unwrap()
}

#[test]
fn a_gamepad_of_sixteen_and_eight_bit_axes_is_read() {
    let axes = found(GAMEPAD);
    let usages: Vec<_> = axes.iter().map(|axis| axis.usage.name()).collect();
    assert_eq!(usages, ["x", "y", "rx", "ry", "z", "rz"]);
    let mut report = [0; 15];
    report[4..6].copy_from_slice(&(-32_768_i16).to_le_bytes());
    report[6..8].copy_from_slice(&1_234_i16.to_le_bytes());
    report[13] = 0x80;
    let read = |usage| axis(&axes, usage).read(&report).unwrap();
    assert_eq!(read(Usage::X), Some(-32_768));
    assert_eq!(read(Usage::Y), Some(1_234));
    assert_eq!(read(Usage::Rz), Some(-128));
    assert_eq!(axes[0].logical, (-32_768, 32_767));
}

#[test]
fn a_dial_of_tenths_of_a_degree_is_read_across_its_button_bit() {
    let axes = found(DIAL);
    let [dial] = axes[..] else { panic!("{axes:?}") };
    assert_eq!((dial.usage, dial.motion), (Usage::Dial, Motion::Relative));
    assert_eq!((dial.bit, dial.bits, dial.report_len), (1, 15, 2));
    for step in [0_i16, 1, -1, 3_600, -3_600] {
        let raw = step.cast_unsigned() << 1 | 1;
        assert_eq!(
            dial.read(&raw.to_le_bytes()),
            Ok(Some(step.into())),
            "{step}"
        );
    }
    let tenth = 0.1_f64.to_radians();
    assert!((dial.radians_per_count().unwrap() - tenth).abs() < 1e-15);
    let beyond = (3_601_u16 << 1).to_le_bytes();
    assert_eq!(
        dial.read(&beyond),
        Ok(None),
        "a number out of range is no value"
    );
}

#[test]
fn a_joystick_with_a_report_id_is_read_and_other_reports_are_passed_over() {
    let axes = found(JOYSTICK);
    let (x, y) = (axis(&axes, Usage::X), axis(&axes, Usage::Y));
    assert_eq!(
        (x.report_len, x.logical, x.physical),
        (10, (0, 65_535), (0, 65_535))
    );
    let report = [3, 0, 0, 0, 0, 0, 0xFF, 0xFF, 0x34, 0x12];
    assert_eq!(x.read(&report), Ok(Some(65_535)));
    assert_eq!(y.read(&report), Ok(Some(0x1234)));
    assert_eq!(y.read(&[4, 1, 2]), Ok(None));
    assert_eq!(
        y.read(&report[..9]),
        Err(DecodeError::Length {
            expected: 10,
            got: 9
        })
    );
    assert_eq!(x.radians_per_count(), None, "its unit is none");
}

#[test]
fn push_and_pop_keep_what_stands_between() {
    // X of 8 bits; inside push and pop Y of 16; then Z of 8 again.
    let pushed = "05 01 A1 01 15 00 25 7F 75 08 95 01 09 30 81 02 A4 26 FF 00 75 10 09 31 81 02 B4 09 32 81 02 C0";
    let axes = found(pushed);
    let shape: Vec<_> = axes
        .iter()
        .map(|axis| (axis.bit, axis.bits, axis.logical.1))
        .collect();
    assert_eq!(shape, [(0, 8, 127), (8, 16, 255), (24, 8, 127)]);
}

#[test]
fn ranges_extended_usages_padding_and_long_items_are_understood() {
    // X..Rz as a range of 8 bits; a long item; 4 bits of padding; a slider named with its page in four bytes.
    let mixed = "05 01 A1 01 15 00 26 FF 00 75 08 95 06 19 30 29 35 81 02 FE 02 00 AA BB 75 04 95 01 81 01 \
                 05 09 0B 36 00 01 00 75 0C 26 FF 0F 81 02 C0";
    let axes = found(mixed);
    assert_eq!(axes.len(), 7);
    let slider = axis(&axes, Usage::Slider);
    assert_eq!((slider.bit, slider.bits, slider.report_len), (52, 12, 8));
    let report = [0, 0, 0, 0, 0, 0, 0xB0, 0xA5];
    assert_eq!(slider.read(&report), Ok(Some(0xA5B)));
    // 255 in one byte behind a minimum of 0 is no -1.
    assert_eq!(
        found("05 01 A1 01 15 00 25 FF 75 08 95 01 09 30 81 02 C0")[0].logical,
        (0, 255)
    );
}

#[test]
fn a_last_usage_holds_for_the_fields_that_are_left_and_arrays_are_no_axes() {
    let repeated = found("05 01 A1 01 15 00 25 7F 75 08 95 03 09 36 81 02 C0");
    let bits: Vec<_> = repeated.iter().map(|axis| axis.bit).collect();
    assert_eq!(bits, [0, 8, 16]);
    assert_eq!(
        found("05 01 A1 01 15 00 25 7F 75 08 95 01 09 30 81 00 C0"),
        []
    );
}

#[test]
fn an_axis_of_32_bits_in_the_middle_of_a_byte_is_read() {
    let wide = "05 01 A1 01 75 04 95 01 81 01 17 00 00 00 80 27 FF FF FF 7F 75 20 09 30 81 02 75 04 81 01 C0";
    let [x] = found(wide)[..] else { panic!() };
    let value = -123_456_789_i32;
    let raw = u64::from(value.cast_unsigned()) << 4;
    assert_eq!(x.read(&raw.to_le_bytes()[..5]), Ok(Some(value)));
}

#[test]
fn what_cannot_be_is_named() {
    for (descriptor, name) in [
        ("05", "descriptor, which is cut off"),
        ("FE", "descriptor, which is cut off"),
        ("FE 05 00 01", "descriptor, which is cut off"),
        ("B4", "pop without push"),
        ("C0", "end of a collection that never began"),
        ("A1 01", "collection without end"),
        ("85 00", "report id"),
        ("29 05", "usage maximum without minimum"),
        ("05 01 19 35 29 30", "usage maximum below minimum"),
        ("05 01 75 20 95 7F 81 01", "report, too long"),
        (
            "05 01 09 30 25 7F 75 40 95 01 81 02",
            "report size of an axis",
        ),
        (
            "05 01 09 30 75 08 95 01 81 02",
            "logical maximum, not above the minimum",
        ),
    ] {
        let refused = axes(&hex(descriptor));
        assert!(
            matches!(refused, Err(DecodeError::Field { name: named, .. }) if named == name),
            "{descriptor}: {refused:?}"
        );
    }
    let deep = [0xA4; MAX_DESCRIPTOR];
    assert!(matches!(
        axes(&deep),
        Err(DecodeError::Field {
            name: "push, too deep",
            ..
        })
    ));
    let long = [0; MAX_DESCRIPTOR + 1];
    assert!(matches!(axes(&long), Err(DecodeError::Length { .. })));
    let many = [0x09, 0x30].repeat(300);
    assert!(matches!(
        axes(&many),
        Err(DecodeError::Field {
            name: "usages, too many",
            ..
        })
    ));
}

#[test]
fn billions_of_fields_without_a_bit_do_not_keep_the_parser() {
    // 4 294 967 295 fields of 0 bits, a hat switch each, in 500 reports: hours when each is looked at.
    let many = "09 39 81 02 ".repeat(500);
    assert_eq!(
        found(&format!("05 01 A1 01 75 00 97 FF FF FF FF {many} C0")),
        []
    );
}

#[test]
fn every_prefix_of_a_descriptor_is_refused_or_has_no_more_axes() {
    for descriptor in [GAMEPAD, DIAL, JOYSTICK].map(hex) {
        let whole = axes(&descriptor).unwrap().len();
        for len in 0..descriptor.len() {
            if let Ok(axes) = axes(&descriptor[..len]) {
                assert!(axes.len() <= whole);
            }
        }
    }
}

#[test]
fn usages_are_found_by_their_names() {
    for usage in Usage::ALL {
        assert_eq!(Usage::named(usage.name()), Some(usage));
    }
    assert_eq!(Usage::named("throttle"), None);
}

proptest! {
    #[test]
    fn arbitrary_descriptors_and_reports_never_panic(
        descriptor in proptest::collection::vec(any::<u8>(), 0..200),
        report in proptest::collection::vec(any::<u8>(), 0..80),
    ) {
        for axis in axes(&descriptor).unwrap_or_default() {
            let _ = axis.read(&report);
            let _ = axis.radians_per_count();
        }
        let _ = Report::new(&report);
    }

    #[test]
    fn flipped_bits_of_a_descriptor_never_panic_and_no_number_leaves_its_range(
        bit in 0_usize..400, report in proptest::collection::vec(any::<u8>(), 15)
    ) {
        let mut descriptor = hex(GAMEPAD);
        let bit = bit % (descriptor.len() * 8);
        descriptor[bit / 8] ^= 1 << (bit % 8);
        for axis in axes(&descriptor).unwrap_or_default() {
            if let Ok(Some(value)) = axis.read(&report) {
                prop_assert!((axis.logical.0..=axis.logical.1).contains(&value));
            }
        }
    }
}
