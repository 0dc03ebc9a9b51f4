//! What is plugged in: serial ports with their USB identity and CAN interfaces by sysfs, CAN adapters by libusb, HID devices by
//! hidapi. No udev library is needed.

mod adapters;
mod hid;
mod remembered;

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

pub(crate) use adapters::adapter;
pub use adapters::{FoundAdapter, can_adapters};
pub use hid::{FoundHid, hid_devices};
pub use remembered::RememberedPort;

/// How a supported device hangs on the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attachment {
    /// A serial port that opens as it is; the rules give access to it.
    Serial,
    /// A CAN adapter: the kernel makes a network interface of it, which needs no device node and no rule.
    CanInterface,
    /// A candleLight: as above, or opened in user space ([`crate::link::gs_usb`]); for that the rules give access to it.
    CandleLight,
}

/// A USB identity of a supported device or of the converter in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UsbIdentity {
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// What carries this identity.
    pub name: &'static str,
    /// Kernel driver.
    pub driver: &'static str,
    /// How it hangs on the host.
    pub attachment: Attachment,
    /// Drivers here that may take what hangs behind, by the names of the configuration.
    pub takers: &'static [&'static str],
    /// Latency timer: 16 ms by default, must be set to 1 ms.
    pub latency_timer: LatencyTimer,
}

/// Whether the converter collects bytes before it hands them over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LatencyTimer {
    /// FTDI: 16 ms unless told otherwise; samples come in bursts.
    Settable,
    /// None.
    None,
}

/// What hangs behind converters that everybody uses.
const ANY_SERIAL: &[&str] = &[
    "bota_serial",
    "robotous_uart",
    "kunwei_kwr75",
    "dynamixel",
    "amt21",
    "encoder_line",
    "pose_stream",
];
/// What hangs on CAN.
const ANY_CAN: &[&str] = &["robotous_can", "optoforce_can", "ati_netcanoem"];

const fn ftdi(product: u16, name: &'static str) -> UsbIdentity {
    let (attachment, latency_timer) = (Attachment::Serial, LatencyTimer::Settable);
    UsbIdentity {
        vendor: 0x0403,
        product,
        name,
        driver: "ftdi_sio",
        attachment,
        takers: ANY_SERIAL,
        latency_timer,
    }
}

const fn serial(
    vendor: u16,
    product: u16,
    name: &'static str,
    driver: &'static str,
    takers: &'static [&'static str],
) -> UsbIdentity {
    let (attachment, latency_timer) = (Attachment::Serial, LatencyTimer::None);
    UsbIdentity {
        vendor,
        product,
        name,
        driver,
        attachment,
        takers,
        latency_timer,
    }
}

const fn can(vendor: u16, product: u16, name: &'static str, driver: &'static str) -> UsbIdentity {
    let (attachment, latency_timer) = (Attachment::CanInterface, LatencyTimer::None);
    UsbIdentity {
        vendor,
        product,
        name,
        driver,
        attachment,
        takers: ANY_CAN,
        latency_timer,
    }
}

const fn candlelight(vendor: u16, product: u16, name: &'static str) -> UsbIdentity {
    UsbIdentity {
        attachment: Attachment::CandleLight,
        ..can(vendor, product, name, "gs_usb")
    }
}

/// Identities of supported devices. Bota and Robotous cables and the usual Dynamixel adapter are FTDI converters whose
/// product id no document gives, so all of FTDI's are here; they do not tell which device hangs behind.
///
/// # Source
/// hardware.md 4.1 (the usb.ids list).
pub const IDENTITIES: &[UsbIdentity] = &[
    ftdi(
        0x6001,
        "FTDI FT232 (Bota, Robotous, Kunwei, Dynamixel adapters)",
    ),
    ftdi(0x6010, "FTDI FT2232"),
    ftdi(0x6011, "FTDI FT4232"),
    ftdi(
        0x6014,
        "FTDI FT232H (Bota, Robotous, Kunwei, Dynamixel adapters)",
    ),
    ftdi(
        0x6015,
        "FTDI FT-X (Bota, Robotous, Kunwei, Dynamixel adapters)",
    ),
    serial(0x10C4, 0xEA60, "Silicon Labs CP210x", "cp210x", ANY_SERIAL),
    serial(0x1A86, 0x7523, "WCH CH340", "ch341-uart", ANY_SERIAL),
    serial(
        0x0483,
        0x5740,
        "STM32 virtual COM port (Leptrino)",
        "cdc_acm",
        &["leptrino", "encoder_line", "pose_stream"],
    ),
    serial(
        0x04D8,
        0x000A,
        "OptoForce, OnRobot HEX (Microchip CDC)",
        "cdc_acm",
        &["optoforce_serial"],
    ),
    serial(
        0x16C0,
        0x0483,
        "Teensy (encoder behind a microcontroller)",
        "cdc_acm",
        &["encoder_line", "pose_stream"],
    ),
    serial(
        0x2E8A,
        0x000A,
        "Raspberry Pi Pico, RP2040 (encoder behind a microcontroller)",
        "cdc_acm",
        &["encoder_line", "pose_stream"],
    ),
    candlelight(0x1D50, 0x606F, "candleLight, CANable"),
    candlelight(0x1209, 0x2323, "candleLight clone"),
    can(0x0C72, 0x000C, "PCAN-USB", "peak_usb"),
    can(0x0C72, 0x000D, "PCAN-USB Pro", "peak_usb"),
    can(0x0BFD, 0x0004, "Kvaser USBcan II", "kvaser_usb"),
    can(0x0BFD, 0x000B, "Kvaser Leaf Light HS", "kvaser_usb"),
    can(0x0BFD, 0x000E, "Kvaser Leaf SemiPro HS", "kvaser_usb"),
];

