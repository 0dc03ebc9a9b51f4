//! Work side by side on the processors that are free. In use are those of one caller and of the threads that are started here; other threads that
//! compute (a second caller, efforts in batches) are not counted.

use core::num::NonZero;
use core::sync::atomic::{AtomicIsize, AtomicUsize, Ordering};
use std::sync::{LazyLock, Mutex, PoisonError};

static ALL: Processors = Processors::new(count);

/// How many there are: asked once, the answer takes files to be read.
fn count() -> usize {
    static COUNT: LazyLock<usize> =
        LazyLock::new(|| std::thread::available_parallelism().map_or(1, NonZero::get));
    *COUNT
}

/// `f` of each item, in order, on this thread and on the processors that are free or become so.
pub(crate) fn in_parallel<T: Sync, R: Send>(items: &[T], f: impl Fn(&T) -> R + Sync) -> Vec<R> {
    ALL.each(usize::MAX, items, f)
}

/// As [`in_parallel`], on so many processors at most.
pub(crate) fn in_parallel_on<T: Sync, R: Send>(
    most: usize,
    items: &[T],
    f: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    ALL.each(most, items, f)
}

/// What `a` and `b` give, side by side where a processor is free, else `a` first; `b` stays on this thread.
pub(crate) fn both<A: Send, B>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B) -> (A, B) {
    ALL.both(a, b)
}

/// Does work with items that change; each processor takes the next one when it is done with one.
pub(crate) fn for_each<T: Send>(
    items: impl IntoIterator<Item = T, IntoIter: Send>,
    work: impl Fn(T) + Sync,
) {
    let items = items.into_iter();
    let most = items.size_hint().0;
    let items = Mutex::new(items);
    let next = || items.lock().unwrap_or_else(PoisonError::into_inner).next();
    let until_done = || {
        while let Some(item) = next() {
            work(item);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..most {
            let Some(processor) = ALL.take() else { break };
            scope.spawn(|| processor.does(until_done));
        }
        until_done();
    });
}

/// Processors of which some are in use.
struct Processors {
    count: fn() -> usize,
    in_use: AtomicIsize,
}

/// Parts of the work for each processor: some items take many times longer than others.
const PARTS: usize = 16;

/// A processor in use, until this is dropped.
struct Processor<'a>(&'a Processors);

/// A thread waits for others, which may use its processor until this is dropped.
struct Waiting<'a>(&'a Processors);

impl Processors {
    /// One is the caller's.
    const fn new(count: fn() -> usize) -> Self {
        Self {
            count,
            in_use: AtomicIsize::new(1),
        }
    }

    /// One that is free.
    fn take(&self) -> Option<Processor<'_>> {
        let count = (self.count)().cast_signed();
        let more = |in_use: isize| (in_use < count).then_some(in_use + 1);
        let was = self
            .in_use
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
        was.is_ok().then(|| Processor(self))
    }

    fn wait(&self) -> Waiting<'_> {
        self.in_use.fetch_sub(1, Ordering::Relaxed);
        Waiting(self)
    }

    fn each<T: Sync, R: Send>(
        &self,
        most: usize,
        items: &[T],
        f: impl Fn(&T) -> R + Sync,
    ) -> Vec<R> {
        let threads = (self.count)().min(most);
        let size = items.len().div_ceil(PARTS * threads).max(1);
        let chunks: Vec<&[T]> = items.chunks(size).collect();
        let begun = AtomicUsize::new(0);
        let next = || {
            let index = begun.fetch_add(1, Ordering::Relaxed);
            Some((index, *chunks.get(index)?))
        };
        let of = |(index, chunk): (usize, &[T])| (index, chunk.iter().map(&f).collect::<Vec<R>>());
        let work = &|| core::iter::from_fn(next).map(of).collect::<Vec<_>>();
        let mut parts = std::thread::scope(|scope| {
            let mut helpers = Vec::new();
            let mut parts = Vec::new();
            while let Some(chunk) = next() {
                // Others may be done meanwhile.
                while helpers.len() + 1 < threads
                    && begun.load(Ordering::Relaxed) < chunks.len()
                    && let Some(processor) = self.take()
                {
                    helpers.push(scope.spawn(move || processor.does(work)));
                }
                parts.push(of(chunk));
            }
            let _waiting = self.wait();
            for helper in helpers {
                match helper.join() {
                    Ok(done) => parts.extend(done),
                    Err(panic) => std::panic::resume_unwind(panic),
                }
            }
            parts
        });
        parts.sort_by_key(|(index, _)| *index);
        parts.into_iter().flat_map(|(_, done)| done).collect()
    }

    fn both<A: Send, B>(&self, a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B) -> (A, B) {
        let Some(processor) = self.take() else {
            return (a(), b());
        };
        std::thread::scope(|threads| {
            let a = threads.spawn(|| processor.does(a));
            let b = b();
            let _waiting = self.wait();
            match a.join() {
                Ok(a) => (a, b),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        })
    }
}

