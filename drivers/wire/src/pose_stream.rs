//! The pose stream: our own format for trackers that send live poses. Version 1.
//!
//! No maker's format exists for this; a small program beside the tracker's own software writes it to a serial line, a
//! pipe or a pty. Little endian, 74 bytes:
//!
//! | offset | type | field |
//! |---|---|---|
//! | 0 | u8 | 0xA5 |
//! | 1 | u8 | 0x5A |
//! | 2 | u8 | version = 1 |
//! | 3 | u8 | length of the frame = 74 |
//! | 4 | u64 | tracking timestamp, ns, the tracker's clock, at most 2^63 - 1 |
//! | 12 | 3 x f64 | position x y z, m |
//! | 36 | 4 x f64 | unit quaternion x y z w |
//! | 68 | f32 | quality score, 0 to 1 |
//! | 72 | u16 | CRC-16/X-25 over bytes 2..72 |
//!
//! The pose is `world_from_aria_device`. A quaternion whose norm differs from 1 by more than [`NORM_TOLERANCE`] is
//! refused; one within it is handed on as it came.
//!
//! # Source
//! This file is the definition. A change of layout takes another version number.

use crate::bytes::{Layout, field};
use crate::crc::X25;
use crate::error::DecodeError;
use crate::stream::Parsed;

/// Length of a frame, bytes.
pub const FRAME_LEN: usize = 74;
/// The first two bytes of a frame.
pub const SYNC: [u8; 2] = [0xA5, 0x5A];
/// The version that this codec reads and writes.
pub const VERSION: u8 = 1;
/// Largest difference of a quaternion's squared norm from 1.
pub const NORM_TOLERANCE: f64 = 1e-3;

const LENGTH_BYTE: u8 = 74;

/// One pose, `world_from_aria_device`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSample {
    /// The instant of the pose on the tracker's own clock, ns.
    pub tracking_ns: i64,
    /// Origin of the device in the world, m.
    pub position: [f64; 3],
    /// Rotation, unit quaternion x y z w.
    pub quaternion: [f64; 4],
    /// The tracker's own quality score, 0 to 1.
    pub quality_score: f32,
}

/// Reads the frame at the start of `bytes`.
///
/// # Errors
/// The bytes cannot become a frame (sync, version, length), the CRC is wrong, or a value is out of its range.
pub fn decode(bytes: &[u8]) -> Result<Parsed<PoseSample>, DecodeError> {
    let head = [SYNC[0], SYNC[1], VERSION, LENGTH_BYTE];
    for ((name, expected), byte) in ["sync", "sync", "version", "length"]
        .into_iter()
        .zip(head)
        .zip(bytes)
    {
        if *byte != expected {
            return Err(DecodeError::Field {
                name,
                value: u32::from(*byte),
            });
        }
    }
    let Some(frame) = bytes.first_chunk::<FRAME_LEN>() else {
        return Ok(Parsed::Incomplete);
    };
    let sample = decode_frame(frame)?;
    Ok(Parsed::Complete {
        value: sample,
        used: FRAME_LEN,
    })
}

fn decode_frame(frame: &[u8; FRAME_LEN]) -> Result<PoseSample, DecodeError> {
    let carried = u16::from_le_bytes(field(frame, 72).unwrap_or_default());
    let computed = X25.checksum(frame.get(2..72).unwrap_or_default());
    if computed != carried {
        return Err(DecodeError::Checksum {
            computed: computed.into(),
            carried: carried.into(),
        });
    }
    let f64_at = |at| f64::from_le_bytes(field(frame, at).unwrap_or_default());
    let ticks = u64::from_le_bytes(field(frame, 4).unwrap_or_default());
    let Ok(tracking_ns) = i64::try_from(ticks) else {
        return Err(DecodeError::Field {
            name: "tracking timestamp's high half",
            value: high_half(ticks),
        });
    };
    let position = [12, 20, 28].map(f64_at);
    let quaternion = [36, 44, 52, 60].map(f64_at);
    let quality_score = f32::from_le_bytes(field(frame, 68).unwrap_or_default());
    check_values(position, quaternion, quality_score)?;
    Ok(PoseSample {
        tracking_ns,
        position,
        quaternion,
        quality_score,
    })
}

fn high_half(ticks: u64) -> u32 {
    u32::try_from(ticks >> 32).unwrap_or(u32::MAX)
}

fn check_values(
    position: [f64; 3],
    quaternion: [f64; 4],
    quality_score: f32,
) -> Result<(), DecodeError> {
    if !position.iter().all(|component| component.is_finite()) {
        return Err(DecodeError::NotFinite { name: "position" });
    }
    let norm_squared: f64 = quaternion
        .iter()
        .map(|component| component * component)
        .sum();
    if !norm_squared.is_finite() {
        return Err(DecodeError::NotFinite { name: "quaternion" });
    }
    if (norm_squared - 1.0).abs() > NORM_TOLERANCE {
        #[allow(clippy::cast_possible_truncation, reason = "only shown")]
        let value = (norm_squared as f32).to_bits();
        return Err(DecodeError::Field {
            name: "quaternion's squared norm (f32 bits)",
            value,
        });
    }
    if !(0.0..=1.0).contains(&quality_score) {
        return Err(DecodeError::Field {
            name: "quality score (f32 bits)",
            value: quality_score.to_bits(),
        });
    }
    Ok(())
}

