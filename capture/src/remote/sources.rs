//! The publishers that a recorder hears: what each has numbered, what of it came, what is to be asked for again and when.
//!
//! Without I/O: time is an argument, and what is to be sent comes out of [`Sources::due`].

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use ft_wire::HostTime;

use super::missing::Missing;
use crate::recovery;

/// Publishers of which account is kept.
const MOST: usize = 1024;
/// How long after a hole it is asked for, so that holes that come together are asked for together.
const GATHER: Duration = Duration::from_millis(20);
/// How long a message may take that a heartbeat announced.
const GRACE: Duration = Duration::from_millis(300);
/// After an answer that brought nothing, at least and at most.
const BACK_OFF: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));
/// An answer that is not complete by then will not be.
pub(super) const ANSWER_WITHIN: Duration = Duration::from_secs(5);
/// A publisher of which nothing was heard for this long cannot be reached at the moment.
const SILENT: Duration = Duration::from_millis(1500);
/// One of which nothing was heard for this long does not come back: it is asked no longer.
const GONE: Duration = Duration::from_secs(300);
/// How often it is told how far this recorder is, at most.
const REPORT_PERIOD: Duration = Duration::from_millis(50);
/// How often a publisher is asked that was announced and not heard.
const STRANGER_PERIOD: Duration = Duration::from_secs(5);
/// Runs and messages that are asked for at a time: what comes in some tenths of a second over a slow network.
const PORTION: (usize, i64) = (16, 4096);
/// Messages before its latest that a publisher is asked for that was announced and not heard.
const STRANGER_PORTION: u32 = 1000;

/// A publisher as ROS names it.
pub(super) type Gid = [u8; 16];

/// A message as far as its place matters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrived {
    /// Whose it is.
    pub(super) gid: Gid,
    /// Its number there.
    pub(super) number: i64,
    /// The same as Zenoh counts; `None` = it cannot be asked for.
    pub(super) wrapped: Option<u32>,
}

/// Where a message stands among its publisher's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// The first that came of this publisher.
    First,
    /// The one after the last.
    Next,
    /// After a hole of so many.
    Skips(u64),
    /// It fills a hole.
    Fills,
    /// It was published before the first that came.
    Earlier,
    /// It came twice.
    Twice,
    /// Of a publisher too many: its numbers are not followed.
    Unknown,
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Due {
    /// So many messages of the topic were announced and did not come.
    Lost(Arc<str>, u64),
    /// Ask for the numbers from, to.
    Ask(Option<Gid>, String, u32, u32),
    /// Say before which number nothing is needed.
    Report(Gid, String, Option<u32>),
}

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Sources {
    known: HashMap<Gid, Source>,
    /// Publishers that were only announced, and when each was last asked.
    strangers: HashMap<String, HostTime>,
    due: Vec<Due>,
}

#[derive(Debug)]
struct Source {
    topic: Arc<str>,
    /// What about it is found under; `None` = its messages cannot be asked for.
    publisher: Option<String>,
    /// A number and the same as Zenoh counts.
    anchor: (i64, u32),
    first: i64,
    last: i64,
    missing: Missing,
    /// The oldest number that it still has.
    oldest: Option<i64>,
    promised: Option<(i64, HostTime)>,
    heard: HostTime,
    /// What was asked, and how many answers are outstanding.
    asked: Vec<(i64, i64)>,
    outstanding: usize,
    filled: bool,
    in_vain: u32,
    ask_due: HostTime,
    wants_report: bool,
    report_due: HostTime,
}

impl Sources {
    /// Takes a message of `topic`; `publisher` gives [`recovery::publisher`] of one that was not heard before.
    pub(super) fn take(
        &mut self,
        arrived: Arrived,
        topic: &Arc<str>,
        publisher: impl FnOnce() -> Option<String>,
        now: HostTime,
    ) -> Place {
        if let Some(source) = self.known.get_mut(&arrived.gid) {
            return source.take(arrived.number, now);
        }
        if self.known.len() == MOST {
            return Place::Unknown;
        }
        let publisher = publisher();
        if let Some(publisher) = &publisher {
            self.strangers.remove(publisher);
        }
        let source = Source::new(arrived, Arc::clone(topic), publisher, now);
        self.known.insert(arrived.gid, source);
        Place::First
    }

    /// A publisher said which number its latest message has.
    pub(super) fn heartbeat(&mut self, publisher: &str, wrapped: u32, now: HostTime) {
        let mut known = self.known.values_mut();
        let source = known.find(|source| source.publisher.as_deref() == Some(publisher));
        match source {
            Some(source) => source.heartbeat(wrapped, now),
            None => self.ask_stranger(publisher, wrapped, now),
        }
    }

