//! A port that is found again after a replug, whatever name it has then.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FoundPort, serial_ports};
use crate::link::LinkError;

/// A port of the configuration, and the USB serial number of what was there when it was last seen.
#[derive(Clone, Debug)]
pub struct RememberedPort {
    configured: PathBuf,
    seen: Option<(u16, u16, String)>,
}

impl RememberedPort {
    /// The port named by the configuration, not seen yet.
    #[must_use]
    pub fn new(configured: &Path) -> Self {
        Self {
            configured: configured.to_owned(),
            seen: None,
        }
    }

    /// Where the port is now: the configured name, unless what was seen there is at another one. A converter without a serial
    /// number cannot be told from another one and stays at its name.
    ///
    /// # Errors
    /// What was seen is nowhere, and another device is where it was.
    pub fn path(&mut self) -> Result<PathBuf, LinkError> {
        self.path_among(&serial_ports())
    }

    pub(super) fn path_among(&mut self, ports: &[FoundPort]) -> Result<PathBuf, LinkError> {
        let node = fs::canonicalize(&self.configured).unwrap_or_else(|_| self.configured.clone());
        let there = ports.iter().find(|port| port.path == node);
        let Some(seen) = &self.seen else {
            self.seen = there
                .filter(|port| !port.serial_number.is_empty())
                .map(identity);
            return Ok(self.configured.clone());
        };
        if there.is_some_and(|port| identity(port) == *seen) {
            return Ok(self.configured.clone());
        }
        match (ports.iter().find(|port| identity(port) == *seen), there) {
            (Some(elsewhere), _) => Ok(elsewhere.path.clone()),
            (None, None) => Ok(self.configured.clone()),
            (None, Some(other)) => Err(LinkError::Other {
                port: self.configured.display().to_string(),
                there: other.serial_number.clone(),
                wanted: seen.2.clone(),
            }),
        }
    }
}

fn identity(port: &FoundPort) -> (u16, u16, String) {
    (port.vendor, port.product, port.serial_number.clone())
}
