//! A twin's effort as rows of numbers, so that many efforts take little longer than the memory takes to bring their states and
//! to carry the efforts away.
//!
//! Load and damping get one grid over q, fine enough for the pieces of both. In a cell of it, of the root of the speed and of the
//! direction, with u from -1/2 to 1/2 along the piece and w the place over the root of the speed,
//!
//! ```text
//! effort = sum over k = 0..3 of (g_k + (a_k + b_k w) dq) u^k  +  I ddq + b dq
//! row    = g_0 g_1 g_2 g_3  a_0 a_1 a_2 0  b_0 b_1 b_2 0
//! ```
//!
//! with the constant load and the Coulomb friction of the direction in g_0. A row is three vectors of four: it is loaded whole and
//! worked with as it lies, and only the sums of four states are turned into columns, where gathering a state's ten numbers one
//! by one took most of the time. Places go through memory to the rows' numbers: out of a vector they would take its permutations. The
//! roots are those of the next block, so that the divider works while rows are read.

use super::Coordinate;
use super::four::Four;
use super::pieces::{LOAD, OVER_Q, Pieces, Pitch};

/// States of a block.
pub(super) const BLOCK: usize = 64;
/// Numbers of a row.
const ROW: usize = 12;
/// Where rows may begin: the rows of a mechanism as it is fitted, 60 pieces by 3 in either direction, and more.
const BEGINS: usize = 8192;
/// Above it a double has no fraction: to add it rounds, and leaves the whole number in the lowest bits; below it too.
const WHOLE: f64 = 6_755_399_441_055_744.0;

/// What of a twin is no mechanism, in the recording's coordinate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rest {
    pub(super) inertia: f64,
    pub(super) coulomb: f64,
    pub(super) viscous: f64,
    pub(super) load: f64,
}

/// Aligned so that no vector of a row lies across two lines of the cache.
#[derive(Clone)]
#[repr(align(64))]
struct Numbers([f64; BEGINS + ROW]);

impl core::fmt::Debug for Numbers {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Numbers")
    }
}

/// Where x lies on a grid: `x per_unit + from`, from -1/2 to `top` in the middle of the first and past that of the last piece.
#[derive(Clone, Copy, Debug)]
struct Along {
    per_unit: f64,
    from: f64,
    top: f64,
}

impl Along {
    fn new(low: f64, per_unit: f64, pieces: usize) -> Self {
        Self {
            per_unit,
            from: -low * per_unit - 0.5,
            // A hair less, so that the end is still of the last piece.
            top: (pieces as f64 - 0.5).next_down(),
        }
    }

    #[inline(always)]
    fn of<F: Four>(&self, four: F, x: F::Vector) -> F::Vector {
        let along = four.mul_add(x, four.all(self.per_unit), four.all(self.from));
        let above = four.max(four.all(-0.5), along);
        four.min(four.all(self.top), above)
    }
}

/// See the module. In the twin's coordinate.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    over_q: Along,
    over_root: Along,
    /// Numbers from a piece over q to the next, and from forward to backward.
    steps: [f64; 2],
    numbers: Box<Numbers>,
    /// As [`Pieces::bends`].
    bends: Vec<[[f64; 2]; 2]>,
    inertia: f64,
    viscous: f64,
    coulomb: f64,
}

/// What the rows of a block are found and used by.
pub(super) struct Places {
    /// Begins of rows, in the lowest bits.
    row: [f64; BLOCK],
    u: [f64; BLOCK],
    w: [f64; BLOCK],
    /// Of the speeds of the block that is next.
    roots: [f64; BLOCK],
}

