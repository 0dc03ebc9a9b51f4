//! Work on all processors.

use core::num::NonZero;
use core::sync::atomic::{AtomicUsize, Ordering};
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
    let mut parts: Vec<(usize, Vec<R>)> = std::thread::scope(|scope| {
        let handles: Vec<_> = (1..threads.min(chunks.len()))
            .map(|_| scope.spawn(work))
            .collect();
        let mut parts = work();
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

/// How many there are: asked once, the answer takes files to be read.
fn processors() -> usize {
    static COUNT: LazyLock<usize> =
        LazyLock::new(|| std::thread::available_parallelism().map_or(1, NonZero::get));
    *COUNT
}

/// What `a` and `b` give, run side by side; `b` stays on this thread.
pub(crate) fn both<A: Send, B>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B) -> (A, B) {
    std::thread::scope(|threads| {
        let a = threads.spawn(a);
        let b = b();
        match a.join() {
            Ok(a) => (a, b),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
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
    fn both_give_what_they_give() {
        let mut steps = 0;
        let count = || steps += 1;
        assert_eq!(both(|| 2 * 3, count), (6, ()));
        assert_eq!(steps, 1);
    }
}
