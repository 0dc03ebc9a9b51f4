//! What bits and codes mean: driver and simulator share these, too. Each stands here once more, from the maker's table
//! (`drivers/SOURCES.md` names them).
#![allow(clippy::unwrap_used, reason = "a test")]

use ft_wire::ati_netcanoem::{self, FACTORY_BASE, Reply};
use ft_wire::robotous_rft::{self, FilterSetting, Model};
use ft_wire::{CanFrame, bota_serial, dynamixel2, gs_usb, hid, leptrino, optoforce_hex};

#[test]
fn bota_status_bits_are_those_of_the_maker() {
    use bota_serial::Status;
    let bits = [
        Status::APP_TOOK_TOO_LONG,
        Status::OVERRANGE,
        Status::INVALID_MEASUREMENTS,
        Status::RAW_MEASUREMENTS,
    ];
    assert_eq!(bits, [0x01, 0x02, 0x04, 0x08]);
    assert!(Status(0x02).has(Status::OVERRANGE) && !Status(0x0D).has(Status::OVERRANGE));
}

/// Protocol 1.13: 1 bad correction data in ROM, 2 the sensor, 4 beyond the rating.
#[test]
fn leptrino_status_bits_are_those_of_the_protocol() {
    use leptrino::Status;
    let bits = [
        Status::BAD_CORRECTION,
        Status::SENSOR_ERROR,
        Status::OVER_RATING,
    ];
    assert_eq!(bits, [0x01, 0x02, 0x04]);
    assert!(Status(0x04).has(Status::OVER_RATING) && !Status(0x03).has(Status::OVER_RATING));
}

/// `optoforce: status.py`: bits 15 to 13 the converter, 12 to 10 the sensor, 9 to 4 Fx to Tz.
#[test]
fn optoforce_status_has_three_parts() {
    use optoforce_hex::Status;
    for code in [0, 1, 2, 4, 7] {
        let status = |shift: u32| Status(code << shift);
        let parts = |status: Status| (status.converter(), status.sensor(), status.overload());
        assert_eq!(parts(status(13)), (code, 0, 0));
        assert_eq!(parts(status(10)), (0, code, 0));
        assert_eq!(parts(status(4)), (0, 0, code));
    }
    assert_eq!(Status(0x03F0).overload(), 0x3F);
}

/// 9610-05-1030, section 7.
#[test]
fn ati_status_bits_are_those_of_the_manual() {
    use ati_netcanoem::Status;
    let bits = [
        Status::TOO_HIGH,
        Status::TOO_LOW,
        Status::BUS_ERROR,
        Status::ANY,
    ];
    assert_eq!(bits, [0x0002, 0x0004, 0x4000, 0x8000]);
    assert!(Status(0x4000).has(Status::BUS_ERROR) && !Status(0xBFFF).has(Status::BUS_ERROR));
    let meanings: Vec<_> = (0..16).map(Status::meaning).collect();
    let expected = [
        "watchdog reset",
        "gauge or converter too high",
        "gauge or converter too low",
        "artificial ground out of range",
        "supply too high",
        "supply too low",
        "bad active calibration",
        "EEPROM failure",
        "configuration invalid",
        "an undocumented bit",
        "an undocumented bit",
        "temperature too high",
        "temperature too low",
        "an undocumented bit",
        "CAN bus error",
        "an error",
    ];
    assert_eq!(meanings, expected);
}

/// Ids 0x202, 0x203 and 0x204 carry gauges 0 and 1, 2 and 3, 4 and 5.
#[test]
fn parts_of_an_ati_matrix_are_in_the_order_of_their_ids() {
    let pair = [0x3F, 0xC0, 0, 0, 0xC0, 0x10, 0, 0];
    for (id, part) in [(0x202, 0), (0x203, 1), (0x204, 2)] {
        let frame = CanFrame::standard(id, &pair).unwrap();
        let pair = [1.5, -2.25];
        assert_eq!(
            ati_netcanoem::decode(FACTORY_BASE, &frame),
            Ok(Reply::MatrixPart { part, pair })
        );
    }
}

