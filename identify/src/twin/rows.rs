//! A twin's effort as rows of numbers, so that many efforts take little longer than the memory takes to bring their states and
//! to carry the efforts away.
//!
//! With u and v from -1/2 to 1/2 along the pieces of load and damping and w the place over the root of the speed,
//!
//! ```text
//! effort        = sum over k = 0..3 of g_k u^k + sum over k = 0..2 of (a_k + b_k w) v^k dq + I ddq + b dq
//! load's row    = g_0 g_1 g_2 g_3                 of a direction and a piece
//! damping's row = a_0 a_1 a_2 0   b_0 b_1 b_2 0   of a direction and a piece over q and over the root
//! ```
//!
//! with the constant load and the Coulomb friction of the direction in g_0. Both tables stay in the nearest cache beside the states
//! that pass through it. Rows are loaded whole and worked with as they lie, and only the sums of as many states as a vector holds are turned into
//! columns, where gathering a state's numbers one by one took most of the time. Places go through memory to the rows' numbers: out
//! of a vector they would take its permutations. The roots are those of the next block, so that the divider works while rows are read.

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

/// What the rows of a block are found and used by.
pub(super) struct Places {
    /// Indices of rows, in the lowest bits.
    load: [f64; BLOCK],
    cell: [f64; BLOCK],
    u: [f64; BLOCK],
    v: [f64; BLOCK],
    w: [f64; BLOCK],
    /// Of the speeds of the block that is next.
    roots: [f64; BLOCK],
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
                    let a = core::array::from_fn(|k| a[k] - from * b[k]);
                    [a, b].map(|[c0, c1, c2]: [f64; 3]| [c0, c1, c2, 0.0])
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

    /// The places of a first block.
    #[inline(always)]
    pub(super) fn places<const N: usize, F: Lanes<N>>(simd: F, dq: &[f64; BLOCK]) -> Places {
        let mut roots = [0.0; BLOCK];
        for (root, dq) in lanes_of_mut::<N>(&mut roots).zip(lanes_of::<N>(dq)) {
            simd.store(simd.root_of_size(simd.load(dq)), root);
        }
        let [load, cell, u, v, w] = [[0.0; BLOCK]; 5];
        Places {
            load,
            cell,
            u,
            v,
            w,
            roots,
        }
    }

    /// Writes the efforts at a block of states; `next` are the rates of the block after it.
    #[inline(always)]
    pub(super) fn efforts<const N: usize, F: Lanes<N>>(
        &self,
        simd: F,
        places: &mut Places,
        [q, dq, ddq]: [&[f64; BLOCK]; 3],
        next: &[f64; BLOCK],
        out: &mut [f64; BLOCK],
    ) {
        self.place(simd, q, dq, places);
        if self.bends.is_empty() {
            self.read::<N, F, false>(simd, places, [dq, ddq], next, out);
        } else {
            self.read::<N, F, true>(simd, places, [dq, ddq], next, out);
        }
    }

    #[inline(always)]
    fn place<const N: usize, F: Lanes<N>>(
        &self,
        simd: F,
        q: &[f64; BLOCK],
        dq: &[f64; BLOCK],
        places: &mut Places,
    ) {
        let [loads, over_q, over_root] = self.counts;
        let (forward, of_load) = (simd.all(WHOLE), simd.all(WHOLE + loads));
        let of_damping = simd.all(WHOLE + over_q * over_root);
        let over_root = simd.all(over_root);
        let found = lanes_of_mut::<N>(&mut places.load).zip(lanes_of_mut::<N>(&mut places.cell));
        let within = lanes_of_mut::<N>(&mut places.u).zip(lanes_of_mut::<N>(&mut places.v));
        let roots = lanes_of_mut::<N>(&mut places.w).zip(lanes_of::<N>(&places.roots));
        let states = lanes_of::<N>(q).zip(lanes_of::<N>(dq));
        for ((((load, cell), (u, v)), (w, root)), (q, dq)) in
            found.zip(within).zip(roots).zip(states)
        {
            let (q, dq) = (simd.load(q), simd.load(dq));
            let along = self.load_over.of(simd, q);
            let i = rounded(simd, along);
            simd.store(simd.sub(along, i), u);
            let way = simd.if_below(dq, of_load, forward);
            simd.store(simd.add(i, way), load);
            let along = self.over_q.of(simd, q);
            let i = rounded(simd, along);
            simd.store(simd.sub(along, i), v);
            let along = self.over_root.of(simd, simd.load(root));
            simd.store(along, w);
            let way = simd.if_below(dq, of_damping, forward);
            let first = simd.mul_add(i, over_root, way);
            simd.store(simd.add(rounded(simd, along), first), cell);
        }
    }

