//! The mechanism between a gripper's encoder and its jaws, and widths out of counts.

use std::f64::consts::TAU;

use crate::reading::{SampleInstant, WidthReading};

/// From the encoder's angle to the jaw opening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Linkage {
    /// Two crank-and-rod halves that move against each other:
    /// `alpha = angle - zero_angle`, `x = crank cos(alpha) + sqrt(rod^2 - (crank sin(alpha))^2)`, `width = 2 x`.
    CrankAndRod {
        /// Encoder's angle at which the cranks point outwards, rad.
        zero_angle_rad: f64,
        /// Crank, m.
        crank_m: f64,
        /// Connecting rod, m; longer than the crank.
        rod_m: f64,
    },
    /// Rack and pinion, spindle, belt, slider: `width = width_at_zero + slope (angle - zero_angle)`.
    Linear {
        /// Encoder's angle at which the opening is known, rad.
        zero_angle_rad: f64,
        /// Opening there, m.
        width_at_zero_m: f64,
        /// Change of the opening with the angle, m/rad; negative when the jaws close as the angle grows.
        slope_m_per_rad: f64,
    },
}

impl Linkage {
    /// The Hoi! gripper: 64 deg, 38 mm, 44.4 mm.
    pub const HOI: Self = Self::CrankAndRod {
        zero_angle_rad: 64.0 * TAU / 360.0,
        crank_m: 0.038,
        rod_m: 0.0444,
    };

    /// Jaw opening, m, at the encoder's angle, rad.
    #[must_use]
    pub fn width_m(&self, angle_rad: f64) -> f64 {
        match *self {
            Self::CrankAndRod {
                zero_angle_rad,
                crank_m,
                rod_m,
            } => {
                let (sin, cos) = (angle_rad - zero_angle_rad).sin_cos();
                2.0 * (crank_m * cos + reach(crank_m, rod_m, sin))
            }
            Self::Linear {
                zero_angle_rad,
                width_at_zero_m,
                slope_m_per_rad,
            } => width_at_zero_m + slope_m_per_rad * (angle_rad - zero_angle_rad),
        }
    }

    /// Change of the jaw opening with the angle, m/rad.
    #[must_use]
    pub fn width_slope_m_per_rad(&self, angle_rad: f64) -> f64 {
        match *self {
            Self::CrankAndRod {
                zero_angle_rad,
                crank_m,
                rod_m,
            } => {
                let (sin, cos) = (angle_rad - zero_angle_rad).sin_cos();
                let reach = reach(crank_m, rod_m, sin).max(f64::MIN_POSITIVE);
                -2.0 * crank_m * sin * (1.0 + crank_m * cos / reach)
            }
            Self::Linear {
                slope_m_per_rad, ..
            } => slope_m_per_rad,
        }
    }
}

fn reach(crank_m: f64, rod_m: f64, sin: f64) -> f64 {
    (rod_m.powi(2) - (crank_m * sin).powi(2)).max(0.0).sqrt()
}

/// Widths of an encoder that gives positions only: the rate is the difference to the sample before.
#[derive(Debug)]
pub(crate) struct Widths {
    linkage: Linkage,
    before: Option<(f64, i64)>,
}

/// Two samples further apart than this give no rate, ns.
const TOO_OLD_NS: i64 = 500_000_000;

impl Widths {
    pub(crate) const fn new(linkage: Linkage) -> Self {
        Self {
            linkage,
            before: None,
        }
    }

    /// Forgets the sample before, after a pause.
    pub(crate) fn forget(&mut self) {
        self.before = None;
    }

    /// The reading of `counts` that stand for `angle_rad`. The rate is 0 where no sample before tells it.
    pub(crate) fn reading(
        &mut self,
        at: SampleInstant,
        counts: i32,
        angle_rad: f64,
    ) -> WidthReading {
        let width_m = self.linkage.width_m(angle_rad);
        let now_ns = at.device_ns.unwrap_or(at.arrival.as_nanos());
        let rate = self.before.and_then(|(width, ns)| {
            let step_ns = now_ns.saturating_sub(ns);
            (1..TOO_OLD_NS)
                .contains(&step_ns)
                .then(|| (width_m - width) / (step_ns as f64 * 1e-9))
        });
        self.before = Some((width_m, now_ns));
        WidthReading {
            at,
            width_m,
            width_rate_m_s: rate.unwrap_or(0.0),
            counts,
        }
    }
}

#[cfg(test)]
mod tests {
    use ft_wire::HostTime;

    use super::*;

    #[test]
    fn a_linear_linkage_is_a_line_and_its_slope() {
        let rack = Linkage::Linear {
            zero_angle_rad: 1.0,
            width_at_zero_m: 0.02,
            slope_m_per_rad: -0.01,
        };
        assert!((rack.width_m(2.5) - 0.005).abs() < 1e-15);
        assert_eq!(rack.width_slope_m_per_rad(7.0), -0.01);
    }

    #[test]
    fn a_rate_is_the_difference_to_the_sample_before_and_none_is_made_up() {
        let mut widths = Widths::new(Linkage::Linear {
            zero_angle_rad: 0.0,
            width_at_zero_m: 0.0,
            slope_m_per_rad: 0.1,
        });
        let mut rate = |ms: i64, angle: f64| {
            let at = SampleInstant {
                arrival: HostTime::from_nanos(ms * 1_000_000),
                device_ns: None,
            };
            widths.reading(at, 0, angle).width_rate_m_s
        };
        assert_eq!(rate(1_000, 1.0), 0.0);
        assert!((rate(1_010, 1.1) - 1.0).abs() < 1e-9);
        assert_eq!(rate(1_010, 1.2), 0.0, "two at one instant");
        assert_eq!(rate(3_000, 9.0), 0.0, "a long pause");
    }
}