/// The wrench is divided by these.
#[test]
fn ati_counts_of_none_per_unit_are_refused() {
    let decode = |payload: [u8; 8]| {
        let frame = CanFrame::standard(0x207, &payload).unwrap();
        ati_netcanoem::decode(FACTORY_BASE, &frame)
    };
    let taken = Reply::CountsPerUnit([1, 1_000_000]);
    assert_eq!(decode([0, 0, 0, 1, 0, 0x0F, 0x42, 0x40]), Ok(taken));
    assert!(decode([0, 0, 0, 0, 0, 0x0F, 0x42, 0x40]).is_err());
    assert!(decode([0, 0x0F, 0x42, 0x40, 0, 0, 0, 0]).is_err());
}

/// Codes 1 to 6: lbf, N, klbf, kN, kgf, gf; lbf in, lbf ft, N m, N mm, kgf cm, kN m. By the definitions of pound, inch and foot.
#[test]
fn ati_units_are_those_of_the_manual() {
    const KGF: f64 = 9.806_65;
    const LBF: f64 = 0.453_592_37 * KGF;
    let forces = [LBF, 1.0, 1000.0 * LBF, 1000.0, KGF, 1e-3 * KGF];
    let torques = [0.0254 * LBF, 0.3048 * LBF, 1.0, 1e-3, 0.01 * KGF, 1000.0];
    for (code, expected) in (1..).zip(forces.into_iter().zip(torques)) {
        let frame = CanFrame::standard(0x208, &[code, code]).unwrap();
        let Ok(Reply::Units([force, torque])) = ati_netcanoem::decode(FACTORY_BASE, &frame) else {
            panic!("{code}");
        };
        assert!((force / expected.0 - 1.0).abs() < 1e-12, "{code}: {force}");
        assert!(
            (torque / expected.1 - 1.0).abs() < 1e-12,
            "{code}: {torque}"
        );
    }
}

/// Half of the second phase, at most the adapter's limit (the seventh word), as Linux has it.
#[test]
fn a_candlelights_jump_is_half_of_the_second_phase() {
    let jump = |most| {
        let words: [u32; 10] = [0x13, 48_000_000, 1, 16, 1, 8, most, 1, 1024, 1];
        let bytes = words.map(u32::to_le_bytes).concat();
        let timing = gs_usb::Limits::decode(&bytes).unwrap().timing(1_000_000);
        let timing = timing.unwrap();
        (timing.phase_2, timing.jump)
    };
    assert_eq!((jump(4), jump(1)), ((4, 2), (4, 1)));
}

/// What CiA recommends and Linux's driver takes: 87.5 % of a bit up to 500 kbit/s, 80 % up to 800 kbit/s, 75 % above. With the limits
/// of candleLight's firmware on a clock of 48 MHz.
#[test]
fn candlelight_bits_are_sampled_where_cia_says() {
    let words: [u32; 10] = [0x13, 48_000_000, 1, 16, 1, 8, 4, 1, 1024, 1];
    let limits = gs_usb::Limits::decode(&words.map(u32::to_le_bytes).concat()).unwrap();
    for (bitrate_bps, thousandths) in [
        (125_000, 875),
        (250_000, 875),
        (500_000, 875),
        (800_000, 800),
        (1_000_000, 750),
    ] {
        let timing = limits.timing(bitrate_bps).unwrap();
        let before = 1 + timing.propagation + timing.phase_1;
        let quanta = before + timing.phase_2;
        assert_eq!(48_000_000 / timing.divisor / quanta, bitrate_bps);
        assert_eq!(1_000 * before / quanta, thousandths, "{bitrate_bps}");
    }
}

/// XM430: a turn is 4096 counts, a count of the velocity 0.229 turns a minute, of the current 2.69 mA.
#[test]
fn dynamixel_units_are_those_of_the_manual() {
    let units = [
        dynamixel2::COUNTS_PER_TURN,
        dynamixel2::VELOCITY_UNIT_RPM,
        dynamixel2::CURRENT_UNIT_A,
    ];
    assert_eq!(units, [4096.0, 0.229, 0.002_69]);
}

