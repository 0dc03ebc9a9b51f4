//! Quality of service that a channel's publisher offered, as rosbag2 keeps it beside the messages.

/// Whether lost samples are sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// They are.
    Reliable,
    /// They are not.
    BestEffort,
}

/// Whether late subscribers get the last samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// They do ("latched").
    TransientLocal,
    /// They do not.
    Volatile,
}

/// A publisher's quality of service; history is always "keep last", time limits are infinite.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether lost samples are sent again.
    pub reliability: Reliability,
    /// Whether late subscribers get the last samples.
    pub durability: Durability,
    /// Samples kept for late subscribers and for sending again.
    pub depth: u32,
}

impl Qos {
    /// Streams of samples: best effort, volatile, depth 10.
    pub const SENSOR: Self = Self {
        reliability: Reliability::BestEffort,
        durability: Durability::Volatile,
        depth: 10,
    };
    /// Events that must arrive: reliable, volatile, depth 10.
    pub const RELIABLE: Self = Self {
        reliability: Reliability::Reliable,
        durability: Durability::Volatile,
        depth: 10,
    };
    /// State that late subscribers need: reliable, transient local, depth 1.
    pub const LATCHED: Self = Self {
        reliability: Reliability::Reliable,
        durability: Durability::TransientLocal,
        depth: 1,
    };

    /// The value of the channel metadata `offered_qos_profiles`: a YAML sequence of one profile, with the policy names
    /// that rosbag2 writes since its metadata version 9 (Jazzy).
    #[must_use]
    pub fn to_yaml(self) -> String {
        let reliability = match self.reliability {
            Reliability::Reliable => "reliable",
            Reliability::BestEffort => "best_effort",
        };
        let durability = match self.durability {
            Durability::TransientLocal => "transient_local",
            Durability::Volatile => "volatile",
        };
        let depth = self.depth;
        let infinite = "\n    sec: 9223372036\n    nsec: 854775807";
        format!(
            "- history: keep_last\n  depth: {depth}\n  reliability: {reliability}\n  durability: {durability}\n  \
             deadline:{infinite}\n  lifespan:{infinite}\n  liveliness: automatic\n  \
             liveliness_lease_duration:{infinite}\n  avoid_ros_namespace_conventions: false\n"
        )
    }
}
