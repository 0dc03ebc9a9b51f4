//! Axes of HID devices: the reports of a gadget, the kernel's descriptor and hidraw, our driver.

use std::f64::consts::TAU;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use ft_capture::config::{Device, Driver};
use ft_drivers::discover::{self, FoundHid};
use ft_drivers::{Clock as _, MonotonicClock};

use crate::Case;
use crate::gadget::Gadget;
use crate::hear::hear;
use crate::machine::{load, wait_for};

pub(crate) const CASES: &[Case] = &[
    ("hid_slider_is_a_width", hid_slider_is_a_width),
    ("hid_dial_sums_its_steps", hid_dial_sums_its_steps),
    ("hid_unplugged_is_gone", hid_unplugged_is_gone),
];

/// HID 1.11 6.2.2 by hand: joystick, report 3, a slider of 16 bits, 0 to 65535.
const SLIDER: &[u8] = &[
    0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x85, 0x03, 0x09, 0x36, 0x15, 0x00, 0x27, 0xFF, 0xFF, 0x00,
    0x00, 0x75, 0x10, 0x95, 0x01, 0x81, 0x02, 0xC0,
];
/// A system multi-axis controller's dial of 16 bits, relative, tenths of a degree.
const DIAL: &[u8] = &[
    0x05, 0x01, 0x09, 0x0E, 0xA1, 0x01, 0x09, 0x37, 0x95, 0x01, 0x75, 0x10, 0x55, 0x0F, 0x65, 0x14,
    0x36, 0xF0, 0xF1, 0x46, 0x10, 0x0E, 0x16, 0xF0, 0xF1, 0x26, 0x10, 0x0E, 0x81, 0x06, 0xC0,
];
/// An Arduino Leonardo.
const ARDUINO: (u16, u16) = (0x2341, 0x8036);

/// A HID device on a gadget, its side and the host's.
struct Plugged {
    gadget: Gadget,
    side: PathBuf,
    found: FoundHid,
}

impl Plugged {
    fn new(descriptor: &[u8], report_length: usize) -> Self {
        for module in ["usb_f_hid", "usbhid", "hid_generic"] {
            load(module);
        }
        let gadget = Gadget::new(0, ARDUINO.0, ARDUINO.1, "LABHID");
        gadget.function("hid.usb0");
        gadget.write(
            "functions/hid.usb0/report_length",
            report_length.to_string(),
        );
        gadget.write("functions/hid.usb0/report_desc", descriptor);
        gadget.add("hid.usb0");
        gadget.plug_in();
        let longest = Duration::from_secs(15);
        let mut found = None;
        wait_for("the host's hidraw", longest, || {
            found = discover::hid_devices().into_iter().next();
            found.as_ref().is_some_and(|found| found.path.exists())
        });
        let side = PathBuf::from("/dev/hidg0");
        wait_for("the gadget's side", longest, || side.exists());
        let found = found.unwrap();
        assert_eq!((found.vendor, found.product), ARDUINO);
        Self {
            gadget,
            side,
            found,
        }
    }

    fn device(&self, settings: &str) -> Device {
        Device {
            name: "gripper".to_owned(),
            driver: Driver::HidAxis,
            port: self.found.path.display().to_string(),
            latency_us: 0.0,
            settings: toml::from_str(settings).unwrap(),
        }
    }

    /// Sends reports while `device` is heard for as many samples, and gives the widths.
    fn widths(&self, device: &Device, reports: Vec<Vec<u8>>) -> Vec<f64> {
        let (side, samples) = (self.side.clone(), reports.len());
        // Not joined: it would wait for ever with a host that does not read.
        std::thread::spawn(move || {
            let clock = MonotonicClock::anchored_now();
            // The host must have opened it, or the first reports are for nobody.
            clock.wait_until(clock.now() + Duration::from_millis(1500));
            for report in reports {
                fs::write(&side, report).unwrap();
            }
        });
        let heard = hear(device, samples).unwrap();
        heard.is_whole();
        heard.widths()
    }
}

/// 0.1 m in a turn.
const LINEAR: &str = "linkage = { kind = \"linear\", zero_angle_deg = 0, width_at_zero_m = 0, width_per_turn_m = 0.1 }\n";

fn hid_slider_is_a_width() {
    let plugged = Plugged::new(SLIDER, 3);
    assert_eq!(plugged.found.axes, ["slider"]);
    let device = plugged.device(&format!(
        "axis = \"slider\"\ncounts_per_turn = 65536\n{LINEAR}"
    ));
    let counts: Vec<u16> = (0..100).map(|step| step * 640).collect();
    let report = |counts: &u16| [&[3], &counts.to_le_bytes()[..]].concat();
    let reports: Vec<_> = counts.iter().map(report).collect();
    let widths = plugged.widths(&device, reports);
    for (width, counts) in widths.iter().zip(&counts) {
        let expected = 0.1 * f64::from(*counts) / 65536.0;
        assert!(
            (width - expected).abs() < 1e-9,
            "{width} instead of {expected}"
        );
    }
}

fn hid_dial_sums_its_steps() {
    let plugged = Plugged::new(DIAL, 2);
    let device = plugged.device(&format!("axis = \"dial\"\n{LINEAR}"));
    let steps = [900_i16, 900, -450, 1, -1];
    let reports: Vec<_> = steps
        .iter()
        .map(|step| step.to_le_bytes().to_vec())
        .collect();
    let widths = plugged.widths(&device, reports);
    // 135 degrees of a turn that opens the jaws by 0.1 m.
    let last = widths.last().unwrap();
    let expected = 0.1 / TAU * 135_f64.to_radians();
    assert!(
        (last - expected).abs() < 1e-9,
        "{last} instead of {expected}"
    );
}

fn hid_unplugged_is_gone() {
    let plugged = Plugged::new(SLIDER, 3);
    let device = plugged.device("axis = \"slider\"\ncounts_per_turn = 65536\n");
    let gadget = plugged.gadget;
    let unplugging = std::thread::spawn(move || {
        let clock = MonotonicClock::anchored_now();
        clock.wait_until(clock.now() + Duration::from_millis(1500));
        gadget.unplug();
        gadget
    });
    let ended = hear(&device, 1).map(drop);
    let gone = matches!(ended, Err(ft_drivers::LinkError::Gone { .. }));
    assert!(gone, "{ended:?}");
    unplugging.join().unwrap();
}
