//! A processor that threads share which hand samples to each other, as long as it has time for them.

use std::sync::{Arc, Mutex, PoisonError};

use rustix::thread::{CpuSet, Pid};

/// Keeps its threads on one processor: to hand a sample over then wakes no other one, which takes 30 to 50 us where that idles. They begin where the first
/// of them ran, go on to another processor where something keeps theirs busy, and are left to the system for a while where that is no better: one processor
/// may be too little for them.
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
    /// Since it began.
    waited: Waited,
}

/// How long a thread that could have run did not, and how often it ran.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Waited {
    ns: u64,
    times: u64,
}

impl SharedProcessor {
    /// The calling thread is one of them from now on, where the system says how long threads wait. Takes a lock: for a thread that begins.
    pub fn join(&self) {
        let id = rustix::thread::gettid();
        let Some(waited) = waited(id) else {
            return;
        };
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        shared
            .place
            .begin(rustix::thread::sched_getcpu(), &processors());
        shared.threads.push(Thread { id, waited });
        keep(id, shared.place.processors());
    }

    /// Looks how long they waited for it since the last look. Takes a lock and reads files: not for a thread that reads a port.
    pub fn look(&self) {
        self.look_at(waited);
    }

    fn look_at(&self, waited: impl Fn(Pid) -> Option<Waited>) {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Waited::default();
        // A thread that has ended has no file any more.
        shared.threads.retain_mut(|thread| {
            let Some(now) = waited(thread.id) else {
                return false;
            };
            all.ns += now.ns.saturating_sub(thread.waited.ns);
            all.times += now.times.saturating_sub(thread.waited.times);
            thread.waited = now;
            true
        });
        let Shared { threads, place } = &mut *shared;
        if place.looked(all) {
            for thread in threads.iter() {
                keep(thread.id, place.processors());
            }
        }
    }
}

/// Where threads are kept.
#[derive(Debug, Default)]
struct Place {
    /// The processors that there are; none until the first thread joins.
    all: Vec<usize>,
    /// Which of these they are on when they are not left to the system.
    at: usize,
    /// How many they left in a row because they were busy.
    left: usize,
    /// Looks for which they are left to the system.
    rests: u32,
    /// How many that were the last time.
    rested: u32,
}

/// They waited this long in the mean of all times that one of them was to run: the processor is busy. By themselves they wait for each other for some 10 us.
const BUSY_NS: u64 = 300_000;
/// They are left to the system once so many processors in a row were busy,
const MOST_LEFT: usize = 2;
/// for so many looks at first, and twice as many each time after.
const FIRST_REST: u32 = 30;
const LONGEST_REST: u32 = 3600;

impl Place {
    fn begin(&mut self, here: usize, all: &[usize]) {
        if self.all.is_empty() {
            self.all = all.to_vec();
            self.at = all.iter().position(|one| *one == here).unwrap_or(0);
        }
    }

    /// Where a thread may run.
    fn processors(&self) -> &[usize] {
        if self.rests > 0 {
            return &self.all;
        }
        self.all.get(self.at..=self.at).unwrap_or(&[])
    }

