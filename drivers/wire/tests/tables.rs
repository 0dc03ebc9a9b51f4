//! Bytes that driver and simulator take from the same line of code: a wrong one would meet itself, and no round trip would see it.
//! Each stands here once more, from the maker's table (`drivers/SOURCES.md` names them).
#![allow(clippy::unwrap_used, reason = "a test")]

use ft_wire::bota_serial::{BaudRate, Command as BotaCommand, Filter};
use ft_wire::dynamixel2::StatusError;
use ft_wire::optoforce_hex::Packet;
use ft_wire::robotous_rft::{Command, FilterSetting, Outcome, Response, Text};
use ft_wire::{Parsed, amt21, bota_serial, encoder_line, gs_usb, hid, optoforce_hex, robotous_rft};

fn hex(text: &str) -> Vec<u8> {
    let bytes = text.split_whitespace();
    bytes
        .map(|byte| u8::from_str_radix(byte, 16).unwrap())
        .collect()
}

/// Manual 1.82, 3.6: the first byte is the command's number, the sum is of the data.
#[test]
fn robotous_questions_have_the_manuals_numbers() {
    for (bytes, command) in [
        ("55 01 00 00 00 00 00 00 00 01 AA", Command::ReadModel),
        (
            "55 02 00 00 00 00 00 00 00 02 AA",
            Command::ReadSerialNumber,
        ),
        ("55 03 00 00 00 00 00 00 00 03 AA", Command::ReadFirmware),
        ("55 09 00 00 00 00 00 00 00 09 AA", Command::ReadFilter),
        (
            "55 12 00 00 00 00 00 00 00 12 AA",
            Command::ReadOverloadCounters,
        ),
    ] {
        let bytes = hex(bytes);
        assert_eq!(robotous_rft::encode_command(command).as_slice(), bytes);
        let used = bytes.len();
        let value = command;
        assert_eq!(
            robotous_rft::decode_command(&bytes),
            Ok(Parsed::Complete { value, used })
        );
    }
}

#[test]
fn robotous_answers_have_the_manuals_numbers() {
    let text = Text::new("AB").unwrap();
    let filter = FilterSetting { kind: 1, code: 5 };
    for (bytes, response) in [
        (
            "55 02 41 42 00 00 00 00 00 00 00 00 00 00 00 00 00 85 AA",
            Response::SerialNumber(text),
        ),
        (
            "55 03 41 42 00 00 00 00 00 00 00 00 00 00 00 00 00 86 AA",
            Response::Firmware(text),
        ),
        (
            "55 08 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00 09 AA",
            Response::FilterSet(Outcome::TAKEN),
        ),
        (
            "55 09 01 05 00 00 00 00 00 00 00 00 00 00 00 00 00 0F AA",
            Response::Filter(filter),
        ),
        (
            "55 10 08 00 00 00 00 00 00 00 00 00 00 00 00 00 00 18 AA",
            Response::Rate(8),
        ),
        (
            "55 12 01 02 03 04 05 06 00 00 00 00 00 00 00 00 00 27 AA",
            Response::OverloadCounters([1, 2, 3, 4, 5, 6]),
        ),
    ] {
        let bytes = hex(bytes);
        assert_eq!(robotous_rft::encode_response(&response).as_slice(), bytes);
        let (value, used) = (response, bytes.len());
        assert_eq!(
            robotous_rft::decode_response(&bytes),
            Ok(Parsed::Complete { value, used })
        );
    }
}

/// An acknowledgement repeats the command's own letter.
#[test]
fn bota_acknowledgements_repeat_the_letter() {
    let setup = BotaCommand::CommSetup {
        temperature_compensation: true,
        calibration: true,
        baud: BaudRate::Bps460800,
    };
    let filter = BotaCommand::Filter(Filter {
        sinc_length: 64,
        chop: false,
        fast: false,
        fir_disable: true,
    });
    for (text, command) in [
        ("C", BotaCommand::Config),
        ("R", BotaCommand::Run),
        ("I", BotaCommand::Init),
        ("c,1,1,0,4", setup),
        ("f,64,0,0,1", filter),
        ("s", BotaCommand::Save),
    ] {
        assert_eq!(command.text().as_bytes(), text.as_bytes());
        assert_eq!(command.ack_letter(), text.bytes().next());
        let ack = format!("r,0,{},0", text.get(..1).unwrap());
        let Ok(Parsed::Complete { value, used: 7 }) = bota_serial::decode_ack(ack.as_bytes())
        else {
            panic!("{ack}");
        };
        assert_eq!(Some(value.command), command.ack_letter());
    }
    assert_eq!(BotaCommand::HardwareReset.ack_letter(), None);
}

