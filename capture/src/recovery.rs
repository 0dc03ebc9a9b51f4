//! How who missed messages asks their publisher again: what both sides have to agree on.
//!
//! ```text
//! KEY                            the messages; source info: the publisher's id, and a number from 0 (u32, wraps)
//! KEY/@adv/pub/ZID/EID/_         the publisher's token; its heartbeat, twice a second: the latest number, u32 little endian;
//!                                query `?_sn=FROM..TO`: what it still has of these numbers (`;_max=N`: the latest N of them)
//! KEY/@adv/pub/ZID/EID/have      query `?by=WHO;before=NUMBER`: WHO needs nothing before NUMBER any more (none: it does not
//!                                know yet); the reply: the oldest number that the publisher has, u32 little endian
//! ```
//!
//! The first two are those of zenoh-ext (advanced publisher and subscriber, 1.10). The third is ours: it tells a publisher that ends whom it has to wait for, and a recorder what it need
//! not ask for any more.

use zenoh::query::Parameters;
use zenoh::session::EntityGlobalId;

/// Names the recorder in a query on `have`.
pub(crate) const BY: &str = "by";
/// The number before which it needs nothing.
pub(crate) const BEFORE: &str = "before";
/// The chunk between a topic's key and what is about its publishers.
const ADVANCED: &str = "/@adv/pub/";

/// What is about the publisher `id` of `key`: `KEY/@adv/pub/ZID/EID`.
pub(crate) fn publisher(key: &str, id: EntityGlobalId) -> String {
    format!("{key}{ADVANCED}{}/{}", id.zid(), id.eid())
}

/// The key of the token, of the heartbeat, and where messages are asked for.
pub(crate) fn messages(publisher: &str) -> String {
    format!("{publisher}/_")
}

/// The key of a recorder's report.
pub(crate) fn have(publisher: &str) -> String {
    format!("{publisher}/have")
}

/// The key of the heartbeats of all publishers of `keys`.
pub(crate) fn heartbeats(keys: &str) -> String {
    format!("{keys}{ADVANCED}**")
}

/// Whose heartbeat has this key.
pub(crate) fn of_heartbeat(key: &str) -> Option<&str> {
    key.strip_suffix("/_")
        .filter(|publisher| publisher.contains(ADVANCED))
}

/// The number in a heartbeat or in the reply to a report.
pub(crate) fn number(payload: &[u8]) -> Option<u32> {
    Some(u32::from_le_bytes(payload.try_into().ok()?))
}

/// The message's number in the publisher's own count, which does not wrap: of those that `wrapped` can mean the one nearest
/// to `near`, whose wrapped number is `near_wrapped`.
pub(crate) fn unwrapped(wrapped: u32, near: i64, near_wrapped: u32) -> i64 {
    near + i64::from(wrapped.wrapping_sub(near_wrapped).cast_signed())
}

/// First and last of the numbers that a query asks for; `None` = open. A range that cannot be read asks for everything, as
/// with zenoh-ext.
pub(crate) fn asked_range(parameters: &Parameters<'_>) -> (Option<u32>, Option<u32>) {
    let Some(range) = parameters.get("_sn") else {
        return (None, None);
    };
    match range.split_once("..") {
        Some((first, last)) => (first.parse().ok(), last.parse().ok()),
        None => {
            let one = range.parse().ok();
            (one, one)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heartbeat_names_its_publisher() {
        let publisher = "0/ft/wrench/WrenchStamped_/RIHS01_8d/@adv/pub/9ca0/3";
        assert_eq!(of_heartbeat(&messages(publisher)), Some(publisher));
        for key in [
            have(publisher),
            "0/ft/wrench/_".to_owned(),
            publisher.to_owned(),
        ] {
            assert_eq!(of_heartbeat(&key), None, "{key}");
        }
    }

    #[test]
    fn numbers_go_on_where_32_bits_end() {
        let latest = (1_i64 << 32) + 5;
        assert_eq!(unwrapped(2, latest, 4), latest - 2);
        assert_eq!(unwrapped(u32::MAX, latest, 4), latest - 5);
        assert_eq!(unwrapped(7, latest, 4), latest + 3);
    }

    #[test]
    fn ranges_are_read_as_zenoh_writes_them() {
        for (text, range) in [
            ("_sn=3..9", (Some(3), Some(9))),
            ("_sn=3..", (Some(3), None)),
            ("_sn=..9", (None, Some(9))),
            ("_sn=7", (Some(7), Some(7))),
            ("_sn=..", (None, None)),
            ("_max=5", (None, None)),
            ("_sn=x..9", (None, Some(9))),
        ] {
            assert_eq!(asked_range(&Parameters::from(text)), range, "{text}");
        }
    }
}
