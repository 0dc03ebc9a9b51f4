//! Sorts a recording's messages into tracks.

use std::collections::BTreeMap;
use std::path::Path;

use ft_wire::HostTime;
use ft_wire::frames::{AriaDevice, Frame, FtSensor, Tcp};

use super::pose::StaticTransforms;
use super::track::Track;
use super::{
    KnownFrames, Pose7, PoseTrack, ReadHealth, Recording, Stamped, TopicHealth, TopicMap,
    TrackedFrame,
};
use crate::calibration::Calibration;
use crate::error::{ReadError, TopicList};
use crate::message::{
    Imu, JointState, Message, PoseStamped, TFMessage, Temperature, Text, WrenchStamped,
};
use crate::reader::{Channel, Damage, RawMessage, Record, Schema, UnknownChannels};
use crate::recover::loss_before_recovery;
use crate::{metadata, topic};

/// Name of the gripper's joint in `/gripper/joint_states`.
const GRIPPER_JOINT: &str = "gripper_width";

/// What a channel carries for us.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Wrench,
    TcpPose,
    AriaPose,
    Gripper,
    Temperature,
    Imu,
    TfStatic,
    Marks,
    Other,
}

impl Role {
    fn of(topic: &str) -> Self {
        match topic {
            topic::WRENCH => Self::Wrench,
            topic::TCP_POSE => Self::TcpPose,
            topic::ARIA_POSE => Self::AriaPose,
            topic::GRIPPER => Self::Gripper,
            topic::TEMPERATURE => Self::Temperature,
            topic::IMU => Self::Imu,
            topic::TF_STATIC => Self::TfStatic,
            topic::MARKS => Self::Marks,
            _ => Self::Other,
        }
    }

    fn type_name(self) -> &'static str {
        match self {
            Self::Wrench => WrenchStamped::TYPE_NAME,
            Self::TcpPose | Self::AriaPose => PoseStamped::TYPE_NAME,
            Self::Gripper => JointState::TYPE_NAME,
            Self::Temperature => Temperature::TYPE_NAME,
            Self::Imu => Imu::TYPE_NAME,
            Self::TfStatic => TFMessage::TYPE_NAME,
            Self::Marks => Text::TYPE_NAME,
            Self::Other => "",
        }
    }
}

struct Route {
    topic: String,
    role: Role,
    /// Of this channel alone.
    health: TopicHealth,
}

pub(super) struct Loader<'a> {
    map: &'a TopicMap,
    schemas: BTreeMap<u16, Schema>,
    routes: BTreeMap<u16, Route>,
    topics: BTreeMap<String, TopicHealth>,
    foreign: Vec<(Role, Channel, String)>,
    wrench: Track<[f64; 6]>,
    tcp: Track<Pose7>,
    aria: Track<Pose7>,
    gripper: Track<f64>,
    temperature: Track<f64>,
    angular_rate: Track<[f64; 3]>,
    marks: Track<String>,
    transforms: StaticTransforms,
    calibration: Option<BTreeMap<String, String>>,
    session: BTreeMap<String, String>,
    recovered: Option<String>,
    unknown: UnknownChannels,
}

impl<'a> Loader<'a> {
    pub(super) fn new(map: &'a TopicMap) -> Self {
        Self {
            map,
            schemas: BTreeMap::new(),
            routes: BTreeMap::new(),
            topics: BTreeMap::new(),
            foreign: Vec::new(),
            wrench: Track::default(),
            tcp: Track::default(),
            aria: Track::default(),
            gripper: Track::default(),
            temperature: Track::default(),
            angular_rate: Track::default(),
            marks: Track::default(),
            transforms: StaticTransforms::default(),
            calibration: None,
            session: BTreeMap::new(),
            recovered: None,
            unknown: UnknownChannels::default(),
        }
    }

    pub(super) fn take(&mut self, record: Record<'_>) {
        match record {
            Record::Schema(schema) => {
                self.schemas.entry(schema.id).or_insert(schema);
            }
            Record::Channel(channel) if !self.routes.contains_key(&channel.id) => {
                self.add_channel(channel)
            }
            Record::Message(message) => self.add_message(message),
            Record::Metadata { name, entries } if name == metadata::SESSION => {
                self.session = entries
            }
            Record::Metadata { name, entries } if name == metadata::CALIBRATION => {
                self.calibration = Some(entries);
            }
            Record::Metadata { name, entries } if name == metadata::RECOVERED => {
                self.recovered = self.recovered.take().or(loss_before_recovery(&entries));
            }
            _ => {}
        }
    }

