//! HID devices that have an axis.

use std::fmt;
use std::fs;
use std::path::{Path, PathBuf};

use ft_wire::hid;

use super::{is_permitted, names_in, text, udev_line};

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

/// The HID devices that have an axis, by path.
#[must_use]
pub fn hid_devices() -> Vec<FoundHid> {
    hid_devices_in(Path::new("/sys"), Path::new("/dev"))
}

pub(super) fn hid_devices_in(sys: &Path, dev: &Path) -> Vec<FoundHid> {
    let class = sys.join("class/hidraw");
    let mut found: Vec<_> = names_in(&class)
        .into_iter()
        .filter_map(|node| {
            let device = class.join(&node).join("device");
            let descriptor = fs::read(device.join("report_descriptor")).ok()?;
            let axes: Vec<_> = hid::axes(&descriptor).ok()?;
            if axes.is_empty() {
                return None;
            }
            let uevent = text(&device.join("uevent"));
            let (vendor, product) = identity(value(&uevent, "HID_ID")?)?;
            let path = dev.join(&node);
            Some(FoundHid {
                vendor,
                product,
                name: value(&uevent, "HID_NAME").unwrap_or_default().to_owned(),
                axes: axes.iter().map(|axis| axis.usage.name()).collect(),
                permitted: is_permitted(&path),
                path,
            })
        })
        .collect();
    found.sort_by(|a, b| a.path.cmp(&b.path));
    found
}

fn value<'a>(uevent: &'a str, key: &str) -> Option<&'a str> {
    uevent.lines().find_map(|line| {
        let (found, value) = line.split_once('=')?;
        (found == key).then_some(value)
    })
}

/// `0003:00002341:00008036`: bus, vendor, product.
fn identity(id: &str) -> Option<(u16, u16)> {
    let mut parts = id.split(':').skip(1);
    let mut next = || {
        let number = u32::from_str_radix(parts.next()?, 16).ok()?;
        u16::try_from(number).ok()
    };
    Some((next()?, next()?))
}
