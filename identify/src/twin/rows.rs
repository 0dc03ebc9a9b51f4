//! A twin's effort as rows of numbers, so that many efforts take little longer than the memory takes to bring their states and
//! to carry the efforts away.
//!
//! With u and v from -1/2 to 1/2 along the pieces of load and damping and w the place over the root of the speed,
//!
//! ```text
//! effort        = sum over k = 0..3 of g_k u^k + sum over k = 0..2 of (a_k + b_k w) v^k dq + I ddq + b dq
//! load's row    = g_0 g_1 g_2 g_3                 of a direction and a piece
//! damping's row = a_0 a_1 a_2 i   b_0 b_1 b_2 j   of a direction and the pieces i over q and j over the root
//! ```
//!
//! with the constant load and the Coulomb friction of the direction in g_0, and the viscous friction in a_0 where no valve bends the damping. Both
//! tables stay in the nearest cache beside the states that pass through it.
//!
//! States that follow each other in time stay in a piece for dozens of samples: as long as a whole vector of them lies in the piece of the last one, its
//! two rows stay at hand ([`Within`]), in registers where there are 32 of them, as with AVX-512. Anywhere else rows are loaded whole and worked with as they lie, and only the sums of as many states as a
//! vector holds are turned into columns, where gathering a state's numbers one by one took most of the time. Places go through memory to the
//! rows' numbers: out of a vector they would take its permutations.

use super::Coordinate;
use super::lanes::Lanes;
use super::pieces::{Pieces, Pitch};

/// States of a block.
pub(super) const BLOCK: usize = 64;
/// Most rows of load and of damping, both directions together: a mechanism as it is fitted has 40 and 72, or 80 behind valves. 256 of each
/// take 24 KiB, and leave room in the nearest cache. What has more is evaluated one state after the other.
const LOADS: usize = 256;
const CELLS: usize = 256;
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

/// As many rows as are used, then nothing; their number a power of two. Aligned so that no row lies across two lines of the cache.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Table<Row, const N: usize>([Row; N]);

impl<Row: Copy + Default, const N: usize> Table<Row, N> {
    /// Nothing where there are too many.
    fn of(rows: impl Iterator<Item = Row>) -> Option<Box<Self>> {
        let mut table = Box::new(Self([Row::default(); N]));
        let mut places = table.0.iter_mut();
        for row in rows {
            *places.next()? = row;
        }
        Some(table)
    }

    /// The row whose index is in the lowest bits.
    #[inline(always)]
    #[allow(
        clippy::cast_possible_truncation,
        reason = "the lowest bits are wanted"
    )]
    fn row(&self, index: f64) -> &Row {
        const { assert!(N.is_power_of_two()) }
        &self.0[index.to_bits() as usize & (N - 1)]
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
    fn new(pitch: &Pitch) -> Self {
        Self {
            per_unit: pitch.per_unit,
            from: -pitch.low * pitch.per_unit - 0.5,
            // A hair less, so that the end is still of the last piece.
            top: (pitch.count() as f64 - 0.5).next_down(),
        }
    }

    /// The same places, found by the twin's coordinate.
    fn by(mut self, Coordinate { sign, offset }: Coordinate) -> Self {
        self.from -= sign * offset * self.per_unit;
        self.per_unit *= sign;
        self
    }

    #[inline(always)]
    fn of<const N: usize, F: Lanes<N>>(&self, simd: F, x: F::Vector) -> F::Vector {
        let along = simd.mul_add(x, simd.all(self.per_unit), simd.all(self.from));
        let above = simd.max(simd.all(-0.5), along);
        simd.min(simd.all(self.top), above)
    }
}

/// See the module. In the twin's coordinate.
#[derive(Clone, Debug)]
pub(super) struct Rows {
    load_over: Along,
    load: Box<Table<[f64; 4], LOADS>>,
    over_q: Along,
    over_root: Along,
    damping: Box<Table<[[f64; 4]; 2], CELLS>>,
    /// Pieces of the load, over q, over the root.
    counts: [f64; 3],
    /// As [`Pieces::bends`].
    bends: Vec<[[f64; 2]; 2]>,
    inertia: f64,
    viscous: f64,
    coulomb: f64,
}

/// A row of load and a row of damping, by their indices in the lowest bits: the piece that the last states lay in.
pub(super) type Piece = [f64; 2];

