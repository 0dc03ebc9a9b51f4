//! Several doubles at once, as far as the efforts of many states need them: eight in a vector of x86-64 with AVX-512, four with AVX2 and
//! fused multiplication, or four as the compiler makes it of plain arrays.

/// How `N` doubles are worked with; the processor can.
pub(super) trait Lanes<const N: usize>: Copy {
    /// `N` doubles.
    type Vector: Copy;
    /// From memory.
    fn load(self, from: &[f64; N]) -> Self::Vector;
    /// To memory.
    fn store(self, from: Self::Vector, to: &mut [f64; N]);
    /// The same `N` times.
    fn all(self, value: f64) -> Self::Vector;
    /// a + b
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a - b
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a b + c
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// Square roots.
    fn root(self, a: Self::Vector) -> Self::Vector;
    /// Without signs.
    fn size(self, a: Self::Vector) -> Self::Vector;
    /// Bits that differ.
    fn xor(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// Whether a < b in all.
    fn all_below(self, a: Self::Vector, b: Self::Vector) -> bool;
    /// The larger; the second where one is no number.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The smaller; the second where one is no number.
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `then` where `a` is below 0, elsewhere `or`.
    fn if_below(self, a: Self::Vector, then: Self::Vector, or: Self::Vector) -> Self::Vector;
    /// `then` where `a` is 0, elsewhere 0.
    fn if_zero(self, a: Self::Vector, then: Self::Vector) -> Self::Vector;
    /// The rows of `N` states as four columns.
    fn columns(self, rows: [&[f64; 4]; N]) -> [Self::Vector; 4];
    /// The first three columns of `a + b w`; `rows` are a and b of each state.
    fn mixed_columns(self, rows: [&[[f64; 4]; 2]; N], w: &[f64; N]) -> [Self::Vector; 3];
}

/// Arrays, on any processor.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plain;

impl Plain {
    #[inline(always)]
    fn each(a: [f64; 4], b: [f64; 4], of: impl Fn(f64, f64) -> f64) -> [f64; 4] {
        [
            of(a[0], b[0]),
            of(a[1], b[1]),
            of(a[2], b[2]),
            of(a[3], b[3]),
        ]
    }
}

impl Lanes<4> for Plain {
    type Vector = [f64; 4];

    #[inline(always)]
    fn load(self, from: &[f64; 4]) -> [f64; 4] {
        *from
    }

    #[inline(always)]
    fn store(self, from: [f64; 4], to: &mut [f64; 4]) {
        *to = from;
    }

    #[inline(always)]
    fn all(self, value: f64) -> [f64; 4] {
        [value; 4]
    }

    #[inline(always)]
    fn add(self, a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
        Self::each(a, b, |a, b| a + b)
    }

    #[inline(always)]
    fn sub(self, a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
        Self::each(a, b, |a, b| a - b)
    }

    // Not fused: where the processor cannot, that is a call.
    #[inline(always)]
    fn mul_add(self, a: [f64; 4], b: [f64; 4], c: [f64; 4]) -> [f64; 4] {
        self.add(Self::each(a, b, |a, b| a * b), c)
    }

    #[inline(always)]
    fn root(self, a: [f64; 4]) -> [f64; 4] {
        a.map(|a| a.sqrt())
    }

    #[inline(always)]
    fn size(self, a: [f64; 4]) -> [f64; 4] {
        a.map(|a| a.abs())
    }

    #[inline(always)]
    fn xor(self, a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
        Self::each(a, b, |a, b| f64::from_bits(a.to_bits() ^ b.to_bits()))
    }

    #[inline(always)]
    fn all_below(self, a: [f64; 4], b: [f64; 4]) -> bool {
        a[0] < b[0] && a[1] < b[1] && a[2] < b[2] && a[3] < b[3]
    }

    #[inline(always)]
    fn max(self, a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
        Self::each(a, b, |a, b| if a > b { a } else { b })
    }