impl Processor<'_> {
    fn does<R>(self, work: impl FnOnce() -> R) -> R {
        work()
    }
}

impl Drop for Processor<'_> {
    fn drop(&mut self) {
        self.0.in_use.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.in_use.fetch_add(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    #[test]
    fn results_come_in_the_order_of_the_items() {
        let items: Vec<usize> = (0..101).collect();
        for most in [1, 2, usize::MAX] {
            let squares = in_parallel_on(most, &items, |i| i * i);
            assert!(
                squares
                    .iter()
                    .zip(&items)
                    .all(|(square, i)| *square == i * i)
            );
            assert_eq!(squares.len(), items.len());
        }
        assert!(in_parallel(&[], |i: &usize| *i).is_empty());
    }

    #[test]
    fn both_give_what_they_give() {
        let mut steps = 0;
        let count = || steps += 1;
        assert_eq!(both(|| 2 * 3, count), (6, ()));
        assert_eq!(steps, 1);
    }

    #[test]
    fn all_items_are_worked_with() {
        let mut items: Vec<usize> = (0..50).collect();
        for_each(&mut items, |item| *item += 1);
        assert_eq!(items, (1..51).collect::<Vec<_>>());
    }

    #[test]
    fn work_within_work_gives_the_same_on_any_number_of_processors_and_gives_them_back() {
        let items: Vec<usize> = (0..20).collect();
        let counts: [fn() -> usize; 4] = [|| 1, || 2, || 3, || 8];
        for count in counts {
            let some = Processors::new(count);
            let inner = |i: &usize| some.each(9, &items, |j| i * j).into_iter().sum::<usize>();
            let twice = || some.each(9, &items, inner);
            let (sums, again) = some.both(twice, twice);
            assert_eq!(sums, (0..20).map(|i| 190 * i).collect::<Vec<_>>());
            assert_eq!(sums, again);
            assert_eq!(some.in_use.load(Ordering::Relaxed), 1);
        }
    }

    #[test]
    fn a_panic_is_passed_on_and_gives_the_processors_back() {
        let some = Processors::new(|| 3);
        let items: Vec<usize> = (0..20).collect();
        // In a helper or in the caller, as it comes.
        for bad in 0..20 {
            let fails = |i: &usize| assert_ne!(*i, bad);
            assert!(catch_unwind(AssertUnwindSafe(|| some.each(3, &items, fails))).is_err());
            assert_eq!(some.in_use.load(Ordering::Relaxed), 1);
        }
        let in_helper = || some.both(|| panic!("of a helper"), || ());
        assert!(catch_unwind(AssertUnwindSafe(in_helper)).is_err());
        let in_caller = || some.both(|| (), || panic!("of the caller"));
        assert!(catch_unwind(AssertUnwindSafe(in_caller)).is_err());
        assert_eq!(some.in_use.load(Ordering::Relaxed), 1);
    }

    #[test]
    #[allow(clippy::disallowed_methods, reason = "the other thread has to come")]
    fn a_processor_that_becomes_free_is_used() {
        let some = Processors::new(|| 2);
        let taken = Mutex::new(some.take());
        assert!(some.take().is_none());
        let items = [0, 1, 2, 3, 4, 5, 6, 7];
        let threads = some.each(2, &items, |_| {
            drop(taken.lock().unwrap().take());
            std::thread::sleep(core::time::Duration::from_millis(5));
            std::thread::current().id()
        });
        assert!(threads.iter().any(|id| *id != threads[0]));
    }
}
