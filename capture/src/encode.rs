//! Turns items into the ROS 2 messages of their topics, the same for the recording and for the network.

use ft_drivers::reading::{PoseReading, WidthReading, WrenchReading};
use ft_recording::message::{
    Header, JointState, Message, Point, Pose, PoseStamped, Quaternion, TFMessage, Temperature,
    Text, Time, Transform, TransformStamped, Vector3, Wrench, WrenchStamped,
};
use ft_wire::HostTime;
use ft_wire::frames::{AriaDevice, Frame, FtSensor, Tcp, World};

use crate::config::{Frames, SaidFrames, StaticPose};
use crate::item::{Body, Item};
use crate::rmw::Offer;

/// The topics that carry messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// `/ft/wrench`
    Wrench,
    /// `/ft/temperature`
    Temperature,
    /// `/gripper/joint_states`
    JointStates,
    /// `/aria/pose`
    AriaPose,
    /// `/tf_static`
    TfStatic,
    /// `/marks`
    Marks,
    /// `/diagnostics`
    Diagnostics,
}

impl Topic {
    /// All of them; the position is the topic's index.
    pub const ALL: [Self; 7] = [
        Self::Wrench,
        Self::Temperature,
        Self::JointStates,
        Self::AriaPose,
        Self::TfStatic,
        Self::Marks,
        Self::Diagnostics,
    ];

    /// The topic's name, with its leading slash.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Wrench => "/ft/wrench",
            Self::Temperature => "/ft/temperature",
            Self::JointStates => "/gripper/joint_states",
            Self::AriaPose => "/aria/pose",
            Self::TfStatic => "/tf_static",
            Self::Marks => "/marks",
            Self::Diagnostics => "/diagnostics",
        }
    }

    /// Name and hash of its type.
    #[must_use]
    pub const fn message_type(self) -> (&'static str, &'static str) {
        match self {
            Self::Wrench => (WrenchStamped::TYPE_NAME, WrenchStamped::TYPE_HASH),
            Self::Temperature => (Temperature::TYPE_NAME, Temperature::TYPE_HASH),
            Self::JointStates => (JointState::TYPE_NAME, JointState::TYPE_HASH),
            Self::AriaPose => (PoseStamped::TYPE_NAME, PoseStamped::TYPE_HASH),
            Self::TfStatic => (TFMessage::TYPE_NAME, TFMessage::TYPE_HASH),
            Self::Marks => (Text::TYPE_NAME, Text::TYPE_HASH),
            Self::Diagnostics => (
                ft_recording::message::DiagnosticArray::TYPE_NAME,
                ft_recording::message::DiagnosticArray::TYPE_HASH,
            ),
        }
    }

    /// How it is offered to subscribers.
    #[must_use]
    pub const fn offer(self) -> Offer {
        match self {
            Self::Wrench | Self::Temperature | Self::JointStates | Self::AriaPose => Offer::Stream,
            Self::TfStatic | Self::Marks | Self::Diagnostics => Offer::Event,
        }
    }

    /// Its position in [`Topic::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// Encodes items with buffers that are kept: a stream's message costs no allocation once they have grown.
#[derive(Debug)]
pub struct Encoder {
    wrench: WrenchStamped,
    temperature: Temperature,
    joint: JointState,
    pose: PoseStamped,
    mark: Text,
    buffer: Vec<u8>,
    temperature_due: HostTime,
}

impl Default for Encoder {
    fn default() -> Self {
        let header = |frame: &str| Header {
            stamp: Time::default(),
            frame_id: frame.to_owned(),
        };
        Self {
            wrench: WrenchStamped {
                header: header(FtSensor::NAME),
                wrench: Wrench::default(),
            },
            temperature: Temperature {
                header: header(FtSensor::NAME),
                temperature: 0.0,
                variance: 0.0,
            },
            joint: JointState {
                header: header(""),
                name: vec!["gripper_width".to_owned()],
                position: vec![0.0],
                velocity: vec![0.0],
                effort: Vec::new(),
            },
            pose: PoseStamped {
                header: header(World::NAME),
                pose: Pose::default(),
            },
            mark: Text::default(),
            buffer: Vec::with_capacity(1024),
            temperature_due: HostTime::EPOCH,
        }
    }
}

