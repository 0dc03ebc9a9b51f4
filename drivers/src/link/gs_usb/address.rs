//! How the configuration names an adapter.

use std::fmt;

use crate::link::LinkError;

/// What the names of adapters in user space begin with.
pub const PREFIX: &str = "gs_usb:";
/// What all of the supported sensors come with.
const USUAL_BPS: u32 = 1_000_000;

/// `gs_usb:SERIAL[/CHANNEL][@BIT_RATE]`: the adapter's USB serial number, empty where only one is plugged in; which of its
/// CAN buses, 0 unless said; bit/s, 1 000 000 unless said.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// USB serial number; empty for the only adapter.
    pub serial_number: String,
    /// Which CAN bus of the adapter, from 0.
    pub channel: u8,
    /// Bit rate of the bus, bit/s.
    pub bitrate_bps: u32,
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
                Some((rest, rate)) => (rest, rate.parse().ok().filter(|rate| *rate > 0)?),
                None => (rest, USUAL_BPS),
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

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{PREFIX}{}", self.serial_number)?;
        if self.channel != 0 {
            write!(f, "/{}", self.channel)?;
        }
        if self.bitrate_bps != USUAL_BPS {
            write!(f, "@{}", self.bitrate_bps)?;
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
            ("gs_usb:", "", 0, 1_000_000),
            ("gs_usb:0039001B", "0039001B", 0, 1_000_000),
            ("gs_usb:0039001B/1", "0039001B", 1, 1_000_000),
            ("gs_usb:A/B/1@250000", "A/B", 1, 250_000),
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
