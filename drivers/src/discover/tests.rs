use std::collections::BTreeSet;
use std::os::unix::fs::symlink;

use super::remembered::Place;
use super::*;
use crate::LinkError;

const RULES: &str = include_str!("../../../udev/70-ft-capture.rules");

/// `idVendor`:`idProduct` pairs of the rule lines that `wanted` picks.
fn identities_in_rules(wanted: impl Fn(&str) -> bool) -> BTreeSet<(u16, u16)> {
    let hex = |line: &str, key: &str| {
        let (_, rest) = line.split_once(&format!("ATTRS{{{key}}}==\""))?;
        u16::from_str_radix(rest.split('"').next()?, 16).ok()
    };
    RULES
        .lines()
        .filter(|line| !line.starts_with('#') && wanted(line))
        .filter_map(|line| Some((hex(line, "idVendor")?, hex(line, "idProduct")?)))
        .collect()
}

fn identities(wanted: impl Fn(&UsbIdentity) -> bool) -> BTreeSet<(u16, u16)> {
    IDENTITIES
        .iter()
        .filter(|identity| wanted(identity))
        .map(|found| (found.vendor, found.product))
        .collect()
}

#[test]
fn rules_give_access_to_exactly_the_serial_identities() {
    let allowed = identities_in_rules(|line| line.contains("SUBSYSTEM==\"tty\""));
    assert_eq!(
        allowed,
        identities(|identity| identity.attachment == Attachment::Serial)
    );
}

#[test]
fn rules_give_access_to_exactly_the_candlelights() {
    let allowed = identities_in_rules(|line| line.contains("SUBSYSTEM==\"usb\""));
    assert_eq!(
        allowed,
        identities(|identity| identity.attachment == Attachment::CandleLight)
    );
}

#[test]
fn an_adapter_is_shown_with_its_port_its_interface_and_the_rule_that_is_missing() {
    let adapter = FoundAdapter {
        vendor: 0x1D50,
        product: 0x606F,
        serial_number: "0039001B".to_owned(),
        interface: Some(CanInterface {
            name: "can0".to_owned(),
            driver: "gs_usb".to_owned(),
            up: true,
        }),
        permitted: false,
    };
    let shown = adapter.to_string();
    let rule = udev_line("usb", 0x1D50, 0x606F);
    for part in [
        "gs_usb:0039001B  1d50:606f  candleLight, CANable  can0 in the kernel, up",
        &rule,
    ] {
        assert!(shown.contains(part), "{shown}");
    }
}

#[test]
fn rules_mention_no_identity_that_is_not_known_here() {
    let all = identities_in_rules(|_| true);
    assert!(all.is_subset(&identities(|_| true)), "{all:x?}");
}

#[test]
fn rules_set_the_latency_timer_where_there_is_one() {
    let drivers: BTreeSet<_> = RULES
        .lines()
        .filter(|line| !line.starts_with('#') && line.contains("ATTR{latency_timer}=\"1\""))
        .filter_map(|line| line.split_once("DRIVER==\"")?.1.split('"').next())
        .collect();
    let settable = IDENTITIES
        .iter()
        .filter(|identity| identity.latency_timer == LatencyTimer::Settable);
    assert_eq!(drivers, settable.map(|identity| identity.driver).collect());
}

#[test]
fn no_identity_is_there_twice() {
    assert_eq!(identities(|_| true).len(), IDENTITIES.len());
    assert_eq!(
        identity(0x0403, 0x6014).map(|found| found.driver),
        Some("ftdi_sio")
    );
    assert_eq!(identity(0x0403, 0xFFFF), None);
    // An encoder behind a microcontroller.
    for (vendor, product) in [(0x16C0, 0x0483), (0x2E8A, 0x000A)] {
        let takers = identity(vendor, product).map(|found| found.takers);
        assert!(takers.is_some_and(|takers| takers.contains(&"encoder_line")));
    }
}

/// A directory tree that goes away with the test.
struct Tree(PathBuf);

