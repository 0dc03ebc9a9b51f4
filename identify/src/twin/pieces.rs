//! A mechanism's splines with one polynomial per piece, so that an effort takes a few nanoseconds.
//!
//! On uniform knots every piece of a B-spline combines its coefficients alike, into a polynomial in `u`, 0 to 1 along the
//! piece. Outside its interval `u` stays where it left it: the curve goes on at its end value. Many states at once:
//! [`super::rows`].

use super::{Spline, SurfaceSpline, TwinMechanism};

/// Coefficients of a piece of the load, of the damping over q and over the root of the speed: one more than the degrees.
pub(super) const LOAD: usize = 4;
pub(super) const OVER_Q: usize = 3;
pub(super) const OVER_SPEED: usize = 2;
/// Above it a double has no fraction: to add it rounds, and leaves the whole number in the lowest bits.
const WHOLE: f64 = 4_503_599_627_370_496.0;

type Cell = [[f64; OVER_Q]; OVER_SPEED];

/// `g(q) + P(c(q, |dq|) |dq|) sgn(dq)` ready for evaluation, and its derivatives.
#[derive(Clone, Debug)]
pub(super) struct Pieces {
    pub(super) load_over: Pitch,
    pub(super) load: Vec<[f64; LOAD]>,
    pub(super) over_q: Pitch,
    pub(super) over_root: Pitch,
    /// Index = (way * pieces over q + i_q) * pieces over the root + i_root; way 0 forward, 1 backward.
    pub(super) damping: Vec<Cell>,
    /// Per bend and way: where the valve bends, and by how much.
    pub(super) bends: Vec<[[f64; 2]; 2]>,
}

/// An interval cut into equal pieces.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pitch {
    pub(super) low: f64,
    pub(super) per_unit: f64,
    pieces: f64,
}

impl Pitch {
    fn new([low, high]: [f64; 2], pieces: usize) -> Self {
        let pieces = pieces.max(1) as f64;
        Self {
            low,
            per_unit: pieces / (high - low).max(f64::MIN_POSITIVE),
            pieces,
        }
    }

    /// The piece, and the place in it, 0 to 1. Of no number any piece, and no place.
    #[inline(always)]
    #[allow(
        clippy::cast_possible_truncation,
        reason = "the lowest bits are wanted"
    )]
    fn place(&self, x: f64) -> (u32, f64) {
        let along = ((x - self.low) * self.per_unit).clamp(0.0, self.pieces);
        let piece = (along - 0.5).clamp(0.0, self.pieces - 1.0) + WHOLE;
        (piece.to_bits() as u32, along - (piece - WHOLE))
    }

    /// How many.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "it was a number of pieces"
    )]
    pub(super) fn count(&self) -> usize {
        self.pieces as usize
    }

    /// Derivative of the place along the interval: none where it is clamped.
    fn slope(&self, x: f64) -> f64 {
        let along = (x - self.low) * self.per_unit;
        if (0.0..=self.pieces).contains(&along) {
            self.per_unit
        } else {
            0.0
        }
    }
}

impl Pieces {
    /// Of a mechanism whose degrees are at most 3 (load) and 2 and 1 (damping) and whose directions are cut alike, as a file's are checked to be.
    pub(super) fn of(mechanism: &TwinMechanism) -> Self {
        let [first, _] = &mechanism.damping;
        let [over_q, over_root] = first.pieces.map(|pieces| pieces.max(1));
        let cells = mechanism.damping.iter().flat_map(|surface| {
            (0..over_q).flat_map(move |i| (0..over_root).map(move |j| cell(surface, i, j)))
        });
        let most = mechanism.damping.iter().map(|way| way.valve.bends.len());
        let bends = (0..most.max().unwrap_or(0)).map(|k| {
            mechanism.damping.each_ref().map(|way| {
                let bends = &way.valve.bends;
                let before = if k == 0 {
                    Some(1.0)
                } else {
                    bends.get(k - 1).map(|bend| bend.slope)
                };
                bends.get(k).map_or([f64::INFINITY, 0.0], |bend| {
                    [bend.at, bend.slope - before.unwrap_or(1.0)]
                })
            })
        });
        Self {
            load_over: Pitch::new(mechanism.load.interval, mechanism.load.pieces),
            load: pieces_of_load(&mechanism.load),
            over_q: Pitch::new(first.interval_q, over_q),
            over_root: Pitch::new(first.interval_sqrt_speed, over_root),
            damping: cells.collect(),
            bends: bends.collect(),
        }
    }

