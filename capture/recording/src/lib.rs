//! ROS 2 messages, CDR and MCAP recordings, in and out.
//!
//! [`RecordingWriter`] writes a recording so that a crash costs at most one flush period; [`Recording::load`] reads what
//! identification needs from any MCAP that keeps the reader's contract, whoever wrote it; [`recover::recover`] turns the
//! leftover of a crash into a complete file; [`check::check`] says what a recording is worth.

#![warn(
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss
)]
#![cfg_attr(
    test,
    allow(
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

pub mod calibration;
pub mod cdr;
pub mod check;
pub mod error;
pub mod message;
pub mod qos;
pub mod reader;
pub mod recording;
pub mod recover;
pub mod rewrite;
pub mod schema;
mod sequences;
pub mod writer;

pub use calibration::{Calibration, Estimate};
pub use cdr::CdrError;
pub use error::{CalibrationError, ReadError, WriteError};
pub use message::Message;
pub use qos::Qos;
pub use recording::{KnownFrames, Pose7, PoseTrack, Recording, Stamped, TopicMap, TrackedFrame};
pub use writer::{ChannelId, Finished, MessageStamps, RecordingWriter, WriterOptions};

/// Topics of a recording.
pub mod topic {
    /// `geometry_msgs/msg/WrenchStamped`, frame `ft_sensor`.
    pub const WRENCH: &str = "/ft/wrench";
    /// `sensor_msgs/msg/Temperature` of the force-torque sensor.
    pub const TEMPERATURE: &str = "/ft/temperature";
    /// `sensor_msgs/msg/Imu` of a gyroscope on the gripper, by the wrench's clock; its axes may be any.
    pub const IMU: &str = "/ft/imu";
    /// `sensor_msgs/msg/JointState`, joint `gripper_width`.
    pub const GRIPPER: &str = "/gripper/joint_states";
    /// `geometry_msgs/msg/PoseStamped`, `world_from_aria_device`.
    pub const ARIA_POSE: &str = "/aria/pose";
    /// `geometry_msgs/msg/PoseStamped`, `world_from_tcp`.
    pub const TCP_POSE: &str = "/tcp/pose";
    /// `tf2_msgs/msg/TFMessage`: `aria_device -> tcp`, `tcp -> ft_sensor`.
    pub const TF_STATIC: &str = "/tf_static";
    /// `std_msgs/msg/String`, the operator's marks.
    pub const MARKS: &str = "/marks";
    /// `diagnostic_msgs/msg/DiagnosticArray`.
    pub const DIAGNOSTICS: &str = "/diagnostics";
    /// Start of the names of the raw topics, `/raw/<device>`.
    pub const RAW_PREFIX: &str = "/raw/";
}

/// Names of the metadata records of a recording.
pub mod metadata {
    /// Version, config text, clock anchor.
    pub const SESSION: &str = "ft.session";
    /// A [`Calibration`](crate::Calibration) as JSON in the key `json`.
    pub const CALIBRATION: &str = "ft.calibration";
    /// Per stream: received, gaps, drops, refused, duplicated.
    pub const LEDGER: &str = "ft.ledger";
    /// How `ft.calibration` was found: offset, drift, residuals, as JSON in the key `json`.
    pub const CALIBRATED: &str = "ft.calibrated";
    /// What an import made the recording from: files by hash, clock map, counts.
    pub const IMPORT: &str = "ft.import";
    /// What smoothing the device clocks afterwards moved: by topic, as JSON in the key `json`.
    pub const RETIMED: &str = "ft.retimed";
    /// What [`recover`](crate::recover::recover) found, in a recording that it wrote.
    pub const RECOVERED: &str = "ft.recovered";
}