    #[inline(always)]
    fn read<const N: usize, F: Lanes<N>, const BENT: bool>(
        &self,
        simd: F,
        places: &mut Places,
        [dq, ddq]: [&[f64; BLOCK]; 2],
        next: &[f64; BLOCK],
        out: &mut [f64; BLOCK],
    ) {
        let (inertia, viscous) = (simd.all(self.inertia), simd.all(self.viscous));
        let not_at_rest = simd.all(-self.coulomb);
        let found = lanes_of::<N>(&places.load).zip(lanes_of::<N>(&places.cell));
        let within = lanes_of::<N>(&places.u)
            .zip(lanes_of::<N>(&places.v))
            .zip(lanes_of::<N>(&places.w));
        let states = lanes_of::<N>(dq)
            .zip(lanes_of::<N>(ddq))
            .zip(lanes_of::<N>(next));
        let after = lanes_of_mut::<N>(&mut places.roots).zip(lanes_of_mut::<N>(out));
        for ((((load, cell), ((u, v), w)), ((dq, ddq), next)), (root, out)) in
            found.zip(within).zip(states).zip(after)
        {
            simd.store(simd.root_of_size(simd.load(next)), root);
            let mut loads = [self.load.row(load[0]); N];
            let mut cells = [self.damping.row(cell[0]); N];
            for k in 1..N {
                loads[k] = self.load.row(load[k]);
                cells[k] = self.damping.row(cell[k]);
            }
            let [g0, g1, g2, g3] = simd.columns(loads);
            let [c0, c1, c2] = simd.mixed_columns(cells, w);
            let (u, v) = (simd.load(u), simd.load(v));
            let load = simd.mul_add(simd.mul_add(simd.mul_add(g3, u, g2), u, g1), u, g0);
            let share = simd.mul_add(simd.mul_add(c2, v, c1), v, c0);
            let rate = simd.load(dq);
            let rest = simd.mul_add(simd.load(ddq), inertia, simd.if_zero(rate, not_at_rest));
            let rest = simd.add(simd.mul_add(rate, viscous, rest), load);
            let effort = if BENT {
                simd.add(rest, self.bent(simd, share, rate))
            } else {
                simd.mul_add(share, rate, rest)
            };
            simd.store(effort, out);
        }
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

#[inline(always)]
fn lanes_of<const N: usize>(block: &[f64; BLOCK]) -> impl Iterator<Item = &[f64; N]> {
    block.as_chunks().0.iter()
}

#[inline(always)]
fn lanes_of_mut<const N: usize>(block: &mut [f64; BLOCK]) -> impl Iterator<Item = &mut [f64; N]> {
    block.as_chunks_mut().0.iter_mut()
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
            let mut out = [0.0; BLOCK];
            let [_, dq, _] = self.states;
            let mut places = Rows::places(self.simd, dq);
            for _ in 0..2 {
                self.rows
                    .efforts(self.simd, &mut places, self.states, dq, &mut out);
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
            states in proptest::collection::vec((-0.6..1.4_f64, -3.0..3.0_f64, -5.0..5.0_f64), BLOCK),
        ) {
            let counts = [load.0, over_q.0, over_root.0];
            let mechanism = over([[-0.2, 1.0], [-0.2, end_of_damping]], seed, counts, [load.1, over_q.1, over_root.1], [bends.0, bends.1]);
            let pieces = Pieces::of(&mechanism);
            let sign = if reversed { -1.0 } else { 1.0 };
            let rows = Rows::of(Some(&pieces), REST, Coordinate { sign, offset }).unwrap();
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