    /// Whether it is another place now, after they `waited`.
    fn looked(&mut self, waited: Waited) -> bool {
        if self.rests > 0 {
            self.rests -= 1;
            return self.rests == 0;
        }
        if waited.ns <= BUSY_NS * waited.times {
            self.left = 0;
            return false;
        }
        self.at = (self.at + 1) % self.all.len().max(1);
        self.left += 1;
        if self.left >= MOST_LEFT {
            self.left = 0;
            self.rested = (2 * self.rested).clamp(FIRST_REST, LONGEST_REST);
            self.rests = self.rested;
        }
        true
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

/// Of a thread of this program that runs: `/proc/self/task/ID/schedstat` has ns on a processor, ns waiting for one, and times on one. Nothing where the
/// system does not count, or the thread has ended.
fn waited(thread: Pid) -> Option<Waited> {
    let path = format!("/proc/self/task/{}/schedstat", thread.as_raw_pid());
    let text = std::fs::read_to_string(path).ok()?;
    let mut fields = text.split_ascii_whitespace().skip(1);
    let (ns, times) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
    (times > 0).then_some(Waited { ns, times })
}

/// The processors that the calling thread may run on.
fn processors() -> Vec<usize> {
    let allowed = rustix::thread::sched_getaffinity(None);
    let set = allowed.unwrap_or_else(|_| CpuSet::new());
    (0..CpuSet::MAX_CPU).filter(|&i| set.is_set(i)).collect()
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread::JoinHandle;

    use super::*;

    /// A thread that joins and stays until its end is dropped; its id.
    fn member(shared: &SharedProcessor) -> (mpsc::Sender<()>, Pid, JoinHandle<()>) {
        let (end, ended) = mpsc::channel::<()>();
        let (id, begun) = mpsc::channel();
        let shared = shared.clone();
        let thread = std::thread::spawn(move || {
            shared.join();
            id.send(rustix::thread::gettid()).unwrap();
            let _ = ended.recv();
        });
        (end, begun.recv().unwrap(), thread)
    }

    fn processors_of(thread: Pid) -> Vec<usize> {
        let set = rustix::thread::sched_getaffinity(Some(thread)).unwrap();
        (0..CpuSet::MAX_CPU).filter(|&i| set.is_set(i)).collect()
    }

    #[test]
    fn threads_that_join_are_on_one_processor_and_are_moved_together() {
        let shared = SharedProcessor::default();
        let before = processors();
        let members = [member(&shared), member(&shared)];
        let one = processors_of(members[0].1);
        assert_eq!((one.len(), &one), (1, &processors_of(members[1].1)));
        assert_eq!(processors(), before);
        let waited = |times| {
            Some(Waited {
                ns: 1000 * BUSY_NS * times,
                times,
            })
        };
        shared.look_at(|_| waited(1000));
        let other = processors_of(members[0].1);
        assert_eq!((other.len(), &other), (1, &processors_of(members[1].1)));
        assert_eq!(other == one, before.len() == 1);
        shared.look_at(|_| waited(2000));
        assert_eq!(
            [before.clone(), before],
            members.each_ref().map(|(_, id, _)| processors_of(*id))
        );
        shared.look_at(|_| None);
        assert!(shared.0.lock().unwrap().threads.is_empty());
        for (end, _, thread) in members {
            drop(end);
            thread.join().unwrap();
        }
    }

    #[test]
    fn how_long_a_thread_waited_is_read_until_it_ends() {
        let (end, id, thread) = member(&SharedProcessor::default());
        assert!(waited(id).unwrap().times > 0);
        drop(end);
        thread.join().unwrap();
        // It may have its file for a moment more.
        while waited(id).is_some() {
            std::thread::yield_now();
        }
    }

    #[test]
    fn they_leave_a_busy_processor_and_come_back_after_two_were_busy() {
        let [busy, calm] = [2 * BUSY_NS, BUSY_NS / 30].map(|each| Waited {
            ns: 50 * each,
            times: 50,
        });
        let mut place = Place::default();
        place.begin(3, &[1, 3, 5]);
        place.begin(1, &[1, 3, 5]);
        assert_eq!(place.processors(), [3]);
        assert!(!place.looked(calm) && !place.looked(Waited::default()));
        assert!(place.looked(busy));
        assert_eq!(place.processors(), [5]);
        // One that has time in between is left for another one only when it is busy again.
        assert!(!place.looked(calm) && place.looked(busy));
        assert_eq!(place.processors(), [1]);
        for rest in [FIRST_REST, 2 * FIRST_REST] {
            while !(place.looked(busy) && place.processors() == [1, 3, 5]) {}
            let looks = (1..).find(|_| place.looked(busy)).unwrap();
            assert_eq!((looks, place.processors().len()), (rest, 1));
        }
    }
}
