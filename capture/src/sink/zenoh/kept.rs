//! The latest messages of one publisher, for those who missed some.

use std::collections::VecDeque;

use zenoh::bytes::ZBytes;

use crate::recovery;

/// One message as it was published.
#[derive(Clone, Debug)]
pub(super) struct Message {
    /// Its number, from 1.
    pub(super) number: i64,
    /// When it was true, ns since the Unix epoch.
    pub(super) source_ns: i64,
    /// CDR.
    pub(super) payload: ZBytes,
}

/// At most so many of the latest, without holes.
#[derive(Debug)]
pub(super) struct Kept {
    messages: VecDeque<(i64, ZBytes)>,
    most: usize,
    latest: i64,
}

impl Kept {
    /// Nothing was published yet.
    pub(super) const fn new(most: usize) -> Self {
        Self {
            messages: VecDeque::new(),
            most,
            latest: 0,
        }
    }

    /// Keeps one more; the oldest makes room. Its number.
    pub(super) fn push(&mut self, source_ns: i64, payload: ZBytes) -> i64 {
        if self.messages.len() >= self.most {
            self.messages.pop_front();
        }
        self.messages.push_back((source_ns, payload));
        self.latest += 1;
        self.latest
    }

    /// The latest number; 0 = none.
    pub(super) const fn latest(&self) -> i64 {
        self.latest
    }

    /// The oldest number that is kept, or the next when there is none.
    pub(super) fn oldest(&self) -> i64 {
        self.latest + 1 - i64::try_from(self.messages.len()).unwrap_or(i64::MAX)
    }

    /// First and last number of what was asked for, as far as it is kept.
    pub(super) fn asked(
        &self,
        (first, last): (Option<u32>, Option<u32>),
        most: Option<u32>,
    ) -> (i64, i64) {
        let number =
            |wrapped| recovery::unwrapped(wrapped, self.latest, wrapped_number(self.latest));
        let last = last.map_or(self.latest, number).min(self.latest);
        let first = first.map_or(0, number).max(self.oldest());
        let first = most.map_or(first, |most| first.max(last + 1 - i64::from(most)));
        (first, last)
    }

    /// Of the numbers `first..=last` the first `most` that are kept.
    pub(super) fn portion(&self, first: i64, last: i64, most: usize) -> Vec<Message> {
        let oldest = self.oldest();
        let first = first.max(oldest);
        let skip = usize::try_from(first - oldest).unwrap_or(usize::MAX);
        let count = usize::try_from(last + 1 - first).unwrap_or(0);
        self.messages
            .iter()
            .skip(skip)
            .take(count.min(most))
            .zip(first..)
            .map(|((source_ns, payload), number)| Message {
                number,
                source_ns: *source_ns,
                payload: payload.clone(),
            })
            .collect()
    }
}

/// The number as Zenoh counts: from 0, in 32 bits.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it wraps"
)]
pub(super) const fn wrapped_number(number: i64) -> u32 {
    (number - 1) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(most: usize, published: i64) -> Kept {
        let mut kept = Kept::new(most);
        for number in 1..=published {
            assert_eq!(kept.push(number * 10, ZBytes::from([7])), number);
        }
        kept
    }

    fn numbers(messages: &[Message]) -> Vec<i64> {
        messages.iter().map(|message| message.number).collect()
    }

    #[test]
    fn the_oldest_make_room() {
        let kept = kept(5, 12);
        assert_eq!((kept.oldest(), kept.latest()), (8, 12));
        let portion = kept.portion(1, 12, 100);
        assert_eq!(numbers(&portion), [8, 9, 10, 11, 12]);
        assert_eq!(portion[0].source_ns, 80);
        assert_eq!(numbers(&kept.portion(9, 12, 2)), [9, 10]);
        assert_eq!(numbers(&kept.portion(11, 40, 9)), [11, 12]);
        assert_eq!(numbers(&kept.portion(13, 40, 9)), [0; 0]);
        assert_eq!(numbers(&Kept::new(3).portion(0, 9, 9)), [0; 0]);
    }

    #[test]
    fn what_is_asked_for_counts_from_zero() {
        let kept = kept(5, 12);
        assert_eq!(kept.asked((Some(8), Some(9)), None), (9, 10));
        assert_eq!(kept.asked((Some(2), None), None), (8, 12));
        assert_eq!(kept.asked((None, None), Some(2)), (11, 12));
        assert_eq!(kept.asked((Some(10), Some(4000)), None), (11, 12));
        let (first, last) = kept.asked((Some(9), Some(7)), None);
        assert!(first > last, "nothing");
    }
}