    /// No mechanism: no effort anywhere, but of what is no number.
    pub(super) fn nothing() -> Self {
        // One piece that no state leaves.
        let all = Pitch::new([-1e6, 1e6], 1);
        Self {
            load_over: all,
            load: vec![[0.0; LOAD]],
            over_q: all,
            over_root: Pitch::new([0.0, 1e6], 1),
            damping: vec![[[0.0; OVER_Q]; OVER_SPEED]; 2],
            bends: Vec::new(),
        }
    }

    /// The effort at a state.
    pub(super) fn effort(&self, q: f64, dq: f64) -> f64 {
        let (piece, u) = self.load_over.place(q);
        let speed = dq.abs();
        let (cell, v, w) = self.damping_place(q, dq, speed);
        let way = usize::from(dq < 0.0);
        let size = self.bent(self.damping(cell, v, w) * speed, way);
        self.load(piece, u) + if dq < 0.0 { -size } else { size }
    }

    /// Derivatives of the effort by q and dq; at rest those of the forward direction.
    pub(super) fn gradient(&self, q: f64, dq: f64) -> [f64; 2] {
        let (piece, u) = self.load_over.place(q);
        let [_, c1, c2, c3] = self.load.get(piece as usize).copied().unwrap_or_default();
        let load_by_q = self.load_over.slope(q) * (c1 + u * (2.0 * c2 + 3.0 * c3 * u));
        let speed = dq.abs();
        let (cell, v, w) = self.damping_place(q, dq, speed);
        let [a, b] = self.damping.get(cell as usize).copied().unwrap_or_default();
        let c = quadratic(a, v) + w * quadratic(b, v);
        let by_v = |[_, p, q]: [f64; OVER_Q]| p + 2.0 * q * v;
        let c_by_q = self.over_q.slope(q) * (by_v(a) + w * by_v(b));
        let c_by_root = self.over_root.slope(speed.sqrt()) * quadratic(b, v);
        let way = usize::from(dq < 0.0);
        let sign = if dq < 0.0 { -1.0 } else { 1.0 };
        let bends = self.bends.iter().map(|bend| bend[way]);
        let passed = bends.filter(|[at, _]| c * speed > *at);
        let through = 1.0 + passed.map(|[_, change]| change).sum::<f64>();
        [
            load_by_q + sign * through * c_by_q * speed,
            // c depends on the root of the speed, whose derivative times the speed is half the root.
            through * (c + 0.5 * speed.sqrt() * c_by_root),
        ]
    }

    /// Index of a damping's cell, and the places in it over q and over the root of the speed.
    #[inline(always)]
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "numbers of pieces"
    )]
    fn damping_place(&self, q: f64, dq: f64, speed: f64) -> (u32, f64, f64) {
        let (i, v) = self.over_q.place(q);
        let (j, w) = self.over_root.place(speed.sqrt());
        let (rows, row) = (self.over_q.pieces as u32, self.over_root.pieces as u32);
        let way = if dq < 0.0 { rows } else { 0 };
        (i.wrapping_add(way).wrapping_mul(row).wrapping_add(j), v, w)
    }

    #[inline(always)]
    fn load(&self, piece: u32, u: f64) -> f64 {
        let [c0, c1, c2, c3] = self.load.get(piece as usize).unwrap_or(&[f64::NAN; LOAD]);
        ((c3 * u + c2) * u + c1) * u + c0
    }

    #[inline(always)]
    fn damping(&self, cell: u32, v: f64, w: f64) -> f64 {
        let none = &[[f64::NAN; OVER_Q]; OVER_SPEED];
        let [a, b] = self.damping.get(cell as usize).unwrap_or(none);
        quadratic(*a, v) + w * quadratic(*b, v)
    }

    /// What the valve makes of an effort that it would have in proportion.
    fn bent(&self, size: f64, way: usize) -> f64 {
        let bends = self.bends.iter().map(|bend| bend[way]);
        size + bends
            .map(|[at, change]| change * (size - at).max(0.0))
            .sum::<f64>()
    }
}

