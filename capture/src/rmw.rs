//! How rmw_zenoh names topics, attaches metadata and announces endpoints, so that ROS 2 nodes see ours as their own.
//!
//! # Source
//! `ros2/rmw_zenoh`: `docs/design.md`, `liveliness_utils.cpp`, `attachment_helpers.cpp`, `qos.cpp`. The test vectors
//! are of that document and of traffic of `rmw_zenoh_cpp` 0.1.8 (Humble) captured by `dora-rs/dora`. Not tried against
//! a live `ros2` command.

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_128;

/// Which ROS 2 distributions are to see the topics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Profile {
    /// Iron and later: type hashes in the keys.
    #[default]
    Jazzy,
    /// Humble: the literal `TypeHashNotSupported` in their place.
    Humble,
}

/// How a publisher offers a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Offer {
    /// Best effort, volatile, keep last 10: sensor streams.
    Stream,
    /// Reliable, volatile, keep last 10: marks and diagnostics.
    Event,
}

impl Offer {
    /// The QoS chunk of the liveliness token: empty where equal to rmw_zenoh's default, the depth always written.
    const fn qos_chunk(self) -> &'static str {
        match self {
            Self::Stream => "2::,10:,:,:,,",
            Self::Event => "::,10:,:,:,,",
        }
    }
}

/// A topic as rmw_zenoh sees it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    name: String,
    dds_type: String,
    hash: String,
}

impl Topic {
    /// `name` with its leading slash, `type_name` as `pkg/msg/Name`, `type_hash` as `RIHS01_...`.
    #[must_use]
    pub fn new(name: &str, type_name: &str, type_hash: &str, profile: Profile) -> Self {
        let dds_type = match type_name.split_once("/msg/") {
            Some((package, message)) => format!("{package}::msg::dds_::{message}_"),
            None => type_name.to_owned(),
        };
        let hash = match profile {
            Profile::Jazzy => type_hash,
            Profile::Humble => "TypeHashNotSupported",
        };
        Self {
            name: name.to_owned(),
            dds_type,
            hash: hash.to_owned(),
        }
    }

    /// The key expression that samples are put on.
    #[must_use]
    pub fn key_expr(&self, domain_id: u32) -> String {
        format!(
            "{domain_id}/{}/{}/{}",
            self.name.trim_matches('/'),
            self.dds_type,
            self.hash
        )
    }

    /// The liveliness token of a publisher of this topic.
    #[must_use]
    pub fn token(&self, node: &NodeName, endpoint_id: usize, offer: Offer) -> String {
        format!(
            "@ros2_lv/{}/{}/0/{endpoint_id}/MP/%/%{}/{}/{}/{}/{}/{}",
            node.domain_id,
            node.zenoh_id,
            node.namespace,
            node.node,
            self.name.replace('/', "%"),
            self.dds_type,
            self.hash,
            offer.qos_chunk()
        )
    }
}

/// Our node in the ROS graph.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// `ROS_DOMAIN_ID`.
    pub domain_id: u32,
    /// Namespace of the node and of its topics, without slashes; empty = the root.
    pub namespace: String,
    /// The session's id as Zenoh prints it.
    pub zenoh_id: String,
    /// The node's name, without slashes.
    pub node: String,
}

impl NodeName {
    /// The node's own liveliness token.
    #[must_use]
    pub fn token(&self) -> String {
        format!(
            "@ros2_lv/{}/{}/0/0/NN/%/%{}/{}",
            self.domain_id, self.zenoh_id, self.namespace, self.node
        )
    }
}

/// The publisher's id, from its liveliness token.
#[must_use]
pub fn gid(token: &str) -> [u8; 16] {
    xxh3_128(token.as_bytes()).to_le_bytes()
}

/// Bytes of an attachment.
pub const ATTACHMENT_LEN: usize = 33;

/// What every sample must carry: sequence number (from 1), source time (ns since the Unix epoch) and publisher id.
#[must_use]
pub fn attachment(sequence: i64, source_ns: i64, gid: [u8; 16]) -> [u8; ATTACHMENT_LEN] {
    let mut bytes = [0; ATTACHMENT_LEN];
    let (numbers, rest) = bytes.split_at_mut(16);
    let (first, second) = numbers.split_at_mut(8);
    first.copy_from_slice(&sequence.to_le_bytes());
    second.copy_from_slice(&source_ns.to_le_bytes());
    if let [length, id @ ..] = rest {
        *length = 16;
        id.copy_from_slice(&gid);
    }
    bytes
}

/// What an attachment says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// The publisher's number of the message, from 1.
    pub sequence: i64,
    /// Source time, ns since the Unix epoch.
    pub source_ns: i64,
    /// The publisher's id.
    pub gid: [u8; 16],
}

/// Numbers and instants beyond this are nonsense: it is the year 2116, and room to reckon with.
const BEYOND: i64 = 1 << 62;

