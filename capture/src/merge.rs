//! Puts what several link threads delivered into the order of arrival.
//!
//! Each thread delivers in order, but between two threads the queue's order is that of the scheduler. An item is held
//! back until nothing earlier is expected, so that the recording's `log_time` never steps back as long as no thread is
//! late by more than the hold.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::time::Duration;

use ft_wire::HostTime;

use crate::item::Item;

/// A reorder buffer by `arrival`.
#[derive(Debug)]
pub struct Merge {
    hold: Duration,
    waiting: BinaryHeap<Reverse<Waiting>>,
    pushed: u64,
}

impl Merge {
    /// A buffer that holds each item for `hold` after its arrival.
    #[must_use]
    pub fn new(hold: Duration) -> Self {
        Self {
            hold,
            waiting: BinaryHeap::with_capacity(1024),
            pushed: 0,
        }
    }

    /// Takes an item in.
    pub fn push(&mut self, item: Item) {
        self.pushed += 1;
        self.waiting.push(Reverse(Waiting {
            order: (item.arrival, self.pushed),
            item,
        }));
    }

    /// The earliest item, if it arrived at least the hold before `now`.
    pub fn pop_due(&mut self, now: HostTime) -> Option<Item> {
        let earliest = self.waiting.peek()?;
        (earliest.0.order.0 + self.hold <= now)
            .then(|| self.waiting.pop())?
            .map(|Reverse(waiting)| waiting.item)
    }

    /// The earliest item, due or not: for the end.
    pub fn pop_any(&mut self) -> Option<Item> {
        self.waiting.pop().map(|Reverse(waiting)| waiting.item)
    }
}

/// Ordered by arrival, then by the order of delivery.
#[derive(Debug)]
struct Waiting {
    order: (HostTime, u64),
    item: Item,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.order == other.order
    }
}
impl Eq for Waiting {}
impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.order.cmp(&other.order)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::item::Body;

    fn mark(at: i64, text: &str) -> Item {
        let at = HostTime::from_nanos(at);
        Item {
            device: None,
            arrival: at,
            clock_epoch: 0,
            sample_time: at,
            body: Body::Mark(text.to_owned()),
        }
    }

    fn text(item: Option<Item>) -> Option<String> {
        match item?.body {
            Body::Mark(text) => Some(text),
            _ => None,
        }
    }

    #[test]
    fn a_late_thread_is_put_in_order() {
        let mut merge = Merge::new(Duration::from_nanos(10));
        merge.push(mark(20, "second"));
        merge.push(mark(15, "first"));
        assert_eq!(text(merge.pop_due(HostTime::from_nanos(24))), None);
        assert_eq!(
            text(merge.pop_due(HostTime::from_nanos(30))).as_deref(),
            Some("first")
        );
        assert_eq!(
            text(merge.pop_due(HostTime::from_nanos(30))).as_deref(),
            Some("second")
        );
        assert_eq!(text(merge.pop_any()), None);
    }

    #[test]
    fn what_came_at_one_instant_keeps_the_order_of_delivery() {
        let mut merge = Merge::new(Duration::ZERO);
        for name in ["a", "b", "c"] {
            merge.push(mark(7, name));
        }
        let order: Vec<_> = std::iter::from_fn(|| text(merge.pop_any())).collect();
        assert_eq!(order, ["a", "b", "c"]);
    }
}
