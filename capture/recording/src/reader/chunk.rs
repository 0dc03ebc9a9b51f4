//! Unpacking of chunks.

use std::fmt;
use std::io::{BufReader, Read};

use zstd::zstd_safe::{DCtx, ResetDirective, get_error_name};

/// No chunk may unpack to more, and no record may be longer: 1 GiB.
pub(super) const LIMIT: u64 = 1 << 30;

/// How a chunk's unpacking ended; what was unpacked until then is in `out`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unpacked {
    /// As packed.
    Whole,
    /// The packed bytes end early or are wrong, or there is too much in them.
    Partly,
    /// The compression is not supported.
    Unsupported,
}

/// Unpacks one chunk after the other.
#[derive(Default)]
pub(super) struct Unpacker {
    zstd: DCtx<'static>,
}

impl fmt::Debug for Unpacker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Unpacker").finish_non_exhaustive()
    }
}

impl Unpacker {
    /// Replaces `out` by what `packed` unpacks to, but for at most one byte more than `limit`. Never allocates by a length that
    /// a file claims.
    pub(super) fn unpack(
        &mut self,
        compression: &str,
        packed: &[u8],
        limit: u64,
        out: &mut Vec<u8>,
    ) -> Unpacked {
        out.clear();
        let result = match compression {
            "" => {
                out.extend_from_slice(packed);
                Ok(())
            }
            "zstd" => self.unpack_zstd(packed, limit, out),
            "lz4" => unpack_lz4(packed, limit, out),
            _ => return Unpacked::Unsupported,
        };
        match result {
            Ok(()) if out.len() as u64 <= limit => Unpacked::Whole,
            _ => Unpacked::Partly,
        }
    }

    fn unpack_zstd(&mut self, packed: &[u8], limit: u64, out: &mut Vec<u8>) -> std::io::Result<()> {
        // In one go where the chunks before have made room; what cannot be unpacked so is unpacked as far as it goes.
        if !packed.is_empty()
            && out.capacity() as u64 >= limit
            && let Ok(length) = self.zstd.decompress(out, packed)
            && length as u64 <= limit
        {
            return Ok(());
        }
        out.clear();
        self.zstd
            .reset(ResetDirective::SessionOnly)
            .map_err(|code| std::io::Error::other(get_error_name(code)))?;
        let decoder = zstd::stream::read::Decoder::with_context(packed, &mut self.zstd);
        read_all(decoder, limit, out)
    }
}

fn read_all(source: impl Read, limit: u64, out: &mut Vec<u8>) -> std::io::Result<()> {
    source
        .take((limit + 1).saturating_sub(out.len() as u64))
        .read_to_end(out)
        .map(drop)
}

/// A chunk may hold several LZ4 frames, one behind the other.
fn unpack_lz4(packed: &[u8], limit: u64, out: &mut Vec<u8>) -> std::io::Result<()> {
    let mut source = BufReader::new(packed);
    loop {
        let mut decoder = lz4::Decoder::new(source)?;
        let before = out.len();
        read_all(&mut decoder, limit, out)?;
        let (rest, ended) = decoder.finish();
        ended?;
        source = rest;
        let more = !source.buffer().is_empty() || !source.get_ref().is_empty();
        if !more || out.len() == before {
            return Ok(());
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_bomb_is_cut_off() {
        let packed = zstd::stream::encode_all(&vec![0; 1 << 20][..], 1).unwrap();
        assert!(packed.len() < 1000);
        let mut out = Vec::new();
        let mut unpacker = Unpacker::default();
        for _ in 0..2 {
            let unpacked = unpacker.unpack("zstd", &packed, 5000, &mut out);
            assert_eq!((unpacked, out.len()), (Unpacked::Partly, 5001));
            out.reserve(1 << 21);
        }
    }

    #[test]
    fn two_lz4_frames_are_both_unpacked() {
        let frame = |text: &[u8]| {
            let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
            encoder.write_all(text).unwrap();
            encoder.finish().0
        };
        let mut out = Vec::new();
        let packed = [frame(b"one "), frame(b"two")].concat();
        assert_eq!(
            Unpacker::default().unpack("lz4", &packed, LIMIT, &mut out),
            Unpacked::Whole
        );
        assert_eq!(out, b"one two");
        assert_eq!(
            Unpacker::default().unpack("lz4", &packed[..packed.len() - 6], LIMIT, &mut out),
            Unpacked::Partly
        );
    }

    #[test]
    fn the_start_of_a_cut_zstd_chunk_is_given() {
        let content: Vec<u8> = (0..400_000_u32)
            .flat_map(|i| i.wrapping_mul(2_654_435_761).to_le_bytes())
            .collect();
        let packed = zstd::stream::encode_all(&content[..], 1).unwrap();
        let mut out = Vec::new();
        let mut unpacker = Unpacker::default();
        let limit = content.len() as u64;
        for _ in 0..2 {
            let unpacked = unpacker.unpack("zstd", &packed[..packed.len() / 2], limit, &mut out);
            assert_eq!(unpacked, Unpacked::Partly);
            assert!(out.len() > content.len() / 3 && content.starts_with(&out));
            // With room for all of it, too, and for a whole chunk behind a cut one.
            out.reserve(content.len());
            let unpacked = unpacker.unpack("zstd", &packed, limit, &mut out);
            assert_eq!((unpacked, &out), (Unpacked::Whole, &content));
        }
    }

    #[test]
    fn another_compression_is_named_as_such() {
        assert_eq!(
            Unpacker::default().unpack("brotli", b"", LIMIT, &mut Vec::new()),
            Unpacked::Unsupported
        );
    }
}
