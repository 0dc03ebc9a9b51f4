//! Kunwei KWR75 sensors on RS-422 or USB, 460 800 bit/s 8N1.
//!
//! | bytes | 0 | 1 | 2..26 | 26..28 |
//! |---|---|---|---|---|
//! | sample | 48 (streamed) or 49 (asked) | AA | 6 x f32 **little endian**: Fx Fy Fz in **kg**, Mx My Mz in **kg m** | 0D 0A |
//!
//! Commands, 4 bytes: `48 AA 0D 0A` stream at 1 kHz, `49 AA 0D 0A` one sample, `43 AA 0D 0A` stop. None is answered by itself.
//!
//! **No check sum, no counter.** Head and tail may stand in the payload by chance, so one frame proves nothing: a reader must find
//! several at 28 bytes' distance before it trusts the first. A flipped bit in a number is seen only when the number becomes
//! not finite or larger than [`MAX_KG`] and [`MAX_KGM`]; drivers must look at steps too.
//!
//! # Source
//! hardware.md 2.7: manual KWR75-RS422, 4.3 and 4.4, with an example frame [A].

use crate::bytes::{Layout, field};
use crate::error::DecodeError;
use crate::stream::Parsed;

/// Length of a sample, bytes.
pub const FRAME_LEN: usize = 28;
/// Newtons per kg, and newton metres per kg m, as the manual converts.
pub const NEWTONS_PER_KG: f64 = 9.81;
/// More than any model of the series measures, kg.
pub const MAX_KG: f32 = 500.0;
/// More than any model of the series measures, kg m.
pub const MAX_KGM: f32 = 50.0;

const MARK: u8 = 0xAA;
const TAIL: [u8; 2] = [0x0D, 0x0A];

/// What the host can say.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command {
    /// Stream at 1 kHz.
    Start,
    /// One sample; the first one after power-up is not answered.
    Once,
    /// Stop.
    Stop,
}

/// One sample, in the sensor's own units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Whether it answers [`Command::Once`].
    pub asked: bool,
    /// Fx Fy Fz, kg.
    pub force_kg: [f32; 3],
    /// Mx My Mz, kg m.
    pub torque_kgm: [f32; 3],
}

/// Writes a command.
#[must_use]
pub const fn encode_command(command: Command) -> [u8; 4] {
    let code = match command {
        Command::Start => 0x48,
        Command::Once => 0x49,
        Command::Stop => 0x43,
    };
    [code, MARK, TAIL[0], TAIL[1]]
}

/// Writes a sample.
#[must_use]
pub fn encode(sample: &Sample) -> [u8; FRAME_LEN] {
    let mut out = Layout::new();
    out.put(&[if sample.asked { 0x49 } else { 0x48 }, MARK]);
    for value in sample.force_kg.iter().chain(&sample.torque_kgm) {
        out.put(&value.to_le_bytes());
    }
    out.put(&TAIL).finish()
}

/// Reads the sample at the start of `bytes`.
///
/// # Errors
/// Head or tail are wrong, or a number is not finite or beyond what the series measures.
pub fn decode(bytes: &[u8]) -> Result<Parsed<Sample>, DecodeError> {
    let Some(asked) = head(bytes)? else {
        return Ok(Parsed::Incomplete);
    };
    let Some(tail) = field::<2>(bytes, FRAME_LEN - 2) else {
        return Ok(Parsed::Incomplete);
    };
    if tail != TAIL {
        return Err(DecodeError::Field {
            name: "tail",
            value: u16::from_be_bytes(tail).into(),
        });
    }
    let number = |at: usize| f32::from_le_bytes(field(bytes, at).unwrap_or_default());
    let force_kg = [2, 6, 10].map(number);
    let torque_kgm = [14, 18, 22].map(number);
    for (name, values, most) in [("force", force_kg, MAX_KG), ("torque", torque_kgm, MAX_KGM)] {
        for value in values {
            if !value.is_finite() {
                return Err(DecodeError::NotFinite { name });
            }
            if value.abs() > most {
                let value = value.to_bits();
                return Err(DecodeError::Field { name, value });
            }
        }
    }
    Ok(Parsed::Complete {
        value: Sample {
            asked,
            force_kg,
            torque_kgm,
        },
        used: FRAME_LEN,
    })
}