    #[inline(always)]
    fn min(self, a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
        Self::each(a, b, |a, b| if a < b { a } else { b })
    }

    #[inline(always)]
    fn if_below(self, a: [f64; 4], then: [f64; 4], or: [f64; 4]) -> [f64; 4] {
        core::array::from_fn(|k| if a[k] < 0.0 { then[k] } else { or[k] })
    }

    #[inline(always)]
    fn if_zero(self, a: [f64; 4], then: [f64; 4]) -> [f64; 4] {
        Self::each(a, then, |a, then| if a == 0.0 { then } else { 0.0 })
    }

    #[inline(always)]
    fn columns(self, rows: [&[f64; 4]; 4]) -> [[f64; 4]; 4] {
        let column = |k: usize| [rows[0][k], rows[1][k], rows[2][k], rows[3][k]];
        [column(0), column(1), column(2), column(3)]
    }

    #[inline(always)]
    fn mixed_columns(self, rows: [&[[f64; 4]; 2]; 4], w: &[f64; 4]) -> [[f64; 4]; 3] {
        let of = |i: usize, k: usize| rows[i][0][k] + rows[i][1][k] * w[i];
        let column = |k: usize| [of(0, k), of(1, k), of(2, k), of(3, k)];
        [column(0), column(1), column(2)]
    }
}

#[cfg(target_arch = "x86_64")]
impl Lanes<4> for pulp::x86::V3 {
    type Vector = pulp::f64x4;

    #[inline(always)]
    fn load(self, from: &[f64; 4]) -> pulp::f64x4 {
        pulp::cast(*from)
    }

    #[inline(always)]
    fn store(self, from: pulp::f64x4, to: &mut [f64; 4]) {
        *to = pulp::cast(from);
    }

    #[inline(always)]
    fn all(self, value: f64) -> pulp::f64x4 {
        self.splat_f64x4(value)
    }

    #[inline(always)]
    fn add(self, a: pulp::f64x4, b: pulp::f64x4) -> pulp::f64x4 {
        self.add_f64x4(a, b)
    }

    #[inline(always)]
    fn sub(self, a: pulp::f64x4, b: pulp::f64x4) -> pulp::f64x4 {
        self.sub_f64x4(a, b)
    }

    #[inline(always)]
    fn mul_add(self, a: pulp::f64x4, b: pulp::f64x4, c: pulp::f64x4) -> pulp::f64x4 {
        self.mul_add_f64x4(a, b, c)
    }

    #[inline(always)]
    fn root(self, a: pulp::f64x4) -> pulp::f64x4 {
        self.sqrt_f64x4(a)
    }

    #[inline(always)]
    fn size(self, a: pulp::f64x4) -> pulp::f64x4 {
        self.abs_f64x4(a)
    }

    #[inline(always)]
    fn xor(self, a: pulp::f64x4, b: pulp::f64x4) -> pulp::f64x4 {
        self.xor_f64x4(a, b)
    }

    #[inline(always)]
    fn all_below(self, a: pulp::f64x4, b: pulp::f64x4) -> bool {
        let below = self.cmp_lt_f64x4(a, b);
        self.avx._mm256_movemask_pd(pulp::cast(below)) == 0xf
    }

    #[inline(always)]
    fn max(self, a: pulp::f64x4, b: pulp::f64x4) -> pulp::f64x4 {
        pulp::cast(self.avx._mm256_max_pd(pulp::cast(a), pulp::cast(b)))
    }

    #[inline(always)]
    fn min(self, a: pulp::f64x4, b: pulp::f64x4) -> pulp::f64x4 {
        pulp::cast(self.avx._mm256_min_pd(pulp::cast(a), pulp::cast(b)))
    }

    #[inline(always)]
    fn if_below(self, a: pulp::f64x4, then: pulp::f64x4, or: pulp::f64x4) -> pulp::f64x4 {
        self.select_f64x4(self.cmp_lt_f64x4(a, self.all(0.0)), then, or)
    }

