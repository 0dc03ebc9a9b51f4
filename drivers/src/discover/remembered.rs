//! A port that is found again after a replug, whatever name it has then.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FoundPort, serial_ports};

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
    #[must_use]
    pub fn path(&mut self) -> PathBuf {
        self.path_among(&serial_ports())
    }

    pub(super) fn path_among(&mut self, ports: &[FoundPort]) -> PathBuf {
        let node = fs::canonicalize(&self.configured).unwrap_or_else(|_| self.configured.clone());
        let there = ports.iter().find(|port| port.path == node);
        let Some(seen) = &self.seen else {
            self.seen = there
                .filter(|port| !port.serial_number.is_empty())
                .map(identity);
            return self.configured.clone();
        };
        if there.is_some_and(|port| identity(port) == *seen) {
            return self.configured.clone();
        }
        let elsewhere = ports.iter().find(|port| identity(port) == *seen);
        elsewhere.map_or_else(|| self.configured.clone(), |port| port.path.clone())
    }
}

fn identity(port: &FoundPort) -> (u16, u16, String) {
    (port.vendor, port.product, port.serial_number.clone())
}