/// Whether the head is that of an asked sample; `None` while bytes are missing.
fn head(bytes: &[u8]) -> Result<Option<bool>, DecodeError> {
    let asked = match bytes.first() {
        None => return Ok(None),
        Some(0x48) => false,
        Some(0x49) => true,
        Some(other) => {
            return Err(DecodeError::Field {
                name: "head",
                value: (*other).into(),
            });
        }
    };
    match bytes.get(1) {
        None => Ok(None),
        Some(&MARK) => Ok(Some(asked)),
        Some(other) => Err(DecodeError::Field {
            name: "mark",
            value: (*other).into(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::test_support::{assert_prefixes_incomplete, hex};

    // hardware.md 2.7: the example frame of the manual.
    const GOLDEN: &str =
        "48 AA B0 75 1C C1 9B 3F ED C0 AE 5C F0 40 D4 B5 2D BE 5F 55 99 3E 7C 1A B0 BB 0D 0A";

    fn golden() -> Sample {
        Sample {
            asked: false,
            force_kg: [-9.778_732, -7.414_014, 7.511_313],
            torque_kgm: [-0.169_639, 0.299_479, -0.005_374],
        }
    }

    #[test]
    fn the_manuals_frame_decodes_and_encodes() {
        let bytes = hex(GOLDEN);
        let Ok(Parsed::Complete { value, used }) = decode(&bytes) else {
            panic!("the golden frame")
        };
        assert_eq!(used, FRAME_LEN);
        let all = |sample: &Sample| [sample.force_kg, sample.torque_kgm].concat();
        for (read, printed) in all(&value).into_iter().zip(all(&golden())) {
            assert!((read - printed).abs() < 1e-6, "{read} {printed}");
        }
        assert_eq!(encode(&value).as_slice(), bytes);
    }

    #[test]
    fn commands_are_those_of_the_manual() {
        for (bytes, command) in [
            ("48 AA 0D 0A", Command::Start),
            ("49 AA 0D 0A", Command::Once),
            ("43 AA 0D 0A", Command::Stop),
        ] {
            assert_eq!(encode_command(command).as_slice(), hex(bytes));
        }
    }

    #[test]
    fn every_prefix_is_incomplete() {
        assert_prefixes_incomplete(&hex(GOLDEN), decode);
    }

    #[test]
    fn a_flipped_bit_in_head_mark_or_tail_is_refused() {
        let bytes = hex(GOLDEN);
        for bit in (0..16).chain(208..224) {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            match decode(&flipped) {
                // 48 and 49 are both heads.
                Ok(Parsed::Complete { value, .. }) => assert!(bit == 0 && value.asked),
                other => assert!(other.is_err(), "bit {bit}: {other:?}"),
            }
        }
    }

    #[test]
    fn a_flipped_bit_in_a_number_is_seen_only_when_the_number_is_impossible() {
        let bytes = hex(GOLDEN);
        let seen = |bit: usize| {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            decode(&flipped).is_err()
        };
        // The second bit of the exponent of Fx, and its lowest bit of all.
        assert!(seen(5 * 8 + 5) && !seen(2 * 8));
    }

    #[test]
    fn numbers_that_cannot_be_are_named() {
        let with = |force_kg, torque_kgm| {
            decode(&encode(&Sample {
                asked: true,
                force_kg,
                torque_kgm,
            }))
        };
        assert_eq!(
            with([0.0, f32::NAN, 0.0], [0.0; 3]),
            Err(DecodeError::NotFinite { name: "force" })
        );
        assert_eq!(
            with([0.0; 3], [0.0, 0.0, -60.0]),
            Err(DecodeError::Field {
                name: "torque",
                value: (-60.0_f32).to_bits()
            })
        );
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..40)) {
            let _ = decode(&bytes);
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(
            asked: bool,
            force_kg in proptest::array::uniform3(-500.0_f32..500.0),
            torque_kgm in proptest::array::uniform3(-50.0_f32..50.0),
        ) {
            let value = Sample { asked, force_kg, torque_kgm };
            prop_assert_eq!(decode(&encode(&value)), Ok(Parsed::Complete { value, used: FRAME_LEN }));
        }
    }
}
