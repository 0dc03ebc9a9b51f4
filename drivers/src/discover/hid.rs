//! HID devices that have an axis, listed by the `hidapi` crate.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use ft_wire::hid;
use hidapi::{DeviceInfo, HidApi};

use super::{is_permitted, udev_line};

/// A HID device with at least one axis.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FoundHid {
    /// Device node, such as `/dev/hidraw0`.
    pub path: PathBuf,
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// What it calls itself.
    pub name: String,
    /// Serial number, empty when there is none.
    pub serial_number: String,
    /// Number of the USB interface: which part of a device that has several under one serial number.
    pub interface: Option<u8>,
    /// Names of its axes.
    pub axes: Vec<&'static str>,
    /// Whether this user may open it.
    pub permitted: bool,
}

impl fmt::Display for FoundHid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (vendor, product, name) = (self.vendor, self.product, &self.name);
        write!(
            f,
            "{}  {vendor:04x}:{product:04x}  {name}",
            self.path.display()
        )?;
        if !self.serial_number.is_empty() {
            write!(f, "  {}", self.serial_number)?;
        }
        write!(f, "  for hid_axis, axes {}", self.axes.join(", "))?;
        if !self.permitted {
            let rule = udev_line("hidraw", vendor, product);
            write!(
                f,
                "  NOT PERMITTED: add this line to the rules of udev/: {rule}"
            )?;
        }
        Ok(())
    }
}

/// The HID devices that have an axis, by path. None is opened.
#[must_use]
pub fn hid_devices() -> Vec<FoundHid> {
    let Ok(api) = HidApi::new() else {
        return Vec::new();
    };
    // One entry for each collection of a device: they share a node.
    let by_node: BTreeMap<_, _> = api
        .device_list()
        .filter_map(|info| Some((PathBuf::from(info.path().to_str().ok()?), info)))
        .collect();
    by_node
        .into_iter()
        .filter_map(|(path, info)| {
            let axes = axes(&fs::read(descriptor(&path)).ok()?)?;
            Some(FoundHid {
                vendor: info.vendor_id(),
                product: info.product_id(),
                name: name(info),
                serial_number: info.serial_number().unwrap_or_default().to_owned(),
                interface: u8::try_from(info.interface_number()).ok(),
                axes,
                permitted: is_permitted(&path),
                path,
            })
        })
        .collect()
}

/// Names of the axes of a descriptor, `None` when there is none.
pub(super) fn axes(descriptor: &[u8]) -> Option<Vec<&'static str>> {
    let axes = hid::axes(descriptor).ok()?;
    (!axes.is_empty()).then(|| axes.iter().map(|axis| axis.usage.name()).collect())
}

/// Where sysfs keeps a node's descriptor: hidapi gives it for an opened device only, and a keyboard is not opened to be listed.
fn descriptor(node: &Path) -> PathBuf {
    Path::new("/sys/class/hidraw")
        .join(node.file_name().unwrap_or_default())
        .join("device/report_descriptor")
}

fn name(info: &DeviceInfo) -> String {
    let [maker, product] =
        [info.manufacturer_string(), info.product_string()].map(|text| text.unwrap_or_default());
    format!("{maker} {product}").trim().to_owned()
}
