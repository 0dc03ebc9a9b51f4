//! Axes of HID devices: the reports of a gadget, the kernel's descriptor and hidraw, our driver.

use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ft_capture::config::{Device, Driver};
use ft_drivers::discover::{self, FoundHid, RememberedPort};
use ft_drivers::hid_axis::HidFrame;
use ft_drivers::link::hidraw::HidrawLink;
use ft_drivers::{Clock as _, Link as _, LinkError, MonotonicClock};

use crate::Case;
use crate::gadget::Gadget;
use crate::hear::hear;
use crate::machine::{load, wait_for};

pub(crate) const CASES: &[Case] = &[
    ("hid_slider_is_a_width", hid_slider_is_a_width),
    ("hid_dial_sums_its_steps", hid_dial_sums_its_steps),
    ("hid_unplugged_is_gone", hid_unplugged_is_gone),
    ("hid_device_is_ours_alone", hid_device_is_ours_alone),
    (
        "hid_report_that_is_too_long_is_told",
        hid_report_that_is_too_long_is_told,
    ),
    (
        "hid_two_of_a_kind_are_told_apart",
        hid_two_of_a_kind_are_told_apart,
    ),
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

/// For the host to notice a device.
const LONGEST: Duration = Duration::from_secs(15);

/// The host's node of the device with this serial number, once there is one.
fn found(serial_number: &str) -> FoundHid {
    let mut found = None;
    wait_for("the host's hidraw", LONGEST, || {
        let mut devices = discover::hid_devices().into_iter();
        found = devices.find(|device| device.serial_number == serial_number);
        found.as_ref().is_some_and(|found| found.path.exists())
    });
    found.unwrap()
}

/// A HID device on a gadget, its side and the host's.
struct Plugged {
    gadget: Gadget,
    side: PathBuf,
    found: FoundHid,
}

impl Plugged {
    fn new(descriptor: &[u8], report_length: usize) -> Self {
        Self::numbered(0, "LABHID", descriptor, report_length)
    }

    /// In this socket, with this serial number.
    fn numbered(
        socket: usize,
        serial_number: &str,
        descriptor: &[u8],
        report_length: usize,
    ) -> Self {
        for module in ["usb_f_hid", "usbhid", "hid_generic"] {
            load(module);
        }
        let gadget = Gadget::new(socket, ARDUINO.0, ARDUINO.1, serial_number);
        gadget.function("hid.usb0");
        gadget.write(
            "functions/hid.usb0/report_length",
            report_length.to_string(),
        );
        gadget.write("functions/hid.usb0/report_desc", descriptor);
        gadget.add("hid.usb0");
        gadget.plug_in();
        let found = found(serial_number);
        assert_eq!((found.vendor, found.product), ARDUINO);
        let side = PathBuf::from(format!("/dev/hidg{socket}"));
        wait_for("the gadget's side", LONGEST, || side.exists());
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

fn open(port: &Path) -> Result<HidrawLink, LinkError> {
    HidrawLink::open(port, MonotonicClock::anchored_now())
}

fn hid_device_is_ours_alone() {
    let plugged = Plugged::new(SLIDER, 3);
    let _first = open(&plugged.found.path).unwrap();
    let second = open(&plugged.found.path);
    assert!(matches!(second, Err(LinkError::Busy { .. })), "{second:?}");
}

fn hid_report_that_is_too_long_is_told() {
    // Report 4 besides: 64 bytes without an axis.
    let padding = [
        0x85, 0x04, 0x09, 0x01, 0x75, 0x08, 0x95, 0x40, 0x81, 0x02, 0xC0,
    ];
    let descriptor = [&SLIDER[..SLIDER.len() - 1], &padding].concat();
    let plugged = Plugged::new(&descriptor, 65);
    let mut link = open(&plugged.found.path).unwrap();
    let clock = MonotonicClock::anchored_now();
    let end = clock.now() + Duration::from_secs(5);
    let (first, _) = link.recv(end).unwrap().unwrap();
    assert_eq!(first, HidFrame::Descriptor(descriptor.into()));
    assert_eq!(link.take_notice(), None);
    fs::write(&plugged.side, [4; 65]).unwrap();
    fs::write(&plugged.side, [3, 7, 0]).unwrap();
    let (report, _) = link.recv(end).unwrap().unwrap();
    let HidFrame::Report(report) = report else {
        panic!("{report:?}");
    };
    assert_eq!(report.as_slice(), [3, 7, 0]);
    assert_eq!(link.overflows(), 1);
    let told = link.take_notice().unwrap();
    assert!(told.contains("longer than 64 bytes"), "{told}");
}

/// Two devices of one identity, plugged in again in the other order: each is found by its serial number.
fn hid_two_of_a_kind_are_told_apart() {
    let serial_numbers = ["LABHIDA", "LABHIDB"];
    let pair = [0, 1].map(|index| Plugged::numbered(index, serial_numbers[index], SLIDER, 3));
    let before = serial_numbers.map(|serial_number| found(serial_number).path);
    let mut remembered = [0, 1].map(|index: usize| RememberedPort::hid(&before[index]));
    for (port, path) in remembered.iter_mut().zip(&before) {
        assert_eq!(port.path().unwrap(), *path);
    }
    for plugged in &pair {
        plugged.gadget.unplug();
    }
    wait_for("both to be gone", LONGEST, || {
        discover::hid_devices().is_empty()
    });
    pair[1].gadget.plug_in();
    assert_eq!(found("LABHIDB").path, before[0], "the kernel's names swap");
    let first = remembered[0].path();
    assert!(matches!(first, Err(LinkError::Other { .. })), "{first:?}");
    pair[0].gadget.plug_in();
    assert_eq!(found("LABHIDA").path, before[1]);
    for (port, path) in remembered.iter_mut().zip([&before[1], &before[0]]) {
        assert_eq!(port.path().unwrap(), *path);
    }
}