/// Reads an attachment; `None` when it is not one of rmw_zenoh's, or its number or instant cannot be.
#[must_use]
pub fn read_attachment(bytes: &[u8]) -> Option<Attachment> {
    let (numbers, rest) = bytes.split_first_chunk::<16>()?;
    let [16, gid @ ..] = rest else { return None };
    let (sequence, source_ns) = numbers.split_first_chunk::<8>()?;
    let sequence = i64::from_le_bytes(*sequence);
    let source_ns = i64::from_le_bytes(source_ns.try_into().ok()?);
    let can_be = (1..BEYOND).contains(&sequence) && (0..BEYOND).contains(&source_ns);
    can_be.then_some(Attachment {
        sequence,
        source_ns,
        gid: gid.try_into().ok()?,
    })
}

/// `geometry_msgs::msg::dds_::WrenchStamped_` as ROS writes it, `geometry_msgs/msg/WrenchStamped`.
#[must_use]
pub fn ros_type(dds_type: &str) -> Option<String> {
    let (package, message) = dds_type.strip_suffix('_')?.split_once("::msg::dds_::")?;
    Some(format!("{package}/msg/{message}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HASH: &str = "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77";

    fn wrench(profile: Profile) -> Topic {
        Topic::new(
            "/ft/wrench",
            "geometry_msgs/msg/WrenchStamped",
            HASH,
            profile,
        )
    }

    #[test]
    fn keys_are_those_of_the_design_document() {
        assert_eq!(
            wrench(Profile::Jazzy).key_expr(0),
            format!("0/ft/wrench/geometry_msgs::msg::dds_::WrenchStamped_/{HASH}")
        );
        let chatter = Topic::new(
            "/chatter",
            "std_msgs/msg/String",
            "RIHS01_df",
            Profile::Humble,
        );
        assert_eq!(
            chatter.key_expr(0),
            "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
        );
    }

    #[test]
    fn the_gid_of_a_captured_token_is_the_captured_gid() {
        let token = "@ros2_lv/0/9ca0f8facf84ffb1e6bfa4f2500889f0/0/3/MP/%/%/_ros2cli_712/%chatter/\
                     std_msgs::msg::dds_::String_/TypeHashNotSupported/:1:,1:,:,:,,";
        let captured = 0xf071_68d3_856c_e9f6_8925_4cbe_d625_2151_u128.to_be_bytes();
        assert_eq!(gid(token), captured);
    }

    #[test]
    fn tokens_and_their_gid_agree_with_the_reference() {
        let node = NodeName {
            domain_id: 0,
            namespace: String::new(),
            zenoh_id: "9ca0f8facf84ffb1e6bfa4f2500889f0".to_owned(),
            node: "ft_capture".to_owned(),
        };
        let token = wrench(Profile::Jazzy).token(&node, 10, Offer::Stream);
        assert_eq!(
            token,
            format!(
                "@ros2_lv/0/9ca0f8facf84ffb1e6bfa4f2500889f0/0/10/MP/%/%/ft_capture/%ft%wrench/\
                 geometry_msgs::msg::dds_::WrenchStamped_/{HASH}/2::,10:,:,:,,"
            )
        );
        assert_eq!(
            gid(&token),
            0x1446_47cf_4160_c1c1_aff5_4000_1ee7_b567_u128.to_be_bytes()
        );
        assert_eq!(
            node.token(),
            "@ros2_lv/0/9ca0f8facf84ffb1e6bfa4f2500889f0/0/0/NN/%/%/ft_capture"
        );
        let blue = NodeName {
            namespace: "blue".to_owned(),
            ..node
        };
        assert!(blue.token().ends_with("/NN/%/%blue/ft_capture"));
    }

    #[test]
    fn an_attachment_is_the_captured_one() {
        let id = 0xf071_68d3_856c_e9f6_8925_4cbe_d625_2151_u128.to_be_bytes();
        let source_ns = i64::from_le_bytes([0x34, 0xda, 0xe1, 0x01, 0x62, 0xf8, 0xc4, 0x18]);
        let bytes = attachment(216, source_ns, id);
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(
            hex,
            "d80000000000000034dae10162f8c41810f07168d3856ce9f689254cbed6252151"
        );
        let read = Attachment {
            sequence: 216,
            source_ns,
            gid: id,
        };
        assert_eq!(read_attachment(&bytes), Some(read));
        for length in 0..bytes.len() {
            assert_eq!(read_attachment(&bytes[..length]), None);
        }
        assert_eq!(read_attachment(&[bytes.as_slice(), &[0]].concat()), None);
        for (sequence, source_ns) in [
            (0, 5),
            (-1, 5),
            (i64::MIN, 5),
            (BEYOND, 5),
            (1, -5),
            (1, i64::MAX),
        ] {
            let nonsense = attachment(sequence, source_ns, id);
            assert_eq!(read_attachment(&nonsense), None, "{sequence} {source_ns}");
        }
    }
}