/// [`Piece`]'s rows, for states that lie in it.
#[derive(Clone, Copy)]
struct Within<V> {
    /// Bits by which a forward rate differs from one of the piece's direction.
    sign: V,
    /// Per unit and from where, so that the piece goes from -1/2 to 1/2: load over q, damping over q and over the root.
    u: [V; 2],
    v: [V; 2],
    w: [V; 2],
    g: [V; 4],
    a: [V; 3],
    b: [V; 3],
}

impl<V: Copy> Within<V> {
    /// Load with dry friction, and damping, at `N` states; nothing when one of them is not in the piece, or on its edge: at rest is one.
    #[inline(always)]
    fn at<const N: usize, F: Lanes<N, Vector = V>>(
        &self,
        simd: F,
        q: V,
        rate: V,
    ) -> Option<(V, V)> {
        let u = simd.mul_add(q, self.u[0], self.u[1]);
        let v = simd.mul_add(q, self.v[0], self.v[1]);
        // Of the other direction there is no root.
        let root = simd.root(simd.xor(rate, self.sign));
        let w = simd.mul_add(root, self.w[0], self.w[1]);
        // Last what may be no number while the others are some: where the others are none, so are the efforts.
        let most = simd.max(simd.max(simd.size(u), simd.size(v)), simd.size(w));
        if !simd.all_below(most, simd.all(0.5)) {
            return None;
        }
        let [g0, g1, g2, g3] = self.g;
        let c0 = simd.mul_add(self.b[0], w, self.a[0]);
        let c1 = simd.mul_add(self.b[1], w, self.a[1]);
        let c2 = simd.mul_add(self.b[2], w, self.a[2]);
        let load = simd.mul_add(simd.mul_add(simd.mul_add(g3, u, g2), u, g1), u, g0);
        Some((load, simd.mul_add(simd.mul_add(c2, v, c1), v, c0)))
    }
}

