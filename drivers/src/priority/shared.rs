//! A processor that threads share which hand samples to each other, as long as it has time for them.

use std::sync::{Arc, Mutex, PoisonError};

use rustix::thread::{CpuSet, Pid};

use super::processors;

/// Keeps its threads on one processor: to hand a sample over then wakes no other one, which takes 30 to 50 us where that idles. They begin where the first
/// of them ran, go on to the next processor where something else keeps theirs busy, and are left to the system while all are busy.
#[derive(Clone, Debug, Default)]
pub struct SharedProcessor(Arc<Mutex<Shared>>);

#[derive(Debug, Default)]
struct Shared {
    threads: Vec<Thread>,
    place: Place,
}

#[derive(Debug)]
struct Thread {
    id: Pid,
    /// Since it began; nothing where the system does not say.
    waited: Option<Waited>,
}

/// How long a thread that could have run did not, and how often it ran.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Waited {
    ns: u64,
    times: u64,
}

impl SharedProcessor {
    /// The calling thread is one of them from now on. Takes a lock: for a thread that begins.
    pub fn join(&self) {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let id = rustix::thread::gettid();
        shared
            .place
            .begin(rustix::thread::sched_getcpu(), &processors());
        shared.threads.push(Thread {
            id,
            waited: waited(id),
        });
        keep(id, &shared.place.processors());
    }

    /// Looks how long they waited for it since the last look. Takes a lock and reads files: not for a thread that reads a port.
    pub fn look(&self) {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Waited::default();
        // A thread that has ended has no file any more.
        shared.threads.retain_mut(|thread| {
            let now = waited(thread.id);
            if let (Some(now), Some(before)) = (now, thread.waited) {
                all.ns += now.ns.saturating_sub(before.ns);
                all.times += now.times.saturating_sub(before.times);
            }
            thread.waited = now;
            now.is_some()
        });
        let Shared { threads, place } = &mut *shared;
        if place.looked(all) {
            for thread in threads.iter() {
                keep(thread.id, &place.processors());
            }
        }
    }
}

/// Where threads are kept.
#[derive(Debug, Default, PartialEq, Eq)]
enum Place {
    #[default]
    NotYet,
    /// On one of these.
    On {
        all: Vec<usize>,
        at: usize,
        /// Busy ones that they left one after the other to come here.
        left: usize,
    },
    /// On any of these for so many looks more.
    Anywhere { all: Vec<usize>, looks: u32 },
}

/// They waited this long in the mean of all times that one of them was to run: something else keeps the processor busy. By themselves they wait for each other
/// for some 10 us.
const BUSY_NS: u64 = 300_000;
/// They are left to the system for so many looks.
const REST: u32 = 30;

impl Place {
    fn begin(&mut self, here: usize, all: &[usize]) {
        if *self == Self::NotYet {
            let all = all.to_vec();
            let at = all.iter().position(|one| *one == here).unwrap_or(0);
            *self = Self::On { all, at, left: 0 };
        }
    }

    /// Where a thread may run.
    fn processors(&self) -> Vec<usize> {
        match self {
            Self::NotYet => Vec::new(),
            Self::On { all, at, .. } => all.get(*at).copied().into_iter().collect(),
            Self::Anywhere { all, .. } => all.clone(),
        }
    }

    /// Whether it is another place now, after they `waited`.
    fn looked(&mut self, waited: Waited) -> bool {
        let is_busy = waited.ns > BUSY_NS * waited.times;
        match self {
            Self::On { all, at, left } if is_busy => {
                *at = (*at + 1) % all.len().max(1);
                *left += 1;
                if *left >= all.len() {
                    let (all, looks) = (core::mem::take(all), REST);
                    *self = Self::Anywhere { all, looks };
                }
                true
            }
            Self::On { left, .. } => {
                *left = 0;
                false
            }
            Self::Anywhere { all, looks: 0 } => {
                let all = core::mem::take(all);
                *self = Self::On {
                    all,
                    at: 0,
                    left: 0,
                };
                true
            }
            Self::Anywhere { looks, .. } => {
                *looks -= 1;
                false
            }
            Self::NotYet => false,
        }
    }
}

/// Keeps a thread of this program on some processors; what the system refuses stays as it is.
fn keep(thread: Pid, on: &[usize]) {
    let mut set = CpuSet::new();
    for &one in on.iter().filter(|one| **one < CpuSet::MAX_CPU) {
        set.set(one);
    }
    let _ = rustix::thread::sched_setaffinity(Some(thread), &set);
}

/// Of a thread of this program: `/proc/self/task/ID/schedstat` has ns on a processor, ns waiting for one, and times on one.
fn waited(thread: Pid) -> Option<Waited> {
    let path = format!("/proc/self/task/{}/schedstat", thread.as_raw_pid());
    let text = std::fs::read_to_string(path).ok()?;
    let mut fields = text.split_ascii_whitespace().skip(1);
    Some(Waited {
        ns: fields.next()?.parse().ok()?,
        times: fields.next()?.parse().ok()?,
    })
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;

    use super::*;

    #[test]
    fn threads_that_join_are_on_one_processor_and_others_where_they_were() {
        let shared = SharedProcessor::default();
        let of_a_thread = || {
            let shared = shared.clone();
            let joined = std::thread::spawn(move || {
                shared.join();
                processors()
            });
            joined.join().unwrap()
        };
        let before = processors();
        let (one, other) = (of_a_thread(), of_a_thread());
        assert_eq!((one.len(), &one), (1, &other));
        assert_eq!(processors(), before);
    }

    #[test]
    fn a_thread_that_waits_is_seen_to() {
        let (end, ended) = mpsc::channel::<()>();
        let (id, begun) = mpsc::channel();
        let thread = std::thread::spawn(move || {
            id.send(rustix::thread::gettid()).unwrap();
            let _ = ended.recv();
        });
        let id = begun.recv().unwrap();
        assert!(waited(id).unwrap().times > 0);
        drop(end);
        thread.join().unwrap();
        assert_eq!(waited(id), None);
    }

    #[test]
    fn they_leave_a_busy_processor_and_come_back_after_all_were_busy() {
        let [busy, calm] = [2 * BUSY_NS, BUSY_NS / 30].map(|each| Waited {
            ns: 50 * each,
            times: 50,
        });
        let mut place = Place::default();
        assert!(!place.looked(busy));
        place.begin(3, &[1, 3, 5]);
        place.begin(1, &[1, 3, 5]);
        assert_eq!(place.processors(), [3]);
        assert!(!place.looked(calm) && !place.looked(Waited::default()));
        assert!(place.looked(busy));
        assert_eq!(place.processors(), [5]);
        // Each was busy in turn.
        assert!(place.looked(busy) && place.looked(busy));
        assert_eq!(place.processors(), [1, 3, 5]);
        for _ in 0..REST {
            assert!(!place.looked(calm));
        }
        assert!(place.looked(calm));
        assert_eq!(place.processors(), [1]);
        // One that has time in between is left for another one only when it is busy again.
        assert!(place.looked(busy) && !place.looked(calm) && place.looked(busy));
        assert_eq!(place.processors(), [5]);
    }
}