#[inline(always)]
fn quadratic([c0, c1, c2]: [f64; OVER_Q], v: f64) -> f64 {
    (c2 * v + c1) * v + c0
}

fn pieces_of_load(spline: &Spline) -> Vec<[f64; LOAD]> {
    let powers = powers::<LOAD>(spline.degree);
    let piece = |i: usize| {
        let mut out = [0.0; LOAD];
        for (j, power) in powers.iter().enumerate().take(spline.degree + 1) {
            let c = spline.coefficients.get(i + j).copied().unwrap_or(0.0);
            add(&mut out, c, power);
        }
        out
    };
    (0..spline.pieces.max(1)).map(piece).collect()
}

fn cell(surface: &SurfaceSpline, i: usize, j: usize) -> Cell {
    let [degree_q, degree_root] = surface.degree;
    let (over_q, over_root) = (
        powers::<OVER_Q>(degree_q),
        powers::<OVER_SPEED>(degree_root),
    );
    let row = surface.pieces[1] + degree_root;
    let mut out = [[0.0; OVER_Q]; OVER_SPEED];
    for (a, in_q) in over_q.iter().enumerate().take(degree_q + 1) {
        for (b, in_root) in over_root.iter().enumerate().take(degree_root + 1) {
            let at = (i + a) * row + j + b;
            let c = surface.coefficients.get(at).copied().unwrap_or(0.0);
            for (sum, share) in out.iter_mut().zip(in_root) {
                add(sum, c * share, in_q);
            }
        }
    }
    out
}

fn add<const N: usize>(out: &mut [f64; N], factor: f64, power: &[f64; N]) {
    for (sum, share) in out.iter_mut().zip(power) {
        *sum += factor * share;
    }
}

