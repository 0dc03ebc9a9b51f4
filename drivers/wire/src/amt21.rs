//! CUI AMT21 absolute encoders on RS-485, 2 Mbit/s (models A to D) or 9600 to 115 200 bit/s (models E to H), 8N1.
//!
//! | request, one byte | reply |
//! |---|---|
//! | address (a multiple of 4, factory 0x54) | u16 **little endian**: bit 15 K1, bit 14 K0, bits 13..0 position, 16 384 per turn |
//!
//! K1 = not of the exclusive or of the odd bits of the position, K0 = that of the even bits. 12-bit models leave bits 1 and 0 at 0.
//! No framing: one request at a time, and two bytes are the whole answer.
//!
//! **What the check bits cannot promise**: one flipped bit is refused; two flips of odd bits, or of even ones, are not seen, and
//! two bytes of different answers pass one time in four.
//!
//! # Source
//! hardware.md 3.2: `cuidevices/AMT21_RS485_Sample_Code_Mega`, datasheet with an example [A].

use crate::error::DecodeError;

/// Counts per turn.
pub const COUNTS_PER_TURN: u16 = 1 << 14;
/// The factory's address.
pub const FACTORY_ADDRESS: u8 = 0x54;
/// Length of an answer, bytes.
pub const REPLY_LEN: usize = 2;

const POSITION: u16 = COUNTS_PER_TURN - 1;
const ODD: u16 = 0x2AAA;
const EVEN: u16 = 0x1555;

/// The byte that asks the encoder at `address` for its position.
#[must_use]
pub const fn position_request(address: u8) -> u8 {
    address & !3
}

/// Reads a position.
///
/// # Errors
/// The check bits are wrong.
pub fn decode_position(reply: [u8; REPLY_LEN]) -> Result<u16, DecodeError> {
    let word = u16::from_le_bytes(reply);
    let position = word & POSITION;
    let (computed, carried) = (check_bits(position), word >> 14);
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    Ok(position)
}

/// Writes a position; bits above the 14th are left out.
#[must_use]
pub fn encode_position(position: u16) -> [u8; REPLY_LEN] {
    let position = position & POSITION;
    (position | check_bits(position) << 14).to_le_bytes()
}

/// K1 and K0 as bits 1 and 0.
fn check_bits(position: u16) -> u16 {
    let even_number_of = |bits: u16| u16::from((position & bits).count_ones().is_multiple_of(2));
    even_number_of(ODD) << 1 | even_number_of(EVEN)
}

#[cfg(test)]
mod tests {
    use super::*;

    // hardware.md 3.2; 0x61AB is the datasheet's example, the others computed.
    const GOLDEN: [([u8; 2], u16); 6] = [
        ([0x00, 0xC0], 0),
        ([0x01, 0x80], 1),
        ([0x02, 0x40], 2),
        ([0xAB, 0x61], 0x21AB),
        ([0xFF, 0x3F], 0x3FFF),
        ([0x00, 0x60], 0x2000),
    ];

    #[test]
    fn golden_positions_decode_and_encode() {
        for (bytes, position) in GOLDEN {
            assert_eq!(decode_position(bytes), Ok(position));
            assert_eq!(encode_position(position), bytes);
        }
        assert_eq!(position_request(0x57), 0x54);
    }

    #[test]
    fn every_position_comes_back_and_every_flipped_bit_is_refused() {
        for position in 0..COUNTS_PER_TURN {
            let bytes = encode_position(position);
            assert_eq!(decode_position(bytes), Ok(position));
            for bit in 0..16 {
                let flipped = (u16::from_le_bytes(bytes) ^ (1 << bit)).to_le_bytes();
                assert!(decode_position(flipped).is_err(), "{position} bit {bit}");
            }
        }
    }

    #[test]
    fn a_quarter_of_all_words_passes_the_check() {
        let passing = (0..=u16::MAX)
            .filter(|word| decode_position(word.to_le_bytes()).is_ok())
            .count();
        assert_eq!(passing, 1 << 14);
    }
}
