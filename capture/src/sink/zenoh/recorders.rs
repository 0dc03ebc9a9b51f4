//! Recorders on other machines: a thread that gives them again what they missed, and what is known of how far each is.
//!
//! One thread for all, so that neither the publisher nor Zenoh's threads wait for a recorder that takes nothing; such a
//! recorder holds up the others until Zenoh lets it go (`wait_before_close`).

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crossbeam_channel::{Receiver, Sender, bounded};
use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;
use zenoh::Wait;
use zenoh::query::Query;
use zenoh::sample::SourceInfo;
use zenoh::session::EntityGlobalId;

use super::kept::{Kept, Message, wrapped_number};
use crate::recovery;
use crate::rmw;

/// Queries that may wait; who asked in vain asks again.
const CAPACITY: usize = 1024;
/// Messages that are taken from what is kept at a time: so long the publisher waits.
const PORTION: usize = 256;
/// Reports that are remembered.
const MOST_REPORTS: usize = 1024;
/// A recorder that has said nothing for this long is gone.
const SILENT: Duration = Duration::from_secs(3);

/// What one publisher has, and who it is.
#[derive(Debug)]
pub(super) struct Shelf {
    /// The key of its messages.
    pub(super) key: String,
    /// Zenoh's name of it.
    pub(super) id: EntityGlobalId,
    /// ROS's name of it.
    pub(super) gid: [u8; 16],
    /// Its latest messages.
    pub(super) kept: Mutex<Kept>,
}

