//! What became of a remote recording.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

/// The account of one topic.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct RemoteLedger {
    /// Messages in the file.
    pub received: u64,
    /// Of these, those that did not come by themselves: asked for again, or from before the recording.
    pub recovered: u64,
    /// Messages that the publisher numbered after the first in the file, and that are not in the file.
    pub gaps: u64,
    /// Messages that the publishers numbered before their first in the file: published before the recording, or lost then.
    pub earlier: u64,
    /// Messages that came twice; one was kept.
    pub duplicated: u64,
    /// Messages that came and were given up, as the ledger of every recording says it: none, because what has no room at once is
    /// asked for again, and is a gap when it cannot be had.
    pub drops: u64,
    /// Messages without rmw_zenoh's attachment, or with one that cannot be.
    pub refused: u64,
    /// Messages of a type that no capture publishes, of others on the network: they are not recorded.
    pub others: u64,
    /// Messages in the file of publishers beyond those whose numbers are followed: whether others of theirs are missing is not known.
    pub unfollowed: u64,
}

impl RemoteLedger {
    /// Whether anything that was published since the first message is missing.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.gaps + self.refused > 0
    }
}

/// The end of a remote recording.
#[derive(Clone, Debug, Serialize)]
pub struct RemoteSummary {
    /// Where it is.
    pub path: PathBuf,
    /// Its size.
    pub bytes: u64,
    /// By topic.
    pub topics: BTreeMap<String, RemoteLedger>,
}

impl RemoteSummary {
    /// Whether anything is missing.
    #[must_use]
    pub fn lost_data(&self) -> bool {
        self.topics.values().any(RemoteLedger::lost_data)
    }

    /// Whether nothing came, on whatever topic.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.topics.values().all(|ledger| ledger.received == 0)
    }
}

impl std::fmt::Display for RemoteSummary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "{:<27} {:>9} {:>9} {:>7} {:>8} {:>7} {:>7} {:>7}",
            "topic", "received", "recovered", "missing", "earlier", "doubled", "refused", "others"
        )?;
        for (topic, ledger) in &self.topics {
            writeln!(
                f,
                "{topic:<27} {:>9} {:>9} {:>7} {:>8} {:>7} {:>7} {:>7}",
                ledger.received,
                ledger.recovered,
                ledger.gaps,
                ledger.earlier,
                ledger.duplicated,
                ledger.refused,
                ledger.others
            )?;
        }
        writeln!(
            f,
            "recorded {} ({:.1} MB)",
            self.path.display(),
            self.bytes as f64 * 1e-6
        )?;
        let unfollowed: u64 = self.topics.values().map(|ledger| ledger.unfollowed).sum();
        if unfollowed > 0 {
            writeln!(
                f,
                "{unfollowed} messages are of publishers too many to follow: what is missing of theirs is not known"
            )?;
        }
        f.write_str(if self.lost_data() {
            "DATA WAS LOST: see the counts above"
        } else if unfollowed > 0 {
            "of the others nothing was lost"
        } else {
            "nothing was lost"
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_of_a_namespaced_gripper_is_not_empty() {
        let summary = |received| RemoteSummary {
            path: PathBuf::new(),
            bytes: 0,
            topics: BTreeMap::from([(
                "/blue/ft/wrench".to_owned(),
                RemoteLedger {
                    received,
                    ..RemoteLedger::default()
                },
            )]),
        };
        assert!(!summary(1).is_empty());
        assert!(summary(0).is_empty());
    }

    #[test]
    fn a_hole_is_a_loss_and_what_was_before_the_recording_is_none() {
        let before = RemoteLedger {
            earlier: 9,
            recovered: 9,
            duplicated: 9,
            ..RemoteLedger::default()
        };
        assert!(!before.lost_data());
        assert!(RemoteLedger { gaps: 1, ..before }.lost_data());
        assert!(
            !RemoteLedger {
                others: 1,
                ..before
            }
            .lost_data()
        );
    }
}
