//! The text that the sensor prints when it is powered, picked out of a byte stream.

use ft_wire::bota_serial::{BootLine, decode_boot_line};

use crate::reading::Identity;

/// Lines of text among the bytes that are no frame.
#[derive(Debug)]
pub(super) struct BootText {
    line: [u8; 64],
    len: usize,
    collected: Identity,
    /// Who is there, once the last line has come.
    pub(super) identity: Option<Identity>,
    /// `App Init` came: the sensor's program began.
    pub(super) booted: bool,
}

impl BootText {
    pub(super) fn new() -> Self {
        Self {
            line: [0; 64],
            len: 0,
            collected: Identity::default(),
            identity: None,
            booted: false,
        }
    }

    pub(super) fn push(&mut self, byte: u8) {
        match byte {
            b'\r' | b'\n' => {
                self.end_of_line();
                self.len = 0;
            }
            b' '..=b'~' => {
                if let Some(slot) = self.line.get_mut(self.len) {
                    *slot = byte;
                    self.len += 1;
                }
            }
            _ => self.len = 0,
        }
    }

    fn end_of_line(&mut self) {
        match decode_boot_line(self.line.get(..self.len).unwrap_or_default()) {
            None => {}
            Some(BootLine::AppInit) => {
                self.booted = true;
                self.collected = Identity::default();
            }
            Some(BootLine::Name(name)) => name.clone_into(&mut self.collected.model),
            Some(BootLine::SerialNumber(number)) => {
                number.clone_into(&mut self.collected.serial_number)
            }
            // The last line of the boot text.
            Some(BootLine::Firmware(version)) => {
                version.clone_into(&mut self.collected.firmware);
                self.identity = Some(core::mem::take(&mut self.collected));
            }
        }
    }
}