impl Rows {
    /// Nothing when there are too many, or of a length beyond reason.
    pub(super) fn of(pieces: Option<&Pieces>, rest: Rest, coordinate: Coordinate) -> Option<Self> {
        let nothing = Pieces::nothing();
        let pieces = pieces.unwrap_or(&nothing);
        let pitches = [&pieces.load_over, &pieces.over_q, &pieces.over_root];
        if pitches
            .iter()
            .any(|pitch| !(1e-9..1e9).contains(&pitch.per_unit))
        {
            return None;
        }
        // No root is below 0: rest is on the edge of its piece, or outside.
        if pieces.over_root.low < 0.0 {
            return None;
        }
        let [loads, over_q, over_root] = pitches.map(Pitch::count);
        let sign = coordinate.sign;
        let load = [rest.coulomb, -rest.coulomb]
            .into_iter()
            .flat_map(|friction| {
                pieces.load.iter().map(move |powers| {
                    let mut g = centred(powers).map(|g| sign * g);
                    g[0] += sign * rest.load + friction;
                    g
                })
            });
        // Forward in the twin's coordinate may be backward in the recording's.
        let ways = if sign < 0.0 { [1, 0] } else { [0, 1] };
        let unbent = if pieces.bends.is_empty() {
            rest.viscous
        } else {
            0.0
        };
        let damping = ways.into_iter().flat_map(|way| {
            let cells = pieces.damping.chunks(over_q * over_root).nth(way);
            cells
                .into_iter()
                .flatten()
                .enumerate()
                .map(move |(k, cell)| {
                    let [a, b] = cell.each_ref().map(centred);
                    // The place over the root counts from the middle of the first piece.
                    let from = (k % over_root) as f64 - 0.5;
                    let [a0, a1, a2] = core::array::from_fn(|k| a[k] - from * b[k]);
                    let [b0, b1, b2] = b;
                    let at = [k / over_root, k % over_root].map(|at| at as f64);
                    [[a0 + unbent, a1, a2, at[0]], [b0, b1, b2, at[1]]]
                })
        });
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
            load_over: Along::new(&pieces.load_over).by(coordinate),
            load: Table::of(load)?,
            over_q: Along::new(&pieces.over_q).by(coordinate),
            over_root: Along::new(&pieces.over_root),
            damping: Table::of(damping)?,
            counts: [loads, over_q, over_root].map(|count| count as f64),
            bends: bends.collect(),
            inertia: rest.inertia,
            viscous: rest.viscous,
            coulomb: rest.coulomb,
        })
    }

    /// Writes the efforts at a block of states; `last` is the piece of the states before them, and then of these.
    #[inline(always)]
    pub(super) fn efforts<const N: usize, F: Lanes<N>>(
        &self,
        simd: F,
        last: &mut Option<Piece>,
        states: [&[f64; BLOCK]; 3],
        out: &mut [f64; BLOCK],
    ) {
        if self.bends.is_empty() {
            self.block::<N, F, false>(simd, last, states, out);
        } else {
            self.block::<N, F, true>(simd, last, states, out);
        }
    }

    #[inline(always)]
    fn block<const N: usize, F: Lanes<N>, const BENT: bool>(
        &self,
        simd: F,
        last: &mut Option<Piece>,
        [q, dq, ddq]: [&[f64; BLOCK]; 3],
        out: &mut [f64; BLOCK],
    ) {
        let [q, dq, ddq] = [q.as_chunks().0, dq.as_chunks().0, ddq.as_chunks().0];
        let mut vectors = q.iter().zip(dq).zip(ddq).zip(out.as_chunks_mut().0);
        // A loop within a piece, so that its rows stay in registers, and a step elsewhere.
        loop {
            #[allow(
                clippy::manual_map,
                reason = "a closure would be compiled for less than the processor has"
            )]
            let within = match *last {
                Some(piece) => Some(self.within(simd, piece)),
                None => None,
            };
            loop {
                let Some((((q, dq), ddq), out)) = vectors.next() else {
                    return;
                };
                let (q, rate) = (simd.load(q), simd.load(dq));
                let there = match &within {
                    Some(within) => within.at(simd, q, rate),
                    None => None,
                };
                let is_there = there.is_some();
                let (load, share) = match there {
                    Some(found) => found,
                    None => self.anywhere(simd, q, rate, last),
                };
                self.write::<N, F, BENT>(simd, [load, share, rate], ddq, out);
                if !is_there {
                    break;
                }
            }
        }
    }

    #[inline(always)]
    fn within<const N: usize, F: Lanes<N>>(
        &self,
        simd: F,
        [load, cell]: Piece,
    ) -> Within<F::Vector> {
        let (g, [a, b]) = (self.load.row(load), self.damping.row(cell));
        let [loads, ..] = self.counts;
        let at = load - WHOLE;
        let (backward, at) = if at < loads {
            (false, at)
        } else {
            (true, at - loads)
        };
        let (over_q, over_root) = (a[3], b[3]);
        Within {
            sign: simd.all(if backward { -0.0 } else { 0.0 }),
            u: [
                simd.all(self.load_over.per_unit),
                simd.all(self.load_over.from - at),
            ],
            v: [
                simd.all(self.over_q.per_unit),
                simd.all(self.over_q.from - over_q),
            ],
            w: [
                simd.all(self.over_root.per_unit),
                simd.all(self.over_root.from - over_root),
            ],
            g: [
                simd.all(g[0]),
                simd.all(g[1]),
                simd.all(g[2]),
                simd.all(g[3]),
            ],
            // From the middle of this piece over the root.
            a: [
                simd.all(a[0] + over_root * b[0]),
                simd.all(a[1] + over_root * b[1]),
                simd.all(a[2] + over_root * b[2]),
            ],
            b: [simd.all(b[0]), simd.all(b[1]), simd.all(b[2])],
        }
    }

    /// As [`Within::at`] of states in any pieces; `last` becomes that of the last two of them, when that is one.
    #[inline(always)]
    fn anywhere<const N: usize, F: Lanes<N>>(
        &self,
        simd: F,
        q: F::Vector,
        rate: F::Vector,
        last: &mut Option<Piece>,
    ) -> (F::Vector, F::Vector) {
        let [loads, over_q, over_root] = self.counts;
        let forward = simd.all(WHOLE);
        let mut places = [[0.0; N]; 3];
        let [at_load, at_cell, at_w] = &mut places;
        // Rounded before the direction comes in: between two pieces it is the same one in both.
        let along = self.load_over.of(simd, q);
        let i = rounded(simd, along);
        let u = simd.sub(along, i);
        let way = simd.if_below(rate, simd.all(WHOLE + loads), forward);
        let load = simd.add(i, way);
        let along = self.over_q.of(simd, q);
        let i = rounded(simd, along);
        let v = simd.sub(along, i);
        let w = self.over_root.of(simd, simd.root(simd.size(rate)));
        let way = simd.if_below(rate, simd.all(WHOLE + over_q * over_root), forward);
        let cell = simd.add(simd.mul_add(i, simd.all(over_root), way), rounded(simd, w));
        simd.store(load, at_load);
        simd.store(cell, at_cell);
        simd.store(w, at_w);
        let mut loads = [self.load.row(at_load[0]); N];
        let mut cells = [self.damping.row(at_cell[0]); N];
        for k in 1..N {
            loads[k] = self.load.row(at_load[k]);
            cells[k] = self.damping.row(at_cell[k]);
        }
        let [g0, g1, g2, g3] = simd.columns(loads);
        let [c0, c1, c2] = simd.mixed_columns(cells, at_w);
        let load = simd.mul_add(simd.mul_add(simd.mul_add(g3, u, g2), u, g1), u, g0);
        let load = simd.add(load, simd.if_zero(rate, simd.all(-self.coulomb)));
        // Where the last two lie in one piece, the next may, too: not so in states of no order. What is no number lies in none.
        let piece = |k: usize| [at_load[k], at_cell[k]];
        let is_one = piece(N - 2) == piece(N - 1);
        *last = is_one.then_some(piece(N - 1));
        (load, simd.mul_add(simd.mul_add(c2, v, c1), v, c0))
    }

    /// Writes the efforts at `N` states by load, damping and rate.
    #[inline(always)]
    fn write<const N: usize, F: Lanes<N>, const BENT: bool>(
        &self,
        simd: F,
        [load, share, rate]: [F::Vector; 3],
        ddq: &[f64; N],
        out: &mut [f64; N],
    ) {
        let rest = simd.mul_add(simd.load(ddq), simd.all(self.inertia), load);
        let effort = if BENT {
            let rest = simd.mul_add(rate, simd.all(self.viscous), rest);
            simd.add(rest, self.bent(simd, share, rate))
        } else {
            simd.mul_add(share, rate, rest)
        };
        simd.store(effort, out);
    }

    /// What a valve makes of `share dq`.
    #[inline(always)]
    fn bent<const N: usize, F: Lanes<N>>(
        &self,
        simd: F,
        share: F::Vector,
        rate: F::Vector,
    ) -> F::Vector {
        let none = simd.all(0.0);
        let whole = simd.mul_add(share, rate, none);
        let size = simd.if_below(rate, simd.sub(none, whole), whole);
        let mut bent = size;
        for [forward, backward] in &self.bends {
            let [at, change] =
                [0, 1].map(|k| simd.if_below(rate, simd.all(backward[k]), simd.all(forward[k])));
            bent = simd.mul_add(simd.max(none, simd.sub(size, at)), change, bent);
        }
        simd.if_below(rate, simd.sub(none, bent), bent)
    }
}

