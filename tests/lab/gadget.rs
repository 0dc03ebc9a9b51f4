//! Virtual USB devices that the guest's kernel enumerates for real: gadgets on `dummy_hcd`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::time::Duration;

use ft_drivers::discover::{self, FoundPort};

use crate::machine::{load, run, wait_for};

const GADGETS: &str = "/sys/kernel/config/usb_gadget";
/// For the host to notice a device.
const ENUMERATION: Duration = Duration::from_secs(15);

/// A USB device made of functions of the kernel; unplugged and gone when it is dropped.
pub(crate) struct Gadget {
    folder: PathBuf,
    socket: usize,
    serial_number: String,
}

impl Gadget {
    /// A device without functions, not plugged in, for one of the four sockets.
    pub(crate) fn new(socket: usize, vendor: u16, product: u16, serial_number: &str) -> Self {
        static LOADED: Once = Once::new();
        LOADED.call_once(|| {
            load("libcomposite");
            load("dummy_hcd num=4");
            if !Path::new(GADGETS).exists() {
                run("mount -t configfs configfs /sys/kernel/config");
            }
        });
        let folder = Path::new(GADGETS).join(serial_number);
        for part in ["strings/0x409", "configs/c.1"] {
            fs::create_dir_all(folder.join(part)).unwrap();
        }
        let gadget = Self {
            folder,
            socket,
            serial_number: serial_number.to_owned(),
        };
        gadget.write("idVendor", format!("0x{vendor:04x}"));
        gadget.write("idProduct", format!("0x{product:04x}"));
        gadget.write("strings/0x409/manufacturer", "Lab");
        gadget.write("strings/0x409/product", "Simulated device");
        gadget.write("strings/0x409/serialnumber", serial_number);
        gadget
    }

    /// One serial port; the second part is the device's side.
    pub(crate) fn serial(
        socket: usize,
        vendor: u16,
        product: u16,
        serial_number: &str,
    ) -> (Self, PathBuf) {
        for module in ["usb_f_acm", "cdc_acm"] {
            load(module);
        }
        let gadget = Self::new(socket, vendor, product, serial_number);
        gadget.add("acm.usb0");
        let number = fs::read_to_string(gadget.folder.join("functions/acm.usb0/port_num"));
        let tty = PathBuf::from(format!("/dev/ttyGS{}", number.unwrap().trim()));
        wait_for("the gadget's side", ENUMERATION, || tty.exists());
        (gadget, tty)
    }

    pub(crate) fn write(&self, attribute: &str, value: impl AsRef<[u8]>) {
        let path = self.folder.join(attribute);
        fs::write(&path, value).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    }

    /// Makes a function, to be set up.
    pub(crate) fn function(&self, function: &str) -> PathBuf {
        let made = self.folder.join("functions").join(function);
        fs::create_dir_all(&made).unwrap();
        made
    }

    /// Makes a function unless there is one, and puts it into the device.
    pub(crate) fn add(&self, function: &str) {
        let made = self.function(function);
        let link = self.folder.join("configs/c.1").join(function);
        if !link.exists() {
            std::os::unix::fs::symlink(&made, link).unwrap();
        }
    }

    pub(crate) fn plug_in(&self) {
        self.write("UDC", format!("dummy_udc.{}", self.socket));
    }

    pub(crate) fn unplug(&self) {
        // Refused when it was not plugged in.
        let _ = fs::write(self.folder.join("UDC"), "\n");
    }

    /// The host's serial port of this device, once there is one that can be opened.
    pub(crate) fn port(&self) -> FoundPort {
        let mut found = None;
        wait_for("the host's serial port", ENUMERATION, || {
            let mut ports = discover::serial_ports().into_iter();
            found = ports.find(|port| port.serial_number == self.serial_number);
            found.as_ref().is_some_and(|port| port.path.exists())
        });
        found.unwrap()
    }
}

impl Drop for Gadget {
    fn drop(&mut self) {
        self.unplug();
        let remove = |part: &str| fs::read_dir(self.folder.join(part)).into_iter().flatten();
        for entry in remove("configs/c.1").flatten() {
            if entry.file_type().is_ok_and(|kind| kind.is_symlink()) {
                let _ = fs::remove_file(entry.path());
            }
        }
        let _ = fs::remove_dir(self.folder.join("configs/c.1"));
        for entry in remove("functions").flatten() {
            let _ = fs::remove_dir(entry.path());
        }
        for part in ["strings/0x409", ""] {
            let _ = fs::remove_dir(self.folder.join(part));
        }
    }
}