/// The control table of XL330, XL430 and XM430.
#[test]
fn dynamixel_addresses_are_those_of_the_manual() {
    use dynamixel2::address;
    let addresses = [
        address::TORQUE_ENABLE,
        address::HARDWARE_ERROR,
        address::PRESENT_STATE,
    ];
    assert_eq!(addresses, [64, 70, 126]);
}

/// Manual 1.82, and the maker's ROS 2 package.
#[test]
fn robotous_codes_are_those_of_the_manual() {
    let cut_offs = [500, 300, 200, 150, 100, 50, 40, 30, 20, 10, 5, 3, 2, 1];
    for (code, hz) in (1..).zip(cut_offs) {
        let filter = FilterSetting { kind: 1, code };
        assert_eq!(filter.cut_off_hz(), Some(hz));
        assert_eq!(FilterSetting::low_pass(hz), Some(filter));
    }
    let rates = [200, 10, 20, 50, 100, 200, 333, 500, 1000];
    for (code, hz) in (0..).zip(rates) {
        assert_eq!(robotous_rft::rate_hz(code), Some(hz));
    }
    let most = [
        (57_600, 200),
        (115_200, 333),
        (230_400, 500),
        (460_800, 500),
        (921_600, 1000),
    ];
    for (bps, hz) in most {
        assert_eq!(robotous_rft::max_rate_hz_at(bps), Some(hz));
    }
}

/// Manual 1.82, 3.6.11.
#[test]
fn robotous_models_have_the_manuals_divisors() {
    let models = robotous_rft::MODELS.map(|model| {
        let Model { name, df, dt, .. } = model;
        (name, df, dt, model.max_rate_hz)
    });
    let expected = [
        ("RFT40-SA01", 50.0, 2000.0, 200),
        ("RFT44-SB01", 50.0, 2000.0, 200),
        ("RFT60-HA01", 50.0, 2000.0, 1000),
        ("RFT64-SB01", 50.0, 2000.0, 1000),
        ("RFT64-6A01", 50.0, 1000.0, 1000),
        ("RFT80-6A01", 50.0, 1000.0, 1000),
        ("RFT80-6A02", 50.0, 1000.0, 1000),
        ("RFT80-6A03", 25.0, 500.0, 1000),
    ];
    assert_eq!(models, expected);
}

/// A dial of a byte in degrees, 0 to `most`, with this unit exponent and these flags of its input.
fn dials(most: u8, exponent: u8, flags: u8) -> Vec<hid::Axis> {
    let descriptor = [
        0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x15, 0x00, 0x25, most, 0x55, exponent, 0x65, 0x14,
        0x75, 0x08, 0x95, 0x01, 0x09, 0x37, 0x81, flags, 0xC0,
    ];
    hid::axes(&descriptor).unwrap_or_default()
}

/// HID 1.11, 6.2.2.5: bit 0 of an input is set for padding, which has no value whatever its usage; bit 2 for steps.
#[test]
fn inputs_are_padding_positions_or_steps() {
    let motions = |flags| -> Vec<_> {
        let dials = dials(100, 0, flags).into_iter();
        dials.map(|dial| dial.motion).collect()
    };
    assert_eq!(motions(0x02), [hid::Motion::Absolute]);
    assert_eq!(motions(0x06), [hid::Motion::Relative]);
    assert_eq!(motions(0x03), []);
}

/// HID 1.11, 6.2.2.7: an exponent is four bits with a sign, 7 the largest and 8 the smallest.
#[test]
fn unit_exponents_have_a_sign() {
    let exponents = [0x0, 0x1, 0x7, 0x8, 0xF].map(|code| dials(100, code, 0x02)[0].exponent);
    assert_eq!(exponents, [0, 1, 7, -8, -1]);
}

#[test]
fn a_maximum_of_minus_one_behind_a_minimum_of_none_means_255() {
    assert_eq!(dials(0xFF, 0, 0x02)[0].logical, (0, 255));
}