/// The supported device with this identity.
#[must_use]
pub fn identity(vendor: u16, product: u16) -> Option<&'static UsbIdentity> {
    IDENTITIES
        .iter()
        .find(|identity| (identity.vendor, identity.product) == (vendor, product))
}

/// A serial port on USB.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundPort {
    /// Device node, such as `/dev/ttyUSB0`.
    pub path: PathBuf,
    /// Name that stays over replugging: from `/dev/serial/by-id`, or of our own rules from `/dev/ft-capture`.
    pub by_id: Option<PathBuf>,
    /// USB vendor id.
    pub vendor: u16,
    /// USB product id.
    pub product: u16,
    /// Maker's text, empty when there is none.
    pub manufacturer: String,
    /// Product's text, empty when there is none.
    pub product_name: String,
    /// Serial number, empty when there is none.
    pub serial_number: String,
    /// Number of the USB interface: which channel of a converter that has several under one serial number.
    pub interface: Option<u8>,
    /// Kernel driver, empty when unknown.
    pub driver: String,
    /// Latency timer, ms; `None` when the driver has none.
    pub latency_timer_ms: Option<u32>,
    /// Whether this user may open it.
    pub permitted: bool,
}

impl FoundPort {
    /// The supported device with this identity.
    #[must_use]
    pub fn identity(&self) -> Option<&'static UsbIdentity> {
        identity(self.vendor, self.product)
    }
}

impl fmt::Display for FoundPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let path = self.by_id.as_ref().unwrap_or(&self.path);
        let known = self
            .identity()
            .map_or("not a known identity", |identity| identity.name);
        write!(
            f,
            "{}  {:04x}:{:04x}  {known}",
            path.display(),
            self.vendor,
            self.product
        )?;
        for text in [&self.manufacturer, &self.product_name, &self.serial_number] {
            if !text.is_empty() {
                write!(f, "  {text}")?;
            }
        }
        if let Some(identity) = self.identity() {
            write!(f, "  for {}", identity.takers.join(", "))?;
        }
        if let Some(ms) = self.latency_timer_ms.filter(|ms| *ms > 1) {
            write!(
                f,
                "  latency timer {ms} ms: samples come in bursts, install the rules of udev/"
            )?;
        }
        if !self.permitted {
            let rule = udev_line("tty", self.vendor, self.product);
            write!(
                f,
                "  NOT PERMITTED: install the rules of udev/, or this line: {rule}"
            )?;
        }
        Ok(())
    }
}

/// The line of udev rules that lets the user at the machine open a device.
#[must_use]
pub fn udev_line(subsystem: &str, vendor: u16, product: u16) -> String {
    format!(
        "SUBSYSTEM==\"{subsystem}\", ATTRS{{idVendor}}==\"{vendor:04x}\", ATTRS{{idProduct}}==\"{product:04x}\", MODE=\"0660\", \
         TAG+=\"uaccess\", ENV{{ID_MM_DEVICE_IGNORE}}=\"1\""
    )
}

/// Whether this user may read and write a node.
pub(crate) fn is_permitted(node: &Path) -> bool {
    use rustix::fs::{Access, access};
    access(node, Access::READ_OK | Access::WRITE_OK).is_ok()
}

/// A CAN interface of the kernel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CanInterface {
    /// Name, such as `can0`.
    pub name: String,
    /// Kernel driver, empty for a virtual interface.
    pub driver: String,
    /// Whether it is up; a CAN interface is brought up by the administrator.
    pub up: bool,
}

impl fmt::Display for CanInterface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let driver = if self.driver.is_empty() {
            "virtual"
        } else {
            &self.driver
        };
        write!(f, "{}  {driver}", self.name)?;
        if !self.up {
            write!(f, "  down: {}", bring_up(&self.name))?;
        }
        Ok(())
    }
}