/// `shadow-robot/optoforce: optoforce.py`: AA 00 12 08, eight characters, the sum.
#[test]
fn an_optoforce_serial_number_has_the_bytes_of_the_table() {
    let bytes = hex("AA 00 12 08 49 53 45 31 32 33 34 35 02 A4");
    let value = Packet::SerialNumber(*b"ISE12345");
    let used = bytes.len();
    assert_eq!(optoforce_hex::encode(&value).as_slice(), bytes);
    assert_eq!(
        optoforce_hex::decode(&bytes),
        Ok(Parsed::Complete { value, used })
    );
}

/// `candleLight_fw: include/gs_usb.h`; the word 0000BEEF, and what a vendor's request to an interface is in USB 2.0, 9.3.
#[test]
fn candlelight_requests_have_the_firmwares_numbers() {
    use gs_usb::request;
    assert_eq!((gs_usb::REQUEST_OUT, gs_usb::REQUEST_IN), (0x41, 0xC1));
    assert_eq!(gs_usb::HOST_FORMAT, 0x0000_BEEF_u32.to_le_bytes());
    let numbers = [
        request::HOST_FORMAT,
        request::BIT_TIMING,
        request::MODE,
        request::LIMITS,
        request::DEVICE,
    ];
    assert_eq!(numbers, [0, 1, 2, 4, 5]);
}

/// Protocol 2.0: bit 7 is the hardware alert, the others are the number.
#[test]
fn a_dynamixel_error_byte_is_alert_and_number() {
    for (byte, alert, code) in [
        (0, false, 0),
        (0x80, true, 0),
        (0x87, true, 7),
        (0x01, false, 1),
    ] {
        let error = StatusError(byte);
        assert_eq!((error.hardware_alert(), error.code()), (alert, code));
    }
}

#[test]
fn an_amt21_of_the_factory_is_asked_at_its_address() {
    assert_eq!(amt21::FACTORY_ADDRESS, 0x54);
    assert_eq!(amt21::position_request(0x54), 0x54);
}

#[test]
fn a_check_of_an_encoder_line_has_hexadecimal_digits_only() {
    assert!(encoder_line::decode(b"$ENC,1000000,2048*77\r\n").is_ok());
    assert!(encoder_line::decode(b"$ENC,1000007,2048*70\r\n").is_ok());
    // A digit G would be 16, and 6 * 16 + 16 the right check.
    assert!(encoder_line::decode(b"$ENC,1000007,2048*6G\r\n").is_err());
}

/// HID 1.11, 6.2.2.7: system 1 is centimetres, 2 radians, 4 degrees; the next nibble is the power of the length.
#[test]
fn an_axis_in_radians_is_one() {
    // A dial of 8 bits: 0 to 100 are 0 to 100 rad times 10^-2.
    let descriptor =
        hex("05 01 09 04 A1 01 09 37 15 00 25 64 35 00 45 64 55 0E 65 12 75 08 95 01 81 02 C0");
    let axes = hid::axes(&descriptor).unwrap();
    let [dial] = axes[..] else { panic!("{axes:?}") };
    assert!((dial.radians_per_count().unwrap() - 0.01).abs() < 1e-15);
}

/// HID 1.11, 6.2.2.8: usages belong to the next main item alone, be it an output (90) or a feature (B0).
#[test]
fn usages_of_outputs_and_features_are_not_those_of_the_next_input() {
    for main in ["91 02", "B1 02"] {
        let descriptor = hex(&format!(
            "05 01 09 04 A1 01 15 00 25 64 75 08 95 01 09 36 {main} 09 37 81 02 C0"
        ));
        let axes = hid::axes(&descriptor).unwrap();
        let usages: Vec<_> = axes.iter().map(|axis| axis.usage).collect();
        assert_eq!(usages, [hid::Usage::Dial], "{main}");
    }
}