impl Encoder {
    /// Hands each message of `item` to `emit`; items that only the service itself needs have none.
    pub fn encode<E>(
        &mut self,
        item: &Item,
        mut emit: impl FnMut(Topic, &[u8]) -> Result<(), E>,
    ) -> Result<(), E> {
        let stamp = Time::from(item.sample_time);
        match &item.body {
            Body::Wrench(reading) => {
                self.fill_wrench(stamp, reading);
                self.wrench.encode(&mut self.buffer);
                emit(Topic::Wrench, &self.buffer)?;
                if self.fill_temperature(item, reading) {
                    self.temperature.encode(&mut self.buffer);
                    emit(Topic::Temperature, &self.buffer)?;
                }
                Ok(())
            }
            Body::Width(reading) => {
                self.fill_joint(stamp, reading);
                self.joint.encode(&mut self.buffer);
                emit(Topic::JointStates, &self.buffer)
            }
            Body::Pose(reading) => {
                self.fill_pose(stamp, reading);
                self.pose.encode(&mut self.buffer);
                emit(Topic::AriaPose, &self.buffer)
            }
            Body::Mark(text) => {
                self.mark.data.clone_from(text);
                self.mark.encode(&mut self.buffer);
                emit(Topic::Marks, &self.buffer)
            }
            Body::Diagnostics(array) => {
                array.encode(&mut self.buffer);
                emit(Topic::Diagnostics, &self.buffer)
            }
            Body::Raw(_) | Body::Event(_) | Body::Clock(_) => Ok(()),
        }
    }

    fn fill_wrench(&mut self, stamp: Time, reading: &WrenchReading) {
        let vector = |[x, y, z]: [f64; 3]| Vector3 { x, y, z };
        self.wrench.header.stamp = stamp;
        self.wrench.wrench = Wrench {
            force: vector(reading.wrench.force),
            torque: vector(reading.wrench.torque),
        };
    }

    /// The temperature is written once a second; false when it is not due or not there.
    fn fill_temperature(&mut self, item: &Item, reading: &WrenchReading) -> bool {
        let Some(celsius) = reading.temperature_celsius else {
            return false;
        };
        if item.sample_time < self.temperature_due {
            return false;
        }
        self.temperature_due = item.sample_time + std::time::Duration::from_secs(1);
        self.temperature.header.stamp = Time::from(item.sample_time);
        self.temperature.temperature = f64::from(celsius);
        true
    }

    fn fill_joint(&mut self, stamp: Time, reading: &WidthReading) {
        self.joint.header.stamp = stamp;
        self.joint.position.clear();
        self.joint.position.push(reading.width_m);
        self.joint.velocity.clear();
        self.joint.velocity.push(reading.width_rate_m_s);
    }

    fn fill_pose(&mut self, stamp: Time, reading: &PoseReading) {
        let ([px, py, pz], [x, y, z, w]) = (reading.pose.position, reading.pose.quaternion);
        self.pose.header.stamp = stamp;
        self.pose.pose = Pose {
            position: Point {
                x: px,
                y: py,
                z: pz,
            },
            orientation: Quaternion { x, y, z, w },
        };
    }
}

/// The `/tf_static` message: `aria_device -> tcp` and `tcp -> ft_sensor`.
#[must_use]
pub fn static_transforms(frames: &Frames, at: HostTime) -> TFMessage {
    said_transforms(&frames.clone().into(), at)
}

/// As [`static_transforms`], of those that are said.
#[must_use]
pub fn said_transforms(frames: &SaidFrames, at: HostTime) -> TFMessage {
    let transform = |parent: &str, child: &str, pose: &StaticPose| TransformStamped {
        header: Header {
            stamp: Time::from(at),
            frame_id: parent.to_owned(),
        },
        child_frame_id: child.to_owned(),
        transform: {
            let ([x, y, z], [qx, qy, qz, qw]) = (pose.position_m, pose.quaternion_xyzw);
            Transform {
                translation: Vector3 { x, y, z },
                rotation: Quaternion {
                    x: qx,
                    y: qy,
                    z: qz,
                    w: qw,
                },
            }
        },
    };
    TFMessage {
        transforms: [
            (AriaDevice::NAME, Tcp::NAME, &frames.aria_device_from_tcp),
            (Tcp::NAME, FtSensor::NAME, &frames.tcp_from_ft_sensor),
        ]
        .into_iter()
        .filter_map(|(parent, child, pose)| Some(transform(parent, child, pose.as_ref()?)))
        .collect(),
    }
}
