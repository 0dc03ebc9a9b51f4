//! Numbers as people read them.

/// `value ± std` with as many digits as the standard deviation deserves: at most six decimals, or three digits of a smaller value.
pub(crate) fn with_std(value: f64, std: f64) -> String {
    let size = if value == 0.0 { 1.0 } else { value.abs() };
    let most = (2.0 - size.log10().floor()).clamp(6.0, 12.0);
    let digits = if std > 0.0 {
        (1.0 - std.log10().floor()).clamp(0.0, most) as usize
    } else {
        3
    };
    format!("{value:.digits$} ± {std:.digits$}")
}

/// Three decimals, and three digits at least.
pub(crate) fn figure(value: f64) -> String {
    let size = if value == 0.0 { 1.0 } else { value.abs() };
    let digits = (2.0 - size.log10().floor()).clamp(3.0, 6.0) as usize;
    format!("{value:.digits$}")
}

/// To six digits, to keep files small.
pub(crate) fn six(value: f64) -> f64 {
    format!("{value:.5e}").parse().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_are_those_that_the_standard_deviation_deserves() {
        assert_eq!(with_std(1.999_999_68, 5.7e-7), "2.000000 ± 0.000001");
        assert_eq!(with_std(2.0e-5, 3.1e-6), "0.0000200 ± 0.0000031");
        assert_eq!(with_std(123.4, 12.0), "123 ± 12");
        assert_eq!(with_std(0.0, 0.25), "0.00 ± 0.25");
    }
}
