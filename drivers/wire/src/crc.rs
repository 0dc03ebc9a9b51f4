//! The check sums of the devices.

use crc::{CRC_16_IBM_SDLC, CRC_16_UMTS, Crc, Table};

/// CRC-16/X-25 (also named IBM-SDLC): reflected 0x1021, init and xor-out 0xFFFF. Bota sensors and the pose stream.
pub const X25: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_IBM_SDLC);

/// CRC-16/UMTS: 0x8005, not reflected, init 0. Dynamixel protocol 2.0.
pub const DYNAMIXEL: Crc<u16, Table<16>> = Crc::<u16, Table<16>>::new(&CRC_16_UMTS);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn check_values_of_the_catalogue_hold() {
        assert_eq!(X25.checksum(b"123456789"), 0x906E);
        assert_eq!(DYNAMIXEL.checksum(b"123456789"), 0xFEE8);
    }
}
