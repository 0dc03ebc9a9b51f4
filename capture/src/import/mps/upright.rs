//! The turn that makes a trajectory's world stand upright.

use ft_recording::Pose7;

/// Which way gravity points in a trajectory's world.
#[derive(Debug, Default)]
pub(super) struct Upright {
    sum: [f64; 3],
}

/// A turn of the world.
pub(super) struct Turn {
    pub(super) pose: Pose7,
    pub(super) rotation_deg: f64,
}

impl Upright {
    pub(super) fn add(&mut self, gravity: [f64; 3]) {
        if gravity.iter().all(|value| value.is_finite()) {
            for (sum, value) in self.sum.iter_mut().zip(gravity) {
                *sum += value;
            }
        }
    }

    /// The smallest rotation that takes gravity to -z; none when the file does not tell.
    pub(super) fn turn(&self) -> Turn {
        let none = Turn {
            pose: Pose7::IDENTITY,
            rotation_deg: 0.0,
        };
        let length = self.sum.iter().map(|v| v * v).sum::<f64>().sqrt();
        if !(length > 0.0 && length.is_finite()) {
            return none;
        }
        let [x, y, z] = self.sum.map(|v| v / length);
        let cos = -z;
        // From (x, y, z) to (0, 0, -1): axis (x, y, z) x (0, 0, -1) = (-y, x, 0).
        let quaternion = if cos < -0.999_999 {
            [1.0, 0.0, 0.0, 0.0]
        } else {
            [-y, x, 0.0, 1.0 + cos]
        };
        let half = quaternion.iter().map(|q| q * q).sum::<f64>().sqrt();
        Pose7::normalised([0.0; 3], quaternion.map(|q| q / half)).map_or(none, |pose| Turn {
            pose,
            rotation_deg: cos.clamp(-1.0, 1.0).acos().to_degrees(),
        })
    }
}
