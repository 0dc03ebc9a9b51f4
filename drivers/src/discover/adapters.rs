//! candleLight adapters, listed by libusb.

use std::fmt;
use std::fs;
use std::path::Path;

use rusb::{Context, Device, DeviceDescriptor, UsbContext as _};

use super::{Attachment, CanInterface, can_interfaces, identity, udev_line};
use crate::link::LinkError;
use crate::link::gs_usb::PREFIX;

/// A CAN adapter that can be opened in user space.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundAdapter {
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// Serial number, empty when there is none or it may not be opened.
    pub serial_number: String,
    /// The kernel's interface of it, when the kernel made one.
    pub interface: Option<CanInterface>,
    /// Whether this user may open it.
    pub permitted: bool,
}

impl FoundAdapter {
    /// For the configuration: `gs_usb:SERIAL`.
    #[must_use]
    pub fn port(&self) -> String {
        format!("{PREFIX}{}", self.serial_number)
    }
}

impl fmt::Display for FoundAdapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (vendor, product) = (self.vendor, self.product);
        let name = identity(vendor, product).map_or("", |identity| identity.name);
        write!(f, "{}  {vendor:04x}:{product:04x}  {name}", self.port())?;
        if let Some(interface) = &self.interface {
            write!(f, "  {} in the kernel", interface.name)?;
            if interface.up {
                write!(f, ", up: not to be opened here")?;
            }
        }
        if !self.permitted {
            let rule = udev_line("usb", vendor, product);
            write!(
                f,
                "  NOT PERMITTED in user space: install the rules of udev/, or this line: {rule}"
            )?;
        }
        Ok(())
    }
}

/// The candleLight adapters, by serial number.
#[must_use]
pub fn can_adapters() -> Vec<FoundAdapter> {
    let mut found: Vec<_> = candlelights()
        .map(|(device, descriptor)| {
            let opened = device.open();
            FoundAdapter {
                vendor: descriptor.vendor_id(),
                product: descriptor.product_id(),
                permitted: !matches!(opened, Err(rusb::Error::Access)),
                serial_number: opened
                    .and_then(|handle| handle.read_serial_number_string_ascii(&descriptor))
                    .unwrap_or_default(),
                interface: interface(&device),
            }
        })
        .collect();
    found.sort_by(|a, b| a.serial_number.cmp(&b.serial_number));
    found
}

fn candlelights() -> impl Iterator<Item = (Device<Context>, DeviceDescriptor)> {
    // A system without USB has no adapters; rusb's context for all would panic there.
    let devices = Context::new().and_then(|context| context.devices()).ok();
    let devices: Vec<_> = devices.iter().flat_map(|list| list.iter()).collect();
    devices.into_iter().filter_map(|device| {
        let descriptor = device.device_descriptor().ok()?;
        let identity = identity(descriptor.vendor_id(), descriptor.product_id())?;
        (identity.attachment == Attachment::CandleLight).then_some((device, descriptor))
    })
}

/// The kernel's interface of a device: sysfs names its USB interfaces by bus and ports, such as `1-2.4:1.0`.
fn interface(device: &Device<Context>) -> Option<CanInterface> {
    let ports: Vec<_> = device
        .port_numbers()
        .ok()?
        .iter()
        .map(u8::to_string)
        .collect();
    let prefix = format!("{}-{}:", device.bus_number(), ports.join("."));
    can_interfaces().into_iter().find(|interface| {
        let link = Path::new("/sys/class/net")
            .join(&interface.name)
            .join("device");
        fs::canonicalize(link).is_ok_and(|path| {
            path.file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with(&prefix))
        })
    })
}

/// The adapter with this serial number, or the only one when it is empty. `port` is for the errors.
///
/// # Errors
/// There is none, there are several, it may not be opened, or the kernel's interface of it is up.
pub(crate) fn adapter(port: &str, serial_number: &str) -> Result<Device<Context>, LinkError> {
    let port = || port.to_owned();
    let mut denied = false;
    let mut found = Vec::new();
    for (device, descriptor) in candlelights() {
        if !serial_number.is_empty() {
            let named = device
                .open()
                .and_then(|handle| handle.read_serial_number_string_ascii(&descriptor));
            denied |= matches!(named, Err(rusb::Error::Access));
            if named.as_deref() != Ok(serial_number) {
                continue;
            }
        }
        found.push(device);
    }
    match (found.pop(), found.len()) {
        (Some(device), 0) => match interface(&device) {
            Some(interface) if interface.up => Err(LinkError::Busy { port: port() }),
            _ => Ok(device),
        },
        (Some(_), others) => Err(LinkError::Ambiguous {
            port: port(),
            count: others + 1,
        }),
        (None, _) if denied => Err(LinkError::Denied { port: port() }),
        (None, _) => Err(LinkError::NotFound { port: port() }),
    }
}
