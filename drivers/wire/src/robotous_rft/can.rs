//! The protocol on CAN: a command in one frame, a response in two.

use super::{Command, Response};
use crate::bytes::{Layout, field};
use crate::can::CanFrame;
use crate::error::DecodeError;

/// Standard CAN ids, 1 to 255 and all different; changed with the maker's tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CanIds {
    /// Host to sensor.
    pub command: u8,
    /// Sensor to host, D1..D8.
    pub first: u8,
    /// Sensor to host, D9..D16.
    pub second: u8,
}

impl Default for CanIds {
    fn default() -> Self {
        Self {
            command: 0x64,
            first: 0x01,
            second: 0x02,
        }
    }
}

/// Half of a response on CAN.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// D1..D8.
    First([u8; 8]),
    /// D9..D16.
    Second([u8; 8]),
}

/// Reads half of a response.
///
/// # Errors
/// The id is neither of the sensor's, or the payload has not 8 bytes.
pub fn decode_half(ids: CanIds, frame: &CanFrame) -> Result<Half, DecodeError> {
    let make = match frame.arbitration_id() {
        id if frame.is_extended() => {
            return Err(DecodeError::Field {
                name: "extended can_id",
                value: id,
            });
        }
        id if id == u32::from(ids.first) => Half::First,
        id if id == u32::from(ids.second) => Half::Second,
        value => {
            return Err(DecodeError::Field {
                name: "can_id",
                value,
            });
        }
    };
    let payload = frame.payload();
    let data = <[u8; 8]>::try_from(payload).map_err(|_| DecodeError::Length {
        expected: 8,
        got: payload.len(),
    })?;
    Ok(make(data))
}

/// Joins the halves of a response. That they belong together is the caller's to know.
///
/// # Errors
/// D1 is no response known here.
pub fn join(first: [u8; 8], second: [u8; 8]) -> Result<Response, DecodeError> {
    Response::from_data(Layout::new().put(&first).put(&second).finish())
}

/// A command as a CAN frame.
#[must_use]
pub fn command_frame(ids: CanIds, command: Command) -> CanFrame {
    CanFrame::standard(ids.command.into(), &command.to_data()).unwrap_or_default()
}

/// A response as two CAN frames, in the order in which they are sent.
#[must_use]
pub fn response_frames(ids: CanIds, response: &Response) -> [CanFrame; 2] {
    let data = response.to_data();
    let half = |id: u8, at| {
        CanFrame::standard(id.into(), &field::<8>(&data, at).unwrap_or_default())
            .unwrap_or_default()
    };
    [half(ids.first, 0), half(ids.second, 8)]
}
