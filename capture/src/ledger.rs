//! The account of every sample: what came, what was missing, what was discarded and by whom.

use std::sync::atomic::{AtomicU64, Ordering};

use ft_drivers::reading::Counts;
use serde::Serialize;

/// Name of what the program itself puts into a recording, marks and diagnostics; no device has it.
pub const OWN_STREAM: &str = "ft_capture";

/// Counters of one device's stream, written by its link thread and the sinks, read by anyone.
#[derive(Debug, Default)]
pub struct StreamCounters {
    received: AtomicU64,
    gaps: AtomicU64,
    refused: AtomicU64,
    duplicated: AtomicU64,
    skipped: AtomicU64,
    overflows: AtomicU64,
    overrange: AtomicU64,
    invalid: AtomicU64,
    drops: AtomicU64,
    view_drops: AtomicU64,
    interruptions: AtomicU64,
}

impl StreamCounters {
    /// Takes over what the driver counted, on top of what drivers of earlier connections counted.
    pub fn set_driver_counts(&self, before: Counts, now: Counts) {
        self.received
            .store(before.received + now.received, Ordering::Relaxed);
        self.gaps.store(before.gaps + now.gaps, Ordering::Relaxed);
        self.refused
            .store(before.refused + now.refused, Ordering::Relaxed);
        self.duplicated
            .store(before.duplicated + now.duplicated, Ordering::Relaxed);
        self.skipped
            .store(before.skipped + now.skipped, Ordering::Relaxed);
        self.overflows
            .store(before.overflows + now.overflows, Ordering::Relaxed);
    }

    /// A sample beyond its rated range was delivered.
    pub fn add_overrange(&self) {
        self.overrange.fetch_add(1, Ordering::Relaxed);
    }

    /// A sample that its device calls wrong was delivered.
    pub fn add_invalid(&self) {
        self.invalid.fetch_add(1, Ordering::Relaxed);
    }

    /// The writer's queue was full: an item is missing in the recording.
    pub fn add_drop(&self) {
        self.drops.fetch_add(1, Ordering::Relaxed);
    }

    /// The publisher's queue was full: an item is missing at the viewers.
    pub fn add_view_drop(&self) {
        self.view_drops.fetch_add(1, Ordering::Relaxed);
    }

    /// The link was lost while samples flowed.
    pub fn add_interruption(&self) {
        self.interruptions.fetch_add(1, Ordering::Relaxed);
    }

    /// The account as it stands.
    #[must_use]
    pub fn snapshot(&self) -> StreamLedger {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        StreamLedger {
            received: read(&self.received),
            gaps: read(&self.gaps),
            drops: read(&self.drops),
            refused: read(&self.refused),
            duplicated: read(&self.duplicated),
            skipped: read(&self.skipped),
            overflows: read(&self.overflows),
            overrange: read(&self.overrange),
            invalid: read(&self.invalid),
            interruptions: read(&self.interruptions),
            view_drops: read(&self.view_drops),
        }
    }
}

/// The account of one stream (metadata `ft.ledger`, the summary, `/diagnostics`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct StreamLedger {
    /// Samples that the driver delivered.
    pub received: u64,
    /// Samples that the device's own counter or clock shows as missing.
    pub gaps: u64,
    /// Items that we discarded before the recording because the writer was behind.
    pub drops: u64,
    /// Frames refused as malformed.
    pub refused: u64,
    /// Samples that came twice; one was kept.
    pub duplicated: u64,
    /// Bytes or frames that belong to no frame of the device, skipped while searching; set-up text counts here.
    pub skipped: u64,
    /// Frames for which the kernel's queue or the CAN adapter had no room, so that they never came, or that came as no frame at all; at
    /// least so many.
    pub overflows: u64,
    /// Samples delivered although a component was beyond its rated range.
    pub overrange: u64,
    /// Samples delivered although the device called them wrong.
    pub invalid: u64,
    /// Times the link was lost while samples flowed.
    pub interruptions: u64,
    /// Items that viewers missed because the publisher was behind. The recording is not touched by these.
    pub view_drops: u64,
}

impl StreamLedger {
    /// What was added since `before`.
    #[must_use]
    pub const fn since(&self, before: &Self) -> Self {
        Self {
            received: self.received.saturating_sub(before.received),
            gaps: self.gaps.saturating_sub(before.gaps),
            drops: self.drops.saturating_sub(before.drops),
            refused: self.refused.saturating_sub(before.refused),
            duplicated: self.duplicated.saturating_sub(before.duplicated),
            skipped: self.skipped.saturating_sub(before.skipped),
            overflows: self.overflows.saturating_sub(before.overflows),
            overrange: self.overrange.saturating_sub(before.overrange),
            invalid: self.invalid.saturating_sub(before.invalid),
            interruptions: self.interruptions.saturating_sub(before.interruptions),
            view_drops: self.view_drops.saturating_sub(before.view_drops),
        }
    }

    /// Whether anything that the device measured is missing in the recording, or cannot be trusted.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.gaps + self.drops + self.refused + self.overflows + self.invalid + self.interruptions
            > 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn viewers_that_miss_something_are_no_loss_of_data() {
        let counters = StreamCounters::default();
        counters.add_view_drop();
        counters.set_driver_counts(
            Counts::default(),
            Counts {
                received: 5,
                duplicated: 1,
                ..Counts::default()
            },
        );
        let ledger = counters.snapshot();
        assert!(!ledger.lost_data());
        assert_eq!(
            (ledger.received, ledger.view_drops, ledger.duplicated),
            (5, 1, 1)
        );
    }

    #[test]
    fn every_kind_of_loss_is_one() {
        let gap = StreamLedger {
            gaps: 1,
            ..StreamLedger::default()
        };
        let drop = StreamLedger {
            drops: 1,
            ..StreamLedger::default()
        };
        let refused = StreamLedger {
            refused: 1,
            ..StreamLedger::default()
        };
        let invalid = StreamLedger {
            invalid: 1,
            ..StreamLedger::default()
        };
        let interrupted = StreamLedger {
            interruptions: 1,
            ..StreamLedger::default()
        };
        let overflown = StreamLedger {
            overflows: 1,
            ..StreamLedger::default()
        };
        for ledger in [gap, drop, refused, overflown, invalid, interrupted] {
            assert!(ledger.lost_data(), "{ledger:?}");
        }
    }
}