impl Tree {
    fn new(name: &str) -> Self {
        let root = std::env::temp_dir().join(format!("ft-discover-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&root);
        fs::create_dir_all(&root).unwrap();
        Self(fs::canonicalize(root).unwrap())
    }

    fn file(&self, path: &str, content: &str) -> PathBuf {
        let path = self.0.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, format!("{content}\n")).unwrap();
        path
    }

    fn link(&self, link: &str, target: &str) {
        let link = self.0.join(link);
        fs::create_dir_all(link.parent().unwrap()).unwrap();
        symlink(self.0.join(target), link).unwrap();
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn a_usb_port_is_found_with_all_that_sysfs_says() {
    let tree = Tree::new("serial");
    tree.file("sys/devices/usb1/1-2/idVendor", "0403");
    tree.file("sys/devices/usb1/1-2/idProduct", "6014");
    tree.file("sys/devices/usb1/1-2/manufacturer", "FTDI");
    tree.file("sys/devices/usb1/1-2/product", "USB-Serial");
    tree.file("sys/devices/usb1/1-2/serial", "FT1234");
    tree.file("sys/devices/usb1/1-2/1-2:1.0/bInterfaceNumber", "01");
    tree.file("sys/devices/usb1/1-2/1-2:1.0/ttyUSB0/latency_timer", "16");
    tree.link(
        "sys/devices/usb1/1-2/1-2:1.0/ttyUSB0/driver",
        "sys/bus/usb-serial/drivers/ftdi_sio",
    );
    tree.file("sys/bus/usb-serial/drivers/ftdi_sio/x", "");
    tree.link(
        "sys/bus/usb-serial/devices/ttyUSB0",
        "sys/devices/usb1/1-2/1-2:1.0/ttyUSB0",
    );
    tree.link(
        "sys/class/tty/ttyUSB0/device",
        "sys/devices/usb1/1-2/1-2:1.0/ttyUSB0",
    );
    tree.file("sys/devices/platform/serial8250/x", "");
    tree.link(
        "sys/class/tty/ttyS0/device",
        "sys/devices/platform/serial8250",
    );
    tree.file("dev/ttyUSB0", "");
    tree.link("dev/serial/by-id/usb-FTDI_FT1234", "dev/ttyUSB0");

    let ports = serial_ports_in(&tree.0.join("sys"), &tree.0.join("dev"));
    let [port] = ports.as_slice() else {
        panic!("{ports:?}")
    };
    assert_eq!(port.path, tree.0.join("dev/ttyUSB0"));
    assert_eq!(
        port.by_id,
        Some(tree.0.join("dev/serial/by-id/usb-FTDI_FT1234"))
    );
    assert_eq!((port.vendor, port.product), (0x0403, 0x6014));
    assert_eq!(
        (port.manufacturer.as_str(), port.serial_number.as_str()),
        ("FTDI", "FT1234")
    );
    assert_eq!(port.interface, Some(1));
    assert_eq!(
        (port.driver.as_str(), port.latency_timer_ms),
        ("ftdi_sio", Some(16))
    );
    let shown = port.to_string();
    assert!(
        shown.contains("0403:6014") && shown.contains("latency timer 16 ms"),
        "{shown}"
    );
}

#[test]
fn can_interfaces_are_told_by_their_type() {
    let tree = Tree::new("can");
    tree.file("sys/class/net/can0/type", "280");
    tree.file("sys/class/net/can0/flags", "0x40080");
    tree.file("sys/class/net/vcan0/type", "280");
    tree.file("sys/class/net/vcan0/flags", "0x400c1");
    tree.file("sys/class/net/eth0/type", "1");
    let found = can_interfaces_in(&tree.0.join("sys"));
    let names: Vec<_> = found
        .iter()
        .map(|interface| (interface.name.as_str(), interface.up))
        .collect();
    assert_eq!(names, [("can0", false), ("vcan0", true)]);
    assert!(
        found[0].to_string().contains("ip link set can0 up"),
        "{}",
        found[0]
    );
}

#[test]
fn a_machine_without_any_of_it_has_none() {
    let tree = Tree::new("none");
    assert_eq!(serial_ports_in(&tree.0, &tree.0), []);
    assert_eq!(can_interfaces_in(&tree.0), []);
    assert_eq!(latency_timer_ms(Path::new("/dev/null")), None);
}

#[test]
fn the_line_for_a_missing_permission_is_one_of_the_rules() {
    for identity in IDENTITIES {
        let subsystem = match identity.attachment {
            Attachment::Serial => "tty",
            Attachment::CandleLight => "usb",
            Attachment::CanInterface => continue,
        };
        let line = udev_line(subsystem, identity.vendor, identity.product);
        assert!(RULES.lines().any(|rule| rule == line), "{line}");
    }
}

#[test]
fn every_rule_keeps_modem_manager_away_and_lets_the_seat_in() {
    let access: Vec<_> = RULES
        .lines()
        .filter(|line| line.starts_with("SUBSYSTEM==\"tty\""))
        .collect();
    assert!(!access.is_empty());
    for line in access {
        assert!(
            line.contains("TAG+=\"uaccess\"") && line.contains("ENV{ID_MM_DEVICE_IGNORE}=\"1\"")
        );
    }
}

#[test]
fn every_identity_names_who_may_take_it() {
    assert!(
        IDENTITIES
            .iter()
            .all(|identity| !identity.takers.is_empty())
    );
}

fn port(path: &str, serial_number: &str) -> FoundPort {
    FoundPort {
        path: PathBuf::from(path),
        by_id: None,
        vendor: 0x0403,
        product: 0x6014,
        manufacturer: String::new(),
        product_name: String::new(),
        serial_number: serial_number.to_owned(),
        interface: Some(0),
        driver: "ftdi_sio".to_owned(),
        latency_timer_ms: Some(1),
        permitted: true,
    }
}

#[test]
fn a_port_is_found_again_by_its_serial_number_under_another_name() {
    let (first, second) = (Path::new("/dev/ttyFT90"), Path::new("/dev/ttyFT91"));
    let mut remembered = RememberedPort::serial(first);
    let [mine, other] = ["A1", "B2"];
    let at = |path: &Path, serial: &str| port(path.to_str().unwrap(), serial);
    let mut path =
        |ports: &[FoundPort]| remembered.path_among(ports.iter().map(Into::into).collect());
    assert_eq!(path(&[at(first, mine), at(second, other)]).unwrap(), first);
    // Replugged in the other order.
    assert_eq!(path(&[at(first, other), at(second, mine)]).unwrap(), second);
    assert_eq!(path(&[]).unwrap(), first, "none is in");
    assert_eq!(path(&[at(first, mine)]).unwrap(), first);
    let refused = path(&[at(first, other)]).unwrap_err().to_string();
    assert_eq!(
        refused,
        "/dev/ttyFT90: the device there has serial number B2, the one that was there had A1: plug that one in"
    );
}

#[test]
fn the_channels_of_one_converter_are_told_apart() {
    let names = ["/dev/ttyFT90", "/dev/ttyFT91"];
    let at = |path: &str, interface| {
        let found = FoundPort {
            interface: Some(interface),
            ..port(path, "A1")
        };
        Place::from(&found)
    };
    let mut remembered = RememberedPort::serial(Path::new(names[1]));
    let mut path = |places: &[Place]| remembered.path_among(places.to_vec());
    let both = [at(names[0], 0), at(names[1], 1)];
    assert_eq!(path(&both).unwrap(), Path::new(names[1]));
    // Replugged, and named the other way round.
    let swapped = [at(names[0], 1), at(names[1], 0)];
    assert_eq!(path(&swapped).unwrap(), Path::new(names[0]));
    let refused = path(&[at(names[1], 0)]).unwrap_err().to_string();
    assert!(
        refused.contains("serial number A1, interface 0,")
            && refused.contains("had A1, interface 1:"),
        "{refused}"
    );
}

#[test]
fn a_device_that_takes_the_name_while_it_is_opened_is_let_go() {
    let first = Path::new("/dev/ttyFT90");
    let [mine, other] = ["A1", "B2"].map(|serial| vec![(&port("/dev/ttyFT90", serial)).into()]);
    let mut remembered = RememberedPort::serial(first);
    let mut open = |before: &Vec<Place>, after: &Vec<Place>| {
        let mut looks = vec![after.clone(), before.clone()];
        remembered.open_among(|| looks.pop().unwrap(), |path| Ok(path.to_owned()))
    };
    assert_eq!(open(&mine, &mine).unwrap(), first);
    // Nothing was there when it was looked for, and the other one when it was opened.
    let taken = open(&Vec::new(), &other).unwrap_err();
    assert!(matches!(taken, LinkError::Other { .. }), "{taken}");
    assert_eq!(open(&Vec::new(), &mine).unwrap(), first);
}

#[test]
fn a_device_that_could_not_be_opened_is_not_remembered() {
    let first = Path::new("/dev/ttyFT90");
    let [wrong, right] = ["B2", "A1"].map(|serial| vec![(&port("/dev/ttyFT90", serial)).into()]);
    let mut remembered = RememberedPort::serial(first);
    let busy = || LinkError::Busy {
        port: "/dev/ttyFT90".to_owned(),
    };
    let refused = remembered.open_among(|| wrong.clone(), |_| Err::<(), _>(busy()));
    assert!(matches!(refused, Err(LinkError::Busy { .. })));
    let opened = remembered.open_among(|| right.clone(), |path| Ok(path.to_owned()));
    assert_eq!(opened.unwrap(), first);
}

#[test]
fn a_port_without_a_serial_number_stays_at_its_name() {
    let first = Path::new("/dev/ttyFT90");
    let mut remembered = RememberedPort::serial(first);
    for found in [port("/dev/ttyFT90", ""), port("/dev/ttyFT91", "")] {
        assert_eq!(remembered.path_among(vec![(&found).into()]).unwrap(), first);
    }
}

/// A joystick with one axis, X.
const JOYSTICK: [u8; 19] = [
    0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x09, 0x30, 0x15, 0x00, 0x25, 0x7F, 0x75, 0x08, 0x95, 0x01,
    0x81, 0x02, 0xC0,
];

#[test]
fn a_descriptor_without_axes_is_no_encoder() {
    assert_eq!(hid::axes(&JOYSTICK), Some(vec!["x"]));
    assert_eq!(hid::axes(&[0xA1, 0x01, 0xC0]), None);
    assert_eq!(hid::axes(&JOYSTICK[..12]), None);
}

#[test]
fn a_hid_device_that_may_not_be_opened_shows_the_line_of_the_rules() {
    let device = FoundHid {
        path: PathBuf::from("/dev/hidraw7"),
        vendor: 0x2341,
        product: 0x8036,
        name: "Arduino Leonardo".to_owned(),
        serial_number: "A1".to_owned(),
        interface: None,
        axes: vec!["x"],
        permitted: false,
    };
    let shown = device.to_string();
    let rule = udev_line("hidraw", 0x2341, 0x8036);
    for part in ["Arduino Leonardo  A1  for hid_axis, axes x", &rule] {
        assert!(shown.contains(part), "{shown}");
    }
}