    /// A publisher said which is the oldest number that it has.
    pub(super) fn oldest(&mut self, gid: Gid, wrapped: u32, now: HostTime) {
        if let Some(source) = self.known.get_mut(&gid) {
            source.take_oldest(wrapped, now);
        }
    }

    /// An answer is complete, whatever was in it.
    pub(super) fn answered(&mut self, gid: Gid, now: HostTime) {
        if let Some(source) = self.known.get_mut(&gid) {
            source.answered(now);
        }
    }

    /// What is to be done now.
    pub(super) fn due(&mut self, now: HostTime) -> Vec<Due> {
        let mut due = std::mem::take(&mut self.due);
        for (gid, source) in &mut self.known {
            source.due(*gid, now, &mut due);
        }
        due
    }

    /// Whether something may still come that is worth waiting for.
    pub(super) fn are_open(&self, now: HostTime) -> bool {
        self.known.values().any(|source| {
            let missing = source.missing.first().is_some() || source.promised.is_some();
            missing && source.publisher.is_some() && !source.is_silent(now)
        })
    }

    fn ask_stranger(&mut self, publisher: &str, wrapped: u32, now: HostTime) {
        let asked = self.strangers.get(publisher);
        if asked.is_some_and(|then| now.saturating_since(*then) < STRANGER_PERIOD) {
            return;
        }
        if asked.is_some() || self.strangers.len() < MOST {
            self.strangers.insert(publisher.to_owned(), now);
            let first = wrapped.saturating_sub(STRANGER_PORTION);
            self.due
                .push(Due::Ask(None, publisher.to_owned(), first, wrapped));
        }
    }
}

impl Source {
    fn new(arrived: Arrived, topic: Arc<str>, publisher: Option<String>, now: HostTime) -> Self {
        Self {
            topic,
            publisher: publisher.filter(|_| arrived.wrapped.is_some()),
            anchor: (arrived.number, arrived.wrapped.unwrap_or(0)),
            first: arrived.number,
            last: arrived.number,
            missing: Missing::default(),
            oldest: None,
            promised: None,
            heard: now,
            asked: Vec::new(),
            outstanding: 0,
            filled: false,
            in_vain: 0,
            ask_due: now,
            wants_report: true,
            report_due: now,
        }
    }

    fn take(&mut self, number: i64, now: HostTime) -> Place {
        self.heard = now;
        if number <= self.last {
            if !self.missing.fill(number) {
                return Place::Twice;
            }
            self.filled = true;
            return if number < self.first {
                Place::Earlier
            } else {
                Place::Fills
            };
        }
        let lost = self.reach(number - 1, now);
        self.last = number;
        match lost {
            0 => Place::Next,
            lost => Place::Skips(lost),
        }
    }

    /// The numbers up to `number` should have come: how many of them are new holes.
    fn reach(&mut self, number: i64, now: HostTime) -> u64 {
        let first = self.last + 1;
        if number < first {
            return 0;
        }
        if self.missing.first().is_none() {
            self.in_vain = 0;
            self.ask_due = now + GATHER;
        }
        self.missing.add(first, number);
        self.last = number;
        u64::try_from(number + 1 - first).unwrap_or(0)
    }

    fn heartbeat(&mut self, wrapped: u32, now: HostTime) {
        self.heard = now;
        self.wants_report = true;
        let number = self.unwrapped(wrapped);
        if number > self.last && self.promised.is_none() {
            self.promised = Some((number, now + GRACE));
        }
    }

    fn take_oldest(&mut self, wrapped: u32, now: HostTime) {
        self.heard = now;
        let oldest = self.unwrapped(wrapped);
        if self.oldest.is_none() {
            self.missing.add(oldest.max(1), self.first - 1);
            self.wants_report = true;
        }
        self.oldest = Some(oldest);
        self.missing.forget_before(oldest);
    }

    fn answered(&mut self, now: HostTime) {
        self.outstanding = self.outstanding.saturating_sub(1);
        if self.outstanding > 0 {
            return;
        }
        // Who cannot be reached does not answer, and may have everything; over a slow network not all of an answer is in time.
        if !self.is_silent(now) && !self.filled {
            self.missing.count_in_vain(&self.asked);
        }
        self.asked.clear();
        self.ask_due = if self.filled {
            self.in_vain = 0;
            now
        } else {
            self.in_vain = (self.in_vain + 1).min(8);
            now + (BACK_OFF.0 * 2_u32.pow(self.in_vain - 1)).min(BACK_OFF.1)
        };
        self.wants_report = true;
    }

