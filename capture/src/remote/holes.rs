//! What Zenoh's own recovery gave up is asked for again: it asks once for each hole, and what is lost while it asks stays
//! lost. Here every missing number is kept, and the publisher's cache is asked until it has answered, or has not for too long.

use std::collections::{BTreeSet, HashMap};

use zenoh::Wait;
use zenoh::query::{ConsolidationMode, QueryTarget, ReplyKeyExpr};
use zenoh::sample::Sample;

use crate::rmw::Attachment;

/// Missing numbers that are kept; more than that is more than any cache has.
const MOST: usize = 1_000_000;
/// Ranges of one publisher that are asked for at a time.
const RANGES: usize = 32;
/// Times that a publisher is asked without bringing anything.
const PATIENCE: u32 = 5;

/// The missing numbers of every publisher.
#[derive(Debug, Default)]
pub(super) struct Holes {
    sources: HashMap<[u8; 16], Source>,
    count: usize,
}

/// One publisher's.
#[derive(Debug)]
struct Source {
    /// What its cache answers to.
    selector: String,
    /// From our numbers to Zenoh's.
    offset: i64,
    missing: BTreeSet<i64>,
    asked_in_vain: u32,
}

impl Holes {
    /// `sample` came, and the numbers `from..attachment.sequence` before it did not.
    pub(super) fn add(&mut self, sample: &Sample, attachment: Attachment, from: i64) {
        let Some(info) = sample.source_info() else {
            return;
        };
        let (id, key) = (info.source_id(), sample.key_expr());
        let source = self
            .sources
            .entry(attachment.gid)
            .or_insert_with(|| Source {
                selector: format!("{key}/@adv/*/{}/{}/**", id.zid(), id.eid()),
                offset: attachment.sequence - i64::from(info.source_sn()),
                missing: BTreeSet::new(),
                asked_in_vain: 0,
            });
        for number in from..attachment.sequence {
            if self.count == MOST {
                return;
            }
            self.count += usize::from(source.missing.insert(number));
        }
        source.asked_in_vain = 0;
    }

    /// Whether the number was missing; it is no longer.
    pub(super) fn fill(&mut self, attachment: Attachment) -> bool {
        let Some(source) = self.sources.get_mut(&attachment.gid) else {
            return false;
        };
        let filled = source.missing.remove(&attachment.sequence);
        if filled {
            self.count -= 1;
            source.asked_in_vain = 0;
        }
        filled
    }

    /// Whether there is anything left to ask for.
    pub(super) fn are_open(&self) -> bool {
        self.sources.values().any(Source::is_open)
    }

    /// Asks every publisher for what is missing; the answers go to `take`.
    pub(super) fn ask(
        &mut self,
        session: &zenoh::Session,
        take: &(impl Fn(Sample) + Clone + Send + Sync + 'static),
    ) {
        for source in self.sources.values_mut().filter(|source| source.is_open()) {
            source.asked_in_vain += 1;
            for (from, to) in ranges(&source.missing).take(RANGES) {
                let (from, to) = (from - source.offset, to - source.offset);
                let take = take.clone();
                // Without a connection there is no answer; then it is asked again.
                let _ = session
                    .get(format!("{}?_sn={from}..{to}", source.selector))
                    .target(QueryTarget::All)
                    .consolidation(ConsolidationMode::None)
                    .accept_replies(ReplyKeyExpr::Any)
                    .callback(move |reply| {
                        if let Ok(sample) = reply.into_result() {
                            take(sample);
                        }
                    })
                    .wait();
            }
        }
    }
}

impl Source {
    fn is_open(&self) -> bool {
        !self.missing.is_empty() && self.asked_in_vain < PATIENCE
    }
}

/// Runs of consecutive numbers, first and last.
fn ranges(numbers: &BTreeSet<i64>) -> impl Iterator<Item = (i64, i64)> {
    let mut numbers = numbers.iter().copied().peekable();
    std::iter::from_fn(move || {
        let first = numbers.next()?;
        let mut last = first;
        while let Some(next) = numbers.next_if_eq(&(last + 1)) {
            last = next;
        }
        Some((first, last))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_asked_for_in_runs() {
        let numbers = BTreeSet::from([3, 4, 5, 9, 11, 12]);
        assert_eq!(
            ranges(&numbers).collect::<Vec<_>>(),
            [(3, 5), (9, 9), (11, 12)]
        );
        assert_eq!(ranges(&BTreeSet::new()).next(), None);
    }
}
