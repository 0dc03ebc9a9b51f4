//! The rules of `udev/`, applied by systemd's udevd.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Once;

use ft_drivers::discover::{Attachment, IDENTITIES, udev_line};

use crate::Case;
use crate::gadget::Gadget;
use crate::machine::run;

pub(crate) const CASES: &[Case] = &[
    (
        "udev_rules_open_every_serial_identity",
        udev_rules_open_every_serial_identity,
    ),
    ("udev_rules_open_candlelights", udev_rules_open_candlelights),
    (
        "udev_names_stay_with_the_serial_number",
        udev_names_stay_with_the_serial_number,
    ),
    (
        "udev_leaves_other_devices_alone",
        udev_leaves_other_devices_alone,
    ),
    (
        "udev_line_that_devices_prints_works",
        udev_line_that_devices_prints_works,
    ),
];

const OURS: &str = "/run/udev/rules.d/70-ft-capture.rules";

/// udevd with the system's rules and ours.
fn daemon() {
    static STARTED: Once = Once::new();
    STARTED.call_once(|| {
        let root = std::env::var("FT_LAB_ROOT").unwrap();
        fs::create_dir_all("/run/udev/rules.d").unwrap();
        fs::copy(Path::new(&root).join("udev/70-ft-capture.rules"), OURS).unwrap();
        run("/lib/systemd/systemd-udevd --daemon --resolve-names=never");
        run("udevadm trigger --subsystem-match=tty");
        run("udevadm settle --timeout=60");
    });
}

/// What udev knows of a node.
fn properties(node: &Path) -> String {
    run("udevadm settle --timeout=60");
    let output = Command::new("udevadm")
        .args(["info", "--query=all"])
        .arg(format!("--name={}", node.display()))
        .output()
        .unwrap();
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn mode(node: &Path) -> u32 {
    fs::metadata(node).unwrap().permissions().mode() & 0o777
}

fn is_opened(node: &Path) -> Result<(), String> {
    let known = properties(node);
    let told = |what: &str| known.lines().any(|line| line == what);
    let tagged = known
        .lines()
        .any(|line| line.starts_with("E: TAGS=") && line.contains(":uaccess:"));
    if tagged && told("E: ID_MM_DEVICE_IGNORE=1") && mode(node) == 0o660 {
        return Ok(());
    }
    Err(format!("mode {:o}; {known}", mode(node)))
}

fn udev_rules_open_every_serial_identity() {
    daemon();
    let serial = IDENTITIES
        .iter()
        .filter(|identity| identity.attachment == Attachment::Serial);
    for identity in serial {
        let (gadget, _) = Gadget::serial(0, identity.vendor, identity.product, "LABUDEV");
        gadget.plug_in();
        let port = gadget.port();
        assert_eq!(port.identity(), Some(identity));
        is_opened(&port.path).unwrap_or_else(|why| panic!("{}: {why}", identity.name));
    }
}

/// Devices with these identities and any function; libusb opens their nodes.
fn udev_rules_open_candlelights() {
    daemon();
    let candlelights = IDENTITIES
        .iter()
        .filter(|identity| identity.attachment == Attachment::CandleLight);
    for identity in candlelights {
        let (gadget, _) = Gadget::serial(0, identity.vendor, identity.product, "LABUDEV");
        gadget.plug_in();
        gadget.port();
        let node = usb_node("LABUDEV").expect("the device's node");
        is_opened(&node).unwrap_or_else(|why| panic!("{}: {why}", identity.name));
    }
}

/// The node of the USB device with this serial number.
fn usb_node(serial_number: &str) -> Option<PathBuf> {
    let devices = fs::read_dir("/sys/bus/usb/devices").ok()?;
    let text = |folder: &Path, name: &str| {
        let text = fs::read_to_string(folder.join(name)).unwrap_or_default();
        text.trim().to_owned()
    };
    let mut folders = devices.flatten().map(|entry| entry.path());
    let folder = folders.find(|folder| text(folder, "serial") == serial_number)?;
    let number = |name| text(&folder, name).parse::<u32>().ok();
    let (bus, device) = (number("busnum")?, number("devnum")?);
    Some(PathBuf::from(format!("/dev/bus/usb/{bus:03}/{device:03}")))
}

fn udev_names_stay_with_the_serial_number() {
    daemon();
    let gadgets = [(0, "LABONE"), (1, "LABTWO")].map(|(socket, serial_number)| {
        let (gadget, _) = Gadget::serial(socket, 0x0483, 0x5740, serial_number);
        gadget.plug_in();
        gadget
    });
    let links = || {
        // Both are there before udev is waited for.
        let ports = [0, 1].map(|index: usize| gadgets[index].port());
        run("udevadm settle --timeout=60");
        for (port, serial_number) in ports.iter().zip(["LABONE", "LABTWO"]) {
            let name = format!("/dev/ft-capture/{serial_number}-00");
            let target = fs::canonicalize(&name).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_eq!(target, port.path);
        }
        [0, 1].map(|index: usize| {
            let port = gadgets[index].port();
            (port.by_id.expect("a name by serial number"), port.path)
        })
    };
    let before = links();
    for ((name, _), serial_number) in before.iter().zip(["LABONE", "LABTWO"]) {
        assert!(name.to_string_lossy().contains(serial_number), "{name:?}");
    }
    for gadget in &gadgets {
        gadget.unplug();
    }
    run("udevadm settle --timeout=60");
    gadgets[1].plug_in();
    let _first = gadgets[1].port();
    gadgets[0].plug_in();
    let after = links();
    assert_eq!(after[0].0, before[0].0);
    assert_eq!(after[1].0, before[1].0);
    assert_eq!(after[0].1, before[1].1, "the kernel's names are swapped");
}

fn udev_leaves_other_devices_alone() {
    daemon();
    let (gadget, _) = Gadget::serial(0, 0x1234, 0x5678, "LABOTHER");
    gadget.plug_in();
    let known = properties(&gadget.port().path);
    let ours = ["uaccess", "ID_MM_DEVICE_IGNORE"];
    assert!(!ours.iter().any(|mark| known.contains(mark)), "{known}");
}

/// What `ft-capture devices` prints for a port that may not be opened.
fn udev_line_that_devices_prints_works() {
    daemon();
    let added = Path::new("/run/udev/rules.d/71-lab.rules");
    // No worker is busy with the old rules then.
    run("udevadm settle --timeout=60");
    fs::write(added, udev_line("tty", 0x1234, 0x5678) + "\n").unwrap();
    run("udevadm control --reload");
    let (gadget, _) = Gadget::serial(0, 0x1234, 0x5678, "LABOTHER");
    gadget.plug_in();
    let opened = is_opened(&gadget.port().path);
    fs::remove_file(added).unwrap();
    run("udevadm control --reload");
    opened.unwrap();
}
