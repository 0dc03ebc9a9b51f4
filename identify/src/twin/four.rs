//! Four doubles at once, as far as the efforts of many states need them: in one vector of x86-64 with AVX2 and fused
//! multiplication, or as the compiler makes it of plain arrays.

/// How four doubles are worked with; the processor can.
pub(super) trait Four: Copy {
    /// Four doubles.
    type Vector: Copy;
    /// From memory.
    fn load(self, from: &[f64; 4]) -> Self::Vector;
    /// To memory.
    fn store(self, from: Self::Vector, to: &mut [f64; 4]);
    /// The same four times.
    fn all(self, value: f64) -> Self::Vector;
    /// a + b
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a - b
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// a b + c
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// Square roots of the sizes.
    fn root_of_size(self, a: Self::Vector) -> Self::Vector;
    /// The larger; the second where one is no number.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The smaller; the second where one is no number.
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `then` where `a` is below 0, elsewhere `or`.
    fn if_below(self, a: Self::Vector, then: Self::Vector, or: Self::Vector) -> Self::Vector;
    /// `then` where `a` is 0, elsewhere 0.
    fn if_zero(self, a: Self::Vector, then: Self::Vector) -> Self::Vector;
    /// Rows as columns.
    fn turned(self, rows: [Self::Vector; 4]) -> [Self::Vector; 4];
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

impl Four for Plain {
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
    fn root_of_size(self, a: [f64; 4]) -> [f64; 4] {
        a.map(|a| a.abs().sqrt())
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
    fn turned(self, rows: [[f64; 4]; 4]) -> [[f64; 4]; 4] {
        let column = |k: usize| [rows[0][k], rows[1][k], rows[2][k], rows[3][k]];
        [column(0), column(1), column(2), column(3)]
    }
}

#[cfg(target_arch = "x86_64")]
impl Four for pulp::x86::V3 {
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
    fn root_of_size(self, a: pulp::f64x4) -> pulp::f64x4 {
        self.sqrt_f64x4(self.abs_f64x4(a))
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
    fn turned(self, rows: [pulp::f64x4; 4]) -> [pulp::f64x4; 4] {
        let [a, b, c, d] = rows.map(pulp::cast);
        let avx = self.avx;
        let (even, odd) = (avx._mm256_unpacklo_pd(a, b), avx._mm256_unpackhi_pd(a, b));
        let (even_2, odd_2) = (avx._mm256_unpacklo_pd(c, d), avx._mm256_unpackhi_pd(c, d));
        [
            pulp::cast(avx._mm256_permute2f128_pd::<0x20>(even, even_2)),
            pulp::cast(avx._mm256_permute2f128_pd::<0x20>(odd, odd_2)),
            pulp::cast(avx._mm256_permute2f128_pd::<0x31>(even, even_2)),
            pulp::cast(avx._mm256_permute2f128_pd::<0x31>(odd, odd_2)),
        ]
    }
}