    #[inline(always)]
    fn if_zero(self, a: pulp::f64x4, then: pulp::f64x4) -> pulp::f64x4 {
        self.select_f64x4(self.cmp_eq_f64x4(a, self.all(0.0)), then, self.all(0.0))
    }

    #[inline(always)]
    fn columns(self, rows: [&[f64; 4]; 4]) -> [pulp::f64x4; 4] {
        let [a, b, c, d] = rows;
        turned(self, [*a, *b, *c, *d].map(pulp::cast))
    }

    #[inline(always)]
    fn mixed_columns(self, rows: [&[[f64; 4]; 2]; 4], w: &[f64; 4]) -> [pulp::f64x4; 3] {
        let [a, b, c, d] = rows;
        let mixed = [
            mixed(self, a, w[0]),
            mixed(self, b, w[1]),
            mixed(self, c, w[2]),
            mixed(self, d, w[3]),
        ];
        let [a, b, c, _] = turned(self, mixed);
        [a, b, c]
    }
}

/// a + b w
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn mixed(simd: pulp::x86::V3, [a, b]: &[[f64; 4]; 2], w: f64) -> pulp::f64x4 {
    simd.mul_add_f64x4(pulp::cast(*b), simd.splat_f64x4(w), pulp::cast(*a))
}

/// Rows as columns.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn turned(simd: pulp::x86::V3, rows: [pulp::f64x4; 4]) -> [pulp::f64x4; 4] {
    let [a, b, c, d] = rows.map(pulp::cast);
    let avx = simd.avx;
    let (even, odd) = (avx._mm256_unpacklo_pd(a, b), avx._mm256_unpackhi_pd(a, b));
    let (even_2, odd_2) = (avx._mm256_unpacklo_pd(c, d), avx._mm256_unpackhi_pd(c, d));
    [
        pulp::cast(avx._mm256_permute2f128_pd::<0x20>(even, even_2)),
        pulp::cast(avx._mm256_permute2f128_pd::<0x20>(odd, odd_2)),
        pulp::cast(avx._mm256_permute2f128_pd::<0x31>(even, even_2)),
        pulp::cast(avx._mm256_permute2f128_pd::<0x31>(odd, odd_2)),
    ]
}

#[cfg(target_arch = "x86_64")]
impl Lanes<8> for pulp::x86::V4 {
    type Vector = pulp::f64x8;

    #[inline(always)]
    fn load(self, from: &[f64; 8]) -> pulp::f64x8 {
        pulp::cast(*from)
    }

    #[inline(always)]
    fn store(self, from: pulp::f64x8, to: &mut [f64; 8]) {
        *to = pulp::cast(from);
    }

    #[inline(always)]
    fn all(self, value: f64) -> pulp::f64x8 {
        self.splat_f64x8(value)
    }

    #[inline(always)]
    fn add(self, a: pulp::f64x8, b: pulp::f64x8) -> pulp::f64x8 {
        self.add_f64x8(a, b)
    }

    #[inline(always)]
    fn sub(self, a: pulp::f64x8, b: pulp::f64x8) -> pulp::f64x8 {
        self.sub_f64x8(a, b)
    }

    #[inline(always)]
    fn mul_add(self, a: pulp::f64x8, b: pulp::f64x8, c: pulp::f64x8) -> pulp::f64x8 {
        self.mul_add_f64x8(a, b, c)
    }

    #[inline(always)]
    fn root(self, a: pulp::f64x8) -> pulp::f64x8 {
        self.sqrt_f64x8(a)
    }

    #[inline(always)]
    fn size(self, a: pulp::f64x8) -> pulp::f64x8 {
        self.abs_f64x8(a)
    }

    #[inline(always)]
    fn xor(self, a: pulp::f64x8, b: pulp::f64x8) -> pulp::f64x8 {
        self.xor_f64x8(a, b)
    }

