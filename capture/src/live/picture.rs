//! The latest of everything, rates, and what was missed on the way to this viewer.

use std::collections::{BTreeMap, VecDeque};

use ft_recording::cdr::CdrError;
use ft_recording::message::{
    JointState, Message, Pose, PoseStamped, TFMessage, Text, Transform, WrenchStamped,
};
use ft_recording::topic;
use ft_wire::HostTime;
use ft_wire::frames::{Frame, FtSensor, Tcp};
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use serde::Serialize;
use serde_json::Value;

use super::hub::Sample;
use super::strip::Bin;

/// Topics of which account is kept; a network that names more is not listened to for ever.
const MOST_TOPICS: usize = 64;
/// Publishers of one topic of which account is kept.
const MOST_SOURCES: usize = 32;
/// Bins that are kept: ten seconds.
pub const HISTORY: usize = 1000;
/// Marks that are shown.
const MOST_MARKS: usize = 8;
/// Characters of a mark or of a topic's name: each viewer gets them four times a second.
const LONGEST_TEXT: usize = 256;

/// What a viewer knows.
#[derive(Debug)]
pub struct Picture {
    /// Where it comes from, for people.
    pub source: String,
    /// Each topic's account at this viewer, by name without the namespace.
    pub topics: BTreeMap<String, TopicAccount>,
    /// The latest wrench: force N, torque N m, and when it was true.
    pub wrench: Option<([f64; 6], HostTime)>,
    /// Force and torque of the last seconds, the last is the newest.
    pub history: VecDeque<Bin>,
    /// Gripper width, m.
    pub width_m: Option<f64>,
    /// The latest marks, the last is the newest.
    pub marks: VecDeque<Mark>,
    /// The capture service's own words (answer to the command `status`), and when they came.
    pub status: Option<(Value, HostTime)>,
    /// Messages that are not what their type says.
    pub undecodable: u64,
    /// The latest `/tf_static`, CDR, and when it came about.
    pub static_transforms: Option<(Vec<u8>, HostTime)>,
    device_pose: Option<Isometry3<f64>>,
    tcp_pose: Option<Isometry3<f64>>,
    device_from_tcp: Isometry3<f64>,
    tcp_from_sensor: Isometry3<f64>,
}

/// An operator's mark.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// Its text.
    pub text: String,
    /// When, s since the Unix epoch.
    pub at_s: f64,
}

/// One topic's account at this viewer.
#[derive(Debug, Default, Serialize)]
pub struct TopicAccount {
    /// Messages that came.
    pub received: u64,
    /// Messages that the publisher numbered and that did not come.
    pub missed: u64,
    /// Messages per second over the last second.
    pub rate_hz: f64,
    /// When the latest was true, ns since the Unix epoch.
    pub last_ns: i64,
    #[serde(skip)]
    window: Option<(HostTime, u64)>,
    #[serde(skip)]
    sources: VecDeque<([u8; 16], i64)>,
}

impl Picture {
    /// Nothing is known yet of `source`.
    #[must_use]
    pub fn new(source: &str) -> Self {
        Self {
            source: source.to_owned(),
            topics: BTreeMap::new(),
            wrench: None,
            history: VecDeque::with_capacity(HISTORY),
            width_m: None,
            marks: VecDeque::new(),
            status: None,
            undecodable: 0,
            static_transforms: None,
            device_pose: None,
            tcp_pose: None,
            device_from_tcp: Isometry3::identity(),
            tcp_from_sensor: Isometry3::identity(),
        }
    }

    /// Takes one message.
    pub(super) fn take(&mut self, sample: &Sample<'_>) {
        if !self.topics.contains_key(sample.topic) {
            if self.topics.len() == MOST_TOPICS || sample.topic.len() > LONGEST_TEXT {
                return;
            }
            self.topics
                .insert(sample.topic.to_owned(), TopicAccount::default());
        }
        if let Some(account) = self.topics.get_mut(sample.topic) {
            account.received += 1;
            account.last_ns = sample.at.as_nanos();
            if let Some((source, sequence)) = sample.numbered {
                account.count_missed(source, sequence);
            }
        }
        if self.decode(sample).is_err() {
            self.undecodable += 1;
        }
    }

