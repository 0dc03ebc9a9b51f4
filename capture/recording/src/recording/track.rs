//! Samples of one kind on their way into a recording, and what is counted about them.

use std::collections::BTreeMap;

use ft_wire::HostTime;

use super::Stamped;

/// What became of a topic's messages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicHealth {
    /// Type, or encoding when there is no type.
    pub kind: String,
    /// Messages in the file.
    pub messages: u64,
    /// Messages whose stamp is before one that came earlier in the file. They are used.
    pub out_of_order: u64,
    /// Messages that repeat stamp and value of another. They are left out.
    pub duplicates: u64,
    /// Messages that have the stamp of another but not its value. They are used.
    pub repeated_stamps: u64,
    /// Messages (or transforms) with NaN, infinity, no such joint, or a quaternion that is no rotation. They are left out.
    pub non_finite: u64,
    /// Messages that are not of the topic's type. They are left out.
    pub undecodable: u64,
}

impl TopicHealth {
    /// Adds what became of another channel's messages.
    pub(super) fn add(&mut self, other: &Self) {
        self.messages += other.messages;
        self.out_of_order += other.out_of_order;
        self.duplicates += other.duplicates;
        self.repeated_stamps += other.repeated_stamps;
        self.non_finite += other.non_finite;
        self.undecodable += other.undecodable;
    }
}

/// What was left out of a recording, and what is wrong with the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReadHealth {
    /// Every topic of the file, by its name there.
    pub topics: BTreeMap<String, TopicHealth>,
    /// What is missing or damaged, in one line; `None` when the file is whole.
    pub truncated: Option<String>,
}

/// Repetitions are looked for among this many samples of the same stamp.
const REPETITION_WINDOW: usize = 16;

#[derive(Debug)]
pub(super) struct Track<T> {
    samples: Vec<Stamped<T>>,
    latest: Option<HostTime>,
}

/// Samples by stamp, and what was found while sorting them.
pub(super) struct Settled<T> {
    pub(super) samples: Vec<Stamped<T>>,
    pub(super) duplicates: u64,
    pub(super) repeated_stamps: u64,
}

impl<T> Default for Track<T> {
    fn default() -> Self {
        Self {
            samples: Vec::new(),
            latest: None,
        }
    }
}

impl<T: PartialEq> Track<T> {
    /// Takes a sample; a value that is none counts as not finite.
    pub(super) fn push(&mut self, at: HostTime, value: Option<T>, health: &mut TopicHealth) {
        health.out_of_order += u64::from(self.latest.is_some_and(|latest| at < latest));
        self.latest = self.latest.max(Some(at));
        match value {
            Some(value) => self.samples.push(Stamped { at, value }),
            None => health.non_finite += 1,
        }
    }

    pub(super) fn settle(self) -> Settled<T> {
        let Self { mut samples, .. } = self;
        samples.sort_by_key(|sample| sample.at);
        let (mut kept, mut duplicates, mut repeated_stamps) = (0, 0, 0);
        for next in 0..samples.len() {
            let (before, rest) = samples.split_at(next);
            let Some(sample) = rest.first() else { break };
            let before = before.get(..kept).unwrap_or_default();
            let mut same_stamp = before
                .iter()
                .rev()
                .take_while(|kept| kept.at == sample.at)
                .take(REPETITION_WINDOW)
                .peekable();
            let repeated = same_stamp.peek().is_some();
            if same_stamp.any(|kept| kept.value == sample.value) {
                duplicates += 1;
            } else {
                repeated_stamps += u64::from(repeated);
                samples.swap(kept, next);
                kept += 1;
            }
        }
        samples.truncate(kept);
        samples.shrink_to_fit();
        Settled {
            samples,
            duplicates,
            repeated_stamps,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn late_repeated_and_missing_samples_are_counted_apart() {
        let mut track = Track::default();
        let mut health = TopicHealth::default();
        for (at, value) in [
            (3, Some(3.0)),
            (1, Some(1.0)),
            (3, Some(3.0)),
            (3, Some(4.0)),
            (4, None),
        ] {
            track.push(HostTime::from_nanos(at), value, &mut health);
        }
        let settled = track.settle();
        let samples: Vec<_> = settled
            .samples
            .iter()
            .map(|s| (s.at.as_nanos(), s.value))
            .collect();
        assert_eq!(samples, [(1, 1.0), (3, 3.0), (3, 4.0)]);
        assert_eq!((settled.duplicates, settled.repeated_stamps), (1, 1));
        assert_eq!((health.out_of_order, health.non_finite), (1, 1));
    }
}