    #[inline(always)]
    fn all_below(self, a: pulp::f64x8, b: pulp::f64x8) -> bool {
        self.cmp_lt_f64x8(a, b).0 == 0xff
    }

    #[inline(always)]
    fn max(self, a: pulp::f64x8, b: pulp::f64x8) -> pulp::f64x8 {
        pulp::cast(self.avx512f._mm512_max_pd(pulp::cast(a), pulp::cast(b)))
    }

    #[inline(always)]
    fn min(self, a: pulp::f64x8, b: pulp::f64x8) -> pulp::f64x8 {
        pulp::cast(self.avx512f._mm512_min_pd(pulp::cast(a), pulp::cast(b)))
    }

    #[inline(always)]
    fn if_below(self, a: pulp::f64x8, then: pulp::f64x8, or: pulp::f64x8) -> pulp::f64x8 {
        self.select_f64x8(self.cmp_lt_f64x8(a, self.splat_f64x8(0.0)), then, or)
    }

    #[inline(always)]
    fn if_zero(self, a: pulp::f64x8, then: pulp::f64x8) -> pulp::f64x8 {
        let none = self.splat_f64x8(0.0);
        self.select_f64x8(self.cmp_eq_f64x8(a, none), then, none)
    }

    #[inline(always)]
    fn columns(self, rows: [&[f64; 4]; 8]) -> [pulp::f64x8; 4] {
        let [a, b, c, d, e, f, g, h] = rows;
        let pairs = [
            pair(self, pulp::cast(*a), pulp::cast(*c)),
            pair(self, pulp::cast(*b), pulp::cast(*d)),
            pair(self, pulp::cast(*e), pulp::cast(*g)),
            pair(self, pulp::cast(*f), pulp::cast(*h)),
        ];
        turned_in_pairs(self, pairs)
    }

    #[inline(always)]
    fn mixed_columns(self, rows: [&[[f64; 4]; 2]; 8], w: &[f64; 8]) -> [pulp::f64x8; 3] {
        let [a, b, c, d, e, f, g, h] = rows;
        let pairs = [
            pair(self, mixed(*self, a, w[0]), mixed(*self, c, w[2])),
            pair(self, mixed(*self, b, w[1]), mixed(*self, d, w[3])),
            pair(self, mixed(*self, e, w[4]), mixed(*self, g, w[6])),
            pair(self, mixed(*self, f, w[5]), mixed(*self, h, w[7])),
        ];
        let [a, b, c, _] = turned_in_pairs(self, pairs);
        [a, b, c]
    }
}

/// Two rows in one vector.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn pair(simd: pulp::x86::V4, low: pulp::f64x4, high: pulp::f64x4) -> core::arch::x86_64::__m512d {
    let avx = simd.avx512f;
    let low = avx._mm512_castpd256_pd512(pulp::cast(low));
    avx._mm512_insertf64x4::<1>(low, pulp::cast(high))
}

/// The rows of states 0 and 2, 1 and 3, 4 and 6, 5 and 7 as columns in the states' order.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn turned_in_pairs(
    simd: pulp::x86::V4,
    [a, b, c, d]: [core::arch::x86_64::__m512d; 4],
) -> [pulp::f64x8; 4] {
    let avx = simd.avx512f;
    let (even, odd) = (avx._mm512_unpacklo_pd(a, b), avx._mm512_unpackhi_pd(a, b));
    let (even_2, odd_2) = (avx._mm512_unpacklo_pd(c, d), avx._mm512_unpackhi_pd(c, d));
    [
        pulp::cast(avx._mm512_shuffle_f64x2::<0b10_00_10_00>(even, even_2)),
        pulp::cast(avx._mm512_shuffle_f64x2::<0b10_00_10_00>(odd, odd_2)),
        pulp::cast(avx._mm512_shuffle_f64x2::<0b11_01_11_01>(even, even_2)),
        pulp::cast(avx._mm512_shuffle_f64x2::<0b11_01_11_01>(odd, odd_2)),
    ]
}