    fn decode(&mut self, sample: &Sample<'_>) -> Result<(), CdrError> {
        let bytes = sample.payload;
        match sample.topic {
            topic::WRENCH => {
                let message = WrenchStamped::decode(bytes)?;
                self.wrench = Some((message.wrench.into(), sample.at));
            }
            topic::GRIPPER => {
                self.width_m = JointState::decode(bytes)?.position.first().copied();
            }
            topic::ARIA_POSE => {
                self.device_pose = Some(isometry(&PoseStamped::decode(bytes)?.pose));
            }
            topic::TCP_POSE => self.tcp_pose = Some(isometry(&PoseStamped::decode(bytes)?.pose)),
            topic::MARKS => self.add_mark(Text::decode(bytes)?.data, sample.at),
            topic::TF_STATIC => {
                self.static_transforms = Some((bytes.to_vec(), sample.at));
                for stated in TFMessage::decode(bytes)?.transforms {
                    self.take_static(&stated.child_frame_id, &stated.transform);
                }
            }
            _ => {}
        }
        Ok(())
    }

    fn take_static(&mut self, child: &str, transform: &Transform) {
        let pose = isometry(&Pose {
            position: <[f64; 3]>::from(transform.translation).into(),
            orientation: transform.rotation,
        });
        match child {
            Tcp::NAME => self.device_from_tcp = pose,
            FtSensor::NAME => self.tcp_from_sensor = pose,
            _ => {}
        }
    }

    fn add_mark(&mut self, text: String, at: HostTime) {
        if self.marks.len() == MOST_MARKS {
            self.marks.pop_front();
        }
        self.marks.push_back(Mark {
            text: text.chars().take(LONGEST_TEXT).collect(),
            at_s: at.as_nanos() as f64 * 1e-9,
        });
    }

    /// Takes the rates anew; to be called about once a second.
    pub(super) fn measure_rates(&mut self, now: HostTime) {
        for account in self.topics.values_mut() {
            if let Some((then, before)) = account.window {
                let seconds = now.seconds_since(then);
                if seconds > 0.0 {
                    account.rate_hz = (account.received - before) as f64 / seconds;
                }
            }
            account.window = Some((now, account.received));
        }
    }

    /// Takes a bin of force and torque.
    pub(super) fn remember(&mut self, bin: Bin) {
        if self.history.len() == HISTORY {
            self.history.pop_front();
        }
        self.history.push_back(bin);
    }

    /// `world_from_tcp`, where a pose is known.
    #[must_use]
    pub fn world_from_tcp(&self) -> Option<Isometry3<f64>> {
        self.tcp_pose
            .or_else(|| Some(self.device_pose? * self.device_from_tcp))
    }

    /// `tcp_from_ft_sensor`; identity when nobody said.
    #[must_use]
    pub const fn tcp_from_sensor(&self) -> Isometry3<f64> {
        self.tcp_from_sensor
    }

    /// `world_from_aria_device`, where it is known.
    #[must_use]
    pub const fn world_from_device(&self) -> Option<Isometry3<f64>> {
        self.device_pose
    }

    /// Messages received on `topic`.
    #[must_use]
    pub fn received(&self, topic: &str) -> u64 {
        self.topics.get(topic).map_or(0, |account| account.received)
    }
}

impl TopicAccount {
    /// Sequence numbers count from 1 at each publisher; a restart is another publisher.
    fn count_missed(&mut self, source: [u8; 16], sequence: i64) {
        if let Some((_, last)) = self.sources.iter_mut().find(|(known, _)| *known == source) {
            if sequence > *last {
                self.missed += u64::try_from(sequence - *last - 1).unwrap_or(0);
            }
            *last = sequence;
            return;
        }
        if self.sources.len() == MOST_SOURCES {
            self.sources.pop_front();
        }
        self.sources.push_back((source, sequence));
    }
}

