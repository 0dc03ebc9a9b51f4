//! Check sums, bit by bit from their published parameters.

/// CRC-16/X-25: polynomial 0x1021 reflected, start 0xFFFF, inverted at the end.
pub(crate) fn x25(bytes: &[u8]) -> u16 {
    let mut crc = 0xFFFF_u16;
    for byte in bytes {
        crc ^= u16::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 {
                (crc >> 1) ^ 0x8408
            } else {
                crc >> 1
            };
        }
    }
    !crc
}

/// CRC-16 of Dynamixel 2.0: polynomial 0x8005, start 0, not reflected.
pub(crate) fn dynamixel(bytes: &[u8]) -> u16 {
    let mut crc = 0_u16;
    for byte in bytes {
        crc ^= u16::from(*byte) << 8;
        for _ in 0..8 {
            crc = if crc & 0x8000 != 0 {
                (crc << 1) ^ 0x8005
            } else {
                crc << 1
            };
        }
    }
    crc
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_catalogued_check_values_come_out() {
        assert_eq!(x25(b"123456789"), 0x906E);
        assert_eq!(dynamixel(b"123456789"), 0xFEE8);
    }
}