impl Rows {
    /// Nothing when load and damping have no common grid of a size that fits.
    pub(super) fn of(pieces: Option<&Pieces>, rest: Rest, coordinate: Coordinate) -> Option<Self> {
        let nothing = Pieces::nothing();
        let pieces = pieces.unwrap_or(&nothing);
        let grid = Grid::of(pieces)?;
        let Coordinate { sign, offset } = coordinate;
        let mut over_q = Along::new(pieces.load_over.low, grid.per_unit, grid.over_q);
        over_q.from -= sign * offset * grid.per_unit;
        over_q.per_unit *= sign;
        let root = &pieces.over_root;
        let bends = pieces.bends.iter().map(|[forward, backward]| {
            // A way with fewer bends has them nowhere.
            let [forward, backward] =
                [forward, backward].map(|bend| if bend[1] == 0.0 { [0.0; 2] } else { *bend });
            if sign < 0.0 {
                [backward, forward]
            } else {
                [forward, backward]
            }
        });
        Some(Self {
            over_q,
            over_root: Along::new(root.low, root.per_unit, grid.over_root),
            steps: [grid.over_root, grid.over_q * grid.over_root].map(|rows| (ROW * rows) as f64),
            numbers: grid.numbers(pieces, rest, sign)?,
            bends: bends.collect(),
            inertia: rest.inertia,
            viscous: rest.viscous,
            coulomb: rest.coulomb,
        })
    }

    /// The places of a first block.
    #[inline(always)]
    pub(super) fn places<F: Four>(four: F, dq: &[f64; BLOCK]) -> Places {
        let mut roots = [0.0; BLOCK];
        for (root, dq) in fours_mut(&mut roots).zip(fours(dq)) {
            four.store(four.root_of_size(four.load(dq)), root);
        }
        Places {
            row: [0.0; BLOCK],
            u: [0.0; BLOCK],
            w: [0.0; BLOCK],
            roots,
        }
    }

    /// Writes the efforts at a block of states; `next` are the rates of the block after it.
    #[inline(always)]
    pub(super) fn efforts<F: Four>(
        &self,
        four: F,
        places: &mut Places,
        [q, dq, ddq]: [&[f64; BLOCK]; 3],
        next: &[f64; BLOCK],
        out: &mut [f64; BLOCK],
    ) {
        self.place(four, q, dq, places);
        if self.bends.is_empty() {
            self.read::<F, false>(four, places, [dq, ddq], next, out);
        } else {
            self.read::<F, true>(four, places, [dq, ddq], next, out);
        }
    }

    #[inline(always)]
    fn place<F: Four>(&self, four: F, q: &[f64; BLOCK], dq: &[f64; BLOCK], places: &mut Places) {
        let Places { row, u, w, roots } = places;
        let [over_q, backward] = self.steps;
        let ways = [four.all(WHOLE + backward), four.all(WHOLE)];
        let (over_q, over_root) = (four.all(over_q), four.all(ROW as f64));
        let found = fours_mut(row).zip(fours_mut(u)).zip(fours_mut(w));
        let states = fours(q).zip(fours(dq)).zip(fours(roots));
        for (((row, u), w), ((q, dq), root)) in found.zip(states) {
            let along = self.over_q.of(four, four.load(q));
            let i = rounded(four, along);
            four.store(four.sub(along, i), u);
            let along = self.over_root.of(four, four.load(root));
            four.store(along, w);
            let way = four.if_below(four.load(dq), ways[0], ways[1]);
            let begin = four.mul_add(i, over_q, way);
            four.store(four.mul_add(rounded(four, along), over_root, begin), row);
        }
    }

