//! Efforts at many states at once: blocks of them, in vectors as wide as the processor has.

use pulp::NullaryFnOnce;

use super::evaluator::Evaluator;
use super::lanes::{Lanes, Plain};
use super::rows::{BLOCK, Rows};

/// States that make a thread worth it.
const LEAST_OF_A_THREAD: usize = 250_000;

/// One quantity of many states.
#[derive(Clone, Copy, Debug)]
pub enum Each<'a> {
    /// The same in all.
    Same(f64),
    /// One number for each.
    Own(&'a [f64]),
}

/// Arrays of states that are not of one length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{name}` has {got} states, the efforts have {expected}: give as many, or one number")]
pub struct LengthError {
    /// `q`, `dq` or `ddq`.
    pub name: &'static str,
    /// Length of the array for the efforts.
    pub expected: usize,
    /// Length of the array.
    pub got: usize,
}

impl Evaluator {
    /// Writes the efforts at as many states as `out` has room for, as [`Self::effort`] gives them one by one, in vectors and without
    /// allocation. The states may be cut and given to several threads: where they are cut the last digits may differ.
    ///
    /// # Errors
    /// [`LengthError`]: an array is longer or shorter than `out`, which is left as it was.
    pub fn efforts<'a>(
        &self,
        q: impl Into<Each<'a>>,
        dq: impl Into<Each<'a>>,
        ddq: impl Into<Each<'a>>,
        out: &mut [f64],
    ) -> Result<(), LengthError> {
        let states = [q.into(), dq.into(), ddq.into()];
        fits(states, out.len())?;
        self.write(states, out);
        Ok(())
    }

    /// As [`Self::efforts`], of states that fit.
    fn write(&self, states: [Each<'_>; 3], out: &mut [f64]) {
        let Some(rows) = self.rows() else {
            self.one_by_one(states, out);
            return;
        };
        let batch = Batch {
            evaluator: self,
            rows,
            states,
            out,
        };
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V4::try_new() {
            simd.vectorize(In { simd, batch });
            return;
        } else if let Some(simd) = pulp::x86::V3::try_new() {
            simd.vectorize(In { simd, batch });
            return;
        }
        In { simd: Plain, batch }.call();
    }

    /// As [`Self::efforts`] by `threads` threads, each with its share of the states: several bring more from the memory than one can. Below a
    /// quarter of a million states for each thread there are fewer of them, for to begin one takes as long as thousands of efforts.
    ///
    /// # Errors
    /// [`LengthError`], as there.
    ///
    /// # Panics
    /// When the system gives no thread.
    pub fn efforts_by<'a>(
        &self,
        threads: usize,
        q: impl Into<Each<'a>>,
        dq: impl Into<Each<'a>>,
        ddq: impl Into<Each<'a>>,
        out: &mut [f64],
    ) -> Result<(), LengthError> {
        let states = [q.into(), dq.into(), ddq.into()];
        fits(states, out.len())?;
        let threads = threads.min(out.len() / LEAST_OF_A_THREAD).max(1);
        let share = out.len().div_ceil(threads).max(1);
        std::thread::scope(|scope| {
            let mut shares = out.chunks_mut(share).enumerate();
            let own = shares.next();
            for (i, out) in shares {
                let states = states.map(|each| each.part(i * share, out.len()));
                scope.spawn(move || self.write(states, out));
            }
            if let Some((_, out)) = own {
                self.write(states.map(|each| each.part(0, out.len())), out);
            }
        });
        Ok(())
    }

    fn one_by_one(&self, states: [Each<'_>; 3], out: &mut [f64]) {
        for (k, out) in out.iter_mut().enumerate() {
            let [q, dq, ddq] = states.each_ref().map(|each| each.at(k));
            *out = self.effort(q, dq, ddq);
        }
    }
}

/// Nothing when all states are as many as the efforts.
fn fits(states: [Each<'_>; 3], expected: usize) -> Result<(), LengthError> {
    for (each, name) in states.into_iter().zip(["q", "dq", "ddq"]) {
        if let Some(got) = each.len().filter(|got| *got != expected) {
            return Err(LengthError {
                name,
                expected,
                got,
            });
        }
    }
    Ok(())
}

impl<'a> Each<'a> {
    /// Those of the states from `from` on.
    fn part(self, from: usize, count: usize) -> Self {
        match self {
            Self::Same(value) => Self::Same(value),
            Self::Own(values) => Self::Own(values.get(from..from + count).unwrap_or_default()),
        }
    }
}

impl Each<'_> {
    fn len(&self) -> Option<usize> {
        match self {
            Self::Same(_) => None,
            Self::Own(values) => Some(values.len()),
        }
    }

    fn at(&self, k: usize) -> f64 {
        match self {
            Self::Same(value) => *value,
            Self::Own(values) => values.get(k).copied().unwrap_or(f64::NAN),
        }
    }

    /// The block from `from` on; where the states end within it, their copy in `scratch`, zeros behind it.
    #[inline(always)]
    fn block<'b>(&'b self, from: usize, scratch: &'b mut [f64; BLOCK]) -> &'b [f64; BLOCK] {
        let values = match self {
            Self::Same(value) => {
                *scratch = [*value; BLOCK];
                return scratch;
            }
            Self::Own(values) => values.get(from..).unwrap_or_default(),
        };
        if let Some(whole) = values.first_chunk() {
            return whole;
        }
        *scratch = [0.0; BLOCK];
        for (copy, value) in scratch.iter_mut().zip(values) {
            *copy = *value;
        }
        scratch
    }
}

impl From<f64> for Each<'_> {
    fn from(value: f64) -> Self {
        Self::Same(value)
    }
}

impl<'a> From<&'a [f64]> for Each<'a> {
    fn from(values: &'a [f64]) -> Self {
        Self::Own(values)
    }
}

impl<'a> From<&'a Vec<f64>> for Each<'a> {
    fn from(values: &'a Vec<f64>) -> Self {
        Self::Own(values)
    }
}

/// Efforts to be written.
struct Batch<'a> {
    evaluator: &'a Evaluator,
    rows: &'a Rows,
    states: [Each<'a>; 3],
    out: &'a mut [f64],
}

/// [`Batch`] as a function that is compiled for what the processor has.
struct In<'a, const N: usize, F> {
    simd: F,
    batch: Batch<'a>,
}

impl<const N: usize, F: Lanes<N>> NullaryFnOnce for In<'_, N, F> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { simd, batch } = self;
        let Batch {
            evaluator,
            rows,
            states: [q, dq, ddq],
            out,
        } = batch;
        let [mut a, mut b, mut c, mut end] = [[0.0; BLOCK]; 4];
        let mut last = None;
        for (i, out) in out.chunks_mut(BLOCK).enumerate() {
            let from = i * BLOCK;
            let (q, dq) = (q.block(from, &mut a), dq.block(from, &mut b));
            let states = [q, dq, ddq.block(from, &mut c)];
            match out.first_chunk_mut() {
                Some(whole) => rows.efforts(simd, &mut last, states, whole),
                None => {
                    rows.efforts(simd, &mut last, states, &mut end);
                    for (effort, end) in out.iter_mut().zip(end) {
                        *effort = end;
                    }
                }
            }
            evaluator.add_named(q, dq, out);
        }
    }
}