    fn add_channel(&mut self, channel: Channel) {
        let type_name = self
            .schemas
            .get(&channel.schema_id)
            .map_or("", |schema| &schema.name)
            .to_owned();
        let mut role = self
            .map
            .resolve(&channel.topic)
            .map_or(Role::Other, Role::of);
        let kind = if type_name.is_empty() {
            &channel.message_encoding
        } else {
            &type_name
        };
        let health = TopicHealth {
            kind: kind.clone(),
            ..TopicHealth::default()
        };
        self.topics.entry(channel.topic.clone()).or_insert(health);
        let topic = channel.topic.clone();
        let id = channel.id;
        if role != Role::Other
            && (channel.message_encoding != "cdr" || type_name != role.type_name())
        {
            self.foreign.push((role, channel, type_name));
            role = Role::Other;
        }
        let health = TopicHealth::default();
        let route = Route {
            topic,
            role,
            health,
        };
        self.routes.insert(id, route);
    }

    fn add_message(&mut self, message: RawMessage<'_>) {
        let Some(route) = self.routes.get_mut(&message.channel_id) else {
            self.unknown.add(message.channel_id);
            return;
        };
        let health = &mut route.health;
        health.messages += 1;
        let data = message.data;
        let decoded = match route.role {
            Role::Wrench => WrenchStamped::decode(data).map(|wrench| {
                let value: [f64; 6] = wrench.wrench.into();
                let finite = value.iter().all(|component| component.is_finite());
                self.wrench
                    .push(wrench.header.stamp.into(), finite.then_some(value), health);
            }),
            Role::TcpPose => {
                PoseStamped::decode(data).map(|pose| push_pose(&mut self.tcp, &pose, health))
            }
            Role::AriaPose => {
                PoseStamped::decode(data).map(|pose| push_pose(&mut self.aria, &pose, health))
            }
            Role::Gripper => JointState::decode(data).map(|joints| {
                let width = gripper_width(&joints).filter(|width| width.is_finite());
                self.gripper.push(joints.header.stamp.into(), width, health);
            }),
            Role::Temperature => Temperature::decode(data).map(|reading| {
                let value = Some(reading.temperature).filter(|value| value.is_finite());
                self.temperature
                    .push(reading.header.stamp.into(), value, health);
            }),
            Role::Imu => Imu::decode(data).map(|imu| {
                let finite = |rate: &[f64; 3]| rate.iter().all(|value| value.is_finite());
                let rate = imu.rate().filter(finite);
                self.angular_rate
                    .push(imu.header.stamp.into(), rate, health);
            }),
            Role::TfStatic => TFMessage::decode(data).map(|tf| {
                for transform in &tf.transforms {
                    health.non_finite += u64::from(!self.transforms.add(transform));
                }
            }),
            Role::Marks => Text::decode(data).map(|text| {
                self.marks
                    .push(host_time(message.publish_time), Some(text.data), health);
            }),
            Role::Other => Ok(()),
        };
        health.undecodable += u64::from(decoded.is_err());
    }

    /// The static transforms that the recording has.
    pub(super) fn known_frames(&self) -> KnownFrames {
        KnownFrames {
            aria_device_from_tcp: self.transforms.between(AriaDevice::NAME, Tcp::NAME),
            tcp_from_ft_sensor: self.transforms.between(Tcp::NAME, FtSensor::NAME),
        }
    }

    /// The recording, once all records were taken; it may lack poses when they are not needed.
    pub(super) fn finish(
        mut self,
        path: &Path,
        sha256: String,
        damage: &[Damage],
        needs_pose: bool,
    ) -> Result<Recording, ReadError> {
        for route in self.routes.values() {
            if let Some(health) = self.topics.get_mut(&route.topic) {
                health.add(&route.health);
            }
        }
        let truncated = describe_all(self.unknown.behind(damage).chain(self.recovered.clone()));
        self.check_map(path, truncated.as_ref())?;
        let wrench = self.settle(Role::Wrench, |loader| &mut loader.wrench);
        let tcp = self.settle(Role::TcpPose, |loader| &mut loader.tcp);
        let aria = self.settle(Role::AriaPose, |loader| &mut loader.aria);
        let gripper_width = self.settle(Role::Gripper, |loader| &mut loader.gripper);
        let temperature = self.settle(Role::Temperature, |loader| &mut loader.temperature);
        let angular_rate = self.settle(Role::Imu, |loader| &mut loader.angular_rate);
        let marks = self.settle(Role::Marks, |loader| &mut loader.marks);
        if wrench.is_empty() {
            return Err(self.missing(path, &[Role::Wrench], truncated));
        }
        let pose = match (tcp.is_empty(), aria.is_empty()) {
            (false, _) => PoseTrack {
                frame: TrackedFrame::Tcp,
                samples: tcp,
            },
            (true, is_empty) if !is_empty || !needs_pose => PoseTrack {
                frame: TrackedFrame::AriaDevice,
                samples: aria,
            },
            _ => {
                return Err(self.missing(path, &[Role::TcpPose, Role::AriaPose], truncated));
            }
        };
        let calibration = self
            .calibration
            .as_ref()
            .map(Calibration::from_metadata)
            .transpose();
        let between = |to, from| self.transforms.between(to, from).unwrap_or(Pose7::IDENTITY);
        Ok(Recording {
            path: path.to_owned(),
            sha256,
            wrench,
            pose,
            gripper_width,
            temperature,
            angular_rate,
            aria_device_from_tcp: between(AriaDevice::NAME, Tcp::NAME),
            tcp_from_ft_sensor: between(Tcp::NAME, FtSensor::NAME),
            marks,
            calibration: calibration.map_err(|source| ReadError::Calibration {
                path: path.to_owned(),
                source,
            })?,
            session: self.session,
            health: ReadHealth {
                topics: self.topics,
                truncated,
            },
        })
    }

