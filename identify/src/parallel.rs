//! Work on all processors: work within such work takes those that nobody uses.

use core::num::NonZero;
use core::sync::atomic::{AtomicIsize, AtomicUsize, Ordering};
use std::sync::LazyLock;

/// `f` of each item, in order, on all processors.
pub(crate) fn in_parallel<T: Sync, R: Send>(items: &[T], f: impl Fn(&T) -> R + Sync) -> Vec<R> {
    in_parallel_on(usize::MAX, items, f)
}

/// As [`in_parallel`], on so many processors at most.
pub(crate) fn in_parallel_on<T: Sync, R: Send>(
    most: usize,
    items: &[T],
    f: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let threads = processors().min(most);
    let size = items.len().div_ceil(4 * threads).max(1);
    let chunks: Vec<&[T]> = items.chunks(size).collect();
    let helpers = (1..threads.min(chunks.len())).map_while(|_| Taken::one());
    let helpers: Vec<Taken> = helpers.collect();
    if helpers.is_empty() {
        return items.iter().map(f).collect();
    }
    let next = AtomicUsize::new(0);
    let work = || {
        let mut done = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(chunk) = chunks.get(index) else {
                return done;
            };
            done.push((index, chunk.iter().map(&f).collect::<Vec<R>>()));
        }
    };
    let work = &work;
    let mut parts: Vec<(usize, Vec<R>)> = std::thread::scope(|scope| {
        let helpers = helpers.into_iter();
        let handles: Vec<_> = helpers
            .map(|taken| scope.spawn(move || taken.by(work)))
            .collect();
        let mut parts = work();
        let _lent = Lent::begin();
        for handle in handles {
            match handle.join() {
                Ok(done) => parts.extend(done),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        parts
    });
    parts.sort_by_key(|(index, _)| *index);
    parts.into_iter().flat_map(|(_, done)| done).collect()
}

/// What `a` and `b` give, run side by side where a processor is free; `b` stays on this thread.
pub(crate) fn both<A: Send, B>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B) -> (A, B) {
    let Some(taken) = Taken::one() else {
        return (a(), b());
    };
    std::thread::scope(|threads| {
        let a = threads.spawn(|| taken.by(a));
        let b = b();
        let _lent = Lent::begin();
        match a.join() {
            Ok(a) => (a, b),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// How many there are: asked once, the answer takes files to be read.
fn processors() -> usize {
    static COUNT: LazyLock<usize> =
        LazyLock::new(|| std::thread::available_parallelism().map_or(1, NonZero::get));
    *COUNT
}

/// Processors that nobody here uses; the first caller's own is in use.
fn free() -> &'static AtomicIsize {
    static FREE: LazyLock<AtomicIsize> =
        LazyLock::new(|| AtomicIsize::new(processors().cast_signed() - 1));
    &FREE
}

/// A processor that is in use as long as this lives.
struct Taken;

impl Taken {
    /// One that was free.
    fn one() -> Option<Self> {
        let less = |free: isize| (free > 0).then_some(free - 1);
        let was = free().fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
        was.is_ok().then_some(Self)
    }

    /// Does the work on it.
    fn by<R>(self, work: impl FnOnce() -> R) -> R {
        work()
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        free().fetch_add(1, Ordering::Relaxed);
    }
}

/// The processor of a thread that waits, which others may use as long as this lives.
struct Lent;

impl Lent {
    fn begin() -> Self {
        free().fetch_add(1, Ordering::Relaxed);
        Self
    }
}

impl Drop for Lent {
    fn drop(&mut self) {
        free().fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn work_within_work_gives_the_same_and_its_panics_are_passed_on() {
        let items: Vec<usize> = (0..20).collect();
        let inner = |i: &usize| in_parallel(&items, |j| i * j).into_iter().sum::<usize>();
        let (sums, again) = both(|| in_parallel(&items, inner), || in_parallel(&items, inner));
        assert_eq!(sums, (0..20).map(|i| 190 * i).collect::<Vec<_>>());
        assert_eq!(sums, again);
        let failed = std::panic::catch_unwind(|| in_parallel(&items, |i| 1 / (i % 7)));
        assert!(failed.is_err());
    }

    #[test]
    fn both_give_what_they_give() {
        let mut steps = 0;
        let count = || steps += 1;
        assert_eq!(both(|| 2 * 3, count), (6, ()));
        assert_eq!(steps, 1);
    }
}
