//! What a message of a stamped type says: its stamp, and whether its numbers can be used.

use ft_wire::HostTime;

use crate::CdrError;
use crate::message::{Header, Imu, JointState, Message, PoseStamped, Temperature, WrenchStamped};
use crate::recording::Pose7;

/// One message, decoded once.
pub(super) struct Look {
    /// `header.stamp`.
    pub(super) stamp: HostTime,
    pub(super) numbers: Numbers,
    /// Force and torque of a wrench.
    pub(super) wrench: Option<[f64; 6]>,
}

/// Whether a message's numbers can be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Numbers {
    Fine,
    /// A quaternion whose length is not 1; readers that do not mend it turn what it turns.
    NotUnit,
    /// Not finite, or a quaternion that is no rotation: identification leaves it out.
    Invalid,
}

/// A quaternion's length may differ from 1 by so much: it was written with three digits.
const UNIT_WITHIN: f64 = 1e-3;

impl Look {
    /// `None` when `kind` has no stamp.
    pub(super) fn at(kind: &str, data: &[u8]) -> Option<Result<Self, CdrError>> {
        Some(match kind {
            WrenchStamped::TYPE_NAME => WrenchStamped::decode(data).map(|message| {
                let wrench: [f64; 6] = message.wrench.into();
                Self {
                    wrench: Some(wrench),
                    ..Self::of(&message.header, finite(&wrench))
                }
            }),
            PoseStamped::TYPE_NAME => {
                PoseStamped::decode(data).map(|message| Self::of(&message.header, pose(&message)))
            }
            JointState::TYPE_NAME => JointState::decode(data)
                .map(|message| Self::of(&message.header, finite(&message.position))),
            Temperature::TYPE_NAME => Temperature::decode(data)
                .map(|message| Self::of(&message.header, finite(&[message.temperature]))),
            Imu::TYPE_NAME => Imu::decode(data).map(|message| {
                // What it does not measure may be anything.
                let rate = message.rate().unwrap_or_default();
                Self::of(&message.header, finite(&rate))
            }),
            _ => return None,
        })
    }

    fn of(header: &Header, numbers: Numbers) -> Self {
        Self {
            stamp: header.stamp.into(),
            numbers,
            wrench: None,
        }
    }
}

fn finite(values: &[f64]) -> Numbers {
    match values.iter().all(|value| value.is_finite()) {
        true => Numbers::Fine,
        false => Numbers::Invalid,
    }
}

fn pose(message: &PoseStamped) -> Numbers {
    let quaternion: [f64; 4] = message.pose.orientation.into();
    let length = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
    match Pose7::normalised(message.pose.position.into(), quaternion) {
        None => Numbers::Invalid,
        Some(_) if (length - 1.0).abs() > UNIT_WITHIN => Numbers::NotUnit,
        Some(_) => Numbers::Fine,
    }
}
