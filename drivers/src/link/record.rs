//! Frames as bytes, for raw channels of recordings.

use ft_wire::hid::Report;
use ft_wire::{CanFrame, Chunk};

use crate::hid_axis::HidFrame;

/// Top bit of a CAN id in `struct can_frame`: the id has 29 bits.
pub const CAN_EFF_FLAG: u32 = 0x8000_0000;

/// A frame that a recording keeps as it came.
pub trait RawFrame: Sized {
    /// Appends the frame's bytes to `out`.
    fn write_raw(&self, out: &mut Vec<u8>);

    /// The frame of these bytes, or `None` when they are none.
    fn from_raw(bytes: &[u8]) -> Option<Self>;
}

/// The bytes themselves.
impl RawFrame for Chunk {
    fn write_raw(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(self.as_slice());
    }

    fn from_raw(bytes: &[u8]) -> Option<Self> {
        Self::new(bytes)
    }
}

/// Linux's `struct can_frame`, 16 bytes little endian: u32 id with [`CAN_EFF_FLAG`], u8 length, 3 bytes 0, 8 bytes data.
impl RawFrame for CanFrame {
    fn write_raw(&self, out: &mut Vec<u8>) {
        let flag = if self.is_extended() { CAN_EFF_FLAG } else { 0 };
        out.extend_from_slice(&(self.arbitration_id() | flag).to_le_bytes());
        let payload = self.payload();
        out.extend_from_slice(&[u8::try_from(payload.len()).unwrap_or(8), 0, 0, 0]);
        let end = out.len() + 8;
        out.extend_from_slice(payload);
        out.resize(end, 0);
    }

    fn from_raw(bytes: &[u8]) -> Option<Self> {
        let [i0, i1, i2, i3, len, _, _, _, data @ ..] = <[u8; 16]>::try_from(bytes).ok()?;
        let id = u32::from_le_bytes([i0, i1, i2, i3]);
        let payload = data.get(..usize::from(len))?;
        if id & CAN_EFF_FLAG == 0 {
            Self::standard(u16::try_from(id).ok()?, payload)
        } else {
            Self::extended(id & !CAN_EFF_FLAG, payload)
        }
    }
}

/// A byte 0 and the report, or a byte 1 and the descriptor.
impl RawFrame for HidFrame {
    fn write_raw(&self, out: &mut Vec<u8>) {
        match self {
            Self::Report(report) => {
                out.push(0);
                out.extend_from_slice(report.as_slice());
            }
            Self::Descriptor(descriptor) => {
                out.push(1);
                out.extend_from_slice(descriptor);
            }
        }
    }

    fn from_raw(bytes: &[u8]) -> Option<Self> {
        match bytes.split_first()? {
            (0, report) => Report::new(report).map(Self::Report),
            (1, descriptor) => Some(Self::Descriptor(descriptor.into())),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(frame: &impl RawFrame) -> Vec<u8> {
        let mut bytes = Vec::new();
        frame.write_raw(&mut bytes);
        bytes
    }

    #[test]
    fn a_can_frame_has_the_kernels_layout() {
        let standard = CanFrame::standard(0x123, &[1, 2, 3]).unwrap();
        assert_eq!(
            raw(&standard),
            [0x23, 0x01, 0, 0, 3, 0, 0, 0, 1, 2, 3, 0, 0, 0, 0, 0]
        );
        let extended = CanFrame::extended(0x123, &[9; 8]).unwrap();
        assert_eq!(
            raw(&extended),
            [0x23, 0x01, 0, 0x80, 8, 0, 0, 0, 9, 9, 9, 9, 9, 9, 9, 9]
        );
        for frame in [standard, extended] {
            assert_eq!(CanFrame::from_raw(&raw(&frame)), Some(frame));
        }
    }

    #[test]
    fn bytes_that_are_no_frame_are_refused() {
        assert_eq!(CanFrame::from_raw(&[0; 15]), None);
        assert_eq!(
            CanFrame::from_raw(&[0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
            None
        );
        assert_eq!(
            CanFrame::from_raw(&[0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
            None
        );
        assert_eq!(Chunk::from_raw(&[0; Chunk::CAPACITY + 1]), None);
    }

    #[test]
    fn a_chunk_is_its_bytes() {
        let chunk = Chunk::new(&[1, 2, 3]).unwrap();
        assert_eq!(raw(&chunk), [1, 2, 3]);
        assert_eq!(Chunk::from_raw(&[1, 2, 3]), Some(chunk));
    }

    #[test]
    fn hid_frames_come_back_from_their_bytes() {
        for frame in [
            HidFrame::Report(Report::new(&[3, 1, 2]).unwrap()),
            HidFrame::Descriptor([5, 1].into()),
        ] {
            assert_eq!(HidFrame::from_raw(&raw(&frame)), Some(frame));
        }
        assert_eq!(HidFrame::from_raw(&[2, 0]), None);
        assert_eq!(HidFrame::from_raw(&[]), None);
    }
}