    #[inline(always)]
    fn read<F: Four, const BENT: bool>(
        &self,
        four: F,
        places: &mut Places,
        [dq, ddq]: [&[f64; BLOCK]; 2],
        next: &[f64; BLOCK],
        out: &mut [f64; BLOCK],
    ) {
        let Places { row, u, w, roots } = places;
        let (inertia, viscous) = (four.all(self.inertia), four.all(self.viscous));
        let not_at_rest = four.all(-self.coulomb);
        let states = fours(row)
            .zip(fours(u))
            .zip(fours(w))
            .zip(fours(dq))
            .zip(fours(ddq));
        let after = fours(next).zip(fours_mut(roots)).zip(fours_mut(out));
        for (((((row, u), w), dq), ddq), ((next, root), out)) in states.zip(after) {
            four.store(four.root_of_size(four.load(next)), root);
            let (mut sums, mut shares) = ([four.all(0.0); 4], [four.all(0.0); 4]);
            for k in 0..4 {
                let [g, a, b] = self.row(row[k]);
                let share = four.mul_add(four.load(b), four.all(w[k]), four.load(a));
                if BENT {
                    (sums[k], shares[k]) = (four.load(g), share);
                } else {
                    sums[k] = four.mul_add(share, four.all(dq[k]), four.load(g));
                }
            }
            let (u, rate) = (four.load(u), four.load(dq));
            let rest = four.mul_add(four.load(ddq), inertia, four.if_zero(rate, not_at_rest));
            let rest = four.mul_add(rate, viscous, rest);
            let mut effort = four.add(cubic(four, four.turned(sums), u), rest);
            if BENT {
                let share = cubic(four, four.turned(shares), u);
                effort = four.add(effort, self.bent(four, share, rate));
            }
            four.store(effort, out);
        }
    }

    /// The three vectors of the row that begins where the lowest bits say.
    #[inline(always)]
    #[allow(
        clippy::cast_possible_truncation,
        reason = "the lowest bits are wanted"
    )]
    fn row(&self, begin: f64) -> [&[f64; 4]; 3] {
        let begin = begin.to_bits() as usize & (BEGINS - 1);
        let (row, _) = self.numbers.0[begin..begin + ROW].as_chunks();
        [&row[0], &row[1], &row[2]]
    }

    /// What a valve makes of `share dq`.
    #[inline(always)]
    fn bent<F: Four>(&self, four: F, share: F::Vector, rate: F::Vector) -> F::Vector {
        let none = four.all(0.0);
        let whole = four.mul_add(share, rate, none);
        let size = four.if_below(rate, four.sub(none, whole), whole);
        let mut bent = size;
        for [forward, backward] in &self.bends {
            let [at, change] =
                [0, 1].map(|k| four.if_below(rate, four.all(backward[k]), four.all(forward[k])));
            bent = four.mul_add(four.max(none, four.sub(size, at)), change, bent);
        }
        four.if_below(rate, four.sub(none, bent), bent)
    }
}

/// What load and damping have in common.
struct Grid {
    over_q: usize,
    over_root: usize,
    per_unit: f64,
}

impl Grid {
    fn of(pieces: &Pieces) -> Option<Self> {
        let [load, damping, over_root] =
            [&pieces.load_over, &pieces.over_q, &pieces.over_root].map(Pitch::count);
        let over_q = load / common_divisor(load, damping) * damping;
        let finer = |pitch: &Pitch| pitch.per_unit * (over_q as f64 / pitch.count() as f64);
        let (per_unit, of_damping) = (finer(&pieces.load_over), finer(&pieces.over_q));
        let shift = (pieces.load_over.low - pieces.over_q.low) * per_unit;
        let same = (per_unit / of_damping - 1.0).abs() <= 1e-12 && shift.abs() <= 1e-12;
        let fits = 2 * over_q * over_root * ROW <= BEGINS && (1e-9..1e9).contains(&per_unit);
        (same && fits).then_some(Self {
            over_q,
            over_root,
            per_unit,
        })
    }

    fn numbers(&self, pieces: &Pieces, rest: Rest, sign: f64) -> Option<Box<Numbers>> {
        let [load, damping] = [&pieces.load_over, &pieces.over_q].map(Pitch::count);
        let mut numbers = Box::new(Numbers([0.0; BEGINS + ROW]));
        let mut rows = numbers.0.chunks_exact_mut(ROW);
        for (way, friction) in [rest.coulomb, -rest.coulomb].into_iter().enumerate() {
            // Forward in the twin's coordinate may be backward in the recording's.
            let recorded = if sign < 0.0 { 1 - way } else { way };
            for i in 0..self.over_q {
                let of_load = pieces.load.get(i * load / self.over_q)?;
                let mut g = part(of_load, i, self.over_q / load).map(|g| sign * g);
                g[0] += sign * rest.load + friction;
                for j in 0..self.over_root {
                    let over_q = recorded * damping + i * damping / self.over_q;
                    let [a, b] = pieces.damping.get(over_q * self.over_root + j)?;
                    let [a, b] = [a, b].map(|powers| part(powers, i, self.over_q / damping));
                    let row = rows.next()?;
                    row[..LOAD].copy_from_slice(&g);
                    for k in 0..OVER_Q {
                        // The place over the root counts from the middle of the first piece.
                        row[4 + k] = a[k] - (j as f64 - 0.5) * b[k];
                        row[8 + k] = b[k];
                    }
                }
            }
        }
        Some(numbers)
    }
}

