//! What bits and codes mean: driver and simulator share these, too. Each stands here once more, from the maker's table
//! (`drivers/SOURCES.md` names them).
#![allow(clippy::unwrap_used, reason = "a test")]

use ft_wire::ati_netcanoem::{self, FACTORY_BASE, Reply};
use ft_wire::robotous_rft::{self, FilterSetting, Model};
use ft_wire::{CanFrame, bota_serial, hid, leptrino};

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

/// HID 1.11, 6.2.2.5: bit 0 of an input is set for padding, which has no value whatever its usage.
#[test]
fn constant_inputs_are_padding() {
    let dial = |flags| {
        let descriptor = [
            0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x15, 0x00, 0x25, 0x64, 0x75, 0x08, 0x95, 0x01,
            0x09, 0x37, 0x81, flags, 0xC0,
        ];
        hid::axes(&descriptor).map(|axes| axes.len())
    };
    assert_eq!(dial(0x02), Ok(1));
    assert!(!matches!(dial(0x03), Ok(1..)), "{:?}", dial(0x03));
}