    fn due(&mut self, gid: Gid, now: HostTime, due: &mut Vec<Due>) {
        if let Some((number, _)) = self.promised.take_if(|(_, until)| now >= *until) {
            let lost = self.reach(number, now);
            if lost > 0 {
                due.push(Due::Lost(Arc::clone(&self.topic), lost));
            }
        }
        let Some(publisher) = self.publisher.clone() else {
            return;
        };
        if self.wants_report && now >= self.report_due {
            self.wants_report = false;
            self.report_due = now + REPORT_PERIOD;
            let needed = self.missing.first().unwrap_or(self.last + 1);
            let before = self.oldest.map(|_| self.wrapped(needed));
            due.push(Due::Report(gid, publisher.clone(), before));
        }
        let waits = self.outstanding > 0 && now < self.ask_due + 2 * ANSWER_WITHIN;
        let is_gone = now.saturating_since(self.heard) > GONE;
        if waits || is_gone || now < self.ask_due {
            return;
        }
        self.asked = self.missing.portion(PORTION.0, PORTION.1);
        self.outstanding = self.asked.len();
        self.filled = false;
        if self.outstanding > 0 {
            self.ask_due = now;
        }
        for &(first, last) in &self.asked {
            let (first, last) = (self.wrapped(first), self.wrapped(last));
            due.push(Due::Ask(Some(gid), publisher.clone(), first, last));
        }
    }

    fn is_silent(&self, now: HostTime) -> bool {
        now.saturating_since(self.heard) > SILENT
    }

    fn unwrapped(&self, wrapped: u32) -> i64 {
        let (number, anchor) = self.anchor;
        let behind = self.last - number;
        recovery::unwrapped(wrapped, self.last, wrapping(anchor, behind))
    }