/// The nearest whole numbers.
#[inline(always)]
fn rounded<F: Four>(four: F, x: F::Vector) -> F::Vector {
    let whole = four.all(WHOLE);
    four.sub(four.add(x, whole), whole)
}

/// c0 + c1 u + c2 u^2 + c3 u^3
#[inline(always)]
fn cubic<F: Four>(four: F, [c0, c1, c2, c3]: [F::Vector; 4], u: F::Vector) -> F::Vector {
    let c1 = four.mul_add(four.mul_add(c3, u, c2), u, c1);
    four.mul_add(c1, u, c0)
}

#[inline(always)]
fn fours(block: &[f64; BLOCK]) -> impl Iterator<Item = &[f64; 4]> {
    block.as_chunks().0.iter()
}

#[inline(always)]
fn fours_mut(block: &mut [f64; BLOCK]) -> impl Iterator<Item = &mut [f64; 4]> {
    block.as_chunks_mut().0.iter_mut()
}

fn common_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { common_divisor(b, a % b) }
}

/// The powers of u from -1/2 to 1/2 in fine piece `i`, of those from 0 to 1 in the piece that `many` of them make up.
fn part<const N: usize>(powers: &[f64; N], i: usize, many: usize) -> [f64; N] {
    let middle = ((i % many) as f64 + 0.5) / many as f64;
    let mut out = *powers;
    for k in 0..N {
        for higher in (k..N - 1).rev() {
            out[higher] += middle * out[higher + 1];
        }
    }
    let mut scale = 1.0;
    for power in &mut out {
        *power *= scale;
        scale /= many as f64;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::four::Plain;
    use super::super::pieces::tests::over;
    use super::*;
    use proptest::prelude::*;

    const REST: Rest = Rest {
        inertia: 2.0,
        coulomb: 0.3,
        viscous: 0.2,
        load: 0.1,
    };

    struct Once<'a, F> {
        four: F,
        rows: &'a Rows,
        states: [&'a [f64; BLOCK]; 3],
    }

    impl<F: Four> pulp::NullaryFnOnce for Once<'_, F> {
        type Output = [f64; BLOCK];

        fn call(self) -> [f64; BLOCK] {
            let mut out = [0.0; BLOCK];
            let [_, dq, _] = self.states;
            let mut places = Rows::places(self.four, dq);
            for _ in 0..2 {
                self.rows
                    .efforts(self.four, &mut places, self.states, dq, &mut out);
            }
            out
        }
    }

    /// The efforts by whatever this processor has.
    fn efforts(rows: &Rows, states: [&[f64; BLOCK]; 3]) -> Vec<[f64; BLOCK]> {
        let four = Plain;
        let plain = pulp::NullaryFnOnce::call(Once { four, rows, states });
        #[cfg(target_arch = "x86_64")]
        if let Some(four) = pulp::x86::V3::try_new() {
            return vec![plain, four.vectorize(Once { four, rows, states })];
        }
        vec![plain]
    }

    proptest! {
        #[test]
        fn rows_are_the_pieces_inside_and_outside_in_either_sense(
            seed: u64, load in (1_usize..21, 0_usize..4), over_q in (1_usize..13, 0_usize..3), over_root in (1_usize..4, 0_usize..2),
            bends in (0_usize..3, 0_usize..3), reversed: bool, offset in -2.0..2.0_f64,
            states in proptest::collection::vec((-0.6..1.4_f64, -3.0..3.0_f64, -5.0..5.0_f64), BLOCK),
        ) {
            let counts = [load.0, over_q.0, over_root.0];
            let mechanism = over([[-0.2, 1.0]; 2], seed, counts, [load.1, over_q.1, over_root.1], [bends.0, bends.1]);
            let pieces = Pieces::of(&mechanism);
            let sign = if reversed { -1.0 } else { 1.0 };
            let rows = Rows::of(Some(&pieces), REST, Coordinate { sign, offset });
            let cells = 2 * load.0 / common_divisor(load.0, over_q.0) * over_q.0 * over_root.0;
            prop_assert_eq!(rows.is_some(), cells * ROW <= BEGINS);
            let Some(rows) = rows else { return Ok(()) };
            let of = |i: usize| core::array::from_fn(|k| {
                let (q, dq, ddq) = states[k];
                // Rest too, and both ends.
                let (q, dq) = match k { 0 => (q, 0.0), 1 => (1.0, dq), 2 => (-0.2, dq), 3 => (q, -0.0), _ => (q, dq) };
                [sign * q + offset, sign * dq, sign * ddq][i]
            });
            let (q, dq, ddq): ([f64; BLOCK], [f64; BLOCK], [f64; BLOCK]) = (of(0), of(1), of(2));
            for found in efforts(&rows, [&q, &dq, &ddq]) {
                for k in 0..BLOCK {
                    let (at, rate) = (sign * (q[k] - offset), sign * dq[k]);
                    let friction = if rate == 0.0 { 0.0 } else { REST.coulomb.copysign(rate) };
                    let recorded = pieces.effort(at, rate) + friction + REST.viscous * rate + REST.load;
                    let wanted = sign * recorded + REST.inertia * ddq[k];
                    prop_assert!((found[k] - wanted).abs() < 1e-9 * wanted.abs().max(1.0), "{k}: {} {wanted}", found[k]);
                }
            }
        }
    }

    #[test]
    fn what_has_no_common_grid_has_no_rows() {
        let none = |intervals: [[f64; 2]; 2], pieces: [usize; 3]| {
            let pieces = Pieces::of(&over(intervals, 1, pieces, [3, 2, 1], [0, 0]));
            let coordinate = Coordinate {
                sign: 1.0,
                offset: 0.0,
            };
            Rows::of(Some(&pieces), REST, coordinate).is_none()
        };
        assert!(!none([[0.0, 1.0]; 2], [20, 12, 3]));
        assert!(none([[0.0, 1.0], [0.0, 1.1]], [20, 12, 3]));
        assert!(none([[0.1, 1.1], [0.0, 1.0]], [20, 12, 3]));
        assert!(none([[0.0, 1.0]; 2], [97, 101, 3]));
    }

    #[test]
    fn what_is_no_number_stays_none() {
        let coordinate = Coordinate {
            sign: 1.0,
            offset: 0.0,
        };
        for pieces in [
            None,
            Some(Pieces::of(&over(
                [[0.0, 1.0]; 2],
                5,
                [20, 12, 3],
                [3, 2, 1],
                [1, 0],
            ))),
        ] {
            let mechanism = pieces.is_some();
            let rows = Rows::of(pieces.as_ref(), REST, coordinate).unwrap();
            for bits in [
                f64::NAN.to_bits(),
                f64::NAN.to_bits() | 0x1234_5678,
                u64::MAX,
            ] {
                let nothing = [f64::from_bits(bits); BLOCK];
                let some = [0.3; BLOCK];
                for found in efforts(&rows, [&some, &nothing, &some]) {
                    assert!(found.iter().all(|effort| effort.is_nan()));
                }
                for found in efforts(&rows, [&nothing, &some, &some]) {
                    assert!(found.iter().all(|effort| effort.is_nan()) || !mechanism);
                }
            }
            for end in [f64::INFINITY, f64::NEG_INFINITY, 1e300] {
                for found in efforts(&rows, [&[end; BLOCK], &[0.3; BLOCK], &[0.0; BLOCK]]) {
                    assert!(found.iter().all(|effort| effort.is_finite()));
                }
            }
        }
    }
}