/// Writes `sample` as a frame. A negative `tracking_ns` is written as 0.
#[must_use]
pub fn encode(sample: &PoseSample) -> [u8; FRAME_LEN] {
    let mut layout = Layout::<FRAME_LEN>::new();
    layout.put(&SYNC).put(&[VERSION, LENGTH_BYTE]);
    layout.put(&u64::try_from(sample.tracking_ns).unwrap_or(0).to_le_bytes());
    for component in sample.position.iter().chain(&sample.quaternion) {
        layout.put(&component.to_le_bytes());
    }
    layout.put(&sample.quality_score.to_le_bytes());
    let crc = X25.checksum(layout.so_far().get(2..).unwrap_or_default());
    layout.put(&crc.to_le_bytes()).finish()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const SAMPLE: PoseSample = PoseSample {
        tracking_ns: 1_234_567_890_123,
        position: [1.0, -2.0, 0.5],
        quaternion: [0.5, -0.5, 0.5, 0.5],
        quality_score: 0.75,
    };

    /// Computed from the table above with an independent script (struct.pack and a bitwise CRC).
    const GOLDEN: &str = "A5 5A 01 4A CB 04 FB 71 1F 01 00 00 00 00 00 00 00 00 F0 3F 00 00 00 00 00 \
        00 00 C0 00 00 00 00 00 00 E0 3F 00 00 00 00 00 00 E0 3F 00 00 00 00 00 00 \
        E0 BF 00 00 00 00 00 00 E0 3F 00 00 00 00 00 00 E0 3F 00 00 40 3F BA DC";

    fn golden() -> Vec<u8> {
        crate::test_support::hex(GOLDEN)
    }

    /// A frame with `edit` applied to the bytes and the CRC made right again.
    fn edited(edit: impl FnOnce(&mut [u8])) -> Vec<u8> {
        let mut frame = encode(&SAMPLE).to_vec();
        edit(&mut frame);
        let crc = X25.checksum(&frame[2..72]);
        frame[72..].copy_from_slice(&crc.to_le_bytes());
        frame
    }

    #[test]
    fn golden_bytes_decode_and_encode() {
        assert_eq!(
            decode(&golden()),
            Ok(Parsed::Complete {
                value: SAMPLE,
                used: FRAME_LEN
            })
        );
        assert_eq!(encode(&SAMPLE).as_slice(), golden());
    }

    #[test]
    fn every_prefix_is_incomplete() {
        crate::test_support::assert_prefixes_incomplete(&golden(), decode);
    }

    #[test]
    fn every_flipped_bit_is_refused() {
        crate::test_support::assert_flipped_bits_refused(&golden(), decode);
    }

    #[test]
    fn each_field_out_of_its_range_is_named() {
        let refused = |name: &str, frame: &[u8]| match decode(frame) {
            Err(
                DecodeError::Field { name: found, .. } | DecodeError::NotFinite { name: found },
            ) => {
                assert!(found.starts_with(name), "{found}");
            }
            other => panic!("{name}: {other:?}"),
        };
        refused("sync", &[0xA5, 0x5B]);
        refused("version", &[0xA5, 0x5A, 2]);
        refused("length", &[0xA5, 0x5A, 1, 75]);
        refused("tracking timestamp", &edited(|frame| frame[11] = 0x80));
        refused(
            "position",
            &edited(|frame| frame[12..20].copy_from_slice(&f64::NAN.to_le_bytes())),
        );
        refused(
            "quaternion",
            &edited(|frame| frame[36..44].copy_from_slice(&f64::INFINITY.to_le_bytes())),
        );
        refused(
            "quaternion's squared norm",
            &edited(|frame| frame[36..44].copy_from_slice(&0.6_f64.to_le_bytes())),
        );
        refused(
            "quality",
            &edited(|frame| frame[68..72].copy_from_slice(&f32::NAN.to_le_bytes())),
        );
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..160)) {
            let _ = decode(&bytes);
        }

        #[test]
        fn arbitrary_frames_with_a_good_crc_never_panic(body in proptest::collection::vec(any::<u8>(), 68)) {
            let _ = decode(&edited(|frame| frame[4..72].copy_from_slice(&body)));
        }

        #[test]
        fn what_is_encoded_decodes_to_itself(
            tracking_ns in 0..i64::MAX, position in any::<[i32; 3]>(), angle in -3.0..3.0_f64, score in 0.0..=1.0_f32,
        ) {
            let sample = PoseSample {
                tracking_ns,
                position: position.map(|count| f64::from(count) * 1e-6),
                quaternion: [0.0, angle.sin(), 0.0, angle.cos()],
                quality_score: score,
            };
            prop_assert_eq!(decode(&encode(&sample)), Ok(Parsed::Complete { value: sample, used: FRAME_LEN }));
        }
    }
}