impl Shelf {
    /// Looks at what is kept.
    pub(super) fn with<T>(&self, look: impl FnOnce(&mut Kept) -> T) -> T {
        look(&mut self.kept.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// What can be asked of a publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum About {
    /// Its messages ([`recovery::messages`]).
    Messages,
    /// What it has ([`recovery::have`]).
    Have,
}

/// A question, and of which publisher.
#[derive(Debug)]
struct Asked {
    query: Query,
    of: usize,
    about: About,
}

/// By publisher and recorder: before which number it needs nothing, and when it said so.
type Reports = HashMap<(usize, String), (i64, HostTime)>;

/// See the module.
#[derive(Debug)]
pub(super) struct Recorders {
    shelves: Vec<Arc<Shelf>>,
    asked: Sender<Asked>,
    reports: Arc<Mutex<Reports>>,
    clock: MonotonicClock,
}

impl Recorders {
    /// Starts the thread that answers for `shelves`; it ends when this and the queryables are gone.
    pub(super) fn start(shelves: Vec<Arc<Shelf>>, clock: MonotonicClock) -> std::io::Result<Self> {
        let (asked, queries) = bounded(CAPACITY);
        let reports = Arc::new(Mutex::new(Reports::new()));
        let desk = shelves.clone();
        std::thread::Builder::new()
            .name("ft-answers".to_owned())
            .spawn(move || answer_until_closed(&desk, &queries))?;
        Ok(Self {
            shelves,
            asked,
            reports,
            clock,
        })
    }

    /// Where queries about the publisher `of` go; it does not wait for who asks. A report counts at once: its answer may
    /// have to wait until all that was asked for before has crossed a slow network.
    pub(super) fn desk(&self, of: usize, about: About) -> impl Fn(Query) + Send + Sync + 'static {
        let asked = self.asked.clone();
        let shelf = self.shelves.get(of).filter(|_| about == About::Have);
        let shelf = shelf.cloned();
        let (reports, clock) = (Arc::clone(&self.reports), self.clock);
        move |query| {
            let parameters = query.parameters();
            if let (Some(by), Some(shelf)) = (parameters.get(recovery::BY), &shelf) {
                let before = reported(parameters.get(recovery::BEFORE), shelf);
                remember(
                    &mut reports.lock().unwrap_or_else(PoisonError::into_inner),
                    (of, by.to_owned()),
                    (before, clock.now()),
                );
            }
            let _ = asked.try_send(Asked { query, of, about });
        }
    }

    /// How far all recorders are together: a sum that grows while any of them gets what it lacks.
    pub(super) fn progress(&self) -> i64 {
        let reports = self.reports.lock().unwrap_or_else(PoisonError::into_inner);
        reports.values().map(|(before, _)| *before).sum()
    }

    /// Whether a recorder that is still there lacks messages of the publisher `index` up to `latest`.
    pub(super) fn wait_for(&self, index: usize, latest: i64, now: HostTime) -> bool {
        let reports = self.reports.lock().unwrap_or_else(PoisonError::into_inner);
        reports.iter().any(|((of, _), (before, at))| {
            *of == index && *before <= latest && now.saturating_since(*at) < SILENT
        })
    }
}

fn answer_until_closed(shelves: &[Arc<Shelf>], queries: &Receiver<Asked>) {
    while let Ok(Asked { query, of, about }) = queries.recv() {
        let Some(shelf) = shelves.get(of) else {
            continue;
        };
        // Who asked may be gone: then there is nobody to tell.
        let _ = match about {
            About::Messages => give(&query, shelf),
            About::Have if query.parameters().contains_key(recovery::BY) => {
                give_oldest(&query, shelf)
            }
            // A pattern that met the messages, too: they were given there.
            About::Have => Ok(()),
        };
    }
}

/// Before which number a recorder needs nothing, by what it wrote; 0 = it does not know yet.
fn reported(before: Option<&str>, shelf: &Shelf) -> i64 {
    let latest = shelf.with(|kept| kept.latest());
    let before = before.and_then(|text| text.parse().ok());
    before.map_or(0, |before| {
        recovery::unwrapped(before, latest, wrapped_number(latest))
    })
}

fn give_oldest(query: &Query, shelf: &Shelf) -> zenoh::Result<()> {
    let oldest = shelf.with(|kept| kept.oldest());
    let payload = wrapped_number(oldest).to_le_bytes();
    query
        .reply(query.key_expr().clone(), payload.as_slice())
        .wait()
}

fn remember(reports: &mut Reports, of: (usize, String), report: (i64, HostTime)) {
    if reports.len() >= MOST_REPORTS && !reports.contains_key(&of) {
        let now = report.1;
        reports.retain(|_, (_, at)| now.saturating_since(*at) < SILENT);
    }
    if reports.len() < MOST_REPORTS || reports.contains_key(&of) {
        reports.insert(of, report);
    }
}

/// Gives what is asked for; nothing is held while it waits for who asked.
fn give(query: &Query, shelf: &Shelf) -> zenoh::Result<()> {
    let parameters = query.parameters();
    let most = parameters.get("_max").and_then(|text| text.parse().ok());
    let (mut first, last) = shelf.with(|kept| kept.asked(recovery::asked_range(parameters), most));
    loop {
        let portion = shelf.with(|kept| kept.portion(first, last, PORTION));
        let Some(next) = portion.last().map(|message| message.number + 1) else {
            return Ok(());
        };
        for Message {
            number,
            source_ns,
            payload,
        } in portion
        {
            let attachment = rmw::attachment(number, source_ns, shelf.gid);
            query
                .reply(shelf.key.as_str(), payload)
                .attachment(attachment.as_slice())
                .source_info(SourceInfo::new(shelf.id, wrapped_number(number)))
                .wait()?;
        }
        first = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_invents_recorders_costs_no_memory() {
        let mut reports = Reports::new();
        let at = HostTime::from_nanos(1);
        for number in 0..2 * MOST_REPORTS {
            remember(&mut reports, (0, number.to_string()), (5, at));
        }
        assert_eq!(reports.len(), MOST_REPORTS);
        let later = at + SILENT;
        remember(&mut reports, (0, "new".to_owned()), (5, later));
        assert_eq!(reports.len(), 1, "those who are gone make room");
    }
}