    /// Takes a track's samples and adds to the health of the topics that play its role.
    fn settle<T: Clone + PartialEq>(
        &mut self,
        role: Role,
        track: impl FnOnce(&mut Self) -> &mut Track<T>,
    ) -> Vec<Stamped<T>> {
        let settled = std::mem::take(track(self)).settle();
        let topic = self
            .routes
            .values()
            .find(|route| route.role == role)
            .map(|route| &route.topic);
        if let Some(health) = topic.and_then(|topic| self.topics.get_mut(topic)) {
            health.duplicates += settled.duplicates;
            health.repeated_stamps += settled.repeated_stamps;
        }
        settled.samples
    }

    fn check_map(&self, path: &Path, truncated: Option<&String>) -> Result<(), ReadError> {
        match self
            .map
            .sources()
            .find(|source| !self.topics.contains_key(*source))
        {
            None => Ok(()),
            Some(topic) => Err(ReadError::MapFrom {
                path: path.to_owned(),
                topic: topic.to_owned(),
                topics: self.topic_list(truncated.cloned()),
            }),
        }
    }

    fn topic_list(&self, damage: Option<String>) -> TopicList {
        let topics = self.topics.iter();
        let topics =
            topics.map(|(topic, health)| (topic.clone(), health.kind.clone(), health.messages));
        TopicList {
            topics: topics.collect(),
            damage,
        }
    }

    /// Why there is nothing for any of `roles`: foreign messages, unusable messages, or no topic at all.
    fn missing(&self, path: &Path, roles: &[Role], damage: Option<String>) -> ReadError {
        let path = path.to_owned();
        if let Some((role, channel, type_name)) =
            self.foreign.iter().find(|(role, ..)| roles.contains(role))
        {
            let topic = channel.topic.clone();
            return match channel.message_encoding.as_str() {
                "cdr" => {
                    let got = if type_name.is_empty() {
                        "(no schema)".to_owned()
                    } else {
                        type_name.clone()
                    };
                    ReadError::WrongType {
                        path,
                        topic,
                        got,
                        expected: role.type_name(),
                    }
                }
                encoding => ReadError::ForeignEncoding {
                    path,
                    topic,
                    encoding: encoding.to_owned(),
                },
            };
        }
        let route = self
            .routes
            .values()
            .find(|route| roles.contains(&route.role));
        let used = route.and_then(|route| Some((route, self.topics.get(&route.topic)?)));
        if let Some((route, health)) = used.filter(|(_, health)| health.messages > 0) {
            return ReadError::NothingUsable {
                path,
                topic: route.topic.clone(),
                messages: health.messages,
                undecodable: health.undecodable,
                non_finite: health.non_finite,
            };
        }
        let (needed, map_to) = match roles {
            [Role::Wrench] => (
                "/ft/wrench (geometry_msgs/msg/WrenchStamped)",
                topic::WRENCH,
            ),
            _ => (
                "/tcp/pose and no /aria/pose (geometry_msgs/msg/PoseStamped)",
                topic::TCP_POSE,
            ),
        };
        ReadError::MissingTopic {
            path,
            needed,
            map_to,
            topics: self.topic_list(damage),
        }
    }
}

fn push_pose(track: &mut Track<Pose7>, message: &PoseStamped, health: &mut TopicHealth) {
    let pose = Pose7::normalised(
        message.pose.position.into(),
        message.pose.orientation.into(),
    );
    track.push(message.header.stamp.into(), pose, health);
}

/// The joint `gripper_width`, or the only joint.
fn gripper_width(joints: &JointState) -> Option<f64> {
    let named = joints.name.iter().position(|name| name == GRIPPER_JOINT);
    match (named, joints.position.as_slice()) {
        (Some(index), positions) => positions.get(index).copied(),
        (None, [only]) => Some(*only),
        (None, _) => None,
    }
}

/// An instant of an MCAP; the far future beyond the year 2262.
fn host_time(nanos: u64) -> HostTime {
    i64::try_from(nanos).map_or(HostTime::FAR_FUTURE, HostTime::from_nanos)
}

/// The first few of what is wrong, in one line; `None` when nothing is.
fn describe_all(mut parts: impl Iterator<Item = String>) -> Option<String> {
    let shown: Vec<_> = parts.by_ref().take(5).collect();
    let more = parts.count();
    match (shown.is_empty(), more) {
        (true, _) => None,
        (false, 0) => Some(shown.join("; ")),
        (false, more) => Some(format!("{}; and {more} more", shown.join("; "))),
    }
}