/// How the administrator brings a CAN interface up.
pub(crate) fn bring_up(interface: &str) -> String {
    format!(
        "ip link set {interface} up type can bitrate 1000000 restart-ms 100 (ATI's factory rate is 250000)"
    )
}

/// The serial ports on USB, by path. Ports that are not on USB are left out.
#[must_use]
pub fn serial_ports() -> Vec<FoundPort> {
    serial_ports_in(Path::new("/sys"), Path::new("/dev"))
}

/// The CAN interfaces, by name.
#[must_use]
pub fn can_interfaces() -> Vec<CanInterface> {
    can_interfaces_in(Path::new("/sys"))
}

/// Latency timer of a serial port, ms, or `None` when its driver has none (only FTDI's has).
#[must_use]
pub fn latency_timer_ms(port: &Path) -> Option<u32> {
    let node = fs::canonicalize(port).unwrap_or_else(|_| port.to_owned());
    latency_timer_in(Path::new("/sys"), node.file_name()?.to_str()?)
}

fn latency_timer_in(sys: &Path, tty: &str) -> Option<u32> {
    text(
        &sys.join("bus/usb-serial/devices")
            .join(tty)
            .join("latency_timer"),
    )
    .parse()
    .ok()
}

fn serial_ports_in(sys: &Path, dev: &Path) -> Vec<FoundPort> {
    let mut ports: Vec<_> = names_in(&sys.join("class/tty"))
        .into_iter()
        .filter_map(|tty| {
            let device = fs::canonicalize(sys.join("class/tty").join(&tty).join("device")).ok()?;
            let usb = device
                .ancestors()
                .find(|ancestor| ancestor.join("idVendor").is_file())?;
            let hex = |name: &str| u16::from_str_radix(&text(&usb.join(name)), 16).ok();
            let path = dev.join(&tty);
            Some(FoundPort {
                by_id: ["serial/by-id", "ft-capture"]
                    .iter()
                    .find_map(|folder| link_to(&dev.join(folder), &path)),
                vendor: hex("idVendor")?,
                product: hex("idProduct")?,
                manufacturer: text(&usb.join("manufacturer")),
                product_name: text(&usb.join("product")),
                serial_number: text(&usb.join("serial")),
                interface: device
                    .ancestors()
                    .take_while(|ancestor| *ancestor != usb)
                    .find_map(|ancestor| {
                        u8::from_str_radix(&text(&ancestor.join("bInterfaceNumber")), 16).ok()
                    }),
                driver: driver_of(&device),
                latency_timer_ms: latency_timer_in(sys, &tty),
                permitted: is_permitted(&path),
                path,
            })
        })
        .collect();
    ports.sort_by(|a, b| a.path.cmp(&b.path));
    ports
}

fn can_interfaces_in(sys: &Path) -> Vec<CanInterface> {
    /// `ARPHRD_CAN` of `linux/if_arp.h`.
    const TYPE_CAN: &str = "280";
    /// `IFF_UP` of `linux/if.h`.
    const UP: u32 = 1;
    let mut interfaces: Vec<_> = names_in(&sys.join("class/net"))
        .into_iter()
        .filter_map(|name| {
            let entry = sys.join("class/net").join(&name);
            let flags = text(&entry.join("flags"));
            let flags = u32::from_str_radix(flags.trim_start_matches("0x"), 16).unwrap_or(0);
            (text(&entry.join("type")) == TYPE_CAN).then(|| CanInterface {
                driver: driver_of(&entry.join("device")),
                up: flags & UP != 0,
                name,
            })
        })
        .collect();
    interfaces.sort_by(|a, b| a.name.cmp(&b.name));
    interfaces
}

fn names_in(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).into_iter().flatten().flatten();
    entries
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect()
}

fn text(file: &Path) -> String {
    fs::read_to_string(file)
        .map(|text| text.trim().to_owned())
        .unwrap_or_default()
}

/// The driver of a device directory, or of the nearest directory above it that has one.
fn driver_of(device: &Path) -> String {
    let device = fs::canonicalize(device).unwrap_or_default();
    let driver = device
        .ancestors()
        .find_map(|ancestor| fs::read_link(ancestor.join("driver")).ok());
    driver
        .and_then(|driver| driver.file_name()?.to_str().map(str::to_owned))
        .unwrap_or_default()
}

/// The symbolic link in `directory` that leads to `node`.
fn link_to(directory: &Path, node: &Path) -> Option<PathBuf> {
    let node = fs::canonicalize(node).ok()?;
    let mut links: Vec<_> = names_in(directory)
        .into_iter()
        .map(|name| directory.join(name))
        .collect();
    links.sort();
    links
        .into_iter()
        .find(|link| fs::canonicalize(link).is_ok_and(|target| target == node))
}

#[cfg(test)]
mod tests;
