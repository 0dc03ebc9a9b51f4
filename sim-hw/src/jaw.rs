//! The jaws' linkage: shaft angle to opening.
//!
//! With the shaft angle p, a = p - 64 deg, L1 = 0.038 m, L2 = 0.0444 m: `x = L1 cos a + sqrt(L2^2 - (L1 sin a)^2)`, opening = 2 x
//! (the gripper of the Hoi! data set).

const L1_M: f64 = 0.038;
const L2_M: f64 = 0.0444;
const OFFSET_DEG: f64 = 64.0;

/// Shaft angle, deg, for an opening, m; the opening is kept within what the linkage reaches.
pub(crate) fn shaft_degrees(opening_m: f64) -> f64 {
    let half = (0.5 * opening_m).clamp(L2_M - L1_M + 1e-4, L1_M + L2_M - 1e-4);
    // Law of cosines in the triangle of L1, L2 and the half opening.
    let cosine = (half * half + L1_M * L1_M - L2_M * L2_M) / (2.0 * half * L1_M);
    cosine.clamp(-1.0, 1.0).acos().to_degrees() + OFFSET_DEG
}

/// Shaft rate, deg/s, for an opening and its rate.
pub(crate) fn shaft_degrees_per_second(opening_m: f64, rate_m_s: f64) -> f64 {
    let step = 1e-5;
    (shaft_degrees(opening_m + step) - shaft_degrees(opening_m - step)) / (2.0 * step) * rate_m_s
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_linkage_is_inverted() {
        for degrees in [110.0_f64, 130.0, 160.0, 190.0] {
            let a = (degrees - 64.0).to_radians();
            let opening = 2.0 * (L1_M * a.cos() + (L2_M.powi(2) - (L1_M * a.sin()).powi(2)).sqrt());
            assert!((shaft_degrees(opening) - degrees).abs() < 1e-9);
        }
    }
}
