//! Static transforms of a recording, changed where frames are to stand elsewhere; the others stay.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use ft_wire::HostTime;

use crate::error::ReadError;
use crate::message::{Header, Message, TFMessage, TransformStamped};
use crate::reader::{Record, RecordReader};
use crate::recording::{Pose7, StaticTransforms, TopicMap, frame_name};
use crate::topic;

/// Where frames are to stand.
#[derive(Debug, Default)]
pub(super) struct Wanted {
    /// Base, frame and `base_from_frame`.
    pub(super) frames: Vec<(String, String, Pose7)>,
    pub(super) map: TopicMap,
    /// Stamp of transforms that no message has yet.
    pub(super) at: HostTime,
}

/// What is to be done to the source's transforms.
#[derive(Debug, Default)]
pub(super) struct Changes {
    /// Topics that carry them, as the source calls them.
    topics: BTreeSet<String>,
    messages: u64,
    /// `parent_from_child`, by parent and child.
    changed: BTreeMap<(String, String), Pose7>,
    /// Transforms between frames that no chain joined.
    added: Vec<TransformStamped>,
}

impl Wanted {
    /// Reads the source's transforms, and sees which must change.
    pub(super) fn changes(&self, source: Option<&Path>) -> Result<Changes, ReadError> {
        let mut changes = Changes::default();
        let mut transforms = StaticTransforms::default();
        if let Some(source) = source.filter(|_| !self.frames.is_empty()) {
            changes.read(source, &self.map, &mut transforms)?;
        }
        for (base, frame, pose) in &self.frames {
            let Some(path) = transforms.path(base, frame) else {
                transforms.set(base, frame, *pose);
                changes.added.push(transform(base, frame, pose, self.at));
                continue;
            };
            // The last that another wanted frame has not changed already.
            let is_free = |(parent, child): &(String, String)| {
                let both = [(parent, child), (child, parent)];
                both.iter().all(|(a, b)| {
                    let key = ((*a).clone(), (*b).clone());
                    !changes.changed.contains_key(&key)
                })
            };
            let free = path.into_iter().rfind(is_free);
            let Some((parent, child)) = free else {
                continue;
            };
            let known = |to: &str, from: &str| transforms.between(to, from);
            let (above, below) = (known(base, &parent), known(&child, frame));
            if let (Some(above), Some(below)) = (above, below) {
                let edge = above.inverse().then(pose).then(&below.inverse());
                transforms.set(&parent, &child, edge);
                changes.changed.insert((parent, child), edge);
            }
        }
        Ok(changes)
    }
}

impl Changes {
    fn read(
        &mut self,
        source: &Path,
        map: &TopicMap,
        transforms: &mut StaticTransforms,
    ) -> Result<(), ReadError> {
        let mut reader = RecordReader::open(source)?;
        let mut channels = BTreeSet::new();
        while let Some(record) = reader.next_record()? {
            match record {
                Record::Channel(channel)
                    if channel.message_encoding == "cdr"
                        && map.resolve(&channel.topic) == Some(topic::TF_STATIC) =>
                {
                    channels.insert(channel.id);
                    self.topics.insert(channel.topic);
                }
                Record::Message(message) if channels.contains(&message.channel_id) => {
                    let message = TFMessage::decode(message.data).unwrap_or_default();
                    self.messages += 1;
                    for transform in &message.transforms {
                        transforms.add(transform);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// What has to be written of its own, because the source has no message that could take it in.
    pub(super) fn left(&mut self) -> Option<TFMessage> {
        if self.messages > 0 {
            return None;
        }
        let transforms = std::mem::take(&mut self.added);
        (!transforms.is_empty()).then_some(TFMessage { transforms })
    }

    /// Whether a message of this topic has to go through [`Changes::apply`].
    pub(super) fn concern(&self, topic: &str) -> bool {
        self.topics.contains(topic) && (!self.changed.is_empty() || !self.added.is_empty())
    }

    /// The message with the changes; `None` when it is none.
    pub(super) fn apply(&mut self, data: &[u8]) -> Option<Vec<u8>> {
        let mut message = TFMessage::decode(data).ok()?;
        for transform in &mut message.transforms {
            let parent = frame_name(&transform.header.frame_id).to_owned();
            let child = frame_name(&transform.child_frame_id).to_owned();
            let key = (parent, child);
            let straight = self.changed.get(&key).copied();
            let (parent, child) = key;
            let turned = || Some(self.changed.get(&(child, parent))?.inverse());
            if let Some(pose) = straight.or_else(turned) {
                transform.transform.translation = pose.position.into();
                transform.transform.rotation = pose.quaternion.into();
            }
        }
        message.transforms.append(&mut self.added);
        let mut out = Vec::new();
        message.encode(&mut out);
        Some(out)
    }
}

fn transform(parent: &str, child: &str, pose: &Pose7, at: HostTime) -> TransformStamped {
    let mut out = TransformStamped {
        header: Header {
            stamp: at.into(),
            frame_id: parent.to_owned(),
        },
        child_frame_id: child.to_owned(),
        ..TransformStamped::default()
    };
    out.transform.translation = pose.position.into();
    out.transform.rotation = pose.quaternion.into();
    out
}
