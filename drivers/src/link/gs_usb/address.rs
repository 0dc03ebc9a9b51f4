//! How the configuration names an adapter.

use std::fmt;

use crate::link::LinkError;

/// What the names of adapters in user space begin with.
pub const PREFIX: &str = "gs_usb:";

/// `gs_usb:SERIAL[/CHANNEL][@BIT_RATE]`: the adapter's USB serial number, empty where only one is plugged in; which of its
/// CAN buses, 0 unless said; bit/s, what the driver's sensor leaves the factory with unless said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// USB serial number; empty for the only adapter.
    pub serial_number: String,
    /// Which CAN bus of the adapter, from 0.
    pub channel: u8,
    /// Bit rate of the bus, bit/s; `None` for the sensor's own.
    pub bitrate_bps: Option<u32>,
}

impl Address {
    /// Reads a port of the configuration.
    ///
    /// # Errors
    /// It is not written as above.
    pub fn parse(port: &str) -> Result<Self, LinkError> {
        let parts = || {
            let rest = port.strip_prefix(PREFIX)?;
            let (rest, bitrate_bps) = match rest.rsplit_once('@') {
                Some((rest, rate)) => (rest, Some(rate.parse().ok().filter(|rate| *rate > 0)?)),
                None => (rest, None),
            };
            let (serial_number, channel) = match rest.rsplit_once('/') {
                Some((serial_number, channel)) => (serial_number, channel.parse().ok()?),
                None => (rest, 0),
            };
            Some(Self {
                serial_number: serial_number.to_owned(),
                channel,
                bitrate_bps,
            })
        };
        parts().ok_or_else(|| LinkError::Name {
            port: port.to_owned(),
            form: "gs_usb:SERIAL/CHANNEL@BIT_RATE, such as gs_usb:0039001B/0@1000000",
        })
    }
}

impl Address {
    /// From now on this is the adapter meant, where none was named.
    pub(crate) fn remember(&mut self, serial_number: &str) {
        if self.serial_number.is_empty() {
            serial_number.clone_into(&mut self.serial_number);
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{PREFIX}{}", self.serial_number)?;
        if self.channel != 0 {
            write!(f, "/{}", self.channel)?;
        }
        if let Some(bitrate_bps) = self.bitrate_bps {
            write!(f, "@{bitrate_bps}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_is_read_and_written() {
        for (text, serial_number, channel, bitrate_bps) in [
            ("gs_usb:", "", 0, None),
            ("gs_usb:0039001B", "0039001B", 0, None),
            ("gs_usb:0039001B/1", "0039001B", 1, None),
            ("gs_usb:A/B/1@250000", "A/B", 1, Some(250_000)),
        ] {
            let address = Address::parse(text).unwrap();
            let serial_number = serial_number.to_owned();
            let expected = Address {
                serial_number,
                channel,
                bitrate_bps,
            };
            assert_eq!(address, expected);
            assert_eq!(address.to_string(), text);
        }
    }

    #[test]
    fn the_first_adapter_found_is_the_one_that_is_meant() {
        let mut address = Address::parse("gs_usb:/1@250000").unwrap();
        for found in ["", "A1", "B2"] {
            address.remember(found);
        }
        assert_eq!(address.to_string(), "gs_usb:A1/1@250000");
    }

    #[test]
    fn what_is_no_address_is_refused_with_its_form() {
        for text in [
            "can0",
            "gs_usb:A@",
            "gs_usb:A@0",
            "gs_usb:A/x",
            "gs_usb:A/256",
        ] {
            let refused = Address::parse(text).unwrap_err().to_string();
            assert!(refused.contains("gs_usb:SERIAL"), "{refused}");
        }
    }
}