/// Coefficients of the powers of `u` in the functions of `degree` (below `N`) that are not zero on a piece, the first one first (Cox and
/// de Boor on unit knots, [`crate::spline::Basis::evaluate`] as polynomials).
fn powers<const N: usize>(degree: usize) -> [[f64; N]; N] {
    let mut functions = [[0.0; N]; N];
    functions[0][0] = 1.0;
    for d in 1..=degree.min(N - 1) {
        let mut next = [[0.0; N]; N];
        for (j, old) in functions.iter().enumerate().take(d) {
            // Times (j + 1 - u) / d, and times (u + d - 1 - j) / d for the following function.
            for (k, c) in old.iter().enumerate().take(d) {
                let c = c / d as f64;
                next[j][k] += (j + 1) as f64 * c;
                next[j][k + 1] -= c;
                next[j + 1][k] += (d - 1 - j) as f64 * c;
                next[j + 1][k + 1] += c;
            }
        }
        functions = next;
    }
    functions
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::mechanism::{Bend, Valve};
    use crate::spline::Basis;
    use proptest::prelude::*;

    fn random(seed: &mut u64) -> f64 {
        *seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Load over -0.2 to 1 and damping over -0.3 to 1.1.
    fn mechanism(
        seed: u64,
        pieces: [usize; 3],
        degree: [usize; 3],
        bends: [usize; 2],
    ) -> TwinMechanism {
        over([[-0.2, 1.0], [-0.3, 1.1]], seed, pieces, degree, bends)
    }

    /// Load and damping over intervals; pieces and degrees of the load, of the damping over q and over the root of the speed; bends of
    /// the valves of both ways.
    pub(in crate::twin) fn over(
        [load_over, interval_q]: [[f64; 2]; 2],
        seed: u64,
        pieces: [usize; 3],
        degree: [usize; 3],
        bends: [usize; 2],
    ) -> TwinMechanism {
        let mut seed = seed;
        let mut many = |n: usize| -> Vec<f64> { (0..n).map(|_| 5.0 * random(&mut seed)).collect() };
        let [load, over_q, over_root] = pieces;
        let functions = (over_q + degree[1]) * (over_root + degree[2]);
        let damping = bends.map(|bends| SurfaceSpline {
            interval_q,
            interval_sqrt_speed: [0.0, 1.4],
            pieces: [over_q, over_root],
            degree: [degree[1], degree[2]],
            coefficients: many(functions),
            valve: Valve {
                bends: (0..bends)
                    .map(|k| Bend {
                        at: 2.0 + k as f64,
                        slope: 0.7 / (k + 1) as f64,
                    })
                    .collect(),
            },
        });
        TwinMechanism {
            kind: "spline".to_owned(),
            load: Spline {
                interval: load_over,
                pieces: load,
                degree: degree[0],
                coefficients: many(load + degree[0]),
            },
            damping,
        }
    }

    /// The B-splines themselves.
    fn by_basis(mechanism: &TwinMechanism, q: f64, dq: f64) -> f64 {
        let load = &mechanism.load;
        let [low, high] = load.interval;
        let g = Basis::new(low, high, load.pieces, load.degree).value(&load.coefficients, q);
        let surface = &mechanism.damping[usize::from(dq < 0.0)];
        let basis = |[low, high]: [f64; 2], i: usize| {
            Basis::new(low, high, surface.pieces[i], surface.degree[i])
        };
        let (in_q, in_root) = (
            basis(surface.interval_q, 0),
            basis(surface.interval_sqrt_speed, 1),
        );
        let (first_q, by_q) = in_q.evaluate(q);
        let (first_root, by_root) = in_root.evaluate(dq.abs().sqrt());
        let mut c = 0.0;
        for (i, by_q) in by_q.iter().enumerate().take(in_q.degree() + 1) {
            for (j, by_root) in by_root.iter().enumerate().take(in_root.degree() + 1) {
                let at = (first_q + i) * in_root.len() + first_root + j;
                c += surface.coefficients[at] * by_q * by_root;
            }
        }
        g + surface.valve.effort(c * dq.abs()) * if dq < 0.0 { -1.0 } else { 1.0 }
    }

    proptest! {
        #[test]
        fn pieces_are_the_splines_inside_and_outside(
            seed: u64, load in (1_usize..25, 0_usize..LOAD), over_q in (1_usize..45, 0_usize..OVER_Q),
            over_root in (1_usize..5, 0_usize..OVER_SPEED), bends in (0_usize..3, 0_usize..3),
            q in -0.6..1.4_f64, dq in -3.0..3.0_f64,
        ) {
            let of = mechanism(seed, [load.0, over_q.0, over_root.0], [load.1, over_q.1, over_root.1], [bends.0, bends.1]);
            let (pieces, wanted) = (Pieces::of(&of), by_basis(&of, q, dq));
            prop_assert!((pieces.effort(q, dq) - wanted).abs() < 1e-9 * wanted.abs().max(1.0));
        }

        #[test]
        fn derivatives_are_those_of_the_effort(seed: u64, bends in (0_usize..3, 0_usize..3), q in -0.6..1.4_f64, dq in -3.0..3.0_f64) {
            let pieces = Pieces::of(&mechanism(seed, [7, 9, 3], [3, 2, 1], [bends.0, bends.1]));
            let h = 1e-6;
            let found = pieces.gradient(q, dq);
            // Between knots and bends: where the derivative is the same on both sides.
            let (before, after) = (pieces.gradient(q - h, dq - h), pieces.gradient(q + h, dq + h));
            prop_assume!(dq.abs() > 10.0 * h && (0..2).all(|i| (before[i] - after[i]).abs() < 1e-2));
            let by_q = (pieces.effort(q + h, dq) - pieces.effort(q - h, dq)) / (2.0 * h);
            let by_dq = (pieces.effort(q, dq + h) - pieces.effort(q, dq - h)) / (2.0 * h);
            prop_assert!((found[0] - by_q).abs() < 1e-2, "{found:?} {by_q}");
            prop_assert!((found[1] - by_dq).abs() < 1e-2, "{found:?} {by_dq}");
        }
    }

    #[test]
    fn what_is_no_number_stays_none_and_ends_are_no_edge() {
        let pieces = Pieces::of(&mechanism(3, [20, 12, 3], [3, 2, 1], [1, 0]));
        for bits in [
            f64::NAN.to_bits(),
            f64::NAN.to_bits() | 0x1234_5678,
            0xffff_ffff_ffff_ffff,
        ] {
            let nothing = f64::from_bits(bits);
            assert!(pieces.effort(nothing, 0.1).is_nan() && pieces.effort(0.1, nothing).is_nan());
        }
        for end in [f64::INFINITY, f64::NEG_INFINITY, 1e300] {
            assert!(pieces.effort(end, 0.1).is_finite());
        }
    }
}