/// The nearest whole numbers.
#[inline(always)]
fn rounded<const N: usize, F: Lanes<N>>(simd: F, x: F::Vector) -> F::Vector {
    let whole = simd.all(WHOLE);
    simd.sub(simd.add(x, whole), whole)
}

/// The powers of u from -1/2 to 1/2 of those from 0 to 1.
fn centred<const N: usize>(powers: &[f64; N]) -> [f64; N] {
    let mut out = *powers;
    for k in 0..N {
        for higher in (k..N - 1).rev() {
            out[higher] += 0.5 * out[higher + 1];
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::lanes::Plain;
    use super::super::pieces::tests::over;
    use super::*;
    use proptest::prelude::*;

    const REST: Rest = Rest {
        inertia: 2.0,
        coulomb: 0.3,
        viscous: 0.2,
        load: 0.1,
    };

    struct Once<'a, const N: usize, F> {
        simd: F,
        rows: &'a Rows,
        states: [&'a [f64; BLOCK]; 3],
    }

    impl<const N: usize, F: Lanes<N>> pulp::NullaryFnOnce for Once<'_, N, F> {
        type Output = [f64; BLOCK];

        fn call(self) -> [f64; BLOCK] {
            let (mut out, mut last) = ([0.0; BLOCK], None);
            for _ in 0..2 {
                self.rows
                    .efforts(self.simd, &mut last, self.states, &mut out);
            }
            out
        }
    }

    /// The efforts by whatever this processor has.
    fn efforts(rows: &Rows, states: [&[f64; BLOCK]; 3]) -> Vec<[f64; BLOCK]> {
        let simd = Plain;
        let plain = pulp::NullaryFnOnce::call(Once { simd, rows, states });
        #[cfg(target_arch = "x86_64")]
        {
            let mut all = vec![plain];
            all.extend(
                pulp::x86::V3::try_new().map(|simd| simd.vectorize(Once { simd, rows, states })),
            );
            all.extend(
                pulp::x86::V4::try_new().map(|simd| simd.vectorize(Once { simd, rows, states })),
            );
            all
        }
        #[cfg(not(target_arch = "x86_64"))]
        vec![plain]
    }

    proptest! {
        #[test]
        fn rows_are_the_pieces_inside_and_outside_in_either_sense(
            seed: u64, load in (1_usize..21, 0_usize..4), over_q in (1_usize..13, 0_usize..3), over_root in (1_usize..4, 0_usize..2),
            end_of_damping in 0.5..1.5_f64,
            bends in (0_usize..3, 0_usize..3), reversed: bool, offset in -2.0..2.0_f64,
            spread in prop_oneof![Just(1.0), Just(0.1), Just(0.01)],
            states in proptest::collection::vec((-0.6..1.4_f64, -3.0..3.0_f64, -5.0..5.0_f64), BLOCK),
        ) {
            let counts = [load.0, over_q.0, over_root.0];
            let mechanism = over([[-0.2, 1.0], [-0.2, end_of_damping]], seed, counts, [load.1, over_q.1, over_root.1], [bends.0, bends.1]);
            let pieces = Pieces::of(&mechanism);
            let sign = if reversed { -1.0 } else { 1.0 };
            let rows = Rows::of(Some(&pieces), REST, Coordinate { sign, offset }).unwrap();
            let of = |i: usize| core::array::from_fn(|k| {
                // Close to the first: most of them in its piece.
                let close = |of: fn(&(f64, f64, f64)) -> f64| of(&states[0]) + spread * (of(&states[k]) - of(&states[0]));
                let (q, dq, ddq) = (close(|s| s.0), close(|s| s.1), states[k].2);
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
    fn only_what_lies_in_a_piece_is_of_it() {
        let pieces = Pieces::of(&over([[0.0, 1.0]; 2], 3, [10, 5, 2], [3, 2, 1], [0, 0]));
        for (sign, offset) in [(1.0, 0.0), (-1.0, 0.3)] {
            let rows = Rows::of(Some(&pieces), REST, Coordinate { sign, offset }).unwrap();
            let mut last = None;
            let of = |q: f64| sign * q + offset;
            let load = |q: f64, rate: f64, last: &mut Option<Piece>| {
                rows.anywhere(Plain, [of(q); 4], [rate; 4], last)
            };
            // The middle of a piece over q, 0.45, is not one of damping's, 0.5.
            let wanted = load(0.45, -0.5, &mut last);
            let within = rows.within(Plain, last.unwrap());
            let found = within.at(Plain, [of(0.45); 4], [-0.5; 4]).unwrap();
            for (found, wanted) in [(found.0, wanted.0), (found.1, wanted.1)] {
                assert!((found[0] - wanted[0]).abs() < 1e-12, "{found:?} {wanted:?}");
            }
            let mut beside = [of(0.45); 4];
            assert!(within.at(Plain, beside, [-0.6; 4]).is_some());
            beside[3] = of(0.51);
            assert!(within.at(Plain, beside, [-0.5; 4]).is_none());
            for rate in [0.5, 0.0, -0.0, -0.4, -2.0, f64::NAN] {
                let rates = [-0.5, -0.5, rate, -0.5];
                assert!(within.at(Plain, [of(0.45); 4], rates).is_none(), "{rate}");
            }
            assert!(within.at(Plain, [f64::INFINITY; 4], [-0.5; 4]).is_none());
            // Of states in no order none is kept.
            rows.anywhere(
                Plain,
                [of(0.1), of(0.2), of(0.3), of(0.6)],
                [0.5; 4],
                &mut last,
            );
            assert!(last.is_none());
        }
    }

    #[test]
    fn what_is_too_large_has_no_rows() {
        let fits = |interval: [f64; 2], pieces: [usize; 3]| {
            let pieces = Pieces::of(&over([interval; 2], 1, pieces, [3, 2, 1], [0, 0]));
            let coordinate = Coordinate {
                sign: 1.0,
                offset: 0.0,
            };
            Rows::of(Some(&pieces), REST, coordinate).is_some()
        };
        assert!(fits([0.0, 1.0], [LOADS / 2, 12, 3]));
        assert!(!fits([0.0, 1.0], [LOADS / 2 + 1, 12, 3]));
        assert!(fits([0.0, 1.0], [20, CELLS / 8, 4]));
        assert!(!fits([0.0, 1.0], [20, CELLS / 8 + 1, 4]));
        assert!(!fits([0.0, 1e-12], [20, 12, 3]));
    }

    /// At rest a root from below 0 on would lie in the middle of a piece, whose rows are of one direction.
    #[test]
    fn roots_from_below_nothing_on_have_no_rows() {
        let mut pieces = Pieces::of(&over([[0.0, 1.0]; 2], 1, [20, 12, 3], [3, 2, 1], [0, 0]));
        let coordinate = Coordinate {
            sign: 1.0,
            offset: 0.0,
        };
        assert!(Rows::of(Some(&pieces), REST, coordinate).is_some());
        pieces.over_root.low = -0.1;
        assert!(Rows::of(Some(&pieces), REST, coordinate).is_none());
    }

    /// Between two steps both directions are on the same as one state by itself.
    #[test]
    fn between_two_steps_efforts_are_those_one_by_one() {
        let mut pieces = Pieces::of(&over([[0.0, 1.0]; 2], 7, [5, 5, 3], [0, 0, 0], [0, 0]));
        (pieces.over_root.low, pieces.over_root.per_unit) = (0.0, 2.0);
        let rest = Rest {
            inertia: 0.0,
            coulomb: 0.0,
            viscous: 0.0,
            load: 0.0,
        };
        let coordinate = Coordinate {
            sign: 1.0,
            offset: 0.0,
        };
        let rows = Rows::of(Some(&pieces), rest, coordinate).unwrap();
        let q: [f64; BLOCK] = core::array::from_fn(|k| [0.1, 0.2, 0.4, 0.8, 1.0][k % 5]);
        // Roots of 1/2 and 1.
        for rate in [0.25, 1.0, -0.25, -1.0] {
            for found in efforts(&rows, [&q, &[rate; BLOCK], &[0.0; BLOCK]]) {
                for (found, q) in found.iter().zip(q) {
                    let wanted = pieces.effort(q, rate);
                    assert!(
                        (found - wanted).abs() < 1e-12,
                        "{q} {rate}: {found} {wanted}"
                    );
                }
            }
        }
    }

    /// A vector of what is no number is in no piece, whatever its bits: what comes after it is what it is.
    #[test]
    fn what_is_no_number_does_not_spread() {
        let pieces = Pieces::of(&over([[0.0, 1.0]; 2], 5, [20, 12, 3], [3, 2, 1], [0, 0]));
        let (none, all) = (Pieces::nothing(), [1.0, -1.0]);
        for (pieces, sign) in all
            .iter()
            .flat_map(|sign| [(&pieces, *sign), (&none, *sign)])
        {
            let coordinate = Coordinate { sign, offset: 0.2 };
            let rows = Rows::of(Some(pieces), REST, coordinate).unwrap();
            let q = core::array::from_fn(|k| sign * (0.3 + 1e-3 * k as f64) + 0.2);
            for rate in [0.3, -0.3] {
                let rates = [rate; BLOCK];
                let wanted = efforts(&rows, [&q, &rates, &[0.5; BLOCK]]);
                for bits in [
                    f64::NAN.to_bits(),
                    f64::NAN.to_bits() | 0x1234_5678,
                    u64::MAX,
                    1 << 63 | f64::NAN.to_bits(),
                ] {
                    // Before and after states that are some.
                    for hole in [0..16, 8..24] {
                        let (mut holed_q, mut holed_rates) = (q, rates);
                        holed_q[hole.clone()].fill(f64::from_bits(bits));
                        holed_rates[hole.clone()].fill(f64::from_bits(bits));
                        for [q, rates] in [[&holed_q, &rates], [&q, &holed_rates]] {
                            let found = efforts(&rows, [q, rates, &[0.5; BLOCK]]);
                            for (found, wanted) in found.iter().zip(&wanted) {
                                for k in (0..BLOCK).filter(|k| !hole.contains(k)) {
                                    assert!((found[k] - wanted[k]).abs() < 1e-12, "{k} {found:?}");
                                }
                            }
                        }
                    }
                }
            }
        }
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
