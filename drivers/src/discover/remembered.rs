//! A port that is found again after a replug, whatever name it has then.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FoundHid, FoundPort, hid_devices, serial_ports};
use crate::link::LinkError;

/// A device node and what is behind it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Place {
    path: PathBuf,
    identity: Identity,
}

/// What stays over a replug.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Identity {
    vendor: u16,
    product: u16,
    serial_number: String,
    /// Which of the device's interfaces: the channels of an FT2232 or FT4232 share their serial number.
    interface: Option<u8>,
}

impl Identity {
    /// For errors: the serial number, and the interface where `other` differs by that alone.
    fn beside(&self, other: &Self) -> String {
        match self.interface {
            Some(interface) if self.serial_number == other.serial_number => {
                format!("{}, interface {interface}", self.serial_number)
            }
            _ => self.serial_number.clone(),
        }
    }
}

impl From<&FoundPort> for Place {
    fn from(port: &FoundPort) -> Self {
        Self {
            path: port.path.clone(),
            identity: Identity {
                vendor: port.vendor,
                product: port.product,
                serial_number: port.serial_number.clone(),
                interface: port.interface,
            },
        }
    }
}

impl From<&FoundHid> for Place {
    fn from(device: &FoundHid) -> Self {
        Self {
            path: device.path.clone(),
            identity: Identity {
                vendor: device.vendor,
                product: device.product,
                serial_number: device.serial_number.clone(),
                interface: device.interface,
            },
        }
    }
}

/// A port of the configuration, and the USB serial number and interface of what was there when it was last seen.
#[derive(Clone, Debug)]
pub struct RememberedPort {
    configured: PathBuf,
    seen: Option<Identity>,
    there_are: fn() -> Vec<Place>,
}

impl RememberedPort {
    /// The serial port named by the configuration, not seen yet.
    #[must_use]
    pub fn serial(configured: &Path) -> Self {
        Self::new(configured, || {
            serial_ports().iter().map(Place::from).collect()
        })
    }

    /// The HID device named by the configuration, not seen yet.
    #[must_use]
    pub fn hid(configured: &Path) -> Self {
        Self::new(configured, || {
            hid_devices().iter().map(Place::from).collect()
        })
    }

    fn new(configured: &Path, there_are: fn() -> Vec<Place>) -> Self {
        Self {
            configured: configured.to_owned(),
            seen: None,
            there_are,
        }
    }

    /// Where the port is now: the configured name, unless what was seen there is at another one. A device without a serial
    /// number cannot be told from another one and stays at its name.
    ///
    /// # Errors
    /// What was seen is nowhere, and another device is where it was.
    pub fn path(&mut self) -> Result<PathBuf, LinkError> {
        self.path_among((self.there_are)())
    }

    /// Opens the port where it is now, and looks again: between look and opening another device may have come to its name.
    ///
    /// # Errors
    /// Those of [`RememberedPort::path`] and of `open`; the other device is let go.
    pub fn open<L>(
        &mut self,
        open: impl FnOnce(&Path) -> Result<L, LinkError>,
    ) -> Result<L, LinkError> {
        self.open_among(self.there_are, open)
    }

    pub(super) fn open_among<L>(
        &mut self,
        mut there_are: impl FnMut() -> Vec<Place>,
        open: impl FnOnce(&Path) -> Result<L, LinkError>,
    ) -> Result<L, LinkError> {
        // What could not be opened, or was gone again, is not the device to look for later.
        let mut looking = self.clone();
        let path = looking.path_among(there_are())?;
        let link = open(&path)?;
        if looking.path_among(there_are())? == path {
            *self = looking;
            return Ok(link);
        }
        let port = path.display().to_string();
        Err(LinkError::Gone { port })
    }

    pub(super) fn path_among(&mut self, places: Vec<Place>) -> Result<PathBuf, LinkError> {
        let node = fs::canonicalize(&self.configured).unwrap_or_else(|_| self.configured.clone());
        let there = places.iter().find(|place| place.path == node);
        let Some(seen) = &self.seen else {
            self.seen = there
                .map(|place| place.identity.clone())
                .filter(|identity| !identity.serial_number.is_empty());
            return Ok(self.configured.clone());
        };
        if there.is_some_and(|place| place.identity == *seen) {
            return Ok(self.configured.clone());
        }
        match (places.iter().find(|place| place.identity == *seen), there) {
            (Some(elsewhere), _) => Ok(elsewhere.path.clone()),
            (None, None) => Ok(self.configured.clone()),
            (None, Some(other)) => Err(LinkError::Other {
                port: self.configured.display().to_string(),
                there: other.identity.beside(seen),
                wanted: seen.beside(&other.identity),
            }),
        }
    }
}
