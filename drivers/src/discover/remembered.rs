//! A port that is found again after a replug, whatever name it has then.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FoundHid, FoundPort, hid_devices, serial_ports};
use crate::link::LinkError;

/// A device node and what is behind it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Place {
    path: PathBuf,
    identity: (u16, u16, String),
}

impl From<&FoundPort> for Place {
    fn from(port: &FoundPort) -> Self {
        let identity = (port.vendor, port.product, port.serial_number.clone());
        let path = port.path.clone();
        Self { path, identity }
    }
}

impl From<&FoundHid> for Place {
    fn from(device: &FoundHid) -> Self {
        let identity = (device.vendor, device.product, device.serial_number.clone());
        let path = device.path.clone();
        Self { path, identity }
    }
}

/// A port of the configuration, and the USB serial number of what was there when it was last seen.
#[derive(Clone, Debug)]
pub struct RememberedPort {
    configured: PathBuf,
    seen: Option<(u16, u16, String)>,
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
        let path = self.path_among(there_are())?;
        let link = open(&path)?;
        if self.path_among(there_are())? == path {
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
                .filter(|(_, _, serial_number)| !serial_number.is_empty());
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
                there: other.identity.2.clone(),
                wanted: seen.2.clone(),
            }),
        }
    }
}