    fn wrapped(&self, number: i64) -> u32 {
        let (anchor_number, anchor) = self.anchor;
        wrapping(anchor, number - anchor_number)
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "it wraps"
)]
const fn wrapping(anchor: u32, ahead: i64) -> u32 {
    anchor.wrapping_add(ahead as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GID: Gid = [7; 16];
    const PUBLISHER: &str = "0/t/@adv/pub/z/1";

    fn at(milliseconds: i64) -> HostTime {
        HostTime::from_nanos(1_000_000_000 + milliseconds * 1_000_000)
    }

    /// Zenoh counts from 0, we from 1.
    fn wrapped(number: i64) -> u32 {
        u32::try_from(number - 1).unwrap()
    }

    fn take(sources: &mut Sources, number: i64, now: HostTime) -> Place {
        let arrived = Arrived {
            gid: GID,
            number,
            wrapped: Some(wrapped(number)),
        };
        sources.take(arrived, &"/t".into(), || Some(PUBLISHER.to_owned()), now)
    }

    fn ask(first: i64, last: i64) -> Due {
        Due::Ask(
            Some(GID),
            PUBLISHER.to_owned(),
            wrapped(first),
            wrapped(last),
        )
    }

    fn report(before: Option<i64>) -> Due {
        Due::Report(GID, PUBLISHER.to_owned(), before.map(wrapped))
    }

    /// A publisher whose first message was heard, and that has nothing from before.
    fn heard() -> Sources {
        let mut sources = Sources::default();
        assert_eq!(take(&mut sources, 5, at(0)), Place::First);
        assert_eq!(sources.due(at(0)), [report(None)]);
        sources.oldest(GID, wrapped(5), at(1));
        assert_eq!(sources.due(at(60)), [report(Some(6))]);
        sources
    }

    #[test]
    fn a_hole_is_asked_for_once_it_is_gathered_and_closes_message_by_message() {
        let mut sources = heard();
        assert_eq!(take(&mut sources, 6, at(70)), Place::Next);
        assert_eq!(take(&mut sources, 9, at(71)), Place::Skips(2));
        assert_eq!(take(&mut sources, 11, at(72)), Place::Skips(1));
        assert_eq!(sources.due(at(72)), []);
        assert_eq!(sources.due(at(92)), [ask(7, 8), ask(10, 10)]);
        assert_eq!(sources.due(at(200)), [], "one answer at a time");
        for number in [7, 8] {
            assert_eq!(take(&mut sources, number, at(210)), Place::Fills);
        }
        assert_eq!(take(&mut sources, 8, at(210)), Place::Twice);
        assert!(sources.are_open(at(210)));
        sources.answered(GID, at(211));
        sources.answered(GID, at(212));
        // What did not come is asked for at once, because something did.
        assert_eq!(sources.due(at(212)), [report(Some(10)), ask(10, 10)]);
        assert_eq!(take(&mut sources, 10, at(213)), Place::Fills);
        sources.answered(GID, at(213));
        assert!(!sources.are_open(at(213)));
        assert_eq!(sources.due(at(300)), [report(Some(12))]);
    }

    #[test]
    fn what_was_lost_last_is_found_by_the_heartbeat() {
        let mut sources = heard();
        sources.heartbeat(PUBLISHER, wrapped(8), at(120));
        assert_eq!(sources.due(at(120)), [report(Some(6))]);
        assert_eq!(take(&mut sources, 6, at(150)), Place::Next);
        assert_eq!(sources.due(at(419)), []);
        assert_eq!(sources.due(at(420)), [Due::Lost("/t".into(), 2)]);
        assert_eq!(sources.due(at(440)), [ask(7, 8)]);
        assert_eq!(take(&mut sources, 9, at(450)), Place::Next);
        assert_eq!(take(&mut sources, 7, at(460)), Place::Fills);
    }

    #[test]
    fn the_file_begins_with_what_the_publisher_still_has() {
        let mut sources = Sources::default();
        take(&mut sources, 100, at(0));
        sources.oldest(GID, wrapped(40), at(1));
        assert_eq!(sources.due(at(2))[1..], [ask(40, 99)]);
        assert_eq!(take(&mut sources, 40, at(3)), Place::Earlier);
        // Meanwhile the publisher forgets.
        sources.oldest(GID, wrapped(60), at(4));
        sources.answered(GID, at(5));
        assert_eq!(sources.due(at(60))[1..], [ask(60, 99)]);
    }

    #[test]
    fn while_a_publisher_cannot_be_reached_patience_does_not_end() {
        let mut sources = heard();
        take(&mut sources, 9, at(100));
        let mut now = at(100);
        for _ in 0..100 {
            now = now + Duration::from_secs(2);
            let due = sources.due(now);
            assert!(due.contains(&ask(6, 8)), "{due:?}");
            sources.answered(GID, now);
        }
        assert!(!sources.are_open(now), "nobody waits for it at the end");
        for number in [10, 11] {
            take(&mut sources, number, now);
        }
        assert!(sources.are_open(now));
        // Now it is there, and says that it has nothing of it.
        for _ in 0..20 {
            now = now + Duration::from_secs(2);
            take(&mut sources, 11, now);
            sources.due(now);
            sources.answered(GID, now);
        }
        assert!(!sources.are_open(now));
        assert_eq!(
            take(&mut sources, 7, now),
            Place::Fills,
            "late all the same"
        );
    }

    #[test]
    fn an_ask_that_is_answered_by_half_is_not_counted_in_vain() {
        let mut sources = heard();
        take(&mut sources, 40, at(100));
        let mut now = at(120);
        // One of the many that were asked for comes at a time, as over a slow network.
        for number in 6..39 {
            assert!(sources.due(now).contains(&ask(number, 39)), "{number}");
            take(&mut sources, number, now);
            sources.answered(GID, now);
            now = now + Duration::from_millis(100);
            take(&mut sources, 40, now);
        }
        assert!(sources.are_open(now), "39 is waited for to the end");
        assert!(sources.due(now).contains(&ask(39, 39)));
    }

    #[test]
    fn a_publisher_that_is_only_announced_is_asked_now_and_then() {
        let mut sources = Sources::default();
        for second in 0..10 {
            sources.heartbeat(PUBLISHER, 2, at(second * 1000));
        }
        let due = sources.due(at(10_000));
        assert_eq!(due, vec![Due::Ask(None, PUBLISHER.to_owned(), 0, 2); 2]);
    }

    #[test]
    fn of_a_publisher_too_many_nothing_is_said_to_be_missing() {
        let mut sources = Sources::default();
        let take = |sources: &mut Sources, publisher: usize, number| {
            let mut gid = GID;
            gid[..8].copy_from_slice(&publisher.to_le_bytes());
            let arrived = Arrived {
                gid,
                number,
                wrapped: None,
            };
            sources.take(arrived, &"/t".into(), || None, at(0))
        };
        for publisher in 0..MOST {
            assert_eq!(take(&mut sources, publisher, 9), Place::First);
        }
        for number in [9, 10, 12] {
            assert_eq!(take(&mut sources, MOST, number), Place::Unknown);
        }
        assert_eq!(take(&mut sources, 0, 10), Place::Next);
    }

    #[test]
    fn who_cannot_be_asked_is_only_counted() {
        let mut sources = Sources::default();
        let arrived = |number| Arrived {
            gid: GID,
            number,
            wrapped: None,
        };
        sources.take(arrived(1), &"/t".into(), || None, at(0));
        let place = sources.take(arrived(4), &"/t".into(), || None, at(1));
        assert_eq!(place, Place::Skips(2));
        assert_eq!(sources.due(at(5000)), []);
        assert!(!sources.are_open(at(2)));
    }
}