fn isometry(pose: &Pose) -> Isometry3<f64> {
    let [x, y, z] = pose.position.into();
    let [i, j, k, w]: [f64; 4] = pose.orientation.into();
    let rotation = UnitQuaternion::try_new(Quaternion::new(w, i, j, k), 1e-6);
    Isometry3::from_parts(
        Translation3::new(x, y, z),
        rotation.unwrap_or_else(UnitQuaternion::identity),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_recording::message::{Header, TransformStamped};

    fn sample<'a>(topic: &'a str, payload: &'a [u8], sequence: i64) -> Sample<'a> {
        Sample {
            topic,
            type_name: "",
            payload,
            at: HostTime::from_nanos(5_000_000_000),
            numbered: Some(([1; 16], sequence)),
        }
    }

    fn encoded(message: &impl Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        bytes
    }

    #[test]
    fn what_was_missed_is_counted_by_the_publishers_numbers() {
        let mut picture = Picture::new("here");
        let bytes = encoded(&WrenchStamped::default());
        for sequence in [1, 2, 5] {
            picture.take(&sample(topic::WRENCH, &bytes, sequence));
        }
        let mut restarted = sample(topic::WRENCH, &bytes, 1);
        restarted.numbered = Some(([2; 16], 1));
        picture.take(&restarted);
        let account = &picture.topics[topic::WRENCH];
        assert_eq!((account.received, account.missed), (4, 2));
    }

    #[test]
    fn what_is_no_message_is_counted() {
        let mut picture = Picture::new("here");
        let bytes = encoded(&WrenchStamped::default());
        picture.take(&sample(topic::WRENCH, &bytes[..20], 1));
        assert_eq!((picture.undecodable, picture.wrench), (1, None));
    }

    #[test]
    fn a_network_that_invents_topics_costs_no_memory() {
        let mut picture = Picture::new("here");
        for index in 0..1000 {
            picture.take(&sample(&format!("/invented/{index}"), &[], 1));
        }
        assert_eq!(picture.topics.len(), MOST_TOPICS);
        let mut picture = Picture::new("here");
        picture.take(&sample(&"/x".repeat(1000), &[], 1));
        assert!(picture.topics.is_empty());
        let novel = Text {
            data: "ä".repeat(100_000),
        };
        picture.take(&sample(topic::MARKS, &encoded(&novel), 1));
        assert_eq!(picture.marks[0].text, "ä".repeat(LONGEST_TEXT));
    }

    #[test]
    fn the_tool_is_where_tracker_and_static_frames_put_it() {
        let mut picture = Picture::new("here");
        let tf = TFMessage {
            transforms: vec![TransformStamped {
                header: Header::default(),
                child_frame_id: Tcp::NAME.to_owned(),
                transform: Transform {
                    translation: [0.0, 0.0, 0.25].into(),
                    rotation: [0.0, 0.0, 0.0, 1.0].into(),
                },
            }],
        };
        let turned = std::f64::consts::FRAC_1_SQRT_2;
        let pose = PoseStamped {
            header: Header::default(),
            pose: Pose {
                position: [1.0, 0.0, 0.0].into(),
                orientation: [turned, 0.0, 0.0, turned].into(),
            },
        };
        picture.take(&sample(topic::TF_STATIC, &encoded(&tf), 1));
        picture.take(&sample(topic::ARIA_POSE, &encoded(&pose), 1));
        let at = picture.world_from_tcp().unwrap().translation.vector;
        assert!(
            (at - nalgebra::Vector3::new(1.0, -0.25, 0.0)).norm() < 1e-12,
            "{at}"
        );
    }
}
